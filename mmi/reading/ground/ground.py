"""The ground of a city: from a file, from a model's surfaces, or from where the buildings stand; and buildings set on it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyproj
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from shapely.geometry import LineString

from mmi.city.model import CityObject, Prism, TriangleMesh
from mmi.city.terrain import Terrain
from mmi.foundation.errors import CityError
from mmi.reading.coordinates import Box, LocalFrame, points_to_local_frame
from mmi.reading.ground.relief import (
    VOID,
    choose_spacing,
    no_height,
    read_relief_points,
    spikes_among,
    terrain_from_points,
    terrain_from_triangles,
)
from mmi.reading.ground.smooth_fit import fitted_ground
from mmi.reading.report import Ledger

__all__ = ["Ground", "ground_of_buildings", "ground_of_file", "ground_of_model", "raised", "settled"]

Ground = Terrain | float
"""A terrain, or the height of flat ground."""

_AROUND = 30.0
"""Metres of terrain around the city."""
_FLAT = 1.0
"""Metres: the ground is flat where the buildings' feet differ by less."""
_NEAR, _STEEPEST = 60.0, 0.25
"""Metres around a building within which others tell whether it hangs, and the steepest slope that ground is taken to have."""
_CROWD = 6
"""Buildings that near to one another, of which the lowest is not believed alone."""
_DEEPEST = 6.0
"""Metres by which a building is let down to the ground at most; one that stands higher is meant to hang in the air."""


def ground_of_file(path: Path, frame: LocalFrame, bounds: Box, ledger: Ledger, *, unit: str | None = None) -> Terrain:
    """Ground from a raster, or points or contour lines with heights; ``unit`` is theirs, ``m`` or ``ft``, None: as they say.

    Raises:
        CityError: the file has none, or lies elsewhere.
    """
    points, crs = read_relief_points(path, ledger, unit=unit)
    if frame.crs == "local":
        crs = None
    elif crs is None:
        crs = pyproj.CRS.from_user_input(frame.crs)
        ledger.warn(f"{path.name}: declares no CRS, taken as the city's {frame.crs}")
    moved = points_to_local_frame(points, crs, frame)
    x0, y0, x1, y1 = bounds
    inside = (moved[:, 0] > x0) & (moved[:, 0] < x1) & (moved[:, 1] > y0) & (moved[:, 1] < y1)
    if np.count_nonzero(inside) < 3:
        raise CityError(
            f"{path}: heights of the ground within the city expected, found {np.count_nonzero(inside)} points there"
        )
    wide = _wide(bounds)
    terrain, dropped = terrain_from_points(moved, bounds=wide, spacing=choose_spacing(wide))
    ledger.note("read", "points of the ground", count=len(points))
    if dropped:
        ledger.note("left out", "point of the ground: a spike", count=dropped)
    return terrain


def ground_of_model(
    mesh: TriangleMesh, move: Callable[[NDArray[np.float64]], NDArray[np.float64]], bounds: Box, ledger: Ledger
) -> Terrain:
    """Ground from a model's triangles, or loose points."""
    vertices, wide = move(mesh.vertices), _wide(bounds)
    spacing = choose_spacing(wide)
    void = no_height(vertices[:, 2])
    if len(mesh.triangles):
        triangles = mesh.triangles[~void[mesh.triangles].any(axis=1)]
        spikes = spikes_among(vertices, triangles)
        sound = triangles[~spikes[triangles].any(axis=1)]
        ledger.note("read", "triangles of the ground", count=len(mesh.triangles))
        ledger.note("left out", VOID.format("triangle"), count=len(mesh.triangles) - len(triangles))
        ledger.note("left out", "triangle of the ground: at a spike", count=len(triangles) - len(sound))
        return terrain_from_triangles(vertices, sound, bounds=wide, spacing=spacing)
    ledger.note("read", "points of the ground", count=len(vertices))
    ledger.note("left out", VOID.format("point"), count=int(void.sum()))
    return terrain_from_points(vertices[~void], bounds=wide, spacing=spacing)[0]


def ground_of_buildings(
    objects: Sequence[CityObject], streets: Sequence[LineString], bounds: Box, ledger: Ledger
) -> Ground:
    """Ground through the feet of the buildings, level across ``streets`` (metres); flat where the feet differ little.

    A warning says how well it fits.
    """
    objects = [one for one, stands in zip(objects, _standing(objects), strict=True) if stands]
    feet = np.array([one.base for one in objects])
    low, high = np.quantile(feet, [0.05, 0.95])
    if high - low <= _FLAT:
        return float(np.median(feet))
    ledger.note("inferred", "ground from the feet of the buildings", count=len(objects))
    fit = fitted_ground(
        np.array([one.footprint for one in objects], dtype=object),
        feet,
        bounds=_wide(bounds),
        streets=np.array(streets, dtype=object),
    )
    for i in np.flatnonzero(fit.wrong):
        ledger.note("noted", "foot of a building: too high or low for the ground", objects[i].id)
    half, most = np.quantile(np.abs(fit.misfits[~fit.wrong]), [0.5, 0.9])
    wrong = np.count_nonzero(fit.wrong)
    are = "is" if wrong == 1 else "are"
    apart = f", {wrong} {are} taken to be wrong" if wrong else ""
    ledger.warn(
        f"the ground is a guess from the feet of {len(objects)} buildings: half of them are within {half:.2f} m of it, nine "
        f"in ten within {most:.2f} m{apart}; --terrain FILE gives the real one"
    )
    return fit.terrain


def _standing(objects: Sequence[CityObject]) -> NDArray[np.bool_]:
    """Which objects (n,) stand on the ground; the others hang above every slope that rises from a neighbour's lower foot.

    In a crowd, one foot that is lower than all others is no measure: it may be a basement.
    """
    xy = shapely.get_coordinates(shapely.centroid([one.footprint for one in objects]))
    feet = np.array([one.base for one in objects])
    away, near = cKDTree(xy).query(xy, k=min(16, len(objects)), distance_upper_bound=_NEAR)
    away, near = away.reshape(len(xy), -1), near.reshape(len(xy), -1)
    limits = np.append(feet, np.inf)[near] + _STEEPEST * np.where(np.isfinite(away), away, 0.0) + _FLAT
    limits.sort(axis=1)
    crowd = np.isfinite(limits).sum(axis=1) >= _CROWD
    return np.asarray(feet <= limits[np.arange(len(feet)), crowd.astype(np.int64)])


def settled(objects: Sequence[CityObject], ground: Ground, ledger: Ledger) -> tuple[CityObject, ...]:
    """Objects let down to the ground: where it slopes or the model is coarse, walls go on down to its lowest point."""
    result = []
    for one in objects:
        lowest = _under(one, ground)[0]
        gap = one.base - lowest
        if not 0.0 < gap <= _DEEPEST:
            result.append(one)
            continue
        if gap > 0.05:
            ledger.note("repaired", "building: let down to the ground", one.id)
        foot = one.base + 0.05
        mesh = one.mesh
        if mesh is not None:
            vertices = mesh.vertices.copy()
            vertices[vertices[:, 2] <= foot, 2] = lowest
            mesh = TriangleMesh(vertices, mesh.triangles, mesh.textures, mesh.colors, mesh.uv)
        core = None if one.core is None else _lowered(one.core, foot, lowest)
        result.append(CityObject(one.id, _lowered(one.prisms, foot, lowest), mesh, core))
    return tuple(result)


def raised(objects: Sequence[CityObject], terrain: Terrain) -> tuple[CityObject, ...]:
    """Objects of prisms on flat ground at height 0, set on hills: heights now count from the mean of the ground below each."""
    result = []
    for one in objects:
        lowest, middle = _under(one, terrain)
        prisms = tuple(
            replace(prism, bottom=min(lowest, middle + prism.bottom) if prism.bottom <= 0.0 else middle + prism.bottom,
                    top=middle + prism.top)
            for prism in one.prisms
        )  # fmt: skip
        result.append(CityObject(one.id, prisms, one.mesh, one.core))
    return tuple(result)


def _under(one: CityObject, ground: Ground) -> tuple[float, float]:
    """Lowest and mean height of the ground at the corners of an outline."""
    if not isinstance(ground, Terrain):
        return ground, ground
    heights, _ = ground.at_corners(shapely.extract_unique_points(one.footprint))
    return float(heights.min()), float(heights.mean())


def _lowered(prisms: tuple[Prism, ...], foot: float, lowest: float) -> tuple[Prism, ...]:
    return tuple(replace(one, bottom=lowest) if one.bottom <= foot else one for one in prisms)


def _wide(bounds: Box) -> Box:
    x0, y0, x1, y1 = bounds
    return x0 - _AROUND, y0 - _AROUND, x1 + _AROUND, y1 + _AROUND
