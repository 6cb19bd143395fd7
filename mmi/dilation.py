"""Colour beyond the silhouette: what filtering meets next to a covered texel is that texel's colour, not the background."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["dilate"]


@njit(cache=True)
def dilate(color: NDArray[np.uint8], covered: NDArray[np.bool_], reach: int) -> NDArray[np.uint8]:
    """``color`` (h, w, 3) with texels that are not ``covered`` (h, w) filled in.

    Within ``reach`` texels of a covered one (counted through edges and corners) a texel takes the mean of its already
    filled neighbours, ring by ring; beyond that, the mean of all covered texels, for the sake of coarse mipmaps.
    """
    height, width = covered.shape
    result = color.copy()
    ring = np.where(covered, 0, reach + 1).astype(np.int32)
    total = np.zeros(3)
    count = 0
    for i in range(height):
        for j in range(width):
            if covered[i, j]:
                count += 1
                for k in range(3):
                    total[k] += color[i, j, k]
    for step in range(1, reach + 1):
        for i in range(height):
            for j in range(width):
                if ring[i, j] < step:
                    continue
                n = 0
                r = g = b = 0.0
                for y in range(max(i - 1, 0), min(i + 2, height)):
                    for x in range(max(j - 1, 0), min(j + 2, width)):
                        if ring[y, x] < step:
                            n += 1
                            r += result[y, x, 0]
                            g += result[y, x, 1]
                            b += result[y, x, 2]
                if n > 0:
                    ring[i, j] = step
                    result[i, j, 0], result[i, j, 1], result[i, j, 2] = round(r / n), round(g / n), round(b / n)
    if count > 0:
        for i in range(height):
            for j in range(width):
                if ring[i, j] > reach:
                    for k in range(3):
                        result[i, j, k] = round(total[k] / count)
    return result
