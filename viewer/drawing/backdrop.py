"""The plain surface below and around a city's ground: what a viewer sees of the ground where its tiles are too far to draw.

Tiles are left out where all that lies beyond them is a line of two pixels below the horizon (``viewer.scene.scene``), and
the city's ground ends somewhere; the backdrop goes on to the horizon in the ground's mean colour.
"""

from __future__ import annotations

import numpy as np

from mmi.appearance.city_mesh import CityMesh
from mmi.appearance.ground_mesh import GRAIN

__all__ = ["backdrop"]

_BELOW = 0.05
"""Metres below the ground: tiles hide the backdrop, and where there are none the step is too small to be seen."""
_REACH = 12_000.0
"""Metres beyond the city. Seen from eye height, the horizon of a flat world is less than a pixel above the edge there."""


def backdrop(ground: CityMesh) -> CityMesh:
    """Two triangles as one object, in the texture of ``ground`` and the mean colour of its triangles, weighted by area."""
    corners = ground.positions[ground.triangles].astype(np.float64)
    sides = corners[:, 1:, :2] - corners[:, :1, :2]
    areas = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    color = np.average(ground.colors[ground.triangles].mean(axis=1), axis=0, weights=np.maximum(areas, 1e-12))
    low, high = ground.positions.min(axis=0) - _REACH, ground.positions.max(axis=0) + _REACH
    level = float(ground.positions[:, 2].min()) - _BELOW
    plan = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]], dtype=np.float64)
    return CityMesh(
        positions=np.column_stack([plan, np.full(4, level)]).astype(np.float32),
        uv=(plan / GRAIN).astype(np.float32),
        colors=np.repeat(np.rint(color).astype(np.uint8)[None], 4, axis=0),
        triangles=np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32),
        object_vertices=np.array([0, 4]),
        object_triangles=np.array([0, 2]),
        texture=ground.texture,
    )
