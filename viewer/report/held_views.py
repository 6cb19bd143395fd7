"""Views that are held: a technique draws the same view frame after frame, timed first and then scored (DESIGN section 6).

    hold_view     draw the frames, time them, and record the budgets they were planned with
    held_again    plan them once more with the budgets that were recorded, and so draw the same: what is scored
    alike_after   after how many of them the picture is like the geometry's

Nothing is known of a viewer who was put into a view, so each view wants a fresh technique. What comes to the picture while the
viewer stands is what requests capture and what plans find when they finish. A technique that has neither shows the same in
every frame.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

from mmi.foundation.camera import View
from viewer.cells.cell_cache import CellCache
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.drawing.renderer import Renderer
from viewer.measuring.view_errors import alike
from viewer.plan import Budget, CellLayers, Costs, Done, Plan, Technique
from viewer.runtime.cost_model import CostModel

__all__ = [
    "HeldFrame",
    "HeldView",
    "alike_after",
    "held_again",
    "hold_view",
    "layers_shown",
    "settled_after",
    "settled_frames",
]

_PATIENT = 3600.0
"""Seconds for a frame that has time for everything."""
_TIMINGS = 3
"""A view of a single frame is drawn this many times, and the median of its times counts."""


@dataclass(frozen=True, slots=True)
class HeldFrame:
    """A frame of a held view, at ``time`` seconds, and the ``budget`` that it was planned with.

    ``seconds`` is what planning and drawing took. The first frame is planned as behind a loading screen, since the viewer comes
    into a cell there: what that takes does not count. ``gpu`` is what the GPU says of the drawing; ``done`` is what requests
    and draws took apart from each other.
    """

    time: float
    budget: Budget
    seconds: float
    gpu: float | None
    done: Done


@dataclass(frozen=True, slots=True, eq=False)
class HeldView:
    """The frames of a held view and their plans; ``costs`` is what drawing is believed to take after the last one."""

    frames: tuple[HeldFrame, ...]
    plans: tuple[Plan, ...]
    costs: Costs


def hold_view(
    technique: Technique,
    renderer: Renderer,
    cache: CellCache,
    view: View,
    *,
    frames: int,
    frames_per_second: float = 30.0,
    updates: float = math.inf,
    costs: Costs | None = None,
) -> HeldView:
    """Draw ``frames`` frames of ``view`` with a fresh technique. Updates may take ``updates`` seconds of each at most.

    ``costs`` is what drawing is believed to take, which the frames refine. Cells are waited for beforehand, which does not
    count. Nothing that was captured is left. Raises DatasetError where a cell's files are missing or damaged.
    """
    model = CostModel() if costs is None else CostModel(costs)
    budget = Budget(1.0 / frames_per_second, updates, model.costs)
    plans: list[Plan] = []
    found: list[HeldFrame] = []
    for number in range(frames):
        time = number / frames_per_second
        start = clock.perf_counter()
        plan = technique.plan(view, now=time, budget=budget)
        planning = clock.perf_counter() - start
        _load(cache, plan)
        again = _TIMINGS if frames == 1 and plan.finish is None else 1  # finishing is over when it was done once
        picture = _typical(renderer.draw(plan, view, read=False) for _ in range(again))
        planning = planning if number else 0.0
        found.append(HeldFrame(time, budget, planning + picture.seconds, picture.gpu_seconds, picture.done))
        plans.append(plan)
        model = model.after(picture.done, planning=planning, target=budget.frame, updates=updates)
        budget = replace(budget, costs=model.costs, done=picture.done)
    _forget(renderer, plans)
    return HeldView(tuple(found), tuple(plans), model.costs)


@contextmanager
def held_again(
    technique: Technique, renderer: Renderer, cache: CellCache, view: View, held: HeldView
) -> Iterator[Iterator[tuple[Plan, bool]]]:
    """Plan the frames of ``held`` again with a fresh technique, and capture what they ask for. Yields the plans, one by one.

    They are those of ``held``, because they follow from its budgets. Requests were executed when a plan comes, so that it has
    none; with it comes whether it had some. What was captured is forgotten in the end. Raises DatasetError where a cell's files
    are missing or damaged.
    """
    plans: list[Plan] = []

    def again() -> Iterator[tuple[Plan, bool]]:
        for frame in held.frames:
            plan = technique.plan(view, now=frame.time, budget=frame.budget)
            plans.append(plan)
            _load(cache, plan)
            renderer.execute(plan)
            yield replace(plan, requests=(), drops=()), bool(plan.requests) or plan.finish is not None
            if plan.finish is not None and frame is not held.frames[-1]:
                renderer.draw(replace(plan, requests=(), drops=()), view, read=False)  # the next goes on from there

    try:
        yield again()
    finally:
        _forget(renderer, plans)


def alike_after(
    plans: Iterable[tuple[Plan, bool]], renderer: Renderer, view: View, truth: DrawnPicture
) -> tuple[Plan, int | None]:
    """The last of ``plans`` (:func:`held_again`), and how many come before the first whose picture is like ``truth``.

    None where none is (:func:`viewer.measuring.view_errors.alike`).
    """
    last: Plan | None = None
    after = None
    for number, (plan, asked) in enumerate(plans):
        if after is None and (asked or last is None or not plan.same_as(last)):
            after = number if alike(truth, renderer.draw(plan, view, measured=True)) else None
        last = plan
    assert last is not None, "a view is held for a frame at least"
    return last, after


def settled_frames(
    technique: Technique, renderer: Renderer, cache: CellCache, view: View, held: HeldView
) -> int | None:
    """After how many frames ``held`` had settled (:func:`settled_after`), by the technique that planned it.

    It is asked for one more plan, for a frame that has time for everything; but where updates were forbidden they still are.
    What finishing finds in a frame counts like a request: where this one still finds something, the view has not settled.
    """
    last = held.frames[-1]
    more = math.inf if last.budget.updates > 0.0 else 0.0
    budget = replace(last.budget, frame=_PATIENT, updates=more, costs=held.costs, done=last.done)
    patient = technique.plan(view, now=last.time + last.budget.frame, budget=budget)
    after = settled_after(held.plans, patient)
    if after is None or patient.finish is None:
        return after
    _load(cache, patient)
    if last.done.fresh or renderer.draw(replace(patient, drops=()), view, read=False).done.fresh:
        return None
    return max([after, *(number + 1 for number, frame in enumerate(held.frames) if frame.done.fresh)])


def settled_after(plans: Sequence[Plan], patient: Plan) -> int | None:
    """How many of ``plans`` come before the first from which on they have no requests and stay the same.

    ``patient`` is the next plan, of a frame that has time for everything: where it has requests, the last plans had none only
    because there was no time for any. None where the view has not settled. That images are dropped makes no plan another.
    """
    end, count = replace(patient, drops=()), len(plans)
    while count and not end.requests and replace(plans[count - 1], drops=()).same_as(end):
        count -= 1
    return count if count < len(plans) else None


def layers_shown(plan: Plan) -> int:
    """How many layers a plan draws, those of each sector counted apart. The pieces of a layer (``s0.l2.1``) are one layer."""
    drawn = (draw for draw in plan.draws if isinstance(draw, CellLayers))
    return len({(draw.cell, *name.split(".")[:2]) for draw in drawn for name in draw.names})


def _load(cache: CellCache, plan: Plan) -> None:
    cache.want(plan.cells)
    cache.require(plan.cells)


def _forget(renderer: Renderer, plans: Iterable[Plan]) -> None:
    """Drop all images that plans had captured."""
    images = dict.fromkeys(request.into.image for plan in plans for request in plan.requests)
    if images:
        renderer.execute(Plan((), drops=tuple(images)))


def _typical(pictures: Iterable[DrawnPicture]) -> DrawnPicture:
    """The one of the median time."""
    ranked = sorted(pictures, key=lambda picture: picture.seconds)
    return ranked[len(ranked) // 2]
