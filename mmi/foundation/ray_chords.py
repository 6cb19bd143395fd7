"""How far apart two points of one capture ray are seen from elsewhere: the measure behind every bound, as compiled kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View
from mmi.foundation.kernels import kernel

__all__ = ["Intrinsics", "chord", "intrinsics_of", "may_exceed"]


class Intrinsics(NamedTuple):
    """A capture's camera: ``left`` and ``top`` of its window from the optical axis, and its ``focal`` length, in texels."""

    left: float
    top: float
    focal: float


def intrinsics_of(view: View, viewpoints: NDArray[np.float64]) -> tuple[Intrinsics, NDArray[np.float64]]:
    """The intrinsics of a capture's view, and ``viewpoints`` (k, 3) in its eye space, metres."""
    offsets = viewpoints @ view.eye_from_world[:3, :3].T + view.eye_from_world[:3, 3]
    return Intrinsics(float(view.window[0]), float(view.window[1]), view.focal), offsets


@kernel(error_model="numpy")
def chord(
    x: float, y: float, captured: float, drawn: float, intrinsics: Intrinsics, offsets: NDArray[np.float64]
) -> float:
    """Distance between the directions to where a texel was captured and where it is drawn (both 1/z), from any of ``offsets``.

    (x, y) counts in texels from the window's corner; ``offsets`` (k, 3) are viewpoints in the capture's eye space.
    """
    ux, uy = (intrinsics.left + x) / intrinsics.focal, -(intrinsics.top + y) / intrinsics.focal
    most = 0.0
    z1, z2 = 1.0 / captured, 1.0 / drawn
    for k in range(len(offsets)):
        x1, y1, w1 = ux * z1 - offsets[k, 0], uy * z1 - offsets[k, 1], -z1 - offsets[k, 2]
        x2, y2, w2 = ux * z2 - offsets[k, 0], uy * z2 - offsets[k, 1], -z2 - offsets[k, 2]
        n1, n2 = (x1 * x1 + y1 * y1 + w1 * w1) ** -0.5, (x2 * x2 + y2 * y2 + w2 * w2) ** -0.5
        dx, dy, dw = x1 * n1 - x2 * n2, y1 * n1 - y2 * n2, w1 * n1 - w2 * n2
        most = max(most, dx * dx + dy * dy + dw * dw)
    return most**0.5


@kernel(error_model="numpy", fastmath=True)
def may_exceed(most: float, near: float, far: float, reach: float) -> bool:
    """Whether the square of the chord between two points of a capture ray may exceed ``most``, from ``reach`` metres around.

    The points are ``near`` and ``far`` metres away. From M the sine of the angle between P and Q is |(P-M) x (Q-M)| / (|P-M|
    |Q-M|), and its numerator |M x (P-Q)|, as both are on one ray: at most reach |P-Q| / ((|P| - reach) (|Q| - reach)). That
    bound falls when both distances grow in the same ratio, so distances on the ground are enough for rays that rise.
    """
    if near <= 2.0 * reach:
        return True
    square = (reach * (far - near) / ((near - reach) * (far - reach))) ** 2
    return square * (1.0 + square) > most  # the chord's square is at most that, below a right angle
