"""The horizon sweep: which rings of walls rise above the skyline of a sampled viewpoint, column by column.

Everything numerical of :mod:`mmi.visibility.horizon` lives here and nothing else: rings in flat arrays, one Numba kernel. A
panorama is cut into ``columns`` equal azimuth columns. Per column the sweep keeps a staircase of (distance, slope): what
lies farther than the distance and no steeper than the slope is hidden. Slope is height above the eye over distance.

An occluder hides in a column only if a stretch of its ring enters the column at one boundary and leaves it at the other;
then every ray of the column meets the stretch no farther than its farthest point in the column, and that distance is
what counts. Walking the ring (rather than taking edge by edge) leaves no gap in the columns that hold its corners.

An occludee is seen if in some column that one of its edges touches, the top of the edge's nearest point there is not
hidden. The nearest point suffices: every other point of the object in that column is at least as far and no steeper (or
below the eye, where anything in front hides it), so what hides the nearest point's top hides them all; and the ray to a
point of roof or underside crosses an edge first.

The same walk says from where an edge is seen and how far down: of each viewpoint that sees it the *bin* (viewpoints that
follow each other share one), and the lowest height that one of them sees, since what a step hides at an edge's nearest
point it hides farther along the column up to a greater height. Here edges count as facing a viewpoint also where they
face what is within ``reach`` metres of it, since a viewpoint stands for its surroundings.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from mmi.foundation.kernels import kernel

__all__ = ["BINS", "Rings", "pack_rings", "sweep"]

BINS = 64
"""Bins of viewpoints, at most: an edge has a bit for each, which says whether it is seen from there."""

_STAIRS = 48
"""A column's staircase has at most so many steps. A step that finds it full is left out: less is hidden, nothing is lost."""

_RADIAL = 1e-6
"""Edges that turn by less than this share of a column point at the viewpoint: where they cross a boundary is not stable, so
they count with their farther end."""


class Rings(NamedTuple):
    """Closed rings, solid to their left, each with a height: ``xy`` (n, 2) metres, first vertex not repeated.

    Ring i is ``xy[starts[i] : starts[i + 1]]``; ``heights`` (r,) metres; ``boxes`` (r, 4) min x, min y, max x, max y;
    ``owners`` (r,) the polygon, counted as in the input of :func:`pack_rings`. Made by that, with arrays that are read-only.
    """

    xy: NDArray[np.float64]
    starts: NDArray[np.int64]
    heights: NDArray[np.float64]
    boxes: NDArray[np.float64]
    owners: NDArray[np.int64]


class _Panorama(NamedTuple):
    """The skyline of a viewpoint, column by column: the staircase of column c is ``steps[c, : counts[c]]``.

    ``steps`` (columns, _STAIRS, 2) are distances in metres and slopes, both growing; ``rays`` (columns, 2) are the directions
    of the boundaries at which columns begin.
    """

    rays: NDArray[np.float64]
    steps: NDArray[np.float64]
    counts: NDArray[np.int64]


class _Found(NamedTuple):
    """What the sweep finds: ``seen`` (objects,), and ``lowest`` and ``sight`` (e,) of edges, as :func:`sweep` returns them."""

    seen: NDArray[np.bool_]
    lowest: NDArray[np.float64]
    sight: NDArray[np.uint64]


def pack_rings(polygons: NDArray[np.object_], heights: NDArray[np.float64]) -> Rings:
    """All rings (exteriors and holes) of ``polygons`` (p,), which have ``heights`` (p,)."""
    rings, owners = shapely.get_rings(shapely.orient_polygons(polygons), return_index=True)
    xy, ring_of_point = shapely.get_coordinates(rings, return_index=True)
    closing = np.append(ring_of_point[1:] != ring_of_point[:-1], True) if len(xy) else np.empty(0, dtype=bool)
    counts = np.bincount(ring_of_point[~closing], minlength=len(rings))
    packed = Rings(
        xy=np.ascontiguousarray(xy[~closing]),
        starts=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        heights=heights[owners].astype(np.float64),
        boxes=shapely.bounds(rings).reshape(-1, 4),
        owners=owners.astype(np.int64),
    )
    for array in packed:
        array.setflags(write=False)
    return packed


def sweep(
    viewpoints: NDArray[np.float64],
    occluders: Rings,
    order: NDArray[np.int64],
    occludees: Rings,
    owners: NDArray[np.int64],
    seen: NDArray[np.bool_],
    *,
    columns: int,
    reach: float,
) -> tuple[NDArray[np.float64], NDArray[np.uint64]]:
    """Marks in ``seen`` (objects,) every object that some of ``viewpoints`` (k, 3) may see. Tells what of each edge shows.

    ``occluders`` hide with their height, from the ground up, and are looked at in ``order`` (r,): nearest first makes
    the rest cheap. Ring i of ``occludees`` belongs to object ``owners[i]``. No viewpoint may lie on an occluder's ring.

    Returns for each edge of ``occludees`` (e,), counted by its first vertex, the lowest height of it that may be seen
    (-inf: nothing hides it, inf: everything), and a set of bits: bit i where a viewpoint of bin i sees something of it.
    The k viewpoints fall into min(k, BINS) bins of successive ones.
    """
    turn = np.arange(columns) * (2.0 * math.pi / columns)
    rays = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    panorama = _Panorama(rays, np.empty((columns, _STAIRS, 2)), np.empty(columns, dtype=np.int64))
    edges = len(occludees.xy)
    found = _Found(seen, np.full(edges, math.inf), np.zeros(edges, dtype=np.uint64))
    _sweep(viewpoints, occluders, order, occludees, owners, reach, panorama, found)
    return found.lowest, found.sight


@kernel(error_model="numpy")
def _sweep(
    viewpoints: NDArray[np.float64],
    occluders: Rings,
    order: NDArray[np.int64],
    occludees: Rings,
    owners: NDArray[np.int64],
    reach: float,
    panorama: _Panorama,
    found: _Found,
) -> None:
    bins = min(len(viewpoints), BINS)
    for v in range(len(viewpoints)):
        x, y, eye = viewpoints[v]
        panorama.counts[:] = 0
        for ring in order:
            height = occluders.heights[ring] - eye
            if height > 0.0 and not _box_hidden(occluders.boxes[ring], x, y, height, panorama):
                _raise_horizon(occluders, ring, x, y, height, panorama)
        for ring in range(len(occludees.heights)):
            if _box_hidden(occludees.boxes[ring], x, y, occludees.heights[ring] - eye, panorama):
                continue
            bit = np.uint64(1) << np.uint64(v * bins // len(viewpoints))
            if _ring_seen(occludees, ring, viewpoints[v], reach, bit, panorama, found):
                found.seen[owners[ring]] = True


@kernel(error_model="numpy")
def _hidden(column: int, distance: float, slope: float, panorama: _Panorama) -> bool:
    """Whether a point at ``distance`` and ``slope`` is behind and below a step of the column's staircase."""
    return _skyline(column, distance, panorama) >= slope


@kernel(error_model="numpy")
def _skyline(column: int, distance: float, panorama: _Panorama) -> float:
    """The slope up to which a point at ``distance`` is hidden; -inf where nothing is in front of it."""
    steps = panorama.steps
    i = panorama.counts[column] - 1
    while i >= 0 and steps[column, i, 0] >= distance:
        i -= 1
    return steps[column, i, 1] if i >= 0 else -math.inf


@kernel(error_model="numpy")
def _add_step(column: int, distance: float, slope: float, panorama: _Panorama) -> None:
    """Keeps the staircase sorted by distance with growing slopes."""
    steps, counts = panorama.steps, panorama.counts
    n = counts[column]
    i = n
    while i > 0 and steps[column, i - 1, 0] > distance:
        i -= 1
    if i > 0 and steps[column, i - 1, 1] >= slope:
        return
    j = i
    while j < n and steps[column, j, 1] <= slope:
        j += 1
    if j == i:
        if n == _STAIRS:
            return
        for k in range(n, i, -1):
            steps[column, k, 0] = steps[column, k - 1, 0]
            steps[column, k, 1] = steps[column, k - 1, 1]
        counts[column] = n + 1
    elif j > i + 1:
        for k in range(j, n):
            steps[column, k - j + i + 1, 0] = steps[column, k, 0]
            steps[column, k - j + i + 1, 1] = steps[column, k, 1]
        counts[column] = n - (j - i - 1)
    steps[column, i, 0] = distance
    steps[column, i, 1] = slope


@kernel(error_model="numpy")
def _box_hidden(box: NDArray[np.float64], x: float, y: float, height: float, panorama: _Panorama) -> bool:
    """Whether everything in ``box`` (min x, min y, max x, max y) below ``height`` over the eye is hidden."""
    columns = len(panorama.counts)
    x0, y0, x1, y1 = box[0] - x, box[1] - y, box[2] - x, box[3] - y
    dx = max(x0, -x1, 0.0)
    dy = max(y0, -y1, 0.0)
    distance = math.hypot(dx, dy)
    if distance == 0.0:
        return False
    # the silhouette of the box, clockwise end (right) and counter-clockwise end (left) as seen from the viewpoint
    if x0 > 0.0:
        right_x, left_x = (x1 if y0 > 0.0 else x0), (x1 if y1 < 0.0 else x0)
    elif x1 < 0.0:
        right_x, left_x = (x0 if y1 < 0.0 else x1), (x0 if y0 > 0.0 else x1)
    else:
        right_x, left_x = (x1, x0) if y0 > 0.0 else (x0, x1)
    if y0 > 0.0:
        right_y, left_y = (y1 if x1 < 0.0 else y0), (y1 if x0 > 0.0 else y0)
    elif y1 < 0.0:
        right_y, left_y = (y0 if x0 > 0.0 else y1), (y0 if x1 < 0.0 else y1)
    else:
        right_y, left_y = (y0, y1) if x0 > 0.0 else (y1, y0)
    scale = columns / (2.0 * math.pi)
    first = math.atan2(right_y, right_x) * scale
    last = math.atan2(left_y, left_x) * scale
    if last < first:
        last += columns
    slope = height / distance
    for column in range(math.floor(first), math.floor(last) + 1):
        if not _hidden(column % columns, distance, slope, panorama):
            return False
    return True


@kernel(error_model="numpy")
def _raise_horizon(rings: Rings, ring: int, x: float, y: float, height: float, panorama: _Panorama) -> None:
    """Walks a ring and adds a step to each column that a stretch of it crosses from its upper to its lower boundary.

    That is the side of the ring that faces the viewpoint: the solid is to the left, so azimuth falls along it. ``height`` is
    that of the ring over the eye at (x, y).
    """
    xy, start, end, rays = rings.xy, rings.starts[ring], rings.starts[ring + 1], panorama.rays
    columns = len(rays)
    scale = columns / (2.0 * math.pi)
    ax, ay = xy[start, 0] - x, xy[start, 1] - y
    a_turn, a_far = math.atan2(ay, ax) * scale, math.hypot(ax, ay)
    a_column = math.floor(a_turn)
    from_above = False  # entered the present column through its upper boundary
    farthest = a_far  # of the stretch in the present column
    crossed = False  # a boundary during the first round
    n = end - start
    for i in range(1, 2 * n + 1):
        b = start + i % n
        bx, by = xy[b, 0] - x, xy[b, 1] - y
        b_turn, b_far = math.atan2(by, bx) * scale, math.hypot(bx, by)
        b_turn += columns * round((a_turn - b_turn) / columns)
        b_column = math.floor(b_turn)
        if b_column < a_column:
            ex, ey = bx - ax, by - ay
            cross = ax * ey - ay * ex
            both = max(a_far, b_far)
            radial = a_turn - b_turn < _RADIAL
            for boundary in range(a_column, b_column, -1):
                column = boundary % columns
                distance = cross / (rays[column, 0] * ey - rays[column, 1] * ex)
                if radial or not 0.0 <= distance <= both:
                    distance = both
                if from_above:
                    farthest = max(farthest, distance)
                    _add_step(column, farthest, height / farthest, panorama)
                from_above = True
                farthest = distance
        elif b_column > a_column:
            from_above = False
        if i > n and b_column != a_column:
            return  # the column in which the walk began is complete
        crossed = crossed or b_column != a_column
        if i == n and not crossed:
            return
        farthest = max(farthest, b_far)
        ax, ay, a_far, a_turn, a_column = bx, by, b_far, b_turn, b_column


@kernel(error_model="numpy")
def _ring_seen(
    rings: Rings,
    ring: int,
    viewpoint: NDArray[np.float64],
    reach: float,
    bit: np.uint64,
    panorama: _Panorama,
    found: _Found,
) -> bool:
    """Whether the top of an edge of the ring shows in a column that it touches. Edges that face away are left out.

    Of those that face the viewpoint (3,) or what is within ``reach`` of it, what was ``found`` is brought up to date: ``bit``
    is that of the viewpoint's bin.
    """
    xy, start, end, rays = rings.xy, rings.starts[ring], rings.starts[ring + 1], panorama.rays
    lowest, sight = found.lowest, found.sight
    x, y, eye = viewpoint
    height = rings.heights[ring] - eye
    columns = len(rays)
    scale = columns / (2.0 * math.pi)
    shows = False
    for first in range(start, end):
        second = first + 1 if first + 1 < end else start
        ax, ay, bx, by = xy[first, 0] - x, xy[first, 1] - y, xy[second, 0] - x, xy[second, 1] - y
        ex, ey = bx - ax, by - ay
        cross = ax * ey - ay * ex
        length = math.hypot(ex, ey)
        if cross > reach * length:
            continue
        facing = cross <= 0.0
        if not facing:
            ax, ay, bx, by, ex, ey = bx, by, ax, ay, -ex, -ey
        a_turn, b_turn = math.atan2(ay, ax) * scale, math.atan2(by, bx) * scale
        a_far, b_far = math.hypot(ax, ay), math.hypot(bx, by)
        down = b_turn + columns * round((a_turn - b_turn) / columns)
        if not facing:
            cross = ax * ey - ay * ex
        t = -(ax * ex + ay * ey) / length**2 if length > 0.0 else 0.0
        if t <= 0.0:
            foot, foot_column = a_far, math.floor(a_turn)
        elif t >= 1.0:
            foot, foot_column = b_far, math.floor(down)
        else:
            foot = math.hypot(ax + t * ex, ay + t * ey)
            foot_turn = math.atan2(ay + t * ey, ax + t * ex) * scale
            foot_column = math.floor(foot_turn + columns * round((a_turn - foot_turn) / columns))
        radial = a_turn - down < _RADIAL
        nearest = a_far
        for column in range(math.floor(max(a_turn, down)), math.floor(min(a_turn, down)) - 1, -1):
            # the edge in this column runs from ``nearest`` to ``leaving``
            leaving = b_far
            if column > down:
                ray = column % columns
                leaving = cross / (rays[ray, 0] * ey - rays[ray, 1] * ex)
            at_foot = radial or abs(column - foot_column) <= 1 or not leaving >= foot
            distance = (foot if at_foot else min(nearest, leaving)) * (1.0 - 1e-9)
            nearest = leaving
            hidden_slope = _skyline(column % columns, distance, panorama)
            if hidden_slope < height / distance:
                shows = shows or facing
                sight[first] |= bit
                if hidden_slope == -math.inf:
                    lowest[first] = -math.inf
                    break
                lowest[first] = min(lowest[first], eye + hidden_slope * distance)
    return shows
