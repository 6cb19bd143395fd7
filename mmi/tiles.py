"""Flat polygons cut along the lines of a grid into tiles, so that a viewer can draw those near it; no crack shows along a cut.

A crack would open where a vertex of one tile lies on an edge of its neighbour. So each vertex on a line of the grid becomes
one of the triangles of both sides, and what is on a line is told after rounding to float32, in which tiles are drawn.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray

__all__ = ["cut_polygons", "grid_lines", "match_borders"]

_Owned: TypeAlias = tuple[NDArray[np.object_], NDArray[np.int64]]
"""Polygons, and the place in the input of the shape that each is a piece of."""


def grid_lines(low: float, high: float, *, spacing: float) -> NDArray[np.float64]:
    """(k,) coordinates from ``low`` to ``high``, evenly and at most ``spacing`` apart; float32 holds them exactly; k >= 2."""
    steps = max(math.ceil((high - low) / spacing), 1)
    return np.linspace(low, high, steps + 1).astype(np.float32).astype(np.float64)


def cut_polygons(
    shapes: NDArray[np.object_], xs: NDArray[np.float64], ys: NDArray[np.float64]
) -> tuple[NDArray[np.object_], NDArray[np.int64], NDArray[np.int64]]:
    """Cut ``shapes`` (n,), polygons or collections of them, along x = ``xs`` and y = ``ys``, sorted, whose ends enclose them.

    Returns polygons (m,), the shape (m,) that each is a piece of, and its tile (m,), counted row by row from the lowest x
    and y; sorted by tile, then by shape. Lines and points that are left of a shape are dropped.
    """
    parts, owners = shapely.get_parts(shapes, return_index=True)
    filled = shapely.area(parts) > 0.0
    columns = _strips((parts[filled], owners[filled]), xs, 0)
    cells = [_strips(column, ys, 1) for column in columns]
    by_row = [column[row] for row in range(len(ys) - 1) for column in cells]
    owners = np.concatenate([one[1] for one in by_row])
    tiles = np.repeat(np.arange(len(by_row)), [len(one[1]) for one in by_row])
    order = np.lexsort((owners, tiles))
    return np.concatenate([one[0] for one in by_row])[order], owners[order], tiles[order]


def match_borders(
    points: NDArray[np.float64], triangles: NDArray[np.int64], xs: NDArray[np.float64], ys: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Make triangles meet vertex to vertex along x = ``xs`` and y = ``ys``, whatever triangulation left out there.

    ``points`` (n, 2), ``triangles`` (m, 3). Points are rounded to float32; triangles that are a line then, or lie on one,
    go; one with an edge along a line is divided where another has a vertex on that edge. Returns all points, new ones at the
    end, the triangles, and for each point the one of ``points`` that it looks like: itself, or a corner of its triangle.
    """
    points = points.astype(np.float32).astype(np.float64)
    corners = points[triangles]
    triangles = triangles[~(corners == np.roll(corners, -1, axis=1)).all(axis=2).any(axis=1)]
    sources = np.arange(len(points))
    for axis, lines in enumerate((xs, ys)):
        line = np.searchsorted(lines, points[:, axis])
        line[lines[np.minimum(line, len(lines) - 1)] != points[:, axis]] = -1
        on = line[triangles]
        flat = (on[:, 0] >= 0) & (on[:, 0] == on[:, 1]) & (on[:, 1] == on[:, 2])
        triangles, on = triangles[~flat], on[~flat]
        # Rank the vertices of all lines by line and then along it: those between two of a line have the ranks between.
        used = np.unique(triangles[on >= 0])
        stops, rank_of_used = np.unique(
            np.column_stack([points[used, axis], points[used, 1 - axis]]), axis=0, return_inverse=True
        )
        rank = np.full(len(points), -1)
        rank[used] = rank_of_used.ravel()
        following = np.roll(triangles, -1, axis=1)
        rows, sides = np.nonzero((on >= 0) & (on == line[following]))
        first, last, apex = (triangles[rows, (sides + k) % 3] for k in range(3))
        split = np.abs(rank[last] - rank[first]) > 1
        rows, first, last, apex = rows[split], first[split], last[split], apex[split]
        added, fans = [], []
        count = len(points)
        for a, b, c in zip(first, last, apex, strict=True):
            step = 1 if rank[b] > rank[a] else -1
            between = np.arange(rank[a] + step, rank[b], step)
            chain = np.concatenate([[a], count + np.arange(len(between)), [b]])
            fans.append(np.column_stack([chain[:-1], chain[1:], np.full(len(chain) - 1, c)]))
            added.append(stops[between][:, [axis, 1 - axis]])
            count += len(between)
        points = np.concatenate([points, *added])
        sources = np.concatenate([sources, np.repeat(sources[first], [len(one) for one in added])])
        triangles = np.concatenate([np.delete(triangles, rows, axis=0), *fans])
    return points, triangles, sources


def _strips(polygons: _Owned, lines: NDArray[np.float64], axis: int) -> list[_Owned]:
    """What of ``polygons`` lies between each of ``lines`` and the next, found by halving: most of them meet few lines."""
    parts, owners = polygons
    if len(lines) == 2 or not len(parts):
        return [polygons] * (len(lines) - 1)
    middle = len(lines) // 2
    bounds = shapely.bounds(parts)
    low, high = bounds[:, axis] < lines[middle], bounds[:, axis + 2] > lines[middle]
    across = low & high
    strips = []
    for side, between in ((low, lines[: middle + 1]), (high, lines[middle:])):
        corners = shapely.total_bounds(parts).reshape(2, 2) + np.array([[-1.0], [1.0]])
        corners[:, axis] = between[[0, -1]]
        cut = shapely.intersection(parts[across], shapely.box(*corners.ravel()))
        pieces, of = shapely.get_parts(cut, return_index=True)
        filled = shapely.area(pieces) > 0.0
        whole = side & ~across
        half = (
            np.concatenate([parts[whole], pieces[filled]]),
            np.concatenate([owners[whole], owners[across][of[filled]]]),
        )
        strips += _strips(half, between, axis)
    return strips
