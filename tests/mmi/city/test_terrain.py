"""The height field against SciPy's interpolation and brute force over its grid."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator
from shapely.geometry import LineString, box

from mmi.city.terrain import Terrain
from mmi.foundation.errors import CityError

TERRAINS = st.builds(
    lambda rows, columns, x, y, spacing, seed: Terrain(
        (x, y), spacing, np.random.default_rng(seed).normal(50.0, 20.0, (rows, columns))
    ),
    st.integers(2, 7),
    st.integers(2, 9),
    st.floats(-5000.0, 5000.0),
    st.floats(-5000.0, 5000.0),
    st.floats(0.25, 60.0),
    st.integers(0, 999),
)


def axes(terrain):
    """x (columns,) and y (rows,) of the grid's lines."""
    rows, columns = terrain.heights.shape
    x, y = terrain.origin
    return x + terrain.spacing * np.arange(columns), y + terrain.spacing * np.arange(rows)


def around(terrain, count, seed, *, beyond):
    """(count, 2) points of the terrain's rectangle and ``beyond`` of its size around it."""
    low, high = np.array(terrain.bounds).reshape(2, 2)
    rng = np.random.default_rng(seed)
    return low + (high - low) * rng.uniform(-beyond, 1.0 + beyond, (count, 2))


@given(TERRAINS, st.integers(0, 99))
def test_it_is_bilinear(terrain, seed):
    xs, ys = axes(terrain)
    plain = RegularGridInterpolator((ys, xs), terrain.heights, bounds_error=False, fill_value=None)
    points = around(terrain, 200, seed, beyond=0.0)
    assert terrain.at(points) == pytest.approx(plain(points[:, ::-1]), abs=1e-6)


@given(TERRAINS)
def test_on_the_grid_it_is_the_heights_themselves(terrain):
    grid = np.stack(np.meshgrid(*axes(terrain)), axis=-1)
    assert terrain.at(grid) == pytest.approx(terrain.heights, abs=1e-6)
    assert terrain.at(np.dstack([grid, np.full(grid.shape[:2], 7.0)])).shape == terrain.heights.shape


@given(TERRAINS, st.integers(0, 99))
def test_beyond_its_border_it_is_as_high_as_the_nearest_point(terrain, seed):
    points = around(terrain, 200, seed, beyond=3.0)
    low, high = np.array(terrain.bounds).reshape(2, 2)
    assert terrain.at(points) == pytest.approx(terrain.at(np.clip(points, low, high)), abs=1e-9)
    assert terrain.heights.min() - 1e-9 <= terrain.at(points).min()
    assert terrain.at(points).max() <= terrain.heights.max() + 1e-9


def test_along_the_lines_of_the_grid_it_is_straight():
    terrain = Terrain((10.0, 20.0), 5.0, [[0.0, 10.0, 4.0], [2.0, 6.0, 8.0]])
    assert terrain.at([12.5, 20.0]) == 5.0
    assert terrain.at([12.5, 22.5]) == pytest.approx(4.5)
    assert terrain.at([[20.0, 24.0], [99.0, 99.0]]) == pytest.approx([7.2, 8.0])
    assert terrain.bounds == (10.0, 20.0, 20.0, 25.0)


@given(TERRAINS, st.integers(0, 99), st.sampled_from([0.0, 0.1, 1.0]))
def test_the_range_over_a_box_holds_all_ground_in_it(terrain, seed, size):
    low = around(terrain, 12, seed, beyond=0.6)
    extent = np.ptp(np.array(terrain.bounds).reshape(2, 2), axis=0)
    rng = np.random.default_rng(seed)
    boxes = np.hstack([low, low + size * extent * rng.random((12, 2))])
    lowest, highest = terrain.range_over(boxes)
    inside = boxes[:, None, :2] + rng.random((12, 300, 2)) * (boxes[:, None, 2:] - boxes[:, None, :2])
    found = terrain.at(inside)
    assert (lowest <= found.min(axis=1) + 1e-9).all()
    assert (found.max(axis=1) <= highest + 1e-9).all()
    # Exact to the squares that a box touches: nothing else counts.
    xs, ys = axes(terrain)
    step = terrain.spacing * (1.0 + 1e-9)
    nearest = np.clip(boxes.reshape(-1, 2, 2), *np.array(terrain.bounds).reshape(2, 2)).reshape(-1, 4)
    for (x0, y0, x1, y1), least, most in zip(nearest, lowest, highest, strict=True):
        touched = terrain.heights[np.ix_((ys >= y0 - step) & (ys <= y1 + step), (xs >= x0 - step) & (xs <= x1 + step))]
        assert touched.min() <= least <= most <= touched.max()


def test_the_range_over_whole_squares_is_that_of_their_corners():
    terrain = Terrain((0.0, 0.0), 10.0, np.arange(20.0).reshape(4, 5))
    lowest, highest = terrain.range_over(
        [[10.0, 10.0, 20.0, 20.0], [11.0, 12.0, 12.0, 19.0], [-90.0, -90.0, -50.0, -1.0]]
    )
    assert lowest.tolist() == [6.0, 6.0, 0.0]
    assert highest.tolist() == [12.0, 12.0, 0.0]
    assert [len(one) for one in terrain.range_over(np.empty((0, 4)))] == [0, 0]


@given(TERRAINS, st.integers(0, 99))
def test_heights_at_corners_are_those_of_one_shape_after_the_other(terrain, seed):
    places = around(terrain, 12, seed, beyond=0.3)
    shapes = [box(*places[0], *(places[0] + 3.0)), *(LineString(some) for some in (places[1:4], places[4:12]))]
    heights, starts = terrain.at_corners(shapes)
    for shape, found in zip(shapes, np.split(heights, starts[1:]), strict=True):
        points = shape.exterior.coords if shape.geom_type == "Polygon" else shape.coords
        assert found == pytest.approx([float(terrain.at(one)) for one in points])


def test_heights_cannot_be_changed():
    terrain = Terrain((0.0, 0.0), 1.0, np.zeros((2, 2)))
    with pytest.raises(ValueError, match="read-only"):
        terrain.heights[0, 0] = 1.0


@pytest.mark.parametrize("heights", [[[0.0, 1.0]], [[0.0], [1.0]], [0.0, 1.0], [[0.0, math.nan], [0.0, 0.0]]])
def test_heights_that_are_no_terrain(heights):
    with pytest.raises(CityError, match="2 x 2 or more, found shape"):
        Terrain((0.0, 0.0), 1.0, np.array(heights))


@pytest.mark.parametrize(
    ("origin", "spacing"),
    [((0.0, 0.0), 0.0), ((0.0, 0.0), -1.0), ((0.0, 0.0), math.inf), ((0.0, 0.0), math.nan), ((math.nan, 0.0), 1.0)],
)
def test_grids_that_are_nowhere(origin, spacing):
    with pytest.raises(CityError, match="positive spacing, found"):
        Terrain(origin, spacing, np.zeros((2, 2)))
