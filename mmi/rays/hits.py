"""What rays hit first, and what everything that finds it is asked: the seam between those who cast and those who draw."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Caster", "Hits", "no_hits", "rays_of"]


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """What each of n rays hits first.

    ``triangle`` (n,) int32, the row of the mesh's triangles, -1 for none; ``distance`` (n,) float32 metres along the ray
    from where it started, infinite for none; ``weights`` (n, 2) float32, how much of the triangle's second and third corner
    the point has (the first has the rest), 0 for none.
    """

    triangle: NDArray[np.int32]
    distance: NDArray[np.float32]
    weights: NDArray[np.float32]


class Caster(Protocol):
    """Anything that finds first hits. It may be called from several threads at a time."""

    def first_hits(
        self, origins: ArrayLike, directions: ArrayLike, *, nearest: float = 0.0, pixel_angle: float = 0.0
    ) -> Hits:
        """The first hits of rays in the city's frame from ``origins`` (3,) or (n, 3) along ``directions`` (n, 3), which are
        unit vectors; those nearer than ``nearest`` metres do not count. Both sides of a triangle can be hit; one without area,
        or that a ray passes edge-on, is not. Rays go through what is clear of cut-outs, at the level of the texture that
        pixels of ``pixel_angle`` radians show, the finest for 0.
        """
        ...


def no_hits(count: int) -> Hits:
    """The hits of ``count`` rays that hit nothing, in arrays that may be written to."""
    return Hits(
        np.full(count, -1, dtype=np.int32), np.full(count, np.inf, np.float32), np.zeros((count, 2), np.float32)
    )


def rays_of(origins: ArrayLike, directions: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rays as casters get them, as float64 arrays: origins (1, 3), which all rays share, or (n, 3), and directions (n, 3).

    Raises ValueError if they have other shapes.
    """
    starts = np.ascontiguousarray(origins, dtype=np.float64)
    along = np.ascontiguousarray(directions, dtype=np.float64)
    if along.ndim != 2 or along.shape[1] != 3 or starts.shape not in ((3,), along.shape):
        raise ValueError(
            f"rays need origins (3,) or (n, 3) and directions (n, 3), found {starts.shape} and {along.shape}"
        )
    return starts.reshape(-1, 3), along
