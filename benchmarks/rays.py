"""Rays a second of the grid and of Embree, next to each other and to what Embree does when nothing else is done.

    python benchmarks/rays.py examples/helsinki/helsinki.osm.pbf
    citygen montmartre --detail 2 -o out/montmartre.json
    citygen metropolis --buildings 100000 -o out/metropolis.jsonl
    python benchmarks/rays.py out/montmartre.json out/metropolis.jsonl --workers 1 2

CITY is what ``build-impostors`` reads. Rays are those that walkers in the streets need: of pictures of 512 x 512 pixels and 60
degrees, in random directions, the pixels that leave the near field (no object is nearer than ``--near-field`` metres, nor
level ground) and that the horizon map does not call sky; ``hit`` of them hit something. They are cast from ``--near-field``
metres on, in the order of the pixels.

Every caster casts the same rays in each of ``--rounds`` rounds, one after the other; times are the least of a caster, of which
others on the same machine take least. ``ceiling`` is Embree alone: float32 arrays made before, distances and triangles not
looked at, one share for each worker. ``differ`` counts the rays of which a caster says another triangle than the ceiling does:
the first drawn of coincident faces instead of any.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import CityMesh, build_city_mesh
from mmi.cells.viewing_cells import viewing_cells
from mmi.city.model import City
from mmi.foundation.camera import Camera, level_view
from mmi.rays.casters import make_caster
from mmi.rays.embree import EmbreeCaster, embree_caster
from mmi.rays.height_field import height_field
from mmi.rays.horizon_map import horizon_of, sky
from mmi.reading.read_city import read_city

CAMERA = Camera(512, 512, math.radians(60.0))
EYE = 1.7
"""Metres above the ground."""
COLUMNS = "{:<10} {:>7} {:>11} {:>10} {:>10} {:>8}"


def street_rays(
    city: City, mesh: CityMesh, *, views: int, near_field: float, seed: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Origins and directions (n, 3) of the pixels that are cast in ``views`` pictures from streets."""
    rng = np.random.default_rng(seed)
    graph = viewing_cells(city)
    cells = [graph.nodes[one]["cell"] for one in graph]
    lengths = np.array([cell.length for cell in cells])
    heights, caster = height_field(mesh), embree_caster(mesh, workers=1)
    origins, directions = [], []
    for chosen in rng.choice(len(cells), size=views, p=lengths / lengths.sum()):
        cell, along = cells[chosen], rng.random()
        at = np.add(cell.p, along * np.subtract(cell.q, cell.p))
        eye = np.array([*at, 0.5 * sum(cell.eye) + along * cell.rise])
        rays = pixel_rays(eye, rng.uniform(-math.pi, math.pi))
        rays = rays[rays[:, 2] * near_field > -EYE]
        rays = rays[caster.first_hits(eye, rays).distance >= near_field]
        rays = rays[~sky(horizon_of(heights, eye, beyond=near_field), rays)]
        origins.append(np.broadcast_to(eye, rays.shape))
        directions.append(rays)
    return np.concatenate(origins), np.concatenate(directions)


def pixel_rays(eye: NDArray[np.float64], heading: float) -> NDArray[np.float64]:
    """(h * w, 3) the unit directions through the middles of a picture's pixels, row after row."""
    view = level_view(eye, heading, focal=CAMERA.focal, window=CAMERA.window)
    columns, rows = np.meshgrid(np.arange(CAMERA.width) + 0.5, np.arange(CAMERA.height) + 0.5)
    x, y = (view.window[0] + columns) / view.focal, -(view.window[1] + rows) / view.focal
    rays = np.stack([x, y, -np.ones_like(x)], axis=-1).reshape(-1, 3) @ view.eye_from_world[:3, :3]
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def ceiling(
    caster: EmbreeCaster, origins: NDArray[np.float64], directions: NDArray[np.float64], nearest: float, workers: int
) -> Callable[[], NDArray[np.int32]]:
    """What casts the rays by Embree alone and returns the triangles that it says."""
    bounds = np.linspace(0, len(directions), workers + 1).astype(int)
    parts = [
        ((origins + nearest * directions)[a:b].astype(np.float32), directions[a:b].astype(np.float32))
        for a, b in pairwise(bounds)
    ]
    threads = ThreadPoolExecutor(workers)

    def cast() -> NDArray[np.int32]:
        said = threads.map(lambda part: caster.scene.run(*part, output=1)["primID"], parts)
        return np.concatenate(list(said))

    return cast


def timed(what: Callable[[], object]) -> tuple[float, object]:
    start = time.perf_counter()
    found = what()
    return time.perf_counter() - start, found


def measure(path: Path, options: argparse.Namespace) -> None:
    city, _ = read_city(path)
    mesh = build_city_mesh(city)
    origins, directions = street_rays(city, mesh, views=options.views, near_field=options.near_field)
    near = options.near_field
    runs: list[tuple[str, int, Callable[[], NDArray[np.int32]]]] = []
    for workers in options.workers:
        built = {}
        for kind in ("embree", "grid"):
            seconds, built[kind] = timed(
                lambda kind=kind, workers=workers: make_caster(mesh, kind=kind, workers=workers)
            )
            if workers == options.workers[0]:
                print(f"{path.name}: {len(mesh.triangles):,} triangles; {kind} built in {seconds:.1f} s")
        runs.append(("ceiling", workers, ceiling(built["embree"], origins, directions, near, workers)))
        for kind, caster in built.items():
            runs.append(
                (
                    kind,
                    workers,
                    lambda caster=caster: caster.first_hits(origins, directions, nearest=near).triangle,
                )
            )
    said = [cast() for _, _, cast in runs]
    seconds = np.array([[timed(cast)[0] for _, _, cast in runs] for _ in range(options.rounds)]).min(axis=0)
    grid = next(caster for caster in built.values() if not isinstance(caster, EmbreeCaster)).grid
    print(
        f"{len(directions):,} rays of {options.views} views, {(said[0] >= 0).mean():.0%} hit; grid of "
        f"{' x '.join(str(n) for n in grid.size)} cells of {grid.cell:.1f} m, "
        f"{len(grid.entries) / max(len(mesh.triangles), 1):.1f} entries a triangle"
    )
    print(COLUMNS.format("caster", "workers", "rays/s", "ceiling/it", "embree/it", "differ"))
    rates = {(name, workers): len(directions) / one for (name, workers, _), one in zip(runs, seconds, strict=True)}
    for (name, workers, _), triangles in zip(runs, said, strict=True):
        rate = rates[name, workers]
        over = [f"{rates[other, workers] / rate:.2f}" for other in ("ceiling", "embree")]
        print(COLUMNS.format(name, workers, f"{rate:,.0f}", *over, int((triangles != said[0]).sum())))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("city", type=Path, nargs="+")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--near-field", type=float, default=100.0)
    parser.add_argument("--rounds", type=int, default=7)
    options = parser.parse_args()
    for path in options.city:
        measure(path, options)


if __name__ == "__main__":
    main()
