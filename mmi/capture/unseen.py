"""Texels of a capture that nobody in the cell can see: they are left out.

A layer is captured without what is in front of it, so its picture holds all of its objects that the reference viewpoint would
see if the rest of the city were not there. Much of that is hidden, from everywhere in the cell, by near objects and by other
layers: :class:`mmi.visibility.selection.WallVisibility` knows the lowest visible point of each wall. What is below takes
memory for nothing, and mixes into the depths of what is visible beside it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mmi.capture.layer_values import DepthTexture
from mmi.cells.viewing_cells import ViewingCell
from mmi.city.model import City
from mmi.foundation.kernels import kernel
from mmi.visibility.selection import WallVisibility
from mmi.visibility.walls import Walls

__all__ = ["seen_of_meshes", "without_unseen"]

_ON_WALL = 0.05
"""Metres that a captured point may lie off its wall; a thousandth of its distance is added, since depths are no more exact."""
_SAME = 1e-5
"""A point is on the same wall as the one above it where their distances differ by less than this share."""
_ABOVE = 1.0
"""Metres: nobody in the cell has eyes this far above the reference viewpoint, so roofs that are higher cannot be seen."""


def seen_of_meshes(
    city: City, cell: ViewingCell, objects: NDArray[np.int64], walls: Walls, wall_visibility: WallVisibility
) -> WallVisibility:
    """``wall_visibility`` for what lies within the walls of detailed meshes among ``objects`` (n,), not only for the walls.

    A wall that faces away is hidden, by its own prism if by nothing else. A mesh may be anywhere within the prism: a tower at
    the back of a low house stands at that wall, in full sight. Who sees it looks into the prism through a wall that shows, and
    not below what of that can be seen; from there upwards, if that is above all eyes. So along walls that face away from any
    corner of the cell, what is higher than the lowest that shows of any wall of the object may be seen.
    """
    meshes = np.array([i for i in objects if city.objects[i].mesh is not None], dtype=np.int64)
    lowest, eye = wall_visibility.lowest.copy(), cell.eye[1]
    for i in meshes:
        own = slice(walls.first[i], walls.first[i + 1])
        least = float(wall_visibility.lowest[own].min())
        if least <= eye or walls.top[own].min() < eye:
            least = -np.inf  # lines of sight may go down there, or come in through a roof
        a, b = (end[own, None, :] - cell.corners for end in (walls.a, walls.b))
        away = (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0] >= 0.0).any(axis=1)
        lowest[own] = np.where(away, np.minimum(lowest[own], least), lowest[own])
    return WallVisibility(lowest, wall_visibility.bits, wall_visibility.bins)


def without_unseen(texture: DepthTexture, walls: Walls, wall_visibility: WallVisibility) -> DepthTexture:
    """``texture`` without the texels of walls that lie a texel or more below what ``wall_visibility`` says may be seen of them.

    Of a wall that is hidden in whole nothing is left, unless it is so low that its top may be a roof's edge in wall_visibility.

    A point near several walls of its object goes by the one that is visible lowest; one that is on none (a roof, an
    underside) stays.
    """
    view = texture.view
    axes = np.ascontiguousarray(view.world_from_eye[:2, :3])
    hidden = _hidden(
        texture.depth,
        texture.object_ids,
        view.window[0],
        view.window[1],
        view.focal,
        view.eye,
        axes,
        walls.a,
        walls.b,
        walls.first,
        np.where(
            walls.top < view.eye[2] + _ABOVE,
            np.minimum(wall_visibility.lowest, walls.top),
            np.where(wall_visibility.lowest < walls.top, wall_visibility.lowest, np.inf),
        ),
    )
    depth, ids = texture.depth.copy(), texture.object_ids.copy()
    depth[hidden], ids[hidden] = np.inf, -1
    return DepthTexture(view, texture.color, depth, ids)


@kernel(error_model="numpy")
def _hidden(
    depth: NDArray[np.float32],
    ids: NDArray[np.int32],
    left: int,
    top: int,
    focal: float,
    eye: NDArray[np.float64],
    axes: NDArray[np.float64],
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    first: NDArray[np.int64],
    lowest: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """(h, w). ``axes`` (2, 3) turn the eye's directions into the ground plane; the view is level."""
    hidden = np.zeros(depth.shape, dtype=np.bool_)
    for i in range(depth.shape[1]):
        last, known = -1, 0.0  # down a column, a wall is at one distance
        found, low = False, np.inf
        for j in range(depth.shape[0]):
            one = ids[j, i]
            if one < 0:
                continue
            z = np.float64(depth[j, i])
            u = (left + i + 0.5) / focal * z
            height = eye[2] - (top + j - 0.5) / focal * z  # of the texel above
            if one == last and abs(z - known) <= _SAME * z:
                hidden[j, i] = found and height < low
                continue
            last, known = one, z
            x, y = eye[0] + axes[0, 0] * u - axes[0, 2] * z, eye[1] + axes[1, 0] * u - axes[1, 2] * z
            nearest = _ON_WALL + 1e-3 * z
            reach = nearest * nearest
            found, low = False, np.inf
            for w in range(first[one], first[one + 1]):
                ex, ey, px, py = b[w, 0] - a[w, 0], b[w, 1] - a[w, 1], x - a[w, 0], y - a[w, 1]
                square = ex * ex + ey * ey
                t = min(max((px * ex + py * ey) / square, 0.0), 1.0) if square > 0.0 else 0.0
                if (px - t * ex) ** 2 + (py - t * ey) ** 2 <= reach:
                    found = True
                    low = min(low, lowest[w])
            hidden[j, i] = found and height < low
    return hidden
