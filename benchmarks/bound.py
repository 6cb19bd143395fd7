"""Does the bound hold? Random views in the cells: how thick wrong regions get, and how far surfaces are off.

    build-impostors CITY -o OUT --max-error 5
    python benchmarks/bound.py OUT [OUT ...] --views 2000

Only what the bound is about is measured (no FLIP, PSNR or SSIM, which take most of the time of compare-impostors): by the
threshold T of each dataset, the views whose thickest wrong region exceeds T + 2 px (two for the rasters of texture and
view), and the largest displacement. With --worst DIR, pictures of the worst views.

*Gaps* are pixels of sky or ground that are wrong and have nothing but objects around them in the geometry: what would show as
lines of sky in facades.

Where rows of houses are a pixel wide each, both rasters may pick another house in every pixel, and the region is as thick as
the row is long. So what exceeds T + 2 px is looked at again, at four times the resolution: a wrong pixel is forgiven where the
geometry then shows within a pixel what the technique has, and the technique what the geometry has. *Beyond a pixel* are the
views that exceed T + 2 px nevertheless.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import binary_erosion

from mmi.dataset.reading import open_dataset
from mmi.foundation.camera import View
from mmi.foundation.thickness import largest_disc, thickness
from viewer.cells.scene_cache import cell_cache
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.drawing.renderer import Renderer
from viewer.measuring.view_errors import wrong_regions
from viewer.plan import Budget
from viewer.report.pictures import triptych
from viewer.scene.scene import open_scene
from viewer.techniques.catalogue import make_technique
from viewer.walks.random_views import random_views

_FINER = 4
"""Times as many pixels a side, where a view is looked at again."""


def measure(folder: Path, views: int, seed: int, worst: Path | None, keep: int) -> str:
    """A row of the table for one dataset."""
    dataset = open_dataset(folder)
    scene = open_scene(dataset, name="multi-mesh")
    camera, scenes = scene.camera, {"multi-mesh": scene}
    limit = scene.parameters.max_error_px + 2.0
    found = []
    with (
        Renderer(scene.mesh, scene.ground, size=(camera.width, camera.height), measured=True, samples=0) as renderer,
        cell_cache(scenes, renderer, measured=True, capacity=256 << 20) as cache,
    ):
        full, multi = make_technique("full", scenes), make_technique("multi-mesh", scenes)

        def draw(view: View) -> tuple[DrawnPicture, DrawnPicture]:
            truth = renderer.draw(full.plan(view, now=0.0, budget=Budget()), view, measured=True)
            plan = multi.plan(view, now=0.0, budget=Budget())
            cache.want(plan.cells)
            cache.require(plan.cells)
            return truth, renderer.draw(plan, view, measured=True)

        for number, (cell, pose) in enumerate(
            random_views(scene.whereabouts.cells, views, seed=seed, terrain=scene.terrain)
        ):
            view = pose.view(camera)
            truth, shown = draw(view)
            regions = wrong_regions(truth, shown)
            angles = shown.displacement[np.isfinite(shown.displacement)].astype(np.float64)
            displaced = camera.focal * math.tan(min(float(angles.max(initial=0.0)), 1.5))
            thick = thickness(regions.wrong)
            beyond = thick if thick <= limit else beyond_a_pixel(draw, view, (truth, shown), limit)
            gaps = regions.holes & binary_erosion(_ids(truth) >= 0, np.ones((3, 3)))
            found.append((thick, beyond, displaced, float(regions.wrong.mean()), float(gaps.sum())))
            if worst is not None and (thick, number) >= sorted([(f[0], i) for i, f in enumerate(found)])[-keep:][0]:
                worst.mkdir(parents=True, exist_ok=True)
                name = worst / f"{folder.name}-{thick:05.1f}-{number}-{cell}.png"
                Image.fromarray(triptych(truth.color, shown.color, regions.wrong, regions.holes)).save(name)
            print(f"\r{folder.name}: {number + 1} of {views}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    if worst is not None:
        for name in sorted(worst.glob(f"{folder.name}-*.png"))[:-keep]:
            name.unlink()
    thick, beyond, displaced, wrong, gaps = np.array(found).T
    cells = [scene.dataset.cell(cell.id) for cell in scene.whereabouts.cells]
    mean = {
        key: np.mean([getattr(entry, key) for entry in cells])
        for key in ("near_triangles", "triangles", "texels", "bytes")
    }
    near = np.mean([len(entry.near) for entry in cells])
    layers = np.mean([entry.layer_count for entry in cells])
    return (
        f"| {folder.name} | {limit - 2.0:g} | {views} | {100.0 * wrong.mean():.3f} | {gaps.mean():.1f} | "
        f"{np.percentile(thick, 50):.0f} / {np.percentile(thick, 99):.0f} / {thick.max():.0f} | "
        f"{np.count_nonzero(thick > limit)} | {np.count_nonzero(beyond > limit)} | "
        f"{np.percentile(displaced, 50):.1f} / {np.percentile(displaced, 99):.1f} / {displaced.max():.1f} | "
        f"{np.count_nonzero(displaced > limit - 2.0)} | "
        f"{near:.1f} | {mean['near_triangles']:.0f} | {layers:.1f} | {mean['triangles']:.0f} | {mean['texels'] / 1e3:.0f}k | "
        f"{mean['bytes'] / 1e3:.0f} kB |"
    )


def beyond_a_pixel(
    draw: Callable[[View], tuple[DrawnPicture, DrawnPicture]],
    view: View,
    frames: tuple[DrawnPicture, DrawnPicture],
    limit: float,
) -> float:
    """Thickness of what is wrong in a view whatever a pixel around shows, or some thickness up to ``limit``."""
    truth, shown = (_ids(frame) for frame in frames)
    wrong = truth != shown
    left, top, width, height = view.window
    wide, high = width // _FINER, height // _FINER
    while True:
        thick, (row, column) = largest_disc(wrong)
        if thick <= limit:
            return thick
        x, y = (min(max(int(at) - n // 2, 0), size - n) for at, n, size in ((column, wide, width), (row, high, height)))
        window = ((left + x) * _FINER, (top + y) * _FINER, width, height)
        part = np.s_[y : y + high, x : x + wide]
        fine = [_ids(frame) for frame in draw(View(view.eye_from_world, _FINER * view.focal, window))]
        forgiven = _occurs(shown[part], fine[0]) & _occurs(truth[part], fine[1])
        wrong[part] &= ~forgiven
        if thickness(wrong[part]) > limit:
            return thickness(wrong)


def _ids(frame: DrawnPicture) -> NDArray[np.int32]:
    assert frame.object_ids is not None  # the renderer measures
    return frame.object_ids


def _occurs(ids: NDArray[np.int32], fine: NDArray[np.int32]) -> NDArray[np.bool_]:
    """(h, w): whether each of ``ids`` is in ``fine``, of _FINER times as many pixels a side, within a pixel of its place."""
    h, w = ids.shape
    around = np.pad(fine, _FINER, constant_values=np.iinfo(np.int32).min)
    found = np.zeros(ids.shape, dtype=bool)
    for j, i in product(range(3 * _FINER), repeat=2):
        found |= around[j : j + h * _FINER : _FINER, i : i + w * _FINER : _FINER] == ids
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", type=Path, nargs="+", metavar="OUT")
    parser.add_argument("--views", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("--worst", type=Path, metavar="DIR")
    parser.add_argument("--keep", type=int, default=6, help="pictures a dataset (default: %(default)s)")
    options = parser.parse_args()
    print(
        "| dataset | T px | views | wrong % | gaps px a view | thickness px p50 / p99 / max | above T + 2 | beyond a pixel | "
        "displacement px p50 / p99 / max | above T | near | near triangles | layers | triangles | texels | bytes a cell |"
    )
    print("|" + "---|" * 16)
    for folder in options.datasets:
        print(measure(folder, options.views, options.seed, options.worst, options.keep), flush=True)


if __name__ == "__main__":
    main()
