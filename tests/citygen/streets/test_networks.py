"""Street networks are planar graphs with the numbers asked for."""

import networkx as nx
import numpy as np
import pytest
import shapely

from citygen.presets import COUNTRY
from citygen.streets.networks import faces, lattice_network, manhattan_network, street_graph
from citygen.streets.ragged import oriented_boxes
from citygen.streets.subdivision import subdivide
from mmi.foundation.errors import ParameterError


def town(seed, size=500.0, **options):
    """A small town on a square, whose streets wind."""
    square = size * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    rng = np.random.default_rng(seed)
    given = {"blocks": 20, "ranks": COUNTRY} | options
    return subdivide(square, lambda p: 0.5 * np.sin(p[:, 0] / 90.0) + 0.3 * np.cos(p[:, 1] / 120.0), rng, **given)


NETWORKS = {
    "manhattan": lambda: manhattan_network(np.random.default_rng(1)),
    "manhattan, small": lambda: manhattan_network(np.random.default_rng(5), avenues=4, streets=20),
    "lattice": lambda: lattice_network(np.random.default_rng(2), columns=9, rows=14),
    "town": lambda: town(3),
    "town with dead ends": lambda: town(4, junctions=70, stubs=8, kept_free=((250.0, 250.0, 50.0),)),
}


@pytest.fixture(scope="module", params=NETWORKS)
def network(request):
    return NETWORKS[request.param]()


def test_streets_meet_only_at_junctions(network):
    i, j = shapely.STRtree(network.lines).query(network.lines, predicate="intersects")
    i, j = i[i < j], j[i < j]
    assert len(i)
    for a, b, met in zip(i, j, shapely.intersection(network.lines[i], network.lines[j]), strict=True):
        shared = network.nodes[np.intersect1d(network.ends[a], network.ends[b])]
        assert len(shared), f"streets {a} and {b} meet where there is no junction: {met}"
        assert met.difference(shapely.MultiPoint(shared).buffer(1e-6)).is_empty
    assert shapely.is_simple(network.lines).all()


def test_streets_run_from_their_first_end_to_their_second(network):
    for k, end in ((0, 0), (1, -1)):
        at = shapely.get_coordinates(shapely.get_point(network.lines, end))
        assert np.array_equal(at, network.nodes[network.ends[:, k]])
    assert len(np.unique(network.nodes, axis=0)) == len(network.nodes)


def test_euler(network):
    graph = street_graph(network)
    assert nx.number_connected_components(graph) == 1
    assert len(faces(network)) == graph.number_of_edges() - graph.number_of_nodes() + 1


def test_graph_is_what_cities_have(network):
    graph = street_graph(network)
    assert sorted(edge["index"] for _, _, edge in graph.edges(data=True)) == list(range(len(network.lines)))
    for a, b, edge in graph.edges(data=True):
        first, last = (graph.nodes[node] for node in (min(a, b), max(a, b)))
        assert edge["geometry"].coords[0] == (first["x"], first["y"])
        assert edge["geometry"].coords[-1] == (last["x"], last["y"])
        assert edge["half_width"] > 0.0
        assert edge["name"]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("blocks", "junctions"), [(12, 50), (25, 77)])
def test_town_has_the_blocks_and_junctions_asked_for(seed, blocks, junctions):
    made = town(seed, blocks=blocks, junctions=junctions, stubs=5)
    assert len(faces(made)) == blocks
    assert len(made.nodes) == junctions
    assert len(made.lines) == blocks + junctions - 1


def test_no_street_crosses_what_is_kept_free():
    made = town(4, kept_free=((200.0, 260.0, 60.0),))
    assert shapely.distance(made.lines, shapely.Point(200.0, 260.0)).min() >= 60.0


def test_town_blocks_are_neither_slivers_nor_tiny():
    areas = faces(town(6))
    assert shapely.area(areas).sum() == pytest.approx(250_000.0)
    assert shapely.area(areas).min() > 2_500.0
    assert (4.0 * np.pi * shapely.area(areas) / shapely.length(areas) ** 2).min() > 0.3


def test_same_seed_same_streets():
    one, other, third = town(1), town(1), town(2)
    assert shapely.equals_exact(one.lines, other.lines).all()
    assert not np.array_equal(one.nodes, third.nodes)


def test_boundary_may_be_too_small():
    with pytest.raises(ParameterError, match="50 blocks expected"):
        town(1, size=100.0, blocks=50)
    with pytest.raises(ParameterError, match="3 junctions expected"):
        town(1, blocks=10, junctions=3)


def test_manhattan_has_long_blocks_and_a_diagonal():
    made = manhattan_network(np.random.default_rng(1))
    _, _, sizes = oriented_boxes(faces(made))
    long, short = np.median(sizes, axis=0)
    assert 75.0 < short < 90.0
    assert 270.0 < long < 320.0
    # From pavement to pavement, by the widths of the streets: some 270 m.
    avenues = np.char.endswith(made.names, "Avenue")
    assert 240.0 < long - 2.0 * (made.half_widths[avenues].mean() + 5.0) < 290.0
    broadway = made.lines[made.names == "Broadway"]
    assert len(broadway) >= 20
    assert shapely.line_merge(shapely.union_all(broadway)).geom_type == "LineString"
