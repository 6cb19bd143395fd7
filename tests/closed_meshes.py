"""Oracles for meshes that should be solid: directed edges, signed volume, winding numbers; and shapes to build on.

Shares no code with what it checks.
"""

from __future__ import annotations

import numpy as np
import shapely
from hypothesis import strategies as st
from shapely import affinity


def merged(mesh):
    """Vertices without repetitions, and the triangles that use them."""
    vertices, names = np.unique(mesh.vertices, axis=0, return_inverse=True)
    return vertices, names.reshape(-1)[mesh.triangles]


def directed_edges(mesh):
    """(k,) numbers of the sides of all triangles, sorted, and of the same sides the other way round."""
    vertices, triangles = merged(mesh)
    sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]).astype(np.int64)
    n = len(vertices)
    return np.sort(sides[:, 0] * n + sides[:, 1]), np.sort(sides[:, 1] * n + sides[:, 0])


def is_closed(mesh):
    """Whether every side of a triangle is met as often the other way round."""
    there, back = directed_edges(mesh)
    return np.array_equal(there, back)


def is_simple(mesh):
    """Whether no two triangles have a side the same way round."""
    there, _ = directed_edges(mesh)
    return bool((np.diff(there) > 0).all())


def volume(mesh):
    corners = mesh.vertices[mesh.triangles] - mesh.vertices.mean(axis=0)
    return float(np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6.0)


def prism_volume(prism):
    return prism.footprint.area * (prism.top - prism.bottom)


def winding(mesh, points):
    """(n,) how often the surface goes around each point: the sum of solid angles, over 4 pi."""
    a, b, c = (mesh.vertices[mesh.triangles[:, i]][None] - points[:, None] for i in range(3))
    x, y, z = (np.linalg.norm(one, axis=2) for one in (a, b, c))
    above = np.einsum("ijk,ijk->ij", a, np.cross(b, c))
    below = x * y * z + (a * b).sum(2) * z + (b * c).sum(2) * x + (c * a).sum(2) * y
    return (2.0 * np.arctan2(above, below)).sum(axis=1) / (4.0 * np.pi)


def outside_prisms(one):
    """How many vertices of an object's mesh none of its prisms contains."""
    points = one.mesh.vertices
    flat = shapely.points(points[:, :2])
    inside = np.zeros(len(points), dtype=bool)
    for prism in one.prisms:
        level = (points[:, 2] >= prism.bottom - 1e-9) & (points[:, 2] <= prism.top + 1e-9)
        inside |= level & (shapely.distance(prism.footprint, flat) < 1e-7)
    return int((~inside).sum())


def points_in_core(one, count, rng):
    """(n, 3) points by chance in an object's core, up to ``count`` a prism, a little within its surface."""
    found = []
    for prism in one.core:
        x0, y0, x1, y1 = prism.footprint.bounds
        tried = rng.uniform((x0, y0, prism.bottom + 1e-3), (x1, y1, prism.top - 1e-3), (8 * count, 3))
        shrunk = prism.footprint.buffer(-1e-3)
        found.append(tried[shapely.contains_xy(shrunk, tried[:, :2])][:count])
    return np.concatenate(found) if found else np.empty((0, 3))


@st.composite
def footprints(draw):
    """Rectilinear, convex or star-shaped polygons of some 5 to 40 m, turned and moved; some have a courtyard."""
    kind = draw(st.sampled_from(["blocks", "convex", "star", "courtyard"]))
    rng = np.random.default_rng(draw(st.integers(0, 2**20)))
    if kind == "blocks":
        corner = rng.integers(0, 12, (rng.integers(1, 5), 2))
        parts = [shapely.box(0, 0, 8, 9)] + [shapely.box(*at, *(at + rng.integers(5, 14, 2))) for at in corner]
        shape = shapely.union_all(parts)
        shape = shape if shape.geom_type == "Polygon" else shapely.box(0, 0, 9, 14)
    elif kind == "convex":
        shape = shapely.convex_hull(shapely.multipoints(rng.uniform(0.0, 25.0, (rng.integers(4, 10), 2))))
    elif kind == "star":
        n = int(rng.integers(5, 10))
        angle = 2.0 * np.pi * (np.arange(n) + rng.uniform(0.0, 0.6, n)) / n
        shape = shapely.Polygon(np.column_stack([np.cos(angle), np.sin(angle)]) * rng.uniform(6.0, 16.0, (n, 1)))
    else:
        low, high = rng.uniform(6.0, 11.0, 2), rng.uniform(16.0, 22.0, 2)
        shape = shapely.box(0.0, 0.0, 30.0, 28.0).difference(shapely.box(*low, *high))
    if shape.area < 30.0:
        shape = shapely.box(0.0, 0.0, 8.0, 6.0)
    turned = affinity.rotate(shape, draw(st.sampled_from([0.0, 90.0, 17.3, 45.0])), origin=(0, 0))
    return affinity.translate(turned, *draw(st.sampled_from([(0.0, 0.0), (1234.567, -789.123)])))
