"""Triangle meshes as readers handle them: joined, cut from polygons, turned, freed of corners that have no place."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

import mapbox_earcut
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mmi import limits
from mmi.city.model import TriangleMesh
from mmi.reading.report import Ledger

__all__ = ["cut_polygons", "joined_meshes", "linked", "number_of", "placed_corners", "y_up_to_z_up"]


def number_of(word: bytes) -> float:
    """The number in a word; not a number also where C writes that in other letters (``-nan(ind)``, ``1.#IND``, ``1.#INF``).

    Raises:
        ValueError: it is no number.
    """
    try:
        return float(word)
    except ValueError:
        if re.fullmatch(rb"[+-]?(nan\(.*\)|1\.#\w+)", word, re.IGNORECASE):
            return math.nan
        raise


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


def cut_polygons(
    points: NDArray[np.float64], sizes: NDArray[np.int64], corners: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Polygons cut into triangles (m, 3), and the polygon of each (m,); in the order of the polygons.

    The polygons have ``sizes`` (k,) corners each; ``corners`` (n,) are those of all, as places in ``points``. Triangles are
    places in ``corners``. Inner corners and concave outlines are kept.
    """
    starts = np.cumsum(sizes) - sizes
    parts, owners = [], []
    threes = np.flatnonzero(sizes == 3)
    parts.append(starts[threes, None] + np.arange(3))
    owners.append(threes)
    fours = np.flatnonzero(sizes == 4)
    if fours.size:
        quads = starts[fours, None] + np.arange(4)
        a, b, c, d = np.moveaxis(np.nan_to_num(points[corners[quads]]), 1, 0)
        # A dart is cut at its inner corner: the other diagonal would leave it.
        other = (np.cross(b - a, c - a) * np.cross(c - a, d - a)).sum(axis=1) < 0.0
        quads[other] = np.roll(quads[other], -1, axis=1)
        parts += [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
        owners += [fours, fours]
    for face in np.flatnonzero(sizes > 4):
        ring = starts[face] + np.arange(sizes[face])
        cut = _cut_polygon(np.nan_to_num(points[corners[ring]]))
        parts.append(ring[cut])
        owners.append(np.full(len(cut), face))
    triangles, face_of = np.concatenate(parts), np.concatenate(owners)
    order = np.argsort(face_of, kind="stable")
    return triangles[order], face_of[order]


def _cut_polygon(ring: NDArray[np.float64]) -> NDArray[np.int64]:
    """Triangles (m, 3) of the polygon (n, 3), seen along the axis that shows it largest; a fan where it has no area."""
    ahead = np.roll(ring, -1, axis=0)
    normal = np.cross(ring - ring[0], ahead - ring[0]).sum(axis=0)
    axis = int(np.argmax(np.abs(normal)))
    flat = ring[:, [(axis + 1) % 3, (axis + 2) % 3]]
    flat = flat if normal[axis] >= 0.0 else flat[:, ::-1]
    cut = mapbox_earcut.triangulate_float64(np.ascontiguousarray(flat), np.array([len(ring)], dtype=np.uint32))
    if len(cut) == 0:
        k = np.arange(1, len(ring) - 1)
        return np.column_stack([np.zeros_like(k), k, k + 1])
    triangles = np.asarray(cut, dtype=np.int64).reshape(-1, 3)
    a, b, c = np.moveaxis(flat[triangles], 1, 0)
    turned = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] < 0.0
    triangles[turned] = triangles[turned][:, ::-1]
    return triangles


def placed_corners(
    points: NDArray[np.float64], triangles: NDArray[np.int64], name: str, ledger: Ledger
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """``points`` (n, 3), another one for those that are no numbers or absurdly far; which triangles (m,) have none of these."""
    with np.errstate(invalid="ignore"):
        sound = np.asarray(np.abs(points).max(axis=1) <= limits.MESH_COORDINATE)
    if sound.all():
        return points, np.ones(len(triangles), dtype=bool)
    keep = np.asarray(sound[triangles].all(axis=1))
    what = f"triangle: corners that are no numbers or farther than {limits.MESH_COORDINATE:.0e} m"
    ledger.note("left out", what, name, count=int((~keep).sum()))
    # A place of its own, such as 0, would count in the bounds of the city.
    return np.where(sound[:, None], points, points[sound][0] if sound.any() else 0.0), keep


def y_up_to_z_up(mesh: TriangleMesh) -> TriangleMesh:
    """(x, y, z) becomes (x, -z, y)."""
    vertices = mesh.vertices[:, [0, 2, 1]] * (1.0, -1.0, 1.0)
    return TriangleMesh(vertices, mesh.triangles, mesh.textures, mesh.colors, mesh.uv)
