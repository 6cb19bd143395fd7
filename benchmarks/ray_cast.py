"""Figures 8 to 11 of Wimmer, Giegl & Schmalstieg 1998 on this renderer: what ray casting the far field gains, beside theirs.

    python benchmarks/ray_cast.py examples/helsinki/helsinki.osm.pbf -o out/ray-cast
    python benchmarks/ray_cast.py examples/helsinki/helsinki.osm.pbf -o out/ray-cast --only figure8-large

figure8, figure8-large    frame times along a walk at 640 x 480: all geometry, all geometry culled to the view by the cells of a
                          regular grid, the near field alone, and ray casting; in the paper's size of city, and in a large one
figure9                   near fields of several sizes: frame times, and pixels that are cast
figure10, figure10-large  most of the city in view, at 320 x 240: from its rim in the streets, and from above its roofs
figure11                  what pixels are: covered, sky, reused, cast

The techniques take turns frame by frame, each with a renderer of its own, so that a noisy machine meets all alike. ``to full``
and ``to near only`` are how many times as fast the median frame is; ``cores' ms`` is the median of what all cores did together.
A frame is timed from the view to the finished picture, which is not read back. Full is drawn every few frames in a large city.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import numpy as np
from casting import (
    CAST,
    COLORS,
    CULLED,
    FULL,
    LARGE,
    NEAR,
    PAPER_SIZE,
    Culled,
    Timed,
    common_options,
    contender,
    district_of,
    grown,
    in_turn,
    print_rows,
    rows_of,
    rules_of,
    walked,
    written,
)
from matplotlib.figure import Figure

from mmi.foundation.camera import Camera
from mmi.inspection.figures import SMALL, new_figure, tidy
from mmi.walks.walk import Pose, Step
from viewer.scene.scene import WalkScene

CAMERA, SMALL_CAMERA = Camera(640, 480, math.radians(60.0)), Camera(320, 240, math.radians(60.0))
_ALL = (FULL, CULLED, NEAR, CAST)
_NEAR_FIELDS = (25.0, 50.0, 100.0, 200.0, 400.0)
_PAPER_FPS = {
    "figure8": {FULL: 2.0, CAST: 9.25},
    "figure10": {FULL: 1.1, CAST: 16.3},
}
"""The paper's average frames a second."""
_PAPER_SHARES = {
    "covered": (60.37, 75.89, 92.62),
    "sky": (7.38, 23.76, 39.21),
    "reused": (0.0, 0.13, 0.81),
    "cast and hit": (0.0, 0.13, 0.49),
    "cast and missed": (0.0, 0.10, 0.38),
}
"""Percent of pixels in figure 11: the least, the mean and the most of all frames."""
_ABOVE = 40.0
"""Metres above the highest roof from which a city is looked down at."""
_DOWN = math.radians(-8.0)


def compared(scene: WalkScene, steps: Sequence[Step], options: argparse.Namespace, told: str) -> dict[str, Timed]:
    """A walk by all techniques."""
    every = {
        FULL: max(1, len(scene.mesh.triangles) // 1_000_000),
        CULLED: max(1, len(scene.mesh.triangles) // 2_000_000),
    }
    with ExitStack() as stack:
        runners = {name: contender(stack, scene, name, rules_of(options), every=every.get(name, 1)) for name in _ALL}
        return in_turn(steps, runners, told)


def figure8(district: WalkScene, options: argparse.Namespace, triangles: int, name: str) -> None:
    """Frame times along a walk."""
    steps = the_walk(district, options)
    scene = grown(district, triangles, steps)
    found = compared(scene, steps, options, name)
    rows = rows_of(f"{len(scene.mesh.triangles):,}", found)
    print(f"\n{name}: {len(steps)} frames of {CAMERA.width} x {CAMERA.height}, near field of {options.near_field:g} m")
    print_rows(rows)
    told_beside_paper("figure8", rows)
    print_shares(shares_of(found[CAST]))
    written(
        options,
        name,
        {"rows": rows, "ms": {one: timed.ms.tolist() for one, timed in found.items()}},
        along(found, f"{len(scene.mesh.triangles):,} triangles, 640 x 480", _PAPER_FPS["figure8"]),
    )


def figure9(district: WalkScene, options: argparse.Namespace) -> None:
    """Near fields of several sizes."""
    steps = the_walk(district, options)
    scene = grown(district, PAPER_SIZE, steps)
    with ExitStack() as stack:
        runners = {
            f"{reach:g} m": contender(stack, scene, CAST, rules_of(options, near_field=reach)) for reach in _NEAR_FIELDS
        }
        found = in_turn(steps, runners, "figure9")
    print(f"\nfigure9: near fields, {len(scene.mesh.triangles):,} triangles, {len(steps)} frames")
    print(
        "| near field | ms p50 | p95 | largest | cores' ms | triangles | cast a frame, median | p95 | largest | reused |"
    )
    print("|" + "---|" * 10)
    rows = []
    for name, timed in found.items():
        cast = np.array([one.rays for one in timed.pixels])
        row = {
            "near_field": name,
            "p50": float(np.median(timed.ms)),
            "p95": float(np.percentile(timed.ms, 95)),
            "largest": float(timed.ms[1:].max()),
            "cores_ms": 1e3 * float(np.median(timed.processor)),
            "triangles": round(float(np.mean(timed.triangles))),
            "cast": [float(one) for one in (*np.percentile(cast[1:], [50, 95]), cast[1:].max())],
            "reused": float(np.mean([one.reused for one in timed.pixels])),
        }
        rows.append(row)
        print(
            f"| {name} | {row['p50']:.1f} | {row['p95']:.1f} | {row['largest']:.1f} | {row['cores_ms']:.1f} | "
            f"{row['triangles']:,} | {' | '.join(f'{one:.0f}' for one in row['cast'])} | {row['reused']:.0f} |"
        )
    print("the first frame, of which nothing was known, is left out of the largest and of what is cast")
    figure = new_figure(8.0, 5.0)
    above, below = figure.subplots(2, 1, sharex=True)
    for shade, (name, timed) in zip(np.linspace(0.85, 0.15, len(found)), found.items(), strict=True):
        color = (shade, 0.3, 1.0 - shade)
        above.plot(smooth(timed.ms), linewidth=0.9, color=color, label=name)
        below.plot([max(one.rays, 1) for one in timed.pixels], linewidth=0.7, color=color)
    above.set_ylabel("frame (ms)", fontsize=SMALL)
    below.set_ylabel("rays cast", fontsize=SMALL)
    below.set_yscale("log")
    below.set_xlabel("frame", fontsize=SMALL)
    above.set_title(
        "the paper's figure 9: best at 60 to 100 m; nearer is uneven, farther costs triangles", fontsize=SMALL
    )
    finished((above, below))
    written(options, "figure9", {"rows": rows}, figure)


def figure10(district: WalkScene, options: argparse.Namespace, triangles: int, name: str) -> None:
    """Most of the city in view: from its rim along streets, and from above."""
    small = replace(district, camera=SMALL_CAMERA)
    steps = the_walk(small, options)
    scene = grown(small, triangles, steps)
    middle = np.nanmean(scene.boxes[:, :, :2].mean(axis=1), axis=0)
    top = float(np.nanmax(scene.boxes[:, 1, 2]))
    rows = []
    for told, looked in (
        ("from the rim, in streets", from_rim(scene, district, steps, middle)),
        ("from above", from_above(steps, middle, scene, top + _ABOVE)),
    ):
        shown = [Culled(scene).share(step.pose.view(SMALL_CAMERA)) for step in looked[:: max(1, len(looked) // 10)]]
        found = compared(scene, looked, options, f"{name}, {told}")
        print(
            f"\n{name}, {told}: {len(steps)} frames of 320 x 240, {100.0 * float(np.mean(shown)):.0f} % of "
            f"{len(scene.mesh.triangles):,} triangles in view"
        )
        some = rows_of(f"{len(scene.mesh.triangles):,}", found)
        print_rows(some)
        told_beside_paper("figure10", some)
        print_shares(shares_of(found[CAST]))
        rows += [{**row, "from": told} for row in some]
        where = name if told.endswith("streets") else f"{name}-above"
        written(options, where, {"rows": rows}, along(found, f"320 x 240, {told}", _PAPER_FPS["figure10"]))


def figure11(district: WalkScene, options: argparse.Namespace) -> None:
    """What pixels are, along the walk of figure 8."""
    steps = the_walk(district, options)
    for triangles in (PAPER_SIZE, LARGE):
        scene = grown(district, triangles, steps)
        with ExitStack() as stack:
            runners = {CAST: contender(stack, scene, CAST, rules_of(options))}
            shares = shares_of(in_turn(steps, runners, "figure11")[CAST])
        print(f"\nfigure11: {len(scene.mesh.triangles):,} triangles, percent of the pixels of {len(steps)} frames")
        print_shares(shares)
        written(options, f"figure11-{triangles}", shares)


# -------------------------------------------------------------------------------------------------------- the walks


def the_walk(district: WalkScene, options: argparse.Namespace) -> tuple[Step, ...]:
    return walked(district, options.frames, speed=options.speed, fps=options.fps, seed=options.seed)


def from_rim(scene: WalkScene, district: WalkScene, steps: Sequence[Step], middle: np.ndarray) -> tuple[Step, ...]:
    """The walk moved to the copy of its district that is farthest west, looking at the middle of the city all the time."""
    low, high = np.nanmin(district.boxes[:, 0, :2], axis=0), np.nanmax(district.boxes[:, 1, :2], axis=0)
    period = high - low + 10.0
    here = np.mean([step.pose.eye[:2] for step in steps], axis=0)
    rim = float(np.nanmin(scene.boxes[:, 0, 0]))
    copies = max(0, math.floor((here[0] - rim) / period[0] - 0.25))
    shift = np.array([-copies * period[0], 0.0, 0.0])
    return tuple(looking(step, np.array(step.pose.eye) + shift, middle, 0.0) for step in steps)


def from_above(steps: Sequence[Step], middle: np.ndarray, scene: WalkScene, height: float) -> tuple[Step, ...]:
    """The same path above the western rim at some height, looking down at the city."""
    start = np.array(steps[0].pose.eye)
    rim = np.array([float(np.nanmin(scene.boxes[:, 0, 0])), middle[1], height])
    return tuple(
        looking(step, rim + (np.array(step.pose.eye) - start) * (1.0, 1.0, 0.0), middle, _DOWN) for step in steps
    )


def looking(step: Step, eye: np.ndarray, at: np.ndarray, pitch: float) -> Step:
    """The step from another place, turned towards another."""
    x, y = at - eye[:2]
    return replace(step, pose=Pose((float(eye[0]), float(eye[1]), float(eye[2])), math.atan2(y, x), pitch))


# -------------------------------------------------------------------------------------------- what is told and drawn


def shares_of(timed: Timed) -> dict[str, list[float]]:
    """Percent of pixels, the least, the mean and the most of all frames but the first, of which nothing was known."""
    pixels = timed.pixels[1:]
    counts = {
        "covered": [one.covered for one in pixels],
        "sky": [one.sky for one in pixels],
        "reused": [one.reused + one.late for one in pixels],
        "cast and hit": [one.hit for one in pixels],
        "cast and missed": [one.missed for one in pixels],
    }
    total = np.sum(list(counts.values()), axis=0)
    shares = {name: 100.0 * np.array(some) / total for name, some in counts.items()}
    return {name: [float(one.min()), float(one.mean()), float(one.max())] for name, one in shares.items()}


def print_shares(shares: Mapping[str, Sequence[float]]) -> None:
    print("| % of pixels | min | mean | max | paper: min | mean | max |")
    print("|" + "---|" * 7)
    for name, some in shares.items():
        print(f"| {name} | {' | '.join(f'{one:.2f}' for one in (*some, *_PAPER_SHARES[name]))} |", flush=True)


def told_beside_paper(figure: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """How many times as fast ray casting is, and whether it can win at all."""
    paper = _PAPER_FPS[figure]
    by = {row["technique"]: row for row in rows}
    ratio, bound = by[CAST]["to_full"], by[NEAR]["to_full"]
    print(
        f"ray-cast is {ratio:.2f} times as fast as full, {by[CULLED]['p50'] / by[CAST]['p50']:.2f} times as full culled; "
        f"the paper {paper[CAST] / paper[FULL]:.1f} times ({paper[FULL]:g} to {paper[CAST]:g} frames a second)"
    )
    if bound <= 1.0:
        print("the near field alone takes as long as full: ray casting cannot win here")
    elif ratio <= 1.0:
        print(f"ray casting does not win here: the near field alone is only {bound:.2f} times as fast as full")


def smooth(values: np.ndarray, window: int = 5) -> np.ndarray:
    """The medians of some values around each."""
    padded = np.pad(values, window // 2, mode="edge")
    found: np.ndarray = np.median(np.lib.stride_tricks.sliding_window_view(padded, window), axis=1)
    return found


def along(found: Mapping[str, Timed], title: str, paper: Mapping[str, float]) -> Figure:
    """Frame times along the walk, and dashed the paper's averages: of as much of full as there."""
    figure = new_figure(8.0, 3.6)
    axes = figure.subplots()
    for name, timed in found.items():
        frames = np.flatnonzero(np.isfinite(timed.seconds))
        axes.plot(frames, smooth(timed.ms), color=COLORS[name], linewidth=0.9, label=name)
    full = float(np.mean(found[FULL].ms))
    axes.axhline(
        full * paper[FULL] / paper[CAST],
        color=COLORS[CAST],
        linestyle="--",
        linewidth=0.8,
        label=f"paper's ray casting, {paper[CAST] / paper[FULL]:.1f} x full",
    )
    axes.set_yscale("log")
    axes.set_ylabel("frame (ms, medians of 5)", fontsize=SMALL)
    axes.set_xlabel("frame", fontsize=SMALL)
    axes.set_title(title, fontsize=SMALL)
    finished((axes,))
    return figure


def finished(panels: Sequence[Any]) -> None:
    for axes in panels:
        axes.tick_params(labelsize=SMALL)
        tidy(axes)
    panels[0].legend(fontsize=SMALL, frameon=False, ncols=3)


EXPERIMENTS = {
    "figure8": lambda district, options: figure8(district, options, PAPER_SIZE, "figure8"),
    "figure8-large": lambda district, options: figure8(district, options, LARGE, "figure8-large"),
    "figure9": figure9,
    "figure10": lambda district, options: figure10(district, options, PAPER_SIZE, "figure10"),
    "figure10-large": lambda district, options: figure10(district, options, LARGE, "figure10-large"),
    "figure11": figure11,
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
