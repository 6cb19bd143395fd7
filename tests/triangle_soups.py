"""Triangles without a city: meshes of them, and rays cast at them by testing each.

Shares no code with what it checks.
"""

from __future__ import annotations

import numpy as np

from mmi.appearance.city_mesh import CityMesh


def mesh_from(triangles):
    """A city mesh of one object with these triangles (m, 3, 3)."""
    positions = np.asarray(triangles, dtype=np.float32).reshape(-1, 3)
    n = len(positions)
    return CityMesh(
        positions=positions,
        uv=np.zeros((n, 2), dtype=np.float32),
        colors=np.full((n, 3), 255, dtype=np.uint8),
        triangles=np.arange(n, dtype=np.int32).reshape(-1, 3),
        object_vertices=np.array([0, n]),
        object_triangles=np.array([0, n // 3]),
        texture=np.full((1, 1, 3), 255, dtype=np.uint8),
    )


def corners_of(mesh):
    """(m, 3, 3) the corners of a mesh's triangles, metres."""
    return mesh.positions[mesh.triangles].astype(np.float64)


def points_on(triangles, count, rng):
    """(count, 3) points of triangles (m, 3, 3), many of them corners and on edges."""
    weights = rng.dirichlet(np.ones(3), count)
    kind = rng.random(count)
    weights[kind < 0.5, 2] = 0.0
    weights[kind < 0.25, 1] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    return np.einsum("nc,ncx->nx", weights, triangles[rng.integers(0, len(triangles), count)])


def hits_beyond(eye, directions, triangles, beyond):
    """(n,) whether the rays from ``eye`` along ``directions`` (n, 3) meet a triangle ``beyond`` metres away, horizontally.

    Cramer's rule for all pairs; edges and corners belong to a triangle.
    """
    a, e, f = triangles[:, 0] - eye, triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal = np.cross(e, f)
    with np.errstate(divide="ignore", invalid="ignore"):
        det = directions @ normal.T
        t = np.einsum("mx,mx->m", a, normal) / det
        p = t[..., None] * directions[:, None] - a
        square = np.einsum("mx,mx->m", normal, normal)
        v = np.einsum("mx,nmx->nm", normal, np.cross(p, f)) / square
        w = np.einsum("mx,nmx->nm", normal, np.cross(e, p)) / square
        away = t * np.hypot(directions[:, 0], directions[:, 1])[:, None]
        return ((t > 0.0) & (v >= 0.0) & (w >= 0.0) & (v + w <= 1.0) & (away >= beyond)).any(axis=1)
