"""How a ray meets a triangle, in kernels that every fast caster calls.

The test is that of Woop, Benthin and Wald, "Watertight ray/triangle intersection" (JCGT 2013), in double precision: corners
are sheared so that the ray becomes the third axis, and the signs of three areas say on which side of each edge it passes. The
area of an edge is computed from the edge's two corners alone, and changes its sign exactly when they change places. So a ray
never slips through between two triangles that share an edge: it is on the inner side of that edge in one of them, and on an
edge counts as inside in both.

Corners are (m, 9) float32, three corners of three coordinates a triangle, in metres. Here and where cells are walked, arrays
are indexed by unsigned numbers: Numba would look for negative ones in each access, which is a fifth of the time.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import CityMesh
from mmi.foundation.kernels import kernel

__all__ = ["Ray", "bounds_of", "corners_of", "meeting", "point_met", "ray_along"]

_0, _1, _2, _3, _6 = np.uint64(0), np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(6)


class Ray(NamedTuple):
    """A ray as triangles are sheared for it: two axes across it (0, 1 or 2), and the one that it goes along most, unsigned.

    ``ox``, ``oy``, ``oz`` are its origin along these three; ``sx`` and ``sy`` how far it goes along the first two for each
    metre along the third, and ``sz`` lengths of its direction for each such metre. ``dx``, ``dy``, ``dz`` are its direction.
    """

    kx: np.uint64
    ky: np.uint64
    kz: np.uint64
    ox: float
    oy: float
    oz: float
    sx: float
    sy: float
    sz: float
    dx: float
    dy: float
    dz: float


def corners_of(mesh: CityMesh) -> NDArray[np.float32]:
    """(m, 9) the corners of a mesh's triangles, side by side: 36 bytes a triangle."""
    return np.ascontiguousarray(mesh.positions[mesh.triangles].reshape(-1, 9))


@kernel(nogil=True, error_model="numpy")
def bounds_of(corners: NDArray[np.float32]) -> NDArray[np.float32]:
    """(m, 10) the boxes and planes of triangles: lowest and highest x, y and z, then a unit normal n and an offset d, so that
    n x + d is the height of a point x above the plane. Normal and offset are 0 without area; the offset is that of the normal
    as it is rounded.
    """
    bounds = np.zeros((len(corners), 10), dtype=np.float32)
    for i in range(len(corners)):
        a, one = corners[i], bounds[i]
        for k in range(3):
            one[2 * k] = min(a[k], min(a[3 + k], a[6 + k]))
            one[2 * k + 1] = max(a[k], max(a[3 + k], a[6 + k]))
        bx, by, bz = float(a[3]) - a[0], float(a[4]) - a[1], float(a[5]) - a[2]
        cx, cy, cz = float(a[6]) - a[0], float(a[7]) - a[1], float(a[8]) - a[2]
        nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        if length > 0.0:
            n = one[6:]
            n[0], n[1], n[2] = nx / length, ny / length, nz / length
            x, y, z = a[0] + (bx + cx) / 3.0, a[1] + (by + cy) / 3.0, a[2] + (bz + cz) / 3.0
            n[3] = -(n[0] * x + n[1] * y + n[2] * z)
    return bounds


@kernel(nogil=True, error_model="numpy")
def ray_along(ox: float, oy: float, oz: float, dx: float, dy: float, dz: float) -> Ray:
    """The ray from (ox, oy, oz) along (dx, dy, dz)."""
    ax, ay, az = abs(dx), abs(dy), abs(dz)
    if ax >= ay and ax >= az:
        return Ray(_1, _2, _0, oy, oz, ox, dy / dx, dz / dx, 1.0 / dx, dx, dy, dz)
    if ay >= az:
        return Ray(_2, _0, _1, oz, ox, oy, dz / dy, dx / dy, 1.0 / dy, dx, dy, dz)
    return Ray(_0, _1, _2, ox, oy, oz, dx / dz, dy / dz, 1.0 / dz, dx, dy, dz)


@kernel(nogil=True, error_model="numpy")
def meeting(corners: NDArray[np.float32], i: int | np.uint64, ray: Ray) -> float:
    """How far along a ray it meets triangle ``i``, in lengths of its direction; NaN if it does not."""
    u, v, w, az, bz, cz = _areas(corners, i, ray)
    if (u < 0.0 or v < 0.0 or w < 0.0) and (u > 0.0 or v > 0.0 or w > 0.0):
        return np.nan
    return ray.sz * (u * az + v * bz + w * cz) / (u + v + w)  # 0 / 0 without area, or edge-on


@kernel(nogil=True, error_model="numpy")
def point_met(corners: NDArray[np.float32], i: int | np.uint64, ray: Ray) -> tuple[float, float, float]:
    """Where a ray that meets triangle ``i``, or passes it by a rounding, meets it: how far along, and the weights of the second
    and the third corner. NaN where the ray sees no area.
    """
    u, v, w, az, bz, cz = _areas(corners, i, ray)
    det = u + v + w
    u, v, w = max(u / det, 0.0), max(v / det, 0.0), max(w / det, 0.0)
    total = u + v + w
    if det == 0.0 or not total > 0.0:
        return np.nan, 0.0, 0.0
    u, v, w = u / total, v / total, w / total
    return ray.sz * (u * az + v * bz + w * cz), v, w


@kernel(nogil=True, error_model="numpy")
def _areas(
    corners: NDArray[np.float32], i: int | np.uint64, ray: Ray
) -> tuple[float, float, float, float, float, float]:
    """Twice the areas opposite the three corners of triangle ``i``, as a ray sees them, and how deep each corner lies.

    The ray passes through the triangle if no two areas have different signs. Depths are along the ray's third axis.
    """
    row, kx, ky, kz = np.uint64(i), ray.kx, ray.ky, ray.kz
    az = corners[row, kz] - ray.oz
    bz = corners[row, _3 + kz] - ray.oz
    cz = corners[row, _6 + kz] - ray.oz
    ax = corners[row, kx] - ray.ox - ray.sx * az
    ay = corners[row, ky] - ray.oy - ray.sy * az
    bx = corners[row, _3 + kx] - ray.ox - ray.sx * bz
    by = corners[row, _3 + ky] - ray.oy - ray.sy * bz
    cx = corners[row, _6 + kx] - ray.ox - ray.sx * cz
    cy = corners[row, _6 + ky] - ray.oy - ray.sy * cz
    return cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax, az, bz, cz
