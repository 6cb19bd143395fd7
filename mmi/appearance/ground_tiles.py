"""The plane cut along the lines of a grid into tiles, so that a viewer can draw those near it; no crack shows along a cut.

A crack would open where a vertex of one tile lies on an edge of its neighbour. So each vertex on a line of the grid becomes one
of the triangles of both sides, and whether it lies on a line is decided after rounding to float32, in which tiles are drawn.
"""

from __future__ import annotations

import math

import numpy as np
import shapely
from numpy.typing import NDArray

__all__ = ["grid_lines", "match_borders", "tile_boxes"]


def grid_lines(low: float, high: float, *, spacing: float) -> NDArray[np.float64]:
    """(k,) coordinates from ``low`` to ``high``, evenly and at most ``spacing`` apart; float32 holds them exactly; k >= 2."""
    steps = max(math.ceil((high - low) / spacing), 1)
    return np.linspace(low, high, steps + 1).astype(np.float32).astype(np.float64)


def tile_boxes(xs: NDArray[np.float64], ys: NDArray[np.float64]) -> NDArray[np.object_]:
    """The rectangles (tiles,) between the lines x = ``xs`` and y = ``ys``, sorted: row by row from the lowest x and y."""
    low, high = (np.meshgrid(x, y) for x, y in ((xs[:-1], ys[:-1]), (xs[1:], ys[1:])))
    return shapely.box(low[0].ravel(), low[1].ravel(), high[0].ravel(), high[1].ravel())


def match_borders(
    points: NDArray[np.float64], triangles: NDArray[np.int64], xs: NDArray[np.float64], ys: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Make triangles meet vertex to vertex along x = ``xs`` and y = ``ys``, whatever triangulation left out there.

    ``points`` (n, 2), ``triangles`` (m, 3). Points are rounded to float32; triangles that are a line then, or lie on one, are
    left out; a triangle with an edge along a line is divided where another has a vertex on that edge. Returns all points (new
    ones at the end), the triangles, and for each point the one of ``points`` that it looks like: itself, or a corner of its
    triangle.
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
