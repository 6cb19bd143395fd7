import numpy as np
import pytest

from mmi.foundation.errors import DatasetError
from viewer.cells.layer_atlas import BORDER
from viewer.cells.loaded_cell import load_cell
from viewer.cells.scene_cache import foretold_bytes
from viewer.plan import CellKey


def test_a_loaded_cell_is_what_was_captured(scene, dataset):
    loaded = load_cell(scene, "0001-01", measured=True)
    entry = dataset.cell("0001-01")
    assert loaded.key == CellKey("multi-mesh", "0001-01")
    assert [layer.name for layer in loaded.layers] == [one.name for some in entry.layers for one in some]
    far = {scene.objects[one] for one in entry.far}
    for layer, described in zip(loaded.layers, [one for some in entry.layers for one in some], strict=True):
        inner = np.s_[BORDER:-BORDER, BORDER:-BORDER]
        covered = layer.picture.pixels[inner][..., 3] == 255
        depth = layer.picture.depth[inner]
        assert np.array_equal(layer.picture.object_ids[inner] >= 0, covered)
        assert set(np.unique(layer.picture.object_ids)) - {-1} <= far
        assert np.isfinite(depth[covered]).all()
        assert len(layer.triangles) == described.triangles
        beyond = np.isfinite(depth) & ~covered
        padded = np.pad(covered, 1)
        around = np.any(
            [padded[i : i + covered.shape[0], j : j + covered.shape[1]] for i in range(3) for j in range(3)], 0
        )
        assert np.array_equal(beyond, around & ~covered), "depth goes on for one texel"
        view = entry.view(int(layer.name[1]), described)
        u, v, deep = view.project(layer.vertices[:, :3].astype(float)).T
        np.testing.assert_allclose(layer.vertices[:, 5], deep, rtol=1e-5)
        at = layer.vertices[:, 3:5] / layer.vertices[:, 5:] * loaded.size
        np.testing.assert_allclose(at[:, 0], u - described.window[0] + layer.corner[0] + BORDER, atol=0.01)
        np.testing.assert_allclose(at[:, 1], v - described.window[1] + layer.corner[1] + BORDER, atol=0.01)
    assert loaded.bytes > sum(layer.picture.pixels.nbytes + layer.picture.depth.nbytes for layer in loaded.layers)
    plain = load_cell(scene, "0001-01")
    assert all(layer.picture.object_ids is None for layer in plain.layers)
    assert plain.bytes < loaded.bytes


@pytest.mark.parametrize("measured", [False, True])
def test_bytes_are_those_of_the_arrays_and_foretold_from_the_manifest(scene, dataset, measured):
    """On the GPU the atlas has all texels of the arrays, and those between pictures."""
    for entry in dataset.manifest.cells:
        loaded = load_cell(scene, entry.id, measured=measured)
        assert loaded.layers
        pictures = [
            [one for one in (layer.picture.pixels, layer.picture.depth, layer.picture.object_ids) if one is not None]
            for layer in loaded.layers
        ]
        texel = {sum(one.nbytes for one in some) / some[1].size for some in pictures}
        assert len(texel) == 1
        held = sum(one.nbytes for some in pictures for one in some)
        meshes = sum(layer.vertices.nbytes + layer.triangles.nbytes for layer in loaded.layers)
        assert loaded.bytes == loaded.size[0] * loaded.size[1] * texel.pop() + meshes
        assert held + meshes <= loaded.bytes
        foretold = foretold_bytes(dataset, entry.id, measured=measured)
        assert loaded.bytes <= foretold <= 1.1 * loaded.bytes


def test_damaged_files_are_refused(tmp_path, dataset):
    import shutil

    from mmi.dataset.reading import open_dataset
    from viewer.scene.scene import open_scene

    shutil.copytree(dataset.path, tmp_path / "copy")
    broken = open_scene(open_dataset(tmp_path / "copy"), name="multi-mesh")
    for suffix in ("glb", "exr"):
        file = tmp_path / "copy" / "cells" / f"0001-01.{suffix}"
        whole = file.read_bytes()
        for damage in (whole[: len(whole) // 2], whole[:-1] + bytes([whole[-1] ^ 1]), b""):
            file.write_bytes(damage)
            with pytest.raises(DatasetError, match=f"0001-01.{suffix}"):
                load_cell(broken, "0001-01")
        file.unlink()
        with pytest.raises(DatasetError, match=f"0001-01.{suffix}"):
            load_cell(broken, "0001-01")
        file.write_bytes(whole)
