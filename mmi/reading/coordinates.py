"""From the coordinates of a file to the city's local metric frame.

A projected CRS whose metres are metres (scale within 0.25 %, no shear, east and north axes, used where it is meant to be) is
kept; everything else, degrees and web-mercator first of all, goes to the UTM zone of the city's centre. Files that declare no
CRS, or one that their coordinates contradict, are refused in words that say what to pass as ``--crs``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

import numpy as np
import pyproj
import shapely
from numpy.typing import NDArray
from pyproj.exceptions import ProjError
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from mmi import limits
from mmi.foundation.errors import CityError, ParameterError
from mmi.reading.antimeridian import box_of_degrees, boxes_meet, degrees_outside, within_180
from mmi.reading.raw_layers import BuildingLayer, RawBuilding, RawModel, RawStreet, StreetLayer
from mmi.reading.report import Ledger

__all__ = [
    "Box", "LocalFrame", "agree_on_crs", "box_to_local_frame", "check_not_swapped", "choose_local_frame",
    "coordinate_bounds", "declared_crs", "lonlat_bounds", "meets_box", "named_crs", "parse_crs",
    "points_to_local_frame", "to_local_frame", "within_clip",
]  # fmt: skip

Box = tuple[float, float, float, float]
"""(west, south, east, north) in degrees, or (min x, min y, max x, max y)."""

_EPSG = re.compile(r"EPSG\D{0,8}(?:[\d.]+[:/]{1,2})?(\d{4,6})(?!\d)", re.IGNORECASE)
_WGS84 = pyproj.CRS.from_epsg(4326)
_MAX_SCALE_ERROR = 0.0025
_MAX_SHEAR_DEGREES = 0.2
_MIN_CORNERS = 40
_frame_crs = lru_cache(maxsize=16)(pyproj.CRS.from_user_input)  # asked for with each object


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """The frame of a city: ``crs`` (``"EPSG:..."``), the ``origin`` to subtract, and ``why`` it is not the file's own CRS."""

    crs: str
    origin: tuple[float, float, float]
    why: str


def parse_crs(text: str) -> pyproj.CRS:
    """The horizontal CRS that ``text`` names (``EPSG:32632``, WKT, ...).

    Raises:
        ParameterError: pyproj does not understand it, or it places nothing on the earth's surface.
    """
    try:
        crs = _horizontal(pyproj.CRS.from_user_input(text))
    except ProjError as error:
        raise ParameterError(f"--crs: expected a coordinate system such as EPSG:32632, found {text!r}") from error
    if not (crs.is_projected or crs.is_geographic):
        raise ParameterError(f"--crs: expected a projected or geographic system, found {text!r} ({crs.type_name})")
    return crs


def declared_crs(file: Path, text: str | None, *, hint: str = "") -> pyproj.CRS | None:
    """The horizontal CRS that GDAL says a file declares; None for none, and for one that places nothing on the earth.

    Raises:
        CityError: pyproj does not understand it; ``hint`` says what to do.
    """
    if not text:
        return None
    try:
        crs = _horizontal(pyproj.CRS.from_user_input(text))
    except ProjError as error:
        raise CityError(f"{file}: declares a CRS that is not understood: {text[:80]!r}{hint}") from error
    # An engineering CRS (GDAL's "undefined") places nothing on the earth.
    return crs if crs.is_projected or crs.is_geographic else None


def named_crs(where: str, text: str, fallback: pyproj.CRS | None) -> pyproj.CRS:
    """The horizontal CRS of the first EPSG code in ``text`` that is of one; ``fallback`` where there is none.

    A name may hold versions (``EPSG:6.12:25833``) and a second code, of heights (``EPSG:25833+5783``).

    Raises:
        CityError: there is none, and no fallback; ``where`` says what names it.
    """
    for code in [text] if re.fullmatch(r"\d{4,6}", text) else _EPSG.findall(text):
        with suppress(ProjError):
            crs = _horizontal(pyproj.CRS.from_epsg(int(code)))
            if crs.is_projected or crs.is_geographic:
                return crs
    if fallback is not None:
        return fallback
    raise CityError(
        f"{where}: an EPSG code expected, of a projected or geographic system, found {text[:80]!r}; name one with --crs"
    )


def _horizontal(crs: pyproj.CRS) -> pyproj.CRS:
    """``crs`` without its vertical part."""
    return (crs.sub_crs_list[0] if crs.is_compound else crs).to_2d()


def _name(crs: pyproj.CRS) -> str:
    authority = crs.to_authority(min_confidence=70)
    return ":".join(authority) if authority else crs.name


def _transform(source: pyproj.CRS, target: pyproj.CRS, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (n, 2), x or longitude first, from one CRS to another; not finite where that is impossible."""
    x, y = _transformer(source, target).transform(points[:, 0], points[:, 1])
    return np.column_stack([x, y])


@lru_cache(maxsize=16)
def _transformer(source: pyproj.CRS, target: pyproj.CRS) -> pyproj.Transformer:
    """Looking for the way between two systems takes longer than many points take on it."""
    return pyproj.Transformer.from_crs(source, target, always_xy=True)


def lonlat_bounds(file: str, bounds: Box, crs: pyproj.CRS) -> Box:
    """Where coordinates within ``bounds`` of ``crs`` lie: west, south, east, north in degrees, east up to 360.

    Raises:
        CityError: they contradict the CRS, or no city lies there; names ``file`` and says what to do.
    """
    x0, y0, x1, y1 = bounds
    found = f"{file}: coordinates x {x0:.7g} to {x1:.7g}, y {y0:.7g} to {y1:.7g}"
    name = _name(crs)
    degrees_like = -180 <= x0 <= 180 and x1 <= 360 and -90 <= y0 and y1 <= 90
    if crs.is_geographic:
        if -90 <= x0 and x1 <= 90 and (y1 > 90 or y0 < -90) and -180 <= y0 and y1 <= 180:
            raise CityError(f"{found} are no longitude and latitude: latitude and longitude look swapped")
        if not degrees_like:
            raise CityError(
                f"{found} do not fit {name} (degrees): the CRS is unknown; name the right one with --crs EPSG:..."
            )
        box = bounds
    else:
        if degrees_like and max(x1 - x0, y1 - y0) < 5.0:
            raise CityError(f"{found} look like degrees but are declared as {name}; pass --crs EPSG:4326 if they are")
        corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [(x0 + x1) / 2, (y0 + y1) / 2]])
        try:
            places = _transform(crs, _WGS84, corners)
            again = _transform(_WGS84, crs, places)
        except ProjError as error:
            raise CityError(f"{file}: {name} cannot be placed on the earth; name a CRS with --crs EPSG:...") from error
        if not (np.isfinite(places).all() and np.isfinite(again).all() and np.abs(again - corners).max() < 1.0):
            raise CityError(f"{found} do not fit {name}; name the right CRS with --crs EPSG:...")
        box = box_of_degrees(places)
    lon, lat = within_180((box[0] + box[2]) / 2), (box[1] + box[3]) / 2
    if not -60 <= lat <= 84:
        swapped = "latitude and longitude swapped, or " if crs.is_geographic and -60 <= lon <= 84 else ""
        raise CityError(
            f"{file}: would lie at longitude {lon:.2f}, latitude {lat:.2f} ({name}), where no city is: {swapped}another CRS "
            "(--crs)?"
        )
    area = crs.area_of_use
    if area is not None:
        # UTM zones are often used far beyond their borders, also across the equator, and stay true to some 20 degrees.
        beyond = max(0.0, area.south - lat, lat - area.north) if crs.utm_zone is None else 0.0
        far = degrees_outside(lon, area.west, area.east) > (5 if crs.utm_zone is None else 20) or beyond > 5
    if area is not None and far:
        raise CityError(
            f"{file}: would lie at longitude {lon:.2f}, latitude {lat:.2f}, far outside the area of {name} "
            f"(longitude {area.west:g} to {area.east:g}, latitude {area.south:g} to {area.north:g}); "
            "name the right CRS with --crs EPSG:..."
        )
    return box


def agree_on_crs(
    buildings: BuildingLayer, streets: StreetLayer | None, override: pyproj.CRS | None
) -> tuple[pyproj.CRS, pyproj.CRS]:
    """The CRS of the buildings and of the streets (layers that are not empty); twice the buildings' where streets are None.

    ``override`` replaces what a file declares or lacks, unless its format fixes the CRS (OpenStreetMap). Where the two then
    lie apart but would meet if ``override`` held for one file only, it holds for that one.

    Raises:
        CityError: a CRS is missing or contradicted by the coordinates, or the layers lie apart; says where each lies.
        ParameterError: ``override`` is given where every file has its CRS by its format.
    """
    if override is not None and buildings.crs_certain and (streets is None or streets.crs_certain):
        raise ParameterError(
            f"--crs: a file whose CRS is unknown or wrong expected, found {buildings.file}: OpenStreetMap is always EPSG:4326"
        )
    building_bounds = coordinate_bounds([item.geometry for item in buildings.items])
    if streets is None:
        crs = override or _declared(buildings)
        lonlat_bounds(buildings.file, building_bounds, crs)
        return crs, crs
    street_bounds = coordinate_bounds([line for item in streets.items for line in item.lines])
    choices: list[tuple[pyproj.CRS | None, pyproj.CRS | None]] = []
    if override is not None:
        forced_b = None if buildings.crs_certain else override
        forced_s = None if streets.crs_certain else override
        choices += [(forced_b or buildings.crs, forced_s or streets.crs)]
        choices += [(forced_b or buildings.crs, streets.crs), (buildings.crs, forced_s or streets.crs)]
    else:
        choices = [(buildings.crs, streets.crs)]
    first_error: CityError | None = None
    for of_buildings, of_streets in choices:
        try:
            building_crs = _declared(replace(buildings, crs=of_buildings))
            street_crs = _declared(replace(streets, crs=of_streets))
            there = lonlat_bounds(buildings.file, building_bounds, building_crs)
            here = lonlat_bounds(streets.file, street_bounds, street_crs)
            if boxes_meet(there, here):
                return building_crs, street_crs
            raise CityError(_apart(buildings.file, there, building_crs, streets.file, here, street_crs))
        except CityError as error:
            first_error = first_error or error
    assert first_error is not None
    raise first_error


def _declared(layer: BuildingLayer | StreetLayer) -> pyproj.CRS:
    if layer.crs is None:
        raise CityError(f"{layer.file}: declares no CRS: expected one; name it with --crs EPSG:...")
    return layer.crs


def _apart(file_b: str, b: Box, crs_b: pyproj.CRS, file_s: str, s: Box, crs_s: pyproj.CRS) -> str:
    """The message for layers that do not meet."""

    def place(box: Box) -> str:
        return f"longitude {box[0]:.4f} to {box[2]:.4f}, latitude {box[1]:.4f} to {box[3]:.4f}"

    swapped = (s[1], s[0], s[3], s[2])
    hint = "one declares a wrong CRS (--crs), or they are of different places"
    if crs_b.is_geographic or crs_s.is_geographic:
        if boxes_meet(b, swapped):
            culprit = file_s if crs_s.is_geographic else file_b
            hint = f"latitude and longitude look swapped in {culprit}"
        hint = hint.replace("(--crs)", "(--crs) or has latitude and longitude swapped")
    return f"buildings ({file_b}: {place(b)}) and streets ({file_s}: {place(s)}) lie apart: {hint}"


def coordinate_bounds(geometries: Sequence[BaseGeometry]) -> Box:
    """Bounding box of geometries in their own coordinates."""
    x0, y0, x1, y1 = shapely.total_bounds(np.asarray(geometries, dtype=object))
    return float(x0), float(y0), float(x1), float(y1)


def check_not_swapped(file: str, outlines: Sequence[BaseGeometry], crs: pyproj.CRS) -> None:
    """Refuse outlines in degrees whose latitude stands first, where that can be told.

    Houses have right angles. Read the wrong way round they are stretched by 1 / (cos(lat) cos(lon)), so the corners tell,
    unless the city lies near longitude 0 on the equator.

    Raises:
        CityError: right angles abound only if the axes are exchanged.
    """
    if not crs.is_geographic:
        return
    parts = shapely.get_parts(np.asarray(outlines, dtype=object))
    polygons = parts[shapely.get_type_id(parts) == 3]
    if len(polygons) == 0:
        return
    x0, y0, x1, y1 = shapely.total_bounds(polygons)
    lon, lat = (x0 + x1) / 2, (y0 + y1) / 2
    if abs(lon) > 84:
        return
    coords, ring = shapely.get_coordinates(shapely.get_exterior_ring(polygons), return_index=True)
    inner = (ring[2:] == ring[1:-1]) & (ring[1:-1] == ring[:-2])
    as_read, corners = _right_angles(coords, inner, math.cos(math.radians(lat)), 1.0)
    exchanged, _ = _right_angles(coords, inner, 1.0, math.cos(math.radians(lon)))
    if corners >= _MIN_CORNERS and exchanged > 0.3 and exchanged > 2.0 * as_read:
        raise CityError(
            f"{file}: latitude and longitude look swapped: at longitude {lon:.2f}, latitude {lat:.2f} only {as_read:.0%} of "
            f"the buildings' corners are right angles, the other way round {exchanged:.0%}"
        )


def _right_angles(
    coords: NDArray[np.float64], inner: NDArray[np.bool_], scale_x: float, scale_y: float
) -> tuple[float, int]:
    """Share of right angles (within 3 degrees) among the marked corners with legs of over a metre, and their number."""
    metres = coords * (111_320.0 * np.array([scale_x, scale_y]))
    legs = np.diff(metres, axis=0)
    before, after = legs[:-1][inner], legs[1:][inner]
    lengths = np.hypot(*before.T) * np.hypot(*after.T)
    long = (np.hypot(*before.T) > 1.0) & (np.hypot(*after.T) > 1.0)
    cosines = np.abs((before * after).sum(axis=1)[long]) / lengths[long]
    # Straight runs are no corners.
    turning = cosines < math.cos(math.radians(20))
    return float((cosines[turning] < math.sin(math.radians(3))).mean()) if turning.any() else 0.0, int(turning.sum())


def choose_local_frame(file: str, bounds: Box, crs: pyproj.CRS, place: Box) -> LocalFrame:
    """The frame of a city (from ``file``) of ``bounds`` in ``crs``, which lie at ``place`` (degrees).

    The origin is the centre of ``bounds`` in the frame's CRS, down to whole 10 m; its height is 0.

    Raises:
        CityError: the buildings spread over more than 100 km (``limits.EXTENT``).
    """
    lon, lat = within_180((place[0] + place[2]) / 2), (place[1] + place[3]) / 2
    epsg = crs.to_epsg(min_confidence=70)
    target = crs if epsg is None else pyproj.CRS.from_epsg(epsg)  # knows its area of use, unlike a .prj file
    why = _unsuitable(target, lon, lat) or ("has no EPSG code" if epsg is None else None)
    if why is not None:
        zone = min(60, int((lon + 180) // 6) + 1)
        target = pyproj.CRS.from_epsg((32600 if lat >= 0 else 32700) + zone)
    x0, y0, x1, y1 = bounds
    corners = _transform(crs, target, np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]))
    low, high = corners.min(axis=0), corners.max(axis=0)
    # Half around the earth, corners may come close to one another again.
    around = (place[2] - place[0]) * 111_320.0 * math.cos(math.radians(lat))
    spread = max(*(high - low), around) if np.isfinite(corners).all() else np.inf
    if spread > limits.EXTENT:
        far = f"{spread / 1000:.0f} km" if np.isfinite(spread) else "half the earth"
        raise CityError(f"{file}: the buildings spread over {far}: expected a city; cut one out with --clip")
    centre = np.floor((low + high) / 20.0) * 10.0
    reason = "" if why is None else f"{_name(crs)} {why}: reprojected to {_name(target)}"
    return LocalFrame(f"EPSG:{target.to_epsg()}", (float(centre[0]), float(centre[1]), 0.0), reason)


def _unsuitable(crs: pyproj.CRS, lon: float, lat: float) -> str | None:
    """Why distances and angles of ``crs`` at this place cannot be taken as they are, or None."""
    if not crs.is_projected:
        return "is in degrees"
    axes = crs.axis_info
    if any(axis.unit_name != "metre" for axis in axes):
        return f"is in units of {axes[0].unit_name}"
    if {axis.direction for axis in axes} != {"east", "north"}:
        return "does not point east and north"
    operation = crs.coordinate_operation
    if operation is not None and "Pseudo" in operation.method_name:
        return "is web-mercator, whose metres are inflated"
    area = crs.area_of_use
    if area is not None and not (
        area.south - 1 <= lat <= area.north + 1 and degrees_outside(lon, area.west, area.east) <= 1
    ):
        return (
            f"is used outside its area (longitude {area.west:g} to {area.east:g}, "
            f"latitude {area.south:g} to {area.north:g})"
        )
    try:
        factors = pyproj.Proj(crs).get_factors(lon, lat)
    except ProjError:
        return "has no known scale"
    error = max(abs(factors.meridional_scale - 1), abs(factors.parallel_scale - 1))
    if error > _MAX_SCALE_ERROR or factors.angular_distortion > _MAX_SHEAR_DEGREES:
        return f"stretches distances by {error:.1%} here"
    return None


def to_local_frame(
    geometries: Sequence[BaseGeometry], crs: pyproj.CRS | None, frame: LocalFrame
) -> NDArray[np.object_]:
    """Geometries from ``crs`` (None: the frame's own units) into ``frame``, flat, rounded to 1 mm so that bytes are stable."""
    flat = shapely.force_2d(np.asarray(geometries, dtype=object))
    return np.asarray(
        shapely.transform(flat, lambda points: np.round(_plan_to_local_frame(points, crs, frame), 3) + 0.0),
        dtype=object,
    )


def points_to_local_frame(
    points: NDArray[np.float64], crs: pyproj.CRS | None, frame: LocalFrame
) -> NDArray[np.float64]:
    """Points (n, 3) from ``crs`` (None: the frame's own units) into ``frame``; heights less the origin's."""
    return np.column_stack([_plan_to_local_frame(points[:, :2], crs, frame), points[:, 2] - frame.origin[2]])


def _plan_to_local_frame(points: NDArray[np.float64], crs: pyproj.CRS | None, frame: LocalFrame) -> NDArray[np.float64]:
    plan = points if crs is None else _transform(crs, _frame_crs(frame.crs), points)
    return plan - np.array(frame.origin[:2])


def box_to_local_frame(box: Box, frame: LocalFrame) -> Polygon:
    """A box of degrees as a polygon of the frame, its sides bent with the projection."""
    outline = shapely.segmentize(shapely.box(*box), max(box[2] - box[0], box[3] - box[1]) / 32)
    return to_local_frame([outline], _WGS84, frame)[0]


def meets_box(geometries: Sequence[BaseGeometry], crs: pyproj.CRS, box: Box) -> NDArray[np.bool_]:
    """Which geometries (n,) of ``crs`` meet ``box`` (degrees) with their bounding boxes."""
    x0, y0, x1, y1 = shapely.bounds(np.asarray(geometries, dtype=object)).T
    if not crs.is_geographic:
        corners = np.concatenate([np.column_stack(xy) for xy in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))])
        lon, lat = _transform(crs, _WGS84, corners).reshape(4, -1, 2).transpose(2, 0, 1)
        lon = np.where((np.ptp(lon, axis=0) > 180.0) & (lon < 0.0), lon + 360.0, lon)
        x0, y0, x1, y1 = lon.min(axis=0), lat.min(axis=0), lon.max(axis=0), lat.max(axis=0)
    beside = [(x0 + turn <= box[2]) & (x1 + turn >= box[0]) for turn in (-360.0, 0.0, 360.0)]
    return np.asarray(np.any(beside, axis=0) & (y0 <= box[3]) & (y1 >= box[1]))


_Item = TypeVar("_Item", RawBuilding, RawModel, RawStreet)


def within_clip(
    items: Sequence[_Item], inside: NDArray[np.bool_], clip: Box, ledger: Ledger, *, file: str, kind: str
) -> tuple[_Item, ...]:
    """Those ``items`` (n,) of a file that are ``inside`` (n,) the box; the others are counted. ``kind``: building, street.

    Raises:
        CityError: none is.
    """
    for item, stays in zip(items, inside, strict=True):
        if not stays:
            ledger.note("left out", f"{kind}: outside --clip", item.id)
    if not inside.any():
        box = ",".join(f"{one:g}" for one in clip)
        raise CityError(f"{file}: no {kind}s within --clip {box} (west,south,east,north in degrees)")
    return tuple(item for item, stays in zip(items, inside, strict=True) if stays)
