"""What GDAL may open: files of the formats that this project promises, told by their first bytes, and nothing behind them.

GDAL takes a file for whatever its contents or its name resemble. A few hundred bytes of XML or JSON can make it read other
files, ask servers or run pipelines (VRT, WFS, WMS, GDALG), and so can a name (``/vsicurl/``, ``WFS:``, ``zip://``) or a view
of SQL in a GeoPackage. So whatever is opened goes through here first.
"""

from __future__ import annotations

import sqlite3
import warnings
from contextlib import closing
from pathlib import Path

import pyogrio

from mmi import limits
from mmi.foundation.errors import CityError
from mmi.foundation.whole_files import check_size

__all__ = ["RASTERS", "VECTOR_FORMATS", "layers_of", "local_path", "vector_file"]

VECTOR_FORMATS = "GeoJSON, GeoPackage, Shapefile, FlatGeobuf, CSV with WKT"
RASTERS = (
    (".asc", ("AAIGrid", "GRASSASCIIGrid")),
    (".bil", ("EHdr", "ENVI")),
    (".dem", ("USGSDEM",)),
    (".flt", ("EHdr", "ENVI")),
    (".grd", ("GSAG", "GSBG", "GS7BG", "NWT_GRD")),
    (".hgt", ("SRTMHGT",)),
    (".img", ("HFA",)),
    (".jp2", ("JP2OpenJPEG",)),
    (".tif", ("GTiff",)),
    (".tiff", ("GTiff",)),
    (".xyz", ("XYZ",)),
)
"""Rasters by the suffix of their file, and which of GDAL's drivers may read it."""
_DRIVERS = ("CSV", "ESRI Shapefile", "ESRIJSON", "FlatGeobuf", "GPKG", "GeoJSON", "GeoJSONSeq", "JSONFG", "TopoJSON")
_SHAPEFILE, _FLATGEOBUF, _SQLITE, _ZIP = b"\x00\x00\x27\x0a", b"fgb\x03fgb", b"SQLite format 3\x00", b"PK"
_HEAD = 65536
_LEADS_ELSEWHERE = (b"<OGR", b"<VRT", b"<GDAL", b"<WFS", b"<WMS", b"gdal_streamed_alg")
"""GDAL looks for these anywhere near the beginning, even inside of the words of a GeoJSON."""
_TAKEN_APART = "!;?"
"""Letters of a name by which pyogrio takes it for an address, or for a file in an archive."""


def local_path(path: Path) -> Path:
    """The same file by a name that GDAL takes for nothing but a file on this machine.

    Raises:
        CityError: it has no such name, or is too large.
    """
    whole = path.absolute()
    try:
        str(whole).encode("utf-8")
    except UnicodeEncodeError:
        raise CityError(
            f"{path}: a name in UTF-8 expected, as GDAL takes no other; rename the file or folder"
        ) from None
    if str(whole).startswith("/vsi"):
        raise CityError(f"{path}: a file on this machine expected, found one of GDAL's virtual file systems")
    check_size(path, limits.CITY_BYTES, CityError)
    return whole


def vector_file(path: Path, expected: str) -> Path:
    """The file by its :func:`local_path`, where its contents are of a format that is promised; ``expected`` says what is.

    Raises:
        CityError: they are not, or it has no such name.
    """
    whole = local_path(path)
    if any(letter in str(whole) for letter in _TAKEN_APART):
        raise CityError(
            f"{path}: a name without {' '.join(_TAKEN_APART)} expected, as GDAL's reader takes it apart there"
        )
    with whole.open("rb") as file:
        head = file.read(_HEAD)
    found = _not_promised(whole, head)
    if found:
        raise CityError(f"{path}: expected {expected}; found: {found}")
    return whole


def _not_promised(path: Path, head: bytes) -> str:
    """What the file is instead of a vector format that is promised; nothing where it is one."""
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip(b"\x1e \t\r\n")
    mark = next((one for one in _LEADS_ELSEWHERE if one in head), None)
    if mark is not None and b"\x00" not in head[: head.index(mark)]:
        return f"a file that leads to other files or to servers ({mark.decode()}), which is not followed"
    if text.startswith(b"{") or head.startswith((_SHAPEFILE, _FLATGEOBUF)):
        return ""
    if head.startswith(_SQLITE):
        return _not_geopackage(path)
    if head.startswith(_ZIP):
        return "a zip; unpack it, and give what is in it"
    if text.startswith(b"<"):
        return "XML"
    if path.suffix.lower() == ".csv" and b"\x00" not in head:
        return ""
    return f"another kind of file; if GDAL knows it, ogr2ogr {path.stem}.gpkg {path.name} converts it"


def _not_geopackage(path: Path) -> str:
    """Why a file of SQLite is none that may be opened: the tables that a GeoPackage is told by are views, or missing."""
    try:
        kinds = _kinds(path)
    except sqlite3.Error as error:
        return f"a damaged GeoPackage ({error})"
    if "gpkg_contents" not in kinds:
        return "a database of SQLite that is no GeoPackage"
    view = next((name for name, kind in kinds.items() if name.startswith("gpkg_") and kind != "table"), None)
    return (
        "" if view is None else f"a GeoPackage whose {view} is a {kinds[view]}, which is SQL that runs while one reads"
    )


def _kinds(path: Path) -> dict[str, str]:
    """What each table of a database of SQLite is: table, view or virtual table; names in lower case, as SQLite compares."""
    with closing(sqlite3.connect(f"{path.as_uri()}?mode=ro&immutable=1", uri=True)) as database:
        rows = database.execute("SELECT name, type, sql FROM sqlite_master WHERE type IN ('table', 'view')").fetchall()
    return {
        str(name).lower(): "virtual table" if str(sql).upper().startswith("CREATE VIRTUAL") else str(kind)
        for name, kind, sql in rows
    }


def layers_of(path: Path, expected: str) -> tuple[tuple[str, bool], ...]:
    """The layers of a :func:`vector_file`: each name, and whether it is a view, which must not be read.

    Raises:
        CityError: as :func:`vector_file`; also where GDAL takes the file for another format than is promised.
        pyogrio.errors.DataSourceError: GDAL cannot read it; other errors of pyogrio.
    """
    whole = vector_file(path, expected)
    with whole.open("rb") as file:
        kinds = _kinds(whole) if file.read(len(_SQLITE)) == _SQLITE else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        names = [str(name) for name, _ in pyogrio.list_layers(whole)]
        layers = tuple((name, kinds is not None and kinds.get(name.lower()) != "table") for name in names)
        first = next((name for name, is_view in layers if not is_view), None)
        driver = _DRIVERS[0] if first is None else pyogrio.read_info(whole, layer=first)["driver"]
    if driver not in _DRIVERS:
        raise CityError(f"{path}: expected {expected}; found: {driver}, which is not read")
    return layers
