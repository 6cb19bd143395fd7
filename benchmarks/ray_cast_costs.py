"""What ray casting the far field costs (Wimmer, Giegl & Schmalstieg 1998), and what it depends on: experiments the paper lacks.

    python benchmarks/ray_cast_costs.py examples/helsinki/helsinki.osm.pbf -o out/ray-cast --frames 100
    python benchmarks/ray_cast_costs.py examples/helsinki/helsinki.osm.pbf -o out/ray-cast --frames 100 --only extent

extent   frame times in cities of 10,000 to ten million triangles that grow in extent: all at a time, frame by frame in turn
detail   the same, where one district's triangles are cut finer
still    rays cast in each frame: walking, then standing still, then turning on the spot
halves   the last frame's rays cast in a thread while the near field is drawn, against one after the other
depth    depths read back from the renderer, against a software pass over the near field's triangles
steps    where a frame's time goes, in a large city
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import numpy as np
from casting import (
    BUDGET,
    CAST,
    COLORS,
    FULL,
    LARGE,
    NEAR,
    PAPER_SIZE,
    Contender,
    Timed,
    common_options,
    contender,
    contender_of,
    district_of,
    finer,
    grown,
    in_turn,
    rules_of,
    walked,
    written,
)
from matplotlib.figure import Figure
from numpy.typing import NDArray
from software_depth import software_depths

from mmi.appearance.city_mesh import triangles_of
from mmi.foundation.camera import Camera
from mmi.inspection.figures import SMALL, new_figure, tidy
from mmi.walks.walk import Pose, Step
from viewer.casting.far_field import far_field_of
from viewer.drawing.renderer import Renderer
from viewer.plan import Draw, Ground, Objects
from viewer.scene.scene import WalkScene

CAMERA = Camera(640, 480, math.radians(60.0))
_SIZES = (10_000, 30_000, 100_000, 300_000, 1_000_000, 3_000_000, 10_000_000)
_CUTS = (1, 2, 3, 6, 10, 17)
_FULL_FRAMES = 5
_STILL, _TURN = 40, math.radians(3.0)
"""Frames that a viewer stands, and how far it turns from frame to frame then."""
_RAYS = 32768


def extent(district: WalkScene, options: argparse.Namespace) -> None:
    """Cities that grow in extent."""
    steps = the_walk(district, options)
    scenes = {size: grown(district, size, steps) for size in _SIZES}
    measured_growth("extent", scenes, steps, options)


def detail(district: WalkScene, options: argparse.Namespace) -> None:
    """One district that grows in detail."""
    steps = the_walk(district, options)
    scenes = {}
    for cuts in _CUTS:
        scene = finer(district, cuts)
        scenes[len(scene.mesh.triangles)] = scene
    measured_growth("detail", scenes, steps, options)


def measured_growth(
    name: str, scenes: dict[int, WalkScene], steps: Sequence[Step], options: argparse.Namespace
) -> None:
    """All cities held at a time, and frames of all of them in turn; then some frames of all geometry of each."""
    with ExitStack() as stack:
        cast = {size: contender(stack, scene, CAST, rules_of(options)) for size, scene in scenes.items()}
        near = {
            size: Contender(contender_of(scenes[size], NEAR, rules_of(options)), one.renderer, one.camera)
            for size, one in cast.items()
        }
        runners = {f"{size}": one for size, one in cast.items()} | {f"{size} near": one for size, one in near.items()}
        found = in_turn(steps, runners, name)
        full: dict[int, Timed] = {}
        for size, one in cast.items():
            runner = Contender(contender_of(scenes[size], FULL, rules_of(options)), one.renderer, one.camera)
            for step in steps[:: max(1, len(steps) // _FULL_FRAMES)]:
                runner.frame(replace(step, index=0))
            full[size] = runner.timed
    print(f"\n{name}: {len(steps)} frames of 640 x 480; full: some of them, in turn with nothing")
    print(
        "| triangles | ray-cast ms p50 | p95 | cores' ms | to 100,000 | near only ms p50 | cores' ms | full ms p50 | rays |"
    )
    print("|" + "---|" * 9)
    base = min(scenes, key=lambda size: abs(math.log(size / 100_000)))
    rows = []
    for size in scenes:
        one, bare = found[f"{size}"], found[f"{size} near"]
        row = {
            "triangles": len(scenes[size].mesh.triangles),
            "p50": float(np.median(one.ms)),
            "p95": float(np.percentile(one.ms, 95)),
            "cores_ms": 1e3 * float(np.median(one.processor)),
            "to_base": float(np.median(one.ms) / np.median(found[f"{base}"].ms)),
            "near_p50": float(np.median(bare.ms)),
            "near_cores_ms": 1e3 * float(np.median(bare.processor)),
            "full_p50": float(np.median(full[size].ms[1:])),
            "rays": float(np.mean([tally.rays for tally in one.pixels[1:]])),
        }
        rows.append(row)
        print(
            f"| {row['triangles']:,} | {row['p50']:.1f} | {row['p95']:.1f} | {row['cores_ms']:.1f} | {row['to_base']:.2f} | "
            f"{row['near_p50']:.1f} | {row['near_cores_ms']:.1f} | {row['full_p50']:.1f} | {row['rays']:.0f} |",
            flush=True,
        )
    written(options, name, {"rows": rows}, growth_plot(rows, f"a city that grows in {name}, 640 x 480"))


def still(district: WalkScene, options: argparse.Namespace) -> None:
    """Rays of each frame: on the way, standing, and turning once around."""
    steps = list(the_walk(district, options))
    last = steps[-1]
    around = math.ceil(2.0 * math.pi / _TURN)
    poses = [last.pose] * _STILL
    poses += [
        Pose(last.pose.eye, math.remainder(last.pose.azimuth + i * _TURN, math.tau), 0.0) for i in range(1, 2 * around)
    ]
    steps += [
        replace(last, index=last.index + 1 + i, time=last.time + (1 + i) / options.fps, pose=pose, cut=False)
        for i, pose in enumerate(poses)
    ]
    scene = grown(district, LARGE, steps)
    with ExitStack() as stack:
        found = in_turn(steps, {CAST: contender(stack, scene, CAST, rules_of(options))}, "still")[CAST]
    rays = np.array([one.rays for one in found.pixels])
    open_pixels = np.array([one.rays + one.reused + one.late for one in found.pixels])
    start = len(steps) - len(poses)
    parts = {
        "walking": slice(1, start),
        "standing, the first four frames": slice(start, start + 4),
        "standing, all later frames": slice(start + 4, start + _STILL),
        f"turning {math.degrees(_TURN):g} degrees a frame, once around": slice(start + _STILL, start + _STILL + around),
        "turning, the second time around": slice(start + _STILL + around, len(steps)),
    }
    print(f"\nstill: rays cast a frame, of {CAMERA.width * CAMERA.height} pixels")
    print("| | frames | mean | most | pixels that needed a ray or a texel, mean |")
    print("|" + "---|" * 5)
    rows = []
    for told, part in parts.items():
        some = rays[part]
        rows.append(
            {"part": told, "mean": float(some.mean()), "most": int(some.max()), "open": float(open_pixels[part].mean())}
        )
        print(
            f"| {told} | {len(some)} | {some.mean():.0f} | {some.max()} | {open_pixels[part].mean():.0f} |", flush=True
        )
    figure = new_figure(8.0, 3.0)
    axes = figure.subplots()
    axes.plot(np.maximum(rays, 0.5), linewidth=0.8, color=COLORS[CAST], label="rays cast")
    axes.plot(np.maximum(open_pixels, 0.5), linewidth=0.8, color="#777777", label="pixels that needed a ray or a texel")
    for place in (start, start + _STILL, start + _STILL + around):
        axes.axvline(place, color="#222222", linewidth=0.6, linestyle=":")
    axes.set_yscale("log")
    axes.set_xlabel("frame: walking, standing, turning twice around", fontsize=SMALL)
    axes.legend(fontsize=SMALL, frameon=False)
    axes.tick_params(labelsize=SMALL)
    tidy(axes)
    written(options, "still", {"rows": rows, "rays": rays.tolist()}, figure)


def halves(district: WalkScene, options: argparse.Namespace) -> None:
    """Casting beside drawing: what a second half of the machine would gain."""
    steps = the_walk(district, options)
    scene = grown(district, LARGE, steps)
    rules = rules_of(options, workers=1)
    rng = np.random.default_rng(options.seed)
    with ExitStack() as stack:
        near = contender(stack, scene, NEAR, rules)
        caster = far_field_of(scene, rules).caster
        other = stack.enter_context(ThreadPoolExecutor(1))
        took: dict[str, list[float]] = {name: [] for name in ("drawing", "casting", "one after the other", "at once")}
        for step in steps:
            view = step.pose.view(CAMERA)
            u, v = rng.uniform(-320.0, 320.0, _RAYS), rng.uniform(-80.0, 0.0, _RAYS)  # above the horizontal
            directions = view.unproject(u, v, np.ones(_RAYS)) - view.eye
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)

            def cast(eye: NDArray[np.float64] = view.eye, along: NDArray[np.float64] = directions) -> None:
                caster.first_hits(eye, along, nearest=rules.near_field)

            start = time.perf_counter()
            near.frame(step)
            drawn = time.perf_counter()
            cast()
            end = time.perf_counter()
            waiting = other.submit(cast)
            near.frame(step)
            waiting.result()
            both = time.perf_counter() - end
            for name, value in zip(took, (drawn - start, end - drawn, end - start, both), strict=True):
                took[name].append(value)
    found = {name: 1e3 * float(np.median(values)) for name, values in took.items()}
    ratio = float(np.median(np.array(took["one after the other"]) / np.array(took["at once"])))
    print(
        f"\nhalves: {_RAYS} rays of a thread beside the near field of {LARGE:,} triangles, ms (medians of {len(steps)} frames)"
    )
    print("| " + " | ".join(found) + " | gain |")
    print("|" + "---|" * (len(found) + 1))
    print("| " + " | ".join(f"{value:.1f}" for value in found.values()) + f" | {ratio:.2f} |", flush=True)
    written(options, "halves", {**found, "gain": ratio, "device": near.renderer.device})


def depth(district: WalkScene, options: argparse.Namespace) -> None:
    """Depths: read back, or of a pass of our own."""
    steps = the_walk(district, options)
    scene = grown(district, PAPER_SIZE, steps)
    rules = rules_of(options)
    with ExitStack() as stack:
        renderer = stack.enter_context(Renderer(scene.mesh, scene.ground, size=(CAMERA.width, CAMERA.height)))
        near = contender_of(scene, NEAR, rules)
        kept: list[NDArray[np.float32]] = []

        def keep(depths: NDArray[np.float32], _: int) -> tuple[Draw, ...]:
            kept[:] = [depths]
            return ()

        took: dict[str, list[float]] = {name: [] for name in ("drawn", "drawn and read", "software")}
        agree, counts = [], []
        for step in steps:
            view = step.pose.view(CAMERA)
            plan = near.plan(view, now=step.time, budget=BUDGET)
            renderer.draw(plan, view, read=False)  # its index buffers are there now
            times = [time.perf_counter()]
            renderer.draw(plan, view, read=False)
            times.append(time.perf_counter())
            renderer.draw(replace(plan, finish=keep), view, read=False)
            times.append(time.perf_counter())
            sets = [
                (scene.mesh, draw.objects)
                if isinstance(draw, Objects)
                else (scene.ground, np.array(draw.tiles, np.int64))
                for draw in plan.draws
                if isinstance(draw, (Objects, Ground))
            ]
            parts = [(mesh.positions, triangles_of(mesh, objects)) for mesh, objects in sets]
            gathered = time.perf_counter()
            found = software_depths(parts, view)
            end = time.perf_counter()
            for name, value in zip(took, (*np.diff(times), end - gathered), strict=True):
                took[name].append(value)
            near_enough = kept[0] <= rules.near_field
            agree.append(float((near_enough == (found <= rules.near_field)).mean()))
            counts.append(sum(len(triangles) for _, triangles in parts))
    ms = {name: 1e3 * float(np.median(values[1:])) for name, values in took.items()}
    read = 1e3 * float(np.median(np.array(took["drawn and read"]) - np.array(took["drawn"])))
    print(f"\ndepth: ms a frame of {CAMERA.width} x {CAMERA.height}, medians of {len(steps)} frames")
    print("| read back | software pass | its triangles | pixels that both call covered, or open, % |")
    print("|---|---|---|---|")
    print(f"| {read:.1f} | {ms['software']:.1f} | {np.mean(counts):.0f} | {100.0 * np.mean(agree):.2f} |", flush=True)
    written(options, "depth", {**ms, "read": read, "triangles": float(np.mean(counts)), "agree": float(np.mean(agree))})


def parts_of_frames(district: WalkScene, options: argparse.Namespace) -> None:
    """Where a frame's time goes."""
    steps = the_walk(district, options)
    scene = grown(district, LARGE, steps)
    with ExitStack() as stack:
        found = in_turn(
            steps, {name: contender(stack, scene, name, rules_of(options)) for name in (NEAR, CAST)}, "steps"
        )
    near, cast = (1e3 * np.median(np.array(found[name].parts), axis=0) for name in (NEAR, CAST))
    row = {
        "planning": float(cast[0]),
        "of that, near": float(near[0]),
        "drawing the near field": float(near[2]),
        "reading depths, drawing pixels": float(cast[2] - near[2]),
        "finding, casting": float(cast[1]),
        "a frame": float(np.median(found[CAST].ms)),
        "near only": float(np.median(found[NEAR].ms)),
    }
    print(f"\nsteps: ms, medians of {len(steps)} frames in a city of {len(scene.mesh.triangles):,} triangles")
    print("| " + " | ".join(row) + " |")
    print("|" + "---|" * len(row))
    print("| " + " | ".join(f"{value:.1f}" for value in row.values()) + " |", flush=True)
    written(options, "steps", row)


def the_walk(district: WalkScene, options: argparse.Namespace) -> tuple[Step, ...]:
    return walked(district, options.frames, speed=options.speed, fps=options.fps, seed=options.seed)


def growth_plot(rows: Sequence[dict[str, Any]], title: str) -> Figure:
    """Frame times against the size of the city."""
    figure = new_figure(5.0, 3.6)
    axes = figure.subplots()
    sizes = [row["triangles"] for row in rows]
    for key, name in (("full_p50", FULL), ("near_p50", NEAR), ("p50", CAST)):
        axes.plot(
            sizes, [row[key] for row in rows], color=COLORS[name], marker="o", markersize=3.0, linewidth=1.0, label=name
        )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("triangles of the city", fontsize=SMALL)
    axes.set_ylabel("frame (ms, median)", fontsize=SMALL)
    axes.set_title(title, fontsize=SMALL)
    axes.tick_params(labelsize=SMALL)
    axes.legend(fontsize=SMALL, frameon=False)
    tidy(axes)
    return figure


EXPERIMENTS: dict[str, Callable[[WalkScene, argparse.Namespace], None]] = {
    "extent": extent,
    "detail": detail,
    "still": still,
    "halves": halves,
    "depth": depth,
    "steps": parts_of_frames,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    common_options(parser)
    parser.add_argument("--only", default=",".join(EXPERIMENTS), metavar="NAME,...", help="(default: %(default)s)")
    options = parser.parse_args()
    wanted = options.only.split(",")
    if unknown := [one for one in wanted if one not in EXPERIMENTS]:
        parser.error(f"--only: some of {', '.join(EXPERIMENTS)} expected, found {', '.join(unknown)}")
    district = district_of(options.city, CAMERA, detail=options.detail)
    for name in wanted:
        EXPERIMENTS[name](district, options)


if __name__ == "__main__":
    main()
