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

__all__ = ["SKY_HORIZON", "SKY_ZENITH", "ground_mesh", "sky_color"]

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
_GRAIN = 12.8  # metres that the ground's texture covers


def ground_mesh(city: City, *, margin: float) -> CityMesh:
    """Flat ground at ``city.ground``, ``margin`` metres beyond the city's bounds, as one object.

    Carriageway, kerb, pavement (along streets and around buildings) and the rest are polygons cut out of each other:
    they share their borders and lie in one plane, so nothing flickers. It goes on below buildings, and streets are drawn
    on it even where they are bridges or tunnels.
    """
    x0, y0, x1, y1 = city.bounds
    widths = [float(edge.get("half_width", 3.0)) for _, _, edge in city.streets.edges(data=True)]
    lines = [edge["geometry"] for _, _, edge in city.streets.edges(data=True)]
    border = max([margin, _PAVED + 1.0, *(width + 4.0 for width in widths)])
    rest: BaseGeometry = shapely.box(x0 - border, y0 - border, x1 + border, y1 + border)
    surfaces: list[tuple[BaseGeometry, _Color]] = []
    inner: BaseGeometry = Polygon()
    yards = shapely.simplify([one.footprint for one in city.objects if one.base <= city.ground + _RAISED], 0.5)
    paved = shapely.buffer(yards, _PAVED, quad_segs=1)
    for extra, color in _STRIPES:
        # The outline is thinned to a finger's breadth before anything is cut, so that all sides see the same border.
        wide = shapely.buffer(lines, np.array(widths) + extra, quad_segs=3)
        outer = shapely.union_all(np.concatenate([wide, paved]) if extra == _STRIPES[-1][0] else wide).simplify(0.02)
        surfaces.append((shapely.difference(shapely.union(outer, inner), inner), color))
        inner = shapely.union(outer, inner)
    surfaces.append((shapely.difference(rest, inner), _GRASS))
    filled = [
        (*triangulate(polygon), color)
        for shape, color in surfaces
        for polygon in shapely.get_parts(shape)
        if polygon.geom_type == "Polygon" and not polygon.is_empty
    ]
    counts = np.array([len(points) for points, _, _ in filled])
    plan = np.concatenate([points for points, _, _ in filled])
    shifted = [triangles + shift for (_, triangles, _), shift in zip(filled, np.cumsum(counts) - counts, strict=True)]
    colors = np.repeat([color for _, _, color in filled], counts, axis=0)
    triangles = np.concatenate(shifted).astype(np.int32)
    return CityMesh(
        positions=np.column_stack([plan, np.full(len(plan), city.ground)]).astype(np.float32),
        uv=((plan - (x0, y0)) / _GRAIN).astype(np.float32),
        colors=np.rint(255.0 * colors).astype(np.uint8),
        triangles=triangles,
        object_vertices=np.array([0, len(plan)]),
        object_triangles=np.array([0, len(triangles)]),
        texture=facades.ground_texture(),
    )


def sky_color(directions: ArrayLike) -> NDArray[np.uint8]:
    """sRGB of the sky towards ``directions`` (..., 3), unit vectors -> (..., 3) uint8; below the horizon, its colour there."""
    up = np.clip(np.asarray(directions, dtype=np.float64)[..., 2:], 0.0, 1.0) ** 0.6
    return np.rint(np.array(SKY_HORIZON) * (1.0 - up) + np.array(SKY_ZENITH) * up).astype(np.uint8)
