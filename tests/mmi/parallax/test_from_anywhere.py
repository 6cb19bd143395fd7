"""The bound on how far two points of a ray part: exceeded from nowhere, and close, against viewpoints all over the cell."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmi.cells.viewing_cells import ViewingCell
from mmi.foundation.camera import level_view
from mmi.parallax.from_anywhere import parted_at_most, surely_within, viewers_of

lengths, widths, turns = st.floats(2.0, 60.0), st.floats(0.2, 12.0), st.floats(-math.pi, math.pi)
rays, depths = st.tuples(st.floats(-0.6, 0.6), st.floats(-0.3, 1.0)), st.floats(2.0, 500.0)


def cell_of(length, half_width, turn):
    step = 0.5 * length * np.array([math.cos(turn), math.sin(turn)])
    middle = np.array([10.0, -20.0])
    return ViewingCell("", tuple(middle - step), tuple(middle + step), half_width, (1.5, 1.9))


def standing(cell, steps):
    """Viewpoints (n, 3) on a lattice over the cell and its eye band."""
    p, q = np.array(cell.p), np.array(cell.q)
    aside = cell.half_width * np.array([-(q - p)[1], (q - p)[0]]) / cell.length
    shares = [np.linspace(0.0, 1.0, count) for count in steps]
    return np.array(
        [[*(p + s * (q - p) + (2.0 * t - 1.0) * aside), 1.5 + 0.4 * u] for s, t, u in itertools.product(*shares)]
    )


def parted(view, ray, depths, viewpoints):
    """The largest chord between the directions to two points of a ray."""
    points = [view.eye + view.world_from_eye[:3, :3] @ np.array([ray[0] * z, ray[1] * z, -z]) for z in depths]
    one, other = ((point - viewpoints) / np.linalg.norm(point - viewpoints, axis=1)[:, None] for point in points)
    return float(np.linalg.norm(one - other, axis=1).max())


@settings(max_examples=150, deadline=None)
@given(lengths, widths, turns, rays, depths, depths)
def test_nobody_sees_them_farther_apart(length, half_width, turn, ray, near, far):
    cell = cell_of(length, half_width, turn)
    view = level_view(cell.reference, 0.0, focal=100.0, window=(0, 0, 1, 1))
    viewers = viewers_of(cell, view)
    found = parted_at_most(*ray, 1.0 / near, 1.0 / far, 0.0, viewers, 0.0)
    seen = parted(view, ray, (near, far), standing(cell, (13, 7, 2)))
    assert seen <= found * (1.0 + 1e-9) + 1e-12
    assert parted_at_most(*ray, 1.0 / far, 1.0 / near, 0.0, viewers, 0.0) == found
    for limit in (0.001, 0.02, 0.3):
        assert (parted_at_most(*ray, 1.0 / near, 1.0 / far, 0.0, viewers, limit) <= limit) == (found <= limit)
        if surely_within(limit, 1.0 / near, 1.0 / far, viewers.reach):
            assert seen <= limit


@settings(max_examples=100, deadline=None)
@given(lengths, widths, turns, rays, depths, depths, turns)
def test_nor_do_they_on_any_ray_within_the_blur(length, half_width, turn, ray, near, far, direction):
    cell = cell_of(length, half_width, turn)
    view = level_view(cell.reference, 0.0, focal=100.0, window=(0, 0, 1, 1))
    found = parted_at_most(*ray, 1.0 / near, 1.0 / far, 0.01, viewers_of(cell, view), 0.0)
    beside = ray[0] + 0.01 * math.cos(direction), ray[1] + 0.01 * math.sin(direction)
    assert parted(view, beside, (near, far), standing(cell, (7, 4, 2))) <= found * (1.0 + 1e-9) + 1e-12


@pytest.mark.parametrize(("near", "far", "share"), [(25.0, 40.0, 1.3), (50.0, 80.0, 1.12), (150.0, 400.0, 1.05)])
@pytest.mark.parametrize("degrees", [0.0, 20.0, 60.0, 90.0])
def test_it_is_close(near, far, share, degrees):
    cell = cell_of(30.0, 6.0, 0.0)
    view = level_view(cell.reference, math.radians(degrees), focal=100.0, window=(0, 0, 1, 1))
    found = parted_at_most(0.0, 0.0, 1.0 / near, 1.0 / far, 0.0, viewers_of(cell, view), 0.0)
    assert found <= share * parted(view, (0.0, 0.0), (near, far), standing(cell, (31, 13, 2)))


def test_it_may_be_largest_between_corners():
    """Beside a long cell: from its corners, two points 3 m apart part less than from 8 m along its side."""
    cell = cell_of(60.0, 3.0, 0.0)
    view = level_view(cell.reference, math.radians(90.0), focal=100.0, window=(0, 0, 1, 1))
    corners = parted(view, (0.0, 0.0), (10.0, 13.0), standing(cell, (2, 2, 1)))
    anywhere = parted(view, (0.0, 0.0), (10.0, 13.0), standing(cell, (121, 2, 1)))
    assert anywhere > 1.5 * corners
    found = parted_at_most(0.0, 0.0, 1.0 / 10.0, 1.0 / 13.0, 0.0, viewers_of(cell, view), 0.0)
    assert anywhere <= found <= 1.3 * anywhere


def test_boxes_are_parts_of_the_one_before():
    cell = cell_of(47.0, 7.0, 0.7)
    viewers = viewers_of(cell, level_view(cell.reference, 1.1, focal=100.0, window=(0, 0, 1, 1)))
    low, high = viewers.low, viewers.high
    assert (high - low)[len(low) // 2 :, :2].max() <= 3.0
    for i in range(len(low) // 2):
        one, other = 2 * i + 1, 2 * i + 2
        assert np.array_equal(low[one], low[i]) and np.array_equal(high[other], high[i])
        volumes = (np.prod((high - low)[k]) for k in (one, other, i))
        assert sum(itertools.islice(volumes, 2)) == pytest.approx(next(volumes))
