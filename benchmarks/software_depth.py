"""Depths of triangles by a small rasteriser of our own: the opacity buffer of Wimmer, Giegl & Schmalstieg 1998 (section 7)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mmi.foundation.camera import View

__all__ = ["software_depths"]

_NEAR = 0.1


def software_depths(parts: Sequence[tuple[NDArray[np.float32], NDArray[np.int32]]], view: View) -> NDArray[np.float32]:
    """(h, w) metres along the axis to the nearest of triangles, infinite where there are none.

    ``parts`` are positions (n, 3) and triangles (m, 3) of them.
    """
    left, top, width, height = view.window
    depths = np.full((height, width), np.inf, dtype=np.float32)
    for positions, triangles in parts:
        _rasterise(positions, triangles, view.eye_from_world, float(view.focal), float(left), float(top), depths)
    return depths


@njit(cache=True, nogil=True)
def _rasterise(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    eye_from_world: NDArray[np.float64],
    focal: float,
    left: float,
    top: float,
    depths: NDArray[np.float32],
) -> None:
    """Draw triangles, cut at the near plane, into ``depths``; the inverse of the depth is linear over the picture."""
    corners = np.empty((3, 3))
    cut = np.empty((4, 3))
    for triangle in triangles:
        for k in range(3):
            p = positions[triangle[k]]
            for n in range(3):
                m = eye_from_world[n]
                corners[k, n] = m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3]
        count = 0
        for k in range(3):
            a, b = corners[k], corners[(k + 1) % 3]
            if -a[2] >= _NEAR:
                cut[count] = a
                count += 1
            if (-a[2] >= _NEAR) != (-b[2] >= _NEAR):
                t = (-_NEAR - a[2]) / (b[2] - a[2])
                for n in range(3):
                    cut[count, n] = a[n] + t * (b[n] - a[n])
                count += 1
        for k in range(count):
            w = -1.0 / cut[k, 2]
            cut[k, 0], cut[k, 1], cut[k, 2] = focal * cut[k, 0] * w - left, -focal * cut[k, 1] * w - top, w
        for k in range(2, count):
            _fill(cut[0], cut[k - 1], cut[k], depths)


@njit(cache=True, nogil=True)
def _fill(a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64], depths: NDArray[np.float32]) -> None:
    """Pixels whose middles are in a triangle with corners (x, y, inverse depth), row by row."""
    height, width = depths.shape
    area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    if area == 0.0:
        return
    slope_x = ((b[2] - a[2]) * (c[1] - a[1]) - (c[2] - a[2]) * (b[1] - a[1])) / area
    slope_y = ((c[2] - a[2]) * (b[0] - a[0]) - (b[2] - a[2]) * (c[0] - a[0])) / area
    first = max(int(np.ceil(min(a[1], b[1], c[1]) - 0.5)), 0)
    last = min(int(np.ceil(max(a[1], b[1], c[1]) - 0.5)), height)
    for i in range(first, last):
        y = i + 0.5
        low, high = np.inf, -np.inf
        for k in range(3):
            p, q = (a, b) if k == 0 else (b, c) if k == 1 else (c, a)
            if (p[1] <= y) != (q[1] <= y):
                x = p[0] + (y - p[1]) / (q[1] - p[1]) * (q[0] - p[0])
                low, high = min(low, x), max(high, x)
        if low > high:
            continue
        begin, end = max(int(np.ceil(max(low, -1.0) - 0.5)), 0), min(int(np.ceil(min(high, width + 1.0) - 0.5)), width)
        for j in range(begin, end):
            w = a[2] + slope_x * (j + 0.5 - a[0]) + slope_y * (y - a[1])
            if w > 0.0:
                depth = np.float32(1.0 / w)
                if depth < depths[i, j]:
                    depths[i, j] = depth
