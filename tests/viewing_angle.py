"""The angle under which two points are seen from a segment or a cell, and how much it changes (paper section 4.1).

Two points A and B are seen under the angle AMB from M; the closed form of eqs. (3)-(5) gives its extremes for M on a
segment. The angle is a harmonic function of M, so over a cell with a width its extremes lie on the cell's four sides.

The *unsigned* angle in [0, pi] is the paper's; it is blind to an exchange of left and right (+5 degrees becoming -5
degrees is no change). The *signed* angle follows the points without jumps.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mmi.cells.viewing_cells import ViewingCell

__all__ = ["extremal_angles", "point_pair_weights"]

_ON_LINE = 1e-13
"""A point this close to a line, relative to the lengths involved, lies on it."""


def extremal_angles(
    a: ArrayLike, b: ArrayLike, p: ArrayLike, q: ArrayLike, *, signed: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and greatest angle AMB for M in [PQ], radians: the closed form of paper eqs. (3)-(5).

    ``a``, ``b``, ``p``, ``q`` are points (..., 2) that broadcast against each other; the result has their shape less the
    last axis. The unsigned angle lies in [0, pi]. The signed angle turns from MA to MB counter-clockwise, lies in
    (-pi, pi] at P and continues from there without jumps, so it may leave that interval. Where M meets A or B, the
    limits count. The signed angle has no continuation through A or B: raises ValueError if one lies between P and Q;
    also if P = Q.
    """
    shape = np.broadcast_shapes(np.shape(a), np.shape(b), np.shape(p), np.shape(q))
    points = [np.broadcast_to(np.asarray(x, dtype=np.float64), shape).reshape(-1, 2) for x in (a, b, p, q)]
    result = np.empty((len(points[0]), 4))
    for i, (one_a, one_b, one_p, one_q) in enumerate(zip(*points, strict=True)):
        result[i] = _angles_along(
            one_a[0], one_a[1], one_b[0], one_b[1], one_p[0], one_p[1], one_q[0], one_q[1], signed
        )
    if np.isnan(result).any():
        raise ValueError("extremal angles need P and Q apart and, signed, neither A nor B between them")
    return result[:, 0].reshape(shape[:-1]), result[:, 1].reshape(shape[:-1])


def point_pair_weights(cell: ViewingCell, a: ArrayLike, b: ArrayLike, *, signed: bool = True) -> NDArray[np.float64]:
    """Largest change of the angle AMB over the cell's region, radians: exact, for points ``a`` and ``b`` (..., 2).

    Walks the four sides of the region, where the extremes lie. The signed change is 2 pi (no bound) for points that lie
    in the region.
    """
    shape = np.broadcast_shapes(np.shape(a), np.shape(b))
    points = [np.broadcast_to(np.asarray(x, dtype=np.float64), shape).reshape(-1, 2) for x in (a, b)]
    return _region_weights(points[0], points[1], cell.corners, signed).reshape(shape[:-1])


@njit(cache=True, error_model="numpy")
def _region_weights(
    a: NDArray[np.float64], b: NDArray[np.float64], corners: NDArray[np.float64], signed: bool
) -> NDArray[np.float64]:
    weights = np.empty(len(a))
    for i in range(len(a)):
        low, high, reached = math.inf, -math.inf, 0.0
        for k in range(4):
            p, q = corners[k], corners[(k + 1) % 4]
            least, most, start, end = _angles_along(a[i, 0], a[i, 1], b[i, 0], b[i, 1], p[0], p[1], q[0], q[1], signed)
            # Each side starts on its own branch of the signed angle; shift it to where the last side ended.
            shift = reached - start if signed and k > 0 else 0.0
            low, high, reached = min(low, least + shift), max(high, most + shift), end + shift
        inside = False
        for x, y in ((a[i, 0], a[i, 1]), (b[i, 0], b[i, 1])):
            left_of_all = True
            for k in range(4):
                p, q = corners[k], corners[(k + 1) % 4]
                left_of_all = left_of_all and (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) >= 0.0
            inside = inside or left_of_all
        if inside or math.isnan(high - low):
            weights[i] = 2.0 * math.pi if signed else math.pi
        else:
            weights[i] = high - low
    return weights


@njit(cache=True, error_model="numpy")
def _angles_along(
    xa: float, ya: float, xb: float, yb: float, xp: float, yp: float, xq: float, yq: float, signed: bool
) -> tuple[float, float, float, float]:
    """(least, most, at P, at Q) of the angle AMB for M in [PQ]; all nan where it is undefined.

    Like the paper, in a frame whose x axis is PQ, here with its origin at P and without the scaling that puts A at
    (0, 1): eqs. (3)-(5) then read as in _tangent_points, and a point A on the line PQ needs no frame of its own.
    """
    length = math.hypot(xq - xp, yq - yp)
    if length == 0.0:
        return math.nan, math.nan, math.nan, math.nan
    ux, uy = (xq - xp) / length, (yq - yp) / length
    ax, ay = _to_line_frame(xa - xp, ya - yp, ux, uy, length)
    bx, by = _to_line_frame(xb - xp, yb - yp, ux, uy, length)
    one, other = _tangent_points(ax, ay, bx, by)
    if signed:
        if (ay == 0.0 and 0.0 < ax < length) or (by == 0.0 and 0.0 < bx < length):
            return math.nan, math.nan, math.nan, math.nan
        start = _angle_at(0.0, ax, ay, bx, by, -1.0)
        end = start + _turn(length, bx, by) - _turn(length, ax, ay)
        least, most = min(start, end), max(start, end)
        for x in (one, other):
            if 0.0 < x < length:
                angle = start + _turn(x, bx, by) - _turn(x, ax, ay)
                least, most = min(least, angle), max(most, angle)
        return least, most, start, end
    start, end = abs(_angle_at(0.0, ax, ay, bx, by, -1.0)), abs(_angle_at(length, ax, ay, bx, by, 1.0))
    least, most = min(start, end), max(start, end)
    # Eq. (3): where the line AB meets PQ, the unsigned angle is 0 or pi. Then where M meets A or B, from both sides.
    crossing = ax + ay * (bx - ax) / (ay - by) if ay != by else math.nan
    foot_a, foot_b = (ax if ay == 0.0 else math.nan), (bx if by == 0.0 else math.nan)
    for x in (crossing, one, other, foot_a, foot_b):
        if 0.0 < x < length:
            for side in (-1.0, 1.0):
                angle = abs(_angle_at(x, ax, ay, bx, by, side))
                least, most = min(least, angle), max(most, angle)
    return least, most, start, end


@njit(cache=True, error_model="numpy")
def _to_line_frame(dx: float, dy: float, ux: float, uy: float, length: float) -> tuple[float, float]:
    """A point relative to P in the frame of PQ; onto the line, and onto its ends, where rounding alone keeps it off."""
    x, y = dx * ux + dy * uy, ux * dy - uy * dx
    scale = _ON_LINE * max(abs(x), length)
    if abs(y) <= scale:
        y = 0.0
        if abs(x) <= scale:
            x = 0.0
        elif abs(x - length) <= scale:
            x = length
    return x, y


@njit(cache=True, error_model="numpy")
def _tangent_points(ax: float, ay: float, bx: float, by: float) -> tuple[float, float]:
    """Where circles through A and B touch the line y = 0: paper eqs. (4), (5) multiplied by y_A.

    The roots of (by - ay) t^2 + 2 ay (bx - ax) t + ay (by (ay - by) - (bx - ax)^2) = 0 with t = x - ax. None (nan) if A
    and B lie on opposite sides or on the line, where the paper's root is imaginary or zero; one if AB is parallel to it.
    """
    d = bx - ax
    square = ay * by * ((by - ay) ** 2 + d * d)
    if not square > 0.0:
        return math.nan, math.nan
    s = -(ay * d + math.copysign(math.sqrt(square), ay * d))
    one = ax + s / (by - ay) if by != ay else math.nan
    return one, ax + ay * (by * (ay - by) - d * d) / s


@njit(cache=True, error_model="numpy")
def _angle_at(x: float, ax: float, ay: float, bx: float, by: float, side: float) -> float:
    """Signed principal angle AMB from M = (x, 0). If M meets a point, as the limit from x - eps (side 1) or x + eps."""
    adx = side if ax == x and ay == 0.0 else ax - x
    bdx = side if bx == x and by == 0.0 else bx - x
    return math.atan2(adx * by - ay * bdx, adx * bdx + ay * by)


@njit(cache=True, error_model="numpy")
def _turn(x: float, px: float, py: float) -> float:
    """How far the direction to (px, py) turns while M moves from the origin to (x, 0): in (-pi, pi), without jumps."""
    return math.atan2(py * x, px * (px - x) + py * py)
