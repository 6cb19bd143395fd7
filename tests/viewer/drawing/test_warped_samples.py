"""Layered images as points: near to what the processor paints, whole where surfaces are, and kept for those drawn last."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from placed_pictures import WINDOW, apart, hits, picture_of, view_at

from mmi.foundation.camera import View
from viewer.computed import WarpedPicture, WarpedSamples
from viewer.drawing.kinds import warped_samples
from viewer.drawing.renderer import Renderer
from viewer.drawing.style import Style
from viewer.layered.layered_image import NOTHING, LayeredImage
from viewer.layered.merging import merged
from viewer.layered.viewpoints import construction_views
from viewer.layered.warping import warped
from viewer.plan import ImageKey, Objects, Plan, Request, Sky, Slot

SIZE = WINDOW[2:]
OURS = settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
EYES = st.tuples(
    st.floats(-3.0, 4.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-0.4, 0.4), st.floats(-0.3, 0.3)
)


@pytest.fixture(scope="module")
def renderer(scene):
    with Renderer(scene.mesh, scene.ground, size=SIZE, measured=True) as renderer:
        yield renderer


def image_of(sheets, count=9):
    pictures = [picture_of(view, sheets) for view in construction_views(view_at(), 8.0, 4.0, count, sheets.points)]
    return merged(pictures, radius=4.0)


def draw_of(image, key=None):
    told = (image.view, image.starts, image.depths, image.slopes, image.reaches, image.colors, image.ids)
    return WarpedSamples(key or f"test {id(image)}", *told)


def drawn(renderer, view, *draws, **options):
    return renderer.draw(Plan((*draws, Sky())), view, measured=True, **options)


def seen(renderer, image, view):
    """Objects and depths that points show."""
    found = drawn(renderer, view, draw_of(image, repr(image.depths.tobytes())))
    there = found.object_ids >= 0
    return np.where(there, found.object_ids, NOTHING), np.where(there, found.depth, np.inf), found


@OURS
@given(st.integers(0, 2**32 - 1))
def test_to_the_own_view_it_is_the_first_picture(renderer, seed):
    sheets = apart(np.random.default_rng(seed), 5)
    picture = picture_of(view_at(), sheets)
    ids, depth, found = seen(renderer, image_of(sheets), view_at())
    assert np.array_equal(ids, picture.ids)
    there = picture.ids != NOTHING
    assert np.array_equal(found.color[there], picture.color[there])
    assert depth == pytest.approx(picture.depth, rel=1e-4)
    assert found.triangles == 1  # the sky's


@OURS
@given(st.integers(0, 2**32 - 1), EYES)
def test_from_elsewhere_it_is_what_the_processor_warps(renderer, seed, eye):
    """But for cracks, which are not closed here, and for pixels at whose middles patches end."""
    image, view = image_of(apart(np.random.default_rng(seed), 4)), view_at(eye[:3], *eye[3:])
    truth, (ids, depth, found) = warped(image, view), seen(renderer, image, view)
    off = ids != truth.ids
    assert off.mean() < 0.01
    there = ~off & (ids != NOTHING)
    assert (np.abs(depth[there] / truth.depth[there] - 1.0) < 1e-3).mean() > 0.99 if there.any() else True
    assert (found.color[there] == truth.color[there]).all()


@pytest.mark.parametrize("eye", [(3.0, 1.0, 1.0), (-3.0, 1.0, -1.0), (0.0, 2.0, 0.5)])
def test_a_plane_has_no_holes(renderer, eye):
    """One large sheet, slanted, as far as the image has it: the ray through each pixel's middle says where it is."""
    one = apart(np.random.default_rng(5), 1)
    large = type(one)(one.corners - 3.0 * one.sides.sum(axis=1), 7.0 * one.sides)
    view = view_at(eye)
    ids, depth, _ = seen(renderer, image_of(large, 1), view)
    u, v = np.meshgrid(*view.pixel_centres())
    truth = hits(view, large, u, v)[0]
    points = view.unproject(u, v, np.where(np.isfinite(truth), truth, 1.0))
    x, y, _ = np.moveaxis(view_at().project(points), -1, 0)
    left, top, width, height = WINDOW
    inside = np.isfinite(truth) & (x > left + 1) & (x < left + width - 1) & (y > top + 1) & (y < top + height - 1)
    inside &= np.isfinite([hits(view, large, u + dx, v + dy)[0] for dx in (-3, 3) for dy in (-3, 3)]).all(axis=0)
    assert inside.sum() > 200
    assert (ids[inside] == 0).all()
    assert depth[inside] == pytest.approx(truth[inside], rel=1e-3)


def test_a_near_patch_at_the_border_is_drawn_though_its_middle_is_not():
    """A sample as large as half the picture, whose middle is out of sight to each side in turn."""
    renderer = Renderer(*meshes(), size=SIZE, measured=True)
    view = view_at()
    middle = LayeredImage(
        View(view.eye_from_world, 4.0, (0, 0, 1, 1)),
        np.array([0, 1], np.int32),
        np.array([5.0], np.float32),
        np.zeros((1, 2), np.float32),
        np.full((1, 4), 15, np.uint8),
        np.array([[200, 100, 50]], np.uint8),
        np.array([3], np.int32),
    )
    with renderer:
        for left, top in ((-5, -1), (5, -1), (-1, -5), (-1, 5), (-3, -2)):
            moved = LayeredImage(
                View(view.eye_from_world, 4.0, (left, top, 1, 1)),
                *(getattr(middle, name) for name in ("starts", "depths", "slopes", "reaches", "colors", "ids")),
            )
            ids, depth, _ = seen(renderer, moved, view)
            x, y = np.meshgrid(*view.pixel_centres())
            covered = (abs(x - 10.0 * (left + 0.5)) < 5.0) & (abs(y - 10.0 * (top + 0.5)) < 5.0)
            assert np.array_equal(ids == 3, covered)
            assert depth[covered] == pytest.approx(5.0, rel=1e-4) if covered.any() else True


def meshes():
    from cities import crossroads
    from placed_models import model_of

    model = model_of(crossroads())
    return model.mesh, model.ground


def test_it_hides_and_is_hidden_by_depth_whatever_the_order(scene, renderer):
    eye = scene.cell("0001-01").cell.reference
    sheets = apart(np.random.default_rng(3), 4)
    image = image_of(sheets)
    here = View(view_at(eye, 0.3).eye_from_world, image.view.focal, image.view.window)
    moved = LayeredImage(here, image.starts, image.depths, image.slopes, image.reaches, image.colors, image.ids + 500)
    city, found = Objects("", np.arange(len(scene.mesh.triangle_counts))), warped(moved, here)
    alone = drawn(renderer, here, city)
    near = found.depth < alone.depth
    expected = np.where(near, found.ids, alone.object_ids)
    for draws in ((draw_of(moved, "a"), city), (city, draw_of(moved, "a"))):
        found = drawn(renderer, here, *draws)
        assert (found.object_ids != expected).mean() < 1e-2
    assert 0 < near.sum() < np.isfinite(found.depth).sum()


def test_columns_and_colours_alone_are_those_of_the_whole(renderer):
    plan, view = Plan((draw_of(image_of(apart(np.random.default_rng(1), 4))), Sky())), view_at((1.0, 1.0, 0.0))
    whole, part = renderer.draw(plan, view), renderer.draw(plan, view, columns=(10, 33))
    np.testing.assert_array_equal(part.color, whole.color[:, 10:33])


def test_samples_of_a_pixel_show_it_whole(scene):
    image, view = image_of(apart(np.random.default_rng(1), 4)), view_at((1.0, 1.0, 0.0))
    with Renderer(scene.mesh, scene.ground, size=SIZE, samples=4) as smooth, Renderer(*meshes(), size=SIZE) as plain:
        pictures = [one.draw(Plan((draw_of(image), Sky())), view).color for one in (smooth, plain)]
    np.testing.assert_array_equal(*pictures)


def test_tinted_it_has_the_ink_of_what_is_shown_again(renderer):
    image = image_of(apart(np.random.default_rng(1), 4))
    plain, tinted = (
        renderer.draw(Plan((draw_of(image), Sky())), view_at(), style=Style(tint=tint)) for tint in (False, True)
    )
    there = np.isfinite(warped(image, view_at()).depth)
    changed = (plain.color != tinted.color).any(axis=2)
    assert changed[there].mean() > 0.9
    assert not changed[~there].any()


def test_in_an_image_it_is_the_same(renderer):
    image, view, key = (
        image_of(apart(np.random.default_rng(1), 4)),
        view_at((1.0, 1.0, 0.0)),
        ImageKey("test", "points"),
    )
    request = Request(Slot(key, SIZE), view, (draw_of(image),))
    renderer.draw(Plan((Sky(),), requests=(request,)), view)
    ids, _, found = seen(renderer, image, view)
    there = ids != NOTHING
    np.testing.assert_array_equal(renderer.image(key).object_ids[there], ids[there])
    np.testing.assert_array_equal(renderer.image(key).color[there][:, :3], found.color[there])


def test_images_drawn_longest_ago_make_room_and_come_back(scene, renderer, monkeypatch):
    images = [image_of(apart(np.random.default_rng(seed), 4)) for seed in range(4)]
    view = view_at((1.0, 1.0, 0.0))
    truths = [seen(renderer, image, view)[0] for image in images]
    most = 60 * max(len(image.depths) for image in images)
    monkeypatch.setattr(warped_samples, "_MOST_BYTES", most)
    with Renderer(scene.mesh, scene.ground, size=SIZE, measured=True) as renderer:
        for n in (0, 1, 2, 3, 1, 0, 0, 2):
            assert np.array_equal(seen(renderer, images[n], view)[0], truths[n])
            kept = renderer._samples._kept
            assert sum(one.bytes for one in kept.values()) <= most
        assert 1 <= len(kept) < 4
        assert list(kept)[-1] == repr(images[2].depths.tobytes())


def test_an_image_without_samples_is_nothing(renderer):
    nothing = LayeredImage(
        view_at(),
        np.zeros(SIZE[0] * SIZE[1] + 1, np.int32),
        np.empty(0, np.float32),
        np.empty((0, 2), np.float32),
        np.empty((0, 4), np.uint8),
        np.empty((0, 3), np.uint8),
        np.empty(0, np.int32),
    )
    assert (drawn(renderer, view_at(), draw_of(nothing)).object_ids < 0).all()


def test_an_eye_amid_the_samples_is_no_error(renderer):
    image = image_of(apart(np.random.default_rng(4), 5))
    for x in (12.0, 20.0, 60.0):
        view = view_at((x, 0.3, 0.2), np.pi if x > 15.0 else 0.0)
        ids, depth, _ = seen(renderer, image, view)
        assert (depth > 0.0).all()
        assert (ids != warped(image, view).ids).mean() < 0.01


def test_plans_tell_images_by_their_keys():
    image, view = image_of(apart(np.random.default_rng(1), 4)), view_at((1.0, 1.0, 0.0))
    found = warped(image, view)
    one, other = Plan((draw_of(image, "a"),)), Plan((draw_of(image, "b"),))
    assert one.same_as(Plan((draw_of(image, "a"),)))
    assert not one.same_as(other)
    assert not one.same_as(Plan((WarpedPicture(found.color, found.depth, found.ids),)))
