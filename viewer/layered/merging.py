"""Pictures of the same triangles from several viewpoints, made one layered image (section 4.1).

The first picture is the image's own: its pixels are the first layer, just as they are. Of the others come, in their order,
samples that no earlier one has: each pixel is a patch of a plane, and gives a sample to each of the image's pixels whose centre
the patch covers as the image sees it, exactly at that centre. It is left out where

    the first picture sees through it   it sees something farther, or nothing: what would be there is no surface
    the pixel has it already            a sample of the same object is nowhere farther off than a tolerance

The tolerance is in pixels of the image: by so much two points on one of its rays are apart at most, as seen from anywhere
within the radius that the image serves. Samples of slanted surfaces may differ by a quarter of what they cover besides. Where
a later picture has finer pixels, its slopes count.

At last, patches that have no neighbour of their surface on a side end there where one of the other pictures sees past them:
slanted ones would otherwise reach far over their surface's border.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.kernels import kernel
from viewer.layered.layered_image import HALF, MOST_LAYERS, LayeredImage, Picture
from viewer.layered.warping import REACH, between, covered

__all__ = ["merged", "slopes_of"]

_STEEPEST = 12.0
"""The tangent of the steepest angle with the picture that two pixels alone may tell: they may be of two surfaces."""
_ALIKE = 0.25
"""A steep surface goes on where 1 / depth changes from the neighbour to the next as before, but for this share."""
_SLANTED = 0.25
_BENT = 8.0
"""How many times the tolerance an object may be behind a patch of its own that does not reach over its border: it is bent."""
_HAIR = 1e-6
"""Pixels, and a share of 1 / depth, that rounding stays far below."""
_FINER = 0.5
"""A picture whose pixels cover less than this share of what those cover that told a slope tells it better."""


class _Store(NamedTuple):
    """Room for samples in the order in which they are found; ``before`` is the one found before in the same pixel, or -1.

    ``areas`` are what a pixel of the picture that told the slopes covers, in pixels of the image.
    """

    near: NDArray[np.float64]
    slopes: NDArray[np.float32]
    colors: NDArray[np.uint8]
    ids: NDArray[np.int32]
    areas: NDArray[np.float32]
    pixels: NDArray[np.int32]
    before: NDArray[np.int32]


def merged(pictures: Sequence[Picture], *, radius: float, tolerance_px: float = 0.5) -> LayeredImage:
    """One image of all ``pictures``, in the view of the first, for eyes within ``radius`` metres of it.

    Of more than ``MOST_LAYERS`` samples in a pixel, the nearest are kept. Raises ValueError without a picture, or for a radius
    or tolerance that is not above 0.
    """
    if not pictures or not radius > 0.0 or not tolerance_px > 0.0:
        raise ValueError(f"pictures, radius and tolerance expected, found {len(pictures)}, {radius} and {tolerance_px}")
    own = pictures[0]
    width, height = own.view.window[2:]
    there = np.isfinite(own.depth)
    pixels = np.flatnonzero(there).astype(np.int32)
    count = len(pixels)
    store = _room(2 * count + 1024)
    store.near[:count], store.slopes[:count] = 1.0 / own.depth[there].astype(np.float64), slopes_of(own)[there]
    store.colors[:count], store.ids[:count] = own.color[there], own.ids[there]
    store.areas[:count], store.pixels[:count], store.before[:count] = 1.0, pixels, -1
    latest = np.full(width * height, -1, dtype=np.int32)
    latest[pixels] = np.arange(count)
    first = np.zeros(width * height)
    first[pixels] = store.near[:count]
    tolerance = tolerance_px / (own.view.focal * radius)
    slopes = [slopes_of(picture) for picture in pictures[1:]]
    for picture, of_picture in zip(pictures[1:], slopes, strict=True):
        shown = (picture.color, picture.depth, picture.ids, of_picture)
        matrix, is_full = between(picture.view, own.view), True
        while is_full:  # what was added before there was no more room is there already, and is not added again
            count, is_full = _add(*shown, matrix, width, height, tolerance, first, latest, count, store)
            if is_full:
                store = _Store(*(np.concatenate([values, np.empty_like(values)]) for values in store))
    order = np.lexsort((-store.near[:count], store.pixels[:count]))
    counts = np.bincount(store.pixels[:count], minlength=width * height)
    layers = np.arange(count) - np.repeat(np.cumsum(counts) - counts, counts)
    order = order[layers < MOST_LAYERS]
    starts = np.zeros(width * height + 1, dtype=np.int32)
    np.cumsum(np.minimum(counts, MOST_LAYERS), out=starts[1:])
    near, bends, ids = store.near[order], store.slopes[order], store.ids[order]
    reaches = np.full((len(order), 4), HALF, dtype=np.uint8)
    is_border = np.empty((len(order), 4), dtype=bool)
    _find_borders(starts, width, near, bends, ids, tolerance, is_border)
    for picture, of_picture in zip(pictures[1:], slopes, strict=True):
        matrix = between(own.view, picture.view)
        _shorten(
            picture.depth,
            of_picture,
            picture.ids,
            matrix,
            starts,
            width,
            near,
            bends,
            ids,
            is_border,
            tolerance,
            reaches,
        )
    depths = (1.0 / near).astype(np.float32)
    return LayeredImage(own.view, starts, depths, bends, reaches, store.colors[order], ids)


def slopes_of(picture: Picture) -> NDArray[np.float32]:
    """(h, w, 2) by how much 1 / depth grows per pixel to the right and down, along the surface that each pixel shows.

    Of the neighbours of the same object on both sides, the one counts that is better on a line with the one beyond it. What is
    steeper than a tangent of ``_STEEPEST`` counts as two surfaces, and as facing the eye, unless the one beyond goes on alike.
    """
    found = np.zeros((*picture.depth.shape, 2), dtype=np.float32)
    near = 1.0 / picture.depth.astype(np.float64)
    _slopes(near, picture.ids, _STEEPEST / picture.view.focal, found[..., 0])
    _slopes(near.T, picture.ids.T, _STEEPEST / picture.view.focal, found[..., 1].T)
    return found


def _room(count: int) -> _Store:
    return _Store(
        np.empty(count),
        np.empty((count, 2), np.float32),
        np.empty((count, 3), np.uint8),
        np.empty(count, np.int32),
        np.empty(count, np.float32),
        np.empty(count, np.int32),
        np.empty(count, np.int32),
    )


@kernel(error_model="numpy", nogil=True)
def _slopes(near: NDArray[np.float64], ids: NDArray[np.int32], steepest: float, found: NDArray[np.float32]) -> None:
    """Along rows. ``near`` is 0 where nothing is; ``steepest`` the largest change as a share where nothing else tells."""
    height, width = near.shape
    for y in range(height):
        for x in range(width):
            here, best, slope = near[y, x], np.inf, 0.0
            if here <= 0.0:
                continue
            for side in (-1, 1):
                x1, x2 = x + side, x + 2 * side
                if not (0 <= x1 < width and near[y, x1] > 0.0 and ids[y, x1] == ids[y, x]):
                    continue
                change, bends = near[y, x1] - here, np.inf
                if 0 <= x2 < width and near[y, x2] > 0.0 and ids[y, x2] == ids[y, x]:
                    bends = abs(near[y, x2] - near[y, x1] - change)
                if abs(change) > steepest * here and bends > _ALIKE * abs(change):
                    continue
                bends = min(bends, steepest * here)
                if bends < best:
                    best, slope = bends, side * change
            found[y, x] = min(max(slope, -0.9 * here), 0.9 * here)


@kernel(error_model="numpy", nogil=True)
def _add(
    color: NDArray[np.uint8],
    depth: NDArray[np.float32],
    ids: NDArray[np.int32],
    slopes: NDArray[np.float32],
    matrix: NDArray[np.float64],
    width: int,
    height: int,
    tolerance: float,
    first: NDArray[np.float64],
    latest: NDArray[np.int32],
    count: int,
    store: _Store,
) -> tuple[int, bool]:
    """Add a picture's samples that are not there yet to ``count`` of them: how many there are then, and whether room ended.

    ``matrix`` (3, 4) leads from the picture to the image; ``first`` is 1 / depth of the image's own picture, 0 for nothing.
    """
    for row in range(depth.shape[0]):
        for column in range(depth.shape[1]):
            near = 1.0 / depth[row, column]
            if near <= 0.0:
                continue
            u, v, gx, gy = column + 0.5, row + 0.5, float(slopes[row, column, 0]), float(slopes[row, column, 1])
            h = _lifted(matrix, u, v, 1.0, near)
            a, b = _lifted(matrix, 1.0, 0.0, 0.0, gx), _lifted(matrix, 0.0, 1.0, 0.0, gy)
            x0, x1, y0, y1 = covered(h, a, b, 0, width, 0, height)
            if x0 >= x1 or y0 >= y1:
                continue
            # The plane as the image sees it: 1 / depth = p[0] x + p[1] y + p[2].
            hb, ah, ba = _crossed(h, b), _crossed(a, h), _crossed(b, a)
            volume = h[0] * ba[0] + h[1] * ba[1] + h[2] * ba[2]
            p0 = (gx * hb[0] + gy * ah[0] + near * ba[0]) / volume
            p1 = (gx * hb[1] + gy * ah[1] + near * ba[1]) / volume
            p2 = (gx * hb[2] + gy * ah[2] + near * ba[2]) / volume
            area = abs(volume) / (h[2] * h[2] * h[2])
            for y in range(y0, y1):
                for x in range(x0, x1):
                    xc, yc = x + 0.5, y + 0.5
                    s = xc * hb[0] + yc * hb[1] + hb[2]
                    t = xc * ah[0] + yc * ah[1] + ah[2]
                    reach = REACH * abs(xc * ba[0] + yc * ba[1] + ba[2])
                    if not (abs(s) <= reach and abs(t) <= reach and reach > 0.0):
                        continue
                    there, pixel = p0 * xc + p1 * yc + p2, y * width + x
                    if not 0.0 < there <= first[pixel] + tolerance:
                        continue
                    there = min(there, first[pixel])
                    k = latest[pixel]
                    while k >= 0:
                        slanted = _SLANTED * (abs(store.slopes[k, 0]) + abs(store.slopes[k, 1]))
                        if store.ids[k] == ids[row, column] and abs(store.near[k] - there) <= tolerance + slanted:
                            break
                        k = store.before[k]
                    if k >= 0:
                        if area < _FINER * store.areas[k]:
                            store.areas[k] = area
                            store.slopes[k, 0] = min(max(p0, -0.9 * there), 0.9 * there)
                            store.slopes[k, 1] = min(max(p1, -0.9 * there), 0.9 * there)
                        continue
                    if count == len(store.near):
                        return count, True
                    store.near[count], store.ids[count], store.pixels[count] = there, ids[row, column], pixel
                    store.areas[count] = area
                    store.slopes[count, 0] = min(max(p0, -0.9 * there), 0.9 * there)
                    store.slopes[count, 1] = min(max(p1, -0.9 * there), 0.9 * there)
                    for n in range(3):
                        store.colors[count, n] = color[row, column, n]
                    store.before[count] = latest[pixel]
                    latest[pixel] = count
                    count += 1
    return count, False


@kernel(error_model="numpy", nogil=True, inline="always")
def _lifted(matrix: NDArray[np.float64], x: float, y: float, one: float, near: float) -> tuple[float, float, float]:
    return (
        matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * one + matrix[0, 3] * near,
        matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * one + matrix[1, 3] * near,
        matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * one + matrix[2, 3] * near,
    )


@kernel(error_model="numpy", nogil=True, inline="always")
def _crossed(a: tuple[float, float, float], b: tuple[float, float, float]) -> tuple[float, float, float]:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel(error_model="numpy", nogil=True)
def _find_borders(
    starts: NDArray[np.int32],
    width: int,
    near: NDArray[np.float64],
    slopes: NDArray[np.float32],
    ids: NDArray[np.int32],
    tolerance: float,
    is_border: NDArray[np.bool_],
) -> None:
    """Find the sides (m, 4), left, right, up and down, on which samples have no neighbour of their surface."""
    for pixel in range(len(starts) - 1):
        column = pixel % width
        for side in range(4):
            axis, way = side // 2, 2 * (side % 2) - 1
            other = pixel + way * (1 if axis == 0 else width)
            exists = 0 <= column + way < width if axis == 0 else 0 <= other < len(starts) - 1
            for k in range(starts[pixel], starts[pixel + 1]):
                is_border[k, side] = True
                if not exists:
                    continue
                for n in range(starts[other], starts[other + 1]):
                    if ids[n] != ids[k]:
                        continue
                    gap = near[n] - near[k] - 0.5 * way * (slopes[n, axis] + slopes[k, axis])
                    if abs(gap) <= tolerance + _SLANTED * (abs(slopes[n, axis]) + abs(slopes[k, axis])):
                        is_border[k, side] = False
                        break


@kernel(error_model="numpy", nogil=True)
def _shorten(
    depth: NDArray[np.float32],
    picture_slopes: NDArray[np.float32],
    of_picture: NDArray[np.int32],
    matrix: NDArray[np.float64],
    starts: NDArray[np.int32],
    width: int,
    near: NDArray[np.float64],
    slopes: NDArray[np.float32],
    ids: NDArray[np.int32],
    is_border: NDArray[np.bool_],
    tolerance: float,
    reaches: NDArray[np.uint8],
) -> None:
    """Let patches end where a picture sees past them, on the sides where they are at their surface's border.

    A picture that sees a patch smaller than a pixel, or past its middle, cannot tell. ``matrix`` (3, 4) leads from the image to
    the picture.
    """
    for pixel in range(len(starts) - 1):
        u, v = pixel % width + 0.5, pixel // width + 0.5
        for k in range(starts[pixel], starts[pixel + 1]):
            if not (is_border[k, 0] or is_border[k, 1] or is_border[k, 2] or is_border[k, 3]):
                continue
            middle = _lifted(matrix, u, v, 1.0, near[k])
            right, down = _lifted(matrix, 1.0, 0.0, 0.0, slopes[k, 0]), _lifted(matrix, 0.0, 1.0, 0.0, slopes[k, 1])
            across = _crossed(right, down)
            volume = abs(middle[0] * across[0] + middle[1] * across[1] + middle[2] * across[2])
            if not (middle[2] > 0.0 and volume >= middle[2] * middle[2] * middle[2]):
                continue
            if _sees_past(middle, near[k], ids[k], depth, picture_slopes, of_picture, tolerance):
                continue
            for side in range(4):
                if not is_border[k, side]:
                    continue
                axis, way = side // 2, 2 * (side % 2) - 1
                along, far = right if axis == 0 else down, way * 0.5 * reaches[k, side] / HALF
                end = (middle[0] + far * along[0], middle[1] + far * along[1], middle[2] + far * along[2])
                nears = near[k], near[k] + far * slopes[k, axis]
                if _sees_nowhere_past(middle, end, nears, ids[k], depth, picture_slopes, of_picture, tolerance):
                    continue
                for step in range(1, reaches[k, side] + 1):
                    aside = way * 0.5 * step / HALF
                    there = near[k] + aside * slopes[k, axis]
                    x, y = u + (aside if axis == 0 else 0.0), v + (aside if axis == 1 else 0.0)
                    end = _lifted(matrix, x, y, 1.0, there)
                    if _sees_past(end, there, ids[k], depth, picture_slopes, of_picture, tolerance):
                        reaches[k, side] = step - 1
                        break


@kernel(error_model="numpy", nogil=True)
def _sees_past(
    h: tuple[float, float, float],
    near: float,
    one: int,
    depth: NDArray[np.float32],
    slopes: NDArray[np.float32],
    ids: NDArray[np.int32],
    tolerance: float,
) -> bool:
    """Whether a picture shows something behind a point of an object ``one``, which is at ``h`` in it, ``near`` in the image."""
    if not h[2] > 0.0:
        return False
    x, y = h[0] / h[2], h[1] / h[2]
    if not (0.0 <= x < depth.shape[1] and 0.0 <= y < depth.shape[0]):
        return False
    return bool(near / h[2] > _limit(int(y), int(x), one, depth, slopes, ids, tolerance))


@kernel(error_model="numpy", nogil=True)
def _sees_nowhere_past(
    h: tuple[float, float, float],
    end: tuple[float, float, float],
    nears: tuple[float, float],
    one: int,
    depth: NDArray[np.float32],
    slopes: NDArray[np.float32],
    ids: NDArray[np.int32],
    tolerance: float,
) -> bool:
    """Whether :func:`_sees_past` is false from a point to another: what is before all that is shown between them.

    1 / depth is the largest at either end, and all pixels are looked at that are between them. May be false where it is so.
    """
    if not (h[2] > 0.0 and end[2] > 0.0):
        return False
    x0, x1, y0, y1 = h[0] / h[2], end[0] / end[2], h[1] / h[2], end[1] / end[2]
    left, right = int(max(min(x0, x1) - _HAIR, 0.0)), int(min(max(x0, x1) + _HAIR, depth.shape[1] - 1.0))
    top, bottom = int(max(min(y0, y1) - _HAIR, 0.0)), int(min(max(y0, y1) + _HAIR, depth.shape[0] - 1.0))
    most = max(nears[0] / h[2], nears[1] / end[2]) * (1.0 + _HAIR)
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            if most > _limit(row, column, one, depth, slopes, ids, tolerance):
                return False
    return True


@kernel(error_model="numpy", nogil=True, inline="always")
def _limit(
    row: int,
    column: int,
    one: int,
    depth: NDArray[np.float32],
    slopes: NDArray[np.float32],
    ids: NDArray[np.int32],
    tolerance: float,
) -> float:
    """1 / depth up to which a point of an object ``one`` is not before what a pixel shows."""
    slanted = 0.5 * (abs(slopes[row, column, 0]) + abs(slopes[row, column, 1]))
    return float(1.0 / depth[row, column] + slanted + tolerance * (_BENT if ids[row, column] == one else 1.0))
