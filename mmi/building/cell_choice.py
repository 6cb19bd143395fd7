"""Which viewing cells of a city are to be built: all, those named, some spread over it, around a place, or along a walk.

Here places and objects that people name become shapes in the city's frame; :mod:`mmi.cells.choice` finds the cells.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import networkx as nx
import numpy as np
import pyproj
import shapely
from numpy.typing import NDArray
from shapely.geometry import Point, box
from shapely.geometry.base import BaseGeometry

from mmi.cells.choice import along as cells_along
from mmi.cells.choice import around as cells_around
from mmi.cells.choice import spread
from mmi.cells.viewing_cells import viewing_cells
from mmi.city.model import City
from mmi.foundation.errors import CityError, ParameterError
from mmi.planning.parameters import BuildParameters
from mmi.planning.plan import landmark_factors
from mmi.reading.coordinates import LocalFrame, lonlat_bounds, points_to_local_frame
from mmi.walks.walk import Walk

__all__ = ["RADIUS", "CellChoice", "choose_cells"]

RADIUS = 100.0
"""Metres around a place within which cells are chosen, unless told otherwise: some two dozen cells in the middle of a city."""
_STEP = 0.1
"""Metres between the points of a walk at which cells are asked for."""
_MOST_POINTS = 50_000
"""Walks longer than 5 km are asked in longer steps."""
_LOCAL = "local"
"""The coordinate system of a city that has none."""


@dataclass(frozen=True, slots=True, eq=False)
class CellChoice:
    """The ``graph`` of all viewing cells of a city, and the ``names`` of those to build; from :func:`choose_cells`.

    ``apart`` more cells were as near to the place, but cannot be walked to from there through such cells.
    """

    graph: nx.Graph
    names: tuple[str, ...]
    apart: int = 0


def choose_cells(
    city: City,
    parameters: BuildParameters,
    *,
    cells: Sequence[str] | None = None,
    max_cells: int | None = None,
    around: tuple[float, float] | str | None = None,
    radius: float = RADIUS,
    along: Walk | None = None,
) -> CellChoice:
    """Cut the streets into viewing cells and choose some, in one of five ways; all if nothing is said.

    ``cells`` are ids, ``max_cells`` are spread over the city. ``around`` is the id of an object, or a place: longitude and
    latitude (WGS 84, degrees), or x and y in metres of the city's frame where the city has no coordinate system. Chosen are
    the cells whose rectangles come within ``radius`` metres of it and that can be walked to through such cells from the one
    nearest to it. ``along`` is a walk: a viewer who takes it, at whatever frame rate, is in the chosen cells where it would
    be in them if all were built.

    Raises ParameterError for more than one way, an unknown cell, object or landmark, a place without a street within
    ``radius``, a walk that is never on a street, or where there are no cells at all.
    """
    ways = {"cells": cells, "max_cells": max_cells, "around": around, "along": along}
    if sum(way is not None for way in ways.values()) > 1:
        given = " and ".join(name for name, way in ways.items() if way is not None)
        raise ParameterError(f"one way to choose cells expected, found {given}")
    landmark_factors(city, parameters)
    graph = viewing_cells(city, max_length=parameters.cell_length, eye=parameters.eye)
    if not len(graph):
        raise ParameterError(f"{city.source}: streets with room for a viewing cell expected, found none")
    if cells is not None:
        unknown = [cell for cell in cells if cell not in graph]
        if unknown:
            some = ", ".join(list(graph)[:3])
            raise ParameterError(f"cell {unknown[0]}: one of the {len(graph)} cells ({some}, ...) expected")
        return CellChoice(graph, tuple(sorted(set(cells))))
    if max_cells is not None:
        if max_cells < 1:
            raise ParameterError(f"a number of cells of at least 1 expected, found {max_cells}")
        return CellChoice(graph, tuple(sorted(spread(graph, max_cells))))
    if around is not None:
        named = around if isinstance(around, str) else f"{around[0]:.10g},{around[1]:.10g}"
        place = _object(city, around) if isinstance(around, str) else _place(city, around, radius)
        try:
            found = cells_around(graph, place, radius)
        except ParameterError as error:
            raise ParameterError(f"around {named}: {error}") from None
        return CellChoice(graph, tuple(sorted(found.names)), found.apart)
    if along is not None:
        try:
            return CellChoice(graph, tuple(sorted(cells_along(graph, _path(along)))))
        except ParameterError as error:
            raise ParameterError(f"walk {along.name!r}: {error} ({city.source})") from None
    return CellChoice(graph, tuple(sorted(graph)))


def _object(city: City, name: str) -> BaseGeometry:
    """The footprint of an object, or of all parts of one that was cut."""
    parts = [one.footprint for one in city.objects if name in (one.id, one.part_of)]
    if not parts:
        some = ", ".join(one.id for one in city.objects[:3])
        raise ParameterError(
            f"around {name}: LON,LAT or one of the {len(city.objects)} objects of {city.source} ({some}, ...) expected"
        )
    return shapely.union_all(parts)


def _place(city: City, place: tuple[float, float], radius: float) -> Point:
    """A place in the city's frame. Raises ParameterError where it is farther than ``radius`` from the city's box."""
    local = city.crs == _LOCAL
    first, second = place
    degrees_like = abs(first) <= 180.0 and abs(second) <= 90.0
    if not local and not degrees_like:
        raise ParameterError(
            f"around {first:.10g},{second:.10g}: longitude and latitude in degrees expected, since {city.source} has the "
            f"coordinate system {city.crs}"
        )
    point = Point(*(place if local else _in_frame(city, place)))
    outside = point.distance(box(*city.bounds)) if np.isfinite(point.coords).all() else math.inf
    if outside > radius:
        far = f"{outside / 1000.0:.3g} km outside of it" if outside < 1e6 else "far from it"
        raise ParameterError(
            f"around {first:.10g},{second:.10g}: a place in {city.source} expected, which lies at {_where(city)}, "
            f"found one {far}"
        )
    return point


def _in_frame(city: City, place: tuple[float, float]) -> tuple[float, float]:
    points = np.array([[*place, 0.0]])
    x, y, _ = points_to_local_frame(points, pyproj.CRS.from_epsg(4326), LocalFrame(city.crs, city.origin, ""))[0]
    return float(x), float(y)


def _where(city: City) -> str:
    """Where a city lies, in the terms in which places are named."""
    x0, y0, x1, y1 = city.bounds
    if city.crs == _LOCAL:
        return f"x {x0:.0f} to {x1:.0f}, y {y0:.0f} to {y1:.0f} (metres in its own frame: it has no coordinate system)"
    x, y, _ = city.origin
    try:
        west, south, east, north = lonlat_bounds(
            city.source, (x0 + x, y0 + y, x1 + x, y1 + y), pyproj.CRS.from_user_input(city.crs)
        )
    except CityError:
        return f"x {x0 + x:.0f} to {x1 + x:.0f}, y {y0 + y:.0f} to {y1 + y:.0f} of {city.crs}"
    return f"longitude {west:.4f} to {east:.4f}, latitude {south:.4f} to {north:.4f}"


def _path(walk: Walk) -> NDArray[np.float64]:
    """(n, 2) points of a walk, ``_STEP`` apart or hardly more."""
    step = max(_STEP, walk.metres / _MOST_POINTS)
    legs = [np.array([walk.keyframes[0].pose.eye[:2]])]
    for before, after in itertools.pairwise(walk.keyframes):
        if after.cut:
            legs.append(np.array([before.pose.eye[:2], after.pose.eye[:2]]))
            continue
        count = 2 + math.ceil(math.dist(before.pose.eye[:2], after.pose.eye[:2]) / step)
        times = np.linspace(before.time, after.time, count)[:-1]
        points = _points(walk, times)
        # The speed changes between keyframes, to at most three times its mean (Fritsch & Carlson 1980).
        wide = np.flatnonzero(np.hypot(*np.diff(points, axis=0).T) > 1.5 * step)
        more = _points(walk, (times[wide][:, None] + np.diff(times)[wide][:, None] * [1 / 3, 2 / 3]).ravel())
        legs += [points, more]
    return np.concatenate([*legs, [walk.keyframes[-1].pose.eye[:2]]])


def _points(walk: Walk, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2) where a walk is at ``times`` (n,)."""
    return np.array([walk.pose(time).eye[:2] for time in times.tolist()]).reshape(-1, 2)
