"""Ways to walk where a model has no streets: the skeleton of the free space between its buildings.

The skeleton is what is equally far from two walls: the edges of the Voronoi diagram of points along all outlines, without
those that come close to a wall, without the dead ends that every corner makes, and without what cannot be reached (courtyards).
Source: Ogniewicz & Kübler, Hierarchic Voronoi skeletons, 1995 (the idea; dead ends are judged here by what they add to view).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import networkx as nx
import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import QhullError, Voronoi
from shapely.geometry import LineString
from shapely.geometry.base import BaseGeometry

from mmi.foundation.errors import CityError
from mmi.reading.raw_layers import RawStreet

__all__ = ["open_space_streets"]

_WIDEST = 12.0
"""Metres: a path is not taken to be wider, for instance across a square."""
_MOST_POINTS = 120_000
_SHORTEST_WALK = 5.0
"""Times the width of a path: where all paths together are shorter, there is only a gap, and the walk leads around the city."""
_BEYOND = 1.6
"""Times the clearance of its junction that a dead end must reach to be worth a walk; the arm into a corner reaches 1.41."""
_HULL_RATIO = 0.15
"""How closely the hull follows the city: 0 is as closely as possible, 1 is the convex hull."""


def open_space_streets(
    footprints: NDArray[np.object_], *, min_width: float = 4.0, margin: float = 10.0, spacing: float | None = None
) -> tuple[tuple[RawStreet, ...], float]:
    """Paths midway between the buildings ``footprints`` (n,), polygons in metres, and the metres of those left out.

    All are connected; what nothing connects to the longest of them (in courtyards) is left out.

    They keep ``min_width`` / 2 metres from every building and stay within ``margin`` metres of the city's hull. ``spacing``
    is that of the points on the outlines, metres: by default a quarter of ``min_width``, more where the city is large.
    Tags: ``highway`` = pedestrian, ``width`` = twice the smallest clearance, at most 12 m. Where there is nothing between
    buildings, the path leads around them.

    Raises:
        CityError: no footprints, or none with an area.
    """
    buildings = np.asarray([one for one in footprints if one is not None and one.area > 0.0], dtype=object)
    if not len(buildings):
        raise CityError("paths through open space need buildings, found no footprint with an area")
    solid = shapely.union_all(shapely.make_valid(buildings))
    solid = shapely.multipolygons([part for part in shapely.get_parts(solid) if part.geom_type == "Polygon"])
    region = _region(solid, margin)
    total = shapely.length(solid)
    step = max(0.25 * min_width, total / _MOST_POINTS) if spacing is None else spacing
    graph, left_out = _skeleton(solid, region, step, 0.5 * min_width)
    lines = _lines(graph) if len(graph) else []
    streets = _as_streets(_simplified(lines, solid, 0.5 * min_width), solid)
    if sum(line.length for one in streets for line in one.lines) < _SHORTEST_WALK * min_width:
        around = shapely.get_parts(shapely.buffer(solid, max(0.5 * margin, min_width)))
        around = max(around, key=shapely.area)
        streets = _as_streets([LineString(shapely.simplify(around.exterior, 0.25 * min_width).coords)], solid)
    return streets, left_out


def _region(solid: BaseGeometry, margin: float) -> BaseGeometry:
    """The city's hull, bays filled, grown by ``margin``."""
    try:
        hull = shapely.concave_hull(solid, ratio=_HULL_RATIO)
    except shapely.errors.GEOSException:  # the hull's triangulation fails on some outlines: their corners are enough
        corners = np.unique(np.round(shapely.get_coordinates(solid), 1), axis=0)
        hull = shapely.concave_hull(shapely.multipoints(corners), ratio=_HULL_RATIO)
    return shapely.buffer(shapely.union(hull, solid), margin)


def _skeleton(solid: BaseGeometry, region: BaseGeometry, step: float, clearance: float) -> tuple[nx.Graph, float]:
    """The longest connected part of the Voronoi edges in free space, and the metres of the other parts.

    Nodes carry ``at`` (x, y) and ``clearance`` (metres to the nearest wall), edges ``length`` (metres).
    """
    graph = nx.Graph()
    outlines = shapely.segmentize(solid, step)
    points = np.unique(np.round(shapely.get_coordinates(outlines), 6), axis=0)
    middle = points.mean(axis=0)
    try:
        diagram = Voronoi(points - middle)
    except QhullError:
        return graph, 0.0
    ridges = np.array(diagram.ridge_vertices)
    finite = (ridges >= 0).all(axis=1)
    ridges, sites = ridges[finite], diagram.points[diagram.ridge_points[finite]]
    a, b = diagram.vertices[ridges[:, 0]], diagram.vertices[ridges[:, 1]]
    # The nearest that a ridge comes to its sites: halfway between them if it passes there, else at an end.
    along, length = b - a, np.linalg.norm(b - a, axis=1)
    halfway = sites.mean(axis=1)
    share = ((halfway - a) * along).sum(axis=1) / np.maximum(length**2, 1e-12)
    nearest = a + np.clip(share, 0.0, 1.0)[:, None] * along
    clear = np.linalg.norm(nearest - sites[:, 0], axis=1)
    # Walls between points come nearer than the points, by less than this.
    wanted = np.hypot(clearance, 0.5 * step)
    keep = np.flatnonzero((clear >= wanted) & (length > 0.0))
    used, ends = np.unique(ridges[keep], return_inverse=True)
    ends = ends.reshape(-1, 2)
    at = diagram.vertices[used] + middle
    shapely.prepare(solid)
    shapely.prepare(region)
    free = shapely.contains_xy(region, at) & ~shapely.intersects_xy(solid, at)
    radius = np.zeros(len(used))
    for side, places in ((0, a), (1, b)):
        radius[ends[:, side]] = np.linalg.norm(places[keep] - sites[keep, 0], axis=1)
    good = free[ends].all(axis=1)
    ends, metres = ends[good], length[keep][good]
    if not len(ends):
        return graph, 0.0
    network = coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(used), len(used)))
    _, labels = connected_components(network, directed=False)
    shares = np.bincount(labels[ends[:, 0]], weights=metres)
    mine = labels[ends[:, 0]] == np.argmax(shares)
    for (i, j), distance in zip(ends[mine].tolist(), metres[mine].tolist(), strict=True):
        graph.add_edge(i, j, length=distance)
    for node in graph:
        graph.nodes[node].update(at=(float(at[node, 0]), float(at[node, 1])), clearance=float(radius[node]))
    return graph, float(shares.sum() - shares.max())


def _lines(graph: nx.Graph) -> list[LineString]:
    """Lines between junctions, after dead ends that show nothing new are gone and junctions side by side are one."""
    chains = _chains(graph)
    while True:
        doomed = _dead_ends(graph, chains)
        if not doomed:
            break
        for chain in doomed:
            graph.remove_nodes_from(chain[1:-1])
            if graph.has_edge(chain[0], chain[1]):
                graph.remove_edge(chain[0], chain[1])
        graph.remove_nodes_from([node for node, degree in graph.degree if degree == 0])
        chains = _chains(graph)
    centre = _crossings(graph, chains)
    lines = []
    for chain in chains:
        places = [graph.nodes[node]["at"] for node in chain]
        head, tail = centre.get(chain[0]), centre.get(chain[-1])
        if head is not None and tail is not None and head == tail and chain[0] != chain[-1]:
            continue
        places = ([head] if head is not None else []) + places + ([tail] if tail is not None else [])
        line = LineString(places)
        if line.length > 0.0:
            lines.append(line)
    return lines


def _chains(graph: nx.Graph) -> list[list[int]]:
    """Paths between nodes that do not have two neighbours; a ring without any starts at its lowest node."""
    chains: list[list[int]] = []
    seen: set[tuple[int, int]] = set()

    def walk(start: int, second: int) -> None:
        chain = [start, second]
        while graph.degree[chain[-1]] == 2 and chain[-1] != start:
            one, other = graph.adj[chain[-1]]
            chain.append(other if one == chain[-2] else one)
        seen.add((chain[0], chain[1]))
        seen.add((chain[-1], chain[-2]))
        chains.append(chain)

    for node in sorted(graph):
        if graph.degree[node] != 2:
            for neighbour in sorted(graph.adj[node]):
                if (node, neighbour) not in seen:
                    walk(node, neighbour)
    reached = {node for chain in chains for node in chain}
    for node in sorted(graph):
        if node not in reached:
            walk(node, min(graph.adj[node]))
            reached.update(chains[-1])
    return chains


def _dead_ends(graph: nx.Graph, chains: list[list[int]]) -> list[list[int]]:
    """Chains from a junction to an end (turned that way round) whose end sees little that their junction does not.

    Where all ways from a junction are dead ends, the two longest stay.
    """
    by_junction: dict[int, list[tuple[float, list[int]]]] = {}
    for chain in chains:
        if graph.degree[chain[0]] == 1:
            chain = chain[::-1]
        if graph.degree[chain[-1]] != 1 or graph.degree[chain[0]] < 3:
            continue
        length = sum(graph.edges[i, j]["length"] for i, j in pairwise(chain))
        end, junction = graph.nodes[chain[-1]]["clearance"], graph.nodes[chain[0]]["clearance"]
        if length + end < _BEYOND * junction:
            by_junction.setdefault(chain[0], []).append((length + end, chain))
    doomed = []
    for junction, ends in by_junction.items():
        ends.sort(key=lambda one: (one[0], one[1]))
        doomed += [chain for _, chain in (ends[:-2] if len(ends) == graph.degree[junction] else ends)]
    return doomed


def _crossings(graph: nx.Graph, chains: list[list[int]]) -> dict[int, tuple[float, float]]:
    """Where junctions closer than half their clearance to one another meet: node -> the middle of its cluster."""
    near = nx.Graph()
    for chain in chains:
        length = sum(graph.edges[i, j]["length"] for i, j in pairwise(chain))
        both = min(graph.nodes[end]["clearance"] for end in (chain[0], chain[-1]))
        if length < 0.5 * both and min(graph.degree[chain[0]], graph.degree[chain[-1]]) > 2:
            near.add_edge(chain[0], chain[-1])
    centre: dict[int, tuple[float, float]] = {}
    for cluster in nx.connected_components(near):
        x, y = np.mean([graph.nodes[node]["at"] for node in sorted(cluster)], axis=0)
        within = all(
            np.hypot(graph.nodes[node]["at"][0] - x, graph.nodes[node]["at"][1] - y) < graph.nodes[node]["clearance"]
            for node in cluster
        )
        if within:
            centre |= dict.fromkeys(cluster, (float(x), float(y)))
    return centre


def _simplified(lines: list[LineString], solid: BaseGeometry, clearance: float) -> list[LineString]:
    """Lines with as few points as keep the clearance; those that do not have it to begin with, as they are."""
    if not lines:
        return []
    tree = shapely.STRtree(shapely.get_parts(solid))
    distance = _distances(tree)
    current = np.array(lines, dtype=object)
    have = distance(current)
    for share in (0.5, 0.25, 0.1):
        todo = np.flatnonzero(shapely.get_num_points(current) == shapely.get_num_points(np.array(lines, dtype=object)))
        fewer = shapely.simplify(current[todo], np.minimum(share * have[todo], 1.5))
        fine = distance(fewer) >= np.minimum(clearance, have[todo]) - 1e-9
        current[todo[fine]] = fewer[fine]
    return list(current[distance(current) > 0.0])


def _distances(tree: shapely.STRtree) -> Callable[[NDArray[np.object_]], NDArray[np.float64]]:
    """Metres from each line to the nearest geometry of the tree."""

    def distance(lines: NDArray[np.object_]) -> NDArray[np.float64]:
        found = np.full(len(lines), np.inf)
        if len(lines):
            pairs, metres = tree.query_nearest(lines, return_distance=True, all_matches=False)
            found[pairs[0]] = metres
        return found

    return distance


def _as_streets(lines: list[LineString], solid: BaseGeometry) -> tuple[RawStreet, ...]:
    """Lines as pedestrian streets, from west to east."""
    if not lines:
        return ()
    clear = _distances(shapely.STRtree(shapely.get_parts(solid)))(np.array(lines, dtype=object))
    order = sorted(range(len(lines)), key=lambda i: lines[i].bounds)
    return tuple(
        RawStreet(
            f"open/{n}",
            (lines[i],),
            {"highway": "pedestrian", "width": f"{np.floor(10.0 * min(2.0 * clear[i], _WIDEST)) / 10.0:.1f}"},
        )
        for n, i in enumerate(order)
    )
