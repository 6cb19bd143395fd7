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

from mmi import limits
from mmi.city.model import TriangleMesh
from mmi.foundation.errors import CityError
from mmi.reading.city_models.cityjson_parts import (
    DAMAGE,
    attributes_of,
    color_of,
    families_of,
    is_building_kind,
    level_of,
    line_of,
    missing_parts,
    objects_with_all_ids,
    points_of,
    surfaces_of,
    theme_values,
    without_looks,
    worth_of,
)
from mmi.reading.city_models.cityjson_templates import INSTANCE, placed_template
from mmi.reading.city_models.extruded import height_from_attributes, prism_of_rings
from mmi.reading.city_models.faces import Color, Faces
from mmi.reading.coordinates import named_crs
from mmi.reading.names import UniqueNames
from mmi.reading.pictures import PictureShelf, file_beside
from mmi.reading.raw_layers import ModelLayer, RawModel, RawStreet
from mmi.reading.report import Ledger

__all__ = ["is_cityjson", "read_cityjson"]

_GROUND = ("Road", "Railway", "Square", "TransportSquare", "LandUse", "PlantCover", "WaterBody", "Waterway")
_DEPTH = MappingProxyType({"MultiSurface": 1, "CompositeSurface": 1, "Solid": 2, "MultiSolid": 3, "CompositeSolid": 3})
_HEAD = 4096


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
    for document, features in _documents(path, ledger):
        try:
            reader.begin(document)
            for feature in features:
                reader.take(feature)
        except DAMAGE as error:
            raise CityError(
                f"{path}: CityJSON of its specification expected, found other ({line_of(error)})"
            ) from error
    return reader.layer()


def _documents(path: Path, ledger: Ledger) -> Iterator[tuple[dict[str, Any], Iterator[dict[str, Any]]]]:
    """The first document, which says how to read the others, and those with objects: itself, or the features of a sequence."""
    text, repeated = path.read_bytes(), list[str]()
    objects = objects_with_all_ids(repeated)
    try:
        try:
            lines, sequence = [json.loads(text, object_pairs_hook=objects)], False
        except json.JSONDecodeError:
            whole = (line for line in text.splitlines() if line.strip())
            lines, sequence = [json.loads(line, object_pairs_hook=objects) for line in whole], True
            if len(lines) < 2:
                raise
    except (ValueError, RecursionError) as error:
        raise CityError(f"{path}: CityJSON expected, found damaged JSON ({line_of(error)})") from error
    if not all(isinstance(line, dict) for line in lines):
        raise CityError(f"{path}: CityJSON objects expected, found other JSON")
    for name in repeated:
        ledger.note("repaired", "repeated id made unique", name)
    first = lines[0]
    yield first, iter(lines[1:] if sequence and not first.get("CityObjects") else lines)


class _Reader:
    """Collects what the documents of one file hold."""

    def __init__(self, path: Path, ledger: Ledger, lod: str | None, fallback: pyproj.CRS | None) -> None:
        self._path, self._ledger, self._lod, self._fallback = path, ledger, lod, fallback
        self._faces = Faces(str(path))
        self._shelf = PictureShelf(ledger)
        self._points: list[NDArray[np.float64]] = [np.empty((0, 3))]
        self._uv: list[NDArray[np.float64]] = [np.empty((0, 2))]
        self._count, self._uv_count = 0, 0
        self._owners: dict[str, int] = {}
        self._names = UniqueNames()
        self._damage: str | None = None
        self._ground = Faces()
        self._cover = Faces()
        self._streets: list[RawStreet] = []
        self._scale, self._translate = np.ones(3), np.zeros(3)
        self._no_places: frozenset[int] = frozenset()
        self._templates: Any = None
        self._here, self._number = np.empty((0, 3)), 0
        self._added: list[NDArray[np.float64]] = []
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
            except DAMAGE as error:
                raise CityError(f"{self._path}: transform: scale and translate expected, three numbers each") from error
        self._crs = self._declared_crs(document.get("metadata") or {})
        self._templates = document.get("geometry-templates")
        if not document.get("CityObjects") and isinstance(self._templates, dict):
            self._templates = without_looks(self._templates)  # features of a sequence have looks of their own

    def take(self, feature: Mapping[str, Any]) -> None:
        """All city objects of a document or feature."""
        objects = feature.get("CityObjects")
        if not isinstance(objects, dict):
            raise CityError(f"{self._path}: CityObjects expected, found {type(objects).__name__}")
        self._appearance(feature.get("appearance") or {})
        points = points_of(feature.get("vertices"))
        with np.errstate(over="ignore", invalid="ignore"):
            points = points * self._scale + self._translate
            self._no_places = frozenset(np.flatnonzero(~(np.abs(points) < limits.COORDINATE).all(axis=1)).tolist())
        points[list(self._no_places)] = 0.0
        self._here, self._number, self._added = points, len(points), []
        for name, count in missing_parts(objects).items():
            self._ledger.note("left out", "part: not in the file", name, count=count)
        for family, members in families_of(objects).items():
            self._take_sound_family(family, [(name, objects[name]) for name in members])
        self._points.append(np.concatenate([points, *self._added]))
        self._count += self._number

    def layer(self) -> ModelLayer:
        """What was collected.

        Raises:
            CityError: no building is left, and an object was damaged.
        """
        if not self._owners and self._damage is not None:
            raise CityError(self._damage)
        points, uv = np.concatenate(self._points), np.concatenate(self._uv)
        meshes = self._faces.meshes(points, uv)
        items = []
        for name, owner in self._owners.items():
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

    def _take_sound_family(self, family: str, members: list[tuple[str, dict[str, Any]]]) -> None:
        """A family; where something is wrong with it, nothing of it, and a note."""
        tables = (self._faces, self._ground, self._cover)
        marks, streets = [one.mark() for one in tables], len(self._streets)
        try:
            self._take_family(family, [(name, self._without_instances(one)) for name, one in members])
        except DAMAGE as error:
            for table, mark in zip(tables, marks, strict=True):
                table.cut_back(mark)
            del self._streets[streets:]
            self._damage = self._damage or (
                f"{self._path}: object {family}: geometry as CityJSON describes it expected, found other ({line_of(error)})"
            )
            is_building = any(isinstance(one, dict) and is_building_kind(one.get("type")) for _, one in members)
            what = "building" if is_building else "object"
            self._ledger.note("left out", f"{what}: geometry that is not as CityJSON describes it", family)

    def _without_instances(self, one: dict[str, Any]) -> dict[str, Any]:
        """The object with geometries of its own in place of templates."""
        geometries = one.get("geometry") or []
        if not any(geometry["type"] == INSTANCE for geometry in geometries):
            return one
        own = []
        for geometry in geometries:
            if geometry["type"] == INSTANCE:
                geometry, points = placed_template(self._templates, geometry, self._here, self._number)
                self._add_points(points)
                self._ledger.note("read", "instances of templates")
            own.append(geometry)
        return {**one, "geometry": own}

    def _add_points(self, points: NDArray[np.float64]) -> None:
        """More points of this feature, behind those that it has."""
        if not (np.abs(points) < limits.COORDINATE).all():
            raise ValueError(f"finite coordinates expected, below {limits.COORDINATE:g}")
        self._added.append(points)
        self._number += len(points)

    def _take_family(self, family: str, members: list[tuple[str, dict[str, Any]]]) -> None:
        if any(is_building_kind(one["type"]) for _, one in members):
            self._take_building(family, [(name, one) for name, one in members if is_building_kind(one["type"])])
            return
        for name, one in members:
            kind = one["type"]
            for geometry in one.get("geometry") or []:
                if kind == "TINRelief":
                    self._add(self._ground, 0, geometry, looks=False)
                elif kind in ("Road", "Square", "TransportSquare") and geometry["type"] == "MultiLineString":
                    self._take_street(name, one, geometry)
                elif kind in _GROUND and geometry["type"] in _DEPTH:
                    self._add(self._cover, 0, geometry, looks=False)
            if kind not in ("TINRelief", *_GROUND):
                self._ledger.note("left out", f"{kind}: no building", name)

    def _take_building(self, family: str, members: list[tuple[str, dict[str, Any]]]) -> None:
        """The surfaces of a building and its parts at one level of detail."""
        self._ledger.note("read", "buildings")
        choices = [
            geometry for _, one in members for geometry in one.get("geometry") or [] if geometry["type"] in _DEPTH
        ]
        levels = sorted({level_of(geometry) for geometry in choices if level_of(geometry) >= 1.0})
        if not levels:
            self._take_footprints(family, members)
            return
        wanted = levels[-1]
        if self._lod is not None:
            limit = float(self._lod) + (0.95 if float(self._lod).is_integer() else 0.0)
            wanted = max((one for one in levels if one <= limit), default=levels[0])
            if not float(self._lod) <= wanted <= limit:
                self._ledger.note("noted", f"building: no level of detail {self._lod}, taken at another", family)
        whole = any(
            name == family and geometry["type"] in _DEPTH and level_of(geometry) == wanted
            for name, one in members
            for geometry in one.get("geometry") or []
        )
        owner = len(self._owners)
        for name, one in members:
            own = [geometry for geometry in one.get("geometry") or [] if geometry["type"] in _DEPTH]
            level = wanted
            if name != family and not whole:
                # A part at lower levels only is not shown by anything else, unlike its parent.
                below = [found for found in map(level_of, own) if 1.0 <= found <= wanted]
                level = max(below, default=wanted)
            at_level = [geometry for geometry in own if level_of(geometry) == level]
            if at_level:
                self._add(self._faces, owner, max(at_level, key=worth_of), looks=True)
        self._name_owner(family)

    def _name_owner(self, family: str) -> None:
        """The next owner of faces is the building ``family``."""
        self._ledger.note("repaired", "building without an id named", count=int(not family))
        family = family or "Building"
        name = self._names.free(family)
        self._names.take(name)
        self._owners[name] = len(self._owners)
        self._ledger.note("repaired", "repeated id made unique", name, count=int(name != family))

    def _take_footprints(self, family: str, members: list[tuple[str, dict[str, Any]]]) -> None:
        """A building that has footprints only: a prism on each, where its attributes, or those of the part, say how high."""
        whole = next((height_from_attributes(attributes_of(one)) for name, one in members if name == family), None)
        standing = False
        kinds: set[str] = set()
        for _, one in members:
            flat = [geometry for geometry in one.get("geometry") or [] if geometry["type"] in _DEPTH]
            kinds |= {str(geometry["type"]) for geometry in one.get("geometry") or [] if geometry["type"] not in _DEPTH}
            height = height_from_attributes(attributes_of(one)) or whole
            if flat and height is None:
                self._ledger.note("left out", "building: only footprints, without a height", family)
                return
            if flat and height is not None:
                standing = True
                best = max(flat, key=level_of)
                for rings in self._checked_surfaces(best):
                    points, faces = prism_of_rings([self._here[ring] for ring in rings], height[0])
                    first = self._count + self._number
                    self._add_points(points)
                    self._faces.add_bare(
                        len(self._owners), [[[first + k for k in ring] for ring in face] for face in faces]
                    )
                self._ledger.note("inferred", f"height of a footprint from {height[1]}", family)
        if standing:
            self._name_owner(family)
        else:
            why = f"no surfaces ({', '.join(sorted(kinds))})" if kinds else "no geometry"
            self._ledger.note("left out", f"building: {why}", family)

    def _add(self, faces: Faces, owner: int, geometry: Mapping[str, Any], *, looks: bool) -> None:
        surfaces = self._checked_surfaces(geometry)
        depth = _DEPTH[geometry["type"]]
        textures = theme_values(geometry.get("texture"), depth, len(surfaces)) if looks else None
        materials = theme_values(geometry.get("material"), depth, len(surfaces)) if looks else None
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

    def _checked_surfaces(self, geometry: Mapping[str, Any]) -> list[list[list[int]]]:
        """The surfaces of a geometry, whose corners are all among the points of the feature."""
        surfaces = list(surfaces_of(geometry["boundaries"], _DEPTH[geometry["type"]]))
        every = list(chain.from_iterable(chain.from_iterable(surfaces)))
        if every and not (set(map(type, every)) == {int} and min(every) >= 0 and max(every) < self._number):
            raise ValueError(f"vertex {str(max(every))[:20]} of {self._number}")
        if self._no_places and not self._no_places.isdisjoint(every):
            first = min(self._no_places.intersection(every))
            raise ValueError(f"vertices: {first}: three finite numbers expected, below {limits.COORDINATE:g}")
        return surfaces

    def _texture(self, value: Any, count: int) -> tuple[int | None, list[list[int]]]:  # noqa: ANN401
        """Picture and places of texture coordinates, from one value a ring: [texture, uv, uv, ...]."""
        if not value or not isinstance(value[0], list) or not value[0] or value[0][0] is None:
            return None, []
        place = value[0][0]
        if not (isinstance(place, int) and 0 <= place < count):
            self._ledger.note("noted", "texture that is not there: its face is painted", str(place)[:20])
            return None, []
        known = len(self._uv[-1])
        uv = [[self._uv_count + int(k) for k in ring[1:] if k is not None and 0 <= k < known] for ring in value]
        return self._textures[place], uv

    def _take_street(self, name: str, one: Mapping[str, Any], geometry: Mapping[str, Any]) -> None:
        points = self._here
        lines = [
            LineString(points[line, :2])
            for line in geometry["boundaries"]
            if len(line) > 1 and all(0 <= k < len(points) for k in line) and self._no_places.isdisjoint(line)
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
        """Pictures, colours and texture coordinates of a document or feature; none, and a note, where they are damaged."""
        self._uv_count += len(self._uv[-1])
        try:
            table = appearance.get("vertices-texture") or appearance.get("vertex-texture") or np.empty((0, 2))
            uv = np.array(table, dtype=np.float64)
            if uv.shape != (len(table), 2):
                raise ValueError("vertices-texture: pairs of numbers")
            textures = [self._picture(str(one["image"])) for one in appearance.get("textures") or []]
            materials = [color_of(one.get("diffuseColor")) for one in appearance.get("materials") or []]
        except DAMAGE as error:
            self._ledger.note("left out", "appearance: not as CityJSON describes it", line_of(error))
            uv, textures, materials = np.empty((0, 2)), [], []
        self._uv.append(uv)
        self._textures, self._materials = textures, materials

    def _picture(self, image: str) -> int | None:
        """The texture of a picture beside the file, or in its folder of appearances; None, and a note, where there is none."""
        if image not in self._images:
            file = file_beside(self._path.parent, image, self._ledger, also=("appearances", "appearance"))
            if file is None:
                self._ledger.note("left out", "picture: it is not there", image)
                self._images[image] = None
            else:
                self._images[image] = self._shelf.place_file(file, image, alpha=True)
        return self._images[image]
