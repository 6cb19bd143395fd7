"""What the bound costs: tight weights, near and far by distance, and the paper's weights, in objects, triangles and layers.

    python benchmarks/near_far.py examples/helsinki/helsinki.osm.pbf --cells 40 --max-error 5

At the same bound on what a picture may miss of its own objects: *tight* keeps as geometry the objects that miss more (and
what is near or steep anyhow), with long objects cut into parts as a build does it; *whole* is the same without cuts. *Distance*
keeps all that is no farther than the farthest of these: in the same cell, so that each cell has a distance of its own (which
takes what tight needs to find it), or in any of the cells, so that one distance serves all. *Paper* has the paper's weights of
pairs on top of a distance a cell. The last row is the paper's weights with everything nearer than 60 m as geometry, which keeps
no such bound: its column says what its objects miss of themselves at most.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray

from mmi.cells.choice import spread
from mmi.cells.viewing_cells import ViewingCell, viewing_cells
from mmi.city.long_objects import cut_objects
from mmi.city.model import City
from mmi.parallax.critical_zone import cell_region
from mmi.parallax.paper_weights import critical_zone_weights
from mmi.parallax.ray_weights import same_ray_weights
from mmi.parallax.self_parallax import self_parallax
from mmi.planning.layering import assign_layers, boxes_of, event_graph
from mmi.planning.parameters import BuildParameters
from mmi.planning.plan import PreparedCity, prepare_city
from mmi.reading.read_city import read_city
from mmi.visibility.selection import Selection, everything


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What a cell may see: how much each object misses of itself (radians), how far away it is (metres), what is near."""

    selection: Selection
    missed: NDArray[np.float64]
    away: NDArray[np.float64]
    near: NDArray[np.bool_]

    def reach(self, parameters: BuildParameters) -> float:
        """Metres: the near distance that keeps the bound in this cell."""
        return max(parameters.near_distance, float(self.away[self.missed > parameters.max_angle].max(initial=0.0)))


def look(scene: PreparedCity, cell: ViewingCell) -> Seen:
    """Everything about a cell that does not depend on how near and far are told apart."""
    assert scene.visible is not None
    seen = scene.visible(everything(scene.city, cell))
    texel = 1.0 / scene.parameters.camera.focal
    missed = self_parallax(scene.city, cell, scene.walls, seen.objects, seen.wall_visibility, texel=texel)
    footprints = [scene.city.objects[i].footprint for i in seen.objects]
    away = np.asarray(shapely.distance(footprints, cell_region(cell)))
    return Seen(seen, missed, away, np.isin(seen.objects, scene.near(seen).near))


def costs(scene: PreparedCity, seen: Seen, near: NDArray[np.bool_], *, paper: bool) -> tuple[float, ...]:
    """Near objects and triangles, layers, and pixels that far objects miss of themselves at most."""
    parameters, selection = scene.parameters, seen.selection
    far = selection.objects[~near]
    objects = [scene.city.objects[i] for i in far]
    if paper:
        pairs, weights = critical_zone_weights(selection.cell, objects)
    else:
        quad = 8.0 / parameters.camera.focal
        pairs, weights = same_ray_weights(selection.cell, scene.walls, far, selection.wall_visibility, quad=quad)
    boxes = boxes_of(selection.cell.reference, objects)
    graph = event_graph(far, pairs, weights, threshold=parameters.max_angle)
    layers = assign_layers(graph, boxes, strategy="smallest-last")
    triangles = scene.mesh.triangle_counts[selection.objects[near]].sum()
    worst = parameters.camera.pixels_from_angle(float(seen.missed[~near].max(initial=0.0)))
    return near.sum(), triangles, len(layers), worst


def table(city: City, cells: list[ViewingCell], parameters: BuildParameters) -> dict[str, NDArray[np.float64]]:
    """Row by row the costs of each cell, (cells, 4)."""
    whole, parts = (prepare_city(one, parameters) for one in (city, cut_objects(city, parameters.longest_object)))
    wholes, cut = ([look(scene, cell) for cell in cells] for scene in (whole, parts))
    farthest = max(seen.reach(parameters) for seen in wholes)
    ways: dict[str, tuple[PreparedCity, list[Seen], bool, Callable[[Seen], NDArray[np.bool_]]]] = {
        "tight": (parts, cut, False, lambda seen: seen.near),
        "whole": (whole, wholes, False, lambda seen: seen.near),
        "distance, a cell's own": (
            whole,
            wholes,
            False,
            lambda seen: seen.near | (seen.away <= seen.reach(parameters)),
        ),
        f"distance, {farthest:.0f} m": (whole, wholes, False, lambda seen: seen.near | (seen.away <= farthest)),
        "paper, a cell's own": (whole, wholes, True, lambda seen: seen.near | (seen.away <= seen.reach(parameters))),
        "paper, 60 m": (whole, wholes, True, lambda seen: seen.away <= 60.0),
    }
    return {
        name: np.array([costs(scene, seen, choose(seen), paper=paper) for seen in found])
        for name, (scene, found, paper, choose) in ways.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cities", type=Path, nargs="+", metavar="CITY")
    parser.add_argument("--cells", type=int, default=40)
    parser.add_argument("--max-error", type=float, default=5.0)
    options = parser.parse_args()
    for path in options.cities:
        city, _ = read_city(path)
        graph = viewing_cells(city)
        cells = [graph.nodes[name]["cell"] for name in spread(graph, options.cells)]
        rows = table(city, cells, BuildParameters(max_error_px=options.max_error))
        print(f"{path.name}, {options.max_error:g} px, {len(cells)} cells")
        print("| near and far, weights | near objects | near triangles | to tight | layers | misses at most, px |")
        print("|---|---|---|---|---|---|")
        tight = rows["tight"][:, 1].mean()
        for name, values in rows.items():
            near, triangles, layers, _ = values.mean(axis=0)
            worst = values[:, 3].max()
            print(f"| {name} | {near:.1f} | {triangles:.0f} | {triangles / tight:.2f} | {layers:.1f} | {worst:.1f} |")


if __name__ == "__main__":
    main()
