"""Pictures of what is not a colour: depth, objects, differences, wrong surfaces. Plain functions from arrays to sRGB.

All are (h, w, 3) uint8, C-contiguous. The scales can be told apart by colour-blind readers, and by how light they are alone:
depth and differences run through the anchors of viridis and inferno (Smith & van der Walt 2015).
"""

from __future__ import annotations

import colorsys
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.kernels import kernel
from viewer.measuring.view_errors import WrongRegions

__all__ = ["GROUND", "HOLE", "SKY", "WRONG", "depth_picture", "difference_picture", "objects_picture", "wrong_picture"]

SKY = (214, 224, 235)
"""The sky, where depth or objects are shown."""
GROUND = (92, 92, 96)
"""The ground, where objects are shown."""
WRONG = (255, 122, 0)
"""A pixel that shows another object than the geometry does."""
HOLE = (0, 178, 255)
"""A pixel that shows ground or sky where the geometry shows an object."""
_NEAREST, _FARTHEST = 2.0, 2000.0
"""Metres at which the scale of depths begins and ends."""
_STEPS = 4096
_VIRIDIS = ((253, 231, 37), (94, 201, 98), (33, 145, 140), (59, 82, 139), (68, 1, 84))
_INFERNO = ((0, 0, 4), (87, 16, 110), (188, 55, 84), (249, 142, 9), (252, 255, 164))
_LARGEST_DIFFERENCE = 96
"""Differences of so many steps of 255 or more are all as bright as can be; smaller ones are raised so that they show."""
_PALE = 96
"""What a black pixel becomes where wrong surfaces are shown."""
_GOLDEN = 0.6180339887498949
_MOST_COLORS = 1 << 16
"""So many objects have colours of their own; those beyond begin with the first again."""


def depth_picture(depth: NDArray[np.float32]) -> NDArray[np.uint8]:
    """How far things are: ``depth`` (h, w) metres, ``inf`` for the sky. Bright is near; equal factors are equal steps."""
    share = np.log(np.clip(depth, _NEAREST, _FARTHEST) / np.float32(_NEAREST)) / np.float32(
        np.log(_FARTHEST / _NEAREST)
    )
    places = (share * np.float32(_STEPS - 1)).astype(np.int32)
    places[np.isinf(depth)] = _STEPS
    return _looked_up(places, _depth_colors())


def objects_picture(ids: NDArray[np.int32]) -> NDArray[np.uint8]:
    """Which object each pixel shows: ``ids`` (h, w), -2 the ground, -1 the sky. An id has the same colour in every picture."""
    return _looked_up(np.where(ids < 0, ids, ids & (_MOST_COLORS - 1)) + 2, _object_colors())


def difference_picture(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """How much two pictures (h, w, 3) differ, in the channel in which they differ most: black where they are alike.

    Raises ValueError for pictures of different sizes.
    """
    if one.shape != other.shape:
        raise ValueError(f"two pictures of one size expected, found {one.shape} and {other.shape}")
    return _differences(one, other, _difference_colors())


def wrong_picture(shown: NDArray[np.uint8], regions: WrongRegions) -> NDArray[np.uint8]:
    """``shown`` (h, w, 3) pale and grey, and on it the pixels that are wrong and those that are holes.

    Raises ValueError for regions of another size.
    """
    if shown.shape[:2] != regions.wrong.shape:
        raise ValueError(f"regions of size {shown.shape[:2]} expected, found {regions.wrong.shape}")
    return _marked(shown, regions.wrong, regions.holes, np.array([WRONG, HOLE], dtype=np.uint8))


@kernel(nogil=True)
def _looked_up(places: NDArray[np.int32], colors: NDArray[np.uint8]) -> NDArray[np.uint8]:
    found = np.empty((*places.shape, 3), dtype=np.uint8)
    for i in range(places.shape[0]):
        for j in range(places.shape[1]):
            for k in range(3):
                found[i, j, k] = colors[places[i, j], k]
    return found


@kernel(nogil=True)
def _differences(one: NDArray[np.uint8], other: NDArray[np.uint8], colors: NDArray[np.uint8]) -> NDArray[np.uint8]:
    found = np.empty(one.shape, dtype=np.uint8)
    for i in range(one.shape[0]):
        for j in range(one.shape[1]):
            largest = np.int64(0)
            for k in range(3):
                largest = max(largest, abs(np.int64(one[i, j, k]) - np.int64(other[i, j, k])))
            for k in range(3):
                found[i, j, k] = colors[largest, k]
    return found


@kernel(nogil=True)
def _marked(
    shown: NDArray[np.uint8], wrong: NDArray[np.bool_], holes: NDArray[np.bool_], colors: NDArray[np.uint8]
) -> NDArray[np.uint8]:
    found = np.empty(shown.shape, dtype=np.uint8)
    for i in range(shown.shape[0]):
        for j in range(shown.shape[1]):
            light = (
                77 * np.int64(shown[i, j, 0]) + 150 * np.int64(shown[i, j, 1]) + 29 * np.int64(shown[i, j, 2])
            ) >> 8
            for k in range(3):
                if wrong[i, j]:
                    found[i, j, k] = colors[np.int64(holes[i, j]), k]
                else:
                    found[i, j, k] = _PALE + (light >> 1)
    return found


@lru_cache(maxsize=1)
def _depth_colors() -> NDArray[np.uint8]:
    """(steps + 1, 3), the last one the sky's."""
    return _fixed(np.vstack([_ramp(_VIRIDIS, np.linspace(0.0, 1.0, _STEPS)), np.array(SKY)]))


@lru_cache(maxsize=1)
def _difference_colors() -> NDArray[np.uint8]:
    """(256, 3) by difference."""
    return _fixed(_ramp(_INFERNO, np.sqrt(np.minimum(np.arange(256) / _LARGEST_DIFFERENCE, 1.0))))


@lru_cache(maxsize=1)
def _object_colors() -> NDArray[np.uint8]:
    """(n + 2, 3): ground, sky, and objects. Hues go round by the golden section, so that ids next to each other, which are
    often neighbours, are far apart; lightness and saturation change with them.
    """
    shades = ((0.95, 0.55), (0.70, 0.75), (1.0, 0.35), (0.52, 0.65))
    colors = [
        colorsys.hsv_to_rgb(i * _GOLDEN % 1.0, saturation, value)
        for i in range(_MOST_COLORS)
        for value, saturation in (shades[i % len(shades)],)
    ]
    return _fixed(np.vstack([np.array([GROUND, SKY]), 255.0 * np.array(colors)]))


def _ramp(anchors: tuple[tuple[int, int, int], ...], at: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) colours between evenly spaced ``anchors`` at shares ``at`` (n,)."""
    places = np.linspace(0.0, 1.0, len(anchors))
    return np.stack([np.interp(at, places, channel) for channel in np.array(anchors, dtype=np.float64).T], axis=1)


def _fixed(colors: NDArray[np.generic]) -> NDArray[np.uint8]:
    found = np.rint(colors.astype(np.float64)).astype(np.uint8)
    found.setflags(write=False)
    return found
