"""Towns that grow by cutting: a boundary is cut into blocks by streets that follow a field of directions.

Hierarchical splitting (Yang, Wang, Vouga, Wonka 2013) along streamlines of a cross field (Chen et al. 2008): each cut turns
one block into two, so there are as many as were asked for. Streets that lead into a block or out of the town do not change
that; with F blocks, V junctions and one connected graph, there are F + V - 1 streets (Euler), so both can be asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, Polygon
from shapely.ops import substring

from citygen.streets.networks import Network
from citygen.streets.planar import Cut, End, Plan, Point
from citygen.streets.ragged import oriented_boxes
from mmi.foundation.errors import ParameterError

__all__ = ["Field", "Ranks", "subdivide"]

Field = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""From points (n, 2) to angles (n,), radians: streets run that way, or square to it."""

_STEP = 9.0
"""Metres between the vertices of a street."""
_NARROWEST = 24.0
"""Metres between two streets that do not meet there."""
_SHARPEST = math.cos(math.radians(38.0))
"""Cosine of the smallest angle at which streets meet."""


@dataclass(frozen=True, slots=True)
class Ranks:
    """How streets of each rank look: ``kinds`` (OpenStreetMap highway values) and ``half_widths``, metres, greatest first.

    ``shares`` of all cuts, in the order in which they were made, are of each rank. A street is called by the title of its rank
    and one of ``names``. ``dead_end`` is the kind, half width and title of a street that leads nowhere.
    """

    kinds: tuple[str, ...]
    half_widths: tuple[float, ...]
    shares: tuple[float, ...]
    titles: tuple[str, ...]
    names: tuple[str, ...]
    dead_end: tuple[str, float, str]

    def of(self, order: NDArray[np.float64]) -> NDArray[np.int64]:
        """Rank (n,) of cuts whose place among all is ``order`` (n,) in [0, 1]."""
        limits = np.cumsum(self.shares)[:-1]
        return np.asarray(np.searchsorted(limits, order, side="right"), dtype=np.int64)


def subdivide(
    boundary: NDArray[np.float64],
    field: Field,
    rng: np.random.Generator,
    *,
    blocks: int,
    ranks: Ranks,
    junctions: int | None = None,
    stubs: int = 0,
    kept_free: Sequence[tuple[float, float, float]] = (),
    density: Callable[[Point], float] = lambda _: 1.0,
) -> Network:
    """A network of ``blocks`` blocks within ``boundary`` (n, 2), counter-clockwise, whose outline is a street, too.

    With ``junctions``, that many nodes (and ``blocks + junctions - 1`` streets): dead ends and bends make up the number.
    Up to ``stubs`` streets lead out of the town. No street crosses the discs ``kept_free`` (x, y, radius). Where ``density``
    is greater, blocks are smaller: a block's area times its density decides which is cut next.

    Raises:
        ParameterError: the boundary has no room for so many blocks, or the blocks none for so many junctions.
    """
    plan = Plan.within(boundary)
    discs = [(shapely.Point(x, y), radius) for x, y, radius in kept_free]

    def rank(face: int) -> float:
        polygon = plan.polygon(face)
        centre = polygon.centroid
        return float(polygon.area * density((centre.x, centre.y)))

    sizes = {face: rank(face) for face in plan.rings}
    stuck: dict[int, int] = {}
    while len(plan.rings) < blocks:
        face = max(sizes, key=sizes.__getitem__, default=None)
        if face is None:
            raise ParameterError(f"{blocks} blocks expected to fit into the boundary, found room for {len(plan.rings)}")
        found = _best_cut(plan, face, field, rng, discs, lenient=stuck.get(face, 0))
        if found is None:
            stuck[face] = stuck.get(face, 0) + 1
            sizes[face] *= 0.8
            if stuck[face] > 4:
                del sizes[face]
            continue
        stuck.pop(face, None)
        del sizes[face]
        for one in plan.cut(face, found):
            sizes[one] = rank(one)
    _lead_out(plan, stubs, rng)
    if junctions is not None:
        _reach(plan, junctions, rng, discs)
    return _network(plan, ranks)


# ------------------------------------------------------------------------------------------------------------ one cut


def _best_cut(
    plan: Plan,
    face: int,
    field: Field,
    rng: np.random.Generator,
    discs: Sequence[tuple[shapely.Point, float]],
    *,
    lenient: int,
) -> Cut | None:
    """The candidate that leaves the two most compact halves of like size, or None if no candidate is allowed."""
    polygon = plan.polygon(face)
    _, along, size = oriented_boxes(np.array([polygon], dtype=object))
    sides = size.T * np.stack([along[0], [-along[0, 1], along[0, 0]]])
    seeds = polygon.centroid.coords[0] + rng.uniform(-0.22, 0.22, (3 + 3 * lenient, 2)) @ sides
    seeds = seeds[shapely.contains_xy(polygon, seeds)]
    if not len(seeds):
        return None
    reach = 1.2 * float(size.sum())
    best, best_score = None, 0.0
    for line in _streamlines(field, seeds, reach, polygon.bounds):
        cut = _cut_along(plan, face, polygon, line, discs, lenient=lenient)
        if cut is None:
            continue
        halves = plan.halves(face, cut)
        areas = [half.area for half in halves]
        compact = min(4.0 * math.pi * half.area / max(half.length, 1e-9) ** 2 for half in halves)
        score = compact * (0.3 + min(areas) / sum(areas)) * rng.uniform(0.85, 1.15)
        if all(half.is_valid for half in halves) and score > best_score:
            best, best_score = cut, score
    return best


def _streamlines(
    field: Field, seeds: NDArray[np.float64], reach: float, bounds: tuple[float, float, float, float]
) -> list[LineString]:
    """Two lines through each seed, along the field and square to it, out of ``bounds`` or ``reach`` metres each way."""
    n = len(seeds)
    points = np.tile(seeds, (4, 1))
    turns = np.repeat(np.arange(4) * 0.5 * np.pi, n)
    angle = np.tile(field(seeds), 4) + turns
    heading = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    path = [points]
    for _ in range(math.ceil(reach / _STEP)):
        angle = field(points + 0.5 * _STEP * heading)
        along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        square = np.stack([-along[:, 1], along[:, 0]], axis=1)
        # Of the four ways of the cross, the one that turns least.
        u, v = (along * heading).sum(axis=1), (square * heading).sum(axis=1)
        heading = np.where((np.abs(u) >= np.abs(v))[:, None], np.sign(u)[:, None] * along, np.sign(v)[:, None] * square)
        points = points + _STEP * heading
        path.append(points)
        if ((points < bounds[:2]) | (points > bounds[2:])).any(axis=1).all():
            break
    ways = np.stack(path, axis=1).reshape(4, n, -1, 2)
    return [LineString(np.concatenate([ways[k + 2, i, :0:-1], ways[k, i]])) for i in range(n) for k in range(2)]


def _cut_along(
    plan: Plan,
    face: int,
    polygon: Polygon,
    line: LineString,
    discs: Sequence[tuple[shapely.Point, float]],
    *,
    lenient: int,
) -> Cut | None:
    """What of the line lies in the block and around its seed, with its ends moved to junctions nearby, if that is allowed."""
    seed = line.interpolate(0.5, normalized=True)
    parts = shapely.get_parts(shapely.intersection(polygon, line))
    parts = parts[shapely.get_type_id(parts) == 1]
    if not len(parts):
        return None
    part = parts[int(np.argmin(shapely.distance(parts, seed)))]
    coords = shapely.get_coordinates(part).tolist()
    if part.length < _NARROWEST or _ends_inside(part, polygon):
        return None
    start = plan.end_at(face, tuple(coords[0]), snap=14.0 + 3.0 * lenient)
    stop = plan.end_at(face, tuple(coords[-1]), snap=14.0 + 3.0 * lenient)
    a, b = plan.place(start), plan.place(stop)
    if math.dist(a, b) < _NARROWEST or start == stop or _same_segment(start, stop):
        return None
    # Near a moved end, vertices give way to a straight run.
    inner = [(round(x, 3), round(y, 3)) for x, y in coords[1:-1]]
    inner = [p for p in inner if math.dist(p, a) > 18.0 and math.dist(p, b) > 18.0]
    inner = _thinned([a, *inner, b])[1:-1]
    whole = LineString([a, *inner, b])
    if not whole.is_simple or any(shapely.distance(centre, whole) < radius for centre, radius in discs):
        return None
    sharpest = _SHARPEST + (1.0 - _SHARPEST) * 0.08 * lenient
    for end, path in ((start, [a, *inner, b]), (stop, [b, *inner[::-1], a])):
        way = _unit(path[0], path[1])
        if any(way[0] * w[0] + way[1] * w[1] > sharpest for w in plan.ways(face, end)):
            return None
    margin = min(0.3 * whole.length, 1.6 * _NARROWEST)
    middle = substring(whole, margin, whole.length - margin)
    trimmed = substring(whole, 0.5, whole.length - 0.5)
    if not polygon.contains_properly(trimmed) or polygon.exterior.distance(middle) < _NARROWEST / (
        1.0 + 0.15 * lenient
    ):
        return None
    return Cut(start, stop, tuple(inner))


def _ends_inside(line: LineString, polygon: Polygon) -> bool:
    ends = shapely.get_parts(shapely.boundary(line))
    return len(ends) < 2 or bool((shapely.distance(ends, polygon.exterior) > 0.1).any())


def _thinned(points: list[Point]) -> list[Point]:
    """Without the vertices that a street does not need, to half a metre."""
    line = shapely.remove_repeated_points(shapely.simplify(LineString(points), 0.5), 2.0)
    return [tuple(p) for p in shapely.get_coordinates(line).tolist()]


def _unit(a: Point, b: Point) -> Point:
    length = math.dist(a, b)
    return (b[0] - a[0]) / length, (b[1] - a[1]) / length


def _same_segment(one: End, other: End) -> bool:
    return not isinstance(one, int) and not isinstance(other, int) and one[:2] == other[:2]


# ---------------------------------------------------------------------------------------------------------- dead ends


def _lead_out(plan: Plan, count: int, rng: np.random.Generator) -> None:
    """Up to ``count`` streets that go on where one from within meets the outline."""
    ring = [v for v in range(len(plan.points)) if 0 in plan.neighbours[v].values()]
    town = Polygon([plan.points[v] for v in _outline(plan)])
    order = rng.permutation([v for v in ring if len(plan.neighbours[v]) == 3]).tolist()
    lengths = rng.uniform(22.0, 60.0, len(order))
    others: list[LineString] = []
    for vertex, length in zip(order, lengths.tolist(), strict=True):
        if len(others) == count:
            break
        inward = next(v for v, street in plan.neighbours[vertex].items() if street)
        x, y = _unit(plan.points[inward], plan.points[vertex])
        foot = plan.points[vertex]
        tip = (round(foot[0] + length * x, 3), round(foot[1] + length * y, 3))
        stub = LineString([foot, tip])
        free = shapely.distance(substring(stub, 0.4 * length, length), town) > 0.25 * length
        if free and all(shapely.distance(stub, other) > _NARROWEST for other in others):
            others.append(stub)
            plan.add_spur(vertex, (tip,), dead_end=False)


def _outline(plan: Plan) -> list[int]:
    """Vertices of the boundary in order."""
    start = next(v for v in range(len(plan.points)) if 0 in plan.neighbours[v].values())
    path = [start, next(v for v, street in plan.neighbours[start].items() if street == 0)]
    while path[-1] != start:
        path.append(next(v for v, s in plan.neighbours[path[-1]].items() if s == 0 and v != path[-2]))
    return path[:-1]


def _reach(plan: Plan, junctions: int, rng: np.random.Generator, discs: Sequence[tuple[shapely.Point, float]]) -> None:
    """Add dead ends to the largest blocks, then junctions of two streets to the longest, until there are ``junctions``."""
    missing = junctions - plan.count_junctions()
    if missing < 0:
        raise ParameterError(f"{junctions} junctions expected, found {junctions - missing} without any dead end")
    for face in sorted(plan.rings, key=lambda one: -plan.polygon(one).area):
        if missing < 2 or len(plan.dead_ends) >= len(plan.rings) // 3:
            break
        spur = _dead_end(plan, face, rng, discs)
        if spur is not None:
            end, path = spur
            plan.add_spur(end, path, dead_end=True)
            missing -= 2
    lengths = {chain.vertices: plan.line(chain.vertices).length for chain in plan.chains()}
    for _ in range(missing):
        vertices = max(lengths, key=lengths.__getitem__)
        if lengths[vertices] < 1.0:
            raise ParameterError(f"{junctions} junctions expected, found no street long enough to have one more")
        middle = _middle(plan, vertices)
        plan.marked.add(plan.settle(middle))
        del lengths[vertices]
        w = len(plan.points) - 1 if not isinstance(middle, int) else middle
        k = vertices.index(middle if isinstance(middle, int) else middle[1])
        for part in ((*vertices[:k], w), (w, *vertices[k + isinstance(middle, int) :])):
            lengths[part] = plan.line(part).length


def _dead_end(
    plan: Plan, face: int, rng: np.random.Generator, discs: Sequence[tuple[shapely.Point, float]]
) -> tuple[End, tuple[Point, ...]] | None:
    """A street from the middle of a side into the block, away from the other sides; None if there is no room."""
    polygon = plan.polygon(face)
    ring = plan.rings[face]
    sides = [(u, v) for u, v in zip(ring, [*ring[1:], ring[0]], strict=True)]
    sides.sort(key=lambda side: -math.dist(plan.points[side[0]], plan.points[side[1]]))
    for u, v in sides[:4]:
        a, b = plan.points[u], plan.points[v]
        t = float(rng.uniform(0.4, 0.6))
        foot = (round(a[0] + t * (b[0] - a[0]), 3), round(a[1] + t * (b[1] - a[1]), 3))
        x, y = _unit(a, b)
        lean, length = float(rng.uniform(-0.3, 0.3)), float(rng.uniform(38.0, 65.0))
        elbow = (round(foot[0] - 0.5 * length * y, 3), round(foot[1] + 0.5 * length * x, 3))
        tip = (
            round(elbow[0] + 0.5 * length * (-y + lean * x), 3),
            round(elbow[1] + 0.5 * length * (x + lean * y), 3),
        )
        way = LineString([foot, elbow, tip])
        far = LineString([elbow, tip])
        clear = polygon.contains_properly(far) and polygon.exterior.distance(far) > min(18.0, 0.45 * length)
        spaced = math.dist(a, foot) > 15.0 and math.dist(b, foot) > 15.0
        if clear and spaced and all(shapely.distance(centre, way) > radius for centre, radius in discs):
            return (u, v, foot), (elbow, tip)
    return None


def _middle(plan: Plan, vertices: tuple[int, ...]) -> End:
    """The end nearest to the middle of a street: a vertex of it where there is one."""
    if len(vertices) > 2:
        line = plan.line(vertices)
        along = [line.project(shapely.Point(plan.points[v])) for v in vertices[1:-1]]
        return vertices[1 + int(np.argmin(np.abs(np.array(along) - 0.5 * line.length)))]
    u, v = vertices
    (ax, ay), (bx, by) = plan.points[u], plan.points[v]
    return u, v, (round(0.5 * (ax + bx), 3), round(0.5 * (ay + by), 3))


# ------------------------------------------------------------------------------------------------------------ result


def _network(plan: Plan, ranks: Ranks) -> Network:
    chains = plan.chains()
    used = sorted({v for chain in chains for v in (chain.vertices[0], chain.vertices[-1])})
    number = {v: i for i, v in enumerate(used)}
    streets = np.array([chain.street for chain in chains])
    dead = np.isin(streets, sorted(plan.dead_ends))
    rank = ranks.of(np.arange(plan.streets) / max(plan.streets - len(plan.dead_ends), 1))[streets]
    kind, width, name = ranks.dead_end
    titles = [ranks.titles[r] for r in range(len(ranks.kinds))]
    names = [
        f"{name if is_dead else titles[r]} {ranks.names[s % len(ranks.names)]}"
        for s, r, is_dead in zip(streets.tolist(), rank.tolist(), dead.tolist(), strict=True)
    ]
    return Network(
        np.array([plan.points[v] for v in used]),
        np.array([(number[chain.vertices[0]], number[chain.vertices[-1]]) for chain in chains]),
        np.array([plan.line(chain.vertices) for chain in chains], dtype=object),
        np.where(dead, kind, np.array(ranks.kinds)[rank]),
        np.where(dead, width, np.array(ranks.half_widths)[rank]),
        np.array(names),
    )
