"""The programs as whoever types them meets them: one line for a mistake, exit status 0, 2 or 130, nothing lost."""

import json
import os
import re
import resource
import shlex
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import pytest
import shapely
from cities import HELSINKI
from city_files import OsmFile, degrees, geojson
from selection import with_slow
from shapely.geometry import LineString, box

from mmi.dataset.reading import open_dataset
from mmi.planning.frame_costs import FrameCosts
from mmi.programs import build_impostors as builder
from mmi.programs import inspect_layers as inspector
from mmi.programs.build_impostors import build_impostors
from mmi.programs.inspect_layers import inspect_layers
from mmi.walks.walk import Keyframe, Pose, Walk, write_walk

ROOT = Path(__file__).resolve().parents[3]
SMALL = ["--display", "128x128", "--workers", "1", "--near-distance", "20", "--geometry", "near"]
BUILD = [
    sys.executable,
    "-W",
    "error::SyntaxWarning",
    "-c",
    "from mmi.programs.build_impostors import build_impostors; build_impostors()",
]


def town(path, *, tags=None, highways=True):
    """A street with three houses on either side, as OpenStreetMap."""
    file = OsmFile()
    for i in range(3):
        for side in (-1, 1):
            y = side * 30.0
            file.box(10 * i + side + 2, 60.0 * i, y - 10, 60.0 * i + 40, y + 10, building="yes", **(tags or {}))
    if highways:
        file.way(100, [(-20.0, 0.0), (180.0, 0.0)], highway="residential", name="High Street")
    return file.write(path)


@pytest.fixture(scope="module")
def city(tmp_path_factory):
    return town(tmp_path_factory.mktemp("town") / "town.osm", tags={"height": "12"})


@pytest.fixture(scope="module")
def dataset(city, tmp_path_factory):
    out = tmp_path_factory.mktemp("built") / "out"
    with pytest.raises(SystemExit) as status:
        build_impostors([str(city), "-o", str(out), "--quiet", *SMALL])
    assert status.value.code == 0
    return out


def run(capsys, program, *arguments):
    """Exit status, stdout, stderr of a program run in this process."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as status:
        program([str(one) for one in arguments])
    return status.value.code, *capsys.readouterr()


def refusal(capsys, *arguments, program=build_impostors):
    """The one line on stderr of a program that refuses its arguments."""
    status, out, err = run(capsys, program, *arguments)
    name = program.__name__.replace("_", "-")
    assert (status, out) == (2, ""), (out, err)
    assert err.startswith(f"{name}: error: ")
    assert err.endswith("\n")
    assert err.count("\n") == 1
    return err.removeprefix(f"{name}: error: ")


# ------------------------------------------------------------------------------------------------------- options


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--max-error -1", "--max-error: a number of pixels above 0 and up to 256 expected, found -1"),
        ("--max-error 0", "--max-error: a number of pixels"),
        ("--max-error nan", "--max-error: a number of pixels"),
        ("--max-error inf", "--max-error: a number of pixels"),
        ("--max-error 300", "up to 256 expected, found 300"),
        ("--max-error ten", "--max-error: invalid float value: 'ten'"),
        ("--display 0x0", "at least 1x1 pixels, found 0x0"),
        ("--display 10x", "WIDTHxHEIGHT in pixels expected, such as 1920x1080, found '10x'"),
        ("--display -5x5", "--display"),
        ("--display 100000x100000", "--display, --fov: at most 8192 pixels a side"),
        ("--display 100000x10 --fov 179.99", "at most 8192 pixels a side"),
        ("--fov 0.1", "a focal length of at most 8192 pixels"),
        ("--fov 0", "between 0 and 180 degrees, found 0"),
        ("--fov 180", "between 0 and 180 degrees, found 180"),
        ("--fov nan", "between 0 and 180 degrees, found nan"),
        ("--workers 0", "--workers: 1 to 64 processes expected, found 0"),
        ("--workers -1", "--workers: 1 to 64 processes expected, found -1"),
        ("--workers 100000", "--workers: 1 to 64 processes expected, found 100000"),
        ("--cells unknown", "cell unknown: one of the 6 cells (0000-00, 0000-01, 0000-02, ...) expected"),
        ("--cells ''", "names with commas between expected, found ''"),
        ("--cells 0000-00,,0000-01", "names with commas between expected"),
        ("--max-cells 0", "--max-cells: a number of at least 1 expected, found 0"),
        ("--landmark x", "ID=FACTOR expected, such as way/123=4, found 'x'"),
        ("--landmark =2", "ID=FACTOR expected"),
        ("--landmark x=two", "ID=FACTOR expected"),
        ("--landmark x=nan", "landmark x: a factor of 1 or more expected, found nan"),
        ("--landmark x=inf", "landmark x: a factor of 1 or more expected, found inf"),
        ("--landmark x=0.5", "landmark x: a factor of 1 or more expected, found 0.5"),
        (
            "--landmark x=2 --landmark x=3",
            "landmark: one factor for each object expected, found (('x', 2.0), ('x', 3.0))",
        ),
        ("--landmark way/404=2", "landmark way/404: an object of town.osm expected, found none of this id"),
        ("--eye 2,1", "--eye: heights above the ground, low and high, in metres expected, found (2.0, 1.0)"),
        ("--eye a", "lowest,highest eye height in metres expected, found 'a'"),
        ("--eye nan,2", "lowest,highest eye height in metres expected"),
        ("--pictures some", "argument --pictures: invalid choice: 'some'"),
        ("--quad 7", "--quad: a multiple of 8 from 8 to 128 expected, found 7"),
        ("--sectors 1", "--sectors: 4 to 36 sectors expected, found 1"),
        ("--supersample 2", "--supersample: 1, 3 or 5 expected, found 2"),
        ("--near-distance -1", "--near-distance: a positive length in metres expected, found -1"),
        ("--near-distance nan", "--near-distance: a positive length"),
        ("--near-distance inf", "--near-distance: a positive length"),
        ("--near-triangles -1", "--near-triangles: a number of 0 or more expected, found -1"),
        ("--longest-object 9", "--longest-object: 10 metres or more, or none, expected, found 9.0"),
        ("--longest-object nan", "--longest-object: 10 metres or more, or none, expected, found nan"),
        ("--cell-length 0", "--cell-length: 5 to 500 metres expected, found 0"),
        ("--cell-length nan", "--cell-length: 5 to 500 metres expected"),
        ("--clip 10,49,9,48", "--clip: expected west < east and south < north in degrees"),
        ("--clip 1,2,3", "west,south,east,north in degrees expected, found '1,2,3'"),
        ("--clip nan,48,10,49", "west,south,east,north in degrees expected"),
        ("--clip 20,48,21,49", "no buildings within --clip 20,48,21,49"),
        ("--crs nonsense", "--crs: expected a coordinate system such as EPSG:32632, found 'nonsense'"),
        ("--crs EPSG:32632", "--crs: a file whose CRS is unknown or wrong expected"),
        ("--height-column h", "is OpenStreetMap, which has neither layers nor columns"),
        ("--streets nowhere.shp", "nowhere.shp: no such file or folder"),
        ("--near-distance 50 --near-triangles 100", "not allowed with argument --near-distance"),
        ("--cells 0000-00 --max-cells 1", "not allowed with argument --cells"),
        ("--cells 0000-00 --around way/10", "not allowed with argument --cells"),
        ("--around way/10 --max-cells 1", "not allowed with argument --around"),
        ("--around way/10 --along walk.json", "not allowed with argument --around"),
        ("--around ''", "LON,LAT or the id of an object expected, found nothing"),
        ("--around way/404", "around way/404: LON,LAT or one of the 6 objects of town.osm (way/1, way/3, way/11, ...)"),
        ("--around 24.94,60.17", "around 24.94,60.17: a place in town.osm expected, which lies at longitude "),
        ("--around -24.94,60.17", "around -24.94,60.17: a place in town.osm expected, which lies at longitude "),
        (
            "--around 500000,0",
            "longitude and latitude in degrees expected, since town.osm has the coordinate system EPSG:",
        ),
        ("--around way/1 --radius 0", "--radius: metres above 0 expected, found 0"),
        ("--around way/1 --radius nan", "--radius: metres above 0 expected, found nan"),
        ("--around way/1 --radius 5", "around way/1: a street within 5 m expected, found none, the nearest is "),
        ("--radius 5", "--radius: a place to go with it expected (--around), found none"),
        ("--along nowhere.json", "nowhere.json: a walk's JSON file expected, found: No such file or directory"),
        ("--objects trees", "invalid choice: 'trees'"),
        ("--nonsense", "unrecognized arguments: --nonsense (see build-impostors --help)"),
        ("another.osm", "unrecognized arguments: another.osm"),
    ],
)
def test_a_nonsensical_option_gets_one_line(capsys, city, tmp_path, options, words, monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    assert words in refusal(capsys, city, "-o", tmp_path / "out", *shlex.split(options))
    assert not (tmp_path / "out").exists()


def test_city_and_output_are_asked_for(capsys, city):
    assert "required: -o/--output" in refusal(capsys, city)
    assert "required: CITY" in refusal(capsys, "-o", "out")
    assert "a path expected, found nothing" in refusal(capsys, city, "-o", "")


def test_cells_around_a_house_and_along_a_walk_are_built(capsys, city, tmp_path):
    """The street is 200 m long, six cells; the walk goes on 40 m of it."""
    arguments = [city, "-o", tmp_path / "out", *SMALL]
    status, out, _ = run(capsys, build_impostors, *arguments, "--around", "way/1", "--radius", "22")
    assert status == 0
    around = [entry.id for entry in open_dataset(tmp_path / "out").manifest.cells]
    assert 0 < len(around) < 6
    assert re.search(rf"^{len(around)} cells? chosen$", out, re.MULTILINE)
    x, y = open_dataset(tmp_path / "out").manifest.cells[-1].viewing_cell.q
    walked = Walk(
        "on", (Keyframe(0.0, Pose((x + 1.0, y, 1.7), 0.0, 0.0)), Keyframe(9.0, Pose((x + 41.0, y, 1.7), 0.0, 0.0)))
    )
    write_walk(walked, tmp_path / "walk.json")
    assert run(capsys, build_impostors, *arguments, "--quiet", "--along", tmp_path / "walk.json") == (0, "", "")
    both = [entry.id for entry in open_dataset(tmp_path / "out").manifest.cells]
    assert both == [f"0000-{i:02d}" for i in range(len(around) + 2)]
    elsewhere = Walk("elsewhere", (Keyframe(0.0, Pose((900.0, 0.0, 1.7), 0.0, 0.0)),))
    write_walk(elsewhere, tmp_path / "walk.json")
    words = "walk 'elsewhere': a path along the streets expected, found one that stays "
    assert words in refusal(capsys, *arguments, "--along", tmp_path / "walk.json")


# ------------------------------------------------------------------------------------------------------- cities


def _house(x=0.0, **properties):
    return degrees(box(x, 10.0, x + 20.0, 30.0)), properties


_STREET = (degrees(LineString([(-50.0, 0.0), (50.0, 0.0)])), {"highway": "residential"})


def _swapped(feature):
    return shapely.transform(feature[0], lambda xy: xy[:, ::-1]), feature[1]


def _no_such_file(folder):
    return [folder / "city.osm"], "city.osm: no such file or folder"


def _text(folder):
    (folder / "notes.txt").write_text("Dear reader,\n")
    return [folder / "notes.txt"], "notes.txt: expected OpenStreetMap"


def _text_called_geojson(folder):
    (folder / "city.geojson").write_text("Dear reader,\n")
    return [folder / "city.geojson"], "city.geojson: expected OpenStreetMap"


def _image(folder):
    from PIL import Image

    Image.new("RGB", (8, 8)).save(folder / "city.png")
    return [folder / "city.png"], "city.png: expected OpenStreetMap"


def _mesh(folder):
    (folder / "city.obj").write_text("v 0 0 0\n")
    return [folder / "city.obj"], "city.obj: expected OBJ with faces"


def _empty(folder):
    (folder / "city").write_bytes(b"")
    return [folder / "city"], "city: an empty file is not read"


def _empty_osm(folder):
    (folder / "city.osm").write_bytes(b"")
    return [folder / "city.osm"], "city.osm: expected OpenStreetMap XML or PBF"


def _truncated_pbf(folder):
    (folder / "cut.osm.pbf").write_bytes(HELSINKI.read_bytes()[:300_000])
    return [folder / "cut.osm.pbf"], "cut.osm.pbf: expected OpenStreetMap XML or PBF, complete to its end"


def _folder(folder):
    (folder / "photos").mkdir()
    (folder / "photos" / "one.jpg").write_bytes(b"")
    return [folder / "photos"], "photos: a folder; expected one file of a city"


def _folders_of_folders(folder):
    model = '<CityModel xmlns="http://www.opengis.net/citygml/2.0"/>'
    for name, file, text in (("bldg", "one.gml", model), ("tran", "two.gml", model), ("photos", "one.jpg", "")):
        (folder / "tokyo" / "udx" / name).mkdir(parents=True)
        (folder / "tokyo" / "udx" / name / file).write_text(text)
    return [folder / "tokyo"], "that holds its files; these folders in it do: udx/bldg, udx/tran"


def _no_buildings(folder):
    return [geojson(folder / "streets.geojson", [_STREET])], "streets.geojson: expected a layer of building polygons"


def _no_streets(folder):
    city = town(folder / "town.osm", tags={"height": "12"}, highways=False)
    return [city, "--streets", city], "town.osm: no streets: no line layer or highways in it; expected streets, as"


def _no_heights(folder):
    return [town(folder / "town.osm")], "none of 6 buildings has a height"


def _no_crs(folder):
    box_ = (box(500000.0, 5300000.0, 500020.0, 5300020.0), {"height": 9})
    line = (LineString([(500000.0, 5299990.0), (500050.0, 5299990.0)]), {"highway": "residential"})
    city, streets = geojson(folder / "houses.geojson", [box_]), geojson(folder / "streets.geojson", [line])
    return [
        city,
        "--streets",
        streets,
    ], "y 5300000 to 5300020 do not fit EPSG:4326 (degrees): the CRS is unknown; name"


def _latitude_first(folder):
    city = geojson(folder / "houses.geojson", [_swapped(_house(height=9))])
    streets = geojson(folder / "streets.geojson", [_STREET])
    return [city, "--streets", streets], "latitude"


def _no_room(folder):
    file = OsmFile()
    file.box(1, 0.0, 10.0, 20.0, 30.0, building="yes", height="9")
    file.way(2, [(0.0, 20.0), (20.0, 20.0)], highway="residential")
    return [file.write(folder / "tiny.osm")], "tiny.osm: no streets left for --network drive"


@pytest.mark.parametrize(
    "make",
    [
        _no_such_file,
        _text,
        _text_called_geojson,
        _image,
        _mesh,
        _empty,
        _empty_osm,
        _truncated_pbf,
        _folder,
        _folders_of_folders,
        _no_buildings,
        _no_streets,
        _no_heights,
        _no_crs,
        _latitude_first,
        _no_room,
    ],
)
def test_what_is_not_a_city_gets_one_line(capsys, tmp_path, make):
    arguments, words = make(tmp_path)
    assert words in refusal(capsys, *arguments, "-o", tmp_path / "out")
    assert not (tmp_path / "out").exists()


# ------------------------------------------------------------------------------------------------- output folders


def test_a_foreign_folder_is_left_as_it_is(capsys, city, tmp_path):
    (tmp_path / "diary.txt").write_text("Monday")
    assert "found other files (diary.txt); nothing was changed" in refusal(capsys, city, "-o", tmp_path)
    assert [one.name for one in tmp_path.iterdir()] == ["diary.txt"]


def test_a_build_killed_before_it_signed_its_folder_can_be_started_again(capsys, city, tmp_path):
    (tmp_path / "out" / "cells").mkdir(parents=True)
    (tmp_path / "out" / ".lock").write_bytes(b"")
    (tmp_path / "out" / "build.json.part-123").write_bytes(b"{")
    arguments = [city, "-o", tmp_path / "out", "--max-cells", "1", "--quiet", *SMALL]
    assert run(capsys, build_impostors, *arguments) == (0, "", "")
    assert not (tmp_path / "out" / "build.json.part-123").exists()
    (tmp_path / "other" / "cells").mkdir(parents=True)
    (tmp_path / "other" / "cells" / "blood.txt").write_text("A+")
    assert "found other files (cells)" in refusal(capsys, city, "-o", tmp_path / "other")


def test_a_folder_that_cannot_be_made_gets_one_line(capsys, city, tmp_path):
    (tmp_path / "file").write_text("Monday")
    assert "file: a folder for the dataset expected, found a file" in refusal(capsys, city, "-o", tmp_path / "file")
    assert "cannot be written (Not a directory)" in refusal(capsys, city, "-o", tmp_path / "file" / "out")
    assert "/proc/out: cannot be written" in refusal(capsys, city, "-o", "/proc/out")
    assert (tmp_path / "file").read_text() == "Monday"


@contextmanager
def file_size_limit(size):
    """A disk with room for files of this size and no larger."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_gets_one_line_and_the_build_goes_on_later(capsys, city, dataset, tmp_path):
    largest = max(path.stat().st_size for path in dataset.glob("cells/*.*"))
    arguments = [city, "-o", tmp_path / "out", "--quiet", *SMALL]
    assert run(capsys, build_impostors, *arguments, "--max-cells", "1") == (0, "", "")
    with file_size_limit(largest - 1):
        line = refusal(capsys, *arguments)
    assert re.search(r"cells/\S+\.(exr|glb): (the disk is full|cannot be written).*finished cells are kept", line), line
    assert not list((tmp_path / "out").rglob("*.part*")), "half a file would take room that is asked for"
    assert run(capsys, build_impostors, *arguments) == (0, "", "")
    for path in dataset.rglob("*.*"):
        again = tmp_path / "out" / path.relative_to(dataset)
        assert path.name == "build.json" or again.read_bytes() == path.read_bytes()


def test_a_mistake_in_a_later_run_leaves_the_dataset_alone(capsys, city, dataset, tmp_path):
    before = {path: path.stat().st_mtime_ns for path in dataset.rglob("*")}
    refusal(capsys, city, "-o", dataset, "--landmark", "way/404=2", *SMALL)
    refusal(capsys, tmp_path / "gone.osm", "-o", dataset, *SMALL)
    assert {path: path.stat().st_mtime_ns for path in dataset.rglob("*")} == before


# --------------------------------------------------------------------------------------------------------- output


def test_json_is_one_document_with_report_and_summary(capsys, city, dataset):
    status, out, err = run(capsys, build_impostors, city, "-o", dataset, "--json", *SMALL)
    document = json.loads(out)
    assert status == 0
    assert document["city"]["source"] == "town.osm"
    assert document["build"]["complete"] == document["build"]["cells"] == 6
    assert "town.osm" in err, "the tables for people go to stderr"


def test_the_report_says_what_was_read_and_made(capsys, city, dataset):
    status, out, err = run(capsys, build_impostors, city, "-o", dataset, *SMALL)
    assert (status, err) == (0, "")
    assert re.search(r"read +buildings +6", out)
    assert "0 cells built, 6 were complete" in out
    assert f"{dataset}: 6 cells" in out


def test_what_the_city_costs_stands_in_a_table(capsys, city, tmp_path):
    out = tmp_path / "out"
    status, text, _ = run(capsys, build_impostors, city, "-o", out, *SMALL, "--max-cells", "1", "--geometry", "cheaper")
    assert status == 0
    manifest = open_dataset(out).manifest
    (cell,) = manifest.cells
    told = {line.split("  ")[0]: line.split() for line in text.splitlines() if line}
    assert told["as read"][2] == "60", "six houses of four walls and a roof"
    assert told["stored: 1 cell"][3] == f"{cell.triangles:,}"
    assert told["a frame, as stored"][4] == f"{cell.near_triangles + cell.triangles:,}"
    assert told["a frame, as geometry"][4] == f"{cell.frame.geometry.triangles:,}"
    assert told["all cells, estimated"][-2:] == ["0.2", "km"]
    assert cell.near_triangles + cell.triangles <= cell.frame.geometry.triangles
    assert ("1 cell of 1 (100%) stay geometry" in text) == (not cell.pictures)
    assert "px of 10 px" in text


def test_a_threshold_that_would_be_seen_is_pointed_out(capsys, city, tmp_path):
    large = ("--max-cells", "1", "--display", "512x512")
    _, text, _ = run(capsys, build_impostors, city, "-o", tmp_path / "out", *SMALL, *large)
    words = "10 px of 512x512 are as wide as 37.5 px of 1920x1080, where they would be seen; --for laptop is 5 px there"
    assert f"note: {words}\n" in text
    _, text, _ = run(capsys, build_impostors, city, "-o", tmp_path / "fine", *SMALL, *large, "--max-error", "2.5")
    assert "note:" not in text


def test_costs_are_told_as_triangles(capsys, city, tmp_path):
    words = refusal(capsys, city, "-o", tmp_path / "out", "--costs", "1,2")
    assert words.startswith("argument --costs: triangles for a draw, a thousand texels, a thousand bytes")
    words = refusal(capsys, city, "-o", tmp_path / "out", "--costs=-1,2,3")
    assert words.startswith("argument --costs: a number of triangles from 0 to 1e+12 for a draw expected, found -1")
    words = refusal(capsys, city, "-o", tmp_path / "out", "--geometry", "near", "--costs", "1,2,3")
    assert words == "--costs: --geometry cheaper expected, which compares them, found near\n"
    cheaper = (*SMALL, "--max-cells", "1", "--geometry", "cheaper", "--costs", "0,0,5")
    status, _, _ = run(capsys, build_impostors, city, "-o", tmp_path / "out", *cheaper)
    assert status == 0
    assert open_dataset(tmp_path / "out").manifest.parameters.costs == FrameCosts(0.0, 0.0, 5.0)


@pytest.mark.parametrize(
    ("options", "longest", "objects"),
    [
        ([], 40.0, None),
        (["--longest-object", "50"], 50.0, 6),
        (["--longest-object", "25"], 25.0, 12),
        (["--longest-object", "0"], None, 6),
        (["--objects", "blocks"], None, 6),
        (["--objects", "blocks", "--longest-object", "25"], 25.0, 12),
    ],
)
def test_long_objects_are_cut_as_asked_for(capsys, city, tmp_path, options, longest, objects):
    """Houses of the town are 40 m long, but for rounding."""
    status, out, _ = run(capsys, build_impostors, city, "-o", tmp_path / "out", "--max-cells", "1", *options, *SMALL)
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert status == 0
    assert manifest["parameters"]["longest_object"] == longest
    assert objects in (None, manifest["city"]["objects"])
    assert ("12 parts of objects longer than 25 m" in out) == (objects == 12)


def test_quiet_prints_nothing(capsys, city, dataset):
    assert run(capsys, build_impostors, city, "-o", dataset, "--quiet", *SMALL) == (0, "", "")


@pytest.mark.parametrize("program", [build_impostors, inspect_layers])
def test_examples_of_the_help_are_understood(capsys, program, monkeypatch):
    status, out, _ = run(capsys, program, "--help")
    name = program.__name__.replace("_", "-")
    examples = re.findall(rf"^  {name} (.+)$", out, flags=re.M)
    assert status == 0
    assert len(examples) >= 2
    seen = []
    monkeypatch.setattr(builder, "_build", lambda options: seen.append(builder._parameters(options)))
    monkeypatch.setattr(inspector, "_inspect", seen.append)
    for example in examples:
        assert run(capsys, program, *shlex.split(example)) == (0, "", "")
    assert len(seen) == len(examples)


def test_help_does_not_load_what_a_build_needs():
    code = (
        "import sys, mmi.programs.build_impostors\n"
        "try: mmi.programs.build_impostors.build_impostors(['--help'])\n"
        "except SystemExit: pass\n"
        "print(sorted({'numba', 'pyrender', 'osmium', 'geopandas', 'matplotlib', 'rich'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_progress_is_shown_on_a_terminal_only(city, dataset):
    ours, theirs = os.openpty()
    command = [*BUILD, city, "-o", dataset, *SMALL]
    shown = b""
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=theirs, env=os.environ | {"TERM": "xterm"}
    ) as program:
        os.close(theirs)
        # Read while it runs: a terminal that nobody reads holds a few kilobytes, then the program waits.
        with open(ours, "rb", buffering=0) as terminal, suppress(OSError):  # noqa: PTH123
            while more := terminal.read(65536):
                shown += more
    assert program.returncode == 0
    assert b"steps of reading" in shown
    assert b"cells" in shown
    assert b"preparing" in shown
    done = subprocess.run(command, capture_output=True, check=True)
    assert done.stderr == b""


def test_whoever_stops_reading_the_output_sees_no_traceback(city, dataset):
    with subprocess.Popen(
        [*BUILD, city, "-o", dataset, *SMALL], stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT
    ) as process:
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait() == 0


@pytest.mark.parametrize("workers", with_slow([1, 2], {1}))
def test_ctrl_c_loses_nothing_and_leaves_nobody_behind(capsys, tmp_path, workers):
    out = tmp_path / "out"
    arguments = [str(HELSINKI), "-o", str(out), "--display", "128x128", "--max-cells", "60", "--workers", str(workers)]
    process = subprocess.Popen(
        [*BUILD, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True, text=True
    )
    while process.poll() is None and len(list(out.glob("cells/*.json"))) < 2:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to parent and workers alike
    stdout, stderr = process.communicate(timeout=30)
    assert process.returncode == 130
    assert stderr == "build-impostors: interrupted; what was finished is kept, the same command goes on from there\n"
    assert "Traceback" not in stdout
    deadline = time.monotonic() + 10.0
    while (left := _running(process.pid)) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not left
    finished = len(list(out.glob("cells/*.json")))
    assert 2 <= finished < 60
    status, document, _ = run(capsys, build_impostors, *arguments[:-4], "--cells", _finished(out), "--json")
    assert status == 0
    assert json.loads(document)["build"]["complete"] >= 2


def _running(group):
    """Processes of a group that are alive; one that ended and was not collected by its parent yet is not."""
    listing = subprocess.run(["ps", "-e", "-o", "pgid=,stat=,args="], capture_output=True, text=True, check=True).stdout
    fields = [line.split(maxsplit=2) for line in listing.splitlines()]
    return [one for one in fields if one[0] == str(group) and not one[1].startswith("Z")]


def _finished(out):
    return ",".join(path.stem for path in sorted(out.glob("cells/*.json")))


def test_one_layer_for_all_far_objects(capsys, city, dataset, tmp_path):
    status, _, err = run(
        capsys, build_impostors, city, "-o", tmp_path / "out", *SMALL, "--layering", "single", "--quiet"
    )
    assert (status, err) == (0, "")
    single, best = open_dataset(tmp_path / "out").manifest, open_dataset(dataset).manifest
    assert single.parameters == replace(best.parameters, layering="single")
    for one, other in zip(single.cells, best.cells, strict=True):
        assert (one.near, one.far) == (other.near, other.far)
        assert {layer.index for sector in one.layers for layer in sector} <= {0}
        assert one.promised_error_px is None


def test_a_manifest_that_was_edited_is_refused_and_mended_by_the_same_command(capsys, city, tmp_path):
    command = [city, "-o", tmp_path / "out", *SMALL, "--quiet"]
    run(capsys, build_impostors, *command)
    manifest = tmp_path / "out" / "manifest.json"
    before = manifest.read_bytes()
    manifest.write_bytes(before.replace(b'"half_width": ', b'"half_width": 1', 1))
    said = refusal(capsys, tmp_path / "out", "-o", tmp_path / "plots", program=inspect_layers)
    assert "manifest.json: the checksum that build-impostors wrote expected, found other contents" in said
    run(capsys, build_impostors, *command)
    assert manifest.read_bytes() == before
    status, _, err = run(capsys, inspect_layers, tmp_path / "out", "-o", tmp_path / "plots")
    assert (status, err) == (0, "")


# -------------------------------------------------------------------------------------------------- inspect-layers


def test_inspect_layers_lists_what_it_draws(capsys, dataset, tmp_path):
    status, out, err = run(capsys, inspect_layers, dataset, "-o", tmp_path / "plots", "--cell", "0000-02", "--json")
    assert (status, err) == (0, "")
    written = [Path(one) for one in json.loads(out)]
    assert all(path.stat().st_size > 1000 for path in written)
    assert {path.name for path in written} >= {"0000-02-map.png", "0000-02-graph.png", "histograms.png"}


def test_inspect_layers_refuses_what_is_no_dataset(capsys, dataset, tmp_path):
    def line(path, *options):
        return refusal(capsys, path, "-o", tmp_path / "plots", *options, program=inspect_layers)

    assert "the folder of a dataset expected, found nothing" in line(tmp_path / "nowhere")
    (tmp_path / "file").write_text("")
    assert "the folder of a dataset expected, found a file" in line(tmp_path / "file")
    (tmp_path / "other").mkdir()
    assert "no manifest.json here; it is not a dataset" in line(tmp_path / "other")
    unfinished = tmp_path / "unfinished"
    unfinished.mkdir()
    (unfinished / "build.json").write_bytes((dataset / "build.json").read_bytes())
    assert "its build was not finished: run build-impostors again" in line(unfinished)
    for damaged in ("{", "[]", '{"format_version": 99}', '{"format_version": 2, "cells": []}'):
        (unfinished / "manifest.json").write_text(damaged)
        assert "manifest.json: " in line(unfinished)
    assert "no cell '9999-99'; there are 6, such as 0000-00" in line(dataset, "--cell", "9999-99")
    assert not (tmp_path / "plots").exists()


def test_inspect_layers_refuses_a_folder_that_it_cannot_make(capsys, dataset, tmp_path):
    (tmp_path / "file").write_text("")
    assert "a folder for the pictures expected" in refusal(
        capsys, dataset, "-o", tmp_path / "file" / "plots", program=inspect_layers
    )


def test_the_small_town_is_one_that_has_layers(dataset):
    """Else the tests above would not see a cell's files written."""
    assert sum(map(bool, (sector for one in open_dataset(dataset).manifest.cells for sector in one.layers))) > 3
