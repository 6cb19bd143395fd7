"""Movers in pictures: what counts as wrong of them, and how little is, in layers, on a walk, and behind far buildings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from moving import block, movers_of

from mmi.walks.walk import Keyframe, Pose, Walk
from viewer.cells.scene_cache import cell_cache
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.drawing.renderer import Renderer
from viewer.measuring.mover_errors import MoverErrors, mover_errors
from viewer.plan import Budget
from viewer.scene.skyline import skyline_of
from viewer.techniques.catalogue import make_technique
from viewer.techniques.virtual_frames import FrameRules

FIRST = 100


def picture(ids):
    ids = np.array(ids, dtype=np.int32)
    return DrawnPicture(
        color=np.zeros((*ids.shape, 3), dtype=np.uint8),
        object_ids=ids,
        depth=None,
        displacement=None,
        seconds=0.0,
        gpu_seconds=None,
        triangles=0,
        draws=0,
    )


def stripe(start, end, width=40, mover=FIRST, around=3):
    ids = np.full((12, width), around)
    ids[2:10, start:end] = mover
    return picture(ids)


@pytest.mark.parametrize(
    ("truth", "shown", "errors"),
    [
        (stripe(10, 20), stripe(10, 20), (80, 0, 0, 0)),
        (stripe(10, 20), stripe(12, 22), (80, 0, 0, 0)),  # all within the rim
        (stripe(10, 20), stripe(13, 23), (80, 8, 8, 0)),
        (stripe(10, 20), stripe(10, 20, around=7), (80, 0, 0, 0)),  # what is behind does not matter
        (stripe(10, 20), stripe(0, 0), (80, 80, 0, 0)),
        (stripe(0, 0), stripe(10, 20), (0, 0, 80, 80)),
        (stripe(0, 0), stripe(10, 12), (0, 0, 16, 0)),  # it comes into sight a little early
        (stripe(10, 20), stripe(10, 20, mover=FIRST + 1), (80, 80, 80, 80)),
        (stripe(0, 5), stripe(35, 40), (40, 40, 40, 0)),  # the other side of the picture is far
    ],
)
def test_pixels_count_beyond_a_rim(truth, shown, errors):
    found = mover_errors(truth, shown, first=FIRST)
    assert found == MoverErrors(*errors)
    assert found.share == pytest.approx((errors[1] + errors[2]) / max(errors[0], 1))


def test_pictures_that_were_not_measured_are_refused():
    plain = replace(stripe(0, 3), object_ids=None)
    with pytest.raises(ValueError, match="without object ids"):
        mover_errors(plain, stripe(0, 3), first=FIRST)


def drive(*legs):
    """Keys (time, x, y, 0, heading) of a way along straight legs."""
    return [(time, x, y, 0.0, heading) for time, x, y, heading in legs]


TRACKS = [
    drive((0, 140, -3, 180), (6, 60, -3, 180)),  # towards the viewer
    drive((0, 55, 3, 0), (6, 120, 3, 0)),  # away from it
    drive((0, 76, -80, 90), (6, 84, 80, 90)),  # across, from behind one block to behind another
    drive((0, 145, -30, 90), (6, 145, 40, 90)),  # across at the end of the street
    drive((0, 40, 75, 0), (6, 100, 75, 0)),  # always hidden
    drive((0, 90, 0, 0), (3, 92, 0, 170), (6, 90, 0, 340)),  # turns on the spot
]
WALK = Walk("east", (Keyframe(0.0, Pose((5.0, 0.0, 1.7), -0.1, 0.0)), Keyframe(5.0, Pose((25.0, 1.0, 1.7), 0.15, 0.0))))


@pytest.fixture(scope="module")
def moving_scene(scene):
    movers = movers_of(TRACKS, mesh=block(high=(2.0, 1.0, 2.5)), crs="EPSG:32631")
    return replace(scene, movers=movers, skyline=skyline_of(scene.dataset.city()))


@pytest.mark.parametrize("calculation", ["predictive", "common"])
@pytest.mark.parametrize("name", ["multi-mesh", "multi-mesh-dynamic"])
def test_movers_are_right_in_layers_and_vanish_behind_far_buildings(moving_scene, name, calculation):
    first = len(moving_scene.mesh.triangle_counts)
    scenes = {"multi-mesh": moving_scene}
    rules = FrameRules(calculation=calculation, nearest=10.0, thrifty=False)
    technique, full = make_technique(name, scenes, frames=rules), make_technique("full", scenes)
    camera = moving_scene.camera
    total = np.zeros(4, dtype=int)
    seen, images = set(), 0
    with (
        Renderer(
            moving_scene.mesh,
            moving_scene.ground,
            size=(camera.width, camera.height),
            measured=True,
            movers=moving_scene.movers,
        ) as renderer,
        cell_cache(scenes, renderer, measured=True) as cache,
    ):
        for step in WALK.frames(10.0):
            view = step.pose.view(camera)
            truth = renderer.draw(full.plan(view, now=step.time, budget=Budget()), view, measured=True)
            plan = technique.plan(view, now=step.time, budget=Budget(0.1))
            cache.require(plan.cells)
            shown = renderer.draw(plan, view, measured=True)
            total += mover_errors(truth, shown, first=first)
            seen |= set(np.unique(shown.object_ids[shown.object_ids >= first]).tolist())
            images += (shown.object_ids[np.isfinite(shown.displacement)] >= first).sum()
            assert first + 4 not in shown.object_ids
    assert technique.tally.hidden > len(WALK.frames(10.0)), "one is always hidden, one now and then"
    pixels, missing, surplus, hidden = total.tolist()
    assert seen == {first, first + 1, first + 2, first + 3, first + 5}
    assert images > 0.2 * pixels, "most of what is far is an image"
    assert pixels > 5000
    assert (missing + surplus) <= 0.01 * pixels
    assert hidden == 0
