"""Time and size of visible sets: the horizon sweep for a range of parameters, and against the item buffer.

    python benchmarks/visibility.py CITY --cells 12
    python benchmarks/visibility.py CITY --cells 4 --item-buffer

CITY is what ``build-impostors`` reads. Times are medians over the cells, of one process; sets are sums over the cells.
``sampled`` counts the objects that random rays from the cell hit: a lower bound of what is visible. With
``--item-buffer`` both get the same viewpoints and the same number of columns around (6 views of columns / 6 pixels).
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from pathlib import Path

import numpy as np

from mmi.cells.choice import spread
from mmi.cells.viewing_cells import ViewingCell, viewing_cells
from mmi.city.model import City
from mmi.reading.read_city import read_city
from mmi.visibility.cell_outline import sample_viewpoints
from mmi.visibility.horizon import horizon_extractor, prepare_horizon
from mmi.visibility.item_buffer import item_buffer_extractor
from mmi.visibility.selection import Extractor, everything

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from oracles import PrismRays, searching_rays

COLUMNS = "{:>7} {:>8} {:>7} {:>11} {:>10} {:>9} {:>9} {:>8}"


def measured(extract: Extractor, city: City, cells: list[ViewingCell]) -> tuple[float, float, list[set[int]]]:
    """Median and largest seconds a cell, and the visible sets; a first run warms up."""
    extract(everything(city, cells[0]))
    seconds, sets = [], []
    for cell in cells:
        start = time.perf_counter()
        selection = extract(everything(city, cell))
        seconds.append(time.perf_counter() - start)
        sets.append(set(selection.objects.tolist()))
    return statistics.median(seconds), max(seconds), sets


def sampled(city: City, cells: list[ViewingCell], rays: int) -> list[set[int]]:
    caster, rng = PrismRays(city), np.random.default_rng(1)
    hits = [np.unique(caster.first_hits(*searching_rays(city, cell, rays, rng))) for cell in cells]
    return [set(some[some >= 0].tolist()) for some in hits]


def sweeps(city: City, cells: list[ViewingCell], rays: int) -> None:
    seen = sampled(city, cells, rays)
    total = sum(map(len, seen))
    print(f"{len(city.objects)} objects, {len(cells)} cells, {total} objects hit by {rays} rays a cell")
    print(COLUMNS.format("shrink", "columns", "levels", "viewpoints", "median ms", "max ms", "objects", "/sampled"))
    base = {"shrink": 1.5, "columns": 2048, "levels": 12}
    variants = [base]
    variants += [{**base, "shrink": shrink} for shrink in (0.5, 1.0, 2.0, 3.0)]
    variants += [{**base, "columns": columns} for columns in (512, 1024, 4096)]
    variants += [{**base, "levels": levels} for levels in (4, 8, 24)]
    for variant in variants:
        scene = prepare_horizon(
            city, shrink=variant["shrink"], columns=int(variant["columns"]), levels=int(variant["levels"])
        )
        median, largest, sets = measured(horizon_extractor(scene), city, cells)
        lost = sum(len(few - many) for few, many in zip(seen, sets, strict=True))
        assert not lost, f"{lost} objects were hit by rays and are not in the sets"
        points = sum(len(sample_viewpoints(cell, reach=scene.shrink)) for cell in cells) / len(cells)
        objects = sum(map(len, sets))
        print(
            COLUMNS.format(
                variant["shrink"],
                variant["columns"],
                variant["levels"],
                f"{points:.1f}",
                f"{median * 1e3:.1f}",
                f"{largest * 1e3:.1f}",
                objects,
                f"{objects / total:.3f}",
            )
        )


def against_item_buffer(city: City, cells: list[ViewingCell], columns: int, shrink: float) -> None:
    from mmi.appearance.city_mesh import build_city_mesh
    from mmi.capture.renderer import Capturer

    scene = prepare_horizon(city, shrink=shrink, columns=columns)
    swept = measured(horizon_extractor(scene), city, cells)
    with Capturer(build_city_mesh(city)) as capturer:
        drawn = measured(
            item_buffer_extractor(capturer.identify, resolution=columns // 6, spacing=2.0 * shrink), city, cells
        )
    outside = sum(len(few - many) for few, many in zip(drawn[2], swept[2], strict=True))
    for name, (median, _, sets) in (("horizon sweep", swept), ("item buffer", drawn)):
        print(f"{name}: median {median * 1e3:.1f} ms a cell, {sum(map(len, sets))} objects")
    print(f"item buffer / horizon sweep: {drawn[0] / swept[0]:.1f} times the time; {outside} objects outside its sets")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("city", type=Path)
    parser.add_argument("--cells", type=int, default=12)
    parser.add_argument("--rays", type=int, default=300_000)
    parser.add_argument("--item-buffer", action="store_true")
    parser.add_argument("--columns", type=int, default=2048)
    parser.add_argument("--shrink", type=float, default=1.5)
    options = parser.parse_args()
    city, _ = read_city(options.city)
    graph = viewing_cells(city)
    cells = [graph.nodes[one]["cell"] for one in spread(graph, options.cells)]
    if options.item_buffer:
        against_item_buffer(city, cells, options.columns, options.shrink)
    else:
        sweeps(city, cells, options.rays)


if __name__ == "__main__":
    main()
