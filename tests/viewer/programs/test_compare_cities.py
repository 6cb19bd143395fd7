"""``compare-impostors`` straight from a city, and on another display than the one that a dataset was built for."""

import json
import re
import weakref
from pathlib import Path

import jsonschema
import pytest
from cities import crossroads
from moving import movers_of

import viewer
from mmi.movers.movers_file import write_movers
from viewer.caching.rules import CacheRules
from viewer.casting.panorama import Panorama
from viewer.programs import compare_impostors as program
from viewer.programs.compare_impostors import _OF_CITIES, compare_impostors
from viewer.report.compare import compare_views
from viewer.report.options import OF_CITIES, CompareOptions
from viewer.techniques import ray_cast

SCHEMA = json.loads((Path(viewer.__file__).parent / "report" / "schemas" / "report.json").read_text())
OWN = """\
import numpy as np
from viewer import Objects, Plan, Sky

class Some:
    name = "some"
    def __init__(self, scene):
        self.scene = scene
    def plan(self, view, *, now, budget):
        return Plan((Objects("some", np.arange(1)), self.scene.ground_in(view), Sky()))

def some(scene):
    return Some(scene)

def needs_cells(scene):
    return scene.dataset
"""


def feature(kind, coordinates, **properties):
    return {"type": "Feature", "properties": properties, "geometry": {"type": kind, "coordinates": coordinates}}


def collection(*features):
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::32635"}}
    return json.dumps({"type": "FeatureCollection", "crs": crs, "features": features})


def box(x, y, width, depth):
    return [[[x, y], [x + width, y], [x + width, y + depth], [x, y + depth], [x, y]]]


@pytest.fixture
def town(tmp_path, monkeypatch):
    """Two houses along a street, as files; a module of techniques beside them, in the current folder."""
    monkeypatch.setattr(program, "usable_cores", lambda: 1)
    x, y = 385000.0, 6672000.0
    houses = [feature("Polygon", box(x + 30 * i, y + 8, 20, 12), height=10.0 + i, id=i) for i in range(2)]
    (tmp_path / "houses.geojson").write_text(collection(*houses))
    (tmp_path / "street.geojson").write_text(
        collection(feature("LineString", [[x - 20, y], [x + 80, y]], highway="residential"))
    )
    (tmp_path / "techniques_of_cities.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    return "houses.geojson", "--streets", "street.geojson"


def run(capsys, *arguments):
    """(exit status, output, errors)."""
    with pytest.raises(SystemExit) as left:
        compare_impostors([str(one) for one in arguments])
    captured = capsys.readouterr()
    return left.value.code, captured.out, captured.err


SMALL = ["--display", "96x64", "--fov", "80", "--no-flip"]


def test_a_city_is_compared_without_a_dataset(capsys, town):
    techniques = ["--techniques", "full,techniques_of_cities:some"]
    status, out, err = run(capsys, *town, "-o", "r", "--views", 3, "--settle", 2, *techniques, *SMALL, "--quiet")
    assert (status, out, err) == (0, "", "")
    report = json.loads(Path("r/report.json").read_text())
    jsonschema.validate(report, SCHEMA)
    nothing = dict.fromkeys(("built_for", "max_error_px", "promised_px", "promising_cells"))
    assert (
        report["source"] == {"kind": "city", "name": "houses.geojson", "city": "houses.geojson", "cells": 3} | nothing
    )
    assert report["display"] == {"width": 96, "height": 64, "fov_deg": pytest.approx(80.0)}
    own = report["techniques"]["techniques_of_cities:some"]
    assert own["settling"]["layers"] is own["settling"]["later_than_layers"] is None
    assert own["wrong_share"] >= 0.0
    page = Path("r/report.html").read_text()
    assert "drawn as it was read, without a dataset; its streets have 3 cells" in page
    assert "promise" not in page


def test_a_city_is_toured_and_its_table_needs_no_promise(capsys, town):
    walk = ["--tour", 20, "--fps", 2, "--scored", 2, "--techniques", "techniques_of_cities:some,full"]
    status, out, _ = run(capsys, *town, "-o", "r", *walk, *SMALL)
    assert status == 0
    assert "houses.geojson: 2 views at 96 x 64" in out
    assert "built for" not in out
    report = json.loads(Path("r/report.json").read_text())
    jsonschema.validate(report, SCHEMA)
    assert report["walk"]["metres"] == pytest.approx(20.0, abs=2.0)


def test_warnings_of_the_files_are_given(capsys, town):
    """Longitudes of a street far away are said to be left out."""
    street = collection(
        feature("LineString", [[384980.0, 6672000.0], [385080.0, 6672000.0]], highway="residential"),
        feature("LineString", [[385000.0, 6690000.0], [385080.0, 6690000.0]], highway="residential"),
    )
    Path("street.geojson").write_text(street)
    arguments = [*town, "-o", "r", "--views", 1, *SMALL]
    status, out, _ = run(capsys, *arguments)
    assert status == 0
    warned = re.findall(r"^warning: .*$", out, re.MULTILINE)
    from mmi.programs.build_impostors import build_impostors

    with pytest.raises(SystemExit):
        build_impostors([*town, "-o", "built", "--max-cells", "1"])
    assert warned == re.findall(r"^warning: .*$", capsys.readouterr().out, re.MULTILINE)


def test_things_move_in_a_city(capsys, town):
    write_movers(movers_of([[(0.0, 385010.0, 6672000.0, 0.0, 0.0)]], crs="EPSG:32635"), Path("one.json"))
    status, out, _ = run(capsys, *town, "-o", "r", "--views", 1, "--movers", "one.json", "--json", *SMALL)
    assert status == 0
    assert json.loads(out)["movers"]["objects"] == 1


def test_what_is_compared_in_a_city_if_nobody_says_needs_no_dataset():
    assert tuple(_OF_CITIES.split(",")) == OF_CITIES


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["--techniques", "full,multi-mesh"],
            "techniques: for the city .*houses.*found multi-mesh.*build-impostors makes one",
        ),
        (["--techniques", "visible"], "found visible, which draws cells"),
        (["--techniques", "techniques_of_cities:needs_cells"], "houses.geojson: a dataset expected"),
        (["--display", "0x5"], "--display, --fov: .*0x5"),
        (["--display", "9000x9000"], "--display, --fov: at most 8192 pixels"),
        (["--fov", "180"], "--display, --fov: .*180"),
        (["--crs", "nonsense"], "nonsense"),
        (["--network", "fly"], "--network"),
        (["--lod", "2"], "--lod"),
        (["--views", "0"], "1 to 100000 views expected"),
        (["--movers", "missing.json"], "missing.json"),
    ],
)
def test_a_mistake_with_a_city_gets_one_line(capsys, town, arguments, said):
    status, out, err = run(capsys, *town, "-o", "r", "--views", 1, *arguments)
    assert (status, out) == (2, "")
    lines = [line for line in err.splitlines() if "error:" in line]
    assert len(lines) == 1
    assert re.search(said, lines[0]), err
    assert not Path("r/report.json").exists()


@pytest.mark.usefixtures("town")
def test_what_is_neither_dataset_nor_city_gets_one_line(capsys):
    Path("empty").mkdir()
    for wrong, said in (
        ("nowhere", "no such file"),
        ("empty", "found in it: nothing; or a dataset, which has a manifest.json"),
    ):
        status, out, err = run(capsys, wrong, "-o", "r", "--quiet")
        assert (status, out, err.count("\n")) == (2, "", 1)
        assert re.search(f"{wrong}.*{said}", err), err


@pytest.mark.usefixtures("town")
def test_a_report_within_a_city_of_several_files_is_refused(capsys):
    Path("tiles").mkdir()
    status, _, err = run(capsys, "tiles", "-o", "tiles/r")
    assert status == 2
    assert "tiles/r: a folder outside of tiles expected" in err


@pytest.mark.parametrize(
    "option",
    [["--streets", "x"], ["--crs", "EPSG:32635"], ["--network", "all"], ["--height-unit", "ft"], ["--clip", "1,2,3,4"]],
)
def test_options_of_reading_mean_nothing_with_a_dataset(capsys, dataset, tmp_path, option):
    status, _, err = run(capsys, dataset.path, "-o", tmp_path / "r", *option)
    assert status == 2
    assert err.count("\n") == 1
    assert f"error: {option[0]}: a city to read expected, found the dataset" in err


def test_a_dataset_is_compared_on_another_display(capsys, dataset, tmp_path):
    more = ["--techniques", "full,multi-mesh,multi-mesh-dynamic", "--no-flip", "--settle", 2]
    status, out, _ = run(capsys, dataset.path, "-o", tmp_path / "r", "--views", 3, "--display", "512x288", *more)
    assert status == 0
    report = json.loads((tmp_path / "r" / "report.json").read_text())
    jsonschema.validate(report, SCHEMA)
    assert report["display"] == {"width": 512, "height": 288, "fov_deg": pytest.approx(60.0)}
    built_for = {"width": 256, "height": 256, "fov_deg": pytest.approx(60.0), "max_error_px": 5.0}
    source = report["source"]
    assert source["built_for"] == built_for
    assert (source["max_error_px"], source["promised_px"]) == (pytest.approx(10.0), pytest.approx(13.0))
    assert report["techniques"]["multi-mesh"]["wrong_thickness_px"]["max"] <= 13.0
    assert report["techniques"]["multi-mesh"]["displacement_px"]["max"] <= 10.0
    assert "built for 5 px of 256 x 256 at 60 degrees, which are 10.0 px in the middle of these pictures" in out
    assert "no wrong region thicker than 13.0 px" in out
    page = (tmp_path / "r" / "report.html").read_text()
    assert "of another display, 256\N{NO-BREAK SPACE}×\N{NO-BREAK SPACE}256 pixels and 60°, which is 10 px" in page


def test_a_wider_display_has_no_promise_of_thickness(capsys, dataset, tmp_path):
    more = ["--techniques", "multi-mesh", "--no-flip", "--fov", 90]
    status, out, _ = run(capsys, dataset.path, "-o", tmp_path / "r", "--views", 1, *more)
    assert status == 0
    report = json.loads((tmp_path / "r" / "report.json").read_text())
    assert (report["display"]["width"], report["display"]["fov_deg"]) == (256, pytest.approx(90.0))
    assert report["source"]["promised_px"] is None
    assert "these see farther, and nothing is promised of how thick wrong regions are" in out
    assert "sees farther aside, up or down" in (tmp_path / "r" / "report.html").read_text()


def test_cities_are_compared_from_python(tmp_path):
    report = compare_views(crossroads(), tmp_path, views=1)
    assert list(report["techniques"]) == list(OF_CITIES)
    assert report["display"]["width"] == 512


def test_reports_say_by_which_rules_boxes_are_images(tmp_path):
    """All that a user may say: two reports of different figures tell why."""
    rules = CacheRules(error_px=2.0, leaf_triangles=30, depth=2, bytes=1 << 26, keep="frustum", eager=True)
    options = CompareOptions(techniques=("full", "image-cache"), flip=False, images=rules)
    report = compare_views(crossroads(), tmp_path, views=1, options=options)
    jsonschema.validate(report, SCHEMA)
    told = report["techniques"]["image-cache"]["boxes"]
    assert told["most_bytes"] == rules.bytes
    for name in ("error_px", "leaf_triangles", "depth", "keep", "eager"):
        assert told[name] == getattr(rules, name)


def test_what_a_view_has_seen_is_forgotten_after_it(tmp_path, monkeypatch):
    """A panorama takes as much memory as a large picture a few hundred times."""
    seen, most = [], []

    class Watched(Panorama):
        def __init__(self, pixel):
            super().__init__(pixel)
            seen.append(weakref.ref(self))
            most.append(sum(one() is not None for one in seen))

    monkeypatch.setattr(ray_cast, "Panorama", Watched)
    options = CompareOptions(techniques=("full", "ray-cast"), flip=False)
    compare_views(crossroads(), tmp_path / "out", views=6, options=options)
    assert len(seen) >= 12
    assert max(most) <= 4
