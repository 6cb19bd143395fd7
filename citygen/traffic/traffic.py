"""Cars and trucks that drive through a city's streets, generated or real: where each is at every tenth of a second.

They keep to the right, follow what is ahead of them without touching it, and cross a junction one at a time. Streets that
are too narrow for two lanes, and kinds for people on foot, carry none. Junctions that short streets join count as one.
Whatever the crowd, two vehicles never overlap on a street: each moves no further than to where the one ahead was.
"""

from __future__ import annotations

import itertools
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import networkx as nx
import numpy as np
import shapely
import shapely.ops
from numpy.typing import NDArray
from shapely.geometry import LineString, Point
from shapely.geometry.base import BaseGeometry

from citygen.traffic.vehicles import KINDS, vehicle_mesh
from mmi.city.model import City
from mmi.foundation.errors import CityError
from mmi.movers.movers import Movers

__all__ = ["STEP", "traffic"]

STEP = 0.1
"""Seconds between recorded moments."""

_ON_FOOT = frozenset({"footway", "path", "steps", "pedestrian", "cycleway", "track", "bridleway", "corridor"})
_NARROWEST = 2.6  # metres of half width that let two trucks pass
_GAP = 2.0  # metres kept to the vehicle ahead
_ACCELERATION, _BRAKING = 1.8, 3.0  # metres a second squared
_CLEAR = 2.5  # metres before a junction where vehicles wait, and behind it from where they leave it to others
_IN_JUNCTION = 5.0  # metres a second while turning
_Floats = NDArray[np.float64]


def traffic(city: City, seed: int, *, vehicles: int, seconds: float) -> Movers:
    """``vehicles`` that drive about ``city`` for ``seconds``, each with a pose every ``STEP``; the same for the same seed.

    The middle of each is on the ground, to whose slope its pitch and roll fit. Raises CityError where the streets have no room
    for so many.
    """
    if vehicles < 0 or not seconds >= 0.0:
        raise CityError(f"traffic: vehicles and seconds from 0 on expected, found {vehicles} and {seconds}")
    rng = np.random.default_rng([seed, 88])
    roads = _roads(city)
    drivers = _placed(roads, rng, vehicles, source=city.source)
    steps = int(np.floor(seconds / STEP + 1e-9)) + 1
    travelled = np.zeros((steps, vehicles))
    for step in range(steps):
        for i, driver in enumerate(drivers):
            travelled[step, i] = driver.travelled
        if step + 1 < steps:
            for driver in drivers:
                _drive(driver, roads, rng)
    positions, headings = np.empty((steps, vehicles, 3)), np.empty((steps, vehicles))
    for i, driver in enumerate(drivers):
        way = np.concatenate(driver.way)
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
        axle = 0.3 * driver.length
        middle, front, rear = (
            np.column_stack([np.interp(travelled[:, i] - driver.start + shift, along, way[:, c]) for c in range(2)])
            for shift in (0.0, axle, -axle)
        )
        positions[:, i, :2] = middle
        headings[:, i] = np.unwrap(np.arctan2(front[:, 1] - rear[:, 1], front[:, 0] - rear[:, 0]))
    kinds = np.array([driver.kind for driver in drivers], dtype=np.int64)
    times = np.arange(steps, dtype=np.float64) * STEP
    positions[..., 2] = city.ground_at(positions[..., :2])
    pitches, rolls = _slopes(city, positions, headings, kinds)
    return Movers(
        ids=tuple(f"{KINDS[kind].name}-{i}" for i, kind in enumerate(kinds.tolist())),
        kinds=kinds,
        names=tuple(kind.name for kind in KINDS),
        meshes=tuple(vehicle_mesh(kind) for kind in KINDS),
        starts=np.arange(vehicles + 1, dtype=np.int64) * steps,
        times=np.tile(times, vehicles),
        positions=positions.swapaxes(0, 1).reshape(-1, 3),
        angles=np.stack([headings, pitches, rolls], axis=-1).swapaxes(0, 1).reshape(-1, 3),
        stays=np.ones(vehicles, dtype=bool),
        crs=city.crs,
        origin=city.origin,
        source=city.source,
    )


def _slopes(city: City, positions: _Floats, headings: _Floats, kinds: NDArray[np.int64]) -> tuple[_Floats, _Floats]:
    """Pitch and roll (steps, vehicles), radians, of vehicles on the ground below their axles and their sides."""
    ahead = np.stack([np.cos(headings), np.sin(headings)], axis=-1)
    slopes = []
    for direction, sizes in (
        (ahead, [0.3 * kind.length for kind in KINDS]),
        (np.stack([-ahead[..., 1], ahead[..., 0]], axis=-1), [0.5 * kind.width for kind in KINDS]),
    ):
        reach = np.array(sizes)[kinds]
        there, back = (city.ground_at(positions[..., :2] + side * reach[:, None] * direction) for side in (1.0, -1.0))
        slopes.append((there - back) / (2.0 * reach))
    pitches = np.arctan(slopes[0])
    return pitches, np.arctan(slopes[1] * np.cos(pitches))


# --------------------------------------------------------------------------------------------------------------- roads


@dataclass(slots=True, eq=False)
class _Lane:
    """One direction of a street between the nodes ``first`` and ``last``, without the junctions at its ends.

    ``queue``: who is on it, if only with the rear, the foremost first; and where the lane ends on their scale.
    """

    points: _Floats
    length: float
    speed: float
    goal: int
    back: int  # the lane in the other direction
    first: int
    last: int
    queue: deque[tuple[_Driver, float]] = field(default_factory=deque)


@dataclass(slots=True, eq=False)
class _Junction:
    """Lanes that lead out of it, and who is crossing it."""

    leaving: tuple[int, ...]
    crossing: _Driver | None = None


@dataclass(slots=True, eq=False)
class _Roads:
    """``short`` are the streets within junctions, by their nodes; ``surface`` is all that vehicles may drive on."""

    lanes: list[_Lane]
    junctions: dict[int, _Junction]
    short: nx.Graph
    surface: BaseGeometry


@dataclass(slots=True, eq=False)
class _Driver:
    """A vehicle: its middle is ``travelled`` metres along its ``way`` (lanes and turns so far, plus ``start``).

    ``lane`` ends at ``lane_end`` on that scale; while it turns, ``turn_end`` is where the next lane begins. ``held`` are
    junctions that its rear has not left: (junction, where it is clear of it).
    """

    kind: int
    length: float
    cruise: float
    lane: int
    way: list[_Floats]
    start: float
    travelled: float
    lane_end: float
    speed: float = 0.0
    next_lane: int = -1
    turn: _Floats | None = None
    held: list[tuple[int, float, float]] = field(default_factory=list)


def _roads(city: City) -> _Roads:
    """Lanes and junctions of the streets that are wide enough."""
    wide = [
        (a, b, edge)
        for a, b, edge in sorted(city.streets.edges(data=True), key=lambda one: one[2]["index"])
        if edge["kind"] not in _ON_FOOT and edge["half_width"] >= _NARROWEST
    ]
    reach = _reaches(city, wide)
    short = nx.Graph()
    short.add_nodes_from(reach)
    for a, b, edge in wide:
        line = edge["geometry"]
        if line.length < min(reach[a] + reach[b] + 10.0, short.get_edge_data(a, b, {"length": np.inf})["length"]):
            short.add_edge(a, b, line=line, length=line.length, begin=_begin(city, a, b, line))
    of = {node: min(group) for group in nx.connected_components(short) for node in group}
    lanes: list[_Lane] = []
    leaving: dict[int, list[int]] = {node: [] for node in of.values()}
    for a, b, edge in wide:
        if edge["geometry"].length < reach[a] + reach[b] + 10.0:
            continue
        start = _begin(city, a, b, edge["geometry"])
        finish = b if start == a else a
        middle = shapely.ops.substring(edge["geometry"], reach[start], edge["geometry"].length - reach[finish])
        aside = 0.5 * edge["half_width"]
        there, back = (
            middle.offset_curve(-aside, join_style="round"),
            middle.offset_curve(aside, join_style="round").reverse(),
        )
        if any(not isinstance(one, LineString) or one.length < 8.0 for one in (there, back)):
            continue
        speed = 7.0 + min(edge["half_width"], 8.0)
        for line, source, goal, other in ((there, start, finish, len(lanes) + 1), (back, finish, start, len(lanes))):
            leaving[of[source]].append(len(lanes))
            lanes.append(_Lane(np.array(line.coords), line.length, speed, of[goal], other, source, goal))
    surface = shapely.union_all([edge["geometry"].buffer(edge["half_width"]) for _, _, edge in wide])
    shapely.prepare(surface)
    return _Roads(lanes, {node: _Junction(tuple(found)) for node, found in leaving.items()}, short, surface)


def _reaches(city: City, wide: list[tuple[int, int, dict[str, Any]]]) -> dict[int, float]:
    """How far each junction reaches into its streets, metres: to where neighbouring ones no longer overlap."""
    spokes: dict[int, list[tuple[float, float]]] = {}
    for a, b, edge in wide:
        line = edge["geometry"]
        for node in (a, b):
            here = _point(city, node)
            near = line.project(here) < 0.5 * line.length
            away = line.interpolate(10.0 if near else line.length - 10.0)
            spokes.setdefault(node, []).append(
                (float(np.arctan2(away.y - here.y, away.x - here.x)), edge["half_width"])
            )
    reach = {}
    for node, found in spokes.items():
        found.sort()
        reach[node] = 1.3 * max(width for _, width in found) + 2.0
        for (angle, width), (further, other) in zip(found, [*found[1:], found[0]], strict=True):
            half = 0.5 * ((further - angle) % (2.0 * np.pi))
            if 0.05 < half < 1.3:
                reach[node] = min(max(reach[node], 0.5 * (width + other) / np.tan(half) + 2.0), 30.0)
    return reach


def _begin(city: City, a: int, b: int, line: LineString) -> int:
    """Which of the nodes ``a`` and ``b`` a street's line begins at."""
    first = Point(line.coords[0])
    return a if first.distance(_point(city, a)) <= first.distance(_point(city, b)) else b


def _point(city: City, node: int) -> Point:
    return Point(city.streets.nodes[node]["x"], city.streets.nodes[node]["y"])


def _placed(roads: _Roads, rng: np.random.Generator, vehicles: int, *, source: str) -> list[_Driver]:
    """Vehicles at rest, one behind the other, on lanes chosen by chance."""
    drivers: list[_Driver] = []
    free = [lane.length - _CLEAR for lane in roads.lanes]
    lengths = [kind.length for kind in KINDS]
    shares = np.array([kind.share for kind in KINDS])
    for _ in range(vehicles):
        kind = int(rng.choice(len(KINDS), p=shares / shares.sum()))
        room = [i for i, left in enumerate(free) if left >= lengths[kind] + 1.0]
        if not room:
            raise CityError(
                f"{source}: streets with room for {vehicles} vehicles expected, found room for {len(drivers)}"
            )
        lane = room[int(rng.integers(len(room)))]
        slack = min(free[lane] - lengths[kind] - 1.0, float(rng.uniform(0.0, 25.0)))
        middle = free[lane] - slack - 0.5 * lengths[kind]
        free[lane] = middle - 0.5 * lengths[kind] - _GAP
        cruise = float(rng.uniform(0.75, 1.1)) * (0.85 if lengths[kind] > 6.0 else 1.0)
        one = roads.lanes[lane]
        # A little way behind, for the rear axle of one that stands at the very start.
        before = one.points[0] - lengths[kind] * _unit(one.points[1] - one.points[0])
        driver = _Driver(
            kind, lengths[kind], cruise, lane, [np.vstack([before, one.points])], -lengths[kind], middle, one.length
        )
        one.queue.append((driver, one.length))
        drivers.append(driver)
    return drivers


# ------------------------------------------------------------------------------------------------------------- driving


def _drive(driver: _Driver, roads: _Roads, rng: np.random.Generator) -> None:
    """One step: as fast as allowed, no further than what is free ahead."""
    front = driver.travelled + 0.5 * driver.length
    to_turn = driver.lane_end - front
    if driver.turn is None and to_turn < 12.0 + _CLEAR:
        _ask(driver, roads, rng)
    room = _ahead(driver, roads) - _GAP - front
    wish = driver.cruise * roads.lanes[driver.lane].speed
    if driver.turn is None:
        room = min(room, to_turn - _CLEAR)
    else:  # brake for the turn
        wish = min(wish, float(np.sqrt(_IN_JUNCTION**2 + 2.0 * _BRAKING * max(0.0, to_turn))))
    room = max(room, 0.0)
    speed = min(driver.speed + _ACCELERATION * STEP, wish, float(np.sqrt(2.0 * _BRAKING * room)), room / STEP)
    driver.speed = max(speed, 0.0)
    driver.travelled += driver.speed * STEP
    _settle(driver, roads)


def _ask(driver: _Driver, roads: _Roads, rng: np.random.Generator) -> None:
    """Reserve the junction ahead and a lane beyond it, if both are free."""
    lane = roads.lanes[driver.lane]
    junction = roads.junctions[lane.goal]
    if junction.crossing is not None or lane.queue[0][0] is not driver:
        return
    choices = [one for one in junction.leaving if one != lane.back] or [lane.back]
    chosen = choices[int(rng.integers(len(choices)))]
    beyond = roads.lanes[chosen]
    if beyond.queue and beyond.length - _behind(beyond.queue[-1]) < driver.length + 2.0 * _GAP:
        return
    junction.crossing = driver
    driver.next_lane = chosen
    driver.turn = _turn(lane, beyond, roads)
    driver.way += [driver.turn[1:-1], beyond.points]


def _ahead(driver: _Driver, roads: _Roads) -> float:
    """Where the rear of the vehicle ahead is, on the driver's own scale."""
    queue = roads.lanes[driver.lane].queue
    place = next(i for i, (other, _) in enumerate(queue) if other is driver)
    if place > 0:
        return driver.lane_end - _behind(queue[place - 1])
    if driver.turn is None:
        return float(np.inf)
    beyond = roads.lanes[driver.next_lane]
    if not beyond.queue:
        return float(np.inf)
    return driver.lane_end + _long(driver.turn) + beyond.length - _behind(beyond.queue[-1])


def _behind(entry: tuple[_Driver, float]) -> float:
    """How far the rear of one on a lane is from the lane's end."""
    other, end = entry
    return end - other.travelled + 0.5 * other.length


def _settle(driver: _Driver, roads: _Roads) -> None:
    """Take the next lane once its front is on it; leave the old lane and the junction once its rear is clear of them."""
    half = 0.5 * driver.length
    if driver.turn is not None and driver.travelled + half >= driver.lane_end + _long(driver.turn):
        begin = driver.lane_end + _long(driver.turn)
        new = roads.lanes[driver.next_lane]
        driver.held.append((driver.lane, driver.lane_end, begin + _CLEAR))
        driver.lane, driver.lane_end, driver.turn = driver.next_lane, begin + new.length, None
        new.queue.append((driver, driver.lane_end))
    rear = driver.travelled - half
    for lane, end, clear in list(driver.held):
        queue = roads.lanes[lane].queue
        if rear >= end and queue and queue[0] == (driver, end):
            queue.popleft()
        if rear >= clear:
            roads.junctions[roads.lanes[lane].goal].crossing = None
            driver.held.remove((lane, end, clear))


def _long(points: _Floats) -> float:
    return float(np.hypot(*np.diff(points, axis=0).T).sum())


def _unit(vector: _Floats) -> _Floats:
    return np.asarray(vector / np.hypot(*vector))


def _turn(lane: _Lane, beyond: _Lane, roads: _Roads) -> _Floats:
    """The way from one lane to the next: straight across where that is street, else along the streets within the junction."""
    across = _curve(lane.points, beyond.points)
    if lane.last == beyond.first or roads.surface.covers(LineString(across)):
        return across
    nodes = nx.shortest_path(roads.short, lane.last, beyond.first, weight="length")
    ends = [lane.points[-2:], beyond.points[:2]]
    bends = [ends[0][1] + 3.0 * _unit(ends[0][1] - ends[0][0])]
    for a, b in itertools.pairwise(nodes):
        edge = roads.short.edges[a, b]
        line = np.array(edge["line"].coords)
        bends += list(line if edge["begin"] == a else line[::-1])
    bends.append(ends[1][0] - 3.0 * _unit(ends[1][1] - ends[1][0]))
    way = np.array([ends[0][1], *bends, ends[1][0]])
    for _ in range(4):  # Chaikin 1974: corners are cut, ends stay
        cut = np.stack([0.75 * way[:-1] + 0.25 * way[1:], 0.25 * way[:-1] + 0.75 * way[1:]], axis=1).reshape(-1, 2)
        way = np.concatenate([way[:1], cut[1:-1], way[-1:]])
    return np.asarray(way[np.concatenate([[True], np.hypot(*np.diff(way, axis=0).T) > 1e-6])])


def _curve(before: _Floats, after: _Floats) -> _Floats:
    """A smooth way from the end of one lane to the start of the next, 17 points."""
    a, b = before[-1], after[0]
    reach = 0.55 * float(np.hypot(*(b - a)))
    p, q = a + reach * _unit(before[-1] - before[-2]), b - reach * _unit(after[1] - after[0])
    t = np.linspace(0.0, 1.0, 17)[:, None]
    return np.asarray((1 - t) ** 3 * a + 3 * (1 - t) ** 2 * t * p + 3 * (1 - t) * t**2 * q + t**3 * b)
