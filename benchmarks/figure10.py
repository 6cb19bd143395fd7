"""The paper's figure 10 (section 6.2): what updates mend, in crops of views. Stored | updated | geometry.

    python benchmarks/figure10.py -o figure10.png
    python benchmarks/figure10.py -o figure10.png --work out/figure10 --views 200       # keeps the datasets for another run

First row: silhouettes, in a dataset as it is built by default. Second row: the meshes of objects seen from all over an
excessively large viewing cell; a cell of 300 m whose near objects are told by their distance alone, so that nothing bounds the
error of the others. Third row: textures of insufficient resolution, captured for a display of a quarter of the pixels a side.

Datasets of a few cells near the church of a generated city are built for it. Of random views from the cells, each row shows the
crop in which the stored pictures are most wrong in its own way: most pixels of outlines against the sky that are wrong, the
farthest displaced surfaces, the largest difference of colours where the same object is shown. Updated is what
multi-mesh-dynamic draws after that view was held. Below each picture: how far its colours are from the geometry's.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from scipy.ndimage import uniform_filter

from citygen.generate import generate
from mmi.building.cell_choice import choose_cells
from mmi.building.dataset import build_dataset
from mmi.city.model import City
from mmi.dataset.reading import open_dataset
from mmi.foundation.camera import Camera, View
from mmi.planning.parameters import BuildParameters
from viewer.cells.scene_cache import cell_cache
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.drawing.renderer import Renderer
from viewer.measuring.view_errors import psnr, wrong_regions
from viewer.plan import Budget
from viewer.scene.scene import open_scene
from viewer.techniques.catalogue import MAIN, make_technique
from viewer.walks.random_views import random_views

_SHOWN = Camera(512, 512, math.radians(60.0))
"""What all views are drawn for."""
_CROP = (112, 84)
"""Pixels of a crop: width and height."""
_ZOOM = 3
_HELD = 24
"""Frames that a view is held at most before it is shown as updated."""
_GAP, _TEXT = 6, 15
"""Pixels between pictures, and of captions."""
_INK = (34, 34, 34)

_Map = Callable[[DrawnPicture, DrawnPicture], NDArray[np.float64]]


def outlines(truth: DrawnPicture, shown: DrawnPicture) -> NDArray[np.float64]:
    """(h, w) 1 where one of the two pictures shows the sky and the other an object."""
    assert truth.depth is not None and shown.depth is not None
    wrong = wrong_regions(truth, shown).wrong
    return (wrong & (np.isinf(truth.depth) != np.isinf(shown.depth))).astype(np.float64)


def displaced(_: DrawnPicture, shown: DrawnPicture) -> NDArray[np.float64]:
    """(h, w) pixels by which surfaces are off, at most as many as a crop is high."""
    assert shown.displacement is not None
    angles = np.where(np.isfinite(shown.displacement), shown.displacement, 0.0).astype(np.float64)
    return np.minimum(_SHOWN.focal * np.tan(np.minimum(angles, 1.5)), float(_CROP[1]))


def blurred(truth: DrawnPicture, shown: DrawnPicture) -> NDArray[np.float64]:
    """(h, w) squared difference of colours where both show the same object."""
    assert truth.object_ids is not None
    same = (truth.object_ids == shown.object_ids) & (truth.object_ids >= 0)
    return same * np.mean((truth.color.astype(np.float64) - shown.color) ** 2, axis=2)


@dataclass(frozen=True, slots=True)
class Row:
    """A row of the figure: the dataset that it is about, how far from the church its cells are, and what to look for."""

    name: str
    title: str
    parameters: BuildParameters
    metres: tuple[float, float]
    found: _Map


_ROWS = (
    Row("silhouettes", "Silhouettes", BuildParameters(camera=_SHOWN), (60.0, 200.0), outlines),
    Row(
        "distortion",
        "Meshes seen from all over a cell that is far too large",
        BuildParameters(
            camera=_SHOWN,
            cell_length=300.0,
            near_stage="distance",
            near_distance=25.0,
            longest_object=None,
            max_error_px=60.0,
        ),
        (25.0, 120.0),
        displaced,
    ),
    Row(
        "texture",
        "Textures of a quarter of the resolution",
        BuildParameters(camera=replace(_SHOWN, width=_SHOWN.width // 4, height=_SHOWN.height // 4), max_error_px=2.5),
        (40.0, 200.0),
        blurred,
    ),
)


def built(city: City, row: Row, folder: Path, cells: int, workers: int) -> None:
    """Build some cells of a row's dataset that are nearest to the middle of its distances from the church."""
    graph = choose_cells(city, row.parameters).graph
    church = next(one for one in city.objects if one.id == "church")
    middle = np.mean([church.footprint.centroid.x]), np.mean([church.footprint.centroid.y])

    def away(name: str) -> float:
        cell = graph.nodes[name]["cell"]
        return min(math.dist(middle, end[:2]) for end in (cell.p, cell.q))

    within = [name for name in graph if row.metres[0] <= away(name) <= row.metres[1]]
    longest = sorted(within, key=lambda name: -graph.nodes[name]["cell"].length)
    print(f"{row.name}: {min(cells, len(longest))} cells of {len(within)}", file=sys.stderr, flush=True)
    build_dataset(city, folder, row.parameters, cells=longest[:cells], workers=workers)


def crops(folder: Path, row: Row, views: int, seed: int) -> tuple[list[NDArray[np.uint8]], str]:
    """Stored, updated and geometry of the crop that shows most of what a row is about, and a word on it."""
    scene = open_scene(open_dataset(folder), name=MAIN)
    scenes = {MAIN: scene}
    width, height = _CROP
    with ExitStack() as stack:
        renderer = stack.enter_context(
            Renderer(scene.mesh, scene.ground, size=(_SHOWN.width, _SHOWN.height), measured=True)
        )
        cache = stack.enter_context(cell_cache(scenes, renderer, measured=True))

        def draw(name: str, view: View, frames: int = 1) -> DrawnPicture:
            technique = make_technique(name, scenes)
            for i in range(frames):
                plan = technique.plan(view, now=i / 30.0, budget=Budget(math.inf))
                cache.want(plan.cells)
                cache.require(plan.cells)
                if i + 1 == frames or (i and not plan.requests):
                    break
                renderer.execute(plan)
            return renderer.draw(plan, view, measured=True)

        best, chosen = -1.0, None
        for number, (_, pose) in enumerate(
            random_views(scene.whereabouts.cells, views, seed=seed, terrain=scene.terrain)
        ):
            view = pose.view(_SHOWN)
            truth, shown = draw("full", view), draw("multi-mesh", view)
            score = uniform_filter(row.found(truth, shown), (height, width), mode="constant")
            inside = score[height // 2 : -(height // 2), width // 2 : -(width // 2)]
            y, x = np.unravel_index(int(np.argmax(inside)), inside.shape)
            if inside[y, x] > best:
                best, chosen = float(inside[y, x]), (view, int(x), int(y))
            print(f"\r{row.name}: {number + 1} of {views} views", end="", file=sys.stderr, flush=True)
        print(file=sys.stderr)
        assert chosen is not None
        view, x, y = chosen
        pictures = [draw("multi-mesh", view), draw("multi-mesh-dynamic", view, _HELD), draw("full", view)]
    return [one.color[y : y + height, x : x + width] for one in pictures], f"{best:.3g}"


def figure(rows: list[tuple[str, list[NDArray[np.uint8]]]]) -> Image.Image:
    """The rows under each other, each under its title, with columns named above."""
    width, height = (_ZOOM * one for one in _CROP)
    font = ImageFont.load_default(_TEXT)
    line = _TEXT + 9
    whole = (3 * width + 2 * _GAP, len(rows) * (height + 2 * line))
    image = Image.new("RGB", whole, (255, 255, 255))
    pen = ImageDraw.Draw(image)
    for number, (title, pictures) in enumerate(rows):
        top = number * (height + 2 * line)
        pen.text((0, top + line // 2), title, fill=_INK, font=font, anchor="lm")
        for column, (name, picture) in enumerate(zip(("stored", "updated", "geometry"), pictures, strict=True)):
            left = column * (width + _GAP)
            image.paste(Image.fromarray(picture).resize((width, height), Image.Resampling.NEAREST), (left, top + line))
            off = psnr(pictures[-1], picture)
            told = name if column == 2 else f"{name}: {'the same' if math.isinf(off) else f'PSNR {off:.0f} dB'}"
            pen.text((left, top + line + height + line // 2), told, fill=_INK, font=font, anchor="lm")
    return image


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="FILE", help="PNG, or WebP without losses")
    parser.add_argument("--work", type=Path, metavar="DIR", help="where datasets are built and kept (default: nowhere)")
    parser.add_argument("--preset", default="montmartre", help="of citygen, one with a church (default: %(default)s)")
    parser.add_argument("--rows", default=",".join(row.name for row in _ROWS), help="(default: %(default)s)")
    parser.add_argument("--cells", type=int, default=2, help="of each dataset (default: %(default)s)")
    parser.add_argument("--views", type=int, default=30, help="that are looked at (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    wanted = options.rows.split(",")
    found = []
    with ExitStack() as stack:
        work = options.work or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        city = generate(options.preset)
        for row in (row for row in _ROWS if row.name in wanted):
            built(city, row, work / row.name, options.cells, options.workers)
            pictures, most = crops(work / row.name, row, options.views, options.seed)
            print(f"{row.name}: {most} at most", flush=True)
            found.append((row.title, pictures))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    image = figure(found)
    if options.out.suffix == ".webp":
        image.save(options.out, lossless=True, method=6)
    else:
        image.quantize(256, dither=Image.Dither.NONE).save(options.out, optimize=True)
    print(f"{options.out}: {options.out.stat().st_size} bytes")


if __name__ == "__main__":
    main()
