"""The angle that two points of one capture ray subtend from elsewhere: what every image is wrong by, in closed form.

An image shows a point P at another point of the same ray from where it was captured. Let the two be ``near`` = a and ``far`` =
b metres away on a ray u, and the viewer w metres away from there, in a direction at the angle f to u. The directions to the
points make angles of atan2(w sin f, a - w cos f) and the same with b with the ray, and point to the same side of it. So the
points subtend the difference of the two, which grows when a falls or b grows, and whose tangent is

    w sin f (b - a) / (a b - (a + b) w cos f + w^2).                                                    (*)

All arguments are arrays that broadcast; distances are metres, angles radians.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["ROUNDING", "angle_between", "angle_in_cone", "safe_step", "widest_angle"]

ROUNDING = 1e-12
"""Relative: a viewer this close to a ray counts as on it."""


def angle_between(near: ArrayLike, far: ArrayLike, moved: ArrayLike, cosine: ArrayLike) -> NDArray[np.float64]:
    """The angle between two points of a ray from ``moved`` metres away, where ``cosine`` is that of ray and movement: (*)."""
    a, b, w, c = (np.asarray(one, dtype=np.float64) for one in (near, far, moved, cosine))
    side = w * np.sqrt(np.maximum(1.0 - c * c, 0.0))
    return np.asarray(np.arctan2(side * (b - a), (a - w * c) * (b - w * c) + side * side))


def angle_in_cone(
    near: ArrayLike,
    far: ArrayLike,
    moved: ArrayLike,
    least_cosine: ArrayLike,
    most_cosine: ArrayLike,
    *,
    scale: ArrayLike = 0.0,
) -> NDArray[np.float64]:
    """What no pair of points parts by on rays whose cosines with the movement lie in a range.

    The points are at least ``near`` and at most ``far`` metres away, in the same unit on each ray, and that unit is between a
    metre and 1 / ``scale`` metres: depths along an axis do, where distances are depths divided by the cosine of ray and axis.

    The derivative of (*) by f has the sign of cos f (a b + w^2) - (a + b) w, so that (*) rises up to one angle and falls
    behind it. Its derivative by w has the sign of a b - w^2. A unit of k metres leaves (*) as it is if w is divided by k, so
    the worst is at the w' in [scale w, w] that is closest to sqrt(a b), whatever the angle, and there at the clamped angle.
    """
    a, b = np.asarray(near, dtype=np.float64), np.asarray(far, dtype=np.float64)
    product = a * b
    way = np.asarray(moved, dtype=np.float64)
    w = np.clip(np.sqrt(product), np.asarray(scale) * way, way)
    sums = product + w * w
    worst = np.divide(w * (a + b), sums, out=np.ones(np.broadcast(w, sums).shape), where=sums > 0.0)
    cosine = np.clip(worst, least_cosine, most_cosine)
    between = (w >= a * (1.0 - ROUNDING)) & (cosine >= 1.0 - ROUNDING) & (b > a) & (way > 0.0)
    return np.where(between, math.pi, angle_between(a, b, w, cosine))


def widest_angle(near: ArrayLike, far: ArrayLike, moved: ArrayLike) -> NDArray[np.float64]:
    """The largest angle between two points of a ray from anywhere within ``moved`` metres: sin e = w (b - a) / (a b - w^2).

    It is (*) at its extreme cos f = w (a + b) / (a b + w^2), where sin f = sqrt((a^2 - w^2) (b^2 - w^2)) / (a b + w^2). Where
    ``moved`` is ``near`` or more, the viewer may stand on the ray between the points: pi.
    """
    a, b, w = (np.asarray(one, dtype=np.float64) for one in (near, far, moved))
    below, above = np.broadcast_arrays(w * (b - a), a * b - w * w)
    sine = np.divide(below, above, out=np.ones(below.shape), where=above > 0.0)
    parted = np.where(w >= a, math.pi, np.arcsin(np.minimum(sine, 1.0)))
    return np.where((b <= a) | (w <= 0.0), 0.0, parted)


def safe_step(near: ArrayLike, far: ArrayLike, limit: ArrayLike) -> NDArray[np.float64]:
    """Metres within which the viewer may go anywhere before two points of a ray part by ``limit`` (below a right angle).

    :func:`widest_angle` solved for w, which is Duckstein's equation (3): q = h^2 + 2 h r sin e is a b, and r is
    (b - a) / (2 sin e). Infinite where the points are one.
    """
    a, b, sine = (np.asarray(one, dtype=np.float64) for one in (near, far, np.sin(limit)))
    endless = np.isinf(b)
    b = np.where(endless, a, b)
    product, parted = a * b, np.maximum(b - a, 0.0)
    below = parted + np.sqrt(parted * parted + 4.0 * sine * sine * product)
    top, below = np.broadcast_arrays(2.0 * sine * product, below)
    step = np.divide(top, below, out=np.zeros(top.shape), where=below > 0.0)
    return np.where(endless, sine * a, np.where(parted > 0.0, step, math.inf))
