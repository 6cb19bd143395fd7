"""How long it takes to read CityJSON: ours from bytes to meshes, against cjio's load and triangulation of the same files.

    python benchmarks/reading.py ../shared/data/denhaag_cityjson/DenHaag_01.json [FILE ...] --best-of 3

Both are run in turn in one process, the best of each counts, in seconds of CPU. cjio triangulates with the
same library (earcut); files that it does not take (old versions, sequences) have no figure. Ours reads pictures too.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import time
from collections.abc import Callable
from pathlib import Path

from cjio import cityjson

from mmi.reading.city_models.cityjson import read_cityjson
from mmi.reading.report import Ledger


def ours(path: Path) -> int:
    """Triangles of the buildings and the ground."""
    layer = read_cityjson(path, Ledger())
    ground = 0 if layer.terrain is None else len(layer.terrain.triangles)
    return sum(len(item.mesh.triangles) for item in layer.items) + ground


def theirs(path: Path) -> int:
    """Triangles of all objects, by cjio; it prints what it does not like."""
    with path.open(encoding="utf-8") as file, contextlib.redirect_stdout(io.StringIO()):
        model = cityjson.reader(file)
        model.triangulate(sloppy=True)
    shells = 0
    for one in model.j["CityObjects"].values():
        for geometry in one.get("geometry", []):
            nested = geometry["boundaries"]
            shells += sum(map(len, nested)) if geometry["type"] == "Solid" else len(nested)
    return shells


def best(read: Callable[[Path], int], path: Path, times: int) -> tuple[float, int]:
    """Seconds of the fastest of some readings, and the triangles."""
    seconds, count = [], 0
    for _ in range(times):
        start = time.process_time()
        count = read(path)
        seconds.append(time.process_time() - start)
    return min(seconds), count


def main() -> None:
    """Print a row for each file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--best-of", type=int, default=3)
    options = parser.parse_args()
    print(f"{'file':32} {'triangles':>10} {'ours, s':>9} {'cjio: triangles':>16} {'s':>8} {'cjio / ours':>12}")
    for path in options.files:
        seconds, count = best(ours, path, options.best_of)
        row = f"{path.name[:32]:32} {count:10,} {seconds:9.3f}"
        try:
            other, other_count = best(theirs, path, options.best_of)
            print(f"{row} {other_count:16,} {other:8.3f} {other / seconds:12.1f}")
        except Exception as error:  # whatever it throws at files that it does not take
            print(f"{row}   cjio: {type(error).__name__} {str(error)[:60]}")


if __name__ == "__main__":
    main()
