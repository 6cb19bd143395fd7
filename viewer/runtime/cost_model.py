"""What drawing takes on this machine: a first estimate from frames that are known, then refined by every frame.

    model = CostModel(calibrated(painter, scene))       once, in less than a second (viewer.runtime.calibration)
    model = model.after(done, planning=seconds)         after each frame; model.costs is what the next plan is told

A model is a value and its refinement is arithmetic, so that tests replay it without OpenGL. Predictions are meant to be rather
too long than too short, because budgets are to hold: about four frames of five take no longer than was predicted, and three
requests of four.

A frame is predicted as the sum of what its parts cost. When it took longer, every cost grows by a factor, the more so the
larger its share of the prediction is (exponentiated gradient; Kivinen & Warmuth 1997), so that costs stay positive, and frames
that differ tell the costs apart. What a frame and a request cost as such follow at once, since they stand for what the counts
do not tell, how much of the view is covered for instance; what a triangle costs follows slowly. Costs grow faster than they
shrink, and where the two are in balance is the wanted quantile, nearly. A surprise counts for no more than ``_LARGEST``, so
that a frame that another program disturbs changes the prediction by an eighth.

Requests that fill a frame to the brim make it late whenever it takes a little longer than predicted. So there is a margin on
all costs, which a late frame widens and all others narrow a little, until hardly any frame is late because of its requests:
narrow where frames take what they always take, wide on a machine that is busy with other things.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import nnls

from viewer.plan import Costs, Done, Work

__all__ = ["LATE", "CostModel", "fitted"]

_GROWTH, _SHRINKAGE = 0.3, (0.08, 0.04)
"""The share of a surprise, the logarithm of taken : predicted, by which the prediction of the same work changes: where it took
longer; and where it took less, requests and frames. Requests are short, and some of them wait for a processor ten times as long
as they work: predicted to take what four of five take, hardly any would fit. The margin sees to it that frames are not late."""
_LARGEST = math.log(1.5)
"""Surprises are at most this large, up or down."""
_AGILITY = Costs(frame=1.0, draw=0.4, triangle=0.4, request=1.0, pixel=0.4, relief=0.4, captured=0.4)
"""How much each of the costs moves, next to the others."""
_FARTHEST = 2.0
"""A cost moves at most this many times as far as the prediction is to move, as a logarithm."""
_LEAST = 1e-3
"""Costs are at least this share of the default ones: a cost of nothing could never grow."""
_PRIOR = 0.05
"""Weight of what is expected of a cost before anything was drawn, next to the weight of 1 that an example has."""
_FLOOR = 0.05
"""Costs that are fitted are at least this share of what is expected of them."""
LATE = 1.1
"""A frame is late when it takes this many times what it should."""
_LATE_SHARE = 0.005
"""Of all frames, so many may be late because of their requests."""
_WIDENING = 0.15
"""What a frame that is late adds to the margin. Every other one takes so much off that the two are in balance at that share."""
_WIDEST = 3.0
_SHORTEST = 1e-6
"""Seconds; nothing real draws in less."""


@dataclass(frozen=True, slots=True)
class CostModel:
    """What things cost, refined by what frames took; all of it ``margin`` times as much as was found."""

    costs: Costs = field(default_factory=Costs)
    margin: float = 1.0

    def after(
        self, done: Done, *, planning: float = 0.0, target: float = math.inf, updates: float = math.inf
    ) -> CostModel:
        """The model after a frame whose plan was made in ``planning`` seconds. What was not timed teaches nothing.

        The frame should have taken ``target`` seconds, ``updates`` of them for its requests. Where it is late, and would not
        have been without them, the margin grows.
        """
        found = _scaled(self.costs, 1.0 / self.margin)
        if done.draws.seconds > _SHORTEST:
            found = _refined(found, _counted(done.draws, frames=1), done.draws.seconds + planning)
        if done.requests.seconds > _SHORTEST:
            found = _refined(found, _counted(done.requests, frames=0), done.requests.seconds)
        without = done.draws.seconds + planning
        late = without <= LATE * min(target, without + updates) < without + done.requests.seconds
        margin = self.margin + (_WIDENING if late else -_WIDENING * _LATE_SHARE)
        margin = min(max(margin, 1.0), _WIDEST)
        return CostModel(_scaled(found, margin), margin)


def fitted(frames: Sequence[Work], requests: Sequence[Work]) -> Costs:
    """The costs that best explain what ``frames`` took, requests aside, and ``requests``: least squares of relative errors.

    What the examples do not tell apart, or do not have, costs what it does by default on a machine that is as fast as they say:
    costs are drawn there with a weight of ``_PRIOR``. None is below ``_FLOOR`` of that.
    """
    works = [(work, 1) for work in frames] + [(work, 0) for work in requests]
    works = [(work, number) for work, number in works if work.seconds > _SHORTEST]
    if not works:
        return Costs()
    counts = np.array([_counted(work, frames=number) for work, number in works], dtype=np.float64)
    seconds = np.array([work.seconds for work, _ in works])
    default = np.array(Costs())
    expected = counts @ default
    default *= np.exp(np.median(np.log(seconds[expected > 0.0] / expected[expected > 0.0]))) if expected.any() else 1.0
    shares = np.vstack([counts * default / seconds[:, None], _PRIOR * np.eye(len(default))])
    found, _ = nnls(shares, np.concatenate([np.ones(len(works)), np.full(len(default), _PRIOR)]))
    return Costs(*(np.maximum(found, _FLOOR) * default).tolist())


def _scaled(costs: Costs, factor: float) -> Costs:
    return costs if factor == 1.0 else Costs(*(factor * cost for cost in costs))


def _counted(work: Work, *, frames: int) -> tuple[int, ...]:
    """How often each of the costs was paid, in their order: for ``frames`` frames, or where there are none for requests."""
    triangles, captured = (work.triangles, 0) if frames else (0, work.triangles)
    return frames, work.draws, triangles, work.requests, work.pixels, work.relief, captured


def _refined(costs: Costs, counts: tuple[int, ...], seconds: float) -> Costs:
    """The costs after what has ``counts`` took so long. (Plain Python: with so few numbers it is faster than arrays.)"""
    parts = [cost * count for cost, count in zip(costs, counts, strict=True)]
    predicted = sum(parts)
    if predicted <= 0.0:
        return costs
    surprise = min(max(math.log(seconds / predicted), -_LARGEST), _LARGEST)
    step = surprise * (_GROWTH if surprise > 0.0 else _SHRINKAGE[counts[0]])
    shares = [part / predicted for part in parts]
    moves = [agility * share for agility, share in zip(_AGILITY, shares, strict=True)]
    whole = sum(move * share for move, share in zip(moves, shares, strict=True))
    factors = [math.exp(step * min(move / whole, _FARTHEST)) for move in moves]
    least = [_LEAST * cost for cost in Costs()]
    return Costs(*(max(cost * factor, low) for cost, factor, low in zip(costs, factors, least, strict=True)))
