"""Rays go through what is clear of cut-outs, in every caster, and at the level of the texture that a pixel shows."""

import numpy as np
import pytest
from soups import random_directions, random_soup, soup_mesh

from mmi.appearance.cut_outs import alpha_levels, clear_at
from mmi.rays.brute_force import brute_force
from mmi.rays.casters import make_caster
from mmi.rays.see_through import LEVEL_BIAS

KINDS = ("brute", "grid", "embree")
WALL = np.array([[[0, 0, 0], [0, 8, 0], [0, 8, 8]], [[0, 0, 0], [0, 8, 8], [0, 0, 8]]], dtype=np.float64)
WALL_UV = np.array([[[0, 1], [1, 1], [1, 0]], [[0, 1], [1, 0], [0, 0]]], dtype=np.float64)


def caster_of(kind, mesh):
    return brute_force(mesh) if kind == "brute" else make_caster(mesh, kind=kind, workers=1)


def picture(alpha):
    """A texture (h, w, 4) with an ``alpha`` (h, w)."""
    alpha = np.asarray(alpha, dtype=np.uint8)
    return np.dstack([np.full((*alpha.shape, 3), 200, np.uint8), alpha])


def half_clear(size=16):
    """Clear on the left, solid on the right."""
    return picture(np.repeat([[0] * (size // 2) + [255] * (size // 2)], size, axis=0))


def walls(*at, solid=()):
    """Walls across the x axis; those ``solid`` show the right half of the texture only."""
    uv = [WALL_UV * (0.25, 1.0) + (0.7, 0.0) if k in solid else WALL_UV for k in range(len(at))]
    return np.concatenate([np.add(WALL, (x, 0.0, 0.0)) for x in at]), np.concatenate(uv)


@pytest.mark.parametrize("kind", KINDS)
def test_a_ray_goes_on_behind_what_is_clear(kind):
    corners, uv = walls(10.0, 20.0, solid=[1])
    caster = caster_of(kind, soup_mesh(corners, uv=uv, texture=half_clear()))
    hits = caster.first_hits([[0.0, 1.0, 3.0], [0.0, 7.0, 3.0]], [[1.0, 0.0, 0.0]] * 2)
    assert hits.distance.tolist() == [20.0, 10.0]
    assert (hits.triangle // 2).tolist() == [1, 0]


@pytest.mark.parametrize("kind", KINDS)
def test_a_ray_goes_through_many_clear_walls(kind):
    """Some of them a millimetre apart, some in one plane, and nothing behind them for one of the rays."""
    rng = np.random.default_rng(3)
    at = np.concatenate([10.0 + 0.001 * np.arange(40), np.repeat(12.0, 5), rng.uniform(11.0, 30.0, 60)])
    corners, uv = walls(*at, 40.0, solid=[len(at)])
    corners[-2:, :, 2] -= 4.0
    caster = caster_of(kind, soup_mesh(corners, uv=uv, texture=half_clear()))
    hits = caster.first_hits([[0.0, 1.0, 3.0], [0.0, 1.0, 6.0]], [[1.0, 0.0, 0.0]] * 2, nearest=5.0)
    assert hits.distance.tolist() == [40.0, np.inf]
    assert hits.triangle[1] == -1


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("solid", [0, 1, 2])
def test_of_coincident_faces_the_first_that_is_not_clear_is_hit(kind, solid):
    corners, uv = walls(10.0, 10.0, 10.0, solid=[solid])
    caster = caster_of(kind, soup_mesh(corners, uv=uv, texture=half_clear()))
    hits = caster.first_hits(np.array([0.0, 1.0, 3.0]), [[1.0, 0.0, 0.0]])
    assert hits.triangle[0] // 2 == solid
    assert hits.distance[0] == 10.0


@pytest.mark.parametrize("kind", KINDS)
def test_the_level_is_that_at_which_a_texel_is_as_large_as_a_pixel(kind):
    """A wall that is looked at squarely, from farther and farther: what is clear is what the level has clear."""
    rng = np.random.default_rng(7)
    texture = picture(np.where(rng.random((64, 64)) < 0.5, 255, 0))
    caster = caster_of(kind, soup_mesh(WALL, uv=WALL_UV, texture=texture))
    levels = alpha_levels(texture)
    angle = 0.002
    seen = set()
    for away in (10.0, 60.0, 130.0, 260.0, 520.0, 1100.0):
        targets = rng.uniform(0.5, 7.5, (300, 2))
        origins = np.column_stack([np.full(300, -away), targets])
        hits = caster.first_hits(origins, np.tile([1.0, 0.0, 0.0], (300, 1)), pixel_angle=angle)
        texels = 8.0 * away * angle  # 64 texels on 8 metres
        level = max(np.log2(texels) + LEVEL_BIAS, 0.0) if texels > 1.0 else 0.0
        uv = np.column_stack([targets[:, 0] / 8.0, 1.0 - targets[:, 1] / 8.0])
        clear = clear_at(levels, uv, np.full(300, level))
        np.testing.assert_array_equal(hits.triangle < 0, clear)
        seen.add(int(level + 0.5))
    assert len(seen) >= 4


@pytest.mark.parametrize("kind", ["grid", "embree"])
@pytest.mark.parametrize("angle", [0.0, 1e-3, 2e-2])
def test_casters_agree_with_brute_force(kind, angle):
    rng = np.random.default_rng(12)
    alpha = np.clip(rng.normal(120, 90, (32, 64)), 0, 255)
    uv = rng.uniform(-0.5, 1.5, (300, 3, 2))
    uv[:40] = 0.25  # all of a triangle shows one texel
    mesh = soup_mesh(random_soup(rng, 300, size=2.0), uv=uv, texture=picture(alpha))
    origins, directions = rng.uniform(-5.0, 15.0, (1500, 3)), random_directions(rng, 1500)
    expected = brute_force(mesh).first_hits(origins, directions, nearest=1.0, pixel_angle=angle)
    found = make_caster(mesh, kind=kind, workers=1).first_hits(origins, directions, nearest=1.0, pixel_angle=angle)
    solid = brute_force(soup_mesh(mesh.positions)).first_hits(origins, directions, nearest=1.0)
    assert (expected.triangle != solid.triangle).sum() > 100
    assert (found.triangle != expected.triangle).sum() <= 2
    same = found.triangle == expected.triangle
    np.testing.assert_allclose(found.distance[same], expected.distance[same], rtol=1e-5)


@pytest.mark.parametrize("kind", ["grid", "embree"])
def test_triangles_without_a_clear_texel_stay_solid_from_afar(kind):
    """Most of the texture is clear, and the wall shows the rest: the coarsest level mixes both."""
    texture = picture(np.repeat([[0] * 20 + [255] * 12], 32, axis=0))
    corners, uv = walls(10.0, solid=[0])
    assert clear_at(alpha_levels(texture), np.array([[0.8, 0.5]]), np.array([9.0])).all()
    hits = make_caster(soup_mesh(corners, uv=uv, texture=texture), kind=kind, workers=1).first_hits(
        np.array([-5000.0, 2.0, 3.0]), [[1.0, 0.0, 0.0]], pixel_angle=0.1
    )
    assert hits.triangle[0] >= 0
