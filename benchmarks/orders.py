"""In what order should layers be captured again? Errors over time by error angle, front to back, in turn and at random.

    python benchmarks/orders.py out/montmartre -o out/orders
    python benchmarks/orders.py out/helsinki -o out/orders --seeds 1 --excerpts 1 --frames 8 --speeds 5         # in a hurry

The same excerpts of tours, or random views that are held (a speed of 0), are drawn by multi-mesh-dynamic in each order, with
nothing captured at first. What captures cost is fixed numbers, not measured, and all orders have the same budget of them, so
that they capture equally much and the same command finds the same errors on any machine. Errors are those of pictures compared
with the geometry's, and their mean over time is the area under the error curve divided by its length:

    wrong %          pixels that show another object; *beyond* are those that no pixel around explains (resampling)
    thickness px     of the thickest wrong region
    displaced px     how far surfaces are off, the mean over all pixels, exact ones included
    MSE              of colours, in 8-bit steps squared; with --flip also FLIP

Intervals hold 95 of 100 means of resampled excerpts. *Better* says for how many of the excerpts an order has the lower error
than --against, and for how many the higher.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from walks import excerpts, mean_interval

from mmi.dataset.reading import open_dataset
from mmi.foundation.thickness import thickness
from mmi.inspection.figures import SMALL, new_figure, save, tidy
from mmi.walks.walk import Step
from viewer.cells.cell_cache import CellCache
from viewer.cells.scene_cache import cell_cache
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.drawing.renderer import Renderer
from viewer.measuring.view_errors import beyond_resampling, flip_map, wrong_regions
from viewer.plan import Budget, Costs, Plan
from viewer.scene.scene import WalkScene, open_scene
from viewer.techniques.catalogue import MAIN, make_technique
from viewer.techniques.dynamic import ORDERS, DynamicImpostors
from viewer.walks.random_views import random_views

_COLORS = {
    "error-by-time": "#D55E00",
    "error-angle": "#E69F00",
    "front-to-back": "#0072B2",
    "round-robin": "#009E73",
    "random": "#777777",
}
_OTHERS = ("#CC79A7", "#56B4E9")
_PENDING = 8
"""At most this many pictures wait to be compared."""


class Errors(NamedTuple):
    """What is wrong in a picture."""

    wrong: float
    beyond: float
    thick: float
    displaced: float
    mse: float
    flip: float | None


MEASURES = ("wrong %", "beyond %", "thickness px", "displaced px", "MSE", "FLIP")
STORED = "nothing captured"


def errors_of(truth: DrawnPicture, shown: DrawnPicture, focal: float, flip: bool) -> Errors:
    """Compare two measured pictures."""
    wrong = wrong_regions(truth, shown).wrong
    assert shown.displacement is not None
    angles = np.where(np.isfinite(shown.displacement), shown.displacement, 0.0).astype(np.float64)
    return Errors(
        wrong=100.0 * float(wrong.mean()),
        beyond=100.0 * float(beyond_resampling(truth, shown).wrong.mean()),
        thick=thickness(wrong),
        displaced=focal * float(np.tan(np.minimum(angles, 1.5)).mean()),
        mse=float(np.mean((truth.color.astype(np.float64) - shown.color) ** 2)),
        flip=float(flip_map(truth.color, shown.color).mean()) if flip else None,
    )


class InOrder(DynamicImpostors):
    """multi-mesh-dynamic under a name of its own, which its images have too: several draw with one renderer."""

    def __init__(self, scene: WalkScene, order: str) -> None:
        super().__init__(scene, order="error-angle" if order == STORED else order)
        self.name = f"{DynamicImpostors.name} {order}"


class Work(NamedTuple):
    """What an order captured in an excerpt: seconds by the budget's costs, layers, pixels."""

    seconds: float = 0.0
    layers: int = 0
    pixels: int = 0


def views_of(
    scene: WalkScene, speed: float, seed: int, *, count: int, frames: int, fps: float, metres: float
) -> Iterator[tuple[Step, ...]]:
    """Excerpts of a tour, or held views."""
    if speed > 0.0:
        steps = excerpts(scene, speed=speed, fps=fps, count=count, frames=frames, metres=metres, seed=seed)
        yield from (steps[first : first + frames] for first in range(0, len(steps), frames))
        return
    for _, pose in random_views(scene.whereabouts.cells, count, seed=seed, terrain=scene.terrain):
        yield tuple(Step(i, i / fps, pose, cut=i == 0) for i in range(frames))


def drawn_in_orders(
    scene: WalkScene,
    renderer: Renderer,
    cache: CellCache,
    pool: ProcessPoolExecutor,
    steps: Sequence[Step],
    orders: Sequence[str],
    budget: Budget,
    *,
    every: int,
    flip: bool,
) -> tuple[dict[str, list[Errors]], dict[str, Work]]:
    """Draw an excerpt in all orders: the errors of every so-manieth frame, and what was captured."""
    reference = make_technique("full", {MAIN: scene})
    made = {order: InOrder(scene, order) for order in orders}
    work = dict.fromkeys(orders, Work())
    found: dict[str, list[Errors]] = {order: [] for order in orders}
    waiting: deque[tuple[str, Future[Errors]]] = deque()
    images = {}
    for i, step in enumerate(steps):
        view = step.pose.view(scene.camera)
        wanted = i % every == 0
        if wanted:
            truth = renderer.draw(reference.plan(view, now=step.time, budget=Budget()), view, measured=True)
        for order, technique in made.items():
            told = Budget(budget.frame, 0.0, budget.costs) if order == STORED else budget
            plan = technique.plan(view, now=step.time, budget=told)
            images |= dict.fromkeys(request.into.image for request in plan.requests)
            work[order] = _added(work[order], plan, scene, budget.costs)
            cache.want(plan.cells)
            cache.require(plan.cells)
            if not wanted:
                renderer.execute(plan)
                continue
            shown = renderer.draw(plan, view, measured=True)
            waiting.append((order, pool.submit(errors_of, truth, shown, view.focal, flip)))
            while len(waiting) > _PENDING:
                done, future = waiting.popleft()
                found[done].append(future.result())
    for done, future in waiting:
        found[done].append(future.result())
    renderer.execute(Plan((), drops=tuple(images)))
    return found, work


def _added(work: Work, plan: Plan, scene: WalkScene, costs: Costs) -> Work:
    """``work`` and the requests of a plan."""
    seconds = 0.0
    for request in plan.requests:
        triangles = sum(int(scene.mesh.triangle_counts[draw.objects].sum()) for draw in request.draws)
        seconds += costs.of_request(triangles=triangles, draws=len(request.draws), pixels=request.pixels)
    layers = len({request.into.image for request in plan.requests})
    pixels = sum(request.pixels for request in plan.requests)
    return Work(work.seconds + seconds, work.layers + layers, work.pixels + pixels)


def curves(found: dict[str, dict[str, NDArray[np.float64]]], every: int, fps: float) -> Figure:
    """Errors over time, the mean of all excerpts, a row a speed and a column a measure."""
    measured = next(iter(next(iter(found.values())).values())).shape[2]
    shown = [i for i, name in enumerate(MEASURES[:measured]) if name != "thickness px"]
    figure = new_figure(9.0, 0.4 + 2.2 * len(found))
    panels = figure.subplots(len(found), len(shown), sharex=True, squeeze=False)
    others = iter(_OTHERS)
    colors: dict[str, str] = {}
    for row, (walk, orders) in zip(panels, found.items(), strict=True):
        for axes, measure in zip(row, shown, strict=True):
            for order, values in orders.items():
                if order not in colors:
                    colors[order] = "#222222" if order == STORED else _COLORS.get(order) or next(others)
                curve = values[:, :, measure].mean(axis=0)
                axes.plot(
                    every * np.arange(len(curve)) / fps,
                    curve,
                    color=colors[order],
                    linewidth=1.1,
                    linestyle="--" if order == STORED else "-",
                    label=order,
                )
            axes.set_ylim(bottom=0.0)
            axes.tick_params(labelsize=SMALL)
            axes.set_title(f"{MEASURES[measure]}, {walk}", fontsize=SMALL)
            tidy(axes)
    for axes in panels[-1]:
        axes.set_xlabel("seconds", fontsize=SMALL)
    handles, names = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=5, fontsize=SMALL, frameon=False)
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, metavar="OUT")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="DIR", help="gets orders.png and orders.json")
    parser.add_argument("--budget-ms", type=float, default=1.0, help="of fixed costs, a frame (default: %(default)s)")
    parser.add_argument("--speeds", default="0,1.4,5", metavar="M/S,...", help="0 holds views (default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=3, help="so many tours and sets of views (default: %(default)s)")
    parser.add_argument("--excerpts", type=int, default=10, help="or views, of each (default: %(default)s)")
    parser.add_argument("--frames", type=int, default=16, help="of each excerpt (default: %(default)s)")
    parser.add_argument("--every", type=int, default=4, help="every so-manieth frame is scored (default: %(default)s)")
    parser.add_argument("--orders", default=",".join(ORDERS), help="(default: %(default)s)")
    parser.add_argument("--against", default="error-by-time", metavar="ORDER", help="(default: %(default)s)")
    parser.add_argument("--tour", type=float, default=300.0, metavar="METRES")
    parser.add_argument("--fps", type=float, default=30.0)
    parser.add_argument("--flip", action="store_true", help="also FLIP, which takes most of the time then")
    parser.add_argument("--workers", type=int, default=2, help="processes that compare pictures (default: %(default)s)")
    options = parser.parse_args()
    scene = open_scene(open_dataset(options.dataset), name=MAIN)
    size = (scene.camera.width, scene.camera.height)
    orders = [STORED, *options.orders.split(",")]
    budget = Budget(math.inf, 1e-3 * options.budget_ms, Costs())
    options.out.mkdir(parents=True, exist_ok=True)
    series: dict[str, dict[str, NDArray[np.float64]]] = {}
    whole: dict[str, dict[str, Work]] = {}
    with (
        Renderer(scene.mesh, scene.ground, size=size, measured=True) as renderer,
        cell_cache({MAIN: scene}, renderer, measured=True) as cache,
        ProcessPoolExecutor(options.workers, get_context("spawn")) as pool,
    ):
        for speed in map(float, options.speeds.split(",")):
            name = f"{speed:g} m/s" if speed > 0.0 else "held"
            found: dict[str, list[list[Errors]]] = {order: [] for order in orders}
            whole[name] = dict.fromkeys(orders, Work())
            many = options.seeds * options.excerpts
            for seed in range(1, options.seeds + 1):
                for steps in views_of(
                    scene,
                    speed,
                    seed,
                    count=options.excerpts,
                    frames=options.frames,
                    fps=options.fps,
                    metres=options.tour,
                ):
                    errors, work = drawn_in_orders(
                        scene,
                        renderer,
                        cache,
                        pool,
                        steps,
                        orders,
                        budget,
                        every=options.every,
                        flip=options.flip,
                    )
                    for order in orders:
                        found[order].append(errors[order])
                        whole[name][order] = Work(*map(sum, zip(whole[name][order], work[order], strict=True)))
                    print(f"\r{name}: {len(found[STORED])} of {many} excerpts", end="", file=sys.stderr, flush=True)
            print(file=sys.stderr)
            measured = len(MEASURES) if options.flip else len(MEASURES) - 1
            series[name] = {
                order: np.array([[one[:measured] for one in some] for some in values])
                for order, values in found.items()
            }
    for name, by_order in series.items():
        print(
            f"\n{options.dataset}, {name}: {options.seeds * options.excerpts} excerpts of {options.frames} frames, "
            f"updates of {options.budget_ms:g} ms a frame at fixed costs"
        )
        measures = MEASURES[: by_order[STORED].shape[2]]
        print("| order | " + " | ".join(measures) + " | ms captured a frame | layers a frame | pixels a frame |")
        print("|" + "---|" * (len(measures) + 4))
        frames = options.seeds * options.excerpts * options.frames
        means = {order: values.mean(axis=1) for order, values in by_order.items()}  # (excerpts, measures)
        for order in orders:
            columns = []
            for i in range(len(measures)):
                mean, low, high = mean_interval(means[order][:, i], block=1)
                columns.append(f"{mean:.3g} [{low:.3g}, {high:.3g}]")
            done = whole[name][order]
            told = (1e3 * done.seconds / frames, done.layers / frames, done.pixels / frames)
            print(f"| {order} | {' | '.join(columns)} | {told[0]:.2f} | {told[1]:.2f} | {told[2]:.0f} |")
        for order in orders:
            if order in (STORED, options.against) or options.against not in orders:
                continue
            told_all = []
            for i, measure in enumerate(measures):
                off = means[order][:, i] - means[options.against][:, i]
                mean, low, high = mean_interval(off, block=1)
                base = max(float(means[options.against][:, i].mean()), 1e-12)
                better, worse = int((off < -1e-9).sum()), int((off > 1e-9).sum())
                told_all.append(
                    f"{measure} {100.0 * mean / base:+.1f} % [{100.0 * low / base:+.1f}, {100.0 * high / base:+.1f}] "
                    f"({better} better, {worse} worse)"
                )
            print(f"{order} against {options.against}: {'; '.join(told_all)}")
    save(curves(series, options.every, options.fps), options.out / "orders.png")
    told_json = {
        walk: {
            order: dict(zip(MEASURES, values.mean(axis=(0, 1)).tolist(), strict=False))
            for order, values in some.items()
        }
        for walk, some in series.items()
    }
    (options.out / "orders.json").write_text(
        json.dumps({"dataset": options.dataset.name, "budget_ms": options.budget_ms, "errors": told_json}, indent=1)
        + "\n"
    )


if __name__ == "__main__":
    main()
