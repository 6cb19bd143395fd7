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


_STEPS = (1.0, 0.25, 0.0625, 0.0)
"""Shares of that at which the backdrop is cut into triangles. OpenGL works out depths of large ones too coarsely to tell the
backdrop from tiles 5 cm above it: from a roof, streets vanish."""


def backdrop(ground: CityMesh) -> CityMesh:
    """A plain grid as one object, finer towards the city, in the texture of ``ground`` and the mean of its colours by area."""
    corners = ground.positions[ground.triangles].astype(np.float64)
    sides = corners[:, 1:, :2] - corners[:, :1, :2]
    areas = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    color = np.average(ground.colors[ground.triangles].mean(axis=1), axis=0, weights=np.maximum(areas, 1e-12))
    low, high = ground.positions.min(axis=0).astype(np.float64), ground.positions.max(axis=0).astype(np.float64)
    x, y = (
        np.unique([*(low[i] - _REACH * np.array(_STEPS)), *(high[i] + _REACH * np.array(_STEPS))]) for i in range(2)
    )
    plan = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    columns, rows = len(x) - 1, len(y) - 1
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).reshape(-1)
    last = first + columns + 2
    triangles = np.concatenate([np.stack([first, first + 1, last], axis=1), np.stack([first, last, last - 1], axis=1)])
    return CityMesh(
        positions=np.column_stack([plan, np.full(len(plan), low[2] - _BELOW)]).astype(np.float32),
        uv=(plan / GRAIN).astype(np.float32),
        colors=np.repeat(np.rint(color).astype(np.uint8)[None], len(plan), axis=0),
        triangles=triangles.astype(np.int32),
        object_vertices=np.array([0, len(plan)]),
        object_triangles=np.array([0, len(triangles)]),
        texture=ground.texture,
    )
