"""Where everything is: footprints, cells on their streets, and what each cell draws how. Plain data for a map, bounded in size.

A district is told whole. Of a metropolis what is nearest to the viewer is told, and that there is more; who goes on asks again.
All coordinates are metres in the city's frame, (x, y), rounded to decimetres.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from mmi.city.model import City
from mmi.dataset.manifest import CellEntry
from viewer.scene.scene import WalkScene

__all__ = ["CityMap"]

_TOLERANCE = 0.5
"""Metres that a simplified outline may be off."""
_MOST_POINTS = 100_000
"""So many points of outlines are told at most, some 1.5 MB."""
_MOST_CELLS = 5_000
_MOST_ENTRIES = 40_000
"""So many objects of cells are told at most, some 1 MB: ids may be long."""


class CityMap:
    """The map of a ``scene``, whose ``city`` is needed here only. What is told whole is worked out once."""

    def __init__(self, scene: WalkScene, city: City) -> None:
        self._scene = scene
        self._ids = [one.id for one in city.objects]
        footprints = np.array([one.footprint for one in city.objects], dtype=object)
        self._outlines: NDArray[np.object_] = shapely.simplify(footprints, _TOLERANCE, preserve_topology=True)
        self._points = shapely.get_num_coordinates(self._outlines)
        self._middles = shapely.get_coordinates(shapely.centroid(footprints)).reshape(-1, 2)
        entries = scene.dataset.manifest.cells
        self._entries = entries
        self._cell_middles = np.array([entry.reference[:2] for entry in entries]).reshape(-1, 2)
        self._whole: dict[str, Any] | None = None

    def told(self, around: tuple[float, float]) -> dict[str, Any]:
        """The map, or as much of it as lies nearest to ``around`` (x, y); ``whole`` says which.

        ``footprints``: id and rings of each object. ``cells``: id, street, axis, half_width and, of those that are near enough,
        ``near`` (ids of what stays geometry), ``layers`` (id -> index of its layer) and ``unseen`` (ids of far objects that no
        layer shows, as the middle of the cell does not see them). What is in none of them cannot be seen from there.
        """
        if self._whole is not None:
            return self._whole
        chosen = _nearest(self._middles, around, self._points, most=_MOST_POINTS)
        cells = _nearest(self._cell_middles, around, np.ones(len(self._entries), dtype=np.int64), most=_MOST_CELLS)
        sizes = np.array([len(self._entries[i].near) + len(self._entries[i].far) for i in cells], dtype=np.int64)
        detailed = int((np.cumsum(sizes) <= _MOST_ENTRIES).sum())
        whole = len(chosen) == len(self._ids) and detailed == len(self._entries)
        found = {
            "bounds": self._bounds(),
            "footprints": [
                {"id": self._ids[i], "rings": rings}
                for i, rings in zip(chosen.tolist(), _rings(self._outlines[chosen]), strict=True)
            ],
            "cells": [
                {**_cell(self._entries[i]), **(_detail(self._entries[i]) if k < detailed else {})}
                for k, i in enumerate(cells.tolist())
            ],
            "whole": whole,
        }
        if whole:
            self._whole = found
        return found

    def _bounds(self) -> list[float]:
        """Of all footprints and cells."""
        corners = [corner for entry in self._entries for corner in entry.axis]
        shapes = [*self._outlines, shapely.multipoints(corners)] if corners else list(self._outlines)
        return [round(float(one), 1) for one in shapely.total_bounds(np.array(shapes, dtype=object))]


def _nearest(
    middles: NDArray[np.float64], around: tuple[float, float], sizes: NDArray[np.int64], *, most: int
) -> NDArray[np.int64]:
    """(k,) the places of those nearest to a point that have ``most`` together at most, the nearest first."""
    order = np.argsort(np.hypot(*(middles - np.array(around)).T), kind="stable")
    return order[np.cumsum(sizes[order]) <= most]


def _rings(outlines: NDArray[np.object_]) -> list[list[list[list[float]]]]:
    """Of each outline its rings, exteriors and holes, without their last points, which are the first again."""
    found: list[list[list[list[float]]]] = [[] for _ in outlines]
    parts, owner = shapely.get_parts(outlines, return_index=True)
    rings, part = shapely.get_rings(parts, return_index=True)
    points, ring = shapely.get_coordinates(rings, return_index=True)
    rounded = np.round(points, 1).tolist()
    ends = np.searchsorted(ring, np.arange(len(rings) + 1)).tolist()
    for k, place in enumerate(owner[part].tolist()):
        found[place].append(rounded[ends[k] : ends[k + 1] - 1])
    return found


def _cell(entry: CellEntry) -> dict[str, Any]:
    return {
        "id": entry.id,
        "street": entry.street,
        "axis": [[round(x, 1), round(y, 1)] for x, y in entry.axis],
        "half_width": round(entry.half_width, 2),
        "promised_px": entry.promised_error_px,
    }


def _detail(entry: CellEntry) -> dict[str, Any]:
    layers: dict[str, int] = {}
    for _, one in entry.pictures:
        layers.update(dict.fromkeys((entry.far[place] for place in one.objects), one.index))
    return {"near": list(entry.near), "layers": layers, "unseen": _without(entry.far, layers)}


def _without(ids: Sequence[str], known: dict[str, int]) -> list[str]:
    return [one for one in ids if one not in known]
