"""Surfaces that repeat a picture often show a coarser version of it, which looks the same and need not be cut."""

from dataclasses import replace

import numpy as np
import pytest
from cities import block, city_of

from mmi.appearance.city_mesh import build_city_mesh
from mmi.appearance.coarser_pictures import with_coarser_pictures
from mmi.building.city_costs import triangles_as_read
from mmi.city.model import PLAIN, City, Texture, TriangleMesh

HALVES = np.zeros((64, 64, 3), dtype=np.uint8)
HALVES[:, :32] = (200, 40, 20)
HALVES[:, 32:] = (20, 60, 220)


def walls(count, *, metres, repeats, texture=0):
    """A mesh of ``count`` square walls of so many ``metres``, two triangles each, with the picture so many times each way."""
    square = np.array([[0.0, 0.0, 0.0], [metres, 0.0, 0.0], [metres, 0.0, metres], [0.0, 0.0, metres]])
    vertices = np.concatenate([square + np.array([0.0, float(k), 0.0]) for k in range(count)])
    triangles = np.concatenate([np.array([[0, 1, 2], [0, 2, 3]]) + 4 * k for k in range(count)])
    uv = np.array([[0.0, 0.0], [repeats, 0.0], [repeats, repeats], [0.0, repeats]])
    both = np.tile(np.stack([uv[[0, 1, 2]], uv[[0, 2, 3]]]), (count, 1, 1))
    return TriangleMesh(vertices, triangles.astype(np.int32), np.full(2 * count, texture), uv=both)


def town(mesh, *pictures):
    plain = city_of(block("a", 0.0, 0.0, 10.0, 10.0, 9.0))
    (one,) = plain.objects
    return replace(plain, objects=(replace(one, mesh=mesh),), textures=tuple(pictures))


def shown(city: City):
    (one,), pictures = with_coarser_pictures(city.objects, city.textures)
    return one.mesh, pictures


def test_walls_that_repeat_a_picture_often_are_not_cut():
    city = town(walls(400, metres=10.0, repeats=40.0), Texture("halves", HALVES))
    mesh, pictures = shown(city)
    assert [one.name for one in pictures] == ["halves", "halves, coarser 2"], "64 copies of 16 texels hold 40 repeats"
    assert (mesh.textures == 1).all()
    assert (pictures[1].image.shape, 10.0 / 40.0 / 16.0) == ((16, 16, 3), pytest.approx(0.0156, abs=1e-3))
    assert len(build_city_mesh(city).triangles) == triangles_as_read(city, 0, city) == 800
    np.testing.assert_array_equal(mesh.uv, city.objects[0].mesh.uv)


def test_a_coarser_version_shows_the_same():
    """Of each texel of the coarser picture, the mean of what it stands for."""
    picture = np.random.default_rng(3).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    _, pictures = shown(town(walls(400, metres=10.0, repeats=40.0), Texture("noise", picture)))
    means = picture.reshape(16, 4, 16, 4, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(pictures[1].image, means, atol=1.0)


def test_colours_on_the_surface_are_those_of_the_picture():
    """Looked up through the atlas at the corners' middle: left halves of repetitions are red, right ones blue."""
    mesh = walls(400, metres=10.0, repeats=40.0)
    mesh = TriangleMesh(mesh.vertices, mesh.triangles, mesh.textures, uv=mesh.uv + np.float32(0.25))
    built = build_city_mesh(town(mesh, Texture("halves", HALVES)))
    height, width = built.texture.shape[:2]
    weights = np.random.default_rng(5).dirichlet([1.0, 1.0, 1.0], 200)
    uv = built.uv[built.triangles[0]].astype(np.float64)
    own = mesh.uv[0].astype(np.float64)
    checked = 0
    for weight in weights:
        u = (weight @ own)[0] % 1.0
        if min(abs(u - edge) for edge in (0.0, 0.5, 1.0)) < 0.1:
            continue
        x, y = (weight @ uv) * [width, height]
        found = built.texture[int(y), int(x)]
        assert (found[0] > found[2]) == (u < 0.5)
        checked += 1
    assert checked > 50


@pytest.mark.parametrize(
    ("count", "metres", "repeats", "why"),
    [
        (3, 10.0, 40.0, "three walls are not worth a picture"),
        (400, 10.0, 16.0, "sixteen copies are there as it is"),
        (400, 400.0, 40.0, "its texels are 16 cm already"),
    ],
)
def test_no_version_is_made_without_need(count, metres, repeats, why):
    mesh, pictures = shown(town(walls(count, metres=metres, repeats=repeats), Texture("halves", HALVES)))
    assert len(pictures) == 1, why
    assert (mesh.textures == 0).all()


def test_texels_stay_fine():
    """A hundred metres with a picture of 25 cm would fit uncut at a texel a picture; it stays at 4 cm, and is cut."""
    mesh, pictures = shown(town(walls(100, metres=100.0, repeats=400.0), Texture("halves", HALVES)))
    for picture in np.unique(mesh.textures):
        assert 0.25 / pictures[picture].image.shape[1] <= 0.04
    assert pictures[1].image.shape[1] == 8


def test_what_shows_no_picture_is_left_alone():
    mesh = walls(10, metres=10.0, repeats=99.0, texture=PLAIN)
    kept, pictures = shown(town(mesh, Texture("halves", HALVES)))
    assert (kept.textures == PLAIN).all()
    assert len(pictures) == 1


def test_cut_outs_stay_cut_outs():
    clear = np.dstack([HALVES, np.where(HALVES[..., 0] > 100, 255, 0).astype(np.uint8)])
    _, pictures = shown(town(walls(400, metres=10.0, repeats=40.0), Texture("railing", clear)))
    assert [one.is_cut_out for one in pictures] == [True, True]
    assert abs(float((pictures[1].image[..., 3] >= 128).mean()) - 0.5) < 0.05
