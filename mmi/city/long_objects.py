"""Long objects in parts: what misses too much of itself as a whole may be far, but for the part that the viewer stands beside.

The paper keeps a large object as geometry wherever its own parallax exceeds the threshold (section 6.2, figure 10). Here it is
cut by vertical planes first, parallel to the sides of the smallest rectangle around its footprint, into parts of equal length:
from then on these are objects like any others, near or far each for itself. Nothing of what is drawn moves: prisms are cut
into closed ones (walls along a cut are those of neighbours that touch), meshes are left open there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from shapely.geometry import LineString, MultiLineString, Polygon

from mmi.city.model import City, CityObject, Prism, TriangleMesh

__all__ = ["cut_objects"]

_LEAST = 4.0
"""Square metres: parts with a smaller footprint go to a neighbour."""
_DUST = 1e-6
"""Square metres: what is smaller is the rounding of a cut."""
_ROUNDING = 1e-6
"""Relative difference of areas that rounding makes."""
_ON = 1e-7
"""Metres: a vertex this close to a cut lies on it."""


def cut_objects(city: City, longest: float | None) -> City:
    """``city`` with all objects that are longer than ``longest`` metres, or wider, in parts that are not; None cuts nothing.

    Part k of an object has its id with ``#k`` behind (more of these marks where ids have some already), and says what it is
    ``part_of``. Parts are never cut again.
    """
    if longest is None or not city.objects:
        return city
    mark = "#"
    while any(mark in one.id for one in city.objects):
        mark += "#"
    left, bottom, right, top = shapely.bounds([one.footprint for one in city.objects]).T
    long = np.hypot(right - left, top - bottom) > longest
    objects: list[CityObject] = []
    for one, may_be in zip(city.objects, long.tolist(), strict=True):
        objects += _parts(one, longest, mark) if may_be and one.part_of is None else [one]
    return city if len(objects) == len(city.objects) else replace(city, objects=tuple(objects))


class _Grid:
    """Tiles of a rectangle in the ground plane."""

    def __init__(self, footprint: shapely.Geometry, longest: float) -> None:
        corners = shapely.get_coordinates(shapely.oriented_envelope(footprint))[:4]
        sides = np.array([corners[1] - corners[0], corners[3] - corners[0]])
        lengths = np.hypot(*sides.T)
        self.counts = np.maximum(np.ceil(lengths / longest - 1e-9), 1.0).astype(np.int64)
        self.steps = lengths / self.counts
        self.axes = sides / lengths[:, None]
        self.origin = corners[0]
        beyond = float(lengths.max())
        self.cuts = [(axis, k * self.steps[axis]) for axis in (0, 1) for k in range(1, self.counts[axis])]
        self.lines = MultiLineString(
            [
                LineString([self.origin + at * self.axes[axis] + t * beyond * self.axes[1 - axis] for t in (-0.5, 1.5)])
                for axis, at in self.cuts
            ]
        )

    def along(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n, 2) metres along both axes of ``points`` (n, 2 or more)."""
        return np.asarray((points[:, :2] - self.origin) @ self.axes.T)

    def tiles(self, points: NDArray[np.float64]) -> NDArray[np.int64]:
        """(n,) the tile that each of ``points`` (n, 2 or more) is in."""
        place = np.clip((self.along(points) // self.steps).astype(np.int64), 0, self.counts - 1)
        return np.asarray(place[:, 0] * self.counts[1] + place[:, 1])


def _parts(one: CityObject, longest: float, mark: str) -> list[CityObject]:
    grid = _Grid(one.footprint, longest)
    if not grid.cuts:
        return [one]
    prisms = _cut_prisms(one.prisms, grid)
    cores = {} if one.core is None else _cut_prisms(one.core, grid)
    part_of_tile = _tiles_to_parts({tile: sum(p.footprint.area for p in own) for tile, own in prisms.items()}, grid)
    solids: dict[int, tuple[Prism, ...]] = {}
    solid_cores: dict[int, tuple[Prism, ...]] = {}
    for parts, cut in ((solids, prisms), (solid_cores, cores)):
        for tile, own in sorted(cut.items()):
            part = int(part_of_tile[tile])
            parts[part] = (*parts.get(part, ()), *own)
    meshes: dict[int, TriangleMesh] = {}
    if one.mesh is not None:
        mesh = _cut_mesh(one.mesh, grid)
        part_of_triangle = part_of_tile[grid.tiles(mesh.vertices[mesh.triangles].mean(axis=1))]
        order = np.argsort(part_of_triangle, kind="stable")
        names, starts = np.unique(part_of_triangle[order], return_index=True)
        meshes = {int(k): mesh.picked(rows) for k, rows in zip(names, np.split(order, starts[1:]), strict=True)}
    found: list[CityObject] = []
    for part, solid in sorted(solids.items()):
        if one.mesh is not None and part not in meshes:
            continue  # prisms around nothing
        core = None if one.core is None else solid_cores.get(part, ())
        found.append(CityObject(f"{one.id}{mark}{len(found)}", solid, meshes.get(part), core, one.id))
    return found if len(found) > 1 else [one]


def _tiles_to_parts(areas: dict[int, float], grid: _Grid) -> NDArray[np.int64]:
    """(tiles,) itself for each tile of the grid; of one that holds next to nothing, the nearest that holds enough."""
    enough = [tile for tile, area in sorted(areas.items()) if area >= _LEAST] or [max(areas, key=areas.__getitem__)]
    places = grid.steps * np.stack(np.divmod(np.arange(grid.counts.prod()), grid.counts[1]), axis=-1)
    return np.array(enough, dtype=np.int64)[cKDTree(places[enough]).query(places)[1]]


def _cut_prisms(prisms: tuple[Prism, ...], grid: _Grid) -> dict[int, list[Prism]]:
    """Tile -> what lies in it."""
    found: dict[int, list[Prism]] = {}
    for prism in prisms:
        for face in _faces(prism.footprint, grid.lines):
            (tile,) = grid.tiles(shapely.get_coordinates(shapely.point_on_surface(face))).tolist()
            found.setdefault(tile, []).append(Prism(face, prism.bottom, prism.top))
    return found


def _faces(polygon: Polygon, lines: MultiLineString) -> list[Polygon]:
    """What lines cut a polygon into. Faces on both sides of a line have the same corners along it."""
    if not shapely.intersects(polygon, lines):
        return [polygon]
    edges = shapely.union(polygon.boundary, lines)  # divided where they meet
    faces = shapely.get_parts(shapely.polygonize(shapely.get_parts(edges)))
    faces = faces[shapely.contains(polygon, shapely.point_on_surface(faces))]
    if abs(float(shapely.area(faces).sum()) - polygon.area) > _ROUNDING * polygon.area:
        return [polygon]  # a ring so nearly along a line that they do not divide each other: it stays whole
    return [face for face in faces.tolist() if face.area > _DUST]


# ---------------------------------------------------------------------------------------------------------- meshes


def _cut_mesh(mesh: TriangleMesh, grid: _Grid) -> TriangleMesh:
    """The same surface with no triangle in two tiles. Both sides of a cut share its vertices."""
    for axis, at in grid.cuts:
        mesh = _cut_along(mesh, grid.along(mesh.vertices)[:, axis] - at)
    return mesh


def _cut_along(mesh: TriangleMesh, side: NDArray[np.float64]) -> TriangleMesh:
    """The same surface with no triangle on both sides of where ``side`` (n,), which each vertex has, changes its sign."""
    sign = np.where(np.abs(side) <= _ON, 0, np.sign(side)).astype(np.int64)
    signs = sign[mesh.triangles]
    cut = (signs.min(axis=1) < 0) & (signs.max(axis=1) > 0)
    if not cut.any():
        return mesh
    rows = np.flatnonzero(cut)
    # First comes the corner that is alone on its side; where another lies on the cut, that one.
    on = signs[rows] == 0
    alone = signs[rows] == -np.sign(signs[rows].sum(axis=1, keepdims=True))
    lonely = np.argmax(np.where(on.any(axis=1, keepdims=True), on, alone), axis=1)
    turn = (lonely[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(mesh.triangles[rows], turn, axis=1).astype(np.int64)
    uv = np.take_along_axis(mesh.uv[rows], turn[..., None], axis=1).astype(np.float64)
    through = on.any(axis=1)
    # Edges that the cut divides: both at the lonely corner, or the one across from a corner that lies on it.
    one = np.where(through[:, None], corners[:, [1, 2]], corners[:, [0, 1]])
    other = corners[:, [0, 2]]
    ends = np.sort(np.stack([one, np.where(through[:, None], one, other)], axis=1), axis=2)
    edges, place = np.unique(ends.reshape(-1, 2), axis=0, return_inverse=True)
    place = place.reshape(-1, 2) + len(mesh.vertices)
    share = (side[edges[:, 0]] / (side[edges[:, 0]] - side[edges[:, 1]]))[:, None]
    points = mesh.vertices[edges[:, 0]] + share * (mesh.vertices[edges[:, 1]] - mesh.vertices[edges[:, 0]])

    def between(first: int, second: int) -> NDArray[np.float64]:
        a, b = side[corners[:, first]], side[corners[:, second]]
        t = (a / np.where(a == b, 1.0, a - b))[:, None]
        return np.asarray(uv[:, first] + t * (uv[:, second] - uv[:, first]))

    a, b, c = corners.T
    ua, ub, uc = uv[:, 0], uv[:, 1], uv[:, 2]
    p, q = place.T
    up, uq, ur = between(0, 1), between(0, 2), between(1, 2)
    pieces = [
        (through, (a, b, p), (ua, ub, ur)),
        (through, (a, p, c), (ua, ur, uc)),
        (~through, (a, p, q), (ua, up, uq)),
        (~through, (p, b, c), (up, ub, uc)),
        (~through, (p, c, q), (up, uc, uq)),
    ]
    of = np.concatenate([np.flatnonzero(~cut), *(rows[where] for where, _, _ in pieces)])
    order = np.argsort(of, kind="stable")
    triangles = [mesh.triangles[~cut], *(np.stack(names, axis=1)[where] for where, names, _ in pieces)]
    coordinates = [mesh.uv[~cut], *(np.stack(values, axis=1)[where] for where, _, values in pieces)]
    return TriangleMesh(
        np.concatenate([mesh.vertices, points]),
        np.concatenate(triangles)[order].astype(np.int32),
        mesh.textures[of[order]],
        mesh.colors[of[order]],
        np.concatenate(coordinates)[order].astype(np.float32),
    )
