"""Which objects can overlap in the image from somewhere in a cell: critical zones (paper section 4.1, figure 2).

A visibility event between two objects needs a line of sight from the cell that meets both. Such a line runs, up to the
farther object, inside the convex hull of that object and the cell, its *critical zone*: two objects of which neither
meets the zone of the other never overlap, whatever their heights. Everything here happens in the ground plane.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from mmi.cells.viewing_cells import ViewingCell

__all__ = ["cell_region", "critical_zone", "interacting_pairs"]


def cell_region(cell: ViewingCell) -> Polygon:
    """The rectangle where the viewer may be, metres: the cell's axis swept sideways by its half width."""
    return Polygon(cell.corners)


def critical_zone(cell: ViewingCell, footprint: BaseGeometry) -> Polygon:
    """Convex hull of an object's ``footprint`` and the cell's region, metres (paper section 4.1, figure 2)."""
    return _critical_zones(cell, [footprint])[0]


def interacting_pairs(cell: ViewingCell, footprints: Sequence[BaseGeometry]) -> NDArray[np.int64]:
    """Pairs of objects of which one meets the critical zone of the other; all other pairs have weight zero.

    ``footprints`` are polygons or multipolygons in metres. Returns (m, 2) indices into ``footprints``, i < j in each row,
    rows in lexicographic order. Touching counts as meeting.
    """
    if len(footprints) < 2:
        return np.empty((0, 2), dtype=np.int64)
    zones = _critical_zones(cell, footprints)
    shapely.prepare(zones)
    zone_of, met = shapely.STRtree(footprints).query(zones, predicate="intersects")
    first, second = np.minimum(zone_of, met), np.maximum(zone_of, met)
    keys = np.unique((first * len(footprints) + second)[first < second])
    return np.stack(np.divmod(keys, len(footprints)), axis=1).astype(np.int64)


def _critical_zones(cell: ViewingCell, footprints: Sequence[BaseGeometry]) -> NDArray[np.object_]:
    """(n,) the critical zone of each footprint."""
    coordinates, owner = shapely.get_coordinates(footprints, return_index=True)
    n = len(footprints)
    points = np.concatenate([coordinates, np.tile(cell.corners, (n, 1))])
    owner = np.concatenate([owner, np.repeat(np.arange(n), 4)])
    order = np.argsort(owner, kind="stable")
    return np.asarray(shapely.convex_hull(shapely.multipoints(shapely.points(points[order]), indices=owner[order])))
