"""The frame loop with a painter that draws nothing: what it asks for, and when."""

import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from techniques_drawn import OF_DATASETS

from mmi.walks.walk import Keyframe, Pose, Walk
from viewer.cells.scene_cache import cell_cache
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.plan import Budget, Costs, Done, ImageKey, Plan, Request, Sky, Slot, Work
from viewer.runtime.cost_model import CostModel
from viewer.runtime.loop import FrameLoop, replay, run_walk
from viewer.techniques.catalogue import make_technique

WALK = Walk(
    "east and north",
    (
        Keyframe(0.0, Pose((2.0, 0.0, 1.7), 0.0, 0.0)),
        Keyframe(12.0, Pose((110.0, 0.5, 1.7), 0.3, 0.0)),
        Keyframe(12.0, Pose((0.0, 20.0, 1.7), 1.5, 0.0), cut=True),
        Keyframe(16.0, Pose((0.0, 100.0, 1.7), 1.5, 0.1)),
    ),
)


class Painter:
    """Remembers what it was asked to draw, and checks that it could."""

    def __init__(self):
        self.plans, self.there = [], {}

    def upload_layer(self, cell, layer):
        self.there.setdefault(cell.key, set()).add(layer.name)
        return True

    def evict(self, cell):
        self.there.pop(cell, None)

    def prepare(self, plan, view):  # noqa: ARG002
        return 0.0

    def draw(self, plan, view, *, read=True):  # noqa: ARG002
        for draw in plan.draws:
            if hasattr(draw, "names"):
                assert set(draw.names) <= self.there.get(draw.cell, set()), "drawn before it was there"
        self.plans.append(plan)
        return DrawnPicture(np.empty((0, 0, 3), np.uint8), None, None, None, 0.001, None, 10, 2)


def run(scenes, name, *, capacity=1 << 30, slowly=0.0, patient=False):
    """``slowly``: seconds between frames; ``patient``: as long as it takes until all cells ahead are there."""
    painter = Painter()
    seen = []

    def between_frames(step, frame):
        seen.append(step.index)
        time.sleep(slowly)
        end = time.monotonic() + 60.0
        while patient and not all(cache.holds(cell) for cell in frame.plan.ahead):
            assert time.monotonic() < end
            cache.spend(1.0)
            time.sleep(0.001)

    with cell_cache(scenes, painter, capacity=capacity) as cache:
        loop = FrameLoop(make_technique(name, scenes), painter, cache, camera=scenes["multi-mesh"].camera)
        times = run_walk(WALK.frames(10.0), loop, shown=between_frames)
        report = cache.report
    assert seen == list(range(len(times)))
    return painter, times, report


@pytest.fixture
def scenes(scene, single):
    return {"multi-mesh": scene, "single-mesh": single}


@pytest.mark.parametrize("name", OF_DATASETS)
def test_a_walk_replayed_gives_the_same_plans_whatever_the_loading(scenes, name):
    first, times, _ = run(scenes, name)
    second, again, _ = run(scenes, name, capacity=1, slowly=0.002)
    assert len(first.plans) == len(WALK.frames(10.0)) == len(times)
    assert all(a.same_as(b) for a, b in zip(first.plans, second.plans, strict=True))
    assert [(one.cell, one.entered, one.cut) for one in times] == [(one.cell, one.entered, one.cut) for one in again]


def test_cells_are_there_before_they_are_entered_when_there_is_time(scenes):
    _, times, report = run(scenes, "multi-mesh", patient=True)
    assert sum(one.entered for one in times) >= 3
    assert report.waits == 0
    assert all(one.waiting == 0.0 for one in times)


def test_without_memory_for_cells_ahead_each_is_waited_for_once(scenes):
    _, times, report = run(scenes, "multi-mesh", capacity=1, slowly=0.005)
    entered = sum(one.entered for one in times)
    assert report.waits == entered
    assert [one.waiting > 0.0 for one in times] == [one.entered for one in times]
    assert report.largest_bytes > 0


def test_a_walk_waits_at_its_start_and_where_it_is_cut_and_says_so_apart(scenes):
    _, times, _ = run(scenes, "multi-mesh", capacity=1)
    cuts = [i for i, one in enumerate(times) if one.cut]
    assert cuts == [0, 120]
    for i in cuts:
        assert times[i].loading > 0.0
        assert times[i].waiting == 0.0
        assert times[i].total < times[i].loading + 1.0
    assert all(one.loading == 0.0 for i, one in enumerate(times) if i not in cuts)


class Spender:
    """A cache that has everything, and remembers in which frames it was given time for uploads."""

    def __init__(self, painter):
        self.painter, self.frames = painter, []

    def want(self, needed, ahead=()):
        pass

    def require(self, cells, *, counted=True):  # noqa: ARG002
        return 0.0

    def spend(self, seconds):  # noqa: ARG002
        self.frames.append(len(self.painter.plans))
        return 0.0


def test_uploads_ahead_wait_for_frames_that_take_no_longer_than_usual(scenes):
    def seconds(frame):
        return 5.0 if frame % 10 in (7, 8, 9) or frame >= 100 else 1.0

    class Scripted(Painter):
        def draw(self, plan, view, *, read=True):
            frame = super().draw(Plan(()), view, read=read)
            return replace(frame, seconds=seconds(len(self.plans) - 1), triangles=len(plan.draws))

    painter = Scripted()
    cache = Spender(painter)
    technique = make_technique("multi-mesh", scenes)
    times = run_walk(WALK.frames(10.0), FrameLoop(technique, painter, cache, camera=scenes["multi-mesh"].camera))
    slow = {i for i in range(len(times)) if seconds(i) == 5.0}
    given = {frame - 1 for frame in cache.frames}  # after it was drawn
    assert not given & {i for i in slow if i <= 100}
    assert set(range(100)) - slow <= given
    assert {i for i in slow if i >= 150} <= given  # by then, that is what a frame takes


def test_a_frame_is_the_sum_of_its_parts(scenes):
    _, times, _ = run(scenes, "multi-mesh")
    for one in times:
        assert one.drawing == 0.001
        assert one.total >= one.drawing + one.uploading + one.waiting
        assert (one.triangles, one.draws) == (10, 2)


def loop_of(scenes, name, cache, painter):
    return FrameLoop(make_technique(name, scenes), painter, cache, camera=scenes["multi-mesh"].camera)


@pytest.mark.parametrize("name", OF_DATASETS)
def test_stepping_by_hand_is_the_walk(scenes, name):
    """Poses and times asked for one by one, without a word of cuts but the one that is there, give the walk's frames."""
    whole, times, _ = run(scenes, name)
    painter = Painter()
    with cell_cache(scenes, painter) as cache:
        loop = loop_of(scenes, name, cache, painter)
        frames = [loop.frame(step.pose, step.time, cut=step.index == 120) for step in WALK.frames(10.0)]
    assert all(a.same_as(b) for a, b in zip(whole.plans, painter.plans, strict=True))
    assert all(frame.plan is plan for frame, plan in zip(frames, painter.plans, strict=True))
    told = [(one.time, one.cell, one.entered, one.cut) for one in times]
    assert [(one.times.time, one.times.cell, one.times.entered, one.times.cut) for one in frames] == told


def test_a_view_that_is_held_shows_the_same_and_loads_what_is_ahead(scenes):
    pose = WALK.keyframes[0].pose
    painter = Painter()
    with cell_cache(scenes, painter) as cache:
        loop = loop_of(scenes, "multi-mesh", cache, painter)
        first = loop.frame(pose, 0.0)
        end, held = time.monotonic() + 60.0, []
        while len(held) < 3 or not all(cache.holds(cell) for cell in first.plan.ahead):
            assert time.monotonic() < end
            held.append(loop.frame(pose, 0.1 * (len(held) + 1)))
            time.sleep(0.01)
        report = cache.report
    assert first.times.cut, "the first frame is where the viewer was put"
    assert not any(one.times.cut or one.times.entered or one.times.waiting or one.times.loading for one in held)
    assert all(one.plan.draws[1:] == first.plan.draws[1:] and one.plan.place == first.plan.place for one in held)
    assert report.cells_loaded == 1 + len(first.plan.ahead)


def test_frames_that_are_replayed_have_the_same_plans(scenes):
    """What a window's viewer did, asked for again in another rhythm and with another cache."""
    asked = [(step.pose, step.time) for step in WALK.frames(4.0)] + [
        (WALK.keyframes[-1].pose, 17.0 + i) for i in range(3)
    ]
    plans = []
    for capacity in (1 << 30, 1):
        painter = Painter()
        with cell_cache(scenes, painter, capacity=capacity) as cache:
            loop = loop_of(scenes, "multi-mesh", cache, painter)
            plans.append([loop.frame(pose, at).plan for pose, at in asked])
    assert all(a.same_as(b) for a, b in zip(*plans, strict=True))


class Curious:
    """A technique that draws nothing and remembers what it was told."""

    name = "curious"

    def __init__(self):
        self.told = []

    def plan(self, view, *, now, budget):  # noqa: ARG002
        self.told.append((now, budget))
        return Plan(())


class Timed(Painter):
    """Says of each frame that its requests and draws took so long, ever longer."""

    def draw(self, plan, view, *, read=True):
        frame = super().draw(plan, view, read=read)
        n = len(self.plans)
        return replace(frame, done=Done(Work(1e-3 * n, 10, 1, 100, 1), Work(2e-3 * n, 1000, 4)))


def test_a_technique_is_told_what_the_last_frame_took(scenes):
    technique, painter = Curious(), Timed()
    loop = FrameLoop(
        technique, painter, Spender(painter), camera=scenes["multi-mesh"].camera, budget=0.02, updates=0.003
    )
    took = [loop.frame(WALK.keyframes[0].pose, float(at)).times for at in range(3)]
    assert [at for at, _ in technique.told] == [0.0, 1.0, 2.0]
    budgets = [budget for _, budget in technique.told]
    assert [(one.frame, one.updates, one.done) for one in budgets] == [
        (0.02, 0.003, None),
        (0.02, 0.003, took[0].done),
        (0.02, 0.003, took[1].done),
    ]
    assert took[1].done.draws.seconds == 0.004
    assert [one.budget for one in took] == budgets


def test_costs_are_those_given_until_frames_refine_them(scenes):
    given = Costs(1e-3, 1e-5, 1e-7, 1e-4, 1e-8, 1e-8, 1e-7)
    technique, painter = Curious(), Timed()
    loop = FrameLoop(technique, painter, Spender(painter), camera=scenes["multi-mesh"].camera, costs=given)
    frames = [loop.frame(WALK.keyframes[0].pose, float(at)).times for at in range(3)]
    model = CostModel(given)
    for frame, (_, budget) in zip(frames, technique.told, strict=True):
        assert budget.costs == model.costs
        model = model.after(frame.done, planning=frame.planning)
    assert loop.costs == model.costs != given


def test_uploads_are_expected_to_go_on_and_are_part_of_what_a_frame_costs(scenes):
    class Busy(Spender):
        def spend(self, seconds):  # noqa: ARG002
            return 0.5

    technique, painter = Curious(), Painter()  # which times nothing, so that costs stay as they are
    loop = FrameLoop(technique, painter, Busy(painter), camera=scenes["multi-mesh"].camera)
    for at in range(2):
        loop.frame(WALK.keyframes[0].pose, float(at))
    first, second = (budget.costs for _, budget in technique.told)
    assert second == first._replace(frame=first.frame + 0.5)


def test_what_is_made_ready_where_the_viewer_is_put_is_no_part_of_a_frame(scenes):
    """A technique's first plan, for which much is compiled and read, is made behind the loading screen."""

    class Slow(Curious):
        def plan(self, view, *, now, budget):
            time.sleep(0.05)
            return super().plan(view, now=now, budget=budget)

    painter = Painter()
    loop = FrameLoop(Slow(), painter, Spender(painter), camera=scenes["multi-mesh"].camera)
    pose = WALK.keyframes[0].pose
    first, then, cut = (loop.frame(pose, at, cut=at == 2.0).times for at in (0.0, 1.0, 2.0))
    for one in (first, cut):
        assert one.loading >= 0.05 > one.total
        assert one.planning == 0.0
    assert then.loading == 0.0
    assert then.total >= then.planning >= 0.05


class Updating:
    """Captures as many small pictures as fit into a budget, and shows what it captured: plans depend on all that it is told."""

    name = "updating"

    def __init__(self):
        self.captured = 0

    def plan(self, view, *, now, budget):  # noqa: ARG002
        costs = budget.costs
        small = view.cropped((0, 0, 16, 16))
        left = min(budget.updates, budget.frame - costs.of_draws(triangles=1000, draws=4))
        requests = []
        while (left := left - costs.of_request(triangles=10, draws=1, pixels=256)) > 0.0 and len(requests) < 50:
            requests.append(Request(Slot(ImageKey(self.name, f"{self.captured}"), (16, 16)), small, (Sky(),)))
            self.captured += 1
        return Plan((Sky(),), requests=tuple(requests))


def test_a_recorded_walk_yields_its_plans_without_a_painter(scenes):
    rng = np.random.default_rng(3)

    class Noisy(Painter):
        def draw(self, plan, view, *, read=True):
            frame = super().draw(plan, view, read=read)
            n = len(plan.requests)
            captured = Work(n * 1e-3 * rng.random(), 10 * n, n, 256 * n, n)
            return replace(frame, done=Done(captured, Work(5e-3 * rng.random(), 1000, 4)))

    painter, steps = Noisy(), WALK.frames(10.0)
    camera = scenes["multi-mesh"].camera
    times = run_walk(steps, FrameLoop(Updating(), painter, Spender(painter), camera=camera, updates=0.004))
    assert len({len(plan.requests) for plan in painter.plans}) > 3, "what frames take should matter"
    again = list(replay(steps, [one.budget for one in times], Updating(), camera=camera))
    assert all(a.same_as(b) for a, b in zip(painter.plans, again, strict=True))
    without = list(replay(steps, [Budget()] * len(steps), Updating(), camera=camera))
    assert not all(a.same_as(b) for a, b in zip(painter.plans, without, strict=True))


def test_a_recording_of_another_walk_is_refused(scenes):
    steps = WALK.frames(10.0)
    with pytest.raises(ValueError, match="shorter"):
        list(replay(steps, [Budget()], Updating(), camera=scenes["multi-mesh"].camera))


def test_where_requests_fill_a_frame_uploads_have_what_is_left_of_it(scenes):
    given = []

    class Curbed(Spender):
        def spend(self, seconds):
            given.append(seconds)
            return 0.0

    class Slow(Painter):
        def draw(self, plan, view, *, read=True):
            return replace(super().draw(plan, view, read=read), seconds=0.5)

    camera, pose = scenes["multi-mesh"].camera, WALK.keyframes[0].pose
    for technique, budget in ((Updating(), 0.51), (Updating(), 0.4), (Curious(), 0.4)):
        painter = Slow()
        FrameLoop(technique, painter, Curbed(painter), camera=camera, budget=budget).frame(pose, 0.0)
    assert given[0] == pytest.approx(0.01)
    assert given[1] == 0.0
    assert given[2] == pytest.approx(0.05)


def test_what_is_drawn_for_the_first_time_is_made_behind_the_loading_screen(scenes):
    class Prepared(Painter):
        def __init__(self):
            super().__init__()
            self.prepared = []

        def prepare(self, plan, view):  # noqa: ARG002
            self.prepared.append(len(self.plans))
            return 0.25

    painter, steps = Prepared(), WALK.frames(10.0)
    loop = FrameLoop(Curious(), painter, Spender(painter), camera=scenes["multi-mesh"].camera)
    times = run_walk(steps, loop)
    assert painter.prepared == [i for i, step in enumerate(steps) if step.cut or not i]
    assert [one.loading >= 0.25 for one in times] == [one.cut for one in times]
    assert all(one.total < 0.25 for one in times)


def test_a_window_changes_its_camera_its_budget_and_the_turns(scenes):
    """Between frames; other threads get the interpreter within a window's turns, and the usual ones are back afterwards."""
    painter, turns = Painter(), []
    draw = painter.draw

    def noting(plan, view, *, read=True):
        turns.append(sys.getswitchinterval())
        return draw(plan, view, read=read)

    painter.draw = noting
    camera = scenes["multi-mesh"].camera
    with cell_cache(scenes, painter, capacity=1 << 30) as cache:
        usual = sys.getswitchinterval()
        loop = FrameLoop(make_technique("full", scenes), painter, cache, camera=camera, updates=0.25, turns=2e-3)
        pose = WALK.keyframes[0].pose
        frame = loop.frame(pose, 0.0)
        assert (frame.times.budget.updates, frame.view.window[2:]) == (0.25, (camera.width, camera.height))
        loop.updates, loop.camera = 0.0, replace(camera, width=2 * camera.width)
        frame = loop.frame(pose, 0.1)
        assert (frame.times.budget.updates, frame.view.window[2:]) == (0.0, (2 * camera.width, camera.height))
    assert turns == [pytest.approx(2e-3)] * 2
    assert sys.getswitchinterval() == usual
