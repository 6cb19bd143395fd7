"""Which objects are near a viewer, found by a grid of buckets, so that asking takes no longer in a larger city (section 4.1).

A viewer on the way asks again every few metres only: near is who is near any place of a square that the viewer is in, so that
what the renderer keeps of a set is used again.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["NearSet", "Neighbourhoods"]

_SQUARE = 8.0
"""Metres of a side of the squares within which the near set stays the same."""
_MOST_BUCKETS = 1 << 21


class NearSet(NamedTuple):
    """Objects that are near: ``key`` names the set, ``objects`` (n,) are in it; ``flags`` (all objects,) say who is."""

    key: str
    objects: NDArray[np.int64]
    flags: NDArray[np.bool_]


class Neighbourhoods:
    """Objects with ``boxes`` (n, 2, 3), NaN where there are none, and who is within ``reach`` metres of a place on the map."""

    def __init__(self, boxes: NDArray[np.float64], *, reach: float) -> None:
        self._reach, self._count = reach, len(boxes)
        self._last: tuple[tuple[int, int], NearSet] | None = None
        there = np.flatnonzero(np.isfinite(boxes[:, 0, 0]))
        low, high = boxes[there, 0, :2], boxes[there, 1, :2]
        self._objects, self._low, self._high = there, low, high
        if not len(there):
            return
        self._corner = low.min(axis=0)
        extent = np.maximum(high.max(axis=0) - self._corner, 1.0)
        self._side = max(reach, math.sqrt(float(extent[0] * extent[1]) / _MOST_BUCKETS))
        self._shape = np.floor(extent / self._side).astype(np.int64) + 1
        first = np.floor((low - self._corner) / self._side).astype(np.int64)
        counts = np.floor((high - self._corner) / self._side).astype(np.int64) - first + 1
        of = np.repeat(np.arange(len(there)), counts[:, 0] * counts[:, 1])
        place = np.arange(len(of)) - np.repeat(
            np.cumsum(counts.prod(axis=1)) - counts.prod(axis=1), counts.prod(axis=1)
        )
        column, row = place % counts[of, 0] + first[of, 0], place // counts[of, 0] + first[of, 1]
        bucket = row * self._shape[0] + column
        order = np.argsort(bucket, kind="stable")
        self._members = of[order]
        self._starts = np.searchsorted(bucket[order], np.arange(int(self._shape.prod()) + 1))

    def around(self, eye: NDArray[np.float64]) -> NearSet:
        """Who is within reach of any place of the square that ``eye`` (3,) is in; objects in their order."""
        square = np.floor(eye[:2] / _SQUARE).astype(np.int64)
        place, last = (int(square[0]), int(square[1])), self._last
        if last is not None and last[0] == place:
            return last[1]
        low = (square * _SQUARE).astype(np.float64)
        high = low + _SQUARE
        some = self._candidates(low, high)
        away = np.maximum(np.maximum(self._low[some] - high, low - self._high[some]), 0.0)
        near = some[np.hypot(away[:, 0], away[:, 1]) <= self._reach]
        objects = np.sort(self._objects[near])
        flags = np.zeros(self._count, dtype=np.bool_)
        flags[objects] = True
        found = NearSet(f"near {self._reach:g} {place[0]} {place[1]}", objects, flags)
        self._last = (place, found)  # one after the other: viewers move little from frame to frame
        return found

    def _candidates(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.int64]:
        """(k,) places of those whose buckets are within reach of a square, each once."""
        if not len(self._objects):
            return np.zeros(0, dtype=np.int64)
        first = np.clip(np.floor((low - self._reach - self._corner) / self._side), 0, self._shape).astype(np.int64)
        last = np.clip(np.floor((high + self._reach - self._corner) / self._side), -1, self._shape - 1).astype(np.int64)
        rows = [
            self._members[self._starts[y * self._shape[0] + first[0]] : self._starts[y * self._shape[0] + last[0] + 1]]
            for y in range(int(first[1]), int(last[1]) + 1)
            if first[0] <= last[0]
        ]
        return np.unique(np.concatenate(rows)) if rows else np.zeros(0, dtype=np.int64)
