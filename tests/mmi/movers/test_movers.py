"""Moving objects: where they are between their poses, how they turn, and what is refused."""

from __future__ import annotations

import math
import time as clock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from moving import block, movers_of

from mmi.foundation.errors import ParameterError
from mmi.movers.movers import SHORTEST, Movers, distances, pose_matrices

RIGHT = 0.5 * math.pi


def rotation(axis, angle):
    """By Rodrigues' formula, for what the closed form says."""
    x, y, z = axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * skew + (1.0 - math.cos(angle)) * skew @ skew


def test_between_two_poses_it_moves_evenly_and_straight():
    found = movers_of([[(1.0, 0, 0, 0, 0), (3.0, 4, 2, 6, 90)]])
    assert np.allclose(found.poses(1.5)[0, :3, 3], (1.0, 0.5, 1.5))
    assert np.allclose(found.poses(2.0)[0, :3, :3], rotation((0, 0, 1), RIGHT / 2))
    assert np.allclose(found.poses(3.0)[0] @ [1, 0, 0, 1], (4, 3, 6, 1))  # ahead is +y now


def test_before_and_after_its_poses_it_stands_or_is_away():
    tracks = [[(1.0, 0, 0, 0, 0), (2.0, 5, 0, 0, 0)]] * 2
    found = movers_of(tracks, stays=[True, False])
    for time, x in ((-9.0, 0.0), (1.0, 0.0), (2.0, 5.0), (1e7, 5.0)):
        assert np.allclose(found.poses(time)[:, 0, 3], x)
    assert found.present(0.999).tolist() == [True, False]
    assert found.present(1.0).tolist() == found.present(2.0).tolist() == [True, True]
    assert found.present(2.001).tolist() == [True, False]


@pytest.mark.parametrize(
    ("a", "b", "middle"), [(350, 10, 0), (10, 350, 0), (-170, 170, 180), (0, 720 + 90, 45), (5, 5, 5)]
)
def test_headings_turn_the_short_way(a, b, middle):
    found = movers_of([[(0.0, 0, 0, 0, a), (1.0, 0, 0, 0, b)]])
    assert np.allclose(found.poses(0.5)[0, :3, :3], rotation((0, 0, 1), math.radians(middle)))


@settings(max_examples=50)
@given(st.tuples(*[st.floats(-10.0, 10.0)] * 3))
def test_angles_turn_about_the_objects_own_axes(angles):
    """Roll about ahead, then pitch about its right side, then heading about up: each product of single rotations."""
    heading, pitch, roll = angles
    expected = rotation((0, 0, 1), heading) @ rotation((0, -1, 0), pitch) @ rotation((1, 0, 0), roll)
    found = pose_matrices(np.zeros((1, 3)), np.array([angles]))
    assert np.allclose(found[0, :3, :3], expected, atol=1e-12)


def test_the_nose_and_the_left_side_go_up():
    assert movers_of([[(0.0, 0, 0, 0, 30, 10, 0)]]).poses(0.0)[0, 2, 0] > 0.1
    assert movers_of([[(0.0, 0, 0, 0, 30, 0, 10)]]).poses(0.0)[0, 2, 1] > 0.1


def test_all_at_once_equals_one_by_one():
    """Tracks of very different lengths; the plain twin looks through one track and uses numpy's interpolation."""
    rng = np.random.default_rng(3)
    tracks = []
    for length in (1, 2, 3, 7, 64, 65):
        times = np.cumsum(rng.uniform(0.01, 1.0, length)) - 3.0
        headings = np.degrees(np.cumsum(rng.uniform(-1.0, 1.0, length)))
        tracks.append(np.column_stack([times, rng.uniform(-50, 50, (length, 3)), headings]).tolist())
    found = movers_of(tracks)
    moments = [*rng.uniform(-5.0, 40.0, 40), *(row[0] for row in tracks[4])]
    for moment in moments:
        poses = found.poses(moment)
        for pose, track in zip(poses, tracks, strict=True):
            rows = np.array(track)
            x, y, z, heading = (np.interp(moment, rows[:, 0], rows[:, c]) for c in range(1, 5))
            assert np.allclose(pose[:3, 3], (x, y, z))
            assert np.allclose(pose[:3, :3], rotation((0, 0, 1), math.radians(heading)))


def test_a_thousand_movers_take_little_time():
    rows = np.column_stack([np.arange(600) * 0.1, np.arange(600), np.zeros((600, 3))])
    n, k = 1000, len(rows)
    found = Movers(
        ids=tuple(map(str, range(n))),
        kinds=np.zeros(n, dtype=np.int64),
        names=("block",),
        meshes=(block(),),
        starts=np.arange(n + 1, dtype=np.int64) * k,
        times=np.tile(rows[:, 0], n),
        positions=np.tile(rows[:, 1:4], (n, 1)),
        angles=np.zeros((n * k, 3)),
        stays=np.ones(n, dtype=bool),
    )
    found.poses(1.0)
    start = clock.perf_counter()
    for moment in range(20):
        assert found.poses(moment + 0.05)[-1, 0, 3] == pytest.approx(10 * moment + 0.5)
    assert (clock.perf_counter() - start) / 20 < 0.02  # about 1 ms; one by one it would be 100 ms


def test_boxes_hold_the_shape():
    found = movers_of([[(0.0, 1, 2, 3, 37, 12, -50), (1.0, 4, 2, 9, 170, 40, 5)]])
    for moment in (0.0, 0.3, 1.0):
        poses = found.poses(moment)
        points = found.meshes[0].vertices @ poses[0, :3, :3].T + poses[0, :3, 3]
        corners = found.corners(poses)[0]
        assert np.allclose(np.sort(corners, axis=0)[[0, -1]], np.sort(points, axis=0)[[0, -1]])  # it is a box itself


@settings(max_examples=50)
@given(st.tuples(*[st.floats(-20.0, 20.0)] * 3), st.tuples(*[st.floats(-4.0, 4.0)] * 3))
def test_distances_are_those_to_the_nearest_point(eye, angles):
    """Dense points of a box are never nearer, and one of them is hardly farther."""
    poses = pose_matrices(np.array([[1.0, -2.0, 0.5]]), np.array([angles]))
    low, high = np.array([-2.0, -1.0, 0.0]), np.array([2.0, 1.0, 1.5])
    steps = np.linspace(0.0, 1.0, 21)
    own = low + (high - low) * np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    world = own @ poses[0, :3, :3].T + poses[0, :3, 3]
    nearest = np.linalg.norm(world - np.array(eye), axis=1).min()
    found = distances(np.array(eye), poses, np.array([[low, high]]))[0]
    assert found - 1e-9 <= nearest <= found + 0.2


def test_another_origin_moves_nothing_in_the_world():
    found = movers_of([[(0.0, 1, 2, 3, 0)]], crs="EPSG:32635", origin=(100.0, 200.0, 5.0))
    moved = found.in_frame(crs="EPSG:32635", origin=(90.0, 210.0, 5.0))
    assert moved.positions.tolist() == [[11.0, -8.0, 3.0]]
    assert moved.origin == (90.0, 210.0, 5.0)
    assert found.in_frame(crs="EPSG:32635", origin=(100.0, 200.0, 5.0)) is found
    with pytest.raises(ParameterError, match="coordinate system local expected, found EPSG:32635"):
        found.in_frame(crs="local", origin=(0.0, 0.0, 0.0))


def test_the_span_is_that_of_all():
    assert movers_of([[(1.0, 0, 0, 0, 0)], [(-2.0, 0, 0, 0, 0), (0.5, 0, 0, 0, 0)]]).span == (-2.0, 1.0)
    assert movers_of([]).span == (0.0, 0.0)


def test_nothing_that_moves_is_fine():
    empty = movers_of([])
    assert empty.poses(1.0).shape == (0, 4, 4)
    assert empty.corners(empty.poses(1.0)).shape == (0, 8, 3)
    assert empty.present(1.0).shape == (0,)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"ids": ("a", "a")}, "object a: an id of its own expected, found it twice"),
        ({"ids": ("a", "")}, "of whole characters expected, found ''"),
        ({"ids": ("a", "\ud800")}, "of whole characters expected"),
        ({"kinds": np.array([0, 1])}, "kinds below 1 expected, found 1"),
        ({"names": ("x", "y")}, "a name of its own for each of 1 meshes"),
        ({"starts": np.array([0, 0, 3])}, "object a: at least one pose expected"),
        ({"times": np.array([0.0, 0.0, 0.0])}, "object b: pose 2: time: at least 0.001 s after the 0 s"),
        ({"times": np.array([0.0, 0.0, np.nan])}, "object b: pose 2: time: numbers up to"),
        ({"positions": np.array([[0, 0, 0], [0, np.inf, 0], [0, 0, 0]])}, "object b: pose 1: position: numbers up to"),
        ({"angles": np.array([[0, 0, 2e7], [0, 0, 0], [0, 0, 0]])}, "object a: pose 1: angle: numbers up to"),
        ({"stays": np.array([True])}, "expected for 2 objects and 3 poses"),
        ({"origin": (0.0, np.nan, 0.0)}, "an origin of three numbers expected"),
    ],
)
def test_what_does_not_fit_is_refused(change, said):
    good = movers_of([[(0.0, 0, 0, 0, 0)], [(0.0, 0, 0, 0, 0), (SHORTEST, 0, 0, 0, 0)]], ids=("a", "b"))
    fields = {name: getattr(good, name) for name in Movers.__slots__ if name not in ("boxes", "reach")}
    Movers(**fields)
    with pytest.raises(ParameterError, match=said):
        Movers(**(fields | change))
