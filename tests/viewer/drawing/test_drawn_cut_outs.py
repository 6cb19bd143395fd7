"""Clear texels are not drawn, by the viewer and by captures: what is behind them shows, in colour, depth and object."""

from dataclasses import replace

import numpy as np
import pytest
from cities import city_of
from cut_out_cities import LEAF, leaves, modelled, quad, street_of_trees
from shapely.geometry import box

from mmi.appearance.city_mesh import build_city_mesh
from mmi.appearance.ground_mesh import ground_mesh
from mmi.capture.renderer import Capturer
from mmi.city.model import PLAIN, CityObject, Prism, Texture
from mmi.foundation.camera import view_towards
from viewer.drawing.renderer import Renderer
from viewer.plan import ImageKey, Objects, Plan, Relief, ReliefPart, Request, Sky, Slot

SIZE = (320, 240)
WINDOW = (-160, -120, *SIZE)
RED, BLUE = (220, 30, 30), (20, 60, 200)
EAST = view_towards(np.array([0.0, 0.0, 5.0]), 0.0, 0.0, focal=277.0, window=WINDOW)
"""Along x, with y to the left."""


def half_clear(under=(0, 0, 0)):
    """The left half clear, in the colour that painting programs leave there; the right one red."""
    image = np.zeros((64, 64, 4), dtype=np.uint8)
    image[:, :32, :3] = under
    image[:, 32:] = (*RED, 255)
    return Texture("half", image)


def opaque(texture, color):
    """A texture of the same size without alpha, in one colour."""
    return Texture(texture.name, np.full((*texture.image.shape[:2], 3), color, dtype=np.uint8))


def wall(name="wall", x=60.0):
    """A blue wall across the view."""
    one = modelled(name, [quad((x, 100.0, -50.0), (0.0, -200.0), 120.0, PLAIN)])
    return replace(one, mesh=replace(one.mesh, colors=np.tile(BLUE, (2, 1)).astype(np.uint8)))


def sheet(x=20.0, size=8.0):
    """A quad across the view, with texture 0: its left is the viewer's."""
    return modelled("sheet", [quad((x, 0.5 * size, 5.0 - 0.5 * size), (0.0, -size), size, 0)])


def mesh_of_city(objects, *textures):
    empty = city_of(wall())
    return build_city_mesh(replace(empty, objects=tuple(objects), textures=textures))


def shown_by_viewer(mesh, view, *, samples=0, measured=True):
    ground = ground_mesh(city_of(CityObject("far", (Prism(box(-5, -5, 5, 5), -900.0, -890.0),))), margin=10.0)
    with Renderer(mesh, ground, size=SIZE, measured=True, samples=samples) as renderer:
        return renderer.draw(
            Plan((Objects("all", np.arange(len(mesh.triangle_counts))), Sky())), view, measured=measured
        )


def shown_by_capturer(mesh, view, *, supersample=1):
    with Capturer(mesh) as capturer:
        every = np.arange(len(mesh.triangle_counts))
        (texture,) = capturer.depth_textures(every, [view], supersample=supersample)
        assert np.array_equal(capturer.identify(every, view), texture.object_ids)
        return texture


SHOWN = pytest.mark.parametrize("shown", [shown_by_viewer, shown_by_capturer])


@SHOWN
def test_the_clear_half_shows_what_is_behind_it(shown):
    picture = half_clear()
    before, behind, both = (
        shown(mesh_of_city(objects, texture), EAST)
        for objects, texture in (
            ([sheet(), wall()], opaque(picture, RED)),
            ([wall()], picture),
            ([sheet(), wall()], picture),
        )
    )
    covered = before.object_ids == 0
    assert covered.sum() == pytest.approx((8.0 * 277.0 / 20.0) ** 2, rel=0.03)
    left = np.arange(SIZE[0]) < SIZE[0] // 2
    solid = covered & ~left
    assert np.array_equal(both.object_ids, np.where(solid, 0, 1))
    assert np.allclose(both.depth, np.where(solid, before.depth, behind.depth), rtol=1e-4)
    there = np.where(solid[..., None], before.color, behind.color).astype(int)
    assert abs(both.color - there).max() <= 2, "no pixel is of the colour of clear texels"


@pytest.mark.parametrize("under", [(0, 0, 0), (255, 255, 255)])
def test_with_many_samples_borders_are_mixtures_of_both_sides(under):
    picture = half_clear(under)
    before, behind, both = (
        shown_by_viewer(mesh_of_city(objects, texture), EAST, samples=4, measured=False).color.astype(int)
        for objects, texture in (
            ([sheet(), wall()], opaque(picture, RED)),
            ([wall()], picture),
            ([sheet(), wall()], picture),
        )
    )
    assert (both >= np.minimum(before, behind) - 2).all() and (both <= np.maximum(before, behind) + 2).all()


def test_a_supersampled_capture_has_no_fringe_either():
    picture = half_clear()
    found = shown_by_capturer(mesh_of_city([sheet(), wall()], picture), EAST, supersample=3)
    plain = shown_by_capturer(mesh_of_city([sheet(), wall()], opaque(picture, RED)), EAST, supersample=3)
    red = plain.color[plain.object_ids == 0][0]
    assert abs(found.color[found.object_ids == 0].astype(int) - red).max() <= 2


@SHOWN
@pytest.mark.parametrize("distance", [15.0, 60.0, 200.0])
def test_foliage_covers_as_much_from_afar(shown, distance):
    """The share of a picture of leaves that is solid, against the share of its square that shows it."""
    rng = np.random.default_rng(2)
    image = np.zeros((128, 128, 4), dtype=np.uint8)
    image[np.kron(rng.random((32, 32)), np.ones((4, 4))) < 0.35] = (*LEAF, 255)
    share = (image[..., 3] > 0).mean()
    views = [view_towards(np.array([20.0 - distance, 0.0, z]), 0.0, 0.0, focal=277.0, window=WINDOW) for z in (5, 5.2)]
    mesh = mesh_of_city([sheet(size=8.0), wall(x=90.0)], Texture("leaves", image))
    whole = mesh_of_city([sheet(size=8.0), wall(x=90.0)], opaque(leaves(), LEAF))
    solid, square = (sum((shown(one, view).object_ids == 0).sum() for view in views) for one in (mesh, whole))
    assert solid / square == pytest.approx(share, abs=0.1)


@SHOWN
def test_what_lies_beside_a_cut_out_in_the_atlas_has_no_holes_from_afar(shown):
    """A wall with a small picture of its own, among pictures that are clear."""
    clear = np.zeros((64, 64, 4), dtype=np.uint8)
    clear[0, 0] = 255
    bricks = Texture("bricks", np.full((8, 8, 3), 120, dtype=np.uint8))
    house = modelled("house", [quad((900.0, 60.0, 0.0), (0.0, -120.0), 60.0, 1)])
    mesh = mesh_of_city([house, sheet(x=910.0)], Texture("clear", clear), bricks, Texture("clear too", clear))
    plain = mesh_of_city([house, sheet(x=910.0)], opaque(half_clear(), RED), bricks)
    found, expected = (shown(one, EAST).object_ids == 0 for one in (mesh, plain))
    assert expected.sum() > 500 and np.array_equal(found, expected)


def test_panes_glint_in_a_city_with_cut_outs():
    """As they do where the trees are solid, as far as these do not hide them."""
    city = street_of_trees()
    solid = replace(city, textures=tuple(opaque(one, LEAF) for one in city.textures))
    ground = ground_mesh(city, margin=20.0)
    views = [view_towards(np.array([-20.0, -5.0, 3.0]), turn, 0.2, focal=277.0, window=WINDOW) for turn in range(7)]
    houses = np.array([not one.id.startswith(("tree", "railing")) for one in city.objects])
    found = []
    for one in (city, solid):
        mesh = build_city_mesh(one)
        plan = Plan((Objects("all", np.arange(len(mesh.triangle_counts))), Sky()))
        pictures = []
        for glint in (False, True):
            with Renderer(mesh, ground, size=SIZE, measured=True, glint=glint) as renderer:
                pictures.append([renderer.draw(plan, view, measured=True) for view in views])
        found.append(
            [(a.object_ids, b.object_ids, b.color.astype(int) - a.color) for a, b in zip(*pictures, strict=True)]
        )
    brightest = let_through = 0
    for (ids, again, glint), (others, _, expected) in zip(*found, strict=True):
        assert np.array_equal(ids, again)
        house = (ids >= 0) & houses[ids]
        same = (ids == others) & house
        assert abs(glint[same] - expected[same]).max(initial=0) <= 3
        assert not glint[~house].any()
        brightest = max(brightest, int(glint[same].max(initial=0)))
        let_through += int((house & (others != ids)).sum())
    assert brightest > 30 and let_through > 1000


def test_images_that_are_captured_on_the_gpu_leave_out_what_is_clear():
    mesh = mesh_of_city([sheet(), wall()], half_clear())
    ground = ground_mesh(city_of(CityObject("far", (Prism(box(-5, -5, 5, 5), -900.0, -890.0),))), margin=10.0)
    key = ImageKey("test", "sheet")
    only = Objects("sheet", np.array([0]))
    with Renderer(mesh, ground, size=SIZE, measured=True, samples=4) as renderer:
        renderer.execute(Plan((), requests=(Request(Slot(key, SIZE), EAST, (only,)),)))
        image = renderer.image(key)
        shown = renderer.draw(Plan((only, Sky())), EAST, measured=True)
        again = renderer.draw(Plan((Relief(key, (ReliefPart(EAST, (0, 0), 1.0),)), Sky())), EAST, measured=True)
    assert np.array_equal(image.depth > 0.0, shown.object_ids == 0)
    assert np.mean((again.object_ids == 0) == (shown.object_ids == 0)) > 0.99
