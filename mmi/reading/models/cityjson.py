"""CityJSON 0.x to 2.0 and CityJSONSeq: buildings as meshes with pictures and colours, terrain, and streets where it has any.

A building is a first-level object with all its parts and installations, at the highest level of detail that it has (or the
one asked for). Solids give their outer shell. What is no building stays out, except that a TIN relief, or else the surfaces
of roads, land and water, tell where the ground is, and that roads given as lines are streets.
Source: OGC CityJSON 2.0 (21-089), CityJSON 1.1 for sequences; https://www.cityjson.org/specs.
"""

from __future__ import annotations

import json
import mmap
import re
from collections.abc import Iterator, Mapping
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pyproj
from numpy.typing import NDArray
from shapely.geometry import LineString

from mmi.city.model import TriangleMesh
from mmi.foundation.errors import CityError
from mmi.reading.coordinates import named_crs
from mmi.reading.models.faces import Color, Faces
from mmi.reading.pictures import PictureShelf, file_beside
from mmi.reading.raw_layers import ModelLayer, RawModel, RawStreet
from mmi.reading.report import Ledger

__all__ = ["is_cityjson", "read_cityjson"]

_BUILDING = (
    "Building",
    "BuildingPart",
    "BuildingInstallation",
    "BuildingConstructiveElement",
    "Tunnel",
    "OtherConstruction",
)
_GROUND = ("Road", "Railway", "Square", "TransportSquare", "LandUse", "PlantCover", "WaterBody", "Waterway")
_DEPTH = MappingProxyType({"MultiSurface": 1, "CompositeSurface": 1, "Solid": 2, "MultiSolid": 3, "CompositeSolid": 3})
_HEAD = 4096
_FARTHEST = 1e9
"""Coordinates beyond this are no place on earth in any units."""
_DAMAGE = (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError, RecursionError)
"""What Python raises on JSON of another shape than expected."""


def is_cityjson(path: Path) -> bool:
    """Whether the file says that it is CityJSON or a sequence of its features."""
    with path.open("rb") as file:
        head = file.read(_HEAD)
        if re.search(rb'"type"\s*:\s*"CityJSON(Feature)?"', head):
            return True
        if not head.lstrip().startswith(b"{") or re.search(rb'"type"\s*:\s*"FeatureCollection"', head):
            return False
        # Keys may come in any order: the type may well stand behind megabytes of vertices.
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as whole:
            return whole.find(b'"CityObjects"') >= 0


def read_cityjson(path: Path, ledger: Ledger, *, lod: str | None = None, crs: pyproj.CRS | None = None) -> ModelLayer:
    """Everything that ``path`` holds. ``lod``: the level of detail wanted (``"2"``, ``"1.2"``); else the highest of each.

    ``crs`` counts where the file's is none that can be understood.

    Raises:
        CityError: the file is damaged, or no CityJSON; names the object at fault.
    """
    reader = _Reader(path, ledger, lod, crs)
    for document, features in _documents(path):
        try:
            reader.begin(document)
            for feature in features:
                reader.take(feature)
        except _DAMAGE as error:
            raise CityError(f"{path}: CityJSON of its specification expected, found other ({_line(error)})") from error
    return reader.layer()


def _documents(path: Path) -> Iterator[tuple[dict[str, Any], Iterator[dict[str, Any]]]]:
    """The first document, which says how to read the others, and those with objects: itself, or the features of a sequence."""
    text = path.read_bytes()
    try:
        try:
            lines, sequence = [json.loads(text)], False
        except json.JSONDecodeError:
            lines, sequence = [json.loads(line) for line in text.splitlines() if line.strip()], True
            if len(lines) < 2:
                raise
    except (ValueError, RecursionError) as error:
        raise CityError(f"{path}: CityJSON expected, found damaged JSON ({_line(error)})") from error
    if not all(isinstance(line, dict) for line in lines):
        raise CityError(f"{path}: CityJSON objects expected, found other JSON")
    first = lines[0]
    yield first, iter(lines[1:] if sequence and not first.get("CityObjects") else lines)


class _Reader:
    """Collects what the documents of one file hold."""

    def __init__(self, path: Path, ledger: Ledger, lod: str | None, fallback: pyproj.CRS | None) -> None:
        self._path, self._ledger, self._lod, self._fallback = path, ledger, lod, fallback
        self._faces = Faces()
        self._shelf = PictureShelf(ledger)
        self._points: list[NDArray[np.float64]] = [np.empty((0, 3))]
        self._uv: list[NDArray[np.float64]] = [np.empty((0, 2))]
        self._count, self._uv_count = 0, 0
        self._ids: dict[str, int] = {}
        self._ground = Faces()
        self._cover = Faces()
        self._streets: list[RawStreet] = []
        self._scale, self._translate = np.ones(3), np.zeros(3)
        self._crs: pyproj.CRS | None = None
        self._images: dict[str, int | None] = {}
        self._textures: list[int | None] = []
        self._materials: list[Color | None] = []

    def begin(self, document: Mapping[str, Any]) -> None:
        """Transform, CRS and appearance that hold for the features that follow."""
        transform = document.get("transform")
        if transform is not None:
            try:
                self._scale = np.array([float(one) for one in transform["scale"]]).reshape(3)
                self._translate = np.array([float(one) for one in transform["translate"]]).reshape(3)
            except _DAMAGE as error:
                raise CityError(f"{self._path}: transform: scale and translate expected, three numbers each") from error
        self._crs = self._declared_crs(document.get("metadata") or {})

    def take(self, feature: Mapping[str, Any]) -> None:
        """All city objects of a document or feature."""
        objects = feature.get("CityObjects")
        if not isinstance(objects, dict):
            raise CityError(f"{self._path}: CityObjects expected, found {type(objects).__name__}")
        self._appearance(feature.get("appearance") or {})
        try:
            points = np.array(feature.get("vertices") or np.empty((0, 3)), dtype=np.float64)
            if points.ndim != 2 or points.shape[1] != 3:
                raise ValueError(f"found an array of shape {points.shape}")
        except _DAMAGE as error:
            raise CityError(f"{self._path}: vertices: lists of three numbers expected ({_line(error)})") from error
        with np.errstate(over="ignore", invalid="ignore"):
            points = points * self._scale + self._translate
        if not (np.abs(points) < _FARTHEST).all():
            raise CityError(f"{self._path}: vertices: finite numbers expected, below {_FARTHEST:g}")
        self._points.append(points)
        for name, one in objects.items():
            if not isinstance(one, dict):
                raise CityError(f"{self._path}: object {name}: a JSON object expected, found {type(one).__name__}")
        families: dict[str, list[str]] = {}
        parents = _parents(objects)
        for name in objects:
            families.setdefault(_family(name, parents), []).append(name)
        for family, members in families.items():
            try:
                self._take_family(family, [(name, objects[name]) for name in members], len(points))
            except _DAMAGE as error:
                raise CityError(
                    f"{self._path}: object {family}: geometry as CityJSON describes it expected, found other"
                    f" ({_line(error)})"
                ) from error
        self._count += len(points)

    def layer(self) -> ModelLayer:
        """What was collected."""
        points, uv = np.concatenate(self._points), np.concatenate(self._uv)
        meshes = self._faces.meshes(points, uv)
        items = []
        for name, owner in self._ids.items():
            if owner in meshes:
                items.append(RawModel(name, meshes[owner]))
            else:
                self._ledger.note("left out", "building: no surface with an area", name)
        ground = self._ground if len(self._ground) else self._cover
        terrain: TriangleMesh | None = ground.meshes(points, uv).get(0)
        return ModelLayer(
            str(self._path), tuple(items), self._crs, self._shelf.textures(), terrain, tuple(self._streets)
        )

    # ------------------------------------------------------------------------------------------------- objects

    def _take_family(self, family: str, members: list[tuple[str, dict[str, Any]]], vertices: int) -> None:
        kinds = {one["type"].lstrip("+") for _, one in members}
        if kinds & set(_BUILDING):
            self._take_building(family, [(name, one) for name, one in members if one["type"] in _BUILDING], vertices)
            return
        for name, one in members:
            kind = one["type"]
            for geometry in one.get("geometry") or []:
                if kind == "TINRelief":
                    self._add(self._ground, 0, geometry, vertices, looks=False)
                elif kind in ("Road", "Square", "TransportSquare") and geometry["type"] == "MultiLineString":
                    self._take_street(name, one, geometry, vertices)
                elif kind in _GROUND and geometry["type"] in _DEPTH:
                    self._add(self._cover, 0, geometry, vertices, looks=False)
            if kind not in ("TINRelief", *_GROUND):
                self._ledger.note("left out", f"{kind}: no building", name)

    def _take_building(self, family: str, members: list[tuple[str, dict[str, Any]]], vertices: int) -> None:
        """The surfaces of a building and its parts at one level of detail."""
        self._ledger.note("read", "buildings")
        choices = [
            geometry for _, one in members for geometry in one.get("geometry") or [] if geometry["type"] in _DEPTH
        ]
        levels = sorted({_level(geometry) for geometry in choices if _level(geometry) >= 1.0})
        if not levels:
            other = any(one.get("geometry") for _, one in members)
            self._ledger.note("left out", f"building: {'only footprints' if other else 'no geometry'}", family)
            return
        wanted = levels[-1]
        if self._lod is not None:
            limit = float(self._lod) + (0.95 if float(self._lod).is_integer() else 0.0)
            wanted = max((one for one in levels if one <= limit), default=levels[0])
            if not float(self._lod) <= wanted <= limit:
                self._ledger.note("noted", f"building: no level of detail {self._lod}, taken at another", family)
        whole = any(
            name == family and geometry["type"] in _DEPTH and _level(geometry) == wanted
            for name, one in members
            for geometry in one.get("geometry") or []
        )
        if family in self._ids:
            raise CityError(f"{self._path}: object {family}: an id of its own expected, found it twice")
        owner = self._ids.setdefault(family, len(self._ids))
        for name, one in members:
            own = [geometry for geometry in one.get("geometry") or [] if geometry["type"] in _DEPTH]
            level = wanted
            if name != family and not whole:
                # A part at lower levels only is not shown by anything else, unlike its parent.
                below = [found for found in map(_level, own) if 1.0 <= found <= wanted]
                level = max(below, default=wanted)
            at_level = [geometry for geometry in own if _level(geometry) == level]
            if at_level:
                self._add(self._faces, owner, max(at_level, key=_worth), vertices, looks=True)

    def _add(self, faces: Faces, owner: int, geometry: Mapping[str, Any], vertices: int, *, looks: bool) -> None:
        depth = _DEPTH[geometry["type"]]
        surfaces = list(_surfaces(geometry["boundaries"], depth))
        textures = _values(geometry.get("texture"), depth, len(surfaces)) if looks else None
        materials = _values(geometry.get("material"), depth, len(surfaces)) if looks else None
        every = list(chain.from_iterable(chain.from_iterable(surfaces)))
        if every and not (set(map(type, every)) == {int} and min(every) >= 0 and max(every) < vertices):
            raise ValueError(f"vertex {str(max(every))[:20]} of {vertices}")
        if self._count:  # points of features that came before
            surfaces = [[[self._count + k for k in ring] for ring in surface] for surface in surfaces]
        if not (textures or materials):
            faces.add_bare(owner, surfaces)
            return
        for i, rings in enumerate(surfaces):
            texture, uv = self._texture(textures[i], len(self._textures)) if textures else (None, [])
            place = materials[i] if materials else None
            color = self._materials[place] if isinstance(place, int) and 0 <= place < len(self._materials) else None
            faces.add(owner, rings, texture=texture, uv=uv, color=color)

    def _texture(self, value: Any, count: int) -> tuple[int | None, list[list[int]]]:  # noqa: ANN401
        """Picture and places of texture coordinates, from one value a ring: [texture, uv, uv, ...]."""
        if not value or not isinstance(value[0], list) or not value[0] or value[0][0] is None:
            return None, []
        place = value[0][0]
        if not (isinstance(place, int) and 0 <= place < count):
            raise ValueError(f"texture {place} of {count}")
        known = len(self._uv[-1])
        uv = [[self._uv_count + int(k) for k in ring[1:] if k is not None and 0 <= k < known] for ring in value]
        return self._textures[place], uv

    def _take_street(self, name: str, one: Mapping[str, Any], geometry: Mapping[str, Any], vertices: int) -> None:
        points = self._points[-1]
        lines = [
            LineString(points[line, :2])
            for line in geometry["boundaries"]
            if len(line) > 1 and all(0 <= k < vertices for k in line)
        ]
        tags = {str(key): str(value) for key, value in (one.get("attributes") or {}).items() if value is not None}
        self._ledger.note("read", "streets")
        if lines:
            self._streets.append(RawStreet(name, tuple(lines), tags))

    # ---------------------------------------------------------------------------------------- what holds for all

    def _declared_crs(self, metadata: Mapping[str, Any]) -> pyproj.CRS | None:
        system = metadata.get("referenceSystem")
        if system is None and isinstance(metadata.get("crs"), dict):
            system = metadata["crs"].get("epsg")
        if system is None:
            return None
        return named_crs(f"{self._path}: referenceSystem", str(system), self._fallback)

    def _appearance(self, appearance: Mapping[str, Any]) -> None:
        """Pictures, colours and texture coordinates of a document or feature."""
        self._uv_count += len(self._uv[-1])
        try:
            table = appearance.get("vertices-texture") or appearance.get("vertex-texture") or np.empty((0, 2))
            self._uv.append(np.array(table, dtype=np.float64))
            if self._uv[-1].shape != (len(table), 2) or not np.isfinite(self._uv[-1]).all():
                raise ValueError("vertices-texture: pairs of finite numbers")
            self._textures = [self._picture(str(one["image"])) for one in appearance.get("textures") or []]
            self._materials = [_color(one.get("diffuseColor")) for one in appearance.get("materials") or []]
        except _DAMAGE as error:
            raise CityError(
                f"{self._path}: appearance: as CityJSON describes it expected, found other ({_line(error)})"
            ) from error

    def _picture(self, image: str) -> int | None:
        """The texture of a picture beside the file, or in its folder of appearances; None, and a note, where there is none."""
        if image not in self._images:
            file = file_beside(self._path.parent, image, self._ledger, also=("appearances", "appearance"))
            if file is None:
                self._ledger.note("left out", "picture: it is not there", image)
                self._images[image] = None
            else:
                self._images[image] = self._shelf.place(file.read_bytes(), image, alpha=True)
        return self._images[image]


def _line(error: BaseException) -> str:
    """What the error says, in one short line."""
    return " ".join(str(error).split())[:160]


def _parents(objects: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """Parts and what they are parts of. Groups are no wholes; the oldest files tell a whole its parts only."""
    found: dict[str, str] = {}
    for name, one in objects.items():
        if one.get("type") != "CityObjectGroup":
            for key in ("children", "Parts", "Installations"):
                found |= dict.fromkeys(one.get(key) or [], name)
    for name, one in objects.items():
        own = one.get("parents") or [one.get("parent")]
        for parent in own if isinstance(own, list) else []:
            if isinstance(parent, str) and parent in objects and objects[parent].get("type") != "CityObjectGroup":
                found[name] = parent
                break
    return found


def _family(name: str, parents: Mapping[str, str]) -> str:
    """The first-level object that ``name`` belongs to."""
    seen = {name}
    while name in parents and parents[name] not in seen:
        name = parents[name]
        seen.add(name)
    return name


def _level(geometry: Mapping[str, Any]) -> float:
    """The level of detail as a number, 2 where it cannot be read."""
    try:
        return float(geometry.get("lod", 2))
    except (TypeError, ValueError):
        return 2.0


def _worth(geometry: Mapping[str, Any]) -> tuple[bool, bool, bool]:
    """Rank of a geometry among those of one level: those with pictures first, then closed ones, then those with colours."""
    return bool(geometry.get("texture")), geometry["type"] != "MultiSurface", bool(geometry.get("material"))


def _surfaces(boundaries: list[Any], depth: int) -> Iterator[list[list[int]]]:
    """The surfaces of nested boundaries, outer shells only."""
    if depth == 1:
        yield from boundaries
    elif depth == 2:
        if boundaries:
            yield from boundaries[0]
    else:
        for solid in boundaries:
            yield from _surfaces(solid, 2)


def _values(themes: Any, depth: int, count: int) -> list[Any] | None:  # noqa: ANN401
    """What the first theme says of each surface, None where it says nothing (of this shape).

    A theme has ``values`` nested like the boundaries, or one ``value`` for all; the oldest files have the values alone.
    """
    if not themes:
        return None
    theme = next(iter(themes.values())) if isinstance(themes, dict) else {"values": themes}
    if "value" in theme:
        return [theme["value"]] * count
    values = theme.get("values")
    if not isinstance(values, list):
        return None
    try:
        flat = list(_surfaces(values, depth))
    except TypeError:
        return None
    return flat if len(flat) == count else None


def _color(value: Any) -> Color | None:  # noqa: ANN401
    """sRGB bytes of a diffuse colour in [0, 1]."""
    if value is None:
        return None
    red, green, blue = (round(255 * min(max(float(one), 0.0), 1.0)) for one in value[:3])
    return red, green, blue
