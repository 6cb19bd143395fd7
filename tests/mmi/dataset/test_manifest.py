"""What enters is held against the schema once: no value behind it is missing, of another kind, or contradicts another."""

import copy
import json
import shutil
from dataclasses import fields, is_dataclass, replace
from importlib.resources import files

import pytest
from cities import crossroads
from manifests import sign_again

from mmi.building.dataset import build_dataset
from mmi.dataset.folder import DatasetFolder
from mmi.dataset.manifest import (
    CellEntry,
    CellFiles,
    CellRecord,
    CityEntry,
    FileEntry,
    LayerEntry,
    manifest_from_json,
    manifest_to_json,
    record_from_json,
    record_to_json,
)
from mmi.dataset.reading import open_dataset
from mmi.foundation.camera import Camera
from mmi.foundation.errors import DatasetError
from mmi.planning.parameters import BuildParameters

PARAMETERS = BuildParameters(near_distance=30.0, camera=Camera(128, 128, 1.0), cell_length=80.0)
SCHEMA = json.loads((files("mmi.dataset") / "schemas" / "manifest.json").read_bytes())


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    out = tmp_path_factory.mktemp("manifest") / "out"
    build_dataset(crossroads(), out, PARAMETERS, max_cells=2)
    return open_dataset(out)


@pytest.mark.parametrize(
    ("value", "described"),
    [
        (CellEntry, SCHEMA["$defs"]["cell"]),
        (LayerEntry, SCHEMA["$defs"]["layer"]),
        (FileEntry, SCHEMA["$defs"]["file"]),
        (CellFiles, SCHEMA["$defs"]["cell"]["properties"]["files"]),
        (CityEntry, SCHEMA["properties"]["city"]),
        (BuildParameters, SCHEMA["properties"]["parameters"]),
    ],
)
def test_values_have_the_fields_that_the_schema_describes(value, described):
    assert {one.name for one in fields(value)} == set(described["properties"])


def test_a_manifest_comes_back_as_it_was_written(dataset):
    assert manifest_to_json(dataset.manifest) == (dataset.path / "manifest.json").read_bytes()
    document = json.loads((dataset.path / "manifest.json").read_bytes())
    assert dataset.manifest.bytes == document["totals"]["bytes"]


def frozen(value):
    """Whether nothing in a value can be changed."""
    if is_dataclass(value):
        return type(value).__dataclass_params__.frozen and all(
            frozen(getattr(value, one.name)) for one in fields(value)
        )
    return all(map(frozen, value)) if isinstance(value, tuple) else isinstance(value, str | int | float | None)


def test_nothing_in_it_can_be_changed(dataset):
    assert frozen(dataset.manifest)


def at(document, way):
    for key in way:
        document = document[key]
    return document


def denied(**fields):
    """A change to a cell of which nothing is promised: what is left to refuse is the value alone."""
    return lambda cell: cell.update(promised_error_px=None, promise_withheld="a reason", **fields)


LAYER = ("cells", 0, "layers", "first", 0)
CHANGES = {
    "a cell without its axis": (("cells", 0), lambda cell: cell.pop("axis")),
    "near is null": (("cells", 0), lambda cell: cell.update(near=None)),
    "an axis of one point": (("cells", 0), lambda cell: cell.update(axis=[[0.0, 0.0]])),
    "an axis of no length": (("cells", 0), lambda cell: cell.update(axis=[[0.0, 0.0], [0.0, 0.0]])),
    "an eye in words": (("cells", 0), lambda cell: cell.update(eye=["low", 1.0])),
    "bytes in words": (("cells", 0), lambda cell: cell.update(bytes="many")),
    "layers are a number": (("cells", 0), lambda cell: cell.update(layers=3)),
    "a cell that leads out of the folder": (("cells", 0), lambda cell: cell.update(id="../x")),
    "a promise and its denial": (("cells", 0), lambda cell: cell.update(promise_withheld="no reason")),
    "neither": (("cells", 0), lambda cell: cell.update(promised_error_px=None)),
    "layers without an EXR": (("cells", 0, "files"), lambda some: some.pop("exr")),
    "a file outside": (("cells", 0, "files", "glb"), lambda file: file.update(name="../../etc/passwd")),
    "a layer of nothing": (LAYER, lambda layer: layer.clear()),
    "an object that is not there": (LAYER, lambda layer: layer.update(objects=[10**6])),
    "fewer than no triangles in order": (LAYER, lambda layer: layer.update(in_order=-1)),
    "more triangles in order than there are": (LAYER, lambda layer: layer.update(in_order=100_000)),
    "a window in words": (LAYER, lambda layer: layer.update(window="wide")),
    "a window of no width": (LAYER, lambda layer: layer.update(window=[0, 0, -1, 16])),
    "an unknown field": ((), lambda manifest: manifest.update(note="mended by hand")),
    "a city of nothing": (("city",), lambda city: city.clear()),
    "the same cell twice": (("cells",), lambda cells: cells.append(copy.deepcopy(cells[0]))),
    "a number larger than any float": (("cells", 0, "axis", 0), lambda point: point.__setitem__(0, 10**400)),
    "a viewpoint beyond any float": (("cells", 0, "reference"), lambda point: point.__setitem__(0, 10**400)),
    "a factor beyond any float": (("parameters",), lambda parameters: parameters.update(landmarks=[["a", 10**400]])),
    "a cell called ..": (("cells", 0), lambda cell: cell.update(id="..")),
    "a file called ..": (("cells", 0, "files", "glb"), lambda file: file.update(name="cells/..")),
    "more cells than there are": (("totals",), lambda totals: totals.update(cells=99)),
    "triangles of no layer": (("cells", 0), lambda cell: cell.update(triangles=cell["triangles"] + 1)),
    "a promise of another threshold": (("cells", 0), lambda cell: cell.update(promised_error_px=5.0)),
    "an origin beyond any float": (("city", "origin"), lambda point: point.__setitem__(2, 10**400)),
    "a ground beyond any float": (("city",), lambda city: city.update(ground=-(10**400))),
    "bytes beyond any file": (("city", "files", "json"), lambda file: file.update(bytes=10**30)),
    "a street beyond the city": (("cells", 0, "axis", 0), lambda point: point.__setitem__(0, 1e9)),
    "a window beyond any picture": (LAYER, lambda layer: layer.update(window=[2**31, 0, 16, 16])),
    "a picture beyond any memory": (LAYER, lambda layer: layer.update(window=[0, 0, 2**31, 2**31])),
    "a focal length of nothing real": (LAYER, lambda layer: layer.update(focal=1e308)),
    "depths the wrong way round": (LAYER, lambda layer: layer.update(depth=[20.0, 10.0])),
    "a layer named as another": (LAYER, lambda layer: layer.update(name=f"s35.l{layer['index']}")),
    "a piece named as another": (LAYER, lambda layer: layer.update(name=f"{layer['name'].partition('.')[0]}.l0.7")),
    "a displacement beyond a right angle": (("cells", 0), lambda cell: cell.update(displacement_px=1e9)),
    "a displacement beyond a right angle of this display": (("cells", 0), denied(displacement_px=1660.0)),
    "a weight beyond a right angle of this display": (("cells", 0), lambda cell: cell.update(largest_weight_px=1660.0)),
    "more missed than there is around": (("cells", 0), denied(missed_px=1e5)),
    "a promise where more is displaced": (("cells", 0), lambda cell: cell.update(displacement_px=11.0)),
    "a promise where more is missed": (("cells", 0), lambda cell: cell.update(missed_px=11.0)),
    "a layer displaced by more than its cell": (("cells", 0), lambda cell: cell.update(displacement_px=0.0)),
    "a sector too many": (("cells", 0, "layers"), lambda layers: layers.append([])),
    "a display of nobody": (("parameters", "camera"), lambda camera: camera.update(width=10**9)),
    "a threshold of no display": (("parameters",), lambda parameters: parameters.update(max_error_px=1e9)),
    "unknown weights": (("parameters",), lambda parameters: parameters.update(weights="heavy")),
}


@pytest.mark.parametrize("name", CHANGES)
def test_what_the_schema_does_not_describe_is_refused_although_the_checksum_holds(dataset, tmp_path, name):
    way, change = CHANGES[name]
    (tmp_path / "manifest.json").write_bytes((dataset.path / "manifest.json").read_bytes())

    def edit(document):
        sectors = document["cells"][0]["layers"]
        first = next(i for i, layers in enumerate(sectors) if layers)
        change(at(document, [first if key == "first" else key for key in way]))

    sign_again(tmp_path, edit)
    with pytest.raises(DatasetError, match=r"manifest\.json: (values as|totals of) .* expected") as refused:
        open_dataset(tmp_path)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("halved", [False, True])
def test_a_record_comes_back(dataset, halved):
    record = CellRecord("a" * 64, "b" * 64, None if halved else dataset.manifest.cells[0])
    assert record_from_json(record_to_json(record)) == record


@pytest.mark.parametrize("change", ["cut", "edited", "signed again but not a cell", "of the version before"])
def test_a_damaged_record_is_refused(dataset, change):
    data = record_to_json(CellRecord("a" * 64, "b" * 64, dataset.manifest.cells[0]))
    if change == "cut":
        data = data[:-7]
    elif change == "edited":
        data = data.replace(b'"street":"', b'"street":"other ', 1)
    elif change == "of the version before":
        data = json.dumps({"inputs": "a" * 64, "content": "b" * 64, "entry": {"files": {}}, "halves": True}).encode()
    else:
        data = record_to_json(CellRecord("short", "b" * 64, None))
    with pytest.raises(DatasetError, match="a record: "):
        record_from_json(data)


def test_every_edited_record_is_noticed_and_its_cell_made_again(tmp_path):
    """A record has a checksum of its own: a number changed by hand does not get into the manifest."""
    out = tmp_path / "out"
    build_dataset(crossroads(), out, PARAMETERS, max_cells=1)
    before = (out / "manifest.json").read_bytes()
    (record,) = (out / "cells").glob("*.json")
    record.write_bytes(record.read_bytes().replace(b'"displacement_px":', b'"displacement_px":9', 1))
    assert build_dataset(crossroads(), out, PARAMETERS, max_cells=1).built == 1
    assert (out / "manifest.json").read_bytes() == before


def test_lists_a_thousand_deep_are_refused_too():
    for depth in (990, 100_000):
        data = b'{"format_version": 8, "checksum": "x", "a": ' + b"[" * depth + b"]" * depth + b"}"
        with pytest.raises(DatasetError, match="expected, found"):
            manifest_from_json(data, name="manifest.json")
        with pytest.raises(DatasetError, match=r"a record: .* expected, found"):
            record_from_json(data)


def test_a_record_that_holds_another_cell_is_damaged_and_what_is_no_record_stays(tmp_path):
    out = tmp_path / "out"
    build_dataset(crossroads(), out, PARAMETERS, max_cells=2)
    before = (out / "manifest.json").read_bytes()
    one, other = sorted((out / "cells").glob("*.json"))
    entries = [record_from_json(path.read_bytes()) for path in (one, other)]
    one.write_bytes(record_to_json(replace(entries[0], entry=entries[1].entry)))
    (out / "cells" / "notes.json").write_text('{"my": "notes"}')
    assert build_dataset(crossroads(), out, PARAMETERS, max_cells=2).built == 1
    assert (out / "manifest.json").read_bytes() == before
    assert (out / "cells" / "notes.json").read_text() == '{"my": "notes"}'


def damaged(data, *, every):
    """``data`` with one bit flipped, at every ``every``-th place."""
    for place in range(0, 8 * len(data), every):
        other = bytearray(data)
        other[place // 8] ^= 1 << place % 8
        yield bytes(other)


def test_no_flipped_bit_of_a_record_is_taken(dataset):
    """Neither noticed nor adopted is what it must never be: each flip is refused, or is the same record written otherwise."""
    data = record_to_json(
        CellRecord(
            "a" * 64,
            "b" * 64,
            replace(
                dataset.manifest.cells[0],
                layers=((),) * 6,
                triangles=0,
                files=CellFiles(dataset.manifest.cells[0].files.glb),
            ),
        )
    )
    for other in damaged(data, every=3):
        try:
            record = record_from_json(other)
        except DatasetError as error:
            assert "\n" not in str(error)
        else:
            assert record == record_from_json(data)


def test_no_flipped_bit_of_a_manifest_is_taken(dataset):
    data = manifest_to_json(replace(dataset.manifest, cells=()))
    for other in damaged(data, every=3):
        try:
            manifest = manifest_from_json(other, name="manifest.json")
        except DatasetError as error:
            assert "\n" not in str(error)
        else:
            assert manifest == manifest_from_json(data, name="manifest.json")


def test_every_flipped_byte_of_a_record_or_of_a_cells_file_is_mended_by_the_next_build(tmp_path):
    out = tmp_path / "out"
    build_dataset(crossroads(), out, PARAMETERS, max_cells=1)
    before = (out / "manifest.json").read_bytes()
    (name,) = (entry.id for entry in open_dataset(out).manifest.cells)
    folder = DatasetFolder(out)
    whole = folder.record(name)
    for path in sorted((out / "cells").iterdir()):
        data = path.read_bytes()
        for other in damaged(data, every=8 * max(len(data) // 24, 1) + 3):
            path.write_bytes(other)
            assert folder.record(name) in (None, whole)
            if path.suffix != ".json":
                assert folder.record(name) is None
        assert build_dataset(crossroads(), out, PARAMETERS, max_cells=1).built == 1
        assert path.read_bytes() == data
    assert (out / "manifest.json").read_bytes() == before


def test_the_size_of_a_file_is_compared_before_it_is_read(dataset, tmp_path):
    """What fills the memory of any machine is not read to see that it is too large."""
    out = shutil.copytree(dataset.path, tmp_path / "out")
    with (out / "city.json").open("r+b") as file:
        file.truncate(1 << 40)
    with pytest.raises(
        DatasetError, match=r"city\.json: \d+ bytes expected, as the manifest says, found 1099511627776"
    ):
        open_dataset(out).city()
