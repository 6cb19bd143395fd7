"""Cells of a city that nobody sees whom a point of the grid serves, by the conservative horizon sweep (mmi.visibility.horizon).

A viewer is served by a point that is behind him, and as far away as the leaf that he is in says: what can hide a cell must hide
it from the whole star of viewers around the point, or the point would show less than they do (section 3.1, enclosed views). So
the sweep is asked for each leaf of the grid, and a point's cells are those hidden from all leaves that it serves. Leaving them
out changes no picture, wherever in these leaves a viewer is and whichever way he looks.

The sweep takes eyes to be above the ground. From a leaf that reaches below it, nothing is hidden.
"""

from __future__ import annotations

import hashlib
import struct
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray

from mmi.cells.viewing_cells import ViewingCell
from mmi.city.model import City
from mmi.foundation.errors import ParameterError
from mmi.foundation.progress import Progress, silent
from mmi.visibility.horizon import horizon_of_boxes, horizon_visible, prepare_horizon
from viewer.placing.model_cells import ModelCells
from viewer.placing.solution_grid import SolutionGrid

__all__ = ["hidden_cells", "print_of_occluders"]

_WIDER = 1e-3
"""Metres that leaves are larger than they are: more than coordinates are rounded by."""


def print_of_occluders(city: City) -> str:
    """The fingerprint of what hides others in ``city``. Raises ParameterError where that is nothing."""
    digest, some = hashlib.sha256(), False
    for one in city.objects:
        for prism in one.occluders:
            digest.update(shapely.to_wkb(prism.footprint, byte_order=1) + struct.pack("<2d", prism.bottom, prism.top))
            some = True
    if not some:
        raise ParameterError(f"hidden: a city with solid buildings expected, found none in {city.source}")
    return digest.hexdigest()


def hidden_cells(city: City, cells: ModelCells, grid: SolutionGrid, progress: Progress = silent) -> NDArray[np.uint8]:
    """(n, b) bits for each point of ``grid``, as :class:`viewer.placing.solution_grid.Needs` has them: of the cells that are
    hidden from all leaves that it serves.
    """
    scene = horizon_of_boxes(prepare_horizon(city), cells.boxes)
    boxes = grid.leaf_boxes + np.array([[-_WIDER], [_WIDER]])
    highest = np.full(len(boxes), city.ground)
    if city.terrain is not None:
        highest = city.terrain.range_over(boxes[:, :, :2].reshape(-1, 4))[1]
    seen = np.ones((len(boxes), len(cells.boxes)), dtype=np.bool_)
    for n, ((x0, y0, z0), (x1, y1, z1)) in enumerate(boxes.tolist()):
        if z0 >= highest[n]:
            middle = 0.5 * (y0 + y1)
            region = ViewingCell("0000-00", (x0, middle), (x1, middle), 0.5 * (y1 - y0), (z0, z1))
            seen[n] = False
            seen[n, horizon_visible(scene, region)[0]] = True
        progress(n + 1, len(boxes), "what is hidden")
    order = np.argsort(grid.leaf_points, kind="stable")
    leaves = np.repeat(np.arange(len(grid.codes)), np.diff(grid.leaf_starts))[order]
    starts = np.searchsorted(grid.leaf_points[order], np.arange(len(grid.points) + 1))
    return np.stack([np.packbits(~seen[leaves[first:end]].any(axis=0)) for first, end in pairwise(starts.tolist())])
