"""The manifest's checksum: whatever is changed is refused in one line, and the next build mends it."""

import copy
import hashlib
import json

import pytest
from cities import crossroads
from manifests import with_cells

import mmi.building.dataset
import mmi.building.workers
import mmi.dataset.folder
import mmi.dataset.manifest
from mmi.building.dataset import build_dataset
from mmi.dataset.manifest import FORMAT_VERSION, manifest_to_json
from mmi.dataset.reading import open_dataset
from mmi.foundation.camera import Camera
from mmi.foundation.errors import DatasetError
from mmi.foundation.json_forms import canonical_json, readable_json, with_checksum
from mmi.planning.parameters import BuildParameters

PARAMETERS = BuildParameters(near_distance=30.0, camera=Camera(128, 128, 1.0), cell_length=80.0)
REFUSED = (
    r"^\S+/manifest\.json: the checksum that build-impostors wrote expected, found other contents; "
    r"run build-impostors again to mend it$"
)


def contents(folder):
    """Bytes of every file but build.json."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "build.json"
    }


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    out = tmp_path_factory.mktemp("dataset") / "out"
    build_dataset(crossroads(), out, PARAMETERS, max_cells=3)
    return out


@pytest.fixture
def manifest(built):
    """The manifest as plain values; afterwards the file is as it was."""
    before = (built / "manifest.json").read_bytes()
    yield json.loads(before)
    (built / "manifest.json").write_bytes(before)


def test_the_checksum_is_that_of_the_rest(built, manifest):
    rest = {key: value for key, value in manifest.items() if key != "checksum"}
    assert manifest["checksum"] == hashlib.sha256(canonical_json(rest)).hexdigest()
    assert json.loads(manifest_to_json(open_dataset(built).manifest)) == manifest


def number(manifest):
    manifest["cells"][1]["half_width"] += 1e-9


def whole_number(manifest):
    manifest["cells"][0]["texels"] = float(manifest["cells"][0]["texels"])


def dropped(manifest):
    del manifest["cells"][1]


def doubled(manifest):
    manifest["cells"].append(copy.deepcopy(manifest["cells"][0]))


def swapped(manifest):
    manifest["cells"].reverse()


def renamed(manifest):
    manifest["city"]["source"] = "elsewhere"


def added(manifest):
    manifest["note"] = "mended by hand"


def emptied(manifest):
    manifest["cells"] = None


def unsigned(manifest):
    del manifest["checksum"]


def signed_otherwise(manifest):
    manifest["checksum"] = manifest["checksum"][::-1]


def signed_with_a_number(manifest):
    manifest["checksum"] = 7


EDITS = [number, whole_number, dropped, doubled, swapped, renamed, added, emptied]
EDITS += [unsigned, signed_otherwise, signed_with_a_number]


@pytest.mark.parametrize("edit", EDITS)
def test_an_edited_manifest_is_refused(built, manifest, edit):
    edit(manifest)
    (built / "manifest.json").write_bytes(readable_json(manifest))
    with pytest.raises(DatasetError, match=REFUSED):
        open_dataset(built)


@pytest.mark.parametrize("value", ["NaN", "-Infinity", "1e999", '"\\ud800"'])
def test_what_no_checksum_can_be_made_of_is_refused(built, manifest, value):
    text = json.dumps({**manifest, "totals": "here"}).replace('"here"', value)
    (built / "manifest.json").write_text(text)
    with pytest.raises(DatasetError, match=REFUSED):
        open_dataset(built)


@pytest.mark.parametrize("value", ["[]", "3", "null", '"manifest"', "{}", '[{"format_version": 2}]', "[" * 100_000])
@pytest.mark.usefixtures("manifest")
def test_json_of_another_kind_is_refused(built, value):
    (built / "manifest.json").write_text(value)
    with pytest.raises(DatasetError, match=r"manifest\.json: (format version|JSON) .*expected"):
        open_dataset(built)


def test_other_white_space_and_order_are_the_same_manifest(built, manifest):
    (built / "manifest.json").write_text(json.dumps(dict(reversed(manifest.items())), ensure_ascii=True))
    assert json.loads(manifest_to_json(open_dataset(built).manifest)) == manifest


def test_a_build_mends_the_manifest_and_nothing_else(built, manifest):
    before = contents(built)
    dropped(manifest)
    (built / "manifest.json").write_bytes(readable_json(manifest))
    summary = build_dataset(crossroads(), built, PARAMETERS, max_cells=3)
    assert (summary.built, summary.complete) == (0, 3)
    assert contents(built) == before


def test_a_dataset_of_the_version_before_is_made_again(built, tmp_path, monkeypatch):
    out = tmp_path / "out"
    with monkeypatch.context() as past:
        for module in (mmi.building.dataset, mmi.building.workers, mmi.dataset.manifest, mmi.dataset.folder):
            past.setattr(module, "FORMAT_VERSION", FORMAT_VERSION - 1)
        build_dataset(crossroads(), out, PARAMETERS, max_cells=3)
    expected = rf"format version {FORMAT_VERSION} expected, found {FORMAT_VERSION - 1}; build it again"
    with pytest.raises(DatasetError, match=expected):
        open_dataset(out)
    old = json.loads((out / "manifest.json").read_bytes())
    del old["checksum"]  # as version 1 was: the version is looked at first
    (out / "manifest.json").write_bytes(readable_json(old))
    with pytest.raises(DatasetError, match="build it again"):
        open_dataset(out)
    assert build_dataset(crossroads(), out, PARAMETERS, max_cells=3).built == 3
    assert contents(out) == contents(built)


def test_cells_are_found_by_their_ids(built):
    dataset = open_dataset(built)
    for entry in dataset.manifest.cells:
        assert dataset.cell(entry.id) == entry
    with pytest.raises(DatasetError, match=r"out: no cell 'nowhere'; there are 3, such as \d+-\d+"):
        dataset.cell("nowhere")
    with pytest.raises(DatasetError, match="no cell 'a'; there are 0"):
        with_cells(dataset).cell("a")


def test_signing_twice_is_signing_once():
    once = with_checksum({"b": 1.5, "a": ["ü"]})
    assert set(once) == {"a", "b", "checksum"}
    assert with_checksum(once) == once
