"""How wrong a picture is, where whole-image averages hide it (DESIGN section 6).

A technique's frame is compared with one of the geometry, from the same view by the same renderer. A pixel is wrong where
it shows another object (ground and sky count as objects), and a hole where the geometry shows an object and the technique
ground or sky. What a viewer notices is how thick the regions are that wrong pixels form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from viewer.gl import Frame

__all__ = ["ViewErrors", "psnr", "thickness", "view_errors"]


@dataclass(frozen=True, slots=True)
class ViewErrors:
    """Errors of one view. Shares are of all pixels; ``thickness_px``, ``displacement_px`` in pixels of the view."""

    hole_share: float
    wrong_share: float
    thickness_px: float
    displacement_p99_px: float
    displacement_px: float
    """The largest displacement of an impostor's surface."""
    psnr_db: float


def view_errors(truth: Frame, shown: Frame, *, focal: float) -> ViewErrors:
    """Compare two measured frames of the same view; ``focal`` is the view's, in pixels.

    Raises ValueError for frames that were not measured or differ in size.
    """
    if truth.object_ids is None or shown.object_ids is None or shown.displacement is None:
        raise ValueError("two measured frames expected")
    if truth.object_ids.shape != shown.object_ids.shape:
        raise ValueError(f"frames of one size expected, found {truth.object_ids.shape} and {shown.object_ids.shape}")
    wrong = truth.object_ids != shown.object_ids
    holes = (truth.object_ids >= 0) & (shown.object_ids < 0)
    pixels = focal * np.tan(np.minimum(shown.displacement.astype(np.float64), 1.5))
    return ViewErrors(
        hole_share=float(holes.mean()),
        wrong_share=float(wrong.mean()),
        thickness_px=thickness(wrong),
        displacement_p99_px=float(np.percentile(pixels, 99.0)),
        displacement_px=float(pixels.max()),
        psnr_db=psnr(truth.color, shown.color),
    )


def thickness(region: NDArray[np.bool_]) -> float:
    """Diameter in pixels of the largest disc inside ``region`` (h, w), pixels taken as unit squares; 0 where it is empty.

    Discs are centred on pixel centres, edges and corners, so that a strip n pixels wide is n thick for even n as well.
    """
    if not region.any():
        return 0.0
    padded = np.pad(region, 1)
    # Centres, edges and corners of all pixels on a lattice of half pixels: inside where all pixels around are.
    lattice = np.zeros((2 * region.shape[0] + 1, 2 * region.shape[1] + 1), dtype=bool)
    lattice[1::2, 1::2] = region
    lattice[0::2, 1::2] = padded[:-1, 1:-1] & padded[1:, 1:-1]
    lattice[1::2, 0::2] = padded[1:-1, :-1] & padded[1:-1, 1:]
    lattice[0::2, 0::2] = padded[:-1, :-1] & padded[1:, :-1] & padded[:-1, 1:] & padded[1:, 1:]
    return float(distance_transform_edt(lattice).max())


def psnr(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    """Peak signal-to-noise ratio of two 8-bit pictures in decibels, infinite where they are equal."""
    error = float(np.mean((a.astype(np.float64) - b.astype(np.float64)) ** 2))
    return float("inf") if error == 0.0 else float(10.0 * np.log10(255.0**2 / error))
