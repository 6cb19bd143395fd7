"""Cells whose dataset holds meshes alone (MMI section 5.2): their pictures are captured when they are brought to the GPU."""

import math
from dataclasses import replace

import numpy as np
import pytest
from cities import crossroads
from rasters import psnr
from scipy.ndimage import binary_dilation

from mmi.building.dataset import build_dataset
from mmi.dataset.cell_files import read_depths, read_pictures
from mmi.dataset.reading import open_dataset
from mmi.foundation.camera import View, view_towards
from viewer.cells.layer_atlas import BORDER
from viewer.cells.loaded_cell import cell_image, load_cell
from viewer.cells.scene_cache import cell_cache, foretold_bytes
from viewer.drawing.renderer import Renderer
from viewer.plan import Budget, CellKey, CellLayers, Plan, Request
from viewer.scene.scene import open_scene
from viewer.techniques.catalogue import make_technique

CELL = "0001-01"
SIZE = (256, 256)


@pytest.fixture(scope="module")
def bare(tmp_path_factory, dataset, scene):
    """The scene of the same cells, built without pictures."""
    folder = tmp_path_factory.mktemp("viewer") / "bare"
    build_dataset(crossroads(), folder, replace(dataset.manifest.parameters, pictures="none"))
    return open_scene(open_dataset(folder), name="multi-mesh", like=scene)


@pytest.fixture
def renderer(scene):
    with Renderer(scene.mesh, scene.ground, size=SIZE, measured=True) as renderer:
        yield renderer


def views(scene, count=8):
    """From here and there in the cell, all around."""
    cell = scene.cell(CELL).cell
    p, q = (np.array([*end, cell.reference[2]]) for end in (cell.p, cell.q))
    for i in range(count):
        eye = p + (q - p) * (i + 0.5) / count
        yield view_towards(eye, 2.0 * math.pi * i / count, 0.05, focal=scene.camera.focal, window=scene.camera.window)


def planned(scene, view):
    return make_technique("multi-mesh", {"multi-mesh": scene}).plan(view, now=0.0, budget=Budget())


def test_plans_are_the_same_as_with_stored_pictures(scene, bare):
    for view in views(scene):
        assert planned(bare, view).same_as(planned(scene, view))
        assert not planned(bare, view).requests, "capturing a cell is a way of loading it"


def test_a_loaded_cell_asks_for_just_what_its_layers_show(bare):
    loaded, entry = load_cell(bare, CELL), bare.dataset.cell(CELL)
    assert loaded.image == cell_image(loaded.key)
    for layer, (sector, described) in zip(loaded.layers, entry.pictures, strict=True):
        request = layer.picture
        assert isinstance(request, Request) and request.clear
        assert (request.into.image, request.into.size, request.into.corner) == (loaded.image, loaded.size, layer.corner)
        left, top, width, height = entry.view(sector, described).window
        assert request.view.window == (left - BORDER, top - BORDER, width + 2 * BORDER, height + 2 * BORDER)
        assert np.array_equal(request.view.eye_from_world, entry.view(sector, described).eye_from_world)
        (shown,) = request.draws
        assert [bare.objects[entry.far[place]] for place in described.objects] == shown.objects.tolist()


def test_what_is_captured_is_what_a_build_stores(scene, bare, renderer):
    """Where a build stores something the same is there; more may be, as a build leaves out what nobody can see."""
    loaded = load_cell(bare, CELL)
    renderer.upload(loaded)
    found = renderer.image(loaded.image)
    pictures, depths = read_pictures(scene.dataset, CELL), read_depths(scene.dataset, CELL)
    entry = scene.dataset.cell(CELL)
    listed = np.array([-1, *(scene.objects[one] for one in (*entry.far, *entry.near))])
    assert pictures
    for layer, picture in zip(loaded.layers, pictures, strict=True):
        depth, places = depths[picture.name]
        rows, columns = (
            slice(start + BORDER, start + BORDER + length)
            for start, length in zip(layer.corner[::-1], depth.shape, strict=True)
        )
        stored = np.isfinite(depth)
        captured = found.depth[rows, columns]
        same = stored & (found.object_ids[rows, columns] == listed[places]) & (captured > 0.0)
        assert same.sum() > 0.97 * stored.sum(), "but for silhouettes, where the two rasters may differ"
        np.testing.assert_allclose(captured[same], depth[same], rtol=2e-3)
        assert psnr(found.color[rows, columns][same][..., :3], picture.pixels[same][..., :3]) > 30.0
        assert (found.color[rows, columns][same][..., 3] == 255).all()


def test_pictures_are_about_those_of_the_stored_ones(scene, bare, renderer):
    """Drawn one after the other, from places that nothing was captured from."""
    key = CellKey("multi-mesh", CELL)
    for view in views(scene):
        plan = Plan(planned(scene, view).draws)
        drawn = []
        for one in (scene, bare):
            renderer.upload(load_cell(one, CELL, measured=True))
            drawn.append(renderer.draw(plan, view, measured=True))
            renderer.evict(key)
        stored, captured = drawn
        assert psnr(captured.color, stored.color) > 32.0
        apart = captured.object_ids != stored.object_ids
        edges = np.zeros(apart.shape, dtype=bool)
        for axis in (0, 1):
            edges |= np.roll(stored.object_ids, 1, axis) != stored.object_ids
        assert not (apart & ~binary_dilation(edges, iterations=2)).any(), "ids differ at silhouettes only"
        assert apart.mean() < 0.01
        near = np.abs(np.nan_to_num(captured.displacement)).max()
        assert near <= np.abs(np.nan_to_num(stored.displacement)).max() + 1e-2


def test_coverage_reaches_a_little_farther(scene, bare, renderer):
    """In the place of rims: seen larger, silhouettes are farther out by a quarter of a texel."""
    key, entry, larger = CellKey("multi-mesh", CELL), scene.dataset.cell(CELL), 8
    loaded = [load_cell(one, CELL, measured=True) for one in (scene, bare)]
    reached = []
    for sector, one in entry.pictures:
        seen = entry.view(sector, one)
        corner = (larger * (one.window[0] - 1), larger * (one.window[1] - 1))
        view = View(seen.eye_from_world, larger * seen.focal, (*corner, *SIZE))
        shown = []
        for cell in loaded:
            renderer.upload(cell)
            picture = renderer.draw(Plan((CellLayers(key, (one.name,)),)), view, measured=True)
            shown.append(picture.depth > 0.0)
            renderer.evict(key)
        stored, captured = shown
        if stored.any():
            assert not (stored & ~captured).any()
            reached.append((captured & binary_dilation(stored, iterations=larger // 4 + 2)).sum() / captured.sum())
            assert captured.sum() > stored.sum()
    assert len(reached) > 2
    assert min(reached) > 0.99


def test_bytes_are_those_of_the_image_and_foretold_from_the_manifest(bare):
    for entry in bare.dataset.manifest.cells:
        loaded = load_cell(bare, entry.id)
        meshes = sum(layer.vertices.nbytes + layer.triangles.nbytes for layer in loaded.layers)
        assert loaded.bytes == 16 * loaded.size[0] * loaded.size[1] + meshes
        assert loaded.bytes <= foretold_bytes(bare.dataset, entry.id, measured=False) <= 1.1 * loaded.bytes


def test_a_cache_captures_what_is_needed_and_forgets_its_image(bare, renderer):
    view = next(view for view in views(bare) if planned(bare, view).draws[1].names)
    plan = planned(bare, view)
    (key,) = plan.cells
    with cell_cache({"multi-mesh": bare}, renderer, measured=True) as cache:
        cache.require(plan.cells)
        assert cache.report.waits == 1
        renderer.draw(plan, view, measured=True)
        assert renderer.image(cell_image(key)).depth.any()
    with pytest.raises(KeyError):
        renderer.image(cell_image(key))
    with pytest.raises(KeyError):
        renderer.draw(plan, view, measured=True)


def test_a_cell_is_captured_a_layer_at_a_time(bare, renderer):
    """So that a frame need not wait for all of it."""
    loaded = load_cell(bare, CELL)
    first, *others = loaded.layers
    room = 0
    while not renderer.upload_layer(loaded, first):
        room += 1
    assert 2 <= room <= 6
    image = renderer.image(loaded.image)
    inside = np.zeros(image.depth.shape, dtype=bool)
    (x, y), (_, _, width, height) = first.corner, first.picture.view.window
    inside[y : y + height, x : x + width] = True
    assert image.depth[inside].any() and not image.depth[~inside].any()
    assert all(renderer.upload_layer(loaded, one) for one in others)


def test_an_evicted_cell_that_was_not_whole_leaves_nothing(bare, renderer):
    loaded = load_cell(bare, CELL)
    assert not renderer.upload_layer(loaded, loaded.layers[0])
    renderer.evict(loaded.key)
    renderer.upload(loaded)
    assert renderer.image(loaded.image).depth.any()
