"""A walk that is walked again to be scored: with the plans that were timed, and all that those had captured."""

import numpy as np
import pytest

from viewer.drawing.renderer import Renderer
from viewer.plan import ImageKey, Objects, Plan, Relief, ReliefPart, Request, Sky, Slot
from viewer.report.compare import CompareOptions, compare_walk
from viewer.walks.walk import Keyframe, Pose, Walk

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
