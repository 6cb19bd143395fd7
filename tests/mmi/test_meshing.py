import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rasters import bilinear, draw, psnr
from scipy.ndimage import binary_fill_holes

from mmi.camera import level_view
from mmi.impostor import DepthTexture
from mmi.meshing import covered_windows, grid_mesh


def texture_of(inverse, *, covered=None, focal=400.0, left=-64, top=-32, color=None):
    """A depth texture with these 1/z (h, w), seen from (3, -4, 1.7)."""
    height, width = inverse.shape
    covered = np.ones(inverse.shape, dtype=bool) if covered is None else covered
    view = level_view(np.array([3.0, -4.0, 1.7]), 0.4, focal=focal, window=(left, top, width, height))
    color = np.zeros((height, width, 3), dtype=np.uint8) if color is None else color
    depth = np.where(covered, 1.0 / inverse, np.inf).astype(np.float32)
    return DepthTexture(view, color, depth, np.where(covered, 5, -1).astype(np.int32))


def plane(height, width, a, b, c):
    """1/z = a + b x + c y at texel centres."""
    y, x = np.mgrid[:height, :width] + 0.5
    return a + b * x + c * y


@settings(max_examples=40, deadline=None)
@given(st.floats(0.005, 0.02), st.floats(-2e-5, 2e-5), st.floats(-2e-5, 2e-5))
def test_a_plane_is_reproduced_exactly(a, b, c):
    texture = texture_of(plane(64, 128, a, b, c))
    mesh = grid_mesh(texture)
    u, v, depth = texture.view.project(mesh.vertices.astype(float)).T
    np.testing.assert_allclose(1.0 / depth, a + b * (u + 64) + c * (v + 32), rtol=2e-5)


def test_vertices_sit_on_the_rays_of_their_texture_coordinates():
    rng = np.random.default_rng(0)
    texture = texture_of(plane(64, 128, 0.01, 3e-5, 0.0) * rng.uniform(0.99, 1.01, (64, 128)))
    mesh = grid_mesh(texture)
    u, v, _ = texture.view.project(mesh.vertices.astype(float)).T
    np.testing.assert_allclose((u + 64) / 128, mesh.uv[:, 0], atol=1e-4)
    np.testing.assert_allclose((v + 32) / 64, mesh.uv[:, 1], atol=1e-4)


def test_triangles_face_the_capture():
    mesh = grid_mesh(texture_of(plane(32, 32, 0.01, 1e-5, 0.0)))
    uv = mesh.uv[mesh.triangles] * [1.0, -1.0]
    area = np.cross(
        np.append(uv[:, 1] - uv[:, 0], np.zeros((len(uv), 1)), 1),
        np.append(uv[:, 2] - uv[:, 0], np.zeros((len(uv), 1)), 1),
    )[:, 2]
    assert np.all(area > 0)


def test_quads_without_coverage_go_and_the_rest_stays():
    covered = np.zeros((64, 128), dtype=bool)
    covered[20:30, 40:60] = True
    mesh = grid_mesh(texture_of(plane(64, 128, 0.01, 0.0, 0.0), covered=covered))
    assert len(mesh.triangles) == 2 * 2  # columns 32 to 64, rows 16 to 32
    covered[31, 63] = True  # at a corner: filtering reaches into three more quads
    mesh = grid_mesh(texture_of(plane(64, 128, 0.01, 0.0, 0.0), covered=covered))
    assert len(mesh.triangles) == 2 * 5


def test_covered_windows_are_whole_quads_around_what_is_covered():
    covered = np.zeros((64, 512), dtype=bool)

    def windows():
        return covered_windows(texture_of(plane(64, 512, 0.01, 0, 0), covered=covered), quad=16)

    assert windows() == []
    covered[20:30, 40:60] = True
    assert windows() == [(-32, -16, 32, 16)]
    covered[2:60, 100:110] = True  # near enough to be in one picture with it
    assert windows() == [(-32, -32, 80, 64)]
    covered[40:50, 450:460] = True  # too far
    assert windows() == [(-32, -32, 80, 64), (384, 0, 16, 32)]


def test_silhouettes_do_not_pull_the_fit():
    """Texels of a wall that ends in mid-quad give the plane of the wall, not one bent towards nothing."""
    covered = np.zeros((64, 128), dtype=bool)
    covered[:, :76] = True
    truth = plane(64, 128, 0.01, 4e-5, 0.0)
    texture = texture_of(truth, covered=covered)
    mesh = grid_mesh(texture)
    u, _, depth = texture.view.project(mesh.vertices.astype(float)).T
    np.testing.assert_allclose(1.0 / depth, 0.01 + 4e-5 * (u + 64), rtol=1e-4)


@pytest.mark.parametrize("slope", [0.0, 2e-5, 9e-5])
def test_interpolated_texture_coordinates_are_within_a_tenth_of_a_texel(slope):
    texture = texture_of(plane(64, 256, 0.004, slope, 0.0), left=-128)
    mesh = grid_mesh(texture)
    projected = texture.view.project(mesh.vertices.astype(float))
    _, uv = draw(projected, mesh.uv.astype(float), mesh.triangles, -128, -32, 256, 64)
    y, x = np.mgrid[:64, :256] + 0.5
    assert np.nanmax(np.abs(uv[..., 0] * 256 - x)) < 0.1
    assert np.nanmax(np.abs(uv[..., 1] * 64 - y)) < 0.1
    assert not np.isnan(uv).any()


def test_seen_from_the_capture_the_mesh_shows_the_captured_picture():
    rng = np.random.default_rng(2)
    y, x = np.mgrid[:64, :256]
    color = (np.stack([x // 6 % 2, y // 5 % 2, (x + y) // 9 % 2], axis=-1) * 160 + 40).astype(np.uint8)
    steps = np.where(x < 100, 0.004, 0.012) + 6e-5 * (x % 100)
    texture = texture_of(steps * rng.uniform(0.995, 1.005, steps.shape), left=-128, color=color)
    mesh = grid_mesh(texture)
    projected = texture.view.project(mesh.vertices.astype(float))
    _, uv = draw(projected, mesh.uv.astype(float), mesh.triangles, -128, -32, 256, 64)
    assert psnr(bilinear(color, uv), color) > 40.0


def test_no_cracks_between_quads_of_different_fineness():
    """From beside the capture every pixel inside the mesh's outline is covered, however finely its quads are split."""
    inverse = plane(96, 192, 0.004, 0.0, 0.0)
    inverse[:, 96:] += 1.5e-4 * np.arange(96)
    texture = texture_of(inverse, left=-96, top=-48)
    mesh = grid_mesh(texture)
    lone = level_view(np.array([4.5, -3.0, 2.2]), 0.35, focal=400.0, window=(-300, -200, 600, 400))
    projected = lone.project(mesh.vertices.astype(float))
    depth, _ = draw(projected, mesh.uv.astype(float), mesh.triangles, -300, -200, 600, 400)
    hit = np.isfinite(depth)
    assert hit.sum() > 10_000
    assert (binary_fill_holes(hit) == hit).all()


def test_a_window_that_is_not_whole_quads_is_refused():
    with pytest.raises(ValueError, match="whole quads"):
        grid_mesh(texture_of(plane(60, 128, 0.01, 0.0, 0.0)))


def _slow_fit(depth, quad):
    """The twin of the kernel: numpy's least squares on the texels of the four quads around each vertex."""
    rows, columns = depth.shape[0] // quad, depth.shape[1] // quad
    inverse = np.full((rows + 1, columns + 1), np.nan)
    for i in range(rows + 1):
        for j in range(columns + 1):
            y, x = np.mgrid[
                max(i - 1, 0) * quad : min(i + 1, rows) * quad, max(j - 1, 0) * quad : min(j + 1, columns) * quad
            ]
            z = depth[y, x].astype(float)
            seen = np.isfinite(z)
            if not seen.any():
                continue
            w = 1.0 / z[seen]
            dx, dy = (x[seen] + 0.5) / quad - j, (y[seen] + 0.5) / quad - i
            fit = np.linalg.lstsq(np.column_stack([np.ones(len(w)), dx, dy]), w, rcond=None)[0][0]
            spread = w.max() - w.min()
            inverse[i, j] = min(max(fit, w.min() - spread, 0.5 * w.min()), w.max() + spread)
    return inverse


def test_the_fit_agrees_with_its_plain_twin():
    from mmi.meshing import _fit

    rng = np.random.default_rng(3)
    inverse = plane(48, 64, 0.01, 3e-5, 1e-5) * rng.uniform(0.9, 1.1, (48, 64))
    covered = rng.uniform(size=(48, 64)) < 0.7
    covered[:16, :16] = False
    texture = texture_of(inverse, covered=covered)
    np.testing.assert_allclose(_fit(texture.depth, 16), _slow_fit(texture.depth, 16), rtol=1e-9)
    assert math.isfinite(_fit(texture.depth, 16)[0, 0]) is False
