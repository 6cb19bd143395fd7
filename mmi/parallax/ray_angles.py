"""The angle that two points of one capture ray subtend from elsewhere in the cell, as compiled kernels.

All take it in the frame of the ray: the reference viewpoint is the origin, distances along the ray and to its side are
horizontal, and a slope (height over distance) raises the ray. The square of the chord between the two directions stands for
the angle, since comparing it needs no trigonometry; :func:`angle_of` turns it into radians.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.kernels import kernel

__all__ = ["RayViewpoints", "angle_of", "closest_to_level", "no_wider_than", "on_ray", "widest"]

_ROUNDING = 1e-9
"""Relative: what sums of a few terms are off by is far less."""


class RayViewpoints(NamedTuple):
    """Viewpoints ``along`` and ``aside`` (p,) metres from the reference, along a ray and to its side.

    ``rise`` metres more or less of height may be added to any of them: half the height of the eye band.
    """

    along: NDArray[np.float64]
    aside: NDArray[np.float64]
    rise: float


@kernel(error_model="numpy")
def on_ray(ux: float, uy: float, viewpoints: NDArray[np.float64], seen: RayViewpoints) -> None:
    """Sets ``seen`` to the ``viewpoints`` (p, 2), metres from the reference, in the frame of the ray towards (ux, uy)."""
    for k in range(len(viewpoints)):
        seen.along[k] = ux * viewpoints[k, 0] + uy * viewpoints[k, 1]
        seen.aside[k] = ux * viewpoints[k, 1] - uy * viewpoints[k, 0]


@kernel(error_model="numpy", fastmath=True)
def widest(
    near: float, far: float, lowest: float, highest: float, viewpoints: RayViewpoints, visible: NDArray[np.bool_]
) -> float:
    """Largest square of the chord between the directions to two points of a ray, over the ``visible`` (p,) viewpoints.

    The points are ``near`` and ``far`` metres away (horizontally) on rays of slopes from ``lowest`` to ``highest``. The rise
    of the viewpoints adds what it turns the two directions by.
    """
    most = 0.0
    level = closest_to_level(lowest, highest)
    for k in range(len(visible)):
        if not visible[k]:
            continue
        x1, x2, y = near - viewpoints.along[k], far - viewpoints.along[k], viewpoints.aside[k]
        r1, r2 = x1 * x1 + y * y, x2 * x2 + y * y
        for slope in (
            lowest,
            level,
            highest,
            _within(_parting_most(near, far, r1, r2, x1 * x2 + y * y), lowest, highest),
            # Elevations part most where d/ds (atan(near s / r1) - atan(far s / r2)) = 0: a rise counts most there.
            _within(math.sqrt(math.sqrt(r1 * r2) / (near * far)), lowest, highest),
        ):
            z1, z2 = slope * near, slope * far
            n1, n2 = 1.0 / math.sqrt(r1 + z1 * z1), 1.0 / math.sqrt(r2 + z2 * z2)
            dx, dy, dz = x1 * n1 - x2 * n2, y * (n1 - n2), abs(z1 * n1 - z2 * n2) + viewpoints.rise * abs(n1 - n2)
            most = max(most, dx * dx + dy * dy + dz * dz)
    return most


@kernel(error_model="numpy")
def _within(slope: float, lowest: float, highest: float) -> float:
    """``slope`` upwards if it is in the range or beyond it, or else downwards, moved into the range if need be."""
    return min(max(slope, lowest), highest) if slope <= highest else min(max(-slope, lowest), highest)


@kernel(error_model="numpy")
def _parting_most(near: float, far: float, r1: float, r2: float, dot: float) -> float:
    """The slope (upwards or downwards) of the ray whose points ``near`` and ``far`` metres away part most, 0 for level.

    ``r1``, ``r2`` are the squares of their horizontal distances from the viewpoint, ``dot`` the product of the two offsets. At
    a slope s the cosine of the angle is (dot + s^2 near far) / sqrt((r1 + s^2 near^2) (r2 + s^2 far^2)); its derivative by
    s^2 is linear once the denominators are gone.
    """
    product, sums = near * far, near * near * r2 + far * far * r1
    numerator, denominator = dot * sums - 2.0 * product * r1 * r2, product * (sums - 2.0 * dot * product)
    return math.sqrt(numerator / denominator) if numerator > 0.0 and denominator > 0.0 else 0.0


@kernel(error_model="numpy")
def no_wider_than(
    near: float, far: float, lowest: float, highest: float, viewpoints: RayViewpoints, visible: NDArray[np.bool_]
) -> float:
    """What :func:`widest` does not exceed for any two points between ``near`` and ``far`` metres, at any of these slopes.

    Seen from a fixed viewpoint, the direction to a point that moves along a ray turns one way only, so that the ends part
    most. At a slope s the square of the chord is 4 sin^2(de/2) + cos e1 cos e2 4 sin^2(df/2), with the elevations e1, e2, and
    the azimuths df apart. Each term counts with its greatest value: the cosines at the slope closest to level, de at the
    ends of the range or where it has an extreme. The rise adds what the inverse distances differ by, at most.
    """
    most = 0.0
    level = closest_to_level(lowest, highest)
    steepest = max(abs(lowest), abs(highest))
    for k in range(len(visible)):
        if not visible[k]:
            continue
        x1, x2, y = near - viewpoints.along[k], far - viewpoints.along[k], viewpoints.aside[k]
        r1, r2 = x1 * x1 + y * y, x2 * x2 + y * y
        h1, h2 = math.sqrt(r1), math.sqrt(r2)
        dx, dy = x1 / h1 - x2 / h2, y / h1 - y / h2
        turned = (dx * dx + dy * dy) * h1 * h2
        turned /= math.sqrt((r1 + level * level * near * near) * (r2 + level * level * far * far))
        steep = math.sqrt(h1 * h2 / (near * far))
        lifted = 0.0
        for slope in (lowest, highest, min(max(steep, lowest), highest), min(max(-steep, lowest), highest)):
            z1, z2 = slope * near, slope * far
            n1, n2 = 1.0 / math.sqrt(r1 + z1 * z1), 1.0 / math.sqrt(r2 + z2 * z2)
            dh, dz = h1 * n1 - h2 * n2, z1 * n1 - z2 * n2
            lifted = max(lifted, dh * dh + dz * dz)
        z1, z2 = steepest * near, steepest * far
        x = min(max(viewpoints.along[k], near), far) - viewpoints.along[k]  # where the ray is closest to the viewpoint
        closest = 1.0 / math.sqrt(x * x + y * y + level * level * near * near)
        farthest = min(1.0 / math.sqrt(r1 + z1 * z1), 1.0 / math.sqrt(r2 + z2 * z2))
        chord = math.sqrt(turned + lifted) + viewpoints.rise * (closest - farthest)
        square = chord * chord * (1.0 + _ROUNDING)
        if not square < math.inf:  # the viewpoint is on the ray
            return math.inf
        most = max(most, square)
    return most


@kernel(error_model="numpy")
def angle_of(chord_square: float) -> float:
    """The angle between unit vectors whose tips are that far apart."""
    return 2.0 * math.asin(min(0.5 * math.sqrt(chord_square), 1.0))


@kernel(error_model="numpy")
def closest_to_level(low: float, high: float) -> float:
    """The number in [low, high] that is closest to zero."""
    return min(max(0.0, low), high)
