"""Draws whose surfaces a technique knows pixel by pixel: single pixels, pictures, samples of images that are yet to be warped.

They hide all else, and it them, by depth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View

__all__ = ["CAST_PIXEL", "CastPixels", "WarpedPicture", "WarpedSamples"]

CAST_PIXEL = np.dtype(
    [
        ("pixel", "<u2", 2),
        ("depth", "<f4"),
        ("uv", "<f4", 2),
        ("level", "<f4"),
        ("tint", "u1", 4),
        ("object", "<i4"),
    ]
)
"""One pixel of :class:`CastPixels`, as it goes to the GPU."""


@dataclass(frozen=True, slots=True, eq=False)
class CastPixels:
    """Single pixels whose surfaces a technique has found itself, by rays for instance; the renderer gives them their colours.

    ``samples`` (n,) of ``CAST_PIXEL``: ``pixel``, column and row in the view's window; ``depth`` along the view's axis, metres,
    which composes them with all else; texture coordinates ``uv`` in the city's texture, and the mipmap ``level`` at which it
    is sampled; ``tint`` multiplies that; ``object`` of the city. The first ``fresh`` of them were found in this frame,
    which took ``seconds``.
    """

    samples: NDArray[np.void]
    fresh: int = 0
    seconds: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class WarpedPicture:
    """A picture of what a view sees, made of samples of others that were moved to where they are in it.

    ``color`` (h, w, 3) uint8 sRGB; ``depth`` (h, w) float32 metres along the view's axis, infinite where the picture shows
    nothing; ``objects`` (h, w) int32 of the city.
    """

    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    objects: NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class WarpedSamples:
    """All samples of a layered image of ``view``, which the renderer moves to where they are in what it draws.

    ``key`` names the image: the same key means the same samples, and they are kept for it. What they are is said at
    :class:`viewer.layered.layered_image.LayeredImage`: ``starts`` (pixels + 1,), and of m samples ``depths`` (m,), ``slopes``
    (m, 2), ``reaches`` (m, 4), ``colors`` (m, 3) and ``objects`` (m,).
    """

    key: str
    view: View
    starts: NDArray[np.int32]
    depths: NDArray[np.float32]
    slopes: NDArray[np.float32]
    reaches: NDArray[np.uint8]
    colors: NDArray[np.uint8]
    objects: NDArray[np.int32]
