import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mmi.foundation.errors import ParameterError
from viewer.casting.frame import CastTally, record_errors, worst_first
from viewer.casting.rules import CastRules


@settings(deadline=None)
@given(hnp.arrays(np.float32, st.integers(0, 60), elements=st.sampled_from([0.5, 1.0, 2.0, 7.0, np.inf])), st.data())
def test_the_worst_go_first_and_of_equal_ones_every_nth(errors, data):
    count = data.draw(st.integers(0, 70))
    chosen = worst_first(errors, count)
    assert len(chosen) == min(count, len(errors))
    assert (np.diff(chosen) > 0).all()
    left = np.delete(errors, chosen)
    if len(chosen) and len(left):
        assert errors[chosen].min() >= left.max()
        equal = np.flatnonzero(errors == errors[chosen].min())
        taken = np.flatnonzero(np.isin(equal, chosen))
        gaps = np.diff(np.concatenate([taken, [taken[0] + len(equal)]]))
        assert gaps.max() <= -(-len(equal) // len(taken)), "they are spread evenly"


@settings(deadline=None)
@given(st.floats(0.0, 99.0), st.floats(-3.2, 3.2), st.floats(100.0, 1e5))
def test_no_far_point_is_off_by_more_than_its_record_says(moved, turn, away):
    """Whatever is a near field away from here, seen from where it was cast."""
    rules = CastRules(near_field=100.0, reuse="hits")
    focal = 443.0
    error = float(record_errors(np.array([moved], dtype=np.float32), rules, focal=focal, limit_px=5.0)[0])
    point = np.array([away, 0.0])
    cast_from = moved * np.array([math.cos(turn), math.sin(turn)])
    there = point - cast_from
    off = abs(math.atan2(there[1], there[0]))
    assert focal * math.tan(min(off, 1.5)) <= error * (1.0 + 1e-5) + 1e-3


def test_records_that_are_far_off_or_unknown_must_not_be_shown():
    away = np.array([np.inf, 0.0, 9.0, 11.0, 30.0, 250.0], dtype=np.float32)
    errors = record_errors(away, CastRules(), focal=443.0, limit_px=5.0)
    assert errors[1] == 0.0
    assert 5.0 < errors[2] < 45.0
    assert np.isinf(errors[[0, 3, 4, 5]]).all()
    errors = record_errors(away, CastRules(), focal=443.0, limit_px=300.0)
    assert np.isfinite(errors[1:5]).all(), "a limit that allows more is kept to"
    own = record_errors(away, CastRules(reuse="hits"), focal=443.0, limit_px=5.0)
    assert np.isinf(own[0])
    assert np.isfinite(own[1:]).all(), "own errors count, and misses have the bound"


def test_tallies_add_up():
    one = CastTally(1, 10, 20, 30, 4, 5, 6, 7, 2.5)
    other = CastTally(2, 1, 2, 3, 4, 5, 6, 7, 1.5)
    assert one.plus(other) == CastTally(3, 11, 22, 33, 8, 10, 12, 14, 2.5)
    assert one.rays == 9


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"near_field": 0.0}, "near_field"),
        ({"near_field": math.nan}, "near_field"),
        ({"limit_px": -1.0}, "limit_px"),
        ({"rays": -1}, "rays"),
        ({"reuse": "always"}, "reuse"),
        ({"caster": "gpu"}, "caster"),
        ({"workers": 0}, "workers"),
    ],
)
def test_rules_without_a_meaning_are_refused(values, named):
    with pytest.raises(ParameterError, match=rf"^{named}: .* expected, found"):
        CastRules(**values)
