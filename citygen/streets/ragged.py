"""Convex polygons by the hundred thousand: their corners in one array, cut by lines all at once.

What shapely does one polygon at a time in some fifty microseconds takes one here. Only for polygons without holes.
``xy`` (n, 2) are the corners of all, counter-clockwise and not closed; ``owner`` (n,) says whose, sorted.
"""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

__all__ = ["Rings", "are_convex", "cut", "following", "from_rings", "oriented_boxes", "pairs", "to_rings"]

Rings = tuple[NDArray[np.float64], NDArray[np.int64]]
"""``xy`` and ``owner``."""


def to_rings(polygons: NDArray[np.object_]) -> Rings:
    """The outlines of polygons (p,)."""
    xy, owner = shapely.get_coordinates(shapely.get_exterior_ring(shapely.orient_polygons(polygons)), return_index=True)
    last = np.diff(owner, append=-1) != 0
    return xy[~last], owner[~last]


def from_rings(rings: Rings) -> tuple[NDArray[np.object_], NDArray[np.int64]]:
    """Polygons and their owners, of owners that have three corners or more."""
    xy, owner = rings
    names, count = np.unique(owner, return_counts=True)
    kept = np.repeat(count >= 3, count)
    if not kept.any():
        return np.zeros(0, dtype=object), np.zeros(0, dtype=np.int64)
    places = np.repeat(np.arange((count >= 3).sum()), count[count >= 3])
    return shapely.polygons(shapely.linearrings(xy[kept], indices=places)), names[count >= 3]


def following(owner: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) for each corner the place of the next one of its polygon."""
    after = np.arange(1, len(owner) + 1)
    first = np.flatnonzero(np.diff(owner, prepend=-1))
    last = np.flatnonzero(np.diff(owner, append=-1))
    after[last] = first
    return after


def are_convex(polygons: NDArray[np.object_], *, bend: float = 1e-3) -> NDArray[np.bool_]:
    """(p,) whether each polygon shape is one polygon without holes that turns right by at most ``bend`` (sine)."""
    xy, owner = to_rings(polygons)
    after = following(owner)
    along = xy[after] - xy
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-12)[:, None]
    turn = along[:, 0] * along[after, 1] - along[:, 1] * along[after, 0]
    convex = (shapely.get_type_id(polygons) == 3) & ~shapely.is_empty(polygons)
    convex[owner[turn < -bend]] = False
    return np.asarray(convex & (shapely.get_num_interior_rings(polygons) == 0), dtype=np.bool_)


def pairs(
    edge_owner: NDArray[np.int64], corner_owner: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """All pairs of an edge and a corner of the same owner (0, 1, 2, ... in both): edge, corner, and where each edge's start.

    Sorted by edge, then corner.
    """
    corners = np.bincount(corner_owner)
    first = np.concatenate([[0], np.cumsum(corners)[:-1]])
    count = corners[edge_owner]
    start = np.concatenate([[0], np.cumsum(count)[:-1]])
    edge = np.repeat(np.arange(len(edge_owner)), count)
    corner = np.arange(len(edge)) - np.repeat(start, count) + first[edge_owner[edge]]
    return edge, corner, start


def oriented_boxes(
    polygons: NDArray[np.object_],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """The smallest boxes around polygons (p,): middles (p, 2), unit vectors along the longer side (p, 2), sizes (p, 2).

    The longer side comes first. (GEOS 3.14 finds boxes of no area around some polygons that are not convex.)
    """
    xy, owner = to_rings(shapely.convex_hull(polygons))
    along = xy[following(owner)] - xy
    length = np.linalg.norm(along, axis=1)
    along /= np.maximum(length, 1e-12)[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    edge, corner, start = pairs(owner, owner)
    spans = [(xy[corner] * way[edge]).sum(axis=1) for way in (along, across)]
    low = np.stack([np.minimum.reduceat(span, start) for span in spans], axis=1)
    size = np.stack([np.maximum.reduceat(span, start) for span in spans], axis=1) - low
    order = np.lexsort((np.where(length > 1e-6, size.prod(axis=1), np.inf), owner))
    best = order[np.searchsorted(owner, np.arange(len(polygons)))]
    along, across, size = along[best], across[best], size[best]
    place = low[best] + 0.5 * size
    turned = (size[:, 1] > size[:, 0])[:, None]
    middle = place[:, :1] * along + place[:, 1:] * across
    return middle, np.where(turned, across, along), np.where(turned, size[:, ::-1], size)


def cut(rings: Rings, points: NDArray[np.float64], normals: NDArray[np.float64]) -> tuple[Rings, Rings]:
    """What of each polygon lies on the side of its line to which the normal points, and what on the other.

    ``points`` and ``normals`` are given for each corner (n, 2). Both sides have the same corners on the line.
    """
    xy, owner = rings
    after = following(owner)
    side = ((xy - points) * normals).sum(axis=1)
    crosses = side * side[after] < 0.0
    t = side / np.where(crosses, side - side[after], 1.0)
    corners = np.stack([xy, xy + t[:, None] * (xy[after] - xy)], axis=1)
    owners = np.repeat(owner[:, None], 2, axis=1)
    kept = [np.stack([on, crosses], axis=1) for on in (side >= 0.0, side <= 0.0)]
    return (corners[kept[0]], owners[kept[0]]), (corners[kept[1]], owners[kept[1]])
