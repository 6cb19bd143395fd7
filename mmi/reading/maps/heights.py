"""How high things are: tags to metres, and guesses where the map is silent.

In this order: the height tag or column, the number of levels times 3.2 m, for a part its building's height, else the
median of the nearest buildings whose height is known.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mmi import limits
from mmi.reading.report import Ledger

__all__ = [
    "FOOT",
    "LEVEL_HEIGHT",
    "OPEN_ROOF_HEIGHT",
    "Heights",
    "heights_from_neighbours",
    "heights_from_tags",
    "parse_metres",
    "settle_span",
]

LEVEL_HEIGHT = 3.2
"""Metres a level."""

OPEN_ROOF_HEIGHT = 4.0
"""Metres: the height of an open roof (canopy, carport) without a tag; the heights of its neighbours say nothing about it."""

FOOT = 0.3048
"""Metres a foot."""

_NEIGHBOURS = 8
_OPEN_ROOFS = frozenset({"roof", "canopy", "carport"})
_OPEN_ROOF_THICKNESS = 0.5

_NUMBER = r"\d+(?:[.,]\d+)?|[.,]\d+"
_METRIC = re.compile(rf"[~≈]?\s*([+-]?(?:{_NUMBER}))\s*(m|meters?|metres?|cm|km|ft|feet|foot)?\.?", re.IGNORECASE)
_IMPERIAL = re.compile(rf"({_NUMBER})\s*['’′]\s*(?:({_NUMBER})\s*(?:\"|''|”|″))?")
_UNITS = MappingProxyType({"": 1.0, "m": 1.0, "c": 0.01, "k": 1000.0, "f": FOOT})


def parse_metres(text: str) -> float | None:
    """Metres in ``text``: 12 | 12 m | 12,5 | 40 ft | 40' | 12'6"; None if it is none of these."""
    text = text.strip()
    if match := _METRIC.fullmatch(text):
        return float(match[1].replace(",", ".")) * _UNITS[(match[2] or "")[:1].lower()]
    if match := _IMPERIAL.fullmatch(text):
        feet, inches = float(match[1].replace(",", ".")), float((match[2] or "0").replace(",", "."))
        return (feet + inches / 12.0) * FOOT
    return None


@dataclass(frozen=True, slots=True)
class Heights:
    """What the tags of one outline say, metres above the ground; None where they are silent or absurd."""

    top: float | None
    bottom: float | None
    open_roof: bool


def _sane(
    tags: dict[str, str], keys: tuple[str, ...], low: float, high: float, id_: str, what: str, ledger: Ledger
) -> float | None:
    """First of ``keys`` with a number in [``low``, ``high``]; everything else found on the way is counted."""
    for key in keys:
        if key not in tags:
            continue
        value = parse_metres(tags[key])
        if value is None:
            ledger.note("repaired", f"{what} that is no number ignored", id_)
        elif not (math.isfinite(value) and low <= value <= high):
            ledger.note("repaired", f"absurd {what} ignored", id_)
        else:
            return value
    return None


def heights_from_tags(
    id_: str, tags: dict[str, str], ledger: Ledger, *, height_label: str, levels_label: str
) -> Heights:
    """Heights that the tags of outline ``id_`` give. Heights outside (0, 1000] m and levels outside (0, 250] are ignored."""
    tiny = 1e-3
    top = _sane(tags, ("height", "building:height", "est_height"), tiny, limits.BUILDING_HEIGHT, id_, "height", ledger)
    if top is not None:
        ledger.note("inferred", f"height from {height_label}")
    else:
        levels = _sane(tags, ("building:levels",), tiny, limits.BUILDING_LEVELS, id_, "number of levels", ledger)
        if levels is not None:
            top = levels * LEVEL_HEIGHT
            ledger.note("inferred", f"height from {levels_label} x {LEVEL_HEIGHT} m")
    bottom = _sane(tags, ("min_height", "building:min_height"), 0.0, limits.BUILDING_HEIGHT, id_, "min_height", ledger)
    if bottom is None:
        level = _sane(tags, ("building:min_level",), 0.0, limits.BUILDING_LEVELS, id_, "min_level", ledger)
        bottom = None if level is None else level * LEVEL_HEIGHT
    kinds = {tags.get("building", "").lower(), tags.get("building:part", "").lower()}
    open_roof = not kinds.isdisjoint(_OPEN_ROOFS)
    return Heights(top, bottom, open_roof)


def heights_from_neighbours(
    unknown_xy: NDArray[np.float64], known_xy: NDArray[np.float64], known_top: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Median of the ``known_top`` (k,) of the 8 nearest of ``known_xy`` (k, 2), k > 0, for each of ``unknown_xy`` (n, 2)."""
    if len(unknown_xy) == 0:
        return np.zeros(0)
    _, nearest = cKDTree(known_xy).query(unknown_xy, k=min(_NEIGHBOURS, len(known_xy)))
    tops = known_top[np.asarray(nearest).reshape(len(unknown_xy), -1)]
    return np.asarray(np.median(tops, axis=1), dtype=np.float64)


def settle_span(id_: str, heights: Heights, fallback_top: float, ledger: Ledger) -> tuple[float, float]:
    """(bottom, top) of one outline above the ground, bottom < top, with ``fallback_top`` where its tags give no top."""
    top = fallback_top if heights.top is None else heights.top
    bottom = heights.bottom
    if bottom is None:
        return (max(0.0, top - _OPEN_ROOF_THICKNESS) if heights.open_roof else 0.0), top
    if bottom < top:
        return bottom, top
    if heights.top is None:
        ledger.note("repaired", "floating part without a height taken as one level", id_)
        return bottom, bottom + LEVEL_HEIGHT
    ledger.note("repaired", "min_height not below height: stands on the ground", id_)
    return 0.0, top
