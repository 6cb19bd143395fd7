"""Which triangles of a cell's layers need captured depths to be drawn in the right order.

A mesh lies off the captured surface where one of its quads spans two objects. That alone does no harm: colour and coverage
are right, and a displacement of the surface within its layer is what the layering bounds. It does harm where something else
is in between: the z-buffer then lets the wrong one win. This module finds those triangles, from the reference viewpoint:
between a texel's captured depth and its mesh lies the ground, or, within the largest displacement around it, a surface of
another layer, of an object that is drawn as geometry (a drum around a tower: one may be a layer, the other near), or of hills.

Surfaces are compared in a coarse panorama around the reference viewpoint: bins of azimuth and slope, each with the range of
horizontal distances that a layer covers there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.capture.layer_values import GridMesh
from mmi.city.terrain import Terrain
from mmi.foundation.camera import View
from mmi.foundation.kernels import kernel

__all__ = ["CapturedLayer", "out_of_order"]

_EVEN = 1e-3
"""Relative difference of depths up to which a triangle lies on what was captured."""
_MOST_BINS = 512
"""How many bins of azimuth there may be. They are as wide as the largest displacement, unless that takes more of them."""
_AROUND = 2
"""Bins around a texel in which other surfaces count: its own may lie anywhere in its bin, and move by one."""
_MOST_STEPS = 1024
"""How many steps the ground may be looked at in, from the eye outwards."""
_GROUND_PX = 0.5
"""Pixels of the capture by which the line where ground and surface meet may be wrong."""


@dataclass(frozen=True, slots=True, eq=False)
class CapturedLayer:
    """One picture of a layer: ``layer`` is its index, ``depth`` (h, w) what ``view`` captured, ``inf`` where nothing was."""

    layer: int
    view: View
    mesh: GridMesh
    depth: NDArray[np.float32]


class _Texels(NamedTuple):
    """A picture: ``depth`` (h, w) metres, and of its texels the ``column`` (w,) and ``row`` (h, w) of the bin they fall into.

    ``stretch`` (w,) is horizontal distance over depth.
    """

    depth: NDArray[np.float32]
    column: NDArray[np.int64]
    stretch: NDArray[np.float64]
    row: NDArray[np.int64]


class _Ranges(NamedTuple):
    """The horizontal distances of what falls into each bin, from ``near`` to ``far`` (..., rows, columns), metres."""

    near: NDArray[np.float32]
    far: NDArray[np.float32]


def out_of_order(
    pictures: Sequence[CapturedLayer],
    *,
    max_angle: float,
    eye_height: float,
    solids: NDArray[np.float64] | None = None,
    terrain: Terrain | None = None,
) -> list[NDArray[np.bool_]]:
    """For each picture, (m,) whether its triangles need captured depths. All are level views from one eye.

    ``max_angle`` radians is the largest displacement between layers, ``eye_height`` metres that of the eye above level ground
    where there is no ``terrain``. ``solids`` (t, 3, 3) are the triangles of near objects, metres from the eye.
    """
    if not pictures:
        return []
    count = int(2.0 * math.pi / max(max_angle, 2.0 * math.pi / _MOST_BINS))
    step = 2.0 * math.pi / count
    rays = [_rays(one.view) for one in pictures]
    low = min(float(slope.min()) for _, _, slope in rays)
    rows = int((max(float(slope.max()) for _, _, slope in rays) - low) / step) + 1
    names = sorted({one.layer for one in pictures})
    # The last two are for what is drawn as geometry: near objects, and hills.
    near = np.full((len(names) + 2, rows, count), np.inf, dtype=np.float32)
    far = np.zeros((len(names) + 2, rows, count), dtype=np.float32)
    if solids is not None:
        _cover_with(solids, low, step, _Ranges(near[-2], far[-2]))
    if terrain is not None:
        reach = max(float(one.depth.max(initial=0.0, where=np.isfinite(one.depth))) for one in pictures)
        heights, apart = _heights_around(terrain, pictures[0].view.eye, count, 2.0 * reach)
        _cover_with_ground(heights, apart, low, step, _Ranges(near[-1], far[-1]))
    bins = [
        ((azimuth / step).astype(np.int64) % count, stretch, ((slope - low) / step).astype(np.int64))
        for azimuth, stretch, slope in rays
    ]
    for one, where in zip(pictures, bins, strict=True):
        k = names.index(one.layer)
        _cover(_Texels(one.depth, *where), _Ranges(near[k], far[k]))
    ranges = _Ranges(_least_around(near, _AROUND), -_least_around(-far, _AROUND))
    found = []
    for one, where in zip(pictures, bins, strict=True):
        corners = one.mesh.uv.astype(np.float64) * one.depth.shape[::-1]
        nearness = 1.0 / one.view.project(one.mesh.vertices.astype(np.float64))[:, 2]  # linear in the picture
        below = one.view.pixel_centres()[1] > 0.0
        bend = np.where(below, (eye_height if terrain is None else 0.0) * one.view.focal / _GROUND_PX, 0.0)
        own = names.index(one.layer)
        found.append(_harmed(corners, nearness, one.mesh.triangles, _Texels(one.depth, *where), bend, own, ranges))
    return found


def _rays(view: View) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Azimuth in [0, 2 pi) (w,), horizontal distance over depth (w,) and slope (h, w) of a level view's texels."""
    u, v = view.pixel_centres()
    ahead = math.atan2(-view.eye_from_world[2, 1], -view.eye_from_world[2, 0])
    azimuth = np.mod(ahead - np.arctan2(u, view.focal), 2.0 * math.pi)
    stretch = np.hypot(1.0, u / view.focal)
    return azimuth, stretch, -v[:, None] / (view.focal * stretch)


@kernel()
def _cover(texels: _Texels, ranges: _Ranges) -> None:
    """Widen each bin's range, ``near`` to ``far`` (rows, columns), by the distances of a picture's texels in it."""
    depth, column, stretch, row = texels
    near, far = ranges
    for i in range(depth.shape[0]):
        for j in range(depth.shape[1]):
            if np.isfinite(depth[i, j]):
                distance = np.float32(depth[i, j] * stretch[j])
                r, c = row[i, j], column[j]
                near[r, c] = min(near[r, c], distance)
                far[r, c] = max(far[r, c], distance)


@kernel()
def _cover_with(solids: NDArray[np.float64], low: float, step: float, ranges: _Ranges) -> None:
    """The same for triangles: each widens all bins that its ranges of azimuth and slope touch by its range of distances."""
    near, far = ranges
    rows, columns = near.shape
    for t in range(len(solids)):
        least, most = np.inf, 0.0
        start = stop = turn = 0.0
        first = np.arctan2(solids[t, 0, 1], solids[t, 0, 0])
        for k in range(3):
            x, y = solids[t, k, 0], solids[t, k, 1]
            nx, ny = solids[t, (k + 1) % 3, 0], solids[t, (k + 1) % 3, 1]
            most = max(most, np.hypot(x, y))
            square = (nx - x) ** 2 + (ny - y) ** 2
            at = min(max(-(x * (nx - x) + y * (ny - y)) / square, 0.0), 1.0) if square > 0.0 else 0.0
            least = min(least, np.hypot(x + at * (nx - x), y + at * (ny - y)))
            start, stop = min(start, turn), max(stop, turn)
            turn += np.arctan2(x * ny - y * nx, x * nx + y * ny)
        least = max(least, 1e-3)
        bottom, top = solids[t, :, 2].min(), solids[t, :, 2].max()
        lowest = bottom / (least if bottom < 0.0 else most)
        highest = top / (least if top > 0.0 else most)
        begin, end = int(np.floor((first + start) / step)), int(np.floor((first + stop) / step))
        for r in range(
            max(int(np.floor((lowest - low) / step)), 0), min(int(np.floor((highest - low) / step)), rows - 1) + 1
        ):
            for c in range(begin, min(end, begin + columns - 1) + 1):
                near[r, c % columns] = min(near[r, c % columns], np.float32(least))
                far[r, c % columns] = max(far[r, c % columns], np.float32(most))


def _heights_around(
    terrain: Terrain, eye: NDArray[np.float64], count: int, reach: float
) -> tuple[NDArray[np.float64], float]:
    """(count, n) metres of the ground above the eye, in the middle of ``count`` bins of azimuth, every so many metres."""
    apart = max(terrain.spacing, reach / _MOST_STEPS)
    azimuth = (np.arange(count) + 0.5) * 2.0 * math.pi / count
    away = apart * np.arange(1, math.ceil(reach / apart) + 1)
    points = eye[:2] + away[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)[:, None]
    return terrain.at(points) - eye[2], apart


@kernel()
def _cover_with_ground(
    heights: NDArray[np.float64],
    apart: float,
    low: float,
    step: float,
    ranges: _Ranges,
) -> None:
    """The same for the ground, whose ``heights`` (columns, n) above the eye are given every ``apart`` metres."""
    near, far = ranges
    for c in range(heights.shape[0]):
        for k in range(heights.shape[1]):
            here = heights[c, k] / (apart * (k + 1))
            last = heights[c, k - 1] / (apart * k) if k > 0 else here
            begin, end = int(np.floor((min(here, last) - low) / step)), int(np.floor((max(here, last) - low) / step))
            for r in range(max(begin, 0), min(end, near.shape[0] - 1) + 1):
                near[r, c] = min(near[r, c], np.float32(apart * k))
                far[r, c] = max(far[r, c], np.float32(apart * (k + 1)))


@kernel()
def _least_around(values: NDArray[np.float32], reach: int) -> NDArray[np.float32]:
    """(layers, rows, columns): the least within ``reach`` bins each way; columns go around."""
    layers, rows, columns = values.shape
    across, result = values.copy(), values.copy()
    for k in range(layers):
        for r in range(rows):
            for c in range(columns):
                for d in range(-reach, reach + 1):
                    across[k, r, c] = min(across[k, r, c], values[k, r, (c + d) % columns])
        for r in range(rows):
            for c in range(columns):
                least = across[k, r, c]
                for d in range(max(r - reach, 0), min(r + reach + 1, rows)):
                    least = min(least, across[k, d, c])
                result[k, r, c] = least
    return result


@kernel()
def _harmed(
    corners: NDArray[np.float64],
    nearness: NDArray[np.float64],
    triangles: NDArray[np.int32],
    texels: _Texels,
    bend: NDArray[np.float64],
    own: int,
    ranges: _Ranges,
) -> NDArray[np.bool_]:
    """(m,) whether something lies between a triangle and a texel that it shows; ``corners`` (n, 2) in texels.

    ``bend`` (h,): differences of 1/z times this, above 1, let the ground come between.
    """
    depth, column, stretch, row = texels
    near, far = ranges
    height, width = depth.shape
    harmed = np.zeros(len(triangles), dtype=np.bool_)
    for t in range(len(triangles)):
        a, b, c = triangles[t]
        ax, ay = corners[a]
        bx, by = corners[b, 0] - ax, corners[b, 1] - ay
        cx, cy = corners[c, 0] - ax, corners[c, 1] - ay
        area = bx * cy - by * cx
        if area == 0.0:
            continue
        share = 1.0 / area
        left, right = min(0.0, bx, cx) + ax, max(0.0, bx, cx) + ax
        upper, lower = min(0.0, by, cy) + ay, max(0.0, by, cy) + ay
        for i in range(max(int(np.floor(upper)), 0), min(int(np.ceil(lower)), height)):
            if harmed[t]:
                break
            y = i + 0.5 - ay
            for j in range(max(int(np.floor(left)), 0), min(int(np.ceil(right)), width)):
                if not np.isfinite(depth[i, j]):
                    continue
                x = j + 0.5 - ax
                p, q = (x * cy - y * cx) * share, (bx * y - by * x) * share
                if p < -1e-9 or q < -1e-9 or p + q > 1.0 + 1e-9:
                    continue
                here = nearness[a] + p * (nearness[b] - nearness[a]) + q * (nearness[c] - nearness[a])
                if abs(here * depth[i, j] - 1.0) <= _EVEN:
                    continue
                if (1.0 / depth[i, j] - here) * bend[i] > 1.0:
                    harmed[t] = True
                    break
                low = min(1.0 / here, depth[i, j]) * stretch[j] * (1.0 - _EVEN)
                high = max(1.0 / here, depth[i, j]) * stretch[j] * (1.0 + _EVEN)
                for k in range(near.shape[0]):
                    if k != own and near[k, row[i, j], column[j]] <= high and far[k, row[i, j], column[j]] >= low:
                        harmed[t] = True
                        break
                if harmed[t]:
                    break
    return harmed
