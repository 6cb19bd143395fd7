"""Small cities on hills, and rays cast by brute force at what is drawn of them: triangles of meshes, prisms and the ground.

Shares no code with what it checks.
"""

from __future__ import annotations

import itertools
import math
from functools import cache

import networkx as nx
import numpy as np
import shapely
from cities import streets
from numba import njit
from shapely import affinity
from shapely.geometry import LineString, Polygon, box

from citygen.buildings.houses import ROOF_KINDS, STYLES, house
from citygen.shapes.textures import city_textures
from mmi.city.model import City, CityObject, Prism
from mmi.city.terrain import Terrain


@cache
def pictures():
    """What generated houses are covered with."""
    return tuple(city_textures(1))


def waves(seed, *, size=160.0, spacing=8.0, steep=0.25):
    """Ground over a square around the origin, ``size`` metres from it to its sides, that slopes up to about ``steep``."""
    rng = np.random.default_rng(seed)
    steps = math.ceil(2.0 * size / spacing)
    x, y = np.meshgrid(*[-size + spacing * np.arange(steps + 1)] * 2)
    heights = np.zeros_like(x)
    for length in (90.0, 140.0, 230.0):
        turn, phase = rng.uniform(0.0, 2.0 * math.pi, 2)
        along = math.cos(turn) * x + math.sin(turn) * y
        heights += 0.5 * steep * length / (2.0 * math.pi) * np.sin(2.0 * math.pi * along / length + phase)
    return Terrain((-size, -size), spacing, heights - heights.min() + 20.0)


def ground_along(terrain, footprint):
    """Lowest and highest ground under an outline."""
    xy = shapely.get_coordinates(shapely.segmentize(footprint.boundary, 0.5))
    ground = terrain.at(xy)
    return float(ground.min()), float(ground.max())


def standing(name, footprint, terrain, height, *, roof=None, rng=None, tower=0.0):
    """A building that leaves nothing between it and the ground, ``height`` above the highest ground around it: a prism, one
    with a ``tower``, or a house with a real ``roof``.
    """
    low, high = ground_along(terrain, footprint)
    if roof is not None:
        style = str(rng.choice(STYLES))
        return house(name, footprint, base=low - 0.2, eaves=high + height, style=style, roof=roof, detail=1, rng=rng)
    prisms = [Prism(footprint, low - 0.2, high + height)]
    if tower:
        core = affinity.scale(footprint.convex_hull, 0.3, 0.3, origin="centroid").intersection(footprint)
        if core.geom_type == "Polygon" and core.area > 0.5:
            prisms.append(Prism(core, high + height, high + height + tower))
    return CityObject(name, tuple(prisms))


def hilly_city(seed, *, houses=0.6, count=40, size=160.0, steep=0.25, height=None):
    """Streets that bend over hills, with blocks, towers and ``houses`` (a share) under real roofs."""
    rng = np.random.default_rng(seed)
    terrain = waves(seed, size=size, steep=steep)
    turn = rng.uniform(0.0, math.pi)
    ends = 0.6 * size * np.array([math.cos(turn), math.sin(turn)])
    bend = rng.uniform(-12.0, 12.0, 2)
    lines = [[tuple(-ends), tuple(bend)], [tuple(bend), tuple(ends)]]
    roads = shapely.union_all([LineString(line) for line in lines]).buffer(4.5)
    objects, taken = [], [roads]
    for _ in range(40 * count):
        if len(objects) == count:
            break
        shape = box(0, 0, rng.uniform(5.0, 22.0), rng.uniform(5.0, 14.0))
        shape = affinity.rotate(shape, rng.uniform(0.0, 180.0), origin=(0, 0))
        shape = affinity.translate(shape, *rng.uniform(-0.9 * size, 0.9 * size, 2))
        if any(shape.distance(one) < 0.3 for one in taken):
            continue
        taken.append(shape)
        name, tall = f"solid/{len(objects)}", height or float(rng.choice([2.5, 4.0, 6.0, 9.0, 15.0]))
        if rng.random() < houses:
            objects.append(standing(name, shape, terrain, max(tall, 3.0), roof=str(rng.choice(ROOF_KINDS)), rng=rng))
        else:
            objects.append(standing(name, shape, terrain, tall, tower=float(rng.choice([0.0, 0.0, 20.0]))))
    return City(
        tuple(objects),
        streets(*lines, half_width=3.0),
        "EPSG:32631",
        (0.0, 0.0, 0.0),
        f"hills {seed}",
        terrain=terrain,
        textures=pictures(),
    )


def on_terrain(terrain, *objects, lines=()):
    """A city of these on ``terrain``."""
    graph = streets(*lines) if lines else nx.MultiGraph()
    return City(objects, graph, "EPSG:32631", (0.0, 0.0, 0.0), "made", terrain=terrain, textures=pictures())


def triangles_of_prism(prism):
    """(m, 3, 3) walls, roof and underside."""
    found = []
    for ring in (prism.footprint.exterior, *prism.footprint.interiors):
        for (ax, ay), (bx, by) in itertools.pairwise(np.asarray(ring.coords)):
            a, b, c, d = (
                (x, y, z)
                for (x, y), z in zip(((ax, ay), (bx, by)) * 2, [prism.bottom] * 2 + [prism.top] * 2, strict=True)
            )
            found += [(a, b, d), (a, d, c)]
    for part in shapely.get_parts(shapely.constrained_delaunay_triangles(prism.footprint)):
        flat = np.asarray(part.exterior.coords)[:3]
        found += [np.column_stack([flat, np.full(3, z)]).tolist() for z in (prism.bottom, prism.top)]
    return np.array(found, dtype=float)


def triangles_of_object(one):
    """(m, 3, 3) what is drawn of it."""
    if one.mesh is not None:
        return one.mesh.vertices[one.mesh.triangles]
    return np.concatenate([triangles_of_prism(prism) for prism in one.prisms])


def triangles_of_ground(terrain):
    """(m, 3, 3): two of each square of the grid."""
    rows, columns = terrain.heights.shape
    x, y = np.meshgrid(
        terrain.origin[0] + terrain.spacing * np.arange(columns), terrain.origin[1] + terrain.spacing * np.arange(rows)
    )
    points = np.stack([x, y, terrain.heights], axis=-1)
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    return np.concatenate([np.stack(one, axis=2).reshape(-1, 3, 3) for one in ((a, b, c), (a, c, d))])


class Drawn:
    """All triangles of a city (some ``objects`` of it) and its ground: -1 is nothing, or the ground."""

    def __init__(self, city, objects=None):
        chosen = range(len(city.objects)) if objects is None else [int(i) for i in objects]
        groups = [(triangles_of_object(city.objects[i]), i) for i in chosen]
        if city.terrain is not None:
            ground = triangles_of_ground(city.terrain)
            groups += [(part, -1) for part in np.array_split(ground, max(1, len(ground) // 12))]
        self.triangles = np.concatenate([np.empty((0, 3, 3)), *(one for one, _ in groups)])
        self.owners = np.array([owner for _, owner in groups], dtype=np.int64)
        self.starts = np.cumsum([0, *(len(one) for one, _ in groups)])
        middles = [0.5 * (one.min(axis=(0, 1)) + one.max(axis=(0, 1))) for one, _ in groups]
        radii = [np.linalg.norm(one - middle, axis=2).max() for (one, _), middle in zip(groups, middles, strict=True)]
        self.spheres = np.column_stack([np.reshape(middles, (-1, 3)), radii])

    def cast(self, origins, directions):
        """(n, 3) each -> how far along (n,), in lengths of the direction, and the object met first (n,)."""
        arrays = (np.ascontiguousarray(one, dtype=np.float64) for one in (origins, directions, self.triangles))
        return _cast(*arrays, self.starts, self.spheres, self.owners)


@njit(cache=True, error_model="numpy")
def _cast(origins, directions, triangles, starts, spheres, owners):
    """Moeller and Trumbore, sphere by sphere."""
    far, hits = np.full(len(origins), np.inf), np.full(len(origins), -1, dtype=np.int64)
    for r in range(len(origins)):
        x, y, z = origins[r]
        dx, dy, dz = directions[r]
        square = dx * dx + dy * dy + dz * dz
        best = np.inf
        for g in range(len(owners)):
            cx, cy, cz = spheres[g, 0] - x, spheres[g, 1] - y, spheres[g, 2] - z
            along = cx * dx + cy * dy + cz * dz
            away = cx * cx + cy * cy + cz * cz - along * along / square
            reach = spheres[g, 3] + 1e-6
            if away > reach * reach or along < -reach * math.sqrt(square):
                continue
            for k in range(starts[g], starts[g + 1]):
                ax, ay, az = triangles[k, 0]
                ex, ey, ez = triangles[k, 1, 0] - ax, triangles[k, 1, 1] - ay, triangles[k, 1, 2] - az
                fx, fy, fz = triangles[k, 2, 0] - ax, triangles[k, 2, 1] - ay, triangles[k, 2, 2] - az
                px, py, pz = dy * fz - dz * fy, dz * fx - dx * fz, dx * fy - dy * fx
                det = ex * px + ey * py + ez * pz
                if det == 0.0:
                    continue
                tx, ty, tz = x - ax, y - ay, z - az
                u = (tx * px + ty * py + tz * pz) / det
                if u < 0.0 or u > 1.0:
                    continue
                qx, qy, qz = ty * ez - tz * ey, tz * ex - tx * ez, tx * ey - ty * ex
                v = (dx * qx + dy * qy + dz * qz) / det
                if v < 0.0 or u + v > 1.0:
                    continue
                t = (fx * qx + fy * qy + fz * qz) / det
                if 0.0 < t < best:
                    best, hits[r] = t, owners[g]
        far[r] = best
    return far, hits


def eyes_in(cell, terrain, count, rng, *, eye=(1.5, 1.9)):
    """(count, 3) viewpoints of walkers anywhere in the cell: ``eye`` metres above the ground."""
    p, q = np.array(cell.p), np.array(cell.q)
    side = np.array([-(q - p)[1], (q - p)[0]]) / cell.length * cell.half_width
    s, t = rng.random((count, 1)), rng.uniform(-1.0, 1.0, (count, 1))
    edge = rng.random(count)
    s[edge < 0.2] = np.round(s[edge < 0.2])
    t[edge > 0.7] = np.sign(t[edge > 0.7])
    xy = p + s * (q - p) + t * side
    return np.column_stack([xy, terrain.at(xy) + rng.uniform(*eye, count)])


def searching(city, origins, rng):
    """(n, 3) directions that may find what is hard to see: most at corners, tops and other points of what is drawn."""
    corners = [triangles_of_object(one) for one in city.objects]
    every = np.concatenate(corners)
    count = len(origins)
    own = np.concatenate(
        [
            np.arange(len(one)) + start
            for one, start in zip(corners, np.cumsum([0, *map(len, corners[:-1])]), strict=True)
        ]
    )
    starts = np.cumsum([0, *map(len, corners)])
    chosen = rng.integers(0, len(corners), count)
    rows = own[starts[chosen] + (rng.random(count) * np.diff(starts)[chosen]).astype(int)]
    weights = rng.dirichlet(np.full(3, 0.4), count)
    points = np.einsum("nc,ncx->nx", weights, every[rows])
    highest = np.array([one.reshape(-1, 3)[one.reshape(-1, 3)[:, 2].argmax()] for one in corners])
    top = rng.random(count) < 0.3
    points[top] = highest[chosen[top]] - [0.0, 0.0, 0.01] + rng.normal(0.0, 0.02, (int(top.sum()), 3))
    directions = points - origins
    anywhere = rng.random(count) < 0.2
    turn = rng.uniform(0.0, 2.0 * math.pi, int(anywhere.sum()))
    directions[anywhere] = np.column_stack([np.cos(turn), np.sin(turn), rng.normal(0.0, 0.25, len(turn))])
    return directions


def rectangle(x, y, wide, deep, turn=0.0):
    """A turned rectangle around (x, y)."""
    return affinity.rotate(box(x - wide / 2, y - deep / 2, x + wide / 2, y + deep / 2), turn)


def ring(x, y, outer, inner):
    """A block around a courtyard."""
    return Polygon(rectangle(x, y, outer, outer).exterior, [rectangle(x, y, inner, inner).exterior.coords])


def terraces(seed, *, steep=0.25):
    """Two rows of touching houses along a street over hills, gabled or plain, higher than they are apart; more behind them."""
    rng = np.random.default_rng(seed)
    terrain = waves(seed + 1000, size=120.0, steep=steep)
    objects = []
    for side in (-1.0, 1.0):
        for away, deep, tall in ((5.0, 10.0, (6.0, 10.0)), (25.0, 9.0, (2.5, 6.0)), (50.0, 12.0, (3.0, 22.0))):
            x = -100.0
            while x < 90.0:
                wide = rng.uniform(6.0, 14.0)
                y0, y1 = sorted((side * away, side * (away + deep)))
                name, height = f"{side:+.0f}/{away:.0f}/{x:.1f}", rng.uniform(*tall)
                roof = str(rng.choice(["gable", "hip", "flat"])) if rng.random() < 0.5 else None
                if away < 25.0 or rng.random() < 0.7:
                    objects.append(
                        standing(name, box(x, y0, x + wide, y1), terrain, max(height, 3.0), roof=roof, rng=rng)
                    )
                x += wide
    return on_terrain(terrain, *objects, lines=([(-60.0, 0.0), (60.0, 0.0)],))
