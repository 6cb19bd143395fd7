"""What time for updates buys: errors and frame times of multi-mesh-dynamic by its budget, on a slow, a normal and a fast walk.

    python benchmarks/budgets.py out/montmartre -o out/budgets
    python benchmarks/budgets.py out/helsinki -o out/budgets --excerpts 1 --frames 20 --scored 5 --speeds 5     # in a hurry

Each walk is made of excerpts of a tour, which have the same places at every speed. With every budget each step is drawn by
multi-mesh-dynamic and by multi-mesh, which of them is first changing from step to step: so both meet the same moments of the
machine. They share a renderer, which measures nothing, and the cells in memory. Then the walk is planned once more with the
budgets that techniques were told, and so are the same plans (the program checks that); pictures of them are compared with those
of the geometry. Intervals hold 95 of 100 means of resampled blocks of the walk.

*Does the budget hold?* A frame is late that takes more than 1.1 times its target; those of multi-mesh are held against the same
targets. The target of the frame loop, and of the criterion, is --fps. Strictly, it is what multi-mesh usually takes there (the
median of its frames within a quarter of a second) and the budget, but no more than --fps leaves. At a budget of 0 both draw the
same plans, so what differs there is noise.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from walks import excerpts, mean_interval

from mmi.dataset.reading import open_dataset
from mmi.inspection.figures import SMALL, new_figure, save, tidy
from mmi.walks.walk import Step
from viewer.cells.scene_cache import cell_cache
from viewer.drawing.renderer import Renderer
from viewer.measuring.judge import Judge
from viewer.measuring.view_errors import ViewErrors
from viewer.plan import Budget, Plan, Technique
from viewer.runtime.calibration import calibrated
from viewer.runtime.cost_model import LATE
from viewer.runtime.loop import FrameLoop, FrameTimes, replay
from viewer.scene.scene import WalkScene, open_scene
from viewer.techniques.catalogue import make_technique
from viewer.techniques.dynamic import DynamicImpostors

STORED = "multi-mesh"
MEASURES = {
    "thickness px": lambda one: one.thickness_px,
    "FLIP": lambda one: one.flip_mean,
    "wrong %": lambda one: 100.0 * one.wrong_share,
}
_AROUND = 0.25
"""Seconds of the walk before and after a frame that say what multi-mesh usually takes there."""
_GEOMETRY = 10
"""Every so many frames the geometry is drawn too, beside the first budget."""
_WALKS = ("slow", "normal", "fast")
_COLORS = ("#0072B2", "#009E73", "#D55E00")


class AtBudget(DynamicImpostors):
    """multi-mesh-dynamic under a name of its own, which its images have too: one renderer scores all."""

    def __init__(self, scene: WalkScene, budget: float) -> None:
        super().__init__(scene)
        self.name = f"{DynamicImpostors.name} {budget:g}"


@dataclass(frozen=True, slots=True, eq=False)
class Walked:
    """A walk's frames by technique: times, plans, and the times of multi-mesh beside it. Milliseconds of the geometry."""

    steps: Sequence[Step]
    times: Mapping[str, Sequence[FrameTimes]]
    beside: Mapping[str, Sequence[FrameTimes]]
    plans: Mapping[str, Sequence[Plan]]
    full: NDArray[np.float64]


def techniques(scene: WalkScene, budgets: Sequence[float]) -> dict[str, tuple[Technique, float]]:
    """Fresh techniques by what tables call them, and seconds that their updates may take."""
    found: dict[str, tuple[Technique, float]] = {STORED: (make_technique(STORED, {STORED: scene}), 0.0)}
    return found | {f"{budget:g} ms": (AtBudget(scene, budget), 1e-3 * budget) for budget in budgets}


def walked(scene: WalkScene, steps: Sequence[Step], budgets: Sequence[float], fps: float, told: str) -> Walked:
    """Walk once with each budget, each time every step by multi-mesh too."""
    found = [
        walked_beside(scene, steps, budget, fps, f"{told}, {budget:g} ms", full=not i)
        for i, budget in enumerate(budgets)
    ]
    print(file=sys.stderr)
    times = {name: one.times[name] for one in found for name in one.times if name != STORED}
    plans = {name: one.plans[name] for one in found for name in one.plans if name != STORED}
    return Walked(
        steps,
        {STORED: [frame for one in found for frame in one.times[STORED]]} | times,
        {name: one.times[STORED] for one in found for name in one.times if name != STORED},
        {STORED: found[0].plans[STORED]} | plans,
        np.concatenate([one.full for one in found]),
    )


def walked_beside(
    scene: WalkScene, steps: Sequence[Step], budget: float, fps: float, told: str, *, full: bool
) -> Walked:
    """Walk with multi-mesh and one of the budgets, a step by each of them in turn, with nothing on the GPU at first.

    With ``full`` the geometry is drawn now and then.
    """
    made = techniques(scene, [budget])
    names = list(made)
    times: dict[str, list[FrameTimes]] = {name: [] for name in names}
    plans: dict[str, list[Plan]] = {name: [] for name in names}
    geometry: list[float] = []
    reference = make_technique("full", {STORED: scene})
    size = (scene.camera.width, scene.camera.height)
    with (
        Renderer(scene.mesh, scene.ground, size=size) as renderer,
        cell_cache({STORED: scene}, renderer) as cache,
    ):
        known = calibrated(renderer, scene)
        loops = {
            name: FrameLoop(
                technique, renderer, cache, camera=scene.camera, budget=1.0 / fps, updates=updates, costs=known
            )
            for name, (technique, updates) in made.items()
        }
        turn = 0
        for i, step in enumerate(steps):
            turn += 2 if step.cut else 1  # so that excerpts do not all begin with the same one
            for name in names if turn % 2 else reversed(names):
                frame = loops[name].frame(step.pose, step.time, cut=step.cut)
                times[name].append(frame.times)
                plans[name].append(frame.plan)
            if full and i % _GEOMETRY == 0:
                view = step.pose.view(scene.camera)
                plan = reference.plan(view, now=step.time, budget=Budget())
                geometry.append(1e3 * renderer.draw(plan, view, read=False).seconds)
            print(f"\r{told}: {i + 1} of {len(steps)} frames timed  ", end="", file=sys.stderr, flush=True)
    return Walked(steps, times, {}, plans, np.array(geometry))


def scored(
    scene: WalkScene, renderer: Renderer, walk: Walked, budgets: Sequence[float], every: int, workers: int, told: str
) -> dict[str, list[ViewErrors]]:
    """Plan the walk again, and compare every so-manieth frame of all techniques with the geometry."""
    reference = make_technique("full", {STORED: scene})
    again = {
        name: replay(
            walk.steps, [frame.budget for frame in walk.times[name][: len(walk.steps)]], technique, camera=scene.camera
        )
        for name, (technique, _) in techniques(scene, budgets).items()
    }
    like_stored = [name for name, plans in walk.plans.items() if all(map(Plan.same_as, plans, walk.plans[STORED]))]
    compared = [STORED, *(name for name in again if name not in like_stored)]
    with (
        cell_cache({STORED: scene}, renderer, measured=True) as cache,
        Judge(scene, renderer, cache, keep=0, workers=workers) as judge,
    ):
        for i, (step, *plans) in enumerate(zip(walk.steps, *again.values(), strict=True)):
            view = step.pose.view(scene.camera)
            wanted = i % every == every // 2
            if wanted:
                plan = reference.plan(view, now=step.time, budget=Budget())
                truth = judge.truth(plan, step.pose, walk.times[STORED][i].cell)
            for name, plan in zip(again, plans, strict=True):
                if name not in compared:
                    continue
                assert plan.same_as(walk.plans[name][i]), f"{name}: the plan of frame {i} expected again, found another"
                cache.want(plan.cells)
                cache.require(plan.cells)
                renderer.execute(plan)
                if wanted:
                    shown = Plan(plan.draws, plan.place, plan.cells)
                    judge.score(name, shown, step.pose, truth, cell=plan.place, time=step.time)
            print(f"\r{told}: {i + 1} of {len(walk.steps)} frames scored", end="", file=sys.stderr, flush=True)
        results = judge.results()
    print(file=sys.stderr)
    _forget(renderer, [plan for some in walk.plans.values() for plan in some])
    found = {name: [one.errors for one in results if one.technique == name] for name in compared}
    return {name: found.get(name, found[STORED]) for name in again}


def _forget(renderer: Renderer, plans: Sequence[Plan]) -> None:
    images = dict.fromkeys(request.into.image for plan in plans for request in plan.requests)
    renderer.execute(Plan((), drops=tuple(images)))


def usual(walk: Walked, name: str, fps: float) -> NDArray[np.float64]:
    """(frames,) seconds that multi-mesh usually took beside a technique, where each frame is, within the same excerpt."""
    seconds = np.array([frame.total for frame in walk.beside[name]])
    excerpt = np.cumsum([step.cut for step in walk.steps])
    reach = max(1, round(_AROUND * fps))
    found = np.empty(len(seconds))
    for i in range(len(seconds)):
        near = np.arange(max(i - reach, 0), min(i + reach + 1, len(seconds)))
        found[i] = np.median(seconds[near[excerpt[near] == excerpt[i]]])
    return found


def late(walk: Walked, name: str, budget: float, fps: float, *, strictly: bool) -> tuple[float, float]:
    """Percent of the frames of a technique that are late, and of those of multi-mesh beside it by the same targets."""
    target = np.full(len(walk.steps), 1.0 / fps)
    if strictly:
        stored = usual(walk, name, fps)
        target = np.maximum(stored, np.minimum(stored + 1e-3 * budget, target))
    taken = (np.array([frame.total for frame in some]) for some in (walk.times[name], walk.beside[name]))
    dynamic, stored_share = (100.0 * float((one > LATE * target).mean()) for one in taken)
    return dynamic, stored_share


def parts_of(frame: FrameTimes) -> tuple[float, float, float, float]:
    """Seconds that a frame took for its plan, for requests, for draws, and for bringing in cells."""
    return frame.planning, frame.done.requests.seconds, frame.done.draws.seconds, frame.uploading + frame.waiting


def told_mean(values: NDArray[np.float64], block: int, digits: int) -> str:
    mean, low, high = mean_interval(values, block=block)
    return f"{mean:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def drawn(
    found: Mapping[str, Mapping[str, Mapping[str, tuple[float, float, float]]]], budgets: Sequence[float]
) -> Figure:
    """Thickness, FLIP and frame time against the budget, a line a walk; dashed: multi-mesh."""
    figure = new_figure(8.0, 3.4)
    panels = figure.subplots(1, 3)
    labels = ["none" if budget == 0.0 else "unlimited" if math.isinf(budget) else f"{budget:g}" for budget in budgets]
    for axes, measure in zip(panels, ("thickness px", "FLIP", "frame ms"), strict=True):
        for row, (walk, color) in enumerate(zip(found, _COLORS, strict=False)):
            values = np.array([found[walk][f"{budget:g} ms"][measure] for budget in budgets])
            spread = np.abs(values[:, 1:] - values[:, :1]).T
            at = np.arange(len(budgets)) + 0.08 * (row - 1)
            axes.errorbar(
                at,
                values[:, 0],
                spread,
                color=color,
                linewidth=1.2,
                marker="o",
                markersize=3.0,
                capsize=2.0,
                label=walk,
            )
            axes.axhline(found[walk][STORED][measure][0], color=color, linestyle="--", linewidth=0.8)
        axes.set_xticks(range(len(budgets)), labels, fontsize=SMALL)
        axes.set_ylim(bottom=0.0)
        axes.tick_params(labelsize=SMALL)
        axes.set_title(
            {"thickness px": "thickness of wrong regions (px)", "FLIP": "FLIP", "frame ms": "frame (ms)"}[measure],
            fontsize=SMALL,
        )
        axes.set_xlabel("ms a frame for updates", fontsize=SMALL)
        tidy(axes)
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=3, fontsize=SMALL, frameon=False)
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, metavar="OUT")
    parser.add_argument(
        "-o", "--out", type=Path, required=True, metavar="DIR", help="gets budgets.png and budgets.json"
    )
    parser.add_argument(
        "--budgets", default="0,2,5,10,inf", metavar="MS,...", help="inf is no limit (default: %(default)s)"
    )
    parser.add_argument("--speeds", default="1.4,5,15", metavar="M/S,...", help="(default: %(default)s)")
    parser.add_argument("--excerpts", type=int, default=5, help="of each walk (default: %(default)s)")
    parser.add_argument("--frames", type=int, default=32, help="of each excerpt (default: %(default)s)")
    parser.add_argument("--scored", type=int, default=16, help="frames of each walk (default: %(default)s)")
    parser.add_argument("--tour", type=float, default=300.0, metavar="METRES")
    parser.add_argument(
        "--fps", type=float, default=30.0, help="a frame may take a second by this (default: %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2, help="processes that compare pictures (default: %(default)s)")
    options = parser.parse_args()
    budgets = [float(one) for one in options.budgets.split(",")]
    speeds = [float(one) for one in options.speeds.split(",")]
    scene = open_scene(open_dataset(options.dataset), name=STORED)
    size = (scene.camera.width, scene.camera.height)
    every = max(1, options.excerpts * options.frames // options.scored)
    options.out.mkdir(parents=True, exist_ok=True)

    names = {
        speed: f"{_WALKS[row] if len(speeds) == len(_WALKS) else 'walk'}, {speed:g} m/s"
        for row, speed in enumerate(speeds)
    }
    print(f"{options.dataset}: city of {len(scene.mesh.triangles)} triangles", flush=True)
    walks: dict[str, Walked] = {}
    for speed in speeds:
        steps = excerpts(
            scene,
            speed=speed,
            fps=options.fps,
            count=options.excerpts,
            frames=options.frames,
            metres=options.tour,
            seed=options.seed,
        )
        walks[names[speed]] = walked(scene, steps, budgets, options.fps, names[speed])
    errors: dict[str, dict[str, list[ViewErrors]]] = {}
    with Renderer(scene.mesh, scene.ground, size=size, measured=True) as renderer:
        for name, walk in walks.items():
            errors[name] = scored(scene, renderer, walk, budgets, every, options.workers, name)

    found: dict[str, dict[str, dict[str, tuple[float, float, float]]]] = {}
    more: dict[bool, list[float]] = {False: [], True: []}
    for name, walk in walks.items():
        scored_block = max(1, len(errors[name][STORED]) // (2 * options.excerpts))
        timed_block = max(1, options.frames // 2)
        print(
            f"\n{name}: {len(walk.steps)} frames in {options.excerpts} excerpts, {len(errors[name][STORED])} scored; "
            f"the geometry takes {np.median(walk.full):.1f} ms"
        )
        print(
            "| updates | thickness px | FLIP | wrong % | frame ms mean | p50 / p95 / p99 | plan + requests + draws + cells | "
            "layers captured a frame | late %, and multi-mesh | strictly late %, and multi-mesh |"
        )
        print("|" + "---|" * 10)
        found[name] = {}
        for one, frames in walk.times.items():
            series = {
                measure: np.array([take(error) for error in errors[name][one]]) for measure, take in MEASURES.items()
            }
            total = 1e3 * np.array([frame.total for frame in frames])
            row = {measure: mean_interval(values, block=scored_block) for measure, values in series.items()}
            row["frame ms"] = mean_interval(total, block=timed_block)
            found[name][one] = row
            parts = 1e3 * np.mean([parts_of(frame) for frame in frames], axis=0)
            captured = np.mean([len({request.into.image for request in plan.requests}) for plan in walk.plans[one]])
            shares = ["", ""]
            if one != STORED:
                budget = float(one.removesuffix(" ms"))
                for which in (False, True):
                    mine, others = late(walk, one, budget, options.fps, strictly=which)
                    shares[which] = f"{mine:.1f}, {others:.1f}"
                    more[which].append(mine - others)
            columns = (
                one,
                told_mean(series["thickness px"], scored_block, 2),
                told_mean(series["FLIP"], scored_block, 4),
                told_mean(series["wrong %"], scored_block, 3),
                f"{total.mean():.2f}",
                " / ".join(f"{value:.1f}" for value in np.percentile(total, [50, 95, 99])),
                " + ".join(f"{value:.2f}" for value in parts),
                f"{captured:.2f}",
                *shares,
            )
            print(f"| {' | '.join(columns)} |")
        if 0.0 in budgets:
            same = sum(map(Plan.same_as, walk.plans["0 ms"], walk.plans[STORED]))
            print(f"at a budget of 0: {same} of {len(walk.steps)} plans are those of multi-mesh")
        for measure, take in MEASURES.items():
            told = []
            for less, higher in pairwise(budgets):
                fall = [
                    take(b) - take(a)
                    for a, b in zip(*(errors[name][f"{one:g} ms"] for one in (less, higher)), strict=True)
                ]
                mean, low, high = mean_interval(np.array(fall), block=scored_block)
                told.append(f"{less:g} to {higher:g} ms {mean:+.3g} [{low:+.3g}, {high:+.3g}]")
            print(f"{measure}: {'; '.join(told)}")
    print(
        f"\nlate frames: at most {max(more[False]):+.1f} percentage points of those of multi-mesh; "
        f"strictly late frames: {max(more[True]):+.1f}"
    )
    save(drawn(found, budgets), options.out / "budgets.png")
    (options.out / "budgets.json").write_text(
        json.dumps({"dataset": options.dataset.name, "walks": found}, indent=1) + "\n"
    )


if __name__ == "__main__":
    main()
