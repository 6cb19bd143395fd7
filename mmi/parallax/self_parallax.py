"""Self-parallax: how wide a strip one object may open in a picture of itself, whatever else stands around.

An object's front hides its own sides and wings (:mod:`mmi.parallax.ray_weights` says what counts). Rays from the reference
go through the ends of every wall that may be seen, just beside them, and through points between. On each, what may be seen of
a wall counts against the walls in front of it, where both have points at a common slope. Two edges that meet in the picture
between such rays begin or end that, and have a ray of their own. A wall also runs through many depths within one texel where
the capture looks along it, and so do a roof and an underside.

An object of thousands of walls (a block, a long terrace) has many rays, and each meets many walls. Two things keep that from
growing with the cube of their number, and neither changes the value: walls are looked up by azimuth, and rays and walls
whose strips cannot be wider than one that is known (:func:`mmi.parallax.ray_angles.no_wider_than`) are left out.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from mmi.cells.viewing_cells import ViewingCell
from mmi.city.model import City
from mmi.foundation.kernels import kernel
from mmi.foundation.ray_chords import may_exceed
from mmi.parallax.critical_zone import cell_region
from mmi.parallax.ray_angles import RayViewpoints, angle_of, closest_to_level, no_wider_than, on_ray, widest
from mmi.parallax.texels import texel_ratios
from mmi.visibility.selection import WallVisibility
from mmi.visibility.visible_walls import VisibleWalls, visible_walls
from mmi.visibility.walls import Walls

__all__ = ["self_parallax"]

_ASIDE = 1e-7
"""Radians: rays pass a corner this far on either side of it."""
_TOUCHING = 1e-6
"""Metres: an object this close to the cell's region counts as meeting it."""
_APART = 1e-6
"""Two hits of a ray are one where their distances differ by less than this share."""
_ROW = 40.0
"""Metres: a row of houses that the reference may see edge-on is at most this long."""
_WITHIN = (0.25, 0.5, 0.75)
"""Where along a wall rays pass through it, besides its ends."""
_WALLS_A_BIN = 8
"""An object has a bin of azimuth for so many of its walls."""
_MOST_BINS = 1024
"""An object has at most so many bins."""
_ROUNDING = 1e-9
"""Radians: azimuths are off by far less."""


def self_parallax(
    city: City,
    cell: ViewingCell,
    walls: Walls,
    objects: NDArray[np.int64],
    wall_visibility: WallVisibility | None,
    *,
    texel: float,
) -> NDArray[np.float64]:
    """(n,) radians for each of ``objects`` (n,): how wide a strip it may open in a picture of it from the reference viewpoint.

    Infinite for what meets the cell. ``walls`` are those of ``city``; ``texel`` is the angle in radians within which rays are
    one, for what needs no finer texels than a display's pixels. Without ``wall_visibility`` every wall that faces the cell
    may be seen in whole.
    """
    visible = visible_walls(cell, walls, objects, wall_visibility)
    parallax = _self_parallax(visible, texel / texel_ratios(walls, walls.of(objects), cell))
    footprints = [city.objects[i].footprint for i in objects]
    parallax[shapely.distance(footprints, cell_region(cell)) <= _TOUCHING] = math.inf
    return parallax


class _Fan(NamedTuple):
    """The walls of an object by azimuth: those that rays of bin i may meet are ``walls[starts[i] : starts[i + 1]]``, in order.

    Azimuths count from the direction ``zero`` (2,), in (-pi, pi]; bin 0 begins at ``least`` radians, and there are ``scale``
    bins to a radian. What lies before the first bin or behind the last belongs to it.
    """

    zero: NDArray[np.float64]
    least: float
    scale: float
    starts: NDArray[np.int64]
    walls: NDArray[np.int64]


class _Hits(NamedTuple):
    """Room for what a ray meets: ``distances`` (m,) metres and ``walls`` (m,)."""

    distances: NDArray[np.float64]
    walls: NDArray[np.int64]


@kernel(error_model="numpy")
def _bin_of(azimuth: float, least: float, scale: float, bins: int) -> int:
    return min(max(math.floor((azimuth - least) * scale), 0), bins - 1)


@kernel(error_model="numpy")
def _fan(a: NDArray[np.float64], b: NDArray[np.float64], first: int, end: int) -> _Fan:
    """The walls ``first`` to ``end`` of ``a``, ``b`` (w, 2) by azimuth."""
    n, zero = end - first, a[first]
    bins = min(max(n // _WALLS_A_BIN, 1), _MOST_BINS)
    turns = np.empty((n, 2))
    least, most = math.inf, -math.inf
    for i in range(n):
        (ax, ay), (bx, by) = a[first + i], b[first + i]
        start = math.atan2(zero[0] * ay - zero[1] * ax, zero[0] * ax + zero[1] * ay)
        stop = start + math.atan2(ax * by - ay * bx, ax * bx + ay * by)
        low, high = min(start, stop) - _ROUNDING, max(start, stop) + _ROUNDING
        if low < -math.pi:
            low, high = low + 2.0 * math.pi, high + 2.0 * math.pi
        if high > math.pi:  # it goes on from -pi
            least, most = -math.pi, math.pi
        turns[i] = low, high
        least, most = min(least, low), max(most, min(high, math.pi))
    scale = bins / (most - least)
    begins, counts = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    starts = np.zeros(bins + 1, dtype=np.int64)
    for i in range(n):
        low, high = turns[i]
        begins[i] = _bin_of(low, least, scale, bins)
        last = _bin_of(high, least, scale, bins)
        if high > math.pi:
            last = bins + _bin_of(high - 2.0 * math.pi, least, scale, bins)
        counts[i] = min(last - begins[i] + 1, bins)
        for k in range(counts[i]):
            starts[(begins[i] + k) % bins + 1] += 1
    starts = np.cumsum(starts)
    place, walls = starts[:-1].copy(), np.empty(starts[-1], dtype=np.int64)
    for i in range(n):
        for k in range(counts[i]):
            at = (begins[i] + k) % bins
            walls[place[at]] = first + i
            place[at] += 1
    return _Fan(zero, least, scale, starts, walls)


@kernel(error_model="numpy")
def _distance(ux: float, uy: float, a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Metres to where the ray towards (ux, uy) meets the wall from ``a`` to ``b`` (2,), 0 where it does not."""
    ca, cb = ux * a[1] - uy * a[0], ux * b[1] - uy * b[0]
    if (ca > 0.0) == (cb > 0.0):
        return 0.0
    s = ca / (ca - cb)
    return max(ux * (a[0] + s * (b[0] - a[0])) + uy * (a[1] + s * (b[1] - a[1])), 0.0)


@kernel(error_model="numpy")
def _meet(ux: float, uy: float, a: NDArray[np.float64], b: NDArray[np.float64], fan: _Fan, hits: _Hits) -> int:
    """Sets ``hits`` to the walls that the ray towards (ux, uy) meets, in order of the walls; returns how many."""
    azimuth = math.atan2(fan.zero[0] * uy - fan.zero[1] * ux, fan.zero[0] * ux + fan.zero[1] * uy)
    at = _bin_of(azimuth, fan.least, fan.scale, len(fan.starts) - 1)
    count = 0
    for entry in range(fan.starts[at], fan.starts[at + 1]):
        i = fan.walls[entry]
        hit = _distance(ux, uy, a[i], b[i])
        if hit > 0.0:
            hits.distances[count], hits.walls[count] = hit, i
            count += 1
    return count


@kernel(error_model="numpy")
def _along_wall(
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    height: float,
    texel: float,
    viewpoints: NDArray[np.float64],
    visible: NDArray[np.bool_],
) -> float:
    """Largest square of the chord between two points of a wall, ``height`` above the reference, that fall into one texel.

    At both ends, and in the middle. A wall that is less than a texel wide counts as one of a row of houses: with as much of
    its line on both sides as falls into the texel, up to ``_ROW`` metres in all. A wall without length lies on no line and
    adds nothing.
    """
    ex, ey = b[0] - a[0], b[1] - a[1]
    length = math.hypot(ex, ey)
    if math.isinf(_ROW / length):
        return 0.0
    turn = math.atan2(a[0] * b[1] - a[1] * b[0], a[0] * b[0] + a[1] * b[1])
    pieces = np.empty((3, 2))
    count = 1
    if abs(turn) > texel:
        step = math.copysign(texel, turn)
        count = 3
        for place in range(3):
            start = (0.0, 0.5 * (turn - step), turn - step)[place]
            for k in range(2):
                angle = start + k * step
                ux = a[0] * math.cos(angle) - a[1] * math.sin(angle)
                uy = a[0] * math.sin(angle) + a[1] * math.cos(angle)
                pieces[place, k] = (a[1] * ux - a[0] * uy) / (ex * uy - ey * ux)
    else:
        half = 0.5 * max(_ROW / length, 1.0)
        while half > 0.5:
            x1, y1 = a[0] + (0.5 - half) * ex, a[1] + (0.5 - half) * ey
            x2, y2 = a[0] + (0.5 + half) * ex, a[1] + (0.5 + half) * ey
            if abs(math.atan2(x1 * y2 - y1 * x2, x1 * x2 + y1 * y2)) <= texel:
                break
            half = max(0.8 * half, 0.5)
        pieces[0, 0], pieces[0, 1] = 0.5 - half, 0.5 + half
    most = 0.0
    for place in range(count):
        for k in range(len(visible)):
            if visible[k]:
                x1 = a[0] + pieces[place, 0] * ex - viewpoints[k, 0]
                y1 = a[1] + pieces[place, 0] * ey - viewpoints[k, 1]
                x2 = a[0] + pieces[place, 1] * ex - viewpoints[k, 0]
                y2 = a[1] + pieces[place, 1] * ey - viewpoints[k, 1]
                n1 = 1.0 / math.sqrt(x1 * x1 + y1 * y1 + height * height)
                n2 = 1.0 / math.sqrt(x2 * x2 + y2 * y2 + height * height)
                dx, dy, dz = x1 * n1 - x2 * n2, y1 * n1 - y2 * n2, height * (n1 - n2)
                most = max(most, dx * dx + dy * dy + dz * dz)
    return most


@kernel(error_model="numpy")
def _along_ray(
    most: float,
    reach: float,
    hits: _Hits,
    visible: VisibleWalls,
    seen: NDArray[np.bool_],
    texels: NDArray[np.float64],
    viewpoints: RayViewpoints,
) -> float:
    """``most``, or the largest square of the chord between two points on the ray that met ``hits``, if that is more.

    ``seen`` (w,): walls that are visible from somewhere; ``viewpoints`` are at most ``reach`` metres away.
    """
    count = len(hits.walls)
    nearest = hits.distances.min()
    # What one cheap look at the whole ray rules out.
    farthest, lowest, highest = 0.0, math.inf, -math.inf
    viewers = np.zeros(len(viewpoints.along), dtype=np.bool_)
    for i in range(count):
        back, far = hits.walls[i], hits.distances[i]
        if seen[back] and may_exceed(most, nearest, far, reach):
            farthest = max(farthest, far)
            lowest, highest = min(lowest, visible.low[back] / far), max(highest, visible.top[back] / far)
            viewers |= visible.visible_from[back]
    if farthest == 0.0 or no_wider_than(nearest, farthest, lowest, highest, viewpoints, viewers) <= most:
        return most
    for i in range(count):
        back, far = hits.walls[i], hits.distances[i]
        if not seen[back] or not may_exceed(most, nearest, far, reach):
            continue
        viewers = visible.visible_from[back]
        if no_wider_than(nearest, far, visible.low[back] / far, visible.top[back] / far, viewpoints, viewers) <= most:
            continue
        if visible.open[back]:  # how far its roof or underside runs within a texel
            level = visible.bottom[back] if visible.bottom[back] > -viewpoints.rise else visible.top[back]
            near = max(far - far * far * texels[back] / max(abs(level), 1e-6), nearest)
            if may_exceed(most, near, far, reach):
                most = max(most, widest(near, far, level / far, level / far, viewpoints, viewers))
        for j in range(count):
            front, near = hits.walls[j], hits.distances[j]
            (ax, ay), (bx, by) = visible.a[front], visible.b[front]
            facing = ax * by - ay * bx < 0.0
            if not facing or near >= far * (1.0 - _APART) or not may_exceed(most, near, far, reach):
                continue
            lowest = max(visible.bottom[front] / near, visible.low[back] / far)
            highest = min(visible.top[front] / near, visible.top[back] / far)
            if lowest <= highest:
                most = max(most, widest(near, far, lowest, highest, viewpoints, viewers))
    return most


@kernel(error_model="numpy")
def _where_edges_meet(
    most: float,
    reach: float,
    front: int,
    back: int,
    front_height: float,
    back_height: float,
    visible: VisibleWalls,
    viewpoints: RayViewpoints,
) -> float:
    """``most``, or the square of the chord on the ray at which two edges meet in the picture from the reference, if more.

    The edges are at heights of two walls: the top of one that is in front and the lowest that is visible of one behind it,
    or a bottom and a top. On one side of that ray a common slope exists and on the other none, and they may part most there.
    """
    if front_height * back_height <= 0.0 or abs(back_height) <= abs(front_height):
        return most  # the slopes differ wherever the front is nearer
    (ax, ay), (bx, by) = visible.a[front], visible.b[front]
    (cx, cy), (dx, dy) = visible.a[back], visible.b[back]
    # A ray u meets a line through A along e at A x e / u x e; the slopes are equal where u is parallel to this:
    one, other = front_height / (ax * by - ay * bx), back_height / (cx * dy - cy * dx)
    vx, vy = one * (bx - ax) - other * (dx - cx), one * (by - ay) - other * (dy - cy)
    length = math.hypot(vx, vy)
    for side in (1.0, -1.0):
        ux, uy = side * vx / length, side * vy / length
        near = _distance(ux, uy, visible.a[front], visible.b[front])
        far = _distance(ux, uy, visible.a[back], visible.b[back])
        if 0.0 < near < far * (1.0 - _APART) and may_exceed(most, near, far, reach):
            on_ray(ux, uy, visible.viewpoints, viewpoints)
            slope = front_height / near
            most = max(most, widest(near, far, slope, slope, viewpoints, visible.visible_from[back]))
    return most


@kernel(error_model="numpy")
def _between_rays(
    most: float, reach: float, fan: _Fan, visible: VisibleWalls, seen: NDArray[np.bool_], viewpoints: RayViewpoints
) -> float:
    """``most``, or the largest square of the chord on rays where edges of two walls of ``fan`` meet, if that is more."""
    for at in range(len(fan.starts) - 1):
        walls = fan.walls[fan.starts[at] : fan.starts[at + 1]]
        for front in walls:
            (ax, ay), (bx, by) = visible.a[front], visible.b[front]
            if ax * by - ay * bx >= 0.0:
                continue
            top, bottom = visible.top[front], visible.bottom[front]
            for back in walls:
                if seen[back]:
                    low, high = visible.low[back], visible.top[back]
                    most = _where_edges_meet(most, reach, front, back, top, low, visible, viewpoints)
                    most = _where_edges_meet(most, reach, front, back, bottom, high, visible, viewpoints)
    return most


@kernel(error_model="numpy")
def _self_parallax(visible: VisibleWalls, texels: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) radians; ``texels`` (w,) are the angles within which rays towards a wall are one."""
    a, b = visible.a, visible.b
    n, p = len(visible.first) - 1, len(visible.viewpoints)
    parallax = np.zeros(n)
    viewpoints = RayViewpoints(np.empty(p), np.empty(p), visible.rise)
    reach = visible.rise
    for k in range(p):
        reach = max(reach, visible.rise + math.hypot(visible.viewpoints[k, 0], visible.viewpoints[k, 1]))
    seen = np.empty(len(a), dtype=np.bool_)
    for w in range(len(a)):
        seen[w] = visible.visible_from[w].any()
    for one in range(n):
        first, end = visible.first[one], visible.first[one + 1]
        if not seen[first:end].any():
            continue
        fan = _fan(a, b, first, end)
        room = _Hits(np.empty(end - first), np.empty(end - first, dtype=np.int64))
        most = _between_rays(0.0, reach, fan, visible, seen, viewpoints)
        for w in range(first, end):
            if not seen[w]:
                continue
            height = closest_to_level(visible.low[w], visible.top[w])
            most = max(most, _along_wall(a[w], b[w], height, texels[w], visible.viewpoints, visible.visible_from[w]))
            for ray in range(4 + len(_WITHIN)):
                t = 0.0 if ray < 2 else 1.0 if ray < 4 else _WITHIN[ray - 4]
                x, y = a[w, 0] + t * (b[w, 0] - a[w, 0]), a[w, 1] + t * (b[w, 1] - a[w, 1])
                turn = 0.0 if ray >= 4 else _ASIDE if ray % 2 else -_ASIDE
                x, y = x - turn * y, y + turn * x
                distance = math.hypot(x, y)
                ux, uy = x / distance, y / distance
                count = _meet(ux, uy, a, b, fan, room)
                if count:
                    on_ray(ux, uy, visible.viewpoints, viewpoints)
                    hits = _Hits(room.distances[:count], room.walls[:count])
                    most = _along_ray(most, reach, hits, visible, seen, texels, viewpoints)
        parallax[one] = angle_of(most)
    return parallax
