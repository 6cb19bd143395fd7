"""A cell as visibility looks at it: viewpoints spaced on its outline, and the footprints that its rectangle meets."""

from __future__ import annotations

import math

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon

from mmi.cells.viewing_cells import ViewingCell
from mmi.foundation.errors import ParameterError

__all__ = ["TOUCH", "footprints_met", "sample_viewpoints"]

TOUCH = 1e-3
"""Metres: a wall this far inside a cell does not count as cutting into it; a base this far up stands on the ground."""


def sample_viewpoints(cell: ViewingCell, *, reach: float) -> NDArray[np.float64]:
    """(k, 3) points on the outline of the cell's rectangle, at the top of its eye band.

    Every point of the outline is within ``reach`` metres of one; what the inside sees, the outline sees (see above).
    """
    if not reach > 0.0:
        raise ParameterError(f"viewpoints reach a positive distance, found {reach}")
    corners = cell.corners
    outline = shapely.linearrings(corners)
    count = math.ceil(outline.length / (2.0 * reach))
    at = (np.arange(count) + 0.5) * (outline.length / count)
    xy = shapely.get_coordinates(shapely.line_interpolate_point(outline, at))
    return np.column_stack([xy, np.full(count, cell.eye[1])])


def footprints_met(prisms: shapely.STRtree, region: Polygon) -> NDArray[np.int64]:
    """Sorted indices of the footprints that ``region`` meets or touches."""
    return np.sort(prisms.query(region, predicate="dwithin", distance=TOUCH))
