"""Cells around a place and along a path, held against the definitions written out; cells spread over a city."""

import math

import networkx as nx
import numpy as np
import pytest
import shapely
from cities import HELSINKI, crossroads
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import LineString, Point, Polygon, box

from mmi.cells.choice import along, around, spread
from mmi.cells.viewing_cells import ViewingCell, viewing_cells
from mmi.cells.whereabouts import HYSTERESIS, Whereabouts
from mmi.foundation.errors import ParameterError
from mmi.reading.read_city import read_city

NOWHERE = st.tuples(st.floats(-90.0, 90.0), st.floats(-90.0, 90.0))


def cell(name, p, q, half_width=3.0):
    return ViewingCell(name, p, q, half_width, (1.5, 1.9))


@st.composite
def street_graphs(draw):
    """Cells between some neighbouring nodes of a bent grid, joined where they share one: dead ends, islands, crossings."""
    side = draw(st.integers(2, 4))
    bend = st.floats(-6.0, 6.0)
    nodes = {
        (i, j): (40.0 * i - 60.0 + draw(bend), 40.0 * j - 60.0 + draw(bend)) for i in range(side) for j in range(side)
    }
    pairs = [(a, b) for a in nodes for b in nodes if a < b and abs(a[0] - b[0]) + abs(a[1] - b[1]) == 1]
    kept = draw(st.lists(st.sampled_from(pairs), min_size=1, max_size=16, unique=True))
    graph = nx.Graph()
    for i, (a, b) in enumerate(kept):
        graph.add_node(f"{i:04d}-00", cell=cell(f"{i:04d}-00", nodes[a], nodes[b], draw(st.floats(0.3, 8.0))))
    for i, one in enumerate(kept):
        graph.add_edges_from((f"{i:04d}-00", f"{j:04d}-00") for j in range(i) if set(one) & set(kept[j]))
    return graph


def region(graph, name):
    return Polygon(graph.nodes[name]["cell"].corners)


def walked_to(graph, start, close):
    """Cells reached from ``start`` through ``close`` ones: grown until nothing more comes."""
    found = {start}
    while more := {name for name in close - found if found & set(graph.neighbors(name))}:
        found |= more
    return found


@settings(deadline=None)
@given(street_graphs(), NOWHERE, st.floats(0.5, 200.0), st.sampled_from([0.0, 5.0, 30.0]))
def test_around_is_what_can_be_walked_to_through_cells_within_the_radius(graph, where, radius, size):
    place = Point(where) if size == 0.0 else box(where[0], where[1], where[0] + size, where[1] + size / 2)
    away = {name: region(graph, name).distance(place) for name in graph}
    close = {name for name, metres in away.items() if metres <= radius}
    if not close:
        with pytest.raises(ParameterError, match=f"found none, the nearest is {min(away.values()):.0f} m away"):
            around(graph, place, radius)
        return
    found = around(graph, place, radius)
    assert away[found.start] == pytest.approx(min(away.values()), abs=1e-6)
    assert list(found.names) == [name for name in graph if name in walked_to(graph, found.start, close)]
    assert found.apart == len(close) - len(found.names)
    assert nx.is_connected(graph.subgraph(found.names))


def test_around_starts_in_the_cell_whose_axis_is_nearest_of_those_that_hold_the_place():
    graph = nx.Graph()
    graph.add_node("wide", cell=cell("wide", (0.0, 5.0), (40.0, 5.0), 9.0))
    graph.add_node("narrow", cell=cell("narrow", (0.0, 0.0), (40.0, 0.0), 3.0))
    assert around(graph, Point(20.0, 1.0), 1.0).start == "narrow"
    assert around(graph, Point(20.0, 2.9), 1.0).start == "wide"
    assert around(graph, Point(20.0, 1.0), 1.0).apart == 1


def test_around_leaves_out_a_street_that_comes_near_again_after_it_went_away():
    """A hairpin: its second arm is within the radius, the bend is not."""
    corners = [(0.0, 0.0), (100.0, 0.0), (100.0, 30.0), (0.0, 30.0)]
    graph = nx.path_graph(["a", "b", "c"])
    for name, p, q in zip("abc", corners[:-1], corners[1:], strict=True):
        graph.nodes[name]["cell"] = cell(name, p, q)
    assert around(graph, Point(0.0, 0.0), 40.0).names == ("a",)
    assert around(graph, Point(0.0, 0.0), 40.0).apart == 1
    assert around(graph, Point(0.0, 0.0), 100.0).names == ("a", "b", "c")


@pytest.mark.parametrize("radius", [0.0, -1.0, math.nan, math.inf])
def test_around_needs_a_radius(radius):
    with pytest.raises(ParameterError, match="a radius of more than 0 m expected"):
        around(viewing_cells(crossroads()), Point(0.0, 0.0), radius)


def visited(whereabouts, path):
    """The cells that a viewer is in who passes the points of ``path``, one in each frame."""
    cells = []
    for point in path:
        cells.append(whereabouts.cell_at(point, current=cells[-1] if cells else None))
    return cells


@settings(max_examples=60, deadline=None)
@given(street_graphs(), st.lists(NOWHERE, min_size=1, max_size=4), st.integers(1, 40), st.integers(0, 100))
def test_along_a_path_the_viewer_is_in_the_same_cells_as_if_all_were_there(graph, corners, stride, first):
    line = LineString(corners) if len(set(corners)) > 1 else None
    steps = np.arange(0.0, line.length, 0.25) if line is not None else [0.0]
    path = np.array([(line.interpolate(step) if line is not None else Point(corners[0])).coords[0] for step in steps])
    if min(region(graph, name).distance(Point(*point)) for name in graph for point in path) > HYSTERESIS:
        with pytest.raises(ParameterError, match="a path along the streets expected, found one that stays"):
            along(graph, path)
        return
    names = along(graph, path)
    everything, chosen = (Whereabouts(tuple(graph.nodes[name]["cell"] for name in some), {}) for some in (graph, names))
    frames = path[min(first, len(path) - 1) :: stride]
    assert visited(chosen, frames) == visited(everything, frames)
    # And no more than that: each is where some viewer would be who is put there.
    assert set(names) == {everything.cell_at(point, current=None) for point in path}


def test_along_down_a_street_takes_that_street_and_not_its_sides():
    graph = viewing_cells(crossroads())
    path = np.column_stack([np.arange(-150.0, 140.0, 0.1), np.zeros(2900)])
    names = along(graph, path)
    assert {graph.nodes[name]["cell"].street for name in names} == {"street 0", "street 1"}
    assert nx.is_connected(graph.subgraph(names))


def test_along_needs_a_path():
    with pytest.raises(ParameterError, match="cells and points expected, found 16 and 0"):
        along(viewing_cells(crossroads()), np.zeros((0, 2)))


def test_a_path_through_helsinki_meets_a_cell_at_every_step():
    graph = viewing_cells(read_city(HELSINKI)[0])
    route = nx.shortest_path(
        graph, *[around(graph, Point(*place), 500.0).start for place in ((-300, -500), (300, 600))]
    )
    path = shapely.segmentize(LineString([graph.nodes[name]["cell"].reference[:2] for name in route]), 0.5)
    names = along(graph, shapely.get_coordinates(path))
    assert set(route) <= set(names)
    assert len(names) < 3 * len(route)
    assert nx.is_connected(graph.subgraph(names))


def test_spread_is_even_and_nested():
    graph = nx.Graph()
    for i in range(8):
        graph.add_node(f"{i:04d}-00", cell=cell(f"{i:04d}-00", (10.0 * i, 0.0), (10.0 * i + 10.0, 0.0)))
    assert spread(graph, 4) == ["0000-00", "0004-00", "0002-00", "0006-00"]
    assert spread(graph, 5)[:3] == spread(graph, 3)
    assert sorted(spread(graph, 99)) == list(graph)
    with pytest.raises(ParameterError):
        spread(graph, 0)


def test_spread_takes_every_cell_once_even_where_cells_coincide():
    graph = nx.Graph()
    for name in ("a", "b", "c"):
        graph.add_node(name, cell=cell(name, (0.0, 0.0), (1.0, 0.0), 1.0))
    assert sorted(spread(graph, 3)) == ["a", "b", "c"]
