"""What a view can show of things whose extent is known: conservative culling, vectorised over all of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View

__all__ = ["box_corners", "boxes_within_view", "spheres_within_view", "window_corners", "within_view"]

_ROUNDING = 1e-9
"""Metres."""


def within_view(corners: NDArray[np.float64], view: View) -> NDArray[np.bool_]:
    """(n,) which of n convex hulls, (n, k, 3) world points each, may show in ``view``.

    False only where all points of a hull lie beyond one side of the view's pyramid, so nothing visible is ever left out;
    hulls across a corner of the pyramid may be kept in vain (Assarsson & Moeller 2000, section 2).
    """
    if not len(corners):
        return np.zeros(0, dtype=bool)
    eye = corners @ view.eye_from_world[:3, :3].T + view.eye_from_world[:3, 3]
    inside = eye @ _sides(view).T >= 0.0  # (n, k, sides)
    return np.asarray(np.all(np.any(inside, axis=1), axis=1))


def boxes_within_view(boxes: NDArray[np.float64], view: View) -> NDArray[np.bool_]:
    """(n,) which axis-aligned ``boxes`` (n, 2, 3) may show in ``view``: as :func:`within_view` of their corners says, but for
    rounding, at a tenth of its cost.

    Of a box, the corner farthest in a side's direction decides (Assarsson & Moeller 2000, section 2).
    """
    sides = _sides(view)
    inwards = sides @ view.eye_from_world[:3, :3]  # (sides, 3), in the world's frame
    middle, half = 0.5 * (boxes[:, 0] + boxes[:, 1]) - view.eye, 0.5 * (boxes[:, 1] - boxes[:, 0])
    return np.asarray(np.all(middle @ inwards.T + half @ np.abs(inwards).T >= 0.0, axis=1))


def spheres_within_view(centres: NDArray[np.float64], radii: NDArray[np.float64], view: View) -> NDArray[np.bool_]:
    """(n,) which spheres around ``centres`` (n, 3) with ``radii`` (n,), metres, may show in ``view``; cheaper than hulls.

    False only where a sphere lies beyond one side of the view's pyramid.
    """
    sides = _sides(view)
    eye = centres @ view.eye_from_world[:3, :3].T + view.eye_from_world[:3, 3]
    beyond = -(eye @ (sides / np.linalg.norm(sides, axis=1, keepdims=True)).T)  # metres
    return np.asarray(np.all(beyond <= radii[:, None] + _ROUNDING, axis=1))


def _sides(view: View) -> NDArray[np.float64]:
    """(5, 3): a point of the eye's frame, where z is negative ahead, is inside where its product with none is negative."""
    left, top, width, height = view.window
    f = view.focal
    return np.array(
        [[f, 0.0, left], [-f, 0.0, -(left + width)], [0.0, -f, top], [0.0, f, -(top + height)], [0.0, 0.0, -1.0]]
    )


def box_corners(low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 8, 3) corners of the axis-aligned boxes between ``low`` and ``high``, (n, 3) each."""
    pick = np.array([[(k >> axis) & 1 for axis in range(3)] for k in range(8)], dtype=bool)
    return np.where(pick, high[:, None, :], low[:, None, :])


def window_corners(view: View, nearest: float, farthest: float) -> NDArray[np.float64]:
    """(8, 3) corners of what lies behind the view's window at depths from ``nearest`` to ``farthest``, metres."""
    left, top, width, height = view.window
    u = np.array([left, left + width, left, left + width] * 2, dtype=np.float64)
    v = np.array([top, top, top + height, top + height] * 2, dtype=np.float64)
    return view.unproject(u, v, np.repeat([nearest, farthest], 4))
