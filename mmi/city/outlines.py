"""The corners and edges of polygons as arrays: what walls, triangulation and sweeps begin with."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

__all__ = ["Outlines", "outlines_of"]


class Outlines(NamedTuple):
    """All rings of some polygons, of each polygon the exterior first.

    ``points`` (n, 2) are corners, ring after ring, each closed: its last point is its first. ``starts`` (e,) are the places of
    those that begin an edge: all but the last of each ring. ``ring`` (n,) is each point's ring, ``polygon`` (r,) each ring's
    polygon.
    """

    points: NDArray[np.float64]
    starts: NDArray[np.int64]
    ring: NDArray[np.int64]
    polygon: NDArray[np.int64]

    @property
    def edges(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Both ends (e, 2) of each edge, in the order of the rings."""
        return self.points[self.starts], self.points[self.starts + 1]

    @property
    def edge_rings(self) -> NDArray[np.int64]:
        """(e,) the ring of each edge."""
        return self.ring[self.starts]


def outlines_of(polygons: ArrayLike) -> Outlines:
    """The corners and edges of ``polygons`` (k,), which may be empty or none."""
    rings, polygon = shapely.get_rings(polygons, return_index=True)
    points, ring = shapely.get_coordinates(rings, return_index=True)
    return Outlines(points, np.flatnonzero(ring[1:] == ring[:-1]), ring, polygon)
