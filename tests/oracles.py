"""Rays cast at a city's prisms by brute force, and viewpoints to cast them from, to hold visibility and weights against.

Shares no code with what it checks.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from numba import njit


class PrismRays:
    """First hits of 3D rays on the walls, roofs and undersides of a city's prisms. The ground stops rays as well.

    A grid of buckets over the plan only leaves out prisms that a ray's vertical plane does not pass.
    """

    def __init__(self, city, *, bucket=30.0):
        walls, prisms = [], []
        for i, one in enumerate(city.objects):
            for prism in one.prisms:
                for ring in (prism.footprint.exterior, *prism.footprint.interiors):
                    xy = np.asarray(ring.coords)
                    walls += [(*a, *b, len(prisms)) for a, b in itertools.pairwise(xy)]
                prisms.append((i, prism.bottom, prism.top, *prism.footprint.bounds))
        self.walls = np.array(walls, dtype=np.float64)
        self.prisms = np.array(prisms, dtype=np.float64)
        self.ground = city.ground
        self.low = self.prisms[:, 3:5].min(axis=0) - 1.0
        self.bucket = bucket
        size = np.ceil((self.prisms[:, 5:7].max(axis=0) + 1.0 - self.low) / bucket).astype(np.int64)
        members = [[] for _ in range(size[0] * size[1])]
        for p, box in enumerate(self.prisms[:, 3:7]):
            first = ((box[:2] - self.low) // bucket).astype(int)
            last = ((box[2:] - self.low) // bucket).astype(int)
            for gx in range(first[0], last[0] + 1):
                for gy in range(first[1], last[1] + 1):
                    members[gy * size[0] + gx].append(p)
        self.size = size
        self.starts = np.concatenate([[0], np.cumsum([len(one) for one in members])]).astype(np.int64)
        self.members = np.array([p for one in members for p in one], dtype=np.int64)
        order = np.argsort(self.walls[:, 4], kind="stable")
        self.walls = self.walls[order]
        self.wall_starts = np.searchsorted(self.walls[:, 4], np.arange(len(prisms) + 1)).astype(np.int64)

    def first_hits(self, origins, directions):
        """origins, directions (n, 3) -> (n,) index of the first object hit, -1 for none (or the ground)."""
        return _first_hits(
            np.ascontiguousarray(origins, dtype=np.float64),
            np.ascontiguousarray(directions, dtype=np.float64),
            self.walls,
            self.wall_starts,
            self.prisms,
            self.starts,
            self.members,
            self.low,
            self.size,
            self.bucket,
            self.ground,
        )


@njit(cache=True, error_model="numpy")
def _first_hits(origins, directions, walls, wall_starts, prisms, starts, members, low, size, bucket, ground):
    hits = np.full(len(origins), -1, dtype=np.int64)
    tallest = prisms[:, 2].max() + 1.0
    for r in range(len(origins)):
        x, y, z = origins[r]
        dx, dy, dz = directions[r]
        best = np.inf
        if dz != 0.0:  # nothing is hit below the ground or above the tallest
            best = max((ground - z) / dz, (tallest - z) / dz)
        gx, gy = math.floor((x - low[0]) / bucket), math.floor((y - low[1]) / bucket)
        entered = 0.0  # where the ray enters the present bucket
        while entered < best:
            if 0 <= gx < size[0] and 0 <= gy < size[1]:
                cell = gy * size[0] + gx
                for m in range(starts[cell], starts[cell + 1]):
                    t = _meets(x, y, z, dx, dy, dz, walls, wall_starts, prisms, members[m])
                    if t < best:
                        best = t
                        hits[r] = int(prisms[members[m], 0])
            elif (dx <= 0.0 if gx < 0 else dx >= 0.0 and gx >= size[0]) or (
                dy <= 0.0 if gy < 0 else dy >= 0.0 and gy >= size[1]
            ):
                break
            tx = (low[0] + (gx + (dx > 0.0)) * bucket - x) / dx if dx != 0.0 else np.inf
            ty = (low[1] + (gy + (dy > 0.0)) * bucket - y) / dy if dy != 0.0 else np.inf
            if tx < ty:
                gx += 1 if dx > 0.0 else -1
                entered = tx
            else:
                gy += 1 if dy > 0.0 else -1
                entered = ty
    return hits


@njit(cache=True, error_model="numpy")
def _meets(x, y, z, dx, dy, dz, walls, wall_starts, prisms, p):
    """Parameter of the ray's first meeting with prism p, inf for none."""
    bottom, top = prisms[p, 1], prisms[p, 2]
    best = np.inf
    for w in range(wall_starts[p], wall_starts[p + 1]):
        ax, ay, bx, by = walls[w, 0] - x, walls[w, 1] - y, walls[w, 2] - x, walls[w, 3] - y
        side_a, side_b = dx * ay - dy * ax, dx * by - dy * bx
        if (side_a > 0.0) == (side_b > 0.0):
            continue
        s = side_a / (side_a - side_b)
        px, py = ax + s * (bx - ax), ay + s * (by - ay)
        t = (px * dx + py * dy) / (dx * dx + dy * dy)
        if 0.0 < t < best and bottom <= z + t * dz <= top:
            best = t
    for height in (bottom, top):
        t = (height - z) / dz
        if 0.0 < t < best:
            px, py = x + t * dx, y + t * dy
            inside = False
            for w in range(wall_starts[p], wall_starts[p + 1]):
                ax, ay, bx, by = walls[w, 0], walls[w, 1], walls[w, 2], walls[w, 3]
                if (ay > py) != (by > py) and px < ax + (py - ay) / (by - ay) * (bx - ax):
                    inside = not inside
            if inside:
                best = t
    return best


def viewpoints_within(cell, count, rng):
    """(count, 3) random points of the cell's region and eye band."""
    p, q = np.array(cell.p), np.array(cell.q)
    along = (q - p) / cell.length
    right = np.array([along[1], -along[0]])
    xy = p + rng.random((count, 1)) * (q - p) + (2.0 * rng.random((count, 1)) - 1.0) * cell.half_width * right
    return np.column_stack([xy, rng.uniform(*cell.eye, count)])


def searching_rays(city, cell, count, rng):
    """Origins and directions (count, 3) of rays likely to find what is hard to see.

    A third anywhere, mostly a little upward; a third at the tops of objects; a third at their walls.
    """
    origins = viewpoints_within(cell, count, rng)
    third = count // 3
    azimuth = rng.uniform(0.0, 2.0 * math.pi, count)
    slope = np.where(rng.random(count) < 0.7, np.abs(rng.normal(0.0, 0.3, count)), rng.normal(0.0, 0.5, count))
    directions = np.column_stack([np.cos(azimuth), np.sin(azimuth), slope])
    prisms = [prism for one in city.objects for prism in one.prisms]
    boundaries = [np.asarray(prism.footprint.exterior.coords) for prism in prisms]
    starts = np.concatenate([[0], np.cumsum([len(one) - 1 for one in boundaries])])
    a = np.concatenate([one[:-1] for one in boundaries])
    b = np.concatenate([one[1:] for one in boundaries])
    spans = np.array([(prism.bottom, prism.top) for prism in prisms])
    chosen = rng.integers(0, len(prisms), 2 * third)
    edge = starts[chosen] + (rng.random(2 * third) * (starts[chosen + 1] - starts[chosen])).astype(np.int64)
    xy = a[edge] + rng.random((2 * third, 1)) * (b[edge] - a[edge])
    bottom, top = spans[chosen].T
    high = top - 1e-3 * (top - bottom) * rng.random(2 * third)
    z = np.where(np.arange(2 * third) < third, high, rng.uniform(bottom, top))
    directions[: 2 * third] = np.column_stack([xy, z]) - origins[: 2 * third]
    return origins, directions
