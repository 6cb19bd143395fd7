"""The skeleton of the space between walls: edges of the Voronoi diagram of points along all outlines that keep off the walls.

The diagram of a large city is put together from those of tiles, each with the walls around it. Its edges are the same, but
for those that are far from any wall. So memory is that of a tile's diagram and of what is kept.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import QhullError, Voronoi, cKDTree
from shapely.geometry.base import BaseGeometry

__all__ = ["Skeleton", "skeleton_between"]

_TILE_POINTS = 200_000
_HALO = 200.0
"""Metres of walls around a tile; in a city of several tiles, what is farther from every wall is no path."""
_SAME = 1e-4
"""Metres between two tiles' computations of one node, at most: they agree to some 1e-8."""

_Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Skeleton:
    """A graph of lines midway between walls.

    Attributes:
        at: (n, 2) the nodes, metres.
        clearance: (n,) metres from each node to the nearest point of a wall.
        edges: (m, 2) pairs of nodes.
        parts: (n,) a number for each node: edges connect what has the same.
    """

    at: _Floats
    clearance: _Floats
    edges: NDArray[np.intp]
    parts: NDArray[np.intp]


def skeleton_between(
    solid: BaseGeometry, region: BaseGeometry, step: float, clearance: float, *, tile_points: int = _TILE_POINTS
) -> Skeleton:
    """The Voronoi edges in ``region`` that keep ``clearance`` metres from ``solid``.

    Points stand every ``step`` metres on the outlines, and at most ``tile_points`` in a tile.
    """
    outlines = shapely.segmentize(solid, step)
    points = np.unique(np.round(shapely.get_coordinates(outlines), 6), axis=0)
    # Walls between points come nearer than the points, by less than this.
    wanted = float(np.hypot(clearance, 0.5 * step))
    tiles = list(_tiles(points, tile_points))
    if len(tiles) == 1:
        at, radius, edges = _edges_of_tile(points, wanted)
    else:
        at, radius, edges = _joined([_edges_around(points, low, high, wanted) for low, high in tiles])
    shapely.prepare(solid)
    shapely.prepare(region)
    free = shapely.contains_xy(region, at) & ~shapely.intersects_xy(solid, at)
    edges = edges[free[edges].all(axis=1)]
    network = coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(at), len(at)))
    _, parts = connected_components(network, directed=False)
    return Skeleton(at, radius, edges, parts.astype(np.intp))


def _tiles(points: _Floats, most: int) -> Iterator[tuple[_Floats, _Floats]]:
    """Boxes (low, high) without gaps that hold at most ``most`` of the points (n, 2) each: halved across their longer side."""
    pending = [(points, np.full(2, -np.inf), np.full(2, np.inf))]
    while pending:
        inside, low, high = pending.pop()
        axis = int(np.argmax(np.ptp(inside, axis=0))) if len(inside) else 0
        cut = float(np.median(inside[:, axis])) if len(inside) else 0.0
        left = inside[:, axis] < cut
        if len(inside) <= most or not left.any():
            yield low, high
            continue
        below, above = high.copy(), low.copy()
        below[axis] = above[axis] = cut
        pending += [(inside[~left], above, high), (inside[left], low, below)]


def _edges_of_tile(points: _Floats, wanted: float) -> tuple[_Floats, _Floats, NDArray[np.intp]]:
    """Nodes (n, 2), their clearances (n,) and edges (m, 2) of the points' Voronoi diagram that are ``wanted`` metres clear."""
    nothing = np.empty((0, 2)), np.empty(0), np.empty((0, 2), dtype=np.intp)
    if len(points) < 3:
        return nothing
    middle = points.mean(axis=0)
    try:
        diagram = Voronoi(points - middle)
    except QhullError:
        return nothing
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
    keep = np.flatnonzero((clear >= wanted) & (length > 0.0))
    used, ends = np.unique(ridges[keep], return_inverse=True)
    ends = ends.reshape(-1, 2)
    radius = np.zeros(len(used))
    for side, places in ((0, a), (1, b)):
        radius[ends[:, side]] = np.linalg.norm(places[keep] - sites[keep, 0], axis=1)
    return diagram.vertices[used] + middle, radius, ends


def _edges_around(
    points: _Floats, low: _Floats, high: _Floats, wanted: float
) -> tuple[_Floats, _Floats, NDArray[np.intp]]:
    """Those edges whose middle lies in the tile from ``low`` to ``high``, as the diagram of all points has them.

    The circles around an edge's ends that touch its sites are empty. Where they lie within the halo, the edge depends on
    nothing beyond it; others are left out.
    """
    near = ((points >= low - _HALO) & (points <= high + _HALO)).all(axis=1)
    at, radius, edges = _edges_of_tile(points[near], wanted)
    if not len(edges):
        return at, radius, edges
    a, b = at[edges[:, 0]], at[edges[:, 1]]
    middle = 0.5 * (a + b)
    # Tiles overlap by more than rounding: an edge that two have is one when they are joined.
    mine = ((middle >= low - _SAME) & (middle <= high + _SAME)).all(axis=1)
    mine &= radius[edges].max(axis=1) + 0.5 * np.linalg.norm(b - a, axis=1) + _SAME <= _HALO
    used, ends = np.unique(edges[mine], return_inverse=True)
    return at[used], radius[used], ends.reshape(-1, 2)


def _joined(
    tiles: list[tuple[_Floats, _Floats, NDArray[np.intp]]],
) -> tuple[_Floats, _Floats, NDArray[np.intp]]:
    """The tiles' nodes and edges as one graph; nodes at the same place are one."""
    first = np.cumsum([0] + [len(at) for at, _, _ in tiles[:-1]])
    at = np.concatenate([at for at, _, _ in tiles])
    radius = np.concatenate([radius for _, radius, _ in tiles])
    edges = np.concatenate([edges + start for (_, _, edges), start in zip(tiles, first, strict=True)])
    if not len(at):
        return at, radius, edges
    pairs = cKDTree(at).query_pairs(_SAME, output_type="ndarray")
    same = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(at), len(at)))
    _, labels = connected_components(same, directed=False)
    _, representative, of = np.unique(labels, return_index=True, return_inverse=True)
    edges = np.unique(np.sort(of[edges], axis=1), axis=0)
    return at[representative], radius[representative], edges[edges[:, 0] != edges[:, 1]]
