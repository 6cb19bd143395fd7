"""How fine texels need to be, so that none appears larger than a pixel of the display from anywhere in the cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mmi.cells.viewing_cells import ViewingCell
from mmi.visibility.walls import Walls

__all__ = ["texel_ratios"]


def texel_ratios(walls: Walls, index: NDArray[np.int64], cell: ViewingCell) -> NDArray[np.float64]:
    """How much finer than a display's pixels, at least 1, texels of walls ``index`` (k,) need to be, (k,).

    So that from nowhere in the cell they appear larger than a pixel: a texel at distance d from the reference covers
    d / focal metres; from the nearest point of the cell, at distance d', a pixel covers d' / focal. So it is the largest d / d'
    over a wall (taken at its ends, thirds and at the foot of the perpendicular; the ratio is smooth in between).
    """
    along = np.subtract(cell.q, cell.p) / cell.length
    axes = np.array([along, [-along[1], along[0]]])
    a = (walls.a[index] - cell.reference[:2]) @ axes.T
    step = (walls.b[index] - cell.reference[:2]) @ axes.T - a
    foot = np.clip(-np.sum(a * step, axis=1) / np.maximum(np.sum(step * step, axis=1), 1e-12), 0.0, 1.0)
    t = np.stack([*(np.full(len(a), at) for at in (0.0, 1 / 3, 2 / 3, 1.0)), foot])
    points = a + t[..., None] * step
    middle = (np.add(cell.p, cell.q) / 2.0 - cell.reference[:2]) @ axes.T
    outside = np.maximum(np.abs(points - middle) - [0.5 * cell.length, cell.half_width], 0.0)
    from_cell = np.maximum(np.hypot(outside[..., 0], outside[..., 1]), 1.0)
    ratios = np.max(np.hypot(points[..., 0], points[..., 1]) / from_cell, axis=0)
    return np.asarray(np.maximum(ratios, 1.0), dtype=np.float64)
