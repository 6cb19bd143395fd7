"""Tours: walks made along the streets of whatever cells there are, to measure and to show without recording a path first.

    cells, neighbours -> which ends meet -> a route: legs of cells, each with the end that it is entered by -> keyframes

The route follows the axes of cells, joint by joint, and jumps only where everything that can be reached was visited.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from mmi.cells.viewing_cells import ViewingCell
from mmi.foundation.errors import ParameterError
from mmi.walks.walk import Keyframe, Pose, Walk

__all__ = ["tour"]

_MEETING = 2.5
"""Metres that may lie between ends of neighbours that meet: cells that buildings cut short are up to 2 m apart."""
_SAME = 0.1
"""Metres below which ends that meet are one point of the path."""
_SPACING = 0.01
"""Metres that keyframes keep from each other at least."""
_ROUNDING = 2.0
"""The camera turns over this many metres before and after a corner, or over half of the cell where that is less."""
_BEND = math.radians(1.0)
"""Turns below this are no corners."""
_ABOUT_FACE = 2.0
"""Seconds that turning round at a dead end takes."""
_FASTEST = 100.0
"""Metres a second."""

_End = tuple[int, int]
"""A cell's index, and 0 for its end p, 1 for q."""


@dataclass(frozen=True, slots=True, eq=False)
class _Streets:
    """Cells as ends that meet.

    ``points`` (n, 2, 3) are the ends p and q at the middle of the eye band. ``ends`` has an edge between the two ends of
    each cell and between ends of cells that meet. ``rank`` is a random order of the ends, for choosing among equals.
    """

    points: NDArray[np.float64]
    ends: nx.Graph
    rank: Mapping[_End, int]

    def length(self, cell: int) -> float:
        """Metres from p to q."""
        return self.apart((cell, 0), (cell, 1))

    def apart(self, a: _End, b: _End) -> float:
        """Metres between two ends."""
        return math.dist(self.points[a], self.points[b])

    def nearest(self, away: NDArray[np.float64]) -> _End:
        """The end with the least of these (n, 2) metres; micrometres make no difference."""
        rounded = np.round(away, 6)
        nearest = [(cell, end) for cell, end in np.argwhere(rounded == rounded.min()).tolist()]
        return min(nearest, key=lambda end: self.rank[end])

    def heading(self, entry: _End) -> float:
        """The azimuth in which a cell is walked that is entered by this end."""
        x, y, _ = self.points[_opposite(entry)] - self.points[entry]
        return math.atan2(y, x)


@dataclass(frozen=True, slots=True, eq=False)
class _Stretch:
    """A straight part of the path: the axis of ``cell`` from ``start`` to ``end`` (3,), walked looking along ``heading``."""

    cell: int
    start: NDArray[np.float64]
    end: NDArray[np.float64]
    heading: float

    @property
    def length(self) -> float:
        """Metres."""
        return math.dist(self.start, self.end)

    @property
    def rounding(self) -> float:
        """Metres at either end over which the camera turns."""
        return min(_ROUNDING, 0.5 * self.length)


@dataclass(frozen=True, slots=True)
class _Corner:
    """Between two stretches: the camera turns by ``turn`` from ``before`` metres before it to ``after`` metres behind it.

    ``gap`` metres lie between the stretches. At a dead end it turns in place instead, ``about_face``.
    """

    turn: float
    before: float
    gap: float
    after: float
    about_face: bool

    def turned(self, distance: float) -> float:
        """How much of the turn is done ``distance`` metres behind the first stretch's end, smoothly from none to all."""
        if self.about_face:
            return 0.0
        t = (distance + self.before) / (self.before + self.gap + self.after)
        t = min(max(t, 0.0), 1.0)
        return self.turn * t * t * (3.0 - 2.0 * t)


_NO_CORNER = _Corner(0.0, 1.0, 0.0, 1.0, about_face=False)


def tour(
    cells: Sequence[ViewingCell],
    neighbours: Mapping[str, Sequence[str]],
    *,
    metres: float = 300.0,
    speed: float = 5.0,
    seed: int = 0,
) -> Walk:
    """A walk along the axes of ``cells``, at most ``metres`` long, at ``speed`` (metres a second).

    ``neighbours`` maps ids of cells to those of cells that they meet; ids that no cell has are ignored. The tour starts in
    the middle of the longest connected part of the streets. At each joint it goes where it was least often, if there is a
    choice straight on, and turns round only at dead ends. Where all of a part was visited it jumps to the nearest other
    one; where all cells were visited it ends, however long it is. ``seed`` decides between equals. Eyes are in the middle
    of the eye band and look ahead, level; at corners the path goes through the joint, and the camera turns over 4 m.

    Raises ParameterError for no cells, and for numbers without meaning.
    """
    if not cells:
        raise ParameterError("cells to walk through expected, found none")
    if not (math.isfinite(metres) and metres > 0.0):
        raise ParameterError(f"a tour of more than 0 m expected, found {metres!r}")
    if not 0.0 < speed <= _FASTEST:
        raise ParameterError(f"a speed above 0 and up to {_FASTEST:g} m/s expected, found {speed!r}")
    if seed < 0:
        raise ParameterError(f"a seed of at least 0 expected, found {seed}")
    streets = _streets(cells, neighbours, np.random.default_rng(seed))
    keyframes: list[Keyframe] = []
    for leg in _route(streets, metres):
        start = keyframes[-1].time if keyframes else 0.0
        track = list(_track(_stretches(streets, leg), speed))
        keyframes += [_keyframe(start + time, eye, azimuth, cut=i == 0) for i, (time, eye, azimuth) in enumerate(track)]
    keyframes[0] = Keyframe(0.0, keyframes[0].pose)
    return Walk(f"tour of {metres:g} m, seed {seed}", tuple(_shortened(keyframes, metres)))


# -------------------------------------------------------------------------------------------------------- the route


def _streets(
    cells: Sequence[ViewingCell], neighbours: Mapping[str, Sequence[str]], rng: np.random.Generator
) -> _Streets:
    points = np.array([[(*end, 0.5 * sum(cell.eye_at(t))) for t, end in enumerate((cell.p, cell.q))] for cell in cells])
    ends = nx.Graph()
    for i in range(len(cells)):
        ends.add_edge((i, 0), (i, 1))
    places = {cell.id: i for i, cell in enumerate(cells)}
    pairs = {
        (min(i, places[name]), max(i, places[name]))
        for i, cell in enumerate(cells)
        for name in neighbours.get(cell.id, ())
        if name in places and places[name] != i
    }
    for i, j in sorted(pairs):
        choices = {((i, a), (j, b)): math.dist(points[i, a], points[j, b]) for a in (0, 1) for b in (0, 1)}
        limit = min(_MEETING, max(min(choices.values()), _SAME))
        ends.add_edges_from(pair for pair, apart in choices.items() if apart <= limit)
    order = rng.permutation(2 * len(cells)).tolist()
    return _Streets(points, ends, {(place // 2, place % 2): rank for rank, place in enumerate(order)})


def _route(streets: _Streets, metres: float) -> Iterator[list[_End]]:
    """The legs of a tour of at least ``metres``, or of all cells: in each the ends by which cells are entered, in order.

    Where a cell is followed by itself the tour turns round.
    """
    parts = [{cell for cell, _ in part} for part in nx.connected_components(streets.ends)]
    part_of = {cell: part for part in parts for cell in part}
    reached = np.zeros(len(streets.points), dtype=bool)
    visits = [0] * len(streets.points)
    entry = _start(streets, parts)
    left = metres
    while True:
        waiting = part_of[entry[0]]
        reached[list(waiting)] = True
        leg: list[_End] = []
        while True:
            leg.append(entry)
            visits[entry[0]] += 1
            waiting.discard(entry[0])
            left -= streets.length(entry[0])
            if left <= 0.0 or not waiting:
                break
            way_out = _opposite(entry)
            entry = _onwards(streets, entry, visits)
            left -= streets.apart(way_out, entry)
        yield leg
        if left <= 0.0 or reached.all():
            return
        away = np.linalg.norm(streets.points - streets.points[_opposite(entry)], axis=2)
        away[reached] = np.inf
        entry = streets.nearest(away)


def _start(streets: _Streets, parts: list[set[int]]) -> _End:
    """An end of the cell in the middle of the longest part."""

    def size(part: set[int]) -> tuple[float, int]:
        return -round(sum(streets.length(i) for i in part), 6), min(
            streets.rank[i, end] for i in part for end in (0, 1)
        )

    longest = min(parts, key=size)
    middles = streets.points.mean(axis=1)
    cells = list(longest)
    centre = np.average(middles[cells], axis=0, weights=[streets.length(i) for i in cells])
    away = np.full(len(middles), np.inf)
    away[cells] = np.linalg.norm(middles[cells] - centre, axis=1)
    return streets.nearest(np.stack([away, away], axis=1))


def _onwards(streets: _Streets, entry: _End, visits: Sequence[int]) -> _End:
    """The cell, and its end, by which a tour goes on that entered a cell by ``entry`` and leaves it by the other end."""
    way_out = _opposite(entry)
    choices = [end for end in streets.ends[way_out] if end[0] != entry[0]]

    def merit(choice: _End) -> tuple[int, float, int]:
        turn = math.remainder(streets.heading(choice) - streets.heading(entry), math.tau)
        return visits[choice[0]], round(abs(turn), 3), streets.rank[choice]

    return min(choices, key=merit) if choices else way_out


def _opposite(end: _End) -> _End:
    return end[0], 1 - end[1]


# ---------------------------------------------------------------------------------------------------- the keyframes


def _stretches(streets: _Streets, leg: list[_End]) -> list[_Stretch]:
    """The straight parts of a leg; ends that all but coincide are drawn together."""
    lines = np.array([(streets.points[entry], streets.points[_opposite(entry)]) for entry in leg])
    for before, after in itertools.pairwise(lines):
        if math.dist(before[1], after[0]) < _SAME:
            before[1] = after[0] = 0.5 * (before[1] + after[0])
    return [
        _Stretch(entry[0], start, end, streets.heading(entry)) for (start, end), entry in zip(lines, leg, strict=True)
    ]


def _track(stretches: list[_Stretch], speed: float) -> Iterator[tuple[float, NDArray[np.float64], float]]:
    """(seconds, eye (3,), azimuth) of the keyframes along a leg.

    Between keyframes at constant speed on a line, a monotone cubic has constant speed. It slows down only next to those at
    corners and dead ends, so there are others close to these.
    """
    corners = [_NO_CORNER, *itertools.starmap(_corner, itertools.pairwise(stretches)), _NO_CORNER]
    time, here = 0.0, stretches[0].start
    first = True
    for stretch, (behind, ahead) in zip(stretches, itertools.pairwise(corners), strict=True):
        length = stretch.length
        stops = {0.0, length}
        if abs(behind.turn) > _BEND:
            stops |= {0.5 * behind.after, behind.after}
        if abs(ahead.turn) > _BEND:
            stops |= {length - 0.5 * ahead.before, length - ahead.before}
        spots = [(stretch.start + stop / length * (stretch.end - stretch.start), stop) for stop in sorted(stops)]
        if behind.gap > _SAME:  # close to its ends, for the path to cross it straight
            across = stretch.start - here
            spots = [(here + share * across, (share - 1.0) * behind.gap) for share in (0.25, 0.75)] + spots
        for eye, stop in spots:
            away = math.dist(here, eye)
            if not first and away < _SPACING:
                continue
            time, here, first = time + away / speed, eye, False
            left = 0.0 if behind.about_face else behind.turn - behind.turned(behind.gap + stop)
            yield time, here, stretch.heading - left + ahead.turned(stop - length)
        if ahead.about_face:
            yield time + 0.5 * _ABOUT_FACE, here, stretch.heading + 0.5 * math.pi
            yield time + _ABOUT_FACE, here, stretch.heading + math.pi
            time += _ABOUT_FACE


def _corner(before: _Stretch, after: _Stretch) -> _Corner:
    turn = math.remainder(after.heading - before.heading, math.tau)
    gap = math.dist(before.end, after.start)
    return _Corner(turn, before.rounding, gap, after.rounding, about_face=before.cell == after.cell)


def _keyframe(time: float, eye: Sequence[float] | NDArray[np.float64], azimuth: float, *, cut: bool) -> Keyframe:
    """A keyframe whose numbers are short in a file: rounded to micrometres, microseconds and millionths of a degree."""
    x, y, z = (round(float(value), 6) for value in eye)
    degrees = round(math.degrees(math.remainder(azimuth, math.tau)), 6)
    return Keyframe(round(time, 6), Pose((x, y, z), math.radians(degrees), 0.0), cut)


def _shortened(keyframes: Sequence[Keyframe], metres: float) -> Iterator[Keyframe]:
    """The keyframes of the first ``metres``, the last of them perhaps a new one."""
    yield keyframes[0]
    left = metres
    for a, b in itertools.pairwise(keyframes):
        length = 0.0 if b.cut else math.dist(a.pose.eye, b.pose.eye)
        if length > left:
            t = left / length
            if left >= _SPACING:
                eye = np.array(a.pose.eye) + t * (np.array(b.pose.eye) - np.array(a.pose.eye))
                turn = math.remainder(b.pose.azimuth - a.pose.azimuth, math.tau)
                yield _keyframe(a.time + t * (b.time - a.time), eye, a.pose.azimuth + t * turn, cut=False)
            return
        left -= length
        yield b
