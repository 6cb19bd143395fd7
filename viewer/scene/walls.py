"""Walls that a walking viewer slides along: the outlines of whatever stands at the height of its eye and below.

The viewer is a circle on the map. It moves in steps that are shorter than its radius, and is pushed back from walls that it
comes too near to; a step that would still end too near to a wall, or beyond it, is not made.
"""

from __future__ import annotations

import math

import numpy as np
import shapely
from numpy.typing import NDArray

from mmi.city.model import City

__all__ = ["RADIUS", "Walls", "walls_of"]

RADIUS = 0.2
"""Metres that a walking viewer keeps from walls."""
_LOWEST, _HIGHEST = 0.5, 1.7
"""Metres above the ground: what ends below the first or begins above the second can be walked over or under."""
_PUSHES = 6
_EPSILON = 1e-6
_TOUCHING = 1e-3
"""Metres from a wall below which somebody is in it."""
_SEARCHED = 50.0
"""Metres around a viewer inside of a building within which buildings stand in its way out."""


class Walls:
    """Buildings on the map: ``polygons`` (n,), any of which may touch or overlap."""

    def __init__(self, polygons: NDArray[np.object_]) -> None:
        self._polygons = shapely.get_parts(np.asarray(polygons, dtype=object))
        shapely.prepare(self._polygons)
        rings = shapely.get_rings(self._polygons)
        points, of = shapely.get_coordinates(rings, return_index=True)
        same = of[1:] == of[:-1]
        ends = np.hstack([points[:-1], points[1:]])[same]
        self._segments = ends[np.hypot(*(ends[:, 2:] - ends[:, :2]).T) > _EPSILON]
        self._lines = shapely.STRtree(shapely.linestrings(self._segments.reshape(-1, 2, 2)))
        self._tree = shapely.STRtree(self._polygons)

    def inside(self, point: tuple[float, float]) -> bool:
        """Whether a point is within a building."""
        found = self._tree.query(shapely.points(*point), predicate="within")
        return bool(len(found))

    def clearance(self, point: tuple[float, float]) -> float:
        """Metres to the nearest wall, at most ``2 * RADIUS``."""
        near = self._near(point, point)
        return min(2.0 * RADIUS, float(_distances(near, point)[0].min(initial=math.inf)))

    def freed(self, point: tuple[float, float]) -> tuple[float, float]:
        """The point itself, or where it is within a building or a wall the nearest place outside of all."""
        if not self.inside(point) and self.clearance(point) >= _TOUCHING:
            return point
        here = shapely.points(*point)
        reach = _SEARCHED
        while True:
            near = self._polygons[self._tree.query(here.buffer(reach))]
            taken = shapely.union_all(near).buffer(RADIUS + 0.01)
            x, y = shapely.get_coordinates(shapely.shortest_line(here, taken.boundary))[-1].tolist()
            if math.hypot(x - point[0], y - point[1]) <= reach - RADIUS or len(near) == len(self._polygons):
                return x, y
            reach *= 2.0

    def slide(self, start: tuple[float, float], end: tuple[float, float]) -> tuple[float, float]:
        """Where a viewer comes to that goes from ``start`` towards ``end``: along walls, through none."""
        x, y = start
        steps = math.ceil(math.hypot(end[0] - x, end[1] - y) / (0.5 * RADIUS))
        near = self._near(start, end)
        if not len(near):
            return end
        step = ((end[0] - x) / max(steps, 1), (end[1] - y) / max(steps, 1))
        for _ in range(steps):
            before = (x, y)
            x, y = _stepped(near, before, (x + step[0], y + step[1]))
            if (x, y) == before:
                break
        return x, y

    def _near(self, a: tuple[float, float], b: tuple[float, float]) -> NDArray[np.float64]:
        """(n, 4) the segments that a viewer on its way from ``a`` to ``b`` may touch, wherever it slides."""
        reach = math.hypot(b[0] - a[0], b[1] - a[1]) + 2.0 * RADIUS
        box = shapely.box(a[0] - reach, a[1] - reach, a[0] + reach, a[1] + reach)
        found: NDArray[np.float64] = self._segments[self._lines.query(box)]
        return found


def walls_of(city: City) -> Walls:
    """The walls of all that stands in a viewer's way in ``city``."""
    prisms = [prism for one in city.objects for prism in one.prisms]
    footprints = np.array([prism.footprint for prism in prisms], dtype=object)
    if not len(prisms):
        return Walls(footprints)
    low = np.full(len(prisms), city.ground)
    if city.terrain is not None:
        low = city.terrain.under(footprints)[0]
    bottoms, tops = np.array([prism.bottom for prism in prisms]), np.array([prism.top for prism in prisms])
    return Walls(footprints[(bottoms < low + _HIGHEST) & (tops > low + _LOWEST)])


def _stepped(near: NDArray[np.float64], start: tuple[float, float], end: tuple[float, float]) -> tuple[float, float]:
    """Where a step ends: at ``end``, pushed away from walls, or at ``start``."""
    least = min(RADIUS, float(_distances(near, start)[0].min()))
    x, y = end
    for _ in range(_PUSHES):
        distances, points = _distances(near, (x, y))
        worst = int(np.argmin(distances))
        distance = float(distances[worst])
        if distance >= RADIUS - _EPSILON:
            break
        if distance < _EPSILON:
            return start
        share = RADIUS / distance
        px, py = points[worst].tolist()
        x, y = px + share * (x - px), py + share * (y - py)
    clear = float(_distances(near, (x, y))[0].min()) >= least - 2.0 * _EPSILON
    return (x, y) if clear and not _crosses(near, start, (x, y)) else start


def _distances(
    segments: NDArray[np.float64], point: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n,) metres from ``point`` to each of (n, 4) segments, and (n, 2) the nearest points of these."""
    a, along = segments[:, :2], segments[:, 2:] - segments[:, :2]
    away = np.array(point) - a
    t = np.clip((away * along).sum(axis=1) / (along * along).sum(axis=1), 0.0, 1.0)
    points = a + t[:, None] * along
    return np.hypot(point[0] - points[:, 0], point[1] - points[:, 1]), points


def _crosses(segments: NDArray[np.float64], a: tuple[float, float], b: tuple[float, float]) -> bool:
    """Whether the way from ``a`` to ``b`` meets any of (n, 4) segments."""
    p, q = segments[:, :2], segments[:, 2:]
    first = _side(a, b, p) * _side(a, b, q)
    along = q - p
    to_a, to_b = np.array(a) - p, np.array(b) - p
    second = (along[:, 0] * to_a[:, 1] - along[:, 1] * to_a[:, 0]) * (
        along[:, 0] * to_b[:, 1] - along[:, 1] * to_b[:, 0]
    )
    return bool(((first <= 0.0) & (second < 0.0)).any())


def _side(a: tuple[float, float], b: tuple[float, float], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """On which side of the line from ``a`` to ``b`` each of (n, 2) points is: above 0 for the left one."""
    found: NDArray[np.float64] = (b[0] - a[0]) * (points[:, 1] - a[1]) - (b[1] - a[1]) * (points[:, 0] - a[0])
    return found
