"""Cut-outs: pictures with clear texels, such as leaves and railings, where a surface shows what is behind it.

A texel is clear where its alpha is below 128; nothing is half clear. Of the levels that filters take, each halves the one
before it by a box. The mean alpha of foliage lies below 128 or above it, so that from afar a crown would vanish or become a
ball: at each level the alpha of every square of 64 texels of the finest level (larger ones where it would have fewer than 4 x 4
texels) is multiplied by what leaves as large a share of it solid as there. Where many texels have the same alpha, as of a
regular fence, some of them become solid. All that draws and all that casts rays takes the levels from here.

Source: I. Castano, Computing Alpha Mipmaps (2010), which scales the alpha of whole pictures; an atlas holds many.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from mmi.foundation.kernels import kernel

__all__ = [
    "CLEAR_BELOW",
    "AlphaLevels",
    "ClearBlocks",
    "alpha_levels",
    "clear_at",
    "clear_blocks",
    "cut_out_triangles",
    "dilated",
    "is_clear",
    "texture_levels",
    "with_solid_share",
]

CLEAR_BELOW = 128
"""The least alpha of a texel that is solid."""
_TILE = 64  # texels of the finest level
_LEAST_TILE = 4  # texels of any level
_STEP = 32  # how far from the limit alphas lie of which some are solid
_BLOCK = 4  # texels a side that are clear together where triangles are told apart: less than the margin of an atlas's pictures


@dataclass(frozen=True, slots=True, eq=False)
class AlphaLevels:
    """The alpha of all levels of a texture: ``texels`` (n,) uint8, level after level, the finest first and row after row.

    Level k has ``sizes[k]`` (height, width) texels and begins at ``starts[k]``, both int64.
    """

    texels: NDArray[np.uint8]
    sizes: NDArray[np.int64]
    starts: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class ClearBlocks:
    """Where a texture of ``size`` (width, height) has clear texels.

    ``before`` (rows + 1, columns + 1) counts the blocks of 4 x 4 texels with any that lie above and left of a block.
    """

    before: NDArray[np.int64]
    size: tuple[int, int]


def alpha_levels(texture: NDArray[np.uint8]) -> AlphaLevels:
    """The alpha of :func:`texture_levels`, for :func:`is_clear`."""
    levels = texture_levels(texture[..., 3:])
    sizes = np.array([one.shape[:2] for one in levels], dtype=np.int64)
    starts = np.concatenate([[0], np.cumsum(sizes.prod(axis=1))[:-1]])
    texels = np.concatenate([one.reshape(-1) for one in levels])
    for array in (texels, sizes, starts):
        array.setflags(write=False)
    return AlphaLevels(texels, sizes, starts)


@kernel(nogil=True)
def is_clear(
    texels: NDArray[np.uint8],
    sizes: NDArray[np.int64],
    starts: NDArray[np.int64],
    u: float,
    v: float,
    level: float,
) -> bool:
    """Whether the texel that holds (``u``, ``v`` down) is clear at the level nearest to ``level``; the texture repeats.

    The arrays are those of :class:`AlphaLevels`. :func:`clear_at` is its twin.
    """
    k = min(max(math.floor(level + 0.5), 0), len(sizes) - 1)
    height, width = sizes[k, 0], sizes[k, 1]
    row, column = math.floor(v * height) % height, math.floor(u * width) % width
    return bool(texels[starts[k] + row * width + column] < CLEAR_BELOW)


def clear_at(levels: AlphaLevels, uv: NDArray[np.float64], level: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(n,) what :func:`is_clear` says of coordinates ``uv`` (n, 2), v down, at ``level`` (n,)."""
    k = np.clip(np.floor(level + 0.5).astype(np.int64), 0, len(levels.sizes) - 1)
    sizes = levels.sizes[k]
    row, column = (np.floor(uv[:, i] * sizes[:, 1 - i]).astype(np.int64) % sizes[:, 1 - i] for i in (1, 0))
    return levels.texels[levels.starts[k] + row * sizes[:, 1] + column] < CLEAR_BELOW


def texture_levels(texture: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    """All levels of a texture (h, w, c), whose last channel is alpha, the finest first, down to one texel.

    A level has half the rows and columns of the one before it, rounded down, at least one; the last has what is left over.
    """
    box, solid = np.ascontiguousarray(texture), np.where(texture[..., -1:] < CLEAR_BELOW, np.uint8(0), np.uint8(255))
    levels = [box]
    while max(box.shape[:2]) > 1:
        box, solid = _halved(box), _halved(solid)
        level = box.copy()
        level[..., -1] = with_solid_share(box[..., -1], solid[..., 0], tile=max(_TILE >> len(levels), _LEAST_TILE))
        levels.append(level)
    return levels


def with_solid_share(alpha: NDArray[np.uint8], share: NDArray[np.uint8], *, tile: int) -> NDArray[np.uint8]:
    """``alpha`` (h, w), in each square of ``tile`` texels a side so that as many are solid as ``share`` (h, w) says.

    Of that, 255 is a whole texel. Those of the largest alpha are solid; of equal ones, some here and there.
    """
    return _shared(np.ascontiguousarray(alpha), np.ascontiguousarray(share), tile)


def dilated(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The image (h, w, 4) with clear texels in the colour of the nearest solid one; none where all are clear."""
    clear = image[..., 3] < CLEAR_BELOW
    if clear.all() or not clear.any():
        return image
    rows, columns = distance_transform_edt(clear, return_distances=False, return_indices=True)
    return np.dstack([image[rows, columns, :3], image[..., 3]])


def clear_blocks(texture: NDArray[np.uint8]) -> ClearBlocks:
    """Where ``texture`` (h, w, 3 or 4) is clear."""
    height, width = texture.shape[:2]
    rows, columns = -(-height // _BLOCK), -(-width // _BLOCK)
    clear = np.zeros((rows * _BLOCK, columns * _BLOCK), dtype=np.bool_)
    if texture.shape[2] == 4:
        clear[:height, :width] = texture[..., 3] < CLEAR_BELOW
    blocks = clear.reshape(rows, _BLOCK, columns, _BLOCK).any(axis=(1, 3))
    before = np.zeros((rows + 1, columns + 1), dtype=np.int64)
    before[1:, 1:] = blocks.cumsum(axis=0).cumsum(axis=1)
    return ClearBlocks(before, (width, height))


def cut_out_triangles(blocks: ClearBlocks, uv: NDArray[np.float32], triangles: NDArray[np.int32]) -> NDArray[np.bool_]:
    """(m,) whether clear texels may lie in the rectangles of coordinates ``uv`` (n, 2) of ``triangles`` (m, 3).

    The others are solid at each level, whatever lies beside their pictures.
    """
    corners = uv[triangles].astype(np.float64)
    low, high = corners.min(axis=1), corners.max(axis=1)
    beyond = (low < -1e-6) | (high > 1.0 + 1e-6)  # the texture repeats: all of that row or column counts
    low, high = np.where(beyond, 0.0, low), np.where(beyond, 1.0, high)
    size, most = np.array(blocks.size), np.array(blocks.before.shape[::-1]) - 1
    first = np.clip(np.floor(low * size / _BLOCK + 1e-6).astype(np.int64), 0, most - 1)
    end = np.clip(np.ceil(high * size / _BLOCK - 1e-6).astype(np.int64), first + 1, most)
    (x0, y0), (x1, y1) = first.T, end.T
    before = blocks.before
    return before[y1, x1] - before[y0, x1] - before[y1, x0] + before[y0, x0] > 0


@kernel()
def _halved(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(h, w, c) -> (h // 2, w // 2, c), at least one row and column: means, halves rounded up."""
    height, width, channels = pixels.shape
    rows, columns = max(height // 2, 1), max(width // 2, 1)
    found = np.empty((rows, columns, channels), dtype=np.uint8)
    for i in range(rows):
        bottom = height if i == rows - 1 else 2 * i + 2
        for j in range(columns):
            right = width if j == columns - 1 else 2 * j + 2
            count = (bottom - 2 * i) * (right - 2 * j)
            for c in range(channels):
                total = count // 2
                for y in range(2 * i, bottom):
                    for x in range(2 * j, right):
                        total += pixels[y, x, c]
                found[i, j, c] = total // count
    return found


@kernel()
def _shared(alpha: NDArray[np.uint8], share: NDArray[np.uint8], tile: int) -> NDArray[np.uint8]:
    """The kernel of :func:`with_solid_share`."""
    height, width = alpha.shape
    found = alpha.copy()
    for top in range(0, height, tile):
        for left in range(0, width, tile):
            bottom, right = min(top + tile, height), min(left + tile, width)
            histogram = np.zeros(256, dtype=np.int64)
            wanted = 0
            for y in range(top, bottom):
                for x in range(left, right):
                    histogram[alpha[y, x]] += 1
                    wanted += share[y, x]
            wanted = (wanted + 127) // 255
            # Alpha ``value`` divides: all above it are solid, and ``needed`` of the ``equal`` that have it.
            value, above = 255, 0
            while value > 0 and above + histogram[value] < wanted:
                above += histogram[value]
                value -= 1
            equal, needed = histogram[value], wanted - above
            below = value - 1
            while below >= 0 and histogram[below] == 0:
                below -= 1
            if wanted == 0:
                factor = min(1.0, (CLEAR_BELOW - 1) / max(value, 1))
            elif needed < equal or value == 0:
                factor = (CLEAR_BELOW - 0.5) / max(value, 0.5)
            elif below < 0:
                factor = max(1.0, CLEAR_BELOW / value)
            else:
                factor = (CLEAR_BELOW - 0.5) / (0.5 * (value + below))
            met = 0
            for y in range(top, bottom):
                for x in range(left, right):
                    found[y, x] = min(255.0, np.rint(factor * alpha[y, x]))
                    if wanted > 0 and alpha[y, x] == value and (needed < equal or value == 0):
                        solid = (met + 1) * needed // equal > met * needed // equal
                        found[y, x] = CLEAR_BELOW + _STEP if solid else CLEAR_BELOW - 1 - _STEP
                        met += 1
    return found
