"""Drawn pictures as the one that is shown: which part of the window each takes, and what two of them come to.

panels       what has to be drawn for a look, and where in the window it goes
difference   by how much two pictures differ
wrong        where a picture shows another object than the geometry does
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from viewer.measuring.view_errors import WrongRegions
from viewer.window.look import Look

__all__ = ["BLINK", "Panel", "depth_picture", "difference", "objects_picture", "panels", "thick", "wrong"]

BLINK = 0.5
"""Seconds that a blinking picture shows each technique."""
_GAIN = 4
"""By how much differences are brightened."""
_THIN, _WRONG, _HOLE = (225, 205, 90), (235, 60, 40), (60, 130, 255)
_FARTHEST = 1500.0


@dataclass(frozen=True, slots=True)
class Panel:
    """A technique's part of the window: columns ``first`` to before ``end``.

    It is a picture of its own, or, where ``whole``, those columns of a picture of the whole window.
    """

    technique: str
    first: int
    end: int
    whole: bool = True


def panels(look: Look, size: tuple[int, int], *, blinked: bool = False) -> tuple[Panel, ...]:
    """The panels that ``look`` has in a window of ``size``; ``blinked``: it is the left technique's turn."""
    width = size[0]
    left, right = look.left, look.right
    match look.mode:
        case "side":
            half = width // 2
            return Panel(left, 0, half, whole=False), Panel(right, half, width, whole=False)
        case "swipe":
            cut = 0 if left == right else round(look.swipe * width)
            found = (Panel(left, 0, cut), Panel(right, cut, width))
            return tuple(one for one in found if one.first < one.end)
        case "blink":
            return (Panel(left if blinked else right, 0, width),)
        case "difference":
            return Panel(left, 0, width), Panel(right, 0, width)
        case _:
            return (Panel(right, 0, width),)


def difference(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """By how much two pictures (h, w, 3) differ, brightened: black where they are equal."""
    away = np.maximum(a, b)
    away -= np.minimum(a, b)
    np.minimum(away, 255 // _GAIN, out=away)
    away *= _GAIN
    return away


def thick(wrong: NDArray[np.bool_], pixels: float) -> NDArray[np.bool_]:
    """Those of (h, w) wrong pixels that lie in a wrong square of about so many ``pixels`` a side: thinner parts vanish."""
    side = round(pixels)
    if side <= 1 or not wrong.any():
        return wrong
    kept = ndimage.minimum_filter(wrong.view(np.uint8), side, mode="constant")
    found: NDArray[np.bool_] = ndimage.maximum_filter(kept, side, mode="constant", origin=-(1 - side % 2)).view(
        np.bool_
    )
    return found


def wrong(shown: NDArray[np.uint8], regions: WrongRegions, thick: WrongRegions) -> NDArray[np.uint8]:
    """The picture (h, w, 3) in grey, and over it wrong pixels in yellow; those of ``thick`` regions in red, holes in blue."""
    picture = np.repeat((shown.sum(axis=2, dtype=np.uint16) // 6 + 60).astype(np.uint8)[..., None], 3, axis=2)
    picture[regions.wrong] = _THIN
    picture[thick.wrong] = _WRONG
    picture[thick.holes] = _HOLE
    return picture


def depth_picture(depth: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Depths (h, w) in metres as grey: near is bright, the sky black; each step is a tenth more metres."""
    with np.errstate(divide="ignore"):
        grey = 255.0 * (1.0 - np.log(np.clip(depth, 1.0, None)) / np.log(_FARTHEST))
    grey = np.clip(grey, 20.0, 255.0)
    grey[~np.isfinite(depth)] = 0.0
    return np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)


def objects_picture(ids: NDArray[np.int32]) -> NDArray[np.uint8]:
    """Object ids (h, w) as colours, each its own; ground and sky are dark."""
    mixed = (ids.astype(np.int64) + 3) * 2_654_435_761 % (1 << 32)
    picture = np.stack([(mixed >> shift & 0x7F) + 96 for shift in (5, 13, 21)], axis=-1).astype(np.uint8)
    picture[ids == -1] = (24, 26, 34)
    picture[ids == -2] = (52, 54, 56)
    return picture
