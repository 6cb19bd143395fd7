"""What a viewpoint sees around it of triangles: a panorama of azimuths and slopes with a depth buffer, drawn in software.

Columns are azimuths and rows slopes (height over horizontal distance), as rehearsals count pixels. The rays of a column lie in
an upright plane, which cuts a triangle along a line, and along a line in that plane the inverse of the distance is linear in
the slope. So each column is exact, and nothing needs to be clipped but what is behind the viewpoint. Both sides of a triangle
show, and what is clear in a picture of leaves hides like the rest.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.kernels import kernel

__all__ = ["Panorama", "draw_triangles", "empty_panorama", "spans_of"]

_CLOSEST = 1e-3
"""Metres: nothing is drawn that is closer to the viewpoint, along the ground."""


class Panorama(NamedTuple):
    """What rays from a viewpoint meet first: ``inverse`` (columns, rows) float32, 1 / metres along the ground, 0 where they
    meet nothing, and ``triangle`` (columns, rows) int32, -1 there.

    Column c is the azimuth (c + 0.5) 2 pi / columns. Row ``down`` begins at eye level; each is a slope of ``row``.
    """

    inverse: NDArray[np.float32]
    triangle: NDArray[np.int32]
    down: int
    row: float


def empty_panorama(columns: int, *, up: int, down: int, row: float) -> Panorama:
    """A panorama that shows nothing, of ``up`` rows above eye level and ``down`` below."""
    shape = (columns, up + down)
    return Panorama(np.zeros(shape, dtype=np.float32), np.full(shape, -1, dtype=np.int32), down, row)


@kernel(error_model="numpy")
def draw_triangles(
    vertices: NDArray[np.float32],
    triangles: NDArray[np.int32],
    chosen: NDArray[np.int64],
    eye: NDArray[np.float64],
    panorama: Panorama,
    spans: NDArray[np.int64],
) -> None:
    """Draw the ``chosen`` (k,) of ``triangles`` (m, 3) as seen from ``eye`` (3,) over what ``panorama`` shows already, in the
    rows of ``spans`` (columns, 2).
    """
    inverse, names, down, row = panorama
    columns = len(inverse)
    turn = 2.0 * math.pi / columns
    rays = np.empty((columns, 2))
    for c in range(columns):
        rays[c, 0], rays[c, 1] = math.cos((c + 0.5) * turn), math.sin((c + 0.5) * turn)
    p = np.empty((3, 3))
    for t in chosen:
        for k in range(3):
            for axis in range(3):
                p[k, axis] = vertices[triangles[t, k], axis] - eye[axis]
        # Azimuths of the corners, counted on from the first; they come back to it unless the triangle is above or below.
        ab = math.atan2(p[0, 0] * p[1, 1] - p[0, 1] * p[1, 0], p[0, 0] * p[1, 0] + p[0, 1] * p[1, 1])
        bc = math.atan2(p[1, 0] * p[2, 1] - p[1, 1] * p[2, 0], p[1, 0] * p[2, 0] + p[1, 1] * p[2, 1])
        ca = math.atan2(p[2, 0] * p[0, 1] - p[2, 1] * p[0, 0], p[2, 0] * p[0, 0] + p[2, 1] * p[0, 1])
        start = math.atan2(p[0, 1], p[0, 0])
        begin = math.ceil((start + min(0.0, ab, ab + bc)) / turn - 0.5)
        many = math.ceil((start + max(0.0, ab, ab + bc)) / turn - 0.5) - begin
        if abs(ab + bc + ca) > math.pi:
            begin, many = 0, columns
        for step in range(many):
            c = (begin + step) % columns
            least, most = spans[c]
            if least >= most:
                continue
            ux, uy = rays[c]
            found = 0
            d1, h1, d2, h2 = 0.0, 0.0, 0.0, 0.0
            for k in range(3):
                after = (k + 1) % 3
                one, other = ux * p[k, 1] - uy * p[k, 0], ux * p[after, 1] - uy * p[after, 0]
                if (one > 0.0) == (other > 0.0):
                    continue
                s = one / (one - other)
                d = ux * (p[k, 0] + s * (p[after, 0] - p[k, 0])) + uy * (p[k, 1] + s * (p[after, 1] - p[k, 1]))
                h = p[k, 2] + s * (p[after, 2] - p[k, 2])
                if found == 0:
                    d1, h1 = d, h
                else:
                    d2, h2 = d, h
                found += 1
            if found < 2 or (d1 <= _CLOSEST and d2 <= _CLOSEST):
                continue
            if d1 < _CLOSEST:
                h1, d1 = h1 + (h2 - h1) * (_CLOSEST - d1) / (d2 - d1), _CLOSEST
            if d2 < _CLOSEST:
                h2, d2 = h2 + (h1 - h2) * (_CLOSEST - d2) / (d1 - d2), _CLOSEST
            s1, s2, w1, w2 = h1 / d1 / row + down, h2 / d2 / row + down, 1.0 / d1, 1.0 / d2
            if s1 > s2:
                s1, s2, w1, w2 = s2, s1, w2, w1
            if s2 <= least or s1 >= most:
                continue
            first, end = max(math.ceil(s1 - 0.5), least), min(math.ceil(s2 - 0.5), most)
            rise = (w2 - w1) / (s2 - s1)
            for r in range(first, end):
                w = np.float32(w1 + (r + 0.5 - s1) * rise)
                if w > inverse[c, r]:
                    inverse[c, r], names[c, r] = w, t


@kernel(error_model="numpy")
def spans_of(panorama: Panorama) -> NDArray[np.int64]:
    """(columns, 2) the rows that hold all that a panorama shows, from the first to before the second."""
    columns, rows = panorama.triangle.shape
    spans = np.zeros((columns, 2), dtype=np.int64)
    for c in range(columns):
        low, high = 0, rows
        while low < high and panorama.triangle[c, low] < 0:
            low += 1
        while low < high and panorama.triangle[c, high - 1] < 0:
            high -= 1
        spans[c] = low, high
    return spans
