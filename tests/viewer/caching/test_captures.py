"""As what boxes are captured: whole, towards their middles, with texels finer than pixels, and within the size that is said."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmi.foundation.camera import Camera, View
from viewer.caching.captures import captures_of, least_distances, sharpness_of

CAMERA = Camera(640, 480, math.radians(60.0))
SHARPNESS = sharpness_of(View(np.eye(4), CAMERA.focal, CAMERA.window))
LENGTH = st.floats(0.0, 300.0)


@st.composite
def boxes_and_eyes(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    low = rng.uniform(-200.0, 200.0, (20, 3))
    boxes = np.stack([low, low + rng.uniform(0.0, 1.0, (20, 3)) ** 3 * draw(LENGTH)], axis=1)
    return boxes, rng.uniform(-400.0, 400.0, 3), rng


def test_texels_are_as_fine_as_the_pixels_at_the_border():
    assert pytest.approx(CAMERA.border_pixel[0]) == SHARPNESS.pixel
    assert SHARPNESS.texel_focal > CAMERA.focal / math.cos(0.5 * CAMERA.fov) ** 2
    assert SHARPNESS.finer > 1.0


@pytest.mark.parametrize("size", [(640, 480), (480, 640), (60, 480), (480, 60)])
def test_pixels_in_the_middle_of_every_border_are_no_smaller(size):
    """By how far apart in angle the directions of neighbouring pixels are, on displays that are high as well."""
    camera = Camera(*size, math.radians(60.0))
    view = View(np.eye(4), camera.focal, camera.window)
    left, top, width, height = view.window
    steps = []
    for at, step in (
        ((left, 0), (1, 0)),
        ((left + width, 0), (-1, 0)),
        ((0, top), (0, 1)),
        ((0, top + height), (0, -1)),
    ):
        ends = np.array([(*at, view.focal), (at[0] + step[0], at[1] + step[1], view.focal)])
        steps.append(math.atan2(np.linalg.norm(np.cross(*ends)), np.dot(*ends)))
    assert sharpness_of(view).pixel <= min(steps) <= 1.1 * sharpness_of(view).pixel


@settings(max_examples=60, deadline=None)
@given(boxes_and_eyes())
def test_all_of_a_box_and_two_pixels_more_is_in_its_picture(case):
    boxes, eye, rng = case
    found = captures_of(eye, boxes, SHARPNESS)
    for i in np.flatnonzero(found.possible):
        view = View(found.eye_from_world[i], SHARPNESS.texel_focal, tuple(found.windows[i].tolist()))
        np.testing.assert_allclose(view.eye, eye, atol=1e-9)
        turned = view.eye_from_world[:3, :3]
        np.testing.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(turned) > 0.0
        middle = view.project(boxes[i].mean(axis=0))
        assert np.abs(middle[:2]).max() < 1e-3  # towards the middle
        points = boxes[i, 0] + rng.uniform(0.0, 1.0, (200, 3)) * (boxes[i, 1] - boxes[i, 0])
        aside = rng.normal(size=(200, 3))
        away = np.linalg.norm(points - eye, axis=1)[:, None]
        points += aside / np.linalg.norm(aside, axis=1)[:, None] * 2.0 * SHARPNESS.pixel * away
        u, v, depth = view.project(points).T
        left, top, width, height = view.window
        assert (depth > 0.0).all()
        assert (u >= left).all() and (u <= left + width).all() and (v >= top).all() and (v <= top + height).all()
        assert 0.0 < found.depths[i] <= depth.max() + 1e-6


@settings(max_examples=60, deadline=None)
@given(boxes_and_eyes(), st.sampled_from([64, 128, 256]))
def test_from_the_least_distance_on_pictures_have_room(case, largest):
    boxes, _, rng = case
    least = least_distances(boxes, largest, SHARPNESS)
    aside = rng.normal(size=3)
    aside /= np.linalg.norm(aside)
    for i, box in enumerate(boxes):
        if np.ptp(box, axis=0).max() < 1e-6:
            continue
        eye = box.mean(axis=0) + aside * least[i] * rng.uniform(1.0, 3.0)
        found = captures_of(eye, box[None], SHARPNESS)
        assert found.possible[0]
        assert found.windows[0, 2:].max() <= largest


def test_a_box_around_the_viewer_has_no_picture():
    found = captures_of(np.zeros(3), np.array([[[-1.0] * 3, [1.0] * 3], [[5.0] * 3, [6.0] * 3]]), SHARPNESS)
    assert found.possible.tolist() == [False, True]


@pytest.mark.parametrize("away", [50.0, -50.0])
def test_boxes_right_above_and_below_have_pictures(away):
    found = captures_of(np.zeros(3), np.array([[[-1.0, -1.0, away - 1.0], [1.0, 1.0, away + 1.0]]]), SHARPNESS)
    assert found.possible[0]
    turned = found.eye_from_world[0, :3, :3]
    np.testing.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-12)
