"""Tracks with the poses that matter: those that interpolation gives back closely enough are left out (Douglas & Peucker 1973).

What drives straight at an even speed needs two poses, however often it was recorded.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mmi.movers.movers import Movers

__all__ = ["thinned"]

_TURN = 0.5 * np.pi
"""Radians between two poses, at most: beyond a half turn the short way round would be the other way."""


def thinned(movers: Movers, *, metres: float) -> Movers:
    """The same objects with fewer poses: at the times of those left out, no point of a shape is off by more than ``metres``.

    Angles count as the arcs that the shape's farthest point describes. First and last poses stay.
    """
    kept = np.zeros(len(movers.times), dtype=bool)
    for i, (start, end) in enumerate(itertools.pairwise(movers.starts.tolist())):
        turned = np.unwrap(movers.angles[start:end], axis=0)
        rows = np.column_stack([movers.positions[start:end], turned * movers.reach[i]])
        kept[start:end] = _needed(movers.times[start:end], rows, turned, metres)
    counts = np.add.reduceat(kept, movers.starts[:-1]) if movers.ids else np.zeros(0, dtype=np.int64)
    return replace(
        movers,
        starts=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        times=movers.times[kept],
        positions=movers.positions[kept],
        angles=movers.angles[kept],
    )


def _needed(
    times: NDArray[np.float64], rows: NDArray[np.float64], turned: NDArray[np.float64], metres: float
) -> NDArray[np.bool_]:
    """(k,) which of an object's poses stay: ``rows`` (k, 6) and its unwrapped angles ``turned`` (k, 3)."""
    kept = np.zeros(len(times), dtype=bool)
    kept[[0, -1]] = True
    spans = [(0, len(times) - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        inner = slice(first + 1, last)
        share = ((times[inner] - times[first]) / (times[last] - times[first]))[:, None]
        off = np.abs(rows[inner] - (rows[first] + share * (rows[last] - rows[first])))
        wrong = np.linalg.norm(off[:, :3], axis=1) + off[:, 3:].sum(axis=1)
        split = first + 1 + int(np.argmax(wrong))
        if wrong.max() <= metres:
            if np.abs(turned[last] - turned[first]).max() <= _TURN:
                continue
            split = (first + last) // 2
        kept[split] = True
        spans += [(first, split), (split, last)]
    return kept
