"""Footprints with a height become prisms: what is known of buildings at level of detail 0.

The height is told by an attribute with one of the names that columns of maps have, or by a number of storeys.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mmi import limits
from mmi.reading.maps.gis_columns import HEIGHT_COLUMNS, LEVELS_COLUMNS, plain_name, says_feet
from mmi.reading.maps.heights import FOOT, LEVEL_HEIGHT, parse_metres

__all__ = ["height_from_attributes", "prism_of_rings"]

_LEVELS = ("storeysaboveground", *LEVELS_COLUMNS)


def height_from_attributes(attributes: Mapping[str, object]) -> tuple[float, str] | None:
    """Metres, and what they come from (``measuredHeight``, ``storeysAboveGround x 3.2 m``); None where nothing says so."""
    for names, metres, note in ((HEIGHT_COLUMNS, 1.0, ""), (_LEVELS, LEVEL_HEIGHT, f" x {LEVEL_HEIGHT} m")):
        for wanted in names:
            for name, value in attributes.items():
                if plain_name(name) == wanted:
                    height = metres * _number(value) * (FOOT if says_feet(name) else 1.0)
                    if 0.0 < height <= limits.BUILDING_HEIGHT:
                        return height, f"{name}{note}"
    return None


def _number(value: object) -> float:
    """The number in an attribute, which may name its unit; not a number where there is none."""
    if isinstance(value, Mapping):  # {"value": 12.0, "uom": "m"}, where the unit may be a URN
        in_feet = re.search("ft|feet|foot", str(value.get("uom")), re.IGNORECASE)
        value = f"{value.get('value')} {'ft' if in_feet else ''}".strip()
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return math.nan
    found = parse_metres(str(value))
    return math.nan if found is None else found


def prism_of_rings(
    rings: Sequence[NDArray[np.float64]], height: float, *, roof: bool = False
) -> tuple[NDArray[np.float64], list[list[list[int]]]]:
    """Points (n, 3) and faces of the prism over rings (k, 3), the outer one first; faces are rings of places in the points.

    It stands on the lowest point of the rings and is ``height`` metres high; a ``roof`` hangs as low below its highest point.
    All faces look outwards, whichever way the rings turn.
    """
    level = np.concatenate(rings)[:, 2]
    base = float(level.max()) - height if roof else float(level.min())
    points: list[NDArray[np.float64]] = []
    floor: list[list[int]] = []
    ceiling: list[list[int]] = []
    walls: list[list[list[int]]] = []
    count = 0
    for i, ring in enumerate(rings):
        flat = _open(ring[:, :2])
        if len(flat) < 3:
            if i == 0:
                break
            continue
        if (_turn(flat) > 0.0) != (i == 0):  # the outer ring counter-clockwise, courtyards the other way
            flat = flat[::-1]
        n = len(flat)
        points += [np.column_stack([flat, np.full(n, z)]) for z in (base, base + height)]
        low = [count + k for k in range(n)]
        floor.append(low[::-1])
        ceiling.append([n + k for k in low])
        walls += [[[low[k], low[(k + 1) % n], n + low[(k + 1) % n], n + low[k]]] for k in range(n)]
        count += 2 * n
    if not points:
        return np.empty((0, 3)), []
    return np.concatenate(points), [floor, ceiling, *walls]


def _open(ring: NDArray[np.float64]) -> NDArray[np.float64]:
    """The ring without points that repeat the one before, its first included."""
    return ring[(ring != np.roll(ring, 1, axis=0)).any(axis=1)]


def _turn(ring: NDArray[np.float64]) -> float:
    """Twice the area of a ring (n, 2), positive where it turns counter-clockwise."""
    near = ring - ring[0]
    x, y = near.T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())
