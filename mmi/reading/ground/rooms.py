"""Rooms: models whose paths run inside them, over a floor and below a ceiling that are surfaces of the model itself.

A vertical line goes into a solid by a face that looks down and leaves it by one that looks up. Free space indoors is the
other way round: it begins at a face that looks up, the floor, and ends at the next one that looks down, the ceiling. So a
footprint says nothing of a shell, which is hollow, while whoever walks inside it is still kept from its walls.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, MultiPoint, Polygon
from shapely.geometry.base import BaseGeometry

from mmi.city.model import CityObject, Prism, TriangleMesh
from mmi.reading.models.objects_from_meshes import outline_within

__all__ = ["CLEAR", "floor_below", "opened"]

CLEAR = (0.03, 2.0)
"""Metres above the ground between which a path indoors is free: who walks steps over rugs, and passes below lintels."""
_APART = 0.25
"""Metres between the places of a path that are looked at."""
_UNDER = 0.01
"""Metres that the ground lies below the floor: surfaces in one plane flicker."""
_WALLS = 0.03
"""Vertical part of a unit normal below which a face is neither floor nor ceiling."""


def floor_below(objects: Sequence[CityObject], lines: Sequence[LineString]) -> float | None:
    """The height of the ground (metres) where all ``lines`` run through rooms of the ``objects``; None where they do not.

    They do where none of them leaves the footprints, and most of their places are free from a floor to a ceiling. The ground
    is a little below the lowest floor.
    """
    footprints = np.array([one.footprint for one in objects], dtype=object)
    paths = np.array(lines, dtype=object)
    if not len(paths) or not shapely.intersects(shapely.box(*shapely.total_bounds(footprints)), paths).all():
        return None
    tree = shapely.STRtree(footprints)
    path, _ = tree.query(paths, predicate="intersects")
    if len(np.unique(path)) < len(paths):
        return None
    places = _places(paths)
    place, owner = tree.query(shapely.points(places), predicate="intersects")
    if len(np.unique(place)) < len(places):
        return None
    floors = _floors([objects[i].mesh for i in owner.tolist()], place, places)
    free = np.isfinite(floors)
    return float(floors[free].min()) - _UNDER if 2 * np.count_nonzero(free) > len(floors) else None


def opened(objects: Sequence[CityObject], lines: Sequence[LineString], ground: float) -> tuple[CityObject, ...]:
    """The objects, of which those that are hollow where the ``lines`` run are bounded by their walls only, at eye height.

    ``ground`` is the height of the ground below the lines, metres.
    """
    places = _places(np.array(lines, dtype=object))
    low, high = (ground + height for height in CLEAR)
    found = []
    for one in objects:
        mesh = one.mesh
        barriers = [prism.footprint for prism in one.prisms if prism.bottom < high and prism.top > low]
        inside = places[shapely.intersects(shapely.union_all(barriers), shapely.points(places))]
        if mesh is None or not len(inside):
            found.append(one)
            continue
        own = np.arange(len(inside))
        free = inside[np.isfinite(_floors([mesh] * len(own), own, inside))]
        prisms = tuple(_hollow(mesh, low, high, free)) if len(free) else one.prisms
        found.append(CityObject(one.id, prisms, mesh, one.core))
    return tuple(found)


def _hollow(mesh: TriangleMesh, low: float, high: float, inside: NDArray[np.float64]) -> list[Prism]:
    """Prisms that hold all of a mesh: between ``low`` and ``high`` its walls, and below and above these heights all of it."""
    base, top = float(mesh.vertices[:, 2].min()), float(mesh.vertices[:, 2].max())
    prisms: list[Prism] = []
    stops = [base, *(height for height in (low, high) if base < height < top), top]
    for bottom, end in pairwise(stops):
        shape = shapely.union_all(outline_within(mesh, bottom, end))
        between = bottom >= low and end <= high
        parts = _with_rooms(shape, inside) if between else list(shapely.get_parts(shape))
        prisms += [Prism(part, bottom, end) for part in parts]
    return prisms


def _with_rooms(shape: BaseGeometry, inside: NDArray[np.float64]) -> list[Polygon]:
    """The polygons of ``shape`` without those holes in which none of the places ``inside`` (n, 2) lies."""
    points = MultiPoint(inside)
    parts = [part for part in shapely.get_parts(shape) if part.geom_type == "Polygon"]
    return [
        Polygon(part.exterior, [ring for ring in part.interiors if shapely.intersects(Polygon(ring), points)])
        for part in parts
    ]


def _places(paths: NDArray[np.object_]) -> NDArray[np.float64]:
    """(n, 2) the corners of all paths, and places at most ``_APART`` metres from one to the next."""
    return np.asarray(shapely.get_coordinates(shapely.segmentize(paths, _APART)))


def _floors(
    meshes: Sequence[TriangleMesh | None], place: NDArray[np.intp], places: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n,) the lowest height at each of the ``places`` (n, 2) from which a vertical line is free; infinite where none is.

    ``meshes`` (k,) are what the lines at ``place`` (k,) may meet.
    """
    heights: list[list[NDArray[np.float64]]] = [[] for _ in places]
    for mesh, i in zip(meshes, place.tolist(), strict=True):
        if mesh is not None:
            heights[i].append(_crossings(mesh, places[i]))
    return np.array([_floor(np.concatenate([np.empty((0, 2)), *found])) for found in heights])


def _floor(crossings: NDArray[np.float64]) -> float:
    """The lowest face that looks up, below one that looks down, with a free height between them; infinite if there is none.

    ``crossings`` (n, 2) are heights, and 1 where the line comes into a solid, -1 where it leaves one.
    """
    crossings = crossings[np.lexsort((crossings[:, 1], crossings[:, 0]))]
    depth = np.cumsum(crossings[:, 1])
    free = (
        (crossings[:-1, 1] < 0.0)
        & (crossings[1:, 1] > 0.0)
        & (depth[:-1] <= 0.0)
        & (np.diff(crossings[:, 0]) >= CLEAR[1])
    )
    return float(crossings[:-1, 0][free].min(initial=np.inf))


def _crossings(mesh: TriangleMesh, place: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2) where the vertical line at ``place`` (2,) meets a mesh: heights, and 1 for faces that look down, -1 for up."""
    corners = mesh.vertices[mesh.triangles]
    flat = corners[..., :2] - place
    over = (flat.min(axis=1) <= 0.0).all(axis=1) & (flat.max(axis=1) >= 0.0).all(axis=1)
    corners, flat = corners[over], flat[over]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    level = np.abs(normals[:, 2]) > _WALLS * np.linalg.norm(normals, axis=1)
    corners, flat, up = corners[level], flat[level], normals[level, 2]
    following = np.roll(flat, -1, axis=1)
    # Twice the area that the line cuts off beside each edge: corner k weighs as much as the edge opposite to it.
    areas = np.roll(flat[..., 0] * following[..., 1] - flat[..., 1] * following[..., 0], -1, axis=1) / up[:, None]
    inside = (areas >= 0.0).all(axis=1)
    heights = (areas * corners[..., 2]).sum(axis=1)[inside]
    found = np.column_stack([heights, -np.sign(up[inside])])
    # An edge between two faces is met once.
    return np.unique(np.round(found, 6), axis=0)
