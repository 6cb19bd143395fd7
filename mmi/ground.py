"""The ground that a city stands on and the sky above it: what pictures need around buildings.

Neither belongs to impostors: both are drawn as they are, ground before layers, sky where nothing else is.
"""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from mmi import facades
from mmi.city import City
from mmi.surfaces import CityMesh, triangulate
from mmi.tiles import cut_polygons, grid_lines, match_borders

__all__ = ["GRAIN", "SKY_HORIZON", "SKY_ZENITH", "ground_mesh", "sky_color", "tile_bounds"]

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
_PAVED = 7.0  # metres of pavement around buildings
_RAISED = 1.0  # metres above ground from which nothing stands on it
GRAIN = 12.8
"""Metres that the ground's texture covers."""


def ground_mesh(city: City, *, margin: float, tile: float = 200.0) -> CityMesh:
    """Flat ground at ``city.ground``, ``margin`` metres beyond the city's bounds, an object a tile.

    Tiles are rectangles of at most ``tile`` metres a side, row by row from the south-west. Carriageway, kerb, pavement (along
    streets and around buildings) and the rest are polygons cut out of each other: they share their borders and lie in one
    plane, so nothing flickers. Ground goes on below buildings, and streets are drawn on it even where they are bridges or
    tunnels.
    """
    x0, y0, x1, y1 = city.bounds
    widths = [float(edge.get("half_width", 3.0)) for _, _, edge in city.streets.edges(data=True)]
    border = max([margin, _PAVED + 1.0, *(width + 4.0 for width in widths)])
    xs, ys = (grid_lines(low - border, high + border, spacing=tile) for low, high in ((x0, x1), (y0, y1)))
    surfaces = _surfaces(city, shapely.box(xs[0], ys[0], xs[-1], ys[-1]))
    pieces, of_surface, of_tile = cut_polygons(np.array([shape for shape, _ in surfaces], dtype=object), xs, ys)
    filled = [triangulate(piece) for piece in pieces]
    counts = np.array([len(points) for points, _ in filled])
    plan, triangles, sources = match_borders(
        np.concatenate([points for points, _ in filled]),
        np.concatenate([one + first for (_, one), first in zip(filled, np.cumsum(counts) - counts, strict=True)]),
        xs,
        ys,
    )
    surface, tiles = (np.repeat(of, counts)[sources] for of in (of_surface, of_tile))
    triangles = triangles[np.argsort(tiles[triangles[:, 0]], kind="stable")]
    used = np.unique(triangles)
    used = used[np.argsort(tiles[used], kind="stable")]
    place = np.zeros(len(plan), dtype=np.int32)
    place[used] = np.arange(len(used))
    starts = np.append(np.unique(tiles[used]), tiles.max() + 1)
    colors = np.rint(255.0 * np.array([color for _, color in surfaces])).astype(np.uint8)
    return CityMesh(
        positions=np.column_stack([plan[used], np.full(len(used), city.ground)]).astype(np.float32),
        uv=((plan[used] - (x0, y0)) / GRAIN).astype(np.float32),
        colors=colors[surface[used]],
        triangles=place[triangles],
        object_vertices=np.searchsorted(tiles[used], starts),
        object_triangles=np.searchsorted(tiles[triangles[:, 0]], starts),
        texture=facades.ground_texture(),
    )


def tile_bounds(ground: CityMesh) -> NDArray[np.float64]:
    """(n, 4) x0, y0, x1, y1 of each object of ``ground``, metres; none may be empty."""
    plan, first = ground.positions[:, :2].astype(np.float64), ground.object_vertices[:-1]
    return np.hstack([np.minimum.reduceat(plan, first), np.maximum.reduceat(plan, first)])


def sky_color(directions: ArrayLike) -> NDArray[np.uint8]:
    """sRGB of the sky towards ``directions`` (..., 3), unit vectors -> (..., 3) uint8; below the horizon, its colour there."""
    up = np.clip(np.asarray(directions, dtype=np.float64)[..., 2:], 0.0, 1.0) ** 0.6
    return np.rint(np.array(SKY_HORIZON) * (1.0 - up) + np.array(SKY_ZENITH) * up).astype(np.uint8)


def _surfaces(city: City, whole: BaseGeometry) -> list[tuple[BaseGeometry, _Color]]:
    """What the ground consists of, and its colours; together the shapes cover ``whole``, each point of it once."""
    widths = [float(edge.get("half_width", 3.0)) for _, _, edge in city.streets.edges(data=True)]
    lines = [edge["geometry"] for _, _, edge in city.streets.edges(data=True)]
    yards = shapely.simplify([one.footprint for one in city.objects if one.base <= city.ground + _RAISED], 0.5)
    paved = shapely.buffer(yards, _PAVED, quad_segs=1)
    surfaces: list[tuple[BaseGeometry, _Color]] = []
    inner: BaseGeometry = Polygon()
    for extra, color in _STRIPES:
        # The outline is thinned to a finger's breadth before anything is cut, so that all sides see the same border.
        wide = shapely.buffer(lines, np.array(widths) + extra, quad_segs=3)
        outline = shapely.union_all(np.concatenate([wide, paved]) if extra == _STRIPES[-1][0] else wide).simplify(0.02)
        outer = shapely.union(outline, inner)
        surfaces.append((shapely.difference(outer, inner), color))
        inner = outer
    surfaces.append((shapely.difference(whole, inner), _GRASS))
    return surfaces
