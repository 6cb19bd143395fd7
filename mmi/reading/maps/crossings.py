"""How often edges of outlines and streets cross, told before they go to geometry whose time and memory grow with that.

``make_valid`` finds all crossings of an outline: of a scribble of 2,000 points half a million, which takes half a minute and a
gigabyte. Whether an outline is valid takes as long where its edges lie beside one another (a comb of 10,000 slanting teeth).
Honest outlines cross themselves a few times, where somebody slipped. Streets that do not share nodes are joined where they
cross, and a thousand straight lanes at random cross a hundred thousand times.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from mmi import limits

__all__ = ["Tangles", "streets_tangled"]

_AT_ONCE = 1_000_000
"""Pairs of edges that are looked at together, at most (tens of MB)."""


class Tangles:
    """What tells outlines that are too intricate to be mended, and counts what it found in all of those that it let pass."""

    __slots__ = ("_compared", "_crossings")

    def __init__(self) -> None:
        self._crossings = self._compared = 0

    def why(self, shape: BaseGeometry) -> str | None:
        """Why an outline of any kind is not to be mended, in words for a report; None where it is."""
        corners, line = _corners(shape)
        if len(corners) > limits.OUTLINE_POINTS:
            return f"an outline of more than {limits.OUTLINE_POINTS:,} points"
        most = min(limits.CROSSINGS, limits.CROSSINGS_A_POINT * len(corners))
        starts, ends = _edges(corners, line)
        if self._compared > limits.EDGES_COMPARED_IN_ALL:
            return "an outline after too many edges side by side in others"
        found = _look(starts, ends, most=most, compared=limits.EDGES_COMPARED)
        self._compared += found.compared
        if found.crossings > most:
            return "an outline that crosses itself over and over"
        if found.compared > limits.EDGES_COMPARED:
            return "an outline with too many edges side by side"
        if self._crossings + found.crossings > limits.CROSSINGS_IN_ALL:
            return f"an outline that crosses itself, after {limits.CROSSINGS_IN_ALL:,} crossings of others"
        self._crossings += found.crossings
        return None


def streets_tangled(lines: NDArray[np.object_]) -> bool:
    """Whether lines (n,) cross themselves and each other too often to be joined there (``limits.STREET_CROSSINGS``)."""
    starts, ends = _edges(*shapely.get_coordinates(lines, return_index=True))
    most = max(limits.STREET_CROSSINGS, len(starts))
    compared = max(limits.STREET_EDGES_COMPARED, 100 * len(starts))
    found = _look(starts, ends, most=most, compared=compared)
    return found.crossings > most or found.compared > compared


def _edges(corners: NDArray[np.float64], line: NDArray[np.intp]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Starts and ends (m, 2) of the edges of lines; of the corners (n, 2) each belongs to a ``line`` (n,)."""
    first = np.flatnonzero((line[1:] == line[:-1]) & (corners[1:] != corners[:-1]).any(axis=1))
    return corners[first], corners[first + 1]


class _Found(NamedTuple):
    """How many pairs of edges cross, and how many were looked at as their boxes overlap."""

    crossings: int
    compared: int


def _look(starts: NDArray[np.float64], ends: NDArray[np.float64], *, most: int, compared: int) -> _Found:
    """What there is of edges from ``starts`` to ``ends`` (n, 2), until that is more than ``most`` or ``compared``."""
    if len(starts) < 3:
        return _Found(0, 0)
    edges = shapely.linestrings(np.stack([starts, ends], axis=1))
    tree = shapely.STRtree(edges)
    step = max(1, _AT_ONCE // len(edges))
    looked_at = crossings = 0
    for begin in range(0, len(edges), step):
        a, b = tree.query(edges[begin : begin + step])
        a += begin
        a, b = a[a < b], b[a < b]
        looked_at += len(a)
        crossings += _crossing(starts, ends, a, b)
        if crossings > most or looked_at > compared:
            break
    return _Found(crossings, looked_at)


def _corners(shape: BaseGeometry) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """The corners (n, 2) of all rings of a geometry, and the ring that each belongs to (n,)."""
    parts = shapely.get_parts([shape])
    while (shapely.get_type_id(parts) >= 4).any():  # collections of collections
        parts = shapely.get_parts(parts)
    return shapely.get_coordinates(shapely.get_rings(parts[shapely.get_type_id(parts) == 3]), return_index=True)


def _crossing(starts: NDArray[np.float64], ends: NDArray[np.float64], a: NDArray[np.intp], b: NDArray[np.intp]) -> int:
    """How many of the pairs ``a``, ``b`` (n,) of edges (m, 2) meet elsewhere than in a common corner. Their boxes overlap."""
    for _ in range(2):  # the ends of each lie on both sides of the other
        sides = [_turn(starts[a], ends[a], corners[b]) for corners in (starts, ends)]
        near = sides[0] * sides[1] <= 0.0
        a, b = b[near], a[near]
    joined = [(p[a] == q[b]).all(axis=1) for p in (starts, ends) for q in (starts, ends)]
    return int((~np.any(joined, axis=0)).sum())


def _turn(a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]) -> NDArray[np.float64]:
    """The sign that tells on which side of the line from ``a`` to ``b`` a point ``c`` is, all (n, 2)."""
    (ux, uy), (vx, vy) = (b - a).T, (c - a).T
    return np.sign(ux * vy - uy * vx)
