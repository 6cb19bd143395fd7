"""Triangles in the cells of a regular grid (Fujimoto, Tanaka and Iwata 1986; paper section 4.2): built here, walked elsewhere.

The grid spans the triangles' box with cubic cells, about as many as there are triangles. A cell lists each triangle that
has a part in it, by a separating-axis test of the triangle and the cell (Schwarz and Seidel, "Fast parallel surface and solid
voxelization on GPUs", 2010), the first drawn first. Cells are enlarged a little for that test, so that neither its roundings
nor those of a ray's walk leave a triangle out. Triangles without area are in no cell.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.kernels import kernel

__all__ = ["Grid", "build_grid"]

_CELLS_A_TRIANGLE = 3.0
"""Measured: with 2, rays of Helsinki take a tenth longer; with 4, those of a town of 1.5 million triangles do."""
_MOST_CELLS = 1 << 27
"""Of four bytes each."""
_MOST_ENTRIES = 16.0
"""Cells that list a triangle, on average, at most: long triangles make the grid coarser."""
_SAMPLE = 4096
"""Triangles by which a grid is tried before it is built."""
_SLACK = 1e-3
"""Share of a cell by which it is enlarged on each side, when triangles are entered."""
_THINNEST = 1e-6
"""A flat city's box gets this share of its longest side in the other directions, and each box this share all around."""


class Grid(NamedTuple):
    """A regular grid over triangles.

    ``low`` (3,) its lowest corner, ``cell`` the length of a cell's edges, in metres, ``size`` (3,) cells along each axis.
    Cell (x, y, z) has the number c = (x size[1] + y) size[2] + z and lists the triangles
    ``entries[starts[c] : starts[c + 1]]``, both int32.
    """

    low: NDArray[np.float64]
    cell: float
    size: NDArray[np.int64]
    starts: NDArray[np.int32]
    entries: NDArray[np.int32]


def build_grid(corners: NDArray[np.float32], *, cells_a_triangle: float = _CELLS_A_TRIANGLE) -> Grid:
    """The grid of triangles with ``corners`` (m, 9), metres, with about ``cells_a_triangle`` times m cells, fewer where the
    triangles are so long that most cells would list many.
    """
    if not len(corners):
        return Grid(np.zeros(3), 1.0, np.ones(3, np.int64), np.zeros(2, np.int32), np.zeros(0, np.int32))
    points = corners.reshape(-1, 3)
    low, high = points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64)
    around = max(_THINNEST * float((high - low).max()), 1e-6)
    low, high = low - around, high + around
    cell = _cell_length(high - low, min(cells_a_triangle * len(corners), _MOST_CELLS))
    sample = np.ascontiguousarray(corners[:: -(-len(corners) // _SAMPLE)])
    none, nowhere = np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.int64)
    while True:
        size = np.maximum(1, np.ceil((high - low) / cell)).astype(np.int64)
        if size.prod() == 1 or _enter(sample, low, cell, size, nowhere, none) <= _MOST_ENTRIES * len(sample):
            break
        cell *= 1.25
    counts = np.zeros(size.prod() + 1, dtype=np.int64)
    entries = np.empty(_enter(corners, low, cell, size, counts[1:], none), dtype=np.int32)
    np.cumsum(counts, out=counts)
    starts = counts.astype(np.int32)
    _enter(corners, low, cell, size, counts[:-1], entries)
    for one in (low, size, starts, entries):
        one.setflags(write=False)
    return Grid(low, cell, size, starts, entries)


def _cell_length(extent: NDArray[np.float64], cells: float) -> float:
    """The edge of cubes of which about ``cells`` cover a box of ``extent`` (3,)."""
    longest = float(extent.max())
    shortest = longest / max(cells, 1.0)
    for _ in range(50):
        between = np.sqrt(longest * shortest)
        if np.ceil(extent / between).prod() > cells:
            shortest = between
        else:
            longest = between
    return longest


@kernel(nogil=True, error_model="numpy")
def _enter(
    corners: NDArray[np.float32],
    low: NDArray[np.float64],
    cell: float,
    size: NDArray[np.int64],
    places: NDArray[np.int64],
    entries: NDArray[np.int32],
) -> int:
    """Write each triangle into its cells; ``places`` (cells,) say where the next one of each cell goes.

    An empty ``entries`` only counts: ``places`` grow by the triangles of each cell. Without ``places`` the total is counted
    alone, which is what returns.
    """
    total = 0
    cells = np.empty(16, dtype=np.int64)
    sides = np.empty((9, 3))
    for i in range(len(corners)):
        found, cells = _cells_of(corners[i], low, cell, size, sides, cells)
        total += found
        if len(places):
            for k in range(found):
                c = cells[k]
                if len(entries):
                    entries[places[c]] = i
                places[c] += 1
    return total


@kernel(nogil=True, error_model="numpy")
def _cells_of(
    triangle: NDArray[np.float32],
    low: NDArray[np.float64],
    cell: float,
    size: NDArray[np.int64],
    sides: NDArray[np.float64],
    cells: NDArray[np.int64],
) -> tuple[int, NDArray[np.int64]]:
    """The cells that a ``triangle`` (9,) has a part in: how many, and their numbers in ``cells``, or in a longer array in its
    place.

    Lengths are in cells here. ``sides`` (9, 3) is room for the sides of the triangle's three shadows along the axes: a cell
    with its least corner at (p, q) has a part on the inner side of one if ``sides[., 0] p + sides[., 1] q >= sides[., 2]``.
    """
    scale, least, width = 1.0 / cell, -_SLACK, 1.0 + 2.0 * _SLACK
    ax, ay, az = (triangle[0] - low[0]) * scale, (triangle[1] - low[1]) * scale, (triangle[2] - low[2]) * scale
    bx, by, bz = (triangle[3] - low[0]) * scale, (triangle[4] - low[1]) * scale, (triangle[5] - low[2]) * scale
    cx, cy, cz = (triangle[6] - low[0]) * scale, (triangle[7] - low[1]) * scale, (triangle[8] - low[2]) * scale
    nx = (by - ay) * (cz - az) - (bz - az) * (cy - ay)
    ny = (bz - az) * (cx - ax) - (bx - ax) * (cz - az)
    nz = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if nx == 0.0 and ny == 0.0 and nz == 0.0:
        return 0, cells
    x0, x1 = _span(min(ax, bx, cx), max(ax, bx, cx), size[0])
    y0, y1 = _span(min(ay, by, cy), max(ay, by, cy), size[1])
    z0, z1 = _span(min(az, bz, cz), max(az, bz, cz), size[2])
    most = (x1 - x0 + 1) * (y1 - y0 + 1) * (z1 - z0 + 1)
    if len(cells) < most and most <= 4096:
        cells = np.empty(2 * most, dtype=np.int64)
    if most == 1:
        cells[0] = (x0 * size[1] + y0) * size[2] + z0
        return 1, cells
    _shadow(sides, 0, ax, ay, bx, by, cx, cy, nz, width)
    _shadow(sides, 3, ay, az, by, bz, cy, cz, nx, width)
    _shadow(sides, 6, az, ax, bz, bx, cz, cx, ny, width)
    # The plane passes a cell if the cell's corners lowest and highest along the normal are on its two sides.
    plane = nx * ax + ny * ay + nz * az
    most_at = plane - width * (min(nx, 0.0) + min(ny, 0.0) + min(nz, 0.0))
    least_at = plane - width * (max(nx, 0.0) + max(ny, 0.0) + max(nz, 0.0))
    found = 0
    for x in range(x0, x1 + 1):
        p = x + least
        for y in range(y0, y1 + 1):
            q = y + least
            if not _within(sides, 0, p, q):
                continue
            for z in range(z0, z1 + 1):
                r = z + least
                at = nx * p + ny * q + nz * r
                if least_at <= at <= most_at and _within(sides, 3, q, r) and _within(sides, 6, r, p):
                    if found == len(cells):
                        longer = np.empty(2 * found, dtype=np.int64)
                        longer[:found] = cells
                        cells = longer
                    cells[found] = (x * size[1] + y) * size[2] + z
                    found += 1
    return found, cells


@kernel(nogil=True, error_model="numpy")
def _span(first: float, last: float, size: int) -> tuple[int, int]:
    """The first and the last cell that an interval has a part in, along one axis."""
    low, high = int(np.floor(first - _SLACK)), int(np.floor(last + _SLACK))
    return min(max(low, 0), size - 1), min(max(high, 0), size - 1)


@kernel(nogil=True, error_model="numpy")
def _shadow(
    sides: NDArray[np.float64],
    k: int,
    ap: float,
    aq: float,
    bp: float,
    bq: float,
    cp: float,
    cq: float,
    normal: float,
    width: float,
) -> None:
    """Rows k to k + 3 of ``sides``: the inner sides of a triangle's shadow, for squares of a ``width``; ``normal`` says by its
    sign which way round the corners are.
    """
    turn = 1.0 if normal >= 0.0 else -1.0
    p0, q0 = cp, cq
    for i in range(3):
        p1, q1 = (ap, aq) if i == 0 else (bp, bq) if i == 1 else (cp, cq)
        across, along = -turn * (q1 - q0), turn * (p1 - p0)
        sides[k + i, 0], sides[k + i, 1] = across, along
        sides[k + i, 2] = across * p0 + along * q0 - width * (max(across, 0.0) + max(along, 0.0))
        p0, q0 = p1, q1


@kernel(nogil=True, error_model="numpy")
def _within(sides: NDArray[np.float64], k: int, p: float, q: float) -> bool:
    """Whether a square at (p, q) has a part on the inner side of all three sides from row ``k``."""
    return bool(
        sides[k, 0] * p + sides[k, 1] * q >= sides[k, 2]
        and sides[k + 1, 0] * p + sides[k + 1, 1] * q >= sides[k + 1, 2]
        and sides[k + 2, 0] * p + sides[k + 2, 1] * q >= sides[k + 2, 2]
    )
