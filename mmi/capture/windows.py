"""Where a layer appears from the reference viewpoint: sectors of the panorama, windows in their image planes, texel sizes.

A panorama is cut into equal sectors of azimuth, each a level picture (paper section 5.1: six of 60 degrees). A layer is
captured only in the window that its objects cover, with texels small enough that from no viewpoint of the cell a texel
appears larger than a pixel of the display (Schaufler 1998, eq. 1: resolution in proportion to the object's size over its
distance, here its least distance to the cell).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mmi.cells.viewing_cells import ViewingCell
from mmi.foundation.camera import View, level_view
from mmi.parallax.texels import texel_ratios
from mmi.visibility.selection import WallVisibility
from mmi.visibility.walls import Walls

__all__ = ["layer_views"]


def layer_views(
    walls: Walls,
    objects: NDArray[np.int64],
    cell: ViewingCell,
    *,
    sectors: int,
    focal: float,
    quad: int,
    wall_visibility: WallVisibility | None = None,
) -> list[tuple[int, View]]:
    """(sector, view) for every sector that the objects appear in, as far as ``wall_visibility`` leaves something of their
    walls.

    ``focal`` is the display's; each view has texels as fine as the walls in it need (see :func:`texel_ratios`). Windows are
    whole quads of ``quad`` texels and reach one quad beyond the sector's borders, so that the meshes of neighbouring
    sectors overlap and no gap opens between them.
    """
    eye = cell.reference
    half = math.pi / sectors
    index = walls.of(objects)
    low = walls.bottom[index]
    if wall_visibility is not None:
        # Where roof or underside may be seen, that ends at walls which face away.
        ends = (walls.top[index] < cell.eye[1]) | (walls.bottom[index] > cell.eye[0])
        low = np.where(ends, low, np.maximum(low, wall_visibility.lowest[index]))
        shows = low < walls.top[index]
        index, low = index[shows], low[shows]
    ratios = texel_ratios(walls, index, cell)
    a, b = walls.a[index] - eye[:2], walls.b[index] - eye[:2]
    bottom, top = low - eye[2], walls.top[index] - eye[2]
    views = []
    for sector in range(sectors):
        azimuth = 2.0 * half * sector
        within = _project(a, b, bottom, top, azimuth, focal, math.tan(half) + 2.0 * quad / focal)[0]
        if not within.any():
            continue
        fine = focal * float(ratios[within].max())
        border = quad * (math.ceil(fine * math.tan(half) / quad) + 1)
        seen, u, v_low, v_high = _project(a, b, bottom, top, azimuth, fine, border / fine)
        if not seen.any():
            continue
        # With room for a rim of a texel (mmi.capture.rims) all around.
        left = max(quad * math.floor((u.min() - 1.0) / quad), -border)
        right = min(quad * math.ceil((u.max() + 1.0) / quad), border)
        upper, lower = quad * math.floor((v_low.min() - 1.0) / quad), quad * math.ceil((v_high.max() + 1.0) / quad)
        window = (left, upper, max(right - left, quad), max(lower - upper, quad))
        views.append((sector, level_view(eye, azimuth, focal=fine, window=window)))
    return views


def _project(
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    bottom: NDArray[np.float64],
    top: NDArray[np.float64],
    azimuth: float,
    focal: float,
    spread: float,
) -> tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Walls clipped to |x| <= ``spread`` * depth: which remain (n,), their u (k, 2), least v (k, 2), largest v (k, 2)."""
    forward = np.array([math.cos(azimuth), math.sin(azimuth)])
    right = np.array([math.sin(azimuth), -math.cos(azimuth)])
    xa, da, xb, db = a @ right, a @ forward, b @ right, b @ forward
    start, end = np.zeros(len(a)), np.ones(len(a))
    with np.errstate(divide="ignore", invalid="ignore"):
        for fa, fb in (
            (spread * da - xa, spread * db - xb),
            (spread * da + xa, spread * db + xb),
            (da - 1e-3, db - 1e-3),
        ):
            crossing = fa / (fa - fb)
            start = np.where((fa < 0.0) & (fb >= 0.0), np.maximum(start, crossing), start)
            end = np.where((fa >= 0.0) & (fb < 0.0), np.minimum(end, crossing), end)
            end = np.where((fa < 0.0) & (fb < 0.0), -1.0, end)
    seen = start <= end
    t = np.stack([start, end], axis=1)[seen]
    x = xa[seen, None] + t * (xb - xa)[seen, None]
    depth = da[seen, None] + t * (db - da)[seen, None]
    v_top, v_bottom = -focal * top[seen, None] / depth, -focal * bottom[seen, None] / depth
    return seen, focal * x / depth, np.minimum(v_top, v_bottom), np.maximum(v_top, v_bottom)
