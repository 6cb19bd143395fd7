"""Things that are kept group after group in one list: a group is a range of it, its first and one after its last."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["numbers_in"]


def numbers_in(firsts: NDArray[np.integer], ends: NDArray[np.integer]) -> NDArray[np.int64]:
    """All numbers of the ranges from ``firsts`` (k,) to before ``ends`` (k,), one range after the other."""
    counts = ends - firsts
    begun = np.cumsum(counts) - counts
    return np.arange(counts.sum(), dtype=np.int64) + np.repeat(firsts - begun, counts)
