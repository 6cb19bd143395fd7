"""Viewing cells: the street graph cut into short straight stretches, and how they neighbour each other (paper section 4)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mmi.errors import ParameterError

__all__ = ["ViewingCell"]


@dataclass(frozen=True, slots=True)
class ViewingCell:
    """Where a viewer may be: within ``half_width`` of the axis from ``p`` to ``q``, eyes at heights within ``eye``.

    The region is the rectangle that the axis sweeps sideways (no caps at the ends). ``p``, ``q`` are (x, y), ``eye`` is
    (lowest, highest) in metres in the city's frame. ``id`` names street and piece (``0017-03``), so that it stays when
    other streets change.
    """

    id: str
    p: tuple[float, float]
    q: tuple[float, float]
    half_width: float
    eye: tuple[float, float]
    street: str = ""

    def __post_init__(self) -> None:
        if not (self.length > 0.0 and math.isfinite(self.length)):
            raise ParameterError(f"cell {self.id}: an axis of positive length expected, found {self.p} to {self.q}")
        if not (self.half_width > 0.0 and self.eye[0] <= self.eye[1]):
            raise ParameterError(
                f"cell {self.id}: a positive half width and an eye band (low, high) expected, "
                f"found {self.half_width} and {self.eye}"
            )

    @property
    def length(self) -> float:
        """Metres from p to q."""
        return math.hypot(self.q[0] - self.p[0], self.q[1] - self.p[1])

    @property
    def reference(self) -> NDArray[np.float64]:
        """(3,) the viewpoint from which layers are captured: the middle of the axis, at the middle of the eye band."""
        return np.array(
            [0.5 * (self.p[0] + self.q[0]), 0.5 * (self.p[1] + self.q[1]), 0.5 * (self.eye[0] + self.eye[1])]
        )

    @property
    def corners(self) -> NDArray[np.float64]:
        """(4, 2) the region's corners, counter-clockwise, starting to the right of p."""
        p, q = np.array(self.p), np.array(self.q)
        along = (q - p) / self.length
        right = self.half_width * np.array([along[1], -along[0]])
        return np.array([p + right, q + right, q - right, p - right])
