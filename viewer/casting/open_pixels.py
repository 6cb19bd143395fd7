"""What each pixel of a picture needs, once the near field is drawn (paper sections 4.1, 5.2 and 6).

    COVERED   something near is drawn there, or something that is above the horizon of all that is far
    SKY       above the horizon of all that is far
    REUSED    a texel of the panorama has it, cast from near enough
    CAST      nothing has it: a ray must be cast

A texel is looked up where the pixel looks to, and where the surface found there would have been seen from where it was cast:
the direction is corrected by the parallax, twice at most, and of all texels met the one is taken whose point is nearest to the
pixel's own direction. So what is shown again is reprojected, and stretched surfaces get no gaps.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View
from mmi.foundation.kernels import kernel
from mmi.rays.horizon_map import is_above
from viewer.casting.angles import angle_of
from viewer.casting.panorama import Found, Texels, texel_of

__all__ = ["CAST", "COVERED", "REUSED", "SKY", "TILE", "Rays", "classify", "rays_of"]

COVERED, SKY, REUSED, CAST = 0, 1, 2, 3
_CORRECTIONS = 2
_EXACT_PX = 0.05
"""Pixels within which a texel is the pixel's own."""
TILE = 16
"""Pixels of a side of the tiles that are looked at as a whole first."""
_WIDEST = 1.0
"""Radians of azimuth that a tile may have to be looked at as a whole."""
_TURN = 2.0 * math.pi
_ASIDE, _ABOVE = (0, -1, 0, 1, -1, 1, -1, 0, 1), (0, -1, -1, -1, 0, 0, 1, 1, 1)
_ROUNDING_PX = 1.0
"""Pixels that a texel may be off besides what the viewer has moved: it may lie half a texel beside, and the pixel too."""


class Rays(NamedTuple):
    """The rays through a picture's pixels. The one of column j and row i goes along ``axes`` (3, 3), rows right, up and back of
    the eye, times ((``left`` + j) / ``focal``, -(``top`` + i) / ``focal``, -1): that is a point at depth 1.
    """

    axes: NDArray[np.float64]
    eye: NDArray[np.float64]
    focal: float
    left: float
    top: float


def rays_of(view: View, first_column: int = 0) -> Rays:
    """The rays through the middles of a view's pixels, from a column on."""
    left, top, _, _ = view.window
    axes = np.ascontiguousarray(view.eye_from_world[:3, :3])
    return Rays(axes, view.eye, float(view.focal), left + first_column + 0.5, top + 0.5)


@kernel(error_model="numpy", nogil=True)
def classify(
    depths: NDArray[np.float32],
    first_row: int,
    step: int,
    rays: Rays,
    near: float,
    slopes: NDArray[np.float64],
    first: float,
    per_radian: float,
    texels: Texels,
    record_error: NDArray[np.float32],
    near_objects: NDArray[np.bool_],
    limit: float,
    own_errors: bool,
    found: Found,
    begin: int,
) -> tuple[int, int]:
    """Find out what pixels need, into ``found``, those of every ``step``-th row of tiles from ``first_row`` on.

    Returns where the list of open ones that starts at ``begin`` ends, and how many pixels are sky.

    ``depths`` (h, w) are those of what was drawn, infinite for sky; far is what is ``near`` metres away or more. The horizon
    of the far is ``slopes`` as :func:`mmi.rays.horizon_map.is_above` has them. ``record_error`` (records,) says by how many
    pixels what was cast for each record may be off at most, infinite where it must not be shown; with ``own_errors`` it is each
    texel's own point that counts, where it has one. ``near_objects`` says which of the city's objects are drawn.
    """
    end, sky = begin, 0
    for top in range(TILE * first_row, depths.shape[0], TILE * step):
        bottom = min(top + TILE, depths.shape[0])
        for left in range(0, depths.shape[1], TILE):
            right = min(left + TILE, depths.shape[1])
            if _is_near(depths, top, bottom, left, right, rays, near):
                found.state[top:bottom, left:right] = COVERED
                continue
            steep, least = _steepest(top, bottom, left, right, rays, slopes, first, per_radian)
            if least > steep:
                sky += _all_above(depths, top, bottom, left, right, found)
                continue
            end, some = _each(
                depths,
                top,
                bottom,
                left,
                right,
                rays,
                near,
                slopes,
                first,
                per_radian,
                steep,
                texels,
                record_error,
                near_objects,
                limit,
                own_errors,
                found,
                end,
            )
            sky += some
    return end, sky


@kernel(error_model="numpy", nogil=True)
def _is_near(
    depths: NDArray[np.float32], top: int, bottom: int, left: int, right: int, rays: Rays, near: float
) -> bool:
    """Whether what is near covers all of a tile."""
    longest = 0.0
    for k in range(4):
        x = (rays.left + (right - 1 if k & 1 else left)) / rays.focal
        y = (rays.top + (bottom - 1 if k & 2 else top)) / rays.focal
        longest = max(longest, math.sqrt(x * x + y * y + 1.0))
    limit = np.float32(near / longest)
    beyond = 0  # counted, which several pixels are at a time
    for i in range(top, bottom):
        for j in range(left, right):
            beyond += depths[i, j] > limit
    return beyond == 0


@kernel(error_model="numpy", nogil=True)
def _all_above(depths: NDArray[np.float32], top: int, bottom: int, left: int, right: int, found: Found) -> int:
    """A tile that is above the horizon: how many of its pixels are sky, those that nothing near covers."""
    sky = 0
    for i in range(top, bottom):
        for j in range(left, right):
            is_open = depths[i, j] == np.inf
            found.state[i, j] = SKY if is_open else COVERED
            sky += is_open
    return sky


@kernel(error_model="numpy", nogil=True)
def _steepest(
    top: int,
    bottom: int,
    left: int,
    right: int,
    rays: Rays,
    slopes: NDArray[np.float64],
    first: float,
    per_radian: float,
) -> tuple[float, float]:
    """The steepest of the horizon in all azimuths of a tile, infinite where its corners do not tell them; and the least slope
    of the tile's directions, -inf where a corner does not look upwards.

    Great circles between directions above the horizontal bulge upwards, so that corners that look upwards have the least.
    """
    least, low, high = np.inf, 0.0, 0.0
    start = 0.0
    for k in range(4):
        x = (rays.left + (right - 1 if k & 1 else left)) / rays.focal
        y = -(rays.top + (bottom - 1 if k & 2 else top)) / rays.focal
        dx, dy, dz = _direction(x, y, rays.axes)
        level = math.sqrt(dx * dx + dy * dy)
        if level <= 1e-6:
            return np.inf, -np.inf
        least = min(least, dz / level if dz > 0.0 else -np.inf)
        turn = angle_of(dy, dx)
        if k == 0:
            start = turn
        aside = turn - start
        aside -= _TURN * math.floor(aside / _TURN + 0.5)
        low, high = min(low, aside), max(high, aside)
    if high - low > _WIDEST:
        return np.inf, least
    begin = start + low - first
    begin -= _TURN * math.floor(begin / _TURN)
    column, last = int(begin * per_radian), int((begin + high - low) * per_radian)
    if last >= len(slopes):
        return np.inf, least
    return slopes[column : last + 1].max(), least


@kernel(error_model="numpy", nogil=True, inline="always")
def _direction(x: float, y: float, axes: NDArray[np.float64]) -> tuple[float, float, float]:
    """The point at depth 1 that is ``x`` to the right and ``y`` above the middle."""
    return (
        axes[0, 0] * x + axes[1, 0] * y - axes[2, 0],
        axes[0, 1] * x + axes[1, 1] * y - axes[2, 1],
        axes[0, 2] * x + axes[1, 2] * y - axes[2, 2],
    )


@kernel(error_model="numpy", nogil=True)
def _each(
    depths: NDArray[np.float32],
    top: int,
    bottom: int,
    left: int,
    right: int,
    rays: Rays,
    near: float,
    slopes: NDArray[np.float64],
    first: float,
    per_radian: float,
    steep: float,
    texels: Texels,
    record_error: NDArray[np.float32],
    near_objects: NDArray[np.bool_],
    limit: float,
    own_errors: bool,
    found: Found,
    end: int,
) -> tuple[int, int]:
    """Find out what each pixel of a tile needs, and add those that are open to the list that has come to ``end``: where it has
    come to now, and how many are sky. The horizon is nowhere steeper in the tile than ``steep``.
    """
    eye, focal, per_column = rays.eye, rays.focal, 1.0 / texels.step
    sky = 0
    for i in range(top, bottom):
        y = -(rays.top + i) / focal
        for j in range(left, right):
            x = (rays.left + j) / focal
            length = math.sqrt(x * x + y * y + 1.0)
            drawn = depths[i, j]
            if drawn * length <= near:
                found.state[i, j] = COVERED
                continue
            dx, dy, dz = _direction(x, y, rays.axes)
            is_open = drawn == np.inf
            level = math.sqrt(dx * dx + dy * dy)
            above, turn = steep == -np.inf or dz > steep * level, 0.0
            if not above:
                turn = angle_of(dy, dx)
                above = is_above(slopes, first, per_radian, turn, level, dz)
            if above:
                found.state[i, j] = SKY if is_open else COVERED
                sky += is_open
                continue
            column = min(int((turn + math.pi) * per_column), texels.columns - 1)
            row = min(int((angle_of(dz, level) + 0.5 * math.pi) * per_column), texels.rows - 1)
            texel = row * texels.columns + column
            shrink = 1.0 / length
            dx, dy, dz = shrink * dx, shrink * dy, shrink * dz
            off = _off(texels.map[texel], dx, dy, dz, eye, record_error, near_objects, is_open)
            if off > texels.step * texels.step:  # few are
                texel, off = _best(dx, dy, dz, column, row, eye, texels, record_error, near_objects, is_open)
            found.pixel[end] = i * depths.shape[1] + j
            if texel < 0:
                found.state[i, j], found.texel[end], found.error[end] = CAST, -1, np.inf
                end += 1
                continue
            off = focal * math.sqrt(off)
            own = own_errors and texels.map[texel].object >= 0
            error = off if own else record_error[texels.map[texel].record]
            if error > (max(limit, _ROUNDING_PX) if own else limit) or off > error + _ROUNDING_PX:
                found.state[i, j] = CAST
                if not own and off > error + _ROUNDING_PX:
                    texel, error = -1, np.inf  # it is some other pixel's
            else:
                found.state[i, j] = REUSED
                if off > _EXACT_PX:
                    error = max(error, off)
            found.texel[end], found.error[end] = texel, error
            end += 1
    return end, sky


@kernel(error_model="numpy", nogil=True, inline="always")
def _off(
    texel: Any,  # noqa: ANN401  a record of the map, as Numba has it
    dx: float,
    dy: float,
    dz: float,
    eye: NDArray[np.float64],
    record_error: NDArray[np.float32],
    near_objects: NDArray[np.bool_],
    is_open: bool,
) -> float:
    """The square of the chord from a unit direction to that in which a texel's point is seen, to 1e-15; infinite where it must
    not be shown.

    Points of near objects are drawn where the viewer sees them, so that an open pixel shows none of them.
    """
    if texel.record == 0 or record_error[texel.record] == np.inf:
        return np.inf
    px, py, pz = float(texel.x), float(texel.y), float(texel.z)
    if texel.object >= 0:
        if is_open and near_objects[texel.object]:
            return np.inf
        px, py, pz = px - eye[0], py - eye[1], pz - eye[2]
    cosine = (px * dx + py * dy + pz * dz) / math.sqrt(px * px + py * py + pz * pz)
    return max(2.0 - 2.0 * cosine, 0.0)


@kernel(error_model="numpy", nogil=True)
def _best(
    dx: float,
    dy: float,
    dz: float,
    column: int,
    row: int,
    eye: NDArray[np.float64],
    texels: Texels,
    record_error: NDArray[np.float32],
    near_objects: NDArray[np.bool_],
    is_open: bool,
) -> tuple[int, float]:
    """The texel whose point is seen nearest to a direction, and the square of how far off it is; -1 where there is none.

    It is looked for at ``column`` and ``row``, where the direction goes to, around there, and where what is found would be.
    """
    known, columns, rows, step = texels.map, texels.columns, texels.rows, texels.step
    best, least, near = -1, np.inf, step * step
    tx, ty, tz = dx, dy, dz
    for correction in range(_CORRECTIONS + 1):
        met = -1
        for k in range(9):  # the texel itself, then those around it
            if k > 0 and met >= 0 and least <= near:
                break
            c, r = column + _ASIDE[k], row + _ABOVE[k]
            if r < 0 or r >= rows:
                continue
            if c < 0:
                c += columns
            elif c >= columns:
                c -= columns
            place = r * columns + c
            off = _off(known[place], dx, dy, dz, eye, record_error, near_objects, is_open)
            if off < least:
                best, least, met = place, off, place
        if met < 0 or least <= near or correction == _CORRECTIONS:
            break
        texel = known[met]
        if texel.object < 0:
            break
        px, py, pz = texel.x - eye[0], texel.y - eye[1], texel.z - eye[2]
        size = math.sqrt(px * px + py * py + pz * pz)
        tx, ty, tz = tx + dx - px / size, ty + dy - py / size, tz + dz - pz / size
        before = column, row
        column, row = texel_of(tx, ty, tz, columns, rows, step)
        if (column, row) == before:
            break
    return best, least
