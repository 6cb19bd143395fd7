"""Places along lines are those that shapely finds by walking along all of them; stretches of streets run as their sources."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import LineString, Point

from mmi.reading.along_lines import nearest_places, points_along
from mmi.reading.maps.streets import _split_where_touching
from mmi.reading.maps.sumo import _are_close, _mean_line
from mmi.reading.raw_layers import RawStreet

corner = st.tuples(st.integers(0, 12), st.integers(0, 12))
line = st.lists(corner, min_size=2, max_size=8).map(LineString).filter(lambda one: one.length > 0)


@settings(max_examples=60, deadline=None)
@given(lines=st.lists(line, min_size=1, max_size=5), places=st.lists(corner, min_size=1, max_size=6))
def test_the_nearest_line_and_the_place_on_it_are_those_that_shapely_finds_one_by_one(lines, places):
    shapes, points = np.array(lines, dtype=object), np.array([Point(one) for one in places], dtype=object)
    found, along = nearest_places(shapes, points)
    for point, nearest, metres in zip(points, found, along, strict=True):
        assert nearest == int(np.argmin(shapely.distance(shapes, point)))
        assert metres == pytest.approx(shapely.line_locate_point(shapes[nearest], point))


@settings(max_examples=60, deadline=None)
@given(lines=st.lists(line, min_size=1, max_size=4), share=st.floats(-0.2, 1.2))
def test_points_along_lines_are_those_that_shapely_interpolates(lines, share):
    shapes = np.array(lines, dtype=object)
    which = np.arange(len(lines))[::-1]
    metres = share * shapely.length(shapes[which])
    expected = shapely.line_interpolate_point(shapes[which], np.maximum(metres, 0.0))
    assert points_along(shapes, which, metres) == pytest.approx(shapely.get_coordinates(expected), abs=1e-9)


def split(*lines):
    streets = [RawStreet(str(i), (one,), {"highway": "residential"}) for i, one in enumerate(lines)]
    return _split_where_touching(streets, [street.lines for street in streets], "streets")


@settings(max_examples=60, deadline=None)
@given(lines=st.lists(line.filter(lambda one: one.is_simple and not one.is_closed), min_size=1, max_size=4))
def test_stretches_run_as_the_streets_that_they_are_of(lines):
    for piece in split(*lines):
        source = lines[piece.street]
        start, end = (source.project(Point(piece.line.coords[k])) for k in (0, -1))
        assert start < end


def test_a_street_that_crosses_itself_is_run_in_one_direction():
    loop = LineString([(0, 0), (30, 0), (30, 20), (10, 20), (10, -20)])  # meets itself in (10, 0)
    assert [list(piece.line.coords) for piece in split(loop)] == [
        [(0, 0), (10, 0)],
        [(10, 0), (30, 0), (30, 20), (10, 20), (10, 0)],
        [(10, 0), (10, -20)],
    ]


def test_a_street_of_many_corners_is_split_where_others_cross_it():
    x = np.linspace(0.0, 20_000.0, 50_001)
    wave = LineString(np.column_stack([x, 10.0 * np.sin(x / 50.0)]))
    crossings = 500
    others = [LineString([(40.0 * k + 7.0, -50.0), (40.0 * k + 7.0, 50.0)]) for k in range(crossings)]
    pieces = split(wave, *others)
    assert len(pieces) == 1 + 3 * crossings
    own = [piece.line for piece in pieces if piece.street == 0]
    assert len(own) == 1 + crossings
    assert all(a.coords[-1] == b.coords[0] for a, b in pairwise(own))


millimetres = st.integers(0, 40_000).map(lambda number: number / 1000.0)  # the squares of smaller lengths may be 0
directions = st.lists(st.tuples(millimetres, millimetres), min_size=2, max_size=6)


@given(directions, directions)
def test_directions_are_close_by_the_distance_of_hausdorff(one, other):
    distance = shapely.hausdorff_distance(LineString(one), LineString(other))
    if abs(distance - 12.0) > 1e-6:
        assert _are_close(np.array(one), np.array(other)) == (distance < 12.0)


def test_directions_of_many_corners_are_compared_and_joined():
    x = np.linspace(0.0, 20_000.0, 100_001)
    there = np.column_stack([x, np.sin(x / 50.0)])
    back = there[:-1] + np.array([0.0, 4.0])
    assert _are_close(there, back)
    assert not _are_close(there, back + np.array([0.0, 20.0]))
    middle = _mean_line([there, back])
    assert len(middle) == 1001
    assert middle[0] == pytest.approx((0.0, 2.0))
    assert np.abs(middle[:, 1] - 2.0 - np.sin(middle[:, 0] / 50.0)).max() < 0.2
