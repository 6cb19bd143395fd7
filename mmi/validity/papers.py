"""The formulas of the papers as they are printed, for comparison: what is safe is in the other modules.

Schaufler and Stuerzlinger 1996 ("A Three Dimensional Image Cache for Virtual Reality"), figures 2 and 3; Duckstein 1998
("Extension of Validity Calculation to Moving Objects"), equations (1) to (5) and figures 4 and 5. Points of n boxes are
(n, k, 3), in the papers their corners; what lies between the corners may be worse. Viewpoints are (3,), or (n, 3) with one
for each box.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmi.validity.movement import frames_left, viewpoint_step

__all__ = [
    "common_error",
    "corners",
    "move_in_angle",
    "moved_points",
    "on_quadrilateral",
    "predicted_frames",
    "safety_zone",
    "safety_zone_of_the_nearer",
    "sideways_angle",
    "turned_to_viewer",
]


def sideways_angle(near: ArrayLike, far: ArrayLike, moved: ArrayLike) -> NDArray[np.float64]:
    """alpha_trans (figure 2): the angle between two points that one point of an impostor shows, after a step to the side."""
    a, b, w = (np.asarray(one, dtype=np.float64) for one in (near, far, moved))
    return np.asarray(np.arctan2(w, a) - np.arctan2(w, b))


def move_in_angle(aside: ArrayLike, near: ArrayLike, image: ArrayLike, moved: ArrayLike) -> NDArray[np.float64]:
    """alpha_size (figure 3): between a corner of the front and its image on the impostor, after a step ahead.

    The corner is ``near`` metres ahead and ``aside`` metres from the axis, the impostor ``image`` metres ahead.
    """
    x, a, b, w = (np.asarray(one, dtype=np.float64) for one in (aside, near, image, moved))
    return np.asarray(np.abs(np.arctan2(x, a - w) - np.arctan2(x * b / a, b - w)))


def corners(boxes: ArrayLike) -> NDArray[np.float64]:
    """(n, 8, 3) corners of boxes (n, 2, 3)."""
    both = np.asarray(boxes, dtype=np.float64)
    order = [(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    return np.stack([np.stack([both[:, i, 0], both[:, j, 1], both[:, k, 2]], axis=-1) for i, j, k in order], axis=1)


def on_quadrilateral(captured: ArrayLike, points: ArrayLike, middle: ArrayLike) -> NDArray[np.float64]:
    """Projections (n, k, 3) from ``captured`` onto quadrilaterals through ``middle`` (n, 3), across the lines to there."""
    eye = np.asarray(captured, dtype=np.float64)
    line, offsets = np.asarray(middle, dtype=np.float64) - eye, _seen(eye, points)
    share = np.sum(line * line, axis=-1)[:, None] / np.einsum("nkc,nc->nk", offsets, line)
    return np.asarray(eye[..., None, :] + offsets * share[..., None])


def turned_to_viewer(eye: ArrayLike, captured: ArrayLike, shown: ArrayLike, middle: ArrayLike) -> NDArray[np.float64]:
    """The same points of quadrilaterals that turned around ``middle`` (n, 3) from ``captured`` towards ``eye``."""
    centre = np.asarray(middle, dtype=np.float64)
    before, after = (centre - np.asarray(one, dtype=np.float64) for one in (captured, eye))
    before = before / np.linalg.norm(before, axis=-1, keepdims=True)
    after = after / np.linalg.norm(after, axis=-1, keepdims=True)
    offsets = np.asarray(shown, dtype=np.float64) - centre[:, None]
    axis = np.cross(before, after)[:, None]
    cosine = np.sum(before * after, axis=-1)[:, None, None]
    along = np.sum(axis * offsets, axis=-1, keepdims=True) / (1.0 + cosine)
    return np.asarray(offsets * cosine + np.cross(axis, offsets) + axis * along + centre[:, None])


def moved_points(moved: ArrayLike, points: ArrayLike) -> NDArray[np.float64]:
    """Points (n, k, 3) of objects that were ``moved`` (n, 4, 4): alone (figure 4), or their projections as well (figure 5)."""
    matrix, before = np.asarray(moved, dtype=np.float64), np.asarray(points, dtype=np.float64)
    return np.asarray(np.einsum("nij,nkj->nki", matrix[:, :3, :3], before) + matrix[:, None, :3, 3])


def common_error(eye: ArrayLike, points: ArrayLike, shown: ArrayLike) -> NDArray[np.float64]:
    """The common calculation (1): the largest angle (n,) between points and their projections from ``eye``.

    As an arc tangent: the arc cosine that is printed has no digits left below 1e-8 radians.
    """
    a, b = _seen(eye, points), _seen(eye, shown)
    parted = np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1))
    return np.asarray(np.max(parted, axis=-1))


def safety_zone(eye: ArrayLike, points: ArrayLike, shown: ArrayLike, limit: float) -> NDArray[np.float64]:
    """The predictive calculation (2), (3) with h = |VP - a| as printed: metres (n,), too many where projections are nearer."""
    a, b = _seen(eye, points), _seen(eye, shown)
    return _zone(np.linalg.norm(a, axis=-1), np.linalg.norm(a - b, axis=-1), limit)


def safety_zone_of_the_nearer(eye: ArrayLike, points: ArrayLike, shown: ArrayLike, limit: float) -> NDArray[np.float64]:
    """Equations (2) and (3) with h the distance to the nearer of a point and its projection: right for these points."""
    a, b = _seen(eye, points), _seen(eye, shown)
    nearer = np.minimum(np.linalg.norm(a, axis=-1), np.linalg.norm(b, axis=-1))
    return _zone(nearer, np.linalg.norm(a - b, axis=-1), limit)


def predicted_frames(zone: ArrayLike, moved: ArrayLike, eye: ArrayLike, step: ArrayLike) -> NDArray[np.int64]:
    """Equation (5): whole frames (n,) if all steps of the relative viewpoint are like the first; (4) where nothing moves."""
    return frames_left(zone, viewpoint_step(moved, eye, step, 1))


def _seen(eye: ArrayLike, points: ArrayLike) -> NDArray[np.float64]:
    """Points from the viewpoint."""
    return np.asarray(np.asarray(points, dtype=np.float64) - np.asarray(eye, dtype=np.float64)[..., None, :])


def _zone(h: NDArray[np.float64], parted: NDArray[np.float64], limit: float) -> NDArray[np.float64]:
    """sqrt(h^2 + r^2 + 2 h r sin e) - r as q / (sqrt(q + r^2) + r) with q = h^2 + 2 h r sin e, which loses no digits."""
    sine = math.sin(limit)
    r = parted / (2.0 * sine)
    q = h * h + h * parted
    zone = np.where(parted > 1e-12 * h, q / (np.sqrt(q + r * r) + r), math.inf)
    return np.asarray(np.min(zone, axis=-1))
