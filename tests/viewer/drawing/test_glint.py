"""Windows that mirror the sun: shading that depends on the eye, which pictures keep as they were captured (MMI section 5.5)."""

import math

import numpy as np
import pytest
from rasters import psnr

from mmi.appearance.facades import glass_of
from mmi.foundation.camera import level_view, view_towards
from viewer.cells.loaded_cell import load_cell
from viewer.drawing.renderer import Renderer
from viewer.plan import CellLayers, Ground, ImageKey, Objects, Plan, Relief, ReliefPart, Request, Sky, Slot

SIZE = (320, 240)
FOCAL = 277.0
WINDOW = (-160, -120, *SIZE)
IMAGE = ImageKey("test", "glint")
CELL = "0001-01"


@pytest.fixture(scope="module")
def renderers(scene):
    """Without glint, and with it."""
    with (
        Renderer(scene.mesh, scene.ground, size=SIZE, measured=True) as plain,
        Renderer(scene.mesh, scene.ground, size=SIZE, measured=True, glint=True) as shining,
    ):
        yield plain, shining


def view_from(scene, along, azimuth):
    """From metres east of the cell's middle."""
    eye = scene.cell(CELL).cell.reference + np.array([along, 0.0, 0.0])
    return view_towards(eye, azimuth, 0.15, focal=FOCAL, window=WINDOW)


def everything(scene):
    tiles = tuple(range(len(scene.ground.triangle_counts)))
    return Plan((Objects("all", np.arange(len(scene.mesh.triangle_counts))), Ground(tiles), Sky()))


def glint_of(renderers, scene, view):
    """(h, w) how much brighter the second renderer's picture is, and the first one's measured picture."""
    plain, shining = (one.draw(everything(scene), view, measured=True) for one in renderers)
    return (shining.color.astype(int) - plain.color).sum(axis=2), plain


def rays(view):
    """(h, w, 3) from the eye to a metre of depth, in the city's frame."""
    u, v = np.meshgrid(*view.pixel_centres())
    return np.stack([u / view.focal, -v / view.focal, -np.ones_like(u)], axis=-1) @ view.eye_from_world[:3, :3]


@pytest.fixture(scope="module")
def bright(scene, renderers):
    """The azimuth in which most glitters."""
    azimuths = np.arange(0.0, 2.0 * math.pi, math.pi / 8.0)
    return max(azimuths, key=lambda azimuth: glint_of(renderers, scene, view_from(scene, 0.0, azimuth))[0].sum())


def test_panes_are_brighter_and_nothing_else_is_another(scene, renderers, bright):
    glint, plain = glint_of(renderers, scene, view_from(scene, 0.0, bright))
    assert (glint >= 0).all() and (glint > 100).sum() > 20
    assert (plain.object_ids[glint > 0] >= 0).all(), "no ground and no sky"
    shown = renderers[1].draw(everything(scene), view_from(scene, 0.0, bright), measured=True)
    for name in ("object_ids", "depth", "displacement"):
        assert np.array_equal(getattr(shown, name), getattr(plain, name), equal_nan=True)


def test_where_it_glitters_the_ray_is_mirrored_towards_a_low_sun(scene, renderers, bright):
    """The twin of the shader, with walls' normals from the picture's own depths."""
    view = view_from(scene, 0.0, bright)
    glint, plain = glint_of(renderers, scene, view)
    ray = rays(view) * plain.depth[..., None]
    normal = np.cross(np.gradient(ray, axis=1), np.gradient(ray, axis=0))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    away = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    mirrored = away - 2.0 * (away * normal).sum(axis=-1, keepdims=True) * normal
    sun = np.array([-0.45, -0.62, 0.0])
    sun = sun / np.linalg.norm(sun) * math.cos(math.radians(6.0)) + [0.0, 0.0, math.sin(math.radians(6.0))]
    strong = (glint > 150) & np.isfinite(normal).all(axis=-1)
    assert strong.sum() > 20
    off = np.degrees(np.arccos(np.clip((mirrored @ sun)[strong], -1.0, 1.0)))
    assert np.percentile(off, 95) < 25.0 and np.median(off) < 15.0


def test_a_relief_from_here_is_the_geometry_and_one_from_elsewhere_glitters_as_it_did_there(scene, renderers, bright):
    def shown(renderer, view, captured_as):
        objects = everything(scene).draws[0]
        request = Request(Slot(IMAGE, SIZE), captured_as, (objects,))
        relief = Relief(IMAGE, (ReliefPart(captured_as, (0, 0), 1000.0),))
        return renderer.draw(Plan((relief, *everything(scene).draws[1:]), requests=(request,)), view).color

    here, there = view_from(scene, 0.0, bright), view_from(scene, -3.0, bright)
    glint, truth = glint_of(renderers, scene, here)
    for renderer in renderers:
        assert psnr(shown(renderer, here, here), renderer.draw(everything(scene), here).color) > 45.0
    found = {}
    for name, captured_as in (("here", here), ("there", there)):
        plain, shining = (shown(renderer, here, captured_as).astype(int) for renderer in renderers)
        found[name] = (shining - plain).sum(axis=2)
    off = {name: np.abs(one - glint).sum() / glint.sum() for name, one in found.items()}
    assert off["here"] < 0.01
    assert off["there"] > 0.2, "what the windows mirror is another from there"
    # The same points of panes, as they are seen from there.
    kept, seen = glint_of(renderers, scene, there)
    points = here.eye + rays(here) * truth.depth[..., None]
    u, v, depth = np.moveaxis(there.project(points), -1, 0)
    column, row = (u - WINDOW[0]).astype(int), (v - WINDOW[1]).astype(int)
    common = (glint > 0) & (column >= 0) & (column < SIZE[0]) & (row >= 0) & (row < SIZE[1])
    column, row = column[common], row[common]
    same = np.abs(seen.depth[row, column] - depth[common]) < 0.05
    assert same.sum() > 100
    captured, expected = found["there"][common][same], kept[row, column][same]
    assert np.abs(captured - expected).mean() < 0.5 * np.abs(glint[common][same] - expected).mean()


def test_stored_pictures_know_nothing_of_it(scene, renderers, bright):
    loaded = load_cell(scene, CELL, measured=True)
    place, view = scene.cell(CELL), view_from(scene, 0.0, bright)
    drawn = []
    for renderer in renderers:
        renderer.upload(loaded)
        drawn.append(renderer.draw(Plan((CellLayers(loaded.key, place.layers),)), view).color)
        renderer.evict(loaded.key)
    assert np.array_equal(*drawn)


def test_a_texture_without_painted_facades_has_no_glass(scene):
    own = np.full((512, 512, 3), 90, dtype=np.uint8)
    assert not glass_of(own).any()
    assert glass_of(scene.mesh.texture).any()
    with Renderer(scene.ground, scene.ground, size=SIZE, glint=True) as renderer:
        view = level_view(np.array([0.0, 0.0, 5.0]), 0.0, focal=FOCAL, window=WINDOW)
        renderer.draw(Plan((Objects("all", np.arange(len(scene.ground.triangle_counts))), Sky())), view)
