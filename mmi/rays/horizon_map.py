"""The horizon map of a viewpoint: how steep the city rises in each direction, beyond a near field. What is above it is sky.

Wimmer, Giegl & Schmalstieg 1998, section 6, march a ray through the height field for each column of the picture, which has to
be upright. Here the columns are of azimuth and each direction is held against its own, so that the viewer may tilt and turn;
and it is not a ray that is followed but the wedge of the whole column, so that nothing passes between two rays.

A column looks for the steepest slope (height above the eye over horizontal distance) among all cells of the height field that
touch its wedge and reach beyond the near field. It descends the pyramid of maxima, steepest first, and leaves out every block
that cannot rise above what is found: of a block, the highest point at the nearest place (below the eye, at the farthest) is
steeper than anything in it. It stops at cells that look as narrow as the column. Cost is that of the blocks near the horizon,
not of the city.

The map is conservative: no direction is called sky whose ray hits anything at a horizontal distance of ``beyond`` metres or
more. Cells are taken a millimetre larger and higher than they are, which is more than the rounding of whoever casts the rays.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmi.foundation.errors import ParameterError
from mmi.foundation.kernels import kernel
from mmi.rays.height_field import HeightField, Pyramid

__all__ = ["Horizon", "azimuths_of", "horizon_of", "is_above", "sky"]

_SLACK = 1e-3
"""Metres by which cells are larger and higher than they are."""
_DEPTH = 256
"""Blocks that wait while others are looked into, at most: three a level, of no more than 64 levels."""
_TURN = 2.0 * math.pi


@dataclass(frozen=True, slots=True, eq=False)
class Horizon:
    """Per column of azimuth, the slope above which nothing is seen of the city beyond the near field.

    ``slopes`` (n,) float64 are heights above the eye over horizontal distance: -inf where the column is empty, inf where it is
    full. Column i begins at ``first`` + i / ``per_radian`` radians, counter-clockwise from +x.
    """

    slopes: NDArray[np.float64]
    first: float
    per_radian: float

    def __post_init__(self) -> None:
        self.slopes.setflags(write=False)


def horizon_of(
    field: HeightField,
    eye: ArrayLike,
    *,
    beyond: float,
    columns: int = 2048,
    window: tuple[float, float] | None = None,
) -> Horizon:
    """The horizon of everything in ``field`` that is ``beyond`` metres or more from ``eye`` (3,), measured horizontally.

    There are ``columns`` columns all around; with a ``window``, from one azimuth counter-clockwise to another (radians), those
    that it touches. Raises ParameterError where there is no column, or the near field or the eye is no place.
    """
    place = np.asarray(eye, dtype=np.float64).reshape(-1)
    if place.shape != (3,) or not np.isfinite(place).all():
        raise ParameterError(f"a horizon's eye is a point (x, y, z) in metres, found {place.tolist()}")
    if columns < 1:
        raise ParameterError(f"a horizon needs at least one column, found {columns}")
    if not 0.0 <= beyond < math.inf:
        raise ParameterError(f"a horizon begins at a distance of 0 metres or more, found {beyond:g}")
    width = _TURN / columns
    first, count = 0, columns
    if window is not None and window[1] - window[0] < _TURN:
        first = math.floor(window[0] / width)
        last = math.floor((window[0] + (window[1] - window[0]) % _TURN) / width)
        count = min(last - first + 1, columns)
    slopes = np.empty(count)
    ground = _Ground(field.corner[0] - place[0], field.corner[1] - place[1], place[2], field.step, beyond)
    _find_steepest(field.pyramid, ground, first, width, slopes)
    return Horizon(slopes, first * width, 1.0 / width)


def azimuths_of(directions: ArrayLike) -> tuple[float, float] | None:
    """The azimuths of the cone that ``directions`` (n, 3) span (the corners of a view, say), as a window of a horizon.

    None is all around: the cone holds the vertical, or comes so close that it cannot be told. (A cone of nothing as well.)
    """
    xy = np.asarray(directions, dtype=np.float64).reshape(-1, 3)[:, :2]
    if not len(xy) or not np.hypot(*xy.T).all():
        return None
    turns = np.sort(np.arctan2(xy[:, 1], xy[:, 0]))
    gaps = np.append(turns[1:], turns[0] + _TURN) - turns
    widest = int(np.argmax(gaps))
    if gaps[widest] <= math.pi + 1e-9:
        return None
    start = float(turns[(widest + 1) % len(turns)])
    return start, start + _TURN - float(gaps[widest])


def sky(horizon: Horizon, directions: ArrayLike) -> NDArray[np.bool_]:
    """(n,) whether each of ``directions`` (n, 3), of any length, is above the horizon of its azimuth.

    False outside the horizon's window.
    """
    rows = np.ascontiguousarray(directions, dtype=np.float64).reshape(-1, 3)
    return _sky(horizon.slopes, horizon.first, horizon.per_radian, rows)


@kernel(error_model="numpy", nogil=True)
def is_above(
    slopes: NDArray[np.float64], first: float, per_radian: float, turn: float, level: float, dz: float
) -> bool:
    """Whether a direction is above the horizon whose fields the first three are, as a kernel for kernels.

    ``turn`` is the direction's azimuth, ``level`` the length of its part along the ground, ``dz`` that of its part upwards.
    """
    turn -= first
    turn -= _TURN * math.floor(turn / _TURN)
    column = int(turn * per_radian)
    if not 0 <= column < len(slopes):
        return False
    slope = slopes[column]
    return slope == -math.inf or dz > slope * level


@kernel(error_model="numpy", nogil=True)
def _sky(
    slopes: NDArray[np.float64], first: float, per_radian: float, directions: NDArray[np.float64]
) -> NDArray[np.bool_]:
    above = np.empty(len(directions), dtype=np.bool_)
    for i in range(len(directions)):
        x, y = directions[i, 0], directions[i, 1]
        above[i] = is_above(slopes, first, per_radian, math.atan2(y, x), math.sqrt(x * x + y * y), directions[i, 2])
    return above


class _Ground(NamedTuple):
    """The field as the eye has it, in metres: its corner from the eye (``x``, ``y``), the ``eye``'s height, its ``step``, and
    where the near field ends (``beyond``).
    """

    x: float
    y: float
    eye: float
    step: float
    beyond: float


class _Wedge(NamedTuple):
    """A column: the directions of its right and left border and of its middle, and its ``width`` in radians."""

    rx: float
    ry: float
    lx: float
    ly: float
    mx: float
    my: float
    width: float


@kernel(error_model="numpy", nogil=True)
def _find_steepest(pyramid: Pyramid, ground: _Ground, first: int, width: float, slopes: NDArray[np.float64]) -> None:
    """Fills in the ``slopes`` of columns ``first`` and following, of ``width`` radians each."""
    heights, starts, shapes = pyramid
    blocks = np.empty((_DEPTH, 3), dtype=np.int64)  # level, row, column of those that wait
    bounds = np.empty(_DEPTH)  # and how steep each may be
    top = len(starts) - 1
    guess = np.array([top, 0, 0])  # the steepest cell of the column before
    for i in range(len(slopes)):
        right, left = (first + i) * width, (first + i + 1) * width
        middle = 0.5 * (right + left)
        wedge = _Wedge(
            math.cos(right), math.sin(right), math.cos(left), math.sin(left), math.cos(middle), math.sin(middle), width
        )
        steepest, final = _bound(heights[starts[top]], top, 0, 0, ground, wedge)
        waiting = 0
        if not final:
            blocks[0], bounds[0] = (top, 0, 0), steepest
            waiting = 1
            level, row, column = guess
            place = starts[level] + row * shapes[level, 1] + column
            guessed, final = _bound(heights[place], level, row, column, ground, wedge)
            steepest = guessed if final else -math.inf
        while waiting:
            waiting -= 1
            if bounds[waiting] <= steepest:
                continue
            level, row, column = blocks[waiting]
            level -= 1
            base = waiting
            for r in range(2 * row, min(2 * row + 2, shapes[level, 0])):
                for c in range(2 * column, min(2 * column + 2, shapes[level, 1])):
                    place = starts[level] + r * shapes[level, 1] + c
                    bound, final = _bound(heights[place], level, r, c, ground, wedge)
                    if bound <= steepest:
                        continue
                    if final:
                        steepest = bound
                        guess[:] = level, r, c
                        continue
                    k = waiting
                    while k > base and bounds[k - 1] > bound:
                        bounds[k], blocks[k] = bounds[k - 1], blocks[k - 1]
                        k -= 1
                    bounds[k], blocks[k] = bound, (level, r, c)
                    waiting += 1
        slopes[i] = steepest


@kernel(error_model="numpy", nogil=True)
def _bound(height: float, level: int, row: int, column: int, ground: _Ground, wedge: _Wedge) -> tuple[float, bool]:
    """How steep anything in a block of some ``height`` may be, -inf if the wedge misses it; and whether this is its slope.

    It is where the block is a cell of the finest level, or looks as narrow as the column.
    """
    if height == -math.inf:
        return -math.inf, True
    size = ground.step * (1 << level)
    half = 0.5 * size + _SLACK
    x, y = ground.x + (column + 0.5) * size, ground.y + (row + 0.5) * size
    if wedge.width <= math.pi:
        if wedge.mx * x + wedge.my * y + half * (abs(wedge.mx) + abs(wedge.my)) < 0.0:
            return -math.inf, True
        if wedge.width < math.pi and (
            wedge.rx * y - wedge.ry * x + half * (abs(wedge.rx) + abs(wedge.ry)) < 0.0
            or wedge.ly * x - wedge.lx * y + half * (abs(wedge.lx) + abs(wedge.ly)) < 0.0
        ):
            return -math.inf, True
    x, y = abs(x), abs(y)
    far, near = (x + half) ** 2 + (y + half) ** 2, max(x - half, 0.0) ** 2 + max(y - half, 0.0) ** 2  # squares
    beyond = ground.beyond**2
    if far < beyond:
        return -math.inf, True
    rise = height - ground.eye + _SLACK
    slope = rise / math.sqrt(max(near, beyond) if rise > 0.0 else far)
    return slope, level == 0 or size * size <= near * wedge.width**2
