"""The paper's item buffer (section 5.3): what pictures of object ids show from points on the cell's outline.

Full panoramas from samples on the outline; what is drawn in some pixel is visible. Works for any mesh, may miss what shows
only between the samples or in less than a pixel.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon

from mmi.foundation.camera import View, level_views_around
from mmi.foundation.errors import ParameterError
from mmi.visibility.cell_outline import TOUCH, footprints_met, sample_viewpoints
from mmi.visibility.selection import Extractor, Selection, narrowed

__all__ = ["Identify", "item_buffer_extractor", "panorama"]

Identify = Callable[[NDArray[np.int64], View], NDArray[np.int32]]
"""(objects, view) -> (h, w): the object that each pixel of the view's window shows of ``objects``, -1 where none."""


def item_buffer_extractor(identify: Identify, *, resolution: int = 512, spacing: float = 4.0) -> Extractor:
    """Narrows a selection to what pictures of object ids show (paper section 5.3), and what the cell touches.

    Panoramas of six views, ``resolution`` pixels across each, from points ``spacing`` metres apart on the cell's outline;
    points inside a solid do not count. ``identify`` draws.
    """
    if resolution < 1:
        raise ParameterError(f"an item buffer needs at least 1 pixel across a view, found {resolution}")

    def extract(selection: Selection) -> Selection:
        prisms = [(prism, i) for i in selection.objects for prism in selection.city.objects[i].prisms]
        footprints = np.array([prism.footprint for prism, _ in prisms], dtype=object)
        spans = np.array([(prism.bottom, prism.top) for prism, _ in prisms]).reshape(-1, 2)
        touching = footprints_met(shapely.STRtree(footprints), Polygon(selection.cell.corners))
        seen = np.zeros(len(selection.city.objects), dtype=bool)
        seen[[prisms[i][1] for i in touching]] = True
        for eye in sample_viewpoints(selection.cell, reach=0.5 * spacing):
            distances = shapely.distance(footprints, shapely.Point(eye[:2]))
            if np.any((distances == 0.0) & (spans[:, 0] < eye[2]) & (eye[2] < spans[:, 1])):
                continue
            away = np.maximum(distances, TOUCH)
            slopes = (spans - eye[2]) / away[:, None]
            for view in panorama(eye, resolution=resolution, rise=_most(slopes[:, 1]), fall=_most(-slopes[:, 1])):
                shown = identify(selection.objects, view)
                seen[np.unique(shown[shown >= 0])] = True
        return narrowed(selection, np.flatnonzero(seen))

    return extract


def _most(slopes: NDArray[np.float64]) -> float:
    return float(np.max(slopes, initial=0.0))


def panorama(
    eye: NDArray[np.float64], *, resolution: int, rise: float, fall: float, sectors: int = 6
) -> tuple[View, ...]:
    """Level views all around ``eye`` (3,), ``resolution`` pixels across each.

    They show slopes (height over horizontal distance) from ``-fall`` to ``rise``, but none beyond 75 degrees.
    """
    half = math.pi / sectors
    focal = 0.5 * resolution / math.tan(half)
    steepest = math.tan(math.radians(75.0))
    up, down = (math.ceil(focal * min(slope, steepest) / math.cos(half)) + 1 for slope in (rise, fall))
    window = (-(resolution // 2), -up, resolution, up + down)
    return level_views_around(eye, sectors, focal=focal, window=window)
