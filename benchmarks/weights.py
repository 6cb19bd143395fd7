"""How many layers the paper's weights ask for on a real city, and what each stage costs.

    python benchmarks/weights.py ../shared/data/paris_9e ../shared/data/nyc_west_village

A folder holds derived_buildings.geojson (column height_m) and derived_streets.geojson in metres. Streets are cut into
cells of at most --length metres with a half width of 3 m; far objects are those from --near to --reach metres away, all of
them or what the horizon sweep leaves of them. Objects are buildings, or with --blocks touching buildings merged, as in
the paper. Pixels are those of the paper's display (512 pixels, 60 degrees).
"""

from __future__ import annotations

import argparse
import math
import time
from collections import defaultdict
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import networkx as nx
import numpy as np
import pyogrio
import shapely
from numpy.typing import NDArray

from mmi.cells.viewing_cells import ViewingCell
from mmi.city.model import City, CityObject, Prism
from mmi.foundation.camera import Camera
from mmi.parallax.critical_zone import interacting_pairs
from mmi.parallax.paper_weights import pair_weights
from mmi.planning.layering import assign_layers, event_graph, panorama_boxes
from mmi.planning.segmentation import near_by_distance
from mmi.visibility.horizon import horizon_extractor, prepare_horizon
from mmi.visibility.selection import Selection, everything

STRATEGIES = ("incremental", "largest-first", "smallest-last", "dsatur", "best")
HALF_WIDTH = 3.0


def read_city(folder: Path, blocks: bool) -> City:
    frame = pyogrio.read_dataframe(folder / "derived_buildings.geojson")
    shapes = shapely.force_2d(frame.geometry.to_numpy())
    heights = frame["height_m"].fillna(frame["height_m"].median()).clip(lower=3.0).to_numpy()
    origin = shapely.total_bounds(shapes)[:2]
    shapes = shapely.transform(shapes, lambda xy: xy - origin)
    parts, owner = shapely.get_parts(shapes, return_index=True)
    prisms: dict[int, list[Prism]] = defaultdict(list)
    names = owner
    if blocks:
        merged = shapely.get_parts(shapely.union_all(shapely.buffer(parts, 0.05, join_style="mitre")))
        names = shapely.STRtree(merged).query(shapely.point_on_surface(parts), predicate="within")[1]
    for part, height, name in zip(parts, heights[owner], names, strict=True):
        prisms[int(name)].append(Prism(part, 0.0, float(height)))
    objects = tuple(CityObject(f"object/{name}", tuple(prisms[name])) for name in sorted(prisms))
    return City(objects, nx.MultiGraph(), frame.crs.to_string(), (origin[0], origin[1], 0.0), folder.name)


def read_cells(folder: Path, city: City, length: float) -> list[ViewingCell]:
    lines = pyogrio.read_dataframe(folder / "derived_streets.geojson").geometry.to_numpy()
    lines = shapely.transform(shapely.force_2d(lines), lambda xy: xy - np.array(city.origin[:2]))
    x0, y0, x1, y1 = shapely.total_bounds([one.footprint for one in city.objects])
    cells = []
    for street, line in enumerate(shapely.get_parts(shapely.clip_by_rect(lines, x0, y0, x1, y1))):
        n = max(1, math.ceil(line.length / length))
        ends = [line.interpolate(k / n, normalized=True).coords[0] for k in range(n + 1)]
        for k, (p, q) in enumerate(pairwise(ends)):
            if math.dist(p, q) > 5.0:
                cells.append(ViewingCell(f"{street:04d}-{k:02d}", p, q, HALF_WIDTH, (1.5, 1.9)))
    return cells


def layers_in_views(
    layers: Sequence[NDArray[np.int64]], boxes: NDArray[np.float64], far: NDArray[np.int64]
) -> list[float]:
    """For each of six sectors, how many layers have an object there."""
    counts = np.zeros(6)
    for layer in layers:
        start, end = boxes[np.searchsorted(far, layer), :2].T
        for sector in range(6):
            after = (sector * math.pi / 3.0 - start) % (2.0 * math.pi)
            counts[sector] += bool(((after <= end - start) | (after > 5.0 * math.pi / 3.0)).any())
    return [float(count) for count in counts]


def spread(values: list[float]) -> str:
    return f"{np.median(values):8.5g} {np.percentile(values, 95):8.5g} {max(values):8.5g}"


def measure(city: City, cells: list[ViewingCell], arguments: argparse.Namespace) -> None:
    camera = Camera(512, 512, math.radians(60.0))
    see = horizon_extractor(prepare_horizon(city)) if arguments.visible else None
    near, reach = near_by_distance(arguments.near), near_by_distance(arguments.reach)
    rows: dict[str, list[float]] = defaultdict(list)

    def timed(stage, function, *args, **options):  # noqa: ANN001, ANN002, ANN003, ANN202
        start = time.perf_counter()
        result = function(*args, **options)
        rows[f"ms {stage}"].append(1e3 * (time.perf_counter() - start))
        return result

    for turn, cell in enumerate([cells[0], *cells]):
        if turn == 1:
            rows.clear()  # the first turn compiled
        within = reach(everything(city, cell)).near
        selection = Selection(city, cell, within, np.empty(0, dtype=np.int64))
        selection = near(see(selection) if see else selection)
        objects = [city.objects[i] for i in selection.far]
        footprints = [one.footprint for one in objects]
        rows["far objects"].append(len(objects))
        rows["near objects"].append(len(selection.near))
        pairs = timed("critical zones", interacting_pairs, cell, footprints)
        weights = timed("weights", pair_weights, cell, footprints, pairs)
        rows["pairs"].append(len(pairs))
        if arguments.unsigned:
            unsigned = timed("unsigned weights", pair_weights, cell, footprints, pairs, signed=False)
            rows["unsigned / signed, median"].append(float(np.median(unsigned / weights)) if len(pairs) else 1.0)
        tops = [one.top for one in objects]
        boxes = timed("boxes", panorama_boxes, cell.reference, footprints, [one.base for one in objects], tops)
        rows["median weight, px"].append(camera.pixels_from_angle(float(np.median(weights))) if len(pairs) else 0.0)
        for pixels in arguments.pixels:
            threshold = camera.angle_from_pixels(pixels)
            graph = timed("event graph", event_graph, selection.far, pairs, weights, threshold=threshold)
            rows[f"{pixels:g} px: edges"].append(graph.number_of_edges())
            for strategy in STRATEGIES:
                layers = timed(strategy, assign_layers, graph, boxes, strategy=strategy)
                rows[f"{pixels:g} px: layers, {strategy}"].append(len(layers))
            rows[f"{pixels:g} px: layers in a 60 degree view"] += layers_in_views(layers, boxes, selection.far)
    kind = "blocks" if arguments.blocks else "buildings"
    print(
        f"\n{city.source}: {len(city.objects)} {kind}, {len(cells)} cells, {'visible' if see else 'all'} objects from ",
        end="",
    )
    print(f"{arguments.near:g} to {arguments.reach:g} m")
    print(f"{'':36}  median      p95      max")
    for name in sorted(rows, key=lambda name: name.startswith("ms ")):
        print(f"{name:34}{spread(rows[name])}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--near", type=float, default=40.0)
    parser.add_argument("--reach", type=float, default=300.0)
    parser.add_argument("--length", type=float, default=40.0, help="metres of street per cell")
    parser.add_argument("--pixels", type=float, nargs="+", default=[5.0, 10.0])
    parser.add_argument("--cells", type=int, default=60, help="at most so many, spread over the city")
    parser.add_argument("--visible", action="store_true", help="only what the horizon sweep leaves")
    parser.add_argument("--blocks", action="store_true", help="merge touching buildings")
    parser.add_argument("--unsigned", action="store_true", help="the unsigned weights as well")
    arguments = parser.parse_args()
    for folder in arguments.folders:
        city = read_city(folder, arguments.blocks)
        cells = read_cells(folder, city, arguments.length)
        measure(city, cells[:: max(1, math.ceil(len(cells) / arguments.cells))], arguments)


if __name__ == "__main__":
    main()
