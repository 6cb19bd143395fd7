"""The frame loop, which draws one frame when asked: it has a plan made, brings in what it needs, draws it and times it all.

    loop = FrameLoop(technique, painter, cache, camera=camera)
    frame = loop.frame(pose, time)          as often as a window, a held view or a replay wants one
    run_walk(steps, loop)                   all frames of a walk, one at once after the other
    replay(steps, budgets, technique)       the plans that were made then, without OpenGL

Where the viewer is comes from poses and times that are given, never from the clock. What a technique is told besides, of the
clock too, is the frame's :class:`viewer.plan.Budget`, which is recorded: a walk replayed with the recorded budgets gives the
same plans and pictures on any machine. What a frame took is the time from asking for its plan to the finished picture, loading
included.
"""

from __future__ import annotations

import math
import time as clock
from bisect import bisect_left, insort
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from mmi.foundation.camera import Camera, View
from mmi.walks.walk import Pose, Step
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.drawing.thread_turns import turns_after
from viewer.plan import Budget, CellKey, Costs, Done, Plan, Technique
from viewer.runtime.cost_model import CostModel

__all__ = ["Frame", "FrameLoop", "FrameTimes", "Loader", "Painter", "replay", "run_walk"]

_UPLOADING = 0.1
"""The share of a usual frame's time that uploads of cells ahead may take in a frame."""
_RECENT = 1024
"""The median of this many last frames says what a frame usually takes."""
_COSTLY = 1.2
"""Uploads of cells ahead wait for another frame where one took more than this many times the usual."""
_TURNS = 1.0
"""Seconds after which the loading thread may take the interpreter from a frame: what reads files may not give it back for
milliseconds. It gets it while OpenGL draws."""


class Painter(Protocol):
    """What draws plans: a renderer, or a test's double of one."""

    def prepare(self, plan: Plan, view: View) -> float:
        """Make what drawing ``plan`` for the first time makes, so that it takes no longer than later; the seconds that took."""
        ...

    def draw(self, plan: Plan, view: View, *, read: bool = True) -> DrawnPicture:
        """Draw ``plan`` as ``view`` sees it."""
        ...


class Loader(Protocol):
    """What brings in cells: a :class:`viewer.cells.cell_cache.CellCache`, or a share in one."""

    def want(self, needed: Iterable[CellKey], ahead: Iterable[CellKey] = ()) -> None:
        """Say what is needed now, and what may be needed next, most urgent first."""
        ...

    def require(self, cells: Iterable[CellKey], *, counted: bool = True) -> float:
        """Wait until ``cells`` can be drawn; the seconds that took."""
        ...

    def spend(self, seconds: float) -> float:
        """Upload what has arrived, for about as long; the seconds that took."""
        ...


@dataclass(frozen=True, slots=True)
class FrameTimes:
    """One frame of a walk: seconds ``total``, of which ``planning``, ``drawing``, ``uploading`` cells ahead and ``waiting``.

    ``gpu`` is what the GPU says of the drawing. ``entered``: the viewer is in another cell than in the last frame.
    ``planning`` is the making of the plan, which was told ``budget``; ``done`` says what the plan's requests and what its draws
    took of ``drawing``. ``loading`` is what a walk waits for before its first frame and where it is cut, as behind a loading
    screen: the plan, its cell and the one that it will most likely come to next, and what drawing for the first time takes; no
    part of ``total``, nor of ``planning``.
    """

    time: float
    cell: str
    entered: bool
    cut: bool
    total: float
    drawing: float
    gpu: float | None
    uploading: float
    waiting: float
    loading: float
    triangles: int
    draws: int
    planning: float = 0.0
    budget: Budget = field(default_factory=Budget)
    done: Done = field(default_factory=Done)


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A frame that was drawn: from where, by which plan, its picture, and what it took."""

    view: View
    plan: Plan
    picture: DrawnPicture
    times: FrameTimes


@dataclass(slots=True)
class _Usual:
    """What a frame usually takes: the median of the last ones."""

    recent: deque[float] = field(default_factory=deque)
    ranked: list[float] = field(default_factory=list)
    """The same frames, sorted."""

    def median(self, otherwise: float) -> float:
        return self.ranked[len(self.ranked) // 2] if self.ranked else otherwise

    def add(self, seconds: float) -> None:
        if len(self.recent) == _RECENT:
            del self.ranked[bisect_left(self.ranked, self.recent.popleft())]
        self.recent.append(seconds)
        insort(self.ranked, seconds)


class FrameLoop:
    """Draws frames of one viewer with one technique, when asked.

    ``budget`` is the time that a frame should take, ``updates`` what the requests of its plan should take of it at most, in
    seconds. ``costs`` is what drawing is believed to take before the first frame (:mod:`viewer.runtime.calibration` finds it);
    what frames took refines it. ``cache`` brings in the cells that plans need, into what ``painter`` draws from. Frames are
    asked for in the order of their times. Other threads may take the interpreter from a frame after ``turns`` seconds.
    ``camera`` and ``updates`` may be changed between frames.
    """

    def __init__(
        self,
        technique: Technique,
        painter: Painter,
        cache: Loader,
        *,
        camera: Camera,
        budget: float = 1.0 / 30.0,
        updates: float = math.inf,
        costs: Costs | None = None,
        turns: float = _TURNS,
    ) -> None:
        self._technique, self._painter, self._cache = technique, painter, cache
        self.camera, self.updates = camera, updates
        self._budget, self._turns = budget, turns
        self._last: FrameTimes | None = None
        self._usual = _Usual()
        self._model = CostModel() if costs is None else CostModel(costs)

    @property
    def costs(self) -> Costs:
        """What drawing is believed to take now."""
        return self._model.costs

    def frame(self, pose: Pose, time: float, *, cut: bool = False, read: bool = False) -> Frame:
        """Draw what the viewer sees from ``pose`` at ``time`` (seconds), with its colours if ``read``.

        ``cut`` says that the viewer was put here and did not come from where it was; so it is in the first frame. A pose that
        is asked for again is a view that is held. Raises DatasetError where a cell's files are missing or damaged.
        """
        last = self._last
        cut = cut or last is None
        view = pose.view(self.camera)
        budget = self._next_budget()
        with turns_after(self._turns):
            start = clock.perf_counter()
            plan = self._technique.plan(view, now=time, budget=budget)
            self._cache.want(plan.cells, plan.ahead)
            planned = clock.perf_counter() - start
            loading = 0.0
            if cut:
                loading = planned + self._cache.require((*plan.cells, *plan.ahead[:1]), counted=False)
                loading += self._painter.prepare(plan, view)
                planned = 0.0
            waiting = self._cache.require(plan.cells)
            picture = self._painter.draw(plan, view, read=read)
            spent = planned + waiting + picture.seconds
            usual = self._usual.median(spent)
            room = _UPLOADING * usual
            if plan.requests:  # they fill the frame on purpose
                room = min(room, max(self._budget - spent, 0.0))
            uploading = self._cache.spend(room) if spent <= _COSTLY * usual else 0.0
        self._usual.add(spent)
        self._model = self._model.after(picture.done, planning=planned, target=self._budget, updates=self.updates)
        self._last = FrameTimes(
            time=time,
            cell=plan.place,
            entered=not cut and last is not None and plan.place != last.cell,
            cut=cut,
            total=spent + uploading,
            drawing=picture.seconds,
            gpu=picture.gpu_seconds,
            uploading=uploading,
            waiting=waiting,
            loading=loading,
            triangles=picture.triangles,
            draws=picture.draws,
            planning=planned,
            budget=budget,
            done=picture.done,
        )
        return Frame(view, plan, picture, self._last)

    def _next_budget(self) -> Budget:
        """What the next plan is told. Uploads are seldom alone: they are expected to take what they took in the last frame."""
        costs = self._model.costs
        if self._last is None:
            return Budget(self._budget, self.updates, costs)
        costs = costs._replace(frame=costs.frame + self._last.uploading)
        return Budget(self._budget, self.updates, costs, self._last.done)


def replay(steps: Iterable[Step], budgets: Iterable[Budget], technique: Technique, *, camera: Camera) -> Iterator[Plan]:
    """The plans of a walk whose budgets were recorded (:attr:`FrameTimes.budget`), by a ``technique`` that is fresh.

    Raises ValueError where there are not as many budgets as steps.
    """
    for step, budget in zip(steps, budgets, strict=True):
        yield technique.plan(step.pose.view(camera), now=step.time, budget=budget)


def run_walk(
    steps: Sequence[Step],
    loop: FrameLoop,
    *,
    read: bool = False,
    shown: Callable[[Step, Frame], None] | None = None,
) -> list[FrameTimes]:
    """Draw every step of a walk, each at once after the last. Returns what each frame took.

    ``shown`` gets each frame after it was timed, with its colours if ``read``. Raises DatasetError where a cell's files are
    missing or damaged.
    """
    times: list[FrameTimes] = []
    for step in steps:
        frame = loop.frame(step.pose, step.time, cut=step.cut, read=read)
        times.append(frame.times)
        if shown is not None:
            shown(step, frame)
    return times
