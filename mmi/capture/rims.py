"""Rims: where a layer's picture ends because another object touches what it shows, it shows a texel of that other object too.

Houses of a row and parts of one long object (:mod:`mmi.city.long_objects`) touch, and some of them are geometry and some in
layers. A silhouette of a layer is as good as its texels: half of one may be missing, and between two houses that touch the
sky would show as a bright line. A silhouette in front of the sky is left as it is. What a rim shows is really there, at the
depth where it is.
"""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from mmi.capture.layer_values import DepthTexture
from mmi.city.model import City
from mmi.foundation.kernels import kernel
from mmi.foundation.ray_chords import Intrinsics, chord, intrinsics_of

__all__ = ["touching", "with_rims"]

_TOUCH = 0.05
"""Metres: objects touch whose footprints are at most this far apart."""
_ONE_EDGE = 0.01
"""Two surfaces meet halfway between two texels where their depths there differ by at most this share."""
_EVEN = 1e-3
"""Depths that differ by at most this share are equal."""
_STEEPEST = 0.05
"""The depths of neighbouring texels of one surface differ by at most this share."""


def touching(city: City, objects: NDArray[np.int64]) -> NDArray[np.int64]:
    """(m, 2) indices of those of ``objects`` (n,) that touch in plan, each pair both ways round."""
    footprints = np.array([city.objects[i].footprint for i in objects], dtype=object)
    tree = shapely.STRtree(footprints)
    one, other = tree.query(footprints, predicate="dwithin", distance=_TOUCH)
    apart = one != other
    return np.column_stack([objects[one[apart]], objects[other[apart]]])


def with_rims(
    texture: DepthTexture,
    beside: DepthTexture,
    pairs: NDArray[np.int64],
    *,
    viewpoints: NDArray[np.float64],
    tolerance: float,
) -> DepthTexture:
    """``texture`` with a rim of a texel, where its objects end at those of ``pairs`` (m, 2; :func:`touching`) that touch them.

    ``beside`` shows those others from the same view.

    A texel is part of the rim where it is next to a covered one and ``texture`` shows nothing in it, or a surface of the same
    object that lies behind. Where what ``beside`` shows there meets the surface of the covered one, halfway between both, and
    lies within ``tolerance`` radians of that surface as ``viewpoints`` (k, 3) see it, the rim shows it. Where it turns farther
    away, or lies in front, so that nobody knows from here where the surface ends, the rim continues the surface, if ``texture``
    shows nothing. Raises ValueError where the views' windows differ.
    """
    if texture.view.window != beside.view.window:
        raise ValueError(f"pictures of one window expected, found {texture.view.window} and {beside.view.window}")
    count = int(pairs.max(initial=-1)) + 1
    arrays = _rimmed(
        (texture.color, texture.depth, texture.object_ids),
        (beside.color, beside.depth, beside.object_ids),
        np.unique(pairs @ np.array([count, 1])),
        count,
        *intrinsics_of(texture.view, viewpoints),
        2.0 * np.sin(0.5 * tolerance),
    )
    return DepthTexture(texture.view, *arrays)


_Picture = tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.int32]]


@kernel(error_model="numpy")
def _rimmed(
    picture: _Picture,
    other: _Picture,
    pairs: NDArray[np.int64],
    count: int,
    intrinsics: Intrinsics,
    offsets: NDArray[np.float64],
    tolerance: float,
) -> _Picture:
    """Colour, depth and ids of ``picture`` with its rim, see :func:`with_rims`.

    ``pairs`` are one * ``count`` + other, sorted; ``tolerance`` is a chord.
    """
    color, depth, ids = picture
    other_color, other_depth, other_ids = other
    height, width = depth.shape
    new_color, new_depth, new_ids = color.copy(), depth.copy(), ids.copy()
    for j in range(height):
        for i in range(width):
            if other_ids[j, i] < 0:
                continue
            w = 1.0 / np.float64(other_depth[j, i])
            for turn in range(4):
                x, y = (turn == 0) - (turn == 1), (turn == 2) - (turn == 3)
                # The covered texel, the one behind it, and the one on the other side.
                ci, cj, bi, bj, oi, oj = i + x, j + y, i + 2 * x, j + 2 * y, i - x, j - y
                if not (0 <= ci < width and 0 <= cj < height) or ids[cj, ci] < 0:
                    continue
                one, empty = ids[cj, ci], ids[j, i] < 0
                if not empty and (ids[j, i] != one or depth[j, i] <= (1.0 + _EVEN) * other_depth[j, i]):
                    continue
                pair = np.int64(one) * count + other_ids[j, i]
                place = np.searchsorted(pairs, pair)
                if place == len(pairs) or pairs[place] != pair:
                    continue
                # 1/z is linear in planes: both surfaces are continued to halfway between the two texels.
                v = 1.0 / np.float64(depth[cj, ci])
                slope, other_slope = np.nan, np.nan
                if 0 <= bi < width and 0 <= bj < height and ids[bj, bi] == one:
                    slope = v - 1.0 / np.float64(depth[bj, bi])
                if 0 <= oi < width and 0 <= oj < height and other_ids[oj, oi] == other_ids[j, i]:
                    other_slope = w - 1.0 / np.float64(other_depth[oj, oi])
                # Where depth jumps there, it tells nothing; a surface without a slope of its own goes on as the other does.
                known, other_known = abs(slope) <= _STEEPEST * v, abs(other_slope) <= _STEEPEST * w
                if not known:
                    slope = -other_slope if other_known else 0.0
                if not other_known:
                    other_slope = -slope
                meets = abs((w + 0.5 * other_slope) - (v + 0.5 * slope)) <= _ONE_EDGE * w
                if meets and chord(i + 0.5, j + 0.5, w, v + slope, intrinsics, offsets) <= tolerance:
                    new_color[j, i], new_depth[j, i], new_ids[j, i] = (
                        other_color[j, i],
                        other_depth[j, i],
                        other_ids[j, i],
                    )
                    break
                if empty and (meets or w > v + slope):
                    new_color[j, i], new_depth[j, i], new_ids[j, i] = color[cj, ci], 1.0 / (v + slope), one
    return new_color, new_depth, new_ids
