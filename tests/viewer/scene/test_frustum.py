import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmi.foundation.camera import level_view, view_towards
from viewer.scene.frustum import box_corners, boxes_within_view, spheres_within_view, window_corners, within_view

WINDOW = (-160, -120, 320, 240)
coordinate = st.floats(-60.0, 60.0)
point = st.tuples(coordinate, coordinate, coordinate).map(np.array)


@given(point, point, st.floats(-math.pi, math.pi), st.floats(-1.2, 1.2), st.tuples(*[st.floats(0.0, 1.0)] * 3))
def test_what_holds_a_point_in_view_is_within_it(low, size, azimuth, pitch, inside):
    """Brute force: a box is kept whenever some point of it projects into the window."""
    view = view_towards(np.array([1.0, -2.0, 1.7]), azimuth, pitch, focal=277.0, window=WINDOW)
    box = box_corners(low[None], (low + np.abs(size))[None])
    u, v, depth = view.project(low + np.abs(size) * np.array(inside))
    shows = depth > 0.0 and -160 <= u <= 160 and -120 <= v <= 120
    assert within_view(box, view)[0] or not shows


@given(st.lists(st.tuples(point, point), min_size=1, max_size=9), st.floats(-math.pi, math.pi), st.floats(-1.2, 1.2))
def test_boxes_are_within_a_view_where_their_corners_are(boxes, azimuth, pitch):
    view = view_towards(np.array([1.3, -2.1, 1.7]), azimuth, pitch, focal=277.0, window=WINDOW)
    found = np.array([[low, low + np.abs(size)] for low, size in boxes])
    hair = 1e-9 * np.array([[-1.0], [1.0]])  # a box may just touch a side: rounding decides
    smaller, larger = (within_view(box_corners(*np.moveaxis(found + by, 1, 0)), view) for by in (-hair, hair))
    shows = boxes_within_view(found, view)
    assert (shows >= smaller).all() and (shows <= larger).all()


def test_boxes_beside_behind_above_and_below_are_left_out():
    view = level_view(np.zeros(3), 0.0, focal=277.0, window=WINDOW)
    centres = np.array([[50, 0, 0], [20, 60, 0], [20, -60, 0], [-50, 0, 0], [20, 0, 60], [20, 0, -60]], dtype=float)
    assert within_view(box_corners(centres - 1.0, centres + 1.0), view).tolist() == [True] + 5 * [False]
    assert within_view(np.empty((0, 8, 3)), view).shape == (0,)


def test_a_box_around_the_viewer_is_within_every_view():
    for azimuth in np.linspace(-3.0, 3.0, 7):
        view = level_view(np.zeros(3), azimuth, focal=277.0, window=WINDOW)
        assert within_view(box_corners(np.full((1, 3), -1.0), np.ones((1, 3))), view).all()


def test_a_window_is_seen_from_where_it_was_captured_and_not_from_behind():
    captured = level_view(np.zeros(3), 0.0, focal=277.0, window=(40, -30, 60, 50))
    corners = window_corners(captured, 20.0, 50.0)
    projected = captured.project(corners)
    assert projected[:, 0].min() == pytest.approx(40.0)
    assert projected[:, 0].max() == pytest.approx(100.0)
    assert projected[:, 1].min() == pytest.approx(-30.0)
    assert projected[:, 1].max() == pytest.approx(20.0)
    assert sorted(projected[:, 2].tolist()) == pytest.approx([20.0] * 4 + [50.0] * 4)
    assert within_view(corners[None], captured).all()
    assert not within_view(corners[None], level_view(np.zeros(3), math.pi, focal=277.0, window=WINDOW)).any()


@settings(max_examples=100)
@given(
    st.tuples(*[st.floats(-30.0, 30.0)] * 3),
    st.floats(0.0, 8.0),
    st.tuples(*[st.floats(-1.0, 1.0)] * 3),
    st.floats(-3.0, 3.0),
    st.floats(-1.2, 1.2),
)
def test_a_sphere_of_which_a_point_shows_is_kept(centre, radius, aside, azimuth, pitch):
    view = view_towards(np.array([1.0, 2.0, 1.7]), azimuth, pitch, focal=300.0, window=(-160, -100, 320, 200))
    length = max(float(np.linalg.norm(aside)), 1e-9)
    point = np.array(centre) + radius * np.array(aside) / max(length, 1.0)
    u, v, depth = view.project(point)
    shows = depth > 0.0 and abs(u) <= 160.0 and abs(v) <= 100.0
    kept = spheres_within_view(np.array([centre]), np.array([radius]), view)[0]
    assert kept or not shows


def test_spheres_behind_and_aside_are_left_out():
    view = view_towards(np.zeros(3), 0.0, 0.0, focal=300.0, window=(-160, -100, 320, 200))
    centres = np.array([[20.0, 0, 0], [-20.0, 0, 0], [20.0, 15.0, 0], [20.0, 0, -9.0]])
    assert spheres_within_view(centres, np.full(4, 1.0), view).tolist() == [True, False, False, False]
    assert spheres_within_view(centres, np.full(4, 30.0), view).all()
