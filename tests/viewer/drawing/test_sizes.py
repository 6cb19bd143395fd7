"""One renderer for windows of several sizes, and for some columns of a window: the pixels are those of the whole picture."""

import numpy as np
import pytest

from mmi.foundation.camera import Camera
from mmi.walks.walk import Pose
from viewer.cells.scene_cache import cell_cache
from viewer.drawing.renderer import Renderer
from viewer.drawing.style import Style
from viewer.plan import Budget, ImageKey, Plan, Request, Sky, Slot
from viewer.techniques.catalogue import make_technique

POSE = Pose((1.0, 0.5, 1.7), 0.2, 0.05)


@pytest.fixture(scope="module")
def renderer(scene):
    with Renderer(scene.mesh, scene.ground, size=(64, 48), measured=True) as found:
        yield found


def seen(scene, size, name="full"):
    view = POSE.view(Camera(*size, 1.2))
    return make_technique(name, {"multi-mesh": scene}).plan(view, now=0.0, budget=Budget()), view


@pytest.mark.parametrize("measured", [False, True])
def test_another_size_is_drawn_as_by_a_renderer_of_that_size(scene, renderer, measured):
    for size in ((96, 80), (64, 48), (131, 33), (96, 80)):
        plan, view = seen(scene, size)
        renderer.resize(size)
        assert renderer.size == size
        found = renderer.draw(plan, view, measured=measured)
        with Renderer(scene.mesh, scene.ground, size=size, measured=True) as own:
            truth = own.draw(plan, view, measured=measured)
        assert np.array_equal(found.color, truth.color)
        if measured:
            assert np.array_equal(found.object_ids, truth.object_ids)
            assert np.array_equal(found.depth, truth.depth)


def test_more_sizes_than_are_kept(scene, renderer):
    pictures = {}
    for _ in range(2):
        for width in range(64, 64 + 12):
            plan, view = seen(scene, (width, 48))
            renderer.resize((width, 48))
            picture = renderer.draw(plan, view).color
            assert np.array_equal(pictures.setdefault(width, picture), picture)
    assert len(renderer._other_targets) < 8


@pytest.mark.parametrize("measured", [False, True])
@pytest.mark.parametrize("name", ["full", "multi-mesh"])
def test_columns_are_those_of_the_whole_picture(scene, renderer, name, measured):
    size = (97, 64)
    plan, view = seen(scene, size, name)
    renderer.resize(size)
    with cell_cache({"multi-mesh": scene}, renderer, measured=True) as cache:
        cache.want(plan.cells)
        cache.require(plan.cells)
        whole = renderer.draw(plan, view, measured=measured)
        parts = [renderer.draw(plan, view, measured=measured, columns=one) for one in ((0, 30), (30, 97))]
        assert np.array_equal(np.hstack([part.color for part in parts]), whole.color)
        if measured:
            assert np.array_equal(np.hstack([part.object_ids for part in parts]), whole.object_ids)
            assert np.array_equal(np.hstack([part.depth for part in parts]), whole.depth)
        again = renderer.draw(plan, view, measured=measured)
        assert np.array_equal(again.color, whole.color)
        mixed = Plan(plan.draws, plan.place, plan.cells, fading=(Sky(),), mix=0.25)  # a cross-fade is limited as well
        faded = renderer.draw(mixed, view, measured=measured).color
        part = renderer.draw(mixed, view, measured=measured, columns=(30, 60)).color
        assert np.array_equal(part, faded[:, 30:60])
        lines = Style(wireframe=True)
        drawn = renderer.draw(plan, view, measured=measured, style=lines).color
        part = renderer.draw(plan, view, measured=measured, style=lines, columns=(30, 60)).color
        assert np.array_equal(part, drawn[:, 30:60])
        assert not np.array_equal(drawn, whole.color)


def test_colours_are_read_into_what_is_given(scene, renderer):
    size = (97, 64)
    plan, view = seen(scene, size)
    renderer.resize(size)
    whole = renderer.draw(plan, view).color
    into = np.zeros((64, 200, 3), dtype=np.uint8)
    found = renderer.draw(plan, view, into=into[:, 50:147]).color
    assert np.shares_memory(found, into)
    assert np.array_equal(into[:, 50:147], whole)
    assert not into[:, :50].any()
    assert not into[:, 147:].any()


def test_columns_outside_of_the_picture_are_refused(scene, renderer):
    plan, view = seen(scene, (64, 48))
    renderer.resize((64, 48))
    for columns in ((0, 65), (-1, 5), (5, 5), (6, 5)):
        with pytest.raises(ValueError, match="columns"):
            renderer.draw(plan, view, columns=columns)


def test_images_of_an_owner_are_forgotten_and_those_of_others_stay(scene, renderer):
    size = (64, 48)
    plan, view = seen(scene, size)
    renderer.resize(size)
    for owner in ("one", "other"):
        renderer.execute(Plan((), requests=(Request(Slot(ImageKey(owner, "x"), size), view, plan.draws[:1]),)))
    assert renderer.image_bytes("one") == renderer.image_bytes("other") == 16 * 64 * 64
    renderer.forget("one")
    renderer.forget("nobody")
    assert renderer.image_bytes("one") == 0
    assert renderer.image(ImageKey("other", "x")).color.any()
    with pytest.raises(KeyError):
        renderer.image(ImageKey("one", "x"))
    renderer.forget("other")
