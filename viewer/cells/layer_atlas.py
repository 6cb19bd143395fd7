"""One picture for all layers of a cell, so that they are few draws: where each layer's pictures go, and what borders it.

Pictures stand on shelves (``mmi.foundation.shelves``). Around each is a border of repeated texels, so that filtering at a
picture's edge never meets another.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.shelves import on_shelves

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
    corners, (used, height) = on_shelves(np.array(sizes, dtype=np.int64).reshape(-1, 2), widest)
    return [(x, y) for x, y in corners.tolist()], (max(used, 1), max(height, 1))


def bordered(picture: NDArray[_Kind]) -> NDArray[_Kind]:
    """``picture`` (h, w, ...) with its border: (h + 2 BORDER, w + 2 BORDER, ...)."""
    height, width = picture.shape[:2]
    result = np.empty((height + 2 * BORDER, width + 2 * BORDER, *picture.shape[2:]), dtype=picture.dtype)
    inner = result[BORDER:-BORDER]
    inner[:, BORDER:-BORDER], inner[:, :BORDER], inner[:, -BORDER:] = picture, picture[:, :1], picture[:, -1:]
    result[:BORDER], result[-BORDER:] = inner[0], inner[-1]
    return result
