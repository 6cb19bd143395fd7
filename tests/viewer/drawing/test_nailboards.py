"""Triangles clipped to boxes, and captured images on quadrilaterals with depth: against the geometry."""

import math

import numpy as np
import pytest

from mmi.foundation.camera import View, view_towards
from viewer.caching.captures import captures_of, sharpness_of
from viewer.drawing.renderer import Renderer
from viewer.plan import Faces, ImageKey, Nailboards, Objects, Plan, Request, Sky, Slot

SIZE = (320, 240)
FOCAL = 277.0
WINDOW = (-160, -120, *SIZE)
KEY = ImageKey("test", "boards")


@pytest.fixture(scope="module")
def renderer(scene):
    with Renderer(scene.mesh, scene.ground, size=SIZE, measured=True) as renderer:
        yield renderer


def look(scene, azimuth=0.3, along=0.0, pitch=0.0):
    eye = scene.cell("0001-01").cell.reference + np.array([along, 0.0, 0.0])
    return view_towards(eye, azimuth, pitch, focal=FOCAL, window=WINDOW)


def everything(scene):
    return np.arange(len(scene.mesh.triangles), dtype=np.int32)


def in_order(scene):
    return Objects("everything", np.arange(len(scene.mesh.triangle_counts)))


def drawn(renderer, view, *draws, requests=()):
    return renderer.draw(Plan((*draws, Sky()), requests=tuple(requests)), view, measured=True)


def test_faces_of_all_objects_are_the_objects(scene, renderer):
    view = look(scene)
    truth, found = (drawn(renderer, view, one) for one in (in_order(scene), Faces("all", everything(scene))))
    np.testing.assert_array_equal(found.object_ids, truth.object_ids)
    np.testing.assert_array_equal(found.color, truth.color)
    assert found.triangles == truth.triangles


def test_of_clipped_faces_only_what_is_in_the_box_is_drawn(scene, renderer):
    view = look(scene)
    box = view.eye + np.array([[20.0, -10.0, -1.0], [120.0, 30.0, 6.0]])
    truth = drawn(renderer, view, in_order(scene))
    found = drawn(renderer, view, Faces("", everything(scene), box))
    there = found.object_ids >= 0
    u, v = np.meshgrid(*view.pixel_centres())
    points = view.unproject(u, v, np.where(np.isfinite(found.depth), found.depth, 1.0))
    slack = 1e-3 * found.depth[there, None]
    assert there.any() and not there.all()
    assert (points[there] >= box[0] - slack).all() and (points[there] <= box[1] + slack).all()
    seen = view.unproject(u, v, np.where(np.isfinite(truth.depth), truth.depth, 1.0))
    inside = (truth.object_ids >= 0) & (seen > box[0] + 0.05).all(axis=2) & (seen < box[1] - 0.05).all(axis=2)
    np.testing.assert_array_equal(found.object_ids[inside], truth.object_ids[inside])
    assert (
        drawn(renderer, view, in_order(scene)).object_ids == truth.object_ids
    ).all()  # nothing is clipped afterwards


def board_of(view, depth, *, fresh=True):
    return Nailboards(
        KEY,
        view.focal,
        view.eye_from_world[None],
        np.array([view.window]),
        np.zeros((1, 2), dtype=np.int64),
        np.array([depth]),
        np.array([fresh]),
    )


@pytest.mark.parametrize("depth", [10.0, 80.0])
@pytest.mark.parametrize(("azimuth", "pitch"), [(0.3, 0.0), (2.0, 0.3), (4.0, -0.2)])
def test_from_where_it_was_captured_a_board_is_the_geometry_with_its_depths(scene, renderer, azimuth, pitch, depth):
    view = look(scene, azimuth, pitch=pitch)
    truth = drawn(renderer, view, in_order(scene))
    request = Request(Slot(KEY, SIZE), view, (in_order(scene),))
    found = drawn(renderer, view, board_of(view, depth), requests=[request])
    np.testing.assert_array_equal(found.object_ids, truth.object_ids)
    np.testing.assert_allclose(found.color.astype(int), truth.color.astype(int), atol=1)  # between equal texels
    there = truth.object_ids >= 0
    np.testing.assert_allclose(found.depth[there], truth.depth[there], rtol=1e-4)
    assert found.displacement[there].max() < 1e-3


def test_boards_and_geometry_hide_each_other_by_depth(scene, renderer):
    view = look(scene)
    truth = drawn(renderer, view, in_order(scene))
    counts = scene.mesh.triangle_counts
    for half in (np.arange(len(counts)) % 2 == 0, np.arange(len(counts)) % 2 == 1):
        one, other = (Objects("", np.flatnonzero(some)) for some in (half, ~half))
        request = Request(Slot(KEY, SIZE), view, (one,))
        found = drawn(renderer, view, board_of(view, 5.0), other, requests=[request])  # it stands before everything
        assert (found.object_ids != truth.object_ids).mean() < 0.002  # where surfaces touch


def test_a_board_of_a_board_from_the_same_place_is_the_same(scene, renderer):
    view = look(scene)
    second = ImageKey("test", "second")
    first = Request(Slot(KEY, SIZE), view, (in_order(scene),))
    again = Request(Slot(second, SIZE), view, (board_of(view, 30.0),))
    shown = board_of(view, 50.0)
    found = drawn(
        renderer,
        view,
        Nailboards(second, *(getattr(shown, name) for name in Nailboards.__slots__[1:])),
        requests=[first, again],
    )
    truth = drawn(renderer, view, in_order(scene))
    np.testing.assert_array_equal(found.object_ids, truth.object_ids)
    there = truth.object_ids >= 0
    np.testing.assert_allclose(found.depth[there], truth.depth[there], rtol=1e-4)


def test_how_far_surfaces_are_from_where_a_board_shows_them_is_measured(scene, renderer):
    before, view = look(scene), look(scene, along=1.0)
    request = Request(Slot(KEY, SIZE), before, (in_order(scene),))
    found = drawn(renderer, view, board_of(before, 40.0), requests=[request])
    there = found.object_ids >= 0
    assert np.isfinite(found.displacement[there]).all()
    assert 0.0 < np.median(found.displacement[there]) < math.atan(1.0 / 5.0)


def test_a_box_is_captured_clipped_and_shown_at_its_place(scene, renderer):
    view = look(scene)
    one = int(np.flatnonzero(scene.mesh.triangle_counts)[0])
    box = scene.boxes[one]
    towards = box.mean(axis=0) - view.eye
    view = view_towards(view.eye, math.atan2(towards[1], towards[0]), 0.0, focal=FOCAL, window=WINDOW)
    found = captures_of(view.eye, box[None], sharpness_of(view))
    assert found.possible[0]
    inner = View(found.eye_from_world[0], sharpness_of(view).texel_focal, tuple(found.windows[0].tolist()))
    size = (512, 512)
    request = Request(Slot(KEY, size, (3, 5)), inner, (Faces("", everything(scene), found.boxes[0]),))
    board = Nailboards(
        KEY, inner.focal, found.eye_from_world, found.windows, np.array([[3, 5]]), found.depths, np.array([True])
    )
    shown = drawn(renderer, view, board, requests=[request])
    truth = drawn(renderer, view, Objects("", np.array([one])))
    alone = truth.object_ids == one
    assert alone.sum() > 50
    wrong = alone & (shown.object_ids != one)
    assert wrong.sum() <= 0.05 * alone.sum()


def test_no_boards_draw_nothing(scene, renderer):
    none = Nailboards(
        KEY,
        1.0,
        np.zeros((0, 4, 4)),
        np.zeros((0, 4), np.int64),
        np.zeros((0, 2), np.int64),
        np.zeros(0),
        np.zeros(0, bool),
    )
    assert none.pixels == 0
    assert (drawn(renderer, look(scene), none).object_ids < 0).all()


def test_a_board_of_what_was_never_captured_is_refused(scene, renderer):
    view = look(scene)
    board = board_of(view, 10.0)
    with pytest.raises(KeyError):
        drawn(
            renderer, view, Nailboards(ImageKey("test", "nothing"), *(getattr(board, n) for n in board.__slots__[1:]))
        )
