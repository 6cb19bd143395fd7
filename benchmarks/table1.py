"""The paper's table 1 (section 6.1): frame rates of a walk by each technique, as ratios within one run.

    python benchmarks/table1.py out/helsinki --tour 300
    python benchmarks/table1.py out/helsinki --tour 300 --near 100000      # near geometry of 100,000 triangles and more

A walk along the dataset's streets, drawn by all techniques in turn, second by second, with empty caches at the start: cells
come from disk while the walk goes on. All draw the same frames, as many a second of the walk as ``local`` draws it in about the
time that walking takes (``--fps`` says otherwise: fewer frames load the same cells in less time). ``--near`` cuts every
triangle of the city into as many as it takes for the median cell to have so many triangles of near geometry, as a stand-in
for a model with that much detail; impostors do not change by it. Updates of multi-mesh-dynamic take --budget-ms of a frame at
most, and no more than what is left of 1/30 s: its frame rate follows from that, and the paper does not say what it spent.
``--json`` appends the figures as a line.
"""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from walks import PAPER, detailed, rounds, total_ms

from mmi.dataset.reading import open_dataset
from viewer.report.baseline import single_mesh_scene
from viewer.scene.scene import open_scene
from viewer.techniques.catalogue import TECHNIQUES
from viewer.walks.tour import tour


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, metavar="OUT")
    parser.add_argument("--tour", type=float, default=300.0, metavar="METRES")
    parser.add_argument("--speed", type=float, default=5.0, metavar="M/S")
    parser.add_argument("--fps", type=float, help="frames a second of the walk (default: as many as local draws)")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--near", type=int, metavar="TRIANGLES")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--techniques", default=",".join(TECHNIQUES))
    parser.add_argument("--budget-ms", type=float, default=5.0, help="for updates, a frame (default: %(default)s)")
    parser.add_argument("--warm", action="store_true", help="walk once before, so that all cells are in memory")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    techniques = options.techniques.split(",")
    scene = open_scene(open_dataset(options.dataset), name="multi-mesh")
    entries = {entry.id: entry for entry in scene.dataset.manifest.cells}
    neighbours = {name: entry.neighbours for name, entry in entries.items()}
    walk = tour(scene.whereabouts.cells, neighbours, metres=options.tour, speed=options.speed, seed=options.seed)
    visited: list[str] = []
    for step in walk.frames(30.0):
        visited.append(scene.whereabouts.cell_at(np.array(step.pose.eye), current=visited[-1] if visited else None))
    near = np.median([entries[name].near_triangles for name in visited])
    side = 1 if options.near is None else math.ceil(math.sqrt(options.near / near))
    if side > 1:
        scene = replace(scene, mesh=detailed(scene.mesh, side))
    scenes = {"multi-mesh": scene}
    if "single-mesh" in techniques:
        folder = options.dataset.with_name(options.dataset.name + "-single-mesh")
        scenes["single-mesh"] = single_mesh_scene(scene, folder, visited, workers=2)
    fps = options.fps
    if fps is None:
        tried, _ = rounds(scenes, walk, ["local"], fps=10.0, rounds=1)
        fps = 1e3 / float(np.median(total_ms(tried["local"])))
    print(
        f"{options.dataset}: {walk.metres:.0f} m through {len(set(visited))} cells, {len(walk.frames(fps))} frames "
        f"({fps:.0f} a second), {options.rounds} rounds, city of {len(scene.mesh.triangles)} triangles, "
        f"near geometry {near * side**2:.0f}"
    )
    found, _ = rounds(
        scenes, walk, techniques, fps=fps, rounds=options.rounds, warm=options.warm, updates=1e-3 * options.budget_ms
    )

    times = {name: total_ms(runs) for name, runs in found.items()}
    middle = {name: float(np.median(some)) for name, some in times.items()}
    print(
        "| technique | ms p50 / p95 / p99 / max | triangles | draws | /full | /visible | /local | O2 | InfiniteReality |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    parts: list[str] = []
    for name in techniques:
        p = np.percentile(times[name], [50, 95, 99, 100])
        frames = [frame for run in found[name] for frame in run]
        works = [(frame.planning, frame.done.requests.seconds, frame.done.draws.seconds) for frame in frames]
        planning, asked, drawing = 1e3 * np.mean(works, axis=0)
        parts.append(f"{name}: {planning:.1f} ms a frame for plans, {asked:.1f} for updates, {drawing:.1f} for drawing")
        sent = [np.mean([getattr(frame, what) for frame in frames]) for what in ("triangles", "draws")]
        ratios = [f"{middle[other] / middle[name]:.2f}" for other in ("full", "visible", "local") if other in middle]
        paper = [
            " / ".join(f"{rates[name] / rates[other]:.2f}" for other in ("full", "visible", "local"))
            for rates in PAPER.values()
        ]
        print(
            f"| {name} | {p[0]:.1f} / {p[1]:.1f} / {p[2]:.1f} / {p[3]:.1f} | {sent[0]:.0f} | {sent[1]:.1f} | "
            + " | ".join([*ratios, *paper])
            + " |"
        )
    print("\n".join(parts))
    for name in techniques:
        runs, limit = found[name], 2e-3 * middle[name]
        slow = [frame for run in runs for frame in run if frame.total > limit]
        told = f"{name}: {len(slow)} of {len(times[name])} frames above twice the median"
        if TECHNIQUES[name].layered:
            loading = [frame for frame in slow if frame.total - frame.waiting - frame.uploading <= limit]
            waits = [1e3 * frame.waiting for run in runs for frame in run if frame.waiting > 0.0]
            first = [1e3 * frame.loading for run in runs for frame in run if frame.cut]
            told += (
                f", {len(loading)} of them for waiting and uploads; {len(waits)} frames waited for a cell"
                f"{f', at most {max(waits):.0f} ms' if waits else ''}; uploads at most "
                f"{1e3 * max(frame.uploading for run in runs for frame in run):.1f} ms a frame; "
                f"the first cell and cells behind cuts took {np.mean(first):.0f} ms each"
            )
        print(told)
    if options.json is not None:
        with options.json.open("a") as file:
            print(json.dumps({"dataset": options.dataset.name, "near": near * side**2, "ms": middle}), file=file)


if __name__ == "__main__":
    main()
