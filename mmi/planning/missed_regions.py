"""How thick the regions are that a rehearsed panorama misses: the largest disc of missed pixels, and whose pixels it holds."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.kernels import kernel
from mmi.foundation.thickness import largest_disc

__all__ = ["WORTH_KNOWING", "thickest_region"]

WORTH_KNOWING = 0.75
"""Regions that are less thick than this share of the limit are not measured."""
_WRAP = 64
"""So many columns are looked at twice, so that a region across the seam of the panorama is found whole."""


def thickest_region(
    missed: NDArray[np.int32], spans: NDArray[np.int64], known: float
) -> tuple[float, NDArray[np.int32]]:
    """Diameter in pixels of the largest disc of what is missed, if above ``known`` (else 0), and what the disc holds.

    ``missed`` (columns, rows) is which object is missed, -1 for none, around a viewpoint: the first column is next to the last.
    Only rows within ``spans`` (columns, 2) count.
    """
    ends = _squares(missed, spans, max(math.ceil(known / math.sqrt(2.0)), 1))
    most, inside = 0.0, np.empty(0, dtype=np.int32)
    if not len(ends):
        return most, inside
    reach = 2 * int(ends[:, 2].max()) + 2
    groups = np.split(ends, np.flatnonzero(np.diff(ends[:, 0]) > reach) + 1)
    for group in sorted(groups, key=lambda one: -int(one[:, 2].max())):
        # All pixels that a disc of diameter d touches are missed: those of a square of side d / sqrt(2) and more.
        if group[:, 2].max() * math.sqrt(2.0) <= max(most, known):
            break
        columns = np.arange(group[0, 0] - reach, group[-1, 0] + reach) % len(missed)
        rows = np.arange(max(group[:, 1].min() - reach, 0), min(group[:, 1].max() + reach, missed.shape[1]))
        within = (rows >= spans[columns, :1]) & (rows < spans[columns, 1:])
        part = np.where(within, missed[np.ix_(columns, rows)], -1)
        thick, (column, row) = largest_disc(part >= 0)
        if thick > max(most, known):
            i, j = np.nonzero(part >= 0)
            held = np.hypot(i + 0.5 - column, j + 0.5 - row) <= 0.5 * thick
            most, inside = thick, part[i[held], j[held]]
    return most, inside


@kernel(error_model="numpy")
def _squares(missed: NDArray[np.int32], spans: NDArray[np.int64], least: int) -> NDArray[np.int64]:
    """Column, row and side of squares inside what is missed that end there and have ``least`` pixels a side or more."""
    columns, rows = missed.shape
    found = np.empty((1024, 3), dtype=np.int64)
    count = 0
    before, here = np.zeros(rows + 1, dtype=np.int64), np.zeros(rows + 1, dtype=np.int64)  # of the row before
    from_row, to_row = 0, 0
    for turned in range(columns + _WRAP):
        c = turned % columns
        low, high = spans[c]
        for r in range(low, high):
            side = 0
            if missed[c, r] >= 0:
                side = 1 + min(before[r], before[r + 1], here[r])
                if side >= least:
                    if count == len(found):
                        more = np.empty((2 * count, 3), dtype=np.int64)
                        more[:count] = found
                        found = more
                    found[count] = turned, r, side
                    count += 1
            here[r + 1] = side
        before[from_row + 1 : to_row + 1] = 0
        before, here = here, before
        from_row, to_row = low, high
    return found[:count].copy()
