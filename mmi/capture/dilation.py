"""Colour beyond the silhouette: what filtering meets next to a covered texel is that texel's colour, not the background."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.kernels import kernel

__all__ = ["dilate"]


@kernel()
def dilate(color: NDArray[np.uint8], covered: NDArray[np.bool_], reach: int) -> NDArray[np.uint8]:
    """``color`` (h, w, 3) with texels that are not ``covered`` (h, w) filled in.

    Within ``reach`` texels of a covered one (counted through edges and corners) a texel takes the mean of its already
    filled neighbours, ring by ring; beyond that, the mean of all covered texels, for the sake of coarse mipmaps.
    """
    height, width = covered.shape
    total = np.zeros(3)
    count = 0
    for i in range(height):
        for j in range(width):
            if covered[i, j]:
                count += 1
                for k in range(3):
                    total[k] += color[i, j, k]
    result = color.copy()
    if count == 0:
        return result
    mean = np.empty(3, dtype=np.uint8)
    for k in range(3):
        mean[k] = round(total[k] / count)
    ring = np.where(covered, 0, reach + 1).astype(np.int32)
    front = np.empty((height * width - count, 2), dtype=np.int32)  # texels in the order in which rings reach them
    end = 0
    for i in range(height):
        for j in range(width):
            if ring[i, j] > reach:
                if _touches(ring, i, j, 0):
                    front[end, 0], front[end, 1] = i, j
                    end += 1
                else:
                    for k in range(3):
                        result[i, j, k] = mean[k]
    begin = 0
    for step in range(1, reach + 1):
        for f in range(begin, end):
            ring[front[f, 0], front[f, 1]] = step
        last = end
        for f in range(begin, last):
            i, j = front[f]
            n = 0
            r = g = b = 0.0
            for y in range(max(i - 1, 0), min(i + 2, height)):
                for x in range(max(j - 1, 0), min(j + 2, width)):
                    if ring[y, x] < step:
                        n += 1
                        r += result[y, x, 0]
                        g += result[y, x, 1]
                        b += result[y, x, 2]
                    elif ring[y, x] > reach and step < reach:
                        ring[y, x] = reach  # seen: it belongs to the next ring
                        front[end, 0], front[end, 1] = y, x
                        end += 1
            result[i, j, 0], result[i, j, 1], result[i, j, 2] = round(r / n), round(g / n), round(b / n)
        begin = last
    return result


@kernel()
def _touches(ring: NDArray[np.int32], i: int, j: int, level: int) -> bool:
    """Whether a texel has a neighbour of this ring."""
    for y in range(max(i - 1, 0), min(i + 2, ring.shape[0])):
        for x in range(max(j - 1, 0), min(j + 2, ring.shape[1])):
            if ring[y, x] == level:
                return True
    return False
