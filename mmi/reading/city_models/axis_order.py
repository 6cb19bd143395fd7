"""Which of two horizontal coordinates points east: what a coordinate system says, what its writers did, and what solids prove.

CityGML follows its coordinate system, of which many say latitude or northing first, and many writers put east first all the
same. Where only one order falls into the area of the system, that one is meant. Where both do (a system for the whole world) or
neither, the faces of solids tell: they look outwards in a right-handed frame, and inwards with exchanged axes.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

import numpy as np
import pyproj
from numpy.typing import NDArray
from pyproj.exceptions import ProjError

from mmi.city.model import TriangleMesh
from mmi.reading.report import Ledger

__all__ = ["axes_are_exchanged"]

_CLEAR = 0.9
"""Share of the volume that has to say the same."""


def axes_are_exchanged(
    points: NDArray[np.float64], crs: pyproj.CRS, solids: Iterable[TriangleMesh], ledger: Ledger
) -> bool:
    """Whether the first coordinate of ``points`` (n, 3) points north; ``solids`` are buildings in these coordinates."""
    north_first = bool(crs.axis_info) and crs.axis_info[0].direction.lower() == "north"
    as_read, exchanged = _inside_area(points, crs)
    if not north_first:
        return False
    if as_read != exchanged:
        answer = exchanged
    else:
        sign = _facing(solids)
        answer = sign <= 0
        if sign:
            ledger.note("noted", "order of the axes: told by the faces of the buildings, which look outwards")
    if not answer:
        ledger.note("noted", "order of the axes: east first, though the coordinate system says north first")
    return answer


def _inside_area(points: NDArray[np.float64], crs: pyproj.CRS) -> tuple[bool, bool]:
    """Whether the middle of the points lies in the area of the coordinate system, with east first and with north first."""
    area = crs.area_of_use
    if area is None or not len(points):
        return False, False
    x, y = np.median(points[:, :2], axis=0)
    try:
        places = [_to_degrees(crs).transform(x, y), _to_degrees(crs).transform(y, x)]
    except ProjError:
        return False, False
    east_first, north_first = (area.west <= lon <= area.east and area.south <= lat <= area.north for lon, lat in places)
    return east_first, north_first


@lru_cache(maxsize=16)
def _to_degrees(crs: pyproj.CRS) -> pyproj.Transformer:
    """Looked for once for all tiles of a city."""
    return pyproj.Transformer.from_crs(crs, pyproj.CRS.from_epsg(4326), always_xy=True)


def _facing(solids: Iterable[TriangleMesh]) -> int:
    """1 where the faces of nearly all of the volume look outwards, -1 where they look inwards, 0 where that is not clear.

    A floor may be missing: it is taken to lie at the lowest point.
    """
    outwards = inwards = 0.0
    for mesh in solids:
        low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        size = np.where(high > low, high - low, 1.0)  # degrees and metres alike
        a, b, c = np.moveaxis(((mesh.vertices - (*(0.5 * (low + high))[:2], low[2])) / size)[mesh.triangles], 1, 0)
        volume = float((a * np.cross(b, c)).sum() / 6.0)
        outwards, inwards = outwards + max(volume, 0.0), inwards - min(volume, 0.0)
    total = outwards + inwards
    if total <= 0.0 or max(outwards, inwards) < _CLEAR * total:
        return 0
    return 1 if outwards > inwards else -1
