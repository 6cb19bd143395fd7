"""``compare-impostors`` as a user meets it: what it writes, and one line for each mistake."""

import json
import re
import shlex
import shutil
import subprocess
import sys

import pytest
from manifests import sign_again
from moving import movers_of

from mmi.dataset.reading import open_dataset
from mmi.movers.movers_file import write_movers
from mmi.walks.walk import Keyframe, Pose, Walk, write_walk
from viewer.programs import compare_impostors as program
from viewer.programs.compare_impostors import _MORE, _TECHNIQUES, compare_impostors
from viewer.techniques.catalogue import TECHNIQUES

QUICK = ["--techniques", "local,multi-mesh", "--no-flip", "--worst", "1"]


@pytest.fixture
def one_process(monkeypatch):
    """Views are scored in this process: to start others takes longer than to score a few views."""
    monkeypatch.setattr(program, "usable_cores", lambda: 1)


def run(capsys, *arguments):
    """(exit status, output, errors)."""
    with pytest.raises(SystemExit) as left:
        compare_impostors([str(one) for one in arguments])
    captured = capsys.readouterr()
    return left.value.code, captured.out, captured.err


def test_views_are_compared_and_a_table_is_printed(capsys, dataset, tmp_path):
    status, out, err = run(capsys, dataset.path, "-o", tmp_path / "r", "--views", 2, *QUICK)
    assert (status, err) == (0, "")
    assert re.search(r"^local +\d", out, re.MULTILINE)
    assert re.search(r"^multi-mesh +0\.\d+ +0\.\d+", out, re.MULTILINE)
    assert out.rstrip().splitlines()[-2].endswith("report.html")
    assert json.loads((tmp_path / "r" / "report.json").read_text())["views"] == 2


@pytest.mark.usefixtures("one_process")
def test_the_promise_is_checked_and_its_verdict_comes_last(capsys, dataset, tmp_path):
    check = ["--views", 4, "--techniques", "multi-mesh", "--no-flip", "--worst", 1, "--check"]
    status, out, err = run(capsys, dataset.path, "-o", tmp_path / "r", *check)
    assert (status, err) == (0, "")
    assert re.fullmatch(
        r"promise kept: worst region \d px \(T \+ 2 = 7\), displacement [\d.]+ px \(T = 5\), 4 views",
        out.splitlines()[-1],
    )
    assert "Promise kept: worst region" in (tmp_path / "r" / "report.html").read_text()
    # The same impostors, of which more is promised than they were built to keep; figures that contradict it are not read.
    shutil.copytree(dataset.path, tmp_path / "more")

    def promise_more(document):
        document["parameters"]["max_error_px"] = 0.01
        for cell in document["cells"]:
            cell |= {"promised_error_px": 0.01, "displacement_px": 0.0, "missed_px": 0.0}
            for layer in (one for sector in cell["layers"] for one in sector):
                layer["displacement_px"] = 0.0

    sign_again(tmp_path / "more", promise_more)
    status, out, err = run(capsys, tmp_path / "more", "-o", tmp_path / "r", *check)
    assert (status, err) == (1, "")
    assert re.match(r"promise BROKEN in \d of 4 views: worst region ", out.splitlines()[-1])
    status, out, err = run(capsys, tmp_path / "more", "-o", tmp_path / "r", *check, "--quiet")
    assert (status, out, err) == (1, "", "")
    status, _, err = run(capsys, tmp_path / "more", "-o", tmp_path / "r", *check[:-1], "--quiet")
    assert (status, err) == (0, ""), "unless it is asked for, the exit status says nothing of it"


def test_a_check_of_what_promises_nothing_is_refused(capsys, dataset, tmp_path):
    status, _, err = run(capsys, dataset.path, "-o", tmp_path, "--check", "--techniques", "full,local")
    assert status == 2
    assert err == (
        "compare-impostors: error: --check: a dataset's promise of multi-mesh to check expected, found full, local\n"
    )


@pytest.mark.usefixtures("one_process")
def test_views_are_held_and_it_is_said_when_they_had_settled(capsys, dataset, tmp_path):
    held = ["--views", 2, "--settle", 3, "--budget-ms", 2.5, "--fps", 20, *QUICK]
    status, out, err = run(capsys, dataset.path, "-o", tmp_path, *held)
    assert (status, err) == (0, "")
    assert "views that were held for 3 frames" in out
    alike = "like the geometry after 0 / 0 / 0 frames, 0 not, 0 after more frames than layers"
    assert f"\n  multi-mesh: {alike}; settled after 0 / 0 / 0 frames, 0 not\n" in out
    report = json.loads((tmp_path / "report.json").read_text())
    assert (report["held_frames"], report["budget_ms"], report["frames_per_second"]) == (3, 2.5, 20.0)


@pytest.mark.usefixtures("one_process")
@pytest.mark.usefixtures("one_process")
def test_movers_come_from_a_file(capsys, dataset, tmp_path):
    write_movers(movers_of([[(0.0, 80, 2, 0, 0)]], crs="EPSG:32631"), tmp_path / "one.json")
    arguments = ("--views", "2", "--techniques", "multi-mesh", "--no-flip", "--json", "--movers", tmp_path / "one.json")
    status, out, _ = run(
        capsys, dataset.path, "-o", tmp_path / "r", *arguments, "--movers-error", "2", "--movers-time", "3"
    )
    assert status == 0
    found = {"source": "one.json", "objects": 1, "max_error_px": 2.0, "calculation": "predictive", "time_s": 3.0}
    assert json.loads(out)["movers"] == found
    arguments = ("--views", "2", "--techniques", "multi-mesh", "--no-flip", "--movers", tmp_path / "one.json")
    status, out, _ = run(capsys, dataset.path, "-o", tmp_path / "r", *arguments)
    assert status == 0
    assert re.search(r"^1 moving objects of one\.json", out, re.MULTILINE)
    assert re.search(r"^  multi-mesh: [\d.]+ as geometry, [\d.]+ hidden, [\d.]+ as images", out, re.MULTILINE)


def test_a_time_for_movers_that_would_move_anyway_is_refused(capsys, dataset, tmp_path):
    write_movers(movers_of([[(0.0, 80, 2, 0, 0)]], crs="EPSG:32631"), tmp_path / "one.json")
    moving = ("--tour", 5, "--movers", tmp_path / "one.json", "--movers-time", 3)
    status, out, err = run(capsys, dataset.path, "-o", tmp_path / "r", *moving)
    assert (status, out) == (2, "")
    assert (
        err
        == "compare-impostors: error: --movers-time: views expected (--views), found a walk, on which objects move\n"
    )


def test_json_is_all_there_is_on_standard_output(capsys, dataset, tmp_path):
    status, out, _ = run(capsys, dataset.path, "-o", tmp_path, "--views", 1, "--json", *QUICK)
    assert status == 0
    assert json.loads(out) == json.loads((tmp_path / "report.json").read_text())


def test_a_technique_of_ones_own_is_named_by_its_module_and_function(capsys, dataset, tmp_path, monkeypatch):
    """It lies in the current folder, which installed programs do not import from by themselves."""
    (tmp_path / "my_techniques.py").write_text(
        "from viewer.techniques.geometry import CellGeometry\n\ndef nearby(scene):\n    return CellGeometry(scene, 'local')\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [one for one in sys.path if one not in ("", str(tmp_path))])
    own = ["--techniques", "local,my_techniques:nearby", "--no-flip", "--json"]
    status, out, _ = run(capsys, dataset.path, "-o", "r", "--views", 6, *own)
    assert status == 0
    report = json.loads(out)
    mine = report["techniques"]["my_techniques:nearby"]
    assert mine["wrong_share"] == report["techniques"]["local"]["wrong_share"] > 0.0
    assert mine["origin"]["function"] == "my_techniques:nearby"
    assert re.fullmatch("[0-9a-f]{12}", mine["origin"]["version"])
    assert (tmp_path / "r" / "worst" / "my_techniques-nearby-01.png").exists()


def test_the_techniques_of_the_help_are_those_of_the_package():
    """Those that capture while they run are asked for, because their views want to be held."""
    assert [*_TECHNIQUES.split(","), *_MORE] == list(TECHNIQUES)


@pytest.mark.usefixtures("one_process")
def test_a_tour_is_saved_and_walked_again(capsys, dataset, tmp_path):
    walk = tmp_path / "walk.json"
    walks = ["--fps", 2, "--scored", 2, "--json", *QUICK]
    status, out, _ = run(capsys, dataset.path, "-o", tmp_path / "a", "--tour", 30, "--save-path", walk, *walks)
    assert status == 0
    tour = json.loads(out)
    assert tour["mode"] == "tour"
    assert tour["walk"]["metres"] == pytest.approx(30.0, abs=2.0)
    status, out, _ = run(capsys, dataset.path, "-o", tmp_path / "b", "--path", walk, *walks)
    assert status == 0
    again = json.loads(out)
    assert again["mode"] == "path"
    assert again["series"]["multi-mesh"]["cell"] == tour["series"]["multi-mesh"]["cell"]
    assert again["scored"] == tour["scored"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--views", "0"], "1 to 100000 views expected"),
        (["--views", "x"], "--views"),
        (["--views", "1", "--tour"], "--tour"),
        (["--techniques", "full,magic"], "--techniques.*magic"),
        (["--techniques", ","], "--techniques"),
        (["--techniques", "full,nowhere:technique"], "--techniques.*nowhere:technique.*ModuleNotFoundError"),
        (["--techniques", "json:nothing"], "--techniques.*json:nothing.*found none"),
        (["--video"], "--video.*walk"),
        (["--save-path", "x.json"], "--save-path"),
        (["--tour", "-5"], "tour of more than 0 m"),
        (["--tour", "nan"], "tour of more than 0 m"),
        (["--tour", "9", "--speed", "0"], "speed"),
        (["--tour", "9", "--fps", "0"], "--fps"),
        (["--tour", "9", "--fade", "-1"], "--fade"),
        (["--settle", "0"], "--settle"),
        (["--settle", "x"], "--settle"),
        (["--tour", "9", "--settle", "2"], "--settle.*views.*walk"),
        (["--budget-ms", "-1"], "--budget-ms"),
        (["--budget-ms", "nan"], "--budget-ms"),
        (["--antialias", "-2"], "--antialias"),
        (["--antialias", "3"], "--antialias"),
        (["--tour", "9000", "--video", "webp"], "--video.*mp4"),
        (["--cache", "0"], "--cache"),
        (["--cache", "nan"], "--cache"),
        (["--cache", "inf"], "--cache"),
        (["--worst", "-1"], "--worst"),
        (["--path", "missing.json"], "missing.json"),
        (["--seed", "-1", "--views", "1"], "seed"),
        (["--movers", "missing.json"], "missing.json: a traffic file's JSON file expected"),
        (["--movers-error", "0"], "--movers-error: 0.01 to 100 expected"),
        (["--movers-validity", "guess"], "--movers-validity"),
        (["--movers-time", "nan"], "--movers-time"),
        (["--movers-error", "2"], "--movers-error: objects that move expected"),
        (["--movers-validity", "common"], "--movers-validity: objects that move expected"),
        (["--movers-time", "0"], "--movers-time: objects that move expected"),
    ],
)
def test_a_wrong_option_gets_one_line(capsys, dataset, tmp_path, arguments, said):
    status, out, err = run(capsys, dataset.path, "-o", tmp_path / "r", *arguments)
    assert status == 2
    assert out == ""
    assert err.count("\n") == 1
    assert re.search(said, err), err
    assert err.startswith("compare-impostors: error: ")


def test_a_wrong_dataset_gets_one_line(capsys, tmp_path, dataset):
    (tmp_path / "file").write_text("x")
    (tmp_path / "empty").mkdir()
    for wrong in ("nowhere", "file", "empty"):
        status, _, err = run(capsys, tmp_path / wrong, "-o", tmp_path / "r")
        assert status == 2
        assert err.count("\n") == 1
        assert wrong in err
    status, _, err = run(capsys, dataset.path, "-o", tmp_path / "file")
    assert (status, err.count("\n")) == (2, 1)
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize("kind", ["missing", "truncated", "tampered"])
@pytest.mark.parametrize("name", ["manifest.json", "city.json", "city.glb", "cells/*.glb", "cells/*.exr"])
def test_damaged_files_get_one_line_and_no_picture(capsys, tmp_path, dataset, name, kind):
    copy = tmp_path / "copy"
    shutil.copytree(dataset.path, copy)
    for file in copy.glob(name):
        data = file.read_bytes()
        if kind == "missing":
            file.unlink()
        elif kind == "truncated":
            file.write_bytes(data[: len(data) // 3])
        else:
            place = data.index(b"1", len(data) // 3) if b"1" in data[len(data) // 3 :] else len(data) - 1
            file.write_bytes(data[:place] + b"2" + data[place + 1 :])
    status, out, err = run(capsys, copy, "-o", tmp_path / "r", "--views", 3, *QUICK)
    assert status == 2
    assert out == ""
    assert err.count("\n") == 1
    assert re.search(name.replace("*", "[^ ]*"), err), err
    assert not (tmp_path / "r" / "report.html").exists()


@pytest.mark.usefixtures("one_process")
def test_a_walk_that_leaves_the_city_is_walked_all_the_same(capsys, dataset, tmp_path):
    """Off the streets, the nearest cell is drawn."""
    away = Walk("away", (Keyframe(0.0, Pose((0, 10, 1.7), 0.0, 0.0)), Keyframe(9.0, Pose((900, 500, 90), 1.0, -0.3))))
    write_walk(away, tmp_path / "away.json")
    status, out, _ = run(
        capsys, dataset.path, "-o", tmp_path, "--path", tmp_path / "away.json", "--fps", 1, "--json", *QUICK
    )
    assert status == 0
    assert set(json.loads(out)["series"]["multi-mesh"]["cell"]) <= {one.id for one in open_cells(dataset)}


def open_cells(dataset):
    from viewer.scene.scene import open_scene

    return open_scene(open_dataset(dataset.path), name="multi-mesh").whereabouts.cells


def test_help_shows_examples_whose_options_exist(capsys):
    status, out, _ = run(capsys, "--help")
    assert status == 0
    examples = re.findall(r"^  (compare-impostors [^ ].*?)(?:   .*)?$", out, re.MULTILINE)
    assert len(examples) >= 3
    known = set(re.findall(r"--[a-z-]+", out.split("examples:")[0]))
    for example in examples:
        assert {word for word in shlex.split(example) if word.startswith("--")} <= known


def test_ctrl_c_leaves_with_130_and_one_line(dataset, tmp_path):
    code = (
        "import _thread, threading, viewer.report.compare as c\n"
        "from viewer.programs.compare_impostors import compare_impostors\n"
        "real = c._scenes\n"
        "c._scenes = lambda *a: (_thread.interrupt_main(), real(*a))[1]\n"
        "compare_impostors()"
    )
    command = [sys.executable, "-c", code, str(dataset.path), "-o", str(tmp_path), "--views", "3", *QUICK]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 130
    assert done.stderr.count("\n") == 1
    assert "interrupted" in done.stderr
