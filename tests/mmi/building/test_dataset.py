import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from cities import block, crossroads
from hills import hilly_city
from selection import with_slow

from mmi.building.cell_choice import choose_cells
from mmi.building.dataset import build_dataset
from mmi.city.model import City
from mmi.dataset.cell_files import read_impostor
from mmi.dataset.manifest import FORMAT_VERSION, FileEntry
from mmi.dataset.reading import open_dataset
from mmi.foundation.camera import Camera
from mmi.foundation.errors import DatasetError, ParameterError
from mmi.planning.parameters import BuildParameters

PARAMETERS = BuildParameters(near_distance=30.0, camera=Camera(128, 128, 1.0), cell_length=80.0, longest_object=None)


def contents(folder):
    """Checksum of every file but build.json."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "build.json"
    }


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    out = tmp_path_factory.mktemp("dataset") / "out"
    summary = build_dataset(crossroads(), out, PARAMETERS)
    assert summary.built == summary.cells >= 8
    return out


def test_a_dataset_reads_back_as_it_was_captured(built):
    dataset = open_dataset(built)
    city = dataset.city()
    assert [one.id for one in city.objects] == [one.id for one in crossroads().objects]
    for entry in dataset.manifest.cells[:3]:
        impostor = read_impostor(dataset, entry.id, city)
        assert impostor.layers
        assert sorted([*impostor.near, *impostor.far]) == sorted({*impostor.near, *impostor.far})
        assert sum(len(layer.mesh.triangles) for layer in impostor.layers) == entry.triangles
        for layer in impostor.layers:
            shown = np.unique(layer.texture.object_ids[layer.texture.coverage])
            assert set(shown) == set(layer.objects)
            points = layer.texture.view.project(layer.mesh.vertices.astype(float))
            left, top, width, height = layer.texture.view.window
            np.testing.assert_allclose(points[:, 0], left + layer.mesh.uv[:, 0] * width, atol=0.02)
            np.testing.assert_allclose(points[:, 1], top + layer.mesh.uv[:, 1] * height, atol=0.02)


def test_every_cell_lists_what_is_visible_and_who_is_next_to_it(built):
    manifest = open_dataset(built).manifest
    chosen = choose_cells(crossroads(), PARAMETERS)
    graph, names = chosen.graph, list(chosen.names)
    assert [entry.id for entry in manifest.cells] == names
    for entry in manifest.cells:
        assert list(entry.neighbours) == sorted(graph.neighbors(entry.id))
        assert entry.viewing_cell == graph.nodes[entry.id]["cell"]
        assert not set(entry.near) & set(entry.far)
        assert entry.promised_error_px == PARAMETERS.max_error_px
        assert entry.largest_weight_px <= PARAMETERS.max_error_px
    assert manifest.bytes == sum(
        path.stat().st_size for path in built.rglob("*") if path.suffix in (".exr", ".glb") or path.name == "city.json"
    )


def test_two_workers_write_the_same_bytes(built, tmp_path):
    build_dataset(crossroads(), tmp_path / "out", PARAMETERS, workers=2)
    assert contents(tmp_path / "out") == contents(built)


def test_a_finished_build_is_not_done_again(built):
    times = {path: path.stat().st_mtime_ns for path in (built / "cells").iterdir()}
    summary = build_dataset(crossroads(), built, PARAMETERS)
    assert (summary.built, summary.unchanged) == (0, 0)
    assert {path: path.stat().st_mtime_ns for path in (built / "cells").iterdir()} == times


PATHS = [str(Path(__file__).parents[i]) for i in (0, 2, 3)]
SCRIPT = """
import sys
sys.path[:0] = {paths!r}
from cities import crossroads
from mmi.building.dataset import build_dataset
from test_dataset import PARAMETERS
if __name__ == "__main__":
    build_dataset(crossroads(), sys.argv[1], PARAMETERS, workers=int(sys.argv[2]))
"""


@pytest.mark.parametrize("workers", with_slow([1, 2], {1}))
def test_a_killed_build_ends_like_an_undisturbed_one(built, tmp_path, workers):
    script = tmp_path / "build.py"
    script.write_text(SCRIPT.format(paths=PATHS))
    out = tmp_path / "out"
    dice = random.Random(workers)
    killed = 0
    for _ in range(40):
        process = subprocess.Popen([sys.executable, str(script), str(out), str(workers)])
        before = len(list(out.glob("cells/*.json")))
        wanted = before + dice.randint(2, 5)
        while process.poll() is None and len(list(out.glob("cells/*.json"))) < wanted:
            time.sleep(0.002)
        time.sleep(dice.uniform(0.0, 0.2))
        if process.poll() is None:
            process.send_signal(signal.SIGKILL)
            killed += 1
        if process.wait() == 0:
            break
    assert process.returncode == 0
    assert killed >= 1
    time.sleep(0.5 if workers > 1 else 0.0)  # an orphaned worker may still finish its last cell
    assert contents(out) == contents(built)


def _changed(city: City, name: str, top: float) -> City:
    objects = tuple(block(one.id, *one.footprint.bounds, top) if one.id == name else one for one in city.objects)
    return replace(city, objects=objects)


def test_a_changed_building_rebuilds_the_cells_that_see_it_and_no_others(tmp_path):
    out = tmp_path / "out"
    build_dataset(crossroads(), out, PARAMETERS)
    # A house in the courtyard of a block, too low to be seen over it, and then tall enough to be seen by some.
    yard = next(one for one in crossroads().objects if one.id == "block/13")
    x, y = yard.footprint.centroid.coords[0]
    low = replace(crossroads(), objects=(*crossroads().objects, block("house", x - 5, y - 5, x + 5, y + 5, 4.0)))
    summary = build_dataset(low, out, PARAMETERS)
    assert (summary.built, summary.unchanged) == (0, summary.cells)
    high = _changed(low, "house", yard.top + 25.0)
    summary = build_dataset(high, out, PARAMETERS)
    sees = {e.id for e in open_dataset(out).manifest.cells if "house" in e.near + e.far}
    assert summary.built == len(sees) > 0
    assert summary.unchanged == summary.cells - len(sees) > 0
    build_dataset(high, tmp_path / "fresh", PARAMETERS)
    assert contents(out) == contents(tmp_path / "fresh")


def test_changed_ground_rebuilds_cells_although_no_object_is_another(tmp_path):
    """What lies between a mesh and what was captured may be a hill that nothing stands on."""
    city = hilly_city(3)
    assert city.terrain is not None
    away = shapely.union_all([*(one.footprint for one in city.objects), street_lines(city)]).buffer(2.5 * 8.0)
    points = city.terrain.points
    raised = city.terrain.heights + np.where(shapely.contains_xy(away, points[..., 0], points[..., 1]), 0.0, 4.0)
    other = replace(city, terrain=replace(city.terrain, heights=raised))
    assert (raised != city.terrain.heights).any() and other.ground == city.ground
    out = tmp_path / "out"
    assert build_dataset(city, out, PARAMETERS, max_cells=4).built == 4
    summary = build_dataset(other, out, PARAMETERS, max_cells=4)
    assert summary.built == summary.cells == 4
    build_dataset(other, tmp_path / "fresh", PARAMETERS, max_cells=4)
    assert contents(out) == contents(tmp_path / "fresh")


def street_lines(city):
    return shapely.union_all([street["geometry"] for _, _, street in city.streets.edges(data=True)])


def test_a_changed_parameter_rebuilds_everything(tmp_path):
    out = tmp_path / "out"
    build_dataset(crossroads(), out, PARAMETERS, max_cells=3)
    summary = build_dataset(crossroads(), out, replace(PARAMETERS, max_error_px=5.0), max_cells=3)
    assert summary.built == 3


def test_more_cells_keep_those_that_are_there(tmp_path):
    out = tmp_path / "out"
    build_dataset(crossroads(), out, PARAMETERS, max_cells=3)
    names = [entry.id for entry in open_dataset(out).manifest.cells]
    other = next(name for name in choose_cells(crossroads(), PARAMETERS).names if name not in names)
    summary = build_dataset(crossroads(), out, PARAMETERS, cells=[other])
    assert (summary.built, summary.cells) == (1, 4)


@pytest.mark.parametrize("suffix", [".exr", ".glb", ".json"])
def test_a_damaged_cell_is_noticed_and_mended(tmp_path, suffix):
    out = tmp_path / "out"
    build_dataset(crossroads(), out, PARAMETERS, max_cells=2)
    before = contents(out)
    victim = sorted((out / "cells").glob(f"*{suffix}"))[0]
    victim.write_bytes(victim.read_bytes()[:-7])
    dataset = open_dataset(out)
    if suffix != ".json":
        with pytest.raises(DatasetError, match=victim.name):
            read_impostor(dataset, victim.stem, dataset.city())
    assert build_dataset(crossroads(), out, PARAMETERS, max_cells=2).built == 1
    assert contents(out) == before


def test_foreign_folders_are_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(DatasetError, match=r"thesis\.tex.*nothing was changed"):
        build_dataset(crossroads(), tmp_path, PARAMETERS)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
    with pytest.raises(DatasetError, match="found a file"):
        build_dataset(crossroads(), tmp_path / "thesis.tex", PARAMETERS)


def test_a_second_build_in_the_same_folder_is_refused(tmp_path):
    from mmi.dataset.folder import build_folder

    with build_folder(tmp_path / "out"), pytest.raises(DatasetError, match="another"), build_folder(tmp_path / "out"):
        pass


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"{", "damaged"),
        (b"[]", "format version"),
        (b'{"format_version": 99}', "99"),
        (b'{"format_version": 1}', "build it again"),
        (b'{"format_version": 2}', "build it again"),
        (b'{"format_version": %d}' % FORMAT_VERSION, "checksum"),
    ],
)
def test_a_damaged_manifest_is_refused(tmp_path, data, message):
    (tmp_path / "manifest.json").write_bytes(data)
    with pytest.raises(DatasetError, match=message):
        open_dataset(tmp_path)


def test_a_manifest_cannot_point_outside_the_dataset(built):
    dataset = open_dataset(built)
    for name in ("../secret", "/etc/passwd"):
        with pytest.raises(DatasetError, match="within"):
            dataset.read(FileEntry(name, 1, ""))


def test_a_full_disk_says_so_and_loses_nothing(built, tmp_path):
    """A limit on file sizes stands in for the disk: writing fails in the same place."""
    script = tmp_path / "build.py"
    script.write_text(
        "import resource, signal\nsignal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))\n" + SCRIPT.format(paths=PATHS)
    )
    kept = {
        key: value for key, value in os.environ.items() if not key.startswith("COV")
    }  # its file would fill the disk
    environment = kept | {"NUMBA_CACHE_DIR": str(tmp_path / "numba")}
    done = subprocess.run(
        [sys.executable, str(script), str(tmp_path / "out"), "1"], capture_output=True, text=True, env=environment
    )
    assert done.returncode != 0
    assert "DatasetError" in done.stderr.splitlines()[-1]
    assert "disk is full" in done.stderr.splitlines()[-1]
    build_dataset(crossroads(), tmp_path / "out", PARAMETERS)
    assert contents(tmp_path / "out") == contents(built)


@pytest.mark.parametrize(
    ("options", "message"), [({"cells": ["nowhere"]}, "nowhere"), ({"max_cells": 0}, "at least 1")]
)
def test_cells_that_are_not_there(tmp_path, options, message):
    with pytest.raises(ParameterError, match=message):
        build_dataset(crossroads(), tmp_path / "out", PARAMETERS, **options)


def test_landmarks_must_exist(tmp_path):
    with pytest.raises(ParameterError, match="cathedral"):
        build_dataset(crossroads(), tmp_path / "out", replace(PARAMETERS, landmarks=(("cathedral", 2.0),)))


def test_the_machine_s_doings_are_recorded(built):
    build = json.loads((built / "build.json").read_bytes())
    assert build["totals"]["cells"] >= 8
    assert build["totals"]["peak_memory_bytes"] > 10**7
