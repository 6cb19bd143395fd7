"""Looks: what a change changes, and what is refused."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mmi.foundation.errors import ParameterError
from viewer.window.look import MODES, SHOWS, Look


def test_a_change_leaves_the_rest():
    look = Look().changed({"mode": "side", "left": "visible"}).changed({"swipe": 0.25})
    assert (look.mode, look.left, look.right, look.swipe) == ("side", "visible", "multi-mesh", 0.25)


def test_plain_data_says_all():
    look = Look(mode="blink", layer=3, budget_ms=None)
    assert Look().changed(look.plain()) == look


@given(
    mode=st.sampled_from(MODES),
    show=st.sampled_from(SHOWS),
    swipe=st.floats(0.0, 1.0),
    layer=st.none() | st.integers(0, 1000),
    budget_ms=st.none() | st.floats(0.0, 1000.0),
    quality=st.none() | st.integers(30, 95),
)
def test_what_has_a_meaning_is_taken(mode, show, swipe, layer, budget_ms, quality):
    some = {"mode": mode, "show": show, "swipe": swipe, "layer": layer, "budget_ms": budget_ms, "quality": quality}
    assert {name: getattr(Look().changed(some), name) for name in some} == some


@pytest.mark.parametrize(
    ("some", "named"),
    [
        ({"mode": "upside down"}, "mode"),
        ({"mode": ["one"]}, "mode"),
        ({"show": None}, "show"),
        ({"left": ""}, "left"),
        ({"right": 3}, "right"),
        ({"left": "x" * 201}, "left"),
        ({"swipe": 1.5}, "swipe"),
        ({"swipe": -0.5}, "swipe"),
        ({"swipe": math.nan}, "swipe"),
        ({"swipe": None}, "swipe"),
        ({"swipe": True}, "swipe"),
        ({"layer": -1}, "layer"),
        ({"layer": 1.0}, "layer"),
        ({"layer": True}, "layer"),
        ({"freeze": 1}, "freeze"),
        ({"fly": "yes"}, "fly"),
        ({"budget_ms": -1.0}, "budget_ms"),
        ({"budget_ms": math.inf}, "budget_ms"),
        ({"threshold_px": 1e9}, "threshold_px"),
        ({"quality": 96}, "quality"),
        ({"colour": "red"}, "fields"),
    ],
)
def test_what_has_no_meaning_is_refused(some, named):
    with pytest.raises(ParameterError, match=named):
        Look().changed(some)
