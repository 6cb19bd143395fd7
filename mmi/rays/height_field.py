"""The city from above: the highest point over every cell of a plane grid, and the maxima of ever larger cells.

This is the "2-dimensional height-field" of Wimmer, Giegl & Schmalstieg 1998 (section 6), with a pyramid of maxima over it, so
that whole districts can be passed over at once. A triangle counts in every cell that it touches, with the highest point that it
has there: it is clipped to the cell, so that long walls and sloped roofs do not lift what is beside them.

Clipping goes row by row. Within a row of cells the highest point of a flat polygon over a range of x lies on its border, so
it is enough to follow the border: the parts of the three edges in the row, and the two lines along which the row's own borders
cut the triangle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import CityMesh
from mmi.foundation.errors import ParameterError
from mmi.foundation.kernels import kernel

__all__ = ["HeightField", "Pyramid", "height_field"]

_FINEST = 0.5
"""Metres: cells are no smaller unless asked for."""
_CELLS = 16_000_000
"""Cells of the finest level, about, where the step is chosen for the city: 85 megabytes with all levels."""
_MOST_CELLS = 256_000_000
"""Cells that a step may ask for."""


class Pyramid(NamedTuple):
    """All levels in one array, for kernels: cell (r, c) of level k is ``heights[starts[k] + r * shapes[k, 1] + c]``.

    ``heights`` (n,) float32 metres, ``starts`` (levels,) and ``shapes`` (levels, 2) int64; the last level is one cell.
    """

    heights: NDArray[np.float32]
    starts: NDArray[np.int64]
    shapes: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class HeightField:
    """How high the city reaches over each cell of a grid, and over each block of 2 x 2, 4 x 4, ... of them.

    ``levels[k]`` (rows, columns) float32 holds the highest z in metres of anything in each cell, -inf where nothing is; its
    cell (r, c) begins at ``corner`` (x, y) + (c, r) * ``step`` * 2**k metres. Each level halves the one before (rounded up)
    down to a single cell. Arrays become views of ``pyramid``, and are read-only.
    """

    corner: tuple[float, float]
    step: float
    levels: tuple[NDArray[np.float32], ...]
    pyramid: Pyramid = field(init=False)

    def __post_init__(self) -> None:
        shapes = np.array([level.shape for level in self.levels], dtype=np.int64).reshape(-1, 2)
        if not len(shapes) or (shapes[1:] != (shapes[:-1] + 1) // 2).any() or (shapes[-1] != 1).any():
            raise ValueError(f"levels that halve down to one cell expected, found shapes {shapes.tolist()}")
        ends = np.cumsum(shapes.prod(axis=1))
        heights = np.concatenate([level.reshape(-1) for level in self.levels], dtype=np.float32, casting="same_kind")
        pyramid = Pyramid(heights, np.concatenate([[0], ends[:-1]]).astype(np.int64), shapes)
        for array in pyramid:
            array.setflags(write=False)
        views = [one.reshape(shape) for one, shape in zip(np.split(heights, ends[:-1]), shapes, strict=True)]
        object.__setattr__(self, "pyramid", pyramid)
        object.__setattr__(self, "levels", tuple(views))


def height_field(mesh: CityMesh, *, step: float | None = None) -> HeightField:
    """The height field of all triangles of ``mesh``, in cells of ``step`` metres.

    Without a ``step``, cells measure half a metre, or more in a city for which that would make more than 16 million of them. A
    mesh without triangles gives a field of one empty cell. Raises ParameterError for a step that is no length, or so short that
    the field would have more than 256 million cells.
    """
    if step is not None and not 0.0 < step < math.inf:
        raise ParameterError(f"a height field's step is a length in metres, found {step:g}")
    if not len(mesh.triangles):
        return HeightField((0.0, 0.0), step or _FINEST, (np.full((1, 1), -np.inf, dtype=np.float32),))
    low, high = (of(mesh.positions[:, :2], axis=0).astype(np.float64) for of in (np.min, np.max))
    wide, deep = high - low
    chosen = float(step) if step else max(_FINEST, math.sqrt(wide * deep / _CELLS), (wide + deep) / _CELLS)
    columns, rows = (math.floor(length / chosen) + 1 for length in (wide, deep))
    if rows * columns > _MOST_CELLS:
        raise ParameterError(
            f"a height field of at most {_MOST_CELLS} cells expected, "
            f"found {columns} x {rows} of {chosen:g} metres: a longer step is needed"
        )
    levels = [np.full((rows, columns), -np.inf, dtype=np.float32)]
    _raise_cells(mesh.positions, mesh.triangles, low[0], low[1], chosen, levels[0])
    while levels[-1].size > 1:
        levels.append(_halved(levels[-1]))
    return HeightField((float(low[0]), float(low[1])), chosen, tuple(levels))


@kernel(error_model="numpy", nogil=True)
def _halved(level: NDArray[np.float32]) -> NDArray[np.float32]:
    """The maxima of 2 x 2 cells; the last row and column may have fewer."""
    rows, columns = level.shape
    half = np.full(((rows + 1) // 2, (columns + 1) // 2), -np.inf, dtype=np.float32)
    for r in range(rows):
        for c in range(columns):
            half[r >> 1, c >> 1] = max(half[r >> 1, c >> 1], level[r, c])
    return half


@kernel(error_model="numpy", nogil=True)
def _raise_cells(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    x: float,
    y: float,
    step: float,
    cells: NDArray[np.float32],
) -> None:
    """Raises the ``cells`` (rows, columns), which begin at (x, y), to the triangles over them.

    Triangles are measured in cells: u along the columns, v along the rows.
    """
    p = np.empty((3, 3))
    caps = np.empty((2, 2, 2))  # lower and upper border of the row, the two points where it cuts the triangle, (u, z)
    found = np.empty(2, dtype=np.int64)  # and how many there are
    for t in range(len(triangles)):
        for k in range(3):
            i = triangles[t, k]
            p[k, 0], p[k, 1], p[k, 2] = (positions[i, 0] - x) / step, (positions[i, 1] - y) / step, positions[i, 2]
        first = int(min(p[0, 1], p[1, 1], p[2, 1]))
        last = int(max(p[0, 1], p[1, 1], p[2, 1]))
        if first == last:
            left = int(min(p[0, 0], p[1, 0], p[2, 0]))
            if left == int(max(p[0, 0], p[1, 0], p[2, 0])):
                cells[first, left] = max(cells[first, left], max(p[0, 2], p[1, 2], p[2, 2]))
                continue
        for row in range(first, last + 1):
            found[:] = 0
            for k in range(3):
                a, b = p[k], p[(k + 1) % 3]
                if (a[1] < row and b[1] < row) or (a[1] >= row + 1 and b[1] >= row + 1):
                    continue
                u0, z0, u1, z1 = a[0], a[2], b[0], b[2]
                for side in range(2):
                    border = row + side
                    if (a[1] < border) == (b[1] < border):
                        continue
                    share = (border - a[1]) / (b[1] - a[1])
                    u = min(max(a[0] + share * (b[0] - a[0]), min(a[0], b[0])), max(a[0], b[0]))
                    z = a[2] + share * (b[2] - a[2])
                    caps[side, found[side], 0], caps[side, found[side], 1] = u, z
                    found[side] += 1
                    if (a[1] < border) == (side == 0):
                        u0, z0 = u, z
                    else:
                        u1, z1 = u, z
                _raise_along(cells[row], u0, z0, u1, z1)
            for side in range(2):
                if found[side] == 2:
                    _raise_along(cells[row], caps[side, 0, 0], caps[side, 0, 1], caps[side, 1, 0], caps[side, 1, 1])


@kernel(error_model="numpy", nogil=True)
def _raise_along(cells: NDArray[np.float32], u0: float, z0: float, u1: float, z1: float) -> None:
    """Raises the ``cells`` (columns,) of a row to the line from (u0, z0) to (u1, z1) over them."""
    if u0 > u1:
        u0, z0, u1, z1 = u1, z1, u0, z0
    first, last = int(u0), int(u1)
    if first == last:
        cells[first] = max(cells[first], max(z0, z1))
        return
    rise = (z1 - z0) / (u1 - u0)
    for column in range(first, last + 1):
        highest = min(u1, column + 1.0) if rise > 0.0 else max(u0, float(column))
        cells[column] = max(cells[column], z0 + rise * (highest - u0))
