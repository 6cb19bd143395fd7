"""Layered depth images (Aliaga & Lastra 1999, section 4; Shade et al. 1998): several samples a pixel, from near to far.

A sample stands for a *patch*: the part of a plane within its pixel's pyramid. 1 / depth is linear in the coordinates of a
picture of a plane, so that a depth at the pixel's centre and two slopes say what plane that is. Patches of neighbours on one
plane meet exactly, from wherever one looks, and none reaches out of its pixel: warping needs no sizes of splats, and the
order of pixels is enough to tell what hides what.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View

__all__ = ["HALF", "MOST_LAYERS", "NOTHING", "LayeredImage", "Picture"]

HALF = 15
"""Half a pixel as :class:`LayeredImage` has reaches."""

MOST_LAYERS = 255
"""Samples that a pixel has at most."""
NOTHING = -1
"""The object of a pixel that shows nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """What the renderer drew of some triangles as ``view`` sees them, top row first.

    ``color`` (h, w, 3) uint8 sRGB, ``depth`` (h, w) float32 metres along the view's axis, infinite where nothing is, ``ids``
    (h, w) int32 objects. Raises ValueError for arrays of other sizes than the view's window, and for
    depths that are not above 0, which is what a renderer leaves where it draws no sky.
    """

    view: View
    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    ids: NDArray[np.int32]

    def __post_init__(self) -> None:
        width, height = self.view.window[2:]
        for name, shape in (("color", (height, width, 3)), ("depth", (height, width)), ("ids", (height, width))):
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} of shape {shape} expected, found {getattr(self, name).shape}")
        if not (self.depth > 0.0).all():
            raise ValueError(f"depths above 0 expected, infinite for nothing, found {self.depth.min():g}")


@dataclass(frozen=True, slots=True, eq=False)
class LayeredImage:
    """Samples of the pixels of ``view``, row by row from the top: those of pixel i are ``starts[i]`` to ``starts[i + 1] - 1``.

    ``starts`` (h * w + 1,) int32; of m samples, each pixel's from near to far, the ``depths`` (m,) float32, metres along the
    view's axis at the pixel's centre; the ``slopes`` (m, 2) float32 of 1 / depth, per pixel to the right and down; the
    ``reaches`` (m, 4) uint8 of patches from the centre to the left, to the right, up and down, ``HALF`` for half a pixel, which
    is the most; the ``colors`` (m, 3) uint8 sRGB and the objects ``ids`` (m,) int32. Arrays cannot be written to.
    """

    view: View
    starts: NDArray[np.int32]
    depths: NDArray[np.float32]
    slopes: NDArray[np.float32]
    reaches: NDArray[np.uint8]
    colors: NDArray[np.uint8]
    ids: NDArray[np.int32]

    def __post_init__(self) -> None:
        pixels, samples = self.view.window[2] * self.view.window[3], len(self.depths)
        shapes = {
            "starts": (pixels + 1,),
            "slopes": (samples, 2),
            "reaches": (samples, 4),
            "colors": (samples, 3),
            "ids": (samples,),
        }
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} of shape {shape} expected, found {getattr(self, name).shape}")
        for name in ("starts", "depths", "slopes", "reaches", "colors", "ids"):
            getattr(self, name).setflags(write=False)

    @property
    def counts(self) -> NDArray[np.int32]:
        """(h, w) samples of each pixel."""
        return np.diff(self.starts).reshape(self.view.window[3], self.view.window[2])
