"""The ground that a city stands on and the sky above it: what pictures need around buildings.

Neither belongs to impostors: the ground is drawn as it is, and the sky where nothing else is drawn.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon

from mmi.appearance import facades
from mmi.appearance.city_mesh import CityMesh
from mmi.appearance.ground_tiles import grid_lines, match_borders, tile_boxes
from mmi.appearance.shading import light
from mmi.city.model import City
from mmi.city.terrain import Terrain
from mmi.city.triangulate import triangulate

__all__ = ["GRAIN", "SKY_HORIZON", "SKY_ZENITH", "ground_mesh"]

SKY_HORIZON = (214, 224, 232)
"""sRGB of the sky at and below the horizon."""
SKY_ZENITH = (104, 150, 204)
"""sRGB of the sky overhead."""

_Color = tuple[float, float, float]
# Metres beyond a street's half width, and colour: carriageway, kerb, pavement.
_STRIPES: tuple[tuple[float, _Color], ...] = (
    (0.0, (0.46, 0.46, 0.47)),
    (0.25, (0.86, 0.85, 0.82)),
    (2.75, (0.72, 0.70, 0.66)),
)
_GRASS: _Color = (0.63, 0.64, 0.56)
_COLORS = (*(color for _, color in _STRIPES), _GRASS)
_PAVED = 7.0  # metres of pavement around buildings
_ON_FOOT = frozenset({"pedestrian", "footway", "path", "steps"})
"""Kinds of streets that are pavement all across."""
_RAISED = 1.0  # metres above ground from which nothing stands on it
GRAIN = 12.8
"""Metres that the ground's texture covers."""


def ground_mesh(city: City, *, margin: float, tile: float = 200.0) -> CityMesh:
    """The ground up to ``margin`` metres beyond the city's bounds, with an object for each tile.

    Tiles are rectangles of at most ``tile`` metres a side, row by row from the south-west. Carriageway, kerb, pavement (along
    streets and around buildings) and the rest are polygons cut out of each other: they share their borders and lie in one
    plane, so nothing flickers; on hills they are cut along the terrain's grid, which they follow, and shaded by its slope.
    Ground goes on below buildings, and streets are drawn on it even where they are bridges or tunnels.
    """
    x0, y0, x1, y1 = city.bounds
    widths = [float(edge.get("half_width", 3.0)) for _, _, edge in city.streets.edges(data=True)]
    border = max([margin, _PAVED + 1.0, *(width + 4.0 for width in widths)])
    lines = [grid_lines(low - border, high + border, spacing=tile) for low, high in ((x0, x1), (y0, y1))]
    if city.terrain is not None:
        lines = [_lines_of(city.terrain, axis, outer, tile) for axis, outer in enumerate(lines)]
    xs, ys = lines
    surfaces = _surfaces(city, xs, ys)
    pieces, place = shapely.get_parts(surfaces.ravel(), return_index=True)
    if city.terrain is not None:
        xs, ys = (_lines_of(city.terrain, axis, outer, 0.0) for axis, outer in enumerate((xs, ys)))
        pieces, of_piece = _cut_along(pieces, xs, ys)
        place = place[of_piece]
    filled = shapely.area(pieces) > 0.0
    points, corners, of = triangulate(pieces[filled])
    of_tile, of_surface = np.divmod(place[filled][of], len(_COLORS))
    plan, triangles, sources = match_borders(points, corners, xs, ys)
    surface, tiles = of_surface[sources], of_tile[sources]
    triangles = triangles[np.argsort(tiles[triangles[:, 0]], kind="stable")]
    used = np.flatnonzero(np.bincount(triangles.ravel()))
    used = used[np.argsort(tiles[used], kind="stable")]
    place = np.zeros(len(plan), dtype=np.int32)
    place[used] = np.arange(len(used))
    starts = np.append(np.unique(tiles[used]), tiles.max() + 1)
    colors = 255.0 * np.array(_COLORS)[surface[used]]
    if city.terrain is not None:
        colors *= _slope_light(city.terrain, plan[used])
    return CityMesh(
        positions=np.column_stack([plan[used], city.ground_at(plan[used])]).astype(np.float32),
        uv=((plan[used] - (x0, y0)) / GRAIN).astype(np.float32),
        colors=np.clip(np.rint(colors), 0, 255).astype(np.uint8),
        triangles=place[triangles],
        object_vertices=np.searchsorted(tiles[used], starts),
        object_triangles=np.searchsorted(tiles[triangles[:, 0]], starts),
        texture=facades.ground_texture(),
    )


def _surfaces(city: City, xs: NDArray[np.float64], ys: NDArray[np.float64]) -> NDArray[np.object_]:
    """(tiles, surfaces): what each tile of the ground consists of; its shapes cover it, each point of it once.

    Streets of one width are widened tile by tile, all that come near a tile at a time: that is quicker than one by one.
    """
    tiles = tile_boxes(xs, ys)
    edges = [edge for _, _, edge in city.streets.edges(data=True) if edge.get("kind") not in _ON_FOOT]
    lines = np.array([edge["geometry"] for edge in edges], dtype=object)
    widths, width = np.unique([float(edge.get("half_width", 3.0)) for edge in edges], return_inverse=True)
    reach = widths.max(initial=0.0) + _STRIPES[-1][0]
    tile, line = shapely.STRtree(lines).query(tiles, predicate="dwithin", distance=reach)
    (street_tile, street_width), streets = _bundles(shapely.multilinestrings, lines[line], tile, width[line])
    yards = shapely.get_parts(
        shapely.simplify([one.footprint for one, up in zip(city.objects, _raised(city), strict=True) if not up], 0.5)
    )
    yards = np.concatenate([yards, _walks(city)])
    tile, yard = shapely.STRtree(yards).query(tiles, predicate="dwithin", distance=_PAVED)
    (paved_tile, _), paved = _bundles(shapely.multipolygons, yards[yard], tile, np.zeros_like(tile))
    surfaces: list[NDArray[np.object_]] = []
    inner = np.full(len(tiles), Polygon(), dtype=object)
    for extra, _ in _STRIPES:
        shapes = np.full((len(tiles), len(widths) + 1), None, dtype=object)
        shapes[street_tile, street_width] = shapely.buffer(streets, widths[street_width] + extra, quad_segs=3)
        if extra == _STRIPES[-1][0]:
            shapes[paved_tile, -1] = shapely.buffer(paved, _PAVED, quad_segs=1)
        outline = shapely.union_all(shapely.intersection(shapes, tiles[:, None]), axis=1)
        # The outline is thinned to a finger's breadth before it is cut out of others, so that all see the same border.
        outer = shapely.union(shapely.simplify(outline, 0.02), inner)
        surfaces.append(shapely.difference(outer, inner))
        inner = outer
    surfaces.append(shapely.difference(tiles, inner))
    return np.stack(surfaces, axis=1)


def _walks(city: City) -> NDArray[np.object_]:
    """Polygons along streets that are pavement: with ``_PAVED`` metres around them they are as wide as these streets."""
    edges = [edge for _, _, edge in city.streets.edges(data=True) if edge.get("kind") in _ON_FOOT]
    lines = np.array([edge["geometry"] for edge in edges], dtype=object)
    wide = np.array([max(float(edge.get("half_width", 3.0)) - _PAVED, 0.05) for edge in edges])
    return np.asarray(shapely.get_parts(shapely.buffer(lines, wide, quad_segs=2)), dtype=object)


def _raised(city: City) -> NDArray[np.bool_]:
    """(objects,) which of the city's objects do not stand on the ground."""
    base = np.array([one.base for one in city.objects])
    if city.terrain is None or not len(base):
        return base > city.ground + _RAISED
    _, highest = city.terrain.range_over(shapely.bounds([one.footprint for one in city.objects]))
    return np.asarray(base > highest + _RAISED)


def _lines_of(terrain: Terrain, axis: int, outer: NDArray[np.float64], least: float) -> NDArray[np.float64]:
    """Lines of the terrain's grid across ``axis`` (0: x) between the first and the last of ``outer``, at least ``least`` metres
    apart, together with these two; where ``least`` is 0, together with all of ``outer``.
    """
    low, high = terrain.bounds[axis], terrain.bounds[axis + 2]
    step = terrain.spacing * max(1, math.ceil(least / terrain.spacing))
    inner = np.arange(low, high + 0.5 * terrain.spacing, step).astype(np.float32).astype(np.float64)
    inner = inner[(inner > outer[0]) & (inner < outer[-1])]
    return np.unique(np.concatenate([inner, outer[[0, -1]] if least else outer]))


def _cut_along(
    pieces: NDArray[np.object_], xs: NDArray[np.float64], ys: NDArray[np.float64]
) -> tuple[NDArray[np.object_], NDArray[np.int64]]:
    """Polygons (k,) cut along the lines x = ``xs`` and y = ``ys``, and which of ``pieces`` each is a part of."""
    squares = tile_boxes(xs, ys)
    tree = shapely.STRtree(squares)
    inside = tree.query(pieces, predicate="covers")
    meeting = tree.query(pieces, predicate="intersects")
    count = len(squares)
    crossing = np.setdiff1d(meeting[0] * count + meeting[1], inside[0] * count + inside[1])
    piece, square = np.divmod(crossing, count)
    parts, of = shapely.get_parts(shapely.intersection(pieces[piece], squares[square]), return_index=True)
    filled = shapely.get_type_id(parts) == 3
    return np.concatenate([squares[inside[1]], parts[filled]]), np.concatenate([inside[0], piece[of[filled]]])


def _slope_light(terrain: Terrain, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) how much more or less light the terrain gets at ``points`` (n, 2) than level ground."""
    step = 0.5 * terrain.spacing
    east, north = np.array([step, 0.0]), np.array([0.0, step])
    slopes = [(terrain.at(points + one) - terrain.at(points - one)) / (2.0 * step) for one in (east, north)]
    normals = np.column_stack([-slopes[0], -slopes[1], np.ones(len(points))])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return light(normals) / light(np.array([[0.0, 0.0, 1.0]]))


def _bundles(
    collect: Callable[..., NDArray[np.object_]],
    shapes: NDArray[np.object_],
    tile: NDArray[np.int64],
    kind: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.object_]]:
    """Pairs (2, k) of a tile and a kind, and the ``shapes`` (n,) of each pair as one; ``tile`` and ``kind`` (n,) are theirs."""
    order = np.lexsort((kind, tile))
    pairs, bundle = np.unique(np.stack([tile, kind])[:, order], axis=1, return_inverse=True)
    return pairs, collect(shapes[order], indices=bundle.ravel())
