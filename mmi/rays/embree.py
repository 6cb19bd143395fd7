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
from mmi.rays.coincident import FLAT, Coincident, coincident_faces, settle
from mmi.rays.grid import build_grid
from mmi.rays.hits import Hits, no_hits, rays_of
from mmi.rays.ray_triangle import bounds_of, corners_of, point_met, ray_along
from mmi.rays.see_through import SeeThrough, see_through_of
from mmi.rays.shares import Shares

__all__ = ["EmbreeCaster", "embree_caster"]


@dataclass(frozen=True, slots=True, eq=False)
class EmbreeCaster:
    """A caster that asks Embree's ``scene`` (None without triangles). ``corners`` (m, 9) of the triangles are metres."""

    corners: NDArray[np.float32]
    scene: Any
    coincident: Coincident
    see: SeeThrough
    shares: Shares

    def first_hits(
        self, origins: ArrayLike, directions: ArrayLike, *, nearest: float = 0.0, pixel_angle: float = 0.0
    ) -> Hits:
        """First hits, as :class:`mmi.rays.hits.Caster` has them."""
        starts, along = rays_of(origins, directions)
        hits = no_hits(len(along))

        def cast(first: int, last: int) -> None:
            part = slice(first, last)
            self._cast(
                starts[part] if len(starts) > 1 else starts,
                along[part],
                nearest,
                pixel_angle,
                (hits.triangle[part], hits.distance[part], hits.weights[part]),
            )

        if self.scene is not None:
            self.shares.run(cast, len(along))
        return hits

    def _cast(
        self,
        origins: NDArray[np.float64],
        directions: NDArray[np.float64],
        nearest: float,
        pixel_angle: float,
        found: tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]],
    ) -> None:
        """Cast some rays and write what they hit into ``found``: parts of the three arrays of hits.

        Rays that hit nothing but what is clear, or seen edge-on, go on from just behind it.
        """
        rays = np.arange(len(directions))
        begins, steps = np.full(len(rays), nearest), np.full(len(rays), 2.0 * FLAT)
        while len(rays):
            moved, along = _moved(rays, origins, directions, begins)
            said = self.scene.run(moved, along, output=1)
            hit = (said["primID"], said["tfar"])
            going = _look(
                rays,
                origins,
                directions,
                nearest,
                pixel_angle,
                self.corners,
                self.coincident,
                self.see,
                hit,
                begins,
                steps,
                found,
            )
            rays = rays[going]


def embree_caster(mesh: CityMesh, *, workers: int) -> EmbreeCaster:
    """A caster for a mesh, with ``workers`` threads. Building it takes seconds for a million triangles."""
    corners = corners_of(mesh)
    scene = None
    if len(corners):
        scene = EmbreeScene(robust=True)
        TriangleMesh(scene, mesh.positions, mesh.triangles)
        ray = np.ones((1, 3), dtype=np.float32)
        scene.run(ray, ray)  # Embree builds its tree for the first ray, which must not be several at a time
    coincident = coincident_faces(corners, bounds_of(corners), build_grid(corners))
    return EmbreeCaster(corners, scene, coincident, see_through_of(mesh), Shares(workers))


@kernel(nogil=True, error_model="numpy")
def _moved(
    rays: NDArray[np.int64],
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    begins: NDArray[np.float64],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The origins and directions of some ``rays`` (k,), as Embree gets them: each begins ``begins`` (n,) metres along."""
    moved = np.empty((len(rays), 3), dtype=np.float32)
    along = np.empty((len(rays), 3), dtype=np.float32)
    for k in range(len(rays)):
        r = rays[k]
        s = r if len(origins) > 1 else 0
        for n in range(3):
            moved[k, n] = origins[s, n] + begins[r] * directions[r, n]
            along[k, n] = directions[r, n]
    return moved, along


@kernel(nogil=True, error_model="numpy")
def _look(
    rays: NDArray[np.int64],
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    nearest: float,
    pixel_angle: float,
    corners: NDArray[np.float32],
    coincident: Coincident,
    see: SeeThrough,
    said: tuple[NDArray[np.int32], NDArray[np.float32]],
    begins: NDArray[np.float64],
    steps: NDArray[np.float64],
    found: tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]],
) -> NDArray[np.bool_]:
    """Write what some ``rays`` (k,) hit into ``found``; ``said`` are the triangles that Embree says, and how far from where the
    ray began.

    Returns (k,) which of them go on, and moves their ``begins`` (n,). They take longer ``steps`` (n,) where one has not left
    behind what it is to pass.
    """
    triangle, distance, weights = found
    going = np.zeros(len(rays), dtype=np.bool_)
    for k in range(len(rays)):
        hit, r = said[0][k], rays[k]
        if hit < 0:
            continue
        s = r if len(origins) > 1 else 0
        ray = ray_along(
            origins[s, 0], origins[s, 1], origins[s, 2], directions[r, 0], directions[r, 1], directions[r, 2]
        )
        chosen = settle(corners, coincident, see, hit, ray, pixel_angle)
        if chosen >= 0:
            t, v, w = point_met(corners, chosen, ray)
            if not math.isnan(t):
                triangle[r], distance[r], weights[r, 0], weights[r, 1] = chosen, max(t, nearest), v, w
                continue
        going[k] = True
        steps[r] = 2.0 * steps[r] if said[1][k] <= steps[r] else 2.0 * FLAT
        begins[r] += said[1][k] + steps[r]
    return going
