"""Tiles of a grid and their borders, by hand."""

import numpy as np
import pytest
import shapely

from mmi.appearance.ground_tiles import grid_lines, match_borders, tile_boxes


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


def test_boxes_go_row_by_row():
    boxes = tile_boxes(np.array([0.0, 1.0, 3.0]), np.array([10.0, 20.0, 25.0]))
    assert shapely.bounds(boxes).tolist() == [[0, 10, 1, 20], [1, 10, 3, 20], [0, 20, 1, 25], [1, 20, 3, 25]]


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
