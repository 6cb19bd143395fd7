"""How far points of one capture ray move apart in the picture: weights that bound what layers get wrong (docs/bound.md).

A layer is captured once, from the cell's reference viewpoint C. What the capture misses is what some surface of the same
layer hides from C: a point X behind a point Y on one ray from C. Seen from anywhere else in the cell, whatever opens up
between the two is the strip of points that were on that ray, and it is as wide as the angle YMX. So not the angle between
any two points of two objects counts (the paper's weight, :mod:`mmi.parallax.paper_weights`), but that between points of one
ray:

- within one object, the *self-parallax*: what its own front hides of its sides and wings, and how far a wall (a roof, an
  underside) runs within one texel where the capture looks along it. An object that has more of it than the user allows
  stays geometry (:func:`self_parallax`);
- between two objects, the *weight* of the pair (:func:`same_ray_weights`). Here rays count as one if they fall into one
  column or its neighbours: meshes connect what is next to each other in the texture.

X counts only as far as it may be seen at all, and only for viewpoints that may see it (between two objects, it or what is in
front of it: the mesh stretches between both): :class:`mmi.visibility.selection.WallVisibility` says what of a wall is
visible from which part of the cell (:mod:`mmi.visibility.visible_walls`). Rays meet two surfaces at a range of slopes
(height over distance). The angle is taken at the slope of this range that is closest to level, where moving sideways parts
them most, and where walking towards them does: at both ends, and where the difference of the two elevations is largest.
"""

from __future__ import annotations

import math

import numpy as np
import shapely
from numba import njit
from numpy.typing import NDArray

from mmi.cells.viewing_cells import ViewingCell
from mmi.city.model import City
from mmi.foundation.ray_chords import may_exceed
from mmi.parallax.critical_zone import cell_region
from mmi.parallax.texels import texel_ratios
from mmi.visibility.selection import WallVisibility
from mmi.visibility.visible_walls import visible_walls
from mmi.visibility.walls import Walls

__all__ = ["same_ray_weights", "self_parallax"]

_ASIDE = 1e-7
"""Radians: rays pass a corner this far on either side of it."""
_TOUCHING = 1e-6
"""Metres: an object this close to the cell's region counts as meeting it."""
_APART = 1e-6
"""Relative difference of distances below which two hits of a ray are one."""
_ROW = 40.0
"""Metres of a row of houses that the reference may see edge-on."""
_WITHIN = (0.25, 0.5, 0.75)
"""Where along a wall rays pass through it, besides its ends."""


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
    outlook = visible_walls(cell, walls, objects, wall_visibility)
    parallax = _self_parallax(
        outlook.a,
        outlook.b,
        outlook.bottom,
        outlook.low,
        outlook.top,
        outlook.first,
        outlook.whence,
        outlook.viewpoints,
        outlook.rise,
        outlook.open,
        texel / texel_ratios(walls, walls.of(objects), cell),
    )
    footprints = [city.objects[i].footprint for i in objects]
    parallax[shapely.distance(footprints, cell_region(cell)) <= _TOUCHING] = math.inf
    return parallax


def same_ray_weights(
    cell: ViewingCell, walls: Walls, objects: NDArray[np.int64], wall_visibility: WallVisibility | None, *, quad: float
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Pairs (m, 2) of indices into ``objects`` that share rays, and how far points of them on one ray part, (m,) radians.

    ``quad`` is the angle in radians within which rays count as one. No object may meet the cell. Pairs that are not
    listed weigh nothing.
    """
    outlook = visible_walls(cell, walls, objects, wall_visibility)
    columns = max(8, math.ceil(2.0 * math.pi / quad))
    table = _pair_weights(
        outlook.a,
        outlook.b,
        outlook.bottom,
        outlook.low,
        outlook.top,
        outlook.owner,
        len(objects),
        outlook.whence,
        outlook.open,
        outlook.viewpoints,
        outlook.rise,
        columns,
    )
    table = np.triu(np.maximum(table, table.T), 1)
    pairs = np.argwhere(table > 0.0)
    return pairs, table[pairs[:, 0], pairs[:, 1]]


@njit(cache=True, error_model="numpy", fastmath=True)
def _widest(
    near: float,
    far: float,
    lowest: float,
    highest: float,
    along: NDArray[np.float64],
    aside: NDArray[np.float64],
    whence: NDArray[np.bool_],
    rise: float,
) -> float:
    """Largest square of the chord between the directions to two points of a ray, over the viewpoints of ``whence`` (p,).

    The points are ``near`` and ``far`` metres away (horizontally) on rays of slopes from ``lowest`` to ``highest``; the
    viewpoints are ``along`` and ``aside`` (p,) metres from the reference, along the ray and to its side. ``rise`` metres more
    or less of height add what they turn the two directions by.
    """
    most = 0.0
    level = _level(lowest, highest)
    for k in range(len(whence)):
        if not whence[k]:
            continue
        x1, x2, y = near - along[k], far - along[k], aside[k]
        r1, r2 = x1 * x1 + y * y, x2 * x2 + y * y
        # Elevations part most where d/ds (atan(near s / r1) - atan(far s / r2)) = 0.
        steep = math.sqrt(math.sqrt(r1 * r2) / (near * far))
        for slope in (lowest, level, highest, min(max(steep, lowest), highest)):
            z1, z2 = slope * near, slope * far
            n1, n2 = 1.0 / math.sqrt(r1 + z1 * z1), 1.0 / math.sqrt(r2 + z2 * z2)
            dx, dy, dz = x1 * n1 - x2 * n2, y * (n1 - n2), abs(z1 * n1 - z2 * n2) + rise * abs(n1 - n2)
            most = max(most, dx * dx + dy * dy + dz * dz)
    return most


@njit(cache=True, error_model="numpy")
def _angle(chord_square: float) -> float:
    """The angle between unit vectors whose tips are that far apart."""
    return 2.0 * math.asin(min(0.5 * math.sqrt(chord_square), 1.0))


@njit(cache=True, error_model="numpy")
def _level(low: float, high: float) -> float:
    """The number in [low, high] that is closest to zero."""
    return min(max(0.0, low), high)


@njit(cache=True, error_model="numpy")
def _along_wall(
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    height: float,
    texel: float,
    viewpoints: NDArray[np.float64],
    whence: NDArray[np.bool_],
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
        for k in range(len(whence)):
            if whence[k]:
                x1 = a[0] + pieces[place, 0] * ex - viewpoints[k, 0]
                y1 = a[1] + pieces[place, 0] * ey - viewpoints[k, 1]
                x2 = a[0] + pieces[place, 1] * ex - viewpoints[k, 0]
                y2 = a[1] + pieces[place, 1] * ey - viewpoints[k, 1]
                n1 = 1.0 / math.sqrt(x1 * x1 + y1 * y1 + height * height)
                n2 = 1.0 / math.sqrt(x2 * x2 + y2 * y2 + height * height)
                dx, dy, dz = x1 * n1 - x2 * n2, y1 * n1 - y2 * n2, height * (n1 - n2)
                most = max(most, dx * dx + dy * dy + dz * dz)
    return most


@njit(cache=True, error_model="numpy")
def _self_parallax(
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    bottom: NDArray[np.float64],
    low: NDArray[np.float64],
    top: NDArray[np.float64],
    first: NDArray[np.int64],
    whence: NDArray[np.bool_],
    viewpoints: NDArray[np.float64],
    rise: float,
    ends: NDArray[np.bool_],
    texels: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Rays through the ends of every wall that may be seen, just beside them, and through points between."""
    n, p = len(first) - 1, len(viewpoints)
    parallax = np.zeros(n)
    along, aside = np.empty(p), np.empty(p)
    reach = rise
    for k in range(p):
        reach = max(reach, rise + math.hypot(viewpoints[k, 0], viewpoints[k, 1]))
    seen = np.empty(len(a), dtype=np.bool_)
    for w in range(len(a)):
        seen[w] = whence[w].any()
    for one in range(n):
        start, end = first[one], first[one + 1]
        hits, walls = np.empty(end - start), np.empty(end - start, dtype=np.int64)
        most = 0.0
        for w in range(start, end):
            if not seen[w]:
                continue
            height = _level(low[w], top[w])
            most = max(most, _along_wall(a[w], b[w], height, texels[w], viewpoints, whence[w]))
            for ray in range(4 + len(_WITHIN)):
                t = 0.0 if ray < 2 else 1.0 if ray < 4 else _WITHIN[ray - 4]
                x, y = a[w, 0] + t * (b[w, 0] - a[w, 0]), a[w, 1] + t * (b[w, 1] - a[w, 1])
                turn = 0.0 if ray >= 4 else _ASIDE if ray % 2 else -_ASIDE
                x, y = x - turn * y, y + turn * x
                distance = math.hypot(x, y)
                ux, uy = x / distance, y / distance
                count, nearest = 0, np.inf
                for i in range(start, end):
                    ca, cb = ux * a[i, 1] - uy * a[i, 0], ux * b[i, 1] - uy * b[i, 0]
                    if (ca > 0.0) == (cb > 0.0):
                        continue
                    s = ca / (ca - cb)
                    hit = ux * (a[i, 0] + s * (b[i, 0] - a[i, 0])) + uy * (a[i, 1] + s * (b[i, 1] - a[i, 1]))
                    if hit > 0.0:
                        hits[count], walls[count] = hit, i
                        count, nearest = count + 1, min(nearest, hit)
                for k in range(p):
                    along[k] = ux * viewpoints[k, 0] + uy * viewpoints[k, 1]
                    aside[k] = ux * viewpoints[k, 1] - uy * viewpoints[k, 0]
                for i in range(count):
                    back, far = walls[i], hits[i]
                    if not seen[back] or not may_exceed(most, nearest, far, reach):
                        continue
                    if ends[back]:  # how far its roof or underside runs within a texel
                        level = bottom[back] if bottom[back] > -rise else top[back]
                        near = max(far - far * far * texels[back] / max(abs(level), 1e-6), nearest)
                        if may_exceed(most, near, far, reach):
                            slope = level / far
                            most = max(most, _widest(near, far, slope, slope, along, aside, whence[back], rise))
                    for j in range(count):
                        front, near = walls[j], hits[j]
                        facing = a[front, 0] * b[front, 1] - a[front, 1] * b[front, 0] < 0.0
                        if not facing or near >= far * (1.0 - _APART) or not may_exceed(most, near, far, reach):
                            continue
                        lowest = max(bottom[front] / near, low[back] / far)
                        highest = min(top[front] / near, top[back] / far)
                        if lowest > highest:
                            continue
                        most = max(most, _widest(near, far, lowest, highest, along, aside, whence[back], rise))
        parallax[one] = _angle(most)
    return parallax


@njit(cache=True, error_model="numpy")
def _columns_of(
    ax: float, ay: float, bx: float, by: float, columns: int, rays: NDArray[np.float64], spans: NDArray[np.float64]
) -> tuple[int, int]:
    """The first column that a wall touches and how many; ``spans`` (columns, 2) gets its least and largest distance in each."""
    scale = columns / (2.0 * math.pi)
    if ax * by - ay * bx < 0.0:
        ax, ay, bx, by = bx, by, ax, ay
    start = math.atan2(ay, ax) * scale
    end = start + math.atan2(ax * by - ay * bx, ax * bx + ay * by) * scale
    ex, ey = bx - ax, by - ay
    square = ex * ex + ey * ey
    t = min(max(-(ax * ex + ay * ey) / square, 0.0), 1.0) if square > 0.0 else 0.0
    fx, fy = ax + t * ex, ay + t * ey
    foot = start + math.atan2(ax * fy - ay * fx, ax * fx + ay * fy) * scale
    cross = ax * ey - ay * ex
    begin, last = math.floor(start), math.floor(end)
    entering = math.hypot(ax, ay)
    for column in range(begin, last + 1):
        leaving = math.hypot(bx, by)
        if column < last:
            ray = (column + 1) % columns
            leaving = cross / (rays[ray, 0] * ey - rays[ray, 1] * ex)
        least = min(entering, leaving)
        if column <= foot < column + 1:
            least = math.hypot(fx, fy)
        spans[column - begin, 0], spans[column - begin, 1] = least, max(entering, leaving)
        entering = leaving
    return begin, last - begin + 1


@njit(cache=True, error_model="numpy")
def _pair_weights(
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    bottom: NDArray[np.float64],
    low: NDArray[np.float64],
    top: NDArray[np.float64],
    owner: NDArray[np.int64],
    n: int,
    whence: NDArray[np.bool_],
    ends: NDArray[np.bool_],
    viewpoints: NDArray[np.float64],
    rise: float,
    columns: int,
) -> NDArray[np.float64]:
    """(n, n) radians: [i, j] for what of object j may open behind i.

    Column by column: the nearest of each object that faces the reference against every wall of another that may be seen, in
    this column and its neighbours.
    """
    p, quad = len(viewpoints), 2.0 * math.pi / columns
    turn = np.arange(columns) * quad
    rays = np.stack((np.cos(turn), np.sin(turn)), axis=1)
    spans = np.empty((columns + 2, 2))
    # Per column and object: distance, least and largest slope of what is nearest of it there.
    nearest = np.full((columns, n), math.inf)
    lowest, highest = np.full((columns, n), math.inf), np.full((columns, n), -math.inf)
    closest = np.zeros((columns, n), dtype=np.int64)
    counts = np.zeros(columns + 1, dtype=np.int64)
    for w in range(len(a)):
        begin, many = _columns_of(a[w, 0], a[w, 1], b[w, 0], b[w, 1], columns, rays, spans)
        facing = a[w, 0] * b[w, 1] - a[w, 1] * b[w, 0] < 0.0
        visible = whence[w].any()
        for k in range(many):
            column = (begin + k) % columns
            if facing or ends[w]:
                i, (least, most) = owner[w], spans[k]
                if facing and least < nearest[column, i]:
                    nearest[column, i], closest[column, i] = least, w
                lowest[column, i] = min(lowest[column, i], bottom[w] / (least if bottom[w] < 0.0 else most))
                highest[column, i] = max(highest[column, i], top[w] / (least if top[w] > 0.0 else most))
        if visible:
            for k in range(-1, many + 1):
                counts[(begin + k) % columns + 1] += 1
    starts = np.cumsum(counts)
    place = starts[:-1].copy()
    behind, reach = np.empty(starts[-1], dtype=np.int64), np.empty((starts[-1], 2))
    for w in range(len(a)):
        if not whence[w].any():
            continue
        begin, many = _columns_of(a[w, 0], a[w, 1], b[w, 0], b[w, 1], columns, rays, spans)
        for k in range(-1, many + 1):
            column = (begin + k) % columns
            inside = min(max(k, 0), many - 1)
            behind[place[column]], reach[place[column]] = w, spans[inside]
            place[column] += 1
    chords = np.zeros((n, n))
    along, aside = np.empty(p), np.empty(p)
    either = np.empty(p, dtype=np.bool_)
    fronts = np.empty(n, dtype=np.int64)
    for column in range(columns):
        many = 0
        for i in range(n):
            if nearest[column, i] < math.inf:
                fronts[many] = i
                many += 1
        if not many or starts[column] == starts[column + 1]:
            continue
        ux, uy = math.cos(turn[column] + 0.5 * quad), math.sin(turn[column] + 0.5 * quad)
        for k in range(p):
            along[k] = ux * viewpoints[k, 0] + uy * viewpoints[k, 1]
            aside[k] = ux * viewpoints[k, 1] - uy * viewpoints[k, 0]
        for entry in range(starts[column], starts[column + 1]):
            w, (least, far) = behind[entry], reach[entry]
            j = owner[w]
            bottommost = low[w] / (least if low[w] < 0.0 else far)
            topmost = top[w] / (least if top[w] > 0.0 else far)
            for f in range(many):
                i = fronts[f]
                near = nearest[column, i]
                if i == j or near >= far * (1.0 - _APART):
                    continue
                from_slope = max(lowest[column, i], bottommost) - quad
                to_slope = min(highest[column, i], topmost) + quad
                if from_slope > to_slope:
                    continue
                for k in range(p):
                    either[k] = whence[w, k] or whence[closest[column, i], k]
                chord = _widest(near, far, from_slope, to_slope, along, aside, either, rise)
                chords[i, j] = max(chords[i, j], chord)
    return 2.0 * np.arcsin(np.minimum(0.5 * np.sqrt(chords), 1.0))
