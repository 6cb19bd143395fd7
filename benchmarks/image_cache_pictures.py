"""What the image cache shows wrongly in the worst of many views: demand 1 of its experiments (Schaufler & Stuerzlinger 1996).

    python benchmarks/image_cache_pictures.py examples/helsinki/helsinki.osm.pbf living-room -o out/cache-pictures
    python benchmarks/image_cache_pictures.py forest --network walk -o out/cache-pictures --views 100

For each city (a file, or a preset of citygen) the first frames of random views, in which everything is captured anew, and
frames of walks, each 60 frames after the one before: images combined from images by then. Every box is an image that can be
one, and nothing limits the updates.

thickest    regions in which another object is seen than the geometry shows, pixels: how many views have which
a pixel off the same of what the geometry shows nowhere within a pixel, drawn eight times as fine. In rows of facades narrower
            than a pixel any of them may be seen at a pixel; those regions are thick and nothing is off by a pixel
FLIP        the mean of all views

The worst pictures are written, the geometry's on the left, the cache's in the middle, what is wrong on the right. Ctrl-C ends
the views of a city, and what was found so far is told.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from citygen.generate import generate
from citygen.presets import PRESETS
from mmi.foundation.camera import Camera, View, view_towards
from mmi.foundation.thickness import thickness
from mmi.reading.read_city import read_city
from mmi.reading.read_options import ReadOptions
from viewer.caching.rules import CacheRules
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.drawing.renderer import Renderer
from viewer.measuring.view_errors import flip_map, wrong_regions
from viewer.plan import Budget
from viewer.scene.scene import WalkScene, scene_of_city
from viewer.techniques.geometry import FullGeometry
from viewer.techniques.image_cache import ImageCache
from viewer.walks.random_views import random_views
from viewer.walks.tour import tour

CAMERA = Camera(512, 512, math.radians(60.0))
_FINER = 8
"""Samples of the geometry along a pixel, where it is asked what it shows within one."""
_SHOWN_FROM = 2.0
"""Wrong regions thicker than so many pixels are looked at more closely."""
_APART = 60
"""Frames of a walk from one that is compared to the next."""


class Found(NamedTuple):
    """What one view showed: pixels, and FLIP."""

    thickest: float
    off: float
    flip: float
    combined: int
    kept_px: float


class Scored(NamedTuple):
    """Two pictures of a view and where they differ."""

    found: Found
    truth: NDArray[np.uint8]
    shown: NDArray[np.uint8]
    wrong: NDArray[np.bool_]


def nowhere_near(scene: WalkScene, renderer: Renderer, view: View, shown: DrawnPicture) -> NDArray[np.bool_]:
    """(h, w) pixels where ``shown`` has an object that the geometry shows nowhere within a pixel of their middles."""
    left, top = (_FINER * side for side in view.window[:2])
    width, height = view.window[2:]
    plan = FullGeometry(scene).plan(view, now=0.0, budget=Budget())
    assert shown.object_ids is not None
    found = np.ones((height, width), dtype=np.bool_)
    # Of the fine picture, tile by tile of the coarse one's size: what a renderer of one size can draw.
    ids = np.full((_FINER * height, _FINER * width), -3, dtype=np.int32)
    for row in range(_FINER):
        for column in range(_FINER):
            window = (left + column * width, top + row * height, width, height)
            tile = renderer.draw(plan, View(view.eye_from_world, _FINER * view.focal, window), measured=True)
            assert tile.object_ids is not None
            ids[row * height : (row + 1) * height, column * width : (column + 1) * width] = tile.object_ids
    reach = _FINER  # a pixel from the middle, whichever way
    around = np.pad(ids, reach, constant_values=-3)
    for y in range(_FINER // 2, _FINER // 2 + 2 * reach):
        for x in range(_FINER // 2, _FINER // 2 + 2 * reach):
            found &= around[y : y + _FINER * height : _FINER, x : x + _FINER * width : _FINER] != shown.object_ids
    return found


def scored(scene: WalkScene, renderer: Renderer, cache: ImageCache, view: View) -> Scored:
    """Draw a view by both and compare."""
    truth = renderer.draw(FullGeometry(scene).plan(view, now=0.0, budget=Budget()), view, measured=True)
    shown = renderer.draw(cache.plan(view, now=0.0, budget=Budget()), view, measured=True)
    assert truth.color is not None
    assert shown.color is not None
    wrong = wrong_regions(truth, shown).wrong
    thickest = off = thickness(wrong)
    if thickest > _SHOWN_FROM:
        off = thickness(wrong & nowhere_near(scene, renderer, view, shown))
    flip = float(flip_map(truth.color, shown.color).mean())
    found = Found(thickest, off, flip, cache.latest.combined, cache.latest.kept_px)
    return Scored(found, truth.color, shown.color, wrong)


def first_frames(scene: WalkScene, views: int, seed: int) -> Iterator[Scored]:
    """Of random views, each with a cache that holds nothing."""
    for _, pose in random_views(scene.whereabouts.cells, views, seed=seed, terrain=scene.terrain):
        view = view_towards(np.array(pose.eye), pose.azimuth, pose.pitch, focal=CAMERA.focal, window=CAMERA.window)
        with Renderer(scene.mesh, scene.ground, size=(CAMERA.width, CAMERA.height), measured=True) as renderer:
            yield scored(scene, renderer, ImageCache(scene, _rules("frustum")), view)


def on_walks(scene: WalkScene, views: int, seed: int) -> Iterator[Scored]:
    """Every so many frames of a tour, at a walker's pace and ten frames a second; of several where the first ends before."""
    places, left = scene.whereabouts, views
    while left:
        metres = 0.14 * _APART * left + 1.0
        steps = tour(places.cells, places.adjacency, metres=metres, speed=1.4, seed=seed).frames(10.0)
        if len(steps) <= _APART:
            raise SystemExit(f"{scene.source}: walks of more than {_APART} frames expected, found {len(steps)}")
        cache = ImageCache(scene, _rules("sphere"))
        with Renderer(scene.mesh, scene.ground, size=(CAMERA.width, CAMERA.height), measured=True) as renderer:
            for k, step in enumerate(steps):
                eye, azimuth, pitch = np.array(step.pose.eye), step.pose.azimuth, step.pose.pitch
                view = view_towards(eye, azimuth, pitch, focal=CAMERA.focal, window=CAMERA.window)
                if k and k % _APART == 0:
                    yield scored(scene, renderer, cache, view)
                    left -= 1
                    if not left:
                        break
                else:
                    renderer.draw(cache.plan(view, now=0.0, budget=Budget()), view, read=False)
        seed += 1


def _rules(keep: str) -> CacheRules:
    return CacheRules(eager=True, leaf_triangles=200, keep="frustum" if keep == "frustum" else "sphere")


def table_of(name: str, kind: str, pictures: Iterator[Scored], total: int, out: Path) -> dict[str, Any]:
    """Print a line of the table and keep the worst picture."""
    worst: Scored | None = None
    rows = []
    try:
        for number, one in enumerate(pictures):
            rows.append(one.found)
            if worst is None or one.found[:2] > worst.found[:2]:
                worst = one
            if number % 5 == 4 or number == total - 1:
                print(f"\r{name}, {kind}: {number + 1} of {total}", end="", file=sys.stderr, flush=True)
    except KeyboardInterrupt:
        if worst is None:
            raise
    print(file=sys.stderr)
    assert worst is not None
    counts = Counter(f"{one.thickest:.1f}" for one in rows)
    told = ", ".join(f"{px} px in {counts[px]}" for px in sorted(counts, key=float))
    over = [one.off for one in rows if one.thickest > _SHOWN_FROM]
    print(
        f"| {name} | {kind} | {len(rows)} | {told} | {max(over, default=0.0):.1f} px | "
        f"{np.mean([one.flip for one in rows]):.4f} | {np.mean([one.combined for one in rows]):.1f} | "
        f"{max(one.kept_px for one in rows):.2f} |",
        flush=True,
    )
    mask = np.repeat(np.where(worst.wrong, 0, 255).astype(np.uint8)[..., None], 3, axis=2)
    Image.fromarray(np.concatenate([worst.truth, worst.shown, mask], axis=1)).save(
        out / f"{name}-{kind.replace(' ', '-')}.png"
    )
    return {"city": name, "kind": kind, "views": [one._asdict() for one in rows]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cities", nargs="+", metavar="CITY", help=f"a file, or one of {', '.join(PRESETS)}")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="DIR", help="gets worst pictures and a JSON")
    parser.add_argument("--views", type=int, default=100, help="random views of each city (default: %(default)s)")
    parser.add_argument("--walks", type=int, default=20, help="frames of walks, 60 apart (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=6, help="(default: %(default)s)")
    parser.add_argument("--network", choices=("drive", "walk", "all"), default=None, help="streets of a file to use")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    print("| city | frames | views | thickest | a pixel off | FLIP | combined | error told, px |")
    print("|" + "---|" * 8)
    found = []
    for name in options.cities:
        if name in PRESETS:
            city = generate(name)
        else:
            reading = ReadOptions() if options.network is None else ReadOptions(network=options.network)
            city = read_city(Path(name), reading)[0]
        scene = scene_of_city(city, name="multi-mesh", camera=CAMERA)
        told = Path(name).name.split(".")[0]
        if options.views:
            views = first_frames(scene, options.views, options.seed)
            found.append(table_of(told, "first frames", views, options.views, options.out))
        if options.walks:
            walks = on_walks(scene, options.walks, options.seed)
            found.append(table_of(told, "walks", walks, options.walks, options.out))
    (options.out / "pictures.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
