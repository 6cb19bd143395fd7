"""The yaws in which a point sees boxes, held against views in many directions; and that views within others see less."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from viewer.placing.directions import TURN, arc_holds, arcs_of, distances_to, ranges_of, seen_from
from viewer.placing.rules import Fov

FOVS = (Fov(0.577, 0.433), Fov(1.0, 0.3), Fov(2.5, 2.0))
YAWS = np.arange(0.0, TURN, math.radians(0.5))


def boxes_around(seed, count=400):
    """Boxes of many sizes near the origin, some around it."""
    rng = np.random.default_rng(seed)
    middles = rng.normal(scale=4.0, size=(count, 3))
    half = 2.0 ** rng.uniform(-4.0, 3.0, size=(count, 3))
    half[::10] = 0.0
    return np.stack([middles - half, middles + half], axis=1)


def plainly_seen(boxes, eye, yaw, fov):
    """All boxes at once, plane by plane."""
    low, high = boxes[:, 0] - eye, boxes[:, 1] - eye
    cos, sin = math.cos(yaw), math.sin(yaw)

    def highest(x, y):
        return np.where(x > 0.0, high[:, 0], low[:, 0]) * x + np.where(y > 0.0, high[:, 1], low[:, 1]) * y

    ahead = highest(cos, sin)
    return (
        (ahead >= 0.0)
        & (highest(fov.across * cos + sin, fov.across * sin - cos) >= 0.0)
        & (highest(fov.across * cos - sin, fov.across * sin + cos) >= 0.0)
        & (low[:, 2] <= fov.up * ahead)
        & (-high[:, 2] <= fov.up * ahead)
    )


@pytest.mark.parametrize("fov", FOVS)
def test_seen_is_what_no_plane_parts_from_the_eye(fov):
    rng = np.random.default_rng(9)
    boxes = boxes_around(10)
    for yaw in YAWS[::7]:
        eye = rng.normal(scale=3.0, size=3)
        assert np.array_equal(seen_from(boxes, eye, yaw, fov), plainly_seen(boxes, eye, yaw, fov))


@pytest.mark.parametrize("fov", FOVS)
def test_arcs_hold_all_yaws_that_see(fov):
    boxes = boxes_around(1)
    arcs = arcs_of(boxes, np.zeros(3), fov)
    within = 0
    sees = np.stack([seen_from(boxes, np.zeros(3), yaw, fov) for yaw in YAWS], axis=1)
    for k, yaw in enumerate(YAWS):
        held = arc_holds(arcs, yaw)
        assert not (sees[:, k] & ~held).any()
        assert np.array_equal(held, arc_holds(arcs, yaw - TURN))
        within += held.sum()
    assert sees.sum() > 0.9 * within  # hulls are not much larger


@pytest.mark.parametrize("fov", FOVS)
def test_arcs_end_where_boxes_come_into_view(fov):
    """Of boxes that are narrow as seen from the eye, the arc is exact."""
    rng = np.random.default_rng(2)
    middles = rng.normal(scale=20.0, size=(80, 3))
    middles = middles[np.linalg.norm(middles[:, :2], axis=1) > 5.0]
    boxes = np.stack([middles - 0.02, middles + 0.02], axis=1)
    for box, (first, last) in zip(boxes, arcs_of(boxes, np.zeros(3), fov), strict=True):
        step = 0.02
        if first == last == 0.0:
            assert not any(seen_from(box[None], np.zeros(3), yaw, fov)[0] for yaw in YAWS)
        elif (last - first) % TURN > 3.0 * step:
            for yaw in (first + step, last - step):
                assert seen_from(box[None], np.zeros(3), yaw, fov)[0]
            for yaw in (first - 1e-6, last + 1e-6):
                assert not seen_from(box[None], np.zeros(3), yaw, fov)[0]


def test_a_view_shows_what_its_pyramid_meets():
    """Points of a box that are in the pyramid: then it is seen."""
    rng = np.random.default_rng(3)
    boxes = boxes_around(4)
    for fov in FOVS:
        for yaw in rng.uniform(0.0, TURN, size=20):
            points = boxes[:, :1] + rng.uniform(size=(len(boxes), 50, 3)) * np.ptp(boxes, axis=1)[:, None]
            ahead = math.cos(yaw) * points[..., 0] + math.sin(yaw) * points[..., 1]
            aside = math.cos(yaw) * points[..., 1] - math.sin(yaw) * points[..., 0]
            inside = (np.abs(aside) <= fov.across * ahead) & (np.abs(points[..., 2]) <= fov.up * ahead)
            assert not (inside.any(axis=1) & ~seen_from(boxes, np.zeros(3), yaw, fov)).any()


@given(st.integers(0, 2**32 - 1))
def test_an_eye_within_the_pyramid_sees_no_more(seed):
    rng = np.random.default_rng(seed)
    fov, yaw = FOVS[seed % 3], rng.uniform(0.0, TURN)
    ahead = rng.exponential(3.0)
    aside, up = ahead * fov.across * rng.uniform(-1.0, 1.0), ahead * fov.up * rng.uniform(-1.0, 1.0)
    cos, sin = math.cos(yaw), math.sin(yaw)
    eye = np.array([cos * ahead - sin * aside, sin * ahead + cos * aside, up])
    boxes = boxes_around(seed, 100)
    assert not (seen_from(boxes, eye, yaw, fov) & ~arc_holds(arcs_of(boxes, np.zeros(3), fov), yaw)).any()


def test_ranges_count_what_is_seen():
    rng = np.random.default_rng(6)
    boxes, weights = boxes_around(7), rng.integers(1, 100, size=400)
    arcs = arcs_of(boxes, np.zeros(3), FOVS[0])
    ranges = ranges_of(arcs, np.array([1.0, 2.0]))
    assert ranges.borders[0] == 0.0
    assert (np.diff(ranges.borders) > 0.0).all()
    assert np.isin([1.0, 2.0], ranges.borders).all()
    some = np.flatnonzero(rng.random(400) < 0.3)
    totals, part = ranges.totals(weights), ranges.totals(weights[some], some)
    for index, yaw in enumerate(ranges.middles):
        held = arc_holds(arcs, yaw)
        assert ranges.at(yaw) == index
        assert np.array_equal(ranges.seen_in(index), np.flatnonzero(held))
        assert totals[index] == weights[held].sum()
        assert part[index] == weights[some][held[some]].sum()
    for index in range(0, len(ranges.borders), 29):
        lowest, highest = (ranges.at(ranges.middles[index] + turn) for turn in (-0.3, 0.3))
        number = len(ranges.borders)
        between = [(lowest + n) % number for n in range((highest - lowest) % number + 1)]
        expected = np.unique(np.concatenate([ranges.seen_in(one) for one in between]))
        assert np.array_equal(ranges.seen_near(index, 0.3), expected)


def test_distances_to_boxes():
    boxes = boxes_around(8, 50)
    point = np.array([1.0, -2.0, 0.5])
    nearest = np.clip(point, boxes[:, 0], boxes[:, 1])
    assert np.allclose(distances_to(boxes, point), np.linalg.norm(nearest - point, axis=1), rtol=1e-12, atol=0.0)
