"""What a viewer sees of a dataset next to the geometry that it replaces: geometry | impostors | what is wrong.

    python examples/compare_with_geometry.py out/helsinki out/comparison [CELL]

For CELL, or the one with the most pictures of layers: from its reference viewpoint and from both ends, along the street and
across. White is an impostor where the geometry shows something else, magenta the geometry where the impostors show ground or
sky.
"""

import math
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from mmi.camera import level_view
from mmi.cellfiles import read_city_mesh, read_impostor
from mmi.dataset import open_dataset
from viewer.gl import Renderer
from viewer.technique import CellLayers, Ground, Objects, Plan, Sky


def main(folder: Path, out: Path, chosen: str | None = None, *, size: tuple[int, int] = (640, 400)) -> float:
    dataset = open_dataset(folder)
    city, (mesh, ground) = dataset.city(), read_city_mesh(dataset)
    most = max(dataset.manifest["cells"], key=lambda entry: sum(map(len, entry["layers"])))
    most = most if chosen is None else dataset.cell(chosen)
    impostor = read_impostor(dataset, most["id"], city)
    cell, names = impostor.cell, tuple(layer["name"] for sector in most["layers"] for layer in sector)
    full = Plan((Sky(), Ground(), Objects("all", np.arange(len(city.objects)))))
    layered = Plan((Sky(), Ground(), Objects("near", impostor.near), CellLayers("demo", cell.id, names)))
    along = math.atan2(cell.q[1] - cell.p[1], cell.q[0] - cell.p[0])
    window = (-size[0] // 2, -int(0.6 * size[1]), *size)
    out.mkdir(parents=True, exist_ok=True)
    shares = []
    with Renderer(mesh, ground, size=size, measured=True) as renderer:
        renderer.upload("demo", impostor)
        for place, t in (("middle", 0.5), ("start", 0.0), ("end", 1.0)):
            eye = np.append(np.array(cell.p) * (1 - t) + np.array(cell.q) * t, cell.reference[2])
            for way, turn in (("ahead", 0.0), ("back", math.pi), ("across", math.pi / 2)):
                view = level_view(eye, along + turn, focal=0.8 * size[0], window=window)
                truth, shown = (renderer.draw(plan, view, measured=True) for plan in (full, layered))
                wrong = truth.object_ids != shown.object_ids
                missing = wrong & (truth.object_ids >= 0) & (shown.object_ids < 0)
                marks = np.where(wrong[..., None], np.where(missing[..., None], [255, 0, 255], 255), truth.color // 4)
                Image.fromarray(np.hstack([truth.color, shown.color, marks.astype(np.uint8)])).save(
                    out / f"{cell.id}-{place}-{way}.png"
                )
                shares.append(float(wrong.mean()))
    print(
        f"{out}: {len(shares)} views of cell {cell.id}, {len(impostor.near)} objects near, {len(impostor.far)} in layers;"
    )
    print(f"wrong pixels {100 * np.mean(shares):.3f} % on average, {100 * max(shares):.3f} % at worst")
    return max(shares)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), *sys.argv[3:])
