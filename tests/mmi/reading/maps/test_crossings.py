"""Outlines that are too intricate to be mended are told by their crossings, counted as brute force counts them."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
import pytest
import shapely
from city_files import degrees, geojson
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import GeometryCollection, LineString, MultiPolygon, Point, Polygon, box

from mmi import limits
from mmi.foundation.errors import CityError
from mmi.reading.maps.crossings import Tangles, streets_tangled
from mmi.reading.maps.repair import clean_outlines
from mmi.reading.read_city import read_city
from mmi.reading.read_options import ReadOptions
from mmi.reading.report import Ledger

OVER_AND_OVER = "an outline that crosses itself over and over"


def scribble(points, seed=1):
    return Polygon(np.random.default_rng(seed).uniform(0.0, 100.0, (points, 2)))


def comb(teeth):
    """A valid outline whose slanting teeth have boxes that all overlap."""
    x, wide = np.arange(teeth, dtype=np.float64), np.array([0.5, 0.0])
    low, high = np.column_stack([x, 0.0 * x]), np.column_stack([x + teeth, 0.0 * x + teeth])
    tooth = np.stack([low, high, high + wide, low + wide], axis=1).reshape(-1, 2)
    return Polygon([*tooth, (teeth, -5.0), (-1.0, -5.0)])


def crossings(polygon):
    """The pairs of edges that meet elsewhere than in a common corner, one by one."""
    rings = [ring.coords for ring in (polygon.exterior, *polygon.interiors)]
    edges = [edge for ring in rings for edge in pairwise(ring) if edge[0] != edge[1]]
    return sum(
        not set(one) & set(other) and LineString(one).intersects(LineString(other))
        for one, other in combinations(edges, 2)
    )


ring = st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), min_size=4, max_size=12).map(Polygon)


@settings(max_examples=80, deadline=None)
@given(ring)
def test_crossings_are_counted_as_one_by_one(polygon):
    expected = crossings(polygon)
    for most, reason in ((expected, None), (expected - 1, OVER_AND_OVER))[: 1 + (expected > 0)]:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(limits, "CROSSINGS", most)
            assert Tangles().why(polygon) == reason


def test_a_scribble_is_left_out_and_what_lies_beside_it_is_not():
    ledger = Ledger()
    outlines = np.array([scribble(2000), box(0, 0, 10, 10), scribble(200), comb(8000)], dtype=object)
    found = clean_outlines(["a", "b", "c", "d"], outlines, ledger)
    assert [len(polygons) for polygons in found] == [0, 1, 0, 0]
    assert ledger.count("left out", f"building: {OVER_AND_OVER}") == 2
    assert ledger.count("left out", "building: an outline with too many edges side by side") == 1


def test_honest_outlines_of_many_points_are_read():
    circle = Point(0, 0).buffer(100.0, 25_000)
    steps = np.arange(30_000.0)
    stairs = Polygon([*np.column_stack([steps // 2, (steps + 1) // 2]), (0.0, 15_000.0)])
    yards = MultiPolygon([box(20 * k, 0, 20 * k + 10, 10) - box(20 * k + 2, 2, 20 * k + 8, 8) for k in range(2000)])
    found = clean_outlines(["circle", "stairs", "yards"], np.array([circle, stairs, yards], dtype=object), Ledger())
    assert [len(polygons) for polygons in found] == [1, 1, 2000]


def test_faces_that_share_their_corners_do_not_cross():
    """As those of a roof do, seen from above."""
    grid = [shapely.box(x, y, x + 1, y + 1) for x in range(30) for y in range(30)]
    halves = [Polygon(one.exterior.coords[k : k + 3]) for one in grid for k in (0, 2)]
    assert Tangles().why(GeometryCollection([MultiPolygon(halves), Point(3, 3)])) is None


def test_outlines_of_too_many_points_are_left_out(monkeypatch):
    monkeypatch.setattr(limits, "OUTLINE_POINTS", 100)
    assert Tangles().why(Point(0, 0).buffer(1.0, 25)) == "an outline of more than 100 points"
    assert Tangles().why(Point(0, 0).buffer(1.0, 24)) is None


def lanes(count):
    """Two sets of parallel lanes at right angles, each line drawn once: ``count`` squared crossings."""
    along = [LineString([(-1, 7 * i), (7 * count, 7 * i)]) for i in range(count)]
    across = [LineString([(7 * i, -1), (7 * i, 7 * count)]) for i in range(count)]
    return np.array(along + across, dtype=object)


@pytest.mark.parametrize(("most", "tangled"), [(144, False), (143, True)])
def test_crossings_of_streets_are_counted_across_all_of_them(monkeypatch, most, tangled):
    monkeypatch.setattr(limits, "STREET_CROSSINGS", most)
    assert streets_tangled(lanes(12)) == tangled


def test_streets_cross_once_for_each_of_their_edges_whatever_their_number(monkeypatch):
    monkeypatch.setattr(limits, "STREET_CROSSINGS", 1)
    assert streets_tangled(lanes(12))
    assert not streets_tangled(shapely.segmentize(lanes(12), 12.0)), "144 crossings of 24 lanes of 8 edges"


def test_streets_that_meet_in_corners_do_not_cross(monkeypatch):
    monkeypatch.setattr(limits, "STREET_CROSSINGS", 0)
    grid = [LineString([(x, y), (x + dx, y + 1 - dx)]) for x in range(20) for y in range(20) for dx in (0, 1)]
    assert not streets_tangled(np.array(grid, dtype=object))


def test_streets_side_by_side_are_too_many_to_be_compared(monkeypatch):
    slanting = np.array([LineString([(i, 0), (i + 1000, 1000)]) for i in range(400)], dtype=object)
    assert not streets_tangled(slanting)
    monkeypatch.setattr(limits, "STREET_CROSSINGS", 10)
    monkeypatch.setattr(limits, "STREET_EDGES_COMPARED", 100)
    assert streets_tangled(slanting), "79,800 pairs, a hundred for each edge are 40,000"


def test_a_map_of_lanes_at_random_is_refused_in_one_line(tmp_path):
    """Twelve hundred lanes cross about 150,000 times; to join them would take about a minute."""
    ends = np.random.default_rng(4).uniform(-400.0, 400.0, (1200, 2, 2))
    streets = geojson(
        tmp_path / "lanes.geojson", [(degrees(LineString(one)), {"highway": "residential"}) for one in ends]
    )
    houses = geojson(tmp_path / "h.geojson", [(degrees(box(x, x, x + 9, x + 9)), {"height": 9}) for x in (-500, 500)])
    expected = (
        r"lanes.geojson: streets that cross at most 100,000 times, .* found that 1200 of them cross more often or"
    )
    with pytest.raises(CityError, match=expected):
        read_city(houses, ReadOptions(streets=streets))


def test_crossings_are_counted_in_all_outlines(monkeypatch):
    """Bow ties cross once each: with two in all the third is left out, and what does not cross still stands."""
    monkeypatch.setattr(limits, "CROSSINGS_IN_ALL", 2)
    tie = Polygon([(0, 0), (10, 10), (10, 0), (0, 10)])
    outlines = np.array([tie, tie, box(0, 0, 9, 9), tie, box(20, 0, 29, 9)], dtype=object)
    ledger = Ledger()
    found = clean_outlines(list("abcde"), outlines, ledger)
    assert [len(one) for one in found] == [2, 2, 1, 0, 1]
    assert ledger.count("left out", "building: an outline that crosses itself, after 2 crossings of others") == 1


def test_edges_are_compared_in_all_outlines(monkeypatch):
    """Valid outlines of more than a thousand points are looked at, until there was enough of that."""
    monkeypatch.setattr(limits, "EDGES_COMPARED_IN_ALL", 1000)
    outlines = np.array([comb(300), comb(300), box(0, 0, 9, 9)], dtype=object)
    ledger = Ledger()
    assert [len(one) for one in clean_outlines(list("abc"), outlines, ledger)] == [1, 0, 1]
    assert ledger.count("left out", "building: an outline after too many edges side by side in others") == 1


def test_crossings_are_counted_for_each_point_and_edges_side_by_side(monkeypatch):
    monkeypatch.setattr(limits, "EDGES_COMPARED", 1000)
    assert Tangles().why(comb(300)) == "an outline with too many edges side by side"
    monkeypatch.undo()
    tangled = scribble(20)
    least = crossings(tangled) // 21 + 1  # its first corner comes again at the end
    for each, reason in ((least, None), (least - 1, OVER_AND_OVER)):
        monkeypatch.setattr(limits, "CROSSINGS_A_POINT", each)
        assert Tangles().why(tangled) == reason
