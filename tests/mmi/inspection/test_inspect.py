"""Pictures of a dataset: which are drawn, that they show the build's own plan, and what is said when they cannot be."""

import json
import os
import shutil
from dataclasses import replace

import pytest
from cities import HELSINKI, crossroads, streets
from manifests import sign_again, with_cells, with_first_cell, with_first_picture
from PIL import Image

import mmi.inspection.inspect
from mmi.building.dataset import build_dataset
from mmi.city.model import City
from mmi.dataset.reading import open_dataset
from mmi.foundation.camera import Camera
from mmi.foundation.errors import DatasetError, ParameterError
from mmi.inspection.figures import PICTURE_FORMATS
from mmi.inspection.inspect import inspect_dataset, typical_cell
from mmi.inspection.layer_sheets import dataset_histograms
from mmi.planning.parameters import BuildParameters
from mmi.programs.inspect_layers import inspect_layers

PARAMETERS = BuildParameters(near_distance=30.0, camera=Camera(128, 128, 1.0), cell_length=80.0, sectors=4)


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    out = tmp_path_factory.mktemp("dataset") / "out"
    build_dataset(crossroads(), out, PARAMETERS, max_cells=3)
    return open_dataset(out)


def test_a_typical_cell_has_its_map_graph_and_sectors_and_the_dataset_its_histograms(built, tmp_path):
    cell = typical_cell(built)
    calls = []
    written = inspect_dataset(built, tmp_path / "new" / "folder", progress=lambda *call: calls.append(call))
    shown = [k for k, layers in enumerate(built.cell(cell).layers) if layers]
    assert shown
    names = [f"{cell}-map", f"{cell}-graph", *(f"{cell}-sector-{k}" for k in shown), "histograms"]
    assert written == [tmp_path / "new" / "folder" / f"{name}.png" for name in names]
    assert calls == [(i + 1, len(names), name) for i, name in enumerate(names)]
    for path in written:
        with Image.open(path) as picture:
            assert picture.format == "PNG" and min(picture.size) > 200


def test_cells_asked_for_are_drawn_once_and_give_the_same_bytes(built, tmp_path):
    cells = [entry.id for entry in built.manifest.cells][:2]
    written = inspect_dataset(built, tmp_path / "a", cells=[*cells, cells[0]])
    assert [path.name for path in written if path.name.endswith("-map.png")] == [f"{cell}-map.png" for cell in cells]
    again = inspect_dataset(built, tmp_path / "b", cells=cells[1:])
    for path in again:
        assert path.read_bytes() == (tmp_path / "a" / path.name).read_bytes()


def test_pictures_come_in_other_formats(built, tmp_path):
    written = inspect_dataset(built, tmp_path, format="svg")
    assert {path.suffix for path in written} == {".svg"} and sorted(tmp_path.iterdir()) == sorted(written)
    for path in written:
        assert path.read_text().startswith("<?xml")


def test_unknown_formats_are_refused_before_anything_is_written(built, tmp_path):
    with pytest.raises(ParameterError, match="format: png, svg, pdf expected, found 'gif'"):
        inspect_dataset(built, tmp_path / "plots", format="gif")
    assert not (tmp_path / "plots").exists()


def entry(cell, layers, far):
    return cell, layers, far


@pytest.mark.parametrize(
    ("cells", "typical"),
    [
        ([entry("a", 9, 9), entry("b", 2, 4), entry("c", 0, 0), entry("d", 0, 0), entry("e", 1, 1)], "b"),
        ([entry("a", 2, 7), entry("b", 2, 5), entry("c", 2, 6)], "c"),
        ([entry("b", 0, 0), entry("a", 0, 0)], "b"),
    ],
)
def test_a_typical_cell_is_in_the_middle_of_those_with_layers(built, cells, typical):
    one = built.manifest.cells[0]
    picture = replace(one.pictures[0][1], objects=(0,))

    def made(cell, layers, far):
        pictures = tuple(replace(picture, index=i, name=f"s0.l{i}") for i in range(layers))
        files = one.files if layers else replace(one.files, exr=None)
        triangles = layers * picture.triangles
        return replace(one, id=cell, layers=(pictures,), far=("x",) * far, files=files, triangles=triangles)

    made_cells = [made(*cell) for cell in cells]
    for order in (made_cells, made_cells[::-1]):
        assert typical_cell(with_cells(built, *order)) == typical


def test_a_cell_without_layers_has_its_map(tmp_path):
    build_dataset(crossroads(), tmp_path / "out", replace(PARAMETERS, near_distance=1000.0), max_cells=1)
    dataset = open_dataset(tmp_path / "out")
    cell = typical_cell(dataset)
    written = inspect_dataset(dataset, tmp_path / "plots")
    assert [path.name for path in written] == [f"{cell}-map.png", f"{cell}-graph.png", "histograms.png"]


@pytest.fixture
def titles(monkeypatch):
    """The titles of all histograms drawn since."""
    titles = []

    def noted(*, title, **figures):
        titles.append(title)
        return dataset_histograms(title=title, **figures)

    monkeypatch.setattr(mmi.inspection.inspect, "dataset_histograms", noted)
    return titles


@pytest.mark.parametrize("choice", [{"layering": "single"}, {"weights": "critical-zone"}])
def test_what_keeps_no_bound_is_drawn_and_none_claimed(tmp_path, titles, choice):
    build_dataset(crossroads(), tmp_path / "out", replace(PARAMETERS, **choice), max_cells=1)
    assert len(inspect_dataset(open_dataset(tmp_path / "out"), tmp_path / "plots")) > 3
    (title,) = titles
    assert title.endswith("no bound on the error at 128 x 128")


def test_a_bound_is_claimed_for_the_cells_that_promise_it(built, tmp_path, titles):
    inspect_dataset(built, tmp_path, cells=[])
    inspect_dataset(with_first_cell(built, promised_error_px=None, promise_withheld="a reason"), tmp_path, cells=[])
    assert [title.split(", ", 1)[1] for title in titles] == [
        "at most 10 px of error at 128 x 128",
        "at most 10 px of error at 128 x 128, promised for 2 of them",
    ]


@pytest.mark.slow
def test_visibility_by_item_buffer_is_planned_again_too(tmp_path):
    parameters = replace(PARAMETERS, visibility="item-buffer")
    build_dataset(crossroads(), tmp_path / "out", parameters, max_cells=1)
    assert len(inspect_dataset(open_dataset(tmp_path / "out"), tmp_path / "plots")) > 3


@pytest.mark.parametrize("what", ["near", "far", "layers"])
def test_a_plan_that_is_not_the_manifests_is_refused(built, tmp_path, what):
    first = built.manifest.cells[0]
    if what == "layers":
        other = with_first_picture(built, index=first.pictures[0][1].index + 1)
    elif what == "near":
        other = with_first_cell(built, near=first.near[:-1])
    else:
        other = with_first_cell(
            built, far=first.far[:-1], layers=((),) * 6, files=replace(first.files, exr=None), triangles=0
        )
    expected = {"near": "near objects", "far": "far objects", "layers": "layers"}[what]
    with pytest.raises(DatasetError, match=rf"manifest\.json: the {expected} of cell .*; run build-impostors again"):
        inspect_dataset(other, tmp_path, cells=[first.id])


def test_unknown_cells_and_empty_datasets_are_refused(built, tmp_path):
    with pytest.raises(DatasetError, match="no cell '9999-99'; there are 3, such as"):
        inspect_dataset(built, tmp_path, cells=["9999-99"])
    with pytest.raises(DatasetError, match="with cells expected, found none"):
        inspect_dataset(with_cells(built), tmp_path)


def test_a_folder_that_cannot_be_made_or_written_is_named(built, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(DatasetError, match=r"file: a folder for the pictures expected"):
        inspect_dataset(built, tmp_path / "file")
    with pytest.raises(DatasetError, match=r"below: a folder for the pictures expected"):
        inspect_dataset(built, tmp_path / "file" / "below")
    (tmp_path / "plots" / f"{typical_cell(built)}-map.png").mkdir(parents=True)
    with pytest.raises(DatasetError, match=r"-map\.png: a writable file expected"):
        inspect_dataset(built, tmp_path / "plots")


def test_street_names_in_any_script_and_with_dollars_are_drawn(tmp_path):
    city = crossroads()
    lines = streets(*([tuple(p) for p in e["geometry"].coords] for _, _, e in city.streets.edges(data=True)))
    for _, _, edge in lines.edges(data=True):
        edge["name"] = "東京 $\\frac$ 5$"
    city = City(city.objects, lines, city.crs, city.origin, "$x_$")
    build_dataset(city, tmp_path / "out", PARAMETERS, max_cells=1)
    assert inspect_dataset(open_dataset(tmp_path / "out"), tmp_path / "plots")


def run(*arguments):
    """Exit status of inspect-layers."""
    with pytest.raises(SystemExit) as end:
        inspect_layers([os.fspath(one) for one in arguments])
    return end.value.code


def test_the_program_lists_what_it_wrote(built, tmp_path, capsys):
    assert run(built.path, "-o", tmp_path, "--json") == 0
    listed = json.loads(capsys.readouterr().out)
    assert sorted(listed) == sorted(map(str, tmp_path.glob("*.png"))) and listed


def test_the_program_writes_every_format_and_refuses_others(built, tmp_path, capsys):
    assert run(built.path, "-o", tmp_path, "--format", "pdf") == 0
    assert {path.suffix for path in tmp_path.iterdir()} == {".pdf"}
    for form in PICTURE_FORMATS:  # understood, and then there is no dataset
        assert run(tmp_path / "none", "-o", tmp_path, "--format", form) == 2
        assert "none" in capsys.readouterr().err
    assert run(built.path, "-o", tmp_path, "--format", "gif") == 2
    assert "'gif'" in capsys.readouterr().err


def test_the_program_says_what_is_wrong_in_one_line(built, tmp_path, capsys):
    for arguments in ([tmp_path / "none", "-o", tmp_path], [built.path, "-o", tmp_path, "--cell", "x"]):
        assert run(*arguments) == 2
        error = capsys.readouterr().err
        assert error.startswith("inspect-layers: error: ") and error.count("\n") == 1


@pytest.mark.parametrize(
    "parameters",
    [
        BuildParameters(),
        replace(PARAMETERS, landmarks=(("a", 2.0), ("b", 3.5)), near_triangles=100, eye=(1.0, 2.0), layering="dsatur"),
    ],
)
def test_parameters_come_back_from_json(parameters):
    assert BuildParameters.from_dict(json.loads(json.dumps(parameters.as_dict()))) == parameters


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"eye": [1.5]}, "as stored"), ({"camera": {"width": 3}}, "as stored"), ({"camera": 7}, "as stored"),
        ({"max_error_px": "ten"}, "max_error_px: a number"),
        ({"landmarks": [["a"]]}, "as stored"), ({"sectors": 6.5}, "sectors: a whole"),
        ({"quad": 16.0}, "quad: a whole"), ({"weights": "heavy"}, "weights: same-ray or critical-zone or"),
        ({"more": 1}, "expected, found"), ({"near_triangles": True}, "near_triangles: a whole"),
    ],
)  # fmt: skip
def test_damaged_parameters_are_refused(built, tmp_path, change, message):
    stored = {**PARAMETERS.as_dict(), **change}
    with pytest.raises(ParameterError, match=message):
        BuildParameters.from_dict(stored)
    shutil.copy(built.path / "manifest.json", tmp_path)
    sign_again(tmp_path, lambda document: document.update(parameters=stored))
    with pytest.raises(DatasetError, match=r"manifest\.json: "):
        open_dataset(tmp_path)


@pytest.mark.parametrize("stored", [None, [], {}])
def test_parameters_must_be_all_there(stored):
    with pytest.raises(ParameterError, match=r"parameters \['camera', .* expected, found"):
        BuildParameters.from_dict(stored)


@pytest.mark.slow
def test_a_real_district_is_drawn(tmp_path):
    from mmi.reading.read_city import read_city

    city, _ = read_city(HELSINKI)
    build_dataset(city, tmp_path / "out", max_cells=2)
    dataset = open_dataset(tmp_path / "out")
    assert len(inspect_dataset(dataset, tmp_path / "plots", cells=[one.id for one in dataset.manifest.cells])) > 8
