"""Polygons in space become triangle meshes, an object each: what CityJSON and CityGML have in common.

A face is an outer ring and holes, nearly flat; it is cut into triangles in the plane along which it is largest. All faces of
a file are collected first, as lists of numbers, and turned into meshes at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import mapbox_earcut
import numpy as np
from numpy.typing import NDArray

from mmi import limits
from mmi.city.model import PAINTED, PLAIN, TriangleMesh
from mmi.foundation.errors import CityError

__all__ = ["Color", "Faces", "triangulate_faces"]

Color = tuple[int, int, int]
"""sRGB bytes."""
_MOST_REPEATS = 1e5
"""Texture coordinates beyond this are taken for damage."""


class Faces:
    """The faces of a file while it is read. Owners are numbers, points and texture coordinates places in tables.

    Who adds too many gets a CityError (``limits.FACE_CORNERS``): a file may use the same ones again and again.
    """

    def __init__(self, file: str = "") -> None:
        self._file = file
        self._points: list[int] = []
        self._uv: list[int] = []
        self._ring_lengths: list[int] = []
        self._ring_counts: list[int] = []
        self._owners: list[int] = []
        self._looks: list[tuple[int, int, int, int]] = []

    def __len__(self) -> int:
        return len(self._owners)

    def mark(self) -> tuple[int, int, int]:
        """How much there is, for ``cut_back``."""
        return len(self._points), len(self._ring_lengths), len(self._owners)

    def cut_back(self, mark: tuple[int, int, int]) -> None:
        """Forget the faces that came after ``mark`` was taken."""
        points, rings, faces = mark
        del self._points[points:], self._uv[points:], self._ring_lengths[rings:]
        del self._ring_counts[faces:], self._owners[faces:], self._looks[faces:]

    def add(
        self,
        owner: int,
        rings: Sequence[Sequence[int]],
        *,
        texture: int | None = None,
        uv: Sequence[Sequence[int]] = (),
        color: Color | None = None,
    ) -> bool:
        """A face with its outer ring first; ``uv`` as ``rings``. False where fewer than three points are left of the ring.

        Without texture and colour it is to be painted. A ring that repeats points, its first at the end too, loses them.
        """
        points: list[int] = []
        places: list[int] = []
        lengths: list[int] = []
        for i, ring in enumerate(rings):
            own = uv[i] if texture is not None and i < len(uv) and len(uv[i]) == len(ring) else None
            if len(set(ring)) == len(ring) > 2:  # nearly all
                points += ring
                places += own or [-1] * len(ring)
                lengths.append(len(ring))
                continue
            kept = [k for k in range(len(ring)) if ring[k] != ring[k - 1] or len(ring) == 1]
            if len(kept) < 3:
                if i == 0:
                    return False
                continue
            points += [ring[k] for k in kept]
            places += [-1] * len(kept) if own is None else [own[k] for k in kept]
            lengths.append(len(kept))
        if not lengths:
            return False
        self._points += points
        self._check_number()
        self._uv += places
        self._ring_lengths += lengths
        self._ring_counts.append(len(lengths))
        self._owners.append(owner)
        kind = PAINTED if texture is None and color is None else PLAIN if texture is None else texture
        self._looks.append((kind, *((255, 255, 255) if color is None or kind >= 0 else color)))
        return True

    def add_bare(self, owner: int, faces: Sequence[Sequence[Sequence[int]]]) -> None:
        """Faces without looks, as ``add`` would one by one, many at once."""
        rings = list(chain.from_iterable(faces))
        if not all(faces) or not all(len(set(ring)) == len(ring) > 2 for ring in rings):
            for face in faces:
                self.add(owner, face)
            return
        before = len(self._points)
        self._points += chain.from_iterable(rings)
        self._check_number()
        self._uv += [-1] * (len(self._points) - before)
        self._ring_lengths += map(len, rings)
        self._ring_counts += map(len, faces)
        self._owners += [owner] * len(faces)
        self._looks += [(PAINTED, 255, 255, 255)] * len(faces)

    def _check_number(self) -> None:
        if len(self._points) > limits.FACE_CORNERS:
            raise CityError(
                f"{self._file}: at most {limits.FACE_CORNERS} corners of faces expected, found more; give it in tiles"
            )

    def meshes(self, points: NDArray[np.float64], uv: NDArray[np.float64]) -> dict[int, TriangleMesh]:
        """A mesh for each owner that has triangles, from the tables ``points`` (n, 3) and ``uv`` (k, 2)."""
        if not self._owners:
            return {}
        place, corner_uv = np.array(self._points), np.array(self._uv)
        triangles, face = triangulate_faces(points[place], np.array(self._ring_lengths), np.array(self._ring_counts))
        table = np.vstack([uv.reshape(-1, 2), np.zeros((1, 2))])  # -1 is the last
        looks = np.array(self._looks)[face]
        coordinates = table[corner_uv[triangles]]
        # A picture without (sane) coordinates everywhere shows nothing: its face is plain.
        known = (corner_uv[triangles] >= 0).all(axis=1) & (np.abs(coordinates) < _MOST_REPEATS).all(axis=(1, 2))
        coordinates[~known] = 0.0
        looks[(looks[:, 0] >= 0) & ~known, 0] = PLAIN
        owners = np.array(self._owners)[face]
        order = np.argsort(owners, kind="stable")
        owners, triangles = owners[order], place[triangles[order]]
        looks, coordinates = looks[order], coordinates[order]
        found: dict[int, TriangleMesh] = {}
        starts = np.flatnonzero(np.diff(owners, prepend=-1))
        for start, end in zip(starts.tolist(), [*starts[1:].tolist(), len(owners)], strict=True):
            used, corners = np.unique(triangles[start:end], return_inverse=True)
            found[int(owners[start])] = TriangleMesh(
                points[used],
                corners.reshape(-1, 3).astype(np.int32),
                looks[start:end, 0].astype(np.int32),
                looks[start:end, 1:].astype(np.uint8),
                coordinates[start:end].astype(np.float32),
            )
        return found


def triangulate_faces(
    corners: NDArray[np.float64], ring_lengths: NDArray[np.int64], ring_counts: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Triangles (m, 3) of faces, as places in ``corners`` (n, 3), and the face (m,) that each belongs to, in order.

    ``ring_lengths`` (r,) points of each ring, ``ring_counts`` (f,) rings of each face. Triangles turn as their outer ring.
    """
    ring_ends = np.cumsum(ring_lengths)
    ring_starts = ring_ends - ring_lengths
    last_ring = np.cumsum(ring_counts)
    first_ring = last_ring - ring_counts
    normals = _newell(corners, ring_starts, ring_lengths)[first_ring]
    simple = ring_counts == 1
    sizes = np.where(simple, ring_lengths[first_ring], 0)
    start = ring_starts[first_ring]
    three, four = np.flatnonzero(sizes == 3), np.flatnonzero(sizes == 4)
    quads, whole = _quads(corners, start[four], normals[four])
    triangles = [start[three][:, None] + np.arange(3), quads]
    faces = [three, np.repeat(four[whole], 2)]
    others = np.sort(np.concatenate([np.flatnonzero(sizes > 4), np.flatnonzero(~simple), four[~whole]]))
    # Project along the normal's largest part, so that the outer ring turns counter-clockwise.
    drop = np.argmax(np.abs(normals), axis=1)
    turned = np.take_along_axis(normals, drop[:, None], axis=1)[:, 0] < 0.0
    for i in others.tolist():
        a, b = ring_starts[first_ring[i]], ring_ends[last_ring[i] - 1]
        axes = [(1, 2), (2, 0), (0, 1)][drop[i]]
        flat = (corners[a:b] - corners[a])[:, axes[::-1] if turned[i] else axes]
        ends = (ring_ends[first_ring[i] : last_ring[i]] - a).astype(np.uint32)
        found = mapbox_earcut.triangulate_float64(np.ascontiguousarray(flat), ends).reshape(-1, 3).astype(np.int64)
        p, q, r = (flat[found[:, k]] for k in range(3))
        wrong = (q[:, 0] - p[:, 0]) * (r[:, 1] - p[:, 1]) < (q[:, 1] - p[:, 1]) * (r[:, 0] - p[:, 0])
        found[wrong] = found[wrong][:, ::-1]
        triangles.append(found + a)
        faces.append(np.full(len(found), i))
    every, face = np.concatenate(triangles), np.concatenate(faces)
    order = np.argsort(face, kind="stable")
    return every[order], face[order]


def _newell(corners: NDArray[np.float64], starts: NDArray[np.int64], lengths: NDArray[np.int64]) -> NDArray[np.float64]:
    """(r, 3) twice the area of each ring, times its normal (Newell's method)."""
    following = np.arange(1, len(corners) + 1)
    following[starts + lengths - 1] = starts
    near = corners - np.repeat(corners[starts], lengths, axis=0)
    return np.asarray(np.add.reduceat(np.cross(near, near[following]), starts))


def _quads(
    corners: NDArray[np.float64], start: NDArray[np.int64], normals: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Two triangles (2 k, 3) of each quad that a diagonal divides, and which (q,) those are."""
    points = corners[start[:, None] + np.arange(4)]
    result = np.zeros((len(start), 2, 3), dtype=np.int64)
    whole = np.zeros(len(start), dtype=bool)
    for halves in (((0, 1, 2), (0, 2, 3)), ((1, 2, 3), (1, 3, 0))):
        good = ~whole
        for i, j, k in halves:
            cross = np.cross(points[:, j] - points[:, i], points[:, k] - points[:, i])
            good &= np.einsum("qc,qc->q", cross, normals) > 0.0
        result[good] = start[good, None, None] + np.array(halves)
        whole |= good
    return result[whole].reshape(-1, 3), whole
