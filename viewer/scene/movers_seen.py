"""Which moving objects a view may show at a time, how they stand, and how far away they are: conservative, vectorised."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View
from mmi.movers.movers import Movers, distances
from viewer.scene.frustum import spheres_within_view, within_view

__all__ = ["SeenMovers", "movers_in"]


@dataclass(frozen=True, slots=True, eq=False)
class SeenMovers:
    """Some movers, the nearest first: ``which`` (k,) are their places among all, ``poses`` (k, 4, 4) world_from_model.

    ``corners`` (k, 8, 3) are those of their boxes in the world, ``distances`` (k,) from the eye to the boxes; metres.
    """

    which: NDArray[np.int64]
    poses: NDArray[np.float64]
    corners: NDArray[np.float64]
    distances: NDArray[np.float64]

    def of(self, kept: NDArray[np.bool_]) -> SeenMovers:
        """Those that are ``kept`` (k,), in their order."""
        return SeenMovers(self.which[kept], self.poses[kept], self.corners[kept], self.distances[kept])


def movers_in(view: View, movers: Movers, time: float) -> SeenMovers:
    """The movers that ``view`` may show at ``time`` (seconds), whatever else may hide them.

    None that shows is left out; a few are kept whose boxes pass by a corner of the picture.
    """
    which = np.flatnonzero(movers.present(time) & spheres_within_view(movers.places(time), movers.reach, view))
    poses = movers.poses(time, which)
    corners = movers.corners(poses, which)
    away = distances(view.eye, poses, movers.boxes[which])
    kept = np.flatnonzero(within_view(corners, view))
    order = kept[np.lexsort((which[kept], away[kept]))]
    return SeenMovers(which[order], poses[order], corners[order], away[order])
