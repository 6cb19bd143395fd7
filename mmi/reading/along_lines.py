"""Places along lines: which line a point lies on and how far along it, and the point at a distance, in near-linear time.

What shapely has for this (``line_locate_point``, ``line_interpolate_point``) walks along the whole line for each point, which
takes minutes for as many points on a line as a street of 200,000 corners has.
"""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

__all__ = ["nearest_places", "points_along"]

_BESIDE = 0.2
"""Metres: what lies within this of a line is looked for there only, which is much quicker than the nearest of all lines."""


def nearest_places(
    lines: NDArray[np.object_], points: NDArray[np.object_]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """The line that is nearest to each of the ``points`` (n,), and metres along it to there, both (n,).

    Of several that are equally near it is the first of the ``lines`` (k,), and the first place on that one. Points are quick
    that lie on lines, or nearly so.
    """
    corners, line, along = _measured(lines)
    first = np.flatnonzero((line[1:] == line[:-1]) & (corners[1:] != corners[:-1]).any(axis=1))
    segments = shapely.linestrings(np.stack([corners[first], corners[first + 1]], axis=1))
    tree = shapely.STRtree(segments)
    of, near = tree.query(points, predicate="dwithin", distance=_BESIDE)
    elsewhere = np.setdiff1d(np.arange(len(points)), of)
    which, there = tree.query_nearest(points[elsewhere], all_matches=True)
    of, near = np.r_[of, elsewhere[which]], np.r_[near, there]
    order = np.lexsort((near, shapely.distance(points[of], segments[near]), of))
    nearest = near[order][np.r_[True, np.diff(of[order]) > 0]] if len(of) else near
    start = first[nearest]
    return line[start], along[start] + shapely.line_locate_point(segments[nearest], points)


def points_along(
    lines: NDArray[np.object_], which: NDArray[np.intp], metres: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Points (n, 2) on the lines ``which`` (n,) of ``lines`` (k,), ``metres`` (n,) from their starts; at most at their ends."""
    corners, line, along = _measured(lines)
    last = np.searchsorted(line, np.arange(len(lines)), side="right") - 1
    # One scale for all lines, a metre between the end of one and the start of the next.
    starts = np.cumsum(along[last] + 1.0) - (along[last] + 1.0)
    at = starts[which] + np.clip(metres, 0.0, along[last[which]])
    return np.column_stack([np.interp(at, starts[line] + along, corners[:, axis]) for axis in (0, 1)])


def _measured(lines: NDArray[np.object_]) -> tuple[NDArray[np.float64], NDArray[np.intp], NDArray[np.float64]]:
    """The corners (m, 2) of all lines, the line that each belongs to (m,), and metres along it to there (m,)."""
    corners, line = shapely.get_coordinates(lines, return_index=True)
    same = line[1:] == line[:-1]
    total = np.r_[0.0, np.cumsum(np.where(same, np.hypot(*np.diff(corners, axis=0).T), 0.0))]
    return corners, line, total - total[np.searchsorted(line, line)]
