"""OpenStreetMap ``.osm`` and ``.osm.pbf``: outlines of buildings, and highways with their node ids.

Two passes over the file: relations first (which ways do they need?), then ways with the places of their nodes. Rings of
multipolygons are joined by ``osm_shapes``. Files that an editor saved (JOSM) may hold new objects, whose ids are negative, and
deleted ones; ways may bring the places of their nodes (Overpass).
Tags: https://wiki.openstreetmap.org/wiki/Simple_3D_Buildings.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import osmium
import pyproj

from mmi.foundation.errors import CityError
from mmi.reading.maps.crossings import Tangles
from mmi.reading.maps.osm_shapes import Relation, Way, outline_of_relation, polygon_of_way, street_of_way
from mmi.reading.maps.osm_text import DAMAGED, OsmText, look_through, without_damage
from mmi.reading.raw_layers import BuildingLayer, RawBuilding, RawStreet, StreetLayer
from mmi.reading.report import Ledger

__all__ = ["is_osm", "read_osm"]

_BUILDING_TAGS = (
    "building", "building:part", "height", "building:height", "est_height", "building:levels", "min_height",
    "building:min_height", "building:min_level", "layer", "location",
)  # fmt: skip
_STREET_TAGS = (
    "highway", "name", "width", "lanes", "tunnel", "bridge", "layer", "covered", "indoor", "access", "foot", "motor_vehicle",
    "footway", "area",
)  # fmt: skip


_NOWHERE = osmium.osm.Location().x
"""What osmium has as the longitude of a node that is not in the file."""

# osmium has no class for all of its errors; what decompresses has others.
_DAMAGE = (osmium.InvalidLocationError, RuntimeError, ValueError, EOFError, zlib.error)


@dataclass(frozen=True, slots=True)
class _Group:
    """A relation of type building: its tags, ids of the ways and areas that outline it, and whether it is tagged building."""

    id: str
    tags: dict[str, str]
    ways: tuple[int, ...]
    areas: tuple[int, ...]
    says_building: bool


def is_osm(path: Path) -> bool:
    """True if the first bytes of ``path`` are OpenStreetMap XML or PBF, or its name says so."""
    if path.name.lower().endswith((".osm", ".pbf", ".osm.gz", ".osm.bz2")):
        return True
    with path.open("rb") as file:
        head = file.read(1024)
    return b"OSMHeader" in head[:64] or (head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<") and b"<osm" in head)


def read_osm(path: Path, ledger: Ledger, *, buildings: bool, streets: bool) -> tuple[BuildingLayer, StreetLayer]:
    """Buildings and streets of ``path`` in degrees (EPSG:4326); the kind not asked for comes back empty.

    Raises:
        CityError: the file cannot be read to its end.
    """
    try:
        text, trial = look_through(path), Ledger()
        try:
            found = _read_all(text, trial, buildings=buildings, streets=streets)
        except _DAMAGE as error:  # where a number is none, osmium reads nothing beyond
            repaired, lost = text, list[str]()
            with suppress(*_DAMAGE):
                repaired, lost = without_damage(path)
            if not lost:
                raise error
            trial = Ledger()
            found = _read_all(repaired, trial, buildings=buildings, streets=streets)
            known = ledger.count("left out", DAMAGED)
            trial.note("left out", DAMAGED, ", ".join(lost[:3]), count=0 if known else len(lost))
        ledger.absorb(trial)
        relations, groups, areas, ways, raw_buildings, raw_streets = found
    except _DAMAGE as error:
        raise CityError(f"{path}: expected OpenStreetMap XML or PBF, complete to its end; found: {error}") from error
    assembled: list[RawBuilding] = []
    outlines: set[int] = set()
    tagged = {f"way/{number}": f"way/{number}" for number, _, _ in raw_buildings} | {
        one.id: one.id for one in relations
    }
    tagged |= {f"way/{number}": one.id for one in relations if "building" in one.tags for number in one.outer}
    more_relations, more_tags = _from_groups(groups, areas, tagged, ledger)
    tangles = Tangles()
    for relation in (*relations, *more_relations):
        geometry = outline_of_relation(relation, ways, tangles, ledger)
        if geometry is not None:
            assembled.append(RawBuilding(relation.id, geometry, more_tags.get(relation.id, {}) | relation.tags))
            if "building" in relation.tags:
                outlines.update(relation.outer)
    for number, way, tags in raw_buildings:
        id_ = f"way/{number}"
        if number in outlines and "building:part" not in tags:
            ledger.note("left out", "building: outline of a relation that was read", id_)
        elif (polygon := polygon_of_way(id_, way, ledger)) is not None:
            assembled.append(RawBuilding(id_, polygon, more_tags.get(id_, {}) | tags))
    crs = pyproj.CRS.from_epsg(4326)
    return (
        BuildingLayer(str(path), tuple(assembled), crs, True, "height tag", "building:levels"),
        StreetLayer(str(path), tuple(raw_streets), crs, True),
    )


_Areas = dict[int, tuple[tuple[int, ...], tuple[int, ...]]]
"""Outer and inner ways of relations, by the relations' ids."""
_Outline = tuple[int, Way, dict[str, str]]
"""A way that outlines a building: its id, the way, and its tags."""


def _read_all(
    text: OsmText, ledger: Ledger, *, buildings: bool, streets: bool
) -> tuple[list[Relation], list[_Group], _Areas, dict[int, Way], list[_Outline], list[RawStreet]]:
    """Relations that are buildings, those that group them, areas and ways that these need, outlines, and streets."""
    relations, groups, members = _read_relations(text, ledger, buildings=buildings, streets=streets)
    areas = _read_areas(text, {number for group in groups for number in group.areas})
    members |= {number for outer, inner in areas.values() for number in (*outer, *inner)}
    ways, outlines, raw_streets = _read_ways(text, ledger, members, buildings=buildings, streets=streets)
    return relations, groups, areas, ways, outlines, raw_streets


def _entities(text: OsmText, kind: Any, places: Any = None) -> Iterator[Any]:  # noqa: ANN401 (osmium's types)
    """The objects of a kind in the order of the file; ``places`` is a table of nodes that is filled and used meanwhile."""
    processor = osmium.FileProcessor(text.source)
    if places is not None:
        processor = processor.with_locations(places)
    yield from processor.with_filter(osmium.filter.EntityFilter(kind))


def _tags_of(tags: Mapping[str, str], keys: tuple[str, ...]) -> dict[str, str]:
    """The ``tags`` whose keys are among ``keys``."""
    return {key: value for key in keys if (value := tags.get(key)) is not None}


def _is_building(tags: Mapping[str, str]) -> bool:
    """True for buildings and building parts; ``building=no`` counts, so that it is reported."""
    return "building" in tags or (tags.get("building:part") or "no") != "no"


def _place(location: Any) -> tuple[float, float] | None:  # noqa: ANN401 (osmium's type)
    """(longitude, latitude), None where that is nowhere on earth."""
    return (location.lon, location.lat) if location.valid() else None


def _new_nodes(text: OsmText) -> dict[int, tuple[float, float] | None]:
    """(longitude, latitude) of nodes with negative ids, for which osmium's table of places has no room."""
    return {node.id: _place(node.location) for node in _entities(text, osmium.osm.NODE) if node.id < 0}


def _places_in_ways(text: OsmText) -> dict[int, tuple[float, float]]:
    """(longitude, latitude) of nodes that ways tell themselves; looked for where one of the first hundred ways does."""
    places: dict[int, tuple[float, float]] = {}
    for count, way in enumerate(_entities(text, osmium.osm.WAY), 1):
        places |= {node.ref: (node.location.lon, node.location.lat) for node in way.nodes if node.location.valid()}
        if count == 100 and not places:
            break
    return places


def _read_relations(
    text: OsmText, ledger: Ledger, *, buildings: bool, streets: bool
) -> tuple[list[Relation], list[_Group], frozenset[int]]:
    """Building relations that are areas, those that group others, and the ids of all ways that they need."""
    relations: list[Relation] = []
    groups: list[_Group] = []
    members: set[int] = set()
    for relation in _entities(text, osmium.osm.RELATION):
        id_ = f"relation/{relation.id}"
        if streets and "highway" in relation.tags:
            ledger.note("read", "highways")
            ledger.note("left out", "street: a relation, which is an area", id_)
        kind = relation.tags.get("type", "")
        if buildings and kind == "building" and id_ not in text.deleted:
            outline = [(one.type, one.ref) for one in relation.members if one.role == "outline"]
            outline_ways, outline_areas = (tuple(ref for type_, ref in outline if type_ == wanted) for wanted in "wr")
            tags = _tags_of(relation.tags, _BUILDING_TAGS)
            groups.append(_Group(id_, tags, outline_ways, outline_areas, _is_building(relation.tags)))
            members.update(outline_ways)
            continue
        if not buildings or not _is_building(relation.tags):
            continue
        ledger.note("read", "buildings" if "building" in relation.tags else "building parts")
        if id_ in text.deleted:
            ledger.note("left out", "building: deleted in an editor", id_)
            continue
        if kind not in {"multipolygon", "boundary"}:
            ledger.note("left out", f"building: relation of type {kind or 'none'}, only groups others", id_)
            continue
        outer: list[int] = []
        inner: list[int] = []
        for member in relation.members:
            if member.type == "w":
                (inner if member.role == "inner" else outer).append(member.ref)
        members.update(outer, inner)
        relations.append(Relation(id_, _tags_of(relation.tags, _BUILDING_TAGS), tuple(outer), tuple(inner)))
    return relations, groups, frozenset(members)


def _read_areas(text: OsmText, wanted: set[int]) -> _Areas:
    """The outer and inner ways of relations by their ids; the file is read only where some are wanted."""
    areas: _Areas = {}
    for relation in _entities(text, osmium.osm.RELATION) if wanted else ():
        if relation.id in wanted:
            ways = [(one.role == "inner", one.ref) for one in relation.members if one.type == "w"]
            outer, inner = (tuple(ref for is_inner, ref in ways if is_inner is side) for side in (False, True))
            areas[relation.id] = (outer, inner)
    return areas


def _from_groups(
    groups: list[_Group],
    areas: _Areas,
    tagged: dict[str, str],
    ledger: Ledger,
) -> tuple[list[Relation], dict[str, dict[str, str]]]:
    """What relations of type building say: buildings that only they name, and more tags for buildings that are there.

    ``tagged`` has the building that each way or relation outlines, where that is told without them.
    """
    relations: list[Relation] = []
    more: dict[str, dict[str, str]] = {}
    for group in groups:
        outlines = [*(f"way/{number}" for number in group.ways), *(f"relation/{number}" for number in group.areas)]
        known = sorted({tagged[id_] for id_ in outlines if id_ in tagged})
        if known or not outlines:
            if group.says_building:
                ledger.note("read", "buildings")
                ledger.note("left out", "building: relation of type building, only groups others", group.id)
            told = {key: value for key, value in group.tags.items() if key not in ("building", "building:part")}
            for id_ in known if told else ():
                more[id_] = told
                ledger.note("noted", "building with the tags of its relation", id_)
            continue
        ledger.note("read", "buildings")
        outer = (*group.ways, *(way for number in group.areas for way in areas.get(number, ((), ()))[0]))
        inner = tuple(way for number in group.areas for way in areas.get(number, ((), ()))[1])
        relations.append(Relation(group.id, {"building": "yes"} | group.tags, outer, inner))
    return relations, more


def _read_ways(
    text: OsmText,
    ledger: Ledger,
    members: frozenset[int],
    *,
    buildings: bool,
    streets: bool,
) -> tuple[dict[int, Way], list[_Outline], list[RawStreet]]:
    """Member ways by id; building ways as (id, way, tags); streets."""
    ways: dict[int, Way] = {}
    outlines: list[_Outline] = []
    raw_streets: list[RawStreet] = []
    # A file may hold ways before nodes: fill the table of places first, then use it.
    places = osmium.index.create_map("flex_mem")
    for _ in _entities(text, osmium.osm.NOTHING, places):
        pass
    new: dict[int, tuple[float, float] | None] | None = None
    own: dict[int, tuple[float, float]] | None = None
    for way in _entities(text, osmium.osm.WAY, places):
        is_building = buildings and _is_building(way.tags)
        is_street = streets and "highway" in way.tags
        if not (is_building or is_street or way.id in members):
            continue
        id_ = f"way/{way.id}"
        if is_building:
            ledger.note("read", "buildings" if "building" in way.tags else "building parts")
        if is_street:
            ledger.note("read", "highways")
        if id_ in text.deleted:
            for kind, is_kind in (("building", is_building), ("street", is_street)):
                ledger.note("left out", f"{kind}: deleted in an editor", id_, count=int(is_kind))
            continue
        refs = tuple(node.ref for node in way.nodes)
        located = tuple(_place(node.location) for node in way.nodes)
        astray = any(
            place is None and node.location.x != _NOWHERE for node, place in zip(way.nodes, located, strict=True)
        )
        if refs and min(refs) < 0:
            new = _new_nodes(text) if new is None else new
            located = tuple(new.get(ref, place) for ref, place in zip(refs, located, strict=True))
            astray = astray or any(ref in new and new[ref] is None for ref in refs)
        if None in located:
            own = _places_in_ways(text) if own is None else own
            located = tuple(place or own.get(ref) for ref, place in zip(refs, located, strict=True))
        found = Way(refs, located, astray and None in located)
        if way.id in members:
            ways[way.id] = found
        if is_building:
            outlines.append((way.id, found, _tags_of(way.tags, _BUILDING_TAGS)))
        if is_street:
            street = street_of_way(id_, found, _tags_of(way.tags, _STREET_TAGS), ledger)
            if street is not None:
                raw_streets.append(street)
    return ways, outlines, raw_streets
