"""Random views inside cells: what measures are taken from, and what no capture has seen."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mmi import limits
from mmi.cells.viewing_cells import ViewingCell
from mmi.city.terrain import Terrain
from mmi.foundation.errors import ParameterError
from mmi.walks.walk import Pose

__all__ = ["random_views"]

_LOWEST = 1.0
"""Eyes keep this many metres above the ground on hills, where a cell's band is as high as its ground is uneven."""


def random_views(
    cells: Sequence[ViewingCell], n: int, *, seed: int, terrain: Terrain | None = None
) -> list[tuple[str, Pose]]:
    """``n`` views (cell, pose), sorted by cell: each from any cell, from anywhere in its rectangle and eye band,
    level, with any heading.

    With the ``terrain``, none from below the ground where that is higher than elsewhere in the cell. The same cells and seed
    give the same views, and none is taken from a reference viewpoint, where layers were captured.
    Raises ParameterError for no cells, a number of views below 1 or too large, or a negative seed.
    """
    if not cells:
        raise ParameterError("cells to take views from expected, found none")
    if not 1 <= n <= limits.VIEWS:
        raise ParameterError(f"1 to {limits.VIEWS} views expected, found {n}")
    if seed < 0:
        raise ParameterError(f"a seed of 0 or more expected, found {seed}")
    rng = np.random.default_rng(seed)
    views = []
    for place in np.sort(rng.integers(0, len(cells), n)):
        cell = cells[place]
        p, q = np.array(cell.p), np.array(cell.q)
        along = (q - p) / cell.length
        side = np.array([-along[1], along[0]])
        while True:
            t = float(rng.uniform(0.0, 1.0))
            spot = p + t * (q - p) + rng.uniform(-1.0, 1.0) * cell.half_width * side
            low, high = cell.eye_at(t)
            if terrain is not None:
                low = min(max(low, float(terrain.at(spot)) + _LOWEST), high)
            eye = (float(spot[0]), float(spot[1]), float(rng.uniform(low, high)))
            if math.dist(eye, cell.reference) > 0.0:
                break
        views.append((cell.id, Pose(eye, float(rng.uniform(-math.pi, math.pi)), 0.0)))
    return views
