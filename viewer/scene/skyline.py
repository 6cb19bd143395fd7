"""What a city's buildings hide from a viewer: boxes below the skyline, column by column of the panorama, all at once.

The sweep is the one that finds what a cell may see (:mod:`mmi.visibility.horizon`), from one viewpoint: conservative, since
buildings count as a little smaller and lower than they are. What is near hides what is far; the ground hides nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mmi.city.model import City
from mmi.visibility.horizon import prepare_horizon
from mmi.visibility.horizon_sweep import Rings, sweep

__all__ = ["Skyline", "skyline_of", "unhidden"]

_SHRINK, _LEVELS = 0.2, 6
"""Metres by which buildings are smaller than they are (those that touch are one), and different heights that they have."""
_COLUMNS = 2048
_AROUND = 1.0
"""Metres from a viewer within which nothing is hidden."""


@dataclass(frozen=True, slots=True, eq=False)
class Skyline:
    """What hides: walls around blocks of buildings that stand on the ground."""

    occluders: Rings


def skyline_of(city: City) -> Skyline:
    """The skyline of a city, made once; it takes about two seconds for ten thousand buildings."""
    return Skyline(prepare_horizon(city, shrink=_SHRINK, columns=_COLUMNS, levels=_LEVELS).occluders)


def unhidden(skyline: Skyline, eye: NDArray[np.float64], corners: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(k,) which boxes with ``corners`` (k, 8, 3) may be seen from ``eye`` (3,), where buildings alone hide them.

    False only where all of a box is behind buildings, below what shows of the sky over them.
    """
    low, high = corners.min(axis=1), corners.max(axis=1)
    gaps = np.maximum(np.maximum(low - eye, eye - high), 0.0)[:, :2]
    seen: NDArray[np.bool_] = np.hypot(gaps[:, 0], gaps[:, 1]) <= _AROUND
    rest = np.flatnonzero(~seen)
    if not len(rest):
        return seen
    occluders = skyline.occluders
    away = _gaps(occluders.boxes, eye)
    farthest = np.hypot(*np.maximum(np.abs(low[rest] - eye), np.abs(high[rest] - eye)).T[:2]).max()
    close = np.flatnonzero((away > 0.0) & (away < farthest))  # what the viewer is within hides nothing
    order = close[np.argsort(away[close], kind="stable")]
    found = np.zeros(len(rest), dtype=bool)
    sweep(
        eye[None].copy(),
        occluders,
        order,
        _outlines(low[rest], high[rest]),
        np.arange(len(rest)),
        found,
        columns=_COLUMNS,
        reach=0.0,
    )
    seen[rest] = found
    return seen


def _gaps(boxes: NDArray[np.float64], eye: NDArray[np.float64]) -> NDArray[np.float64]:
    """(r,) metres on the map between ``eye`` and each of ``boxes`` (r, 4)."""
    x, y = (np.maximum(np.maximum(boxes[:, i] - eye[i], eye[i] - boxes[:, i + 2]), 0.0) for i in range(2))
    return np.asarray(np.hypot(x, y))


def _outlines(low: NDArray[np.float64], high: NDArray[np.float64]) -> Rings:
    """Boxes between ``low`` and ``high`` (k, 3) as rings with heights, counter-clockwise."""
    (x0, y0, _), (x1, y1, top) = low.T, high.T
    xy = np.stack([np.column_stack(one) for one in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))], axis=1).reshape(-1, 2)
    starts = 4 * np.arange(len(low) + 1, dtype=np.int64)
    return Rings(xy, starts, top.copy(), np.column_stack([x0, y0, x1, y1]), np.arange(len(low), dtype=np.int64))
