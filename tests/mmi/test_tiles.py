"""Polygons cut along a grid: against shapely, one tile at a time; borders by hand."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import MultiPolygon, Polygon, box

from mmi.tiles import cut_polygons, grid_lines, match_borders


@pytest.mark.parametrize(
    ("low", "high", "spacing", "expected"),
    [
        (0.0, 10.0, 5.0, [0.0, 5.0, 10.0]),
        (-3.0, 8.0, 5.0, [-3.0, -3.0 + 11.0 / 3.0, -3.0 + 22.0 / 3.0, 8.0]),
        (2.0, 3.0, 200.0, [2.0, 3.0]),
        (2.0, 3.0, np.inf, [2.0, 3.0]),
    ],
)
def test_lines_are_even_and_at_most_so_far_apart(low, high, spacing, expected):
    lines = grid_lines(low, high, spacing=spacing)
    assert lines.tolist() == [float(np.float32(one)) for one in expected]


def shapes(seed):
    """Two neighbours of many corners on whole and half numbers, one with a hole; and a collection of two."""
    rng = np.random.default_rng(seed)
    left = Polygon([(0, 0), *((5 + rng.integers(-3, 4) / 2, y) for y in range(11)), (0, 10)])
    right = shapely.difference(box(0, 0, 10, 10), left)
    hole = box(*(rng.integers(2, 13, 2) / 2 + [[0], [1.5]]).ravel())
    left = shapely.difference(left, hole)
    return np.array([left, right, MultiPolygon([box(11, 0, 12, 1), box(11, 9, 12, 10)]), Polygon()], dtype=object)


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 2**31), st.sampled_from([1.0, 2.5, 3.0, 20.0]))
def test_pieces_are_what_each_tile_shows_of_each_shape(seed, spacing):
    given_shapes = shapes(seed)
    xs, ys = grid_lines(0.0, 12.0, spacing=spacing), grid_lines(0.0, 10.0, spacing=spacing)
    pieces, owners, tiles = cut_polygons(given_shapes, xs, ys)
    assert (np.diff(tiles * len(given_shapes) + owners) >= 0).all()
    for tile in range((len(xs) - 1) * (len(ys) - 1)):
        row, column = divmod(tile, len(xs) - 1)
        square = box(xs[column], ys[row], xs[column + 1], ys[row + 1])
        for i, shape in enumerate(given_shapes):
            mine = pieces[(tiles == tile) & (owners == i)]
            expected = shapely.intersection(shape, square)
            assert shapely.area(mine).sum() == pytest.approx(expected.area, abs=1e-9)
            assert shapely.union_all(mine).symmetric_difference(expected).area == pytest.approx(0.0, abs=1e-9)
            assert (shapely.get_type_id(mine) == shapely.GeometryType.POLYGON).all()


def test_a_vertex_on_a_border_is_put_into_the_triangle_on_the_other_side():
    #  3---2---5      2 and 3 triangles meet at x = 1; the right-hand ones have vertices 6 and 7 there that the left lacks
    points = np.array([[0, 0], [1, 0], [1, 4], [2, 0], [1, 0], [1, 4], [1, 1], [1, 3]], dtype=float)
    triangles = np.array([[0, 1, 2], [3, 6, 4], [3, 7, 6], [3, 5, 7], [4, 6, 7]])
    moved, cut, sources = match_borders(points, triangles, np.array([0.0, 1.0, 2.0]), np.array([0.0, 4.0]))
    assert moved[: len(points)].tolist() == points.tolist()
    left = [{tuple(moved[i]) for i in one} for one in cut if (moved[one][:, 0] < 1.0).any()]
    assert left == [{(0, 0), (1, 0), (1, 1)}, {(0, 0), (1, 1), (1, 3)}, {(0, 0), (1, 3), (1, 4)}]
    right = [one.tolist() for one in cut if (moved[one][:, 0] > 1.0).any()]
    assert right == [[3, 6, 4], [3, 7, 6], [3, 5, 7]]
    assert len(cut) == 6  # the triangle on the line is gone
    assert sources.tolist() == [*range(8), 1, 1]
    first, second, third = (moved[cut[:, i]] for i in range(3))
    turn = (second - first)[:, 0] * (third - first)[:, 1] - (second - first)[:, 1] * (third - first)[:, 0]
    assert (turn > 0.0).all()


def test_borders_that_match_stay_as_they_are():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [2.0, 0.0]])
    triangles = np.array([[0, 1, 2], [1, 3, 2]])
    moved, cut, sources = match_borders(points, triangles, np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0]))
    assert (moved.tolist(), cut.tolist(), sources.tolist()) == (points.tolist(), triangles.tolist(), [0, 1, 2, 3])
