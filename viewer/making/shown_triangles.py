"""Triangles that a picture may show: what falls between the middles of pixels, or is hidden, need not be drawn.

OpenGL finds that out as well, but takes several times as long, and of a detailed model seen from afar nearly all triangles are
such. So all of them are painted into a picture of depths, as far as they surely cover the middles of pixels; then those that
may cover a middle, and may be as near as what is there, are told from the others. What OpenGL shows does not change: middles
within a margin of a border count as covered or not, whichever leaves out less, and so does what single precision cannot tell.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View
from mmi.foundation.kernels import kernel

__all__ = ["may_show"]

_MARGIN = 1.0 / 128.0
"""Pixels: several times what corners are off by where OpenGL rounds them to 1 / 256, as all in use do."""
_ROUNDING = 2.0**-21
"""What places are off by in single precision at most, as a share of the largest coordinate."""
_DEPTHS = 2.0**-20
"""What depths of a depth buffer are off by at most, as a share of the whole."""
_MANY = 1024
"""Triangles with more middles of pixels in their bounds are drawn, and count as hiding nothing: there are few."""


def may_show(
    corners: NDArray[np.float32], view: View, *, nearest: float, solid: NDArray[np.bool_] | None = None
) -> NDArray[np.bool_]:
    """(m,) whether a picture of triangles as ``view`` sees them may show each of them.

    ``corners`` (3, 3, m), world, have the axis first, then the corner. What is nearer along the view's axis than ``nearest``,
    metres, is not drawn. Triangles that are not ``solid`` (m,) hide nothing.
    """
    found = np.zeros(corners.shape[2], dtype=bool)
    if not len(found):
        return found
    width, height = view.window[2:]
    off = _ROUNDING * max(float(corners.max()), -float(corners.min()), float(np.abs(view.eye).max()))
    hides = np.ones(len(found), dtype=bool) if solid is None else solid
    seen, depths = np.empty_like(corners), np.zeros((height, width), dtype=np.float32)
    _project(corners.reshape(3, -1), view.eye_from_world[:3], view.focal, view.window[:2], seen.reshape(3, -1))
    _paint(seen, view.focal, nearest, off, hides, depths, found)
    _tell(seen, view.focal, nearest, off, depths, found)
    return found


@kernel(error_model="numpy", nogil=True)
def _project(
    points: NDArray[np.float32],
    eye_from_world: NDArray[np.float64],
    focal: float,
    upper_left: tuple[int, int],
    seen: NDArray[np.float32],
) -> None:
    """Where ``points`` (3, n) are in the picture, from its upper left, and 1 / depth: (3, n) ``seen``."""
    left, top = upper_left
    a, b, c, d = eye_from_world[0]
    e, f, g, h = eye_from_world[1]
    i, j, k, o = eye_from_world[2]
    for n in range(points.shape[1]):
        x, y, z = points[0, n], points[1, n], points[2, n]
        near = -1.0 / (i * x + j * y + k * z + o)
        seen[0, n] = near * focal * (a * x + b * y + c * z + d) - left
        seen[1, n] = -near * focal * (e * x + f * y + g * z + h) - top
        seen[2, n] = near


@kernel(error_model="numpy", nogil=True, inline="always")
def _span(one: float, two: float, three: float, margin: float, count: int) -> tuple[int, int]:
    """The first and the last of ``count`` pixels whose middles are between three places, or a ``margin`` beside them."""
    low, high = min(one, two, three) - margin - 0.5, max(one, two, three) + margin - 0.5
    return math.ceil(min(max(low, 0.0), float(count))), math.floor(max(min(high, count - 1.0), -1.0))


@kernel(error_model="numpy", nogil=True, inline="always")
def _is_before(near: float, depths: NDArray[np.float32], left: int, right: int, top: int, bottom: int) -> bool:
    """Whether something is before what is painted in any of some pixels."""
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            if near >= depths[row, column]:
                return True
    return False


@kernel(error_model="numpy", nogil=True)
def _paint(
    seen: NDArray[np.float32],
    focal: float,
    nearest: float,
    off: float,
    hides: NDArray[np.bool_],
    depths: NDArray[np.float32],
    found: NDArray[np.bool_],
) -> None:
    """Paint 1 / depth of what triangles hide, and find those that may cover the middle of a pixel.

    Those that are seen from behind are not painted: of something closed, others are before them.
    """
    first_near = 1.0 / (nearest + off)
    for k in range(len(found)):
        x0, y0, w0 = float(seen[0, 0, k]), float(seen[1, 0, k]), float(seen[2, 0, k])
        x1, y1, w1 = float(seen[0, 1, k]), float(seen[1, 1, k]), float(seen[2, 1, k])
        x2, y2, w2 = float(seen[0, 2, k]), float(seen[1, 2, k]), float(seen[2, 2, k])
        least, most = min(w0, w1, w2), max(w0, w1, w2)
        if not (least > 0.0 and most < first_near):
            found[k] = True  # before the near plane, perhaps
            continue
        margin = _MARGIN + off * focal * most
        left, right = _span(x0, x1, x2, margin, depths.shape[1])
        if left > right:
            continue
        top, bottom = _span(y0, y1, y2, margin, depths.shape[0])
        if top > bottom:
            continue
        found[k] = True
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if not area < 0.0 or not hides[k] or (right - left + 1) * (bottom - top + 1) > _MANY:
            continue
        if not _is_before(most, depths, left, right, top, bottom):
            continue
        room0 = margin * (abs(x1 - x0) + abs(y1 - y0))
        room1 = margin * (abs(x2 - x1) + abs(y2 - y1))
        room2 = margin * (abs(x0 - x2) + abs(y0 - y2))
        if room0 + room1 + room2 > -area:  # too narrow to cover anything surely
            continue
        gx = ((w1 - w0) * (y2 - y0) - (w2 - w0) * (y1 - y0)) / area
        gy = ((w2 - w0) * (x1 - x0) - (w1 - w0) * (x2 - x0)) / area
        slack = margin * (abs(gx) + abs(gy)) + _DEPTHS / nearest
        for row in range(top, bottom + 1):
            v = row + 0.5
            for column in range(left, right + 1):
                u = column + 0.5
                near = np.float32(w0 + gx * (u - x0) + gy * (v - y0) - slack)
                if near <= depths[row, column]:
                    continue
                if (y1 - y0) * (u - x0) - (x1 - x0) * (v - y0) < room0:
                    continue
                if (y2 - y1) * (u - x1) - (x2 - x1) * (v - y1) < room1:
                    continue
                if (y0 - y2) * (u - x2) - (x0 - x2) * (v - y2) < room2:
                    continue
                depths[row, column] = near


@kernel(error_model="numpy", nogil=True)
def _tell(
    seen: NDArray[np.float32],
    focal: float,
    nearest: float,
    off: float,
    depths: NDArray[np.float32],
    found: NDArray[np.bool_],
) -> None:
    """Leave out those of the triangles ``found`` that are surely hidden wherever they may cover the middle of a pixel."""
    first_near = 1.0 / (nearest + off)
    for k in range(len(found)):
        if not found[k]:
            continue
        x0, y0, w0 = float(seen[0, 0, k]), float(seen[1, 0, k]), float(seen[2, 0, k])
        x1, y1, w1 = float(seen[0, 1, k]), float(seen[1, 1, k]), float(seen[2, 1, k])
        x2, y2, w2 = float(seen[0, 2, k]), float(seen[1, 2, k]), float(seen[2, 2, k])
        least, most = min(w0, w1, w2), max(w0, w1, w2)
        if not (least > 0.0 and most < first_near):
            continue
        margin = _MARGIN + off * focal * most
        left, right = _span(x0, x1, x2, margin, depths.shape[1])
        top, bottom = _span(y0, y1, y2, margin, depths.shape[0])
        if (right - left + 1) * (bottom - top + 1) > _MANY:
            continue
        found[k] = _is_before(most + _DEPTHS / nearest, depths, left, right, top, bottom)
        if not found[k]:
            continue
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        sign = 1.0 if area > 0.0 else -1.0
        room0 = -margin * (abs(x1 - x0) + abs(y1 - y0))
        room1 = -margin * (abs(x2 - x1) + abs(y2 - y1))
        room2 = -margin * (abs(x0 - x2) + abs(y0 - y2))
        is_flat = abs(area) > -(room0 + room1 + room2)  # else its plane says nothing
        gx = ((w1 - w0) * (y2 - y0) - (w2 - w0) * (y1 - y0)) / area if is_flat else 0.0
        gy = ((w2 - w0) * (x1 - x0) - (w1 - w0) * (x2 - x0)) / area if is_flat else 0.0
        slack = margin * (abs(gx) + abs(gy)) + _DEPTHS / nearest
        found[k] = False
        for row in range(top, bottom + 1):
            v = row + 0.5
            for column in range(left, right + 1):
                u = column + 0.5
                near = w0 + gx * (u - x0) + gy * (v - y0) if is_flat else most
                if near + slack < depths[row, column]:
                    continue
                if sign * ((x1 - x0) * (v - y0) - (y1 - y0) * (u - x0)) < room0:
                    continue
                if sign * ((x2 - x1) * (v - y1) - (y2 - y1) * (u - x1)) < room1:
                    continue
                if sign * ((x0 - x2) * (v - y2) - (y0 - y2) * (u - x2)) < room2:
                    continue
                found[k] = True
                break
            if found[k]:
                break
