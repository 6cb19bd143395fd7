"""Errors of images of many boxes: against points of all boxes that share rays, and against a plain twin."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmi.validity.box_rays import cosines_with
from mmi.validity.layers import layer_distances, layer_errors, layer_parallax
from mmi.validity.ray_pairs import angle_in_cone

SEEDS = st.integers(0, 2**32 - 1)


def street(rng, count, *, closest=15.0, farthest=200.0):
    """Boxes (k, 2, 3) like houses around the origin, some behind others."""
    turn, away = rng.uniform(0.0, 2.0 * math.pi, count), np.exp(rng.uniform(np.log(closest), np.log(farthest), count))
    size = rng.uniform(3.0, 20.0, (count, 2))
    middle = np.stack((np.cos(turn) * away, np.sin(turn) * away), axis=1)
    low = np.column_stack((middle - 0.5 * size, rng.uniform(-2.0, 2.0, count)))
    return np.stack((low, np.column_stack((middle + 0.5 * size, rng.uniform(3.0, 60.0, count)))), axis=1)


def hits(captured, rays, boxes):
    """Distances (r, k) at which rays (r, 3) enter and leave boxes; nan where they miss."""
    with np.errstate(divide="ignore"):
        one, other = ((boxes[None, :, side] - captured) / rays[:, None] for side in (0, 1))
    enter, leave = np.minimum(one, other).max(axis=-1), np.maximum(one, other).min(axis=-1)
    met = (enter <= leave) & (leave > 0.0)
    return np.where(met, np.maximum(enter, 0.0), np.nan), np.where(met, leave, np.nan)


def rays_through(rng, captured, boxes, count):
    points = boxes[:, None, 0] + rng.uniform(size=(len(boxes), count, 3)) * (boxes[:, 1] - boxes[:, 0])[:, None]
    rays = points.reshape(-1, 3) - captured
    return rays / np.linalg.norm(rays, axis=1)[:, None]


def subtended(eye, one, other):
    a, b = one - eye, other - eye
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1))


@settings(max_examples=40, deadline=None, derandomize=True)
@given(SEEDS, st.integers(1, 25))
def test_no_two_points_of_a_ray_part_more(seed, count):
    rng = np.random.default_rng(seed)
    captured, boxes = np.array([0.3, -0.2, 1.7]), street(rng, count)
    layer = layer_parallax(captured, boxes)
    rays = rays_through(rng, captured, boxes, 60)
    enter, leave = hits(captured, rays, boxes)
    with np.errstate(all="ignore"):
        first, last = np.nanmin(enter, axis=1), np.nanmax(leave, axis=1)
    for _ in range(8):
        eye = captured + rng.normal(size=3) * [6.0, 6.0, 1.0]
        worst = np.nanmax(subtended(eye, captured + rays * first[:, None], captured + rays * last[:, None]))
        (bound,) = layer_errors([layer], eye)
        assert worst <= bound * (1.0 + 1e-7) + 1e-9
    (safe,) = layer_distances([layer], 0.02)
    aside = rng.normal(size=3)
    eye = captured + aside / np.linalg.norm(aside) * safe
    assert subtended(eye, captured + rays * first[:, None], captured + rays * last[:, None]).max() <= 0.02 + 1e-9


@settings(max_examples=40, deadline=None, derandomize=True)
@given(SEEDS, st.integers(2, 20), st.floats(0.001, 0.05))
def test_points_of_neighbouring_rays_part_no_more_when_rays_are_widened(seed, count, widened):
    rng = np.random.default_rng(seed)
    captured, boxes = np.array([0.0, 0.0, 1.7]), street(rng, count)
    layer = layer_parallax(captured, boxes, widened=widened)
    rays = rays_through(rng, captured, boxes, 40)
    turned = np.cross(rays, rng.normal(size=rays.shape))
    turned /= np.linalg.norm(turned, axis=1)[:, None]
    beside = rays * math.cos(widened) + turned * math.sin(widened)
    enter, leave = hits(captured, rays, boxes)
    other_enter, other_leave = hits(captured, beside, boxes)
    for _ in range(5):
        eye = captured + rng.normal(size=3) * [6.0, 6.0, 1.0]
        (bound,) = layer_errors([layer], eye)
        for true in (np.nanmin(enter, axis=1), np.nanmax(leave, axis=1)):
            for drawn in (other_enter, other_leave):
                parted = subtended(
                    eye, (captured + rays * true[:, None])[:, None], captured + rays[:, None] * drawn[..., None]
                )
                assert np.nanmax(parted, initial=0.0) <= bound * (1.0 + 1e-7) + 1e-9


@settings(max_examples=40, deadline=None, derandomize=True)
@given(SEEDS, st.integers(0, 30))
def test_the_kernel_is_its_plain_twin(seed, count):
    rng = np.random.default_rng(seed)
    layers = [layer_parallax(rng.normal(size=3), street(rng, count, closest=5.0)) for _ in range(3)]
    for scale in (0.01, 1.0, 30.0):
        eye = rng.normal(size=3) * scale
        plain = []
        for one in layers:
            moved = eye - one.captured
            cone = cosines_with(one.directions, one.spread, moved)
            plain.append(np.max(angle_in_cone(one.near, one.far, np.linalg.norm(moved), *cone), initial=0.0))
        np.testing.assert_allclose(layer_errors(layers, eye), plain, rtol=1e-12, atol=1e-15)


def test_a_house_behind_another_counts_and_one_beside_it_does_not():
    front = [[20.0, -5.0, 0.0], [20.1, 5.0, 10.0]]
    behind, beside, above = (
        [[60.0, -5.0, 0.0], [60.1, 5.0, 10.0]],
        [[60.0, 20.0, 0.0], [60.1, 25.0, 10.0]],
        [[60.0, -5.0, 40.0], [60.1, 5.0, 50.0]],
    )
    eye, captured = np.array([0.0, 1.0, 1.7]), np.array([0.0, 0.0, 1.7])
    alone, hidden, aside, over = layer_errors(
        [layer_parallax(captured, np.array([front, *rest])) for rest in ([], [behind], [beside], [above])], eye
    )
    assert hidden == pytest.approx(math.atan(1.0 / 20.0) - math.atan(1.0 / 60.1), rel=0.05)
    assert alone == aside == over < 0.01 * hidden


def test_a_widened_layer_joins_what_a_quad_would_join():
    boxes = np.array([[[20.0, -5.0, 0.0], [20.1, 0.0, 10.0]], [[60.0, 0.3, 0.0], [60.1, 15.0, 10.0]]])
    captured = np.array([0.0, 0.0, 1.7])
    plain, wide = layer_errors(
        [layer_parallax(captured, boxes), layer_parallax(captured, boxes, widened=0.01)], np.array([0.0, 2.0, 1.7])
    )
    assert wide > 10.0 * plain


def test_an_empty_layer_is_right_and_one_around_the_viewer_is_not():
    empty, around = (
        layer_parallax(np.zeros(3), np.empty((0, 2, 3))),
        layer_parallax(np.zeros(3), np.array([[[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]])),
    )
    np.testing.assert_array_equal(layer_errors([empty, around], [0.0, 0.0, 0.1]), [0.0, math.pi])
    np.testing.assert_array_equal(layer_errors([empty, around], [0.0, 0.0, 0.0]), [0.0, 0.0])
    np.testing.assert_array_equal(layer_distances([empty, around], 0.01), [math.inf, 0.0])
