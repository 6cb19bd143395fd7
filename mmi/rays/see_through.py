"""Rays go on where a surface is a cut-out and its texel is clear: leaves, railings (:mod:`mmi.appearance.cut_outs`).

Which texel is looked at depends on how large it is seen, as for the renderer: the level is that at which a texel is as large as
what a pixel covers on the triangle, at the distance of the hit. The pixel is square and faces the ray.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import CityMesh
from mmi.appearance.cut_outs import alpha_levels, clear_blocks, cut_out_triangles, is_clear
from mmi.foundation.kernels import kernel
from mmi.rays.ray_triangle import Ray, point_met

__all__ = ["LEVEL_BIAS", "SeeThrough", "is_open", "see_through_of"]

LEVEL_BIAS = -0.75
"""Added to levels, as the renderer of walks does (``viewer.drawing.kinds.meshes``)."""
_GRAZING = 1e-9


class SeeThrough(NamedTuple):
    """The triangles of a mesh that may be clear somewhere, for kernels.

    ``rows`` (m,) int32 are rows of ``uv`` (k, 6) float32, the texture coordinates of three corners, or -1; empty where no
    triangle is clear anywhere. ``texels``, ``sizes`` and ``starts`` are those of :class:`mmi.appearance.cut_outs.AlphaLevels`.
    """

    rows: NDArray[np.int32]
    uv: NDArray[np.float32]
    texels: NDArray[np.uint8]
    sizes: NDArray[np.int64]
    starts: NDArray[np.int64]


def see_through_of(mesh: CityMesh) -> SeeThrough:
    """What rays may go through of a mesh."""
    some = np.zeros(0, dtype=np.intp)
    if mesh.has_cut_outs:
        some = np.flatnonzero(cut_out_triangles(clear_blocks(mesh.texture), mesh.uv, mesh.triangles))
    rows = np.full(len(mesh.triangles) if len(some) else 0, -1, dtype=np.int32)
    rows[some] = np.arange(len(some))
    levels = alpha_levels(mesh.texture if len(some) else np.zeros((1, 1, 4), dtype=np.uint8))
    see = SeeThrough(rows, mesh.uv[mesh.triangles[some]].reshape(-1, 6), levels.texels, levels.sizes, levels.starts)
    for array in see:
        array.setflags(write=False)
    return see


@kernel(nogil=True, error_model="numpy")
def is_open(see: SeeThrough, corners: NDArray[np.float32], i: int | np.uint64, ray: Ray, pixel_angle: float) -> bool:
    """Whether triangle ``i`` is clear where a ray meets it, for pixels of ``pixel_angle`` radians."""
    if len(see.rows) == 0 or see.rows[i] < 0:
        return False
    uv = see.uv[see.rows[i]]
    t, v, w = point_met(corners, i, ray)
    if math.isnan(t):
        return False
    height, width = see.sizes[0, 0], see.sizes[0, 1]
    texels = _texels_across(corners[i], uv, ray, width, height) * t * pixel_angle
    level = min(math.log2(texels) + LEVEL_BIAS, float(len(see.sizes))) if texels > 1.0 else 0.0
    first = 1.0 - v - w
    u_met = first * uv[0] + v * uv[2] + w * uv[4]
    v_met = first * uv[1] + v * uv[3] + w * uv[5]
    return is_clear(see.texels, see.sizes, see.starts, u_met, v_met, level)


@kernel(nogil=True, error_model="numpy")
def _texels_across(a: NDArray[np.float32], uv: NDArray[np.float32], ray: Ray, width: int, height: int) -> float:
    """Texels that the texture of triangle ``a`` (9,) with coordinates ``uv`` (6,) moves on from a ray to one that passes a
    metre beside it, level; or above it, where that is more. 0 where the ray grazes.
    """
    dx, dy, dz = ray.dx, ray.dy, ray.dz
    bx, by, bz = float(a[3]) - a[0], float(a[4]) - a[1], float(a[5]) - a[2]
    cx, cy, cz = float(a[6]) - a[0], float(a[7]) - a[1], float(a[8]) - a[2]
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    area, facing = nx * nx + ny * ny + nz * nz, nx * dx + ny * dy + nz * dz
    if not abs(facing) > _GRAZING * math.sqrt(area):
        return 0.0
    level = math.hypot(dx, dy)
    rx, ry = (dy / level, -dx / level) if level > 0.0 else (1.0, 0.0)
    most = 0.0
    for ex, ey, ez in ((rx, ry, 0.0), (ry * dz, -rx * dz, rx * dy - ry * dx)):
        along = (nx * ex + ny * ey + nz * ez) / facing  # what the ray has to go on or back to stay in the plane
        px, py, pz = ex - along * dx, ey - along * dy, ez - along * dz
        of_b = (px * (cy * nz - cz * ny) + py * (cz * nx - cx * nz) + pz * (cx * ny - cy * nx)) / area
        of_c = (px * (ny * bz - nz * by) + py * (nz * bx - nx * bz) + pz * (nx * by - ny * bx)) / area
        u = (of_b * (uv[2] - uv[0]) + of_c * (uv[4] - uv[0])) * width
        v = (of_b * (uv[3] - uv[1]) + of_c * (uv[5] - uv[1])) * height
        most = max(most, math.hypot(u, v))
    return most
