"""Critical zones on cities that can be checked by hand, and the vectorised pairs against a loop over all pairs."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import affinity
from shapely.geometry import LineString, MultiPolygon, Polygon, box

from mmi.cells.viewing_cells import ViewingCell
from mmi.parallax.critical_zone import cell_region, critical_zone, interacting_pairs

CELL = ViewingCell("c", (0.0, 0.0), (10.0, 0.0), 2.0, (1.5, 1.9))


@st.composite
def footprints(draw):
    """Rectangles, L shapes, and pairs of them, anywhere but on the cell."""
    shapes = []
    for _ in range(draw(st.integers(0, 8))):
        x, y = draw(st.integers(-60, 60)), draw(st.integers(-60, 60))
        w, h = draw(st.integers(1, 15)), draw(st.integers(1, 15))
        one = box(x, y, x + w, y + h)
        if draw(st.booleans()):
            one = one.difference(box(x + w / 2, y + h / 2, x + w, y + h))
        if draw(st.booleans()):
            one = MultiPolygon([one, box(x + 20, y, x + 22, y + 3)])
        if one.distance(cell_region(CELL)) > 0.0:
            shapes.append(one)
    return shapes


def test_region_is_the_swept_axis():
    assert cell_region(CELL).equals(box(0, -2, 10, 2))


def test_zone_is_the_hull_of_object_and_region():
    zone = critical_zone(CELL, box(20, -1, 22, 1))
    assert zone.equals(Polygon([(0, -2), (10, -2), (22, -1), (22, 1), (10, 2), (0, 2)]))
    two = MultiPolygon([box(20, -1, 22, 1), box(4, 30, 6, 31)])
    assert critical_zone(CELL, two).contains(LineString([(22, 0), (5, 30)]))


def test_only_what_can_overlap_interacts():
    front, behind = box(20, -3, 24, 3), box(40, -3, 44, 3)
    beside = box(20, 60, 24, 70)
    other_way = box(-30, -3, -24, 3)
    pairs = interacting_pairs(CELL, [beside, behind, other_way, front])
    assert pairs.tolist() == [[1, 3]]
    assert pairs.dtype == np.int64


def test_a_small_object_in_the_zone_of_a_large_one_interacts_either_way():
    # The large one reaches into no zone of the small one, but the small one stands between cell and large one.
    large, small = box(40, -50, 60, 50), box(20, 20, 21, 21)
    assert not critical_zone(CELL, small).intersects(large)
    for order in ([large, small], [small, large]):
        assert interacting_pairs(CELL, order).tolist() == [[0, 1]]


@pytest.mark.parametrize("n", [0, 1])
def test_too_few_for_a_pair(n):
    pairs = interacting_pairs(CELL, [box(20, 0, 21, 1)] * n)
    assert pairs.shape == (0, 2)
    assert pairs.dtype == np.int64


@settings(deadline=None)
@given(footprints())
def test_pairs_agree_with_the_definition(shapes):
    zones = [critical_zone(CELL, one) for one in shapes]
    expected = [
        [i, j]
        for i in range(len(shapes))
        for j in range(i + 1, len(shapes))
        if zones[i].intersects(shapes[j]) or zones[j].intersects(shapes[i])
    ]
    assert interacting_pairs(CELL, shapes).tolist() == expected


@settings(deadline=None)
@given(footprints(), st.integers(0, 2**31))
def test_objects_on_one_line_of_sight_are_a_pair(shapes, seed):
    # The oracle shares no hulls: cast rays from random points of the cell, everything that a ray meets interacts.
    pairs = set(map(tuple, interacting_pairs(CELL, shapes).tolist()))
    rng = np.random.default_rng(seed)
    eyes = np.stack([rng.uniform(0, 10, 60), rng.uniform(-2, 2, 60)], axis=1)
    ends = eyes + 200.0 * np.stack([np.cos(t := rng.uniform(0, 2 * np.pi, 60)), np.sin(t)], axis=1)
    rays = shapely.linestrings(np.stack([eyes, ends], axis=1))
    if not shapes:
        return
    ray, met = shapely.STRtree(shapes).query(rays, predicate="intersects")
    for one in range(60):
        seen = np.sort(met[ray == one])
        assert {(int(i), int(j)) for k, i in enumerate(seen) for j in seen[k + 1 :]} <= pairs


def test_turning_and_moving_the_city_changes_nothing():
    shapes = [box(20, -3, 24, 3), box(40, -5, 44, 9), box(20, 60, 24, 70), box(-30, -3, -24, 3), box(-70, -9, -60, 20)]
    expected = interacting_pairs(CELL, shapes).tolist()
    assert expected
    turned = [affinity.translate(affinity.rotate(one, 90, origin=(0, 0)), 500, -70) for one in shapes]
    cell = ViewingCell("c", (500.0, -70.0), (500.0, -60.0), 2.0, (1.5, 1.9))
    assert interacting_pairs(cell, turned).tolist() == expected
