"""One picture for all layers of a cell, so that they are few draws: where each layer's pictures go, and what borders it.

Shelves: pictures sorted by height stand side by side in rows as high as their first. Between them is a border of repeated
texels, so that filtering at a picture's edge never meets another.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

__all__ = ["BORDER", "bordered", "shelves"]

_Kind = TypeVar("_Kind", bound=np.generic)

BORDER = 2
"""Texels around each picture that repeat its outermost ones."""


def shelves(sizes: Sequence[tuple[int, int]]) -> tuple[list[tuple[int, int]], tuple[int, int]]:
    """Where pictures of ``sizes`` (width, height) go: their upper left corners (x, y), and the size of the whole.

    The whole is about square, and at least one texel large.
    """
    area = sum(width * height for width, height in sizes)
    widest = max([1, round(1.1 * area**0.5), *(width for width, _ in sizes)])
    corners = [(0, 0)] * len(sizes)
    x = y = shelf = used = 0
    for i in sorted(range(len(sizes)), key=lambda i: (-sizes[i][1], -sizes[i][0], i)):
        width, height = sizes[i]
        if x + width > widest:
            x, y, shelf = 0, y + shelf, 0
        shelf = max(shelf, height)
        corners[i] = (x, y)
        x += width
        used = max(used, x)
    return corners, (max(used, 1), max(y + shelf, 1))


def bordered(picture: NDArray[_Kind]) -> NDArray[_Kind]:
    """``picture`` (h, w, ...) with its border: (h + 2 BORDER, w + 2 BORDER, ...)."""
    height, width = picture.shape[:2]
    result = np.empty((height + 2 * BORDER, width + 2 * BORDER, *picture.shape[2:]), dtype=picture.dtype)
    inner = result[BORDER:-BORDER]
    inner[:, BORDER:-BORDER], inner[:, :BORDER], inner[:, -BORDER:] = picture, picture[:, :1], picture[:, -1:]
    result[:BORDER], result[-BORDER:] = inner[0], inner[-1]
    return result
