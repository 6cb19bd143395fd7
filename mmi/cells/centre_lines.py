"""Centre lines of streets as straight pieces: chords within a tolerance, and equal parts of them.

Pieces end at joints: numbers that ends which meet each other have in common.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from mmi.city.model import City
from mmi.foundation.errors import CityError

__all__ = [
    "CHORD_TOLERANCE",
    "MERGE_TOLERANCE",
    "SHORT_PIECE",
    "Piece",
    "Street",
    "chords_of",
    "length_of",
    "pieces_along",
    "split_evenly",
    "streets_of",
]

CHORD_TOLERANCE = 0.5
"""Metres: a street is nowhere farther than this from the chord that replaces it."""
MERGE_TOLERANCE = 1.0
"""Metres: it may be this far from it where that avoids a piece shorter than ``SHORT_PIECE``."""
SHORT_PIECE = 5.0
"""Metres: a shorter piece is merged with its neighbour in the street, if that is possible."""


@dataclass(frozen=True, slots=True, eq=False)
class Street:
    """``points`` (n, 2) is the centre line without repeated points, from the joint ``start`` to the joint ``end``."""

    index: int
    points: NDArray[np.float64]
    start: int
    end: int
    half_width: float
    name: str


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """Part of a street: ``points`` (n, 2) of the centre line; the chord from first to last point stands for them.

    ``start`` and ``end`` are joints: numbers that ends which meet each other have in common.
    """

    street: Street
    points: NDArray[np.float64]
    start: int
    end: int

    @property
    def chord(self) -> NDArray[np.float64]:
        """(2, 2) first and last point."""
        return self.points if len(self.points) == 2 else self.points[[0, -1]]


def streets_of(city: City) -> list[Street]:
    """The city's streets by index, each from the joint of one node to that of the other."""
    edges = list(city.streets.edges(data=True))
    for _, _, edge in edges:
        width = edge.get("half_width", math.nan)
        if not (math.isfinite(width) and width > 0.0):
            raise CityError(f"{city.source}: street {edge['index']} needs a positive half_width, found {width!r}")
    joint = {node: i for i, node in enumerate(city.streets.nodes)}
    at = np.array([(data["x"], data["y"]) for _, data in city.streets.nodes(data=True)]).reshape(-1, 2)
    ends = np.array([(joint[a], joint[b]) for a, b, _ in edges], dtype=np.int64).reshape(-1, 2)
    points, of = shapely.get_coordinates([edge["geometry"] for _, _, edge in edges], return_index=True)
    new = np.ones(len(points), dtype=bool)
    new[1:] = (of[1:] != of[:-1]) | (points[1:] != points[:-1]).any(axis=1)
    points, of = points[new], of[new]
    bounds = np.searchsorted(of, np.arange(len(edges) + 1))
    first, last = points[bounds[:-1]], points[bounds[1:] - 1]
    a, b = at[ends[:, 0]], at[ends[:, 1]]
    forward = np.hypot(*(first - a).T) + np.hypot(*(last - b).T)
    backward = np.hypot(*(first - b).T) + np.hypot(*(last - a).T)
    ends = np.where((forward <= backward)[:, None], ends, ends[:, ::-1])
    streets = [
        Street(edge["index"], points[low:high], start, end, edge["half_width"], edge.get("name", ""))
        for (_, _, edge), (low, high), (start, end) in zip(
            edges, itertools.pairwise(bounds.tolist()), ends.tolist(), strict=True
        )
    ]
    return sorted(streets, key=lambda street: street.index)


def chords_of(street: Street, joints: Iterator[int]) -> list[Piece]:
    """The street as chords within tolerance of its centre line, short ones merged where that stays so."""
    if len(street.points) == 2:
        return [Piece(street, street.points, street.start, street.end)]
    kept = _simplified(street.points, CHORD_TOLERANCE)
    while True:
        candidates = []
        lengths = np.hypot(*np.diff(street.points[kept], axis=0).T)
        for i in np.flatnonzero(lengths < SHORT_PIECE):
            for bend in {int(i), int(i) + 1} - {0, len(kept) - 1}:
                a, b = kept[bend - 1], kept[bend + 1]
                leave = _distances(street.points[a : b + 1], street.points[a], street.points[b]).max()
                if leave <= MERGE_TOLERANCE and np.any(street.points[a] != street.points[b]):
                    candidates.append((leave, bend))
        if not candidates:
            break
        del kept[min(candidates)[1]]
    return pieces_along(
        street, [street.points[a : b + 1] for a, b in itertools.pairwise(kept)], street.start, street.end, joints
    )


def pieces_along(
    street: Street, runs: list[NDArray[np.float64]], start: int, end: int, joints: Iterator[int]
) -> list[Piece]:
    """Pieces one after the other from joint ``start`` to joint ``end``, with new joints between them."""
    between = [start, *itertools.islice(joints, len(runs) - 1), end]
    return [Piece(street, run, *ends) for run, ends in zip(runs, itertools.pairwise(between), strict=True)]


def _simplified(points: NDArray[np.float64], tolerance: float) -> list[int]:
    """Indices of those ``points`` (n, 2) whose polyline no other point leaves by more than ``tolerance`` metres."""
    kept = {0, len(points) - 1}
    stack = [(0, len(points) - 1)]
    while stack:
        a, b = stack.pop()
        if b - a < 2:
            continue
        leave = _distances(points[a + 1 : b], points[a], points[b])
        worst = int(np.argmax(leave))
        # A loop's two ends are one point: a chord needs a length, however small the loop.
        if leave[worst] > tolerance or not np.any(points[a] != points[b]):
            middle = a + 1 + worst
            kept.add(middle)
            stack += [(a, middle), (middle, b)]
    return sorted(kept)


def _distances(points: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) distances of ``points`` (n, 2) from the segment ``a`` to ``b``, metres."""
    along = b - a
    square = float(along @ along)
    t = np.clip((points - a) @ along / square, 0.0, 1.0) if square > 0.0 else np.zeros(len(points))
    return np.hypot(*(points - a - t[:, None] * along).T)


def length_of(points: NDArray[np.float64]) -> float:
    """Metres along ``points`` (n, 2)."""
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def split_evenly(piece: Piece, n: int, joints: Iterator[int]) -> list[Piece]:
    """A chord in ``n`` equal parts."""
    if n == 1:
        return [Piece(piece.street, piece.chord, piece.start, piece.end)]
    a, b = piece.chord
    stops = a + np.linspace(0.0, 1.0, n + 1)[:, None] * (b - a)
    stops[-1] = b
    return pieces_along(piece.street, [stops[k : k + 2] for k in range(n)], piece.start, piece.end, joints)
