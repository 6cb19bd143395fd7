"""First hits by a walk through the cells of a regular grid (Amanatides and Woo, "A fast voxel traversal algorithm for ray
tracing", Eurographics 1987; paper section 4.2).

A ray enters the grid where it is ``nearest`` metres long, or later, and steps from cell to cell across the nearest of three
planes. It stops in the cell that holds the nearest hit so far. Of a cell's triangles only those are tested whose box and plane
meet the part of the ray that is in the cell: most triangles are windows of other storeys, or parts of other walls. So a
triangle that fills many cells is tested in the one where it is met, and none needs to remember the rays that it was tested for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmi.appearance.city_mesh import CityMesh
from mmi.foundation.kernels import kernel
from mmi.rays.coincident import Coincident, coincident_faces, settle
from mmi.rays.grid import Grid, build_grid
from mmi.rays.hits import Hits, no_hits, rays_of
from mmi.rays.ray_triangle import bounds_of, corners_of, meeting, point_met, ray_along
from mmi.rays.see_through import SeeThrough, is_open, see_through_of
from mmi.rays.shares import Shares

__all__ = ["GridCaster", "grid_caster"]

_0, _1, _2, _3, _4 = np.uint64(0), np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)
_5, _6, _7, _8, _9 = np.uint64(5), np.uint64(6), np.uint64(7), np.uint64(8), np.uint64(9)
_BESIDE = 2e-6
"""Share of the largest coordinate by which boxes and planes may pass beside a ray: four times what float32 makes of that."""


@dataclass(frozen=True, slots=True, eq=False)
class GridCaster:
    """A caster that walks through ``grid``. ``corners`` (m, 9) and ``bounds`` (m, 10) of the triangles are in metres;
    ``beside`` is how far a box or plane may pass from a ray in its cell, for all that is known of it in float32.
    """

    corners: NDArray[np.float32]
    bounds: NDArray[np.float32]
    beside: float
    grid: Grid
    coincident: Coincident
    see: SeeThrough
    shares: Shares

    def first_hits(
        self, origins: ArrayLike, directions: ArrayLike, *, nearest: float = 0.0, pixel_angle: float = 0.0
    ) -> Hits:
        """First hits, as :class:`mmi.rays.hits.Caster` has them."""
        starts, along = rays_of(origins, directions)
        hits = no_hits(len(along))

        def walk(first: int, last: int) -> None:
            _walk(
                starts if len(starts) == 1 else starts[first:last],
                along[first:last],
                nearest,
                pixel_angle,
                self.corners,
                self.bounds,
                self.beside,
                self.grid,
                self.coincident,
                self.see,
                (hits.triangle[first:last], hits.distance[first:last], hits.weights[first:last]),
            )

        if len(self.corners):
            self.shares.run(walk, len(along))
        return hits


def grid_caster(mesh: CityMesh, *, workers: int) -> GridCaster:
    """A caster for a mesh, with ``workers`` threads. Building it takes seconds for a million triangles."""
    corners = corners_of(mesh)
    bounds, grid = bounds_of(corners), build_grid(corners)
    return GridCaster(
        corners=corners,
        bounds=bounds,
        beside=_BESIDE * float(np.abs(corners).max(initial=0.0)),
        grid=grid,
        coincident=coincident_faces(corners, bounds, grid),
        see=see_through_of(mesh),
        shares=Shares(workers),
    )


@kernel(nogil=True, error_model="numpy")
def _enter(grid: Grid, k: int, o: float, d: float, t_in: float, t_out: float) -> tuple[float, float]:
    """The part of a ray from ``t_in`` to ``t_out`` that is between the grid's two planes across axis ``k``; empty (inf, 0)
    if there is none.
    """
    low = grid.low[k] - o
    high = low + grid.cell * grid.size[k]
    if d == 0.0:
        return (t_in, t_out) if low <= 0.0 <= high else (np.inf, 0.0)
    a, b = low / d, high / d
    return max(t_in, min(a, b)), min(t_out, max(a, b))


@kernel(nogil=True, error_model="numpy")
def _begin(grid: Grid, k: int, o: float, d: float, t: float) -> tuple[int, int, float, float]:
    """Along axis ``k``: the cell of a ray at ``t``, its steps from there, when it leaves that cell and how long one takes."""
    size = grid.size[k]
    here = min(max(int(np.floor((o + t * d - grid.low[k]) / grid.cell)), 0), size - 1)
    if d > 0.0:
        return here, 1, (grid.low[k] + (here + 1) * grid.cell - o) / d, grid.cell / d
    if d < 0.0:
        return here, -1, (grid.low[k] + here * grid.cell - o) / d, -grid.cell / d
    return here, 0, np.inf, np.inf


@kernel(nogil=True, error_model="numpy")
def _walk(
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    nearest: float,
    pixel_angle: float,
    corners: NDArray[np.float32],
    bounds: NDArray[np.float32],
    beside: float,
    grid: Grid,
    coincident: Coincident,
    see: SeeThrough,
    found: tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]],
) -> None:
    """Find what rays hit, and write it into ``found``: the three arrays of hits."""
    triangle, distance, weights = found
    size_x, size_y, size_z = grid.size
    starts, entries, slack = grid.starts, grid.entries, np.float32(beside)
    for r in range(len(directions)):
        s = r if len(origins) > 1 else 0
        ox, oy, oz = origins[s, 0], origins[s, 1], origins[s, 2]
        dx, dy, dz = directions[r, 0], directions[r, 1], directions[r, 2]
        t_in, t_out = _enter(grid, 0, ox, dx, nearest, np.inf)
        t_in, t_out = _enter(grid, 1, oy, dy, t_in, t_out)
        t_in, t_out = _enter(grid, 2, oz, dz, t_in, t_out)
        if not t_in <= t_out < np.inf:
            continue
        x, step_x, next_x, slow_x = _begin(grid, 0, ox, dx, t_in)
        y, step_y, next_y, slow_y = _begin(grid, 1, oy, dy, t_in)
        z, step_z, next_z, slow_z = _begin(grid, 2, oz, dz, t_in)
        ray = ray_along(ox, oy, oz, dx, dy, dz)
        fx, fy, fz = np.float32(dx), np.float32(dy), np.float32(dz)
        c = (x * size_y + y) * size_z + z
        jump_x, jump_y, jump_z = step_x * size_y * size_z, step_y * size_z, step_z
        left_x = size_x - x if step_x > 0 else x + 1
        left_y = size_y - y if step_y > 0 else y + 1
        left_z = size_z - z if step_z > 0 else z + 1
        best, hit = np.inf, np.int64(-1)
        while True:
            t_out = min(next_x, next_y, next_z)
            first, last = starts[np.uint64(c)], starts[np.uint64(c + 1)]
            if first < last:
                middle, half = 0.5 * (t_in + t_out), np.float32(0.5 * (t_out - t_in))
                mx, my, mz = np.float32(ox + middle * dx), np.float32(oy + middle * dy), np.float32(oz + middle * dz)
                rx, ry, rz = abs(fx) * half + slack, abs(fy) * half + slack, abs(fz) * half + slack
                x0, x1, y0, y1, z0, z1 = mx - rx, mx + rx, my - ry, my + ry, mz - rz, mz + rz
                for e in range(first, last):
                    i = np.uint64(entries[np.uint64(e)])
                    if (
                        bounds[i, _4] > z1
                        or bounds[i, _5] < z0
                        or bounds[i, _0] > x1
                        or bounds[i, _1] < x0
                        or bounds[i, _2] > y1
                        or bounds[i, _3] < y0
                    ):
                        continue
                    nx, ny, nz, offset = bounds[i, _6], bounds[i, _7], bounds[i, _8], bounds[i, _9]
                    away = abs(nx * mx + ny * my + nz * mz + offset)
                    if away > abs(nx * fx + ny * fy + nz * fz) * half + slack:
                        continue
                    t = meeting(corners, i, ray)
                    closer = nearest <= t and (t < best or (t == best and np.int64(i) < hit))
                    if closer and not is_open(see, corners, i, ray, pixel_angle):
                        best, hit = t, np.int64(i)
            if best <= t_out:
                break
            t_in = t_out
            if next_x <= next_y and next_x <= next_z:
                c += jump_x
                next_x += slow_x
                left_x -= 1
                if left_x == 0:
                    break
            elif next_y <= next_z:
                c += jump_y
                next_y += slow_y
                left_y -= 1
                if left_y == 0:
                    break
            else:
                c += jump_z
                next_z += slow_z
                left_z -= 1
                if left_z == 0:
                    break
        if hit >= 0:
            chosen = settle(corners, coincident, see, int(hit), ray, pixel_angle)
            best, v, w = point_met(corners, chosen, ray)
            triangle[r], distance[r], weights[r, 0], weights[r, 1] = chosen, max(best, nearest), v, w
