"""The experiments of Schaufler & Stuerzlinger 1996 on this renderer: what boxes of the image cache are, and what it gains.

    python benchmarks/image_cache.py examples/helsinki/helsinki.osm.pbf -o out/image-cache
    python benchmarks/image_cache.py examples/helsinki/helsinki.osm.pbf -o out/image-cache --only large --frames 60

flat            section 5.1, figures 6 and 9: a flat scene of four levels below the first (the paper's has 341 boxes), a
                diagonal walk of 120 frames, 2 m each: how many boxes are captured from triangles, combined, shown again,
                or drawn as they are; and the map of them in every sixth frame
forest-aside    section 5.2, figures 7 and 8: sideways before a forest of 100 trees, 100 frames, with frame times beside full
forest-zoom     the same from a corner towards its middle
large           a city of seven million triangles laid out of CITY: frame times of full, of full culled by a grid, and of the
                cache all around the viewer, in the frustum only, with a budget of 5 ms a frame for captures, and with
                that budget after a first frame that captures everything
turning         images captured by who turns on the spot

Techniques take turns frame by frame, each with a renderer of its own. A frame is timed from the view to the finished picture,
which is not read back. The first frame, in which nothing is there yet, is told apart.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from casting import LARGE, Culled, district_of, grown, walked
from matplotlib.collections import PatchCollection
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from citygen.generate import generate
from mmi.foundation.camera import Camera, view_towards
from mmi.inspection.figures import SMALL, new_figure, save, tidy
from viewer.caching.rules import CacheRules
from viewer.drawing.renderer import Renderer
from viewer.plan import Budget, Done, Technique
from viewer.runtime.cost_model import CostModel
from viewer.scene.scene import WalkScene, scene_of_city
from viewer.techniques.geometry import FullGeometry
from viewer.techniques.image_cache import CacheTally, ImageCache

CAMERA = Camera(640, 480, math.radians(60.0))
KINDS = ("new", "combined", "reused", "impossible")
COLORS = {"new": "#d62728", "combined": "#2ca02c", "reused": "#ffffff", "impossible": "#222222"}
"""As in figure 9."""
LINES = {"new": "#d62728", "combined": "#2ca02c", "reused": "#888888", "impossible": "#1f77b4"}
_BUDGET_MS = 5.0
_LARGEST = 512
"""Texels of a side where boxes are as deep as the paper's: its 256 are as large as pixels, and ours are finer."""
_STEP = 2.0
"""Metres of a frame of the flat walk."""


class Where(NamedTuple):
    """A viewer's place and where it looks to, radians."""

    eye: NDArray[np.float64]
    azimuth: float
    pitch: float = 0.0


class Frame(NamedTuple):
    """What a technique took for a frame, milliseconds, and what it drew."""

    ms: float
    captured: int
    triangles: int
    boxes: CacheTally | None


class Contender:
    """A technique with a renderer of its own."""

    def __init__(
        self,
        stack: ExitStack,
        scene: WalkScene,
        technique: Technique,
        *,
        updates: float = math.inf,
        at_first: float | None = None,
    ) -> None:
        size = (CAMERA.width, CAMERA.height)
        self.technique, self.updates = technique, updates
        self._at_first = updates if at_first is None else at_first
        self._renderer = stack.enter_context(Renderer(scene.mesh, scene.ground, size=size))
        self._model = CostModel()
        self._done: Done | None = None
        self.frames: list[Frame] = []

    def frame(self, where: Where) -> None:
        """Draw one, and learn from it what drawing takes."""
        view = view_towards(where.eye, where.azimuth, where.pitch, focal=CAMERA.focal, window=CAMERA.window)
        start = time.perf_counter()
        updates = self.updates if self.frames else self._at_first
        budget = Budget(updates=updates, costs=self._model.costs, done=self._done)
        plan = self.technique.plan(view, now=0.0, budget=budget)
        planning = time.perf_counter() - start
        drawn = self._renderer.draw(plan, view, read=False)
        took = 1e3 * (time.perf_counter() - start)
        self._model, self._done = self._model.after(drawn.done, planning=planning), drawn.done
        boxes = self.technique.latest if isinstance(self.technique, ImageCache) else None
        self.frames.append(Frame(took, len(plan.requests), drawn.triangles, boxes))


def in_turn(places: Sequence[Where], contenders: dict[str, Contender], told: str, *, seldom: int = 1) -> None:
    """Each place by all; full and culled only at every ``seldom``-th."""
    names = list(contenders)
    for i, where in enumerate(places):
        for name in names if i % 2 else reversed(names):
            if name.startswith("image") or i % seldom == 0:
                contenders[name].frame(where)
        if i % 10 == 9 or i == len(places) - 1:
            print(f"\r{told}: {i + 1} of {len(places)} frames", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)


def print_times(contenders: dict[str, Contender], told: str) -> list[dict[str, Any]]:
    """A table of frame times and of what boxes were."""
    print(f"\n{told}")
    print(
        "| technique | first ms | ms p50 | p95 | slowest | to full | triangles | new | combined | reused | as geometry |"
    )
    print("|" + "---|" * 11)
    full = float(np.median([one.ms for one in contenders["full"].frames])) if "full" in contenders else math.nan
    rows = []
    for name, one in contenders.items():
        ms = np.array([frame.ms for frame in one.frames])
        later = ms[1:] if len(ms) > 1 else ms
        boxes = [frame.boxes for frame in one.frames[1:] if frame.boxes is not None]
        means = [float(np.mean([getattr(box, kind) for box in boxes])) if boxes else math.nan for kind in KINDS]
        row = {
            "technique": name,
            "first": float(ms[0]),
            "p50": float(np.median(later)),
            "p95": float(np.percentile(later, 95)),
            "slowest": float(later.max()),
            "to_full": full / float(np.median(later)),
            "triangles": float(np.mean([frame.triangles for frame in one.frames[1:] or one.frames])),
            "boxes": dict(zip(KINDS, means, strict=True)),
            "kept_px": max((box.kept_px for box in boxes), default=math.nan),
            "late": float(np.mean([box.late for box in boxes])) if boxes else math.nan,
            "bytes": max((box.bytes for box in boxes), default=0),
        }
        rows.append(row)
        print(
            f"| {name} | {row['first']:.0f} | {row['p50']:.1f} | {row['p95']:.1f} | {row['slowest']:.1f} | "
            f"{row['to_full']:.2f} | {row['triangles']:,.0f} | " + " | ".join(f"{mean:.1f}" for mean in means) + " |",
            flush=True,
        )
    for row in rows:
        if row["bytes"]:
            print(
                f"{row['technique']}: {row['bytes'] / 1e6:.0f} MB of images, off by {row['kept_px']:.2f} px at most, "
                f"{row['late']:.1f} late a frame"
            )
    return rows


def written(out: Path, name: str, values: object) -> None:
    """Keep what was found as JSON."""
    out.mkdir(parents=True, exist_ok=True)
    (out / f"{name}.json").write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")


def plot_boxes(tallies: Sequence[CacheTally], out: Path, name: str, title: str, total: int) -> None:
    """Numbers of boxes along a walk: figures 6 and 7."""
    figure = new_figure(7.0, 3.0)
    axes = figure.subplots()
    for kind in KINDS:
        axes.plot([getattr(one, kind) for one in tallies], color=LINES[kind], lw=1.2, label=kind)
    axes.plot([one.bytes / 1e5 for one in tallies], color="#7B4FA3", lw=1.0, ls=":", label="texture memory, 100 kB")
    axes.set_ylabel(f"boxes, of {total}", fontsize=SMALL)
    axes.set_xlabel("frame", fontsize=SMALL)
    axes.set_title(title, fontsize=SMALL + 2, loc="left")
    axes.set_yscale("symlog", linthresh=10.0)
    axes.tick_params(labelsize=SMALL)
    axes.set_ylim(top=2e4)  # room for the legend
    axes.legend(fontsize=SMALL, frameon=False, ncols=5, loc="upper left")
    tidy(axes)
    out.mkdir(parents=True, exist_ok=True)
    save(figure, out / f"{name}.png")


def plot_maps(
    technique: ImageCache, kinds: Sequence[dict[str, NDArray[np.int64]]], places: Sequence[Where], out: Path
) -> None:
    """The map of boxes in some frames, from above: figure 9."""
    columns = 5
    figure = new_figure(9.0, 1.95 * -(-len(kinds) // columns))
    boxes = technique.tree.boxes
    for i, (found, where) in enumerate(zip(kinds, places, strict=True)):
        axes = figure.add_subplot(-(-len(kinds) // columns), columns, i + 1)
        for kind in ("impossible", "reused", "combined", "new"):
            some = boxes[found[kind]]
            patches = [Rectangle(tuple(low[:2]), *(high - low)[:2]) for low, high in some]
            axes.add_collection(PatchCollection(patches, facecolor=COLORS[kind], edgecolor="#555555", linewidth=0.3))
        axes.plot(*where.eye[:2], "o", color="#1f77b4", ms=3)
        axes.set_xlim(boxes[0, :, 0])
        axes.set_ylim(boxes[0, :, 1])
        axes.set_aspect("equal")
        axes.set_axis_off()
        axes.set_title(f"frame {6 * i}", fontsize=SMALL - 1)
    save(figure, out / "figure9.png")


def flat(scene: WalkScene, out: Path) -> None:
    """Section 5.1."""
    technique = ImageCache(scene, CacheRules(eager=True, leaf_triangles=1, depth=4, largest=_LARGEST))
    low, high = technique.tree.boxes[0]
    height = float(scene.whereabouts.cells[0].reference[2])
    along = (high - low)[:2] / np.linalg.norm((high - low)[:2])
    azimuth = math.atan2(along[1], along[0])
    middle = 0.5 * (low + high)[:2]
    places = [Where(np.array([*(middle + _STEP * (k - 59.5) * along), height]), azimuth) for k in range(120)]
    tallies, kinds = [], []
    for k, where in enumerate(places):
        view = view_towards(where.eye, where.azimuth, 0.0, focal=CAMERA.focal, window=CAMERA.window)
        technique.plan(view, now=0.0, budget=Budget())
        tallies.append(technique.latest)
        if k % 6 == 0:
            kinds.append(technique.kinds)
    total = len(technique.tree.boxes)
    print(f"\nflat: {total} boxes (paper: 341), {len(places)} frames of {_STEP:g} m")
    for kind in KINDS:
        counts = [getattr(one, kind) for one in tallies[1:]]
        print(
            f"{kind}: {min(counts)} to {max(counts)}, mean {np.mean(counts):.1f} ({np.mean(counts) / total:.1%} of all)"
        )
    written(out, "flat", [one._asdict() for one in tallies])
    plot_boxes(tallies, out, "figure6", f"a diagonal walk over {total} boxes (paper, figure 6)", total)
    plot_maps(technique, kinds, places[::6], out)


def forest(out: Path, name: str) -> None:
    """Section 5.2."""
    scene = scene_of_city(generate("forest"), name="multi-mesh", camera=CAMERA)
    low, high = np.nanmin(scene.boxes[:, 0], axis=0), np.nanmax(scene.boxes[:, 1], axis=0)
    middle, size = 0.5 * (low + high), high - low
    eye_height = low[2] + 1.7
    if name == "forest-aside":
        places = [
            Where(np.array([low[0] + size[0] * k / 99, low[1] - 0.5 * size[1], eye_height]), 0.5 * math.pi)
            for k in range(100)
        ]
    else:
        corner, end = np.array([*low[:2], eye_height]), np.array([*middle[:2], eye_height])
        corner = corner - (end - corner)
        azimuth = math.atan2(*(end - corner)[1::-1])
        places = [Where(corner + (end - corner) * k / 99, azimuth) for k in range(100)]
    eager = CacheRules(eager=True, depth=4, leaf_triangles=1, largest=_LARGEST)
    with ExitStack() as stack:
        contenders = {
            "full": Contender(stack, scene, FullGeometry(scene)),
            "image-cache": Contender(stack, scene, ImageCache(scene)),
            "image-cache, eager": Contender(stack, scene, ImageCache(scene, eager)),
        }
        in_turn(places, contenders, name)
        rows = print_times(contenders, f"{name}: {len(scene.mesh.triangles):,} triangles, {len(places)} frames")
        shown = contenders["image-cache, eager"]
        assert isinstance(shown.technique, ImageCache)
        total = len(shown.technique.tree.boxes)
        print(f"{total} boxes (paper: 585)")
        tallies = [frame.boxes for frame in shown.frames if frame.boxes is not None]
        plot_boxes(tallies, out, f"figure7-{name}", f"{name}, {total} boxes (paper, figure 7)", total)
        written(out, name, {"rows": rows, "ms": {n: [f.ms for f in one.frames] for n, one in contenders.items()}})
        plot_times(contenders, out, f"figure8-{name}", f"{name} (paper, figure 8)")


def plot_times(contenders: dict[str, Contender], out: Path, name: str, title: str) -> None:
    """Frame times along a walk: figure 8."""
    figure = new_figure(7.0, 3.0)
    axes = figure.subplots()
    for (told, one), color in zip(
        contenders.items(), ("#222222", "#7B4FA3", "#E69F00", "#009E73", "#56B4E9", "#D55E00"), strict=False
    ):
        axes.plot([frame.ms for frame in one.frames], color=color, lw=1.0, label=told)
    axes.set_yscale("log")
    axes.set_ylabel("ms a frame", fontsize=SMALL)
    axes.set_xlabel("frame", fontsize=SMALL)
    axes.set_title(title, fontsize=SMALL + 2, loc="left")
    axes.tick_params(labelsize=SMALL)
    axes.legend(fontsize=SMALL, frameon=False, ncols=3)
    tidy(axes)
    save(figure, out / f"{name}.png")


def large(district: WalkScene, options: argparse.Namespace) -> None:
    """Seven million triangles."""
    steps = walked(district, options.frames, speed=options.speed, fps=30.0, seed=1)
    scene = grown(district, options.triangles, steps)
    places = [Where(np.array(step.pose.eye), step.pose.azimuth, step.pose.pitch) for step in steps]
    updates = 1e-3 * _BUDGET_MS
    walks: list[dict[str, Contender]] = []
    for repeat in range(options.repeats):
        with ExitStack() as stack:
            walks.append(
                {
                    "full": Contender(stack, scene, FullGeometry(scene)),
                    "full, culled": Contender(stack, scene, Culled(scene)),
                    "image-cache": Contender(stack, scene, ImageCache(scene)),
                    "image-cache, frustum": Contender(stack, scene, ImageCache(scene, CacheRules(keep="frustum"))),
                    "image-cache, 5 ms": Contender(stack, scene, ImageCache(scene), updates=updates),
                    "image-cache, warm, 5 ms": Contender(
                        stack, scene, ImageCache(scene), updates=updates, at_first=math.inf
                    ),
                }
            )
            in_turn(places, walks[-1], f"large, walk {repeat + 1} of {options.repeats}", seldom=5)
    told = f"large: {len(scene.mesh.triangles):,} triangles, {len(places)} frames of {CAMERA.width} x {CAMERA.height}, "
    told += f"{options.speed:g} m/s"
    rows = print_times(walks[0], told)
    if options.repeats > 1:
        for name, one in walks[0].items():
            one.frames = [
                frame._replace(ms=min(walk[name].frames[k].ms for walk in walks)) for k, frame in enumerate(one.frames)
            ]
        rows = print_times(walks[0], f"{told}, of {options.repeats} walks the fastest of each frame")
    written(options.out, "large", {"rows": rows, "ms": {n: [f.ms for f in c.frames] for n, c in walks[0].items()}})


def turning(district: WalkScene, out: Path) -> None:
    """On the spot, by 3 degrees a frame, twice around."""
    eye = district.whereabouts.cells[0].reference
    found = {}
    for keep in ("sphere", "frustum"):
        technique = ImageCache(district, CacheRules(eager=True, leaf_triangles=200, keep=keep))
        counts = []
        for k in range(240):
            view = view_towards(eye, math.radians(3.0 * k), 0.0, focal=CAMERA.focal, window=CAMERA.window)
            counts.append(len(technique.plan(view, now=0.0, budget=Budget()).requests))
        found[keep] = counts
        print(
            f"turning, {keep}: {counts[0]} images captured in the first frame, {sum(counts[1:120])} in the first turn, "
            f"{sum(counts[120:])} in the second"
        )
    written(out, "turning", found)


def main() -> None:
    names = ("flat", "forest-aside", "forest-zoom", "large", "turning")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("city", type=Path, metavar="CITY", help="a district on flat ground; what build-impostors reads")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="DIR", help="gets tables as JSON, and plots")
    parser.add_argument("--only", default=",".join(names), metavar="NAME,...", help="(default: %(default)s)")
    parser.add_argument("--frames", type=int, default=200, help="of the walk of large (default: %(default)s)")
    parser.add_argument("--speed", type=float, default=5.0, metavar="M/S", help="of it (default: %(default)s)")
    parser.add_argument(
        "--repeats", type=int, default=1, help="of it; machines are noisy, and a frame is as slow as its fastest"
    )
    parser.add_argument("--triangles", type=int, default=LARGE, help="of its city (default: %(default)s)")
    options = parser.parse_args()
    wanted = options.only.split(",")
    if unknown := [one for one in wanted if one not in names]:
        parser.error(f"--only: some of {', '.join(names)} expected, found {', '.join(unknown)}")
    district = district_of(options.city, CAMERA)
    options.out.mkdir(parents=True, exist_ok=True)
    for name in wanted:
        match name:
            case "flat":
                flat(district, options.out)
            case "forest-aside" | "forest-zoom":
                forest(options.out, name)
            case "large":
                large(district, options)
            case _:
                turning(district, options.out)


if __name__ == "__main__":
    main()
