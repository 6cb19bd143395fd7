"""All programs where things are not as on a desk: closed streams, ASCII, odd names, full disks, links. Each ends in a result or
in one true line.

There is no terminal in tests. A read-only installation without a home is in ``tests/mmi/foundation/test_kernels.py``.
"""

import io
import json
import os
import shutil
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

from citygen import cli
from citygen.cli import citygen
from mmi.dataset.reading import open_dataset
from mmi.programs import build_impostors as builder
from mmi.programs import inspect_layers as inspector
from mmi.programs.build_impostors import build_impostors
from mmi.programs.inspect_layers import inspect_layers
from mmi.reading.read_city import read_city
from viewer.programs import compare_impostors as comparer
from viewer.programs import view_impostors as walker
from viewer.programs.compare_impostors import compare_impostors
from viewer.programs.view_impostors import view_impostors

ROOT = Path(__file__).resolve().parents[1]
PROGRAMS = {
    "build-impostors": build_impostors,
    "inspect-layers": inspect_layers,
    "compare-impostors": compare_impostors,
    "view-impostors": view_impostors,
    "citygen": citygen,
}
IDS = ("Σ [red] [/red] :smile:", "half of a pair \ud800", "\x1b[31m", "\u202ertl")
NAME = "café [red] :smile:"
NO_TEXT = os.fsdecode(b"caf\xe9")
SMALL = ["--display", "64x64", "--workers", "1", "--near-distance", "20", "--max-cells", "1"]
QUICK = ["--views", "1", "--techniques", "local,multi-mesh", "--no-flip", "--worst", "1"]


@pytest.fixture(scope="module")
def city(tmp_path_factory):
    """A hamlet whose objects have ids of all kinds of letters, in a folder that is called like markup."""
    path = tmp_path_factory.mktemp("city") / NAME / "hamlet.json"
    with pytest.raises(SystemExit):
        citygen(["hamlet", "--detail", "0", "--quiet", "-o", str(path)])
    document = json.loads(path.read_text())
    houses = [name for name, one in document["CityObjects"].items() if one["type"] == "Building"]
    renamed = dict(zip(houses, IDS, strict=False))
    document["CityObjects"] = {renamed.get(name, name): one for name, one in document["CityObjects"].items()}
    path.write_text(json.dumps(document))
    return path


@pytest.fixture(scope="module")
def dataset(city):
    with pytest.raises(SystemExit) as left:
        build_impostors([str(city), "-o", str(city.parent / "out"), "--quiet", *SMALL])
    assert left.value.code == 0
    return city.parent / "out"


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch):
    """Views are scored here, and no browser is there: ``--window`` ends a viewer that has begun."""
    monkeypatch.setattr(comparer, "usable_cores", lambda: 1)
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.delenv("VIEW_IMPOSTORS_BROWSER", raising=False)


def work_of(city, dataset, out):
    """What each program is given to do, and with which status it ends."""
    return {
        "build-impostors": ([city, "-o", dataset, *SMALL], 0),
        "inspect-layers": ([dataset, "-o", out / "plots"], 0),
        "compare-impostors": ([dataset, "-o", out / "report", *QUICK], 0),
        "view-impostors": ([dataset, "--window"], 2),
        "citygen": (["traffic", "--city", city, "-o", out / "a.json", "--vehicles", "2", "--seconds", "1"], 0),
    }


def mistakes_of(out):
    nowhere = out / f"{NAME} {NO_TEXT} nowhere"
    return {
        "build-impostors": [nowhere, "-o", out / "new"],
        "inspect-layers": [nowhere, "-o", out / "new"],
        "compare-impostors": [nowhere, "-o", out / "new"],
        "view-impostors": [nowhere],
        "citygen": [f"{NAME} {NO_TEXT}", "-o", out / "new.json"],
    }


def run(monkeypatch, name, arguments, *, encoding="utf-8"):
    """(exit status, standard output, standard error) as Python gives them to programs: letters that are missing are errors."""
    out = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    err = io.TextIOWrapper(io.BytesIO(), encoding=encoding, errors="backslashreplace")
    with monkeypatch.context() as streams, pytest.raises(SystemExit) as left:
        streams.setattr(sys, "stdout", out)
        streams.setattr(sys, "stderr", err)
        PROGRAMS[name]([str(one) for one in arguments])
    return left.value.code, out.buffer.getvalue().decode(encoding), err.buffer.getvalue().decode(encoding)


def one_line(name, status, err):
    assert status in (1, 2), (status, err)
    assert err.startswith(f"{name}: error: ")
    assert err.count("\n") == 1
    assert "fault of the program" not in err
    return err


# --------------------------------------------------------------------------------------------------------- letters


@pytest.mark.parametrize("name", PROGRAMS)
def test_names_and_ids_of_any_letters_reach_an_ascii_terminal(monkeypatch, city, dataset, tmp_path, name):
    arguments, expected = work_of(city, dataset, tmp_path / NAME)[name]
    status, out, err = run(monkeypatch, name, arguments, encoding="ascii")
    assert status == expected, err
    assert "\x1b" not in out + err
    if status:
        assert "Chromium" in one_line(name, status, err)
    if name == "build-impostors":
        assert "[red] :smile:/out: 1 cell" in out
        assert "id that is no valid text written out      1  half of a pair \\ud800" in out
    if name in ("inspect-layers", "compare-impostors"):
        assert "caf\\xe9 [red] :smile:" in out


def test_what_a_dataset_is_made_of_is_valid_text(dataset):
    objects = {one.id for one in open_dataset(dataset).city().objects}
    assert {IDS[0], "half of a pair \\ud800", IDS[2], IDS[3]} <= objects
    for path in dataset.rglob("*.json"):
        path.read_bytes().decode("utf-8")


def test_ids_stay_apart_when_they_are_written_out(city, tmp_path):
    document = json.loads(city.read_text())
    houses = [name for name, one in document["CityObjects"].items() if one["type"] == "Building"]
    renamed = dict(zip(houses, ("a\ud800", "a\\ud800", "a\udfff"), strict=False))
    document["CityObjects"] = {renamed.get(name, name): one for name, one in document["CityObjects"].items()}
    (tmp_path / "a.json").write_text(json.dumps(document))
    found, _ = read_city(tmp_path / "a.json")
    assert {"a\\ud800", "a\\ud800#2", "a\\udfff"} <= {one.id for one in found.objects}


@pytest.mark.parametrize("name", PROGRAMS)
@pytest.mark.parametrize("encoding", ["ascii", "utf-8"])
def test_mistakes_name_what_was_given_as_far_as_the_terminal_can(monkeypatch, tmp_path, name, encoding):
    status, out, err = run(monkeypatch, name, mistakes_of(tmp_path)[name], encoding=encoding)
    assert out == ""
    assert "[red] :smile: caf\\udce9" in one_line(name, status, err)


@pytest.mark.parametrize("name", [one for one in PROGRAMS if one != "inspect-layers"])
def test_files_and_folders_whose_names_are_no_text(monkeypatch, city, dataset, tmp_path, name):
    (tmp_path / NO_TEXT).mkdir()
    here, built = tmp_path / NO_TEXT / f"{NO_TEXT}.json", tmp_path / NO_TEXT / "out"
    shutil.copy(city, here)
    shutil.copytree(dataset, built)
    arguments, expected = work_of(here, built, tmp_path / NO_TEXT)[name]
    status, out, err = run(monkeypatch, name, arguments)
    assert status == expected, err
    if name == "build-impostors":
        assert "caf\\xe9.json" in out
        assert f"{tmp_path}/caf\\udce9/out: 1 cell" in out


def test_gdal_takes_no_names_that_are_no_text_and_it_is_said(monkeypatch, tmp_path):
    path = tmp_path / f"{NO_TEXT}.geojson"
    path.write_text('{"type": "FeatureCollection", "features": []}')
    for arguments in ([path], [ROOT / "examples" / "helsinki" / "helsinki.osm.pbf", "--terrain", path]):
        status, _, err = run(monkeypatch, "build-impostors", [*arguments, "-o", tmp_path / "out"])
        assert "caf\\udce9.geojson: a name in UTF-8 expected" in one_line("build-impostors", status, err)


# --------------------------------------------------------------------------------------------------------- streams


@contextmanager
def closed(monkeypatch, *numbers):
    """Streams that whoever started the program has closed: Python has None for them then."""
    kept = {number: os.dup(number) for number in numbers}
    with monkeypatch.context() as streams:
        for number in numbers:
            streams.setattr(sys, ("stdin", "stdout", "stderr")[number], None)
            os.close(number)
        try:
            yield
        finally:
            for number, copy in kept.items():
                os.dup2(copy, number)
                os.close(copy)


@pytest.mark.parametrize("name", PROGRAMS)
@pytest.mark.parametrize("numbers", [(1,), (2,), (0, 1, 2)])
def test_closed_streams_change_nothing(monkeypatch, city, dataset, tmp_path, name, numbers):
    """What is written to them must not go into files that have got their numbers."""
    before = {path: path.read_bytes() for path in dataset.rglob("*") if path.is_file() and path.name != "build.json"}
    real = name in ("build-impostors", "citygen")
    arguments, status = work_of(city, dataset, tmp_path)[name] if real else (mistakes_of(tmp_path)[name], 2)
    with closed(monkeypatch, *numbers), pytest.raises(SystemExit) as left:
        PROGRAMS[name]([str(one) for one in arguments])
    assert left.value.code == status
    assert {path: path.read_bytes() for path in before} == before


def test_pictures_are_drawn_without_streams(monkeypatch, dataset, tmp_path):
    arguments, _ = work_of(None, dataset, tmp_path)["compare-impostors"]
    with closed(monkeypatch, 0, 1, 2), pytest.raises(SystemExit) as left:
        compare_impostors([str(one) for one in arguments])
    assert left.value.code == 0
    report = json.loads((tmp_path / "report" / "report.json").read_text())
    assert report["views"] == 1


def as_started(redirections, *arguments, **environment):
    """``citygen``, the quickest to start, in a process of its own, started by a shell with these redirections."""
    command = [sys.executable, "-c", "from citygen.cli import citygen; citygen()", *arguments]
    return subprocess.run(
        ["/bin/sh", "-c", f'exec "$@" {redirections}', "sh", *command],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        env=os.environ | {"PYTHONUNBUFFERED": ""} | environment,
    )


@pytest.mark.parametrize(
    ("redirections", "arguments", "status", "said"),
    [
        ("<&- >&- 2>&-", ["--list"], 0, ""),
        ("2>/dev/full", ["nowhere"], 2, ""),
        (">/dev/full", ["--help"], 2, "citygen: error: standard output: No space left on device\n"),
        (">/dev/full 2>/dev/full", ["--list"], 2, ""),
    ],
)
def test_a_process_whose_streams_are_closed_or_full(redirections, arguments, status, said):
    """Python itself would leave with status 120, and complain of its own."""
    done = as_started(redirections, *arguments)
    assert (done.returncode, done.stdout, done.stderr) == (status, "", said)


def test_an_unbuffered_output_that_is_full_or_has_no_reader(monkeypatch):
    """Then nothing is left in a buffer that could tell so later."""

    class Refusing(io.StringIO):
        def write(self, _):
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(sys, "stdout", Refusing())
    with pytest.raises(SystemExit) as left:
        citygen(["--list"])
    assert left.value.code == 2
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w", buffering=1) as pipe:
        monkeypatch.setattr(sys, "stdout", pipe)
        with pytest.raises(SystemExit) as left:
            citygen(["--list"])
    assert left.value.code == 0


def test_a_process_in_the_c_locale_names_what_it_was_given():
    done = as_started("", "café [red]", PYTHONIOENCODING="ascii", LC_ALL="C", PYTHONCOERCECLOCALE="0")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("citygen: error: a preset of ")
    assert done.stderr.endswith("found 'caf\\xe9 [red]'\n")


# ----------------------------------------------------------------------------------------------------------- disks


@pytest.fixture
def full_disk(tmp_path):
    """A disk with room for 60 kB, where one may be mounted."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = [shutil.which("mount", path="/bin:/usr/bin") or "mount", "-t", "tmpfs", "-o", "size=60k", "tmpfs", folder]
    try:
        mounted = subprocess.run(mount, capture_output=True, check=False).returncode == 0
    except OSError:
        mounted = False
    if not mounted:
        pytest.skip("no disk may be mounted here")
    yield folder
    subprocess.run([shutil.which("umount", path="/bin:/usr/bin") or "umount", "-l", folder], check=True)


@pytest.mark.parametrize("name", [one for one in PROGRAMS if one != "view-impostors"])
def test_a_full_disk_gets_one_line(monkeypatch, city, dataset, full_disk, name):
    arguments, _ = work_of(city, full_disk / "out", full_disk)[name]
    if name in ("inspect-layers", "compare-impostors"):
        arguments[0] = dataset
    if name in ("citygen", "compare-impostors"):
        (full_disk / "filler").write_bytes(bytes(60_000))
    status, _, err = run(monkeypatch, name, arguments)
    assert "No space left on device" in one_line(name, status, err)
    assert not list(full_disk.rglob("*.part-*"))


# ----------------------------------------------------------------------------------------------------------- links


def refused(monkeypatch, city, out):
    status, _, err = run(monkeypatch, "build-impostors", [city, "-o", out, "--quiet", *SMALL])
    return one_line("build-impostors", status, err)


def test_links_in_place_of_a_builds_own_files_are_refused(monkeypatch, city, tmp_path):
    """Opening a lock that is a link would empty what it leads to, and cells would be written elsewhere."""
    diary, elsewhere, out = tmp_path / "diary.txt", tmp_path / "elsewhere", tmp_path / "out"
    diary.write_text("Monday")
    elsewhere.mkdir()
    out.mkdir()
    (out / ".lock").symlink_to(diary)
    assert "/.lock: a file of a build's own expected, found a link; remove it" in refused(monkeypatch, city, out)
    (out / ".lock").unlink()
    (out / ".lock").mkdir()
    assert "/.lock: a file of a build's own expected, found another kind" in refused(monkeypatch, city, out)
    (out / ".lock").rmdir()
    os.mkfifo(out / ".lock")
    assert "/.lock: a file of a build's own expected, found another kind" in refused(monkeypatch, city, out)
    (out / ".lock").unlink()
    (out / "cells").rmdir()
    (out / "cells").symlink_to(elsewhere)
    assert "/cells: a folder for the dataset's cells expected, found a link" in refused(monkeypatch, city, out)
    (out / "build.json").write_text('{"program": "build-impostors"}')
    (out / "cells").unlink()
    (out / "cells").write_text("no folder")
    assert "/cells: a folder for the dataset's cells expected, found a file" in refused(monkeypatch, city, out)
    assert diary.read_text() == "Monday"
    assert not list(elsewhere.iterdir())


def test_cells_that_are_links_or_devices_are_not_read(monkeypatch, city, dataset, tmp_path):
    """A device may have no end: the cell counts as damaged, and is built again in its place."""
    out = tmp_path / "out"
    shutil.copytree(dataset, out)
    (glb,) = out.glob("cells/*.glb")
    glb.unlink()
    glb.symlink_to("/dev/zero")
    status, _, err = run(monkeypatch, "build-impostors", [city, "-o", out, "--quiet", *SMALL])
    assert (status, err) == (0, "")
    assert not glb.is_symlink()
    assert glb.read_bytes() == (dataset / "cells" / glb.name).read_bytes()


@pytest.mark.parametrize("name", PROGRAMS)
def test_links_that_loop_lead_nowhere(monkeypatch, city, dataset, tmp_path, name):
    (tmp_path / "loop.json").symlink_to(tmp_path / "loop.json")
    loop = tmp_path / "loop.json"
    for arguments in (
        {"build-impostors": [loop, "-o", tmp_path / "out"], "citygen": ["hamlet", "-o", loop / "a.json"]}.get(
            name, [loop, *([] if name == "view-impostors" else ["-o", tmp_path / "out"])]
        ),
        {"view-impostors": [loop], "citygen": ["traffic", "--city", loop, "-o", tmp_path / "t.json"]}.get(
            name, [city if name == "build-impostors" else dataset, "-o", loop]
        ),
    ):
        status, out, err = run(monkeypatch, name, arguments)
        assert out == "" or name == "build-impostors"
        assert "loop.json" in one_line(name, status, err)


def test_pipes_and_devices_are_no_cities(monkeypatch, tmp_path):
    os.mkfifo(tmp_path / "city.osm")
    for path in (tmp_path / "city.osm", "/dev/zero"):
        status, _, err = run(monkeypatch, "build-impostors", [path, "-o", tmp_path / "out"])
        assert "a file or folder expected, found a pipe or a device" in one_line("build-impostors", status, err)


# ---------------------------------------------------------------------------------------------------------- faults

INSIDE = {
    "build-impostors": (builder, "_build"),
    "inspect-layers": (inspector, "_inspect"),
    "compare-impostors": (comparer, "_compare"),
    "view-impostors": (walker, "_view"),
    "citygen": (cli, "_run"),
}


@pytest.mark.parametrize("name", PROGRAMS)
def test_faults_of_every_program_end_in_one_line(monkeypatch, tmp_path, name):
    def fault(_):
        raise LookupError("a table without this row")

    monkeypatch.setattr(*INSIDE[name], fault)
    status, out, err = run(monkeypatch, name, mistakes_of(tmp_path)[name])
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert err.startswith(f"{name}: error: LookupError: a table without this row (test_environment.py, line ")
    status, out, err = run(monkeypatch, name, [*mistakes_of(tmp_path)[name], "--debug"])
    assert (status, out, err.splitlines()[0]) == (1, "", "Traceback (most recent call last):")


def test_functions_of_ones_own_that_fail_are_named(monkeypatch, city, dataset, tmp_path):
    """They are no fault of the program."""
    (tmp_path / "my_faults.py").write_text(
        "def technique(scene):\n    raise LookupError('no such row')\n\n"
        "def weights(*_, **__):\n    raise MemoryError('too much')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    views = ["--views", "1", "--techniques", "full,my_faults:technique"]
    status, _, err = run(monkeypatch, "compare-impostors", [dataset, "-o", tmp_path / "r", *views])
    assert "my_faults:technique" in one_line("compare-impostors", status, err)
    assert "LookupError: no such row" in err
    own = ["--weights", "my_faults:weights", "--quiet"]
    status, _, err = run(monkeypatch, "build-impostors", [city, "-o", tmp_path / "out", *SMALL, *own])
    assert "my_faults:weights" in one_line("build-impostors", status, err)
