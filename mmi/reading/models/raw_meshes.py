"""Triangle meshes as readers handle them: joined, taken apart, picked from, turned, freed of corners that have no place."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mmi.city.model import TriangleMesh
from mmi.reading.report import Ledger

__all__ = ["joined_meshes", "linked", "placed_corners", "y_up_to_z_up"]

_FARTHEST = 1.0e8
"""Metres: coordinates beyond are a mistake, no projection of the earth reaches there."""


def joined_meshes(parts: Sequence[TriangleMesh]) -> TriangleMesh:
    """One mesh of several (at least one), triangles in their order."""
    if len(parts) == 1:
        return parts[0]
    offsets = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    return TriangleMesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.triangles + offset for part, offset in zip(parts, offsets, strict=True)]),
        np.concatenate([part.textures for part in parts]),
        np.concatenate([part.colors for part in parts]),
        np.concatenate([part.uv for part in parts]),
    )


def linked(n: int, a: NDArray[np.integer[Any]], b: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
    """Labels (n,) of what the pairs (a, b) connect, in the order of the lowest member."""
    _, labels = connected_components(coo_array((np.ones(len(a), dtype=bool), (a, b)), shape=(n, n)), directed=False)
    _, first, label = np.unique(labels, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[label.reshape(-1)]


def placed_corners(
    points: NDArray[np.float64], triangles: NDArray[np.int64], name: str, ledger: Ledger
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """``points`` (n, 3) with 0 for those that are no numbers or absurdly far, and which triangles (m,) have none of these."""
    with np.errstate(invalid="ignore"):
        sound = np.asarray(np.abs(points).max(axis=1) <= _FARTHEST)
    if sound.all():
        return points, np.ones(len(triangles), dtype=bool)
    keep = np.asarray(sound[triangles].all(axis=1))
    what = f"triangle: corners that are no numbers or farther than {_FARTHEST:.0e} m"
    ledger.note("left out", what, name, count=int((~keep).sum()))
    return np.where(sound[:, None], points, 0.0), keep


def y_up_to_z_up(mesh: TriangleMesh) -> TriangleMesh:
    """(x, y, z) becomes (x, -z, y)."""
    vertices = mesh.vertices[:, [0, 2, 1]] * (1.0, -1.0, 1.0)
    return TriangleMesh(vertices, mesh.triangles, mesh.textures, mesh.colors, mesh.uv)
