"""What a viewer sees and a capture cannot have seen: where a picture's surfaces were hidden from another viewpoint.

Layers are captured from one viewpoint of a cell. From elsewhere surfaces come into sight that were hidden there; that is
where impostors go wrong, and where errors are worth measuring on their own (DESIGN section 6). The test is that of shadow
maps: the geometry's depth in a picture against its depth as seen from the other viewpoint.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from mmi.foundation.camera import Camera, View, level_views_around

__all__ = ["disocclusion_mask", "panorama_views"]

_BEYOND = 1.0
"""The outermost pixels of a window stand for this many pixels beyond its edge, so that nothing falls between two windows."""


def panorama_views(eye: NDArray[np.float64], *, camera: Camera) -> tuple[View, ...]:
    """Level views from ``eye`` (3,) that look all around, each a picture of ``camera``: what :func:`disocclusion_mask` needs.

    As few as its field of view allows, evenly spread, the first towards +X, counter-clockwise. They reach as far up and
    down as the camera does: least at their sides.
    """
    count = math.ceil(2.0 * math.pi / camera.fov - 1e-9)
    return level_views_around(eye, count, focal=camera.focal, window=camera.window)


def disocclusion_mask(
    depth: NDArray[np.floating],
    view: View,
    captured: Sequence[tuple[View, NDArray[np.floating]]],
    *,
    tolerance: float = 0.05,
    relative: float = 0.005,
) -> NDArray[np.bool_]:
    """Pixels of ``view`` whose surface cannot be seen from where the views of ``captured`` were taken: (h, w) bool.

    ``depth`` (h, w) is the geometry's as ``view`` sees it, each of ``captured`` a view with the geometry's depth in its
    window; metres along the axis, ``inf`` for the sky. A surface is hidden from a captured view where it lies farther than
    the farthest of the 3 x 3 pixels around its place there (slanted surfaces are not flat within a pixel), by more than
    ``tolerance`` metres plus the share ``relative`` of its depth. So the mask may be a captured pixel or two too narrow
    along silhouettes, and hardly ever too wide. It leaves out the sky and what lies outside all captured windows. Where
    windows overlap, one that sees the surface is enough.

    Raises ValueError where a depth's size is not that of its view's window.
    """
    for one, values in ((view, depth), *captured):
        if values.shape != (one.window[3], one.window[2]):
            raise ValueError(
                f"depth of {one.window[2]}x{one.window[3]} pixels expected, found {values.shape[1]}x{values.shape[0]}"
            )
    mask = np.zeros(depth.shape, dtype=bool)
    v, u = np.nonzero(np.isfinite(depth))
    across, down = view.pixel_centres()
    points = view.unproject(across[u], down[v], depth[v, u].astype(np.float64))
    hidden, waiting = np.zeros(len(points), dtype=bool), np.arange(len(points))
    for other, there in captured:
        left, top, width, height = other.window
        at = other.project(points[waiting])
        # Points at depth 0 or behind give any u, v: they are asked about first.
        ahead = np.flatnonzero(at[:, 2] > 0.0)
        column, row = at[ahead, 0] - left, at[ahead, 1] - top
        inside = (np.abs(column - 0.5 * width) <= 0.5 * width + _BEYOND) & (row >= 0.0) & (row < height)
        index, column, row = ahead[inside], column[inside].astype(np.int64), row[inside].astype(np.int64)
        farthest = maximum_filter(there, size=3, mode="nearest")[row, np.clip(column, 0, width - 1)]
        behind = at[index, 2] > farthest + tolerance + relative * at[index, 2]
        hidden[waiting[index]] = behind
        waiting = np.delete(waiting, index[~behind])  # what one view sees is seen
    mask[v, u] = hidden
    return mask
