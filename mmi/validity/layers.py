"""How wrong the image of a layer of many boxes is, cheap enough to ask for every layer in every frame.

An image of several boxes is wrong where a point is drawn at the depth of another on its ray, or would be seen where another
hid it: two points of one box, or of two boxes that share rays. What does not depend on the viewer is worked out once for each
capture (:func:`layer_parallax`); :func:`layer_errors` and :func:`layer_distances` then look at few pairs each.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmi.foundation.kernels import kernel
from mmi.validity.box_rays import disparity, extents, offsets, pick, spread_of
from mmi.validity.ray_pairs import ROUNDING, safe_step

__all__ = ["LayerParallax", "layer_distances", "layer_errors", "layer_parallax"]

_NOTHING = 1e-12
"""Boxes that are at least this far apart (radians) share no ray."""


@dataclass(frozen=True, slots=True, eq=False)
class LayerParallax:
    """Pairs of points (m) that share rays in an image from ``captured`` (3,), in the order of decreasing 1/near - 1/far.

    Their rays are within ``spread`` radians of ``directions`` (m, 3); they are at least ``near`` and at most ``far`` away, in a
    unit of a metre or more. ``nearest`` is the least of ``near`` in the order so far: of a pair and all behind it.
    """

    captured: NDArray[np.float64]
    directions: NDArray[np.float64]
    spread: NDArray[np.float64]
    near: NDArray[np.float64]
    far: NDArray[np.float64]
    nearest: NDArray[np.float64]


def layer_parallax(captured: ArrayLike, boxes: ArrayLike, *, widened: float = 0.0) -> LayerParallax:
    """The pairs of an image of ``boxes`` (k, 2, 3), k least and greatest corners, taken from ``captured`` (3,).

    Every box counts with itself, and with each box whose extents in azimuth and elevation meet its own. With ``widened``
    (radians) points whose rays are that far apart count as if they shared one, at the distances that they have: a quad of a
    grid draws what its corners have between them.
    """
    eye = np.asarray(captured, dtype=np.float64)
    low, high = offsets(eye, boxes)
    middle = 0.5 * (low + high)
    length = np.linalg.norm(middle, axis=-1)
    directions = np.divide(middle, length[:, None], out=np.zeros_like(middle), where=length[:, None] > 0.0)
    spread = np.minimum(spread_of(low, high, directions) + widened, math.pi)
    found = extents(low, high, widened)
    own = np.minimum(found.far, found.near + found.chord)
    near, far = pick(np.argmin(disparity(found.near, own), axis=0), found.near, own)
    one, other = _sharing(low, high, widened)
    if len(one):
        near_one, far_other = _nearer_and_farther(found.near, found.far, one, other)
        near_other, far_one = _nearer_and_farther(found.near, found.far, other, one)
        narrow = np.where(spread[one] <= spread[other], one, other)
        near, far = np.concatenate((near, near_one, near_other)), np.concatenate((far, far_other, far_one))
        directions = np.concatenate((directions, directions[narrow], directions[narrow]))
        spread = np.concatenate((spread, spread[narrow], spread[narrow]))
    order = np.argsort(-disparity(near, far), kind="stable")
    order = order[far[order] > near[order]]
    near, far = near[order], far[order]
    nearest = np.minimum.accumulate(near[::-1])[::-1]
    values = (eye, directions[order], spread[order], near, far, nearest)
    for value in values:
        value.setflags(write=False)
    return LayerParallax(*values)


def layer_errors(layers: Sequence[LayerParallax], eye: ArrayLike) -> NDArray[np.float64]:
    """Radians (len(layers),) that no point is seen away from its image from ``eye`` (3,): 0 for a layer without pairs."""
    viewer = np.asarray(eye, dtype=np.float64)
    return np.array([_largest(viewer - one.captured, *_columns(one)) for one in layers], dtype=np.float64)


def layer_distances(layers: Sequence[LayerParallax], limit: float) -> NDArray[np.float64]:
    """Metres (len(layers),) that the viewer may move from where each was captured, for errors of ``limit`` radians at most."""
    return np.array([np.min(safe_step(one.near, one.far, limit), initial=math.inf) for one in layers], dtype=np.float64)


def _columns(layer: LayerParallax) -> tuple[NDArray[np.float64], ...]:
    return layer.directions, layer.spread, layer.near, layer.far, layer.nearest


def _nearer_and_farther(
    near: NDArray[np.float64], far: NDArray[np.float64], one: NDArray[np.int64], other: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Bounds (p,) of points of ``one`` and of ``other`` boxes on a ray, the first nearer, in the unit where they part least."""
    nears, fars = near[:, one], far[:, other]
    return pick(np.argmin(disparity(nears, fars), axis=0), nears, fars)  # type: ignore[return-value]


def _sharing(
    low: NDArray[np.float64], high: NDArray[np.float64], widened: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs (p,) of boxes that may share a ray, as their extents in azimuth and in elevation meet."""
    nearest = np.maximum(np.maximum(low, -high), 0.0)[:, :2]
    close = np.hypot(nearest[:, 0], nearest[:, 1])
    away = np.hypot(*np.maximum(np.abs(low), np.abs(high))[:, :2].T)
    top = np.arctan2(high[:, 2], np.where(high[:, 2] > 0.0, close, away)) + 0.5 * widened
    bottom = np.arctan2(low[:, 2], np.where(low[:, 2] < 0.0, close, away)) - 0.5 * widened
    middle = np.arctan2(low[:, 1] + high[:, 1], low[:, 0] + high[:, 0])
    half = np.zeros(len(low))
    for x in (low[:, 0], high[:, 0]):
        for y in (low[:, 1], high[:, 1]):
            half = np.maximum(half, np.abs(_wrapped(np.arctan2(y, x) - middle)))
    steepest = np.cos(np.minimum(np.maximum(np.abs(top), np.abs(bottom)), 0.5 * math.pi))
    turn = np.arcsin(np.minimum(math.sin(0.5 * min(widened, math.pi)) / np.maximum(steepest, 1e-300), 1.0))
    half = np.where((close > 0.0) & (half + turn < 0.5 * math.pi), half + turn, math.pi)
    one, other = np.triu_indices(len(low), 1)
    meet = np.abs(_wrapped(middle[one] - middle[other])) <= half[one] + half[other] + _NOTHING
    meet &= (bottom[one] <= top[other] + _NOTHING) & (bottom[other] <= top[one] + _NOTHING)
    return one[meet], other[meet]


def _wrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same angles in [-pi, pi)."""
    return np.asarray((angle + math.pi) % (2.0 * math.pi) - math.pi)


@kernel(error_model="numpy")
def _largest(
    moved: NDArray[np.float64],
    directions: NDArray[np.float64],
    spread: NDArray[np.float64],
    near: NDArray[np.float64],
    far: NDArray[np.float64],
    nearest: NDArray[np.float64],
) -> float:
    """The largest of :func:`mmi.validity.ray_pairs.angle_in_cone` over the pairs of a layer.

    A pair's angle is at most that whose sine is w (b - a) / (a b - w^2) <= w (1/a - 1/b) / (1 - (w / nearest)^2): once what
    was found is more, nothing behind it matters.
    """
    way = math.sqrt(moved[0] ** 2 + moved[1] ** 2 + moved[2] ** 2)
    if way == 0.0:
        return 0.0
    most, sine = 0.0, 0.0
    for i in range(len(near)):
        a, b = near[i], far[i]
        if a <= 0.0:
            return math.pi
        if way < nearest[i] and way * (1.0 / a - 1.0 / b) <= sine * (1.0 - (way / nearest[i]) ** 2):
            break
        cosine = (directions[i, 0] * moved[0] + directions[i, 1] * moved[1] + directions[i, 2] * moved[2]) / way
        angle = math.acos(min(max(cosine, -1.0), 1.0))
        least, highest = math.cos(min(angle + spread[i], math.pi)), math.cos(max(angle - spread[i], 0.0))
        w = min(way, math.sqrt(a * b))
        c = min(max(w * (a + b) / (a * b + w * w), least), highest)
        if w >= a * (1.0 - ROUNDING) and c >= 1.0 - ROUNDING:
            return math.pi
        side = w * math.sqrt(max(1.0 - c * c, 0.0))
        parted = math.atan2(side * (b - a), (a - w * c) * (b - w * c) + side * side)
        if parted > most:
            most, sine = parted, math.sin(min(parted, 0.5 * math.pi))
    return most
