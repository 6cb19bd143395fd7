"""CityGML 1.0 and 2.0: buildings as meshes with pictures and colours, and the ground of relief, roads and land.

There is no well-kept Python library that carries CityGML with its appearances: GDAL drops them, and what else there is
converts in Java. The format is wide, what a city of buildings needs of it is narrow: polygons inside buildings at a level
of detail, pictures and colours that name polygons and rings by id. Elements are told by their local names, which all
versions share. A building with damaged coordinates, or a surface whose link leads nowhere, is left out and counted.
Source: OGC City Geography Markup Language 2.0 (12-019), sections 9.3 and 10.3.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pyproj

from mmi import limits
from mmi.foundation.errors import CityError
from mmi.reading.city_models.axis_order import axes_are_exchanged
from mmi.reading.city_models.citygml_looks import Look, read_looks
from mmi.reading.city_models.extruded import height_from_attributes, prism_of_rings
from mmi.reading.city_models.faces import Faces
from mmi.reading.coordinates import named_crs
from mmi.reading.names import UniqueNames
from mmi.reading.pictures import PictureShelf
from mmi.reading.raw_layers import ModelLayer, RawModel
from mmi.reading.report import Ledger
from mmi.reading.xml_elements import gml_id, link_of, local_name, xml_root

__all__ = ["is_citygml", "read_citygml"]

_HEAD = 8192
_GROUND = ("ReliefFeature", "Road", "Square", "Railway", "LandUse", "WaterBody", "PlantCover", "TrafficArea")
_LEVEL = re.compile(r"lod([0-4])")
_NO_SURFACES = "no surfaces above level of detail 0"


def is_citygml(path: Path) -> bool:
    """Whether the file is XML with a city model, by its first element."""
    with path.open("rb") as file:
        head = file.read(_HEAD)
    return head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<") and b"CityModel" in head


def read_citygml(path: Path, ledger: Ledger, *, lod: str | None = None, crs: pyproj.CRS | None = None) -> ModelLayer:
    """All buildings of ``path``, each at its highest level of detail, or at ``lod`` (``"1"`` to ``"4"``).

    ``crs`` counts where the file's is none that can be understood.

    Raises:
        CityError: damaged XML, or no building with sound coordinates; names the object at fault.
    """
    root = _root(path)
    if _depth(root) > limits.XML_DEPTH:
        raise CityError(f"{path}: CityGML expected, found elements nested more than {limits.XML_DEPTH} deep")
    surfaces = _Surfaces(path, ledger, read_looks(path, root, ledger))
    targets = _targets(root)
    names = UniqueNames()
    buildings = 0
    for member in _members(root):
        kind, own = local_name(member), gml_id(member) or f"{local_name(member)}/{buildings}"
        if kind == "Building":
            ledger.note("read", "buildings")
            name = names.free(own)
            polygons, why_none = _at_level(member, lod, name, targets, ledger)
            footprints = [] if polygons else _footprints(member)
            if surfaces.add_building(name, polygons, footprints, why_none):
                buildings += 1
                names.take(name)
                ledger.note("repaired", "repeated id made unique", name, count=int(name != own))
        elif kind in _GROUND:
            surfaces.add_ground(own, member, relief=kind == "ReliefFeature")
        else:
            ledger.note("left out", f"{kind}: no building", own)
    return surfaces.layer(_crs(path, root, crs))


def _root(path: Path) -> ElementTree.Element:
    """The document's first element, a city model."""
    try:
        with path.open("rb") as file:
            root = xml_root(file)
    except ValueError as error:
        raise CityError(f"{path}: CityGML expected, found damaged XML ({error})") from error
    if local_name(root) != "CityModel":
        raise CityError(f"{path}: CityGML with a CityModel expected, found {local_name(root)}")
    return root


def _depth(root: ElementTree.Element) -> int:
    """How deep elements are nested; stops soon after the deepest that is allowed."""
    depth, level = 0, [root]
    while level and depth <= limits.XML_DEPTH:
        depth, level = depth + 1, [child for element in level for child in element]
    return depth


def _members(root: ElementTree.Element) -> Iterator[ElementTree.Element]:
    for holder in root:
        if local_name(holder) in ("cityObjectMember", "featureMember"):
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


_Targets = tuple[dict[str, ElementTree.Element], frozenset[str]]
"""The surfaces that links name, by id, and the names of which there is nothing in the file."""


def _at_level(
    building: ElementTree.Element, lod: str | None, name: str, targets: _Targets, ledger: Ledger
) -> tuple[list[_Sided], str]:
    """The polygons of a building and its parts at the level of detail wanted, or the highest; else why there are none."""
    surfaces, nowhere = targets
    lost: set[tuple[str, int, int]] = set()
    whole = _Part()
    parts: list[_Part] = []
    links: list[tuple[str, int, _Part, bool]] = []
    known: set[tuple[str, int, int, bool]] = set()

    def walk(element: ElementTree.Element, level: int, part: _Part, turned: bool, linked: bool) -> None:
        local = local_name(element)
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
        target = link_of(element)
        if level > 0 and target in surfaces and (target, level, id(part), turned) not in known:
            known.add((target, level, id(part), turned))
            links.append((target, level, part, turned))
        if level > 0 and target in nowhere:
            lost.add((target, level, id(part)))
        for child in element:
            walk(child, level, part, turned, linked)

    walk(building, 0, whole, False, False)
    while links:  # which may lead to more, or in a circle: each is followed once
        target, level, part, turned = links.pop()
        walk(surfaces[target], level, part, turned, True)
    ledger.note("left out", "surface: its link leads nowhere", name, count=len(lost))
    found = {level for part in (whole, *parts) for level in (*part.own, *part.linked)}
    if not found:
        return [], "its surfaces are links that lead nowhere" if lost else _NO_SURFACES
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
    return polygons, _NO_SURFACES


_Footprint = tuple[ElementTree.Element, tuple[float, str], bool]
"""A polygon at level of detail 0, its height and where that comes from, and whether it is the edge of a roof."""


def _footprints(building: ElementTree.Element) -> list[_Footprint]:
    """The polygons at level of detail 0 of a building and its parts; none where one of them has no height."""
    whole = height_from_attributes(_attributes(building))
    found: list[_Footprint] = []
    for holder in [building, *(one for one in building.iter() if local_name(one) == "BuildingPart")]:
        flat = {local_name(child): child for child in holder if local_name(child) in ("lod0FootPrint", "lod0RoofEdge")}
        kind = next((name for name in ("lod0FootPrint", "lod0RoofEdge") if name in flat), None)
        height = height_from_attributes(_attributes(holder)) or whole
        if kind is not None and height is None:
            return []
        if kind is not None and height is not None:
            polygons = (one for one in flat[kind].iter() if local_name(one) in ("Polygon", "Triangle"))
            found += [(polygon, height, kind == "lod0RoofEdge") for polygon in polygons]
    return found


def _attributes(holder: ElementTree.Element) -> dict[str, object]:
    """What stands directly in a building, by name, with its unit."""
    return {
        local_name(child): {"value": (child.text or "").strip(), "uom": child.attrib.get("uom", "")}
        for child in holder
        if not len(child)
    }


def _targets(root: ElementTree.Element) -> _Targets:
    """What the links of a document name."""
    links = {link_of(element) for element in root.iter()} - {""}
    kinds = ("Polygon", "Triangle", "Rectangle", "OrientableSurface", "CompositeSurface", "MultiSurface", "Surface")
    named = [one for one in root.iter() if gml_id(one) in links] if links else []
    surfaces = {gml_id(one): one for one in named if local_name(one) in kinds}
    return surfaces, frozenset(links - {gml_id(one) for one in named})


def _crs(path: Path, root: ElementTree.Element, fallback: pyproj.CRS | None) -> pyproj.CRS | None:
    """The horizontal CRS of the first envelope or geometry that names one."""
    for element in root.iter():
        name = element.attrib.get("srsName")
        if name:
            return named_crs(f"{path}: srsName", name, fallback)
    return None


class _Surfaces:
    """Faces of buildings and ground while the document is walked."""

    def __init__(self, path: Path, ledger: Ledger, looks: tuple[dict[str, Look], PictureShelf]) -> None:
        self._path, self._ledger = path, ledger
        self._looks, self._shelf = looks
        self._faces, self._relief, self._cover = Faces(str(path)), Faces(str(path)), Faces(str(path))
        self._names: list[str] = []
        self._prisms: set[int] = set()
        self._points: list[tuple[float, ...]] = []
        self._places: dict[tuple[float, ...], int] = {}
        self._uv: list[list[float]] = []
        self._damage: str | None = None

    def add_building(self, name: str, polygons: list[_Sided], footprints: list[_Footprint], why_none: str) -> bool:
        """Polygons, each with the looks that its id has, and prisms on footprints.

        False, and a note, where there is neither or one is damaged.
        """
        mark = self._faces.mark()
        reason = None if polygons or footprints else why_none
        try:
            for polygon, turned in polygons:
                self._add_face(polygon, turned)
            for footprint in footprints:
                self._add_prism(*footprint)
        except ValueError as error:
            reason = "coordinates that are no places"
            self._damage = self._damage or f"{self._path}: object {name}: {error}"
            self._faces.cut_back(mark)
        else:
            self._prisms |= {len(self._names)} if footprints else set()
            for _, (_, source), _ in footprints:
                self._ledger.note("inferred", f"height of a footprint from {source}", name)
        if reason is not None:
            self._ledger.note("left out", f"building: {reason}", name)
            return False
        self._names.append(name)
        return True

    def _add_face(self, polygon: ElementTree.Element, turned: bool) -> None:
        rings, ids = self._rings(polygon)
        texture, coordinates, color = self._looks.get(gml_id(polygon), (None, {}, None))
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
        self._faces.add(len(self._names), rings, texture=texture, uv=uv, color=color)

    def _add_prism(self, footprint: ElementTree.Element, height: tuple[float, str], roof: bool) -> None:
        rings, _ = self._rings(footprint)
        outlines = [np.array([self._points[k] for k in ring]).reshape(-1, 3) for ring in rings]
        points, faces = prism_of_rings(outlines, height[0], roof=roof) if outlines else ((), [])
        places = [self._place(tuple(point.tolist())) for point in points]
        self._faces.add_bare(len(self._names), [[[places[k] for k in ring] for ring in face] for face in faces])

    def add_ground(self, name: str, member: ElementTree.Element, *, relief: bool) -> None:
        """All polygons of a feature that lies on the ground; what covers the ground tells nothing where it has a relief."""
        faces = self._relief if relief else self._cover
        for polygon in (one for one in member.iter() if local_name(one) in ("Polygon", "Triangle")):
            try:
                faces.add(0, self._rings(polygon)[0])
            except ValueError:
                self._ledger.note("left out", "ground: coordinates that are no places", name)

    def layer(self, crs: pyproj.CRS | None) -> ModelLayer:
        """The model; axes are exchanged where the CRS says latitude, or northing, first.

        Raises:
            CityError: no building is left, and one was damaged.
        """
        if not self._names and self._damage is not None:
            raise CityError(self._damage)
        points = np.array(self._points, dtype=np.float64).reshape(-1, 3)
        uv = np.array(self._uv, dtype=np.float64).reshape(-1, 2)
        meshes = self._faces.meshes(points, uv)
        if crs is not None:
            solids = (mesh for owner, mesh in meshes.items() if owner not in self._prisms)
            if axes_are_exchanged(points, crs, solids, self._ledger):
                points = points[:, [1, 0, 2]]
                meshes = self._faces.meshes(points, uv)
        items = tuple(RawModel(name, meshes[owner]) for owner, name in enumerate(self._names) if owner in meshes)
        for name in (name for owner, name in enumerate(self._names) if owner not in meshes):
            self._ledger.note("left out", "building: no surface with an area", name)
        ground = self._relief if len(self._relief) else self._cover
        terrain = ground.meshes(points, np.empty((0, 2))).get(0)
        return ModelLayer(str(self._path), items, crs, self._shelf.textures(), terrain)

    def _rings(self, polygon: ElementTree.Element) -> tuple[list[list[int]], list[str]]:
        """Places of the points of a polygon's rings, outer first, and the rings' ids.

        Raises:
            ValueError: they are no places.
        """
        rings, ids = [], []
        for ring in (one for one in polygon.iter() if local_name(one) == "LinearRing"):
            texts = [one.text or "" for one in ring.iter() if local_name(one) in ("posList", "pos", "coordinates")]
            text = " ".join(texts).replace(",", " ")
            try:
                numbers = [float(word) for word in text.split()]
            except ValueError as error:
                raise ValueError(f"numbers expected, found {text[:40]!r}") from error
            if len(numbers) % 3 or not (np.abs(numbers) < limits.COORDINATE).all():
                raise ValueError(f"points of three finite numbers expected, found {len(numbers)}")
            rings.append([self._place(tuple(numbers[i : i + 3])) for i in range(0, len(numbers), 3)])
            ids.append(gml_id(ring))
        return rings, ids

    def _place(self, point: tuple[float, ...]) -> int:
        """Equal points are one."""
        place = self._places.setdefault(point, len(self._points))
        if place == len(self._points):
            self._points.append(point)
        return place
