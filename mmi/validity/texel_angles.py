"""Whether the texels of an image show: the angle of a texel against that of a pixel (Schaufler and Stuerzlinger, eq. 1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmi.foundation.camera import Camera

__all__ = ["fine_enough", "finest_pixel", "paper_pixel", "texel_angle"]


def texel_angle(size: ArrayLike, distance: ArrayLike) -> NDArray[np.float64]:
    """The angle under which a texel of ``size`` metres is seen across its middle from ``distance`` metres: alpha_tex."""
    return np.asarray(2.0 * np.arctan2(0.5 * np.asarray(size, np.float64), np.asarray(distance, np.float64)))


def paper_pixel(camera: Camera) -> float:
    """alpha_screen as printed: the field of view divided by the pixels across. A mean: pixels at the borders are smaller."""
    return camera.fov / camera.width


def finest_pixel(camera: Camera) -> float:
    """The angle of the smallest pixel across, that at the left or right border: cos^2(fov / 2) of that in the middle.

    At 60 degrees that is three quarters. A texel that is no larger is hidden wherever on the display it appears.
    """
    return camera.border_pixel[0]


def fine_enough(size: ArrayLike, distance: ArrayLike, camera: Camera) -> NDArray[np.bool_]:
    """Whether texels of ``size`` metres are smaller than any pixel from ``distance`` metres, the least to the image."""
    return np.asarray(texel_angle(size, distance) < finest_pixel(camera))
