"""Small cities of prisms to attack the bound with, and rays cast at their walls, roofs and undersides by brute force.

Shares no code with what it checks. Distances along rays are what ``oracles.PrismRays`` does not tell.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from cities import city_of
from hypothesis import strategies as st
from numba import njit
from shapely import affinity
from shapely.geometry import MultiPoint, Polygon, box

from mmi.cells.viewing_cells import ViewingCell
from mmi.city.model import CityObject, Prism


class Solids:
    """``walls`` (w, 6): ax, ay, bx, by, prism, object; ``prisms`` (p, 6): bottom, top, object, circle (x, y, radius).

    In the order of the city; the circle is around the prism.
    """

    def __init__(self, city, objects=None):
        walls, prisms = [], []
        for i in range(len(city.objects)) if objects is None else objects:
            for prism in city.objects[i].prisms:
                for ring in (prism.footprint.exterior, *prism.footprint.interiors):
                    walls += [(*a, *b, len(prisms), i) for a, b in itertools.pairwise(np.asarray(ring.coords))]
                x0, y0, x1, y1 = prism.footprint.bounds
                circle = (0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * math.hypot(x1 - x0, y1 - y0) + 1e-3)
                prisms.append((prism.bottom, prism.top, i, *circle))
        self.walls = np.array(walls, dtype=np.float64).reshape(-1, 6)
        self.prisms = np.array(prisms, dtype=np.float64).reshape(-1, 6)
        self.starts = np.searchsorted(self.walls[:, 4], np.arange(len(prisms) + 1)).astype(np.int64)
        self.ground = city.ground

    def cast(self, origins, directions):
        """(n, 3) each -> how far along (n,), in lengths of the direction, and the object met first (n,); -1: ground or none."""
        origins, directions = (np.ascontiguousarray(one, dtype=np.float64) for one in (origins, directions))
        return _cast(origins, directions, self.walls, self.starts, self.prisms, self.ground)

    def clear(self, origins, points):
        """(n, 3) each -> (n,) whether nothing is between; the points may lie on walls."""
        return self.cast(origins, points - origins)[0] > 1.0 - 1e-7


@njit(cache=True, error_model="numpy")
def _cast(origins, directions, walls, starts, prisms, ground):
    far, hits = np.full(len(origins), np.inf), np.full(len(origins), -1, dtype=np.int64)
    for r in range(len(origins)):
        x, y, z = origins[r]
        dx, dy, dz = directions[r]
        best = (ground - z) / dz if dz < 0.0 else np.inf
        square = dx * dx + dy * dy
        for p in range(len(prisms)):
            bottom, top = prisms[p, 0], prisms[p, 1]
            if abs(dx * (prisms[p, 4] - y) - dy * (prisms[p, 3] - x)) > prisms[p, 5] * math.sqrt(square):
                continue
            for w in range(starts[p], starts[p + 1]):
                ax, ay, bx, by = walls[w, 0] - x, walls[w, 1] - y, walls[w, 2] - x, walls[w, 3] - y
                side_a, side_b = dx * ay - dy * ax, dx * by - dy * bx
                if (side_a > 0.0) == (side_b > 0.0):
                    continue
                s = side_a / (side_a - side_b)
                t = ((ax + s * (bx - ax)) * dx + (ay + s * (by - ay)) * dy) / square
                if 0.0 < t < best and bottom <= z + t * dz <= top:
                    best, hits[r] = t, int(prisms[p, 2])
            for height in (bottom, top):
                t = (height - z) / dz
                if not 0.0 < t < best:
                    continue
                px, py = x + t * dx, y + t * dy
                inside = False
                for w in range(starts[p], starts[p + 1]):
                    ax, ay, bx, by = walls[w, 0], walls[w, 1], walls[w, 2], walls[w, 3]
                    if (ay > py) != (by > py) and px < ax + (py - ay) / (by - ay) * (bx - ax):
                        inside = not inside
                if inside:
                    best, hits[r] = t, int(prisms[p, 2])
        far[r] = best
    return far, hits


def el(wide, deep, wing_wide, wing_deep):
    """An L: a bar along x and a wing at its left end, towards -y."""
    return Polygon(
        [
            (0, 0),
            (wing_wide, 0),
            (wing_wide, wing_deep),
            (wide, wing_deep),
            (wide, wing_deep + deep),
            (0, wing_deep + deep),
        ]
    )


def horseshoe(wide, deep, arm, thick):
    """A U that opens towards -y: arms ``arm`` long and ``thick`` wide at both ends of a bar ``deep`` deep."""
    yard = box(thick, 0, wide - thick, arm)
    return box(0, 0, wide, arm + deep).difference(yard)


def _footprint(kind, wide, deep, turn, extra):
    if kind == "box":
        shape = box(0.0, 0.0, wide, deep)
    elif kind == "el":
        shape = el(wide, 0.4 * deep, 0.4 * wide, 0.6 * deep)
    elif kind == "horseshoe":
        shape = horseshoe(wide, 0.3 * deep, 0.7 * deep, 0.3 * wide)
    else:
        angles = np.sort(np.random.default_rng(extra).uniform(0.0, 2.0 * math.pi, 6))
        shape = MultiPoint(np.column_stack([wide * np.cos(angles), deep * np.sin(angles)])).convex_hull
    return affinity.rotate(shape, turn, origin="centroid")


SOLIDS = st.tuples(
    st.sampled_from(["box", "box", "el", "horseshoe", "hull"]),
    st.floats(2.0, 30.0),  # wide
    st.floats(2.0, 25.0),  # deep
    st.sampled_from([0.0, 0.0, 20.0, 45.0, 77.0, 180.0, 225.0]),  # turned
    st.floats(0.0, 360.0),  # azimuth, degrees
    st.floats(6.0, 90.0),  # distance from the axis' middle
    st.sampled_from([1.0, 2.5, 6.0, 9.0, 15.0, 40.0]),  # height
    st.sampled_from([0.0, 0.0, 0.0, 20.0]),  # of a tower on it
    st.integers(0, 9),
)
CELLS = st.builds(
    lambda length, turn, half: ViewingCell(
        "0000-00",
        (-0.5 * length * math.cos(turn), -0.5 * length * math.sin(turn)),
        (0.5 * length * math.cos(turn), 0.5 * length * math.sin(turn)),
        half,
        (1.5, 1.9),
    ),
    st.sampled_from([8.0, 20.0, 40.0]),
    st.sampled_from([0.0, 0.5 * math.pi, 1.1]),
    st.sampled_from([1.0, 3.0, 5.0]),
)


def city_from(solids, cell, *, clearance=2.0):
    """A city of :data:`SOLIDS`, those left out that come close to the cell or overlap an earlier one."""
    region = Polygon(cell.corners)
    objects, taken = [], []
    for kind, wide, deep, turn, azimuth, distance, height, tower, extra in solids:
        shape = _footprint(kind, wide, deep, turn, extra)
        x, y = distance * math.cos(math.radians(azimuth)), distance * math.sin(math.radians(azimuth))
        shape = affinity.translate(shape, x - shape.centroid.x, y - shape.centroid.y)
        if shape.distance(region) < clearance or shape.area < 1.0 or any(shape.intersects(one) for one in taken):
            continue
        prisms = [Prism(shape, 0.0, height)]
        if tower:
            core = affinity.scale(shape.convex_hull, 0.3, 0.3, origin="centroid").intersection(shape)
            prisms += [Prism(core, height, height + tower)] if core.geom_type == "Polygon" and core.area > 0.5 else []
        taken.append(shape)
        objects.append(CityObject(f"solid/{len(objects)}", tuple(prisms)))
    return city_of(*objects)


def solids_from(rng, count):
    """``count`` :data:`SOLIDS` drawn with a generator."""
    return [
        (
            str(rng.choice(["box", "el", "horseshoe", "hull"])),
            rng.uniform(3.0, 30.0),
            rng.uniform(3.0, 25.0),
            rng.uniform(0.0, 360.0),
            rng.uniform(0.0, 360.0),
            rng.uniform(15.0, 140.0),
            float(rng.choice([3.0, 6.0, 9.0, 15.0, 25.0, 60.0])),
            float(rng.choice([0.0, 0.0, 20.0])),
            int(rng.integers(0, 1000)),
        )
        for _ in range(count)
    ]
