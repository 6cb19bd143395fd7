"""Ground into a terrain: triangulated surfaces, rasters, loose points and contour lines, sampled on one square grid."""

from __future__ import annotations

import contextlib
import math
import re
import warnings
from pathlib import Path

import numpy as np
import pyogrio
import pyproj
import rasterio
import shapely
from numpy.typing import ArrayLike, NDArray
from rasterio.errors import RasterioError
from scipy.ndimage import distance_transform_edt
from scipy.spatial import Delaunay, QhullError, cKDTree

from mmi import limits
from mmi.city.terrain import Terrain
from mmi.foundation.errors import CityError
from mmi.reading.coordinates import declared_crs
from mmi.reading.gdal_files import RASTERS, VECTOR_FORMATS, layers_of, local_path
from mmi.reading.maps.gis_columns import says_feet
from mmi.reading.maps.heights import FOOT
from mmi.reading.report import Ledger

__all__ = [
    "VOID", "choose_spacing", "no_height", "read_relief_points", "spikes_among", "terrain_from_points",
    "terrain_from_triangles",
]  # fmt: skip

_MOST_SQUARES = 512
_FINEST = 5.0
"""Metres."""
_MOST_CELLS = 2_000_000
_MOST_POINTS = 200_000
"""Up to so many points are triangulated; of more, the mean around each point of the grid is taken."""
_MOST_CANDIDATES = 4_000_000
_DEVIATIONS = 6.0
_ROUGHNESS = 0.5
"""Metres that one deviation stands for at least: otherwise the smallest error on a plane would be a spike."""
_STEEPNESS = 0.25
"""Share of the distance to the neighbours: what rises by less is a hill."""
_NEIGHBOURS = 8
_TALLEST_STEP = 100.0
"""Metres that surfaces, which have quays and cliffs, may rise at once."""
_LOWEST, _HIGHEST = -1500.0, 30_000.0
"""All ground lies between these heights, in metres as well as in feet, from the Dead Sea to Mount Everest."""
VOID = "{} of the ground: a void (no ground is as low or high)"
"""Why a cell, point or triangle is left out."""
_FEET = re.compile(r"\b(ft|ftUS|feet|foot)\b", re.IGNORECASE)
_SUFFIXES = ", ".join(suffix for suffix, _ in RASTERS)
_EXPECTED = f"a raster ({_SUFFIXES}), or points or contour lines with heights ({VECTOR_FORMATS})"
# Column names, lower-case letters only, likeliest first.
_HEIGHTS = (
    "height", "elevation", "elev", "altitude", "alt", "z", "ele", "hoehe", "hoogte", "hauteur", "altitud", "cota", "quota",
    "contour", "zvalue", "level", "dem", "dgm",
)  # fmt: skip


def choose_spacing(bounds: tuple[float, float, float, float]) -> float:
    """Metres between the lines of a grid over ``bounds``: at most 512 x 512 squares, and 5 m at the finest."""
    x0, y0, x1, y1 = bounds
    return max(_FINEST, max(x1 - x0, y1 - y0) / _MOST_SQUARES)


def terrain_from_triangles(
    vertices: ArrayLike, triangles: ArrayLike, *, bounds: tuple[float, float, float, float], spacing: float
) -> Terrain:
    """A triangulated surface, ``vertices`` (n, 3) and ``triangles`` (m, 3), over ``bounds`` in metres.

    At each point of the grid the topmost triangle counts, interpolated; points without any take the height of the nearest.

    Raises:
        CityError: no triangle has an extent in plan, or none lies near ``bounds``.
    """
    points, corners = np.asarray(vertices, dtype=np.float64), np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
    columns, rows = _grid_size(bounds, spacing)
    if not len(corners):
        raise CityError("the ground needs triangles, found none")
    origin = (float(bounds[0]), float(bounds[1]))
    place = (points[:, :2] - origin) / spacing
    grid = _topmost(place, points[:, 2], corners, columns, rows)
    missing = ~np.isfinite(grid)
    if missing.all():
        # The surface is smaller than a square of the grid, or lies beside it: only its corners have heights.
        used = np.unique(corners)
        nodes = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1)
        return Terrain(origin, spacing, points[used, 2][cKDTree(place[used]).query(nodes)[1]])
    return Terrain(origin, spacing, _filled(grid, missing))


def terrain_from_points(
    points: ArrayLike, *, bounds: tuple[float, float, float, float], spacing: float
) -> tuple[Terrain, int]:
    """Loose points (n, 3) in metres as a terrain over ``bounds``, linear between them and level beyond; how many were spikes.

    A spike differs from the median of its neighbours by more than six robust deviations, of all such differences and of its
    neighbours' own, and more than hills rise from one point to the next; it is dropped.

    Raises:
        CityError: there is no point with finite coordinates.
    """
    found = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    found = found[np.isfinite(found).all(axis=1)]
    if not len(found):
        raise CityError("the ground needs points with heights, found none that are numbers")
    columns, rows = _grid_size(bounds, spacing)
    # Points far outside are ignored, unless there are hardly any within reach.
    x0, y0, x1, y1 = bounds
    reach = 0.25 * max(x1 - x0, y1 - y0) + 10.0 * spacing
    near = (
        np.abs(found[:, :2] - (0.5 * (x0 + x1), 0.5 * (y0 + y1))) < (0.5 * (x1 - x0) + reach, 0.5 * (y1 - y0) + reach)
    ).all(axis=1)
    found = found[near] if near.sum() >= 3 else found
    if len(found) > _MOST_POINTS:
        return _binned(found, (float(x0), float(y0)), spacing, columns, rows)
    middle = found[:, :2].mean(axis=0)
    _, first = np.unique(np.round(found[:, :2] - middle, 3), axis=0, return_index=True)
    place, z = found[first, :2] - middle, found[first, 2]
    spikes = _spikes(place, z)
    place, z = place[~spikes], z[~spikes]
    origin = (float(x0), float(y0))
    nodes = (place + middle - origin) / spacing
    heights = np.full((rows, columns), -np.inf)
    if len(place) >= 3:
        with contextlib.suppress(QhullError):  # all on one line
            heights = _topmost(nodes, z, Delaunay(place).simplices.astype(np.int64), columns, rows)
    j, i = np.nonzero(~np.isfinite(heights))
    heights[j, i] = z[cKDTree(nodes).query(np.column_stack([i, j]))[1]]
    return Terrain(origin, spacing, heights), int(spikes.sum())


def read_relief_points(
    path: Path, ledger: Ledger, *, unit: str | None = None
) -> tuple[NDArray[np.float64], pyproj.CRS | None]:
    """Points (n, 3) of the ground in the file's coordinates, their heights in metres, and its CRS (None: it declares none).

    Rasters (GeoTIFF and some others) give the middles of their cells, at most about two million; points and contour lines
    have a z or a column of heights. ``unit`` is what heights are in, ``m`` or ``ft``; None: feet where the raster's unit,
    the vertical coordinate system or the column's name says so, else metres.

    Raises:
        CityError: nothing with heights in it, or not readable.
    """
    drivers = next((drivers for suffix, drivers in RASTERS if path.suffix.lower() == suffix), None)
    if drivers is not None:
        points, crs, said = _raster_points(path, drivers, ledger)
    else:
        points, crs, said = _vector_points(path, ledger)
    if unit is None and said and _FEET.search(said):
        ledger.note("noted", f"heights of the ground in feet, as the file says ({said})", path.name)
        unit = "ft"
    elif unit is None and not said and crs is not None and _FEET.search(crs.axis_info[0].unit_name):
        ledger.warn(f"{path}: heights are taken as metres, though its plan is in feet: --terrain-unit ft, or m")
    return (points * (1.0, 1.0, FOOT) if unit == "ft" else points), crs


def _vertical_unit(crs: str | None) -> str:
    """The name of the unit of heights in a coordinate system that has them; empty otherwise."""
    with contextlib.suppress(pyproj.exceptions.ProjError):
        whole = pyproj.CRS.from_user_input(crs or "")
        for one in whole.sub_crs_list or [whole]:
            for axis in one.axis_info:
                if axis.direction.lower() in ("up", "down"):
                    return axis.unit_name
    return ""


def _grid_size(bounds: tuple[float, float, float, float], spacing: float) -> tuple[int, int]:
    """Columns and rows of grid points that cover ``bounds``."""
    x0, y0, x1, y1 = bounds
    if not (x0 < x1 and y0 < y1 and spacing > 0.0 and np.isfinite([*bounds, spacing]).all()):
        raise CityError(f"a terrain needs bounds with an extent and a positive spacing, found {bounds}, {spacing}")
    return math.ceil((x1 - x0) / spacing - 1e-9) + 1, math.ceil((y1 - y0) / spacing - 1e-9) + 1


def _topmost(
    place: NDArray[np.float64], z: NDArray[np.float64], corners: NDArray[np.int64], columns: int, rows: int
) -> NDArray[np.float64]:
    """Heights (rows, columns) of the topmost triangles (m, 3) of points at ``place`` (n, 2: in squares) and ``z`` (n,).

    -inf where there is none.
    """
    a, b, c = (place[corners[:, k]] for k in range(3))
    first = np.ceil(np.minimum(np.minimum(a, b), c) - 1e-9)
    last = np.floor(np.maximum(np.maximum(a, b), c) + 1e-9)
    low = np.clip(first, 0, (columns, rows)).astype(np.int64)
    size = np.maximum(np.clip(last, -1, (columns - 1, rows - 1)).astype(np.int64) - low + 1, 0)
    area = _cross(b - a, c - a)
    count = size.prod(axis=1) * (np.abs(area) > 1e-12)
    heights = np.full(rows * columns, -np.inf)
    # Candidates: the grid points in the triangles' boxes, some millions at a time.
    ends = np.cumsum(count)
    start = 0
    while start < len(corners):
        done = ends[start - 1] if start else 0
        stop = max(int(np.searchsorted(ends, done + _MOST_CANDIDATES, side="right")), start + 1)
        mine, start = np.arange(start, stop), stop
        of = np.repeat(mine, count[mine])
        k = np.arange(len(of)) - np.repeat(ends[mine] - count[mine] - done, count[mine])
        if not len(of):
            continue
        i, j = low[of, 0] + k % size[of, 0], low[of, 1] + k // size[of, 0]
        arm = np.column_stack([i, j]) - a[of]
        weight_b = _cross(arm, c[of] - a[of]) / area[of]
        weight_c = _cross(b[of] - a[of], arm) / area[of]
        weight_a = 1.0 - weight_b - weight_c
        inside = np.minimum(np.minimum(weight_a, weight_b), weight_c) >= -1e-9
        own = z[corners[of]]
        height = weight_a * own[:, 0] + weight_b * own[:, 1] + weight_c * own[:, 2]
        np.maximum.at(heights, (j * columns + i)[inside], height[inside])
    return heights.reshape(rows, columns)


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _filled(grid: NDArray[np.float64], missing: NDArray[np.bool_]) -> NDArray[np.float64]:
    """The grid with the nearest height where one is missing."""
    if not missing.any():
        return grid
    j, i = distance_transform_edt(missing, return_distances=False, return_indices=True)
    return np.asarray(grid[j, i])


def _binned(
    points: NDArray[np.float64], origin: tuple[float, float], spacing: float, columns: int, rows: int
) -> tuple[Terrain, int]:
    """A terrain of many points: the mean around each grid point, less what the slope adds where they lie to one side."""
    place = (points[:, :2] - origin) / spacing
    if not ((place > -0.5) & (place < (columns - 0.5, rows - 0.5))).all(axis=1).any():
        place = np.clip(place, 0.0, (columns - 1, rows - 1))
    i, j = np.rint(place).astype(np.int64).T
    inside = (i >= 0) & (i < columns) & (j >= 0) & (j < rows)
    cell = (j * columns + i)[inside]
    count = np.bincount(cell, minlength=rows * columns)
    sums = [np.bincount(cell, weights=one[inside], minlength=rows * columns) for one in (points[:, 2], *place.T)]
    z, u, v = (one / np.maximum(count, 1) for one in sums)
    used = np.flatnonzero(count)
    nodes = np.column_stack([used % columns, used // columns])
    spikes = _spikes(np.asarray(spacing * nodes, dtype=np.float64), z[used])
    missing = np.ones((rows, columns), dtype=bool)
    missing.reshape(-1)[used[~spikes]] = False
    grid = _filled(z.reshape(rows, columns), missing)
    y, x = np.indices(grid.shape)
    aside, along = u.reshape(grid.shape) - x, v.reshape(grid.shape) - y
    at_nodes = grid
    for _ in range(3):
        down, right = np.gradient(at_nodes)
        at_nodes = np.where(missing, grid, grid - right * aside - down * along)
    return Terrain(origin, spacing, at_nodes), int(count[used[spikes]].sum())


def spikes_among(vertices: NDArray[np.float64], triangles: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Which vertices (n, 3) of a surface stick out from their neighbours, by more than quays, dams and cliffs do.

    Corners in one place count as one.
    """
    spikes = np.zeros(len(vertices), dtype=bool)
    used = np.unique(triangles)
    if len(used):
        _, first, same = np.unique(np.round(vertices[used], 3), axis=0, return_index=True, return_inverse=True)
        place = vertices[used[first]]
        spikes[used] = _spikes(place[:, :2], place[:, 2], least=_TALLEST_STEP)[same.reshape(-1)]
    return spikes


def _spikes(place: NDArray[np.float64], z: NDArray[np.float64], *, least: float = 0.0) -> NDArray[np.bool_]:
    """Which points (n, 2) with heights (n,) stick out from their neighbours, by more than ``least``."""
    if len(z) < 2 * _NEIGHBOURS:
        return np.zeros(len(z), dtype=bool)
    distance, near = cKDTree(place).query(place, k=_NEIGHBOURS + 1)
    distance, near = np.median(distance[:, 1:], axis=1), near[:, 1:]
    # Opposite neighbours balance a slope; the median ignores one neighbour that is a spike itself.
    difference = z - np.median(z[near], axis=1)
    slope = np.median(np.abs(z[near] - np.median(z[near], axis=1)[:, None]), axis=1)
    deviation = 1.4826 * np.median(np.abs(difference))
    usual = _DEVIATIONS * np.maximum(np.maximum(deviation, 1.4826 * slope), _ROUGHNESS)
    return np.asarray(np.abs(difference) > np.maximum(np.maximum(usual, least), _STEEPNESS * distance))


def _raster_points(
    path: Path, drivers: tuple[str, ...], ledger: Ledger
) -> tuple[NDArray[np.float64], pyproj.CRS | None, str]:
    """Middles of cells with their values; decimated where there are many, cells without data left out. Third: their unit."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with _opened(path, drivers) as raster:
                if raster.width * raster.height > limits.RASTER_CELLS:
                    raise CityError(
                        f"{path}: a raster of at most {limits.RASTER_CELLS} cells expected, found "
                        f"{raster.width} x {raster.height}"
                    )
                step = max(1, math.ceil(math.sqrt(raster.width * raster.height / _MOST_CELLS)))
                rows, columns = math.ceil(raster.height / step), math.ceil(raster.width / step)
                band = raster.read(1, out_shape=(rows, columns), masked=True)
                values = np.ma.getdata(band).astype(np.float64)
                known = ~np.ma.getmaskarray(band) & np.isfinite(values)
                void = known & no_height(values)
                j, i = np.nonzero(known & ~void)
                u, v = (i + 0.5) * raster.width / columns, (j + 0.5) * raster.height / rows
                t = raster.transform
                x, y = t.a * u + t.b * v + t.c, t.d * u + t.e * v + t.f
                declared = None if raster.crs is None else raster.crs.to_wkt()
                crs, unit = declared_crs(path, declared), raster.units[0] or _vertical_unit(declared)
    except (RasterioError, ValueError, OSError) as error:
        raise CityError(f"{path}: expected a raster of heights ({' or '.join(drivers)}); found: {error}") from error
    if not len(i):
        raise CityError(f"{path}: expected a raster of heights, found no cell with data")
    if step > 1:
        ledger.note("noted", f"raster of the ground: one cell in {step} each way is used", path.name)
    ledger.note("left out", "cell of the ground: no data", path.name, count=int((~known).sum()))
    ledger.note("left out", VOID.format("cell"), path.name, count=int(void.sum()))
    return np.column_stack([x, y, values[j, i]]), crs, unit


def _opened(path: Path, drivers: tuple[str, ...]) -> rasterio.DatasetReader:
    """The raster, opened by the first of GDAL's drivers that can; raises what the last of them does."""
    for driver in drivers[:-1]:
        with contextlib.suppress(RasterioError):
            return rasterio.open(local_path(path), driver=driver)
    return rasterio.open(local_path(path), driver=drivers[-1])


def no_height(z: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which heights (...) stand for none: -9999, -32768 and the like, where the file declares no such value."""
    return (z < _LOWEST) | (z > _HIGHEST)


def _vector_points(path: Path, ledger: Ledger) -> tuple[NDArray[np.float64], pyproj.CRS | None, str]:
    """Corners of points and lines, heights from a column or from z; third: their unit, or a column that says it."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            layer = next((name for name, is_view in layers_of(path, _EXPECTED) if not is_view), None)
            if layer is None:
                raise CityError(f"{path}: expected {_EXPECTED}; found no layer that is a table")
            meta, _, wkb, data = pyogrio.raw.read(local_path(path), layer=layer)
    except (
        pyogrio.errors.DataSourceError,
        pyogrio.errors.DataLayerError,
        pyogrio.errors.FeatureError,
        ValueError,
    ) as error:
        reason = str(error).split(";")[0]
        raise CityError(f"{path}: expected {_EXPECTED}; found: {reason}") from error
    shapes = shapely.from_wkb(wkb, on_invalid="ignore") if wkb is not None else np.empty(0, dtype=object)
    xyz, of = shapely.get_coordinates(shapes, include_z=True, return_index=True)
    if not len(xyz):
        raise CityError(f"{path}: expected points or contour lines with heights, found no geometry")
    columns = dict(zip((str(name) for name in meta["fields"]), data, strict=True))
    column, unit = _height_column(columns), _vertical_unit(meta["crs"])
    has_z = np.isfinite(xyz[:, 2]) & (xyz[:, 2] != 0.0)
    if column is not None and not (has_z.any() and np.isfinite(xyz[:, 2]).all()):
        xyz[:, 2] = np.asarray(columns[column], dtype=np.float64)[of]
        ledger.note("noted", f"heights of the ground: column {column}")
        unit = f"column {column}: feet" if says_feet(column) else ""
    sound = np.isfinite(xyz).all(axis=1)
    if not sound.any():
        names = ", ".join(columns) or "none"
        raise CityError(
            f"{path}: expected a z or a column of heights (height, elevation, z, ...); found columns {names}"
        )
    ledger.note("left out", "point of the ground: no height", path.name, count=int((~sound).sum()))
    void = sound & no_height(xyz[:, 2])
    ledger.note("left out", VOID.format("point"), path.name, count=int(void.sum()))
    sound &= ~void
    if not sound.any():
        raise CityError(f"{path}: expected heights of the ground, found only values such as {xyz[void][0, 2]:g}")
    return xyz[sound], declared_crs(path, meta["crs"]), unit


def _height_column(columns: dict[str, NDArray[np.generic]]) -> str | None:
    """The column of numbers whose name means heights, the likeliest name first."""
    for wanted in _HEIGHTS:
        for name, values in columns.items():
            letters = re.sub(r"[^a-z]", "", name.lower())
            plain = re.sub(r"(ft|feet)$", "", letters) if says_feet(name) else letters
            if plain == wanted and np.asarray(values).dtype.kind in "iuf":
                return name
    return None
