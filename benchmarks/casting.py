"""What the benchmarks of ray casting share: techniques to compare, walks, and frames timed by all of them in turn."""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from large_cities import laid_out
from matplotlib.figure import Figure
from numpy.typing import NDArray
from walks import detailed

from mmi.appearance.city_mesh import object_boxes
from mmi.foundation.camera import Camera, View
from mmi.inspection.figures import save
from mmi.reading.read_city import read_city
from mmi.walks.walk import Pose, Step
from viewer.casting.frame import CastTally
from viewer.casting.near_set import Neighbourhoods
from viewer.casting.rules import CastRules
from viewer.drawing.renderer import Renderer
from viewer.plan import Budget, Objects, Plan, Sky, Technique
from viewer.scene.frustum import box_corners, within_view
from viewer.scene.scene import WalkScene, scene_of_city
from viewer.scene.workshop import Workshop
from viewer.techniques.geometry import FullGeometry
from viewer.techniques.ray_cast import RayCasting
from viewer.walks.tour import tour

PAPER_SIZE, LARGE = 150_000, 7_000_000
"""Triangles of the paper's city, and of a large one."""
FULL, CULLED, NEAR, CAST = "full", "full, culled", "near only", "ray-cast"
COLORS = {FULL: "#222222", CULLED: "#777777", NEAR: "#009E73", CAST: "#7B4FA3"}
LIMIT_PX = 5.0
_BLOCKS = 400.0
"""Cells, about, of the regular grid by which a city is culled."""
BUDGET = Budget()


class Culled:
    """The whole city, culled by the boxes of the cells of a regular grid, each of which is drawn with one call."""

    name = CULLED

    def __init__(self, scene: WalkScene) -> None:
        self._scene = scene
        there = np.flatnonzero(np.isfinite(scene.boxes[:, 0, 0]))
        low, high = scene.boxes[there, 0], scene.boxes[there, 1]
        middle = 0.5 * (low + high)[:, :2]
        corner = middle.min(axis=0)
        side = math.sqrt(float(np.maximum(np.ptp(middle, axis=0), 1.0).prod()) / _BLOCKS)
        column, row = np.floor((middle - corner) / side).astype(np.int64).T
        _, block = np.unique(column * (1 << 20) + row, return_inverse=True)
        order = np.argsort(block, kind="stable")
        starts = np.flatnonzero(np.diff(block[order], prepend=-1))
        self._blocks = [Objects(f"block {i}", objects) for i, objects in enumerate(np.split(there[order], starts[1:]))]
        self._corners = box_corners(np.minimum.reduceat(low[order], starts), np.maximum.reduceat(high[order], starts))
        self._triangles = np.array([scene.mesh.triangle_counts[one.objects].sum() for one in self._blocks])

    def plan(self, view: View, *, now: float, budget: Budget) -> Plan:  # noqa: ARG002
        """Draw the cells that the view may show."""
        seen = np.flatnonzero(within_view(self._corners, view))
        return Plan((*(self._blocks[i] for i in seen), self._scene.ground_in(view), Sky()))

    def share(self, view: View) -> float:
        """Of the triangles, those in cells that the view may show."""
        return float(self._triangles[within_view(self._corners, view)].sum() / self._triangles.sum())


class NearOnly:
    """The near field, culled as ray casting culls it, ground and sky; nothing else."""

    name = NEAR

    def __init__(self, scene: WalkScene, reach: float) -> None:
        self._scene = scene
        self._neighbourhoods = Neighbourhoods(scene.boxes, reach=reach)

    def plan(self, view: View, *, now: float, budget: Budget) -> Plan:  # noqa: ARG002
        """Draw what is near."""
        near = self._neighbourhoods.around(view.eye)
        boxes = self._scene.boxes[near.objects]
        shows = within_view(box_corners(boxes[:, 0], boxes[:, 1]), view)
        told = np.packbits(shows).tobytes().hex()
        return Plan((Objects(f"{near.key} {told}", near.objects[shows]), self._scene.ground_in(view), Sky()))


@dataclass(slots=True, eq=False)
class Timed:
    """Frames of a technique: ``seconds`` of each, NaN where it was not its turn, and for ray casting what ``pixels`` were."""

    seconds: list[float] = field(default_factory=list)
    processor: list[float] = field(default_factory=list)
    """Seconds of all cores together: what others do on the machine shows less in them."""
    parts: list[tuple[float, float, float]] = field(default_factory=list)
    """Seconds of the plan, of finishing it, and of all the rest."""
    triangles: list[int] = field(default_factory=list)
    pixels: list[CastTally] = field(default_factory=list)

    @property
    def ms(self) -> NDArray[np.float64]:
        """Milliseconds of the frames that were drawn."""
        found = 1e3 * np.array(self.seconds)
        return found[np.isfinite(found)]


@dataclass(frozen=True, slots=True, eq=False)
class Contender:
    """A technique with a renderer that draws nothing else, so that neither finds its sets of objects evicted by others.

    It draws every ``every``-th frame only.
    """

    technique: Technique
    renderer: Renderer
    camera: Camera
    every: int = 1
    timed: Timed = field(default_factory=Timed)

    def frame(self, step: Step) -> None:
        """Draw a step of a walk, and note what it took: from the view to the finished picture, which is not read back."""
        if step.index % self.every:
            self.timed.seconds.append(math.nan)
            return
        view = step.pose.view(self.camera)
        cores = time.process_time()
        start = time.perf_counter()
        plan = self.technique.plan(view, now=step.time, budget=BUDGET)
        planned = time.perf_counter()
        drawn = self.renderer.draw(plan, view, read=False)
        end = time.perf_counter()
        self.timed.seconds.append(end - start)
        self.timed.processor.append(time.process_time() - cores)
        finish = drawn.done.finish
        self.timed.parts.append((planned - start, finish, end - planned - finish))
        self.timed.triangles.append(drawn.triangles)
        if isinstance(self.technique, RayCasting):
            self.timed.pixels.append(self.technique.latest)


def in_turn(steps: Sequence[Step], contenders: Mapping[str, Contender], told: str) -> dict[str, Timed]:
    """Each step by all contenders, now from the first to the last, now the other way round."""
    names = list(contenders)
    for step in steps:
        for name in names if step.index % 2 else reversed(names):
            contenders[name].frame(step)
        if step.index % 10 == 9 or step is steps[-1]:
            print(f"\r{told}: {step.index + 1} of {len(steps)} frames", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return {name: one.timed for name, one in contenders.items()}


def contender(
    stack: ExitStack, scene: WalkScene, name: str, rules: CastRules, *, every: int = 1, warm: bool = True
) -> Contender:
    """A technique with a renderer, which has drawn a first frame of no walk: programs are compiled then."""
    size = (scene.camera.width, scene.camera.height)
    renderer = stack.enter_context(Renderer(scene.mesh, scene.ground, size=size))
    made = contender_of(scene, name, rules)
    if warm:
        view = Pose(tuple(scene.whereabouts.cells[0].reference.tolist()), 0.0, 0.0).view(scene.camera)
        renderer.draw(made.plan(view, now=0.0, budget=BUDGET), view, read=False)
        made = contender_of(scene, name, rules)
    return Contender(made, renderer, scene.camera, every)


def contender_of(scene: WalkScene, name: str, rules: CastRules) -> Technique:
    """A fresh technique by its name."""
    makers: dict[str, Any] = {
        FULL: lambda: FullGeometry(scene),
        CULLED: lambda: Culled(scene),
        NEAR: lambda: NearOnly(scene, rules.near_field),
        CAST: lambda: RayCasting(scene, rules),
    }
    return makers[name]()


def district_of(path: Path, camera: Camera, *, detail: int = 1) -> WalkScene:
    """The scene of a city's file, each triangle cut into ``detail`` squared."""
    city, _ = read_city(path)
    return finer(scene_of_city(city, name="multi-mesh", camera=camera), detail)


def finer(scene: WalkScene, detail: int) -> WalkScene:
    """The same scene, each triangle cut into ``detail`` squared."""
    if detail == 1:
        return scene
    mesh = detailed(scene.mesh, detail)
    return replace(scene, mesh=mesh, boxes=object_boxes(mesh), workshop=Workshop())


def walked(scene: WalkScene, frames: int, *, speed: float, fps: float, seed: int) -> tuple[Step, ...]:
    """So many frames of a tour of a district's streets, as if by ``speed`` metres a second, seen ``fps`` times a second."""
    seconds = frames / fps
    metres = 1.5 * speed * seconds + 50.0  # it slows down at corners
    walk = tour(scene.whereabouts.cells, scene.whereabouts.adjacency, metres=metres, speed=speed, seed=seed)
    steps = walk.frames(fps)[:frames]
    if len(steps) < frames:
        raise ValueError(f"a walk of {frames} frames expected, found one of {len(steps)}")
    return steps


def grown(district: WalkScene, triangles: int, steps: Sequence[Step]) -> WalkScene:
    """A city of so many triangles around a walk."""
    start = time.perf_counter()
    middle = np.mean([step.pose.eye[:2] for step in steps], axis=0)
    scene = laid_out(district, triangles, middle=middle)
    wide, deep, _ = np.ptp(scene.mesh.positions, axis=0)
    print(
        f"city of {len(scene.mesh.triangles):,} triangles, {len(scene.boxes):,} objects, {1e-3 * wide:.1f} x "
        f"{1e-3 * deep:.1f} km: laid out in {time.perf_counter() - start:.1f} s",
        file=sys.stderr,
        flush=True,
    )
    return scene


HEADER = "| city | technique | ms p50 | p95 | mean | frames a second | to full | to near only | cores' ms | triangles |"


def rows_of(city: str, found: Mapping[str, Timed]) -> list[dict[str, Any]]:
    """What a table says of frames: times in milliseconds, how many times as fast as the others by medians."""
    medians = {name: float(np.median(one.ms)) for name, one in found.items()}
    return [
        {
            "city": city,
            "technique": name,
            "p50": medians[name],
            "p95": float(np.percentile(one.ms, 95)),
            "mean": float(one.ms.mean()),
            "fps": 1e3 / float(one.ms.mean()),
            "to_full": medians[FULL] / medians[name] if FULL in medians else math.nan,
            "to_near": medians[NEAR] / medians[name] if NEAR in medians else math.nan,
            "cores_ms": 1e3 * float(np.median(one.processor)),
            "triangles": round(float(np.mean(one.triangles))),
        }
        for name, one in found.items()
    ]


def print_rows(rows: Sequence[Mapping[str, Any]]) -> None:
    """A table of them."""
    print(HEADER)
    print("|" + "---|" * 10)
    for row in rows:
        print(
            f"| {row['city']} | {row['technique']} | {row['p50']:.1f} | {row['p95']:.1f} | {row['mean']:.1f} | "
            f"{row['fps']:.1f} | {row['to_full']:.2f} | {row['to_near']:.2f} | {row['cores_ms']:.1f} | "
            f"{row['triangles']:,} |",
            flush=True,
        )


def common_options(parser: argparse.ArgumentParser) -> None:
    """What all of these benchmarks are asked."""
    parser.add_argument(
        "city",
        type=Path,
        metavar="CITY",
        help="a district on flat ground that cities are laid out of; what build-impostors reads",
    )
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="DIR", help="gets tables as JSON, and plots")
    parser.add_argument("--frames", type=int, default=400, help="of each walk (default: %(default)s)")
    parser.add_argument("--speed", type=float, default=5.0, metavar="M/S", help="(default: %(default)s)")
    parser.add_argument("--fps", type=float, default=30.0, help="frames of a second of it (default: %(default)s)")
    parser.add_argument("--near-field", type=float, default=100.0, metavar="METRES", help="(default: %(default)s)")
    parser.add_argument(
        "--detail", type=int, default=1, metavar="N", help="cut the district's triangles into N squared first"
    )
    parser.add_argument("--workers", type=int, default=2, help="threads that cast rays (default: %(default)s)")
    parser.add_argument("--caster", default="embree", choices=("embree", "grid"))
    parser.add_argument("--seed", type=int, default=1)


def rules_of(options: argparse.Namespace, **others: Any) -> CastRules:  # noqa: ANN401
    """The rules that options ask for, but for some others."""
    asked = {
        "near_field": options.near_field,
        "limit_px": LIMIT_PX,
        "caster": options.caster,
        "workers": options.workers,
    }
    return CastRules(**{**asked, **others})


def written(options: argparse.Namespace, name: str, values: object, figure: Figure | None = None) -> None:
    """Keep what an experiment found as NAME.json, and its plot."""
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / f"{name}.json").write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
    if figure is not None:
        save(figure, options.out / f"{name}.png")
