"""A walk that is walked again to be scored: with the plans that were timed, and all that those had captured."""

from dataclasses import replace

import numpy as np
import pytest

from mmi.walks.walk import Keyframe, Pose, Walk
from viewer.drawing.renderer import Renderer
from viewer.measuring.view_errors import pop
from viewer.plan import Budget, Done, ImageKey, Objects, Plan, Relief, ReliefPart, Request, Sky, Slot, Work
from viewer.report.compare import CompareOptions, compare_walk
from viewer.report.walk_scores import _popping
from viewer.runtime.loop import FrameTimes
from viewer.techniques.geometry import FullGeometry

WALK = Walk("east", (Keyframe(0.0, Pose((20.0, 0.0, 1.7), 0.2, 0.0)), Keyframe(2.0, Pose((40.0, 0.0, 1.7), -0.2, 0.0))))


class Moody:
    """Captures the city, in halves, when the last frame took an odd number of nanoseconds, and shows what it captured last.

    The second half is added to what is there, so that it matters that requests are executed once, in order and in all frames.
    """

    name = "moody"

    def __init__(self, scene):
        n = len(scene.mesh.triangle_counts)
        self.halves = [Objects(f"half {k}", np.arange(k, n, 2)) for k in (0, 1)]
        self.all = Objects("all of it", np.arange(n))
        self.shown = None
        self.count = 0

    def plan(self, view, *, now, budget):  # noqa: ARG002
        requests, drops = (), ()
        odd = budget.done is not None and round(1e9 * budget.done.draws.seconds) % 2 == 1
        if self.shown is None or odd:
            old, key = self.shown, ImageKey("moody", f"{self.count}")
            into = Slot(key, view.window[2:])
            requests = tuple(Request(into, view, (half,), clear=half is self.halves[0]) for half in self.halves)
            self.shown = Relief(key, (ReliefPart(view, (0, 0), 100.0),))
            self.count += 1
            drops = () if old is None else (old.image,)
        return Plan((self.shown, Sky()), requests=requests, drops=drops)


def moody(scene):
    return Moody(scene)


@pytest.fixture
def executed(monkeypatch):
    """What renderers capture for the technique: (whether they measure, request)."""
    found = []
    capture = Renderer._capture

    def remembered(self, request):
        if request.into.image.owner == "moody":
            found.append((self.measured, request))
        return capture(self, request)

    monkeypatch.setattr(Renderer, "_capture", remembered)
    return found


@pytest.mark.parametrize("video", [None, "webp"])
def test_the_plans_that_are_scored_are_those_that_were_timed(dataset, tmp_path, monkeypatch, executed, video):
    made = {}
    plan_of = Moody.plan

    def remembered(self, view, *, now, budget):
        made.setdefault(self, []).append(plan_of(self, view, now=now, budget=budget))
        return made[self][-1]

    monkeypatch.setattr(Moody, "plan", remembered)
    options = CompareOptions(
        techniques=("full", moody), frames_per_second=20.0, scored=3, keep=0, flip=False, video=video
    )
    report = compare_walk(dataset.path, tmp_path, WALK, options=options)
    timed, scored = made.values()
    assert len(timed) == len(scored) == report["walk"]["frames"] == 41
    assert all(a.same_as(b) for a, b in zip(timed, scored, strict=True))
    asked = [request for plan in scored for request in plan.requests]
    assert 2 < len(asked) < 2 * 41, "the technique should be moody"
    assert [request for measuring, request in executed if measuring] == asked
    once = [request for measuring, request in executed if not measuring]
    assert once == [request for plan in timed for request in plan.requests]


class Flashing:
    """Captures a small picture that nobody sees in every third frame; from that frame on it draws all, or the sky alone."""

    name = "flashing"

    def __init__(self, scene, *, flashes):
        self.full, self.flashes, self.frame = FullGeometry(scene), flashes, 0

    def plan(self, view, *, now, budget):
        self.frame += 1
        plan = self.full.plan(view, now=now, budget=budget)
        requests = ()
        if self.frame % 3 == 0:
            small = view.cropped((view.window[0], view.window[1], 8, 8))
            requests = (Request(Slot(ImageKey("flashing", "one"), (8, 8)), small, (Sky(),)),)
        dark = self.flashes and self.frame // 3 % 2 == 1
        return replace(plan, draws=(Sky(),) if dark else plan.draws, requests=requests)


def flashing(scene):
    return Flashing(scene, flashes=True)


def quiet(scene):
    return Flashing(scene, flashes=False)


def test_updates_pop_by_what_frames_that_capture_change_beyond_the_motion(dataset, scene, tmp_path):
    options = CompareOptions(
        techniques=("full", "multi-mesh", quiet, flashing), frames_per_second=5.0, scored=1, keep=0
    )
    report = compare_walk(dataset.path, tmp_path, WALK, options=options)
    full, multi, silent, loud = report["techniques"].values()
    assert full["update_pop"] is multi["update_pop"] is None
    assert silent["update_pop"] == {"frames": 3, "mean": 0.0, "max": 0.0}
    views = [step.pose.view(scene.camera) for step in WALK.frames(5.0)]
    assert len(views) == 11
    size = (scene.camera.width, scene.camera.height)
    with Renderer(scene.mesh, scene.ground, size=size) as renderer:
        told = Budget()
        truth = [renderer.draw(FullGeometry(scene).plan(view, now=0.0, budget=told), view) for view in views]
        technique = Flashing(scene, flashes=True)
        shown = [renderer.draw(technique.plan(view, now=0.0, budget=told), view) for view in views]
    pops = [pop(shown[i - 1], shown[i], truth[i - 1], truth[i]) for i in (2, 5, 8)]
    assert min(pops) > 0.05
    assert loud["update_pop"] == {"frames": 3, "mean": pytest.approx(np.mean(pops)), "max": pytest.approx(max(pops))}
    again = compare_walk(dataset.path, tmp_path, WALK, options=replace(options, flip=False))
    assert all(one["update_pop"] is one["pop"] is None for one in again["techniques"].values())


def test_the_pops_that_are_measured_are_spread_over_the_walk_and_updates_are_none_of_switches():
    entered = FrameTimes(0.0, "", True, False, *[0.0] * 2, None, *[0.0] * 3, 0, 0, done=Done(Work(requests=1)))
    captured = replace(entered, entered=False)
    idle = replace(captured, done=Done())
    run = [idle] + 100 * [captured] + [entered] + 5 * [captured] + [idle, replace(captured, cut=True)]
    options = CompareOptions(techniques=("multi-mesh",), fade=0.1, frames_per_second=20.0)
    found = _popping(run, options)
    switch = {i: event for i, event in found.items() if not event.update}
    assert {i: event.frame for i, event in switch.items()} == {101: 101, 102: 101, 103: 101}
    updates = sorted(i for i, event in found.items() if event.update)
    assert len(updates) == 24
    assert updates[0] == 1 and updates[-1] == 106
    assert np.diff(updates).max() < 10
    assert _popping(run, replace(options, flip=False)) == {}
