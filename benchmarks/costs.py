"""What drawing takes on this machine: frames, draws, triangles, captured pixels and reliefs; and what the cost model says.

    python benchmarks/costs.py out/helsinki out/montmartre

For each dataset, a view along the cell of the most layers. Rows take turns (--rounds times), so that a noisy moment meets all
of them: *least* and *median* milliseconds, and *predicted* by the costs that calibration found at the start, which take no
notice of how much of the view is covered. Below, what a draw, a triangle, a captured pixel and a pixel of a relief come to,
from the least times of rows, which other programs disturb the least; and what sets of objects and of layers take to make,
since plans that replace layers one by one meet new ones all the time.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from mmi.dataset.reading import open_dataset
from mmi.foundation.camera import View
from mmi.walks.walk import Pose
from viewer.cells.scene_cache import cell_cache
from viewer.drawing.renderer import Renderer
from viewer.plan import (
    CellKey,
    CellLayers,
    Costs,
    Draw,
    ImageKey,
    Objects,
    Plan,
    Relief,
    ReliefPart,
    Request,
    Sky,
    Slot,
    Work,
)
from viewer.runtime.calibration import calibrated
from viewer.scene.scene import CellContents, WalkScene, open_scene

_MANY = 32
"""Draws into which what is visible is cut."""
_SMALL = 32
"""Pixels a side of small captures."""


def view_along(scene: WalkScene) -> tuple[CellContents, View]:
    """The cell of the most layers, and a view along it."""
    name = max(scene.dataset.manifest.cells, key=lambda one: len(list(one.pictures))).id
    place = scene.cell(name)
    (x, y, z), cell = place.cell.reference.tolist(), place.cell
    azimuth = math.atan2(cell.q[1] - cell.p[1], cell.q[0] - cell.p[0])
    return place, Pose((x, y, z), azimuth, 0.0).view(scene.camera)


def rows_of(scene: WalkScene, place: CellContents, view: View) -> dict[str, Plan]:
    """What is drawn, by what the table calls it. Requests come with a plan that draws nothing, and draws with no requests."""
    ground, sky = scene.ground_in(view), Sky()
    near, visible = Objects("near", place.near), Objects("visible", place.visible)
    whole = Objects("all", np.arange(len(scene.mesh.triangle_counts)))
    parts = tuple(
        Objects(f"part {i}", some) for i, some in enumerate(np.array_split(place.visible, _MANY)) if len(some)
    )
    layers = CellLayers(CellKey(scene.name, place.cell.id), place.layers_in(view))
    small = view.cropped((-_SMALL // 2, -_SMALL // 2, _SMALL, _SMALL))
    image = ImageKey("costs", "large")

    def captured(key: ImageKey, seen: View, *draws: Draw) -> Request:
        return Request(Slot(key, seen.window[2:]), seen, draws)

    def requests(*some: Request) -> Plan:
        return Plan((), requests=some)

    relief = Relief(image, (ReliefPart(view, (0, 0), 100.0),))
    return {
        "nothing": Plan(()),
        "sky": Plan((sky,)),
        "ground, sky": Plan((ground, sky)),
        "near, ground, sky (local)": Plan((near, ground, sky)),
        "near, layers, ground, sky (multi-mesh)": Plan((near, layers, ground, sky)),
        "visible, ground, sky": Plan((visible, ground, sky)),
        f"visible in {len(parts)} draws, ground, sky": Plan((*parts, ground, sky)),
        "all, ground, sky (full)": Plan((whole, ground, sky)),
        "a capture of the window: nothing": requests(captured(image, view)),
        "a capture of the window: visible": requests(captured(image, view, visible)),
        "a capture of the window: all": requests(captured(image, view, whole)),
        f"8 captures of {_SMALL} x {_SMALL}: nothing": requests(
            *(captured(ImageKey("costs", f"small {i}"), small) for i in range(8))
        ),
        "a relief of the window, ground, sky": Plan((relief, ground, sky)),
    }


def predicted(costs: Costs, work: Work, *, frames: int) -> float:
    """Seconds."""
    if frames:
        return costs.of_draws(triangles=work.triangles, draws=work.draws, relief=work.relief)
    one = costs.of_request(triangles=work.triangles, draws=work.draws, pixels=work.pixels, relief=work.relief)
    return one + (work.requests - 1) * costs.request


def making_us(
    scene: WalkScene, place: CellContents, view: View, renderer: Renderer, rounds: int
) -> Mapping[str, float]:
    """Microseconds that this thread works longer in a frame that meets a set for the first time: the least times compared."""
    layers = CellKey(scene.name, place.cell.id)
    found = {}
    sets: dict[str, Callable[[int], Draw]] = {
        "a new set of all layers but one": lambda i: CellLayers(
            layers, tuple(name for k, name in enumerate(place.layers) if k != i % max(len(place.layers), 1))
        ),
        "a new set of all visible objects but one": lambda i: Objects(f"but {i}", np.delete(place.visible, i)),
    }
    for name, made in sets.items():
        first, again = [], []
        for i in range(min(rounds, len(place.layers) or 1, len(place.visible))):
            plan = Plan((made(i),))
            for times in (first, again):
                start = time.thread_time()
                renderer.draw(plan, view, read=False)
                times.append(time.thread_time() - start)
        found[name] = 1e6 * (min(first) - min(again))
    return found


def table(path: Path, rounds: int) -> None:
    """Print everything about a dataset."""
    scene = open_scene(open_dataset(path), name="multi-mesh")
    camera = scene.camera
    place, view = view_along(scene)
    with (
        Renderer(scene.mesh, scene.ground, size=(camera.width, camera.height)) as renderer,
        cell_cache({"multi-mesh": scene}, renderer) as cache,
    ):
        start = time.perf_counter()
        costs = calibrated(renderer, scene)
        took = time.perf_counter() - start
        cache.require([CellKey("multi-mesh", place.cell.id)])
        rows = rows_of(scene, place, view)
        seconds: dict[str, list[float]] = {name: [] for name in rows}
        works: dict[str, Work] = {}
        for number in range(rounds + 1):
            for name, plan in rows.items():
                done = renderer.draw(plan, view, read=False).done
                works[name] = done.requests if plan.requests else done.draws
                if number:  # the first time sets are made
                    seconds[name].append(works[name].seconds)
        making = making_us(scene, place, view, renderer, rounds)
    print(f"\n{path.name}, {camera.width} x {camera.height}, {renderer.device}; cell {place.cell.id}")
    print(
        f"calibrated in {took:.2f} s: "
        + ", ".join(f"{name} {1e6 * one:.4g} us" for name, one in costs._asdict().items())
    )
    print("\n| what | triangles | draws | least, ms | median, ms | predicted, ms |\n|---|---|---|---|---|---|")
    for name, plan in rows.items():
        work, times = works[name], 1e3 * np.array(seconds[name])
        told = 1e3 * predicted(costs, work, frames=0 if plan.requests else 1)
        print(f"| {name} | {work.triangles} | {work.draws} | {times.min():.2f} | {np.median(times):.2f} | {told:.2f} |")

    def apart(one: str, other: str) -> float:
        return min(seconds[one]) - min(seconds[other])

    def more(one: str, other: str, what: str) -> int:
        return max(int(getattr(works[one], what)) - int(getattr(works[other], what)), 1)

    split = next(name for name in rows if name.startswith("visible in"))
    whole, visible = "all, ground, sky (full)", "visible, ground, sky"
    window, filled = "a capture of the window: nothing", "a capture of the window: visible"
    relief, ground = "a relief of the window, ground, sky", "ground, sky"
    pixels = camera.width * camera.height
    print()
    print(f"a draw: {1e6 * apart(split, visible) / more(split, visible, 'draws'):.0f} us")
    print(f"a triangle that is not visible: {1e9 * apart(whole, visible) / more(whole, visible, 'triangles'):.0f} ns")
    print(
        f"a captured pixel: {1e9 * apart(filled, window) / pixels:.1f} ns with what is visible, "
        f"{1e9 * min(seconds[window]) / pixels:.1f} ns with nothing"
    )
    print(f"a pixel of a relief: {1e9 * apart(relief, ground) / pixels:.1f} ns")
    for name, one in making.items():
        print(f"{name}: {one:.0f} us")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", type=Path, nargs="+", metavar="OUT")
    parser.add_argument("--rounds", type=int, default=30)
    options = parser.parse_args()
    for path in options.datasets:
        table(path, options.rounds)


if __name__ == "__main__":
    main()
