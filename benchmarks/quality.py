"""How wrong a dataset's pictures are: random views inside its cells, impostors against geometry.

    python benchmarks/quality.py out/helsinki --views 200 --seed 1
    python benchmarks/quality.py out/helsinki --views 50 --worst out/worst      # and the worst views as pictures

Viewpoints lie anywhere in a cell's rectangle and eye band, headings are any, the display is the one that the dataset was
built for. No view is the reference viewpoint that layers were captured from.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
from PIL import Image

from mmi.camera import level_view
from mmi.cellfiles import read_city_mesh, read_impostor
from mmi.dataset import open_dataset
from mmi.parameters import BuildParameters
from viewer.gl import Renderer
from viewer.quality import view_errors
from viewer.technique import CellLayers, Ground, Objects, Plan, Sky


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, metavar="OUT")
    parser.add_argument("--views", type=int, default=200, metavar="N")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--worst", type=Path, metavar="DIR", help="write the ten views with the thickest errors here")
    options = parser.parse_args()
    dataset = open_dataset(options.dataset)
    city, (mesh, ground) = dataset.city(), read_city_mesh(dataset)
    camera = BuildParameters.from_dict(dataset.manifest["parameters"]).camera
    size = (camera.width, camera.height)
    window = (-size[0] // 2, -size[1] // 2, *size)
    full = Plan((Sky(), Ground(), Objects("all", np.arange(len(city.objects)))))
    rng = np.random.default_rng(options.seed)
    chosen = rng.integers(0, len(dataset.manifest["cells"]), options.views)
    errors, pictures = [], []
    with Renderer(mesh, ground, size=size, measured=True) as renderer:
        for place in np.sort(chosen):
            entry = dataset.manifest["cells"][place]
            impostor = read_impostor(dataset, entry["id"], city)
            cell = impostor.cell
            renderer.upload("", impostor)
            layers = CellLayers("", cell.id, tuple(one.name for one in impostor.layers))
            layered = Plan((Sky(), Ground(), Objects(f"near {cell.id}", impostor.near), layers))
            along = (np.array(cell.q) - np.array(cell.p)) / cell.length
            s, t = rng.uniform(-0.5, 0.5) * cell.length, rng.uniform(-1.0, 1.0) * cell.half_width
            spot = cell.reference[:2] + s * along + t * np.array([-along[1], along[0]])
            eye = np.array([*spot, rng.uniform(*cell.eye)])
            view = level_view(eye, rng.uniform(0.0, 2.0 * math.pi), focal=camera.focal, window=window)
            truth, shown = (renderer.draw(plan, view, measured=True) for plan in (full, layered))
            errors.append(view_errors(truth, shown, focal=camera.focal))
            wrong = np.repeat((truth.object_ids != shown.object_ids)[..., None] * np.uint8(255), 3, axis=2)
            pictures.append((errors[-1].thickness_px, cell.id, np.hstack([truth.color, shown.color, wrong])))
            pictures = sorted(pictures, key=lambda one: -one[0])[:10]
            renderer.evict("", cell.id)
    table = np.array([[getattr(one, name) for name in one.__slots__] for one in errors])
    name = {column: i for i, column in enumerate(errors[0].__slots__)}

    def spread(column: str) -> str:
        return " / ".join(f"{value:.1f}" for value in np.percentile(table[:, name[column]], [50, 99, 100]))

    finite = table[np.isfinite(table[:, name["psnr_db"]]), name["psnr_db"]]
    print(
        "| dataset | views | holes % | wrong % | thickness px (p50 / p99 / max) | displacement px (p50 / p99 / max) | PSNR dB |"
    )
    print("|---|---|---|---|---|---|---|")
    print(
        f"| {options.dataset.name} | {options.views} | {100 * table[:, name['hole_share']].mean():.3f} "
        f"| {100 * table[:, name['wrong_share']].mean():.3f} | {spread('thickness_px')} | {spread('displacement_px')} "
        f"| {finite.mean():.1f} |"
    )
    if options.worst is not None:
        options.worst.mkdir(parents=True, exist_ok=True)
        for rank, (thick, cell_id, picture) in enumerate(pictures):
            Image.fromarray(picture).save(options.worst / f"{rank}-{cell_id}-{thick:.0f}px.png")


if __name__ == "__main__":
    main()
