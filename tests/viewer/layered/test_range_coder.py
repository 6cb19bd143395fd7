"""Arithmetic coding: numbers come back, bytes are those that a plain decoder reads, and as many as numbers are worth."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmi.foundation.kernels import kernel
from viewer.layered.range_coder import WIDTH, chances_for, ended, number, reading, writing

NUMBERS = st.lists(
    st.tuples(st.integers(0, 2), st.one_of(st.integers(-3, 3), st.integers(1 - 2**25, 2**25 - 1))), max_size=200
)


@kernel(nogil=True)
def _told(coder, chances, kinds, values, signed):
    for k in range(len(values)):
        values[k] = number(coder, chances, WIDTH * kinds[k], values[k], signed)


def written(kinds, values, *, signed=True):
    coder = writing(16 * len(values) + 64)
    _told(coder, chances_for(3 * WIDTH), np.array(kinds, np.int64), np.array(values, np.int64), signed)
    return coder.data[: ended(coder)].tobytes()


def read(data, kinds, *, signed=True):
    coder, values = reading(data), np.zeros(len(kinds), np.int64)
    _told(coder, chances_for(3 * WIDTH), np.array(kinds, np.int64), values, signed)
    return values.tolist(), ended(coder)


class Plain:
    """The same with Python's numbers, written down for reading alone: chances are shares of 65536."""

    def __init__(self, data):
        self.data, self.low, self.high, self.at = data + bytes(8), 0, 2**32 - 1, 0
        self.chances = {}

    def bit(self, slot):
        chance, times = self.chances.get(slot, (32768, 0))
        middle = self.low + (self.high - self.low) * chance // 65536
        found = int.from_bytes(self.data[self.at : self.at + 4], "big") <= middle
        self.low, self.high = (self.low, middle) if found else (middle + 1, self.high)
        while self.low >> 24 == self.high >> 24:
            self.low, self.high = self.low % 2**24 * 256, self.high % 2**24 * 256 + 255
            self.at += 1
        if slot is not None:
            part = 2 ** next(n for n, most in enumerate((2, 5, 10, 20, 31, 32), 1) if times < most)
            chance += (65535 - chance) // part if found else -(chance // part)
            self.chances[slot] = chance, min(times + 1, 31)
        return int(found)

    def number(self, kind):
        if not self.bit((kind, "any")):
            return 0
        sign, deep = (-1 if self.bit((kind, "below")) else 1), 0
        while deep < 24 and self.bit((kind, "deep", deep)):
            deep += 1
        found = 1
        for n in range(deep):
            slot = (kind, "first", deep) if n == 0 else (kind, "second", deep, found) if n == 1 else None
            found = 2 * found + self.bit(slot)
        return sign * found


@settings(max_examples=150, deadline=None)
@given(NUMBERS)
def test_numbers_come_back_and_a_plain_decoder_reads_them(told):
    kinds, values = [one[0] for one in told], [one[1] for one in told]
    data = written(kinds, values)
    assert read(data, kinds) == (values, len(data))
    plain = Plain(data)
    assert [plain.number(kind) for kind in kinds] == values


def test_from_zero_on_signs_are_not_told():
    values = np.random.default_rng(0).integers(0, 9, 4000).tolist()
    data = written([0] * 4000, values, signed=False)
    assert read(data, [0] * 4000, signed=False)[0] == values
    assert len(data) <= len(written([0] * 4000, values))


@pytest.mark.parametrize("spread", [0.3, 3.0, 40.0])
def test_bytes_are_near_to_what_numbers_are_worth(spread):
    values = np.round(np.random.default_rng(1).laplace(0.0, spread, 30_000)).astype(np.int64)
    shares = np.unique(values, return_counts=True)[1] / len(values)
    worth = -sum(share * math.log2(share) for share in shares) / 8.0
    assert len(written([1] * len(values), values)) < 1.06 * worth * len(values) + 100


def test_what_is_certain_takes_a_bit_in_hundreds():
    assert len(written([0] * 100_000, [0] * 100_000)) < 40


@given(st.binary(max_size=60))
def test_any_bytes_are_numbers(data):
    values, _ = read(data, [0, 1, 2] * 50)
    assert all(abs(value) < 2**25 for value in values)
