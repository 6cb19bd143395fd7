"""Which cell a viewer is in, held against shapely and the definition."""

import itertools
import math

import networkx as nx
import numpy as np
import pytest
import shapely
from cities import crossroads
from hypothesis import given
from hypothesis import strategies as st

from mmi.cells.viewing_cells import ViewingCell, viewing_cells
from mmi.cells.whereabouts import HYSTERESIS, Whereabouts
from mmi.foundation.errors import ParameterError


def cell(name, p, q, half_width=3.0):
    return ViewingCell(name, p, q, half_width, (1.5, 1.9))


def road(n, *, length=20.0):
    """n cells one after the other along x, each a neighbour of the next."""
    names = [f"{i:04d}-00" for i in range(n)]
    cells = [cell(name, (length * i, 0.0), (length * (i + 1), 0.0)) for i, name in enumerate(names)]
    return cells, {name: [names[j] for j in (i - 1, i + 1) if 0 <= j < n] for i, name in enumerate(names)}


def eye(x, y=0.0):
    return np.array([x, y, 1.7])


NUMBERS = st.floats(-100.0, 100.0)
CELLS = st.lists(
    st.builds(
        lambda x, y, length, angle, width: (
            ((x, y), (x + length * math.cos(angle), y + length * math.sin(angle)), width)
        ),
        NUMBERS,
        NUMBERS,
        st.floats(0.5, 60.0),
        st.floats(0.0, 6.28),
        st.floats(0.2, 10.0),
    ),
    min_size=1,
    max_size=8,
).map(lambda rows: [cell(str(i), *row) for i, row in enumerate(rows)])


def shapely_distance(one, x, y):
    return shapely.distance(shapely.Polygon(one.corners), shapely.Point(x, y))


@given(CELLS, NUMBERS, NUMBERS)
def test_distances_are_shapelys(cells, x, y):
    found = Whereabouts(cells, {}).distances(eye(x, y))
    assert found == pytest.approx([shapely_distance(one, x, y) for one in cells], abs=1e-9)


@given(CELLS, NUMBERS, NUMBERS)
def test_a_viewer_from_nowhere_is_in_the_nearest_cell(cells, x, y):
    found = cells[int(Whereabouts(cells, {}).cell_at(eye(x, y), current=None))]
    away = [shapely_distance(one, x, y) for one in cells]
    assert shapely_distance(found, x, y) <= min(away) + 1e-9
    inside = [one for one, distance in zip(cells, away, strict=True) if distance == 0.0]
    if found in inside:
        axes = [shapely.distance(shapely.LineString([one.p, one.q]), shapely.Point(x, y)) for one in inside]
        assert axes[inside.index(found)] <= min(axes) + 1e-9


@given(CELLS, NUMBERS, NUMBERS, st.lists(st.floats(0.0, 6.28), max_size=6), st.floats(0.0, 0.999 * HYSTERESIS))
def test_moving_less_than_the_margin_never_changes_cells_twice(cells, x, y, directions, step):
    whereabouts = Whereabouts(cells, {})
    current = whereabouts.cell_at(eye(x, y), current=None)
    if whereabouts.distances(eye(x, y))[int(current)] > 0.0:  # off all streets there is no promise
        return
    for direction in directions:  # to and fro within the margin of (x, y)
        place = eye(x + step * math.cos(direction), y + step * math.sin(direction))
        assert whereabouts.cell_at(place, current=current) == current


@given(CELLS, NUMBERS, NUMBERS, st.integers(0, 7))
def test_a_cell_is_kept_just_as_far_as_the_margin(cells, x, y, number):
    before = cells[number % len(cells)]
    whereabouts = Whereabouts(cells, {})
    away = shapely_distance(before, x, y)
    expected = before.id if away <= HYSTERESIS else whereabouts.cell_at(eye(x, y), current=None)
    if abs(away - HYSTERESIS) > 1e-6:
        assert whereabouts.cell_at(eye(x, y), current=before.id) == expected


def test_along_a_road_cells_change_half_a_metre_late_both_ways():
    cells, neighbours = road(3)
    whereabouts = Whereabouts(cells, neighbours)
    walked = np.arange(10.0, 50.0, 0.01)
    for places, changes in ((walked, [20.5, 40.5]), (walked[::-1], [39.5, 19.5])):
        current, found = None, []
        for x in places:
            name = whereabouts.cell_at(eye(x), current=current)
            if current not in (None, name):
                found.append(x)
            current = name
        assert found == pytest.approx(changes, abs=0.011)


def test_where_cells_overlap_the_nearest_axis_decides_and_then_the_order():
    cells = [cell("a", (-20.0, 0.0), (20.0, 0.0)), cell("b", (0.0, -20.0), (0.0, 20.0))]
    for order in (cells, cells[::-1]):
        whereabouts = Whereabouts(order, {})
        assert whereabouts.cell_at(eye(2.0, 1.0), current=None) == "a"
        assert whereabouts.cell_at(eye(1.0, 2.0), current=None) == "b"
        assert whereabouts.cell_at(eye(1.0, 1.0), current=None) == order[0].id
        assert whereabouts.cell_at(eye(2.0, 1.0), current="b") == "b"


def test_off_the_streets_the_nearest_rectangle_counts_not_the_nearest_axis():
    wide, narrow = cell("wide", (0.0, 0.0), (20.0, 0.0), 8.0), cell("narrow", (0.0, 17.0), (20.0, 17.0), 1.0)
    assert Whereabouts([narrow, wide], {}).cell_at(eye(10.0, 11.0), current="narrow") == "wide"


# ------------------------------------------------------------------------------------------------------------ ahead


def test_what_lies_ahead_along_a_road():
    cells, neighbours = road(9)
    whereabouts = Whereabouts(cells, neighbours)
    here = cells[4].id  # from 80 to 100

    def ahead(x, heading, **options):
        return [int(name[:4]) for name in whereabouts.ahead(eye(x), here, heading, **options)]

    assert ahead(90.0, (1.0, 0.0), reach=15.0) == [5, 3]
    assert ahead(90.0, (-3.0, 0.0), reach=15.0) == [3, 5]
    assert ahead(89.0, None, reach=15.0) == [3, 5]
    assert ahead(90.0, None, reach=15.0) == [3, 5]
    assert ahead(90.0, (0.0, 0.0), reach=15.0) == [3, 5]
    assert ahead(99.0, (1.0, 0.0), reach=41.5) == [5, 6, 3, 7, 2]
    assert ahead(99.0, (1.0, 0.0), reach=0.5) == []
    assert set(ahead(90.0, (1.0, 0.0))) == {1, 2, 3, 5, 6, 7}


def test_nothing_is_ahead_beyond_cells_that_are_not_there():
    cells, neighbours = road(5)
    whereabouts = Whereabouts([one for one in cells if one.id != "0002-00"], neighbours)
    assert whereabouts.ahead(eye(30.0), "0001-00", (1.0, 0.0)) == ("0000-00",)


def test_close_by_but_not_reachable_is_not_ahead():
    cells, neighbours = road(2)
    beside = cell("beside", (0.0, 7.0), (40.0, 7.0))
    assert Whereabouts([beside, *cells], neighbours).ahead(eye(10.0), cells[0].id, None) == (cells[1].id,)


@given(
    st.floats(-60.0, 60.0),
    st.floats(-60.0, 60.0),
    st.integers(0, 9),
    st.none() | st.floats(0.0, 6.28),
    st.floats(1.0, 90.0),
)
def test_ahead_is_what_its_definition_says(x, y, number, direction, reach):
    cells, neighbours, graph = CROSSROADS
    here = cells[number % len(cells)].id
    away = {one.id: shapely_distance(one, x, y) for one in cells}
    if min(abs(distance - reach) for distance in away.values()) < 1e-6:
        return
    close = graph.subgraph([name for name in graph if away[name] <= reach or name == here])
    expected = nx.node_connected_component(close, here) - {here}
    heading = None if direction is None else (math.cos(direction), math.sin(direction))
    point = (x, y) if heading is None else (x + 10.0 * heading[0], y + 10.0 * heading[1])
    found = Whereabouts(cells, neighbours).ahead(eye(x, y), here, heading, reach=reach)
    assert set(found) == expected
    assert len(set(found)) == len(found)
    urgency = [shapely_distance(graph.nodes[name]["cell"], *point) for name in found]
    assert all(a <= b + 1e-9 for a, b in itertools.pairwise(urgency))


def _crossroads():
    graph = viewing_cells(crossroads(), max_length=12.0)
    return [graph.nodes[name]["cell"] for name in graph], {name: list(graph[name]) for name in graph}, graph


CROSSROADS = _crossroads()


# ----------------------------------------------------------------------------------------------------------- errors


def test_cells_are_needed_and_names_are_unique():
    with pytest.raises(ParameterError, match="at least one cell expected"):
        Whereabouts([], {})
    one = cell("a", (0.0, 0.0), (1.0, 0.0))
    with pytest.raises(ParameterError, match="cells of 2 different ids expected, found 1"):
        Whereabouts([one, one], {})


def test_an_unknown_cell_is_refused():
    cells, neighbours = road(2)
    whereabouts = Whereabouts(cells, neighbours)
    with pytest.raises(ParameterError, match="one of 2 cells expected, found 'elsewhere'"):
        whereabouts.cell_at(eye(0.0), current="elsewhere")
    with pytest.raises(ParameterError, match="found 'elsewhere'"):
        whereabouts.ahead(eye(0.0), "elsewhere", None)


def test_ten_thousand_cells_are_a_matter_of_arrays():
    cells, neighbours = road(10_000)
    whereabouts = Whereabouts(cells, neighbours)
    assert whereabouts.cells == tuple(cells)
    assert whereabouts.distances(eye(5.0, 4.0)).shape == (10_000,)
    assert whereabouts.cell_at(eye(100_001.0), current=None) == "5000-00"
    assert whereabouts.ahead(eye(100_010.0), "5000-00", (1.0, 0.0), reach=11.0) == ("5001-00", "4999-00")
