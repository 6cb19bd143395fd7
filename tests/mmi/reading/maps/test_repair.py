"""Mending outlines: the city's solid stays what it was, and nothing invalid is left."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import GeometryCollection, LineString, MultiPolygon, Point, Polygon, box

from mmi.city.model import CityObject, Prism
from mmi.reading.maps.buildings import merge_blocks
from mmi.reading.maps.repair import clean_outlines, cut_overlaps, find_duplicates, solid_polygons
from mmi.reading.report import Ledger


def clean(*outlines):
    ledger = Ledger()
    ids = [f"way/{i}" for i in range(len(outlines))]
    return clean_outlines(ids, np.array(outlines, dtype=object), ledger), ledger


def test_a_bow_tie_becomes_two_triangles():
    (polygons,), ledger = clean(Polygon([(0, 0), (10, 10), (10, 0), (0, 10)]))
    assert len(polygons) == 2
    assert sum(polygon.area for polygon in polygons) == pytest.approx(50.0)
    assert ledger.count("repaired", "invalid outline rebuilt") == 1


def test_a_hole_outside_and_a_spike_are_dropped():
    spiked = Polygon([(0, 0), (10, 0), (10, 5), (30, 5), (10, 5), (10, 10), (0, 10)])
    holed = Polygon(
        [(0, 0), (10, 0), (10, 10), (0, 10)], [[(4, 4), (6, 4), (6, 6), (4, 6)], [(5, 5), (8, 5), (8, 8), (5, 8)]]
    )
    (first, second), _ = clean(spiked, holed)
    assert [polygon.area for polygon in first] == [100.0]
    assert [polygon.area for polygon in second] == [100.0 - (4 + 9 - 1)]


def test_collections_keep_their_polygons():
    mixed = GeometryCollection(
        [Point(0, 0), LineString([(0, 0), (9, 9)]), MultiPolygon([box(0, 0, 2, 2), box(5, 5, 9, 9)])]
    )
    (polygons,), _ = clean(mixed)
    assert [polygon.area for polygon in polygons] == [4.0, 16.0]


def test_slivers_are_left_out_and_counted():
    (tiny, thin, good), ledger = clean(box(0, 0, 0.9, 0.9), box(0, 0, 100, 0.05), box(0, 0, 1, 1))
    assert (tiny, thin) == ((), ())
    assert len(good) == 1
    assert ledger.count("left out") == 2


def test_repeated_points_are_removed_and_counted():
    (polygons,), ledger = clean(Polygon([(0, 0), (5, 0), (5, 0), (5, 5), (0, 5), (0, 5)]))
    assert len(polygons[0].exterior.coords) == 5
    assert ledger.count("repaired", "repeated points removed") == 1


def test_duplicates_keep_the_one_with_a_height():
    square = box(0, 0, 10, 10)
    turned = Polygon([(10, 10), (10, 0.001), (0, 0), (0, 10)])
    outlines = [(square,), (turned,), (box(0, 0, 10, 11),), (square,)]
    assert find_duplicates(outlines, [(0,)] * 4, [False, True, True, True]) == {0: 1, 3: 1}
    assert find_duplicates(outlines, [(0,), (1,), (0,), (2,)], [True] * 4) == {}


prism = st.tuples(
    st.integers(0, 20),
    st.integers(0, 20),
    st.integers(2, 12),
    st.integers(2, 12),
    st.sampled_from([0, 0, 0, 5]),
    st.integers(6, 9),
)


@settings(max_examples=60, deadline=None)
@given(st.lists(prism, min_size=2, max_size=8))
def test_cutting_overlaps_keeps_the_solid(prisms):
    """Oracle: over every unit square, the set of filled heights is the same before and after."""
    polygons = [box(x, y, x + w, y + d) for x, y, w, d, _, _ in prisms]
    bottoms = np.array([p[4] for p in prisms], dtype=float)
    tops = np.array([p[5] for p in prisms], dtype=float)
    left, interleaved, cut = cut_overlaps(polygons, bottoms, tops, np.arange(len(prisms)))

    def filled(shapes):
        """(layer, x, y): is the unit cube filled?"""
        cubes = np.zeros((10, 33, 33), dtype=bool)
        x, y = np.meshgrid(np.arange(33) + 0.5, np.arange(33) + 0.5, indexing="ij")
        for i, pieces in enumerate(shapes):
            inside = np.zeros((33, 33), dtype=bool)
            for piece in pieces:
                inside |= shapely.contains_xy(piece, x, y)
            cubes[int(bottoms[i]) : int(tops[i])] |= inside
        return cubes

    assert (filled(left) == filled([[polygon] for polygon in polygons])).all()
    assert all(piece.is_valid for pieces in left for piece in pieces)
    for i in range(len(prisms)):
        assert cut[i] or [polygons[i]] == left[i]
        for j in range(i + 1, len(prisms)):
            apart = bottoms[i] >= tops[j] or bottoms[j] >= tops[i]
            shared = sum(a.intersection(b).area for a in left[i] for b in left[j])
            assert apart or (i, j) in interleaved or shared < 1e-9


def test_prisms_of_one_object_may_overlap():
    left, pairs, cut = cut_overlaps(
        [box(0, 0, 4, 4), box(1, 1, 3, 3)], np.zeros(2), np.array([5.0, 4.0]), np.array([7, 7])
    )
    assert [len(one) for one in left] == [1, 1]
    assert not pairs
    assert not cut.any()


def test_solid_polygons_of_nothing():
    assert solid_polygons(GeometryCollection()) == []
    assert solid_polygons(LineString([(0, 0), (1, 1)])) == []


def house(id_, x0, y0, x1, y1):
    return CityObject(id_, (Prism(box(x0, y0, x1, y1), 0.0, 5.0),))


def test_blocks_merge_shared_walls_but_not_corners():
    ledger = Ledger()
    houses = [
        house("way/10", 0, 0, 10, 10),
        house("way/9", 10.05, 2, 20, 12),  # 8 m of wall, 5 cm gap
        house("way/7", 20, 12, 30, 22),  # touches way/9 at a corner
        house("way/8", 10.2, -20, 20, -10),  # apart
        house("way/2", 20, 5, 25, 9),  # shares 4 m with way/9
    ]
    blocks = merge_blocks(houses, ledger)
    assert [block.id for block in blocks] == ["way/2", "way/7", "way/8"]
    assert [len(block.prisms) for block in blocks] == [3, 1, 1]
    assert ledger.count("kept", "buildings merged into blocks") == 3
