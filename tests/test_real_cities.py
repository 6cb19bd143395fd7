"""Every real city of ../shared/data as a user would give it to build-impostors: it builds, or is refused with a way out."""

import json
import shlex

import pytest
from cities import HELSINKI, real
from selection import with_slow

from mmi.dataset.reading import open_dataset
from mmi.programs.build_impostors import build_impostors

FEW = ["--max-cells", "2", "--display", "128x128", "--workers", "1", "--json"]


def arguments_of(line):
    """Words of a command line; what starts with ``data:`` lies in ../shared/data."""
    words = []
    for word in shlex.split(line):
        folder, _, rest = word.removeprefix("data:").partition("/")
        words.append(str(real(folder) / rest) if word.startswith("data:") else word)
    return words


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as status:
        build_impostors([str(one) for one in arguments])
    return status.value.code, *capsys.readouterr()


BUILDS = {
    "helsinki": (str(HELSINKI), 400, {}),
    "nyc": ("data:nyc_west_village/nyc.osm.pbf", 1400, {}),
    "paris": (
        "data:paris_9e/map.osm",
        700,
        {"inferred: height from building:levels": 300, "left out: street: tunnel": 10},
    ),
    "paris, derived": (
        "data:paris_9e/derived_buildings.geojson --streets data:paris_9e/derived_streets.geojson",
        700,
        {"inferred: height from column height_m": 480},
    ),
    "lorient": (
        "data:lorient/buildings.shp --streets data:lorient/roads.shp",
        1600,
        {"inferred: height from column HEIGHT": 1600, "repaired: overlap cut away from the lower building": 1},
    ),
    "zug": (
        "data:dirty_zug_cea/building-geometry --buildings-layer zone,surroundings"
        " --streets data:dirty_zug_cea/networks/streets.shp --network walk",
        180,
        {
            "left out: building: same outline as another": 3,
            "left out: building: inside another one": 10,
            "repaired: street cut where it runs through buildings": 30,
            "warning: EPSG:32732 is used outside its area": 1,
        },
    ),
    "rome": (
        "data:dirty_osm_broken/rome.osm.pbf",
        45,
        {
            "left out: building: relation whose outer ring is incomplete": 10,
            "repaired: relation with an incomplete courtyard: courtyard filled": 1,
        },
    ),
    "redon": (
        "data:dirty_osm_broken/redon.osm",
        1000,
        {
            "left out: building: nodes missing from the file": 50,
            "repaired: street shortened where nodes are missing": 30,
            "warning: of the buildings have a height: the others are guessed": 1,
        },
    ),
    "london": (
        "data:london_strand/london.osm.pbf",
        2000,
        {"kept: building parts as prisms of their building": 400, "left out: street: tunnel": 200},
    ),
    "porto": (
        "data:porto/porto.osm.pbf",
        11000,
        {"inferred: height from the median of 8 neighbours": 10000, "warning: only 6": 1},
    ),
    "lorient with its hills": (
        "data:lorient --buildings-layer buildings --streets-layer ROADS2 --terrain data:lorient/dem.geojson",
        1600,
        {"read: points of the ground": 500},
    ),
    "the Hague": ("data:denhaag_cityjson/DenHaag_01.json", 844, {"read: triangles of the ground": 5000}),
    "Delft": ("data:delft_cityjson/delft.json", 160, {"inferred: paths through the open space": 10}),
    "Vienna in 3D": ("data:vienna_lod2_cityjsonl/vienna.jsonl", 149, {"inferred: ground from the feet": 149}),
    "tokyo": ("data:dirty_tokyo_plateau/udx/bldg/53392642_bldg_6697_op2.gml", 8, {"kept: pictures": 8}),
    "Rotterdam": ("data:textured_small/rotterdam_two_buildings", 2, {"kept: pictures": 14}),
    "railway": ("data:textured_small/railway.glb", 50, {"kept: pictures": 20}),
    "lyon": ("data:dirty_lyon_obj/ensemble_de_batiments_1.obj", 5, {}),
    "Brunswick": (
        "data:braunschweig_mesh_net/braunschweig_zup_aligned.obj --streets data:braunschweig_mesh_net/bs.net.xml",
        200,
        {"noted: opposite directions joined to one street": 50},
    ),
    "plant": ("data:stress_doua_heating_plant", 10, {}),
}
SLOW = {
    "Rotterdam",
    "nyc",
    "paris",
    "paris, derived",
    "london",
    "porto",
    "lorient with its hills",
    "the Hague",
    "Vienna in 3D",
    "railway",
    "Brunswick",
    "plant",
    "Delft",
}


@pytest.mark.parametrize("name", with_slow(BUILDS, SLOW))
def test_it_builds_and_says_what_was_mended(capsys, tmp_path, name):
    line, objects, expected = BUILDS[name]
    status, out, err = run(capsys, *arguments_of(line), "-o", tmp_path / "out", *FEW)
    assert status == 0, err
    document = json.loads(out)
    assert document["build"]["built"] == 2
    tallies = {
        f"{section.replace('_', ' ')}: {one['what']}": one["count"]
        for section in ("read", "kept", "repaired", "inferred", "noted", "left_out")
        for one in document["city"][section]
    }
    tallies |= {f"warning: {text}": 1 for text in document["city"]["warnings"]}
    for what, least in expected.items():
        section, _, words = what.partition(": ")
        found = [count for said, count in tallies.items() if said.startswith(section) and words in said]
        assert found, (what, tallies)
        assert max(found) >= least, (what, found)
    dataset = open_dataset(tmp_path / "out")
    assert dataset.manifest.city.objects >= objects
    for cell in dataset.manifest.cells:
        assert cell.near or cell.far
        assert cell.largest_weight_px <= dataset.manifest.parameters.max_error_px
        assert cell.promised_error_px == dataset.manifest.parameters.max_error_px or cell.promise_withheld


REFUSED = {
    "zug, two layers": (
        "data:dirty_zug_cea/building-geometry --streets data:dirty_zug_cea/networks/streets.shp",
        "several layers could be building polygons (surroundings, zone): choose with --buildings-layer",
    ),
    "zug, the folder above": ("data:dirty_zug_cea", "these folders in it do: building-geometry, networks"),
    "prague": (
        "data:dirty_prague_bubenec/bubenec.gpkg",
        "none of 144 buildings has a height: expected metres or levels",
    ),
    "prague, two files": (
        "data:dirty_prague_bubenec",
        "several layers could be street lines (streets, network, broken_network): choose with --streets-layer",
    ),
    "prague, layers of two places": (
        "data:dirty_prague_bubenec/tests.gpkg --streets-layer network",
        "latitude 50.0065 to 50.0371) lie apart: one declares a wrong CRS",
    ),
    "vienna": (
        "data:dirty_vienna_blocks/buildings.geojson",
        "none of 3728 buildings has a height: expected metres or levels",
    ),
    "vienna, streets of another city": (
        "data:dirty_vienna_blocks/buildings.geojson --streets data:paris_9e/derived_streets.geojson",
        "lie apart: one declares a wrong CRS",
    ),
    "two extracts": ("data:dirty_osm_broken", "found in it: redon.osm, rome.osm.pbf"),
    "tokyo, malformed": (
        "data:dirty_tokyo_plateau/udx/bldg/TestCaseOfInvalidFileNameGml.gml",
        "expected OpenStreetMap",
    ),
    "lyon, the folder": ("data:dirty_lyon_obj", "a folder; expected one file of a city"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_it_is_refused_with_a_reason_to_act_on(capsys, tmp_path, name):
    line, words = REFUSED[name]
    status, out, err = run(capsys, *arguments_of(line), "-o", tmp_path / "out", *FEW)
    assert (status, out) == (2, "")
    assert err.startswith("build-impostors: error: ")
    assert err.count("\n") == 1
    assert words in err
    assert not (tmp_path / "out").exists()
