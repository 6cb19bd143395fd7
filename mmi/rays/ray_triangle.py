"""How a ray meets a triangle, in kernels that every fast caster calls.

The test is that of Woop, Benthin and Wald, "Watertight ray/triangle intersection" (JCGT 2013), in double precision: corners
are sheared so that the ray becomes the third axis, and the signs of three areas say on which side of each edge it passes. The
area of an edge is computed from the edge's two corners alone, and changes its sign exactly when they change places. So a ray
never slips through between two triangles that share an edge: it is on the inner side of that edge in one of them, and on an
edge counts as inside in both.

Corners are (m, 9) float32, three corners of three coordinates a triangle, in metres.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import CityMesh
from mmi.foundation.kernels import kernel

__all__ = ["areas", "corners_of", "meeting", "point_met", "shear"]


def corners_of(mesh: CityMesh) -> NDArray[np.float32]:
    """(m, 9) the corners of a mesh's triangles, side by side: 36 bytes a triangle."""
    return np.ascontiguousarray(mesh.positions[mesh.triangles].reshape(-1, 9))


@kernel(nogil=True, error_model="numpy")
def shear(dx: float, dy: float, dz: float) -> tuple[int, int, int, float, float, float]:
    """The axes across a direction and the one most along it, and what corners are sheared and scaled by along these."""
    ax, ay, az = abs(dx), abs(dy), abs(dz)
    if ax >= ay and ax >= az:
        return 1, 2, 0, dy / dx, dz / dx, 1.0 / dx
    if ay >= az:
        return 2, 0, 1, dz / dy, dx / dy, 1.0 / dy
    return 0, 1, 2, dx / dz, dy / dz, 1.0 / dz


@kernel(nogil=True, error_model="numpy")
def areas(
    corners: NDArray[np.float32],
    i: int,
    kx: int,
    ky: int,
    kz: int,
    ox: float,
    oy: float,
    oz: float,
    sx: float,
    sy: float,
) -> tuple[float, float, float, float, float, float]:
    """Twice the areas opposite the three corners of triangle ``i``, as a ray sees them, and how deep each corner lies.

    The ray starts at (ox, oy, oz), in the order of its axes kx, ky, kz (of :func:`shear`, as are the rest); depths are along
    axis kz. The ray passes through the triangle if no two areas have different signs.
    """
    az = corners[i, kz] - oz
    bz = corners[i, 3 + kz] - oz
    cz = corners[i, 6 + kz] - oz
    ax = corners[i, kx] - ox - sx * az
    ay = corners[i, ky] - oy - sy * az
    bx = corners[i, 3 + kx] - ox - sx * bz
    by = corners[i, 3 + ky] - oy - sy * bz
    cx = corners[i, 6 + kx] - ox - sx * cz
    cy = corners[i, 6 + ky] - oy - sy * cz
    return cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax, az, bz, cz


@kernel(nogil=True, error_model="numpy")
def meeting(
    corners: NDArray[np.float32],
    i: int,
    kx: int,
    ky: int,
    kz: int,
    ox: float,
    oy: float,
    oz: float,
    sx: float,
    sy: float,
    sz: float,
) -> float:
    """How far along a ray it meets triangle ``i``, in lengths of its direction; NaN if it does not."""
    u, v, w, az, bz, cz = areas(corners, i, kx, ky, kz, ox, oy, oz, sx, sy)
    if (u < 0.0 or v < 0.0 or w < 0.0) and (u > 0.0 or v > 0.0 or w > 0.0):
        return np.nan
    return sz * (u * az + v * bz + w * cz) / (u + v + w)  # 0 / 0 without area, or edge-on


@kernel(nogil=True, error_model="numpy")
def point_met(
    corners: NDArray[np.float32],
    i: int,
    kx: int,
    ky: int,
    kz: int,
    ox: float,
    oy: float,
    oz: float,
    sx: float,
    sy: float,
    sz: float,
) -> tuple[float, float, float]:
    """Where a ray that meets triangle ``i``, or passes it by a rounding, meets it: how far along, and the weights of the second
    and the third corner. NaN where the ray sees no area.
    """
    u, v, w, az, bz, cz = areas(corners, i, kx, ky, kz, ox, oy, oz, sx, sy)
    det = u + v + w
    u, v, w = max(u / det, 0.0), max(v / det, 0.0), max(w / det, 0.0)
    total = u + v + w
    if det == 0.0 or not total > 0.0:
        return np.nan, 0.0, 0.0
    u, v, w = u / total, v / total, w / total
    return sz * (u * az + v * bz + w * cz), v, w
