"""From where an image's construction pictures are taken (section 4.1, figure 11).

The first is the image's own view, from its grid point. Four are from half way to the middles of the edges of the quadrilateral
that the image replaces, but within the radius that the image serves; four more from as far behind the grid point. They look
the way the image does. Here an eye that is shown the image is always within the pyramid ahead of the grid point, so that
``ahead`` puts the last four there as well: towards the quadrilateral's corners, as far ahead as the radius lets them.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View

__all__ = ["COUNTS", "Arrangement", "construction_views", "window_around"]

Arrangement = Literal["figure 11", "ahead"]
"""Where the last four of nine viewpoints are: behind the grid point as in the paper, or where eyes are."""
COUNTS = (1, 5, 9)
_WIDEST = 2.0
"""The tangent of the angle with the axis to which pictures reach at most: no eye sees farther aside what the image shows."""
_NEAREST = 1e-3


def construction_views(
    view: View,
    quad_depth: float,
    radius: float,
    count: int,
    corners: NDArray[np.float64],
    *,
    arrangement: Arrangement = "figure 11",
) -> tuple[View, ...]:
    """``count`` (1, 5 or 9) views for an image in ``view``: its own first, then those of the eyes nearest to the quadrilateral.

    The quadrilateral is the view's window at ``quad_depth`` metres along its axis; ``radius``, metres, is how far eyes may be
    from the grid point. ``corners`` (k, 3), world, are those of what is captured: each window but the first covers all of them,
    up to a tangent of 2 to each side. Raises ValueError for another ``count``.
    """
    if count not in COUNTS:
        raise ValueError(f"1, 5 or 9 pictures expected, found {count}")
    left, top, width, height = view.window
    u, v = left + 0.5 * width, top + 0.5 * height
    sides = np.array([[left, v], [left + width, v], [u, top], [u, top + height]])
    ways = _towards(view, sides, quad_depth)
    lengths = np.minimum(0.5 * quad_depth * np.linalg.norm(ways, axis=1), radius)
    shifts = ways / np.linalg.norm(ways, axis=1)[:, None] * lengths[:, None]
    if arrangement == "figure 11":
        rest = -shifts
    else:
        ends = np.array([[left, top], [left + width, top], [left, top + height], [left + width, top + height]])
        ways = _towards(view, ends, quad_depth)
        rest = ways / np.linalg.norm(ways, axis=1)[:, None] * min(radius, 0.9 * quad_depth)
    return (view, *(_seen_from(view, view.eye + shift, corners) for shift in [*shifts, *rest][: count - 1]))


def window_around(view: View, corners: NDArray[np.float64]) -> tuple[int, int, int, int]:
    """The least window of a view's image plane that shows ``corners`` (k, 3), world, up to a tangent of 2 to each side."""
    eye = corners @ view.eye_from_world[:3, :3].T + view.eye_from_world[:3, 3]
    ahead = np.maximum(-eye[:, 2], _NEAREST)
    tangents = np.clip(eye[:, :2] / ahead[:, None], -_WIDEST, _WIDEST) * view.focal
    left, right = math.floor(tangents[:, 0].min()), math.ceil(tangents[:, 0].max())
    top, bottom = math.floor(-tangents[:, 1].max()), math.ceil(-tangents[:, 1].min())
    return left, top, max(right - left, 1), max(bottom - top, 1)


def _towards(view: View, places: NDArray[np.float64], depth: float) -> NDArray[np.float64]:
    """(n, 3) world: from the eye to where the picture has ``places`` (n, 2), as long as they are deep at a depth of 1."""
    return view.unproject(places[:, 0], places[:, 1], np.full(len(places), depth)) / depth - view.eye / depth


def _seen_from(view: View, eye: NDArray[np.float64], corners: NDArray[np.float64]) -> View:
    matrix = np.array(view.eye_from_world)
    matrix[:3, 3] = -matrix[:3, :3] @ eye
    moved = View(matrix, view.focal, view.window)
    return moved.cropped(window_around(moved, corners))
