"""The examples run as they stand, and do what they say."""

import importlib
import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest
import shapely
from cities import HELSINKI
from PIL import Image

from mmi.dataset.cell_files import read_impostor
from mmi.dataset.reading import open_dataset
from mmi.foundation.errors import DatasetError
from mmi.inspection.inspect import inspect_dataset
from viewer.report.compare import compare_views
from viewer.report.options import CompareOptions

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def load(name, folder=EXAMPLES):
    """An example as a module."""
    spec = importlib.util.spec_from_file_location(name, folder / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    out = tmp_path_factory.mktemp("example") / "helsinki"
    summary = load("build_from_python").main(HELSINKI, out, max_cells=1)
    return out, summary


def test_a_city_file_becomes_a_dataset(built):
    out, summary = built
    assert summary.built == 1
    parameters = open_dataset(out).manifest.parameters
    assert (parameters.max_error_px, parameters.camera.width) == (5.0, 1280)


def test_layers_are_listed_and_one_is_a_picture(built, capsys, tmp_path):
    load("look_at_layers").main(built[0], tmp_path / "layer.png")
    cell = open_dataset(built[0]).manifest.cells[0]
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"cell {cell.id}: {len(cell.near)} objects stay geometry, {len(cell.far)} are")
    assert len(lines) == 2 + len(cell.pictures)
    with Image.open(tmp_path / "layer.png") as picture:
        colors = np.asarray(picture)
    assert colors.shape[2] == 4
    assert set(np.unique(colors[..., 3])) == {0, 255}, "sky and houses"
    assert colors[colors[..., 3] == 255].std() > 10.0


def test_a_dataset_is_compared_with_its_geometry(built, capsys, tmp_path):
    report = load("compare_with_geometry").main(built[0], tmp_path / "comparison", views=3)
    assert report["techniques"]["visible"]["wrong_share"] == 0.0
    assert report["techniques"]["multi-mesh"]["wrong_share"] < 0.01
    assert (tmp_path / "comparison" / "report.html").exists()
    assert "multi-mesh  wrong 0.0" in capsys.readouterr().out


@pytest.mark.slow
def test_a_walk_of_ones_own_is_drawn(built, capsys, tmp_path):
    times = load("a_walk_of_ones_own").main(built[0], tmp_path / "walk.png")
    assert len(times) > 10
    assert "frames of" in capsys.readouterr().out
    with Image.open(tmp_path / "walk.png") as picture:
        assert picture.size == (2 * 1280, 720)
        assert np.asarray(picture).std() > 20.0


def test_plots_of_ones_own_are_written(built, tmp_path):
    drawn, depths = load("plots_of_ones_own").main(built[0], tmp_path / "map.svg", tmp_path / "depths.pdf")
    assert (tmp_path / "map.svg").read_text().startswith("<?xml")
    assert (tmp_path / "depths.pdf").read_bytes().startswith(b"%PDF")
    cell = open_dataset(built[0]).manifest.cells[0]
    assert f"near, stays geometry ({len(cell.near)})" in {text.get_text() for text in drawn.legends[0].get_texts()}
    layers = {layer.index for _, layer in cell.pictures}
    assert {text.get_text() for text in depths.axes[0].get_yticklabels()} == {f"layer {i}" for i in layers}
    assert all(bar.get_width() > 0.0 for bar in depths.axes[0].patches)


@pytest.mark.slow
def test_a_technique_of_ones_own_is_compared(built, capsys, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLES)
    report = importlib.import_module("a_technique_of_ones_own").main(built[0], tmp_path / "comparison", views=3)
    own = report["techniques"]["within 100 m"]
    assert own["origin"] == {"function": "a_technique_of_ones_own:within_100_m", "version": "1"}
    wrong = [report["techniques"][name]["wrong_share"] for name in ("multi-mesh", "within 100 m", "local")]
    assert wrong == sorted(wrong), "the more is drawn the less is wrong"
    assert wrong[0] < wrong[1] < wrong[2]
    assert "within 100 m " in capsys.readouterr().out


@pytest.mark.slow
def test_a_weight_of_ones_own_is_used_by_workers_and_recorded(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(EXAMPLES)  # as for a script that is run, or PYTHONPATH
    own = importlib.import_module("a_weight_of_ones_own")
    assert own.main(HELSINKI, tmp_path / "own", max_cells=2, workers=2).built == 2
    dataset = open_dataset(tmp_path / "own")
    assert dataset.manifest.parameters.weights == "a_weight_of_ones_own:apart@1"
    assert [cell.promised_error_px for cell in dataset.manifest.cells] == [None, None]
    with pytest.raises(
        DatasetError, match=r"manifest\.json: choices of this package expected, found a_weight_of_ones_own:apart@1"
    ):
        inspect_dataset(dataset, tmp_path / "plots")
    assert not (tmp_path / "plots").exists()
    assert len(inspect_dataset(dataset, tmp_path / "plots", own_functions=True)) > 2
    with pytest.raises(DatasetError, match="single-mesh expects a dataset built with choices of this package"):
        compare_views(
            dataset.path, tmp_path / "comparison", views=1, options=CompareOptions(techniques=("single-mesh",))
        )
    city = dataset.city()
    for cell in dataset.manifest.cells:
        impostor = read_impostor(dataset, cell.id, city)
        away = {i: city.objects[i].footprint.distance(shapely.Point(impostor.cell.reference[:2])) for i in impostor.far}
        for index in {layer.index for layer in impostor.layers}:
            shared = [away[int(i)] for layer in impostor.layers if layer.index == index for i in layer.objects]
            assert max(shared) <= 2.0 * min(shared) * (1.0 + 1e-9)


def test_own_buildings_are_near_in_layers_or_hidden(capsys):
    plan = load("own_buildings").main()
    out = capsys.readouterr().out
    near = out.split("near: ")[1].splitlines()[0]
    assert {name.strip() for name in near.split(",")} >= {"house A1", "house B1", "house C1"}, "the row on the street"
    assert len(plan.layers) > 1
    assert sorted(np.concatenate(plan.layers)) == sorted(plan.selection.far)
    listed = out.split("near: ")[1]
    assert sorted(f"house {column}{row}" for column in "ABC" for row in "1234") == sorted(
        name.strip() for line in listed.replace("hidden:", "x:").splitlines() for name in line.split(":")[-1].split(",")
    )


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.name)
def test_an_example_is_short_enough_to_learn_from(path):
    assert len(path.read_text().splitlines()) < 60


def test_there_are_examples():
    assert len(list(EXAMPLES.glob("*.py"))) >= 3


@pytest.mark.slow
def test_the_first_stages_become_pictures(capsys, tmp_path):
    pictures = tmp_path / "cells.png", tmp_path / "visibility.png"
    load("stages", EXAMPLES.parent / "docs" / "pictures").main(HELSINKI, *pictures)
    found = re.match(r"(\d+) cells; from 0355-00 in Fabianinkatu, (\d+) of (\d+) objects", capsys.readouterr().out)
    cells, seen, objects = map(int, found.groups())
    assert cells > 1000
    assert 19 < seen < objects / 2, "a street, not a square"
    for path in pictures:
        with Image.open(path) as picture:
            assert len(picture.convert("RGB").getcolors(1 << 20)) > 4
