"""Panels of a window, and regions that are thick enough to be shown."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from viewer.window.composing import panels, thick
from viewer.window.look import MODES, Look


@given(st.sampled_from(MODES), st.floats(0.0, 1.0), st.integers(64, 400), st.booleans())
def test_panels_fill_the_window(mode, swipe, width, blinked):
    found = panels(Look(mode=mode, swipe=swipe), (width, 64), blinked=blinked)
    if mode == "difference":
        assert [(one.first, one.end) for one in found] == [(0, width)] * 2
        return
    assert found[0].first == 0
    assert found[-1].end == width
    assert all(a.end == b.first for a, b in itertools.pairwise(found))
    assert all(one.first < one.end for one in found)


def test_who_is_where():
    def named(**some):
        blinked = some.pop("blinked", False)
        return [(one.technique, one.first, one.end) for one in panels(Look(**some), (100, 64), blinked=blinked)]

    assert named(mode="one") == [("multi-mesh", 0, 100)]
    assert named(mode="side") == [("full", 0, 50), ("multi-mesh", 50, 100)]
    assert named(mode="swipe", swipe=0.3) == [("full", 0, 30), ("multi-mesh", 30, 100)]
    assert named(mode="swipe", swipe=0.0) == [("multi-mesh", 0, 100)]
    assert named(mode="swipe", swipe=1.0) == [("full", 0, 100)]
    assert named(mode="swipe", right="full") == [("full", 0, 100)]
    assert named(mode="blink") == [("multi-mesh", 0, 100)]
    assert named(mode="blink", blinked=True) == [("full", 0, 100)]


@pytest.mark.parametrize("side", [1, 2, 3, 4, 7])
def test_squares_of_a_side_stay_and_thinner_ones_vanish(side):
    wrong = np.zeros((40, 60), dtype=bool)
    wrong[5 : 5 + side, 10 : 10 + side] = True
    assert np.array_equal(thick(wrong, side), wrong)
    assert not thick(wrong, side + 1).any()


def test_a_line_is_thin_however_long_it_is():
    wrong = np.zeros((40, 60), dtype=bool)
    wrong[:, 30:32] = True
    wrong[10:16, 20:26] = True
    kept = thick(wrong, 5.0)
    assert kept[12, 22]
    assert not kept[30, 30]
    assert not (kept & ~wrong).any()


@given(st.integers(0, 2**20), st.floats(0.0, 6.0))
def test_nothing_is_wrong_that_was_not(seed, pixels):
    wrong = np.random.default_rng(seed).random((12, 14)) < 0.7
    kept = thick(wrong, pixels)
    assert not (kept & ~wrong).any()
