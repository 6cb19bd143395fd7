"""The horizon map: what it calls sky against rays, how much of the sky it finds, and what it costs.

    python benchmarks/horizon.py examples/helsinki/helsinki.osm.pbf out/montmartre.json
    python benchmarks/horizon.py out/metropolis-1000.jsonl out/metropolis-100000.jsonl --rays 0 --views 0

CITY is what ``build-impostors`` reads. Rays are cast by Embree, from walkers in the streets, from above them and from anywhere
around the city; they begin where they are ``--near-field`` metres away, horizontally. Half go anywhere, half graze the horizon
from above. ``called sky`` are those that the map calls so, and ``of these hit`` those of them that hit something: 0 is
expected.

``found`` is the share of the sky's pixels that the map calls sky, over pictures of 640 x 480 pixels and 60 degrees (every third
pixel of every third row) that walkers see who look about level; a pixel is sky if its ray meets no building and no ground.
``in vain`` are the other pixels of the sky, as a share of all pixels: their rays are cast for nothing. ``ms`` are medians of
the processor's time for one horizon: 60 degrees of it and all around, of walkers; and all around, from above all roofs.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import CityMesh, build_city_mesh
from mmi.appearance.ground_mesh import ground_mesh
from mmi.city.model import City
from mmi.foundation.camera import Camera, View, view_towards
from mmi.rays.casters import make_caster
from mmi.rays.height_field import HeightField, height_field
from mmi.rays.hits import Caster
from mmi.rays.horizon_map import Horizon, azimuths_of, horizon_of, sky
from mmi.reading.read_city import read_city

CAMERA = Camera(640, 480, math.radians(60.0))
EYE = 1.7
"""Metres above the ground."""
AROUND = 2048
"""Columns of a horizon, where they are not what is varied."""


def hits(
    caster: Caster, eye: NDArray[np.float64], directions: NDArray[np.float64], start: float = 0.0
) -> NDArray[np.bool_]:
    """(n,) whether the rays hit, which begin where they are ``start`` metres away, horizontally."""
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    along = start / np.maximum(np.hypot(unit[:, 0], unit[:, 1]), 1e-9)
    return caster.first_hits(eye + along[:, None] * unit, unit).triangle >= 0


def walkers(city: City, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """(count, 3) places in streets, at the eye's height."""
    lines = [edge["geometry"] for _, _, edge in city.streets.edges(data=True)]
    lengths = np.array([line.length for line in lines])
    chosen = rng.choice(len(lines), count, p=lengths / lengths.sum())
    xy = np.array([lines[i].interpolate(rng.random(), normalized=True).coords[0][:2] for i in chosen])
    return np.column_stack([xy, city.ground_at(xy) + EYE])


def viewers(city: City, mesh: CityMesh, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """(count, 3): half walk, a quarter hovers below the highest roof, a quarter is anywhere in and around the city."""
    eyes = walkers(city, count, rng)
    low, high = mesh.positions.min(axis=0), mesh.positions.max(axis=0)
    eyes[count // 2 : 3 * count // 4, 2] += rng.uniform(5.0, high[2] - low[2], 3 * count // 4 - count // 2)
    around = rng.uniform(-0.3, 1.3, (count - 3 * count // 4, 3)) * (high - low) + low
    around[:, 2] = np.maximum(around[:, 2], low[2] + EYE)
    eyes[3 * count // 4 :] = around
    return eyes


def rays_from(horizon: Horizon, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """(count, 3) directions of horizontal length 1: half anywhere, half within a few thousandths of the horizon's slope."""
    turns = rng.uniform(-math.pi, math.pi, count)
    slopes = rng.normal(0.0, 0.4, count)
    columns = np.floor((turns - horizon.first) % (2.0 * math.pi) * horizon.per_radian).astype(int)
    grazing = horizon.slopes[columns % len(horizon.slopes)] + rng.exponential(2e-3, count) - 1e-5
    slopes = np.where((rng.random(count) < 0.5) & np.isfinite(grazing), grazing, slopes)
    return np.column_stack([np.cos(turns), np.sin(turns), slopes])


def violations(
    field: HeightField, caster: Caster, eyes: NDArray[np.float64], rays: int, near: float, rng: np.random.Generator
) -> tuple[int, int, int]:
    """How many rays were cast, how many of them are called sky, and how many of those hit."""
    above = wrong = 0
    each = -(-rays // len(eyes))
    for eye in eyes:
        horizon = horizon_of(field, eye, beyond=near, columns=AROUND)
        directions = rays_from(horizon, each, rng)
        called = sky(horizon, directions)
        above += int(called.sum())
        wrong += int(hits(caster, eye, directions[called], near).sum())
    return each * len(eyes), above, wrong


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A view: its directions (n, 3), which of them are sky, and the window of azimuths."""

    eye: NDArray[np.float64]
    directions: NDArray[np.float64]
    open: NDArray[np.bool_]
    window: tuple[float, float] | None


def directions_of(view: View, every: int) -> NDArray[np.float64]:
    u, v = (one[every // 2 :: every] for one in view.pixel_centres())
    u, v = (one.reshape(-1) for one in np.meshgrid(u, v))
    return view.unproject(u, v, np.ones(len(u))) - view.eye


def pictures(city: City, caster: Caster, count: int, rng: np.random.Generator) -> list[Picture]:
    """What ``count`` walkers see."""
    ground = make_caster(ground_mesh(city, margin=500.0), kind="embree", workers=2)
    found = []
    for eye in walkers(city, count, rng):
        azimuth, pitch = rng.uniform(-math.pi, math.pi), rng.uniform(-0.1, 0.2)
        view = view_towards(eye, azimuth, pitch, focal=CAMERA.focal, window=CAMERA.window)
        directions = directions_of(view, 3)
        sees_sky = ~hits(caster, eye, directions) & ~hits(ground, eye, directions)
        if city.terrain is None:
            sees_sky &= directions[:, 2] > 0.0
        left, top, width, height = CAMERA.window
        corners = [(u, v) for u in (left, left + width) for v in (top, top + height)]
        u, v = np.array(corners, dtype=float).T
        found.append(Picture(eye, directions, sees_sky, azimuths_of(view.unproject(u, v, np.ones(4)) - eye)))
    return found


def shares(field: HeightField, views: list[Picture], near: float, columns: int) -> tuple[float, float, float]:
    """Sky's share of all pixels, what share of it is found, and what share of all pixels is cast in vain."""
    pixels = open_pixels = found = 0
    for one in views:
        horizon = horizon_of(field, one.eye, beyond=near, columns=columns, window=one.window)
        pixels += len(one.open)
        open_pixels += int(one.open.sum())
        found += int((sky(horizon, one.directions) & one.open).sum())
    return open_pixels / pixels, found / max(open_pixels, 1), (open_pixels - found) / pixels


def milliseconds(
    field: HeightField, eyes: NDArray[np.float64], near: float, columns: int, width: float | None
) -> float:
    """Median of a horizon, all around or of a window ``width`` radians wide."""
    took = []
    for turn, eye in enumerate(eyes):
        window = None if width is None else (float(turn), turn + width)
        start = time.thread_time()
        horizon_of(field, eye, beyond=near, columns=columns, window=window)
        took.append(time.thread_time() - start)
    return 1e3 * statistics.median(took)


def measure(path: Path, options: argparse.Namespace) -> None:
    rng = np.random.default_rng(options.seed)
    city, _ = read_city(path)
    mesh = build_city_mesh(city)
    wide, deep, tall = np.ptp(mesh.positions, axis=0)
    hills = "" if city.terrain is None else f", ground that rises {np.ptp(city.terrain.heights):.0f} m"
    print(
        f"{path.name}: {len(city.objects)} objects, {len(mesh.triangles)} triangles, {wide:.0f} x {deep:.0f} m{hills}"
    )
    near, steps = options.near_field, [None, *options.steps]
    caster = make_caster(mesh, kind="embree", workers=2) if options.rays or options.views else None
    views = pictures(city, caster, options.views, rng) if options.views else []
    eyes = viewers(city, mesh, 200, rng)
    below, above = walkers(city, 40, rng), walkers(city, 40, rng)
    above[:, 2] += tall
    header = "{:>8} {:>8} {:>11} {:>8} {:>12} {:>8} {:>8} {:>8} {:>8} {:>8} {:>9} {:>9}"
    names = "step m|columns|cells|field s|called sky|of these|sky|found|in vain|ms|ms around|ms above"
    print(header.format(*names.split("|")))
    print(header.format("", "", "", "", "", "hit", "%", "%", "%", "60 deg", "walking", "roofs"))
    for step in steps:
        start = time.perf_counter()
        field = height_field(mesh, step=step)
        took = time.perf_counter() - start
        for columns in options.columns if step is None else [AROUND]:
            called = wrong = "-"
            if options.rays and columns == AROUND:
                _, *counts = violations(field, caster, eyes, options.rays, near, rng)
                called, wrong = map(str, counts)
            of_views = [f"{100 * one:.2f}" for one in shares(field, views, near, columns)] if views else ["-"] * 3
            cells = field.levels[0].size
            times = [
                f"{milliseconds(field, who, near, columns, width):.2f}"
                for who, width in ((below, CAMERA.fov), (below, None), (above, None))
            ]
            print(header.format(f"{field.step:.2f}", columns, cells, f"{took:.2f}", called, wrong, *of_views, *times))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cities", type=Path, nargs="+", metavar="CITY")
    parser.add_argument("--near-field", type=float, default=100.0, metavar="METRES")
    parser.add_argument("--rays", type=int, default=1_000_000, help="rays of each height field; 0: none")
    parser.add_argument("--views", type=int, default=40, help="pictures; 0: none")
    parser.add_argument("--steps", type=float, nargs="*", default=[0.5, 1.0, 2.0, 4.0], metavar="METRES")
    parser.add_argument("--columns", type=int, nargs="+", default=[1024, AROUND, 4096, 8192])
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    for path in options.cities:
        measure(path, options)


if __name__ == "__main__":
    main()
