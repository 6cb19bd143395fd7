"""Comparing techniques: random views inside cells, or a walk, drawn by each of them and by the geometry (DESIGN section 6).

What is walked through is a dataset, or a city as it was read, where techniques need no impostors.

    compare_views    how wrong techniques are in views that no capture has seen, and how fast each view is drawn
    compare_walk     a walk with its frame loop and its loading, each technique with empty caches; then views spread over it

Both write ``report.json``, ``report.html`` and pictures of the worst views into a folder, and return the report. The geometry
is what techniques are compared with, so it is drawn and timed, and has no errors.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mmi.city.model import City
from mmi.dataset.reading import Dataset, open_dataset
from mmi.foundation.camera import Camera
from mmi.foundation.errors import ParameterError
from mmi.foundation.progress import Progress, silent
from mmi.foundation.whole_files import real_path
from mmi.walks.walk import Step, Walk
from viewer.cells.cell_cache import CacheReport
from viewer.cells.scene_cache import cell_cache
from viewer.drawing.renderer import Renderer
from viewer.measuring.judge import Judge
from viewer.measuring.summary import settling_summary
from viewer.plan import Budget
from viewer.report.baseline import single_mesh_scene
from viewer.report.entries import (
    by_technique,
    frame_series,
    loading_of,
    pops_of,
    report_of,
    scored_views,
    technique_of,
    worst_views,
)
from viewer.report.held_views import HeldView, alike_after, held_again, hold_view, layers_shown, settled_frames
from viewer.report.options import OF_CITIES, CompareOptions
from viewer.report.page import write_report
from viewer.report.tallies import Tallies, tallied, tallies_of
from viewer.report.walk_scores import score_walk, spread
from viewer.runtime.calibration import calibrated
from viewer.runtime.loop import Frame, FrameLoop, FrameTimes, run_walk
from viewer.scene.scene import WalkScene, open_scene, scene_of_city
from viewer.techniques.catalogue import MAIN, REFERENCE, make_technique, refuse_without_dataset
from viewer.walks.random_views import random_views

__all__ = ["CompareOptions", "compare_views", "compare_walk"]

_DISPLAY = Camera(512, 512, math.radians(60.0))
"""What a city is drawn for if nobody says: what builds are for (the paper's experiment)."""
_LONGEST_WEBP = 2 << 30
"""The frames of an animated WebP may take this many bytes: it is made of all of them at once."""


def compare_views(
    source: Path | City,
    out: Path,
    *,
    views: int,
    seed: int = 1,
    options: CompareOptions | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Compare techniques in ``views`` random views inside the cells; the report that was written into ``out``.

    ``source`` is the folder of a dataset, or a city to draw as it was read, by techniques that need no dataset.
    Each view is held for as many frames as ``options.settle`` says, all of which are timed, and the last one is scored.
    ``progress`` is called with (done, of all, what is being done). Raises ParameterError, DatasetError, CaptureError.
    """
    options, tell = options or _usual(source), progress or silent
    main = _open(source, out, options)
    poses = random_views(main.whereabouts.cells, views, seed=seed, terrain=main.terrain)
    cells = [main.whereabouts.cell_at(np.array(pose.eye), current=None) for _, pose in poses]
    scenes = _scenes(main, out, cells, options, tell)
    size = (main.camera.width, main.camera.height)
    # Timed first, in peace: comparing takes all processors.
    held: dict[str, list[HeldView]] = {entry.name: [] for entry in options.entries}
    settled: dict[str, list[int | None]] = {entry.name: [] for entry in options.entries}
    alike: dict[str, list[int | None]] = {entry.name: [] for entry in options.entries}
    layers: list[int] | None = None if main.built is None else []
    tallies: dict[str, list[Tallies]] = {entry.name: [] for entry in options.entries}
    with (
        Renderer(
            main.mesh, main.ground, size=size, samples=options.samples, movers=main.movers, glint=options.glint
        ) as renderer,
        cell_cache(scenes, renderer, capacity=options.cache) as cache,
    ):
        device = renderer.device
        costs = dict.fromkeys(held, calibrated(renderer, main))  # all techniques believe the same at first
        for done, (_, pose) in enumerate(poses):
            tell(done, views, "views timed")
            view = pose.view(main.camera)
            if layers is not None:
                layers.append(layers_shown(make_technique(MAIN, scenes).plan(view, now=0.0, budget=Budget())))
            for entry in options.entries:
                technique = make_technique(
                    entry, scenes, rules=options.rules, frames=options.mover_frames, at=options.movers_time
                )
                found = hold_view(
                    technique,
                    renderer,
                    cache,
                    view,
                    frames=options.settle,
                    frames_per_second=options.frames_per_second,
                    updates=1e-3 * options.budget_ms,
                    costs=costs[entry.name],
                )
                costs[entry.name] = found.costs
                tallies[entry.name].append(tallies_of(technique))
                settled[entry.name].append(settled_frames(technique, renderer, cache, view, found))
                held[entry.name].append(replace(found, plans=()))  # which may hold on to all that a technique has seen
    compared = [entry for entry in options.entries if entry.name != REFERENCE]
    with (
        Renderer(main.mesh, main.ground, size=size, measured=True, movers=main.movers, glint=options.glint) as renderer,
        cell_cache(scenes, renderer, measured=True, capacity=options.cache) as cache,
        Judge(main, renderer, cache, keep=options.keep, flip=options.flip, workers=options.workers) as judge,
    ):
        for done, ((_, pose), cell) in enumerate(zip(poses, cells, strict=True) if compared else ()):
            tell(done, views, "views scored")
            view = pose.view(main.camera)
            reference = make_technique(REFERENCE, scenes, at=options.movers_time)
            truth = judge.truth(reference.plan(view, now=0.0, budget=Budget()), pose, cell)
            for entry in compared:
                technique = make_technique(
                    entry, scenes, rules=options.rules, frames=options.mover_frames, at=options.movers_time
                )
                with held_again(technique, renderer, cache, view, held[entry.name][done]) as plans:
                    held_longer = options.settle > 1  # otherwise nobody is told after how many frames
                    plan, after = (
                        alike_after(plans, renderer, view, truth[0]) if held_longer else (next(plans)[0], None)
                    )
                    alike[entry.name].append(after)
                    judge.score(entry.name, plan, pose, truth, cell=cell)
        tell(views, views, "views scored")
        scores = by_technique(judge.results())
        worst = worst_views(judge, [entry.name for entry in compared], out)
    frames = {name: [frame for one in some for frame in one.frames] for name, some in held.items()}
    techniques = {
        entry.name: technique_of(
            entry,
            scores.get(entry.name),
            seconds=[frame.seconds for frame in frames[entry.name]],
            gpu=[frame.gpu for frame in frames[entry.name]],
            done=[frame.done for frame in frames[entry.name]],
            target=1.0 / options.frames_per_second,
            settling=settling_summary(alike[entry.name], settled[entry.name], layers, held=options.settle)
            if entry.name in scores and options.settle > 1
            else None,
            tallied=tallied(tallies[entry.name], main, options.rules),
        )
        for entry in options.entries
    }
    report = report_of(
        main, device, options, mode="views", views=views, seed=seed, techniques=techniques, scores=scores
    )
    told = scored_views(scores, frames=alike if options.settle > 1 else {}, layers=layers)
    report |= {"walk": None, "series": None, "scored": told, "worst": worst, "videos": []}
    write_report(report, out)
    return report


def compare_walk(
    source: Path | City,
    out: Path,
    walk: Walk | Callable[[WalkScene], Walk],
    *,
    mode: str = "path",
    options: CompareOptions | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Compare techniques along a walk, or one made from the scene; the report that was written into ``out``.

    ``source`` is the folder of a dataset, or a city to draw as it was read, by techniques that need no dataset.
    ``mode`` is what the report calls it: ``path`` or ``tour``. ``progress`` is called with (done, of all, what is being done).
    Raises ParameterError, DatasetError, CaptureError.
    """
    options, tell = options or _usual(source), progress or silent
    main = _open(source, out, options)
    if not isinstance(walk, Walk):
        walk = walk(main)
    steps = walk.frames(options.frames_per_second)
    _check_film(main, steps, options)
    scenes = _scenes(main, out, _places(main, steps), options, tell)

    runs: dict[str, list[FrameTimes]] = {}
    loads: dict[str, CacheReport] = {}
    tallies: dict[str, list[Tallies]] = {}
    size = (main.camera.width, main.camera.height)
    with Renderer(main.mesh, main.ground, size=size, samples=options.samples, movers=main.movers) as renderer:
        device = renderer.device
        costs = calibrated(renderer, main)  # of its own, so that none of the techniques finds its renderer warm
    frames = len(options.entries) * len(steps)
    for number, entry in enumerate(options.entries):
        with (
            Renderer(
                main.mesh, main.ground, size=size, samples=options.samples, movers=main.movers, glint=options.glint
            ) as renderer,
            cell_cache(scenes, renderer, capacity=options.cache) as cache,
        ):
            technique = make_technique(entry, scenes, rules=options.rules, frames=options.mover_frames)
            loop = FrameLoop(
                technique,
                renderer,
                cache,
                camera=main.camera,
                budget=1.0 / options.frames_per_second,
                updates=1e-3 * options.budget_ms,
                costs=costs,
            )
            runs[entry.name] = run_walk(steps, loop, shown=_telling(tell, number * len(steps), frames))
            loads[entry.name] = cache.report
            tallies[entry.name] = [tallies_of(technique)]
    tell(frames, frames, "frames timed")

    found = score_walk(main, scenes, steps, runs, out, options, tell)
    techniques = {
        entry.name: technique_of(
            entry,
            found.scores.get(entry.name),
            seconds=[frame.total for frame in runs[entry.name]],
            gpu=[frame.gpu for frame in runs[entry.name]],
            done=[frame.done for frame in runs[entry.name]],
            target=1.0 / options.frames_per_second,
            pop=pops_of(found.pops.get(entry.name), switches=sum(frame.entered for frame in runs[entry.name])),
            update_pop=pops_of(
                found.update_pops.get(entry.name),
                frames=sum(frame.done.requests.requests > 0 for frame in runs[entry.name]),
            ),
            loading=loading_of(loads[entry.name], runs[entry.name]) if entry.layered else None,
            tallied=tallied(tallies[entry.name], main, options.rules),
        )
        for entry in options.entries
    }
    scored = len(spread(len(steps), options.scored))
    report = report_of(
        main, device, options, mode=mode, views=scored, seed=None, techniques=techniques, scores=found.scores
    )
    report |= {
        "walk": {
            "name": walk.name,
            "seconds": walk.seconds,
            "metres": walk.metres,
            "frames": len(steps),
            "frames_per_second": options.frames_per_second,
            "legs": sum(step.cut for step in steps),
        },
        "series": {name: frame_series(run) for name, run in runs.items()},
        "scored": scored_views(found.scores),
        "worst": found.worst,
        "videos": found.videos,
    }
    write_report(report, out)
    return report


# ------------------------------------------------------------------------------------------------- what is opened


def _usual(source: Path | City) -> CompareOptions:
    """How to compare if nobody says."""
    return CompareOptions(techniques=OF_CITIES) if isinstance(source, City) else CompareOptions()


def _open(source: Path | City, out: Path, options: CompareOptions) -> WalkScene:
    """The scene of a dataset or a city, and a folder for its report."""
    if isinstance(source, City):
        refuse_without_dataset(options.entries, source.source)
        scene = scene_of_city(
            source,
            name=MAIN,
            camera=options.camera or _DISPLAY,
            longest_object=options.longest_object,
            movers=options.movers,
        )
    else:
        scene = _opened(source, out, options)
    out.mkdir(parents=True, exist_ok=True)
    return scene


def _opened(dataset: Path, out: Path, options: CompareOptions) -> WalkScene:
    """The scene of a dataset. The report's folder has to be outside of it, where no build touches it."""
    found: Dataset = open_dataset(dataset)
    here, inside = real_path(found.path), real_path(out)
    if here in (inside, *inside.parents, real_path(inside / "single-mesh")):
        raise ParameterError(f"{out}: a folder outside the dataset {dataset} expected")
    if found.manifest.parameters.layering == "single":
        raise ParameterError(f"{dataset}: a dataset of several layers expected, found one built with --layering single")
    return open_scene(found, name=MAIN, camera=options.camera, movers=options.movers)


def _scenes(
    main: WalkScene, out: Path, cells: Iterable[str], options: CompareOptions, tell: Progress
) -> dict[str, WalkScene]:
    """The scenes that the techniques need."""
    scenes = {MAIN: main}
    if any(entry.scene == "single-mesh" for entry in options.entries):
        scenes["single-mesh"] = single_mesh_scene(
            main,
            out / "single-mesh",
            sorted(set(cells)),
            workers=options.workers,
            progress=lambda done, total, _: tell(done, total, "cells of single-mesh"),
        )
    return scenes


def _check_film(main: WalkScene, steps: Sequence[Step], options: CompareOptions) -> None:
    """Raises ParameterError where the film of a walk would not fit into memory."""
    panels = len({REFERENCE, *(entry.name for entry in options.entries)})
    size = 3 * main.camera.width * main.camera.height * panels * len(steps)
    if options.video == "webp" and size > _LONGEST_WEBP:
        raise ParameterError(
            f"--video: an animated WebP of at most {_LONGEST_WEBP >> 20} MB of frames expected, found {size >> 20} MB; "
            "make it an mp4, or the walk shorter"
        )


def _places(scene: WalkScene, steps: Sequence[Step]) -> list[str]:
    """The cells that a walk comes through."""
    names: list[str] = []
    current = None
    for step in steps:
        current = scene.whereabouts.cell_at(np.array(step.pose.eye), current=current)
        if current not in names[-1:]:
            names.append(current)
    return names


def _telling(tell: Progress, before: int, frames: int) -> Callable[[Step, Frame], None]:
    """What tells of each frame that was timed; ``before`` of all ``frames`` were timed by other techniques."""
    return lambda step, _: tell(before + step.index, frames, "frames timed")
