"""What is wrong with a solid, in the words of val3dity: rings, then polygons, then shells, then the solid.

A level is looked at only where the one below it is whole, so that one fault gives one code. Tolerances are val3dity's (1 cm
from the plane, 20 degrees between normals); vertices are the same when their coordinates are. Left out are the codes that
need more than one solid (501 and up) and those of cavities against each other (401 to 404).

Source: Ledoux, val3dity: validation of 3D GIS primitives according to the international standards (2018); ISO 19107.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from mmi.city.model import TriangleMesh
from mmi.city.triangulate import triangulate
from mmi.city.welding import weld
from mmi.reading.models.raw_meshes import linked

__all__ = ["NAMES", "Defect", "Surface", "check_mesh", "check_solid", "check_surfaces"]

NAMES = MappingProxyType({
    101: "TOO_FEW_POINTS", 102: "CONSECUTIVE_POINTS_SAME", 104: "RING_SELF_INTERSECTION", 201: "INTERSECTION_RINGS",
    203: "NON_PLANAR_POLYGON_DISTANCE_PLANE", 204: "NON_PLANAR_POLYGON_NORMALS_DEVIATION",
    205: "POLYGON_INTERIOR_DISCONNECTED", 206: "INNER_RING_OUTSIDE", 207: "INNER_RINGS_NESTED",
    208: "ORIENTATION_RINGS_SAME", 301: "TOO_FEW_POLYGONS", 302: "SHELL_NOT_CLOSED", 303: "NON_MANIFOLD_CASE",
    305: "MULTIPLE_CONNECTED_COMPONENTS", 306: "SHELL_SELF_INTERSECTION", 307: "POLYGON_WRONG_ORIENTATION",
    405: "WRONG_ORIENTATION_SHELL",
})  # fmt: skip
"""val3dity's names of the codes that are looked for here."""

_OFF_PLANE = 0.01  # metres
_BENT = np.cos(np.radians(20.0))
_NO_AREA = 1e-9  # square metres
_TOUCH = 0.001  # metres: surfaces that come no deeper into each other only touch
_SLIVER = 0.001  # metres: the normal of a thinner triangle says nothing
_REASONS = MappingProxyType({
    "Hole lies outside shell": 206, "Holes are nested": 207, "Nested holes": 207, "Interior is disconnected": 205,
})  # fmt: skip

Surface = Sequence[Sequence[int]]


@dataclass(frozen=True, slots=True, order=True)
class Defect:
    """``code`` and ``name`` as val3dity's (0 for what is no matter of geometry); ``where`` it is, in words."""

    code: int
    name: str
    where: str


@dataclass(frozen=True, slots=True, eq=False)
class _Faces:
    """Polygons as corners one after the other; a ring is a run of corners, a polygon a run of rings, outer ring first.

    Of each corner (k,): ``vertex``, welded; ``points`` (k, 3) metres, relative to the first corner; ``flat`` (k, 2) the same
    in the plane of its polygon, seen from outside; ``ring``; ``following``, the next corner in its ring.
    Of each ring (r,): ``polygon``; ``number`` within it, 0 the outer; ``area`` (r, 3) twice its area along its normal.
    Of each polygon (p,): ``mean`` (p, 3) of its corners; ``normal`` (p, 3) of its outer ring, 0 where that has no area.
    """

    vertex: NDArray[np.int64]
    points: NDArray[np.float64]
    flat: NDArray[np.float64]
    ring: NDArray[np.int64]
    following: NDArray[np.int64]
    polygon: NDArray[np.int64]
    number: NDArray[np.int64]
    area: NDArray[np.float64]
    mean: NDArray[np.float64]
    normal: NDArray[np.float64]


def check_mesh(mesh: TriangleMesh, *, where: str = "", self_intersections: bool = True) -> list[Defect]:
    """What keeps the mesh from being the outer shell of a solid; empty where nothing does."""
    surfaces = [[triangle] for triangle in mesh.triangles.tolist()]
    return check_solid(mesh.vertices, [surfaces], where=where, self_intersections=self_intersections)


def check_solid(
    vertices: ArrayLike, shells: Sequence[Sequence[Surface]], *, where: str = "", self_intersections: bool = True
) -> list[Defect]:
    """Defects of a solid: ``shells`` as in CityJSON (surfaces of rings of indices into ``vertices`` (n, 3)), outer first.

    ``where`` goes before the place of each defect. ``self_intersections``: also look for surfaces that pierce each other.
    """
    found = []
    for number, surfaces in enumerate(shells):
        place = f"{where}: shell {number}" if where else f"shell {number}"
        faces = _faces(vertices, surfaces)
        defects = _surface_defects(faces, place)
        if not defects:
            defects = _shell_defects(faces, place, self_intersections)
        if not defects:
            enclosed = (faces.mean[faces.polygon] * faces.area).sum() / 6.0
            if (enclosed < 0.0) == (number == 0):
                defects = [_defect(405, place)]
        found += defects
    return found


def check_surfaces(vertices: ArrayLike, surfaces: Sequence[Surface], *, where: str = "") -> list[Defect]:
    """Defects of polygons that need not enclose anything: codes 101 to 208."""
    return _surface_defects(_faces(vertices, surfaces), where)


def _defect(code: int, *places: str) -> Defect:
    return Defect(code, NAMES[code], ", ".join(place for place in places if place))


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """np.cross for (n, 3), which is slow for few."""
    result: NDArray[np.float64] = a[:, [1, 2, 0]] * b[:, [2, 0, 1]] - a[:, [2, 0, 1]] * b[:, [1, 2, 0]]
    return result


def _length(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) -> (n,)"""
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=1)))


def _faces(vertices: ArrayLike, surfaces: Sequence[Surface]) -> _Faces:
    rings = [ring for surface in surfaces for ring in surface]
    counts = np.array([len(surface) for surface in surfaces], dtype=np.int64)
    lengths = np.array([len(ring) for ring in rings], dtype=np.int64)
    corners = np.array([index for ring in rings for index in ring], dtype=np.int64)
    points = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)[corners]
    vertex = weld(points)
    points = points - points[:1]
    starts = np.cumsum(lengths) - lengths
    following = np.arange(1, len(corners) + 1)
    following[(starts + lengths)[lengths > 0] - 1] = starts[lengths > 0]
    ring = np.repeat(np.arange(len(rings)), lengths)
    polygon = np.repeat(np.arange(len(surfaces)), counts)
    number = np.arange(len(rings)) - np.repeat(np.cumsum(counts) - counts, counts)
    of = polygon[ring]

    start = points[starts[ring]]
    area = _sums(_cross(points - start, points[following] - start), ring, len(rings))
    mean = _sums(points, of, len(surfaces)) / np.maximum(np.bincount(of, minlength=len(surfaces)), 1)[:, None]
    normal = np.zeros((len(surfaces), 3))
    normal[polygon[number == 0]] = area[number == 0]
    size = _length(normal)[:, None]
    normal = np.where(size > _NO_AREA, normal / np.maximum(size, _NO_AREA), 0.0)
    u = _cross(np.eye(3)[np.abs(normal).argmin(axis=1)], normal)
    u /= np.maximum(_length(u), 1e-9)[:, None]
    offset = points - mean[of]
    flat = np.stack([(offset * u[of]).sum(axis=1), (offset * _cross(normal, u)[of]).sum(axis=1)], axis=1)
    return _Faces(vertex, points, flat, ring, following, polygon, number, area, mean, normal)


def _sums(values: NDArray[np.float64], group: NDArray[np.int64], groups: int) -> NDArray[np.float64]:
    """(n, 3) -> (groups, 3)"""
    return np.stack([np.bincount(group, weights=column, minlength=groups) for column in values.T], axis=1)


# ---------------------------------------------------------------------------------------------- rings and polygons


def _bad_rings(faces: _Faces) -> NDArray[np.int64]:
    """(r,) the code of what is wrong with each ring, or 0."""
    code = np.zeros(len(faces.polygon), dtype=np.int64)
    code[faces.ring[faces.vertex == faces.vertex[faces.following]]] = 102
    code[np.bincount(faces.ring, minlength=len(code)) < 3] = 101
    good = np.flatnonzero(code == 0)
    simple = shapely.is_simple(_lines(faces, code == 0))
    code[good[~simple | (_length(faces.area[good]) < _NO_AREA)]] = 104
    return code


def _lines(faces: _Faces, chosen: NDArray[np.bool_]) -> NDArray[np.object_]:
    """The chosen rings (r,) in their polygon's plane."""
    if not chosen.any():
        return np.empty(0, dtype=object)
    keep = chosen[faces.ring]
    return np.asarray(shapely.linearrings(faces.flat[keep], indices=(np.cumsum(chosen) - 1)[faces.ring[keep]]))


def _surface_defects(faces: _Faces, where: str) -> list[Defect]:
    rings = _bad_rings(faces)
    whole = np.bincount(faces.polygon, minlength=len(faces.mean)) > 0
    whole[faces.polygon[rings > 0]] = False
    polygons = _bad_polygons(faces, whole)
    places = [(rings[i], f"surface {faces.polygon[i]}, ring {faces.number[i]}") for i in np.flatnonzero(rings)]
    places += [(polygons[i], f"surface {i}") for i in np.flatnonzero(polygons)]
    return [_defect(int(code), where, place) for code, place in places]


def _bad_polygons(faces: _Faces, whole: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(p,) the code of what is wrong with each polygon whose rings are ``whole``, or 0."""
    code = np.zeros(len(faces.mean), dtype=np.int64)
    polygon = faces.polygon[faces.ring]
    off = np.abs(((faces.points - faces.mean[polygon]) * faces.normal[polygon]).sum(axis=1))
    code[polygon[off > _OFF_PLANE]] = 203
    inner = faces.number > 0
    alike = (faces.area * faces.normal[faces.polygon]).sum(axis=1) > 0.0
    code[faces.polygon[inner & alike]] = 208
    for i in np.unique(faces.polygon[inner]):
        if whole[i] and code[i] == 0:
            rings = _lines(faces, faces.polygon == i)
            reason = shapely.is_valid_reason(shapely.Polygon(rings[0], list(rings[1:])))
            if reason != "Valid Geometry":
                code[i] = next((number for text, number in _REASONS.items() if reason.startswith(text)), 201)
    code[_bent(faces, whole & (code == 0))] = 204
    code[~whole] = 0
    return code


def _bent(faces: _Faces, chosen: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Which of the chosen polygons have a triangle that leans away from them."""
    corners = np.bincount(faces.polygon[faces.ring], minlength=len(chosen))
    triangles, of = _triangles(faces, chosen & (corners > 3))
    p, q, r = (faces.points[triangles[:, k]] for k in range(3))
    cross = _cross(q - p, r - p)
    size = _length(cross)
    longest = np.maximum.reduce([_length(p - q), _length(q - r), _length(r - p)])
    leans = (cross * faces.normal[of]).sum(axis=1) < _BENT * size
    return of[leans & (size > _SLIVER * longest)]


def _triangles(faces: _Faces, chosen: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Triangles (m, 3) of corners that fill the chosen polygons (p,), and the polygon of each (m,)."""
    rings = chosen[faces.polygon]
    if not rings.any():
        return np.empty((0, 3), dtype=np.int64), np.empty(0, dtype=np.int64)
    if (np.bincount(faces.ring, minlength=len(rings))[rings] == 3).all():
        corner = np.flatnonzero(rings[faces.ring]).reshape(-1, 3)
        return corner, faces.polygon[faces.ring[corner[:, 0]]]
    renumbered = (np.cumsum(chosen) - 1)[faces.polygon[rings]]
    _, triangles, of = triangulate(shapely.polygons(_lines(faces, rings), indices=renumbered))
    corners = np.flatnonzero(rings[faces.ring])
    return corners[triangles], np.flatnonzero(chosen)[of[triangles[:, 0]]]


# ---------------------------------------------------------------------------------------------------------- shells


def _shell_defects(faces: _Faces, where: str, self_intersections: bool) -> list[Defect]:
    if len(faces.mean) < 4:
        return [_defect(301, where, f"{len(faces.mean)} surfaces")]
    a, b = faces.vertex, faces.vertex[faces.following]
    low, high = np.minimum(a, b), np.maximum(a, b)
    _, first, edge, uses = np.unique(
        low * (len(a) + 1) + high, return_index=True, return_inverse=True, return_counts=True
    )
    forward = np.bincount(edge, weights=a < b, minlength=len(uses))
    for code, wrong in (
        (302, uses == 1),
        (303, uses > 2),
        (307, (uses == 2) & (forward != 1)),
    ):
        if wrong.any():
            place = f"surface {faces.polygon[faces.ring[first[np.flatnonzero(wrong)[0]]]]}"
            return [_defect(code, where, f"{np.count_nonzero(wrong)} edges, the first of {place}")]
    if (parts := _pieces(faces.polygon[faces.ring], a, len(faces.mean))) > 1:
        return [_defect(305, where, f"{parts} components")]
    # Each edge joins the corners at either end of it; all corners of a vertex are to be joined.
    pairs = np.argsort(edge, kind="stable").reshape(-1, 2)
    i, j = pairs.T
    links = np.concatenate([np.stack([i, faces.following[j]]), np.stack([faces.following[i], j])], axis=1)
    fans = _components(links[0], links[1], len(a))
    if (extra := fans - len(np.unique(a))) > 0:
        return [_defect(303, where, f"{extra} vertices where it only touches itself")]
    if self_intersections and (pierced := _pierced(faces)) is not None:
        return [_defect(306, where, f"surfaces {pierced[0]} and {pierced[1]}")]
    return []


def _components(a: NDArray[np.int64], b: NDArray[np.int64], count: int) -> int:
    """How many parts ``count`` nodes fall into that are linked a[i] to b[i]."""
    return int(linked(count, a, b).max(initial=-1)) + 1


def _pieces(polygon: NDArray[np.int64], vertex: NDArray[np.int64], polygons: int) -> int:
    """Into how many parts polygons fall that are linked by sharing a vertex."""
    vertices = int(vertex.max()) + 1
    return _components(polygon, polygons + vertex, polygons + vertices)


def _pierced(faces: _Faces) -> tuple[int, int] | None:
    """Two surfaces that pierce or cover each other, if there are any."""
    triangles, of = _triangles(faces, np.ones(len(faces.mean), dtype=bool))
    corners = faces.points[triangles]
    low, high = corners.min(axis=1), corners.max(axis=1)
    boxes = shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1])
    i, j = shapely.STRtree(boxes).query(boxes)
    near = (i < j) & (of[i] != of[j]) & (low[i, 2] <= high[j, 2]) & (low[j, 2] <= high[i, 2])
    i, j = i[near], j[near]
    normal = _cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(_length(normal), 1e-12)[:, None]
    for one, other in ((i, j), (j, i)):
        height = ((corners[one] - corners[other][:, :1]) * normal[other][:, None]).sum(axis=2)
        for find in (_pierces, _covers):
            hit = find(corners[one], corners[other], normal[other], height)
            if len(hit):
                return int(of[one[hit[0]]]), int(of[other[hit[0]]])
    return None


def _pierces(
    one: NDArray[np.float64], other: NDArray[np.float64], normal: NDArray[np.float64], height: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Where an edge of ``one`` goes through ``other``, both (m, 3 corners, 3), by more than a touch.

    ``normal`` (m, 3) of ``other``, ``height`` (m, 3 corners) of ``one`` above it.
    """
    hits = [np.empty(0, dtype=np.int64)]
    for s, t in ((0, 1), (1, 2), (2, 0)):
        apart = (height[:, s] * height[:, t] < 0.0) & (np.minimum(np.abs(height[:, s]), np.abs(height[:, t])) > _TOUCH)
        rows = np.flatnonzero(apart)
        share = height[rows, s] / (height[rows, s] - height[rows, t])
        point = one[rows, s] + share[:, None] * (one[rows, t] - one[rows, s])
        inside = np.ones(len(rows), dtype=bool)
        for k in range(3):
            along = other[rows, (k + 1) % 3] - other[rows, k]
            inwards = (_cross(normal[rows], along) * (point - other[rows, k])).sum(axis=1)
            inside &= inwards > _TOUCH * _length(along)
        hits.append(rows[inside])
    return np.concatenate(hits)


def _covers(
    one: NDArray[np.float64], other: NDArray[np.float64], normal: NDArray[np.float64], height: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Where two triangles lie in one plane and share some of it; arguments as of :func:`_pierces`."""
    rows = np.flatnonzero((np.abs(height) < _TOUCH).all(axis=1) & (np.abs(normal).max(axis=1) > 0.5))
    if not len(rows):
        return rows
    axes = np.array([[1, 2], [2, 0], [0, 1]])[np.abs(normal[rows]).argmax(axis=1)]
    first, second = (shapely.polygons(np.take_along_axis(x[rows], axes[:, None], axis=2)) for x in (one, other))
    return np.asarray(rows[shapely.area(shapely.intersection(first, second)) > _TOUCH])
