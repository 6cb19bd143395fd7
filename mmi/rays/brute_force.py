"""First hits by testing every triangle: the plain twin that the other casters are held against.

It shares nothing with them but what a hit is. A ray meets a triangle if the volumes that it spans with the three sides have
no two signs. Of the faces that it meets in the plane of the nearest one, within ``FLAT``, the one drawn first is hit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmi.appearance.city_mesh import CityMesh
from mmi.appearance.cut_outs import AlphaLevels, alpha_levels, clear_at, clear_blocks, cut_out_triangles
from mmi.rays.coincident import FLAT
from mmi.rays.hits import Hits, no_hits, rays_of
from mmi.rays.see_through import LEVEL_BIAS

__all__ = ["BruteForce", "brute_force"]

_TESTS = 1 << 20
"""Rays times triangles that are tested at once."""
_PARALLEL = 0.98


@dataclass(frozen=True, slots=True, eq=False)
class _Clear:
    """Which triangles may be clear, (m,), their ``uv`` (m, 3, 2) and the texture's alpha."""

    any_clear: NDArray[np.bool_]
    uv: NDArray[np.float64]
    levels: AlphaLevels


@dataclass(frozen=True, slots=True, eq=False)
class BruteForce:
    """A caster that tests every triangle. ``corners`` (m, 3, 3) float64 metres, ``normals`` (m, 3), 0 without area, and
    ``areas`` (m,), in square metres times two; ``clear`` what of them is clear, None if nothing.
    """

    corners: NDArray[np.float64]
    normals: NDArray[np.float64]
    areas: NDArray[np.float64]
    clear: _Clear | None

    def first_hits(
        self, origins: ArrayLike, directions: ArrayLike, *, nearest: float = 0.0, pixel_angle: float = 0.0
    ) -> Hits:
        """First hits, as :class:`mmi.rays.hits.Caster` has them."""
        starts, along = rays_of(origins, directions)
        starts = np.broadcast_to(starts, along.shape)
        hits = no_hits(len(along))
        some = max(1, _TESTS // max(len(self.corners), 1))
        for first in range(0, len(along) if len(self.corners) else 0, some):
            part = slice(first, first + some)
            distances, volumes = self._meetings(starts[part], along[part], nearest)
            if self.clear is not None:
                met = np.nonzero(np.isfinite(distances))
                distances[met] = np.where(
                    self._is_open(along[part][met[0]], met[1], distances[met], volumes[met], pixel_angle),
                    np.inf,
                    distances[met],
                )
            chosen = self._first_drawn(distances)
            rays = np.arange(len(chosen))
            hit = np.isfinite(distances[rays, chosen])
            hits.triangle[part] = np.where(hit, chosen, -1)
            hits.distance[part] = distances[rays, chosen]
            weights = volumes[rays, chosen, 1:]
            hits.weights[part] = np.where(hit[:, None], weights, 0.0)
        return hits

    def _meetings(
        self, origins: NDArray[np.float64], directions: NDArray[np.float64], nearest: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(n, m) how far along each ray it meets each triangle, infinite if not, and (n, m, 3) the weights of its corners."""
        a, b, c = (self.corners[None, :, k] - origins[:, None] for k in range(3))
        volumes = np.stack([_along(directions, first, second) for first, second in ((c, b), (a, c), (b, a))], axis=-1)
        total = volumes.sum(axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            weights = volumes / total[..., None]
            points = weights[..., :1] * a + weights[..., 1:2] * b + weights[..., 2:] * c
            distances = np.einsum("nmk,nk->nm", points, directions)
            one_sided = (volumes >= 0.0).all(axis=-1) | (volumes <= 0.0).all(axis=-1)
            met = one_sided & (total != 0.0) & (distances >= nearest)
        return np.where(met, distances, np.inf), weights

    def _is_open(
        self,
        directions: NDArray[np.float64],
        triangles: NDArray[np.intp],
        distances: NDArray[np.float64],
        weights: NDArray[np.float64],
        pixel_angle: float,
    ) -> NDArray[np.bool_]:
        """(k,) whether ``triangles`` (k,) are clear where rays meet them at ``distances`` (k,) and ``weights`` (k, 3).

        The texture's coordinates are those of two more rays, a pixel to the right and one up, which meet the same plane.
        """
        assert self.clear is not None
        levels, uv = self.clear.levels, self.clear.uv[triangles]
        here = np.einsum("kc,kcn->kn", weights, uv)
        right = np.cross(directions, np.where(np.abs(directions[:, 2:]) < 1.0, (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)))
        right /= np.linalg.norm(right, axis=1, keepdims=True)
        corners = self.corners[triangles]
        edges = np.stack(
            [corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], self.normals[triangles]], axis=-1
        )
        change = np.zeros(len(triangles))
        for beside in (right, np.cross(right, directions)):
            step = beside * (distances * pixel_angle)[:, None]
            normal = self.normals[triangles]
            with np.errstate(divide="ignore", invalid="ignore"):
                back = np.einsum("kn,kn->k", normal, step) / np.einsum("kn,kn->k", normal, directions)
            solved = np.linalg.solve(edges, (step - back[:, None] * directions)[..., None])[:, :2, 0]
            moved = np.einsum("kc,kcn->kn", solved, uv[:, 1:] - uv[:, :1]) * levels.sizes[0, ::-1]
            change = np.maximum(change, np.linalg.norm(moved, axis=1))
        level = np.log2(np.maximum(change, 1.0)) + np.where(change > 1.0, LEVEL_BIAS, 0.0)
        return self.clear.any_clear[triangles] & clear_at(levels, here, level)

    def _first_drawn(self, distances: NDArray[np.float64]) -> NDArray[np.intp]:
        """(n,) of the faces that each ray meets in the plane of its nearest hit, the first."""
        nearest = distances.argmin(axis=1)
        flat = np.stack([self._level_with(one) for one in nearest]) & np.isfinite(distances)
        return np.where(flat.any(axis=1), flat.argmax(axis=1), nearest)

    def _level_with(self, one: int) -> NDArray[np.bool_]:
        """(m,) which triangles lie in the plane of triangle ``one``: the corners of the smaller in that of the larger."""
        theirs = np.abs((self.corners - self.corners[one, 0]) @ self.normals[one]).max(axis=1)
        its = np.abs(np.einsum("kmd,md->mk", self.corners[one, :, None] - self.corners[:, 0], self.normals)).max(axis=1)
        away = np.where(self.areas <= self.areas[one], theirs, its)
        return (away <= FLAT) & (np.abs(self.normals @ self.normals[one]) >= _PARALLEL)


def brute_force(mesh: CityMesh) -> BruteForce:
    """A caster that tests every triangle of a mesh: for tests, or a handful of rays."""
    corners = mesh.positions[mesh.triangles].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    normals /= np.where(areas > 0.0, areas, 1.0)[:, None]
    clear = None
    if mesh.has_cut_outs:
        some = cut_out_triangles(clear_blocks(mesh.texture), mesh.uv, mesh.triangles)
        clear = _Clear(some, mesh.uv[mesh.triangles].astype(np.float64), alpha_levels(mesh.texture))
    return BruteForce(corners, normals, areas, clear)


def _along(
    directions: NDArray[np.float64], first: NDArray[np.float64], second: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n, m) the volumes that directions (n, 3) span with pairs of vectors (n, m, 3)."""
    (ax, ay, az), (bx, by, bz) = np.moveaxis(first, -1, 0), np.moveaxis(second, -1, 0)
    dx, dy, dz = directions.T[:, :, None]
    return dx * (ay * bz - az * by) + dy * (az * bx - ax * bz) + dz * (ax * by - ay * bx)
