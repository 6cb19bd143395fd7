"""Poses that interpolation gives back are left out, and no more than those."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from moving import movers_of

from mmi.movers.thinning import thinned


def test_even_motion_keeps_its_ends():
    rows = [(0.1 * i, 0.3 * i, -0.2 * i, 0.0, 2.0 * i) for i in range(41)]
    assert thinned(movers_of([rows]), metres=0.001).times.tolist() == [0.0, 4.0]


def test_a_full_turn_is_not_lost():
    rows = [(0.1 * i, 0.0, 0.0, 0.0, 9.0 * i) for i in range(41)]  # degrees: 360 in all
    found = thinned(movers_of([rows]), metres=0.001)
    assert 4 < len(found.times) < 12
    for time, *_, heading in rows:
        turned = np.degrees(np.arctan2(found.poses(time)[0, 1, 0], found.poses(time)[0, 0, 0]))
        assert abs((turned - heading + 180.0) % 360.0 - 180.0) < 1e-6


step = st.floats(-1.0, 1.0)


@settings(max_examples=40)
@given(
    st.lists(st.lists(st.tuples(step, step, step, step), min_size=1, max_size=25), max_size=3), st.floats(0.001, 2.0)
)
def test_no_point_is_further_off_than_said(steps, metres):
    """Every corner of every shape, at every time that was recorded."""
    tracks = []
    for one in steps:
        rows = np.cumsum(np.array(one), axis=0)
        tracks.append(
            [(0.1 * i, x, y, z, 40.0 * turn, 10.0 * turn, 5.0 * x) for i, (x, y, z, turn) in enumerate(rows.tolist())]
        )
    before = movers_of(tracks)
    after = thinned(before, metres=metres)
    assert after.ids == before.ids
    for moment in 0.1 * np.arange(25):
        off = before.corners(before.poses(moment)) - after.corners(after.poses(moment))
        assert np.linalg.norm(off, axis=-1).max(initial=0.0) <= metres + 1e-9
