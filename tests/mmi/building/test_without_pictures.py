"""Datasets of meshes without pictures (MMI section 5.2): what they share with others, what they lack, and who says so."""

import json
from dataclasses import replace

import numpy as np
import pytest
from cities import crossroads
from manifests import sign_again
from PIL import Image
from selection import with_slow
from test_dataset import PARAMETERS, contents

from mmi.building.dataset import build_dataset
from mmi.dataset.cell_files import read_depths, read_impostor, read_meshes, read_pictures
from mmi.dataset.glb import read_glb
from mmi.dataset.reading import open_dataset
from mmi.foundation.errors import DatasetError, ParameterError
from mmi.inspection.inspect import inspect_dataset, typical_cell
from mmi.planning.parameters import BuildParameters

BARE = replace(PARAMETERS, pictures="none")
FOUND = "a dataset with pictures of its layers expected, found one built with --pictures none"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    out = tmp_path_factory.mktemp("whole") / "out"
    build_dataset(crossroads(), out, PARAMETERS, max_cells=3)
    return open_dataset(out)


@pytest.fixture(scope="module")
def bare(tmp_path_factory):
    out = tmp_path_factory.mktemp("bare") / "out"
    build_dataset(crossroads(), out, BARE, max_cells=3)
    return open_dataset(out)


def test_the_parameter_is_written_only_where_it_is_not_the_usual():
    assert "pictures" not in PARAMETERS.as_dict()
    assert BARE.as_dict() == {**PARAMETERS.as_dict(), "pictures": "none"}
    for one in (PARAMETERS, BARE):
        assert BuildParameters.from_dict(json.loads(json.dumps(one.as_dict()))) == one
    with pytest.raises(ParameterError, match="pictures: all or none expected, found 'some'"):
        replace(PARAMETERS, pictures="some")


def test_meshes_and_all_else_that_the_manifest_says_are_the_same(whole, bare):
    assert [one.id for one in bare.manifest.cells] == [one.id for one in whole.manifest.cells]
    for entry, other in zip(bare.manifest.cells, whole.manifest.cells, strict=True):
        assert replace(entry, bytes=0, files=other.files, frame=None) == replace(other, bytes=0, frame=None)
        assert entry.frame.geometry == other.frame.geometry
        layers = entry.frame.layers  # and fewer bytes, which cost less
        assert replace(layers, bytes=0, cost=0.0) == replace(other.frame.layers, bytes=0, cost=0.0)
        meshes = read_meshes(bare, entry.id)
        assert meshes
        for one, two in zip(meshes, read_meshes(whole, entry.id), strict=True):
            assert (one.name, one.index, one.sector, one.piece, one.in_order) == (
                two.name,
                two.index,
                two.sector,
                two.piece,
                two.in_order,
            )
            assert one.view.window == two.view.window and one.view.focal == two.view.focal
            for name in ("vertices", "uv", "triangles"):
                assert np.array_equal(getattr(one.mesh, name), getattr(two.mesh, name))


def test_there_are_no_images_and_no_depths(whole, bare):
    """And the bytes are as many fewer: what is left of a cell is its meshes."""
    for entry in bare.manifest.cells:
        with_pictures = whole.cell(entry.id)
        assert entry.files.exr is None and not (bare.path / "cells" / f"{entry.id}.exr").exists()
        assert not read_glb(bare.read(entry.files.glb)).images
        images = read_glb(whole.read(with_pictures.files.glb)).images
        pictures = sum(len(one.data) for one in images)
        textures = 400 * len(images)  # bytes of JSON a texture: material, texture, image, buffer view
        saved = with_pictures.files.glb.bytes - entry.files.glb.bytes
        assert pictures <= saved <= pictures + textures
        assert entry.bytes == entry.files.glb.bytes < with_pictures.bytes


def test_who_reads_pictures_is_told(bare):
    cell = typical_cell(bare)
    for read in (read_pictures, read_depths, lambda *about: read_impostor(*about, bare.city())):
        with pytest.raises(DatasetError, match=FOUND) as found:
            read(bare, cell)
        assert "\n" not in str(found.value)


def test_plots_show_what_was_captured_all_the_same(whole, bare, tmp_path):
    written = inspect_dataset(bare, tmp_path / "bare")
    expected = inspect_dataset(whole, tmp_path / "whole")
    assert [path.name for path in written] == [path.name for path in expected]
    sheets = [path.name for path in written if "sector" in path.name]
    assert sheets
    for name in sheets:
        one, two = (
            np.asarray(Image.open(tmp_path / of / name).convert("RGB"), dtype=float) for of in ("bare", "whole")
        )
        assert one.shape == two.shape and np.abs(one - two).mean() < 1.0, "but for WebP's loss"


@pytest.mark.parametrize("workers", with_slow([1, 2], {2}))
def test_a_folder_can_be_brought_from_one_to_the_other_and_back(whole, bare, tmp_path, workers):
    out = tmp_path / "out"
    for parameters, like in ((PARAMETERS, whole), (BARE, bare), (PARAMETERS, whole)):
        summary = build_dataset(crossroads(), out, parameters, max_cells=3, workers=workers)
        assert summary.built == 3
        assert contents(out) == contents(like.path)
    assert build_dataset(crossroads(), out, PARAMETERS, max_cells=3).built == 0


def test_a_manifest_that_says_one_thing_and_has_another_is_refused(whole, bare, tmp_path):
    """An EXR in a dataset without pictures, and none in one with them."""
    for dataset, choice in ((whole, {"pictures": "none"}), (bare, {})):
        folder = tmp_path / str(len(choice))
        folder.mkdir()
        (folder / "manifest.json").write_bytes((dataset.path / "manifest.json").read_bytes())

        def edit(document, choice=choice):
            document["parameters"].pop("pictures", None)
            document["parameters"].update(choice)

        sign_again(folder, edit)
        with pytest.raises(DatasetError, match="an EXR expected where there are pictures of layers, and only there"):
            open_dataset(folder)
