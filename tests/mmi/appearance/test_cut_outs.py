"""Clear texels at each level of a texture, against plain twins."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmi.appearance.cut_outs import (
    alpha_levels,
    clear_at,
    clear_blocks,
    cut_out_triangles,
    dilated,
    is_clear,
    texture_levels,
    with_solid_share,
)


def noise(height, width, channels=4, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, channels), dtype=np.uint8)


def halved(pixels):
    """The twin, by rows and columns that share a place in the half size."""
    height, width = (max(n // 2, 1) for n in pixels.shape[:2])
    row = np.minimum(np.arange(pixels.shape[0]) // 2, height - 1)
    column = np.minimum(np.arange(pixels.shape[1]) // 2, width - 1)
    found = np.empty((height, width, pixels.shape[2]), dtype=np.uint8)
    for i in range(height):
        for j in range(width):
            some = pixels[row == i][:, column == j].reshape(-1, pixels.shape[2]).astype(int)
            found[i, j] = (some.sum(axis=0) + len(some) // 2) // len(some)
    return found


@pytest.mark.parametrize("size", [(16, 16), (13, 7), (1, 9), (5, 1), (1, 1)])
def test_each_level_halves_the_one_before(size):
    texture = noise(*size)
    texture[..., 3] = 255
    levels = texture_levels(texture)
    assert np.array_equal(levels[0], texture) and levels[-1].shape == (1, 1, 4)
    for fine, coarse in pairwise(levels):
        assert np.array_equal(coarse, halved(fine))


@settings(deadline=None)
@given(st.integers(1, 12), st.integers(1, 12), st.sampled_from([3, 4, 64]), st.integers(0, 9999))
def test_a_square_has_as_many_solid_texels_as_it_should(height, width, tile, seed):
    """And they are those of the largest alpha."""
    alpha, share = noise(height, width, 2, seed).transpose(2, 0, 1)
    alpha, share = alpha // (1 + seed % 90), np.minimum(share.astype(int) * (1 + seed % 3), 255).astype(np.uint8)
    found = with_solid_share(alpha, share, tile=tile)
    for y in range(0, height, tile):
        for x in range(0, width, tile):
            before, after, wanted = (one[y : y + tile, x : x + tile].reshape(-1) for one in (alpha, found, share))
            solid = after >= 128
            assert solid.sum() == (int(wanted.sum()) + 127) // 255
            assert before[solid].min(initial=255) >= before[~solid].max(initial=0)


@pytest.mark.parametrize("share", [0.1, 0.3, 0.45, 0.7, 0.9])
def test_foliage_neither_vanishes_nor_fills_from_afar(share):
    rng = np.random.default_rng(4)
    texture = np.full((256, 256, 4), 255, dtype=np.uint8)
    texture[..., 3] = np.where(np.kron(rng.random((128, 128)), np.ones((2, 2))) < share, 255, 0)
    for k, level in enumerate(texture_levels(texture)[:6]):
        assert abs((level[..., 3] >= 128).mean() - share) < 0.035, k


def test_a_fence_whose_bars_are_finer_than_texels_stays_as_dense():
    texture = np.full((256, 256, 4), 255, dtype=np.uint8)
    texture[..., 3] = np.where(np.arange(256) % 4 == 0, 255, 0)
    for level in texture_levels(texture)[:6]:
        assert (level[..., 3] >= 128).mean() == pytest.approx(0.25, abs=0.01)


def test_what_is_all_solid_or_all_clear_stays_so():
    texture = noise(96, 64)
    texture[:48, :, 3], texture[48:, :, 3] = 200, 90
    for k, level in enumerate(texture_levels(texture)[:5]):
        middle = 48 >> k
        assert (level[:middle, :, 3] >= 128).all() and (level[middle:, :, 3] < 128).all()


@settings(deadline=None)
@given(
    st.integers(1, 40),
    st.integers(1, 40),
    st.lists(st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(-2, 9)), min_size=1, max_size=30),
)
def test_the_texel_that_holds_a_coordinate_says_whether_it_is_clear(height, width, places):
    texture = noise(height, width, seed=height)
    levels, pictures = alpha_levels(texture), texture_levels(texture)
    uv, level = np.array(places)[:, :2], np.array(places)[:, 2]
    found = clear_at(levels, uv, level)
    for (u, v), k, clear in zip(uv, level, found, strict=True):
        assert is_clear(levels.texels, levels.sizes, levels.starts, u, v, k) == clear
        picture = pictures[min(max(int(np.floor(k + 0.5)), 0), len(pictures) - 1)][..., 3]
        rows, columns = picture.shape
        assert (picture[int(np.floor(v * rows)) % rows, int(np.floor(u * columns)) % columns] < 128) == clear


def test_clear_texels_take_the_nearest_solid_colour():
    image = noise(20, 30, seed=5)
    rows, columns = np.nonzero(image[..., 3] >= 128)
    found = dilated(image)
    assert np.array_equal(found[rows, columns], image[rows, columns])
    assert np.array_equal(found[..., 3], image[..., 3])
    for y in range(20):
        for x in range(30):
            far = (rows - y) ** 2 + (columns - x) ** 2
            nearest = image[rows, columns, :3][far == far.min()]
            assert (found[y, x, :3] == nearest).all(axis=1).any()
    none = np.zeros((4, 4, 4), dtype=np.uint8)
    assert np.array_equal(dilated(none), none)


def test_triangles_that_see_clear_texels_are_found():
    texture = np.full((64, 64, 4), 255, dtype=np.uint8)
    texture[40, 20, 3] = 0
    spans = [
        (0.0, 0.0, 0.2, 0.5),
        (0.3, 0.6, 0.33, 0.64),
        (0.0, 0.0, 1.0, 1.0),
        (-0.5, 0.6, 2.5, 0.65),
        (0.5, 0.6, 1, 1),
    ]
    uv = np.array([((a, b), (c, b), (c, d)) for a, b, c, d in spans], dtype=np.float32).reshape(-1, 2)
    triangles = np.arange(len(uv), dtype=np.int32).reshape(-1, 3)
    assert cut_out_triangles(clear_blocks(texture), uv, triangles).tolist() == [False, True, True, True, False]
    assert not cut_out_triangles(clear_blocks(texture[..., :3]), uv, triangles).any()
