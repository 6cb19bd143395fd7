"""Moving objects for tests: boxes on tracks, which are rows of time, x, y, z, heading, perhaps pitch and roll (degrees)."""

from __future__ import annotations

import numpy as np

from mmi.city.model import PLAIN, TriangleMesh
from mmi.movers.movers import Movers

_FACES = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))


def block(low=(-2.0, -1.0, 0.0), high=(2.0, 1.0, 1.5), color=(200, 40, 40)):
    """A box whose six faces have two triangles each."""
    corners = np.array([[(low, high)[(k >> axis) & 1][axis] for axis in range(3)] for k in range(8)])
    triangles = np.array([corner for a, b, c, d in _FACES for corner in ((a, b, c), (a, c, d))], dtype=np.int32)
    return TriangleMesh(corners, triangles, np.full(12, PLAIN, dtype=np.int32), np.tile(np.uint8(color), (12, 1)))


def movers_of(tracks, *, ids=None, stays=None, mesh=None, crs="local", origin=(0.0, 0.0, 0.0)):
    """One object a track, all with the same shape."""
    n = len(tracks)
    rows = [(*row, *(0.0,) * (7 - len(row))) for track in tracks for row in track]
    table = np.array(rows, dtype=np.float64).reshape(-1, 7)
    return Movers(
        ids=tuple(f"block-{i}" for i in range(n)) if ids is None else ids,
        kinds=np.zeros(n, dtype=np.int64),
        names=("block",),
        meshes=(block() if mesh is None else mesh,),
        starts=np.cumsum([0, *map(len, tracks)], dtype=np.int64),
        times=table[:, 0].copy(),
        positions=table[:, 1:4].copy(),
        angles=np.radians(table[:, 4:]),
        stays=np.ones(n, dtype=bool) if stays is None else np.array(stays, dtype=bool),
        crs=crs,
        origin=origin,
    )
