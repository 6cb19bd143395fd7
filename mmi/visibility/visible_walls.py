"""What of some objects' walls a cell may see, and from which viewpoints: what the weights of
:mod:`mmi.parallax.ray_weights` run over.

Viewpoints are the cell's outline: over a region the angle between two fixed points is largest on its boundary. A point seen
from inside the cell is seen from the outline behind as well, and parallax grows along that line of sight; so each line of
sight counts with the stretch of the outline where it leaves the cell.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from mmi.cells.viewing_cells import ViewingCell
from mmi.foundation.kernels import kernel
from mmi.visibility.horizon_sweep import BINS
from mmi.visibility.selection import WallVisibility
from mmi.visibility.walls import Walls

__all__ = ["VisibleWalls", "around", "seen_from", "visible_walls"]

_VIEWPOINTS = 64
"""There are at least so many viewpoints around a cell."""


class VisibleWalls(NamedTuple):
    """The walls of some objects as seen from the reference viewpoint, and the viewpoints that may see them; kernels take it.

    ``a``, ``b`` (w, 2) metres from the reference; ``bottom``, ``low``, ``top`` (w,) metres above it: the wall, and the lowest
    that is visible of it; ``owner`` (w,) counts in the list of objects, object i has walls ``first[i]`` to ``first[i + 1]``.
    ``visible_from`` (w, p): which of the ``viewpoints`` (p, 2), metres from the reference, may see the wall; none where it is
    hidden. ``open`` (w,): the wall belongs to a prism whose underside or roof may be seen, and which ends at this wall; all
    viewpoints count for these. ``rise`` is half the height of the eye band in metres.
    """

    a: NDArray[np.float64]
    b: NDArray[np.float64]
    bottom: NDArray[np.float64]
    low: NDArray[np.float64]
    top: NDArray[np.float64]
    owner: NDArray[np.int64]
    first: NDArray[np.int64]
    visible_from: NDArray[np.bool_]
    open: NDArray[np.bool_]
    viewpoints: NDArray[np.float64]
    rise: float


def visible_walls(
    cell: ViewingCell, walls: Walls, objects: NDArray[np.int64], wall_visibility: WallVisibility | None
) -> VisibleWalls:
    """The walls of ``objects`` (n,) from a cell's reference viewpoint; without ``wall_visibility`` all that face the cell
    show.
    """
    index = walls.of(objects)
    counts = walls.first[objects + 1] - walls.first[objects]
    x, y, eye = cell.reference
    a, b = walls.a[index] - (x, y), walls.b[index] - (x, y)
    bottom, top = walls.bottom[index] - eye, walls.top[index] - eye
    corners = cell.corners - (x, y)
    bins = BINS if wall_visibility is None else wall_visibility.bins
    bits = np.full(len(index), 2**64 - 1, dtype=np.uint64) if wall_visibility is None else wall_visibility.bits[index]
    low = bottom.copy() if wall_visibility is None else np.maximum(bottom, wall_visibility.lowest[index] - eye)
    seen = seen_from(bits, bins)
    viewpoints = around(corners, seen.shape[1])
    visible_from = _visible_from(a, b, seen & (low < top)[:, None], corners, viewpoints)
    rise = 0.5 * (cell.eye[1] - cell.eye[0])
    ends = (bottom > -rise) | (top < rise)
    visible_from[ends], low[ends] = True, bottom[ends]
    return VisibleWalls(
        a=a,
        b=b,
        bottom=bottom,
        low=low,
        top=top,
        owner=np.repeat(np.arange(len(objects)), counts),
        first=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        visible_from=visible_from,
        open=ends,
        viewpoints=viewpoints,
        rise=rise,
    )


def around(corners: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """(count, 2) points at equal distances around the rectangle of ``corners`` (4, 2), four moved to these; ``count`` >= 4."""
    outline = shapely.linearrings(corners)
    spaced = shapely.line_interpolate_point(outline, np.arange(count) / count, normalized=True)
    points = np.asarray(shapely.get_coordinates(spaced), dtype=np.float64)
    sides = np.hypot(*np.diff(np.vstack([corners, corners[:1]]), axis=0).T)
    places = np.rint(count * np.cumsum([0.0, *sides[:3]]) / sides.sum()).astype(np.int64)
    for i in (1, 2, 3):  # no two in one place, the last before the first
        places[i] = min(max(places[i], places[i - 1] + 1), count - 4 + i)
    points[places] = corners
    return points


def seen_from(bits: NDArray[np.uint64], bins: int) -> NDArray[np.bool_]:
    """(w, p): from which viewpoints :func:`around` the cell walls may be seen, by their ``bits`` (w,): as many for each bin.

    A viewpoint where a bin begins counts for the one that ends there, too. p is at least ``_VIEWPOINTS``.
    """
    each = max(2, math.ceil(_VIEWPOINTS / bins))
    seen = (bits[:, None] >> np.arange(bins, dtype=np.uint64) & np.uint64(1)).astype(np.bool_)
    if bins == BINS:  # of more viewpoints than bins, some share a bin with the next
        seen = seen | np.roll(seen, 1, axis=1) | np.roll(seen, -1, axis=1)
    at = np.repeat(seen, each, axis=1)
    at[:, ::each] |= np.roll(seen, 1, axis=1)
    return at


@kernel(error_model="numpy")
def _visible_from(
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    visible: NDArray[np.bool_],
    corners: NDArray[np.float64],
    viewpoints: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """(w, p): the viewpoints from which a wall is ``visible`` (w, p) and that it faces, and those where these lines of sight
    leave the cell.
    """
    p = len(viewpoints)
    length, width = corners[1] - corners[0], corners[2] - corners[1]
    along, across = math.hypot(length[0], length[1]), math.hypot(width[0], width[1])
    around = 2.0 * (along + across)
    ux, uy = length / along
    visible_from = np.zeros((len(a), p), dtype=np.bool_)
    seen, left = np.empty(p, dtype=np.bool_), np.empty(p, dtype=np.bool_)
    for w in range(len(a)):
        ex, ey = b[w, 0] - a[w, 0], b[w, 1] - a[w, 1]
        for k in range(p):
            # The middle of a bin stands for it all: what faces its ends only may not face it.
            x, y = a[w, 0] - viewpoints[k, 0], a[w, 1] - viewpoints[k, 1]
            seen[k] = visible[w, k] and x * ey - y * ex <= 0.0
        left[:] = seen
        for k in range(p):
            if not seen[k]:
                continue
            for end in range(2):
                x = (b[w, 0] if end else a[w, 0]) - viewpoints[k, 0]
                y = (b[w, 1] if end else a[w, 1]) - viewpoints[k, 1]
                # In the cell's frame, from its first corner: where the line towards (x, y) leaves [0, along] x [0, across].
                fx, fy = viewpoints[k, 0] - corners[0, 0], viewpoints[k, 1] - corners[0, 1]
                px, py = fx * ux + fy * uy, fy * ux - fx * uy
                dx, dy = x * ux + y * uy, y * ux - x * uy
                tx = ((along if dx > 0.0 else 0.0) - px) / dx if dx != 0.0 else math.inf
                ty = ((across if dy > 0.0 else 0.0) - py) / dy if dy != 0.0 else math.inf
                t = max(min(tx, ty), 0.0)
                qx, qy = px + t * dx, py + t * dy
                if tx < ty:
                    at = along + qy if dx > 0.0 else 2.0 * along + across + (across - qy)
                else:
                    at = along + across + (along - qx) if dy > 0.0 else qx
                place = math.floor(at / around * p)
                left[place % p] = left[(place + 1) % p] = True
        visible_from[w] = left
    return visible_from
