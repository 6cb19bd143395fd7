"""The angle between two points of a ray: its closed forms against vectors, and against all there is to go wrong."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mmi.foundation.ray_chords import may_exceed
from mmi.validity.ray_pairs import angle_between, angle_in_cone, safe_step, widest_angle

DISTANCES = st.floats(0.01, 1000.0)
ANGLES = st.floats(0.0, math.pi)


def seen_apart(near, far, moved, turn):
    """The angle by vectors in the plane: the ray is the x axis."""
    viewer = moved * np.array([np.cos(turn), np.sin(turn)])
    one, other = np.array([near, 0.0]) - viewer, np.array([far, 0.0]) - viewer
    return abs(math.atan2(one[0] * other[1] - one[1] * other[0], one @ other))


@settings(max_examples=200, deadline=None, derandomize=True)
@given(DISTANCES, DISTANCES, DISTANCES, ANGLES)
def test_an_angle_is_that_of_vectors(one, other, moved, turn):
    near, far = sorted((one, other))
    assume(min(abs(moved - near), abs(moved - far)) > 1e-4 or turn > 1e-4)  # at one of the points it has no direction
    found = angle_between(near, far, moved, math.cos(turn))
    assert found == pytest.approx(seen_apart(near, far, moved, turn), abs=1e-6)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(DISTANCES, DISTANCES, DISTANCES, ANGLES, ANGLES, st.integers(0, 2**32 - 1))
def test_no_pair_within_parts_more_on_a_ray_of_the_cone(one, other, moved, first, last, seed):
    (near, far), (first, last) = sorted((one, other)), sorted((first, last))
    bound = angle_in_cone(near, far, moved, math.cos(last), math.cos(first))
    rng = np.random.default_rng(seed)
    for _ in range(60):
        unit, turn = rng.uniform(1.0, 1.5), rng.uniform(first, last)  # metres to a unit on this ray
        closer, farther = sorted(rng.uniform(near, far, 2) * unit)
        assert seen_apart(closer, farther, moved, turn) <= bound + 1e-7
    if moved > 0.99 * near:
        return  # at one of the points there is no angle
    ends = [seen_apart(near, far, moved, turn) for turn in np.linspace(first, last, 300)]
    assert max(ends) == pytest.approx(bound, rel=0.05, abs=1e-3 + 0.02 * (last - first))


@settings(max_examples=200, deadline=None, derandomize=True)
@given(DISTANCES, DISTANCES, st.floats(0.001, 0.999))
def test_the_widest_is_reached_and_not_exceeded(one, other, share):
    near, far = sorted((one, other))
    moved = share * near
    bound = float(widest_angle(near, far, moved))
    turns = np.linspace(0.0, math.pi, 2000)
    found = np.arctan2(
        moved * np.sin(turns) * (far - near),
        near * far - (near + far) * moved * np.cos(turns) + moved**2,
    )
    assert found.max() <= bound * (1.0 + 1e-9) + 1e-12
    at = moved * (near + far) / (near * far + moved**2)
    assert float(angle_between(near, far, moved, at)) == pytest.approx(bound, rel=1e-6, abs=1e-9)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(DISTANCES, DISTANCES, st.floats(1e-5, 1.5))
def test_a_safe_step_is_where_the_widest_meets_the_limit(one, other, limit):
    near, far = sorted((one, other))
    step = float(safe_step(near, far, limit))
    if far == near:
        assert step == math.inf
        return
    assert 0.0 < step <= near
    if far - near > 1e-6 * far:
        assert float(widest_angle(near, far, step)) == pytest.approx(limit, rel=1e-5)
    # Duckstein's (2) and (3), with the distance to the nearer point.
    r = (far - near) / (2.0 * math.sin(limit))
    printed = math.sqrt(near**2 + r**2 + 2.0 * near * r * math.sin(limit)) - r
    assert step == pytest.approx(printed, rel=1e-6, abs=1e-9 * (1.0 + r + near))


def test_a_step_from_the_farther_point_is_too_long():
    """h is the distance to the nearer of a point and its projection: from the farther one, the zone is too wide by |a - a~|."""
    near, far, limit = 10.0, 14.0, math.radians(0.5)
    r = (far - near) / (2.0 * math.sin(limit))
    farther = math.sqrt(far**2 + r**2 + 2.0 * far * r * math.sin(limit)) - r
    assert float(widest_angle(near, far, farther)) > 1.5 * limit
    assert float(widest_angle(near, far, safe_step(near, far, limit))) == pytest.approx(limit)


def test_what_is_known_at_the_ends():
    assert safe_step(3.0, 3.0, 0.01) == math.inf
    assert safe_step(3.0, math.inf, 0.01) == pytest.approx(3.0 * math.sin(0.01))
    assert safe_step(0.0, 3.0, 0.01) == 0.0
    assert widest_angle(3.0, 3.0, 5.0) == 0.0
    assert widest_angle(3.0, 4.0, 3.0) == math.pi
    assert angle_in_cone(0.0, 4.0, 0.1, -1.0, 1.0) == math.pi
    assert angle_in_cone(0.0, 4.0, 0.0, -1.0, 1.0) == 0.0


@settings(max_examples=100, deadline=None, derandomize=True)
@given(DISTANCES, DISTANCES, st.floats(0.01, 0.45))
def test_it_is_no_more_than_what_captures_use(one, other, share):
    """The bound behind layers' depths (|P - M| >= |P| - reach for both points) is never less than the exact one."""
    near, far = sorted((one, other))
    chord = 2.0 * math.sin(0.5 * float(widest_angle(near, far, share * near)))
    if chord > 1e-6:
        assert may_exceed(chord * chord * (1.0 - 1e-9), near, far, share * near)
