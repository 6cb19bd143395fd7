"""Images that requests capture, and reliefs that show them: against the geometry, seen from the same place and from others."""

import math

import numpy as np
import pytest

from mmi.foundation.camera import View, view_towards
from viewer.drawing.renderer import Renderer
from viewer.plan import RELIEF_QUAD, ImageKey, Objects, Plan, Relief, ReliefPart, Request, Sky, Slot

SIZE = (320, 240)
FOCAL = 277.0
WINDOW = (-160, -120, *SIZE)
CELL = "0001-01"
KEY = ImageKey("test", "one")


@pytest.fixture(scope="module")
def place(scene):
    return scene.cell(CELL)


@pytest.fixture(scope="module")
def renderer(scene):
    with Renderer(scene.mesh, scene.ground, size=SIZE, measured=True) as renderer:
        yield renderer


def look(place, azimuth, along=0.0, up=0.0, pitch=0.0, window=WINDOW):
    eye = place.cell.reference + np.array([along, 0.0, up])
    return view_towards(eye, azimuth, pitch, focal=FOCAL, window=window)


def of(objects):
    return Objects(f"some {objects.tolist()}", objects)


def captured(view, *draws, corner=(0, 0), size=None, clear=True):
    return Request(Slot(KEY, size or view.window[2:], corner), view, draws, clear)


def relief(view, corner=(0, 0), moved=None):
    return Relief(KEY, (ReliefPart(view, corner, 100.0, moved),))


@pytest.mark.parametrize(("azimuth", "pitch"), [(0.3, 0.0), (2.0, 0.3), (4.0, -0.2)])
def test_from_where_it_was_captured_a_relief_is_the_geometry(place, renderer, azimuth, pitch):
    view = look(place, azimuth, pitch=pitch)
    truth = renderer.draw(Plan((of(place.visible), Sky())), view, measured=True)
    plan = Plan((relief(view), Sky()), requests=(captured(view, of(place.visible)),))
    found = renderer.draw(plan, view, measured=True)
    assert np.array_equal(found.object_ids, truth.object_ids)
    assert np.abs(found.color.astype(int) - truth.color).max() <= 2
    there = np.isfinite(truth.depth)
    assert np.array_equal(there, np.isfinite(found.depth))
    np.testing.assert_allclose(found.depth[there], truth.depth[there], rtol=1e-4)
    assert np.nanmax(found.displacement) < 0.05 / FOCAL
    assert found.done.requests.pixels == SIZE[0] * SIZE[1] and found.done.requests.seconds > 0.0


def test_an_image_has_what_was_captured_the_top_row_first(place, renderer):
    view = look(place, 0.3, pitch=0.1)
    truth = renderer.draw(Plan((of(place.visible), Sky())), view, measured=True)
    renderer.execute(Plan((), requests=(captured(view, of(place.visible)),)))
    image = renderer.image(KEY)
    shows = truth.object_ids >= 0
    assert np.array_equal(image.depth > 0.0, shows) and np.array_equal(image.color[..., 3] == 255, shows)
    assert np.array_equal(image.color[~shows], np.zeros((np.count_nonzero(~shows), 4)))
    assert np.abs(image.color[shows][:, :3].astype(int) - truth.color[shows]).max() <= 2
    assert np.array_equal(image.object_ids[shows], truth.object_ids[shows])
    np.testing.assert_allclose(image.depth[shows], truth.depth[shows], rtol=1e-5)


def test_pieces_of_an_image_are_the_whole_in_any_order(place, renderer):
    view = look(place, 0.3)
    renderer.execute(Plan((), requests=(captured(view, of(place.visible)),)))
    whole = renderer.image(KEY)
    half = len(place.visible) // 2
    for some in (place.visible[:half], place.visible[half:]), (place.visible[half:], place.visible[:half]):
        requests = (captured(view, of(some[0])), captured(view, of(some[1]), clear=False))
        renderer.execute(Plan((), requests=requests))
        pieces = renderer.image(KEY)
        assert all(np.array_equal(a, b) for a, b in zip(whole, pieces, strict=True))


def test_slots_of_an_image_do_not_disturb_each_other(place, renderer):
    one, two = look(place, 0.3, window=(-40, -30, 100, 90)), look(place, 2.2, window=(-64, -20, 60, 50))
    size = (230, 120)
    requests = (
        captured(one, of(place.visible), corner=(0, 0), size=size),
        captured(two, of(place.visible), corner=(120, 40), size=size),
    )
    renderer.execute(Plan((), requests=requests))
    both = renderer.image(KEY)
    for request in requests:
        (x, y), (_, _, width, height) = request.into.corner, request.view.window
        alone = captured(request.view, of(place.visible))
        renderer.execute(Plan((), requests=(alone,)))
        for found, expected in zip(both, renderer.image(KEY), strict=True):
            apart = np.abs(found[y : y + height, x : x + width].astype(float) - expected)
            assert apart.max() <= (2.0 if found.ndim == 3 else 1e-3)
        renderer.execute(Plan((), requests=requests))
    assert not both.color[100:, :100].any(), "nothing outside of the slots"
    for request in requests:
        view = request.view
        truth = renderer.draw(Plan((of(place.visible), Sky())), look_through(view), measured=True)
        found = renderer.draw(Plan((relief(view, request.into.corner), Sky())), look_through(view), measured=True)
        left, top, width, height = view.window
        inner = np.s_[120 + top : 120 + top + height, 160 + left : 160 + left + width]
        assert np.array_equal(found.object_ids[inner], truth.object_ids[inner])
        outside = np.ones(found.object_ids.shape, dtype=bool)
        outside[inner] = False
        assert (found.object_ids[outside] == -1).all(), "a part ends where its picture ends"


def look_through(view):
    """The renderer's own window, seen from the same place in the same direction."""
    return view.cropped(WINDOW)


def test_a_place_that_is_not_within_its_image_is_refused(place, renderer):
    view = look(place, 0.3)
    with pytest.raises(ValueError, match="a place within"):
        renderer.execute(Plan((), requests=(captured(view, corner=(1, 0), size=view.window[2:]),)))


def test_an_image_that_was_dropped_is_not_there_and_its_room_is_taken_clean(place, renderer):
    view = look(place, 0.3)
    renderer.execute(Plan((), requests=(captured(view, of(place.visible)),)))
    with pytest.raises(KeyError):
        renderer.draw(Plan((relief(view),), drops=(KEY,)), view)
    renderer.execute(Plan((), requests=(captured(view, clear=False),)))
    assert not renderer.image(KEY).color.any() and not renderer.image(KEY).depth.any()


def test_from_elsewhere_surfaces_are_where_they_are_as_far_as_the_capture_has_seen_them(place, renderer):
    far = np.setdiff1d(place.visible, place.near)
    for azimuth in (0.3, 2.0, 4.0):
        view, nearby = look(place, azimuth), look(place, azimuth, along=2.0, up=0.2)
        request = captured(view, of(far))
        truth = renderer.draw(Plan((of(far), Sky())), nearby, measured=True)
        found = renderer.draw(Plan((relief(view), Sky()), requests=(request,)), nearby, measured=True)
        wrong = truth.object_ids != found.object_ids
        assert wrong.mean() < 0.02
        same = ~wrong & (truth.object_ids >= 0)
        ratio = found.depth[same] / truth.depth[same]
        assert np.percentile(np.abs(ratio - 1.0), 95) < 0.05


def test_what_moves_takes_its_picture_along(place, renderer):
    view = look(place, 0.3)
    turn = 0.2
    moved = np.eye(4)
    moved[:2, :2] = [[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]
    moved[:3, 3] = [3.0, -2.0, 0.5]
    seen_then = captured(view, of(place.visible))
    # Who moves along with it sees what was captured.
    along = view_of(view.eye_from_world @ np.linalg.inv(moved))
    truth = renderer.draw(Plan((of(place.visible), Sky())), view, measured=True)
    found = renderer.draw(Plan((relief(view, moved=moved), Sky()), requests=(seen_then,)), along, measured=True)
    assert np.array_equal(found.object_ids, truth.object_ids)
    assert np.abs(found.color[truth.object_ids >= 0].astype(int) - truth.color[truth.object_ids >= 0]).max() <= 2


def view_of(eye_from_world):
    return View(eye_from_world, FOCAL, WINDOW)


def test_spans_leave_out_nothing_that_is_there(place, renderer):
    view = look(place, 0.3)
    renderer.execute(Plan((), requests=(captured(view, of(place.visible)),)))
    covered = renderer.image(KEY).depth > 0.0
    spans = []
    for first in range(0, SIZE[0], RELIEF_QUAD):
        rows = np.flatnonzero(covered[:, first : first + RELIEF_QUAD].any(axis=1))
        spans.append((rows[0], rows[-1] + 1) if rows.size else (120, 120))
    part = ReliefPart(view, (0, 0), 100.0, spans=np.array(spans))
    nearby = look(place, 0.32, along=1.0)
    for seen in (view, nearby):
        whole = renderer.draw(Plan((relief(view), Sky())), seen, measured=True)
        bent = renderer.draw(Plan((Relief(KEY, (part,)), Sky())), seen, measured=True)
        assert np.mean(whole.object_ids != bent.object_ids) < (1e-9 if seen is view else 0.01)
    assert Relief(KEY, (part,)).pixels < relief(view).pixels


def test_reliefs_are_composed_with_all_else_by_depth(place, renderer):
    view = look(place, 0.3)
    ahead, behind = place.visible[::2], place.visible[1::2]
    truth = renderer.draw(Plan((of(place.visible), Sky())), view, measured=True)
    request = captured(view, of(ahead))
    for draws in ((relief(view), of(behind)), (of(behind), relief(view))):
        found = renderer.draw(Plan((*draws, Sky()), requests=(request,)), view, measured=True)
        assert np.mean(found.object_ids != truth.object_ids) < 1e-3
