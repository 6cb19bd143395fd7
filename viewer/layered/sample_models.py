"""What the samples of a layered image are likely to be, given those before them: what is told of each, and in which context.

Each function tells a property of all samples to a :class:`viewer.layered.range_coder.Coder`, or is told it: writing and reading
go through the same lines, so that they agree. Pixels come row by row, the samples of a pixel from near to far.

    objects     mostly those of the pixel to the left or above
    1 / depth   goes on in a plane with neighbours, which are samples of the same object in pixels beside
    slopes      mostly what 1 / depth differs by from a neighbour on either side; else like those of neighbours
    reaches     end short of the pixel's border where no neighbour goes on
    colors      go on as 1 / depth does; their three channels vary together

How far off neighbours were says how far off the next may be. What is not exact comes out as it will be read.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.kernels import kernel
from viewer.layered.layered_image import HALF
from viewer.layered.range_coder import WIDTH, Coder, bit, chances_for, number

__all__ = ["LARGEST", "Samples", "room_for", "tell_colors", "tell_counts", "tell_depths", "tell_reaches", "tell_slopes"]

_COARSE, _SHARE = 2, 32
"""Steps of 1 / depth that a slope may be off by, or its ``_SHARE``-th part, if that is more."""
_EXACT, _HALF = 64, 32
"""Slopes below the first, in ``_COARSE`` steps, are their own codes; of twice a slope they are larger by the second."""
LARGEST = (1 << 24) * _COARSE
"""No slope is larger, in steps per pixel."""
_LARGEST_CODE = _EXACT + 19 * _HALF
_OFF = 3
"""What colors may be off by."""
_TINT = 2 * _OFF + 1
_HELD = 12
"""Samples that are told to ``_OFF`` after one that neighbours did not tell; then, while neighbours tell them, exactly."""
_LEFT, _UP, _RIGHT, _DOWN, _CORNER = range(5)
"""Where neighbours are, the last to the left and above."""
_SIZES = 10
_LOW, _HIGH, _CODED = range(3)
"""How a slope is told: by the neighbour before, by the one after, or by its code."""
_MOST = 5
"""Samples of a pixel that are told apart where they are context."""


class Samples(NamedTuple):
    """Samples in whole numbers: ``starts`` as in the image; ``places`` (m,) among the objects; ``steps`` (m,) of 1 / depth;
    ``slopes`` (m, 2), steps per pixel; ``reaches`` (m, 4) and ``colors`` (m, 3) as in the image; and their neighbours
    ``beside`` them (m, 5), -1 for none, which :func:`tell_depths` finds.
    """

    starts: NDArray[np.int32]
    places: NDArray[np.int32]
    steps: NDArray[np.int32]
    slopes: NDArray[np.int32]
    reaches: NDArray[np.int32]
    colors: NDArray[np.int32]
    beside: NDArray[np.int32]


def room_for(starts: NDArray[np.int32]) -> Samples:
    """Samples that are not known yet."""
    count = int(starts[-1])
    shapes = ((count,), (count,), (count, 2), (count, 4), (count, 3), (count, 5))
    return Samples(np.array(starts), *(np.zeros(shape, np.int32) for shape in shapes))


def tell_counts(coder: Coder, counts: NDArray[np.int32]) -> None:
    """How many samples pixels have, (h, w)."""
    _tell_counts(coder, chances_for((_MOST + 1) ** 3 * WIDTH), counts)


def tell_depths(coder: Coder, width: int, objects: int, samples: Samples) -> None:
    """Places among so many objects, and steps, in an image so many pixels wide."""
    _tell_depths(coder, chances_for((10 * _SIZES + 3) * WIDTH), chances_for(3 * 16 * 3), width, objects, samples)


def tell_slopes(coder: Coder, samples: Samples) -> None:
    """Slopes, which may be off by two steps or a 32nd."""
    _tell_slopes(coder, chances_for(32 * WIDTH), chances_for(2 * 4 * 16 * 4 * 8 * 2), samples)


def tell_reaches(coder: Coder, samples: Samples) -> None:
    """Reaches."""
    _tell_reaches(coder, chances_for(64), chances_for(4 * 3 * 2 * 2), chances_for(16 * 5 * 2), samples)


def tell_colors(coder: Coder, objects: int, samples: Samples) -> None:
    """Colors, which may be off by 3."""
    latest = np.zeros((objects, 3), np.int32)
    _tell_colors(coder, chances_for(2 * 5 * 3 * _SIZES * WIDTH), latest, samples)


@kernel(error_model="numpy", nogil=True)
def _tell_counts(coder: Coder, chances: NDArray[np.int32], counts: NDArray[np.int32]) -> None:
    for y in range(counts.shape[0]):
        for x in range(counts.shape[1]):
            left = min(counts[y, x - 1], _MOST) if x > 0 else 0
            up = min(counts[y - 1, x], _MOST) if y > 0 else 0
            right = min(counts[y - 1, x + 1], _MOST) if y > 0 and x + 1 < counts.shape[1] else up
            kind = (left * (_MOST + 1) + up) * (_MOST + 1) + right
            counts[y, x] = number(coder, chances, WIDTH * kind, counts[y, x], False)


@kernel(error_model="numpy", nogil=True)
def _tell_depths(
    coder: Coder,
    chances: NDArray[np.int32],
    same: NDArray[np.int32],
    width: int,
    objects: int,
    samples: Samples,
) -> None:
    starts, places, steps, beside = samples.starts, samples.places, samples.steps, samples.beside
    off = np.zeros(len(steps), np.int32)
    for pixel in range(len(starts) - 1):
        column, above = pixel % width, pixel - width
        aside = pixel - 1 if column > 0 else -1
        corner, other = (above - 1 if column > 0 else -1), (above + 1 if column < width - 1 else -1)
        for k in range(starts[pixel], starts[pixel + 1]):
            rank = k - starts[pixel]
            left, up = _of_rank(starts, aside, rank), _of_rank(starts, above, rank)
            beyond, right = _of_rank(starts, corner, rank), _of_rank(starts, other, rank)
            first = places[left] if left >= 0 else places[up] if up >= 0 else 0
            second = places[up] if up >= 0 else first
            third = places[right] if right >= 0 else second
            fourth = places[beyond] if beyond >= 0 else first
            kind = (first == second) + 2 * (third == second) + 4 * (fourth == first) + 8 * (fourth == second)
            slot = 3 * (kind + 16 * min(rank, 2))
            place = places[k]
            if bit(coder, same, slot, place == first):
                place = first
            elif second != first and bit(coder, same, slot + 1, place == second):
                place = second
            elif third not in (first, second) and bit(coder, same, slot + 2, place == third):
                place = third
            else:
                slot = WIDTH * (10 * _SIZES + min(rank, 2))
                place = first + number(coder, chances, slot, place - first, True)
                place = min(max(place, 0), objects - 1)
            places[k] = place
            left, up = _like(starts, aside, left, place, places), _like(starts, above, up, place, places)
            beyond = _like(starts, corner, beyond, place, places)
            predicted, kind, spread = 0, 0, 0
            if left >= 0 and up >= 0:
                least, most = min(steps[left], steps[up]), max(steps[left], steps[up])
                predicted, kind, spread = (least + most) // 2, 3, abs(off[left]) + abs(off[up])
                if beyond >= 0:
                    room = most - least + 16
                    predicted = min(max(steps[left] + steps[up] - steps[beyond], least - room), most + room)
                    kind = 4
            elif left >= 0 or up >= 0:
                one = max(left, up)
                predicted, kind, spread = steps[one], 2, 2 * abs(off[one])
            elif rank > 0:
                predicted, kind = steps[k - 1], 1
            if rank > 0:
                predicted = min(predicted, steps[k - 1])
            slot = WIDTH * (_size(spread) + _SIZES * (kind + 5 * min(rank, 1)))
            off[k] = number(coder, chances, slot, steps[k] - predicted, True)
            steps[k] = predicted + off[k]
            beside[k, _LEFT], beside[k, _UP], beside[k, _CORNER] = left, up, beyond
            beside[k, _RIGHT] = beside[k, _DOWN] = -1
            for one, way in ((left, _RIGHT), (up, _DOWN)):
                if one >= 0:
                    known = beside[one, way]
                    if known < 0 or abs(steps[k] - steps[one]) < abs(steps[known] - steps[one]):
                        beside[one, way] = k


@kernel(error_model="numpy", nogil=True)
def _tell_slopes(coder: Coder, chances: NDArray[np.int32], hows: NDArray[np.int32], samples: Samples) -> None:
    steps, slopes, beside = samples.steps, samples.slopes, samples.beside
    how = np.zeros((len(steps), 2), np.int8)
    for k in range(len(steps)):
        left, up = beside[k, _LEFT], beside[k, _UP]
        for axis in range(2):
            before, after = beside[k, _LEFT + axis], beside[k, _RIGHT + axis]
            low = steps[k] - steps[before] if before >= 0 else 0
            high = steps[after] - steps[k] if after >= 0 else 0
            slope, told = slopes[k, axis], _CODED
            most = max(_COARSE, abs(slope) // _SHARE)
            if abs(low - slope) <= most and abs(low - slope) <= 2 * abs(high - slope):
                told = _LOW
            elif abs(high - slope) <= most:
                told = _HIGH
            there = (before >= 0) + 2 * (after >= 0)
            bent = min(_size(abs(slopes[before, axis] - low)), 7) // 2 if before >= 0 else 3
            known = 4 * (how[left, axis] if left >= 0 else 3) + (how[up, axis] if up >= 0 else 3)
            change = min(_size(abs(high - low)), 7)
            slot = 2 * (bent + 4 * (known + 16 * (there + 4 * (change + 8 * axis))))
            if bit(coder, hows, slot, told == _CODED):
                told = _CODED
            else:
                told = _HIGH if bit(coder, hows, slot + 1, told == _HIGH) else _LOW
            how[k, axis] = told
            if told != _CODED:
                slopes[k, axis] = high if told == _HIGH else low
                continue
            guess = (low + high) // 2
            if left >= 0 and up >= 0:
                guess = (slopes[left, axis] + slopes[up, axis]) // 2
            elif left >= 0 or up >= 0:
                guess = slopes[max(left, up), axis]
            expected = _code(guess)
            slot = WIDTH * (there + 4 * (axis + 2 * min(_size(abs(expected)) // 2, 3)))
            code = expected + number(coder, chances, slot, _code(slope) - expected, True)
            slopes[k, axis] = _slope(min(max(code, -_LARGEST_CODE), _LARGEST_CODE))


@kernel(error_model="numpy", nogil=True)
def _tell_reaches(
    coder: Coder,
    whole: NDArray[np.int32],
    full: NDArray[np.int32],
    others: NDArray[np.int32],
    samples: Samples,
) -> None:
    """Whether all four are ``HALF``, then whether each of them is; and else its four bits, the highest first."""
    reaches, beside = samples.reaches, samples.beside
    for k in range(len(reaches)):
        gaps = _gap(samples, k, 0), _gap(samples, k, 1), _gap(samples, k, 2), _gap(samples, k, 3)
        slot = gaps[0] + gaps[1] + 8 * (gaps[2] + gaps[3])
        is_whole = min(reaches[k, 0], reaches[k, 1], reaches[k, 2], reaches[k, 3]) == HALF
        if bit(coder, whole, slot, is_whole):
            for side in range(4):
                reaches[k, side] = HALF
            continue
        for side in range(4):
            along = beside[k, _UP] if side < 2 else beside[k, _LEFT]  # the border goes on there
            near = reaches[along, side] if along >= 0 else -1
            kind = 0 if near < 0 else 1 if near == HALF else 2
            slot = gaps[side] + 4 * (kind + 3 * (side // 2 + 2 * (side > 0)))
            if bit(coder, full, slot, reaches[k, side] == HALF):
                reaches[k, side] = HALF
                continue
            slot = 16 * ((1 + near // 4 if kind == 2 else 0) + 5 * (side // 2))
            found = 1
            for n in range(4):
                found = 2 * found + bit(coder, others, slot + found, (reaches[k, side] >> (3 - n)) & 1)
            reaches[k, side] = min(found - 16, HALF)


@kernel(error_model="numpy", nogil=True)
def _tell_colors(coder: Coder, chances: NDArray[np.int32], latest: NDArray[np.int32], samples: Samples) -> None:
    """``latest`` (objects, 3) is what objects looked like last.

    What is even is kept exactly, so that it has one colour: what an edge beside it is off by would tint all of it.
    """
    places, colors, beside = samples.places, samples.colors, samples.beside
    off, held = np.zeros(len(places), np.int32), np.zeros(len(places), np.int32)
    for k in range(len(places)):
        place, left, up, beyond = places[k], beside[k, _LEFT], beside[k, _UP], beside[k, _CORNER]
        spread, kind, step, hold, most = 0, 0, _TINT, 0, 0
        if left >= 0 and up >= 0:
            spread, kind, hold = off[left] + off[up], 2, max(held[left], held[up])
        elif left >= 0 or up >= 0:
            spread, kind, hold = 2 * off[max(left, up)], 1, held[max(left, up)]
        if kind > 0 and hold == 0:
            step = 1
        half, even, tint = step // 2, 5 * 3 * _SIZES * WIDTH * (step == 1), 0
        for n in range(3):
            channel = (1, 0, 2)[n]
            guess = latest[place, channel]
            if kind == 2:
                low = min(colors[left, channel], colors[up, channel])
                high = max(colors[left, channel], colors[up, channel])
                guess = (low + high) // 2
                if beyond >= 0:
                    guess = min(max(low + high - colors[beyond, channel], low), high)
            elif kind == 1:
                guess = colors[max(left, up), channel]
            guess = min(max(guess + tint, 0), 255)
            slot = even + WIDTH * (_size(spread) + _SIZES * (kind + 3 * (0 if n == 0 else n + 2 * (tint != 0))))
            away = colors[k, channel] - guess
            away = (away + half) // step if away >= 0 else -((half - away) // step)
            away = number(coder, chances, slot, away, True)
            if n == 0:
                tint = step * away
            most = max(most, abs(away))
            off[k] += (abs(away) * step + _OFF) // _TINT
            colors[k, channel] = latest[place, channel] = min(max(guess + step * away, 0), 255)
        held[k] = _HELD if most > _OFF * (step == 1) else max(hold - 1, 0)


@kernel(error_model="numpy", nogil=True, inline="always")
def _size(value: int) -> int:
    """0 to 9: in which class of sizes a number from 0 on is."""
    size, limit = 0, 1
    while value >= limit and size < _SIZES - 1:
        size, limit = size + 1, limit + (1 if size < 2 else limit)
    return size


@kernel(error_model="numpy", nogil=True)
def _gap(samples: Samples, k: int, side: int) -> int:
    """0 to 3: how well a neighbour goes on where sample ``k`` ends, from well to there is none; left, right, up, down."""
    steps, slopes = samples.steps, samples.slopes
    axis, way = side // 2, 2 * (side % 2) - 1
    n = samples.beside[k, (_LEFT if way < 0 else _RIGHT) + axis]
    if n < 0:
        return 3
    gap = abs(2 * (steps[n] - steps[k]) - way * (slopes[n, axis] + slopes[k, axis]))
    slanted = abs(slopes[n, axis]) + abs(slopes[k, axis])
    return 0 if 2 * gap <= slanted + 16 else 1 if gap <= slanted + 32 else 2


@kernel(error_model="numpy", nogil=True)
def _code(slope: int) -> int:
    """The code of a slope, below its size where that is large."""
    size, doublings = (abs(slope) + _COARSE // 2) // _COARSE, 0
    while size >= _EXACT:
        size, doublings = (size + 1) // 2, doublings + 1
    code = size + _HALF * doublings
    return code if slope >= 0 else -code


@kernel(error_model="numpy", nogil=True)
def _slope(code: int) -> int:
    """The slope of a code."""
    doublings = max(abs(code) // _HALF - 1, 0)
    size = (abs(code) - _HALF * doublings) * _COARSE << doublings
    return size if code > 0 else -size


@kernel(error_model="numpy", nogil=True)
def _of_rank(starts: NDArray[np.int32], pixel: int, rank: int) -> int:
    """The sample of a ``rank`` in a pixel, or its last; -1 where there is none, or no such pixel."""
    if pixel < 0 or starts[pixel] == starts[pixel + 1]:
        return -1
    return int(min(starts[pixel] + rank, starts[pixel + 1] - 1))


@kernel(error_model="numpy", nogil=True)
def _like(starts: NDArray[np.int32], pixel: int, guess: int, place: int, places: NDArray[np.int32]) -> int:
    """The ``guess``, a sample in a pixel or -1, where that is of the object at ``place``, or else the first that is, or -1."""
    if guess < 0 or places[guess] == place:
        return guess
    for n in range(starts[pixel], starts[pixel + 1]):
        if places[n] == place:
            return n
    return -1
