"""Pictures for people: panels side by side under captions, and files that are written whole or not at all.

All pictures are (h, w, 3) uint8 arrays, sRGB, first row on top.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from scipy import ndimage

from mmi.foundation.srgb import png_bytes
from mmi.foundation.whole_files import write_whole

__all__ = ["save_picture", "side_by_side", "triptych"]

_ORANGE = (230, 159, 0)
_INK = (34, 34, 34)
_WRONG, _HOLE = (255, 255, 255), (255, 0, 255)
_GAP = 4
"""Pixels between panels."""


def triptych(
    truth_color: NDArray[np.uint8],
    shown_color: NDArray[np.uint8],
    wrong: NDArray[np.bool_],
    holes: NDArray[np.bool_],
    *,
    titles: Sequence[str] = ("geometry", "technique", "what is wrong"),
) -> NDArray[np.uint8]:
    """Geometry | technique | dimmed geometry with ``wrong`` (h, w) pixels white and ``holes`` (h, w) magenta.

    A thin orange frame surrounds the thickest region of wrong pixels (the largest of equally thick ones) in all three
    panels: in a picture that is scaled down one would not see it otherwise. Sizes are even. Raises ValueError where sizes
    differ.
    """
    if {truth_color.shape, shown_color.shape, (*wrong.shape, 3), (*holes.shape, 3)} != {truth_color.shape}:
        raise ValueError(
            f"colours (h, w, 3) and masks (h, w) of one size expected, found {truth_color.shape}, {shown_color.shape}, "
            f"{wrong.shape}, {holes.shape}"
        )
    marks = truth_color // 4
    marks[wrong] = _WRONG
    marks[holes] = _HOLE
    frame = _thickest(wrong | holes)
    panels = (truth_color, shown_color, marks)
    return side_by_side(panels if frame is None else [_framed(panel, frame) for panel in panels], titles)


def side_by_side(panels: Sequence[NDArray[np.uint8]], titles: Sequence[str]) -> NDArray[np.uint8]:
    """Panels of one size from left to right, a caption over each. Width and height are even, as videos want them.

    Raises ValueError where panels differ in size, or have no title.
    """
    if len(panels) != len(titles) or len({panel.shape for panel in panels}) != 1:
        shapes = ", ".join(str(panel.shape) for panel in panels)
        raise ValueError(f"panels of one size and a title for each expected, found {shapes} and {len(titles)} titles")
    height, width = panels[0].shape[:2]
    size = max(12, width // 24)
    font = ImageFont.load_default(size)
    strip = size + size // 2
    whole = (strip + height, len(panels) * (width + _GAP) - _GAP)
    result = np.full((whole[0] + whole[0] % 2, whole[1] + whole[1] % 2, 3), 255, dtype=np.uint8)
    for place, (panel, title) in enumerate(zip(panels, titles, strict=True)):
        left = place * (width + _GAP)
        caption = Image.new("RGB", (width, strip), (255, 255, 255))
        ImageDraw.Draw(caption).text((size // 3, strip // 2), title, fill=_INK, font=font, anchor="lm")
        result[:strip, left : left + width] = caption
        result[strip : strip + height, left : left + width] = panel
    return result


def save_picture(path: Path, pixels: NDArray[np.uint8]) -> None:
    """Write ``pixels`` as PNG; the same pixels give the same bytes. Raises DatasetError where that is impossible."""
    write_whole(path, png_bytes(pixels))


def _thickest(region: NDArray[np.bool_]) -> tuple[slice, slice] | None:
    """(rows, columns) of the connected part of ``region`` with the largest disc in it; None where it is empty."""
    labels, count = ndimage.label(region, structure=np.ones((3, 3)))
    if count == 0:
        return None
    names = np.arange(1, count + 1)
    depths = ndimage.maximum(ndimage.distance_transform_edt(np.pad(region, 1))[1:-1, 1:-1], labels, names)
    pixels = np.bincount(labels.ravel())[1:]
    best = np.lexsort((-pixels, -np.asarray(depths)))[0]
    rows, columns = ndimage.find_objects(labels)[best]
    return rows, columns


def _framed(panel: NDArray[np.uint8], part: tuple[slice, slice]) -> NDArray[np.uint8]:
    """``panel`` with an orange frame around ``part``, which it leaves free where it fits into the panel."""
    height, width = panel.shape[:2]
    line = max(2, width // 320)
    free = max(2 * line, width // 64)
    image = Image.fromarray(panel)
    corners = (
        max(part[1].start - free, 0),
        max(part[0].start - free, 0),
        min(part[1].stop - 1 + free, width - 1),
        min(part[0].stop - 1 + free, height - 1),
    )
    ImageDraw.Draw(image).rectangle(corners, outline=_ORANGE, width=line)
    return np.asarray(image)
