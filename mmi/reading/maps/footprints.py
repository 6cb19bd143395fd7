"""Footprints and streets in what GDAL reads for us: GeoJSON, GeoPackage, Shapefile and FlatGeobuf (``gdal_files``).

Which layer holds the buildings and which the streets follows from geometry, name and columns; where several would do, the
reader refuses and names them. What the columns mean is told by ``gis_columns``.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from os import SEEK_END
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pyogrio
import pyproj
import shapely
from numpy.typing import NDArray
from pyogrio.errors import DataSourceError
from shapely.geometry import LineString
from shapely.geometry.base import BaseGeometry

from mmi.foundation.errors import CityError
from mmi.reading.coordinates import declared_crs
from mmi.reading.gdal_files import VECTOR_FORMATS, layers_of, local_path
from mmi.reading.maps.gis_columns import (
    BUILDING_COLUMNS,
    HEIGHT_COLUMNS,
    LEVELS_COLUMNS,
    STREET_COLUMNS,
    guess_column,
    ids_of_rows,
    in_feet,
    plain_name,
    tags_of_rows,
    texts_of_unknown_encoding,
    unit_of_heights,
    why_no_building,
    why_no_street,
)
from mmi.reading.maps.wkb import geometries_from_wkb
from mmi.reading.raw_layers import BuildingLayer, RawBuilding, RawStreet, StreetLayer, with_unique_ids
from mmi.reading.report import Ledger

__all__ = ["GDAL_SUFFIXES", "read_footprints", "read_street_lines"]

GDAL_SUFFIXES = (".fgb", ".geojson", ".gpkg", ".json", ".shp")
"""What is looked for in a folder."""
_MESH_SUFFIXES = (".3ds", ".dae", ".fbx", ".obj", ".ply", ".stl")

_EXPECTED = f"OpenStreetMap (.osm, .osm.pbf), or footprints and streets ({VECTOR_FORMATS})"

_BUILDING_WORDS = ("build", "bldg", "footprint", "bati", "gebaeude", "gebäude", "edific", "house", "pand")
_STREET_WORDS = ("street", "road", "highway", "route", "rue", "strasse", "straße", "via", "calle", "troncon", "network")
# pyogrio also raises some of Python's own errors: NameError where a .prj is no text.
_GDAL_ERRORS = (DataSourceError, RuntimeError, ValueError, NameError)
_OTHER_FORMATS = MappingProxyType(
    {
        b'"CityJSON': "CityJSON",
        b'"CityObjects"': "CityJSON",
        b"CityModel": "CityGML",
        b"glTF": "glTF",
        b'"Overpass API': "JSON of Overpass (ask it for XML, without [out:json])",
    }
)


@dataclass(frozen=True, slots=True)
class _Layer:
    """A layer that may be of use: ``kind`` is polygon, line or any; or a view, which is not."""

    file: Path
    name: str
    kind: str
    columns: tuple[str, ...]


def read_footprints(
    path: Path,
    ledger: Ledger,
    *,
    layer: str | None,
    height_column: str | None,
    height_unit: str | None = None,
    levels_column: str | None,
    id_column: str | None,
) -> BuildingLayer:
    """Buildings of the file or folder ``path``. ``layer`` names the layer (several: comma-separated), else it is guessed.

    ``height_unit`` is ``m`` or ``ft``, for heights that name no unit; else the name of the column tells.

    Raises:
        CityError: nothing GDAL reads, no or several layers that could be buildings, a column that is not there.
    """
    layers = _list_layers(path)
    fit = [one for one in layers if one.kind in ("polygon", "any")]
    chosen = _choose(
        path,
        layers,
        fit,
        layer,
        _BUILDING_WORDS,
        (*HEIGHT_COLUMNS, *LEVELS_COLUMNS),
        "building polygons",
        "--buildings-layer",
    )
    items: list[RawBuilding] = []
    found: list[pyproj.CRS | None] = []
    labels: tuple[str, str] = ("", "")
    for one in chosen:
        table = _read(one, ledger)
        height = _wanted_column(table, height_column, HEIGHT_COLUMNS, "--height-column")
        levels = _wanted_column(table, levels_column, LEVELS_COLUMNS, "--levels-column")
        named = _wanted_column(table, id_column, (), "--id-column")
        ids = ids_of_rows(table.columns, len(table.geometries), named)
        ids = [f"{one.name}/{id_}" if len(chosen) > 1 else id_ for id_ in ids]
        wanted = BUILDING_COLUMNS | {"height": (height,), "building:levels": (levels,)}
        tags = tags_of_rows(table.columns, len(table.geometries), wanted)
        unit = unit_of_heights(height, height_unit, str(one.file), ledger)
        tags = [in_feet(own) for own in tags] if unit == "ft" else tags
        telling = guess_column(table.columns, BUILDING_COLUMNS["building"])
        labels = (labels[0] or _label(height) + " in feet" * (unit == "ft"), labels[1] or _label(levels))
        found.append(table.crs)
        for id_, geometry, own in zip(ids, table.geometries, tags, strict=True):
            kinds = () if geometry is None else shapely.get_type_id(shapely.get_parts(_unpacked(geometry)))
            if one.kind == "any" and not np.isin(kinds, (3, 6)).any() and np.isin(kinds, (0, 1, 4, 5)).any():
                ledger.note("noted", "line or point among the footprints", id_)
                continue
            is_part = "building:part" in own and "building" not in own
            ledger.note("read", "building parts" if is_part else "buildings")
            if geometry is None or geometry.is_empty:
                ledger.note("left out", "building: no geometry", id_)
            elif not np.isin(kinds, (3, 6)).any():
                ledger.note("left out", "building: not a polygon", id_)
            elif not np.isfinite(shapely.get_coordinates(geometry)).all():
                ledger.note("left out", "building: coordinates that are no numbers", id_)
            elif (reason := why_no_building(own, telling)) is not None:
                ledger.note("left out", f"building: {reason}", id_)
            else:
                items.append(RawBuilding(id_, geometry, own))
    if len({crs.to_wkt() if crs else "" for crs in found}) > 1:
        raise CityError(f"{path}: layers {', '.join(one.name for one in chosen)} differ in their CRS; expected one")
    unique = with_unique_ids(items, ledger)
    return BuildingLayer(str(path), unique, found[0], False, labels[0], labels[1])


def read_street_lines(path: Path, ledger: Ledger, *, layer: str | None) -> StreetLayer | None:
    """Street centre lines of the file or folder ``path``; None if no layer of it can hold any.

    Raises:
        CityError: as ``read_footprints``.
    """
    layers = _list_layers(path)
    fit = [one for one in layers if one.kind in ("line", "any")]
    if not fit and layer is None:
        return None
    chosen = _choose(
        path, layers, fit, layer, _STREET_WORDS, STREET_COLUMNS["highway"][:2], "street lines", "--streets-layer"
    )
    items: list[RawStreet] = []
    found: list[pyproj.CRS | None] = []
    for one in chosen:
        table = _read(one, ledger)
        found.append(table.crs)
        tags = tags_of_rows(table.columns, len(table.geometries), STREET_COLUMNS)
        ids = ids_of_rows(table.columns, len(table.geometries), "")
        telling = guess_column(table.columns, STREET_COLUMNS["highway"][:1])
        for id_, geometry, own in zip(ids, table.geometries, tags, strict=True):
            parts = [] if geometry is None else shapely.get_parts(_unpacked(geometry))
            lines = tuple(part for part in _flatten(parts) if isinstance(part, LineString) and 0 < part.length < np.inf)
            if one.kind == "any" and not lines:
                continue  # a building of a mixed layer
            ledger.note("read", "streets")
            if not lines:
                ledger.note("left out", "street: not a line", id_)
            elif (reason := why_no_street(own, telling)) is not None:
                ledger.note("left out", f"street: {reason}", id_)
            else:
                items.append(RawStreet(id_, lines, own))
    if len({crs.to_wkt() if crs else "" for crs in found}) > 1:
        raise CityError(f"{path}: layers {', '.join(one.name for one in chosen)} differ in their CRS; expected one")
    return StreetLayer(str(path), tuple(items), found[0], False)


def _list_layers(path: Path) -> list[_Layer]:
    """All layers with lines or polygons in the file, or in the GDAL files of the folder, in name order."""
    if path.is_dir():
        files = sorted(one for one in path.iterdir() if one.suffix.lower() in GDAL_SUFFIXES)
        if not files:
            inside = sorted(one.name for one in path.iterdir())
            found = ", ".join(inside[:6]) + (", ..." if len(inside) > 6 else "") if inside else "nothing"
            raise CityError(
                f"{path}: a folder; expected one file of a city, or a folder that holds {', '.join(GDAL_SUFFIXES)} files; "
                f"found in it: {found}"
            )
    else:
        files = [path]
        _refuse_other_formats(path)
    layers: list[_Layer] = []
    for file in files:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                for name, is_view in layers_of(file, _EXPECTED):
                    if is_view:
                        layers.append(_Layer(file, name, "view", ()))
                        continue
                    info = pyogrio.read_info(local_path(file), layer=name)
                    kind = _kind(info["geometry_type"])
                    if kind is not None:
                        layers.append(_Layer(file, name, kind, tuple(str(one) for one in info["fields"])))
        except _GDAL_ERRORS as error:
            reason = str(error).split("; It might")[0].split(";")[0].removeprefix(f"'{file.absolute()}' ")
            raise CityError(f"{file}: expected {_EXPECTED}; found: {reason}") from error
    return layers


def _refuse_other_formats(path: Path) -> None:
    """CityJSON and its like hold cities as well, but are not read: say so instead of GDAL's puzzled words."""
    with path.open("rb") as file:
        head = file.read(65536)
        file.seek(-min(65536, path.stat().st_size), SEEK_END)
        head += file.read()
    name = next((name for mark, name in _OTHER_FORMATS.items() if mark in head), None)
    if path.suffix.lower() in _MESH_SUFFIXES:
        name = f"a mesh ({path.suffix})"
    if not head:
        name = "an empty file"
    if name is not None:
        raise CityError(f"{path}: {name} is not read; expected {_EXPECTED}")


def _kind(geometry_type: str | None) -> str | None:
    """What a layer's declared type can hold; None for points and tables."""
    if geometry_type is None:
        return None
    word = geometry_type.lower()
    if "polygon" in word or "surface" in word:
        return "polygon"
    if "line" in word or "curve" in word:
        return "line"
    return "any" if "unknown" in word or "collection" in word else None


def _choose(
    path: Path,
    layers: list[_Layer],
    fit: list[_Layer],
    named: str | None,
    words: tuple[str, ...],
    telling_columns: tuple[str, ...],
    what: str,
    option: str,
) -> list[_Layer]:
    """The layers called ``named``, else the only one that fits, else the only one that its name or columns give away."""
    if named is not None:
        by_name = {one.name: one for one in layers}
        wanted = [named] if named in by_name else [one.strip() for one in named.split(",")]
        missing = [one for one in wanted if one not in by_name]
        if missing:
            raise CityError(f"{path}: {option} {missing[0]!r}: no such layer; found {', '.join(by_name) or 'none'}")
        view = next((one for one in wanted if by_name[one].kind == "view"), None)
        if view is not None:
            raise CityError(
                f"{path}: {option} {view!r}: a table expected, found a view, which is SQL that runs while one reads; save it "
                "as a layer of its own"
            )
        return [by_name[one] for one in wanted]
    if not fit:
        kinds = ", ".join(f"{one.name} ({one.kind}s)" for one in layers) or "none with lines or polygons"
        raise CityError(f"{path}: expected a layer of {what}, found {kinds}")
    if len(fit) == 1:
        return fit
    by_word = [one for one in fit if any(word in one.name.lower() for word in words)]
    by_column = [one for one in by_word or fit if any(plain_name(column) in telling_columns for column in one.columns)]
    for candidates in (by_word, by_column):
        if len(candidates) == 1:
            return candidates
    names = ", ".join(one.name for one in by_column or by_word or fit)
    raise CityError(
        f"{path}: several layers could be {what} ({names}): choose with {option} NAME, or several with {option} NAME,NAME"
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Table:
    """A layer in memory: geometries (None where missing or unreadable) and columns."""

    layer: _Layer
    crs: pyproj.CRS | None
    geometries: tuple[BaseGeometry | None, ...]
    columns: dict[str, NDArray[Any]]


def _read(layer: _Layer, ledger: Ledger) -> _Table:
    """All features; what GDAL warns about goes to the ledger."""
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            meta, _, wkb, data = pyogrio.raw.read(
                local_path(layer.file), layer=layer.name, force_2d=True, datetime_as_string=True
            )
    except _GDAL_ERRORS as error:
        raise CityError(f"{layer.file} (layer {layer.name}): cannot be read: {error}") from error
    for one in caught:
        ledger.warn(f"{layer.file.name}: {one.message}")
    geometries = () if wkb is None else tuple(geometries_from_wkb(wkb))
    if layer.file.suffix.lower() == ".shp" and meta["encoding"] == "ISO-8859-1" and not _says_encoding(layer.file):
        data = texts_of_unknown_encoding(data, layer.file.name, ledger)
    columns = {str(name): values for name, values in zip(meta["fields"], data, strict=True)}
    return _Table(
        layer, declared_crs(layer.file, meta["crs"], hint="; name one with --crs EPSG:..."), geometries, columns
    )


def _says_encoding(file: Path) -> bool:
    """Whether a Shapefile has a .cpg with something in it."""
    return any(
        one.stat().st_size
        for one in (file.with_suffix(".cpg"), file.with_suffix(".CPG"), Path(f"{file}.cpg"))
        if one.is_file()
    )


def _unpacked(geometry: BaseGeometry) -> BaseGeometry:
    """A collection's members may be collections: one level is opened by ``get_parts``, deeper ones here."""
    parts = _flatten(shapely.get_parts(geometry))
    return shapely.geometrycollections(parts) if geometry.geom_type == "GeometryCollection" else geometry


def _flatten(parts: Iterable[BaseGeometry]) -> list[BaseGeometry]:
    """Parts of parts, until none is a collection."""
    flat: list[BaseGeometry] = []
    for part in parts:
        if shapely.get_type_id(part) >= 4:
            flat += _flatten(shapely.get_parts(part))
        else:
            flat.append(part)
    return flat


def _wanted_column(table: _Table, named: str | None, names: tuple[str, ...], option: str) -> str:
    """The column called ``named``, which must be there, else a guess, else an empty string."""
    if named is None:
        return guess_column(table.columns, names) or ""
    if named not in table.columns:
        has = ", ".join(table.columns) or "none"
        raise CityError(
            f"{table.layer.file} (layer {table.layer.name}): {option} {named!r}: no such column; found {has}"
        )
    return named


def _label(column: str) -> str:
    return f"column {column}" if column else ""
