"""Tours stay on the streets, go everywhere, and keep their speed."""

import itertools
import math

import networkx as nx
import numpy as np
import pytest
import shapely
from cities import HELSINKI, city_of, crossroads
from hypothesis import given, settings
from hypothesis import strategies as st

from mmi.cells.choice import spread
from mmi.cells.viewing_cells import ViewingCell, viewing_cells
from mmi.foundation.errors import ParameterError
from mmi.reading.read_city import read_city
from mmi.walks.walk import Walk
from viewer.walks.tour import tour

BAND = (1.5, 1.9)


def cell(name, p, q, half_width=3.0):
    return ViewingCell(name, p, q, half_width, BAND)


def parts(graph):
    return [graph.nodes[name]["cell"] for name in graph], {name: list(graph[name]) for name in graph}


def network(*lines, **options):
    """Cells and neighbours of streets without buildings."""
    return parts(viewing_cells(city_of(lines=lines), **options))


def path(walk, rate=50.0):
    """Times (n,), eyes (n, 3), azimuths (n,), and where the walk was cut (n,)."""
    steps = walk.frames(rate)
    return (
        np.array([step.time for step in steps]),
        np.array([step.pose.eye for step in steps]),
        np.array([step.pose.azimuth for step in steps]),
        np.array([step.cut for step in steps]),
    )


def speeds(walk, rate=50.0):
    """(n,) metres a second between frames, NaN at cuts, and (n, 2) the places."""
    _, eyes, _, cut = path(walk, rate)
    found = np.linalg.norm(np.diff(eyes, axis=0), axis=1) * rate
    found[cut[1:]] = np.nan
    return found, eyes[1:, :2]


def visited(walk, cells):
    """Cells whose middle the walk passes, in order of the first time."""
    _, eyes, _, _ = path(walk, 20.0)
    first = {}
    for one in cells:
        close = np.flatnonzero(np.linalg.norm(eyes - one.reference, axis=1) < 0.2)
        if len(close):
            first[one.id] = close[0]
    return sorted(first, key=first.get)


def area(cells):
    return shapely.union_all([shapely.Polygon(one.corners) for one in cells])


# --------------------------------------------------------------------------------------------------------- one road


def test_a_straight_road_is_walked_at_constant_speed_in_the_middle_of_the_band():
    cells, neighbours = network([(0.0, 0.0), (90.0, 60.0)], max_length=30.0)
    walk = tour(cells, neighbours, metres=25.0, speed=4.0)
    _, eyes, azimuths, cut = path(walk)
    assert walk.metres == pytest.approx(25.0, abs=1e-5)
    assert walk.seconds == pytest.approx(25.0 / 4.0, abs=1e-5)
    assert cut.sum() == 1
    assert eyes[:, 2] == pytest.approx(1.7)
    assert np.nanmax(np.abs(speeds(walk)[0] - 4.0)) < 1e-3
    away = np.abs(eyes[:, 0] * 60.0 - eyes[:, 1] * 90.0) / math.hypot(90.0, 60.0)
    assert away.max() < 1e-5
    direction = eyes[-1] - eyes[0]
    assert azimuths == pytest.approx(math.atan2(direction[1], direction[0]), abs=1e-6)


def test_at_a_dead_end_the_viewer_turns_round_in_place():
    cells, neighbours = network([(0.0, 0.0), (60.0, 0.0)], max_length=20.0)
    walk = tour(cells, neighbours, metres=300.0, speed=5.0)
    # From the middle cell to one end, back over both, to the other end: then everything was visited.
    assert walk.metres == pytest.approx(100.0, abs=1e-5)
    assert walk.seconds == pytest.approx(100.0 / 5.0 + 2.0, abs=1e-5)
    times, eyes, azimuths, cut = path(walk)
    assert cut.sum() == 1
    still = np.linalg.norm(np.diff(eyes, axis=0), axis=1) < 1e-9
    assert 1.9 < still.sum() / 50.0 <= 2.01
    assert set(np.round(eyes[1:][still][:, 0], 6)) in ({0.0}, {60.0})
    turned = np.unwrap(azimuths)
    assert abs(turned[-1] - turned[0]) == pytest.approx(math.pi, abs=1e-6)
    assert np.abs(np.diff(turned)).max() * 50.0 < math.radians(180.0)
    assert np.abs(np.diff(turned)[~still]).max() < 1e-2
    assert times[-1] <= walk.seconds


def test_a_single_short_cell():
    walk = tour([cell("a", (0.0, 0.0), (0.6, 0.0), 0.2)], {"a": ["gone"]}, metres=10.0)
    assert walk.metres == pytest.approx(0.6, abs=1e-5)
    assert len(walk.keyframes) == 2


# ---------------------------------------------------------------------------------------------------------- corners


@pytest.mark.parametrize("angle", [20.0, 45.0, 90.0, 135.0, -70.0])
@pytest.mark.parametrize("base", [0.0, 33.0])
def test_around_a_corner_the_camera_turns_smoothly_within_four_metres(angle, base):
    a, b = math.radians(base), math.radians(base + angle)
    joint = (30.0 * math.cos(a), 30.0 * math.sin(a))
    far = (joint[0] + 29.0 * math.cos(b), joint[1] + 29.0 * math.sin(b))
    cells = [cell("a", (0.0, 0.0), joint, 0.2), cell("b", joint, far, 0.2)]
    walks = (tour(cells, {"a": ["b"], "b": ["a"]}, metres=59.0, seed=seed) for seed in range(20))
    walk = next(one for one in walks if one.keyframes[0].pose.eye[:2] == (0.0, 0.0))
    _, eyes, azimuths, _ = path(walk, 200.0)
    passed = np.linalg.norm(eyes[:, :2] - joint, axis=1)
    at = int(np.argmin(passed))
    assert passed[at] < 0.03
    before, after = azimuths[:at][passed[:at] > 2.01], azimuths[at:][passed[at:] > 2.01]
    assert before == pytest.approx(math.radians(base), abs=1e-6)
    assert np.cos(after - b) == pytest.approx(1.0)
    turned = np.degrees(np.diff(np.unwrap(azimuths))) * math.copysign(1.0, angle)
    assert turned.min() > -1e-3  # never back
    assert turned.sum() == pytest.approx(abs(angle), abs=1e-3)
    assert turned.max() * 200.0 < 4.0 * abs(angle)  # degrees a second
    straight = (passed[1:] > 1.1) & (passed[:-1] > 1.1)
    found = np.linalg.norm(np.diff(eyes, axis=0), axis=1) * 200.0
    assert found[straight] == pytest.approx(5.0, rel=1e-3)
    assert found.max() < 1.6 * 5.0
    outside = shapely.distance(area(cells), shapely.points(eyes[:, :2]))
    assert outside.max() < 0.03


@pytest.mark.parametrize(("gap", "legs"), [(0.001, 1), (0.09, 1), (0.7, 1), (2.0, 1), (3.0, 2)])
def test_ends_that_all_but_meet_are_bridged(gap, legs):
    cells = [cell("a", (0.0, 0.0), (20.0, 0.0)), cell("b", (20.0 + gap, 0.0), (30.0 + gap, 0.0))]
    walk = tour(cells, {"a": ["b"], "b": ["a"]}, metres=1000.0, seed=1)
    _, _, _, cut = path(walk)
    assert cut.sum() == legs
    assert walk.metres >= 30.0 - 0.1
    found = speeds(walk)[0]
    assert np.nanmax(found) <= 1.6 * 5.0
    if legs == 1:
        on = found[found > 1e-6]  # not while turning round
        assert np.percentile(on, 10) > 0.5 * 5.0


def test_a_crooked_gap_is_crossed_straight():
    cells = [cell("a", (0.0, 0.0), (20.0, 0.0)), cell("b", (21.0, 1.0), (21.0, 30.0))]
    for seed in range(4):
        walk = tour(cells, {"a": ["b"]}, metres=60.0, seed=seed)
        _, eyes, azimuths, _ = path(walk)
        bridge = shapely.MultiLineString([[one.p, one.q] for one in cells] + [[(20.0, 0.0), (21.0, 1.0)]])
        assert shapely.distance(bridge, shapely.points(eyes[:, :2])).max() < 0.1
        turned = np.abs(np.diff(np.unwrap(azimuths)))
        assert turned.max() * 50.0 < math.radians(400.0)


def test_neighbours_that_form_a_ring_of_two_are_walked_round():
    cells = [cell("a", (0.0, 0.0), (20.0, 0.0)), cell("b", (20.0, 0.0), (0.0, 0.0))]
    walk = tour(cells, {"a": ["b"], "b": ["a"]}, metres=100.0)
    assert walk.metres == pytest.approx(40.0, abs=1e-5)
    assert walk.keyframes[0].pose.eye == pytest.approx(walk.keyframes[-1].pose.eye)


# ------------------------------------------------------------------------------------------------- where it goes


def star():
    """Four streets from one crossing, 40 m each: 0 and 1 all but in line, and so are 2 and 3."""
    return network(
        [(0.0, 0.0), (40.0, 0.0)],
        [(40.0, 0.0), (80.0, 1.0)],
        [(40.0, 0.0), (40.0, 40.0)],
        [(40.0, 0.0), (40.0, -40.0)],
        max_length=50.0,
    )


def test_the_tour_goes_straight_on_where_nothing_else_decides():
    cells, neighbours = star()
    orders = [visited(tour(cells, neighbours, metres=80.0, seed=seed), cells) for seed in range(12)]
    began_outside = [order for order in orders if len(order) == 2]
    assert len(began_outside) > 2
    for first, second in began_outside:
        assert {first, second} in ({"0000-00", "0001-00"}, {"0002-00", "0003-00"})


def test_the_tour_turns_where_straight_on_it_was_already():
    cells, neighbours = star()
    for seed in range(12):
        walk = tour(cells, neighbours, metres=1000.0, seed=seed)
        outside = walk.keyframes[0].pose.eye[:2] != (40.0, 0.0)
        # All but the first street (from its outer end) and the last are walked there and back.
        assert walk.metres == pytest.approx(240.0 if outside else 280.0, abs=0.1)


def test_the_tour_starts_in_the_middle_of_the_longest_part():
    cells, neighbours = network([(0.0, 0.0), (100.0, 0.0)], [(0.0, 50.0), (140.0, 50.0)], max_length=20.0)
    walk = tour(cells, neighbours, metres=1.0)
    x, y, _ = walk.keyframes[0].pose.eye
    assert y == 50.0
    assert x in (60.0, 80.0)


def test_scattered_cells_give_a_leg_each_always_the_nearest_next():
    rng = np.random.default_rng(5)
    cells = []
    for i, (x, y, angle) in enumerate(rng.uniform(-500.0, 500.0, (24, 3))):
        cells.append(cell(f"c{i}", (x, y), (x + 20.0 * math.cos(angle), y + 20.0 * math.sin(angle))))
    neighbours = {one.id: ["gone", "c99"] for one in cells}
    walk = tour(cells, neighbours, metres=10_000.0)
    assert walk.metres == pytest.approx(24 * 20.0, abs=1e-3)
    assert sum(keyframe.cut for keyframe in walk.keyframes) == 23
    assert not walk.keyframes[0].cut
    left = {one.id: {one.p, one.q} for one in cells}
    legs = [(a.pose.eye[:2], b.pose.eye[:2]) for a, b in itertools.pairwise(walk.keyframes) if not b.cut]
    place = None
    for start, end in legs:
        name = min(left, key=lambda name: min(math.dist(start, one) for one in left[name]))
        assert min(math.dist(start, one) for one in left[name]) < 1e-5
        if place is not None:
            nearest = min(math.dist(place, one) for ends in left.values() for one in ends)
            assert math.dist(place, start) == pytest.approx(nearest, abs=1e-5)
        del left[name]
        place = end
    assert not left


def test_the_metres_are_those_walked_also_over_cuts():
    cells = [cell(f"c{i}", (100.0 * i, 0.0), (100.0 * i + 20.0, 0.0)) for i in range(5)]
    for metres in (1.0, 20.0, 33.3, 77.0):
        assert tour(cells, {}, metres=metres).metres == pytest.approx(metres, abs=1e-5)


def test_seeds_decide_between_equals_and_nothing_else_does():
    cells, neighbours = parts(viewing_cells(crossroads(), max_length=12.0))
    walks = [tour(cells, neighbours, metres=120.0, seed=seed) for seed in range(6)]
    assert len(set(walks)) > 2
    assert walks == [tour(cells, neighbours, metres=120.0, seed=seed) for seed in range(6)]
    assert all(isinstance(walk, Walk) for walk in walks)


def test_moving_and_turning_the_city_moves_and_turns_the_tour():
    cells, neighbours = parts(viewing_cells(crossroads(), max_length=12.0))

    def move(point):
        """A quarter turn to the left, and away."""
        return 500.0 - point[1], 300.0 + point[0]

    moved = [cell(one.id, move(one.p), move(one.q), one.half_width) for one in cells]
    a, b = (tour(some, neighbours, metres=200.0, seed=3) for some in (cells, moved))
    for before, after in zip(a.keyframes, b.keyframes, strict=True):
        assert before.time == pytest.approx(after.time, abs=2e-6)
        assert move(before.pose.eye) == pytest.approx(after.pose.eye[:2], abs=2e-6)
        assert math.remainder(after.pose.azimuth - before.pose.azimuth - 0.5 * math.pi, math.tau) == pytest.approx(
            0.0, abs=1e-6
        )


@settings(max_examples=10, deadline=None)
@given(st.lists(st.integers(0, 23), min_size=1, max_size=16, unique=True), st.integers(0, 100), st.floats(15.0, 60.0))
def test_a_tour_of_any_part_of_a_grid(chosen, seed, length):
    """Some of the 24 edges of a grid of 4 x 4 crossings, 50 m apart."""
    spots = [(x, y) for x in range(4) for y in range(4)]
    edges = [(a, b) for a, b in itertools.combinations(spots, 2) if abs(a[0] - b[0]) + abs(a[1] - b[1]) == 1]
    lines = [[(50.0 * x, 50.0 * y) for x, y in edges[i]] for i in chosen]
    cells, neighbours = network(*lines, max_length=length)
    walk = tour(cells, neighbours, metres=1e5, seed=seed)
    assert set(visited(walk, cells)) == {one.id for one in cells}

    grid = nx.Graph([edges[i] for i in chosen])
    _, eyes, azimuths, cut = path(walk, 20.0)
    assert cut.sum() == nx.number_connected_components(grid)
    axes = shapely.union_all([shapely.LineString([one.p, one.q]) for one in cells])
    assert shapely.distance(axes, shapely.points(eyes[:, :2])).max() < 1e-5  # right angles leave the axes nowhere

    found, places = speeds(walk, 20.0)
    assert np.nanmax(found) < 1.6 * 5.0
    from_crossing = np.abs((places + 25.0) % 50.0 - 25.0).max(axis=1)
    straight = from_crossing > 1.5
    assert np.nanmin(found[straight]) > 0.5 * 5.0

    # Looking ahead, and round only where the street ends.
    step = np.diff(eyes, axis=0)[:, :2]
    moving = (np.linalg.norm(step, axis=1) > 1e-3) & ~cut[1:] & (from_crossing > 2.5)
    assert (np.cos(azimuths[1:][moving] - np.arctan2(step[moving, 1], step[moving, 0])) > 0.9999).all()
    still = (np.linalg.norm(step, axis=1) < 1e-6) & ~cut[1:]
    for x, y in np.unique(np.round(places[still] / 50.0), axis=0).astype(int).tolist():
        assert grid.degree[(x, y)] == 1


# ------------------------------------------------------------------------------------------------------- real streets


@pytest.fixture(scope="module")
def helsinki():
    return viewing_cells(read_city(HELSINKI)[0])


def test_helsinki(helsinki):
    cells, neighbours = parts(helsinki)
    walk = tour(cells, neighbours, metres=1000.0, seed=1)
    assert walk.metres == pytest.approx(1000.0, abs=0.1)
    _, eyes, _, cut = path(walk)
    assert cut.sum() == 1
    outside = shapely.distance(area(cells), shapely.points(eyes[:, :2]))
    assert outside.max() < 1.25  # half of the widest gap between cells that buildings cut short
    assert (outside > 0.01).mean() < 0.01
    found = speeds(walk)[0]
    assert np.nanmax(found) < 1.6 * 5.0
    assert np.nanpercentile(found, 3) > 0.5 * 5.0


def test_a_part_of_helsinki_is_walked_whole(helsinki):
    cells, neighbours = parts(helsinki)
    some = set(spread(helsinki, 24))
    few = [one for one in cells if one.id in some]
    walk = tour(few, neighbours, metres=1e4)
    assert set(visited(walk, few)) == some


# ----------------------------------------------------------------------------------------------------------- errors


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"metres": 0.0}, "more than 0 m expected, found 0.0"),
        ({"metres": math.nan}, "more than 0 m expected"),
        ({"metres": math.inf}, "more than 0 m expected"),
        ({"speed": 0.0}, "a speed above 0"),
        ({"speed": math.nan}, "a speed above 0"),
        ({"speed": 1e9}, "a speed above 0"),
        ({"speed": 1e-300}, "a number up to"),
        ({"seed": -1}, "a seed of at least 0 expected, found -1"),
    ],
)
def test_numbers_without_meaning(options, told):
    with pytest.raises(ParameterError, match=told):
        tour([cell("a", (0.0, 0.0), (20.0, 0.0))], {}, **options)


def test_cells_are_needed():
    with pytest.raises(ParameterError, match="cells to walk through expected, found none"):
        tour([], {})
