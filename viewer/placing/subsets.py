"""Which cells in view are best replaced by one image: the search of section 3.3.2.

A subset is all cells that lie within a window of the screen and beyond a depth: five borders, each at one of the places where
cells end (section 3.3.2.2; the sixth, the far one, never moves). Borders move inwards, halfway through the places that the
subset has on that side, to whatever the cost-benefit function of section 3.3.2.1 makes best a few steps on, as long as the
subset removes enough (section 3.3.2.3). Where no border can move so far, they try half as far, and so on to the next place:
the search ends with a subset none of whose borders can move.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.kernels import kernel
from viewer.placing.rules import PlacingRules

__all__ = ["best_subset"]


def best_subset(
    extents: NDArray[np.float64],
    distances: NDArray[np.float64],
    counts: NDArray[np.int64],
    *,
    enough: int,
    seen: int,
    size: tuple[float, float],
    farthest: float,
    rules: PlacingRules,
) -> NDArray[np.bool_]:
    """(k,) which of k cells to replace, so that at least ``enough`` triangles are removed; all where they are no more.

    ``extents`` (k, 4) are the cells' lowest and highest coordinates on the screen, across and up, of which ``size`` is width
    and height in the same unit; ``distances`` (k,) those of their nearest points, ``counts`` (k,) their triangles. ``seen``
    are all triangles in view (G_c), and ``farthest`` is the longest side of the model (A).
    """
    signs = np.array([1.0, -1.0, 1.0, -1.0])
    borders = np.concatenate([extents[:, [0, 1, 2, 3]] * signs, distances[:, None]], axis=1)
    # Near, top, bottom, right, left: in this order of preference, and each such that moving inwards is upwards.
    borders = borders[:, [4, 3, 2, 1, 0]]
    ranks = np.stack([np.unique(one, return_inverse=True)[1].ravel() for one in borders.T], axis=1).astype(np.int32)
    weights = np.array([rules.cost, rules.benefit, rules.small, rules.far, max(size), farthest, float(seen)])
    return np.asarray(
        _search(ranks, np.ascontiguousarray(extents), distances, counts, enough, weights, rules.look_ahead)
    )


@kernel(error_model="numpy", nogil=True)
def _search(
    ranks: NDArray[np.int32],
    extents: NDArray[np.float64],
    distances: NDArray[np.float64],
    counts: NDArray[np.int64],
    enough: int,
    weights: NDArray[np.float64],
    look_ahead: int,
) -> NDArray[np.bool_]:
    """The search; ``ranks`` (k, 5) number the places of each border from the outside, so that a subset is all cells whose
    ranks are at least those of its borders (5,).
    """
    some = np.arange(len(ranks))
    share = 2
    while True:
        best, chosen, smallest = -np.inf, some, True
        for side in range(5):
            inner, places = _moved(ranks, some, side, share)
            smallest &= share >= places
            if len(inner) == len(some) or counts[inner].sum() < enough:
                continue
            value = _value(ranks, extents, distances, counts, inner, enough, weights, share, look_ahead)
            if value > best:
                best, chosen = value, inner
        if best > -np.inf:
            some = chosen
        elif smallest:
            break
        else:
            share *= 2
    mask = np.zeros(len(ranks), dtype=np.bool_)
    mask[some] = True
    return mask


@kernel(error_model="numpy", nogil=True)
def _moved(ranks: NDArray[np.int32], some: NDArray[np.int64], side: int, share: int) -> tuple[NDArray[np.int64], int]:
    """What is left of a subset whose border moves in by a ``share``-th of its places there, at least one; and their number."""
    lowest, highest = ranks[some[0], side], ranks[some[0], side]
    for n in some:
        lowest, highest = min(lowest, ranks[n, side]), max(highest, ranks[n, side])
    present = np.zeros(highest - lowest + 1, dtype=np.bool_)
    for n in some:
        present[ranks[n, side] - lowest] = True
    places = 0
    for one in present:
        places += one
    if places == 1:
        return some, 1
    skipped, border = max(places // share, 1), lowest
    for n in range(len(present)):
        if present[n]:
            if skipped == 0:
                border = lowest + n
                break
            skipped -= 1
    kept = np.empty(len(some), dtype=np.int64)
    found = 0
    for n in some:
        if ranks[n, side] >= border:
            kept[found] = n
            found += 1
    return kept[:found], places


@kernel(error_model="numpy", nogil=True)
def _value(
    ranks: NDArray[np.int32],
    extents: NDArray[np.float64],
    distances: NDArray[np.float64],
    counts: NDArray[np.int64],
    some: NDArray[np.int64],
    enough: int,
    weights: NDArray[np.float64],
    share: int,
    deeper: int,
) -> float:
    """The greatest value of the cost-benefit function for a subset that removes enough, and for those that it can become."""
    best = _cost_benefit(extents, distances, counts, some, weights)
    if deeper > 0:
        for side in range(5):
            inner, _ = _moved(ranks, some, side, share)
            if len(inner) < len(some) and counts[inner].sum() >= enough:
                value = _value(ranks, extents, distances, counts, inner, enough, weights, share, deeper - 1)
                best = max(best, value)
    return best


@kernel(error_model="numpy", nogil=True)
def _cost_benefit(
    extents: NDArray[np.float64],
    distances: NDArray[np.float64],
    counts: NDArray[np.int64],
    some: NDArray[np.int64],
    weights: NDArray[np.float64],
) -> float:
    """CB of section 3.3.2.1; ``weights`` are C, B, B1, B2, max(S_w, S_h), A and G_c."""
    left, right, bottom, top, nearest, removed = np.inf, -np.inf, np.inf, -np.inf, np.inf, 0
    for n in some:
        left, right = min(left, extents[n, 0]), max(right, extents[n, 1])
        bottom, top = min(bottom, extents[n, 2]), max(top, extents[n, 3])
        nearest = min(nearest, distances[n])
        removed += counts[n]
    cost = (weights[6] - removed) / weights[6]
    benefit = weights[2] * (1.0 - max(right - left, top - bottom) / weights[4]) + weights[3] * nearest / weights[5]
    return float(weights[0] * (1.0 - cost) + weights[1] * benefit)
