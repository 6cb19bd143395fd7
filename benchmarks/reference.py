"""Impostors from where they were captured: that multi-mesh equals full there, up to resampling.

    python benchmarks/reference.py out/bench/nyc --cells 60
    python benchmarks/reference.py out/bench/nyc --cells 60 --worst /tmp/nyc.png

For cells spread over the dataset, and each sector of their panoramas, ``full`` and ``multi-mesh`` are drawn from the cell's
reference viewpoint with the display that the dataset was built for. Nothing is disoccluded from there. What is left is that
texels are no pixels (``viewer.measuring.view_errors.beyond_resampling``), meshes no surfaces, and what goes wrong.
Thickness is that of a view's thickest region of wrong pixels, as it is and beyond one pixel of resampling; percentiles are
over views. Most of what PSNR sees is silhouettes that are a pixel off, so it is also given for pictures of several samples
a pixel, as a viewer would draw them; its means are over the views that differ. ``--worst`` writes the view with the
thickest region beyond resampling, of equals the one of the lowest PSNR, as geometry | multi-mesh | what is wrong beyond
resampling.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from mmi.cells.choice import spread
from mmi.cells.whereabouts import Whereabouts
from mmi.dataset.reading import open_dataset
from mmi.foundation.thickness import thickness
from mmi.walks.walk import Pose
from viewer.cells.scene_cache import cell_cache
from viewer.drawing.renderer import Renderer
from viewer.measuring.view_errors import ViewErrors, WrongRegions, beyond_resampling, psnr, view_errors
from viewer.plan import Budget
from viewer.report.pictures import save_picture, triptych
from viewer.scene.scene import WalkScene, open_scene
from viewer.techniques.catalogue import make_technique

MOST_PX, LEAST_DB = 2.0, 35.0
"""What is promised from a reference viewpoint: thickness beyond resampling, and PSNR."""
_SAMPLES = 4
"""A pixel, in pictures that are smooth."""


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceView:
    """One sector of a cell's panorama: colours (h, w, 3) of ``full`` and ``multi-mesh``, and how they differ.

    ``impostor_share`` of the pixels show a layer. ``errors`` count all wrong pixels, ``beyond`` and ``beyond_px`` (thickness)
    those that resampling does not explain. ``smooth_db`` is the PSNR of the same view with several samples a pixel.
    """

    cell: str
    sector: int
    truth: NDArray[np.uint8]
    shown: NDArray[np.uint8]
    impostor_share: float
    errors: ViewErrors
    beyond: WrongRegions
    beyond_px: float
    smooth_db: float


def spread_cells(scene: WalkScene, n: int) -> list[str]:
    """``n`` of the dataset's cells, spread over the city; all where there are fewer."""
    graph = nx.Graph()
    graph.add_nodes_from((cell.id, {"cell": cell}) for cell in scene.whereabouts.cells)
    return spread(graph, n)


def reference_views(scene: WalkScene, cells: Sequence[str]) -> Iterator[ReferenceView]:
    """``full`` and ``multi-mesh`` from the reference viewpoints of ``cells``, one sector after the other."""
    camera, budget = scene.camera, Budget()
    size = (camera.width, camera.height)
    full = make_technique("full", {"multi-mesh": scene})
    with (
        Renderer(scene.mesh, scene.ground, size=size, measured=True, samples=_SAMPLES) as renderer,
        cell_cache({"multi-mesh": scene}, renderer, measured=True) as cache,
    ):
        for name in cells:
            entry = scene.dataset.cell(name)
            # Where streets cross, a viewer may be in several cells: here it is in this one.
            alone = replace(scene, whereabouts=Whereabouts((scene.cell(name).cell,), {}))
            technique = make_technique("multi-mesh", {"multi-mesh": alone})
            x, y, z = entry.reference
            sectors = len(entry.layers)
            for sector in range(sectors):
                view = Pose((x, y, z), math.tau * sector / sectors, 0.0).view(camera)
                plan = technique.plan(view, now=0.0, budget=budget)
                cache.want(plan.cells)
                cache.require(plan.cells)
                geometry = full.plan(view, now=0.0, budget=budget)
                truth, shown = (renderer.draw(one, view, measured=True) for one in (geometry, plan))
                smooth = [renderer.draw(one, view).color for one in (geometry, plan)]
                errors = view_errors(truth, shown, focal=camera.focal, flip=False)
                beyond = beyond_resampling(truth, shown)
                yield ReferenceView(
                    cell=name,
                    sector=sector,
                    truth=truth.color,
                    shown=shown.color,
                    impostor_share=float(np.isfinite(shown.displacement).mean()),
                    errors=errors,
                    beyond=beyond,
                    beyond_px=thickness(beyond.wrong),
                    smooth_db=psnr(*smooth),
                )


def picture(view: ReferenceView) -> NDArray[np.uint8]:
    titles = ("geometry", f"multi-mesh, {view.cell} s{view.sector}", "wrong beyond resampling")
    return triptych(view.truth, view.shown, view.beyond.wrong, view.beyond.holes, titles=titles)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, metavar="DATASET")
    parser.add_argument("--cells", type=int, default=40)
    parser.add_argument("--worst", type=Path, metavar="PNG")
    options = parser.parse_args()
    scene = open_scene(open_dataset(options.dataset), name="multi-mesh")
    cells = spread_cells(scene, options.cells)
    figures: list[tuple[float, ...]] = []
    shares: list[tuple[float, float]] = []
    over: list[tuple[float, float, float, str, int]] = []
    worst: ReferenceView | None = None
    for view in reference_views(scene, cells):
        figures.append(
            (view.errors.psnr_db, view.smooth_db, view.errors.thickness_px, view.beyond_px, view.impostor_share)
        )
        shares.append((view.errors.wrong_share, float(view.beyond.wrong.mean())))
        if view.beyond_px > MOST_PX or view.errors.psnr_db < LEAST_DB:
            over.append((view.beyond_px, view.errors.psnr_db, view.smooth_db, view.cell, view.sector))
        if worst is None or _badness(view) > _badness(worst):
            worst = view
    assert worst is not None
    decibels, smooth, plain, beyond, impostor = np.array(figures).T
    camera, n = scene.camera, len(figures)
    print(
        f"{options.dataset.resolve().name}: {n} views from {len(cells)} reference viewpoints, {camera.width} x "
        f"{camera.height} pixels, {math.degrees(camera.fov):.0f} degrees; {np.count_nonzero(impostor)} show impostors, on "
        f"{100.0 * impostor[impostor > 0.0].mean() if impostor.any() else 0.0:.1f} % of their pixels"
    )
    for title, values in (("PSNR dB", decibels), (f"with {_SAMPLES} samples", smooth)):
        differ = values[np.isfinite(values)]
        mean = f"mean {differ.mean():.1f}" if differ.size else "all views equal"
        print(f"{title:18} min {values.min():.1f}, {mean}; {_of(values < LEAST_DB)} below {LEAST_DB:g}")
    for title, values, share in zip(
        ("thickness px", "beyond resampling"), (plain, beyond), np.mean(shares, axis=0), strict=True
    ):
        p50, p99, most = np.percentile(values, [50, 99, 100])
        print(
            f"{title:18} p50 {p50:.1f}, p99 {p99:.1f}, max {most:.1f}; {_of(values > MOST_PX)} thicker than {MOST_PX:g} px; "
            f"{100.0 * share:.4f} % of pixels"
        )
    for thick, decibel, smoothed, cell, sector in sorted(over, reverse=True):
        print(f"over: {cell} sector {sector}: {thick:.1f} px, {decibel:.1f} dB, smooth {smoothed:.1f} dB")
    print(f"worst: {worst.cell} sector {worst.sector}: {worst.beyond_px:.1f} px, {worst.errors.psnr_db:.1f} dB")
    if options.worst is not None:
        save_picture(options.worst, picture(worst))


def _of(some: NDArray[np.bool_]) -> str:
    return f"{np.count_nonzero(some)} of {len(some)}"


def _badness(view: ReferenceView) -> tuple[float, float]:
    return view.beyond_px, -view.errors.psnr_db


if __name__ == "__main__":
    main()
