"""Layered images of parts of a model against its geometry, by number of construction pictures (Aliaga & Lastra 1999).

    python benchmarks/warping.py examples/helsinki/helsinki.osm.pbf pipes MODEL.glb --places 3 --eyes 12 -o out/warping

For each model (a file, or a preset of citygen) and each place, a point and a direction, the far subset is what lies in boxes
farther from the point than an eighth of the model's largest side and wholly within the view's pyramid. It is captured from 1, 5
and 9 viewpoints, nine both as in figure 11 and all ahead, and warped to random eyes in the pyramid ahead of the point, as far
as to the subset's nearest box, turned by up to 15 degrees. Holes are pixels that show nothing where the geometry does;
*disoccluded* are those whose surface no picture has, within a pixel and 2 percent of its depth, so that the others are gaps
between samples. Wrong pixels show another object; ``beyond`` leaves out what is off by a pixel. Times are ratios of one run:
single against two threads. Rows of all places of a model together come last.

A second table has both warps of ``--warp`` side by side, for images of the last row: the same eyes, and times of whole frames.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable
from functools import partial
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
from viewer.computed import WarpedPicture, WarpedSamples
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.drawing.renderer import Renderer
from viewer.layered.image_codec import decoded, encoded
from viewer.layered.layered_image import LayeredImage, Picture
from viewer.layered.merging import merged
from viewer.layered.viewpoints import Arrangement, construction_views
from viewer.layered.warping import warped
from viewer.measuring.view_errors import beyond_resampling, flip_map, wrong_regions
from viewer.plan import Draw, Faces, Plan, Sky
from viewer.scene.frustum import box_corners
from viewer.scene.scene import WalkScene, scene_of_city

CAMERA = Camera(512, 384, math.radians(60.0))
WAYS: tuple[tuple[int, Arrangement], ...] = ((1, "figure 11"), (5, "figure 11"), (9, "figure 11"), (9, "ahead"))
TURNED = math.radians(15.0)
_LEAST = 1000
"""Triangles that a subset has at least."""


class Subset(NamedTuple):
    """What is replaced: ``triangles`` (n,), and ``corners`` (k, 3) of boxes, the ``nearest`` so deep in the point's view."""

    view: View
    azimuth: float
    triangles: NDArray[np.int32]
    corners: NDArray[np.float64]
    nearest: float


def looking(eye: NDArray[np.float64], azimuth: float) -> View:
    """A level view of the display."""
    return view_towards(eye, azimuth, 0.0, focal=CAMERA.focal, window=CAMERA.window)


def far_subset(scene: WalkScene, eye: NDArray[np.float64], azimuth: float, radius: float) -> Subset:
    """Triangles in cubes of a quarter of the ``radius`` that are farther away than it, and wholly in view."""
    corners = scene.mesh.positions.astype(np.float64)[scene.mesh.triangles]
    keys = np.floor(corners.mean(axis=1) / (0.25 * radius)).astype(np.int64)
    _, cells = np.unique(keys, axis=0, return_inverse=True)
    cells = cells.reshape(-1)
    low, high = np.full((cells.max() + 1, 3), np.inf), np.full((cells.max() + 1, 3), -np.inf)
    np.minimum.at(low, cells, corners.min(axis=1))
    np.maximum.at(high, cells, corners.max(axis=1))
    boxes, view = box_corners(low, high), looking(eye, azimuth)
    u, v, depth = np.moveaxis(view.project(boxes), -1, 0)
    left, top, width, height = view.window
    inside = (depth > 0.0) & (u >= left) & (u <= left + width) & (v >= top) & (v <= top + height)
    chosen = inside.all(axis=1) & (np.linalg.norm(np.clip(eye, low, high) - eye, axis=1) > radius)
    nearest = float(depth[chosen].min()) if chosen.any() else 0.0
    some = np.flatnonzero(chosen[cells]).astype(np.int32)
    return Subset(view, azimuth, some, boxes[chosen].reshape(-1, 3), nearest)


def eyes_of(subset: Subset, radius: float, count: int, rng: np.random.Generator) -> list[View]:
    """Where the image may be shown: in the pyramid that looks as the eye does, from the subset's point."""
    found = []
    left, top, width, height = subset.view.window
    for _ in range(count):
        azimuth = subset.azimuth + rng.uniform(-TURNED, TURNED)
        view = looking(subset.view.eye, azimuth)
        u, v = left + width * rng.random(), top + height * rng.random()
        way = view.unproject(np.array(u), np.array(v), np.array(1.0)) - view.eye
        away = radius * rng.uniform(0.2, 1.0)
        found.append(looking(view.eye + away * way / np.linalg.norm(way), azimuth))
    return found


class Camcorder:
    """Draws a subset, whatever the size of the view."""

    def __init__(self, renderer: Renderer, subset: Subset) -> None:
        self._renderer, self._plan = renderer, Plan((Sky(), Faces("", subset.triangles)))

    def drawn(self, view: View) -> DrawnPicture:
        """The measured picture."""
        self._renderer.resize(view.window[2:])
        return self._renderer.draw(self._plan, view, measured=True)

    def picture(self, view: View) -> Picture:
        """The same, for merging."""
        drawn = self.drawn(view)
        assert drawn.depth is not None and drawn.object_ids is not None
        return Picture(view, drawn.color, drawn.depth, drawn.object_ids)


def seconds(work: Callable[[], object], times: int = 3) -> float:
    """The least of some."""
    took = []
    for _ in range(times):
        start = time.perf_counter()
        work()
        took.append(time.perf_counter() - start)
    return min(took)


def warp_all(image: LayeredImage, eyes: list[View], threads: int) -> None:
    """What is timed."""
    for eye in eyes:
        warped(image, eye, threads=threads)


def picture_draw(image: LayeredImage, view: View) -> WarpedPicture:
    """What ``--warp software`` draws, by a thread."""
    found = warped(image, view)
    return WarpedPicture(found.color, found.depth, found.ids)


def samples_draw(image: LayeredImage, _: View) -> WarpedSamples:
    """What ``--warp points`` draws."""
    return WarpedSamples(
        f"{id(image)}",
        image.view,
        image.starts,
        image.depths,
        image.slopes,
        image.reaches,
        image.colors,
        image.ids,
    )


def side_by_side(
    renderer: Renderer, image: LayeredImage, eyes: list[View], truths: list[DrawnPicture], name: str
) -> list[dict[str, Any]]:
    """A row for each warp: what it shows, and the mean milliseconds of a frame with nothing else but the sky."""

    def frame(make: Callable[[LayeredImage, View], Draw], eye: View) -> None:
        renderer.draw(Plan((make(image, eye), Sky())), eye, read=False)

    renderer.resize((CAMERA.width, CAMERA.height))
    rows: list[dict[str, Any]] = []
    for warp, make in (("software", picture_draw), ("points", samples_draw)):
        found = [renderer.draw(Plan((make(image, eye), Sky())), eye, measured=True) for eye in eyes]
        shown = [before_grey(one.color, one.object_ids) for one in found]
        took = [seconds(partial(frame, make, eye)) for eye in eyes]
        rows.append(
            {"place": name, "warp": warp, "samples": len(image.depths), "ms": 1e3 * float(np.mean(took))}
            | errors_of(truths, shown)
        )
        rows[-1]["ratio"] = rows[-1]["ms"] / rows[0]["ms"]
    return rows


def errors_of(truths: list[DrawnPicture], shown: list[DrawnPicture]) -> dict[str, float]:
    """Means over some pictures, and how thick what is wrong is."""
    regions = [wrong_regions(*pair) for pair in zip(truths, shown, strict=True)]
    beyond = [beyond_resampling(*pair) for pair in zip(truths, shown, strict=True)]
    thick = [thickness(one.wrong) for one in beyond]
    return {
        "holes": float(np.mean([one.holes.mean() for one in regions])),
        "wrong": float(np.mean([one.wrong.mean() for one in regions])),
        "beyond": float(np.mean([one.wrong.mean() for one in beyond])),
        "thickest": float(max(thick)),
        "thick_p50": float(np.median(thick)),
        "worst": float(np.argmax(thick)),
        "flip": float(np.mean([flip_map(a.color, b.color).mean() for a, b in zip(truths, shown, strict=True)])),
    }


def unseen(holes: NDArray[np.bool_], truth: DrawnPicture, eye: View, pictures: list[Picture]) -> int:
    """How many of the holes are of surfaces that no picture has."""
    assert truth.depth is not None and truth.object_ids is not None
    rows, columns = np.nonzero(holes)
    left, top, _, _ = eye.window
    depths = truth.depth[rows, columns].astype(np.float64)
    points = eye.unproject(columns + left + np.float64(0.5), rows + top + np.float64(0.5), depths)
    ids, seen = truth.object_ids[rows, columns], np.zeros(len(rows), bool)
    for picture in pictures:
        u, v, depth = np.moveaxis(picture.view.project(points), -1, 0)
        left, top, width, height = picture.view.window
        row, column = np.floor(v - top).astype(int), np.floor(u - left).astype(int)
        for down, right in np.ndindex(3, 3):
            y, x = row + down - 1, column + right - 1
            inside = (depth > 0.0) & (y >= 0) & (x >= 0) & (y < height) & (x < width)
            y, x = np.where(inside, y, 0), np.where(inside, x, 0)
            seen |= inside & (picture.ids[y, x] == ids) & (abs(picture.depth[y, x] - depth) < 0.02 * depth)
    return int((~seen).sum())


def before_grey(color: NDArray[np.uint8], ids: NDArray[np.int32] | None) -> DrawnPicture:
    """A picture without what is behind it, so that only objects count."""
    assert ids is not None
    shown = np.where((ids >= 0)[..., None], color, np.uint8(128))
    return DrawnPicture(shown, ids, None, None, 0.0, None, 0, 0)


def measured(
    scene: WalkScene, subset: Subset, radius: float, options: argparse.Namespace, name: str
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """A row for each number of pictures, and one for each warp."""
    rng, rows, both = np.random.default_rng(options.seed), [], list[dict[str, Any]]()
    with Renderer(scene.mesh, scene.ground, size=(CAMERA.width, CAMERA.height), measured=True) as renderer:
        camera = Camcorder(renderer, subset)
        eyes = eyes_of(subset, radius, options.eyes, rng)
        raw = [camera.drawn(eye) for eye in eyes]
        truths = [before_grey(drawn.color, drawn.object_ids) for drawn in raw]
        for count, arrangement in WAYS:
            views = construction_views(
                subset.view, subset.nearest, radius, count, subset.corners, arrangement=arrangement
            )
            pictures = [camera.picture(view) for view in views]
            image = merged(pictures, radius=radius)
            data = encoded(image)
            kept = decoded(data, name)
            found = [warped(kept, eye) for eye in eyes]
            shown = [before_grey(one.color, one.ids) for one in found]
            errors = errors_of(truths, shown)
            gone = [
                unseen(wrong_regions(truth, picture).holes, drawn, eye, pictures)
                for truth, picture, drawn, eye in zip(truths, shown, raw, eyes, strict=True)
            ]
            worst = int(errors["worst"])
            pair = np.concatenate([truths[worst].color, shown[worst].color], axis=1)
            options.out.mkdir(parents=True, exist_ok=True)
            Image.fromarray(pair).save(options.out / f"{name}-{count}-{arrangement.replace(' ', '')}.png")
            one, two = (seconds(partial(warp_all, kept, eyes, threads)) / len(eyes) for threads in (1, 2))
            rows.append(
                {
                    "place": name,
                    "pictures": f"{count} {arrangement}",
                    "samples": len(image.depths),
                    "layers": len(image.depths) / max(int((image.counts > 0).sum()), 1),
                    "bytes": len(data),
                    **errors,
                    "disoccluded": float(np.mean(gone)) / (CAMERA.width * CAMERA.height),
                    "warps": 1.0 / two,
                    "threads": one / two,
                    "merging": seconds(partial(merged, pictures, radius=radius), 1),
                    "decoding": seconds(partial(decoded, data, name)),
                }
            )
            print_row(rows[-1], rows[0])
        if options.warps:
            both = side_by_side(renderer, kept, eyes, truths, name)
    return rows, both


def print_row(row: dict[str, Any], first: dict[str, Any]) -> None:
    """One line of the table."""
    ratio, gone = (row[name] / first[name] if first[name] else math.nan for name in ("holes", "disoccluded"))
    print(
        f"| {row['place']} | {row['pictures']} | {row['samples']:,.0f} | {row['layers']:.2f} | {1e-6 * row['bytes']:.3f} | "
        f"{row['holes']:.2%} | {ratio:.2f} | {row['disoccluded']:.3%} | {gone:.2f} | {row['wrong']:.2%} | "
        f"{row['beyond']:.2%} | {row['thickest']:.0f} | {row['thick_p50']:.0f} | {row['flip']:.3f} | {row['warps']:.0f} | "
        f"{row['threads']:.2f} | {row['merging']:.2f} | {1e3 * row['decoding']:.0f} |",
        flush=True,
    )


def together(rows: list[dict[str, Any]], name: str) -> list[dict[str, Any]]:
    """A row for each number of pictures: means over all places, of the thickest region the largest, of medians the median."""
    found = []
    for pictures in dict.fromkeys(row["pictures"] for row in rows):
        some = [row for row in rows if row["pictures"] == pictures]
        means = {key: float(np.mean([row[key] for row in some])) for key in some[0] if key not in ("place", "pictures")}
        means["thickest"] = max(row["thickest"] for row in some)
        means["thick_p50"] = float(np.median([row["thick_p50"] for row in some]))
        found.append({"place": f"{name}, {len(some)} places", "pictures": pictures} | means)
    return found


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", nargs="+", help="files of cities or models, or presets of citygen")
    parser.add_argument("-o", "--out", type=Path, default=Path("out/warping"))
    parser.add_argument("--places", type=int, default=3)
    parser.add_argument("--eyes", type=int, default=12)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--warps", action=argparse.BooleanOptionalAction, default=True, help="the second table")
    options = parser.parse_args()
    rows, both = list[dict[str, Any]](), list[dict[str, Any]]()
    print(
        "| place | pictures | samples | a pixel | MB | holes | to one | disoccluded | to one | wrong | beyond | thickest px | "
        "p50 | FLIP | warps/s | to one thread | merging s | decoding ms |"
    )
    print("|" + "---|" * 18)
    for model in options.models:
        city = generate(model) if model in PRESETS else read_city(Path(model))[0]
        scene, name, before = (
            scene_of_city(city, name="model", camera=CAMERA),
            Path(model).name.split(".")[0],
            len(rows),
        )
        low, high = np.nanmin(scene.boxes[:, 0], axis=0), np.nanmax(scene.boxes[:, 1], axis=0)
        radius, rng, found = 0.125 * float((high - low).max()), np.random.default_rng(options.seed), 0
        for _ in range(100 * options.places):
            if found == options.places:
                break
            eye, azimuth = rng.uniform(low, high), rng.uniform(0.0, 2.0 * math.pi)
            subset = far_subset(scene, eye, azimuth, radius)
            if len(subset.triangles) >= _LEAST:
                found += 1
                some = measured(scene, subset, radius, options, f"{name}-{found}")
                rows, both = rows + some[0], both + some[1]
        of_all = together(rows[before:], name)
        for row in of_all:
            print_row(row, of_all[0])
        if found < options.places:
            print(f"{model}: {options.places} places with {_LEAST} triangles expected, found {found}", file=sys.stderr)
    print("\n| place | warp | samples | holes | wrong | beyond | thickest px | p50 | FLIP | ms a frame | to software |")
    print("|" + "---|" * 11)
    for row in both:
        print(
            f"| {row['place']} | {row['warp']} | {row['samples']:,} | {row['holes']:.2%} | {row['wrong']:.2%} | "
            f"{row['beyond']:.2%} | {row['thickest']:.0f} | {row['thick_p50']:.0f} | {row['flip']:.3f} | {row['ms']:.1f} | "
            f"{row['ratio']:.1f} |"
        )
    told = json.dumps({"pictures": rows, "warps": both}, indent=1) + "\n"
    (options.out / "warping.json").write_text(told, encoding="utf-8")


if __name__ == "__main__":
    main()
