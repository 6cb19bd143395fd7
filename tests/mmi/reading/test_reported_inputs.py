"""Every input of ../shared/data/reports, written after bug reports of other tools: what its README says is right."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest
from cities import real

from mmi.city.model import PLAIN
from mmi.foundation.errors import CityError
from mmi.reading.maps.streets import refusal
from mmi.reading.maps.sumo import read_sumo
from mmi.reading.models.mesh_files import read_meshes
from mmi.reading.read_city import read_city
from mmi.reading.read_options import ReadOptions
from mmi.reading.report import Ledger

FOLDERS = {
    "citygml-berlin-srs", "citygml-nan", "citygml-xlink-missing", "cityjson-compound-crs", "dem-voids", "footprint-units",
    "gis-export-landuse", "gis-lines-rail-water", "gltf-edge-lines", "josm-negative-ids", "mtl-absolute-path",
    "obj-colours-255", "obj-shift-jis-names", "obj-two-mtllibs", "overpass-out-geom", "ply-concave-ngon",
    "shapefile-multipatch", "sumo-compound-types", "walk-access-no-foot-yes",
}  # fmt: skip
"""Of these, this module reads everything."""
ELSEWHERE = {"displaced-sheet"}
"""What is no matter of reading: a sheet that was displaced too far when it was built."""


def read(name, **options):
    """The city and the report of a file of ../shared/data/reports, with ``options`` of ``ReadOptions``."""
    folder = real("reports")
    files = {key: folder / options.pop(key) for key in ("streets", "terrain") if key in options}
    return read_city(folder / name, ReadOptions(**files, **options))


def lines(report, section):
    """What a section of the report counts."""
    return {one.what: one.count for one in report.sections()[section]}


def kinds(city):
    return [edge["kind"] for _, _, edge in city.streets.edges(data=True)]


def colours(layer):
    """The one colour of each object."""
    found = [np.unique(one.mesh.colors, axis=0) for one in layer.items]
    assert all(len(one) == 1 for one in found)
    assert all((one.mesh.textures == PLAIN).all() for one in layer.items)
    return [tuple(one[0].tolist()) for one in found]


def test_no_folder_is_forgotten():
    folders = {one.name for one in real("reports").iterdir() if one.is_dir()}
    assert folders - ELSEWHERE == FOLDERS


@pytest.mark.parametrize(
    ("name", "voids"),
    [("good.tif", 0), ("small_void.tif", 4), ("void.tif", 320), ("void_declared.tif", 0), ("void.asc", 320)],
)
def test_reported_voids(name, voids):
    folder = real("reports") / "dem-voids"
    city, report = read_city(folder / "city.osm", ReadOptions(terrain=folder / name))
    assert all(40.0 <= one.base <= 48.0 for one in city.objects)
    assert sum(n for what, n in lines(report, "left out").items() if "void" in what) == voids


@pytest.mark.parametrize(
    ("name", "crs"),
    [
        *(
            (f"cityjson-compound-crs/{name}.city.json", "EPSG:25833")
            for name in ("compurl", "curies", "plain", "plus", "urn")
        ),
        *((f"citygml-berlin-srs/{name}.gml", "EPSG:25833") for name in ("compound_urn", "compurl", "plus", "url")),
        *((f"citygml-berlin-srs/{name}.gml", "EPSG:25833") for name in ("urlver", "versioned")),
        ("citygml-berlin-srs/berlin.gml", "EPSG:3068"),
    ],
)
def test_reported_names_of_coordinate_systems(name, crs):
    city, _ = read_city(real("reports") / name)
    assert city.crs == crs
    assert len(city.objects) == 6


@pytest.mark.parametrize("name", ["cityjson-compound-crs/vertical.city.json", "citygml-berlin-srs/adv.gml"])
def test_reported_names_that_say_nothing_name_the_option(name):
    path = real("reports") / name
    with pytest.raises(CityError, match=r"an EPSG code expected, of a projected or geographic system.*--crs"):
        read_city(path)
    assert read_city(path, ReadOptions(crs="EPSG:25833"))[0].crs == "EPSG:25833"


@pytest.mark.parametrize("name", ["utf8", "sjis", "gbk", "l1"])
def test_reported_names(name):
    layer = read_meshes(real("reports") / f"obj-shift-jis-names/{name}.obj", Ledger())
    ids = [one.id for one in layer.items]
    number = 4 if name == "l1" else 6
    assert len(set(ids)) == len(ids) == number
    assert all(one.encode("utf-8") for one in ids)
    heights = [float(np.ptp(one.mesh.vertices[:, 2])) for one in layer.items]
    assert all(10.0 <= height <= 20.0 for height in heights)
    found = colours(layer)
    assert [found.count(one) for one in sorted(set(found))] == [number // 2] * 2


def test_reported_two_mtllibs():
    layer = read_meshes(real("reports") / "obj-two-mtllibs/city.obj", Ledger())
    assert len(layer.items) > 1
    for one in layer.items:
        assert set(map(tuple, one.mesh.colors.tolist())) == {(230, 230, 26), (26, 230, 230)}


def test_reported_colours():
    folder = real("reports") / "obj-colours-255"
    found = [read_meshes(folder / name, Ledger()).items for name in ("bytes.obj", "unit.obj")]
    assert [one.mesh.colors.tolist() for one in found[0]] == [one.mesh.colors.tolist() for one in found[1]]
    assert {tuple(one.mesh.colors[0].tolist()) for one in found[0]} == {(200, 40, 40), (40, 200, 40), (40, 40, 200)}


@pytest.mark.parametrize("name", ["edges", "edges_offset", "edges_separate"])
def test_reported_edge_lines(name):
    folder = real("reports") / "gltf-edge-lines"
    (plain, _), (city, report) = (read_city(folder / f"{one}.gltf") for one in ("plain", name))
    assert [one.id for one in city.objects] == [one.id for one in plain.objects] == [f"house{k}" for k in range(6)]
    assert nx.utils.graphs_equal(city.streets, plain.streets)
    assert [(one.what, one.count) for one in report.noted if "edges" in one.what] == [
        ("lines that draw the edges of a model: no streets", 6)
    ]


@pytest.mark.parametrize("name", ["be.ply", "city.ply", "city.off"])
def test_reported_u_shapes(name):
    folder = real("reports") / "ply-concave-ngon"
    (plain, _), (city, _) = (read_city(folder / one) for one in ("city.obj", name))
    assert [round(one.footprint.area, 3) for one in city.objects] == [480.0] * 6
    assert all(one.core for one in city.objects)
    assert [one.footprint.wkb for one in city.objects] == [one.footprint.wkb for one in plain.objects]


@pytest.mark.parametrize(("network", "ids"), [("drive", "abg"), ("walk", "abdfg")])
def test_reported_kinds(network, ids):
    folder = real("reports") / "sumo-compound-types"
    lines = read_sumo(folder / "town.net.xml", Ledger())
    used = [one.id for one in lines.items if refusal(one.tags, network, osm=False) is None]
    assert used == list(ids)
    city, _ = read_city(folder / "buildings.geojson", ReadOptions(streets=folder / "town.net.xml", network=network))
    assert city.streets.number_of_edges() == len(ids)


@pytest.mark.parametrize("name", ["buildings.geojson", "mixed.geojson"])
def test_reported_land_use(name):
    folder = real("reports") / "gis-export-landuse"
    streets = None if name == "mixed.geojson" else folder / "streets.geojson"
    city, report = read_city(folder / name, ReadOptions(streets=streets))
    assert len(city.objects) == 8
    assert {one.top for one in city.objects} == {10.0}
    assert city.streets.number_of_edges() == 1
    assert lines(report, "left out") == {"building: none (empty in the column building)": 3}


@pytest.mark.parametrize(
    ("name", "reasons"),
    [
        ("lines.geojson", ["railway", "waterway", "barrier", "power"]),
        ("overture.geojson", ["rail", "water"]),
    ],
)
def test_reported_rails_and_rivers(name, reasons):
    folder = real("reports") / "gis-lines-rail-water"
    city, report = read_city(folder / "buildings.geojson", ReadOptions(streets=folder / name))
    assert [edge["kind"] for _, _, edge in city.streets.edges(data=True)] == ["residential"]
    assert lines(report, "left out") == {f"street: no road ({reason})": 1 for reason in reasons}


@pytest.mark.parametrize(("name", "gone"), [("city", []), ("deleted", ["way/-1001"]), ("edited", ["way/1001"])])
def test_reported_files_of_an_editor(name, gone):
    city, report = read_city(real("reports") / f"josm-negative-ids/{name}.osm")
    new = [one for one in city.objects if one.id == "way/-200"]
    assert len(city.objects) == 8 - len(gone) + len(new)
    assert [one.top for one in new] == ([25.0] if name == "edited" else [])
    assert city.streets.number_of_edges() == 1
    assert [example for one in report.left_out for example in one.examples] == gone


def test_reported_access_with_foot():
    city, report = read_city(real("reports") / "walk-access-no-foot-yes/city.osm", ReadOptions(network="walk"))
    names = {edge["name"] for _, _, edge in city.streets.edges(data=True)}
    assert names == {"Precinct", "Park path", "Free"}
    assert [(one.what, one.count) for one in report.left_out] == [("street: access=no", 1)]


@pytest.mark.parametrize(("name", "number"), [("city", 8), ("city_rel", 9)])
def test_reported_places_in_ways(name, number):
    city, report = read(f"overpass-out-geom/{name}.osm")
    assert len(city.objects) == number
    assert {one.id: one.top for one in city.objects if one.id.startswith("relation")} == (
        {"relation/9": 14.0} if number == 9 else {}
    )
    assert kinds(city) == ["residential"]
    assert report.left_out == report.repaired == ()


def test_reported_json_of_overpass_is_refused_by_name():
    with pytest.raises(CityError, match=r"city\.json: JSON of Overpass .*is not read; expected OpenStreetMap"):
        read("overpass-out-geom/city.json")


@pytest.mark.parametrize(
    ("name", "by_name"), [("abs", 1), ("case", 1), ("opt", 0), ("quoted", 0), ("space", 0), ("up", 1), ("win1", 1)]
)
def test_reported_paths_of_textures(name, by_name):
    city, report = read(f"mtl-absolute-path/{name}.obj")
    assert [one.id for one in city.objects] == [f"house{k}" for k in range(6)]
    assert [one.name for one in city.textures] == ["my wall.png" if name in ("opt", "space") else "wall.png"]
    assert any((one.mesh.textures == 0).any() for one in city.objects)
    assert lines(report, "repaired").get("file found beside the model by its name", 0) == by_name
    assert not any("picture" in what for what in lines(report, "left out"))


@pytest.mark.parametrize("name", ["rings", "strips"])
def test_reported_multipatches(name):
    city, report = read(f"shapefile-multipatch/{name}.shp", streets="shapefile-multipatch/streets.geojson")
    assert [round(one.footprint.area, 6) for one in city.objects] == [180.0] * 6
    assert [one.top for one in city.objects] == [10.0, 12.0, 14.0, 16.0, 18.0, 20.0]
    assert report.left_out == ()


@pytest.mark.parametrize(
    ("name", "gone", "reason"),
    [("nan", "B2", "coordinates that are no places"), ("empty", "B3", "no surfaces above level of detail 0")],
)
def test_reported_damaged_buildings(name, gone, reason):
    city, report = read(f"citygml-nan/{name}.gml")
    assert [one.id for one in city.objects] == [f"B{k}" for k in range(6) if f"B{k}" != gone]
    assert [one.examples for one in report.left_out if one.what == f"building: {reason}"] == [(gone,)]


def test_reported_links_that_lead_nowhere():
    city, report = read("citygml-xlink-missing/town.gml")
    assert [one.id for one in city.objects] == ["B0", "B1", "B4", "B5"]
    assert {one.what: (one.count, one.examples) for one in report.left_out if one.metres is None} == {
        "surface: its link leads nowhere": (12, ("B1", "B2", "B3")),
        "building: its surfaces are links that lead nowhere": (1, ("B2",)),
        "building: no height or no area": (1, ("B3",)),
    }
    what = "building: not closed, hides what its walls enclose"
    assert [one.examples for one in report.noted if one.what == what] == [("B1",)], "it has no roof"


def test_reported_houses_below_the_ground():
    city, report = read("footprint-units/overture.geojson", streets="footprint-units/streets.geojson")
    assert {one.id: one.top for one in city.objects} == {"o0": 12.0, "o1": 12.8, "o3": pytest.approx(12.4)}
    assert [(one.what, one.examples) for one in report.left_out] == [("building: underground", ("o2",))]


@pytest.mark.parametrize(("unit", "foot"), [("ft", 0.3048), ("m", 1.0), (None, 1.0)])
def test_reported_feet(unit, foot):
    options = {"height_column": "heightroof", "height_unit": unit}
    city, report = read("footprint-units/nyc.geojson", streets="footprint-units/streets.geojson", **options)
    assert [one.top for one in city.objects] == pytest.approx([40.0 * foot, 100.0 * foot, 33.5 * foot])
    assert [text for text in report.warnings if "--height-unit ft" in text] == list(report.warnings)
    assert len(report.warnings) == (unit is None)
