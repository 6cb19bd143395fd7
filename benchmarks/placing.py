"""Where images are placed, after Aliaga & Lastra 1999, without drawing any: table 1 and figure 16 on other models.

    python benchmarks/placing.py pipes --budget 150000 --target 90000,120000 -o out/placing
    python benchmarks/placing.py plant.glb --budget 30000 --target 18000 --plans 100000 -o out/placing

For each target: the cells; the grid's points and the seconds that it takes; the images, how many a point has, and the
milliseconds that a point takes; how close to the target the views come that images are chosen for (figure 16: within 2 percent
typically); and random plans of viewers, eye and yaw, in all of the domain: how many triangles they have in view, in cells, and
how many are left with the image that serves them: never more than the budget. And the same in all directions from all points,
of which there are so many ranges. The ground is not part of the model.
With ``--hidden``, cells that solid buildings hide from all whom a point serves do not count (place-images --hidden).
With ``--reach``, also how far from a point a viewer is at most, in units of the distance between the points, and the farthest
of a million random ones.
"""

from __future__ import annotations

import argparse
import json
import math
import time
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from citygen.generate import generate
from mmi.city.model import City
from mmi.dataset.city_files import city_meshes
from mmi.foundation.camera import Camera
from mmi.foundation.kernels import kernel
from mmi.reading.read_city import read_city
from viewer.making.hidden_cells import hidden_cells
from viewer.placing.coverage import lattice_for, reach
from viewer.placing.directions import TURN, arcs_of, ranges_of, seen_from
from viewer.placing.grid_check import check_grid
from viewer.placing.model_cells import ModelCells, cells_for
from viewer.placing.placements import Placements, placements_at
from viewer.placing.refining import solution_grid
from viewer.placing.rules import PlacingRules, fov_of
from viewer.placing.solution_grid import Needs, SolutionGrid, domain_of

FOV = fov_of(Camera(640, 480, math.radians(60.0)))
PAPER = {
    "power plant": (
        2_000_000,
        {
            250_000: (5815, 21.7),
            300_000: (3224, 12.4),
            350_000: (1485, 6.1),
            400_000: (706, 6.5),
            450_000: (1169, 5.9),
            500_000: (239, 1.2),
        },
    ),
    "torpedo room": (
        850_000,
        {
            150_000: (2333, 11.8),
            200_000: (1160, 6.0),
            250_000: (462, 2.8),
            300_000: (243, 1.6),
            350_000: (212, 1.3),
            400_000: (181, 1.1),
        },
    ),
    "house": (
        1_700_000,
        {
            150_000: (2492, 28.4),
            200_000: (994, 22.0),
            250_000: (714, 10.6),
            300_000: (662, 10.5),
            350_000: (629, 11.2),
            400_000: (593, 12.5),
            450_000: (561, 11.4),
        },
    ),
    "pipes": (1_000_000, {150_000: (893, 4.6), 200_000: (331, 2.8), 250_000: (282, 2.4)}),
}
"""Table 1: of each model its triangles, and by budget the layered depth images and the hours for grid and placing."""


def city_of(name: str) -> City:
    """A file, or a preset, which may have a detail after a colon."""
    if Path(name).exists():
        return read_city(Path(name))[0]
    preset, _, detail = name.partition(":")
    return generate(preset, detail=int(detail) if detail else None)


def triangles_of(city: City) -> tuple[NDArray[np.floating], NDArray[np.integer]]:
    """Positions (v, 3) and triangles (t, 3)."""
    mesh = city_meshes(city)[0]
    return mesh.positions, mesh.triangles


def placed(
    cells: ModelCells, grid: SolutionGrid, needs: tuple[Needs, ...], rules: PlacingRules
) -> tuple[list[Placements], float]:
    """The images of all points, and the milliseconds that a point takes."""
    placements_at(grid.points[0], needs[0], cells, rules)
    start = time.perf_counter()
    found = [placements_at(point, need, cells, rules) for point, need in zip(grid.points, needs, strict=True)]
    return found, 1e3 * (time.perf_counter() - start) / len(found)


def closeness(
    cells: ModelCells, grid: SolutionGrid, found: list[Placements], rules: PlacingRules
) -> NDArray[np.float64]:
    """(images,) what is left of the view that an image was chosen for, to the target."""
    left = []
    for point, one in zip(grid.points, found, strict=True):
        if one.images:
            ranges = ranges_of(arcs_of(cells.boxes, point, rules.pyramid), np.zeros(0))
            seen = ranges.totals(np.where(one.hides(len(cells.counts)), 0, cells.counts))
            for image in one.images:
                index = ranges.at(image.yaw)
                left.append(seen[index] - ranges.totals(cells.counts[image.cells], image.cells)[index])
    return np.array(left) / rules.target


def flown(
    cells: ModelCells,
    grid: SolutionGrid,
    found: list[Placements],
    rules: PlacingRules,
    eyes: NDArray[np.float64],
    yaws: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(n,) triangles in view of viewers at ``eyes`` (n, 3) who look towards ``yaws`` (n,), and those that are left."""
    seen, left = np.empty(len(eyes), dtype=np.int64), np.empty(len(eyes), dtype=np.int64)
    for n, (eye, yaw) in enumerate(zip(eyes, yaws, strict=True)):
        drawn = seen_from(cells.boxes, eye, yaw, rules.pyramid)
        seen[n] = cells.counts[drawn].sum()
        point = grid.closest(eye, yaw)
        if point < 0:
            raise AssertionError(f"a point for {eye}, {yaw} expected, found none")
        drawn &= ~found[point].hides(len(drawn))
        serving = found[point].at(yaw)
        if serving >= 0:
            drawn[found[point].images[serving].cells] = False
        left[n] = cells.counts[drawn].sum()
    return seen, left


def table(
    name: str, budget: int, targets: list[int], plans: int, flat: tuple[float, float] | None, hiding: bool
) -> list[dict[str, Any]]:
    """The rows of a model."""
    city = city_of(name)
    positions, triangles = triangles_of(city)
    rows = []
    for target in targets:
        rules = PlacingRules(budget, target, FOV)
        start = time.perf_counter()
        cells = cells_for(positions, triangles, rules)
        celled = time.perf_counter()
        domain = domain_of(cells)
        if flat is not None:
            domain[:, 2] = flat
        grid = solution_grid(cells, rules, domain)
        needs = grid.needs()
        gridded = time.perf_counter()
        bits = np.zeros((len(needs), 0), dtype=np.uint8)
        if hiding:
            bits = hidden_cells(city, cells, grid)
            needs = tuple(replace(one, hidden=own) for one, own in zip(needs, bits, strict=True))
        swept = time.perf_counter()
        found, ms = placed(cells, grid, needs, rules)
        images = np.array([len(one.images) for one in found])
        hidden = [float(cells.counts[one.hides(len(cells.counts))].sum() / len(triangles)) for one in found]
        close = closeness(cells, grid, found, rules)
        sizes = np.array([one.window for point in found for one in point.images]).reshape(-1, 4)
        screens = np.prod(sizes[:, 2:] - sizes[:, :2], axis=1) / (4.0 * FOV.across * FOV.up)
        rng = np.random.default_rng(1)
        eyes, yaws = rng.uniform(*grid.domain, (plans, 3)), rng.uniform(0, TURN, plans)
        seen, left = flown(cells, grid, found, rules, eyes, yaws)
        flown_by = time.perf_counter()
        checked = check_grid(cells, grid, found, rules)
        rows.append(
            {
                "model": name,
                "triangles": len(triangles),
                "budget": budget,
                "target": target,
                "cells": len(cells.counts),
                "cells_s": celled - start,
                "leaves": len(grid.codes),
                "points": len(grid.points),
                "grid_s": gridded - celled,
                "reaches": [float(grid.reaches.min()), float(grid.reaches.max())],
                "hidden": np.percentile(hidden, [0, 25, 50, 75, 100]).tolist(),
                "hidden_s": swept - gridded,
                "hidden_bytes": len(zlib.compress(bits.tobytes())),
                "images": int(images.sum()),
                "images_a_point": np.bincount(images).tolist(),
                "ms_a_point": ms,
                "close": np.percentile(close, [1, 25, 50, 75, 100]).tolist() if len(close) else [],
                "screens": [float(screens.mean()), float(screens.max())] if len(screens) else [],
                "plans": plans,
                "seen": [float(seen.mean()), int(seen.max()), float((seen > budget).mean())] if plans else [],
                "left": [float(left.mean()), int(left.max()), int((left > budget).sum())] if plans else [],
                "ranges": checked.ranges,
                "ranges_most": checked.most,
                "ranges_over": checked.over,
                "ranges_s": time.perf_counter() - flown_by,
            }
        )
        print(json.dumps(rows[-1]), flush=True)
    return rows


@kernel(error_model="numpy", nogil=True)
def _farthest(
    places: NDArray[np.float64], eyes: NDArray[np.float64], yaws: NDArray[np.float64], fov: tuple[float, float]
) -> float:
    """The greatest distance from an eye to the nearest place in its reverse pyramid."""
    worst = 0.0
    for n in range(len(eyes)):
        cos, sin, nearest = math.cos(yaws[n]), math.sin(yaws[n]), np.inf
        for k in range(len(places)):
            x, y, z = eyes[n, 0] - places[k, 0], eyes[n, 1] - places[k, 1], eyes[n, 2] - places[k, 2]
            ahead = cos * x + sin * y
            if abs(z) <= fov[1] * ahead and abs(cos * y - sin * x) <= fov[0] * ahead:
                nearest = min(nearest, x * x + y * y + z * z)
        worst = max(worst, nearest)
    return math.sqrt(worst)


def reaches() -> None:
    """The lattice's constant for some views, and how far it is from what is needed."""
    print("| view, degrees | points' reach, proven | s | farthest of 10^6 viewers | points in the sphere |")
    print("|---|---|---|---|---|")
    for across, up in ((60.0, 46.8), (60.0, 60.0), (90.0, 73.7), (45.0, 34.5)):
        fov = fov_of(Camera(1000, 1000, math.radians(across)))
        fov = type(fov)(fov.across, math.tan(math.radians(0.5 * up)))
        lattice, start = lattice_for(fov), time.perf_counter()
        bound = reach(lattice, fov)
        took = time.perf_counter() - start
        places = lattice.places(lattice.within(-bound * np.ones(3), lattice.period + bound))
        rng = np.random.default_rng(1)
        eyes, yaws = rng.uniform(0.0, lattice.period, (1_000_000, 3)), rng.uniform(0.0, TURN, 1_000_000)
        found = _farthest(places, eyes, yaws, (fov.across, fov.up))
        inside = 4.0 / 3.0 * math.pi * bound**3 / float(lattice.period.prod())
        print(f"| {across:g} x {up:g} | {bound:.3f} | {took:.2f} | {found:.3f} | {inside:.0f} |", flush=True)


def told(rows: list[dict[str, Any]]) -> None:
    """The table, with the paper's."""
    print(
        "\n| model | P | target | cells | points | grid s | images | ms a point | left / target p1, p50 | left, most |"
    )
    print("|" + "---|" * 10)
    for row in rows:
        close = f"{row['close'][0]:.3f}, {row['close'][2]:.3f}" if row["close"] else ""
        most = f"{row['left'][1]:,}" if row["left"] else ""
        print(
            f"| {row['model']}, {row['triangles']:,} | {row['budget']:,} | {row['target']:,} | {row['cells']:,} | "
            f"{row['points']:,} | {row['grid_s']:.1f} | {row['images']:,} | {row['ms_a_point']:.1f} | {close} | {most} |"
        )
    for model, (triangles, found) in PAPER.items():
        for budget, (images, hours) in found.items():
            print(f"| paper: {model}, {triangles:,} | {budget:,} | | | | {hours} h | {images:,} | | | |")


def heights(text: str) -> tuple[float, float]:
    """An option's two numbers."""
    low, high = (float(one) for one in text.split(","))
    return low, high


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "models", nargs="*", metavar="MODEL", help="a preset of citygen (a detail after a colon), or a file"
    )
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="DIR", help="gets the table as JSON")
    parser.add_argument("--budget", type=int, default=150_000, metavar="P", help="triangles (default: %(default)s)")
    parser.add_argument("--target", default="90000", metavar="N,...", help="triangles (default: %(default)s)")
    parser.add_argument("--plans", type=int, default=10_000, metavar="N", help="random viewers (default: %(default)s)")
    parser.add_argument(
        "--heights", type=heights, metavar="LOW,HIGH", help="of viewers, metres (default: those of the model, and more)"
    )
    parser.add_argument("--hidden", action="store_true", help="do not count what buildings hide")
    parser.add_argument("--reach", action="store_true", help="tell the lattice's constants first")
    options = parser.parse_args()
    if options.reach:
        reaches()
    targets = [int(one) for one in options.target.split(",")]
    rows = [
        row
        for name in options.models
        for row in table(name, options.budget, targets, options.plans, options.heights, options.hidden)
    ]
    told(rows)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "placing.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
