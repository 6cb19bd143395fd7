"""The closed form of eqs. (3)-(5) against dense sampling, with all its special cases."""

import math

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from viewing_angle import extremal_angles, point_pair_weights

from mmi.cells.viewing_cells import ViewingCell

lattice = st.integers(-6, 6).map(float)  # hits every special case: parallel, on the line, at an end, A = B
real = st.floats(-30.0, 30.0, allow_nan=False)
coordinate = lattice | real
point = st.tuples(coordinate, coordinate)


def gap(point, p, q):
    """Distance from a point to the segment PQ."""
    t = np.clip((point - p) @ (q - p) / ((q - p) @ (q - p)), 0.0, 1.0)
    return np.linalg.norm(p + t * (q - p) - point)


def angles(a, b, m):
    """Signed principal angle AMB for viewpoints m (n, 2)."""
    da, db = a - m, b - m
    return np.arctan2(da[:, 0] * db[:, 1] - da[:, 1] * db[:, 0], (da * db).sum(axis=1))


def sampled(a, b, p, q, signed):
    """Least and greatest angle on the segment by sampling, then by sampling around the best samples again and again."""

    def evaluate(t):
        values = angles(a, b, p + t[:, None] * (q - p))
        return base + np.unwrap(values - base) if signed else np.abs(values)

    base = angles(a, b, p[None])[0] if signed else 0.0
    # More samples where the segment passes a point closely, and the angle may dip or peak within centimetres.
    near = np.concatenate([-np.geomspace(1.0, 1e-6, 400), [0.0], np.geomspace(1e-6, 1.0, 400)])
    feet = [(x - p) @ (q - p) / ((q - p) @ (q - p)) for x in (a, b)]
    t = np.unique(np.clip(np.concatenate([np.linspace(0.0, 1.0, 1001), *(foot + near for foot in feet)]), 0.0, 1.0))
    values = evaluate(t)
    result = []
    for sign in (1.0, -1.0):
        best = np.argmin(sign * values)
        low, high, value = t[max(best - 1, 0)], t[min(best + 1, len(t) - 1)], values[best]
        for _ in range(8):
            fine = np.linspace(low, high, 41)
            unwrapped = evaluate(fine)
            unwrapped += (2.0 * math.pi * np.round((value - unwrapped[20]) / (2.0 * math.pi))) if signed else 0.0
            at = np.argmin(sign * unwrapped)
            low, high = fine[max(at - 1, 0)], fine[min(at + 1, 40)]
            value = min(value, unwrapped[at], key=lambda v, s=sign: s * v)
        result.append(value)
    return result


@settings(deadline=None)
@given(a=point, b=point, p=point, q=point, signed=st.booleans())
@example(a=(0.0, 1.0), b=(3.0, -1.0), p=(-5.0, 0.0), q=(5.0, 0.0), signed=True)  # y_B < 0: no tangent circle
@example(a=(0.0, 1.0), b=(3.0, -1.0), p=(-5.0, 0.0), q=(5.0, 0.0), signed=False)  # y_B < 0: pi where AB meets PQ
@example(a=(0.0, 1.0), b=(3.0, 1.0), p=(-5.0, 0.0), q=(5.0, 0.0), signed=False)  # y_B = 1: the median
@example(a=(0.0, 1.0), b=(3.0, 2.0), p=(-9.0, 0.0), q=(2.0, 0.0), signed=True)  # one extremum outside [PQ]
@example(a=(6.0, 0.0), b=(3.0, 2.0), p=(-5.0, 0.0), q=(5.0, 0.0), signed=True)  # A on the line, beyond Q
@example(a=(-6.0, 0.0), b=(6.0, 0.0), p=(-5.0, 0.0), q=(5.0, 0.0), signed=False)  # both on the line
@example(a=(1.0, 1.0), b=(1.0, 1.0), p=(-5.0, 0.0), q=(5.0, 0.0), signed=True)  # A = B
@example(a=(0.0, 1.0), b=(0.0, 4.0), p=(-5.0, 0.0), q=(5.0, 0.0), signed=True)  # from -36.9 through 0 to 36.9 degrees
def test_closed_form_agrees_with_dense_sampling(a, b, p, q, signed):
    a, b, p, q = (np.array(x) for x in (a, b, p, q))
    assume(np.linalg.norm(q - p) > 0.1)
    # Where the segment passes a point closely the angle turns faster than samples can follow; see the tests below.
    assume(min(gap(a, p, q), gap(b, p, q)) > 0.05)
    low, high = extremal_angles(a, b, p, q, signed=signed)
    expected_low, expected_high = sampled(a, b, p, q, signed)
    # Which of pi and -pi an angle starts at is up to rounding.
    branch = 2.0 * math.pi * round((float(low) - expected_low) / (2.0 * math.pi)) if signed else 0.0
    expected_low, expected_high = expected_low + branch, expected_high + branch
    assert low == pytest.approx(expected_low, abs=1e-9)
    assert high == pytest.approx(expected_high, abs=1e-9)


def test_known_extrema_of_a_tangent_circle():
    # The circle through (0, 1) and (0, 4) touches y = 0 at (+-2, 0): sin of half the angle there is 1.5 / 2.5.
    low, high = extremal_angles((0, 1), (0, 4), (-9, 0), (9, 0), signed=True)
    most = math.asin(0.6)
    assert (low, high) == pytest.approx((-most, most), abs=1e-15)
    assert extremal_angles((0, 1), (0, 4), (-9, 0), (9, 0), signed=False) == pytest.approx((0.0, most), abs=1e-15)


def test_unsigned_angle_hides_an_exchange_of_left_and_right():
    a, b, p, q = (0, 1), (0, 1.1), (-1, 0), (1, 0)
    unsigned = np.ptp(extremal_angles(a, b, p, q, signed=False))
    signed = np.ptp(extremal_angles(a, b, p, q, signed=True))
    assert signed == pytest.approx(2.0 * unsigned)


def test_signed_angle_runs_past_pi():
    # Walking between two points from one side to the other: each turns by almost pi, in opposite directions.
    low, high = extremal_angles((1, 0), (-1, 0), (0, -50), (0, 50), signed=True)
    assert (low, high) == pytest.approx((2 * math.atan2(1, 50), 2 * math.pi - 2 * math.atan2(1, 50)))


def test_walking_through_a_point():
    a, b, p, q = (0, 0), (3, 4), (-1, 0), (1, 0)
    bearing = math.atan2(4, 3)
    start, end = math.atan2(4, 4), math.pi - math.atan2(4, 2)
    # Just before A the angle to B is the bearing, just after it is the supplement.
    expected = sorted([start, end, bearing, math.pi - bearing])
    assert extremal_angles(a, b, p, q, signed=False) == pytest.approx((expected[0], expected[-1]))
    assert extremal_angles(b, a, p, q, signed=False) == pytest.approx((expected[0], expected[-1]))
    with pytest.raises(ValueError, match="between them"):
        extremal_angles(a, b, p, q, signed=True)


@pytest.mark.parametrize("signed", [True, False])
def test_points_at_the_ends_count_by_their_limits(signed):
    p, q, b = np.array([1.0, 2.0]), np.array([4.0, 6.0]), np.array([-3.0, 5.0])
    for a in (p, q):
        low, high = extremal_angles(a, b, p, q, signed=signed)
        t = np.linspace(1e-9, 1.0 - 1e-9, 5001)[:, None]
        values = angles(a, b, p + t * (q - p))
        values = values if signed else np.abs(values)
        assert (low, high) == pytest.approx((values.min(), values.max()), abs=1e-7)


def test_segment_without_length_is_refused():
    with pytest.raises(ValueError, match="P and Q apart"):
        extremal_angles((0, 1), (1, 1), (2, 2), (2, 2), signed=False)


def test_broadcasts():
    a = np.array([[0.0, 1.0], [0.0, 2.0], [1.0, 3.0]])
    low, high = extremal_angles(a, (0, 4), (-9, 0), (9, 0), signed=True)
    assert low.shape == high.shape == (3,)
    for i in range(3):
        assert (low[i], high[i]) == extremal_angles(a[i], (0, 4), (-9, 0), (9, 0), signed=True)


@settings(deadline=None)
@given(a=point, b=point, signed=st.booleans(), seed=st.integers(0, 2**31))
def test_cell_weight_bounds_the_interior_and_is_reached_on_the_boundary(a, b, signed, seed):
    cell = ViewingCell("c", (-4.0, 1.0), (5.0, 3.0), 2.0, (1.5, 1.9))
    a, b = np.array(a), np.array(b)
    corners = cell.corners
    edges = [(corners[k], corners[(k + 1) % 4]) for k in range(4)]
    inward = [np.array([p[1] - q[1], q[0] - p[0]]) / np.linalg.norm(q - p) for p, q in edges]
    outside = [max((p - x) @ n for (p, _), n in zip(edges, inward, strict=True)) for x in (a, b)]
    assume(min(outside) > 0.5)
    weight = float(point_pair_weights(cell, a, b, signed=signed))
    rng = np.random.default_rng(seed)
    u, v = rng.uniform(0.0, 1.0, (2, 2000, 1))
    inner = corners[0] + u * (corners[1] - corners[0]) + v * (corners[3] - corners[0])
    t = np.linspace(0.0, 1.0, 1001)[:-1, None]
    around = np.concatenate([p + t * (q - p) for p, q in edges])
    values = angles(a, b, np.concatenate([around, inner]))
    # Azimuths relative to the centre are continuous over the cell, so this is the signed angle without jumps.
    centre = cell.reference[:2]

    def turn(x, m):
        d0, d1 = x - centre, x - m
        return np.arctan2(d0[0] * d1[:, 1] - d0[1] * d1[:, 0], d1 @ d0)

    m = np.concatenate([around, inner])
    values = turn(b, m) - turn(a, m) if signed else np.abs(values)
    boundary = values[: len(around)]
    assert np.ptp(values) <= weight + 1e-9
    assert np.ptp(boundary) >= weight - 0.03  # samples every centimetre, points half a metre away


def test_points_in_the_cell_have_no_bound():
    cell = ViewingCell("c", (0.0, 0.0), (10.0, 0.0), 2.0, (1.5, 1.9))
    assert point_pair_weights(cell, (5.0, 1.0), (50.0, 1.0)) == 2.0 * math.pi
    assert point_pair_weights(cell, (50.0, 1.0), (5.0, 1.0), signed=False) == math.pi
