import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mmi.foundation.camera import Camera, View, level_view, level_views_around, view_towards
from mmi.foundation.errors import ParameterError

finite = st.floats(-500.0, 500.0)


def test_focal_length_of_the_papers_display():
    camera = Camera(512, 512, math.radians(60.0))
    assert camera.focal == pytest.approx(256.0 * math.sqrt(3.0))
    assert camera.angle_from_pixels(256.0) == pytest.approx(math.radians(30.0))


@given(st.floats(0.01, 400.0))
def test_pixels_and_angles_are_inverse(pixels):
    camera = Camera(640, 480, 1.0)
    assert camera.pixels_from_angle(camera.angle_from_pixels(pixels)) == pytest.approx(pixels)


@pytest.mark.parametrize(("width", "height", "fov"), [(0, 1, 1.0), (1, -1, 1.0), (1, 1, 0.0), (1, 1, math.pi)])
def test_a_display_without_meaning_is_refused(width, height, fov):
    with pytest.raises(ParameterError):
        Camera(width, height, fov)


@given(
    st.tuples(finite, finite, finite),
    st.floats(-7.0, 7.0),
    st.floats(-900, 900),
    st.floats(-900, 900),
    st.floats(1, 999),
)
def test_project_after_unproject_is_the_identity(eye, azimuth, u, v, depth):
    view = level_view(np.array(eye), azimuth, focal=400.0, window=(0, 0, 4, 4))
    point = view.unproject(np.array(u), np.array(v), np.array(depth))
    np.testing.assert_allclose(view.project(point), [u, v, depth], atol=1e-6)


def test_east_of_a_northward_view_is_right_and_up_is_up():
    view = level_view(np.array([0.0, 0.0, 2.0]), math.pi / 2, focal=100.0, window=(0, 0, 1, 1))
    np.testing.assert_allclose(view.project(np.array([5.0, 50.0, 7.0])), [10.0, -10.0, 50.0], atol=1e-9)
    np.testing.assert_allclose(view.eye, [0.0, 0.0, 2.0])


def test_pixel_centres_of_a_window():
    u, v = View(np.eye(4), 10.0, (-2, 3, 3, 2)).pixel_centres()
    assert u.tolist() == [-1.5, -0.5, 0.5]
    assert v.tolist() == [3.5, 4.5]


@pytest.mark.parametrize(("azimuth", "pitch"), [(0.0, 0.0), (0.7, 0.4), (-2.0, -1.0), (3.0, 1.4)])
def test_a_view_up_or_down_has_its_direction_in_the_middle_and_no_roll(azimuth, pitch):
    eye = np.array([3.0, -4.0, 1.7])
    view = view_towards(eye, azimuth, pitch, focal=100.0, window=(-10, -10, 20, 20))
    ahead = np.array([math.cos(azimuth) * math.cos(pitch), math.sin(azimuth) * math.cos(pitch), math.sin(pitch)])
    np.testing.assert_allclose(view.project(eye + 7.0 * ahead), [0.0, 0.0, 7.0], atol=1e-9)
    np.testing.assert_allclose(view.eye, eye, atol=1e-12)
    np.testing.assert_allclose(view.eye_from_world[:3, :3] @ view.eye_from_world[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(view.eye_from_world[:3, :3]) == pytest.approx(1.0)
    above = view.project(eye + 7.0 * ahead + [0.0, 0.0, 0.1])
    assert above[0] == pytest.approx(0.0, abs=1e-9)
    assert above[1] < 0.0


def test_a_pitch_of_a_right_angle_has_no_azimuth():
    with pytest.raises(ParameterError, match="pitch"):
        view_towards(np.zeros(3), 0.0, math.pi / 2, focal=1.0, window=(0, 0, 1, 1))


def test_a_display_is_a_window_around_the_principal_point():
    assert Camera(640, 400, 1.0).window == (-320, -200, 640, 400)
    assert Camera(5, 3, 1.0).window == (-2, -1, 5, 3)


@pytest.mark.parametrize("size", [(0, 5), (5, -1), (10**400, 5), (5, (1 << 20) + 1)])
def test_a_display_of_no_pixels_or_too_many_is_refused(size):
    with pytest.raises(ParameterError, match=r"^a display "):
        Camera(*size, 1.0)


@pytest.mark.parametrize("count", [1, 3, 6, 7])
def test_views_all_around_are_the_first_one_turned(count):
    eye = np.array([3.0, -2.0, 1.7])
    views = level_views_around(eye, count, focal=100.0, window=(-5, -6, 10, 12))
    assert len(views) == count
    for i, view in enumerate(views):
        azimuth = 2.0 * math.pi * i / count
        ahead = eye + 7.0 * np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
        np.testing.assert_allclose(view.project(ahead), [0.0, 0.0, 7.0], atol=1e-9)
        np.testing.assert_allclose(view.eye, eye, atol=1e-12)
        assert (view.focal, view.window) == (100.0, (-5, -6, 10, 12))
