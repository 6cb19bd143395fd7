"""Longitude is round: towns across 180 degrees, boxes that meet there, and areas that reach over it.

A town on both sides has longitudes near 180 and near -180. It is put together by 360 degrees added to the negative ones; all
transformations of PROJ take such longitudes as they take others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from mmi.reading.raw_layers import BuildingLayer, ModelLayer, StreetLayer

__all__ = [
    "box_of_degrees", "boxes_meet", "degrees_outside", "joined_buildings", "joined_longitudes", "joined_model",
    "joined_streets", "within_180",
]  # fmt: skip

_WIDEST = 10.0
"""Degrees: what is wider when put together is no town on both sides of 180 degrees."""
_OVERLAP_MARGIN_DEGREES = 0.003  # some 200-330 m


def within_180(lon: float) -> float:
    """The longitude in [-180, 180]."""
    return lon if -180.0 <= lon <= 180.0 else (lon + 180.0) % 360.0 - 180.0


def joined_longitudes(lon: NDArray[np.float64]) -> NDArray[np.float64]:
    """Longitudes (n,), the negative ones raised by 360 where all lie around 180 degrees; else as they are."""
    if not lon.size or not -180.0 <= lon.min() < -180.0 + _WIDEST < 180.0 - _WIDEST < lon.max() <= 180.0:
        return lon
    joined = np.where(lon < 0.0, lon + 360.0, lon)
    return joined if np.ptp(joined) <= _WIDEST else lon


def joined_buildings(layer: BuildingLayer) -> BuildingLayer:
    """The layer, put together where it is of degrees on both sides of 180; what it declares does not matter.

    No town in metres has points near 180 and near -180, and none between.
    """
    shapes = _joined([item.geometry for item in layer.items])
    if shapes is None:
        return layer
    items = (replace(item, geometry=shape) for item, shape in zip(layer.items, shapes, strict=True))
    return replace(layer, items=tuple(items))


def joined_streets(layer: StreetLayer) -> StreetLayer:
    """The streets likewise."""
    shapes = _joined([line for item in layer.items for line in item.lines])
    if shapes is None:
        return layer
    left = iter(shapes)
    items = (replace(item, lines=tuple(next(left) for _ in item.lines)) for item in layer.items)
    return replace(layer, items=tuple(items))


def joined_model(layer: ModelLayer) -> ModelLayer:
    """The buildings and the ground of a model likewise."""
    meshes = [item.mesh for item in layer.items] + ([] if layer.terrain is None else [layer.terrain])
    before = np.concatenate([mesh.vertices[:, 0] for mesh in meshes]) if meshes else np.empty(0)
    after = joined_longitudes(before)
    if after is before:
        return layer
    ends = np.cumsum([len(mesh.vertices) for mesh in meshes])[:-1]
    moved = [
        replace(mesh, vertices=np.column_stack([lon, mesh.vertices[:, 1:]]))
        for mesh, lon in zip(meshes, np.split(after, ends), strict=True)
    ]
    items = tuple(replace(item, mesh=mesh) for item, mesh in zip(layer.items, moved, strict=False))
    return replace(layer, items=items, terrain=None if layer.terrain is None else moved[-1])


def _joined(shapes: Sequence[BaseGeometry]) -> NDArray[np.object_] | None:
    """The shapes put together; None where nothing is to be done."""
    flat = np.asarray(shapes, dtype=object)
    xy = shapely.get_coordinates(flat)
    lon = joined_longitudes(xy[:, 0])
    if lon is xy[:, 0] or (lon == xy[:, 0]).all():
        return None
    return np.asarray(shapely.set_coordinates(flat.copy(), np.column_stack([lon, xy[:, 1]])), dtype=object)


def box_of_degrees(places: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """West, south, east and north of places (n, 2) in degrees; east is above 180 where the box reaches over it."""
    lon = joined_longitudes(places[:, 0])
    return float(lon.min()), float(places[:, 1].min()), float(lon.max()), float(places[:, 1].max())


def degrees_outside(lon: float, west: float, east: float) -> float:
    """How far the longitude lies outside [west, east] (which may cross the antimeridian), degrees."""
    if (lon - west) % 360 <= (east - west) % 360 or east - west >= 360:
        return 0.0
    return min((west - lon) % 360, (lon - east) % 360)


def boxes_meet(a: tuple[float, float, float, float], b: tuple[float, float, float, float]) -> bool:
    """Whether two boxes of degrees meet, or nearly so (some 300 m)."""
    margin = _OVERLAP_MARGIN_DEGREES
    lon_margin = margin / max(0.1, math.cos(math.radians((a[1] + a[3]) / 2)))
    beside = any(a[0] - lon_margin <= b[2] + turn and b[0] + turn - lon_margin <= a[2] for turn in (-360, 0, 360))
    return beside and a[1] - margin <= b[3] and b[1] - margin <= a[3]
