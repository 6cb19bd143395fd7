"""How far points of one capture ray move apart in the picture: weights that bound what layers get wrong (docs/bound.md).

A layer is captured once, from the cell's reference viewpoint C. What the capture misses is what some surface of the same
layer hides from C: a point X behind a point Y on one ray from C. Seen from anywhere else in the cell, whatever opens up
between the two is the strip of points that were on that ray, and it is as wide as the angle YMX. So not the angle between
any two points of two objects counts (the paper's weight, :mod:`mmi.parallax.paper_weights`), but that between points of one
ray:

- within one object, the *self-parallax*: what its own front hides of its sides and wings, and how far a wall (a roof, an
  underside) runs within one texel where the capture looks along it. An object that has more of it than the user allows
  stays geometry (:mod:`mmi.parallax.self_parallax`);
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
from numpy.typing import NDArray

from mmi.cells.viewing_cells import ViewingCell
from mmi.foundation.kernels import kernel
from mmi.parallax.ray_angles import RayViewpoints, on_ray, widest
from mmi.visibility.selection import WallVisibility
from mmi.visibility.visible_walls import VisibleWalls, visible_walls
from mmi.visibility.walls import Walls

__all__ = ["same_ray_weights"]

_APART = 1e-6
"""Two hits of a ray are one where their distances differ by less than this share."""


def same_ray_weights(
    cell: ViewingCell, walls: Walls, objects: NDArray[np.int64], wall_visibility: WallVisibility | None, *, quad: float
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Pairs (m, 2) of indices into ``objects`` that share rays, and how far points of them on one ray part, (m,) radians.

    ``quad`` is the angle in radians within which rays count as one. No object may meet the cell. Pairs that are not
    listed weigh nothing.
    """
    visible = visible_walls(cell, walls, objects, wall_visibility)
    table = _pair_weights(visible, max(8, math.ceil(2.0 * math.pi / quad)))
    table = np.triu(np.maximum(table, table.T), 1)
    pairs = np.argwhere(table > 0.0)
    return pairs, table[pairs[:, 0], pairs[:, 1]]


@kernel(error_model="numpy")
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


@kernel(error_model="numpy")
def _pair_weights(visible: VisibleWalls, columns: int) -> NDArray[np.float64]:
    """(n, n) radians: [i, j] for what of object j may open behind i, of the objects whose walls are ``visible``.

    Column by column: the nearest of each object that faces the reference against every wall of another that may be seen, in
    this column and its neighbours.
    """
    a, b, owner = visible.a, visible.b, visible.owner
    bottom, low, top = visible.bottom, visible.low, visible.top
    n, p, quad = len(visible.first) - 1, len(visible.viewpoints), 2.0 * math.pi / columns
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
        shows = visible.visible_from[w].any()
        for k in range(many):
            column = (begin + k) % columns
            if facing or visible.open[w]:
                i, (least, most) = owner[w], spans[k]
                if facing and least < nearest[column, i]:
                    nearest[column, i], closest[column, i] = least, w
                lowest[column, i] = min(lowest[column, i], bottom[w] / (least if bottom[w] < 0.0 else most))
                highest[column, i] = max(highest[column, i], top[w] / (least if top[w] > 0.0 else most))
        if shows:
            for k in range(-1, many + 1):
                counts[(begin + k) % columns + 1] += 1
    starts = np.cumsum(counts)
    place = starts[:-1].copy()
    behind, reach = np.empty(starts[-1], dtype=np.int64), np.empty((starts[-1], 2))
    for w in range(len(a)):
        if not visible.visible_from[w].any():
            continue
        begin, many = _columns_of(a[w, 0], a[w, 1], b[w, 0], b[w, 1], columns, rays, spans)
        for k in range(-1, many + 1):
            column = (begin + k) % columns
            inside = min(max(k, 0), many - 1)
            behind[place[column]], reach[place[column]] = w, spans[inside]
            place[column] += 1
    chords = np.zeros((n, n))
    viewpoints = RayViewpoints(np.empty(p), np.empty(p), visible.rise)
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
        on_ray(ux, uy, visible.viewpoints, viewpoints)
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
                    either[k] = visible.visible_from[w, k] or visible.visible_from[closest[column, i], k]
                chord = widest(near, far, from_slope, to_slope, viewpoints, either)
                chords[i, j] = max(chords[i, j], chord)
    return 2.0 * np.arcsin(np.minimum(0.5 * np.sqrt(chords), 1.0))
