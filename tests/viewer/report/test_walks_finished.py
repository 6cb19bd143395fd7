"""Techniques whose plans finish carry on from frame to frame: scored, they show what they showed when timed."""

from dataclasses import replace

import numpy as np
import pytest

from mmi.walks.walk import Keyframe, Pose, Walk
from viewer.casting.rules import CastRules
from viewer.drawing.renderer import Renderer
from viewer.plan import Budget
from viewer.report.compare import CompareOptions, compare_walk
from viewer.techniques.ray_cast import RayCasting

WALK = Walk("east", (Keyframe(0.0, Pose((20.0, 0.0, 1.7), 0.2, 0.0)), Keyframe(2.0, Pose((20.8, 0.0, 1.7), -0.2, 0.0))))
RULES = CastRules(near_field=20.0, limit_px=4.0)
OPTIONS = CompareOptions(
    techniques=("full", "ray-cast"), frames_per_second=8.0, scored=17, keep=0, flip=False, rays=RULES
)


@pytest.fixture
def tallies(monkeypatch):
    """What pixels were in each frame, by technique in the order in which they are made."""
    made = {}
    plan_of = RayCasting.plan

    def remembered(self, view, *, now, budget):
        plan = plan_of(self, view, now=now, budget=budget)
        frames = made.setdefault(self, [])
        number = len(frames)
        frames.append(None)

        def finish(depths, first_column):
            draws = plan.finish(depths, first_column)
            frames[number] = self.latest
            return draws

        return replace(plan, finish=finish)

    monkeypatch.setattr(RayCasting, "plan", remembered)
    return made


@pytest.mark.parametrize("scored", [1, 5])
@pytest.mark.parametrize("video", [None, "webp"])
def test_what_is_scored_has_seen_all_frames_before(dataset, tmp_path, tallies, scored, video):
    report = compare_walk(dataset.path, tmp_path, WALK, options=replace(OPTIONS, scored=scored, video=video))
    timed, again = tallies.values()
    assert len(timed) == len(again) == report["walk"]["frames"] == 17
    assert timed == again
    assert sum(one.reused for one in timed) > sum(one.rays for one in timed[1:]) > 1000


def test_a_plan_that_is_drawn_again_shows_the_same(scene):
    technique = RayCasting(scene, RULES)
    camera = scene.camera
    with Renderer(scene.mesh, scene.ground, size=(camera.width, camera.height), measured=True) as renderer:
        for step in WALK.frames(8.0):
            view = step.pose.view(camera)
            plan = technique.plan(view, now=step.time, budget=Budget())
            first = renderer.draw(plan, view)
            tally = technique.tally
            second = renderer.draw(plan, view, measured=True)
            assert technique.tally is tally, "the frame counts once"
            assert np.array_equal(first.color, second.color)
