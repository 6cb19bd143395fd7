"""A city's file becomes a dataset of multi-mesh impostors: what ``build-impostors`` does, in ten lines.

Run ``python examples/build_from_python.py examples/helsinki/helsinki.osm.pbf out/python``.
"""

import math
import sys
from pathlib import Path

from mmi import BuildParameters, BuildSummary, Camera, build_dataset, read_city


def main(source: Path, out: Path, *, max_cells: int = 8) -> BuildSummary:
    city, report = read_city(source)
    for section, what, count, detail in report.rows():
        print(f"{section:10} {count:>6}  {what}  {detail}")

    display = Camera(1280, 720, math.radians(60.0))  # what an error in pixels refers to
    parameters = BuildParameters(max_error_px=5.0, camera=display, near_distance=40.0)
    summary = build_dataset(city, out, parameters, max_cells=max_cells)

    print(f"{summary.built} cells built and {summary.complete} found complete, {summary.bytes / 1e6:.1f} MB in {out}")
    return summary


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
