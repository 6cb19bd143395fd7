"""Needles: triangles whose corners lie on one line, which rounding to millimetres makes of slim ones.

A needle has no area, but to leave it out would open the mesh: its middle corner would lie on an edge of its neighbour. So
the edge is flipped instead: the neighbour across the longest side is divided at that corner, and closed meshes stay closed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mmi.city.model import TriangleMesh
from mmi.city.welding import weld

__all__ = ["without_needles"]

_HEIGHT = 6e-4
"""Metres: a triangle less high than that over its longest side is a needle."""
_FOLDED = 1.5e-3
"""Metres: a triangle that rounding has folded over onto a neighbour is a needle if it is less high than this."""
_ROUNDS = 16
"""Most rounds. A needle whose neighbour is a needle as well waits for the next round: divided, the two would change places."""


def without_needles(mesh: TriangleMesh) -> TriangleMesh:
    """The mesh without triangles that have no area; a needle's middle corner divides the neighbour, as told above."""
    for _ in range(_ROUNDS):
        place = weld(mesh.vertices)[mesh.triangles]
        following = np.roll(place, -1, axis=1)
        keep = (place != following).all(axis=1)  # with two corners in one place, the neighbours meet each other
        corners = mesh.vertices[mesh.triangles]
        sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        height = np.linalg.norm(normal, axis=1) / np.maximum(sides.max(axis=1), 1e-12)
        slim = np.flatnonzero(keep & (height < _FOLDED))
        if not len(slim) and keep.all():
            return mesh
        normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
        from_longest = (sides[slim].argmax(axis=1)[:, None] + np.arange(3)) % 3
        beyond, shared = _across(place, keep, slim[:, None], from_longest)
        folded = (beyond >= 0) & ((normal[slim, None] * normal[beyond]).sum(axis=2) < -0.99)
        needle = (height[slim] < _HEIGHT) | folded.any(axis=1)
        if not needle.any() and keep.all():
            return mesh
        firm = needle & ~np.isin(beyond[:, 0], slim[needle])
        needle = firm if firm.any() else needle
        mesh = _divided(mesh, sides, keep, slim[needle], beyond[needle, 0], shared[needle, 0])
    return mesh


def _across(
    place: NDArray[np.int64], keep: NDArray[np.bool_], which: NDArray[np.int64], side: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The triangles beyond ``side`` of ``which`` (they broadcast), -1 where there is none, and which of their sides that is."""
    size = int(place.max()) + 1 if place.size else 1
    key = (place * size + np.roll(place, -1, axis=1)).ravel()
    key[~np.repeat(keep, 3)] = -1
    order = np.argsort(key, kind="stable")
    wanted = place[which, (side + 1) % 3] * size + place[which, side]
    last = np.searchsorted(key[order], wanted, side="right") - 1
    edge = order[np.maximum(last, 0)]
    found = (last >= 0) & (key[edge] == wanted)
    return np.where(found, edge // 3, -1), edge % 3


def _divided(
    mesh: TriangleMesh,
    sides: NDArray[np.float64],
    keep: NDArray[np.bool_],
    needles: NDArray[np.int64],
    beyond: NDArray[np.int64],
    shared: NDArray[np.int64],
) -> TriangleMesh:
    """Each of ``needles`` (k,) gone and its neighbour ``beyond`` (k,) divided at their ``shared`` (k,) side; where two need
    the same neighbour, the first of them.
    """
    taken: set[int] = set()
    keep = keep.copy()
    rows: list[tuple[NDArray[np.int32], NDArray[np.float32], int]] = []
    for i, other, side in zip(needles.tolist(), beyond.tolist(), shared.tolist(), strict=True):
        if i in taken:
            continue  # divided itself
        j = int(np.argmax(sides[i]))
        if other < 0:
            keep[i] = False  # nothing beside it: it shows nothing and closes nothing
            continue
        if other in taken:
            continue  # next round
        taken |= {i, other}
        keep[i] = keep[other] = False
        apex = mesh.triangles[i, (j + 2) % 3]
        q, p, s = (mesh.triangles[other, (side + k) % 3] for k in range(3))
        uv_q, uv_p, uv_s = (mesh.uv[other, (side + k) % 3] for k in range(3))
        along = np.linalg.norm(mesh.vertices[apex] - mesh.vertices[q]) / max(float(sides[i, j]), 1e-12)
        uv_r = uv_q + np.float32(min(float(along), 1.0)) * (uv_p - uv_q)
        rows.append((np.array([q, apex, s]), np.array([uv_q, uv_r, uv_s]), other))
        rows.append((np.array([apex, p, s]), np.array([uv_r, uv_p, uv_s]), other))
    kept, source = np.flatnonzero(keep), np.array([row[2] for row in rows], dtype=np.int64)
    new = np.array([row[0] for row in rows], dtype=np.int32).reshape(-1, 3)
    new_uv = np.array([row[1] for row in rows], dtype=np.float32).reshape(-1, 3, 2)
    triangles = np.concatenate([mesh.triangles[kept], new])
    left = _not_folded(weld(mesh.vertices)[triangles], len(kept))
    return TriangleMesh(
        mesh.vertices,
        triangles[left],
        np.concatenate([mesh.textures[kept], mesh.textures[source]])[left],
        np.concatenate([mesh.colors[kept], mesh.colors[source]])[left],
        np.concatenate([mesh.uv[kept], new_uv])[left],
    )


def _not_folded(corners: NDArray[np.int64], old: int) -> NDArray[np.bool_]:
    """Which triangles (m, 3) stay: of the new ones, after the first ``old``, none that lies face to face with another."""
    _, group = np.unique(np.sort(corners, axis=1), axis=0, return_inverse=True)
    group = group.reshape(-1)
    rest = np.argsort(corners, axis=1)
    odd = np.isin(rest @ np.array([9, 3, 1]), [0 * 9 + 2 * 3 + 1, 1 * 9 + 0 * 3 + 2, 2 * 9 + 1 * 3 + 0])
    stays = np.ones(len(corners), dtype=bool)
    for i in range(old, len(corners)):
        facing = np.flatnonzero((group == group[i]) & (odd != odd[i]) & stays)
        if stays[i] and len(facing):
            stays[i] = stays[facing[0]] = False
    return stays
