"""The papers' own formulas: that they are what is printed, and where what is safe is less."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from whole_boxes import angles, directions, on_quadrilaterals, points_of, random_boxes, turned_to

from mmi.foundation.camera import Camera
from mmi.validity.images import Flat, error_angle, safe_distance
from mmi.validity.papers import (
    common_error,
    corners,
    move_in_angle,
    moved_points,
    on_quadrilateral,
    predicted_frames,
    safety_zone,
    safety_zone_of_the_nearer,
    sideways_angle,
    turned_to_viewer,
)
from mmi.validity.texel_angles import fine_enough, finest_pixel, paper_pixel, texel_angle

SEEDS = st.integers(0, 2**32 - 1)
PAPER = Camera(512, 512, math.radians(60.0))


def test_a_pixel_at_the_border_is_three_quarters_of_the_middle_one():
    left = math.atan(256.0 / PAPER.focal) - math.atan(255.0 / PAPER.focal)
    assert finest_pixel(PAPER) == pytest.approx(0.75 / PAPER.focal)
    assert finest_pixel(PAPER) < left < 1.01 * finest_pixel(PAPER)
    assert finest_pixel(PAPER) < paper_pixel(PAPER) == math.radians(60.0) / 512 < 1.0 / PAPER.focal


def test_texels_are_fine_enough_from_where_they_are_below_a_pixel():
    size = 0.1
    far = size / finest_pixel(PAPER)
    assert texel_angle(size, far) == pytest.approx(finest_pixel(PAPER), rel=1e-5)
    np.testing.assert_array_equal(fine_enough(size, [0.99 * far, 1.01 * far], PAPER), [False, True])


@settings(max_examples=50, deadline=None, derandomize=True)
@given(SEEDS)
def test_angles_of_the_figures_are_those_of_vectors(seed):
    rng = np.random.default_rng(seed)
    near, image, far = np.sort(rng.uniform(5.0, 50.0, 3))
    aside, moved = rng.uniform(0.1, 5.0), rng.uniform(0.0, 4.0)
    on_axis = np.array([[[near, 0.0, 0.0], [far, 0.0, 0.0]]])
    found = angles(np.array([[0.0, moved, 0.0]]), on_axis[:, :1], on_axis[:, 1:])[0, 0]
    assert sideways_angle(near, far, moved) == pytest.approx(found, abs=1e-9)
    corner, drawn = np.array([[[near, aside, 0.0]]]), np.array([[[image, aside * image / near, 0.0]]])
    found = angles(np.array([[moved, 0.0, 0.0]]), corner, drawn)[0, 0]
    assert move_in_angle(aside, near, image, moved) == pytest.approx(found, abs=1e-9)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(SEEDS)
def test_projections_and_turns_are_those_of_the_oracle(seed):
    rng = np.random.default_rng(seed)
    captured, boxes = random_boxes(rng, 20, closest=1.5)
    points, middle = points_of(rng, boxes, 30), boxes.mean(axis=1)
    eyes = captured + directions(rng, len(boxes)) * 0.3 * np.linalg.norm(middle - captured, axis=1)[:, None]
    expected = on_quadrilaterals(captured, points, boxes)
    turned = turned_to(eyes, captured, expected, boxes)
    worst = np.max(angles(eyes, points, turned), axis=1)
    for i in range(len(boxes)):
        one = slice(i, i + 1)
        shown = on_quadrilateral(captured[i], points[one], middle[one])
        np.testing.assert_allclose(shown, expected[one], rtol=1e-7, atol=1e-7)
        again = turned_to_viewer(eyes[i], captured[i], shown, middle[one])
        np.testing.assert_allclose(again, turned[one], rtol=1e-7, atol=1e-7)
        assert common_error(eyes[i], points[one], again)[0] == pytest.approx(worst[i], rel=1e-6, abs=1e-9)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(SEEDS)
def test_what_corners_say_is_never_more_careful_than_what_is_safe(seed):
    rng = np.random.default_rng(seed)
    captured, boxes = random_boxes(rng, 20, closest=1.5)
    limit, middle = math.radians(0.5), boxes.mean(axis=1)
    for i in range(len(boxes)):
        one, points = slice(i, i + 1), corners(boxes[i : i + 1])
        shown = on_quadrilateral(captured[i], points, middle[one])
        safe = safe_distance(captured[i], boxes[one], Flat(), limit)[0]
        nearer = safety_zone_of_the_nearer(captured[i], points, shown, limit)[0]
        assert safe <= nearer * (1.0 + 1e-9)
        assert nearer <= safety_zone(captured[i], points, shown, limit)[0] * (1.0 + 1e-9)
        eye = captured[i] + directions(rng, 1)[0] * nearer
        assert common_error(eye, points, shown)[0] <= limit * (1.0 + 1e-6)
        assert common_error(eye, points, shown)[0] <= error_angle(eye, captured[i], boxes[one], Flat())[0] * (
            1.0 + 1e-6
        )


def test_a_zone_is_what_is_printed():
    eye, point, image = np.zeros(3), np.array([[[10.0, 2.0, 1.0]]]), np.array([[[12.0, 2.4, 1.2]]])
    limit = math.radians(0.4)
    h, r = np.linalg.norm(point), np.linalg.norm(point - image) / (2.0 * math.sin(limit))
    assert safety_zone(eye, point, image, limit)[0] == pytest.approx(
        math.sqrt(h**2 + r**2 + 2.0 * h * r * math.sin(limit)) - r
    )
    assert safety_zone(eye, point, point, limit)[0] == math.inf
    assert safety_zone(eye, image, point, limit)[0] > safety_zone(eye, point, image, limit)[0]
    assert safety_zone_of_the_nearer(eye, image, point, limit)[0] == safety_zone(eye, point, image, limit)[0]


def test_an_image_that_moves_with_its_object_lasts():
    """Figures 4 and 5: a truck that drives by. The image that stays is wrong at once, the one that moves with it is not."""
    boxes, eye = np.array([[[-1.0, 59.0, 0.0], [1.0, 61.0, 2.0]]]), np.zeros(3)
    moved = np.eye(4)[None].copy()
    moved[0, 0, 3] = 0.5
    points = corners(boxes)
    shown = on_quadrilateral(eye, points, boxes.mean(axis=1))
    stays = common_error(eye, moved_points(moved, points), shown)[0]
    along = common_error(eye, moved_points(moved, points), moved_points(moved, shown))[0]
    assert stays == pytest.approx(0.5 / 60.0, rel=0.05)
    assert along < 0.02 * stays
    zone = safety_zone_of_the_nearer(eye, points, shown, 0.005)
    assert predicted_frames(zone, moved, eye, np.zeros(3))[0] == math.floor(zone[0] / 0.5)
