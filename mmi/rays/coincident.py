"""Coincident faces: of several faces in one plane that a ray meets at once, the one that is drawn first is hit.

Neighbours in a city share walls, models repeat faces, and the depth test of a renderer keeps the first of what is equally deep.
Which of them a ray meets at the least distance is a matter of roundings, so it is settled here: faces that lie within a
millimetre of each other and overlap are found once for a mesh, and what a caster finds first is exchanged for the first of its
coincident faces that the ray meets as well.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.kernels import kernel
from mmi.rays.grid import Grid
from mmi.rays.ray_triangle import Ray, meeting
from mmi.rays.see_through import SeeThrough, is_open

__all__ = ["FLAT", "Coincident", "coincident_faces", "settle"]

FLAT = 1e-3
"""Metres within which faces coincide: twice what float32 leaves of a position 8 km from the city's origin."""
_PARALLEL = 0.98
"""Least cosine between the normals of faces that coincide: that of 11 degrees."""


class Coincident(NamedTuple):
    """Of each triangle i those that coincide with it, in ascending order: ``others[starts[i] : starts[i + 1]]``, both
    int32.
    """

    starts: NDArray[np.int32]
    others: NDArray[np.int32]


def coincident_faces(corners: NDArray[np.float32], bounds: NDArray[np.float32], grid: Grid) -> Coincident:
    """The triangles with ``corners`` (m, 9) that coincide, whichever way they face: no corner of the smaller is farther from
    the larger one's plane than ``FLAT``, and they overlap by more than that in each direction of it.

    ``bounds`` (m, 10) and ``grid`` are theirs: only triangles that share a cell are held against each other.
    """
    pairs = _pairs(corners, bounds, grid, np.empty((1024, 2), dtype=np.int32))
    numbers = np.unique(pairs[:, 0].astype(np.int64) * len(corners) + pairs[:, 1])
    first, second = np.divmod(numbers, max(len(corners), 1))
    ones, others = np.concatenate([first, second]), np.concatenate([second, first])
    order = np.lexsort([others, ones])
    starts = np.zeros(len(corners) + 1, dtype=np.int32)
    np.cumsum(np.bincount(ones, minlength=len(corners)), out=starts[1:])
    found = Coincident(starts, others[order].astype(np.int32))
    for one in found:
        one.setflags(write=False)
    return found


@kernel(nogil=True, error_model="numpy")
def settle(
    corners: NDArray[np.float32],
    coincident: Coincident,
    see: SeeThrough,
    i: int,
    ray: Ray,
    pixel_angle: float,
) -> int:
    """What a ray that meets triangle ``i`` first is said to hit: the first drawn of that and what coincides
    with it, which the ray meets and where it is not clear; -1 if there is none.
    """
    undecided = True
    for k in range(coincident.starts[i], coincident.starts[i + 1]):
        other = coincident.others[k]
        if undecided and other > i:
            undecided = False
            if not is_open(see, corners, i, ray, pixel_angle):
                return i
        if not math.isnan(meeting(corners, other, ray)) and not is_open(see, corners, other, ray, pixel_angle):
            return int(other)
    return i if undecided and not is_open(see, corners, i, ray, pixel_angle) else -1


@kernel(nogil=True, error_model="numpy")
def _pairs(
    corners: NDArray[np.float32], bounds: NDArray[np.float32], grid: Grid, pairs: NDArray[np.int32]
) -> NDArray[np.int32]:
    """(p, 2) the pairs that coincide, the lower first, once for each cell that has both. ``pairs`` is room to begin with."""
    found = 0
    for c in range(len(grid.starts) - 1):
        last = grid.starts[c + 1]
        for m in range(grid.starts[c], last):
            i = grid.entries[m]
            for n in range(m + 1, last):
                j = grid.entries[n]
                if not _near(bounds, i, j) or not _coincide(corners, bounds, i, j):
                    continue
                if found == len(pairs):
                    longer = np.empty((2 * found, 2), dtype=np.int32)
                    longer[:found] = pairs
                    pairs = longer
                pairs[found, 0], pairs[found, 1] = min(i, j), max(i, j)
                found += 1
    return pairs[:found].copy()


@kernel(nogil=True, error_model="numpy")
def _near(bounds: NDArray[np.float32], i: int, j: int) -> bool:
    """Whether two triangles are nearly parallel and their boxes meet."""
    a, b = np.uint64(i), np.uint64(j)
    cosine = bounds[a, 6] * bounds[b, 6] + bounds[a, 7] * bounds[b, 7] + bounds[a, 8] * bounds[b, 8]
    if abs(cosine) < _PARALLEL:
        return False
    return bool(
        bounds[a, 0] <= bounds[b, 1] + FLAT
        and bounds[b, 0] <= bounds[a, 1] + FLAT
        and bounds[a, 2] <= bounds[b, 3] + FLAT
        and bounds[b, 2] <= bounds[a, 3] + FLAT
        and bounds[a, 4] <= bounds[b, 5] + FLAT
        and bounds[b, 4] <= bounds[a, 5] + FLAT
    )


@kernel(nogil=True, error_model="numpy")
def _coincide(corners: NDArray[np.float32], bounds: NDArray[np.float32], i: int, j: int) -> bool:
    """Whether two nearly parallel triangles lie in one plane and overlap."""
    large, small = (i, j) if _area(corners[i]) >= _area(corners[j]) else (j, i)
    nx, ny, nz = float(bounds[large, 6]), float(bounds[large, 7]), float(bounds[large, 8])
    a, b = corners[large], corners[small]
    for k in range(0, 9, 3):
        x, y, z = float(b[k]) - a[0], float(b[k + 1]) - a[1], float(b[k + 2]) - a[2]
        if abs(nx * x + ny * y + nz * z) > FLAT:
            return False
    p, q = (1, 2) if abs(nx) >= abs(ny) and abs(nx) >= abs(nz) else (2, 0) if abs(ny) >= abs(nz) else (0, 1)
    return not (_parted(a, b, p, q) or _parted(b, a, p, q))


@kernel(nogil=True, error_model="numpy")
def _area(a: NDArray[np.float32]) -> float:
    """Twice the area of triangle ``a`` (9,), square metres."""
    bx, by, bz = float(a[3]) - a[0], float(a[4]) - a[1], float(a[5]) - a[2]
    cx, cy, cz = float(a[6]) - a[0], float(a[7]) - a[1], float(a[8]) - a[2]
    return math.hypot(math.hypot(by * cz - bz * cy, bz * cx - bx * cz), bx * cy - by * cx)


@kernel(nogil=True, error_model="numpy")
def _parted(a: NDArray[np.float32], b: NDArray[np.float32], p: int, q: int) -> bool:
    """Whether a side of triangle ``a`` (9,) parts it from triangle ``b`` in the plane of axes p and q, but for ``FLAT``."""
    for k in range(0, 9, 3):
        after, last = (k + 3) % 9, (k + 6) % 9
        sx, sy = float(a[after + p]) - a[k + p], float(a[after + q]) - a[k + q]
        length = math.sqrt(sx * sx + sy * sy)
        if length == 0.0:
            continue
        inner = sx * (float(a[last + q]) - a[k + q]) - sy * (float(a[last + p]) - a[k + p])
        turn = 1.0 if inner >= 0.0 else -1.0
        deepest = -np.inf
        for n in range(0, 9, 3):
            deepest = max(deepest, turn * (sx * (float(b[n + q]) - a[k + q]) - sy * (float(b[n + p]) - a[k + p])))
        if deepest <= FLAT * length:
            return True
    return False
