"""Real cities of ../shared/data: everything read is accounted for, and what comes out is sound."""

from __future__ import annotations

import json

import numpy as np
import pytest
import shapely
from cities import HELSINKI, SHARED, real
from selection import with_slow

from mmi.foundation.errors import CityError
from mmi.reading.read_city import read_city
from mmi.reading.read_options import ReadOptions

ZUG = {"buildings_layer": "zone,surroundings"}
CITIES = {
    "helsinki": (HELSINKI, None, {}),
    "nyc": (SHARED / "nyc_west_village/nyc.osm.pbf", None, {}),
    "paris": (SHARED / "paris_9e/map.osm", None, {}),
    "london": (SHARED / "london_strand/london.osm.pbf", None, {"network": "all"}),
    "porto": (SHARED / "porto/porto.osm.pbf", None, {}),
    "lorient": (SHARED / "lorient/buildings.shp", SHARED / "lorient/roads.shp", {}),
    "lorient, the other roads": (SHARED / "lorient", None, {"streets_layer": "ROADS2", "buildings_layer": "buildings"}),
    "zug": (
        SHARED / "dirty_zug_cea/building-geometry",
        SHARED / "dirty_zug_cea/networks/streets.shp",
        ZUG | {"network": "walk"},
    ),
    "rome": (SHARED / "dirty_osm_broken/rome.osm.pbf", None, {}),
    "redon": (SHARED / "dirty_osm_broken/redon.osm", None, {"network": "all"}),
    "london, by GDAL": (
        SHARED / "london_strand/derived_buildings.geojson",
        SHARED / "london_strand/derived_streets.geojson",
        {"network": "all"},
    ),
}


def read(name, **options):
    path, streets, own = CITIES[name]
    return read_city(real(path), ReadOptions(streets=streets, **(own | options)))


def tally(report, section, start=""):
    return sum(one.count for one in report.sections()[section] if one.what.startswith(start))


@pytest.fixture(scope="module", params=with_slow(CITIES, {"london, by GDAL", "porto"}))
def reading(request):
    return read(request.param)


def test_every_building_is_accounted_for(reading):
    city, report = reading
    parts = tally(report, "kept", "building parts")
    assert tally(report, "read", "building") == len(city.objects) + parts + tally(report, "left out", "building:")


def test_every_height_has_a_source(reading):
    _, report = reading
    gone = ("building: inside", "building: same outline")
    heights = tally(report, "kept", "buildings") + tally(report, "kept", "building parts")
    assert tally(report, "inferred") in range(
        heights, heights + sum(tally(report, "left out", one) for one in gone) + 1
    )


def test_objects_are_sound(reading):
    city, _ = reading
    prisms = [prism for one in city.objects for prism in one.prisms]
    footprints = np.array([prism.footprint for prism in prisms], dtype=object)
    assert shapely.is_valid(footprints).all()
    assert shapely.area(footprints).min() >= 1.0
    assert max(prism.top for prism in prisms) < 300
    assert min(prism.bottom for prism in prisms) == 0.0
    x0, y0, x1, y1 = city.bounds
    assert max(-x0, -y0, x1, y1) < 4000


def test_no_two_buildings_fill_the_same_space(reading):
    city, _ = reading
    prisms = [(i, prism) for i, one in enumerate(city.objects) for prism in one.prisms if prism.bottom == 0.0]
    shapes = np.array([prism.footprint for _, prism in prisms], dtype=object)
    owners = np.array([i for i, _ in prisms])
    a, b = shapely.STRtree(shapes).query(shapes, predicate="intersects")
    other = (a < b) & (owners[a] != owners[b])
    shared = shapely.area(shapely.intersection(shapes[a[other]], shapes[b[other]]))
    assert shared.max(initial=0.0) <= 0.05


def test_streets_are_a_graph_outside_the_buildings(reading):
    city, report = reading
    edges = [edge for _, _, edge in city.streets.edges(data=True)]
    assert sorted(edge["index"] for edge in edges) == list(range(len(edges)))
    for a, b, edge in city.streets.edges(data=True):
        ends = edge["geometry"].coords
        low, high = (city.streets.nodes[min(a, b)], city.streets.nodes[max(a, b)])
        assert (ends[0], ends[-1]) == ((low["x"], low["y"]), (high["x"], high["y"]))
        assert 0.5 <= edge["half_width"] <= 40
    walls = np.array([p.footprint for one in city.objects for p in one.prisms if p.bottom < 2.5], dtype=object)
    lines = np.array([edge["geometry"] for edge in edges], dtype=object)
    line, wall = shapely.STRtree(walls).query(lines, predicate="intersects")
    inner = shapely.buffer(walls[wall], -0.002)  # coordinates are rounded to 1 mm
    assert shapely.length(shapely.intersection(lines[line], inner)).max(initial=0.0) < 0.01
    (kept,) = [one for one in report.kept if one.what.startswith("street")]
    assert kept.metres == pytest.approx(shapely.length(lines).sum())


def test_reports_print_and_save(reading):
    _, report = reading
    assert all(len(row) == 4 and "\n" not in "".join(row) for row in report.rows())
    assert json.loads(json.dumps(report.as_dict())) == report.as_dict()


def test_reading_twice_gives_the_same():
    (one, first), (two, second) = read("london"), read("london")
    assert [(a.id, a.footprint.wkb, a.top) for a in one.objects] == [
        (b.id, b.footprint.wkb, b.top) for b in two.objects
    ]
    assert [(a, b, e["geometry"].wkb) for a, b, e in one.streets.edges(data=True)] == [
        (a, b, e["geometry"].wkb) for a, b, e in two.streets.edges(data=True)
    ]
    assert first.as_dict() == second.as_dict()


def holes(footprint):
    return shapely.get_num_interior_rings(shapely.get_parts(footprint)).sum()


def test_our_rings_agree_with_osmiums_areas():
    """Oracle: the derived files were assembled by osmium's own area code and projected by GDAL."""
    ours, _ = read("paris")
    folder = real("paris_9e")
    theirs, _ = read_city(folder / "derived_buildings.geojson", ReadOptions(streets=folder / "derived_streets.geojson"))
    shift = np.subtract(theirs.origin[:2], ours.origin[:2])
    other = {one.id: shapely.transform(one.footprint, lambda xy: xy + shift) for one in theirs.objects}
    assert len(other) == len(ours.objects)
    for one in ours.objects:
        id_ = one.id[0] + one.id.split("/")[1]
        assert holes(one.footprint) == holes(other[id_])
        assert one.footprint.symmetric_difference(other[id_]).area < 0.02 * one.footprint.length
    assert sum(holes(one.footprint) for one in ours.objects) > 100


def test_blocks_hold_the_prisms_of_their_buildings():
    city, _ = read("paris")
    blocks, _ = read("paris", objects="blocks")
    assert sum(len(one.prisms) for one in blocks.objects) == sum(len(one.prisms) for one in city.objects)
    assert len(blocks.objects) < len(city.objects) / 5
    assert {one.id for one in blocks.objects} <= {one.id for one in city.objects}


def test_zug_lies_in_the_north():
    city, report = read("zug")
    assert city.crs == "EPSG:32632"
    assert any("outside its area" in text for text in report.warnings)
    assert read("zug", crs="EPSG:32732")[0].origin == city.origin


REFUSED = {
    "braunschweig_mesh_net/bs3.3ds": "convert it",
    "dirty_tokyo_plateau/udx/bldg/TestCaseOfInvalidFileNameGml.gml": "expected OpenStreetMap",
    "dirty_prague_bubenec/bubenec.gpkg": "none of 144 buildings has a height",
    "dirty_vienna_blocks/buildings.geojson": "none of 3728 buildings has a height",
    "dirty_zug_cea/topography/terrain.tif": "expected OpenStreetMap",
    "dirty_zug_cea/building-geometry": r"several layers could be building polygons \(surroundings, zone\)",
    "lorient": r"several layers could be street lines \(ROADS2, roads\)",
    "README.md": "expected OpenStreetMap",
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_used_is_refused_in_one_line(name):
    path = real(name)
    before = sorted(path.parent.iterdir())
    with pytest.raises(CityError, match=REFUSED[name]) as caught:
        read_city(path)
    assert "\n" not in str(caught.value)
    assert sorted(path.parent.iterdir()) == before  # GDAL likes to leave files behind


@pytest.mark.parametrize("name", ["porto/porto.osm.pbf", "paris_9e/map.osm"])
def test_truncated_extracts_are_refused(tmp_path, name):
    path = real(name)
    half = tmp_path / path.name
    half.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(CityError, match="complete to its end"):
        read_city(half)
