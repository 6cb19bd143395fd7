"""How far two objects can move against each other in the picture while the viewer stays in a cell (paper section 4.1).

The paper's weight is the change of the angle AMB over the cell (eqs. (3)-(5)) for a point A of one object
and B of the other. Here it is bounded over all pairs of their points. The signed change between two viewpoints M and M' is
g(B) - g(A), where g(X) is the angle under which X sees M and M'. So the largest change is the largest over M, M' of (max of
g over one object) - (min of g over the other): no loop over pairs of points. g is harmonic in X, so the outlines are all
that counts, and M, M' need to be looked for on the boundary of the cell's region only.

Weights between objects come from a function ``(cell, objects) -> (pairs, weights)``. :func:`critical_zone_weights` is
the paper's choice (``--weights critical-zone``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from mmi.cells.viewing_cells import ViewingCell
from mmi.city.model import CityObject
from mmi.foundation.kernels import kernel
from mmi.parallax.critical_zone import cell_region, interacting_pairs

__all__ = ["critical_zone_weights", "pair_weights"]

_TOUCHING = 1e-6
"""Metres: an object this close to the cell's region counts as meeting it."""
_TOLERANCE = 1e-3
"""Radians: sampling may add this much to the bound of an object that is as far away as the cell is large (see _spacing)."""
_MOST_SAMPLES = 64
"""The cell's boundary has at most so many samples, and an edge of an outline as many pieces. Fewer make the bound less tight,
never unsafe."""


def critical_zone_weights(
    cell: ViewingCell, objects: Sequence[CityObject], *, signed: bool = True
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The paper's weights: pairs (m, 2) of indices into ``objects`` that can overlap, and their weights (m,) in radians.

    Pairs that are not listed weigh nothing: neither object meets the other's critical zone. See :func:`pair_weights`.
    """
    footprints = [one.footprint for one in objects]
    pairs = interacting_pairs(cell, footprints)
    return pairs, pair_weights(cell, footprints, pairs, signed=signed)


def pair_weights(
    cell: ViewingCell, outlines: Sequence[BaseGeometry], pairs: NDArray[np.int64], *, signed: bool = True
) -> NDArray[np.float64]:
    """Upper bound, for each pair of objects, of the change over the cell of the angle between any two of their points.

    ``outlines`` are footprints (polygons or multipolygons, metres), ``pairs`` (m, 2) indices into them. Returns (m,)
    radians: at least what any point A of one object, B of the other and two viewpoints in the cell's region show, in the
    plane. Outlines and the cell's boundary are sampled; what sampling could miss is added from bounds on second
    derivatives (see _outline_samples and _object_tables), a few per cent of the weight. An object that meets the
    region has no bound: 2 pi (signed) or pi.
    """
    pairs = np.asarray(pairs, dtype=np.int64).reshape(-1, 2)
    region = cell_region(cell)
    distances = np.asarray(shapely.distance(list(outlines), region), dtype=np.float64)
    weights = np.full(len(pairs), 2.0 * math.pi if signed else math.pi)
    clear = distances > _TOUCHING
    bounded = clear[pairs].all(axis=1)
    used = np.unique(pairs[bounded])
    if not used.size:
        return weights
    half_length, half_width = 0.5 * cell.length, cell.half_width
    coordinates, ring_ends, ring_owner = _rings_in_cell_frame(cell, region, [outlines[i] for i in used])
    points, slack, sum_slack, object_ends = _outline_samples(
        coordinates, ring_ends, ring_owner, len(used), half_length, half_width
    )
    boundary = _boundary_samples(half_length, half_width, float(distances[used].min()))
    place = np.searchsorted(used, pairs[bounded])
    rising, falling = _object_tables(points, slack, object_ends, boundary)
    if signed:
        weights[bounded] = _largest_changes(rising, falling, place)
    else:
        least, most = _object_sums(points, sum_slack, object_ends, boundary)
        weights[bounded] = _largest_unsigned_changes(rising, falling, least, most, place, len(boundary))
    return weights


def _rings_in_cell_frame(
    cell: ViewingCell, region: BaseGeometry, outlines: Sequence[BaseGeometry]
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Coordinates (n, 2) relative to the cell's centre and axis, where each ring ends, and to which outline it belongs.

    Courtyards count only where the cell lies in one: elsewhere a harmonic function has its extremes on the exterior.
    """
    parts, owner = shapely.get_parts(list(outlines), return_index=True)
    rings = shapely.get_exterior_ring(parts)
    around = np.flatnonzero(shapely.intersects(shapely.polygons(rings), region))
    if around.size:
        inner = [(ring, owner[i]) for i in around for ring in parts[i].interiors]
        rings = np.concatenate([rings, np.array([ring for ring, _ in inner], dtype=object)])
        owner = np.concatenate([owner, np.array([one for _, one in inner], dtype=owner.dtype)])
        order = np.argsort(owner, kind="stable")
        rings, owner = rings[order], owner[order]
    offset = shapely.get_coordinates(rings) - cell.reference[:2]
    along = (np.array(cell.q) - np.array(cell.p)) / cell.length
    coordinates = np.stack([offset @ along, along[0] * offset[:, 1] - along[1] * offset[:, 0]], axis=1)
    return coordinates, np.cumsum(shapely.get_num_coordinates(rings)).astype(np.int64), owner.astype(np.int64)


def _boundary_samples(half_length: float, half_width: float, nearest: float) -> NDArray[np.float64]:
    """(k, 2) points around the region's boundary, corners included, dense enough for an object ``nearest`` metres away."""
    step = _spacing(nearest, 2.0 * math.hypot(half_length, half_width))
    step = max(step, 4.0 * (half_length + half_width) / (_MOST_SAMPLES - 4))
    n = [math.ceil(2.0 * half_length / step), math.ceil(2.0 * half_width / step)] * 2
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * (half_length, half_width)
    sides = [np.linspace(corners[i], corners[(i + 1) % 4], n[i], endpoint=False) for i in range(4)]
    return np.concatenate(sides)


@kernel(error_model="numpy")
def _spacing(distance: float, diameter: float) -> float:
    """Metres between samples, ``distance`` metres away from the cell, that add _TOLERANCE * diameter / distance radians.

    A piece of length h adds h^2 / 8 of the second derivative, which is at most 2 / d^2 and 2 diameter / d^3.
    """
    return 2.0 * math.sqrt(_TOLERANCE * distance * max(distance, diameter))


@kernel(error_model="numpy")
def _gap(x0: float, y0: float, x1: float, y1: float, half_length: float, half_width: float) -> float:
    """Metres between a segment outside the rectangle |x| <= half_length, |y| <= half_width and that rectangle."""
    least = math.inf
    for x, y in ((x0, y0), (x1, y1)):
        least = min(least, math.hypot(max(abs(x) - half_length, 0.0), max(abs(y) - half_width, 0.0)))
    dx, dy = x1 - x0, y1 - y0
    square = dx * dx + dy * dy
    if square > 0.0:
        for x, y in (
            (-half_length, -half_width),
            (half_length, -half_width),
            (half_length, half_width),
            (-half_length, half_width),
        ):
            t = min(max(((x - x0) * dx + (y - y0) * dy) / square, 0.0), 1.0)
            least = min(least, math.hypot(x0 + t * dx - x, y0 + t * dy - y))
    return least


@kernel(error_model="numpy")
def _outline_samples(
    coordinates: NDArray[np.float64],
    ring_ends: NDArray[np.int64],
    ring_owner: NDArray[np.int64],
    n: int,
    half_length: float,
    half_width: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Points on the outlines, and how much g (and the sum of azimuths) can exceed its values there between two of them.

    Along a straight edge the azimuth of X from M has a second derivative of at most 1 / d^2, its difference between M
    and M' one of at most 2 / d^2 and 2 |MM'| / d^3 (the third derivative is at most 2 / d^3). On a piece of length h a
    function exceeds its chord by at most h^2 / 8 of that.
    """
    diameter = 2.0 * math.hypot(half_length, half_width)
    most = len(coordinates) * (_MOST_SAMPLES + 2)
    points = np.empty((most, 3))
    slack, sum_slack = np.zeros(most), np.zeros(most)
    object_ends = np.zeros(n, dtype=np.int64)
    count, begin, base = 0, 0, 0.0
    for ring in range(len(ring_ends)):
        # The azimuth from the cell's centre (third column) follows the ring without jumps, from the object's first point.
        first_of_object = ring == 0 or ring_owner[ring] != ring_owner[ring - 1]
        x, y = coordinates[begin]
        azimuth = math.atan2(y, x)
        base = azimuth if first_of_object else base
        azimuth -= 2.0 * math.pi * round((azimuth - base) / (2.0 * math.pi))
        points[count] = (x, y, azimuth)
        count += 1
        for k in range(begin + 1, ring_ends[ring]):
            (x0, y0), (x1, y1) = coordinates[k - 1], coordinates[k]
            length = math.hypot(x1 - x0, y1 - y0)
            done = 0.0
            while done < length:
                here = math.hypot(max(abs(x) - half_length, 0.0), max(abs(y) - half_width, 0.0))
                step = max(_spacing(here, diameter), length / _MOST_SAMPLES)
                done = length if length - done <= 1.25 * step else done + step
                nx, ny = x0 + done / length * (x1 - x0), y0 + done / length * (y1 - y0)
                azimuth += math.atan2(x * ny - y * nx, x * nx + y * ny)
                gap = _gap(x, y, nx, ny, half_length, half_width)
                square = (nx - x) ** 2 + (ny - y) ** 2
                bound = 0.25 * square / gap**2
                sum_slack[count - 1], sum_slack[count] = max(sum_slack[count - 1], bound), bound
                bound *= min(1.0, diameter / gap)
                slack[count - 1], slack[count] = max(slack[count - 1], bound), bound
                x, y = nx, ny
                points[count] = (x, y, azimuth)
                count += 1
        begin = ring_ends[ring]
        object_ends[ring_owner[ring]] = count
    return points[:count], slack[:count], sum_slack[:count], object_ends


@kernel(error_model="numpy")
def _azimuth_bounds(
    x: float, y: float, boundary: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]
) -> None:
    """Fill ``low``, ``high`` (k,): between boundary samples, chords of these enclose the azimuth of (x, y) less that
    from the centre. It is monotonic on a straight side, and its second derivative is 2 |t y| / (t^2 + y^2)^2.
    """
    n = len(boundary)
    for k in range(n):
        mx, my = boundary[k]
        low[k] = math.atan2(y * mx - x * my, x * (x - mx) + y * (y - my))
        high[k] = 0.0
    for k in range(n):
        after = (k + 1) % n
        mx, my = boundary[k]
        dx, dy = boundary[after, 0] - mx, boundary[after, 1] - my
        h = math.hypot(dx, dy)
        t, off = ((x - mx) * dx + (y - my) * dy) / h, abs(dx * (y - my) - dy * (x - mx)) / h
        square = max(-t, 0.0, t - h) ** 2 + off * off
        curvature = min(1.0, 2.0 * max(abs(t), abs(t - h)) * off / square) / square
        slack = min(0.125 * h * h * curvature, abs(low[after] - low[k]))
        high[k], high[after] = max(high[k], slack), max(high[after], slack)
    for k in range(n):
        low[k], high[k] = low[k] - high[k], low[k] + high[k]


@kernel(error_model="numpy")
def _object_tables(
    points: NDArray[np.float64],
    slack: NDArray[np.float64],
    object_ends: NDArray[np.int64],
    boundary: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Per object and pair M, M' of boundary samples: bounds of max g and of max -g over the object, each (n, k(k+1)/2)."""
    n, k = len(object_ends), len(boundary)
    rising, falling = np.full((n, k * (k + 1) // 2), -math.inf), np.full((n, k * (k + 1) // 2), -math.inf)
    low, high = np.empty(k), np.empty(k)
    begin = 0
    for one in range(n):
        for i in range(begin, object_ends[one]):
            _azimuth_bounds(points[i, 0], points[i, 1], boundary, low, high)
            at = 0
            for m in range(k):
                up, down = slack[i] - low[m], slack[i] + high[m]
                up_row, down_row = rising[one, at : at + k - m], falling[one, at : at + k - m]
                for j in range(k - m):
                    rise, fall = high[m + j] + up, down - low[m + j]
                    up_row[j] = rise if rise > up_row[j] else up_row[j]
                    down_row[j] = fall if fall > down_row[j] else down_row[j]
                at += k - m
        begin = object_ends[one]
    return np.minimum(rising, math.pi), np.minimum(falling, math.pi)


@kernel(error_model="numpy")
def _largest_changes(
    rising: NDArray[np.float64], falling: NDArray[np.float64], pairs: NDArray[np.int64]
) -> NDArray[np.float64]:
    """(m,) for each pair of objects, the largest of max g over one plus max -g over the other."""
    weights = np.empty(len(pairs))
    lanes = np.empty(64)
    for i in range(len(pairs)):
        up_a, down_a, up_b, down_b = (
            rising[pairs[i, 0]],
            falling[pairs[i, 0]],
            rising[pairs[i, 1]],
            falling[pairs[i, 1]],
        )
        lanes[:] = 0.0
        for start in range(0, len(up_a), 64):
            for j in range(min(64, len(up_a) - start)):
                one, other = up_a[start + j] + down_b[start + j], down_a[start + j] + up_b[start + j]
                change = one if one > other else other
                lanes[j] = change if change > lanes[j] else lanes[j]
        weights[i] = lanes.max()
    return weights


@kernel(error_model="numpy")
def _object_sums(
    points: NDArray[np.float64],
    sum_slack: NDArray[np.float64],
    object_ends: NDArray[np.int64],
    boundary: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Like _object_tables, for the sum of the azimuths from M and M': bounds of its least and greatest value."""
    n, k = len(object_ends), len(boundary)
    least, most = np.full((n, k * (k + 1) // 2), math.inf), np.full((n, k * (k + 1) // 2), -math.inf)
    low, high = np.empty(k), np.empty(k)
    begin = 0
    for one in range(n):
        for i in range(begin, object_ends[one]):
            _azimuth_bounds(points[i, 0], points[i, 1], boundary, low, high)
            at = 0
            for m in range(k):
                for j in range(m, k):
                    least[one, at] = min(least[one, at], 2.0 * points[i, 2] + low[m] + low[j] - sum_slack[i])
                    most[one, at] = max(most[one, at], 2.0 * points[i, 2] + high[m] + high[j] + sum_slack[i])
                    at += 1
        begin = object_ends[one]
    return least, most


@kernel(error_model="numpy")
def _largest_unsigned_changes(
    rising: NDArray[np.float64],
    falling: NDArray[np.float64],
    least: NDArray[np.float64],
    most: NDArray[np.float64],
    pairs: NDArray[np.int64],
    k: int,
) -> NDArray[np.float64]:
    """(m,) for each pair of objects, a bound of the change of the unsigned angle.

    The unsigned angle is even in the signed one, so it changes by no more than theta(M) - theta(M') and by no more than
    theta(M) + theta(M'), turned by any multiple of 2 pi. The sum decouples like the difference does. The smaller of the
    two counts, bounded over all M and M' between neighbouring samples at a time.
    """
    weights = np.empty(len(pairs))
    difference, low, high = np.empty((k, k)), np.empty((k, k)), np.empty((k, k))
    for i in range(len(pairs)):
        a, b = pairs[i]
        at = 0
        for m in range(k):
            for j in range(m, k):
                change = max(rising[a, at] + falling[b, at], falling[a, at] + rising[b, at])
                difference[m, j] = difference[j, m] = change
                low[m, j] = low[j, m] = least[b, at] - most[a, at]
                high[m, j] = high[j, m] = most[b, at] - least[a, at]
                at += 1
        weight = 0.0
        for m in range(k):
            m1 = (m + 1) % k
            for j in range(m, k):
                j1 = (j + 1) % k
                change = max(difference[m, j], difference[m1, j], difference[m, j1], difference[m1, j1])
                if change > weight:
                    start = min(low[m, j], low[m1, j], low[m, j1], low[m1, j1])
                    stop = max(high[m, j], high[m1, j], high[m, j1], high[m1, j1])
                    weight = max(weight, min(change, _farthest_from_full_turns(start, stop)))
        weights[i] = weight
    return weights


@kernel(error_model="numpy")
def _farthest_from_full_turns(low: float, high: float) -> float:
    """Largest distance of a number in [low, high] to the multiples of 2 pi."""
    turn = 2.0 * math.pi
    shifted = low - turn * math.floor(low / turn)
    end = shifted + high - low
    if (shifted <= math.pi and end >= math.pi) or end >= 3.0 * math.pi:
        return math.pi
    return max(min(shifted, turn - shifted), min(abs(end), abs(end - turn)))
