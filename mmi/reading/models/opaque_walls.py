"""Upright walls of a mesh that let no sight through: from the ground up to which height, stretch by stretch of the map.

Triangles that stand upright on one line of the map are one wall, whoever they belong to and whichever way they face. Between
two neighbouring corners of its triangles a wall is a *stretch*: there every triangle's edges are straight, so that what lies
on one another without a gap is told from both ends alone. A stretch is closed from the ground up to where the first gap begins.
Windows that are holes, arcades and walls that hang in the air end it low; triangles that cross, or are there twice, do no harm.

Coordinates are rounded to the millimetre, and corners that should lie on a line are off it by as much. So walls are as thick as
``_FLAT``, and cracks that are narrower than a centimetre do not count as open.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from mmi.foundation.kernels import kernel

__all__ = ["Stretches", "opaque_stretches"]

_FLAT = 2e-3
"""Metres: an upright triangle is no wider than this on the map, and no farther from the line of its wall."""
_CRACK = 2e-3
"""Metres between the edges of triangles that lie on one another, or side by side, at most."""
_GAP = 5e-3
"""Metres between the end of a wall and another wall, at most, that are closed."""
_FOOT = 0.05
"""Metres that a wall may begin above the ground and still stand on it: buildings are let down to where it was looked at."""
_SHORT = 0.01
"""Metres: shorter triangles belong to no wall."""
_SAMPLE = 1.0
"""Metres between places of a wall where the ground is looked at."""


class _Wall(NamedTuple):
    """Upright triangles on one line of the map, from ``origin`` (2,) in a ``direction`` (2,) of length 1: their corners are at
    ``s`` metres along it and ``z`` high (m, 3). Stretches are between the places ``at`` (n + 1,), sorted.
    """

    origin: NDArray[np.float64]
    direction: NDArray[np.float64]
    at: NDArray[np.float64]
    s: NDArray[np.float64]
    z: NDArray[np.float64]


class Stretches(NamedTuple):
    """``ends`` (n, 2, 2) metres on the map; ``tops`` (n,) heights up to which nothing shows through from the ground up."""

    ends: NDArray[np.float64]
    tops: NDArray[np.float64]

    @property
    def lines(self) -> NDArray[np.object_]:
        """(n,) the stretches as lines."""
        return np.asarray(shapely.linestrings(self.ends), dtype=object)


def opaque_stretches(
    corners: NDArray[np.float64], ground: Callable[[NDArray[np.float64]], NDArray[np.float64]], *, least: float
) -> Stretches:
    """The stretches of the walls among triangles of ``corners`` (m, 3, 3) that are closed for ``least`` metres or more.

    ``ground`` tells how high it lies at points (n, 2).
    """
    corners, base, along = _upright(corners)
    walls: list[_Wall] = []
    for rows, origin, direction in _rows_of_walls(corners, base, along):
        s = (corners[rows, :, :2] - origin) @ direction
        at = np.unique(s)
        at = at[np.diff(at, prepend=-np.inf) > _CRACK]
        if len(at) > 1:
            walls.append(_Wall(origin, direction, at, s, corners[rows, :, 2]))
    if not walls:
        return Stretches(np.empty((0, 2, 2)), np.empty(0))
    begins = np.concatenate([one.origin + one.at[:-1, None] * one.direction for one in walls])
    finishes = np.concatenate([one.origin + one.at[1:, None] * one.direction for one in walls])
    lowest = _lowest_ground(begins, finishes, ground)
    ends, tops = [], []
    cuts = np.cumsum([len(one.at) - 1 for one in walls])[:-1]
    for one, foot in zip(walls, np.split(lowest, cuts), strict=True):
        closed = _closed_up_to(one.s, one.z, one.at, foot + _FOOT)
        high = closed >= foot + least
        span = np.stack([one.at[:-1], one.at[1:]], axis=1)[high]
        ends.append(one.origin + span[..., None] * one.direction)
        tops.append(closed[high])
    return _joined(Stretches(np.concatenate(ends), np.concatenate(tops)))


def _joined(walls: Stretches) -> Stretches:
    """The stretches, and what closes the gaps between their ends and others: as high as you like."""
    points = walls.ends.reshape(-1, 2)
    lines = walls.lines
    end, line = shapely.STRtree(lines).query(shapely.points(points), predicate="dwithin", distance=_GAP)
    foreign = end // 2 != line
    joints = shapely.get_coordinates(shapely.shortest_line(shapely.points(points[end[foreign]]), lines[line[foreign]]))
    joints = joints.reshape(-1, 2, 2)
    joints = joints[np.abs(joints[:, 0] - joints[:, 1]).max(axis=1, initial=0.0) > 0.0]
    return Stretches(np.concatenate([walls.ends, joints]), np.append(walls.tops, np.full(len(joints), np.inf)))


def _upright(
    corners: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """The triangles (k, 3, 3) that stand upright, longest on the map first; where their longest sides begin, and what they span
    (k, 2).
    """
    plan = corners[:, :, :2]
    sides = np.roll(plan, -1, axis=1) - plan
    lengths = np.hypot(sides[..., 0], sides[..., 1])
    longest = lengths.argmax(axis=1)
    rows = np.arange(len(corners))
    length = lengths[rows, longest]
    doubled = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    tall = np.ptp(corners[:, :, 2], axis=1) > _FLAT
    chosen = np.flatnonzero((doubled <= _FLAT * length) & (length > _SHORT) & tall)
    chosen = chosen[np.argsort(-length[chosen], kind="stable")]
    at = longest[chosen]
    return corners[chosen], plan[chosen, at], sides[chosen, at]


def _rows_of_walls(
    corners: NDArray[np.float64], base: NDArray[np.float64], along: NDArray[np.float64]
) -> list[tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]]:
    """The triangles of each wall, a point of its line, and the line's direction (of length 1).

    Where a wall bends by next to nothing, slivers at the bend are of both lines.
    """
    count = len(corners)
    if not count:
        return []
    lines = shapely.linestrings(np.stack([base, base + along], axis=1))
    one, other = shapely.STRtree(lines).query(lines, predicate="dwithin", distance=_FLAT)
    order = np.argsort(one, kind="stable")
    starts = np.searchsorted(one[order], np.arange(count + 1))
    beside = other[order]
    free = np.ones(count, dtype=bool)
    unit = along / np.hypot(*along.T)[:, None]
    found = []
    for seed in range(count):
        if not free[seed]:
            continue
        members, reached = np.array([seed]), np.array([seed])
        while len(reached):
            near = np.unique(np.concatenate([beside[starts[i] : starts[i + 1]] for i in reached.tolist()]))
            near = near[~np.isin(near, members)]
            away = corners[near, :, :2] - base[seed]
            off = np.abs(away[..., 0] * unit[seed, 1] - away[..., 1] * unit[seed, 0]).max(axis=1, initial=0.0)
            reached = near[off <= _FLAT]
            members = np.concatenate([members, reached])
        free[members] = False
        found.append((members, base[seed], unit[seed]))
    return found


def _lowest_ground(
    begins: NDArray[np.float64],
    finishes: NDArray[np.float64],
    ground: Callable[[NDArray[np.float64]], NDArray[np.float64]],
) -> NDArray[np.float64]:
    """(n,) the lowest ground along each stretch between points ``begins`` and ``finishes`` (n, 2)."""
    counts = np.maximum(np.ceil(np.hypot(*(finishes - begins).T) / _SAMPLE).astype(np.int64), 1) + 1
    starts = np.cumsum(counts) - counts
    of = np.repeat(np.arange(len(counts)), counts)
    share = (np.arange(len(of)) - starts[of]) / (counts[of] - 1)
    heights = ground(begins[of] + share[:, None] * (finishes - begins)[of])
    return np.asarray(np.minimum.reduceat(heights, starts))


@kernel(error_model="numpy")
def _closed_up_to(
    s: NDArray[np.float64], z: NDArray[np.float64], at: NDArray[np.float64], ground: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n - 1,) for each stretch between places ``at`` (n,) of a wall, the height up to which its triangles, of corners ``s``
    along it and heights ``z`` (m, 3), leave no gap above the ``ground`` (n - 1,).
    """
    top = np.empty(len(at) - 1)
    low, high = np.empty((len(s), 2)), np.empty((len(s), 2))
    for i in range(len(top)):
        count = 0
        for t in range(len(s)):
            first, last = s[t].min(), s[t].max()
            if first > at[i] + _CRACK or last < at[i + 1] - _CRACK:
                continue
            for end in range(2):
                place = min(max(at[i + end], first), last)
                low[count, end], high[count, end] = np.inf, -np.inf
                for k in range(3):
                    a, b = s[t, k], s[t, (k + 1) % 3]
                    if min(a, b) <= place <= max(a, b):
                        if a == b:
                            p, q = z[t, k], z[t, (k + 1) % 3]
                        else:
                            p = z[t, k] + (place - a) / (b - a) * (z[t, (k + 1) % 3] - z[t, k])
                            q = p
                        low[count, end] = min(low[count, end], p, q)
                        high[count, end] = max(high[count, end], p, q)
            count += 1
        top[i] = ground[i]
        for start in range(-1, count):  # from the ground up, or from the foot of a triangle that begins below it
            at_first, at_last = ground[i], ground[i]
            if start >= 0:
                if low[start, 0] > ground[i] or low[start, 1] > ground[i]:
                    continue
                at_first, at_last = low[start]
            # What a triangle covers that begins no higher than what is closed already is closed up to its upper edge.
            while True:
                best, most = -1, at_first + at_last + 1e-6
                for t in range(count):
                    # A crack along a steep edge is higher than it is wide.
                    crack = _CRACK * math.hypot(1.0, (low[t, 1] - low[t, 0]) / (at[i + 1] - at[i]))
                    above = low[t, 0] > at_first + crack or low[t, 1] > at_last + crack
                    if not above and high[t, 0] + high[t, 1] > most:
                        best, most = t, high[t, 0] + high[t, 1]
                if best < 0:
                    break
                at_first, at_last = high[best]
                top[i] = max(top[i], min(at_first, at_last))
    return top
