"""The worst view of each cell, searched for: where random views say that the bound holds, corners of cells may say otherwise.

    build-impostors CITY -o OUT --max-error 5
    python benchmarks/hunt.py OUT [OUT ...] --cells 40 -o FOLDER

In each cell views are taken from all corners and the middles of all sides, in twelve directions, eyes at the top and the
bottom of the eye band in turn. From the worst of them, one search follows the displacement, and one the thickness of wrong
regions: a step along the cell, across it, up or down, or a turn, of half the size where no step finds worse. As many random
views of the same cell are measured beside it. Sky and ground count as objects.

A region that is thicker than T + 2 px holds a square of pixels of a certain size. That is looked for first, and only views
where it is found are measured exactly, and once more as benchmarks/bound.py does (*beyond a pixel*: whatever a pixel around
may show is forgiven, at four times the resolution).

FOLDER gets hunt.json (worst finds of each cell: pose, pixels) and OUT.walk.json, the finds of a dataset as a walk of jumps:

    compare-impostors OUT -o DIR --path FOLDER/OUT.walk.json --fps 1 --check
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from bound import beyond_a_pixel
from numpy.typing import NDArray

from mmi.cells.viewing_cells import ViewingCell
from mmi.dataset.reading import open_dataset
from mmi.foundation.camera import View
from mmi.foundation.thickness import thickness
from mmi.walks.walk import Keyframe, Pose, Walk, write_walk
from viewer.cells.cell_cache import CellCache
from viewer.cells.scene_cache import cell_cache
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.drawing.renderer import Renderer
from viewer.measuring.view_errors import wrong_regions
from viewer.plan import Budget, CellKey, CellLayers, Objects, Plan, Sky
from viewer.scene.scene import WalkScene, open_scene
from viewer.techniques.catalogue import make_technique
from viewer.walks.random_views import random_views

HEADINGS = 12
SEARCHED = 17
"""Views of each of the two searches."""
INSIDE = 1e-3
"""Metres that positions keep from the border of a cell."""
ROUNDING = 1e-3
"""Pixels by which a measured figure may pass a limit: depths are read back as float32."""


class Place(NamedTuple):
    """A view in a cell: shares of its length, width and eye band, from 0 to 1, and an azimuth in radians."""

    along: float
    across: float
    up: float
    azimuth: float


@dataclass(frozen=True, slots=True)
class Found:
    """A view and its errors in pixels. ``square`` is the side of the largest square of wrong pixels; ``thick`` is 0 where that
    is too small to matter, and ``beyond`` where nothing is above the limit.
    """

    cell: str
    pose: Pose
    displaced: float
    square: int
    thick: float
    beyond: float


class Hunter:
    """Draws and measures views of the cells of a dataset, each with its own cell's impostor, also at a border of the cell."""

    def __init__(self, scene: WalkScene, renderer: Renderer, cache: CellCache) -> None:
        self.scene, self._renderer, self._cache = scene, renderer, cache
        self._full = make_technique("full", {scene.name: scene})
        self.limit = scene.parameters.max_error_px + 2.0
        self._side = smallest_square(self.limit)
        self.views = 0

    def measure(self, cell: str, pose: Pose, known: int = 0) -> Found:
        """The errors of a view; thickness where that may be above the limit, or above that of a square of ``known`` pixels."""
        camera, view = self.scene.camera, pose.view(self.scene.camera)
        frames = self._draw(cell, view)
        self.views += 1
        shown = frames[1]
        assert shown.displacement is not None
        angles = shown.displacement[np.isfinite(shown.displacement)].astype(np.float64)
        displaced = camera.pixels_from_angle(min(float(angles.max(initial=0.0)), 1.5))
        wrong = wrong_regions(*frames).wrong
        square, thick, beyond = largest_square(wrong), 0.0, 0.0
        if square >= self._side or square > known:
            thick = thickness(wrong)
            if thick > self.limit:
                beyond = beyond_a_pixel(lambda finer: self._draw(cell, finer), view, frames, self.limit)
        return Found(cell, pose, displaced, square, thick, beyond)

    def _draw(self, cell: str, view: View) -> tuple[DrawnPicture, DrawnPicture]:
        """The geometry's picture, and the impostor's."""
        place, key = self.scene.cell(cell), CellKey(self.scene.name, cell)
        truth = self._renderer.draw(self._full.plan(view, now=0.0, budget=Budget()), view, measured=True)
        draws = (
            Objects(f"local {self.scene.name} {cell}", place.near),
            CellLayers(key, place.layers_in(view)),
            self.scene.ground_in(view),
            Sky(),
        )
        self._cache.want((key,))
        self._cache.require((key,))
        return truth, self._renderer.draw(Plan(draws, cell, (key,)), view, measured=True)


def smallest_square(limit: float) -> int:
    """The side of a square of whole pixels that is in every region with a disc of more than ``limit`` pixels in diameter.

    A square with a side of the diameter over the root of 2 fits into the disc, and holds a square of whole pixels one smaller.
    """
    return max(math.ceil(limit / math.sqrt(2.0)) - 1, 1)


def largest_square(region: NDArray[np.bool_]) -> int:
    """The side of the largest square of whole pixels in a region (h, w), by eroding it pixel by pixel."""
    side, left = 0, region
    while left.any():
        side += 1
        left = left[1:, 1:] & left[:-1, 1:] & left[1:, :-1] & left[:-1, :-1]
    return side


def pose_at(cell: ViewingCell, place: Place) -> Pose:
    """The pose of a place, which keeps a millimetre inside the cell."""
    p, q = np.array(cell.p), np.array(cell.q)
    along = (q - p) / cell.length
    s = np.clip(place.along * cell.length, INSIDE, cell.length - INSIDE)
    t = np.clip((2.0 * place.across - 1.0) * cell.half_width, INSIDE - cell.half_width, cell.half_width - INSIDE)
    x, y = p + s * along + t * np.array([-along[1], along[0]])
    low, high = cell.eye_at(float(s / cell.length))
    return Pose((float(x), float(y), low + place.up * (high - low)), math.remainder(place.azimuth, math.tau), 0.0)


def starts() -> Iterator[Place]:
    """Corners and middles of sides of any cell, in all directions."""
    spots = [(s, t) for s in (0.0, 0.5, 1.0) for t in (0.0, 0.5, 1.0) if (s, t) != (0.5, 0.5)]
    for i, (s, t) in enumerate(spots):
        for k in range(HEADINGS):
            yield Place(s, t, float((i + k) % 2), k * math.tau / HEADINGS)


def worse(found: Found, *, by_thickness: bool) -> tuple[float, ...]:
    """What a search makes as large as it can."""
    return (found.beyond, found.square, found.thick) if by_thickness else (found.displaced,)


def hunt(hunter: Hunter, cell: ViewingCell) -> list[Found]:
    """All views that a hunt through a cell measures."""
    seen: list[tuple[Place, Found]] = []
    for place in starts():
        known = max((found.square for _, found in seen), default=0)
        seen.append((place, hunter.measure(cell.id, pose_at(cell, place), known)))
    for by_thickness in (False, True):
        place, best = max(seen, key=lambda one: worse(one[1], by_thickness=by_thickness))
        step, left = 1.0, SEARCHED
        while left > 0 and worse(best, by_thickness=by_thickness) > (0.0,):
            moves = [
                place._replace(azimuth=place.azimuth + 0.25 * step),
                place._replace(azimuth=place.azimuth - 0.25 * step),
                place._replace(along=float(np.clip(place.along + 0.25 * step, 0.0, 1.0))),
                place._replace(along=float(np.clip(place.along - 0.25 * step, 0.0, 1.0))),
                place._replace(across=float(np.clip(place.across + 0.25 * step, 0.0, 1.0))),
                place._replace(across=float(np.clip(place.across - 0.25 * step, 0.0, 1.0))),
                place._replace(up=1.0 - place.up),
            ]
            before = best
            for move in moves:
                if move == place or left == 0:
                    continue
                left -= 1
                found = hunter.measure(cell.id, pose_at(cell, move), max(one.square for _, one in seen))
                seen.append((move, found))
                if worse(found, by_thickness=by_thickness) > worse(best, by_thickness=by_thickness):
                    place, best = move, found
                    break
            if best is before:
                step *= 0.5
    return [found for _, found in seen]


def spread_cells(cells: tuple[ViewingCell, ...], n: int | None) -> list[ViewingCell]:
    """``n`` of the cells, evenly over their order, or all."""
    if n is None or n >= len(cells):
        return list(cells)
    return [cells[i * len(cells) // n] for i in range(n)]


@contextmanager
def hunter_of(folder: Path) -> Iterator[Hunter]:
    """The hunter of a dataset, with a renderer of its own."""
    scene = open_scene(open_dataset(folder), name="multi-mesh")
    camera, scenes = scene.camera, {"multi-mesh": scene}
    with (
        Renderer(scene.mesh, scene.ground, size=(camera.width, camera.height), measured=True, samples=0) as renderer,
        cell_cache(scenes, renderer, measured=True, capacity=256 << 20) as cache,
    ):
        yield Hunter(scene, renderer, cache)


def row(found: list[Found], limit: float) -> str:
    """Columns of the table for some views."""
    thick = [one.thick for one in found if one.thick]
    return (
        f"{len(found)} | {max(one.displaced for one in found):.1f} | "
        f"{sum(one.displaced > limit - 2.0 + ROUNDING for one in found)} | "
        f"{max(thick, default=0.0):.1f} | {sum(one.thick > limit for one in found)} | "
        f"{sum(one.beyond > limit for one in found)}"
    )


def hunt_all(
    folder: Path, *, cells: int | None, seed: int, seconds: float, keep: int
) -> tuple[str, dict[str, Any], Walk]:
    """Rows of the table, what hunt.json says, and the walk through the worst finds of a dataset."""
    hunted: list[Found] = []
    random: list[Found] = []
    worst: list[Found] = []
    began = time.monotonic()
    with hunter_of(folder) as hunter:
        chosen = spread_cells(hunter.scene.whereabouts.cells, cells)
        promised = {one.id: one.promised_error_px for one in hunter.scene.dataset.manifest.cells}
        for done, cell in enumerate(chosen):
            if time.monotonic() - began > seconds:
                chosen = chosen[:done]
                break
            found = hunt(hunter, cell)
            hunted += found
            views = random_views([cell], len(found), seed=seed + done, terrain=hunter.scene.terrain)
            known = 0
            for _, pose in views:
                random.append(hunter.measure(cell.id, pose, known))
                known = max(known, random[-1].square)
            worst += {
                id(one): one
                for one in (max(found, key=lambda f: worse(f, by_thickness=kind)) for kind in (False, True))
            }.values()
            print(f"\r{folder.name}: {done + 1} of {len(chosen)} cells", end="", file=sys.stderr, flush=True)
        limit = hunter.limit
    print(file=sys.stderr)
    taken = time.monotonic() - began
    name = f"{folder.name} | {limit - 2.0:g} | {len(chosen)}"
    told = f"| {name} | hunted | {row(hunted, limit)} |\n| {name} | random | {row(random, limit)} |"
    worst.sort(key=lambda one: (-max(one.displaced / (limit - 2.0), one.thick / limit), one.cell))
    finds = [asdict(one) | {"promised_error_px": promised[one.cell]} for one in worst]
    document = {
        "dataset": folder.name,
        "threshold_px": limit - 2.0,
        "views": len(hunted),
        "seconds": taken,
        "finds": finds,
    }
    frames = tuple(Keyframe(float(k), one.pose, cut=k > 0) for k, one in enumerate(worst[:keep]))
    return told, document, Walk(f"the worst finds in {folder.name}", frames)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", type=Path, nargs="+", metavar="OUT")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--cells", type=int, metavar="N", help="spread over each dataset (default: all)")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of the random views (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=math.inf, help="begin no cell of a dataset after so many")
    parser.add_argument("--keep", type=int, default=24, help="views of the walk (default: %(default)s)")
    options = parser.parse_args()
    print(
        "| dataset | T px | cells | views | | displacement px max | above T | thickness px max | above T + 2 | "
        "beyond a pixel |"
    )
    print("|" + "---|" * 10)
    documents = []
    for folder in options.datasets:
        told, document, walk = hunt_all(
            folder, cells=options.cells, seed=options.seed, seconds=options.seconds, keep=options.keep
        )
        print(told, flush=True)
        documents.append(document)
        write_walk(walk, options.output / f"{folder.name}.walk.json")
    (options.output / "hunt.json").write_text(json.dumps(documents, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
