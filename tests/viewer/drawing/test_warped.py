"""Warped pictures: drawn as they are, hidden by what is nearer and hiding what is farther, in columns and tinted."""

import numpy as np
import pytest

from mmi.foundation.camera import view_towards
from viewer.computed import WarpedPicture
from viewer.drawing.renderer import Renderer
from viewer.drawing.style import Style
from viewer.plan import ImageKey, Objects, Plan, Request, Sky, Slot

SIZE = (321, 240)  # rows that are no multiple of four bytes
WINDOW = (-160, -120, *SIZE)


@pytest.fixture(scope="module")
def renderer(scene):
    with Renderer(scene.mesh, scene.ground, size=SIZE, measured=True) as renderer:
        yield renderer


def look(scene, azimuth=0.3):
    return view_towards(scene.cell("0001-01").cell.reference, azimuth, 0.0, focal=277.0, window=WINDOW)


def objects(scene, which=None):
    everything = np.arange(len(scene.mesh.triangle_counts))
    return Objects("", everything if which is None else everything[which])


def drawn(renderer, view, *draws, **options):
    return renderer.draw(Plan((*draws, Sky())), view, measured=True, **options)


def as_picture(found):
    return WarpedPicture(
        found.color, np.where(found.object_ids >= 0, found.depth, np.float32(np.inf)), found.object_ids
    )


def test_a_picture_of_the_geometry_is_the_geometry(scene, renderer):
    view = look(scene)
    truth = drawn(renderer, view, objects(scene))
    found = drawn(renderer, view, as_picture(truth))
    for name in ("color", "object_ids"):
        np.testing.assert_array_equal(getattr(found, name), getattr(truth, name))
    np.testing.assert_allclose(found.depth, truth.depth, rtol=1e-6)
    assert found.draws == 2


def test_it_hides_and_is_hidden_by_depth_whatever_the_order(scene, renderer):
    view = look(scene)
    truth = drawn(renderer, view, objects(scene))
    odd, even = objects(scene, slice(1, None, 2)), objects(scene, slice(0, None, 2))
    picture = as_picture(drawn(renderer, view, odd))
    for draws in ((picture, even), (even, picture)):
        found = drawn(renderer, view, *draws)
        assert (found.object_ids != truth.object_ids).mean() < 1e-3  # where walls touch, either is in front
        assert ((found.color != truth.color).any(axis=2)).mean() < 1e-3


def test_columns_and_colours_alone_are_those_of_the_whole(scene, renderer):
    view = look(scene)
    picture = as_picture(drawn(renderer, view, objects(scene)))
    whole = renderer.draw(Plan((picture, Sky())), view)
    part = renderer.draw(Plan((picture, Sky())), view, columns=(100, 203))
    np.testing.assert_array_equal(part.color, whole.color[:, 100:203])


def test_tinted_it_has_the_ink_of_what_is_shown_again(scene, renderer):
    view = look(scene)
    picture = as_picture(drawn(renderer, view, objects(scene)))
    plain, tinted = (renderer.draw(Plan((picture, Sky())), view, style=Style(tint=tint)) for tint in (False, True))
    there = np.isfinite(picture.depth)
    changed = (plain.color != tinted.color).any(axis=2)
    assert changed[there].mean() > 0.9
    assert not changed[~there].any()


def test_in_an_image_it_is_the_same(scene, renderer):
    view = look(scene)
    picture = as_picture(drawn(renderer, view, objects(scene)))
    key = ImageKey("test", "warped")
    request = Request(Slot(key, SIZE), view, (picture,))
    renderer.draw(Plan((Sky(),), requests=(request,)), view)
    there = np.isfinite(picture.depth)
    np.testing.assert_array_equal(renderer.image(key).color[there][:, :3], picture.color[there])
    np.testing.assert_array_equal(renderer.image(key).object_ids[there], picture.objects[there])
