"""Moving objects over a film: how wrong they are, how long their images last, and what a frame takes.

    citygen traffic --city out/helsinki --vehicles 1000 --seconds 30 -o out/helsinki.traffic.json
    python benchmarks/movers.py out/helsinki out/movers --movers out/helsinki.traffic.json --frames 500 --video

A viewer walks along the cells that see most movers, one after the other. Each frame is drawn with movers as geometry and as
virtual frames, over the geometry (full) and over layers (multi-mesh), and its movers are compared with those of full. What
layers alone are wrong by shows in "multi-mesh, geometry". Writes movers.json, a plot, and a film where one is wanted.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from mmi.dataset.reading import open_dataset
from mmi.movers.movers_file import read_movers
from mmi.walks.walk import Keyframe, Pose, Walk
from viewer.cells.scene_cache import cell_cache
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.drawing.renderer import Renderer
from viewer.measuring.mover_errors import mover_errors
from viewer.plan import Budget, Moving
from viewer.report.pictures import side_by_side
from viewer.report.video import VideoWriter
from viewer.runtime.cost_model import CostModel
from viewer.scene.movers_seen import movers_in
from viewer.scene.scene import WalkScene, open_scene
from viewer.techniques.catalogue import make_technique
from viewer.techniques.virtual_frames import FrameRules
from viewer.techniques.with_movers import WithMovers

_RATE = 30.0
_REACH = 150.0
"""Metres within which movers make a cell worth walking along."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--movers", type=Path, required=True, help="what citygen traffic wrote")
    parser.add_argument("--frames", type=int, default=500)
    parser.add_argument("--legs", type=int, default=5, help="cells that are walked along")
    parser.add_argument("--error", type=float, default=1.0, help="pixels that images of movers may be wrong by")
    parser.add_argument("--video", action="store_true")
    options = parser.parse_args()
    dataset = open_dataset(options.dataset)
    seconds = options.frames / _RATE
    still = open_scene(dataset, name="multi-mesh")
    scene = open_scene(dataset, name="multi-mesh", movers=read_movers(options.movers))
    walk = _walk(scene, options.legs, seconds)
    steps = walk.frames(_RATE)[: options.frames]
    scenes, bare = {"multi-mesh": scene}, {"multi-mesh": still}
    eager = FrameRules(limit_px=options.error, thrifty=False)
    thrifty = replace(eager, thrifty=True)
    common = replace(eager, calculation="common")
    variants = {
        "full, geometry": make_technique("full", scenes),
        "full, predictive": WithMovers(make_technique("full", bare), scene.movers, scene.camera, rules=eager),
        "multi-mesh, geometry": make_technique("multi-mesh", scenes),
        "multi-mesh, predictive": make_technique("multi-mesh", scenes, frames=eager),
        "multi-mesh, where it pays": make_technique("multi-mesh", scenes, frames=thrifty),
        "multi-mesh, common": make_technique("multi-mesh", scenes, frames=common),
    }
    first = len(scene.mesh.triangle_counts)
    size = (scene.camera.width, scene.camera.height)
    errors = {name: np.zeros((len(steps), 4), dtype=int) for name in variants}
    of_images = {name: np.zeros(4, dtype=int) for name in variants}
    drawn = {name: np.zeros(len(steps)) for name in variants}
    planned = {name: np.zeros(len(steps)) for name in variants}
    options.out.mkdir(parents=True, exist_ok=True)
    truths, plans_of = [], {}
    film = None
    for name, technique in variants.items():
        with (
            Renderer(scene.mesh, scene.ground, size=size, measured=True, movers=scene.movers) as renderer,
            cell_cache(scenes, renderer, measured=True) as cache,
        ):
            pictures = []
            model = CostModel()
            budget = Budget(1.0 / _RATE)
            for i, step in enumerate(steps):
                view = step.pose.view(scene.camera)
                start = time.perf_counter()
                plan = technique.plan(view, now=step.time, budget=budget)
                planned[name][i] = time.perf_counter() - start
                cache.want(plan.cells)
                cache.require(plan.cells)
                quick = renderer.draw(plan, view, read=False)
                drawn[name][i] = quick.seconds
                model = model.after(quick.done, planning=float(planned[name][i]))
                budget = replace(budget, costs=model.costs, done=quick.done)
                picture = renderer.draw(replace(plan, requests=(), drops=()), view, measured=True)
                if name == "full, geometry":
                    truths.append(replace(picture, depth=None, displacement=None))
                errors[name][i] = mover_errors(truths[i], picture, first=first)
                solid = [first + draw.which for draw in plan.draws if isinstance(draw, Moving)]
                of_images[name] += mover_errors(_without(truths[i], solid), _without(picture, solid), first=first)
                if options.video and name == "multi-mesh, predictive":
                    pictures.append(picture.color)
            plans_of[name] = pictures
    if options.video:
        panels = ("full, geometry", "multi-mesh, predictive")
        for truth, shown in zip(truths, plans_of["multi-mesh, predictive"], strict=True):
            frame = side_by_side([truth.color, shown], panels)
            if film is None:
                film = VideoWriter(options.out / "movers.mp4", (frame.shape[1], frame.shape[0]), _RATE)
                film.__enter__()
            film.add(frame)
        assert film is not None
        film.__exit__(None, None, None)
    report = {
        name: _told(errors[name], of_images[name], drawn[name], planned[name], technique)
        for name, technique in variants.items()
    }
    (options.out / "movers.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    _print(report)
    _plot(errors, drawn, options.out / "movers.png")


def _walk(scene: WalkScene, legs: int, seconds: float) -> Walk:
    """Along the cells and ways that see most movers nearby, for as long each, from the one that sees most at its time on."""
    each = seconds / legs
    ways = [(entry.viewing_cell, turned) for entry in scene.dataset.manifest.cells for turned in (False, True)]
    left, keyframes = ways, []
    for leg in range(legs):
        start = leg * each
        found = []
        for cell, turned in left:
            (x0, y0), (x1, y1) = (cell.q, cell.p) if turned else (cell.p, cell.q)
            azimuth = float(np.arctan2(y1 - y0, x1 - x0))
            poses = [Pose((x, y, float(cell.reference[2])), azimuth, 0.0) for x, y in ((x0, y0), (x1, y1))]
            seen = movers_in(poses[0].view(scene.camera), scene.movers, start + 0.5 * each)
            found.append((int((seen.distances < _REACH).sum()), cell.id, turned, poses))
        _, chosen, turned, poses = max(found, key=lambda one: (one[0], one[1], one[2]))
        left = [(cell, way) for cell, way in left if cell.id != chosen]
        keyframes += [Keyframe(start, poses[0], cut=leg > 0), Keyframe(start + each - 1e-4, poses[1])]
    return Walk("among movers", tuple(keyframes))


def _without(picture: DrawnPicture, solid: list[np.ndarray]) -> DrawnPicture:
    """The picture without movers that are geometry."""
    assert picture.object_ids is not None
    ids = (
        np.where(np.isin(picture.object_ids, np.concatenate(solid)), -1, picture.object_ids)
        if solid
        else picture.object_ids
    )
    return replace(picture, object_ids=ids)


def _told(
    errors: np.ndarray, of_images: np.ndarray, drawn: np.ndarray, planned: np.ndarray, technique: WithMovers
) -> dict[str, float | None]:
    truth, missing, surplus, hidden = errors.sum(axis=0).tolist()
    tally = technique.tally
    return {
        "mover_pixels": truth,
        "missing_share": missing / max(truth, 1),
        "surplus_share": surplus / max(truth, 1),
        "hidden_share": hidden / max(truth, 1),
        "images_pixels": int(of_images[0]),
        "images_wrong_share": int(of_images[1:3].sum()) / max(int(of_images[0]), 1),
        "frames_with_surplus": int((errors[:, 2] > 0).sum()),
        "most_surplus_px": int(errors[:, 2].max()),
        "geometry": tally.geometry / tally.frames,
        "captured": tally.captured / tally.frames,
        "reused": tally.reused / tally.frames,
        "valid_frames": tally.shown / tally.ended if tally.ended else None,
        "draw_ms": 1e3 * float(np.median(drawn)),
        "plan_ms": 1e3 * float(np.median(planned)),
    }


def _print(report: dict[str, dict[str, float | None]]) -> None:
    heads = (
        "missing %",
        "surplus %",
        "hidden %",
        "images %",
        "geometry",
        "captured",
        "reused",
        "valid",
        "draw ms",
        "plan ms",
    )
    print(f"{'':28}" + "".join(f"{head:>10}" for head in heads))
    for name, one in report.items():
        valid = "-" if one["valid_frames"] is None else f"{one['valid_frames']:.1f}"
        print(
            f"{name:28}{100 * one['missing_share']:10.3f}{100 * one['surplus_share']:10.3f}"
            f"{100 * one['hidden_share']:10.4f}{100 * one['images_wrong_share']:10.3f}{one['geometry']:10.1f}"
            f"{one['captured']:10.2f}{one['reused']:10.1f}{valid:>10}{one['draw_ms']:10.2f}{one['plan_ms']:10.2f}"
        )


def _plot(errors: dict[str, np.ndarray], drawn: dict[str, np.ndarray], path: Path) -> None:
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    for name, one in errors.items():
        if name == "full, geometry":
            continue
        share = 100.0 * (one[:, 1] + one[:, 2]) / np.maximum(one[:, 0], 1)
        above.plot(share, label=name, linewidth=1.0)
    above.axhline(1.0, color="grey", linewidth=0.8, linestyle="--")
    above.set_yscale("symlog", linthresh=0.1)
    above.set_ylabel("wrong pixels of movers, %\n(beyond a rim of 2 px)")
    above.legend(fontsize=8)
    for name, times in drawn.items():
        window = np.ones(15) / 15.0
        below.plot(np.convolve(1e3 * times, window, mode="same"), label=name, linewidth=1.0)
    below.set_ylabel("drawing, ms (mean of 15 frames)")
    below.set_xlabel("frame")
    below.legend(fontsize=8)
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    main()
