"""A layer's picture in a sector, cut into pieces where its objects leave wide gaps: what is empty takes no memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mmi.capture.dilation import dilate
from mmi.capture.layer_values import DepthTexture
from mmi.foundation.kernels import kernel

__all__ = ["covered_pieces", "covered_windows"]

_PIECE = 4096  # texels: a picture of its own costs about as much as so many empty texels
_COLOR_REACH = 4
"""Texels: colour is dilated this far beyond silhouettes."""


def covered_pieces(texture: DepthTexture, *, quad: int, half_width: float) -> list[DepthTexture]:
    """What shows something, cropped to whole quads and colour dilated.

    What shows nothing within ``half_width`` (tangent) of the middle is left out: where the next sector overlaps, that is its.
    """
    left, top, _, _ = texture.view.window
    pieces = []
    for window in covered_windows(texture, quad=quad):
        rows = slice(window[1] - top, window[1] - top + window[3])
        columns = slice(window[0] - left, window[0] - left + window[2])
        ids = np.ascontiguousarray(texture.object_ids[rows, columns])
        view = texture.view.cropped(window)
        u = view.pixel_centres()[0][(ids >= 0).any(axis=0)]
        if not (np.abs(u) <= half_width * view.focal).any():
            continue
        color = dilate(np.ascontiguousarray(texture.color[rows, columns]), ids >= 0, _COLOR_REACH)
        pieces.append(DepthTexture(view, color, np.ascontiguousarray(texture.depth[rows, columns]), ids))
    return pieces


def covered_windows(texture: DepthTexture, *, quad: int) -> list[tuple[int, int, int, int]]:
    """The pieces of the texture's window that hold something, from left to right, in whole quads; none where nothing does.

    Empty columns of quads separate pieces, each with its own upper and lower edge, unless more than ``_PIECE`` texels are
    not saved by that.
    """
    left, top, _, _ = texture.view.window
    keep = _blocks_with_coverage(texture.coverage, quad)
    columns = np.flatnonzero(keep.any(axis=0))
    if not columns.size:
        return []
    spans: list[tuple[int, int, int, int]] = []  # first and last column, first and last row
    for run in np.split(columns, np.flatnonzero(np.diff(columns) > 1) + 1):
        rows = np.flatnonzero(keep[:, run[0] : run[-1] + 1].any(axis=1))
        span = (int(run[0]), int(run[-1]), int(rows[0]), int(rows[-1]))
        while spans:
            last = spans[-1]
            both = (last[0], span[1], min(last[2], span[2]), max(last[3], span[3]))
            if (_area(both) - _area(last) - _area(span)) * quad * quad > _PIECE:
                break
            spans.pop()
            span = both
        spans.append(span)
    return [(left + c0 * quad, top + r0 * quad, (c1 - c0 + 1) * quad, (r1 - r0 + 1) * quad) for c0, c1, r0, r1 in spans]


def _area(span: tuple[int, int, int, int]) -> int:
    return (span[1] - span[0] + 1) * (span[3] - span[2] + 1)


@kernel()
def _blocks_with_coverage(covered: NDArray[np.bool_], side: int) -> NDArray[np.bool_]:
    """(rows, columns): blocks of ``side`` texels that hold a covered one, or touch one (filtering reaches beyond)."""
    height, width = covered.shape
    blocks = np.zeros((height // side, width // side), dtype=np.bool_)
    for i in range(height):
        for j in range(width):
            if covered[i, j]:
                upper, lower = max(i - 1, 0) // side, min(i + 1, height - 1) // side
                left, right = max(j - 1, 0) // side, min(j + 1, width - 1) // side
                blocks[upper, left] = blocks[upper, right] = blocks[lower, left] = blocks[lower, right] = True
    return blocks
