"""Pictures in the atlas, texel by texel, and triangles cut where their pictures repeat, against plain wrapping."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmi.appearance.facades import facade_texture
from mmi.appearance.texture_atlas import Atlas, cut_at_repeats, pack_atlas
from mmi.city.model import Texture

ONCE = np.ones((1, 2))


def picture(height, width, seed=0):
    """Noise: no part of it looks like another, nor like itself mirrored."""
    return Texture(
        f"{height}x{width}", np.random.default_rng(seed).integers(0, 250, (height, width, 3)).astype(np.uint8)
    )


def texel_at(atlas: Atlas, placed):
    """(..., 3) the atlas's texels at ``placed`` (..., 2: u, v down)."""
    height, width = atlas.texture.shape[:2]
    column, row = (np.floor(placed[..., k] * size).astype(int) for k, size in enumerate((width, height)))
    assert ((column >= 0) & (column < width) & (row >= 0) & (row < height)).all()
    return atlas.texture[row, column]


def texel_of(image, uv):
    """(..., 3) texels of a picture at ``uv`` (..., 2: v up) that repeats in both directions."""
    height, width = image.shape[:2]
    column = np.floor((uv[..., 0] % 1.0) * width).astype(int) % width
    row = np.floor(((1.0 - uv[..., 1]) % 1.0) * height).astype(int) % height
    return image[row, column]


def centres(image):
    """(h, w, 2) uv of a picture's texels, v up."""
    height, width = image.shape[:2]
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, 1.0 - (np.arange(height) + 0.5) / height)
    return np.stack([u, v], axis=-1)


@pytest.mark.parametrize("painted", [False, True])
def test_pictures_come_back_texel_by_texel(painted):
    sizes = [(1, 1), (1, 7), (40, 3), (64, 64), (17, 200), (300, 21), (5, 5)]
    pictures = [picture(*size, seed) for seed, size in enumerate(sizes)]
    atlas = pack_atlas(pictures, np.ones((7, 2)), painted=painted)
    assert (atlas.copies == 1).all()
    for i, one in enumerate(pictures):
        uv = centres(one.image)
        placed = atlas.place(np.full(uv.shape[:2], i), uv)
        assert np.array_equal(texel_at(atlas, placed), one.image)


def test_the_corners_of_a_picture_are_where_they_belong():
    image = np.zeros((8, 16, 3), dtype=np.uint8)
    image[0, 0], image[0, -1], image[-1, 0], image[-1, -1] = (1, 0, 0), (2, 0, 0), (3, 0, 0), (4, 0, 0)
    atlas = pack_atlas([Texture("corners", image)], ONCE, painted=False)
    near = np.array([[0.01, 0.99], [0.99, 0.99], [0.01, 0.01], [0.99, 0.01]])
    assert texel_at(atlas, atlas.place(np.zeros(4, dtype=int), near))[:, 0].tolist() == [1, 2, 3, 4]
    (x, y, width, height), (rows, columns, _) = atlas.boxes[0], atlas.texture.shape
    ends = atlas.place(np.zeros(2, dtype=int), np.array([[0.0, 1.0], [1.0, 0.0]]))
    assert ends * (columns, rows) == pytest.approx(np.array([[x, y], [x + width, y + height]]))


def test_copies_stand_side_by_side_and_repeat_as_the_picture_does():
    one, other = picture(8, 16, 1), picture(32, 4, 2)
    atlas = pack_atlas([one, other], np.array([[2.2, 5.0], [1.0, 3.0]]), painted=False)
    assert atlas.copies.tolist() == [[3, 5], [1, 3]]
    rng = np.random.default_rng(4)
    for i, image in enumerate((one.image, other.image)):
        uv = rng.random((500, 2)) * atlas.copies[i]
        assert np.array_equal(texel_at(atlas, atlas.place(np.full(500, i), uv)), texel_of(image, uv))


def test_around_a_picture_its_edges_go_on_so_that_nothing_bleeds():
    pictures = [Texture(str(i), np.full((10 + i, 12, 3), 20 * i, dtype=np.uint8)) for i in range(9)]
    atlas = pack_atlas(pictures, np.ones((9, 2)), painted=True)
    for i, (x, y, width, height) in enumerate(atlas.boxes.astype(int).tolist()):
        assert (atlas.texture[y - 8 : y + height + 8, x - 8 : x + width + 8] == 20 * i).all()
    column, row = (np.array(atlas.white) * atlas.texture.shape[1::-1]).astype(int)
    assert (atlas.texture[row - 7 : row + 7, column - 7 : column + 7] == 255).all()


@pytest.mark.parametrize("wide", [10, 600, 2000])
def test_facades_still_wrap_sideways(wide):
    """At any u, however far out, a facade looks as it does in a texture of its own."""
    atlas = pack_atlas([picture(30, wide)], ONCE, painted=True)
    facade = facade_texture()
    rng = np.random.default_rng(2)
    uv = np.column_stack([rng.uniform(-40.0, 40.0, 2000), rng.random(2000)])
    there = uv * atlas.facade_scale
    shown = texel_at(atlas, np.column_stack([there[:, 0] % 1.0, there[:, 1]]))
    plain = texel_of(facade, np.column_stack([uv[:, 0], 1.0 - uv[:, 1]]))
    assert np.array_equal(shown, plain)


def test_too_many_or_too_large_pictures_are_reduced():
    flat = [Texture(str(i), np.full((3000, 3000, 3), 25 * i, dtype=np.uint8)) for i in range(9)]
    long = Texture(
        "long",
        np.repeat(np.arange(9000, dtype=np.uint32)[:, None] // 40, 8, axis=1)[..., None].repeat(3, 2).astype(np.uint8),
    )
    atlas = pack_atlas([*flat, long], np.full((10, 2), 3.0), painted=True)
    assert max(atlas.texture.shape) <= 8192
    assert (atlas.boxes[:, :2] >= 8).all()
    ends = atlas.boxes[:, :2] + atlas.boxes[:, 2:]
    assert (ends <= np.array(atlas.texture.shape[1::-1])).all()
    for i in range(9):
        uv = np.random.default_rng(i).random((50, 2))
        assert (texel_at(atlas, atlas.place(np.full(50, i), uv)) == 25 * i).all()
    v = np.linspace(0.05, 0.95, 19)
    shown = texel_at(atlas, atlas.place(np.full(19, 9), np.column_stack([np.full(19, 0.5), v])))[:, 0]
    assert shown == pytest.approx((1.0 - v) * 225.0, abs=2.0)


def test_boxes_do_not_overlap():
    rng = np.random.default_rng(6)
    pictures = [Texture(str(i), np.zeros((*rng.integers(1, 90, 2), 3), dtype=np.uint8)) for i in range(60)]
    atlas = pack_atlas(pictures, rng.uniform(1.0, 4.0, (60, 2)), painted=False)
    taken = np.zeros(atlas.texture.shape[:2], dtype=int)
    for x, y, width, height in atlas.boxes.astype(int).tolist():
        taken[y - 8 : y + height + 8, x - 8 : x + width + 8] += 1
    assert taken.max() == 1
    assert taken[:16].max() == 0  # the white patch


def test_nothing_to_pack_is_white():
    atlas = pack_atlas([], np.empty((0, 2)), painted=False)
    assert (atlas.texture == 255).all()
    assert atlas.texture.size > 0
    assert texel_at(atlas, np.array([atlas.white])).tolist() == [[255, 255, 255]]


# Cutting


@st.composite
def triangles(draw):
    """Corners (m, 3, 3), uv (m, 3, 2) far outside of [0, 1] and periods (m, 2)."""
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    m = draw(st.integers(1, 8))
    size = draw(st.sampled_from([0.3, 1.0, 4.0, 12.0]))
    uv = rng.uniform(-30.0, 30.0, (m, 1, 2)) + rng.uniform(-size, size, (m, 3, 2))
    if draw(st.booleans()):  # corners on borders, as models have them
        uv = np.round(uv * 2.0) / 2.0
    corners = rng.uniform(-20.0, 20.0, (m, 3, 3))
    return corners, uv, rng.integers(1, 4, (m, 2)).astype(float)


def areas(corners):
    edges = corners[:, 1:] - corners[:, :1]
    return 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)


def barycentric(corners, points):
    """(k, 3) of ``points`` (k, 3) in the planes of triangles (k, 3, 3)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    normal = np.cross(b - a, c - a)
    square = (normal**2).sum(axis=1)
    s = (np.cross(b - points, c - points) * normal).sum(axis=1) / square
    t = (np.cross(c - points, a - points) * normal).sum(axis=1) / square
    return np.column_stack([s, t, 1.0 - s - t])


@settings(max_examples=80, deadline=None)
@given(triangles())
def test_pieces_fill_their_triangle_and_fit(example):
    corners, uv, period = example
    pieces, placed, source = cut_at_repeats(corners, uv, period)
    assert sorted(set(source.tolist())) == list(range(len(corners)))  # none is lost
    assert (np.diff(source) >= 0).all()
    assert np.bincount(source, areas(pieces)) == pytest.approx(areas(corners), rel=1e-9)
    assert (placed >= 0.0).all()
    assert (placed <= period[source][:, None]).all()
    a, b, c = np.moveaxis(corners, 1, 0)
    normal = np.cross(b - a, c - a)
    turned = np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0])
    assert ((turned * normal[source]).sum(axis=1) > -1e-9).all()  # as seen from the same side
    away = ((pieces - a[source][:, None]) * normal[source][:, None]).sum(axis=2)
    assert np.abs(away / np.linalg.norm(normal, axis=1)[source][:, None]).max() < 1e-9
    inside = barycentric(np.repeat(corners[source], 3, axis=0), pieces.reshape(-1, 3))
    assert inside.min() > -1e-9


@settings(max_examples=80, deadline=None)
@given(triangles(), st.integers(0, 99))
def test_a_point_shows_what_its_picture_shows_there_by_wrapping(example, seed):
    corners, uv, period = example
    image = picture(16, 8, seed).image
    atlas = pack_atlas([Texture("a", image)], period.max(axis=0)[None], painted=False)
    copies = np.broadcast_to(atlas.copies[0].astype(float), period.shape)
    pieces, placed, source = cut_at_repeats(corners, uv, copies)
    weights = np.random.default_rng(seed).dirichlet(np.ones(3), len(pieces))
    points = np.einsum("kc,kcx->kx", weights, pieces)
    shown = np.einsum("kc,kcx->kx", weights, atlas.place(np.zeros((len(pieces), 3), dtype=int), placed))
    squeezed = np.minimum(1.0, 64.0 * copies / np.maximum(np.ptp(uv, axis=1), 1e-9))
    there = np.einsum("kc,kcx->kx", barycentric(corners[source], points), (uv * squeezed[:, None])[source])
    # Not where rounding decides between two texels.
    between = np.abs(there * (8, 16) - np.round(there * (8, 16))).min(axis=1) < 1e-2
    assert np.array_equal(texel_at(atlas, shown)[~between], texel_of(image, there)[~between])


def test_what_fits_is_not_cut():
    corners = np.random.default_rng(1).random((3, 3, 3))
    uv = np.array(
        [[[0, 0], [1, 0], [0, 1]], [[-3, 7], [-2, 7], [-3, 8]], [[0.5, 0.5], [1.5, 0.5], [1, 2.5]]], dtype=float
    )
    period = np.array([[1, 1], [1, 1], [2, 3]], dtype=float)
    pieces, placed, source = cut_at_repeats(corners, uv, period)
    assert source.tolist() == [0, 1, 2]
    assert np.array_equal(pieces, corners)
    assert placed.tolist() == [[[0, 0], [1, 0], [0, 1]], [[0, 0], [1, 0], [0, 1]], [[0.5, 0.5], [1.5, 0.5], [1, 2.5]]]


def test_a_wall_of_ten_bricks_by_four_is_cut_into_forty():
    corners = np.array([[[0, 0, 0], [10, 0, 0], [10, 0, 4]], [[0, 0, 0], [10, 0, 4], [0, 0, 4]]], dtype=float)
    pieces, placed, _ = cut_at_repeats(corners, corners[:, :, [0, 2]], np.ones((2, 2)))
    bricks = np.floor(pieces.mean(axis=1)[:, [0, 2]])
    assert len(np.unique(bricks, axis=0)) == 40
    assert placed == pytest.approx(pieces[:, :, [0, 2]] - bricks[:, None])
    assert areas(pieces).sum() == pytest.approx(40.0)


def test_a_picture_that_nobody_can_see_is_not_cut_into_a_million():
    corners = np.array([[[0, 0, 0], [10, 0, 0], [0, 10, 0]]], dtype=float)
    pieces, _, _ = cut_at_repeats(corners, 1e6 * corners[:, :, :2], np.ones((1, 2)))
    assert len(pieces) < 30_000  # 2080 squares; cut from one side after the other they would be 91,000
    assert areas(pieces).sum() == pytest.approx(50.0)


def test_cutting_nothing():
    pieces, placed, source = cut_at_repeats(np.empty((0, 3, 3)), np.empty((0, 3, 2)), np.empty((0, 2)))
    assert (pieces.shape, placed.shape, source.shape) == ((0, 3, 3), (0, 3, 2), (0,))
    assert math.prod(pieces.shape) == 0
