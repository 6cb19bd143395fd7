"""Which cells are built: places in degrees and in metres, objects, walks; one way at a time."""

import itertools
import math
from dataclasses import replace

import networkx as nx
import numpy as np
import pyproj
import pytest
from cities import HELSINKI, crossroads
from shapely.geometry import Point, Polygon

from mmi.building.cell_choice import CellChoice, choose_cells
from mmi.building.dataset import build_dataset
from mmi.cells.whereabouts import Whereabouts
from mmi.city.long_objects import cut_objects
from mmi.dataset.reading import open_dataset
from mmi.foundation.camera import Camera
from mmi.foundation.errors import ParameterError
from mmi.planning.parameters import BuildParameters
from mmi.reading.read_city import read_city
from mmi.walks.walk import Keyframe, Pose, Walk

PARAMETERS = BuildParameters(near_distance=30.0, camera=Camera(128, 128, 1.0), cell_length=80.0, longest_object=None)
FINE = replace(PARAMETERS, cell_length=40.0)


@pytest.fixture(scope="module")
def helsinki():
    return read_city(HELSINKI)[0]


def without_crs():
    return replace(crossroads(), crs="local")


def walk(*places, seconds=10.0, cuts=()):
    return Walk(
        "a walk",
        tuple(
            Keyframe(seconds * i, Pose((x, y, 1.7), 0.0, 0.0), cut=i in cuts and i > 0)
            for i, (x, y) in enumerate(places)
        ),
    )


def degrees_of(city, x, y):
    there = pyproj.Transformer.from_crs(city.crs, "EPSG:4326", always_xy=True)
    return there.transform(x + city.origin[0], y + city.origin[1])


def distances(choice, shape):
    """Metres from the rectangle of each cell of the city to ``shape``, by name."""
    return {name: Polygon(cell.corners).distance(shape) for name, cell in choice.graph.nodes(data="cell")}


@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (200.0, -150.0), (-100.0, 400.0)])
def test_a_place_in_degrees_is_where_the_city_has_it(helsinki, x, y):
    chosen = choose_cells(helsinki, FINE, around=degrees_of(helsinki, x, y), radius=120.0)
    away = distances(chosen, Point(x, y))
    close = {name for name, metres in away.items() if metres <= 120.0}
    parts = list(nx.connected_components(chosen.graph.subgraph(close)))
    start = min(away, key=lambda name: away[name])
    assert set(chosen.names) == next(part for part in parts if start in part)
    assert chosen.apart == len(close) - len(chosen.names)
    assert chosen.names == tuple(sorted(chosen.names))


def test_a_place_in_a_city_without_coordinate_system_is_metres():
    chosen = choose_cells(without_crs(), FINE, around=(100.0, 2.0), radius=10.0)
    assert {cell.street for cell in (chosen.graph.nodes[name]["cell"] for name in chosen.names)} == {"street 1"}
    with pytest.raises(ParameterError, match=r"around 900,0: .* lies at x -160 to 150, y .* \(metres in its own frame"):
        choose_cells(without_crs(), FINE, around=(900.0, 0.0))


def test_an_object_is_its_footprint():
    chosen = choose_cells(crossroads(), FINE, around="block/22", radius=8.0)
    away = distances(chosen, next(one.footprint for one in crossroads().objects if one.id == "block/22"))
    assert chosen.names == tuple(sorted(name for name, metres in away.items() if metres <= 8.0))
    assert 0 < len(chosen.names) < len(chosen.graph)


def test_an_object_that_was_cut_is_all_of_its_parts(helsinki):
    name = "relation/4198"
    parts = cut_objects(helsinki, 40.0)
    assert name not in parts.index()
    whole, cut = (choose_cells(city, FINE, around=name, radius=50.0) for city in (helsinki, parts))
    assert whole.names == cut.names


def test_a_larger_radius_keeps_what_a_smaller_one_chose(helsinki):
    place = degrees_of(helsinki, 0.0, 0.0)
    chosen = [set(choose_cells(helsinki, FINE, around=place, radius=radius).names) for radius in (40, 80, 160, 1e6)]
    assert all(few <= many for few, many in itertools.pairwise(chosen))
    graph = choose_cells(helsinki, FINE).graph
    assert chosen[-1] == next(part for part in nx.connected_components(graph) if chosen[0] <= part)


@pytest.mark.parametrize("frames_per_second", [1.0, 2.5, 30.0])
def test_a_walk_is_in_the_chosen_cells_where_it_would_be_in_all(helsinki, frames_per_second):
    graph = choose_cells(helsinki, FINE).graph
    ends = [
        min(graph, key=lambda name: math.dist(graph.nodes[name]["cell"].p, place)) for place in ((-200, 0), (200, 300))
    ]
    route = [graph.nodes[name]["cell"].reference for name in nx.shortest_path(graph, *ends)]
    walked = walk(*[(x, y) for x, y, _ in route], seconds=3.0)
    chosen = choose_cells(helsinki, FINE, along=walked)
    everything, some = (
        Whereabouts(tuple(graph.nodes[name]["cell"] for name in names), {}) for names in (graph, chosen.names)
    )
    before = {everything: None, some: None}
    for step in walked.frames(frames_per_second):
        for places in (everything, some):
            before[places] = places.cell_at(np.array(step.pose.eye), current=before[places])
        assert before[everything] == before[some]
    assert nx.is_connected(graph.subgraph(chosen.names))


def test_a_jump_of_a_walk_passes_nothing():
    jumping = walk((-140.0, 0.0), (-130.0, 0.0), (0.0, 140.0), (0.0, 145.0), cuts=(2,))
    chosen = choose_cells(crossroads(), FINE, along=jumping)
    streets = {chosen.graph.nodes[name]["cell"].street for name in chosen.names}
    assert streets == {"street 0", "street 3"}
    assert len(chosen.names) == 2
    assert choose_cells(crossroads(), FINE, along=walk((100.0, 0.0))).names == ("0001-02",)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"around": "way/1"}, r"around way/1: LON,LAT or one of the 447 objects of helsinki.osm.pbf \(relation/4198, "),
        (
            {"around": (60.1672, 24.9384)},
            r"around 60.1672,24.9384: a place in helsinki.osm.pbf expected, which lies at ",
        ),
        (
            {"around": (24.99, 60.17)},
            r"longitude 24.93\d\d to 24.95\d\d, latitude 60.16\d\d to 60.17\d\d, found one \d.* km out",
        ),
        (
            {"around": (385940.0, 6672290.0)},
            "longitude and latitude in degrees expected, since helsinki.osm.pbf has the",
        ),
        ({"around": (math.nan, 60.0)}, "longitude and latitude in degrees expected"),
        ({"around": (24.9384, 60.1672), "radius": math.nan}, "a radius of more than 0 m expected, found nan"),
        (
            {"around": "relation/4198", "radius": 0.01},
            r"around relation/4198: a street within 0.01 m expected, found none, ",
        ),
        (
            {"along": walk((5000.0, 0.0), (5100.0, 0.0))},
            r"walk 'a walk': a path along the streets expected, found one that ",
        ),
        ({"cells": ["0000-00"], "max_cells": 3}, "one way to choose cells expected, found cells and max_cells"),
        ({"around": "way/1", "along": walk((0.0, 0.0))}, "found around and along"),
    ],
)
def test_mistakes_are_named(helsinki, options, words):
    with pytest.raises(ParameterError, match=words):
        choose_cells(helsinki, FINE, **options)


def test_what_is_chosen_is_built_and_goes_on_from_there(tmp_path):
    city = without_crs()
    few = choose_cells(city, PARAMETERS, around=(0.0, 0.0), radius=1.0)
    assert isinstance(few, CellChoice)
    assert build_dataset(city, tmp_path, PARAMETERS, cells=few).built == len(few.names) == 4
    more = choose_cells(city, PARAMETERS, along=walk((-150.0, 0.0), (140.0, 0.0)))
    summary = build_dataset(city, tmp_path, PARAMETERS, cells=more)
    again = set(few.names) & set(more.names)
    assert (summary.complete, summary.built) == (len(again), len(more.names) - len(again))
    assert {entry.id for entry in open_dataset(tmp_path).manifest.cells} == {*few.names, *more.names}
