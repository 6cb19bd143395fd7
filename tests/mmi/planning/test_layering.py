"""Event graphs, layers and panorama boxes: figure 4 of the paper, invariants on random graphs, networkx as the twin."""

import math

import networkx as nx
import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import affinity
from shapely.geometry import MultiPolygon, Point, Polygon, box

from mmi.cells.viewing_cells import ViewingCell
from mmi.foundation.errors import ParameterError
from mmi.parallax.critical_zone import interacting_pairs
from mmi.parallax.paper_weights import pair_weights
from mmi.planning.layering import (
    assign_layers,
    event_graph,
    layer_area,
    layers_greedy,
    layers_incremental,
    panorama_boxes,
)

STRATEGIES = ["best", "incremental", "largest-first", "smallest-last", "dsatur"]
CELL = ViewingCell("c", (0.0, 0.0), (30.0, 10.0), 3.0, (1.5, 1.9))


@st.composite
def graphs(draw):
    """An event graph on up to 12 objects (not numbered from zero), and boxes for them."""
    n = draw(st.integers(0, 12))
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    nodes = np.sort(rng.choice(1000, n, replace=False))
    pairs = np.stack(np.triu_indices(n, 1), axis=1)
    graph = event_graph(nodes, pairs, rng.uniform(0.0, 1.0, len(pairs)), threshold=rng.uniform(0.0, 1.0))
    start, low = rng.uniform(-math.pi, math.pi, n), rng.uniform(-0.1, 0.1, n)
    boxes = np.stack([start, start + rng.uniform(0.0, 1.0, n), low, low + rng.uniform(0.0, 1.0, n)], axis=1)
    return graph, boxes


# The event graph


def test_edges_are_the_pairs_above_the_threshold():
    graph = event_graph(
        np.array([7, 3, 9]), np.array([[2, 0], [0, 1], [1, 2]]), np.array([0.3, 0.1, 0.2]), threshold=0.1
    )
    assert list(graph) == [7, 3, 9]
    assert list(graph.edges(data="weight")) == [(7, 9, 0.3), (3, 9, 0.2)]


def test_landmarks_raise_the_weights_of_their_pairs():
    pairs, weights = np.array([[0, 1], [0, 2], [1, 2]]), np.array([0.1, 0.1, 0.1])
    graph = event_graph(np.array([4, 5, 6]), pairs, weights, threshold=0.15, factors={4: 2.0, 99: 3.0})
    assert list(graph.edges(data="weight")) == [(4, 5, 0.2), (4, 6, 0.2)]
    both = event_graph(np.array([4, 5, 6]), pairs, weights, threshold=0.15, factors={4: 2.0, 5: 3.0})
    assert both.edges[4, 5]["weight"] == pytest.approx(0.6)


@pytest.mark.parametrize("factor", [0.99, -1.0, float("nan"), float("inf")])
def test_a_factor_that_would_void_the_bound(factor):
    with pytest.raises(ParameterError, match=r"landmark factor.*object 4"):
        event_graph(np.array([4]), np.empty((0, 2), np.int64), np.empty(0), threshold=1.0, factors={4: factor})


def test_a_nonsense_threshold():
    with pytest.raises(ParameterError, match="threshold"):
        event_graph(np.array([4]), np.empty((0, 2), np.int64), np.empty(0), threshold=float("nan"))


def city(seed, n=25):
    rng = np.random.default_rng(seed)
    houses = []
    while len(houses) < n:
        bearing, distance = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(60.0, 300.0)
        w, h = rng.uniform(5.0, 25.0, 2)
        house = affinity.rotate(box(0, 0, w, h), rng.uniform(0, 90))
        house = affinity.translate(house, distance * math.cos(bearing), distance * math.sin(bearing))
        if all(house.distance(other) > 1.0 for other in houses):
            houses.append(house)
    return houses, rng.uniform(5.0, 30.0, n)


def graph_of(cell, houses, threshold):
    pairs = interacting_pairs(cell, houses)
    return event_graph(np.arange(len(houses)), pairs, pair_weights(cell, houses, pairs), threshold=threshold)


@pytest.mark.parametrize("seed", range(4))
def test_adding_an_object_never_removes_an_edge(seed):
    houses, _ = city(seed)
    whole = graph_of(CELL, houses, 0.05)
    fewer = graph_of(CELL, houses[:-1], 0.05)
    assert fewer.number_of_edges() > 0
    assert set(fewer.edges(data="weight")) <= set(whole.edges(data="weight"))


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("angle", [90.0, 143.0])
def test_moving_and_turning_the_city_changes_nothing(strategy, angle):
    houses, tops = city(7)

    def moved(shape):
        return affinity.translate(affinity.rotate(shape, angle, origin=(0, 0)), 2000.0, -300.0)

    def layers(cell, footprints):
        graph = graph_of(cell, footprints, 0.05)
        boxes = panorama_boxes(cell.reference, footprints, np.zeros(len(tops)), tops)
        return [layer.tolist() for layer in assign_layers(graph, boxes, strategy=strategy)]

    p, q = (moved(Point(x)).coords[0] for x in (CELL.p, CELL.q))
    turned = ViewingCell("c", p, q, CELL.half_width, CELL.eye)
    expected = layers(CELL, houses)
    assert len(expected) > 1
    assert layers(turned, [moved(one) for one in houses]) == expected


# Layers


@pytest.mark.parametrize("strategy", STRATEGIES)
@settings(deadline=None, max_examples=40)
@given(graphs())
def test_every_object_is_in_one_layer_and_no_layer_holds_an_event(strategy, case):
    graph, boxes = case
    layers = assign_layers(graph, boxes, strategy=strategy)
    assert np.sort(np.concatenate([[], *layers])).tolist() == sorted(graph)
    for layer in layers:
        assert layer.dtype == np.int64
        assert (np.diff(layer) > 0).all()
        assert graph.subgraph(layer.tolist()).number_of_edges() == 0
    firsts = [layer[0] for layer in layers]
    assert firsts == sorted(firsts)


@settings(deadline=None, max_examples=40)
@given(graphs())
def test_best_is_the_best(case):
    graph, boxes = case
    row = {node: i for i, node in enumerate(graph)}

    def cost(layers):
        return len(layers), round(sum(layer_area(boxes[[row[i] for i in layer.tolist()]]) for layer in layers), 9)

    best = cost(assign_layers(graph, boxes))
    assert best == min(cost(assign_layers(graph, boxes, strategy=name)) for name in STRATEGIES[1:])


FIGURE_4 = nx.Graph([(0, 1), (1, 2), (2, 3)])
FIGURE_4.add_node(4)
ROW = np.array([[0.1 * i, 0.1 * i + 0.1, 0.0, 1.0] for i in range(5)])


def test_grouping_is_not_unique():
    # As in figure 4: five blocks whose relations allow two layers; an unlucky order of the incremental algorithm
    # (both ends of the chain 0-1-2-3 first) takes three.
    assert len(layers_incremental(FIGURE_4, ROW)) == 2
    assert len(layers_incremental(FIGURE_4, ROW, order=[0, 3, 1, 2, 4])) == 3
    assert len(assign_layers(FIGURE_4, ROW)) == 2


def test_incremental_prefers_the_layer_that_stays_smallest():
    # Objects 0 and 1 exclude each other and lie far apart; 2 lies next to 1, 3 next to 0, and 4 conflicts with both.
    graph = nx.Graph([(0, 1), (4, 0), (4, 1)])
    graph.add_nodes_from([2, 3])
    starts = [0.0, 1.0, 1.2, -0.2, 0.5]
    boxes = np.array([[start, start + 0.1, 0.0, 0.5] for start in starts])
    layers = layers_incremental(graph, boxes[list(graph)], order=[0, 1, 2, 3, 4])
    assert [layer.tolist() for layer in layers] == [[0, 3], [1, 2], [4]]


def test_incremental_measures_across_the_seam_of_the_panorama():
    # Azimuth 3.1 is next to -3.1 (0.08 away), and 2.0 is far from both.
    graph = nx.Graph([(0, 1)])
    graph.add_node(2)
    boxes = np.array([[2.0, 2.1, 0.0, 0.5], [3.05, 3.1, 0.0, 0.5], [-3.1, -3.05, 0.0, 0.5]])
    assert [layer.tolist() for layer in layers_incremental(graph, boxes)] == [[0], [1, 2]]


def incremental_twin(graph, boxes):
    """Section 4.2 as it stands: the area of every layer with every node, from all boxes in it."""
    row, layers = {node: i for i, node in enumerate(graph)}, []
    for node in graph:
        areas = {
            i: round(layer_area(boxes[[row[other] for other in (*layer, node)]]), 9)
            for i, layer in enumerate(layers)
            if not any(graph.has_edge(node, other) for other in layer)
        }
        if areas:
            layers[min(areas, key=lambda i: (areas[i], i))].append(node)
        else:
            layers.append([node])
    return layers


@settings(deadline=None, max_examples=60)
@given(graphs())
def test_incremental_layers_are_those_of_a_twin(case):
    graph, boxes = case
    assert [layer.tolist() for layer in layers_incremental(graph, boxes)] == incremental_twin(graph, boxes)


def test_incremental_layers_of_many_objects_are_those_of_a_twin():
    rng = np.random.default_rng(5)
    pairs = np.stack(np.triu_indices(150, 1), axis=1)
    graph = event_graph(np.arange(150), pairs, rng.uniform(0.0, 1.0, len(pairs)), threshold=0.9)
    start, low = rng.uniform(-7.0, 7.0, 150), rng.uniform(-0.1, 0.1, 150)
    boxes = np.stack([start, start + rng.uniform(0.0, 2.0, 150), low, low + rng.uniform(0.0, 1.0, 150)], axis=1)
    assert [layer.tolist() for layer in layers_incremental(graph, boxes)] == incremental_twin(graph, boxes)


@pytest.mark.parametrize(
    ("strategy", "twin"), [("largest-first", "largest_first"), ("dsatur", "saturation_largest_first")]
)
@settings(deadline=None, max_examples=40)
@given(case=graphs())
def test_greedy_layers_are_the_colours_of_networkx(strategy, twin, case):
    graph, _ = case
    colors = nx.greedy_color(nx.relabel_nodes(graph, {node: i for i, node in enumerate(graph)}), strategy=twin)
    layers = layers_greedy(graph, strategy)
    assert {node: i for i, layer in enumerate(layers) for node in layer.tolist()} == {
        node: colors[i] for i, node in enumerate(graph)
    }


@settings(deadline=None, max_examples=40)
@given(graphs())
def test_smallest_last_takes_one_layer_more_than_the_graph_has_cores(case):
    """At most: its bound, that of networkx, which breaks ties otherwise."""
    graph, _ = case
    layers = layers_greedy(graph, "smallest-last")
    assert sorted(node for layer in layers for node in layer.tolist()) == sorted(graph)
    assert not any(graph.has_edge(a, b) for layer in layers for a in layer.tolist() for b in layer.tolist())
    assert len(layers) <= 1 + max(nx.core_number(graph).values(), default=-1)


@settings(deadline=None, max_examples=20)
@given(graphs())
def test_a_single_layer_holds_all_whatever_happens_between_them(case):
    graph, boxes = case
    layers = assign_layers(graph, boxes, strategy="single")
    assert [layer.tolist() for layer in layers] == ([sorted(graph)] if len(graph) else [])
    assert all(layer.dtype == np.int64 for layer in layers)


def test_a_single_layer_is_never_the_best_where_there_is_an_event():
    assert len(assign_layers(FIGURE_4, ROW, strategy="single")) == 1
    assert len(assign_layers(FIGURE_4, ROW)) > 1


def test_unknown_strategy():
    with pytest.raises(
        ParameterError, match=r"best or incremental or largest-first or .* or single or .*found 'random'"
    ):
        assign_layers(FIGURE_4, ROW, strategy="random")


# Boxes in the panorama


def test_box_of_a_house():
    eye = (0.0, 0.0, 2.0)
    house = box(10, -10, 20, 10)
    (row,) = panorama_boxes(eye, [house], [0.0], [12.0])
    # Azimuths of the near corners; the ground slopes most at the near wall (10 m), and so does the eaves' line.
    assert row == pytest.approx([-math.pi / 4, math.pi / 4, -0.2, 1.0])
    (low,) = panorama_boxes((0.0, 0.0, 20.0), [house], [0.0], [12.0])
    assert low[2:] == pytest.approx([-2.0, -8.0 / math.hypot(20, 10)])


def test_box_across_the_seam_around_the_eye_and_of_two_parts():
    behind = box(-20, -10, -10, 10)
    court = box(-50, -50, 50, 50).difference(box(-40, -40, 40, 40))
    horseshoe = court.difference(box(0, -1, 60, 1))
    parts = MultiPolygon([box(-20, 5, -10, 6), box(-20, -6, -10, -5)])
    boxes = panorama_boxes((0.0, 0.0, 2.0), [behind, court, horseshoe, parts], [0.0] * 4, [12.0] * 4)
    assert boxes[0, :2] == pytest.approx([3 * math.pi / 4, 5 * math.pi / 4])
    assert boxes[1, 1] - boxes[1, 0] == pytest.approx(2 * math.pi)
    gap = math.atan2(1, 50)
    assert boxes[2, :2] == pytest.approx([gap, 2 * math.pi - gap])
    assert boxes[3, :2] == pytest.approx([math.pi - math.atan2(6, 10), math.pi + math.atan2(6, 10)])
    assert panorama_boxes((0.0, 0.0, 0.0), [], [], []).shape == (0, 4)


@settings(deadline=None)
@given(seed=st.integers(0, 2**31))
def test_box_holds_the_solid(seed):
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(0, 2 * np.pi, 7))
    shape = Polygon(rng.uniform(2, 20, 7)[:, None] * np.stack([np.cos(t), np.sin(t)], axis=1)).buffer(0)
    shape = affinity.translate(shape, *rng.uniform(-60, 60, 2))
    eye = np.array([*rng.uniform(-5, 5, 2), 10.0])
    if shape.is_empty or shape.distance(Point(eye[:2])) < 0.1:
        return
    bottom, top = np.sort(rng.uniform(0.0, 20.0, 2))
    (row,) = panorama_boxes(eye, [shape], [bottom], [top])
    x0, y0, x1, y1 = shape.bounds
    points = rng.uniform((x0, y0, bottom), (x1, y1, top), (300, 3))
    points = points[shapely.contains_xy(shape, points[:, :2])] - eye
    turn = (np.arctan2(points[:, 1], points[:, 0]) - row[0]) % (2 * np.pi)
    slope = points[:, 2] / np.hypot(points[:, 0], points[:, 1])
    assert (turn <= row[1] - row[0] + 1e-12).all()
    assert ((row[2] - 1e-12 <= slope) & (slope <= row[3] + 1e-12)).all()
    # Tight: the walls reach all four sides of the box.
    wall = shapely.get_coordinates(shapely.segmentize(shape.boundary, 0.05)) - eye[:2]
    turn = (np.arctan2(wall[:, 1], wall[:, 0]) - row[0] + 1e-9) % (2 * np.pi)
    far = np.hypot(wall[:, 0], wall[:, 1])
    assert (turn.min(), turn.max()) == pytest.approx((0.0, row[1] - row[0]), abs=1e-6)
    assert ((top - eye[2]) / far).max() == pytest.approx(row[3], rel=1e-2, abs=1e-9)
    assert ((bottom - eye[2]) / far).min() == pytest.approx(row[2], rel=1e-2, abs=1e-9)


def test_area_of_a_layer():
    boxes = np.array([[3.0, 3.2, 0.0, 0.5], [-3.1, -3.0, -0.1, 0.2]])
    assert layer_area(boxes) == pytest.approx((2 * math.pi - 6.0) * 0.6)
    assert layer_area(boxes[:1]) == pytest.approx(0.2 * 0.5)
