"""What entering a cell takes with stored pictures, and with pictures that are captured then; and how many bytes a cell has.

    build-impostors examples/helsinki/helsinki.osm.pbf -o out/all --max-cells 24
    build-impostors examples/helsinki/helsinki.osm.pbf -o out/none --max-cells 24 --pictures none
    python benchmarks/entering.py out/all out/none

Reading happens in a thread beside the frames; bringing to the GPU, which is where pictures are captured, happens between them,
a picture at a time. Each cell is entered three times and the fastest counts, since the first time of all compiles shaders.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from mmi.dataset.reading import open_dataset
from viewer.cells.loaded_cell import load_cell
from viewer.drawing.renderer import Renderer
from viewer.scene.scene import WalkScene, open_scene


def entered(scene: WalkScene, renderer: Renderer, cell: str) -> tuple[float, float, float]:
    """Milliseconds: reading a cell's files, bringing it to the GPU, and the longest piece of the latter."""
    start = time.perf_counter()
    loaded = load_cell(scene, cell)
    read = time.perf_counter()
    longest = 0.0
    for layer in loaded.layers:
        there = False
        while not there:
            before = time.perf_counter()
            there = renderer.upload_layer(loaded, layer)
            longest = max(longest, time.perf_counter() - before)
    done = time.perf_counter()
    renderer.evict(loaded.key)
    return 1e3 * (read - start), 1e3 * (done - read), 1e3 * longest


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("datasets", nargs="+", type=Path)
    parser.add_argument("--rounds", type=int, default=3, help="how often each cell is entered (default: %(default)s)")
    options = parser.parse_args()
    print("median / largest; dataset, pictures a cell, kB a cell, ms to read, ms to the GPU, of that the longest piece")
    for folder in options.datasets:
        scene = open_scene(open_dataset(folder), name="multi-mesh")
        cells = scene.dataset.manifest.cells
        with Renderer(scene.mesh, scene.ground, size=(scene.camera.width, scene.camera.height)) as renderer:
            taken = [np.min([entered(scene, renderer, one.id) for _ in range(options.rounds)], axis=0) for one in cells]
        figures = np.column_stack([[len(one.pictures) for one in cells], [one.bytes / 1e3 for one in cells], taken])
        middle, most = np.median(figures, axis=0), figures.max(axis=0)
        print(folder, *(f"{m:.1f} / {x:.1f}" for m, x in zip(middle, most, strict=True)), sep="  ")


if __name__ == "__main__":
    main()
