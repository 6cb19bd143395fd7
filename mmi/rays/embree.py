"""First hits by Embree (Wald et al., "Embree: a kernel framework for efficient CPU ray tracing", SIGGRAPH 2014).

Embree is called directly and works in float32. It says which triangle a ray meets first; where, how far away, and which of
coincident faces, is computed here in double precision. Its robust mode is used, whose test is watertight. Rays are sent from
``nearest`` metres along, so that what is nearer costs nothing. Embree lets other Python threads run while it casts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import ArrayLike, NDArray

from mmi.appearance.city_mesh import CityMesh
from mmi.foundation.kernels import kernel
from mmi.rays.coincident import Coincident, coincident_faces, settle
from mmi.rays.grid import build_grid
from mmi.rays.hits import Hits, no_hits, rays_of
from mmi.rays.ray_triangle import corners_of, shear
from mmi.rays.shares import Shares

__all__ = ["EmbreeCaster", "embree_caster"]


@dataclass(frozen=True, slots=True, eq=False)
class EmbreeCaster:
    """A caster that asks Embree's ``scene`` (None without triangles). ``corners`` (m, 9) of the triangles are metres."""

    corners: NDArray[np.float32]
    scene: Any
    coincident: Coincident
    shares: Shares

    def first_hits(self, origins: ArrayLike, directions: ArrayLike, *, nearest: float = 0.0) -> Hits:
        """First hits, as :class:`mmi.rays.hits.Caster` has them."""
        starts, along = rays_of(origins, directions)
        hits = no_hits(len(along))
        if self.scene is not None:

            def cast(first: int, last: int) -> None:
                part = slice(first, last)
                some = starts[part] if len(starts) > 1 else starts
                found = (hits.triangle[part], hits.distance[part], hits.weights[part])
                self._cast(some, along[part], nearest, found)

            self.shares.run(cast, len(along))
        return hits

    def _cast(
        self,
        origins: NDArray[np.float64],
        directions: NDArray[np.float64],
        nearest: float,
        found: tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]],
    ) -> None:
        """Cast some rays and write what they hit into ``found``: parts of the three arrays of hits."""
        moved = (origins + nearest * directions).astype(np.float32)
        said = self.scene.run(moved, directions.astype(np.float32), output=1)
        _settle_all(origins, directions, nearest, self.corners, self.coincident, said["primID"], found)


def embree_caster(mesh: CityMesh, *, workers: int) -> EmbreeCaster:
    """A caster for a mesh, with ``workers`` threads. Building it takes seconds for a million triangles."""
    corners = corners_of(mesh)
    scene = None
    if len(corners):
        scene = EmbreeScene(robust=True)
        TriangleMesh(scene, mesh.positions, mesh.triangles)
        ray = np.ones((1, 3), dtype=np.float32)
        scene.run(ray, ray)  # Embree builds its tree for the first ray, which must not be several at a time
    return EmbreeCaster(corners, scene, coincident_faces(corners, build_grid(corners)), Shares(workers))


@kernel(nogil=True, error_model="numpy")
def _settle_all(
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    nearest: float,
    corners: NDArray[np.float32],
    coincident: Coincident,
    said: NDArray[np.int32],
    found: tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]],
) -> None:
    """Where the rays meet the triangles ``said`` (n,), written into ``found``."""
    triangle, distance, weights = found
    for r in range(len(said)):
        if said[r] < 0:
            continue
        o, d = origins[r if len(origins) > 1 else 0], directions[r]
        kx, ky, kz, sx, sy, sz = shear(d[0], d[1], d[2])
        hit, t, v, w = settle(corners, coincident, said[r], kx, ky, kz, o[kx], o[ky], o[kz], sx, sy, sz)
        if not math.isnan(t):
            triangle[r], distance[r], weights[r, 0], weights[r, 1] = hit, max(t, nearest), v, w
