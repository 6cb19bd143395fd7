"""Meshes of buildings become city objects: where they stand, prisms that bound them, and cores that surely hide others.

**Bounds.** All of a mesh lies over its projection, between its lowest and highest point; where much of that is air, higher
prisms stand on what is left of the projection at a few heights.

**Cores.** Let every directed edge of a mesh have as many opposites (solids, also several that touch), but for edges at its
foot (where the floor is missing). Above the foot, and below every face that looks up over some area, a vertical line
through that area has crossed faces that look down only: it is inside. So over the projection less that of all faces that
look up and reach below a height h, or look down and reach above the foot, a prism up to h is solid. Pieces of a mesh that
share no points are looked at one by one, since no sight passes any of them. What meshes hide that are not closed in this sense,
:mod:`mmi.reading.models.enclosures` finds once they stand on the ground.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import MultiPolygon, Polygon
from shapely.geometry.base import BaseGeometry

from mmi.city.model import CityObject, Prism, TriangleMesh
from mmi.city.welding import weld
from mmi.foundation.errors import CityError
from mmi.reading.ground.relief import no_height
from mmi.reading.models.needles import without_needles
from mmi.reading.models.raw_meshes import linked
from mmi.reading.raw_layers import ModelLayer
from mmi.reading.report import Ledger
from mmi.reading.steps import Progress, counted_step

__all__ = ["objects_from_models", "outline_within"]

_FOOT = 1.0
"""Metres above a mesh's lowest point up to which its floor may lie or be missing."""
_LEVEL = 1e-3
"""A triangle whose unit normal has a vertical part below this is a wall."""
_THIN = 0.02
"""Metres around walls that bound nothing (a sheet, a fence), so that they have a footprint."""
_GRID = 1e-3
"""Metres to which outlines are rounded: unions leave edges that no float can tell from nothing."""
_STEPS = 3
_CANDIDATES = 16
_WORTH = 0.15
"""Share of the bounding volume that another prism must save."""
_LEAST_CORE = 4.0
"""Square metres: smaller pieces of a core hide nothing worth a prism."""
_LOW_CORE = 2.0
"""Metres: lower pieces of a core hide nothing worth a prism, either."""
_ROUGH = 120
"""Outlines with more points than this are simplified; they only grow by it."""


def objects_from_models(
    layer: ModelLayer,
    move: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    ledger: Ledger,
    *,
    progress: Progress | None = None,
) -> tuple[tuple[CityObject, ...], frozenset[str]]:
    """The layer's buildings in the city's frame, into which ``move`` takes points (n, 3); each is told to ``progress``.

    Also the ids of those that are not closed, or in which nothing is.

    Raises:
        CityError: no building has a volume or an area.
    """
    objects: list[CityObject] = []
    open_ids: list[str] = []
    ends = np.cumsum([0, *(len(item.mesh.vertices) for item in layer.items)])
    moved = np.round(move(np.concatenate([item.mesh.vertices for item in layer.items])), 3) + 0.0
    items = counted_step(progress, "mending the buildings", layer.items)
    for item, (start, end) in zip(items, pairwise(ends.tolist()), strict=True):
        mesh = _cleaned(replace(item.mesh, vertices=moved[start:end]), item.id, ledger)
        if mesh is None:
            continue
        if no_height(mesh.vertices[:, 2]).any():
            ledger.note("left out", "building: a corner deeper than 1,500 m or higher than 30,000 m", item.id)
            continue
        foot = _foot(mesh)
        closed = foot <= mesh.vertices[:, 2].min() + _FOOT
        if closed and _volume(mesh) < 0.0:
            mesh = _turned(mesh)
            ledger.note("repaired", "building: faced inwards, turned", item.id)
        prisms = _bounds(mesh)
        if not prisms:
            ledger.note("left out", "building: no height or no area", item.id)
            continue
        bodies = [(mesh, foot)] if closed else []
        count, of = _bodies(mesh)
        if count > 1:
            bodies = list(_closed_bodies(mesh, count, of))
        if not closed:
            open_ids.append(item.id)
        core = tuple(prism for body, own_foot in bodies for prism in _core(body, own_foot))
        objects.append(CityObject(item.id, prisms, mesh, core))
    if not objects:
        why = ledger.why_left_out("building")
        raise CityError(
            f"{layer.file}: no buildings; expected objects with surfaces, found {len(layer.items)} without{why}"
        )
    return tuple(objects), frozenset(open_ids)


def _cleaned(mesh: TriangleMesh, name: str, ledger: Ledger) -> TriangleMesh | None:
    """Without triangles that have no area or repeat another; None where nothing is left."""
    if not len(mesh.triangles):
        ledger.note("left out", "building: no surface with an area", name)
        return None
    mesh = without_needles(mesh)
    corners = mesh.vertices[mesh.triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    place = weld(mesh.vertices)
    _, order = np.unique(place, return_index=True)
    # Two that face each other are a wall between two solids: only the same way round is a repetition.
    triangles = place[mesh.triangles]
    turn = np.argmin(triangles, axis=1)
    rolled = np.take_along_axis(triangles, (turn[:, None] + np.arange(3)) % 3, axis=1)
    first = np.zeros(len(rolled), dtype=bool)
    first[np.unique((rolled[:, 0] * len(order) + rolled[:, 1]) * len(order) + rolled[:, 2], return_index=True)[1]] = (
        True
    )
    first |= area <= 1e-9  # these are dropped for another reason
    keep = (area > 1e-9) & first
    if not keep.any():
        ledger.note("left out", "building: no surface with an area", name)
        return None
    if not first.all():
        ledger.note("repaired", "building: repeated faces dropped", name, count=int((~first).sum()))
    # A point that no triangle uses is no part of the building, but would count in its bounds.
    used, corner = np.unique(triangles[keep], return_inverse=True)
    return TriangleMesh(
        mesh.vertices[order[used]],
        corner.reshape(-1, 3).astype(np.int32),
        mesh.textures[keep],
        mesh.colors[keep],
        mesh.uv[keep],
    )


def _foot(mesh: TriangleMesh) -> float:
    """The height above which all edges have their opposites; minus infinity where all have anyway."""
    a = mesh.triangles.reshape(-1).astype(np.int64)
    b = mesh.triangles[:, [1, 2, 0]].reshape(-1).astype(np.int64)
    count = len(mesh.vertices)
    edges, inverse = np.unique(np.minimum(a, b) * count + np.maximum(a, b), return_inverse=True)
    open_ = edges[np.bincount(inverse.reshape(-1), weights=np.where(a < b, 1.0, -1.0)) != 0.0]
    return float(mesh.vertices[np.append(open_ // count, open_ % count), 2].max(initial=-np.inf))


def _bodies(mesh: TriangleMesh) -> tuple[int, NDArray[np.int64]]:
    """How many pieces of a mesh share no points, and the piece (m,) of each triangle."""
    a, b, c = mesh.triangles.T
    of = linked(len(mesh.vertices), np.append(a, b), np.append(b, c))
    return int(of.max()) + 1, of[a]


def _closed_bodies(mesh: TriangleMesh, count: int, of: NDArray[np.int64]) -> Iterator[tuple[TriangleMesh, float]]:
    """The pieces that are closed and large enough for a core, with their feet.

    What may be open below stands on the ground; what starts higher up has a floor.
    """
    corners = mesh.vertices[mesh.triangles]
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, of, corners.min(axis=1))
    np.maximum.at(high, of, corners.max(axis=1))
    size = high - low
    for i in np.flatnonzero((size[:, 2] >= _LOW_CORE) & (size[:, 0] * size[:, 1] >= _LEAST_CORE)).tolist():
        used, places = np.unique(mesh.triangles[of == i], return_inverse=True)
        body = TriangleMesh(mesh.vertices[used], places.reshape(-1, 3).astype(np.int32))
        foot = _foot(body)
        if foot <= low[:, 2].min() + _FOOT:
            yield body, foot


def _volume(mesh: TriangleMesh) -> float:
    """Cubic metres; negative where faces look inwards. A missing floor is taken to lie at height 0 of the middle."""
    points = mesh.vertices - np.append(mesh.vertices[:, :2].mean(axis=0), mesh.vertices[:, 2].min())
    a, b, c = np.moveaxis(points[mesh.triangles], 1, 0)
    return float((a * np.cross(b, c)).sum() / 6.0)


def _turned(mesh: TriangleMesh) -> TriangleMesh:
    return TriangleMesh(mesh.vertices, mesh.triangles[:, ::-1], mesh.textures, mesh.colors, mesh.uv[:, ::-1])


def _bounds(mesh: TriangleMesh) -> tuple[Prism, ...]:
    """Prisms that hold all of the mesh: above each step those triangles that reach higher."""
    corners = mesh.vertices[mesh.triangles]
    highest = corners[:, :, 2].max(axis=1)
    low, high = float(corners[:, :, 2].min()), float(highest.max())
    if high - low < 0.01:
        return ()
    flat = _projected(corners)
    tops = [low, *_steps(corners, highest, low, high), high]
    prisms: list[Prism] = []
    for bottom, top in pairwise(tops):
        above = (highest > bottom) | (bottom == low)
        prisms += [Prism(part, bottom, top) for part in _outline(flat[above], corners[above])]
    return tuple(prisms)


def _steps(corners: NDArray[np.float64], highest: NDArray[np.float64], low: float, high: float) -> list[float]:
    """Heights at which the projection gets so much smaller that another prism pays, sorted."""
    plan = corners[:, :, :2]
    sides = plan[:, 1:] - plan[:, :1]
    area = 0.25 * np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])  # tops and floors
    candidates = np.unique(np.quantile(highest, np.linspace(0.0, 1.0, _CANDIDATES), method="lower"))
    candidates = candidates[(candidates > low + 0.5) & (candidates < high - 0.5)]
    ends = np.concatenate([[low], candidates])
    covered = np.array([area[highest > end].sum() for end in ends])  # of the projection, above each
    chosen: list[int] = [0]

    def bounded(places: list[int]) -> float:
        return float(covered[places] @ np.diff([*ends[places], high]))

    while len(chosen) < _STEPS:
        more = [sorted([*chosen, i]) for i in range(len(ends)) if i not in chosen]
        best = min(more, key=bounded, default=chosen)
        if bounded(chosen) - bounded(best) <= _WORTH * covered[0] * (high - low):
            break
        chosen = best
    return [float(ends[i]) for i in chosen[1:]]


def outline_within(mesh: TriangleMesh, bottom: float, top: float) -> list[Polygon]:
    """Polygons that cover what of a mesh may lie between the heights ``bottom`` and ``top`` (metres), seen from above.

    Walls that bound nothing there are sheets of a few centimetres: of a hollow shell, the space inside stays open.
    """
    corners = mesh.vertices[mesh.triangles]
    heights = corners[:, :, 2]
    within = (heights.max(axis=1) >= bottom) & (heights.min(axis=1) <= top)
    return _outline(_projected(corners[within]), corners[within]) if within.any() else []


def _projected(corners: NDArray[np.float64]) -> NDArray[np.object_]:
    """(m,) triangles seen from above; walls are lines."""
    return np.asarray(shapely.polygons(corners[:, [0, 1, 2, 0], :2]), dtype=object)


def _outline(flat: NDArray[np.object_], corners: NDArray[np.float64]) -> list[Polygon]:
    """Polygons that cover the projected triangles."""
    sides = corners[:, [1, 2, 0], :2] - corners[:, :, :2]
    doubled = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    # Triangles no wider than this would vanish in the grid of a union: they are lines, like walls.
    filled = np.abs(doubled) > 5.0 * _GRID * np.sqrt((sides**2).sum(axis=2).max(axis=1))
    up = filled & (doubled > 0.0)
    shape = _united(flat[up])
    flat = np.where(filled, flat, shapely.linestrings(corners[:, [0, 1, 2], :2]))
    covered = _covered(shape, flat)
    below = flat[filled & ~up & ~covered]  # none of a closed mesh, whose tops lie over it
    if len(below):
        shape = _united(np.append(below, shape))
        covered = _covered(shape, flat)
    rest = flat[~covered]  # walls that bound nothing, and needles, whose tips were lost
    if len(rest):
        shape = _united(np.append(shapely.buffer(rest, _THIN, cap_style="square", quad_segs=1), shape))
    if shapely.get_num_coordinates(shape) > _ROUGH:
        shape = shapely.set_precision(shape.buffer(0.1 + 2 * _GRID, join_style="mitre").simplify(0.1), _GRID)
    parts = [part for part in shapely.get_parts(shape) if part.geom_type == "Polygon" and not part.is_empty]
    return [part if part.area > 1e-4 else part.buffer(_THIN, join_style="mitre") for part in parts]


def _united(shapes: NDArray[np.object_]) -> BaseGeometry:
    """The union on the grid. Laid on it afterwards: a union that looks at the grid throughout takes three times as long.

    What is made of it later is not bound to the grid, as buffers would be that are hardly wider.
    """
    united: BaseGeometry = shapely.set_precision(shapely.set_precision(shapely.union_all(shapes), _GRID), 0.0)
    return united


def _covered(shape: BaseGeometry, flat: NDArray[np.object_]) -> NDArray[np.bool_]:
    """Which of ``flat`` (m,) the shape covers, by as much as the grid takes."""
    near = shape.buffer(1.5 * _GRID)
    shapely.prepare(near)
    covered: NDArray[np.bool_] = shapely.covers(near, flat)
    return covered


def _core(mesh: TriangleMesh, foot: float) -> tuple[Prism, ...]:
    """Prisms inside a closed mesh, from its lowest point up, each higher one within the lower."""
    corners = mesh.vertices[mesh.triangles]
    sides = corners[:, 1:] - corners[:, :1]
    normals = np.cross(sides[:, 0], sides[:, 1])
    vertical = normals[:, 2] / np.maximum(np.linalg.norm(normals, axis=1), 1e-12)
    up, down = vertical > _LEVEL, vertical < -_LEVEL
    lowest, highest = corners[:, :, 2].min(axis=1), corners[:, :, 2].max(axis=1)
    base = float(lowest.min())
    foot = max(foot, base) + 1e-6
    down &= highest > base + _FOOT
    foot = max(foot, float(highest[(vertical < -_LEVEL) & ~down].max(initial=foot)))
    flat = _projected(corners)
    whole = _areas(_united(flat[up]))
    order = np.argsort(lowest[up])
    share = np.cumsum(0.5 * normals[up, 2][order])
    if not len(share) or share[-1] <= 0.0:
        return ()
    heights = lowest[up][order][np.searchsorted(share, np.array([0.02, 0.3, 0.7]) * share[-1])]
    overhang = _areas(_united(flat[down]))
    prisms: list[Prism] = []
    for height in np.unique(np.round(heights, 3)).tolist():
        if height < foot + _LOW_CORE:
            continue
        below = _areas(_united(flat[up & (lowest < height)]))
        solid = _areas(
            shapely.difference(_areas(shapely.difference(whole, below, grid_size=_GRID)), overhang, grid_size=_GRID)
        )
        parts = [part for part in shapely.get_parts(solid) if part.geom_type == "Polygon" and part.area >= _LEAST_CORE]
        prisms += [Prism(part, base, float(height)) for part in parts if part.is_valid]
    return tuple(prisms)


def _areas(shape: BaseGeometry) -> BaseGeometry:
    """What of a shape has an area. On a grid, slivers collapse into lines, and no shape of both kinds can be overlaid."""
    if shape.geom_type in ("Polygon", "MultiPolygon"):
        return shape
    parts = shapely.get_parts(shapely.get_parts(shape))
    return MultiPolygon([part for part in parts if part.geom_type == "Polygon"])
