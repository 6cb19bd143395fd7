"""How wrong images of boxes are now, and for how far the viewer may go: safe for every point in the boxes, not only corners.

An image is captured from a viewpoint and shown as a quadrilateral or as a surface with depth. Every point of a box, and every
point at which it may be drawn, counts; corners of a box are no bound. The papers' formulas, which look at corners, are in
:mod:`mmi.validity.papers`. Where an object moves and its image with it, ask in the object's frame
(:mod:`mmi.validity.movement`).

Boxes are (n, 2, 3): least and greatest corners, metres. Viewpoints are (3,), or (n, 3) with one for each box.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmi.foundation.errors import ParameterError
from mmi.validity.box_rays import BoxRays, box_rays, cosines_with
from mmi.validity.ray_pairs import angle_in_cone, safe_step, widest_angle

__all__ = ["Flat", "Relief", "Shown", "error_angle", "safe_distance"]

_HALVINGS = 50


@dataclass(frozen=True, slots=True, eq=False)
class Flat:
    """A quadrilateral across the line from where it was captured to the middle of the box.

    ``distance`` is its distance along that line, a number or (n,) metres; None puts it through the middle. It stays where it
    is, or ``turns`` around its own middle to face the viewer (Schaufler).
    """

    distance: float | NDArray[np.float64] | None = None
    turns: bool = False

    def __post_init__(self) -> None:
        if self.distance is not None and not np.all(np.asarray(self.distance) > 0.0):
            raise ParameterError(f"a quadrilateral stands before the viewer, found a distance of {self.distance}")


@dataclass(frozen=True, slots=True, eq=False)
class Relief:
    """A surface with depth: a mesh of an image, or a grid that a depth image displaces.

    ``residual`` (metres) and ``relative`` (a share of the distance), numbers or (n,), bound how far a point of the box lies
    from where it is drawn, along the ray; where both are given, the lesser counts. It is drawn within the depths of its box.
    What the image did not capture, as something else hid it, counts too: where nothing is known of it, leave both infinite,
    and any two points of a ray in the box may stand for each other.
    """

    residual: float | NDArray[np.float64] = math.inf
    relative: float | NDArray[np.float64] = math.inf

    def __post_init__(self) -> None:
        if not (np.all(np.asarray(self.residual) >= 0.0) and np.all(np.asarray(self.relative) >= 0.0)):
            raise ParameterError(f"residuals of depth of 0 or more expected, found {self.residual}, {self.relative}")


Shown = Flat | Relief


def error_angle(
    eye: ArrayLike,
    captured: ArrayLike,
    boxes: ArrayLike,
    shown: Shown,
    *,
    inherited: ArrayLike = 0.0,
    rays: BoxRays | None = None,
) -> NDArray[np.float64]:
    """Radians (n,) that no point of a box is seen away from its image, from ``eye``: how wrong the images are now.

    ``inherited`` (radians, a number or (n,)) is how wrong an image was from where it was captured, as it was made from
    other images: it grows as the viewer comes closer. It is pi where nothing is known, as inside a box. A caller that
    asks every frame keeps ``rays``, those of :func:`mmi.validity.box_rays.box_rays` for ``captured`` and ``boxes``: they are
    most of the work.
    """
    moved = np.asarray(eye, dtype=np.float64) - np.asarray(captured, dtype=np.float64)
    rays = box_rays(captured, boxes) if rays is None else rays
    length = np.linalg.norm(moved, axis=-1)
    low, high = cosines_with(rays.directions, rays.spread, moved)
    if isinstance(shown, Flat) and shown.turns:
        angles = _turned(rays, _across(rays, shown), *_turn(rays, _across(rays, shown), moved))
        angles = np.where(length > 0.0, angles, 0.0)
    else:
        flat = isinstance(shown, Flat)
        pairs = _flat_pairs(rays, shown) if isinstance(shown, Flat) else (_relief_pair(rays, shown),)
        scale = np.maximum(np.cos(rays.spread), 0.0) if flat else 0.0
        angles = np.max([angle_in_cone(*pair, length, low, high, scale=scale) for pair in pairs], axis=0)
    return np.minimum(angles + _grown(inherited, rays.near, length * np.maximum(high, 0.0)), math.pi)


def safe_distance(
    captured: ArrayLike, boxes: ArrayLike, shown: Shown, limit: ArrayLike, *, inherited: ArrayLike = 0.0
) -> NDArray[np.float64]:
    """Metres (n,) that the viewer may move from ``captured``, whichever way, before an error angle exceeds ``limit`` (radians).

    Infinite where the image is the box. Raises ParameterError unless limits are between 0 and a right angle.
    """
    limits = np.asarray(limit, dtype=np.float64)
    if not np.all((limits > 0.0) & (limits < 0.5 * math.pi)):
        raise ParameterError(f"a limit between 0 and 90 degrees expected, found {np.degrees(limits)}")
    rays = box_rays(captured, boxes)
    if isinstance(shown, Flat) and shown.turns:
        distance = _across(rays, shown)

        def widest(moved: NDArray[np.float64]) -> NDArray[np.float64]:
            return _turned_at_most(rays, distance, moved)
    else:
        pairs = _flat_pairs(rays, shown) if isinstance(shown, Flat) else (_relief_pair(rays, shown),)
        if not np.any(inherited):
            return np.asarray(np.min([safe_step(*pair, limits) for pair in pairs], axis=0))

        def widest(moved: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.asarray(np.max([widest_angle(*pair, moved) for pair in pairs], axis=0))

    low, high = np.zeros(len(rays.near)), np.maximum(rays.depths[:, 1], rays.far)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        kept = widest(middle) + _grown(inherited, rays.near, middle) <= limits
        low, high = np.where(kept, middle, low), np.where(kept, high, middle)
    return low


def _grown(inherited: ArrayLike, near: NDArray[np.float64], approached: NDArray[np.float64]) -> NDArray[np.float64]:
    """What an angle at ``near`` metres or more becomes at most when the viewer comes ``approached`` metres closer.

    Two points d metres away are 2 d sin(e / 2) apart, and d / (d - w) falls with d; both are then at least d - w away.
    """
    angle = np.asarray(inherited, dtype=np.float64)
    left = near - approached
    closer = np.divide(near, left, out=np.full(np.broadcast(near, left).shape, math.inf), where=left > 0.0)
    with np.errstate(invalid="ignore"):
        grown = 2.0 * np.arcsin(np.minimum(np.sin(0.5 * angle) * closer, 1.0))
    return np.where(angle > 0.0, grown, 0.0)


def _across(rays: BoxRays, shown: Flat) -> NDArray[np.float64]:
    """The depth (n,) of the quadrilaterals."""
    if shown.distance is None:
        return np.asarray(0.5 * (rays.depths[:, 0] + rays.depths[:, 1]))
    return np.broadcast_to(np.asarray(shown.distance, dtype=np.float64), rays.near.shape)


def _flat_pairs(rays: BoxRays, shown: Flat) -> tuple[tuple[NDArray[np.float64], NDArray[np.float64]], ...]:
    """Bounds of the points of a box before and behind its quadrilateral, which has one depth: so depths are the unit."""
    depth = _across(rays, shown)
    least, most = np.maximum(rays.depths[:, 0], 0.0), rays.depths[:, 1]
    return (np.minimum(least, depth), depth), (depth, np.maximum(most, depth))


def _relief_pair(rays: BoxRays, shown: Relief) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Bounds of a point and where it is drawn. The unit may be larger than a metre, so that metres count as units."""
    near = rays.near
    relative = np.asarray(shown.relative, dtype=np.float64)
    share = np.where(relative < 1.0, near / np.where(relative < 1.0, 1.0 - relative, 1.0), math.inf)
    return near, np.minimum(np.minimum(rays.far, near + shown.residual), share)


def _turn(
    rays: BoxRays, distance: NDArray[np.float64], moved: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Distances (n,) of the viewer from the quadrilaterals' middles, the sine and cosine of their turn, the same as _turned."""
    towards = rays.directions * distance[:, None] - moved
    now = np.linalg.norm(towards, axis=-1)
    safe = np.where(now > 0.0, now, 1.0)
    cosine = np.where(now > 0.0, np.sum(towards * rays.directions, axis=-1) / safe, -1.0)
    sine = np.linalg.norm(np.cross(rays.directions, towards), axis=-1) / safe
    unlike = np.maximum(np.abs(cosine) * np.abs(1.0 / distance - 1.0 / safe), np.abs(1.0 / distance - cosine / safe))
    return now, sine, cosine, unlike


def _turned_at_most(rays: BoxRays, distance: NDArray[np.float64], moved: NDArray[np.float64]) -> NDArray[np.float64]:
    """What :func:`_turned` is at most within ``moved`` metres: each term at its own worst, so that it grows with ``moved``."""
    sine = np.minimum(moved / distance, 1.0)
    cosine = np.sqrt(1.0 - sine * sine)
    closest = distance - moved
    safe = np.where(closest > 0.0, closest, 1.0)
    unlike = np.maximum(1.0 / safe - 1.0 / distance, 1.0 / distance - cosine / (distance + moved))
    return np.where(closest > 0.0, _turned(rays, distance, closest, sine, cosine, unlike), math.pi)


def _turned(
    rays: BoxRays,
    distance: NDArray[np.float64],
    now: NDArray[np.float64],
    sine: NDArray[np.float64],
    cosine: NDArray[np.float64],
    unlike: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Radians (n,) by which a turned quadrilateral is wrong at most, seen ``now`` metres from its middle.

    Let the image of a point be (x, y) on the quadrilateral at distance D, and the point k metres behind that plane: it is
    (x, y) (1 + k/D) aside. In the frame of the quadrilateral after its turn by t, at distance D', the point's picture in that
    plane is off by D' (A, B) / (D' + k cos t + x (1 + k/D) sin t), where with z = 1 + k/D

        A = x (cos t - 1) + x k cos t (1/D - 1/D') - k sin t - x^2 z sin t / D'
        B = y k (1/D - cos t / D') - x y z sin t / D'.

    ``unlike`` bounds the factors of x k and y k. As the point moves along its ray, its picture moves on a line, and a distance
    is convex on it: the ends of the range of k are worst. What is e aside at distance D' or more subtends 2 atan(e / 2 D').
    """
    aside = distance * np.tan(np.minimum(rays.spread, 1.5))
    most = np.zeros(len(distance))
    for depth in (rays.depths[:, 0], rays.depths[:, 1]):
        behind, stretch = depth - distance, depth / distance
        off = aside * (1.0 - cosine) + np.abs(behind) * (sine + aside * unlike)
        off = off + aside * aside * stretch * sine / np.where(now > 0.0, now, 1.0)
        left = now + np.minimum(behind * cosine, behind) - aside * stretch * sine
        parted = 2.0 * np.arctan(0.5 * np.divide(off, left, out=np.zeros(len(left)), where=left > 0.0))
        most = np.maximum(most, np.where(left > 0.0, parted, math.pi))
    known = (rays.depths[:, 0] > 0.0) & (rays.spread < 1.5) & (now > 0.0) & (cosine > 0.0)
    return np.where(known, most, math.pi)
