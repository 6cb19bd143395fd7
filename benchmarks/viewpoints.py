"""Where should layers be captured from, and would two captures do better? Near geometry and layers for the same bound.

    python benchmarks/viewpoints.py examples/helsinki/helsinki.osm.pbf --cells 24 --max-error 5

*Middle*, *quarter* and *end* plan each cell with its reference viewpoint there, on the axis. *Two captures* keeps as geometry
only what both quarters' captures miss too much of: no fewer objects could do if each texel came from whichever shows it, and
layers and texels are those of both. *Halves* is what a budget does (:mod:`mmi.building.halving`): two cells, each captured
from its own middle, numbers of triangles and layers their means, of texels their sum. *Texels* is what layers cover in
panoramas of the display's resolution (:func:`mmi.planning.layering.layer_area`), relative to *middle*.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mmi.building.halving import halves
from mmi.cells.choice import spread
from mmi.cells.viewing_cells import ViewingCell, viewing_cells
from mmi.city.long_objects import cut_objects
from mmi.city.model import City
from mmi.planning.layering import boxes_of, layer_area
from mmi.planning.parameters import BuildParameters
from mmi.planning.plan import CellPlan, PreparedCity, plan_cell, prepare_city
from mmi.reading.read_city import read_city


def moved(cell: ViewingCell, share: float) -> ViewingCell:
    """The cell with its reference viewpoint at ``share`` of the way from p to q."""

    class Moved(ViewingCell):
        @property
        def reference(self) -> NDArray[np.float64]:
            x, y = np.array(self.p) + share * np.subtract(self.q, self.p)
            return np.array([x, y, cell.reference[2]])

    return Moved(cell.id, cell.p, cell.q, cell.half_width, cell.eye, cell.street, cell.rise)


def costs(scene: PreparedCity, city: City, plan: CellPlan) -> tuple[float, float, float, float]:
    """Near objects and triangles, layers, and what these cover of a panorama."""
    reference = plan.selection.cell.reference
    area = sum(layer_area(boxes_of(reference, [city.objects[i] for i in layer])) for layer in plan.layers)
    near = plan.selection.near
    return len(near), float(scene.mesh.triangle_counts[near].sum()), len(plan.layers), area


def both(scene: PreparedCity, cell: ViewingCell) -> tuple[CellPlan, CellPlan]:
    """Plans from the two quarters, with only what both keep as geometry."""
    one, other = (plan_cell(scene, moved(cell, share)) for share in (0.25, 0.75))
    near = np.intersect1d(one.selection.near, other.selection.near)
    return tuple(replace(plan, selection=replace(plan.selection, near=near)) for plan in (one, other))  # type: ignore[return-value]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cities", type=Path, nargs="+", metavar="CITY")
    parser.add_argument("--cells", type=int, default=24)
    parser.add_argument("--max-error", type=float, default=5.0)
    options = parser.parse_args()
    for path in options.cities:
        parameters = BuildParameters(max_error_px=options.max_error)
        city = cut_objects(read_city(path)[0], parameters.longest_object)
        scene, graph = prepare_city(city, parameters), viewing_cells(city)
        rows: dict[str, list[tuple[float, float, float, float]]] = {}
        for name in spread(graph, options.cells):
            cell = graph.nodes[name]["cell"]
            for what, share in (("middle", 0.5), ("quarter", 0.25), ("end", 0.0)):
                rows.setdefault(what, []).append(costs(scene, city, plan_cell(scene, moved(cell, share))))
            first, second = (costs(scene, city, plan) for plan in both(scene, cell))
            rows.setdefault("two captures", []).append((*first[:2], first[2] + second[2], first[3] + second[3]))
            parts = halves(cell)
            if parts is not None:
                found = np.array([costs(scene, city, plan_cell(scene, part)) for part in parts])
                rows.setdefault("halves", []).append((*found[:, :3].mean(axis=0).tolist(), float(found[:, 3].sum())))
        print(f"{path.name}, {options.max_error:g} px, {options.cells} cells")
        print("| captured from | near objects | near triangles | layers | texels |")
        print("|---|---|---|---|---|")
        whole = np.mean(rows["middle"], axis=0)
        for what, values in rows.items():
            near, triangles, layers, area = np.mean(values, axis=0)
            print(f"| {what} | {near:.1f} | {triangles:.0f} | {layers:.1f} | {area / whole[3]:.2f} |", flush=True)


if __name__ == "__main__":
    main()
