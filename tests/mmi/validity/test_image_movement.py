"""For how many frames images last: no frame among those that are promised is beyond the limit."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from whole_boxes import angles, directions, on_quadrilaterals, points_of, random_boxes

from mmi.validity.images import Flat, error_angle, safe_distance
from mmi.validity.movement import (
    MANY,
    frames_at_equal_steps,
    frames_left,
    frames_within_limits,
    left_behind_angle,
    relative_viewpoint,
    viewpoint_step,
)
from mmi.validity.papers import predicted_frames

SEEDS = st.integers(0, 2**32 - 1)


def turns(axes, by):
    """Rotations (n, 3, 3) around unit ``axes`` (n, 3) by ``by`` (n,) radians."""
    skew = np.zeros((len(axes), 3, 3))
    skew[:, [2, 0, 1], [1, 2, 0]], skew[:, [1, 2, 0], [2, 0, 1]] = axes, -axes
    by = np.asarray(by)[:, None, None]
    return np.eye(3) + np.sin(by) * skew + (1.0 - np.cos(by)) * (skew @ skew)


def about(rotations, pivots, shifts):
    """(n, 4, 4): rotations around ``pivots`` (n, 3), then shifts (n, 3)."""
    moved = np.zeros((len(pivots), 4, 4))
    moved[:, :3, :3], moved[:, 3, 3] = rotations, 1.0
    moved[:, :3, 3] = pivots + shifts - np.einsum("nij,nj->ni", rotations, pivots)
    return moved


def scene(rng, count):
    """Viewpoints, boxes, their safe distances for half a degree, and a movement of each a frame."""
    captured, boxes = random_boxes(rng, count, closest=1.5)
    safe = safe_distance(captured, boxes, Flat(), math.radians(0.5))
    pivots, n = boxes.mean(axis=1), len(boxes)
    arm = np.linalg.norm(pivots - captured, axis=1)
    pace = safe / rng.uniform(2.0, 40.0, n)
    by, shift = pace / arm * rng.uniform(0.0, 1.0, n), pace * rng.uniform(0.0, 1.0, n)
    moved = about(turns(directions(rng, n), by), pivots, directions(rng, n) * shift[:, None])
    step = directions(rng, n) * (pace * rng.uniform(0.0, 1.0, n))[:, None]
    return captured, boxes, safe, moved, step, (shift + np.linalg.norm(step, axis=1), by, arm)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(SEEDS)
def test_no_point_exceeds_the_limit_in_the_frames_that_equal_steps_promise(seed):
    rng = np.random.default_rng(seed)
    captured, boxes, safe, moved, step, limits = scene(rng, 12)
    points = points_of(rng, boxes, 60)
    shown = on_quadrilaterals(captured, points, boxes)
    for i in range(len(boxes)):
        frames = frames_at_equal_steps(safe[i : i + 1], moved[i : i + 1], captured[i], step[i], most=256)[0]
        limited = frames_within_limits(safe[i], speed=limits[0][i], turn=limits[1][i], arm=limits[2][i], most=256)
        assert limited <= 256
        pose = np.eye(4)
        for frame in range(1, int(max(frames, limited)) + 1):
            pose = moved[i] @ pose
            after = [one[i] @ pose[:3, :3].T + pose[:3, 3] for one in (points, shown)]
            viewer = captured[i] + frame * step[i]
            worst = np.nanmax(angles(viewer[None], after[0][None], after[1][None]))
            assert worst <= math.radians(0.5) * (1.0 + 1e-6) + 1e-9
            there = relative_viewpoint(pose, viewer)
            assert error_angle(there, captured[i], boxes[i : i + 1], Flat())[0] >= worst * (1.0 - 1e-6) - 1e-9


@settings(max_examples=60, deadline=None, derandomize=True)
@given(SEEDS, st.floats(0.0, 2.0), st.floats(0.0, 0.3))
def test_whatever_moves_within_the_limits_stays_in_the_zone(seed, speed, turn):
    """Every frame another direction, another axis: the object and the viewer as they like."""
    rng = np.random.default_rng(seed)
    captured, pivot = np.zeros(3), directions(rng, 1)[0] * rng.uniform(1.0, 50.0)
    distance = rng.uniform(0.1, 30.0)
    arm = np.linalg.norm(pivot)
    frames = int(frames_within_limits(distance, speed=speed, turn=turn, arm=arm, most=100))
    steady = directions(rng, 1)[0]
    pose, viewer, steadily = np.eye(4), captured.copy(), rng.uniform() < 0.5
    for _ in range(frames):
        share, axis = rng.uniform(), steady if steadily else directions(rng, 1)[0]
        here = pose[:3, :3] @ pivot + pose[:3, 3]
        away = (steady if steadily else directions(rng, 1)[0]) * speed
        pose = about(turns(axis[None], [turn]), here[None], (share * away)[None])[0] @ pose
        viewer = viewer - (1.0 - share) * away
        assert np.linalg.norm(relative_viewpoint(pose, viewer) - captured) <= distance * (1.0 + 1e-9) + 1e-9


def test_equal_steps_are_no_bound_where_an_object_turns():
    """The viewer keeps up with an object that turns by 5 degrees a frame: equation (5) sees nearly no step at first."""
    pivot, eye = np.array([[60.0, 0.0, 0.0]]), np.zeros(3)
    moved = about(turns(np.array([[0.0, 0.0, 1.0]]), [math.radians(5.0)]), pivot, np.zeros((1, 3)))
    step = relative_viewpoint(np.linalg.inv(moved[0]), eye) * 0.97  # to where the turned object has what the eye saw
    first = viewpoint_step(moved, eye, step, 1)[0]
    pose = np.linalg.matrix_power(moved[0], 29)
    reached = np.linalg.norm(relative_viewpoint(pose, eye + 29 * step))
    assert reached > 20.0 * 29 * first
    zone = np.array([29.5 * first])
    assert predicted_frames(zone, moved, eye, step)[0] == 29
    promised = frames_at_equal_steps(zone, moved, eye, step)[0]
    assert 1 <= promised < 29
    pose = np.linalg.matrix_power(moved[0], int(promised))
    assert np.linalg.norm(relative_viewpoint(pose, eye + promised * step)) <= zone[0]


def test_driving_along_costs_nothing():
    shift = np.array([[0.9, 0.2, 0.0]])
    moved = about(np.eye(3)[None], np.zeros((1, 3)), shift)
    assert frames_at_equal_steps([3.0], moved, np.zeros(3), shift[0])[0] == MANY
    assert frames_at_equal_steps([3.0], moved, np.zeros(3), shift[0], most=256)[0] == 256
    assert frames_at_equal_steps([3.0], moved, np.zeros(3), np.zeros(3))[0] == 3


@settings(max_examples=60, deadline=None, derandomize=True)
@given(SEEDS)
def test_steps_are_those_of_the_relative_viewpoint(seed):
    rng = np.random.default_rng(seed)
    eye, step = rng.normal(size=3), rng.normal(size=3)
    moved = about(
        turns(directions(rng, 1), [rng.uniform(0.0, 0.5)]), rng.normal(size=(1, 3)) * 9.0, rng.normal(size=(1, 3))
    )
    poses = [np.linalg.matrix_power(moved[0], k) for k in range(30)]
    path = np.array([relative_viewpoint(pose, eye + k * step) for k, pose in enumerate(poses)])
    lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
    found = [viewpoint_step(moved, eye, step, k)[0] for k in range(1, 30)]
    np.testing.assert_allclose(found, lengths, rtol=1e-6, atol=1e-9)


def test_frames_are_whole():
    np.testing.assert_array_equal(
        frames_left([1.0, 0.99, 0.0, math.inf, 3.0], [0.5, 0.5, 0.1, 0.1, 0.0]), [2, 1, 0, MANY, MANY]
    )
    assert frames_within_limits(5.0, speed=0.0) == MANY
    # A turn in place is never farther than twice the arm.
    assert frames_within_limits(5.0, speed=0.0, turn=0.1, arm=2.4) == MANY
    assert frames_within_limits(5.0, speed=0.0, turn=0.1, arm=2.6) == math.floor(2.0 * math.asin(5.0 / 5.2) / 0.1)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(SEEDS)
def test_an_image_that_is_left_behind_is_wrong_by_no_more(seed):
    rng = np.random.default_rng(seed)
    captured, boxes = random_boxes(rng, 30)
    points, n = points_of(rng, boxes, 80), len(boxes)
    shown = on_quadrilaterals(captured, points, boxes)
    away = np.linalg.norm(boxes.mean(axis=1) - captured, axis=1)
    shift = directions(rng, n) * (away * rng.uniform(0.0, 0.2, n))[:, None]
    moved = about(turns(directions(rng, n), rng.uniform(0.0, 0.2, n)), boxes.mean(axis=1), shift)
    eyes = captured + directions(rng, n) * (away * rng.uniform(0.0, 0.1, n))[:, None]
    after = np.einsum("nij,nkj->nki", moved[:, :3, :3], points) + moved[:, None, :3, 3]
    worst = np.nanmax(angles(eyes, after, shown), axis=1)
    bound = error_angle(eyes, captured, boxes, Flat()) + left_behind_angle(eyes, boxes, moved)
    assert np.all(worst <= bound * (1.0 + 1e-9) + 1e-9)


def test_a_frame_is_not_promised_needlessly_few():
    """Of the frames in which the relative viewpoint stays within its zone, more than 95 % are promised at the median."""
    captured, boxes, safe, moved, step, _ = scene(np.random.default_rng(5), 200)
    kept = []
    for i in range(len(boxes)):
        frames = frames_at_equal_steps(safe[i : i + 1], moved[i : i + 1], captured[i], step[i], most=1000)[0]
        pose, true = np.eye(4), 0
        while true < 1000:
            pose = moved[i] @ pose
            if np.linalg.norm(relative_viewpoint(pose, captured[i] + (true + 1) * step[i]) - captured[i]) > safe[i]:
                break
            true += 1
        assert frames <= true
        kept.append(frames / max(true, 1))
    assert np.median(kept) > 0.95
