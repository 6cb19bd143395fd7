"""How wrong a picture is, where whole-image averages hide it (DESIGN section 6).

A technique's picture is compared with one of the geometry, from the same view by the same renderer. A pixel is wrong where
it shows another object (ground and sky count as objects), and a hole where the geometry shows an object and the technique
ground or sky. What a viewer notices is how thick the regions are that wrong pixels form. FLIP, SSIM and PSNR are for
comparison with others' figures.
"""

from __future__ import annotations

from dataclasses import dataclass

import flip_evaluator  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import NDArray
from skimage.metrics import structural_similarity

from mmi.foundation.thickness import thickness
from viewer.drawing.drawn_picture import DrawnPicture

__all__ = [
    "ALIKE_DB",
    "ALIKE_PX",
    "ViewErrors",
    "WrongRegions",
    "alike",
    "beyond_resampling",
    "flip_map",
    "pop",
    "psnr",
    "ssim",
    "view_errors",
    "wrong_regions",
]

ALIKE_DB, ALIKE_PX = 40.0, 2.0
"""A picture is like the geometry's whose PSNR is at least so many decibels, without wrong regions of more pixels."""
_SSIM_WINDOW = 11
"""The side of the window of Wang et al. 2004, in pixels."""


@dataclass(frozen=True, slots=True)
class ViewErrors:
    """Errors of one view. Shares are of all pixels; names in ``_px`` are pixels of the view."""

    hole_share: float
    wrong_share: float
    thickness_px: float
    """The thickness of the thickest region of wrong pixels, holes included."""
    displacement_p50_px: float
    """This and the next two are taken over the pixels that show an impostor; all are 0 where none does."""
    displacement_p99_px: float
    displacement_max_px: float
    flip_mean: float | None
    """This and the next two are None where FLIP was not asked for."""
    flip_p95: float | None
    flip_masked: float | None
    """The mean over the disoccluded pixels. It is also None where there are none, or where they are not known."""
    psnr_db: float
    """Infinite for equal pictures."""
    ssim: float


@dataclass(frozen=True, slots=True, eq=False)
class WrongRegions:
    """Which pixels of a view are wrong, and which of those are holes: (h, w) bool each."""

    wrong: NDArray[np.bool_]
    holes: NDArray[np.bool_]

    def __post_init__(self) -> None:
        self.wrong.setflags(write=False)
        self.holes.setflags(write=False)


def view_errors(
    truth: DrawnPicture,
    shown: DrawnPicture,
    *,
    focal: float,
    disoccluded: NDArray[np.bool_] | None = None,
    flip: bool = True,
) -> ViewErrors:
    """Compare two measured pictures of the same view; ``focal`` is the view's, in pixels.

    ``disoccluded`` (h, w) says where the geometry's picture shows what no layer can have captured
    (``viewer.measuring.disocclusion``). FLIP takes most of the time; without ``flip`` it is left out. Raises ValueError for
    pictures that were not measured or read, and where sizes differ.
    """
    regions = wrong_regions(truth, shown)
    if shown.displacement is None:
        raise ValueError("two measured pictures expected, found one without displacement")
    size = regions.wrong.shape
    for name, array in (("color", truth.color), ("color", shown.color), ("disoccluded", disoccluded)):
        if array is not None and array.shape[:2] != size:
            raise ValueError(f"{name} of size {size} expected, found {array.shape[:2]}")
    angles = shown.displacement[np.isfinite(shown.displacement)].astype(np.float64)
    pixels = focal * np.tan(np.minimum(angles, 1.5)) if angles.size else np.zeros(1)
    errors = flip_map(truth.color, shown.color) if flip else None
    return ViewErrors(
        hole_share=float(regions.holes.mean()),
        wrong_share=float(regions.wrong.mean()),
        thickness_px=thickness(regions.wrong),
        displacement_p50_px=float(np.percentile(pixels, 50.0)),
        displacement_p99_px=float(np.percentile(pixels, 99.0)),
        displacement_max_px=float(pixels.max()),
        flip_mean=None if errors is None else _mean(errors),
        flip_p95=None if errors is None else float(np.percentile(errors, 95.0)),
        flip_masked=None
        if errors is None or disoccluded is None or not disoccluded.any()
        else _mean(errors[disoccluded]),
        psnr_db=psnr(truth.color, shown.color),
        ssim=ssim(truth.color, shown.color),
    )


def wrong_regions(truth: DrawnPicture, shown: DrawnPicture) -> WrongRegions:
    """Where ``shown`` shows another object than ``truth``, both measured pictures of the same view.

    Raises ValueError for pictures that were not measured or differ in size.
    """
    if truth.object_ids is None or shown.object_ids is None:
        raise ValueError("two measured pictures expected, found one without object ids")
    if truth.object_ids.shape != shown.object_ids.shape:
        raise ValueError(f"pictures of one size expected, found {truth.object_ids.shape} and {shown.object_ids.shape}")
    wrong = truth.object_ids != shown.object_ids
    return WrongRegions(wrong, (truth.object_ids >= 0) & (shown.object_ids < 0))


def alike(truth: DrawnPicture, shown: DrawnPicture) -> bool:
    """Whether two measured pictures of a view are hard to tell apart: at least ``ALIKE_DB``, no wrong region past ``ALIKE_PX``.

    Raises what :func:`wrong_regions` does.
    """
    return psnr(truth.color, shown.color) >= ALIKE_DB and thickness(wrong_regions(truth, shown).wrong) <= ALIKE_PX


def beyond_resampling(truth: DrawnPicture, shown: DrawnPicture) -> WrongRegions:
    """What is left of :func:`wrong_regions` where a pixel may take its object from any of the 3 x 3 pixels around it.

    Texels of a capture and pixels of a view are two grids, and what is seen through both may be off by up to a pixel. That
    alone makes regions of any thickness: of a row of houses that are a pixel wide each, every one may be wrong. So a
    wrong pixel is forgiven where the geometry's object at that pixel occurs in the technique's 3 x 3 pixels around it, and
    the technique's object in the geometry's. Ground and sky are objects here as in :func:`wrong_regions`: an outline that
    is off by a pixel against the sky is forgiven, a hole within an object is not, as the geometry shows nothing of what
    shows through it. What lies outside the picture forgives nothing.

    An upright or level edge between two objects that is off by two pixels or more is as wrong as before, over its whole
    width; a slanted one may be off by a pixel to the side and one up or down. As wrong as before is also what the technique
    lacks or invents, be it one of a row of houses so narrow that a pixel meets some of them and a texel others. Forgiven
    too much is where two objects change places next to each other: of one that is off by its own width, before the same
    background, a pixel where it ends and a pixel where it should begin; and all of a pattern of few objects, finer than two
    pixels.

    Raises ValueError for pictures that were not measured or differ in size.
    """
    regions = wrong_regions(truth, shown)
    assert truth.object_ids is not None and shown.object_ids is not None
    forgiven = _around(truth.object_ids, shown.object_ids) & _around(shown.object_ids, truth.object_ids)
    return WrongRegions(regions.wrong & ~forgiven, regions.holes & ~forgiven)


def pop(
    before_shown: DrawnPicture, after_shown: DrawnPicture, before_truth: DrawnPicture, after_truth: DrawnPicture
) -> float:
    """How much more a technique's picture changes than the geometry's does for the same motion: at a cell switch, say.

    The mean FLIP between the technique's pictures less that between the geometry's; below 0 where the geometry changes more.
    """
    shown, truth = flip_map(before_shown.color, after_shown.color), flip_map(before_truth.color, after_truth.color)
    return _mean(shown) - _mean(truth)


def flip_map(reference: NDArray[np.uint8], test: NDArray[np.uint8]) -> NDArray[np.float32]:
    """FLIP of two sRGB pictures (h, w, 3) as (h, w): 0 alike, 1 as different as can be (Andersson et al. 2020).

    For the default viewer, to whom 67 pixels are a degree, so that figures compare with others', whatever the view's own
    field of view is. Pictures of any size will do, edges are repeated where filters reach beyond. 512 x 512 pixels take
    0.6 s of one core and hold Python's lock all the while: only processes share the work. Raises ValueError for pictures of
    different sizes.
    """
    if reference.shape != test.shape or reference.ndim != 3 or reference.shape[2] != 3:
        raise ValueError(f"two pictures (h, w, 3) of one size expected, found {reference.shape} and {test.shape}")
    if np.array_equal(reference, test):
        return np.zeros(reference.shape[:2], dtype=np.float32)
    pictures = (np.ascontiguousarray(picture, dtype=np.float32) / np.float32(255.0) for picture in (reference, test))
    errors: NDArray[np.float32] = flip_evaluator.evaluate(
        *pictures, "LDR", applyMagma=False, computeMeanError=False, parameters={}
    )[0]
    return errors[..., 0]


def psnr(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    """Peak signal-to-noise ratio of two 8-bit pictures in decibels, infinite where they are equal."""
    error = float(np.mean((a.astype(np.float64) - b.astype(np.float64)) ** 2))
    return float("inf") if error == 0.0 else float(10.0 * np.log10(255.0**2 / error))


def ssim(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    """Structural similarity of two 8-bit pictures (h, w, 3), mean of the channels, with the settings of Wang et al. 2004.

    1 where they are equal. The mean is over whole windows of 11 pixels; a picture smaller than that is mirrored at its
    edges until it has one.
    """
    missing = [max(_SSIM_WINDOW - n, 0) for n in a.shape[:2]]
    widths = [*((n // 2, n - n // 2) for n in missing), (0, 0)]
    a, b = (np.pad(picture, widths, mode="symmetric") if any(missing) else picture for picture in (a, b))
    return float(
        structural_similarity(  # type: ignore[no-untyped-call]
            a, b, data_range=255, channel_axis=2, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
        )
    )


def _around(ids: NDArray[np.int32], other: NDArray[np.int32]) -> NDArray[np.bool_]:
    """(h, w): where the object of ``ids`` (h, w) occurs in the 3 x 3 pixels of ``other`` (h, w) around the same place."""
    height, width = ids.shape
    found = np.zeros(ids.shape, dtype=bool)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            here = np.s_[max(-down, 0) : height - max(down, 0), max(-right, 0) : width - max(right, 0)]
            there = np.s_[max(down, 0) : height + min(down, 0), max(right, 0) : width + min(right, 0)]
            found[here] |= ids[here] == other[there]
    return found


def _mean(values: NDArray[np.float32]) -> float:
    return float(values.mean(dtype=np.float64))
