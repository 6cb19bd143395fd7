"""First hits by a walk through the cells of a regular grid (Amanatides and Woo, "A fast voxel traversal algorithm for ray
tracing", Eurographics 1987; paper section 4.2).

A ray enters the grid where it is ``nearest`` metres long, or later, and steps from cell to cell across the nearest of three
planes. It stops in the cell that holds the nearest hit so far.
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
from mmi.rays.ray_triangle import corners_of, meeting, shear
from mmi.rays.shares import Shares

__all__ = ["GridCaster", "grid_caster"]


@dataclass(frozen=True, slots=True, eq=False)
class GridCaster:
    """A caster that walks through ``grid``. ``corners`` (m, 9) of the triangles are metres; ``shares`` has its threads."""

    corners: NDArray[np.float32]
    grid: Grid
    coincident: Coincident
    shares: Shares

    def first_hits(self, origins: ArrayLike, directions: ArrayLike, *, nearest: float = 0.0) -> Hits:
        """First hits, as :class:`mmi.rays.hits.Caster` has them."""
        starts, along = rays_of(origins, directions)
        hits = no_hits(len(along))
        if len(self.corners):
            found = (hits.triangle, hits.distance, hits.weights)

            def walk(first: int, last: int) -> None:
                _walk(starts, along, nearest, self.corners, self.grid, self.coincident, found, first, last)

            self.shares.run(walk, len(along))
        return hits


def grid_caster(mesh: CityMesh, *, workers: int) -> GridCaster:
    """A caster for a mesh, with ``workers`` threads. Building it takes seconds for a million triangles."""
    corners = corners_of(mesh)
    grid = build_grid(corners)
    return GridCaster(corners, grid, coincident_faces(corners, grid), Shares(workers))


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
    corners: NDArray[np.float32],
    grid: Grid,
    coincident: Coincident,
    found: tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]],
    first: int,
    last: int,
) -> None:
    """Find what the rays from ``first`` to ``last`` hit, and write it into ``found``: the three arrays of hits."""
    triangle, distance, weights = found
    size_x, size_y, size_z = grid.size
    starts, entries = grid.starts, grid.entries
    for r in range(first, last):
        o, d = origins[r if len(origins) > 1 else 0], directions[r]
        ox, oy, oz, dx, dy, dz = o[0], o[1], o[2], d[0], d[1], d[2]
        t_in, t_out = _enter(grid, 0, ox, dx, nearest, np.inf)
        t_in, t_out = _enter(grid, 1, oy, dy, t_in, t_out)
        t_in, t_out = _enter(grid, 2, oz, dz, t_in, t_out)
        if not t_in <= t_out < np.inf:
            continue
        x, step_x, next_x, slow_x = _begin(grid, 0, ox, dx, t_in)
        y, step_y, next_y, slow_y = _begin(grid, 1, oy, dy, t_in)
        z, step_z, next_z, slow_z = _begin(grid, 2, oz, dz, t_in)
        kx, ky, kz, sx, sy, sz = shear(dx, dy, dz)
        px, py, pz = o[kx], o[ky], o[kz]
        best, hit = np.inf, -1
        while True:
            c = (x * size_y + y) * size_z + z
            for e in range(starts[c], starts[c + 1]):
                i = entries[e]
                t = meeting(corners, i, kx, ky, kz, px, py, pz, sx, sy, sz)
                if nearest <= t and (t < best or (t == best and i < hit)):
                    best, hit = t, i
            if next_x <= next_y and next_x <= next_z:
                if best <= next_x:
                    break
                x += step_x
                next_x += slow_x
                if not 0 <= x < size_x:
                    break
            elif next_y <= next_z:
                if best <= next_y:
                    break
                y += step_y
                next_y += slow_y
                if not 0 <= y < size_y:
                    break
            else:
                if best <= next_z:
                    break
                z += step_z
                next_z += slow_z
                if not 0 <= z < size_z:
                    break
        if hit >= 0:
            hit, best, v, w = settle(corners, coincident, hit, kx, ky, kz, px, py, pz, sx, sy, sz)
            triangle[r], distance[r], weights[r, 0], weights[r, 1] = hit, max(best, nearest), v, w
