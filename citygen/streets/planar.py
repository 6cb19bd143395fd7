"""A planar street plan in the making: vertices, the rings of its blocks, and which street each segment belongs to.

The one mutable thing of ``citygen.streets.subdivision``, which decides what is cut; here a cut is carried out so that what
was planar stays planar: a new vertex on a segment is one vertex of both blocks beside it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from shapely.geometry import LineString, Polygon

__all__ = ["Chain", "Cut", "End", "Plan", "Point"]

Point = tuple[float, float]

End = int | tuple[int, int, Point]
"""Where a street starts or ends: a vertex, or (u, v, point): a new vertex on the segment from u to v."""

_Vertex = TypeVar("_Vertex")

_NEAR = 4.0
"""Metres within which a vertex of a street's bend serves as a junction."""


@dataclass(frozen=True, slots=True)
class Cut:
    """A street across a block: its ends and the vertices between."""

    start: End
    stop: End
    between: tuple[Point, ...]


@dataclass(frozen=True, slots=True)
class Chain:
    """A street between two junctions: its vertices, and the number of the cut that made it."""

    vertices: tuple[int, ...]
    street: int


@dataclass(slots=True)
class Plan:
    """``points`` of vertices; ``rings`` of blocks, counter-clockwise; ``neighbours``: vertex -> vertex -> number of the street.

    ``streets`` counts the numbers given out; 0 is the boundary. ``marked`` are junctions of only two streets, and
    ``dead_ends`` the numbers of streets that end in a block.
    """

    points: list[Point] = field(default_factory=list)
    rings: dict[int, list[int]] = field(default_factory=dict)
    neighbours: list[dict[int, int]] = field(default_factory=list)
    left: dict[tuple[int, int], int] = field(default_factory=dict)
    marked: set[int] = field(default_factory=set)
    dead_ends: set[int] = field(default_factory=set)
    streets: int = 0
    faces: int = 0

    @classmethod
    def within(cls, boundary: NDArray[np.float64]) -> Plan:
        """One block: the polygon ``boundary`` (n, 2)."""
        plan = cls()
        ring = [plan._vertex((round(x, 3), round(y, 3))) for x, y in boundary.tolist()]
        plan._add_ring(ring)
        for u, v in pairwise([*ring, ring[0]]):
            plan._connect(u, v, 0)
        plan.streets = 1
        return plan

    def polygon(self, face: int) -> Polygon:
        """The block, to the middle of its streets."""
        return Polygon([self.points[v] for v in self.rings[face]])

    def is_junction(self, vertex: int) -> bool:
        """Whether streets meet or end there, or one street becomes another."""
        return len(self.neighbours[vertex]) != 2 or vertex in self.marked

    def count_junctions(self) -> int:
        """How many nodes the street graph has."""
        return sum(self.is_junction(v) for v in range(len(self.points)))

    def place(self, end: End) -> Point:
        """Where the end lies."""
        return self.points[end] if isinstance(end, int) else end[2]

    def end_at(self, face: int, point: Point, *, snap: float) -> End:
        """The end nearest to ``point`` on the block's ring: a junction within ``snap``, a vertex close by, or a new one."""
        ring = self.rings[face]
        xy = np.array([self.points[v] for v in ring])
        distances = np.hypot(*(xy - point).T)
        order = np.argsort(distances, kind="stable")
        for k in order[: int((distances <= snap).sum())]:
            vertex = ring[int(k)]
            if self.is_junction(vertex) or distances[k] <= _NEAR:
                return vertex
        after = np.roll(xy, -1, axis=0) - xy
        t = np.clip(((point - xy) * after).sum(axis=1) / (after**2).sum(axis=1), 0.0, 1.0)
        feet = xy + t[:, None] * after
        k = int(np.argmin(np.hypot(*(feet - point).T)))
        foot = (round(float(feet[k, 0]), 3), round(float(feet[k, 1]), 3))
        return ring[k], ring[(k + 1) % len(ring)], foot

    def ways(self, face: int, end: End) -> list[Point]:
        """Unit vectors along the two sides of the block that leave from there."""
        if isinstance(end, int):
            ring = self.rings[face]
            k = ring.index(end)
            beside = ring[k - 1], ring[(k + 1) % len(ring)]
        else:
            beside = end[0], end[1]
        return [unit for v in beside if (unit := _unit(self.place(end), self.points[v])) is not None]

    def halves(self, face: int, cut: Cut) -> list[Polygon]:
        """The two blocks that the cut would leave."""
        ring: list[End] = list(self.rings[face])
        for end in (cut.start, cut.stop):
            if not isinstance(end, int):
                ring.insert(ring.index(end[0]) + 1, end)
        one, other = _split(ring, cut.start, cut.stop)
        inner = list(cut.between)
        return [
            Polygon([self.place(v) for v in one] + inner[::-1]),
            Polygon([self.place(v) for v in other] + inner),
        ]

    def cut(self, face: int, cut: Cut) -> tuple[int, int]:
        """Carry the cut out; the numbers of the two blocks."""
        start, stop = self.settle(cut.start), self.settle(cut.stop)
        inner = [self._vertex(point) for point in cut.between]
        one, other = _split(self.rings.pop(face), start, stop)
        street = self.next_street()
        for u, v in pairwise([start, *inner, stop]):
            self._connect(u, v, street)
        return self._add_ring(one + inner[::-1]), self._add_ring(other + inner)

    def settle(self, end: End) -> int:
        """The vertex of an end, made if it is new."""
        if isinstance(end, int):
            return end
        u, v, point = end
        w = self._vertex(point)
        street = self.neighbours[u].pop(v)
        del self.neighbours[v][u]
        self._connect(u, w, street)
        self._connect(w, v, street)
        for a, b in ((u, v), (v, u)):
            face = self.left.pop((a, b), None)
            if face is not None:
                ring = self.rings[face]
                ring.insert(ring.index(a) + 1, w)
                self.left[a, w] = self.left[w, b] = face
        return w

    def add_spur(self, end: End, path: tuple[Point, ...], *, dead_end: bool) -> None:
        """A street from ``end`` that leads nowhere."""
        street = self.next_street()
        if dead_end:
            self.dead_ends.add(street)
        vertices = [self.settle(end), *(self._vertex(point) for point in path)]
        for u, v in pairwise(vertices):
            self._connect(u, v, street)

    def next_street(self) -> int:
        """A number for a new street."""
        self.streets += 1
        return self.streets - 1

    def chains(self) -> list[Chain]:
        """Every street from junction to junction, once."""
        found = []
        for start in range(len(self.points)):
            if not self.is_junction(start):
                continue
            for first, street in self.neighbours[start].items():
                path = [start, first]
                while not self.is_junction(path[-1]):
                    path += [v for v in self.neighbours[path[-1]] if v != path[-2]]
                # From its other end the same street is found again, the other way round.
                if (path[0], path[1]) <= (path[-1], path[-2]):
                    found.append(Chain(tuple(path), street))
        return found

    def line(self, vertices: tuple[int, ...]) -> LineString:
        """The street through these vertices."""
        return LineString([self.points[v] for v in vertices])

    def _vertex(self, point: Point) -> int:
        self.points.append(point)
        self.neighbours.append({})
        return len(self.points) - 1

    def _connect(self, u: int, v: int, street: int) -> None:
        self.neighbours[u][v] = self.neighbours[v][u] = street

    def _add_ring(self, ring: list[int]) -> int:
        face = self.faces
        self.faces += 1
        self.rings[face] = ring
        self.left.update(dict.fromkeys(pairwise([*ring, ring[0]]), face))
        return face


def _split(ring: Sequence[_Vertex], start: _Vertex, stop: _Vertex) -> tuple[list[_Vertex], list[_Vertex]]:
    """The ring from ``start`` to ``stop``, and from there back."""
    i = ring.index(start)
    turned = [*ring[i:], *ring[:i]]
    j = turned.index(stop)
    return turned[: j + 1], [*turned[j:], start]


def _unit(a: Point, b: Point) -> Point | None:
    length = math.dist(a, b)
    return ((b[0] - a[0]) / length, (b[1] - a[1]) / length) if length else None
