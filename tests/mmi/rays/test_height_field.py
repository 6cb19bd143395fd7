"""Height fields against triangles clipped to one cell after the other."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from triangle_soups import corners_of, mesh_from, points_on

from mmi.appearance.city_mesh import build_city_mesh
from mmi.foundation.errors import ParameterError
from mmi.rays.height_field import HeightField, height_field

ONE_WALL = [[(0.5, 0.5, 0), (10.5, 10.5, 0), (10.5, 10.5, 9)], [(0.5, 0.5, 0), (10.5, 10.5, 9), (0.5, 0.5, 9)]]


def clipped(polygon, axis, limit, sign):
    """The part of a polygon (a list of points) on one side of a plane."""
    kept = []
    for a, b in zip(polygon, polygon[1:] + polygon[:1], strict=True):
        da, db = sign * (a[axis] - limit), sign * (b[axis] - limit)
        if da >= 0.0:
            kept.append(a)
        if (da > 0.0 > db) or (da < 0.0 < db):
            kept.append(a + da / (da - db) * (b - a))
    return kept


def highest_in(triangles, low, high):
    """The highest z of triangles in a closed rectangle, -inf where they miss it."""
    best = -math.inf
    for triangle in triangles:
        polygon = list(triangle)
        for axis in (0, 1):
            polygon = clipped(polygon, axis, low[axis], 1.0)
            polygon = clipped(polygon, axis, high[axis], -1.0) if polygon else []
        best = max([best, *(float(point[2]) for point in polygon)])
    return best


def check_against_clipping(triangles, step):
    """Each cell between what is well inside of it, and what is in it or a hair beside it."""
    field = height_field(mesh_from(triangles), step=step)
    triangles = np.asarray(triangles, dtype=np.float32).astype(np.float64)
    base, hair = field.levels[0], 1e-6 * step
    for r, c in np.ndindex(base.shape):
        low = np.array(field.corner) + np.array([c, r]) * step
        assert base[r, c] >= highest_in(triangles, low + hair, low + step - hair) - 1e-4
        assert base[r, c] <= highest_in(triangles, low - hair, low + step + hair) + 1e-4


grid_points = st.tuples(*[st.integers(-6, 6)] * 3)
free_points = st.tuples(*[st.floats(-6.0, 6.0, width=32)] * 3)
triangles_of_points = st.lists(
    st.one_of(st.tuples(*[grid_points] * 3), st.tuples(*[free_points] * 3)), min_size=1, max_size=3
)


@settings(max_examples=80, deadline=None)
@given(triangles_of_points, st.sampled_from([0.5, 1.0, 1.7, 5.0, 40.0]))
def test_a_cell_is_as_high_as_what_is_in_it(triangles, step):
    check_against_clipping(triangles, step)


@pytest.mark.parametrize("turn", np.linspace(0.0, math.pi, 9))
def test_upright_walls_stay_narrow(turn):
    c, s = math.cos(turn), math.sin(turn)
    triangles = np.array(ONE_WALL) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    check_against_clipping(triangles, 1.0)
    base = height_field(mesh_from(triangles), step=1.0).levels[0]
    assert np.isfinite(base).sum() <= 2.0 * 10.0 * math.sqrt(2.0) + 3
    assert (base[np.isfinite(base)] == 9.0).all()


def test_a_slope_does_not_lift_its_foot():
    triangles = [[(0, 0, 0), (0, 10, 0), (20, 0, 20)], [(0, 10, 0), (20, 10, 20), (20, 0, 20)]]
    base = height_field(mesh_from(triangles), step=1.0).levels[0]
    assert base.shape == (11, 21)
    np.testing.assert_allclose(base[:10, :20], np.broadcast_to(np.arange(1.0, 21.0), (10, 20)), atol=1e-5)


def test_levels_are_maxima(two_hilly_blocks):
    field = height_field(two_hilly_blocks, step=1.3)
    for below, above in zip(field.levels[:-1], field.levels[1:], strict=True):
        for r, c in np.ndindex(above.shape):
            assert above[r, c] == below[2 * r : 2 * r + 2, 2 * c : 2 * c + 2].max()
    assert field.levels[-1].shape == (1, 1)
    assert field.levels[-1][0, 0] == two_hilly_blocks.positions[:, 2].max()


def test_every_point_is_under_its_cell(two_hilly_blocks):
    field = height_field(two_hilly_blocks, step=0.7)
    points = points_on(corners_of(two_hilly_blocks), 20_000, np.random.default_rng(2))
    c, r = ((points[:, :2] - field.corner) / field.step).astype(int).T
    high = np.maximum.reduce([field.levels[0][r, c]])
    near = (np.abs((points[:, :2] - field.corner) / field.step % 1.0 - 0.5) > 0.499).any(axis=1)
    assert (high[~near] >= points[~near, 2] - 1e-4).all()
    assert near.mean() < 0.1


def test_the_step_grows_with_the_city():
    small = height_field(mesh_from([[(0, 0, 0), (30, 0, 1), (0, 30, 2)]]))
    large = height_field(mesh_from([[(0, 0, 0), (30_000, 0, 1), (0, 30_000, 2)]]))
    line = height_field(mesh_from([[(0, 0, 0), (3e6, 0, 1), (3e6, 0, 2)]]))
    assert small.step == 0.5
    assert 7.4 < large.step < 7.6
    assert all(field.levels[0].size <= 16.1e6 for field in (large, line))


def test_nothing_gives_an_empty_field():
    field = height_field(mesh_from(np.empty((0, 3, 3))))
    assert [level.tolist() for level in field.levels] == [[[-math.inf]]]


@pytest.mark.parametrize("step", [0.0, -1.0, math.inf, math.nan])
def test_a_step_is_a_length(step):
    with pytest.raises(ParameterError, match="step is a length"):
        height_field(mesh_from(ONE_WALL), step=step)


def test_a_step_may_be_too_short():
    with pytest.raises(ParameterError, match=r"at most 256000000 cells expected, found 100001 x 100001"):
        height_field(mesh_from(ONE_WALL), step=1e-4)


def test_levels_halve():
    with pytest.raises(ValueError, match=r"halve down to one cell expected, found shapes \[\[2, 3\], \[1, 1\]\]"):
        HeightField((0.0, 0.0), 1.0, (np.zeros((2, 3), np.float32), np.zeros((1, 1), np.float32)))


@pytest.fixture(scope="module")
def two_hilly_blocks():
    from hills import hilly_city

    return build_city_mesh(hilly_city(3, count=12, size=60.0))
