"""CityGML 1.0 and 2.0: buildings as meshes with pictures and colours, and the ground of relief, roads and land.

There is no well-kept Python library that carries CityGML with its appearances: GDAL drops them, and what else there is
converts in Java. The format is wide, what a city of buildings needs of it is narrow: polygons inside buildings at a level
of detail, pictures and colours that name polygons and rings by id. Elements are told by their local names, which all
versions share. Files are read with the standard library's parser, which fetches nothing; document types are
refused.
Source: OGC City Geography Markup Language 2.0 (12-019), sections 9.3, 9.4 and 10.3.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np
import pyproj
from numpy.typing import NDArray
from pyproj.exceptions import ProjError

from mmi.foundation.errors import CityError
from mmi.reading.coordinates import named_crs
from mmi.reading.models.faces import Color, Faces
from mmi.reading.pictures import PictureShelf, file_beside
from mmi.reading.raw_layers import ModelLayer, RawModel
from mmi.reading.report import Ledger

__all__ = ["is_citygml", "read_citygml"]

_HEAD = 8192
_GROUND = ("ReliefFeature", "Road", "Square", "Railway", "LandUse", "WaterBody", "PlantCover", "TrafficArea")
_LEVEL = re.compile(r"lod([0-4])")
_DEEPEST = 200
_FARTHEST = 1e9
"""Coordinates beyond this are no place on earth in any units."""


def is_citygml(path: Path) -> bool:
    """Whether the file is XML with a city model, by its first element."""
    with path.open("rb") as file:
        head = file.read(_HEAD)
    return head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<") and b"CityModel" in head


def read_citygml(path: Path, ledger: Ledger, *, lod: str | None = None, crs: pyproj.CRS | None = None) -> ModelLayer:
    """All buildings of ``path``, each at its highest level of detail, or at ``lod`` (``"1"`` to ``"4"``).

    ``crs`` counts where the file's is none that can be understood.

    Raises:
        CityError: damaged XML or coordinates; names the object at fault.
    """
    root = _root(path)
    if _depth(root) > _DEEPEST:
        raise CityError(f"{path}: CityGML expected, found elements nested more than {_DEEPEST} deep")
    surfaces = _Surfaces(path, ledger, _appearances(path, root, ledger))
    targets = _targets(root)
    ids: dict[str, int] = {}
    for member in _members(root):
        kind, name = _local(member), _id(member) or f"{_local(member)}/{len(ids)}"
        if kind == "Building":
            ledger.note("read", "buildings")
            polygons = _at_level(member, lod, name, targets, ledger)
            if not polygons:
                ledger.note("left out", "building: no surfaces above level of detail 0", name)
            elif name in ids:
                raise CityError(f"{path}: object {name}: an id of its own expected, found it twice")
            else:
                ids[name] = len(ids)
                surfaces.add_building(ids[name], name, polygons)
        elif kind in _GROUND:
            surfaces.add_ground(name, member, relief=kind == "ReliefFeature")
        else:
            ledger.note("left out", f"{kind}: no building", name)
    return surfaces.layer(ids, _crs(path, root, crs))


def _root(path: Path) -> ElementTree.Element:
    """The document's first element. Prefixes need not be bound, for nothing looks at them; a document type is refused."""
    builder = ElementTree.TreeBuilder()

    def refuse(*_: object) -> None:
        raise CityError(f"{path}: CityGML without a document type expected, found one")

    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartDoctypeDeclHandler = refuse
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    try:
        with path.open("rb") as file:
            parser.ParseFile(file)
    except (expat.ExpatError, LookupError, ValueError) as error:  # the latter two: of encodings
        raise CityError(f"{path}: CityGML expected, found damaged XML ({error})") from error
    root: ElementTree.Element = builder.close()
    if _local(root) != "CityModel":
        raise CityError(f"{path}: CityGML with a CityModel expected, found {_local(root)}")
    return root


def _depth(root: ElementTree.Element) -> int:
    """How deep elements are nested; stops soon after the deepest that is allowed."""
    depth, level = 0, [root]
    while level and depth <= _DEEPEST:
        depth, level = depth + 1, [child for element in level for child in element]
    return depth


def _local(element: ElementTree.Element) -> str:
    return element.tag.rpartition(":")[2]


def _id(element: ElementTree.Element) -> str:
    return next((value for key, value in element.attrib.items() if key.rpartition(":")[2] == "id"), "")


def _members(root: ElementTree.Element) -> Iterator[ElementTree.Element]:
    for holder in root:
        if _local(holder) in ("cityObjectMember", "featureMember"):
            yield from holder


_Sided = tuple[ElementTree.Element, bool]
"""A polygon, and whether it is used from behind."""


@dataclass(slots=True)
class _Part:
    """A building, or a part of it: by level of detail the polygons that stand in it and those that it links to."""

    own: dict[int, list[_Sided]] = field(default_factory=dict)
    linked: dict[int, list[_Sided]] = field(default_factory=dict)

    def at(self, level: int, elsewhere: set[int]) -> list[_Sided]:
        """Its polygons, each once. A link to a polygon ``elsewhere`` (by identity) in the building counts from behind only."""
        own = self.own.get(level, [])
        inside = {id(one) for one, _ in own}
        links = {(id(one), turned): (one, turned) for one, turned in self.linked.get(level, ())}
        return own + [
            (one, turned)
            for one, turned in links.values()
            if id(one) not in inside and (turned or id(one) not in elsewhere)
        ]


def _at_level(
    building: ElementTree.Element, lod: str | None, name: str, targets: dict[str, ElementTree.Element], ledger: Ledger
) -> list[_Sided]:
    """The polygons of a building and its parts at the level of detail wanted, or the highest. ``targets``: of links."""
    whole = _Part()
    parts: list[_Part] = []
    links: list[tuple[str, int, _Part, bool]] = []
    known: set[tuple[str, int, int, bool]] = set()

    def walk(element: ElementTree.Element, level: int, part: _Part, turned: bool, linked: bool) -> None:
        local = _local(element)
        if local in ("BuildingPart", "BuildingInstallation"):
            part = _Part()
            parts.append(part)
        stated = _LEVEL.match(local)
        level = int(stated.group(1)) if stated else level
        if local in ("Polygon", "Triangle", "Rectangle"):
            if level > 0:
                (part.linked if linked else part.own).setdefault(level, []).append((element, turned))
            return
        if local in ("Room", "IntBuildingInstallation") or "TerrainIntersection" in local or "RoofEdge" in local:
            return
        if "ImplicitRepresentation" in local:
            ledger.note("left out", "building: a shape in coordinates of its own", name)
            return
        turned ^= local == "OrientableSurface" and element.attrib.get("orientation") == "-"
        link = next((value for key, value in element.attrib.items() if key.rpartition(":")[2] == "href"), "")
        target = link.lstrip("#")
        if level > 0 and target in targets and (target, level, id(part), turned) not in known:
            known.add((target, level, id(part), turned))
            links.append((target, level, part, turned))
        for child in element:
            walk(child, level, part, turned, linked)

    walk(building, 0, whole, False, False)
    while links:  # which may lead to more, or in a circle: each is followed once
        target, level, part, turned = links.pop()
        walk(targets[target], level, part, turned, True)
    found = {level for part in (whole, *parts) for level in (*part.own, *part.linked)}
    if not found:
        return []
    wanted = max(found)
    if lod is not None:
        asked = int(float(lod))
        wanted = max((one for one in found if one <= asked), default=min(found))
        if wanted != asked:
            ledger.note("noted", f"building: no level of detail {lod}, taken at another", name)
    inside = {id(one) for part in (whole, *parts) for polygons in part.own.values() for one, _ in polygons}
    polygons = whole.at(wanted, inside)
    is_whole = bool(polygons)
    for part in parts:
        # A part at lower levels only is not shown by anything else, unlike the whole.
        below = [one for one in (*part.own, *part.linked) if one <= wanted]
        polygons += part.at(wanted if is_whole else max(below, default=wanted), inside)
    return polygons


def _targets(root: ElementTree.Element) -> dict[str, ElementTree.Element]:
    """The surfaces that links name, by id."""
    links = {
        value.lstrip("#")
        for element in root.iter()
        for key, value in element.attrib.items()
        if key.rpartition(":")[2] == "href"
    }
    surfaces = ("Polygon", "Triangle", "Rectangle", "OrientableSurface", "CompositeSurface", "MultiSurface", "Surface")
    return {_id(one): one for one in root.iter() if _local(one) in surfaces and _id(one) in links}


_Look = tuple[int | None, dict[str, list[float]], Color | None]
"""A polygon's picture, texture coordinates by ring id, and colour."""


def _appearances(path: Path, root: ElementTree.Element, ledger: Ledger) -> tuple[dict[str, _Look], PictureShelf]:
    """What pictures and materials say, by polygon id. The first picture counts, and a picture more than a colour."""
    shelf = PictureShelf(ledger)
    looks: dict[str, _Look] = {}
    places: dict[str, int | None] = {}
    for element in root.iter():
        kind = _local(element)
        if kind == "ParameterizedTexture":
            image = next((one.text or "" for one in element if _local(one) == "imageURI"), "").strip()
            if image not in places:
                file = file_beside(path.parent, image, ledger)
                places[image] = None if file is None else shelf.place(file.read_bytes(), image, alpha=True)
                if file is None:
                    ledger.note("left out", "picture: it is not there", image)
            for target in (one for one in element if _local(one) == "target"):
                uri = next((value for key, value in target.attrib.items() if key.endswith("uri")), "").lstrip("#")
                coordinates = {
                    one.attrib.get("ring", "").lstrip("#"): _numbers(one.text or "", path, uri)
                    for one in target.iter()
                    if _local(one) == "textureCoordinates"
                }
                if places[image] is not None and coordinates and looks.get(uri, (None,))[0] is None:
                    looks[uri] = (places[image], coordinates, None)
        elif kind == "X3DMaterial":
            text = next((one.text or "" for one in element if _local(one) == "diffuseColor"), "")
            parts = _numbers(text or "0.8 0.8 0.8", path, kind)[:3]
            if len(parts) < 3 or not np.isfinite(parts).all():
                raise CityError(f"{path}: X3DMaterial: a diffuseColor of three numbers expected, found {text[:40]!r}")
            red, green, blue = (round(255 * min(max(one, 0.0), 1.0)) for one in parts)
            for target in (one for one in element if _local(one) == "target"):
                looks.setdefault((target.text or "").strip().lstrip("#"), (None, {}, (red, green, blue)))
    return looks, shelf


def _numbers(text: str, path: Path, where: str) -> list[float]:
    try:
        return [float(one) for one in text.split()]
    except ValueError as error:
        raise CityError(f"{path}: {where}: numbers expected, found {text[:40]!r}") from error


def _crs(path: Path, root: ElementTree.Element, fallback: pyproj.CRS | None) -> pyproj.CRS | None:
    """The horizontal CRS of the first envelope or geometry that names one."""
    for element in root.iter():
        name = element.attrib.get("srsName")
        if name:
            return named_crs(f"{path}: srsName", name, fallback)
    return None


class _Surfaces:
    """Faces of buildings and ground while the document is walked."""

    def __init__(self, path: Path, ledger: Ledger, looks: tuple[dict[str, _Look], PictureShelf]) -> None:
        self._path, self._ledger = path, ledger
        self._looks, self._shelf = looks
        self._faces, self._relief, self._cover = Faces(), Faces(), Faces()
        self._points: list[tuple[float, ...]] = []
        self._places: dict[tuple[float, ...], int] = {}
        self._uv: list[list[float]] = []

    def add_building(self, owner: int, name: str, polygons: list[_Sided]) -> None:
        """Polygons, each with the looks that its id has."""
        for polygon, turned in polygons:
            rings, ids = self._rings(polygon, name)
            texture, coordinates, color = self._looks.get(_id(polygon), (None, {}, None))
            uv = []
            if texture is not None:
                for ring, id_ in zip(rings, ids, strict=True):
                    pairs = np.array(coordinates.get(id_, [])).reshape(-1)
                    own = pairs[: len(pairs) // 2 * 2].reshape(-1, 2)
                    if len(own) != len(ring):
                        own = np.empty((0, 2))
                    uv.append(list(range(len(self._uv), len(self._uv) + len(own))))
                    self._uv += own.tolist()
            if turned:
                rings, uv = [ring[::-1] for ring in rings], [own[::-1] for own in uv]
            self._faces.add(owner, rings, texture=texture, uv=uv, color=color)

    def add_ground(self, name: str, member: ElementTree.Element, *, relief: bool) -> None:
        """All polygons of a feature that lies on the ground; what covers the ground tells nothing where it has a relief."""
        faces = self._relief if relief else self._cover
        for polygon in (one for one in member.iter() if _local(one) in ("Polygon", "Triangle")):
            faces.add(0, self._rings(polygon, name)[0])

    def layer(self, ids: dict[str, int], crs: pyproj.CRS | None) -> ModelLayer:
        """The model; axes are exchanged where the CRS says latitude, or northing, first."""
        points = np.array(self._points, dtype=np.float64).reshape(-1, 3)
        if (
            crs is not None
            and crs.axis_info
            and crs.axis_info[0].direction.lower() == "north"
            and not _east_first(points, crs)
        ):
            points = points[:, [1, 0, 2]]
        uv = np.array(self._uv, dtype=np.float64).reshape(-1, 2)
        meshes = self._faces.meshes(points, uv)
        items = tuple(RawModel(name, meshes[owner]) for name, owner in ids.items() if owner in meshes)
        for name in (name for name, owner in ids.items() if owner not in meshes):
            self._ledger.note("left out", "building: no surface with an area", name)
        ground = self._relief if len(self._relief) else self._cover
        terrain = ground.meshes(points, np.empty((0, 2))).get(0)
        return ModelLayer(str(self._path), items, crs, self._shelf.textures(), terrain)

    def _rings(self, polygon: ElementTree.Element, name: str) -> tuple[list[list[int]], list[str]]:
        """Places of the points of a polygon's rings, outer first, and the rings' ids."""
        rings, ids = [], []
        for ring in (one for one in polygon.iter() if _local(one) == "LinearRing"):
            texts = [one.text or "" for one in ring.iter() if _local(one) in ("posList", "pos", "coordinates")]
            numbers = _numbers(" ".join(texts).replace(",", " "), self._path, f"object {name}")
            if len(numbers) % 3 or not (np.abs(numbers) < _FARTHEST).all():
                raise CityError(
                    f"{self._path}: object {name}: points of three finite numbers expected, found {len(numbers)}"
                )
            rings.append([self._place(tuple(numbers[i : i + 3])) for i in range(0, len(numbers), 3)])
            ids.append(_id(ring))
        return rings, ids

    def _place(self, point: tuple[float, ...]) -> int:
        """Equal points are one."""
        place = self._places.setdefault(point, len(self._points))
        if place == len(self._points):
            self._points.append(point)
        return place


def _east_first(points: NDArray[np.float64], crs: pyproj.CRS) -> bool:
    """Whether coordinates stand east first although the CRS says north first, as many writers have it."""
    area = crs.area_of_use
    if area is None or not len(points):
        return False
    x, y = np.median(points[:, :2], axis=0)
    try:
        to_degrees = pyproj.Transformer.from_crs(crs, pyproj.CRS.from_epsg(4326), always_xy=True)
        places = [to_degrees.transform(x, y), to_degrees.transform(y, x)]
    except ProjError:
        return False
    inside = [area.west <= lon <= area.east and area.south <= lat <= area.north for lon, lat in places]
    return inside[0] and not inside[1]
