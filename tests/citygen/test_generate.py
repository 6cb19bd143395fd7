"""Generated cities: counts, walls, clearances and ground, checked on what was made."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapely
from cityjson_checks import check_cityjson

from citygen.buildings.houses import ROOF_KINDS, STYLES, house
from citygen.buildings.objects import party_walls, triangle_count
from citygen.generate import generate
from citygen.metropolis import metropolis
from citygen.presets import PRESETS
from mmi.city.model import City
from mmi.foundation.errors import ParameterError
from mmi.writing.cityjson_writer import write_cityjson

CITIES = {"hamlet": 2, "montmartre": 3, "manhattan": 1, "metropolis": 4}


@pytest.fixture(scope="module")
def cities():
    """Prisms of each kind of town."""
    return {
        name: generate(name, seed, detail=0, buildings=1000 if name == "metropolis" else None)
        for name, seed in CITIES.items()
    }


@pytest.fixture(scope="module", params=CITIES)
def city(request, cities):
    return cities[request.param]


def footprints(city):
    return np.array([one.footprint for one in city.objects], dtype=object)


def test_no_two_footprints_overlap(city):
    ground = footprints(city)
    i, j = shapely.STRtree(ground).query(ground, predicate="intersects")
    i, j = i[i < j], j[i < j]
    assert shapely.area(shapely.intersection(ground[i], ground[j])).max(initial=0.0) < 1e-6


def test_no_wall_is_shorter_than_a_hand(city):
    ground = np.array([one.footprint for one in city.objects if one.id != "church"], dtype=object)
    xy, ring = shapely.get_coordinates(shapely.get_rings(ground), return_index=True)
    assert np.hypot(*np.diff(xy, axis=0).T)[np.diff(ring) == 0].min() >= 0.1


def test_buildings_keep_off_carriageways(city):
    edges = [edge for _, _, edge in city.streets.edges(data=True)]
    lines = np.array([edge["geometry"] for edge in edges], dtype=object)
    roads = shapely.buffer(lines, [edge["half_width"] for edge in edges], cap_style="flat")
    ground = footprints(city)
    i, j = shapely.STRtree(roads).query(ground, predicate="intersects")
    assert shapely.area(shapely.intersection(ground[i], roads[j])).max(initial=0.0) < 1e-6


def test_buildings_stand_on_the_ground(city):
    for one in city.objects:
        outline = shapely.get_coordinates(shapely.segmentize(one.footprint, 1.0))
        ground = city.ground_at(outline)
        assert one.base <= ground.min() + 0.05
        if one.id != "church":
            assert one.base >= ground.min() - 0.05
        assert one.top >= ground.max() + 2.5


def test_neighbours_share_whole_walls(city):
    """What two outlines have in common is made of edges that both have."""
    rings = np.array([prism.footprint for one in city.objects for prism in one.prisms[:1]], dtype=object)
    edges = [
        {
            frozenset(map(tuple, edge))
            for ring in (polygon.exterior, *polygon.interiors)
            for edge in pairwise(np.array(ring.coords).tolist())
        }
        for polygon in rings
    ]
    i, j = shapely.STRtree(rings).query(rings, predicate="touches")
    i, j = i[i < j], j[i < j]
    common = shapely.length(shapely.intersection(shapely.boundary(rings[i]), shapely.boundary(rings[j])))
    shared = [sum(np.hypot(*np.subtract(*edge)) for edge in edges[a] & edges[b]) for a, b in zip(i, j, strict=True)]
    assert np.abs(common - shared).max(initial=0.0) < 1e-6
    # Near, but not touching: no cracks.
    a, b = shapely.STRtree(rings).query(rings, predicate="dwithin", distance=0.003)
    apart = (a < b) & (shapely.distance(rings[a], rings[b]) > 0.0)
    assert not apart.any()


def test_towns_have_party_walls(cities):
    for name, least in (("montmartre", 0.25), ("manhattan", 0.25), ("hamlet", 0.0)):
        flags = np.concatenate(party_walls(footprints(cities[name])))
        assert np.mean(flags) >= least
        assert (name == "hamlet") == (np.mean(flags) == 0.0)


def test_footprints_are_valid_and_vary(cities):
    for made in cities.values():
        assert shapely.is_valid(footprints(made)).all()
    paris = footprints(cities["montmartre"])
    corners = shapely.get_num_coordinates(shapely.simplify(paris, 0.05)) - 1
    assert (corners == 4).mean() > 0.2
    assert (corners >= 6).mean() > 0.1
    assert (shapely.area(paris) / shapely.area(shapely.convex_hull(paris)) < 0.85).mean() > 0.03  # L and U


def test_towers_step_back(cities):
    made = cities["manhattan"]
    tiered = [one for one in made.objects if len(one.prisms) > 1]
    assert len(tiered) > 100
    for one in tiered:
        for low, high in pairwise(one.prisms):
            assert low.footprint.covers(high.footprint)
            assert high.top > low.top
    heights = np.array([one.height for one in made.objects])
    assert np.median(heights) < 40.0
    assert heights.max() > 120.0


def test_houses_of_a_town_are_solids_in_a_file(cities, tmp_path):
    """Roofs over the footprints that there are, after rounding to the millimetre, by the checks that val3dity makes."""
    made = cities["montmartre"]
    rng = np.random.default_rng(5)
    houses = [
        house(
            one.id,
            one.footprint,
            base=one.base,
            eaves=one.top,
            style=STYLES[rng.integers(3)],
            roof=ROOF_KINDS[rng.integers(4)],
            detail=1,
            rng=rng,
            blind=blind,
        )
        for i, (one, blind) in enumerate(zip(made.objects, party_walls(footprints(made)), strict=True))
        if one.id != "church" and i % 16 == 0
    ]
    path = tmp_path / "houses.json"
    write_cityjson(replace(made, objects=tuple(houses)), path)
    assert len(houses) > 90
    assert check_cityjson(json.loads(path.read_text())) == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("preset", ["montmartre", "radial", "manhattan"])
def test_a_whole_town_is_solids_in_a_file(preset, seed, tmp_path):
    path = tmp_path / "town.json"
    write_cityjson(generate(preset, seed), path)
    assert check_cityjson(json.loads(path.read_text())) == []


@pytest.mark.parametrize("seed", [3, 11])
def test_montmartre_is_the_papers_model(seed, cities):
    made = cities["montmartre"] if seed == CITIES["montmartre"] else generate("montmartre", seed, detail=0)
    lines = [edge["geometry"] for _, _, edge in made.streets.edges(data=True)]
    assert made.streets.number_of_edges() == 572
    assert made.streets.number_of_nodes() == 427
    assert len(shapely.get_parts(shapely.polygonize(lines))) == 146
    assert len(made.textures) == 34
    church = made.objects[made.index()["church"]]
    assert church.base > 0.8 * made.terrain.heights.max()
    assert church.top == max(one.top for one in made.objects)
    kinds = {edge["kind"] for _, _, edge in made.streets.edges(data=True)}
    assert {"steps", "service", "residential", "secondary"} <= kinds


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_montmartre_has_the_papers_triangles(seed):
    made = generate("montmartre", seed)
    assert sum(map(triangle_count, made.objects)) == pytest.approx(143_500, rel=0.03)


def same(one: City, other: City):
    if one.index() != other.index():
        return False
    tops = [prism.top for each in (one, other) for item in each.objects for prism in item.prisms]
    half = len(tops) // 2
    edges = [[edge["geometry"] for _, _, edge in each.streets.edges(data=True)] for each in (one, other)]
    return (
        shapely.equals_exact(footprints(one), footprints(other)).all()
        and tops[:half] == tops[half:]
        and len(edges[0]) == len(edges[1])
        and shapely.equals_exact(*map(np.array, edges)).all()
    )


def test_same_seed_same_city(cities):
    for name in ("hamlet", "manhattan"):
        assert same(cities[name], generate(name, CITIES[name], detail=0))
        assert not same(cities[name], generate(name, CITIES[name] + 1, detail=0))


def test_detail_changes_only_the_looks(cities):
    plain, dressed = cities["hamlet"], generate("hamlet", CITIES["hamlet"], detail=1)
    assert len(plain.objects) == 12
    assert plain.index() == dressed.index()
    for one, other in zip(plain.objects, dressed.objects, strict=True):
        assert other.mesh is not None
        assert one.mesh is None
        assert other.prisms[0].footprint.equals(one.prisms[0].footprint)
        assert other.base == one.base


def test_metropolis_has_as_many_buildings_as_asked_for(cities):
    whole = metropolis(CITIES["metropolis"], buildings=1500, detail=0)
    districts = list(whole.districts)
    assert sum(map(len, districts)) == 1500
    assert len(districts) > 1
    assert len(cities["metropolis"].objects) == 1000
    names = [one.id for district in districts for one in district]
    assert names == [f"building/{i}" for i in range(1500)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"preset": "atlantis"}, "a preset of .* expected, found 'atlantis'"),
        ({"preset": "hamlet", "seed": -1}, "seed"),
        ({"preset": "hamlet", "detail": 4}, "detail: 0 to 3 expected, found 4"),
        ({"preset": "hamlet", "buildings": 2000}, "only metropolis"),
        ({"preset": "metropolis", "buildings": 10}, "1000 to 1000000 expected, found 10"),
    ],
)
def test_what_cannot_be_generated(arguments, message):
    with pytest.raises(ParameterError, match=message):
        generate(**arguments)


def test_presets_are_told_in_one_line():
    assert len(PRESETS) == 9
    for name, preset in PRESETS.items():
        assert preset.name == name
        assert 0 < len(preset.summary) < 100
