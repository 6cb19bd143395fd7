"""Layered images as other viewpoints see them: three-dimensional image warping (McMillan & Bishop 1995).

A ray of the new view passes the image's pixels along an epipolar line, and meets patches the nearer to its eye the earlier
it passes their pixels. So pixels are painted in an *occlusion-compatible order*, and no depths are compared: where the new eye
is ahead of the image's, rows from both borders towards the row of the epipole, which is where the image sees the new eye, and
pixels of a row likewise; where it is behind, the other way around. Of one pixel's samples the one that is farther from the eye
comes first. This is exact, because patches stay within the pyramids of their pixels (:mod:`viewer.layered.layered_image`).

Each patch is painted into the pixels whose centres it covers, with the depth of its plane there. Threads share the rows of the
new picture and each goes through all samples, so that the order holds and nobody waits.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View
from mmi.foundation.kernels import kernel
from viewer.layered.layered_image import HALF, NOTHING, LayeredImage

__all__ = ["MEET", "REACH", "Warped", "between", "covered", "warped"]

MEET = 0.02
"""Pixels that patches reach farther than they should, so that neighbours meet in spite of rounding."""
REACH = 0.5 + MEET
"""Pixels that patches reach to each side of their centres at most."""
_FLAT = 1.0 / 64.0
"""A patch whose distance varies by at most this share to each side looks like a parallelogram."""
_FAR = 1e9
"""Pixels; epipoles farther away are taken to be so far."""
_GAP = 0.02
"""A share of the depth: what is farther behind than that shows through a crack, and what is nearer is of the same surface."""


class Warped(NamedTuple):
    """A layered image as another view sees it, top row first.

    ``color`` (h, w, 3) uint8; ``depth`` (h, w) float32 metres along the view's axis, infinite where nothing is; ``ids``
    (h, w) int32 objects, ``NOTHING`` where nothing is.
    """

    color: NDArray[np.uint8]
    depth: NDArray[np.float32]
    ids: NDArray[np.int32]


def between(source: View, target: View) -> NDArray[np.float64]:
    """(3, 4): pixel coordinates (x, y, 1) of ``source``, from its upper left, and 1 / depth -> those of ``target``, times the
    target's depth by the source's.

    The plane-and-parallax form of McMillan & Bishop's warping equation.
    """
    turned = target.eye_from_world[:3, :3] @ source.eye_from_world[:3, :3].T
    moved = target.eye_from_world[:3, 3] - turned @ source.eye_from_world[:3, 3]
    left, top = source.window[:2]
    ray = np.array([[1.0, 0.0, left], [0.0, -1.0, -top], [0.0, 0.0, -source.focal]]) / source.focal
    left, top = target.window[:2]
    picture = np.array([[target.focal, 0.0, left], [0.0, -target.focal, top], [0.0, 0.0, -1.0]])
    return picture @ np.column_stack([turned @ ray, moved])


def warped(image: LayeredImage, view: View, *, threads: int = 1) -> Warped:
    """What ``view`` sees of an image; cracks of a pixel between patches that are neighbours in it are closed.

    Patches that reach behind the eye are left out. The same for any number of ``threads``.
    """
    width, height = view.window[2:]
    found = Warped(
        np.zeros((height, width, 3), np.uint8),
        np.full((height, width), np.inf, np.float32),
        np.full((height, width), NOTHING, np.int32),
    )
    pixels = np.full((height, width), NOTHING, np.int32)
    matrix, size = between(image.view, view), image.view.window[2:]
    x, y, ahead, eye_depth = _epipole(image.view, view)
    samples = (image.starts, image.depths, image.slopes, image.reaches, image.colors, image.ids)

    def paint(band: int) -> None:
        top, bottom = height * band // threads, height * (band + 1) // threads
        _paint(
            *samples,
            size,
            matrix,
            (x, y),
            ahead,
            eye_depth,
            (top, bottom),
            found.color,
            found.depth,
            found.ids,
            pixels,
        )

    if threads == 1:
        paint(0)
    else:
        with ThreadPoolExecutor(threads - 1, "warp") as pool:
            others = [pool.submit(paint, band) for band in range(1, threads)]
            paint(0)
            for other in others:
                other.result()
    _fill(found.depth.copy(), pixels, size[0], *found)
    return found


def _epipole(source: View, target: View) -> tuple[int, int, bool, float]:
    """The column and row in which ``source`` sees the eye of ``target``, 0 to the number of columns or rows; whether that is
    ahead, and how far along the axis.
    """
    right, up, back = source.eye_from_world[:3, :3] @ target.eye + source.eye_from_world[:3, 3]
    ahead, scale = back <= 0.0, source.focal / -min(-abs(back), -1e-300)
    sign = 1.0 if ahead else -1.0
    left, top, width, height = source.window
    x = min(max(sign * scale * right, -_FAR), _FAR) - left
    y = min(max(-sign * scale * up, -_FAR), _FAR) - top
    return math.floor(min(max(x, 0.0), width)), math.floor(min(max(y, 0.0), height)), bool(ahead), float(-back)


@kernel(error_model="numpy", nogil=True)
def covered(
    h: tuple[float, float, float],
    a: tuple[float, float, float],
    b: tuple[float, float, float],
    left: int,
    right: int,
    top: int,
    bottom: int,
) -> tuple[int, int, int, int]:
    """First and last columns and rows, those after the last, whose pixels' centres a patch may cover, within some limits.

    The patch's centre is at ``h``, homogeneous, and it reaches ``REACH`` times ``a`` and ``b`` to each side.
    """
    if not h[2] > 0.0:
        return 0, 0, 0, 0
    inverse = 1.0 / h[2]
    x, y = h[0] * inverse, h[1] * inverse
    varies = REACH * (abs(a[2]) + abs(b[2])) * inverse
    if varies <= _FLAT:
        longer = REACH * inverse * (1.0 + 2.0 * varies)
        wide = longer * (abs(a[0] - x * a[2]) + abs(b[0] - x * b[2]))
        high = longer * (abs(a[1] - y * a[2]) + abs(b[1] - y * b[2]))
        x0, x1, y0, y1 = x - wide, x + wide, y - high, y + high
    elif varies < 1.0:
        x0 = y0 = np.inf
        x1 = y1 = -np.inf
        for k in range(4):
            s = REACH if k & 1 else -REACH
            t = REACH if k & 2 else -REACH
            inverse = 1.0 / (h[2] + s * a[2] + t * b[2])
            x = (h[0] + s * a[0] + t * b[0]) * inverse
            y = (h[1] + s * a[1] + t * b[1]) * inverse
            x0, x1, y0, y1 = min(x0, x), max(x1, x), min(y0, y), max(y1, y)
    else:
        return 0, 0, 0, 0
    if not (x1 > left and x0 < right and y1 > top and y0 < bottom):
        return 0, 0, 0, 0
    return (
        max(left, math.ceil(x0 - 0.5)),
        min(right, math.floor(x1 - 0.5) + 1),
        max(top, math.ceil(y0 - 0.5)),
        min(bottom, math.floor(y1 - 0.5) + 1),
    )


@kernel(error_model="numpy", nogil=True)
def _paint(
    starts: NDArray[np.int32],
    depths: NDArray[np.float32],
    slopes: NDArray[np.float32],
    reaches: NDArray[np.uint8],
    colors: NDArray[np.uint8],
    ids: NDArray[np.int32],
    size: tuple[int, int],
    matrix: NDArray[np.float64],
    epipole: tuple[int, int],
    ahead: bool,
    eye_depth: float,
    rows: tuple[int, int],
    color: NDArray[np.uint8],
    depth: NDArray[np.float32],
    shown: NDArray[np.int32],
    pixels: NDArray[np.int32],
) -> None:
    """Paint all samples into some ``rows``, to before the second; ``pixels`` are the image's that they come from."""
    m00, m01, m02, p0 = matrix[0]
    m10, m11, m12, p1 = matrix[1]
    m20, m21, m22, p2 = matrix[2]
    (width, height), (top, bottom) = size, rows
    right = depth.shape[1]
    for i in range(height):
        row = _in_order(i, height, epipole[1], ahead)
        v = row + 0.5
        for j in range(width):
            column = _in_order(j, width, epipole[0], ahead)
            pixel = row * width + column
            first, end = starts[pixel], starts[pixel + 1]
            if first == end:
                continue
            u = column + 0.5
            r0, r1, r2 = m00 * u + m01 * v + m02, m10 * u + m11 * v + m12, m20 * u + m21 * v + m22
            turn = first  # samples before it are nearer to the image than the eye
            while turn < end and depths[turn] <= eye_depth:
                turn += 1
            for n in range(end - first):
                k = first + n if n < turn - first else end - 1 - (n - (turn - first))
                near, gx, gy = 1.0 / depths[k], float(slopes[k, 0]), float(slopes[k, 1])
                h = (r0 + near * p0, r1 + near * p1, r2 + near * p2)
                a = (m00 + gx * p0, m10 + gx * p1, m20 + gx * p2)
                b = (m01 + gy * p0, m11 + gy * p1, m21 + gy * p2)
                x0, x1, y0, y1 = covered(h, a, b, 0, right, top, bottom)
                if x0 >= x1 or y0 >= y1:
                    continue
                left_reach, right_reach = 0.5 / HALF * reaches[k, 0] + MEET, 0.5 / HALF * reaches[k, 1] + MEET
                up_reach, down_reach = 0.5 / HALF * reaches[k, 2] + MEET, 0.5 / HALF * reaches[k, 3] + MEET
                for y in range(y0, y1):
                    yc = y + 0.5
                    a1, b1, h1 = a[1] - yc * a[2], b[1] - yc * b[2], yc * h[2] - h[1]
                    for x in range(x0, x1):
                        xc = x + 0.5
                        a0, b0, h0 = a[0] - xc * a[2], b[0] - xc * b[2], xc * h[2] - h[0]
                        area = a0 * b1 - b0 * a1
                        s, t = h0 * b1 - b0 * h1, a0 * h1 - h0 * a1
                        if area < 0.0:
                            area, s, t = -area, -s, -t
                        if not (-left_reach * area <= s <= right_reach * area and area > 0.0):
                            continue
                        if not -up_reach * area <= t <= down_reach * area:
                            continue
                        s, t = s / area, t / area
                        there = near + s * gx + t * gy
                        if there > 0.0:
                            depth[y, x] = (h[2] + s * a[2] + t * b[2]) / there
                            shown[y, x], pixels[y, x] = ids[k], pixel
                            color[y, x, 0], color[y, x, 1], color[y, x, 2] = colors[k, 0], colors[k, 1], colors[k, 2]


@kernel(error_model="numpy", nogil=True, inline="always")
def _in_order(step: int, count: int, epipole: int, ahead: bool) -> int:
    """The row, or column, that comes at a ``step``: from both borders towards the ``epipole``, or the other way around."""
    n = step if ahead else count - 1 - step
    return n if n < epipole else count - 1 - (n - epipole)


@kernel(error_model="numpy", nogil=True)
def _fill(
    before: NDArray[np.float32],
    pixels: NDArray[np.int32],
    width: int,
    color: NDArray[np.uint8],
    depth: NDArray[np.float32],
    shown: NDArray[np.int32],
) -> None:
    """Close cracks: pixels beyond two opposite ones of a surface, which are neighbours in the image, ``width`` pixels wide.

    ``before`` are the depths without that.
    """
    for y in range(1, depth.shape[0] - 1):
        for x in range(1, depth.shape[1] - 1):
            for k in range(4):
                dx, dy = (1, 0, 1, 1)[k], (0, 1, 1, -1)[k]
                one, other = before[y - dy, x - dx], before[y + dy, x + dx]
                least = max(one, other) * (1.0 + _GAP)
                if not (before[y, x] > least and min(one, other) * (1.0 + 2.0 * _GAP) > least):
                    continue
                p, q = pixels[y - dy, x - dx], pixels[y + dy, x + dx]
                if shown[y - dy, x - dx] != shown[y + dy, x + dx] or abs(p % width - q % width) > 1:
                    continue
                if abs(p // width - q // width) <= 1:
                    depth[y, x] = 0.5 * (one + other)
                    shown[y, x] = shown[y - dy, x - dx]
                    for n in range(3):
                        color[y, x, n] = color[y - dy, x - dx, n]
                    break
