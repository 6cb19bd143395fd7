"""Columns of GIS layers in the words of OpenStreetMap: which column means what, and which rows are no building and no street.

Columns become OpenStreetMap tags by lists of usual names. Exports of whole maps put land use beside buildings and railways
beside roads; the same columns tell them apart.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mmi.reading.names import readable_name
from mmi.reading.raw_layers import is_yes
from mmi.reading.report import Ledger

__all__ = [
    "BUILDING_COLUMNS", "HEIGHT_COLUMNS", "LEVELS_COLUMNS", "STREET_COLUMNS", "guess_column", "ids_of_rows", "in_feet",
    "plain_name", "says_feet", "tags_of_rows", "texts_of_unknown_encoding", "unit_of_heights", "why_no_building",
    "why_no_street",
]  # fmt: skip

# Names are compared without case and punctuation; the first that a layer has is used.
HEIGHT_COLUMNS = (
    "height", "heightm", "hauteur", "heightag", "buildingheight", "bldgheight", "hoehe", "höhe", "gebhoehe", "altura",
    "altezza", "hoogte", "relh2", "measuredheight", "estheight", "heightft", "heightfeet", "bldgheightft", "buildingheightft",
)  # fmt: skip
LEVELS_COLUMNS = (
    "buildinglevels", "levels", "floors", "floorsag", "numfloors", "nfloors", "storeys", "stories", "nbetages", "etages",
    "geschosse", "pisos", "plantas",
)  # fmt: skip
BUILDING_COLUMNS = MappingProxyType(
    {
        "min_height": ("minheight", "minheightm", "buildingminheight"),
        "building:min_level": ("buildingminlevel", "minlevel"),
        "building:part": ("buildingpart",),
        "building": ("building",),
        "layer": ("layer",),
        "location": ("location",),
        "underground": ("isunderground", "underground"),
        "fclass": ("fclass",),
        "landuse": ("landuse",),
        "natural": ("natural",),
        "waterway": ("waterway",),
        "leisure": ("leisure",),
    }
)
STREET_COLUMNS = MappingProxyType(
    {
        "highway": ("highway", "fclass", "roadclass", "roadtype", "nature", "class", "type", "kind"),
        "name": ("name", "nom", "street", "streetname", "strname", "nomvoie"),
        "width": ("width", "largeur", "breite"),
        "lanes": ("lanes", "nbvoies", "numlanes"),
        "tunnel": ("tunnel",),
        "bridge": ("bridge",),
        "layer": ("layer",),
        "covered": ("covered",),
        "indoor": ("indoor",),
        "access": ("access",),
        "foot": ("foot",),
        "motor_vehicle": ("motorvehicle",),
        "footway": ("footway",),
        "area": ("area",),
        "subtype": ("subtype",),
        "railway": ("railway",),
        "waterway": ("waterway",),
        "barrier": ("barrier",),
        "fence": ("fence",),
        "power": ("power",),
        "aerialway": ("aerialway",),
    }
)
# In a Shapefile a name of ten letters may have lost its last ones: HEIGHT_FEE.
_SAYS_FEET = re.compile(r"(?:^|[\W_]|height|hgt|ht)(?:ft|feet)(?:$|[\W_])|^.{6}(?:[\W_]|ht|gt)fee$", re.IGNORECASE)
# What programs write into cells that have no value.
_EMPTY = frozenset({"", "null", "<null>", "(null)", "nan", "n/a", "#n/a", "-"})
_KNOWN_IN_FEET = frozenset({"heightroof"})  # of New York's building footprints
_IDS = ("id", "osmid", "idway", "osmway", "buildingid", "bldgid", "gmlid", "cleabs", "objectid", "uid", "gid", "pk")
_LAND = ("fclass", "landuse", "natural", "waterway", "leisure")
# Their values, in OpenStreetMap and in its extracts as Shapefiles, that no building has.
_OPEN_LAND = frozenset(
    {
        "allotments", "basin", "beach", "canal", "cemetery", "farmland", "farmyard", "forest", "garden", "golf_course", "grass",
        "grassland", "greenfield", "heath", "marsh", "meadow", "nature_reserve", "orchard", "park", "parking", "pitch",
        "playground", "recreation_ground", "reservoir", "river", "riverbank", "sand", "scrub", "vineyard", "water", "wetland",
        "wood",
    }
)  # fmt: skip
_NO_ROADS = ("railway", "waterway", "barrier", "fence", "power", "aerialway")
# Values of a column that tells the kinds of lines apart, where roads, railways and rivers share it.
_NO_ROAD_KINDS = frozenset(
    {
        "aerialway", "barrier", "broad_gauge", "canal", "ditch", "drain", "fence", "funicular", "hedge", "light_rail",
        "monorail", "narrow_gauge", "power", "power_line", "rail", "railway", "river", "standard_gauge", "stream", "subway",
        "tram", "water", "waterway",
    }
)  # fmt: skip


def plain_name(name: str) -> str:
    """A column's name without case and punctuation."""
    return re.sub(r"[\W_]", "", name.lower())


def guess_column(columns: dict[str, NDArray[Any]], names: tuple[str, ...]) -> str | None:
    """The first column called like one of ``names`` (case and punctuation aside) that is not empty throughout."""
    for name in names:
        for column, values in columns.items():
            if plain_name(column) == name and any(_text(value) is not None for value in values):
                return column
    return None


def _text(value: object) -> str | None:
    """A cell as a tag's value; None where it is empty or says so in a word, a list or binary."""
    if value is None or isinstance(value, np.ndarray | list | bytes) or value != value:
        return None
    if isinstance(value, float | np.floating) and float(value).is_integer():
        value = int(value)
    text = str(value).strip()
    return None if text.lower() in _EMPTY else text


def texts_of_unknown_encoding(columns: list[NDArray[Any]], file: str, ledger: Ledger) -> list[NDArray[Any]]:
    """The columns of a Shapefile that does not say what it is written in, and was read as Latin-1: as ``readable_name`` reads.

    The ledger says so: a note where all texts are UTF-8, as many programs write, else a warning.
    """
    bytes_of = {
        text: text.encode("latin-1")
        for values in columns
        if values.dtype == object
        for text in values.tolist()
        if isinstance(text, str) and not text.isascii() and max(text) <= "\xff"
    }
    if not bytes_of:
        return columns
    readable = {text: readable_name(data) for text, data in bytes_of.items()}
    if all(text.encode("utf-8") == bytes_of[was] for was, text in readable.items()):
        ledger.note("noted", "texts read as UTF-8, as the Shapefile does not say what they are written in", file)
    else:
        ledger.warn(
            f"{file}: says nowhere what its texts are written in, such as {next(iter(readable.values()))!r}: "
            f"its .cpg should (CP932)"
        )
    return [
        np.array([readable.get(one, one) if isinstance(one, str) else one for one in values], dtype=object)
        if values.dtype == object
        else values
        for values in columns
    ]


def says_feet(name: str) -> bool:
    """Whether the name of a column or attribute says that it holds feet (``height_ft``)."""
    return _SAYS_FEET.search(name) is not None


def unit_of_heights(column: str, told: str | None, file: str, ledger: Ledger) -> str:
    """``m`` or ``ft``: the unit of the ``column`` of heights, ``told`` or as its name says; of an unsure one it warns."""
    if told is not None or not column:
        return told or "m"
    if says_feet(column):
        ledger.note("noted", f"heights in feet, as the column's name says ({column})")
        return "ft"
    if plain_name(column) in _KNOWN_IN_FEET:
        ledger.warn(
            f"{file}: column {column} is taken as metres, but holds feet in the data that is known for it: --height-unit ft"
        )
    return "m"


def in_feet(tags: dict[str, str]) -> dict[str, str]:
    """The tags with feet as the unit of heights that name none."""
    feet = {
        key: f"{tags[key]} ft" for key in ("height", "min_height") if re.fullmatch(r"[+-]?[\d.,]+", tags.get(key, ""))
    }
    return tags | feet


def tags_of_rows(
    columns: dict[str, NDArray[Any]], count: int, wanted: Mapping[str, tuple[str, ...]]
) -> list[dict[str, str]]:
    """Tags of each of ``count`` rows: tag -> the cell of the column by one of the ``wanted`` names (exact, or guessed)."""
    tags: list[dict[str, str]] = [{} for _ in range(count)]
    for tag, names in wanted.items():
        column = names[0] if names[0] in columns else guess_column(columns, names)
        if column is None:
            continue
        for own, value in zip(tags, columns[column], strict=True):
            if (text := _text(value)) is not None:
                own[tag] = text
    return tags


def ids_of_rows(columns: dict[str, NDArray[Any]], count: int, named: str) -> list[str]:
    """Ids of ``count`` rows from the column ``named``, else from the first usual id column without gaps or repeats.

    ``feature/N`` is the id of a row that has none.
    """
    if named:
        return [_text(value) or f"feature/{row}" for row, value in enumerate(columns[named])]
    for name in _IDS:
        for column, values in columns.items():
            texts = [_text(value) for value in values]
            if plain_name(column) == name and None not in texts and len(set(texts)) == len(texts):
                return [str(text) for text in texts]
    return [f"feature/{row}" for row in range(count)]


def why_no_building(tags: Mapping[str, str], column: str | None) -> str | None:
    """Why a polygon is no building (land use, water, a car park), or None.

    ``column`` is the layer's column ``building``, None if it has none or one that is empty throughout: then every polygon
    counts, unless a column of land use calls it open land. A building part needs no value there.
    """
    if column is None:
        open_land = next((tags[tag] for tag in _LAND if tags.get(tag, "").lower() in _OPEN_LAND), None)
        # A building may say on what land it stands, but land has no height; the class of a Shapefile is the thing itself.
        sure = "fclass" in tags or not {"height", "building:levels"} & tags.keys()
        return f"open land ({open_land.lower()})" if open_land is not None and sure else None
    if "building" in tags or is_yes(tags.get("building:part")):
        return None
    return f"none (empty in the column {column})"


def why_no_street(tags: Mapping[str, str], column: str | None) -> str | None:
    """Why a line is no road (a railway, a river, a fence, a power line), or None.

    ``column`` is the layer's column ``highway``, None if it has none or one that is empty throughout. A road with rails in
    it is a road.
    """
    for kind in (tags.get("subtype", ""), tags.get("highway", "")):
        if kind.lower() in _NO_ROAD_KINDS:
            return f"no road ({kind.lower()})"
    if "highway" in tags:
        return "no road (highway=no)" if tags["highway"].lower() == "no" else None
    other = next((tag for tag in _NO_ROADS if is_yes(tags.get(tag))), None)
    if other is not None:
        return f"no road ({other})"
    return None if column is None else f"no road (empty in the column {column})"
