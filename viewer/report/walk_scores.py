"""A walk walked again, all techniques side by side: what is wrong in some of its views, what pops, and films."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View
from mmi.foundation.progress import Progress
from mmi.walks.walk import Step
from viewer.cells.cell_cache import CellCache
from viewer.cells.scene_cache import cell_cache
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.drawing.renderer import Renderer
from viewer.measuring.judge import Judge, Scored
from viewer.measuring.view_errors import pop
from viewer.plan import Budget, Plan
from viewer.report.entries import by_technique, worst_views
from viewer.report.options import CompareOptions
from viewer.report.pictures import side_by_side
from viewer.report.video import VideoWriter
from viewer.runtime.loop import FrameTimes
from viewer.scene.scene import WalkScene
from viewer.techniques.catalogue import REFERENCE, make_technique

__all__ = ["WalkScores", "score_walk", "spread"]

_MOST_POPS = 24
"""The pop of at most this many changes of cells, and of updates, is measured, spread over the walk."""


@dataclass(frozen=True, slots=True, eq=False)
class WalkScores:
    """By technique ``scores`` of views, ``pops`` at changes of cells and ``update_pops`` in frames that captured something.

    ``worst`` views and names of ``videos`` are as the report has them.
    """

    scores: Mapping[str, Sequence[Scored]]
    pops: Mapping[str, Sequence[float]]
    update_pops: Mapping[str, Sequence[float]]
    worst: list[dict[str, Any]]
    videos: list[str]


def score_walk(
    main: WalkScene,
    scenes: Mapping[str, WalkScene],
    steps: Sequence[Step],
    runs: Mapping[str, Sequence[FrameTimes]],
    out: Path,
    options: CompareOptions,
    tell: Progress,
) -> WalkScores:
    """Walk again, and compare views spread over the walk.

    ``runs`` are the frames that were timed: what techniques were told then they are told again, so that plans are the same,
    and all that was captured is captured again.
    """
    chosen = set(spread(len(steps), options.scored))
    compared = [entry.name for entry in options.entries if entry.name != REFERENCE]
    popping = {entry.name: _popping(runs[entry.name], options) for entry in options.entries if entry.layered}
    around = {i + step for some in popping.values() for i in some for step in (-1, 0)}
    largest: dict[str, dict[_Event, float]] = {name: {} for name in popping}
    walkers = {
        entry.name: make_technique(entry, scenes, rules=options.rules, frames=options.mover_frames)
        for entry in options.entries
    }
    walkers[REFERENCE] = make_technique(REFERENCE, scenes)
    names = [REFERENCE, *compared]
    film = _Film(out, names, options)
    budgets = {name: [frame.budget for frame in runs[name]] for name in runs}
    untimed = Budget(1.0 / options.frames_per_second)
    size = (main.camera.width, main.camera.height)
    with (
        Renderer(
            main.mesh,
            main.ground,
            size=size,
            measured=True,
            samples=options.samples,
            movers=main.movers,
            glint=options.glint,
        ) as renderer,
        cell_cache(scenes, renderer, measured=True, capacity=options.cache) as cache,
        Judge(main, renderer, cache, keep=options.keep, flip=options.flip, workers=options.workers) as judge,
        film as add,
    ):
        before: dict[str, DrawnPicture] = {}
        for i, step in enumerate(steps):
            tell(step.index, len(steps), "frames scored")
            view = step.pose.view(main.camera)
            told = {name: budgets[name][i] if name in budgets else untimed for name in names}
            made = {name: walkers[name].plan(view, now=step.time, budget=told[name]) for name in names}
            plans = {name: _carried_out(plan, view, renderer, cache) for name, plan in made.items()}
            if step.index in chosen and compared:
                cell = main.whereabouts.cell_at(np.array(step.pose.eye), current=None)
                place = next((plan.place for plan in plans.values() if plan.place), cell)
                truth = judge.truth(plans[REFERENCE], step.pose, place)
                for name in compared:
                    judge.score(name, plans[name], step.pose, truth, cell=place, time=step.time)
            if step.index not in around and not film.wanted:
                continue
            shown = {}
            for name, plan in plans.items():
                if film.wanted or name in (REFERENCE, *popping):
                    cache.want(plan.cells)
                    cache.require(plan.cells)
                    shown[name] = renderer.draw(plan, view)
            for name, some in popping.items():
                if step.index in some and not step.cut:
                    event = some[step.index]
                    found = pop(before[name], shown[name], before[REFERENCE], shown[REFERENCE])
                    largest[name][event] = max(found, largest[name].get(event, -1.0))
            add([shown[name].color for name in names] if film.wanted else [])
            before = shown
        tell(len(steps), len(steps), "frames scored")
        scores = by_technique(judge.results())
        worst = worst_views(judge, compared, out)
    pops, update_pops = (
        {name: [value for event, value in some.items() if event.update == update] for name, some in largest.items()}
        for update in (False, True)
    )
    return WalkScores(scores, pops, update_pops, worst, film.files)


class _Event(NamedTuple):
    """What may pop: where the viewer comes into another cell, or an ``update``, from a ``frame`` on."""

    frame: int
    update: bool


def _popping(run: Sequence[FrameTimes], options: CompareOptions) -> dict[int, _Event]:
    """The frames whose pops are measured, and what may pop there; none without FLIP, of which pops are made.

    A change of cells pops in all frames of its fade, an update in its own.
    """
    if not options.flip:
        return {}
    entered = _some([i for i, frame in enumerate(run) if frame.entered], _MOST_POPS)
    fade = 1 + math.ceil(options.fade * options.frames_per_second)
    switches = {i: _Event(first, False) for first in sorted(entered) for i in range(first, first + fade)}
    captured = [
        i for i, frame in enumerate(run) if frame.done.requests.requests and not frame.cut and i not in switches
    ]
    return {i: _Event(i, True) for i in _some(captured, _MOST_POPS)} | switches


def _carried_out(plan: Plan, view: View, renderer: Renderer, cache: CellCache) -> Plan:
    """What is left of a plan when its requests are executed, and it was finished if it wants to be.

    Requests are orders: each is executed once, whether the frame is scored or not. So is finishing, from which the next frames
    go on.
    """
    if not plan.requests and not plan.drops and plan.finish is None:
        return plan
    cache.want(plan.cells)
    cache.require(plan.cells)
    if plan.finish is not None:
        renderer.draw(plan, view, read=False)  # which executes requests as well
    else:
        renderer.execute(plan)
    return replace(plan, requests=(), drops=())


class _Film:
    """The film of a walk, where one is wanted: all techniques side by side. A context manager that yields what takes frames."""

    def __init__(self, out: Path, names: Sequence[str], options: CompareOptions) -> None:
        self.wanted = options.video is not None
        self.files: list[str] = []
        self._names = list(names)
        self._path = out / f"walk.{options.video}"
        self._rate = options.frames_per_second
        self._writer: VideoWriter | None = None

    def __enter__(self) -> Callable[[Sequence[NDArray[np.uint8]]], None]:
        return self._add

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._writer is not None:
            self._writer.__exit__(kind, value, trace)
            if kind is None:
                self.files.append(self._path.name)

    def _add(self, panels: Sequence[NDArray[np.uint8]]) -> None:
        if not self.wanted:
            return
        frame = side_by_side(panels, self._names)
        if self._writer is None:
            self._writer = VideoWriter(self._path, (frame.shape[1], frame.shape[0]), self._rate)
            self._writer.__enter__()
        self._writer.add(frame)


def spread(n: int, wanted: int) -> list[int]:
    """At most ``wanted`` of the numbers below ``n``, evenly spread."""
    return sorted(set(np.linspace(0, n - 1, min(n, wanted)).round().astype(int).tolist()))


def _some(values: Sequence[int], wanted: int) -> set[int]:
    return {values[i] for i in spread(len(values), wanted)} if values else set()
