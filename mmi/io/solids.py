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
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mmi.city import TriangleMesh
from mmi.surfaces import triangulate

__all__ = ["NAMES", "Defect", "check_mesh", "check_solid", "check_surfaces", "is_closed", "volume", "weld"]

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

    ``vertex`` (k,) of each corner, welded; ``points`` (k, 3) metres, of corners, relative to the first; ``ring`` (k,) of
    each corner; ``following`` (k,) the next corner in its ring; ``polygon`` (r,) of each ring; ``outer`` (r,) which rings
    are; ``number`` (r,) of each ring within its polygon.
    """

    vertex: NDArray[np.int64]
    points: NDArray[np.float64]
    ring: NDArray[np.int64]
    following: NDArray[np.int64]
    polygon: NDArray[np.int64]
    outer: NDArray[np.bool_]
    number: NDArray[np.int64]
    polygons: int


def weld(vertices: ArrayLike) -> NDArray[np.int64]:
    """(n,) for each of ``vertices`` (n, 3) the number of its place: equal coordinates, equal numbers, from 0 without gaps."""
    points = np.asarray(vertices).reshape(-1, 3)
    order = np.lexsort(points.T)
    new = np.ones(len(points), dtype=bool)
    new[1:] = (points[order[1:]] != points[order[:-1]]).any(axis=1)
    place = np.empty(len(points), dtype=np.int64)
    place[order] = np.cumsum(new) - 1
    return place


def is_closed(vertices: ArrayLike, triangles: ArrayLike) -> bool:
    """Whether every directed edge has its opposite exactly once, equal vertices taken as one; nothing encloses nothing.

    ``vertices`` (n, 3), ``triangles`` (m, 3) indices. Triangles with two equal corners are no triangles.
    """
    corners = weld(vertices)[np.asarray(triangles, dtype=np.int64).reshape(-1, 3)]
    following = np.roll(corners, -1, axis=1)
    whole = (corners != following).all(axis=1)
    a, b = corners[whole].reshape(-1), following[whole].reshape(-1)
    if not len(a):
        return False
    count = int(max(a.max(), b.max())) + 1
    there, back = np.sort(a * count + b), np.sort(b * count + a)
    return bool((there[1:] != there[:-1]).all() and (there == back).all())


def volume(vertices: ArrayLike, triangles: ArrayLike) -> float:
    """Cubic metres that closed ``triangles`` (m, 3) of ``vertices`` (n, 3) enclose; negative where they face inwards."""
    chosen = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
    points = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)
    if not len(chosen):
        return 0.0
    a, b, c = np.moveaxis((points - points[chosen[0, 0]])[chosen], 1, 0)
    return float((a * np.cross(b, c)).sum() / 6.0)


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
        defects = _ring_defects(faces, place) + _polygon_defects(faces, place)
        if not defects:
            defects = _shell_defects(faces, place, self_intersections)
        if not defects:
            area = _newell(faces)
            enclosed = (_means(faces)[faces.polygon] * area).sum() / 6.0
            if (enclosed < 0.0) == (number == 0):
                defects = [_defect(405, place)]
        found += defects
    return found


def check_surfaces(vertices: ArrayLike, surfaces: Sequence[Surface], *, where: str = "") -> list[Defect]:
    """Defects of polygons that need not enclose anything: codes 101 to 208."""
    faces = _faces(vertices, surfaces)
    return _ring_defects(faces, where) + _polygon_defects(faces, where)


def _defect(code: int, *places: str) -> Defect:
    return Defect(code, NAMES[code], ", ".join(place for place in places if place))


def _faces(vertices: ArrayLike, surfaces: Sequence[Surface]) -> _Faces:
    rings = [ring for surface in surfaces for ring in surface]
    counts = np.array([len(surface) for surface in surfaces], dtype=np.int64)
    lengths = np.array([len(ring) for ring in rings], dtype=np.int64)
    corners = np.array([index for ring in rings for index in ring], dtype=np.int64)
    points = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)[corners]
    ends = np.cumsum(lengths)
    following = np.arange(1, len(corners) + 1)
    following[ends[lengths > 0] - 1] = (ends - lengths)[lengths > 0]
    number = np.arange(len(rings)) - np.repeat(np.cumsum(counts) - counts, counts)
    return _Faces(
        vertex=weld(points),
        points=points - points[:1],
        ring=np.repeat(np.arange(len(rings)), lengths),
        following=following,
        polygon=np.repeat(np.arange(len(surfaces)), counts),
        outer=number == 0,
        number=number,
        polygons=len(surfaces),
    )


def _newell(faces: _Faces) -> NDArray[np.float64]:
    """(r, 3) twice the area of each ring along its normal."""
    start = np.searchsorted(faces.ring, faces.ring)  # the first corner of each corner's ring
    a, b = faces.points - faces.points[start], faces.points[faces.following] - faces.points[start]
    area = np.zeros((len(faces.polygon), 3))
    np.add.at(area, faces.ring, np.cross(a, b))
    return area


def _means(faces: _Faces) -> NDArray[np.float64]:
    """(p, 3) mean corner of each polygon."""
    polygon = faces.polygon[faces.ring]
    total = np.zeros((faces.polygons, 3))
    np.add.at(total, polygon, faces.points)
    return total / np.maximum(np.bincount(polygon, minlength=faces.polygons), 1)[:, None]


def _normals(faces: _Faces) -> NDArray[np.float64]:
    """(p, 3) unit normal of each polygon, by its outer ring; 0 where that has no area."""
    normal = np.zeros((faces.polygons, 3))
    normal[faces.polygon[faces.outer]] = _newell(faces)[faces.outer]
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.where(size > 1e-9, normal / np.maximum(size, 1e-9), 0.0)


def _flattened(faces: _Faces, normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """(k, 2) corners in the plane of their polygon, seen from outside."""
    axis = np.eye(3)[np.abs(normal).argmin(axis=1)]
    u = np.cross(axis, normal)
    u /= np.maximum(np.linalg.norm(u, axis=1, keepdims=True), 1e-9)
    v = np.cross(normal, u)
    polygon = faces.polygon[faces.ring]
    offset = faces.points - _means(faces)[polygon]
    return np.stack([(offset * u[polygon]).sum(axis=1), (offset * v[polygon]).sum(axis=1)], axis=1)


# ---------------------------------------------------------------------------------------------- rings and polygons


def _bad_rings(faces: _Faces) -> NDArray[np.int64]:
    """(r,) the code of what is wrong with each ring, or 0."""
    code = np.zeros(len(faces.polygon), dtype=np.int64)
    count = np.bincount(faces.ring, minlength=len(code))
    same = faces.vertex == faces.vertex[faces.following]
    code[faces.ring[same]] = 102
    code[count < 3] = 101
    good = code == 0
    rings, flat = _lines(faces, good)
    simple = np.ones(len(code), dtype=bool)
    simple[np.flatnonzero(good)] = shapely.is_simple(rings) if len(flat) else True
    area = np.linalg.norm(_newell(faces), axis=1)
    code[good & (~simple | (area < 1e-9))] = 104
    return code


def _lines(faces: _Faces, chosen: NDArray[np.bool_]) -> tuple[NDArray[np.object_], NDArray[np.float64]]:
    """The chosen rings as linear rings in their polygon's plane, and their corners (k', 2)."""
    keep = chosen[faces.ring]
    flat = _flattened(faces, _normals(faces))[keep]
    if not len(flat):
        return np.empty(0, dtype=object), flat
    renumbered = (np.cumsum(chosen) - 1)[faces.ring[keep]]
    return shapely.linearrings(flat, indices=renumbered), flat


def _ring_defects(faces: _Faces, where: str) -> list[Defect]:
    code = _bad_rings(faces)
    return [_defect(int(code[i]), where, _place(faces, i)) for i in np.flatnonzero(code)]


def _place(faces: _Faces, ring: int) -> str:
    return f"surface {faces.polygon[ring]}, ring {faces.number[ring]}"


def _polygon_defects(faces: _Faces, where: str) -> list[Defect]:
    """What is wrong with polygons whose rings are whole."""
    code = np.zeros(faces.polygons, dtype=np.int64)
    whole = np.ones(faces.polygons, dtype=bool)
    whole[faces.polygon[_bad_rings(faces) > 0]] = False
    whole[np.bincount(faces.polygon, minlength=faces.polygons) == 0] = False
    normal = _normals(faces)
    polygon = faces.polygon[faces.ring]
    off = np.abs(((faces.points - _means(faces)[polygon]) * normal[polygon]).sum(axis=1))
    code[polygon[off > _OFF_PLANE]] = 203
    area = _newell(faces)
    against = (area * normal[faces.polygon]).sum(axis=1) > 0.0
    code[faces.polygon[~faces.outer & against]] = 208
    # Triangles and polygons without holes are whole when their ring is.
    holed = np.zeros(faces.polygons, dtype=bool)
    holed[faces.polygon[~faces.outer]] = True
    for i in np.flatnonzero(whole & holed & (code == 0)):
        own = _lines(faces, faces.polygon == i)[0]
        reason = shapely.is_valid_reason(shapely.Polygon(own[0], list(own[1:])))
        if reason != "Valid Geometry":
            code[i] = next((number for text, number in _REASONS.items() if reason.startswith(text)), 201)
    code[_bent(faces, normal, whole & (code == 0))] = 204
    code[~whole] = 0
    return [_defect(int(code[i]), where, f"surface {i}") for i in np.flatnonzero(code)]


def _bent(faces: _Faces, normal: NDArray[np.float64], chosen: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Which of the chosen polygons have a triangle that leans away from them."""
    corners = np.bincount(faces.polygon[faces.ring], minlength=faces.polygons)
    chosen = chosen & (corners > 3)
    triangles, of = _triangles(faces, chosen)
    p, q, r = np.moveaxis(faces.points[triangles], 1, 0)
    cross = np.cross(q - p, r - p)
    size = np.linalg.norm(cross, axis=1)
    longest = np.sqrt(np.maximum.reduce([((x - y) ** 2).sum(axis=1) for x, y in ((p, q), (q, r), (r, p))]))
    thick = size > _SLIVER * longest
    return of[thick & ((cross * normal[of]).sum(axis=1) < _BENT * size)]


def _triangles(faces: _Faces, chosen: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Triangles (m, 3) of corners that fill the chosen polygons, and the polygon of each (m,)."""
    if not chosen.any():
        return np.empty((0, 3), dtype=np.int64), np.empty(0, dtype=np.int64)
    rings = chosen[faces.polygon]
    lines, _ = _lines(faces, rings)
    renumbered = (np.cumsum(chosen) - 1)[faces.polygon[rings]]
    _, triangles, of = triangulate(shapely.polygons(lines, indices=renumbered))
    corner = np.flatnonzero(rings[faces.ring])
    return corner[triangles], np.flatnonzero(chosen)[of[triangles[:, 0]]]


# ---------------------------------------------------------------------------------------------------------- shells


def _shell_defects(faces: _Faces, where: str, self_intersections: bool) -> list[Defect]:
    if faces.polygons < 4:
        return [_defect(301, where, f"{faces.polygons} surfaces")]
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
    if (parts := _pieces(faces.polygon[faces.ring], a, faces.polygons)) > 1:
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
    return int(connected_components(coo_array((np.ones(len(a), dtype=np.int8), (a, b)), (count, count)))[0])


def _pieces(polygon: NDArray[np.int64], vertex: NDArray[np.int64], polygons: int) -> int:
    """Into how many parts polygons fall that are linked by sharing a vertex."""
    vertices = int(vertex.max()) + 1
    return _components(polygon, polygons + vertex, polygons + vertices)


def _pierced(faces: _Faces) -> tuple[int, int] | None:
    """Two surfaces that pierce or cover each other, if there are any."""
    triangles, of = _triangles(faces, np.ones(faces.polygons, dtype=bool))
    corners = faces.points[triangles]
    low, high = corners.min(axis=1), corners.max(axis=1)
    boxes = shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1])
    i, j = shapely.STRtree(boxes).query(boxes)
    near = (i < j) & (of[i] != of[j]) & (low[i, 2] <= high[j, 2]) & (low[j, 2] <= high[i, 2])
    i, j = i[near], j[near]
    one, other = corners[i], corners[j]
    hit = _edges_pierce(one, other) | _edges_pierce(other, one) | _cover(one, other)
    where = np.flatnonzero(hit)
    return (int(of[i[where[0]]]), int(of[j[where[0]]])) if len(where) else None


def _plane(triangles: NDArray[np.float64]) -> NDArray[np.float64]:
    """(m, 3) unit normals of triangles (m, 3, 3)."""
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-12)


def _edges_pierce(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(m,) whether an edge of ``one`` goes through ``other``, both (m, 3, 3), by more than a touch."""
    normal = _plane(other)
    height = ((one - other[:, :1]) * normal[:, None]).sum(axis=2)
    hit = np.zeros(len(one), dtype=bool)
    for s, t in ((0, 1), (1, 2), (2, 0)):
        above, below = height[:, s], height[:, t]
        through = (above * below < 0.0) & (np.minimum(np.abs(above), np.abs(below)) > _TOUCH)
        share = above / np.where(through, above - below, 1.0)
        point = one[:, s] + share[:, None] * (one[:, t] - one[:, s])
        for k in range(3):
            along = other[:, (k + 1) % 3] - other[:, k]
            inwards = (np.cross(normal, along) * (point - other[:, k])).sum(axis=1)
            through &= inwards > _TOUCH * np.linalg.norm(along, axis=1)
        hit |= through
    return hit


def _cover(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(m,) whether two triangles lie in one plane and share some of it."""
    normal = _plane(one)
    off = np.abs(((other - one[:, :1]) * normal[:, None]).sum(axis=2)).max(axis=1)
    flat = np.flatnonzero((off < _TOUCH) & (np.linalg.norm(normal, axis=1) > 0.5))
    hit = np.zeros(len(one), dtype=bool)
    if len(flat):
        axes = np.array([[1, 2], [2, 0], [0, 1]])[np.abs(normal[flat]).argmax(axis=1)]
        first, second = (shapely.polygons(np.take_along_axis(x[flat], axes[:, None], axis=2)) for x in (one, other))
        hit[flat] = shapely.area(shapely.intersection(first, second)) > _TOUCH
    return hit
