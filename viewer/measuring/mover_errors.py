"""How wrong objects that move are in a picture, apart from all else: against the geometry's picture of the same view and time.

What stands is one background here: it matters which mover a pixel shows, not what is behind it. Where a layer's outline is off,
movers behind it are seen to begin or end there, so that errors of layers count as well; to tell them from those of movers'
images, compare with the same technique and movers as geometry.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_opening

from viewer.drawing.drawn_picture import DrawnPicture

__all__ = ["MoverErrors", "mover_errors"]


class MoverErrors(NamedTuple):
    """Pixels: ``truth`` shows movers in so many, ``missing`` of them lack their mover in the technique's picture, which shows
    one in ``surplus`` pixels where the geometry shows another or none; those within a rim count in neither. ``hidden`` of the
    surplus show movers that the geometry hides altogether, in regions that are thicker than the rim.
    """

    truth: int
    missing: int
    surplus: int
    hidden: int

    @property
    def share(self) -> float:
        """Of the pixels of movers, those that are wrong."""
        return (self.missing + self.surplus) / max(self.truth, 1)


def mover_errors(truth: DrawnPicture, shown: DrawnPicture, *, first: int, rim: int = 2) -> MoverErrors:
    """Compare two measured pictures of the same view, in which movers have the ids from ``first`` on.

    A pixel of a mover is right where the other picture shows that mover within ``rim`` pixels to either side, above and below.
    Raises ValueError for pictures that were not measured.
    """
    if truth.object_ids is None or shown.object_ids is None:
        raise ValueError("two measured pictures expected, found one without object ids")
    one, other = (np.where(ids >= first, ids, -1) for ids in (truth.object_ids, shown.object_ids))
    missing, surplus = (one >= 0) & ~_around(one, other, rim), (other >= 0) & ~_around(other, one, rim)
    hidden = binary_opening((other >= 0) & ~np.isin(other, one), np.ones((rim + 1, rim + 1)))
    return MoverErrors(int((one >= 0).sum()), int(missing.sum()), int(surplus.sum()), int(hidden.sum()))


def _around(ids: NDArray[np.int32], other: NDArray[np.int32], rim: int) -> NDArray[np.bool_]:
    """(h, w) where the object of ``ids`` (h, w) occurs within ``rim`` pixels of the same place in ``other`` (h, w)."""
    height, width = ids.shape
    padded = np.full((height + 2 * rim, width + 2 * rim), -2, dtype=other.dtype)
    padded[rim : rim + height, rim : rim + width] = other
    found = np.zeros(ids.shape, dtype=bool)
    for down in range(2 * rim + 1):
        for right in range(2 * rim + 1):
            found |= padded[down : down + height, right : right + width] == ids
    return found
