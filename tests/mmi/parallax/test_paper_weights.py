"""The bound over all pairs of points of two objects: above every sampled pair, and not far above the worst."""

import math
from itertools import combinations

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from shapely import affinity
from shapely.geometry import MultiPolygon, Point, Polygon, box
from viewing_angle import point_pair_weights

from mmi.cells.viewing_cells import ViewingCell
from mmi.city.model import CityObject, Prism
from mmi.parallax.critical_zone import cell_region
from mmi.parallax.paper_weights import critical_zone_weights, pair_weights

CELL = ViewingCell("c", (-15.0, -5.0), (20.0, 10.0), 3.0, (1.5, 1.9))
COURT = box(-60, -60, 60, 60).difference(box(-45, -45, 45, 45))
"""A block whose courtyard holds the cell."""


def azimuths(points, viewpoints):
    """(n, k) azimuth of n points from k viewpoints less that from the cell's centre: continuous over the cell."""
    centre = CELL.reference[:2]
    d0, d1 = points[:, None] - centre, points[:, None] - viewpoints[None]
    cross = d0[..., 0] * d1[..., 1] - d0[..., 1] * d1[..., 0]
    return np.arctan2(cross, (d0 * d1).sum(axis=-1))


def along(line, step):
    """Points on a line or lines, their corners among them."""
    return shapely.get_coordinates(shapely.segmentize(line, step))


def worst_signed(one, other, step=1.0):
    """The plain twin, from below: the largest change over samples of both outlines and of the cell's boundary."""
    viewpoints = along(cell_region(CELL).exterior, 0.7)
    a, b = azimuths(along(one.boundary, step), viewpoints), azimuths(along(other.boundary, step), viewpoints)
    worst = 0.0
    for k in range(len(viewpoints)):
        ga, gb = a - a[:, k : k + 1], b - b[:, k : k + 1]
        worst = max(worst, float((ga.max(axis=0) - gb.min(axis=0)).max()))
    return worst


def small_city(seed, n=7, nearest=12.0):
    """Houses of three to eight corners, some with wings that stand apart, around the cell."""
    rng = np.random.default_rng(seed)
    houses = []
    while len(houses) < n:
        t = np.sort(rng.uniform(0.0, 2.0 * np.pi, rng.integers(3, 9)))
        radius = rng.uniform(3.0, 15.0) * rng.uniform(0.5, 1.0, len(t))
        house = Polygon(np.stack([radius * np.cos(t), radius * np.sin(t)], axis=1)).buffer(0)
        if rng.uniform() < 0.3:
            house = shapely.union(house, affinity.translate(house, 40.0, 5.0))
        bearing, distance = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(20.0, 250.0)
        house = affinity.translate(house, distance * np.cos(bearing), distance * np.sin(bearing))
        if house.area > 5.0 and house.distance(cell_region(CELL)) > nearest:
            houses.append(house)
    return houses


@pytest.mark.parametrize("seed", range(6))
def test_bounds_every_sample_and_is_tight(seed):
    houses = [*small_city(seed), COURT] if seed == 0 else small_city(seed)
    pairs = np.array(list(combinations(range(len(houses)), 2)))
    weights = pair_weights(CELL, houses, pairs)
    worst = np.array([worst_signed(houses[i], houses[j]) for i, j in pairs])
    assert (weights >= worst).all()
    assert (weights / worst).max() < 1.05


@pytest.mark.parametrize("signed", [True, False])
@settings(deadline=None, max_examples=60)
@given(seed=st.integers(0, 2**31), gap=st.sampled_from([0.01, 0.3, 2.0, 20.0]))
def test_bounds_random_points_of_objects_and_viewpoints_in_the_cell(signed, seed, gap):
    # Points anywhere in the objects, viewpoints anywhere in the cell, objects as close as a centimetre.
    houses = small_city(seed, n=4, nearest=gap)
    rng = np.random.default_rng(seed)
    corners = CELL.corners
    u, v = rng.uniform(0.0, 1.0, (2, 300, 1))
    viewpoints = corners[0] + u * (corners[1] - corners[0]) + v * (corners[3] - corners[0])
    viewpoints = np.concatenate([viewpoints, corners])
    turns = []
    for house in houses:
        x0, y0, x1, y1 = house.bounds
        points = rng.uniform((x0, y0), (x1, y1), (60, 2))
        points = points[shapely.contains_xy(house, points)]
        turns.append((points, azimuths(points, viewpoints)) if len(points) else None)
    assume(all(turn is not None for turn in turns))
    pairs = np.array(list(combinations(range(len(houses)), 2)))
    for (i, j), weight in zip(pairs, pair_weights(CELL, houses, pairs, signed=signed), strict=True):
        (a, ga), (b, gb) = turns[i], turns[j]
        change = gb[None] - ga[:, None]
        if not signed:
            centre = CELL.reference[:2]
            start = np.arctan2(*(b - centre).T[::-1])[None] - np.arctan2(*(a - centre).T[::-1])[:, None]
            change = np.abs((change + start[..., None] + math.pi) % (2.0 * math.pi) - math.pi)
        assert np.ptp(change, axis=2).max() <= weight + 1e-9


def test_exact_for_two_posts():
    # Objects as small as points: the bound is the closed form's range over the cell's boundary.
    places = [(40.0, 30.0), (70.0, 50.0), (-50.0, 10.0), (10.0, -90.0)]
    posts = [Point(place).buffer(1e-4) for place in places]
    pairs = np.array(list(combinations(range(4), 2)))
    a, b = (np.array(places)[pairs[:, k]] for k in (0, 1))
    for signed in (True, False):
        exact = point_pair_weights(CELL, a, b, signed=signed)
        weights = pair_weights(CELL, posts, pairs, signed=signed)
        assert (weights >= exact).all()
        assert weights == pytest.approx(exact, rel=0.05, abs=2e-3)


def test_unsigned_is_less_where_left_and_right_are_exchanged():
    # Seen from either end of the cell, one post stands left of the other by the same angle.
    cell = ViewingCell("c", (-10.0, 0.0), (10.0, 0.0), 0.5, (1.5, 1.9))
    posts = [Point(0.0, 50.0).buffer(1e-4), Point(0.0, 60.0).buffer(1e-4)]
    signed, unsigned = (pair_weights(cell, posts, np.array([[0, 1]]), signed=s)[0] for s in (True, False))
    half = math.atan2(10.0, 49.5) - math.atan2(10.0, 59.5)
    assert signed == pytest.approx(2.0 * half, rel=0.02)
    assert half <= unsigned < 1.25 * half


def test_an_object_that_meets_the_cell_has_no_bound():
    far, touching = (
        box(60, 60, 70, 70),
        shapely.union(cell_region(CELL), box(0, 0, 1, 1)).convex_hull.exterior.buffer(0.5),
    )
    pairs = np.array([[0, 1], [0, 2]])
    weights = pair_weights(CELL, [far, touching, box(80, 90, 90, 99)], pairs)
    assert weights[0] == 2.0 * math.pi
    assert 0.0 < weights[1] < 0.5
    assert pair_weights(CELL, [far, touching], pairs[:1], signed=False)[0] == math.pi


def test_a_courtyard_around_the_cell_counts():
    # Its inner walls are much nearer than its outer ones.
    far = box(200, 200, 210, 210)
    around = pair_weights(CELL, [COURT, far], np.array([[0, 1]]))[0]
    filled_far_side = pair_weights(CELL, [Polygon(COURT.exterior).boundary.buffer(0.01), far], np.array([[0, 1]]))[0]
    assert around > 1.1 * filled_far_side


def test_symmetric_and_independent_of_company():
    houses = small_city(3, n=5)
    pairs = np.array([[0, 1], [2, 4], [1, 3]])
    weights = pair_weights(CELL, houses, pairs)
    assert pair_weights(CELL, houses, pairs[:, ::-1]).tolist() == weights.tolist()
    reordered = [houses[i] for i in (4, 3, 2, 1, 0)]
    assert pair_weights(CELL, reordered, 4 - pairs).tolist() == weights.tolist()


def test_moving_and_turning_the_city_changes_nothing():
    houses = [*small_city(4), MultiPolygon([box(50, 50, 55, 60), box(70, 50, 75, 60)])]
    pairs = np.array(list(combinations(range(len(houses)), 2)))
    before = pair_weights(CELL, houses, pairs)

    def moved(shape):
        return affinity.translate(affinity.rotate(shape, 37.0, origin=(0, 0)), 3000.0, -500.0)

    p, q = (moved(Point(x)).coords[0] for x in (CELL.p, CELL.q))
    cell = ViewingCell("c", p, q, CELL.half_width, CELL.eye)
    assert pair_weights(cell, [moved(one) for one in houses], pairs) == pytest.approx(before, rel=1e-6)


def test_larger_cells_and_larger_objects_weigh_more():
    houses = small_city(5)
    pairs = np.array(list(combinations(range(len(houses)), 2)))
    before = pair_weights(CELL, houses, pairs)
    longer = ViewingCell("c", CELL.p, (26.0, 12.571428571428571), 3.5, CELL.eye)
    assert (pair_weights(longer, houses, pairs) > 0.98 * before).all()
    assert np.median(pair_weights(longer, houses, pairs) / before) > 1.05
    grown = [one.buffer(1.0) for one in houses]
    assert (pair_weights(CELL, grown, pairs) > before).all()


def test_no_pairs():
    assert pair_weights(CELL, [box(50, 50, 60, 60)], np.empty((0, 2), dtype=np.int64)).shape == (0,)


def test_weights_of_the_paper_list_critical_pairs_only():
    places = [box(60, 10, 64, 16), box(90, 20, 94, 30), box(-80, 0, -70, 5)]
    objects = [CityObject(f"way/{i}", (Prism(place, 0.0, 9.0),)) for i, place in enumerate(places)]
    pairs, weights = critical_zone_weights(CELL, objects)
    assert pairs.tolist() == [[0, 1]]
    assert weights.tolist() == pair_weights(CELL, places, pairs).tolist()
    assert critical_zone_weights(CELL, objects, signed=False)[1][0] <= weights[0]
