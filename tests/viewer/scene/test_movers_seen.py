"""Movers that show are never left out, and those far outside of a view are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from moving import movers_of

from mmi.foundation.camera import Camera, view_towards
from viewer.scene.movers_seen import movers_in

CAMERA = Camera(320, 200, 1.0)


def looking(eye=(0.0, 0.0, 1.7), azimuth=0.0, pitch=0.0):
    return view_towards(np.array(eye), azimuth, pitch, focal=CAMERA.focal, window=CAMERA.window)


@settings(max_examples=60)
@given(
    st.lists(st.tuples(*[st.floats(-60.0, 60.0)] * 3, st.floats(-180.0, 180.0)), max_size=6),
    st.floats(-3.0, 3.0),
    st.floats(-1.2, 1.2),
)
def test_whatever_has_a_point_in_the_picture_is_kept(places, azimuth, pitch):
    movers = movers_of([[(0.0, *place)] for place in places])
    view = looking(azimuth=azimuth, pitch=pitch)
    seen = movers_in(view, movers, 0.0)
    steps = np.linspace(0.0, 1.0, 9)
    share = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    for i, pose in enumerate(movers.poses(0.0)):
        own = movers.boxes[i, 0] + share * (movers.boxes[i, 1] - movers.boxes[i, 0])
        u, v, depth = view.project(own @ pose[:3, :3].T + pose[:3, 3]).T
        left, top, width, height = view.window
        inside = (depth > 0) & (u >= left) & (u <= left + width) & (v >= top) & (v <= top + height)
        assert not inside.any() or i in seen.which
    assert (np.diff(seen.distances) >= 0.0).all()


def test_those_behind_and_aside_are_left_out_and_the_nearest_come_first():
    places = [(50, 0, 0), (-20, 0, 0), (20, 0, 0), (0, 40, 0), (30, -60, 0)]
    seen = movers_in(looking(), movers_of([[(0.0, *place, 0.0)] for place in places]), 0.0)
    assert seen.which.tolist() == [2, 0]
    assert seen.distances == pytest.approx([np.hypot(18.0, 0.2), np.hypot(48.0, 0.2)])
    assert seen.poses[:, 0, 3].tolist() == [20.0, 50.0]
    assert seen.corners.shape == (2, 8, 3)


def test_those_that_are_away_are_left_out():
    movers = movers_of([[(0.0, 20, 0, 0, 0), (1.0, 20, 0, 0, 0)]] * 2, stays=[False, True])
    assert movers_in(looking(), movers, 0.5).which.tolist() == [0, 1]
    assert movers_in(looking(), movers, 1.5).which.tolist() == [1]
