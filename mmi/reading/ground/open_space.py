"""Ways to walk where a city has no streets: the skeleton of the free space between its buildings.

The skeleton is what is equally far from two walls: the edges of the Voronoi diagram of points along all outlines, without
those that come close to a wall, without the dead ends that every corner makes, and without what cannot be reached (courtyards).
Source: Ogniewicz & Kübler, Hierarchic Voronoi skeletons, 1995 (the idea; dead ends are judged here by what they add to view).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain

import networkx as nx
import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString
from shapely.geometry.base import BaseGeometry

from mmi.foundation.errors import CityError
from mmi.reading.ground.skeleton import Skeleton, skeleton_between
from mmi.reading.raw_layers import RawStreet, StreetLayer
from mmi.reading.report import Ledger

__all__ = ["OpenSpace", "open_space_layer", "open_space_streets"]

_WIDEST = 12.0
"""Metres: a path is not taken to be wider, for instance across a square."""
_MOST_POINTS = 1_200_000
_NARROWEST_UNTOLD = 4.2
"""Metres: coarser paths than these are told of."""
_SHORTEST = 5.0
"""Times the width of a path: what leads from the way around the city into a niche is shorter."""
_FEW, _WORTH = 0.25, 0.1
"""The way around the city is walked where the longest paths that are connected are shorter than the first share of it, or
where it connects paths to them that are longer than the second share of these.
"""
_BEYOND = 1.6
"""Times the clearance of its junction that a dead end must reach to be worth a walk; the arm into a corner reaches 1.41."""
_HULL_RATIO = 0.15
"""How closely the hull follows the city: 0 is as closely as possible, 1 is the convex hull."""


@dataclass(frozen=True, slots=True, eq=False)
class OpenSpace:
    """Paths through open space.

    Attributes:
        streets: the paths; all are connected.
        enclosed_m: metres between walls that nothing connects to these, in courtyards.
        narrowest_m: a gap between buildings that is narrower than this, metres, has no path.
    """

    streets: tuple[RawStreet, ...]
    enclosed_m: float
    narrowest_m: float


def open_space_streets(
    footprints: NDArray[np.object_], *, min_width: float = 4.0, margin: float = 10.0, spacing: float | None = None
) -> OpenSpace:
    """Paths midway between the buildings ``footprints`` (n,), polygons in metres.

    All are connected. Where they are few, or where parts of them meet only outside of the city, the way around it joins them;
    what nothing connects to the longest of them (in courtyards) is left out.

    They keep ``min_width`` / 2 metres from every building and stay within ``margin`` metres of the city's hull. ``spacing``
    is that of the points on the outlines, metres: by default a quarter of ``min_width``, more where the outlines of a large
    city would have more than 1,200,000 points.
    Tags: ``highway`` = pedestrian, ``width`` = twice the smallest clearance, at most 12 m.

    Raises:
        CityError: no footprints, or none with an area.
    """
    buildings = np.asarray([one for one in footprints if one is not None and one.area > 0.0], dtype=object)
    if not len(buildings):
        raise CityError("paths through open space need buildings, found no footprint with an area")
    solid = shapely.union_all(shapely.make_valid(buildings))
    solid = shapely.multipolygons([part for part in shapely.get_parts(solid) if part.geom_type == "Polygon"])
    city = _filled(solid)
    total = shapely.length(solid)
    step = max(0.25 * min_width, total / _MOST_POINTS) if spacing is None else spacing
    skeleton = skeleton_between(solid, shapely.buffer(city, margin), step, 0.5 * min_width)
    metres = np.linalg.norm(skeleton.at[skeleton.edges[:, 0]] - skeleton.at[skeleton.edges[:, 1]], axis=1)
    shares = np.bincount(skeleton.parts[skeleton.edges[:, 0]], weights=metres, minlength=1)
    lines, parts = _lines(skeleton)
    lines, parts = _simplified(lines, parts, solid, 0.5 * min_width)
    around = shapely.simplify(shapely.buffer(city, max(0.5 * margin, min_width)), 0.25 * min_width)
    edge = shapely.boundary(around)
    links, linked = _links(lines, parts, edge, solid, clearance=0.5 * min_width, reach=2.0 * margin)
    longest, reached = np.zeros((2, len(shares)), dtype=np.bool_)
    longest[np.argmax(shares)] = True
    reached[[*parts[shapely.intersects(lines, edge)], *linked]] = True
    niches = reached & (shares <= _SHORTEST * min_width)
    reached &= ~niches
    is_few = shares.max() < _FEW * edge.length
    is_worth = shares[reached & ~longest].sum() > _WORTH * shares.max()
    kept = reached if is_few or is_worth else longest
    paths = list(lines[kept[parts]])
    if is_few or is_worth:
        inside = shapely.intersection([*paths, *links[kept[linked]]], around)
        paths = [*_pieces(inside), *_pieces(shapely.get_exterior_ring(shapely.get_parts(around)))]
        kept |= niches
    return OpenSpace(_as_streets(paths, solid), float(shares[~kept].sum()), float(np.hypot(min_width, step)))


def _links(
    lines: NDArray[np.object_],
    parts: NDArray[np.intp],
    edge: BaseGeometry,
    solid: BaseGeometry,
    *,
    clearance: float,
    reach: float,
) -> tuple[NDArray[np.object_], NDArray[np.intp]]:
    """Straight lines (k,) from loose ends of ``lines`` to ``edge``, of at most ``reach`` metres and clear; and their parts."""
    if not len(lines):
        return lines, parts
    ends = shapely.points(np.concatenate([shapely.get_coordinates(shapely.get_point(lines, k)) for k in (0, -1)]))
    _, place, times = np.unique(shapely.get_coordinates(ends), axis=0, return_inverse=True, return_counts=True)
    loose = times[place.reshape(-1)] == 1
    links = shapely.shortest_line(ends[loose], edge)
    clear = _distances(shapely.STRtree(shapely.get_parts(solid)))(links) >= clearance
    good = clear & (shapely.length(links) <= reach) & (shapely.length(links) > 0.0)
    return links[good], np.tile(parts, 2)[loose][good]


def _pieces(shapes: Sequence[BaseGeometry] | NDArray[np.object_]) -> list[LineString]:
    """Lines and rings, and those of collections, as lines with a length."""
    parts = shapely.get_parts(np.asarray(shapes, dtype=object))
    return [
        LineString(one.coords) for one in parts if one.geom_type in ("LineString", "LinearRing") and one.length > 0.0
    ]


def open_space_layer(file: str, footprints: NDArray[np.object_], ledger: Ledger) -> StreetLayer:
    """Paths between the buildings of ``file``, which has no streets, as its streets (``footprints`` as above), accounted for.

    Raises:
        CityError: there are none.
    """
    found = open_space_streets(footprints)
    if not found.streets:
        raise CityError(f"{file}: no streets, and no open space between the buildings; expected --streets FILE")
    ledger.note("inferred", "paths through the open space, as there are no streets", count=len(found.streets))
    if found.enclosed_m > 0.0:
        ledger.note("left out", "open space that is enclosed", metres=found.enclosed_m)
    if found.narrowest_m > _NARROWEST_UNTOLD:
        ledger.warn(
            f"{file}: paths are coarse, as the city is large: there is none through gaps under {found.narrowest_m:.1f} m "
            "(--streets FILE, or --clip)"
        )
    return StreetLayer(file, found.streets, None, False)


def _filled(solid: BaseGeometry) -> BaseGeometry:
    """The city's hull, with all that reaches over it, and without holes: what lies between both is filled."""
    try:
        hull = shapely.concave_hull(solid, ratio=_HULL_RATIO)
    except shapely.errors.GEOSException:  # the hull's triangulation fails on some outlines: their corners are enough
        corners = np.unique(np.round(shapely.get_coordinates(solid), 1), axis=0)
        hull = shapely.concave_hull(shapely.multipoints(corners), ratio=_HULL_RATIO)
    both = shapely.get_parts(shapely.union(hull, solid))
    return shapely.union_all(shapely.polygons(shapely.get_exterior_ring(both[shapely.get_type_id(both) == 3])))


def _lines(skeleton: Skeleton) -> tuple[NDArray[np.object_], NDArray[np.intp]]:
    """Lines (n,) between junctions, after dead ends that show nothing new are gone and junctions side by side are one.

    Second: the skeleton's part (n,) that each belongs to.
    """
    neighbours: dict[int, list[int]] = {}
    for i, j in skeleton.edges.tolist():
        neighbours.setdefault(i, []).append(j)
        neighbours.setdefault(j, []).append(i)
    chains = _chains(neighbours)
    while doomed := _dead_ends(neighbours, chains, skeleton):
        for node in chain.from_iterable(one[1:] for one in doomed):
            for other in neighbours.pop(node):
                neighbours[other].remove(node)
        chains = _chains(neighbours)
    centre = _crossings(neighbours, chains, skeleton)
    lines, parts = [], []
    for nodes in chains:
        head, tail = centre.get(nodes[0]), centre.get(nodes[-1])
        if head is not None and tail is not None and head == tail and nodes[0] != nodes[-1]:
            continue
        ends = [[] if end is None else [end] for end in (head, tail)]
        line = LineString([*ends[0], *skeleton.at[nodes].tolist(), *ends[1]])
        if line.length > 0.0:
            lines.append(line)
            parts.append(skeleton.parts[nodes[0]])
    return np.array(lines, dtype=object), np.array(parts, dtype=np.intp)


def _chains(neighbours: dict[int, list[int]]) -> list[list[int]]:
    """Paths between nodes that do not have two neighbours; a ring without any starts at its lowest node."""
    chains: list[list[int]] = []
    seen: set[tuple[int, int]] = set()

    def walk(start: int, second: int) -> None:
        path = [start, second]
        while len(neighbours[path[-1]]) == 2 and path[-1] != start:
            one, other = neighbours[path[-1]]
            path.append(other if one == path[-2] else one)
        seen.add((path[0], path[1]))
        seen.add((path[-1], path[-2]))
        chains.append(path)

    for node in sorted(neighbours):
        if len(neighbours[node]) != 2:
            for other in sorted(neighbours[node]):
                if (node, other) not in seen:
                    walk(node, other)
    reached = set(chain.from_iterable(chains))
    for node in sorted(neighbours):
        if node not in reached:
            walk(node, min(neighbours[node]))
            reached.update(chains[-1])
    return chains


def _metres(nodes: list[int], skeleton: Skeleton) -> float:
    return float(np.linalg.norm(np.diff(skeleton.at[nodes], axis=0), axis=1).sum())


def _dead_ends(neighbours: dict[int, list[int]], chains: list[list[int]], skeleton: Skeleton) -> list[list[int]]:
    """Chains from a junction to an end (turned that way round) whose end sees little that their junction does not.

    Where all ways from a junction are dead ends, the two longest stay.
    """
    by_junction: dict[int, list[tuple[float, list[int]]]] = {}
    for nodes in chains:
        if len(neighbours[nodes[0]]) == 1:
            nodes = nodes[::-1]
        if len(neighbours[nodes[-1]]) != 1 or len(neighbours[nodes[0]]) < 3:
            continue
        reach = _metres(nodes, skeleton) + float(skeleton.clearance[nodes[-1]])
        if reach < _BEYOND * skeleton.clearance[nodes[0]]:
            by_junction.setdefault(nodes[0], []).append((reach, nodes))
    doomed = []
    for junction, ends in by_junction.items():
        ends.sort(key=lambda one: (one[0], one[1]))
        doomed += [nodes for _, nodes in (ends[:-2] if len(ends) == len(neighbours[junction]) else ends)]
    return doomed


def _crossings(
    neighbours: dict[int, list[int]], chains: list[list[int]], skeleton: Skeleton
) -> dict[int, tuple[float, float]]:
    """Where junctions closer than half their clearance to one another meet: node -> the middle of its cluster."""
    near = nx.Graph()
    for nodes in chains:
        ends = [nodes[0], nodes[-1]]
        both = skeleton.clearance[ends].min()
        if min(len(neighbours[end]) for end in ends) > 2 and _metres(nodes, skeleton) < 0.5 * both:
            near.add_edge(*ends)
    centre: dict[int, tuple[float, float]] = {}
    for cluster in nx.connected_components(near):
        members = sorted(cluster)
        x, y = skeleton.at[members].mean(axis=0)
        if (np.linalg.norm(skeleton.at[members] - (x, y), axis=1) < skeleton.clearance[members]).all():
            centre |= dict.fromkeys(cluster, (float(x), float(y)))
    return centre


def _simplified(
    lines: NDArray[np.object_], parts: NDArray[np.intp], solid: BaseGeometry, clearance: float
) -> tuple[NDArray[np.object_], NDArray[np.intp]]:
    """Lines with as few points as keep the clearance; those that do not have it to begin with, as they are; and ``parts``."""
    tree = shapely.STRtree(shapely.get_parts(solid))
    distance = _distances(tree)
    current = lines.copy()
    have = distance(current)
    for share in (0.5, 0.25, 0.1):
        todo = np.flatnonzero(shapely.get_num_points(current) == shapely.get_num_points(lines))
        fewer = shapely.simplify(current[todo], np.minimum(share * have[todo], 1.5))
        fine = distance(fewer) >= np.minimum(clearance, have[todo]) - 1e-9
        current[todo[fine]] = fewer[fine]
    clear = distance(current) > 0.0
    return current[clear], parts[clear]


def _distances(tree: shapely.STRtree) -> Callable[[NDArray[np.object_]], NDArray[np.float64]]:
    """Metres from each line to the nearest geometry of the tree, piece by piece: near a long line lies half of a city."""

    def distance(lines: NDArray[np.object_]) -> NDArray[np.float64]:
        found = np.full(len(lines), np.inf)
        points, line = shapely.get_coordinates(lines, return_index=True)
        within = line[1:] == line[:-1]
        if within.any():
            pieces = shapely.linestrings(np.stack([points[:-1][within], points[1:][within]], axis=1))
            pairs, metres = tree.query_nearest(pieces, return_distance=True, all_matches=False)
            np.minimum.at(found, line[1:][within][pairs[0]], metres)
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
