"""Whole numbers as bytes, each at about the bits that it is worth: binary arithmetic coding with chances that adapt.

A number is told by yes or no, each of which has a *slot* with the chance of a yes, as it was so far. Who codes numbers of
several kinds gives each kind slots of its own, ``WIDTH`` of them. The same functions tell numbers and are told them, so that
both always agree on what comes next. Arithmetic is in whole numbers, the same anywhere.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.kernels import kernel

__all__ = ["WIDTH", "Coder", "bit", "chances_for", "ended", "number", "reading", "writing"]

WIDTH = 112
"""Slots of a kind of numbers."""
_DEEPEST = 25
"""Numbers are below 2 to the power of this."""
_FIRST, _SECOND = 2 + _DEEPEST, 2 + 2 * _DEEPEST
"""Slots of a number's two highest bits after the first, by how many it has."""
_CERTAIN = 1 << 16
_SHIFTS = (1, 1, 2, 2, 2, *5 * (3,), *10 * (4,), *11 * (5,), 6)
"""A chance moves by a share of 2 to the power of minus this of what it was off by, by how often it has moved."""
_LOW, _HIGH, _CODE, _AT, _WRITES = range(5)
_WHOLE = (1 << 32) - 1


class Coder(NamedTuple):
    """Bytes ``data`` that are written or read, and the ``state`` of that: between which bounds what comes next is, what that
    is where it is read, how many bytes are done, and whether they are written.
    """

    data: NDArray[np.uint8]
    state: NDArray[np.int64]


def writing(most: int) -> Coder:
    """What writes into at most so many bytes."""
    return Coder(np.empty(most, np.uint8), np.array([0, _WHOLE, 0, 0, 1], np.int64))


def reading(data: bytes) -> Coder:
    """What reads bytes; after the last come zeros."""
    code = int.from_bytes(data[:4].ljust(4, b"\0"), "big")
    return Coder(np.array(np.frombuffer(data, np.uint8)), np.array([0, _WHOLE, code, 4, 0], np.int64))


def ended(coder: Coder) -> int:
    """How many bytes there are in all; what writes is finished with."""
    if coder.state[_WRITES]:
        at = int(coder.state[_AT])
        coder.data[at : at + 4] = np.frombuffer(int(coder.state[_LOW]).to_bytes(4, "big"), np.uint8)
        return at + 4
    return int(coder.state[_AT])


def chances_for(slots: int) -> NDArray[np.int32]:
    """So many slots, in which yes and no are as likely."""
    return np.full(slots, _CERTAIN // 2 << 5, np.int32)


@kernel(error_model="numpy", nogil=True, inline="always")
def bit(coder: Coder, chances: NDArray[np.int32], slot: int, value: int) -> int:
    """A yes (1) or a no (0): ``value`` if it is written."""
    known = chances[slot]  # the chance, of _CERTAIN, and how often it has moved
    chance, times = known >> 5, known & 31
    found = _told(coder, chance, value)
    shift = _SHIFTS[times]
    chance += ((_CERTAIN - 1 - chance) >> shift) if found else -(chance >> shift)
    chances[slot] = chance << 5 | min(times + 1, 31)
    return found


@kernel(error_model="numpy", nogil=True)
def number(coder: Coder, chances: NDArray[np.int32], slot: int, value: int, signed: bool) -> int:
    """A number below 2 to the power of 25 in size, not below 0 unless ``signed``, whose kind's first slot is ``slot``."""
    if not bit(coder, chances, slot, int(value != 0)):
        return 0
    negative = bit(coder, chances, slot + 1, int(value < 0)) if signed else 0
    size, deep = abs(value), 0
    while deep < _DEEPEST - 1 and bit(coder, chances, slot + 2 + deep, int(size >> (deep + 1) != 0)):
        deep += 1
    found = 1
    for n in range(deep):
        one = (size >> (deep - 1 - n)) & 1
        if n == 0:
            one = bit(coder, chances, slot + _FIRST + deep, one)
        elif n == 1:
            one = bit(coder, chances, slot + _SECOND + 2 * deep + (found & 1), one)
        else:
            one = _told(coder, _CERTAIN // 2, one)
        found = 2 * found + one
    return -found if negative else found


@kernel(error_model="numpy", nogil=True, inline="always")
def _told(coder: Coder, chance: int, value: int) -> int:
    """A yes whose ``chance`` is so many of ``_CERTAIN``, or a no."""
    data, state = coder
    low, high = state[_LOW], state[_HIGH]
    middle = low + (((high - low) * chance) >> 16)
    if not state[_WRITES]:
        value = int(state[_CODE] <= middle)
    if value:
        high = middle
    else:
        low = middle + 1
    while (low ^ high) < 1 << 24:
        at = state[_AT]
        if state[_WRITES]:
            data[at] = high >> 24
        else:
            state[_CODE] = ((state[_CODE] << 8) & _WHOLE) | (data[at] if at < len(data) else 0)
        state[_AT] = at + 1
        low, high = (low << 8) & _WHOLE, ((high << 8) & _WHOLE) | 255
    state[_LOW], state[_HIGH] = low, high
    return value
