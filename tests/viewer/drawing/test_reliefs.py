"""Images that requests capture, and reliefs that show them: against the geometry, seen from the same place and from others."""

import numpy as np
import pytest

from mmi.foundation.camera import view_towards
from viewer.drawing.renderer import Renderer
from viewer.plan import ImageKey, Objects, Plan, Relief, ReliefPart, Request, Sky, Slot

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
