"""Paths through open space: between blocks they run in the middle, they reach what is open, and never through a wall."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from cities import HELSINKI
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Voronoi
from shapely.geometry import LineString, Polygon, box

from mmi.foundation.errors import CityError
from mmi.reading.ground.open_space import open_space_layer, open_space_streets
from mmi.reading.ground.skeleton import skeleton_between
from mmi.reading.read_city import read_city
from mmi.reading.report import Ledger


def paths(*buildings, **options):
    found = open_space_streets(np.array(buildings, dtype=object), **options)
    return found.streets, [one.lines[0] for one in found.streets], found.enclosed_m


def ends_of(lines):
    ends = [tuple(np.round(line.coords[k], 6)) for line in lines for k in (0, -1)]
    return {end: ends.count(end) for end in ends}


def four_blocks(width):
    h = width / 2
    return [box(x, y, x + 60, y + 40) for x in (-60 - h, h) for y in (-40 - h, h)]


@pytest.mark.parametrize("width", [8.0, 16.0, 30.0])
def test_the_skeleton_of_a_crossing_is_a_plus(width):
    streets, lines, left_out = paths(*four_blocks(width))
    h = width / 2
    cross = shapely.union_all([LineString([(-60 - h, 0), (60 + h, 0)]), LineString([(0, -40 - h), (0, 40 + h)])])
    assert len(lines) == 4
    assert sorted(ends_of(lines).values()) == [1, 1, 1, 1, 4]  # one crossing, four ends
    assert shapely.distance(shapely.points(shapely.get_coordinates(shapely.segmentize(lines, 0.5))), cross).max() < 0.8
    assert shapely.union_all(lines).length > 0.85 * cross.length
    assert {one.tags["highway"] for one in streets} == {"pedestrian"}
    assert all(float(one.tags["width"]) == pytest.approx(min(width, 12.0), abs=0.7) for one in streets)
    assert left_out == 0.0


def test_courtyards_are_left_out_and_measured():
    yard = Polygon(box(-40, -40, 40, 40).exterior, [box(-30, -8, 30, 8).exterior.coords])
    streets, lines, left_out = paths(yard, box(-40, 50, 40, 90), box(50, -40, 90, 90))
    assert streets
    assert not any(line.intersects(box(-30, -8, 30, 8)) for line in lines)
    # The middle line, 44 m, and an arm from each corner, from where it is 2 m clear: 8.5 m.
    assert left_out == pytest.approx(44.0 + 4 * 8.5, abs=4.0)


def test_gaps_that_are_too_narrow_are_no_paths():
    blocks = [box(0, 0, 40, 40), box(43, 0, 83, 40), box(0, 50, 83, 90)]
    _, lines, _ = paths(*blocks, min_width=4.0)
    gap = box(40, 0, 43, 38)
    assert not any(line.intersects(gap) for line in lines)
    _, lines, _ = paths(*blocks, min_width=2.0)
    assert any(line.intersects(gap) for line in lines)


def test_a_building_alone_is_walked_around():
    streets, lines, _ = paths(box(0, 0, 20, 10))
    assert len(streets) == 1
    assert shapely.Polygon(lines[0]).contains(box(0, 0, 20, 10))


def test_no_buildings_is_an_error():
    with pytest.raises(CityError, match="no footprint"):
        paths()


def test_gaps_that_meet_only_outside_are_joined_by_the_way_around():
    slabs = [box(0, y, 80, y + 12) for y in (0, 30, 60, 90)]
    _, lines, left_out = paths(*slabs)
    assert left_out == 0.0
    all_of_it = shapely.union_all(lines)
    for y in (21.0, 51.0, 81.0):  # between the slabs
        middle = LineString([(5, y), (75, y)])
        assert middle.within(all_of_it.buffer(1.0))
    assert shapely.union_all(lines).buffer(0.01).geom_type == "Polygon"
    assert shapely.distance(all_of_it, shapely.union_all(slabs)) > 3.0


def test_corners_make_no_dead_ends():
    """A square in front of a street: the four corners of the square would each have an arm."""
    walls = [box(-10, -10, 0, 50), box(0, 40, 50, 50), box(40, -10, 50, 40), box(0, -10, 17, 0), box(23, -10, 40, 0)]
    below = [box(-10, -60, 17, -10), box(23, -60, 50, -10)]
    _, lines, _ = paths(*walls, *below)
    inner = [line for line in lines if line.intersects(box(1, 1, 39, 39))]
    assert not any(
        line.intersects(corner.buffer(8.0)) for line in inner for corner in map(shapely.Point, [(0, 40), (40, 40)])
    )


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6))
def test_paths_never_touch_a_building_and_are_connected(seed):
    rng = np.random.default_rng(seed)
    buildings = []
    for _ in range(14):
        x, y, w, h = rng.uniform((0, 0, 6, 6), (120, 120, 40, 40))
        buildings.append(shapely.affinity.rotate(box(x, y, x + w, y + h), rng.uniform(0, 90)))
    streets, lines, _ = paths(*buildings, min_width=4.0)
    solid = shapely.union_all(buildings)
    assert streets
    assert all(line.distance(solid) >= 2.0 - 1e-6 for line in lines)
    assert all(
        float(one.tags["width"]) <= 2.0 * line.distance(solid) + 1e-9 for one, line in zip(streets, lines, strict=True)
    )
    assert shapely.union_all(lines).buffer(0.01).geom_type == "Polygon"
    assert len({one.id for one in streets}) == len(streets)


def test_a_moved_city_has_the_same_paths():
    blocks = np.array(four_blocks(14.0), dtype=object)
    shifted = shapely.transform(blocks, lambda xy: np.add(xy, (4000.0, -7000.0)))
    a, b = (open_space_streets(one).streets for one in (blocks, shifted))
    assert sum(s.lines[0].length for s in a) == pytest.approx(sum(s.lines[0].length for s in b), abs=0.1)


def test_paths_of_helsinki_find_its_streets():
    city, _ = read_city(HELSINKI)
    part = box(-100, -900, 300, -200)
    solid = np.array([one.footprint for one in city.objects if one.footprint.within(part)], dtype=object)
    found = open_space_streets(solid)
    lines = shapely.union_all([one.lines[0] for one in found.streets])
    assert not shapely.STRtree(solid).query(lines, predicate="intersects").size
    known = shapely.union_all([edge["geometry"] for _, _, edge in city.streets.edges(data=True)])
    known = shapely.intersection(known, shapely.union_all(solid).convex_hull)
    assert shapely.intersection(known, shapely.buffer(lines, 8.0)).length > 0.5 * known.length
    assert found.enclosed_m > 1000.0  # courtyards


def scattered(seed, n=24, size=200.0):
    rng = np.random.default_rng(seed)
    houses = [box(x, y, x + w, y + h) for x, y, w, h in rng.uniform((0, 0, 6, 6), (size, size, 25, 25), (n, 4))]
    return shapely.union_all([shapely.affinity.rotate(one, rng.uniform(0, 90)) for one in houses])


def places_of(skeleton):
    """The skeleton's edges as sorted rows of their ends, to the millimetre."""
    ends = np.sort(np.round(skeleton.at[skeleton.edges], 3).view("f8,f8").reshape(-1, 2), axis=1)
    return {tuple(map(tuple, pair)) for pair in ends.tolist() if pair[0] != pair[1]}


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([300, 1000]))
def test_the_skeleton_of_tiles_is_that_of_the_whole(seed, tile_points):
    solid = scattered(seed)
    region = solid.convex_hull.buffer(10.0)
    whole = skeleton_between(solid, region, 1.0, 2.0)
    tiled = skeleton_between(solid, region, 1.0, 2.0, tile_points=tile_points)
    differ = places_of(whole) ^ places_of(tiled)
    assert len(differ) <= 0.005 * len(whole.edges)  # rounding to the millimetre, and edges shorter than that


def test_the_skeleton_is_part_of_the_voronoi_diagram_that_keeps_clear():
    """Against the definition: every node is equally far from three points of walls or more, and none is nearer."""
    solid = scattered(4)
    skeleton = skeleton_between(solid, solid.convex_hull, 1.0, 2.0, tile_points=500)
    points = np.unique(np.round(shapely.get_coordinates(shapely.segmentize(solid, 1.0)), 6), axis=0)
    nodes = np.unique(skeleton.edges)
    assert len(nodes) > 200
    for node in nodes[::37]:
        metres = np.sort(np.linalg.norm(points - skeleton.at[node], axis=1))
        assert metres[:3] == pytest.approx(skeleton.clearance[node], abs=1e-6)
    assert len(Voronoi(points).vertices) > len(nodes)
    lines = shapely.linestrings(skeleton.at[skeleton.edges])
    assert shapely.distance(lines, solid).min() >= 2.0 - 1e-9


def test_what_is_coarse_is_told(monkeypatch):
    blocks = np.array(four_blocks(14.0), dtype=object)
    ledger = Ledger()
    layer = open_space_layer("town", blocks, ledger)
    assert (len(layer.items), ledger.report(source="", crs="", origin=(0, 0, 0)).warnings) == (4, ())
    monkeypatch.setattr("mmi.reading.ground.open_space._MOST_POINTS", 200)
    assert len(open_space_layer("town", blocks, ledger).items) == 4
    (warning,) = ledger.report(source="", crs="", origin=(0, 0, 0)).warnings
    assert warning.startswith("town: paths are coarse, as the city is large: there is none through gaps under 5.7 m")
