"""What a viewer has cast so far: a map of all directions, and from where each of them was cast (paper section 5).

The paper's map is a cylinder. This one goes up to the zenith and down: a row is a height above the horizon, a column an
azimuth, and both are as far apart as the smallest pixels of the display, those at its left and right border, so that no two
pixels of a level view need the same texel. Memory that no direction has needed is not taken.

A texel keeps what its ray has hit, not a colour: the triangle, where on it, and the point. So it is known how wrong it is when
it is shown from elsewhere, and the renderer gives it the colour that it gives to geometry. A *record* is a place that rays were
cast from (the paper's confidence record); record 0 stands for what nobody has cast.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View
from mmi.foundation.kernels import kernel

__all__ = ["Panorama", "Texels", "smallest_pixel", "store", "texel_of"]

_APART = 1e-6
"""Metres below which two places are one: who turns on the spot stays where it is, to rounding."""
_MOST_RECORDS = 4096
"""Of older ones nothing is shown again."""


class Texels(NamedTuple):
    """All texels, row by row from straight down to straight up; ``size`` is (columns, rows), ``step`` radians of both.

    ``record`` (n,) says from where each was cast; ``triangle`` (n,) what was hit, -1 for nothing, at barycentric ``weights``
    (n, 2) of its second and third corner, which is the ``point`` (n, 3), world; for nothing, ``point`` is the direction.
    """

    columns: int
    rows: int
    step: float
    record: NDArray[np.int32]
    triangle: NDArray[np.int32]
    weights: NDArray[np.float32]
    point: NDArray[np.float32]


def smallest_pixel(view: View) -> float:
    """Radians of the smallest pixel of a view, one in its farther border column, along the azimuth if the view is level."""
    left, _, width, _ = view.window
    aside = max(abs(left), abs(left + width)) / view.focal
    return 1.0 / ((1.0 + aside * aside) * view.focal)


class Panorama:
    """The map of one viewer, whose smallest pixels are ``pixel`` radians wide."""

    def __init__(self, pixel: float) -> None:
        columns = max(math.ceil(2.0 * math.pi / pixel), 8)
        step = 2.0 * math.pi / columns
        rows = math.ceil(math.pi / step) + 1
        # Zeros are not in memory before they are written.
        self.texels = Texels(
            columns,
            rows,
            step,
            np.zeros(columns * rows, dtype=np.int32),
            np.zeros(columns * rows, dtype=np.int32),
            np.zeros((columns * rows, 2), dtype=np.float32),
            np.zeros((columns * rows, 3), dtype=np.float32),
        )
        self._eyes = np.zeros((0, 3))
        self._dropped = 0

    def distances(self, eye: NDArray[np.float64]) -> NDArray[np.float32]:
        """(records,) metres from ``eye`` (3,) to where each was cast; infinite for record 0 and those that are too old."""
        found = np.full(1 + self._dropped + len(self._eyes), np.inf, dtype=np.float32)
        if len(self._eyes):
            away = np.linalg.norm(self._eyes - eye, axis=1)
            found[-len(self._eyes) :] = np.where(away <= _APART, 0.0, away)
        return found

    def record_at(self, eye: NDArray[np.float64]) -> int:
        """The record for what is cast from ``eye`` (3,): a new one where the viewer has moved since the last.

        What was cast from the very place that a viewer comes back to has its record again.
        """
        away = np.linalg.norm(self._eyes - eye, axis=1)
        if len(away) and away.min() <= _APART:
            return 1 + self._dropped + int(np.argmin(away))
        self._eyes = np.vstack([self._eyes, eye])
        if len(self._eyes) > _MOST_RECORDS:
            self._eyes = self._eyes[1:]
            self._dropped += 1
        return self._dropped + len(self._eyes)


@kernel(nogil=True, inline="always")
def texel_of(dx: float, dy: float, dz: float, columns: int, rows: int, step: float) -> tuple[int, int]:
    """Column and row of the texel of a direction of any length but 0."""
    column = int((math.atan2(dy, dx) + math.pi) / step)
    row = int((math.atan2(dz, math.sqrt(dx * dx + dy * dy)) + 0.5 * math.pi) / step)
    return min(column, columns - 1), min(row, rows - 1)


@kernel(nogil=True)
def store(
    record: int,
    eye: NDArray[np.float64],
    directions: NDArray[np.float64],
    triangles: NDArray[np.int32],
    distances: NDArray[np.float32],
    weights: NDArray[np.float32],
    texels: Texels,
) -> None:
    """Keep what rays from ``eye`` (3,) in unit ``directions`` (n, 3) have hit, under ``record``."""
    for k in range(len(triangles)):
        dx, dy, dz = directions[k, 0], directions[k, 1], directions[k, 2]
        column, row = texel_of(dx, dy, dz, texels.columns, texels.rows, texels.step)
        place = row * texels.columns + column
        texels.record[place], texels.triangle[place] = record, triangles[k]
        texels.weights[place, 0], texels.weights[place, 1] = weights[k, 0], weights[k, 1]
        far = float(distances[k])
        if triangles[k] < 0:
            texels.point[place, 0], texels.point[place, 1], texels.point[place, 2] = dx, dy, dz
        else:
            texels.point[place, 0] = eye[0] + far * dx
            texels.point[place, 1] = eye[1] + far * dy
            texels.point[place, 2] = eye[2] + far * dz
