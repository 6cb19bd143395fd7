"""The growth curve: one walk while the city around it grows 1, 4, 16 and 64 times; frame time and memory of each technique.

    python benchmarks/growth.py examples/helsinki/helsinki.osm.pbf -o out/growth --times 1,4,16,64

The city is laid out again and again beside itself, streets and all, with the walked copy in the middle. Impostors are built
for the cells that the walk comes through. All cities are then walked in one run, by all techniques in turn.

The walk keeps to the streets around the middle of the city's bounds: what the city grows by is then as far away as it can be.
Elsewhere a walk sees the edge of the city, and houses beyond it as soon as there are any, which is not what growth costs.
*s to the first cell* are the seconds of the build until its first cell is done: cells, shared files and both workers'
preparation, and that cell.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import replace
from pathlib import Path

import networkx as nx
import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry
from walks import rounds, total_ms

from mmi.building.dataset import build_dataset
from mmi.cells.viewing_cells import ViewingCell, viewing_cells
from mmi.cells.whereabouts import Whereabouts
from mmi.city.model import City, CityObject, Prism
from mmi.dataset.reading import open_dataset
from mmi.planning.parameters import BuildParameters
from mmi.reading.read_city import read_city
from viewer.report.baseline import single_mesh_scene
from viewer.scene.scene import open_scene
from viewer.techniques.catalogue import TECHNIQUES
from viewer.walks.tour import tour

_CHOICE = 2.0
"""Metres of cells around the middle that the tour chooses from, to its own metres."""


def grown(city: City, side: int) -> City:
    """``side`` by ``side`` copies of a city; the first keeps its ids and its streets their numbers, so cells do too."""
    x0, y0, x1, y1 = city.bounds
    middle = (side - 1) // 2
    shifts = [(i - middle, j - middle) for i in range(side) for j in range(side)]
    shifts.sort(key=lambda shift: (shift != (0, 0), shift))
    objects: list[CityObject] = []
    streets = nx.MultiGraph()
    count = city.streets.number_of_edges()
    nodes = 1 + max(city.streets.nodes)
    for copy, (i, j) in enumerate(shifts):
        dx, dy = i * (x1 - x0 + 10.0), j * (y1 - y0 + 10.0)

        def move(shape: BaseGeometry, by: tuple[float, float] = (dx, dy)) -> BaseGeometry:
            return shapely.transform(shape, lambda points: points + np.array(by)) if any(by) else shape

        for one in city.objects:
            prisms = tuple(Prism(move(prism.footprint), prism.bottom, prism.top) for prism in one.prisms)
            objects.append(CityObject(one.id if copy == 0 else f"{one.id} {i},{j}", prisms))
        for node, data in city.streets.nodes(data=True):
            streets.add_node(node + copy * nodes, x=data["x"] + dx, y=data["y"] + dy)
        for a, b, edge in city.streets.edges(data=True):
            moved = {**edge, "geometry": move(edge["geometry"]), "index": edge["index"] + copy * count}
            streets.add_edge(a + copy * nodes, b + copy * nodes, **moved)
    return replace(city, objects=tuple(objects), streets=streets)


def central_cells(city: City, graph: nx.Graph, metres: float) -> tuple[ViewingCell, ...]:
    """The cell nearest to the middle of the city's bounds and those nearest to it along streets, ``metres`` in all."""
    middles = {name: graph.nodes[name]["cell"].reference[:2] for name in max(nx.connected_components(graph), key=len)}
    x0, y0, x1, y1 = city.bounds
    start = min(middles, key=lambda name: (math.dist(middles[name], (0.5 * (x0 + x1), 0.5 * (y0 + y1))), name))
    order = nx.single_source_dijkstra_path_length(
        graph, start, weight=lambda a, b, _: math.dist(middles[a], middles[b])
    )
    chosen: list[ViewingCell] = []
    for name in order:
        if sum(cell.length for cell in chosen) >= metres:
            break
        chosen.append(graph.nodes[name]["cell"])
    return tuple(chosen)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("city", type=Path, metavar="CITY")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR")
    parser.add_argument("--times", default="1,4,16,64")
    parser.add_argument("--tour", type=float, default=120.0, metavar="METRES")
    parser.add_argument("--fps", type=float, default=4.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--techniques", default=",".join(TECHNIQUES))
    options = parser.parse_args()
    techniques = options.techniques.split(",")
    city, _ = read_city(options.city)
    graph = viewing_cells(city)
    cells = tuple(graph.nodes[name]["cell"] for name in graph)
    neighbours = {name: list(graph[name]) for name in graph}
    walk = tour(central_cells(city, graph, _CHOICE * options.tour), neighbours, metres=options.tour, speed=5.0, seed=1)
    places = Whereabouts(cells, neighbours)
    visited: list[str] = []
    for step in walk.frames(options.fps):
        visited.append(places.cell_at(np.array(step.pose.eye), current=visited[-1] if visited else None))
    print(f"{walk.metres:.0f} m through {len(set(visited))} cells", flush=True)

    print(
        "| city | objects | triangles | s to the first cell | technique | ms p50 | p95 | to 1x | triangles sent | draws "
        "| MB to hold |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    first: dict[str, float] = {}
    for times in map(int, options.times.split(",")):
        side = math.isqrt(times)
        folder = options.output / f"{times}"
        larger = grown(city, side)
        done: list[float] = []
        start = time.perf_counter()
        build_dataset(
            larger,
            folder,
            BuildParameters(),
            cells=sorted(set(visited)),
            workers=2,
            progress=lambda *_, done=done: done.append(time.perf_counter()),
        )
        prepared = f"{done[0] - start:.1f}" if done else "built before"
        scene = open_scene(open_dataset(folder), name="multi-mesh")
        scenes = {"multi-mesh": scene}
        if "single-mesh" in techniques:
            scenes["single-mesh"] = single_mesh_scene(
                scene, options.output / f"{times}-single-mesh", visited, workers=2
            )
        found, held = rounds(scenes, walk, techniques, fps=options.fps, rounds=options.rounds)
        for name in techniques:
            ms = total_ms(found[name])
            p50, p95 = np.percentile(ms, [50, 95])
            first.setdefault(name, p50)
            frames = [frame for run in found[name] for frame in run]
            sent, draws = (np.mean([getattr(frame, what) for frame in frames]) for what in ("triangles", "draws"))
            print(
                f"| {times}x | {len(scene.mesh.triangle_counts)} | {len(scene.mesh.triangles)} | {prepared} | {name} | "
                f"{p50:.1f} | {p95:.1f} | {p50 / first[name]:.2f} | {sent:.0f} | {draws:.1f} | {held[name] / 1e6:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
