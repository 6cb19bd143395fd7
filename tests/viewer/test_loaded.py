import numpy as np
import pytest

from mmi.camera import level_view
from mmi.errors import DatasetError
from mmi.impostor import DepthTexture, GridMesh
from mmi.meshing import grid_mesh
from viewer.loaded import divide_triangles, load_cell
from viewer.technique import CellKey

VIEW = level_view(np.zeros(3), 0.0, focal=100.0, window=(-32, -16, 64, 32))


def textured(depth):
    ids = np.where(np.isfinite(depth), 0, -1).astype(np.int32)
    return DepthTexture(VIEW, np.zeros((*depth.shape, 3), np.uint8), depth.astype(np.float32), ids)


def slanted():
    """A plane seen at an angle: 1/z is linear across the picture."""
    u, v = np.meshgrid(*VIEW.pixel_centres())
    return 1.0 / (0.02 + 1e-4 * u - 5e-5 * v)


def brute_force(mesh, depth):
    """Whether each triangle is even, texel by texel, by barycentric coordinates."""
    size = np.array(depth.shape[::-1])
    nearness = 1.0 / VIEW.project(mesh.vertices.astype(float))[:, 2]
    even = []
    for triangle in mesh.triangles:
        (a, b, c), w = (mesh.uv[triangle] * size).astype(float), nearness[triangle]
        basis = np.linalg.inv(np.column_stack([b - a, c - a]))
        good = True
        for i, j in np.argwhere(np.isfinite(depth)):
            s, t = basis @ (np.array([j + 0.5, i + 0.5]) - a)
            if s >= -1e-9 and t >= -1e-9 and s + t <= 1 + 1e-9:
                good &= abs((w[0] + s * (w[1] - w[0]) + t * (w[2] - w[0])) * depth[i, j] - 1.0) <= 1e-3
        even.append(good)
    return np.array(even)


def test_a_plane_is_even_everywhere():
    depth = slanted()
    triangles, even = divide_triangles(grid_mesh(textured(depth), quad=8), VIEW, depth.astype(np.float32))
    assert even == len(triangles) > 0


def test_a_step_is_uneven_where_the_mesh_bridges_it_and_only_there():
    depth = slanted()
    depth[:, 36:] *= 1.5
    depth[:4] = np.inf
    texture = textured(depth)
    mesh = grid_mesh(texture, quad=8)
    triangles, even = divide_triangles(mesh, VIEW, texture.depth)
    expected = brute_force(mesh, texture.depth)
    assert even == expected.sum()
    assert 0 < even < len(triangles)
    order = np.concatenate([np.flatnonzero(expected), np.flatnonzero(~expected)])
    assert np.array_equal(triangles, mesh.triangles[order])
    middles = VIEW.project(mesh.vertices.astype(float))[triangles][..., 0].mean(axis=1)
    assert np.abs(middles[even:] - 4.0).max() < 16.0, "within two quads of the step"


def test_triangles_without_area_or_texels_are_even():
    mesh = GridMesh(
        np.array([[10.0, 0.0, 0.0]] * 3, np.float32), np.full((3, 2), 0.5, np.float32), np.array([[0, 1, 2]])
    )
    assert divide_triangles(mesh, VIEW, np.full((32, 64), 20.0, np.float32))[1] == 1


def test_a_loaded_cell_is_what_was_captured(scene, dataset):
    loaded = load_cell(scene, "0001-01", measured=True)
    entry = dataset.cell("0001-01")
    assert loaded.key == CellKey("multi-mesh", "0001-01")
    assert [layer.name for layer in loaded.layers] == [one["name"] for some in entry["layers"] for one in some]
    far = {scene.objects[one] for one in entry["far"]}
    for layer, described in zip(loaded.layers, [one for some in entry["layers"] for one in some], strict=True):
        covered = layer.pixels[..., 3] == 255
        assert np.array_equal(layer.object_ids >= 0, covered)
        assert set(np.unique(layer.object_ids)) - {-1} <= far
        assert np.isfinite(layer.depth[covered]).all()
        assert len(layer.triangles) == described["triangles"]
        beyond = np.isfinite(layer.depth) & ~covered
        padded = np.pad(covered, 1)
        around = np.any(
            [padded[i : i + covered.shape[0], j : j + covered.shape[1]] for i in range(3) for j in range(3)], 0
        )
        assert np.array_equal(beyond, around & ~covered), "depth goes on for one texel"
        assert layer.bytes > 0
    plain = load_cell(scene, "0001-01")
    assert all(layer.object_ids is None for layer in plain.layers)
    assert plain.bytes < loaded.bytes


def test_damaged_files_are_refused(tmp_path, dataset):
    import shutil

    from mmi.dataset import open_dataset
    from viewer.scene import open_scene

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
