"""OpenStreetMap's XML where osmium, which reads it, needs help: deletions by an editor, and places in relation members.

Overpass writes for ``out geom`` the places of nodes into the ``<nd>`` of ways, which osmium reads, and into those of relation
members, which it refuses; after ``out tags geom`` these have no ids. Such a file is written anew in memory: ways that only a
member shows stand among the others, and equal places without an id are one node.
Source: https://wiki.openstreetmap.org/wiki/Overpass_API/Overpass_QL, section "out".
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import osmium

from mmi import limits
from mmi.reading.maps.osm_pbf import refuse_zero_bytes
from mmi.reading.unpacked import unpacked
from mmi.reading.xml_elements import xml_root

__all__ = ["DAMAGED", "OsmText", "look_through", "without_damage"]

# Elements of OpenStreetMap's XML with their attributes, and what an editor writes there.
_ELEMENT = re.compile(rb"""<(way|relation)((?:\s+[\w:]+\s*=\s*(?:"[^"]*"|'[^']*'))+)\s*/?>""")
_ID = re.compile(rb"""\sid=["'](-?\d+)["']""")
_DELETE = re.compile(rb"""\saction=["']delete["']""")
_PLACES_IN_MEMBER = re.compile(rb"<member\b[^>]*[^>/]>\s*<nd\b")
_CORNER = re.compile(rb"<nd\b[^>]*>")
DAMAGED = "element: an id or a place that is no number, or a place outside the world"
"""Why elements are left out without which the file can be read."""
_OFF_THE_EARTH = "99"
_BLOCK = 1 << 20
_OVERLAP = 512
_FIRST_ID = 1 << 50
"""Ids from here on are free: OpenStreetMap has not used a millionth of them."""


@dataclass(frozen=True, slots=True, eq=False)
class OsmText:
    """What osmium shall read: the file's name, or the file in memory; and what was ``deleted``: ``way/1``, ``relation/2``."""

    source: Any
    deleted: frozenset[str]


def look_through(path: Path) -> OsmText:
    """How to read ``path``; PBF has neither deletions nor places in members.

    Raises:
        CityError: it is too large, or more comes out of it than may.
        OSError, ValueError, EOFError, zlib.error: the file is cut off, or damaged where it has to be written anew, or has texts
            that osmium must not read.
    """
    suffix = path.suffix.lower()
    if suffix == ".pbf":
        refuse_zero_bytes(path)
        return OsmText(str(path), frozenset())
    with unpacked(path) as file:
        any_deleted, to_write = False, False
        corner: re.Match[bytes] | None = None
        tail = b""
        while block := file.read(_BLOCK):
            text = tail + block
            any_deleted = any_deleted or _DELETE.search(text) is not None
            to_write = to_write or _PLACES_IN_MEMBER.search(text) is not None
            corner = corner or _CORNER.search(text)
            tail = text[-_OVERLAP:]
        without_id = corner is not None and b" ref=" not in corner[0]
        if not (any_deleted or to_write or without_id):
            return OsmText(str(path), frozenset())
        text = file.read_all(limits.REWRITTEN_BYTES)
    deleted = frozenset(_deleted(text)) if any_deleted else frozenset()
    if not (to_write or without_id):
        return OsmText(str(path), deleted)
    return OsmText(osmium.io.FileBuffer(_written_anew(text), "osm"), deleted)


def without_damage(path: Path) -> tuple[OsmText, list[str]]:
    """How to read ``path`` without the elements whose ids or places are no numbers, and which these are; none in PBF.

    Raises:
        OSError, ValueError, EOFError, zlib.error: the file is cut off, or no XML.
    """
    suffix = path.suffix.lower()
    if suffix == ".pbf":
        return OsmText(str(path), frozenset()), []
    with unpacked(path) as file:
        text = _written_anew(file.read_all(limits.REWRITTEN_BYTES))
    root = xml_root(io.BytesIO(text))
    lost: list[str] = []
    for one in list(root):
        inside = [part for part in one if part.tag in ("nd", "member")]
        if one.tag in ("node", "way", "relation") and not _are_numbers(one, "id", "lat", "lon"):
            root.remove(one)
            lost.append(f"{one.tag}/{one.get('id', 'without id')[:20]}")
        elif one.tag == "node" and not _is_on_earth(one):
            one.attrib |= {"lat": _OFF_THE_EARTH, "lon": "0"}  # osmium can read that, and tells it from a missing node
            lost.append(f"{one.tag}/{one.get('id', 'without id')[:20]}")
        for part in inside:
            if not _are_numbers(part, "ref", "lat", "lon"):
                one.remove(part)
                lost.append(f"{part.tag} of {one.tag}/{one.get('id', 'without id')[:20]}")
    found = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return OsmText(osmium.io.FileBuffer(found, "osm"), frozenset(_deleted(text))), lost


def _are_numbers(element: ElementTree.Element, *names: str) -> bool:
    """Whether those of the attributes that are there are numbers; ids are whole and within 60 bits."""
    for name in names:
        value = element.get(name)
        if value is None:
            continue
        if name in ("id", "ref") and not re.fullmatch(r"-?\d{1,18}", value):
            return False
        try:
            sound = math.isfinite(float(value))
        except ValueError:
            sound = False
        if not sound:
            return False
    return True


def _is_on_earth(node: ElementTree.Element) -> bool:
    """Whether the place of a node, if it has one, is a latitude and a longitude."""
    return abs(float(node.get("lat", 0.0))) <= 90.0 and abs(float(node.get("lon", 0.0))) <= 180.0


def _deleted(text: bytes) -> Iterator[str]:
    for kind, attributes in _ELEMENT.findall(text):
        id_ = _ID.search(attributes)
        if id_ is not None and _DELETE.search(attributes):
            yield f"{kind.decode()}/{int(id_.group(1))}"


def _written_anew(text: bytes) -> bytes:
    """The document with ids for all corners, and a way for each member that brings the places of one that is not there."""
    root = xml_root(io.BytesIO(text))
    ids: dict[tuple[str | None, str | None], str] = {}
    for corner in root.iter("nd"):  # those that have an id lend it to those of the same place that have none
        if "ref" in corner.attrib and "lat" in corner.attrib:
            ids.setdefault((corner.get("lat"), corner.get("lon")), corner.attrib["ref"])
    known = {way.get("id") for way in root.iter("way")}
    shown: list[ElementTree.Element] = []
    for member in [one for one in root.iter("member") if len(one)]:
        if member.get("type") == "way" and member.get("ref") not in known:
            known.add(member.get("ref"))
            way = ElementTree.Element("way", {"id": member.get("ref", "0")})
            way.extend(member.findall("nd"))
            shown.append(way)
        for child in list(member):
            member.remove(child)
    first_relation = next((i for i, one in enumerate(root) if one.tag == "relation"), len(root))
    root[first_relation:first_relation] = shown
    missing = _FIRST_ID
    for corner in root.iter("nd"):
        if "ref" not in corner.attrib:
            if "lat" not in corner.attrib:  # outside the box that was asked for
                missing += 1
                corner.set("ref", str(2 * missing))
            else:
                place = (corner.get("lat"), corner.get("lon"))
                corner.set("ref", ids.setdefault(place, str(2 * (_FIRST_ID + len(ids)) + 1)))
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
