"""Walls: nobody comes through, whatever the walls; along them one gets on."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from cities import crossroads
from hypothesis import given, settings
from hypothesis import strategies as st

from viewer.scene.walls import RADIUS, Walls, walls_of

CORNER = [shapely.box(5.0, -50.0, 10.0, 5.0), shapely.box(-50.0, 5.0, 10.0, 10.0)]
PLACE = st.tuples(st.floats(-30.0, 30.0), st.floats(-30.0, 30.0))


def walls(*polygons):
    return Walls(np.array(polygons, dtype=object))


def test_where_nothing_stands_one_goes_anywhere():
    assert walls().slide((0.0, 0.0), (3.0, 4.0)) == (3.0, 4.0)
    assert not walls().inside((0.0, 0.0))
    assert walls(*CORNER).slide((-40.0, -40.0), (-39.0, -38.0)) == (-39.0, -38.0)


def test_a_wall_stops_and_lets_slide():
    block = walls(shapely.box(5.0, -50.0, 6.0, 50.0))
    assert np.allclose(block.slide((0.0, 0.0), (20.0, 0.0)), (5.0 - RADIUS, 0.0), atol=1e-3)
    x, y = block.slide((0.0, 0.0), (10.0, 10.0))
    assert x == pytest.approx(5.0 - RADIUS, abs=1e-3)
    assert y == pytest.approx(10.0, abs=0.1)


def test_in_a_corner_one_stands():
    x, y = walls(*CORNER).slide((0.0, 0.0), (30.0, 30.0))
    assert 4.5 < x < 5.0
    assert 4.5 < y < 5.0


def test_courtyards_have_walls_too():
    ring = shapely.box(-10.0, -10.0, 10.0, 10.0).difference(shapely.box(-5.0, -5.0, 5.0, 5.0))
    yard = walls(ring)
    assert not yard.inside((0.0, 0.0))
    assert yard.slide((0.0, 0.0), (30.0, 0.0))[0] < 5.0


def test_a_passage_as_wide_as_a_viewer_can_be_walked():
    passage = walls(shapely.box(0.0, 0.25, 10.0, 5.0), shapely.box(0.0, -5.0, 10.0, -0.25))
    assert passage.slide((-1.0, 0.0), (11.0, 0.0))[0] == pytest.approx(11.0)


def test_who_is_inside_is_put_to_the_nearest_place_outside():
    block = walls(shapely.box(5.0, -50.0, 9.0, 50.0), shapely.box(1.0, -50.0, 5.0, 50.0))  # two that touch
    x, y = block.freed((4.0, 0.0))
    assert x == pytest.approx(1.0 - RADIUS, abs=0.02)
    assert y == pytest.approx(0.0, abs=1e-6)
    assert block.freed((0.5, 0.0)) == (0.5, 0.0)
    assert block.freed((1.0, 0.0))[0] == pytest.approx(1.0 - RADIUS, abs=0.02)  # in the wall itself


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(PLACE, st.floats(0.5, 8.0), st.floats(0.0, 3.0)), min_size=1, max_size=8),
    PLACE,
    st.lists(PLACE, min_size=1, max_size=5),
)
def test_nobody_comes_through_a_wall(blocks, start, ways):
    polygons = []
    for (x, y), size, turn in blocks:
        box = shapely.box(x - size, y - 1.0, x + size, y + 1.0)
        polygons.append(shapely.affinity.rotate(box, turn, use_radians=True))
    some = walls(*polygons)
    everything = shapely.union_all(polygons)
    free = shapely.box(-200.0, -200.0, 200.0, 200.0).difference(everything)
    place = some.freed(start)
    assert not some.inside(place)
    rooms = shapely.get_parts(free)
    room = next(one for one in rooms if one.distance(shapely.points(*place)) < 1e-9)
    for way in ways:
        after = some.slide(place, way)
        assert room.buffer(1e-9).covers(shapely.points(*after))  # not only outside: in the same room as before
        assert some.clearance(after) >= min(RADIUS, some.clearance(place)) - 1e-5
        assert math.dist(after, place) <= math.dist(way, place) * 1.5 + 0.5
        place = after


def test_walls_of_a_city():
    city = crossroads()
    found = walls_of(city)
    one = city.objects[0].footprint.representative_point()
    assert found.inside((one.x, one.y))
    for _, _, street in city.streets.edges(data=True):
        middle = street["geometry"].interpolate(0.5, normalized=True)
        assert not found.inside((middle.x, middle.y))


def test_what_is_overhead_or_underfoot_is_no_wall():
    city = crossroads()
    prism = city.objects[0].prisms[0]
    point = prism.footprint.representative_point()

    def blocks(bottom, top):
        lifted = replace(city.objects[0], prisms=(replace(prism, bottom=bottom, top=top),), core=None, mesh=None)
        return walls_of(replace(city, objects=(lifted,))).inside((point.x, point.y))

    assert blocks(0.0, 10.0)
    assert not blocks(4.0, 10.0)
    assert not blocks(0.0, 0.3)
