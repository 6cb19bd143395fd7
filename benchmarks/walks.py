"""What the benchmarks of walks share: rounds of a walk by several techniques, what a round says, and means with intervals."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import CityMesh
from mmi.walks.walk import Step, Walk
from viewer.cells.cell_cache import CellCache
from viewer.cells.scene_cache import cell_cache
from viewer.drawing.renderer import Renderer
from viewer.runtime.calibration import calibrated
from viewer.runtime.loop import FrameLoop, FrameTimes, run_walk
from viewer.scene.scene import WalkScene
from viewer.techniques.catalogue import make_technique
from viewer.walks.tour import tour

PAPER = {
    "O2": {
        "full": 1.0,
        "local": 14.5,
        "visible": 4.3,
        "single-mesh": 15.9,
        "multi-mesh": 10.9,
        "multi-mesh-dynamic": 6.5,
    },
    "InfiniteReality": {
        "full": 3.3,
        "local": 118.4,
        "visible": 18.4,
        "single-mesh": 103.3,
        "multi-mesh": 85.0,
        "multi-mesh-dynamic": 33.1,
    },
}
"""Frame rates of the paper's table 1, Hz."""
DYNAMIC = "multi-mesh-dynamic"
_TRIANGLE_BYTES = 3 * 4 + 2 * 28
"""Three indices, and two vertices of 28 bytes: walls are quads of their own."""
_TURN = 1.0
"""Seconds of the walk."""
_SETTLING = 0.2
"""Seconds."""
_RESAMPLES = 2000
_OUTSIDE = 5.0
"""Percent of resampled means that lie outside of an interval."""


def triangle_lattice(side: int) -> tuple[np.ndarray, np.ndarray]:
    """A triangle cut into ``side`` squared: (n, 3) points as weights of its corners, and (side * side, 3) triangles of them."""
    steps = [(i, j) for i in range(side + 1) for j in range(side + 1 - i)]
    place = {step: k for k, step in enumerate(steps)}
    weights = np.array([[side - i - j, i, j] for i, j in steps]) / side
    cells = [(place[i, j], place[i + 1, j], place[i, j + 1]) for i in range(side) for j in range(side - i)]
    cells += [
        (place[i + 1, j], place[i + 1, j + 1], place[i, j + 1]) for i in range(side - 1) for j in range(side - 1 - i)
    ]
    return weights, np.array(cells)


def detailed(mesh: CityMesh, side: int) -> CityMesh:
    """The same surfaces with every triangle cut into ``side`` squared: a stand-in for models with that much more detail."""
    weights, cells = triangle_lattice(side)

    def spread(values: np.ndarray) -> np.ndarray:
        corners = values[mesh.triangles].astype(np.float64)  # (m, 3, d)
        return np.einsum("kc,mcd->mkd", weights, corners).reshape(-1, values.shape[1])

    count, n = len(mesh.triangles), len(weights)
    return CityMesh(
        positions=spread(mesh.positions).astype(np.float32),
        uv=spread(mesh.uv).astype(np.float32),
        colors=np.rint(spread(mesh.colors)).astype(np.uint8),
        triangles=(cells[None] + n * np.arange(count)[:, None, None]).reshape(-1, 3).astype(np.int32),
        object_vertices=n * mesh.object_triangles,
        object_triangles=side * side * mesh.object_triangles,
        texture=mesh.texture,
    )


def rounds(
    scenes: Mapping[str, WalkScene],
    walk: Walk,
    techniques: Sequence[str],
    *,
    fps: float,
    rounds: int,
    warm: bool = False,
    updates: float = math.inf,
) -> tuple[dict[str, list[list[FrameTimes]]], dict[str, int]]:
    """``rounds`` times the walk by each technique, caches empty at first, or ``warm``: after the same walk.

    Techniques take turns, ``_TURN`` seconds of the walk each, so that a noisy moment of the machine meets all; whose turn it is
    not loads nothing. ``full`` and ``visible``, which are slow and load nothing, draw every eighth frame only. Updates of
    ``multi-mesh-dynamic``, which has its cells for itself, may take ``updates`` seconds a frame. Also the bytes that each
    technique has to hold: the triangles of its largest frame, and its cells.
    """
    main = scenes["multi-mesh"]
    camera = main.camera
    scenes = {**scenes, DYNAMIC: replace(main, name=DYNAMIC)}
    found: dict[str, list[list[FrameTimes]]] = {name: [] for name in techniques}
    held: dict[str, int] = {}
    turns = walk.frames(fps)
    each = max(1, round(_TURN * fps))
    with Renderer(main.mesh, main.ground, size=(camera.width, camera.height)) as renderer:
        print(f"drawn by {renderer.device}", flush=True)
        costs = calibrated(renderer, main)

        def loop_of(name: str, cache: CellCache) -> FrameLoop:
            technique = make_technique(name, {**scenes, main.name: scenes[name]} if name == DYNAMIC else scenes)
            return FrameLoop(technique, renderer, cache, camera=camera, updates=updates, costs=costs)

        for _ in range(rounds):
            with ExitStack() as stack:
                caches = {name: stack.enter_context(cell_cache(scenes, renderer)) for name in techniques}
                if warm:
                    for name, cache in caches.items():
                        if name not in scenes:
                            continue  # nothing to load
                        run_walk(turns, loop_of(name, cache))
                        cache.want(())
                loops = {name: loop_of(name, cache) for name, cache in caches.items()}
                frames: dict[str, list[FrameTimes]] = {name: [] for name in techniques}
                for start in range(0, len(turns), each):
                    for name, cache in caches.items():
                        steps = turns[start : start + each : 8 if name in ("full", "visible") else 1]
                        frames[name] += run_walk(steps, loops[name])
                        cache.want(())
                        time.sleep(_SETTLING)  # for the cell that was being loaded
                for name, cache in caches.items():
                    found[name].append(frames[name])
                    largest = max(frame.triangles for frame in frames[name])
                    held[name] = max(held.get(name, 0), largest * _TRIANGLE_BYTES + cache.report.largest_bytes)
    return found, held


def total_ms(runs: Sequence[Sequence[FrameTimes]]) -> np.ndarray:
    """Milliseconds of all frames of all rounds."""
    return 1e3 * np.array([frame.total for run in runs for frame in run])


def excerpts(
    scene: WalkScene, *, speed: float, fps: float, count: int, frames: int, metres: float, seed: int
) -> tuple[Step, ...]:
    """``count`` excerpts of ``frames`` frames each from a tour of ``metres`` at ``speed``, with cuts between them.

    They are spread over the tour, with middles that the ``seed`` chooses and that are the same places at every speed. Raises
    ValueError where the streets are too short for them.
    """
    cells = scene.whereabouts.cells
    neighbours = {entry.id: entry.neighbours for entry in scene.dataset.manifest.cells}
    steps = tour(cells, neighbours, metres=metres, speed=speed, seed=seed).frames(fps)
    if len(steps) < count * frames:
        raise ValueError(
            f"a tour of {count * frames} frames expected, found {len(steps)}: make it longer, or excerpts shorter"
        )
    found: list[Step] = []
    end = 0
    shares = np.random.default_rng([seed, count]).uniform(0.0, 1.0, count)
    for number in range(count):
        middle = round((number + float(shares[number])) / count * len(steps))
        first = min(max(middle - frames // 2, end), len(steps) - (count - number) * frames)
        end = first + frames
        found += [replace(step, cut=step.cut or not i) for i, step in enumerate(steps[first:end])]
    return tuple(found)


def mean_interval(values: NDArray[np.float64], *, block: int) -> tuple[float, float, float]:
    """The mean of a series, and between what it lies in 95 of 100 resamples of whole blocks of ``block`` neighbours.

    Neighbours of a walk are alike, so that each alone would make the interval too narrow (Kuensch 1989, with the series closed
    to a ring). Series of one length are resampled alike.
    """
    count = len(values)
    rng = np.random.default_rng([count, block])
    starts = rng.integers(0, count, (_RESAMPLES, -(-count // block)))
    chosen = (starts[..., None] + np.arange(block)).reshape(_RESAMPLES, -1)[:, :count] % count
    low, high = np.percentile(values[chosen].mean(axis=1), [0.5 * _OUTSIDE, 100.0 - 0.5 * _OUTSIDE])
    return float(values.mean()), float(low), float(high)
