"""Comparing techniques: random views inside cells, or a walk, drawn by each of them and by the geometry (DESIGN section 6).

    compare_views    how wrong techniques are in views that no capture has seen, and how fast each view is drawn
    compare_walk     a walk with its frame loop and its loading, each technique with empty caches; then views spread over it

Both write ``report.json``, ``report.html`` and pictures of the worst views into a folder, and return the report.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mmi.dataset.reading import Dataset, open_dataset
from mmi.foundation.errors import ParameterError
from viewer.cells.cell_cache import CacheReport, CellCache
from viewer.cells.scene_cache import cell_cache
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.drawing.renderer import Renderer
from viewer.measuring.judge import Judge, Scored
from viewer.measuring.summary import frame_summary, summarise
from viewer.measuring.view_errors import pop
from viewer.plan import Budget, Technique
from viewer.report.baseline import single_mesh_scene
from viewer.report.entries import (
    by_technique,
    frame_series,
    gpu_times,
    loading_of,
    mean_sent,
    pops_of,
    report_of,
    scored_views,
    worst_views,
)
from viewer.report.page import write_report
from viewer.report.pictures import side_by_side
from viewer.report.video import VideoWriter
from viewer.runtime.loop import FrameLoop, FrameTimes, run_walk
from viewer.scene.scene import WalkScene, open_scene
from viewer.techniques.catalogue import LAYERED, TECHNIQUES, make_technique
from viewer.walks.random_views import random_views
from viewer.walks.walk import Step, Walk

__all__ = ["CompareOptions", "Progress", "compare_views", "compare_walk"]

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how much of it is done, and how much there is."""

_SAMPLES = (0, 2, 4, 8, 16)
_LONGEST_WEBP = 2 << 30
"""Bytes of frames: an animated WebP is made of all of them at once."""
_TIMINGS = 3
"""Times that a random view is drawn for its frame time, the median of which counts."""
_MOST_POPS = 24
"""Changes of cells whose pop is measured, spread over the walk."""


@dataclass(frozen=True, slots=True)
class CompareOptions:
    """How to compare; raises ParameterError for what has no meaning.

    ``fade`` seconds of cross-fade at changes of cells; ``samples`` of multisampling in timed frames and videos; ``cache``
    bytes for cells in memory; ``scored`` views spread over a walk; ``keep`` worst views a technique as pictures; without
    ``flip`` that measure, by far the slowest, is left out; ``video`` is the suffix of a film of the walk.
    """

    techniques: tuple[str, ...] = TECHNIQUES
    frames_per_second: float = 30.0
    fade: float = 0.0
    samples: int = 0
    cache: int = 512 << 20
    scored: int = 60
    keep: int = 6
    flip: bool = True
    video: str | None = None
    workers: int = 1

    def __post_init__(self) -> None:
        unknown = [name for name in self.techniques if name not in TECHNIQUES]
        if unknown or not self.techniques or len(set(self.techniques)) < len(self.techniques):
            raise ParameterError(
                f"techniques: some of {', '.join(TECHNIQUES)} expected, each once, found {', '.join(self.techniques)!r}"
            )
        for name, least, most in (
            ("frames_per_second", 1.0, 240.0),
            ("fade", 0.0, 10.0),
            ("cache", 1_000_000, 1 << 40),
            ("scored", 1, 100_000),
            ("keep", 0, 100),
            ("workers", 1, 1024),
        ):
            value = getattr(self, name)
            if not (math.isfinite(value) and least <= value <= most):
                raise ParameterError(f"{name}: a number from {least:g} to {most:g} expected, found {value!r}")
        if self.samples not in _SAMPLES:
            raise ParameterError(f"samples: one of {', '.join(map(str, _SAMPLES))} expected, found {self.samples!r}")


def compare_views(
    dataset: Path,
    out: Path,
    *,
    views: int,
    seed: int = 1,
    options: CompareOptions | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Compare techniques in ``views`` random views inside the dataset's cells; the report that was written into ``out``.

    Raises ParameterError, DatasetError, CaptureError.
    """
    options, tell = options or CompareOptions(), progress or _silent
    main = _open(dataset, out)
    poses = random_views(main.whereabouts.cells, views, seed=seed, terrain=main.terrain)
    cells = [main.whereabouts.cell_at(np.array(pose.eye), current=None) for _, pose in poses]
    scenes = _scenes(main, out, cells, options, tell)
    camera = main.camera
    # Timed first, in peace: comparing takes all processors.
    pictures: dict[str, list[DrawnPicture]] = {name: [] for name in options.techniques}
    with (
        _renderer(main, measured=False, samples=options.samples) as renderer,
        cell_cache(scenes, renderer, capacity=options.cache) as cache,
    ):
        device = renderer.device
        for done, (_, pose) in enumerate(poses):
            tell("views timed", done, views)
            view = pose.view(camera)
            for name in options.techniques:
                plan = make_technique(name, scenes).plan(view, now=0.0, budget=Budget())
                cache.want(plan.cells)
                cache.require(plan.cells)
                again = [renderer.draw(plan, view, read=False) for _ in range(_TIMINGS)]
                pictures[name].append(sorted(again, key=lambda picture: picture.seconds)[_TIMINGS // 2])
    with (
        _renderer(main, measured=True, samples=0) as renderer,
        cell_cache(scenes, renderer, measured=True, capacity=options.cache) as cache,
        _judge(main, renderer, cache, options) as judge,
    ):
        for done, ((_, pose), cell) in enumerate(zip(poses, cells, strict=True)):
            tell("views scored", done, views)
            view = pose.view(camera)
            full = make_technique("full", scenes).plan(view, now=0.0, budget=Budget())
            truth = judge.truth(full, pose, cell)
            for name in options.techniques:
                technique = make_technique(name, scenes)
                judge.score(technique, technique.plan(view, now=0.0, budget=Budget()), pose, truth, cell=cell)
        tell("views scored", views, views)
        scores = by_technique(judge.results())
        worst = worst_views(judge, options.techniques, out)
    techniques = {
        name: summarise([one.errors for one in scores[name]])
        | {
            "pop": None,
            "frame_ms": frame_summary([picture.seconds for picture in pictures[name]]),
            "gpu_ms": gpu_times([picture.gpu_seconds for picture in pictures[name]]),
            "loading": None,
        }
        | mean_sent([(picture.triangles, picture.draws) for picture in pictures[name]])
        for name in options.techniques
    }
    report = report_of(main, device, mode="views", views=views, seed=seed, techniques=techniques)
    report |= {"walk": None, "series": None, "scored": scored_views(scores), "worst": worst, "videos": []}
    write_report(report, out)
    return report


def compare_walk(
    dataset: Path,
    out: Path,
    walk: Walk | Callable[[WalkScene], Walk],
    *,
    mode: str = "path",
    options: CompareOptions | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Compare techniques along a walk, or one made from the scene; the report that was written into ``out``.

    ``mode`` is what the report calls it: ``path`` or ``tour``. Raises ParameterError, DatasetError, CaptureError.
    """
    options, tell = options or CompareOptions(), progress or _silent
    main = _open(dataset, out)
    if not isinstance(walk, Walk):
        walk = walk(main)
    steps = walk.frames(options.frames_per_second)
    panels = len({"full", *options.techniques})
    size = 3 * main.camera.width * main.camera.height * panels * len(steps)
    if options.video == "webp" and size > _LONGEST_WEBP:
        raise ParameterError(
            f"--video: an animated WebP of at most {_LONGEST_WEBP >> 20} MB of frames expected, found {size >> 20} MB; "
            "make it an mp4, or the walk shorter"
        )
    places = _places(main, steps)
    scenes = _scenes(main, out, places, options, tell)

    runs: dict[str, list[FrameTimes]] = {}
    loads: dict[str, CacheReport] = {}
    device = ""
    for number, name in enumerate(options.techniques):
        tell("walks", number, len(options.techniques))
        with (
            _renderer(main, measured=False, samples=options.samples) as renderer,
            cell_cache(scenes, renderer, capacity=options.cache) as cache,
        ):
            device = renderer.device
            technique = make_technique(name, scenes, fade=options.fade)
            budget = 1.0 / options.frames_per_second
            loop = FrameLoop(technique, renderer, cache, camera=main.camera, budget=budget)
            runs[name] = run_walk(steps, loop)
            loads[name] = cache.report
    tell("walks", len(options.techniques), len(options.techniques))

    scores, pops, worst, videos = _score_walk(main, scenes, steps, runs, out, options, tell)
    techniques = {
        name: summarise([one.errors for one in scores[name]])
        | {
            "pop": pops_of(pops[name], sum(frame.entered for frame in runs[name])) if name in LAYERED else None,
            "frame_ms": frame_summary([frame.total for frame in runs[name]]),
            "gpu_ms": gpu_times([frame.gpu for frame in runs[name]]),
            "loading": loading_of(loads[name], runs[name]) if name in LAYERED else None,
        }
        | mean_sent([(frame.triangles, frame.draws) for frame in runs[name]])
        for name in options.techniques
    }
    report = report_of(
        main, device, mode=mode, views=len(_spread(len(steps), options.scored)), seed=None, techniques=techniques
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
        "scored": scored_views(scores),
        "worst": worst,
        "videos": videos,
    }
    write_report(report, out)
    return report


# ------------------------------------------------------------------------------------------------- what is opened


def _open(dataset: Path, out: Path) -> WalkScene:
    """The scene of a dataset, with a folder for its report outside of it, where no build touches the dataset."""
    found: Dataset = open_dataset(dataset)
    here, inside = found.path.resolve(), out.resolve()
    if here in (inside, *inside.parents, (inside / "single-mesh").resolve()):
        raise ParameterError(f"{out}: a folder outside the dataset {dataset} expected")
    if found.manifest.parameters.layering == "single":
        raise ParameterError(f"{dataset}: a dataset of several layers expected, found one built with --layering single")
    out.mkdir(parents=True, exist_ok=True)
    return open_scene(found, name="multi-mesh")


def _scenes(
    main: WalkScene, out: Path, cells: Iterable[str], options: CompareOptions, tell: Progress
) -> dict[str, WalkScene]:
    """The scenes that the techniques need."""
    scenes = {"multi-mesh": main}
    if "single-mesh" in options.techniques:
        scenes["single-mesh"] = single_mesh_scene(
            main,
            out / "single-mesh",
            sorted(set(cells)),
            workers=options.workers,
            progress=lambda done, total, _: tell("cells of single-mesh", done, total),
        )
    return scenes


def _renderer(scene: WalkScene, *, measured: bool, samples: int) -> Renderer:
    size = (scene.camera.width, scene.camera.height)
    return Renderer(scene.mesh, scene.ground, size=size, measured=measured, samples=samples)


def _judge(scene: WalkScene, renderer: Renderer, cache: CellCache, options: CompareOptions) -> Judge:
    return Judge(scene, renderer, cache, keep=options.keep, flip=options.flip, workers=options.workers)


def _places(scene: WalkScene, steps: Sequence[Step]) -> list[str]:
    """The cells that a walk comes through."""
    names: list[str] = []
    current = None
    for step in steps:
        current = scene.whereabouts.cell_at(np.array(step.pose.eye), current=current)
        if current not in names[-1:]:
            names.append(current)
    return names


# ------------------------------------------------------------------------------------------------- walks, scored


def _score_walk(
    main: WalkScene,
    scenes: Mapping[str, WalkScene],
    steps: Sequence[Step],
    runs: Mapping[str, Sequence[FrameTimes]],
    out: Path,
    options: CompareOptions,
    tell: Progress,
) -> tuple[dict[str, list[Scored]], dict[str, list[float]], list[dict[str, Any]], list[str]]:
    """Walk again, all techniques side by side: scores of views spread over the walk, pops, the worst views, films."""
    chosen = set(_spread(len(steps), options.scored))
    entered = {
        name: _some([i for i, frame in enumerate(runs[name]) if frame.entered], _MOST_POPS)
        for name in options.techniques
        if name in LAYERED
    }
    # A fade is over some frames after the cell was entered.
    after = 1 + math.ceil(options.fade * options.frames_per_second)
    popping = {name: {i for entry in some for i in range(entry, entry + after)} for name, some in entered.items()}
    around = {i + step for some in popping.values() for i in some for step in (-1, 0)} if options.flip else set()
    largest: dict[tuple[str, int], float] = {}
    techniques: dict[str, Technique] = {name: make_technique(name, scenes, fade=options.fade) for name in runs}
    full = make_technique("full", scenes)
    names = ["full", *(name for name in options.techniques if name != "full")]
    film = _Film(out, names, options)
    with (
        _renderer(main, measured=True, samples=options.samples) as renderer,
        cell_cache(scenes, renderer, measured=True, capacity=options.cache) as cache,
        _judge(main, renderer, cache, options) as judge,
        film as add,
    ):
        before: dict[str, DrawnPicture] = {}
        for step in steps:
            tell("frames", step.index, len(steps))
            view = step.pose.view(main.camera)
            budget = Budget(1.0 / options.frames_per_second)
            plans = {name: one.plan(view, now=step.time, budget=budget) for name, one in techniques.items()}
            whole = full.plan(view, now=step.time, budget=budget)
            if step.index in chosen:
                cell = main.whereabouts.cell_at(np.array(step.pose.eye), current=None)
                place = next((plan.place for plan in plans.values() if plan.place), cell)
                truth = judge.truth(whole, step.pose, place)
                for name, plan in plans.items():
                    judge.score(techniques[name], plan, step.pose, truth, cell=place, time=step.time)
            if step.index not in around and not film.wanted:
                continue
            shown = {}
            for name, plan in {"full": whole, **plans}.items():
                if film.wanted or name in ("full", *entered):
                    cache.want(plan.cells)
                    cache.require(plan.cells)
                    shown[name] = renderer.draw(plan, view)
            for name, some in popping.items():
                if step.index in some and options.flip and not step.cut:
                    entry = max(i for i in entered[name] if i <= step.index)
                    found = pop(before[name], shown[name], before["full"], shown["full"])
                    largest[name, entry] = max(found, largest.get((name, entry), -1.0))
            add([shown[name].color for name in names] if film.wanted else [])
            before = shown
        tell("frames", len(steps), len(steps))
        scores = by_technique(judge.results())
        worst = worst_views(judge, options.techniques, out)
    pops = {name: [value for (other, _), value in largest.items() if other == name] for name in options.techniques}
    return scores, pops, worst, film.files


class _Film:
    """The film of a walk, where one is wanted: all techniques side by side. A context manager that yields what takes frames."""

    def __init__(self, out: Path, names: Sequence[str], options: CompareOptions) -> None:
        self.wanted = options.video is not None
        self.files: list[str] = []
        self._names = list(names)
        self._path = out / f"walk.{options.video}"
        self._rate = options.frames_per_second
        self._writer: VideoWriter | None = None

    def __enter__(self) -> Callable[[Sequence[np.ndarray[Any, Any]]], None]:
        return self._add

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, trace: Any) -> None:  # noqa: ANN401
        if self._writer is not None:
            self._writer.__exit__(kind, value, trace)
            if kind is None:
                self.files.append(self._path.name)

    def _add(self, panels: Sequence[np.ndarray[Any, Any]]) -> None:
        if not self.wanted:
            return
        frame = side_by_side(panels, self._names)
        if self._writer is None:
            self._writer = VideoWriter(self._path, (frame.shape[1], frame.shape[0]), self._rate)
            self._writer.__enter__()
        self._writer.add(frame)


def _spread(n: int, wanted: int) -> list[int]:
    """At most ``wanted`` of the numbers below ``n``, evenly spread."""
    return sorted(set(np.linspace(0, n - 1, min(n, wanted)).round().astype(int).tolist()))


def _some(values: Sequence[int], wanted: int) -> set[int]:
    return {values[i] for i in _spread(len(values), wanted)} if values else set()


def _silent(what: str, done: int, total: int) -> None:
    """No progress."""
