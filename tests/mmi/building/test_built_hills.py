"""What may be seen on hills, against rays cast at everything that is drawn: meshes, prisms and the ground."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hills import Drawn, eyes_in, hilly_city, on_terrain, rectangle, ring, searching, standing, terraces, waves
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import viewpoints_within
from shapely.geometry import box

from mmi.cells.viewing_cells import ViewingCell, viewing_cells
from mmi.city.model import CityObject, Prism
from mmi.city.terrain import Terrain
from mmi.visibility.horizon import horizon_visible, prepare_horizon
from mmi.visibility.walls import walls_of


def missing_from(city, found, origins, rng):
    """What rays from ``origins`` hit that is not in the set."""
    hits = np.unique(Drawn(city).cast(origins, searching(city, origins, rng))[1])
    return [city.objects[i].id for i in np.setdiff1d(hits[hits >= 0], found)]


def cells_of(city, count, **options):
    """``count`` of its cells, from first to last."""
    names = list(graph := viewing_cells(city, **options))
    return [graph.nodes[names[i]]["cell"] for i in np.linspace(0, len(names) - 1, count).round().astype(int)]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("make", [hilly_city, terraces])
def test_no_walker_sees_what_is_not_in_the_set(make, seed):
    city, rng = make(seed), np.random.default_rng(seed)
    scene = prepare_horizon(city, shrink=(0.5, 1.0)[seed % 2])
    for cell in cells_of(city, 2):
        found, _ = horizon_visible(scene, cell)
        origins = np.concatenate([eyes_in(cell, city.terrain, 6000, rng), viewpoints_within(cell, 1500, rng)])
        # Not from under the ground: a band reaches over a whole cell.
        origins = origins[origins[:, 2] > city.ground_at(origins) + 0.1]
        assert missing_from(city, found, origins, rng) == []
        if make is terraces:
            assert len(found) < 0.85 * len(city.objects)


BUILDINGS = st.lists(
    st.tuples(
        st.floats(-70.0, 70.0),
        st.floats(-70.0, 70.0),
        st.floats(4.0, 40.0),
        st.floats(4.0, 14.0),
        st.sampled_from([0.0, 30.0, 45.0, 90.0]),
        st.sampled_from([0.5, 2.0, 4.0, 9.0, 25.0]),
        st.sampled_from([None, None, "gable", "hip"]),
    ),
    min_size=2,
    max_size=14,
)


@settings(max_examples=120, deadline=None)
@given(BUILDINGS, st.integers(0, 50), st.sampled_from([0.1, 0.3, 0.6]), st.sampled_from([0.0, 0.9, 2.2]))
def test_no_ray_hits_what_is_not_in_the_set(buildings, seed, steep, turn):
    """Buildings may overlap, stand in the way, and be lower than the eye or dug in."""
    rng, terrain = np.random.default_rng(seed), waves(seed, size=90.0, spacing=6.0, steep=steep)
    objects = []
    for i, (x, y, wide, deep, turned, height, roof) in enumerate(buildings):
        shape = rectangle(x, y, wide, deep, turned)
        objects.append(standing(str(i), shape, terrain, max(height, 3.0) if roof else height, roof=roof, rng=rng))
    reach = 12.0 * np.array([math.cos(turn), math.sin(turn)])
    city = on_terrain(terrain, *objects)
    low, high = terrain.range_over([-16.0, -16.0, 16.0, 16.0])
    cell = ViewingCell("0000-00", tuple(-reach), tuple(reach), 3.0, (low[0] + 1.5, high[0] + 1.9))
    found, _ = horizon_visible(prepare_horizon(city, shrink=0.5, columns=512), cell)
    assert missing_from(city, found, eyes_in(cell, terrain, 1500, rng), rng) == []


@pytest.mark.parametrize("seed", range(3))
def test_walls_are_seen_no_lower_than_the_set_says(seed):
    """Of plain prisms: whatever point of a wall a ray hits first, ``WallVisibility`` says that it may be seen there."""
    city, rng = terraces(seed), np.random.default_rng(seed)
    plain = tuple(CityObject(one.id, one.prisms[:1]) for one in city.objects)
    city = dataclasses.replace(city, objects=plain)
    walls = walls_of(city)
    scene = prepare_horizon(city, shrink=0.5)
    for cell in cells_of(city, 2):
        found, wall_visibility = horizon_visible(scene, cell)
        origins = eyes_in(cell, city.terrain, 6000, rng)
        directions = searching(city, origins, rng)
        far, hits = Drawn(city).cast(origins, directions)
        points = origins[hits >= 0] + far[hits >= 0, None] * directions[hits >= 0]
        checked = 0
        for point, hit in zip(points, hits[hits >= 0], strict=True):
            own = walls.of(np.array([hit]))
            a, along = walls.a[own], walls.b[own] - walls.a[own]
            length = np.hypot(*along.T)
            away = np.abs(along[:, 0] * (point[1] - a[:, 1]) - along[:, 1] * (point[0] - a[:, 0])) / length
            on = away < 1e-6
            if on.sum() == 1 and point[2] < walls.top[own][on][0] - 1e-3:
                assert point[2] >= wall_visibility.lowest[own][on][0] - 1e-6
                checked += 1
        assert checked > 300
        assert np.isin(np.unique(hits[hits >= 0]), found).all()


# By hand: a street along x on ground that is as high as ``height(x, y)``


def ground(height, *, size=150.0, spacing=5.0):
    at = np.arange(-size, size + 1.0, spacing)
    x, y = np.meshgrid(at, at)
    return Terrain((-size, -size), spacing, np.asarray(height(x, y), dtype=float) + 0.0 * x)


def visible(city, *, foot=None, **options):
    """From a cell of ten metres along x around the origin."""
    foot = float(city.ground_at([0.0, 0.0])) if foot is None else foot
    cell = ViewingCell("0000-00", (-5.0, 0.0), (5.0, 0.0), 3.0, (foot + 1.5, foot + 1.9))
    found, _ = horizon_visible(prepare_horizon(city, **options), cell)
    missing = missing_from(
        city, found, eyes_in(cell, city.terrain, 6000, np.random.default_rng(1)), np.random.default_rng(2)
    )
    assert missing == []
    return [city.objects[i].id for i in found]


SLOPE = ground(lambda _, y: 0.2 * (y + 150.0))
WALL = rectangle(0.0, 20.0, 220.0, 16.0)


def test_a_wall_downhill_hides_nothing_where_the_eye_is_above_its_roof():
    low = standing("wall", rectangle(0.0, -40.0, 220.0, 10.0), SLOPE, 2.0)
    city = on_terrain(SLOPE, low, standing("behind", rectangle(0.0, -60.0, 10.0, 10.0), SLOPE, 3.0))
    assert visible(city) == ["wall", "behind"]


def test_a_wall_uphill_hides_what_is_behind_it_unless_that_stands_higher():
    def behind(y, height):
        return standing(f"{y:.0f} m, {height:.0f} m high", rectangle(0.0, y, 10.0, 10.0), SLOPE, height)

    # The eye is 1.9 m up, the wall's front 15 m away at most: its top rises by one in one and a half.
    wall = standing("wall", WALL, SLOPE, 9.0)
    city = on_terrain(SLOPE, wall, behind(50.0, 3.0), behind(80.0, 3.0), behind(110.0, 90.0))
    assert visible(city) == ["wall", "110 m, 90 m high"]


def test_a_house_in_a_valley_is_seen_over_a_low_wall_and_not_over_a_high_one():
    valley = ground(lambda _, y: np.minimum(0.0, -0.3 * (np.abs(y) - 30.0)) + 60.0)
    house = standing("house", rectangle(0.0, 90.0, 10.0, 10.0), valley, 4.0)
    for height, seen in ((1.0, ["wall", "house"]), (6.0, ["wall"])):
        assert visible(on_terrain(valley, standing("wall", WALL, valley, height), house)) == seen


def test_a_house_that_is_behind_a_hill_is_kept():
    """The ground hides nothing by itself: no set is too small for what a mesh of it leaves out."""
    hill = ground(lambda _, y: 20.0 * np.exp(-(((y - 60.0) / 15.0) ** 2)))
    house = standing("house", rectangle(0.0, 110.0, 10.0, 10.0), hill, 3.0)
    assert visible(on_terrain(hill, house)) == ["house"]


def test_what_spans_a_valley_hides_nothing_below_it():
    """Its corners stand on the ground, and between them it is high above it."""
    gorge = ground(lambda x, _: np.minimum(0.5 * np.abs(x), 20.0))
    low, _ = gorge.range_over([30.0, 25.0, 40.0, 35.0])
    span = CityObject("span", (Prism(box(-40.0, 20.0, 40.0, 35.0), float(low[0]), 40.0),))
    city = on_terrain(gorge, span, standing("below", rectangle(0.0, 60.0, 6.0, 6.0), gorge, 3.0))
    assert visible(city) == ["span", "below"]


def test_what_floats_above_a_slope_hides_nothing():
    floating = CityObject("floating", (Prism(WALL, float(SLOPE.at([0.0, 12.0])) + 1.0, 60.0),))
    city = on_terrain(SLOPE, floating, standing("behind", rectangle(0.0, 60.0, 10.0, 10.0), SLOPE, 4.0))
    assert visible(city) == ["floating", "behind"]


def test_a_pitched_roof_hides_only_as_high_as_its_eaves_and_shows_as_high_as_its_ridge():
    rng = np.random.default_rng(3)
    gabled = standing("gabled", WALL, SLOPE, 4.0, roof="gable", rng=rng)
    plain = standing("plain", WALL, SLOPE, gabled.top - float(SLOPE.at([0.0, 28.0])))
    behind = standing("behind", rectangle(0.0, 45.0, 10.0, 10.0), SLOPE, 18.0)
    assert visible(on_terrain(SLOPE, plain, behind)) == ["plain"]
    assert visible(on_terrain(SLOPE, gabled, behind)) == ["gabled", "behind"]


def test_from_a_courtyard_on_a_slope_only_its_walls():
    yard = standing("yard", ring(0.0, 0.0, 60.0, 30.0), SLOPE, 8.0)
    objects = [
        standing(f"{x:.0f}/{y:.0f}", rectangle(x, y, 9.0, 9.0), SLOPE, 3.0)
        for x in (-45.0, 45.0)
        for y in (-45.0, 45.0)
    ]
    tower = standing("tower", rectangle(0.0, 60.0, 9.0, 9.0), SLOPE, 70.0)
    assert visible(on_terrain(SLOPE, yard, *objects, tower)) == ["yard", "tower"]


def test_lifting_everything_changes_nothing():
    city = terraces(5)
    cell = cells_of(city, 3)[1]
    up = 512.0
    terrain = dataclasses.replace(city.terrain, heights=city.terrain.heights + up)

    def lifted(prisms):
        return tuple(Prism(one.footprint, one.bottom + up, one.top + up) for one in prisms)

    objects = tuple(CityObject(one.id, lifted(one.prisms), core=lifted(one.occluders)) for one in city.objects)
    there = dataclasses.replace(city, objects=objects, terrain=terrain)
    above = dataclasses.replace(cell, eye=(cell.eye[0] + up, cell.eye[1] + up))
    (one, _), (other, _) = (horizon_visible(prepare_horizon(c), v) for c, v in ((city, cell), (there, above)))
    assert one.tolist() == other.tolist()
