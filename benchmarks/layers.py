"""How far from the fewest layers are the colouring strategies? On the graphs of visibility events of real cells.

    python benchmarks/layers.py examples/helsinki/helsinki.osm.pbf --cells 40 --max-error 5

For each strategy: layers, the area that their boxes take in the panorama (what texels cost), milliseconds, and in how many
cells it needs no more layers than an exact colouring. That one is a branch and bound on the most constrained object
(Brélaz 1979) that starts from the largest clique and the best strategy; where it takes longer than --limit seconds a cell, what
it has found so far counts, and the table says so.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import networkx as nx
import numpy as np

from mmi.cells.choice import spread
from mmi.cells.viewing_cells import viewing_cells
from mmi.city.long_objects import cut_objects
from mmi.planning.layering import assign_layers, boxes_of, layer_area
from mmi.planning.parameters import BuildParameters
from mmi.planning.plan import plan_cell, prepare_city
from mmi.reading.read_city import read_city

STRATEGIES = ("incremental", "largest-first", "smallest-last", "dsatur", "best")


def fewest_colors(graph: nx.Graph, known: int, seconds: float) -> tuple[int, bool]:
    """The chromatic number, given a colouring with ``known`` colours; and whether it was proven in time."""
    clique = max(nx.find_cliques(graph), key=len, default=[])
    if len(clique) == known:
        return known, True
    stop, best = time.perf_counter() + seconds, known
    colors = {node: i for i, node in enumerate(clique)}

    def search(used: int) -> bool:
        """Whether the search under the colours given so far was complete."""
        nonlocal best
        if time.perf_counter() > stop:
            return False
        if used >= best:
            return True
        left = [node for node in graph if node not in colors]
        if not left:
            best = used
            return True
        taken = {node: {colors[other] for other in graph[node] if other in colors} for node in left}
        node = max(left, key=lambda one: (len(taken[one]), graph.degree(one)))
        complete = True
        for color in range(min(used + 1, best - 1)):
            if color not in taken[node]:
                colors[node] = color
                complete &= search(max(used, color + 1))
                del colors[node]
                if best == len(clique):
                    return True
        return complete

    complete = search(len(clique))
    return best, complete


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cities", type=Path, nargs="+", metavar="CITY")
    parser.add_argument("--cells", type=int, default=40)
    parser.add_argument("--max-error", type=float, default=5.0)
    parser.add_argument("--weights", default="same-ray")
    parser.add_argument("--limit", type=float, default=5.0, help="seconds of search for the exact colouring of a cell")
    options = parser.parse_args()
    for path in options.cities:
        city, _ = read_city(path)
        city = cut_objects(city, BuildParameters().longest_object)
        scene = prepare_city(city, BuildParameters(max_error_px=options.max_error, weights=options.weights))
        graph = viewing_cells(city)
        layers: dict[str, list[int]] = {name: [] for name in STRATEGIES}
        areas: dict[str, list[float]] = {name: [] for name in STRATEGIES}
        spent: dict[str, float] = dict.fromkeys(STRATEGIES, 0.0)
        exact, proven, sizes = [], 0, []
        for name in spread(graph, options.cells):
            plan = plan_cell(scene, graph.nodes[name]["cell"])
            events, objects = plan.graph, [city.objects[i] for i in plan.selection.far]
            boxes = boxes_of(plan.selection.cell.reference, objects)
            row = {node: i for i, node in enumerate(events)}
            for strategy in STRATEGIES:
                start = time.perf_counter()
                found = assign_layers(events, boxes, strategy=strategy)
                spent[strategy] += time.perf_counter() - start
                layers[strategy].append(len(found))
                areas[strategy].append(sum(layer_area(boxes[[row[int(i)] for i in layer]]) for layer in found))
            number, complete = fewest_colors(events, min(layers[one][-1] for one in STRATEGIES), options.limit)
            exact.append(number)
            proven += complete
            sizes.append((events.number_of_nodes(), events.number_of_edges()))
        nodes, edges = np.mean(sizes, axis=0)
        print(f"{path.name}: {len(exact)} cells, {nodes:.0f} objects and {edges:.0f} events a cell; ", end="")
        print(f"exact {np.mean(exact):.2f} layers, proven in {proven} cells")
        print("| strategy | layers mean | max | cells with the fewest | area, best = 1 | ms a cell |")
        print("|---|---|---|---|---|---|")
        for strategy in STRATEGIES:
            few = np.array(layers[strategy])
            print(
                f"| {strategy} | {few.mean():.2f} | {few.max()} | {np.count_nonzero(few == exact)} | "
                f"{sum(areas[strategy]) / sum(areas['best']):.2f} | {1e3 * spent[strategy] / len(few):.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
