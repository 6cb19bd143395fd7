"""Build whole cities and say what it took: the README's table, and where the time goes.

    python benchmarks/build.py examples/helsinki/helsinki.osm.pbf ../shared/data/paris_9e/map.osm -o out/benchmark
    python benchmarks/build.py CITY --display 1920x1080 --max-cells 40 --workers 2

Seconds are those of this machine; compare them within one run only.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

STAGES = (
    "preparation",
    "visibility",
    "segmentation",
    "weights",
    "layering",
    "rehearsal",
    "windows",
    "capture",
    "meshing",
    "encoding",
    "ordering",
    "writing",
)


def build(city: Path, out: Path, options: list[str]) -> tuple[dict, dict]:
    """The manifest and build.json of a build from scratch, as a user would start it."""
    shutil.rmtree(out, ignore_errors=True)
    program = Path(sys.executable).with_name("build-impostors")
    subprocess.run([program, city, "-o", out, "--quiet", *options], check=True)
    return json.loads((out / "manifest.json").read_bytes()), json.loads((out / "build.json").read_bytes())


def row(name: str, manifest: dict, made: dict) -> str:
    """One line of the table; medians over cells, layers over all views that have any."""
    cells = manifest["cells"]
    views = [len({layer["index"] for layer in sector}) for cell in cells for sector in cell["layers"] if sector]
    near, far = [len(cell["near"]) for cell in cells], [len(cell["far"]) for cell in cells]
    totals = made["totals"]
    return (
        f"| {name} | {manifest['city']['objects']} | {len(cells)} | {np.median(np.add(near, far)):.0f} | {np.median(near):.0f} "
        f"| {np.median(far):.0f} | {np.median(views or [0]):.0f} / {max(views, default=0)} "
        f"| {np.mean([cell['bytes'] for cell in cells]) / 1e6:.2f} "
        f"| {totals['seconds'] / totals['built']:.3f} | {totals['built'] / totals['seconds']:.1f} "
        f"| {totals['peak_memory_bytes'] / 1e6:.0f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cities", nargs="+", type=Path, metavar="CITY")
    parser.add_argument("-o", "--output", type=Path, help="keep the datasets here")
    parser.add_argument("--display", default="512x512")
    parser.add_argument("--max-cells", type=int)
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    options = parser.parse_args()
    more = ["--display", options.display, "--workers", str(options.workers)]
    more += ["--max-cells", str(options.max_cells)] if options.max_cells else []
    output = options.output or Path(tempfile.mkdtemp())
    results = []
    for city in options.cities:
        name = f"{city.parent.name}" if city.is_file() else city.name
        results.append((name, *build(city, output / name, more)))

    print(f"\n{options.display}, {options.workers} workers\n")
    print(
        "| city | objects | cells | visible | near | far | layers a view (median, max) | MB a cell | s a cell | cells/s | MB |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for name, manifest, made in results:
        print(row(name, manifest, made))
    print("\nmilliseconds of one worker a cell, by stage\n")
    print(f"| city | {' | '.join(STAGES)} | all |\n|---|{'---|' * (len(STAGES) + 1)}")
    for name, _, made in results:
        spent = [1000.0 * made["stages"].get(stage, 0.0) / made["totals"]["built"] for stage in STAGES]
        print(f"| {name} | {' | '.join(f'{one:.1f}' for one in spent)} | {sum(spent):.0f} |")
    if options.output is None:
        shutil.rmtree(output)


if __name__ == "__main__":
    main()
