"""SUMO road networks (.net.xml): edges become street lines, both directions of a street one line.

An edge is one direction of a street, between two junctions, with a shape for each of its lanes. Lanes lie to the right of
the edge's line, so that the mean of the lanes of both directions is the middle of the street.
Source: https://sumo.dlr.de/docs/Networks/SUMO_Road_Networks.html.
"""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator, Set
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pyproj
import shapely
from numpy.typing import NDArray
from pyproj.exceptions import ProjError
from shapely.geometry import LineString

from mmi import limits
from mmi.foundation.errors import CityError
from mmi.reading.raw_layers import RawStreet, StreetLayer
from mmi.reading.report import Ledger
from mmi.reading.unpacked import unpacked

__all__ = ["is_sumo", "read_sumo"]

_LANE_WIDTH = 3.2
"""Metres, where a lane declares none: SUMO's default."""
_APART = 12.0
"""Metres up to which two directions between the same junctions are one street: farther apart they are two carriageways."""
_MOST_COMPARED = 1000
"""Corners of a direction that are held against the other: all of them would take minutes on edges of 200,000."""
_WALKS = frozenset({"footway", "path", "steps", "cycleway", "bridleway", "pedestrian"})
_ROAD_VEHICLES = frozenset(
    {
        "army", "authority", "bus", "coach", "delivery", "emergency", "evehicle", "hov", "moped", "motorcycle", "passenger",
        "private", "taxi", "trailer", "truck", "vip",
    }
)  # fmt: skip
_NOT_STREETS = ("railway.", "waterway.", "aeroway.", "aerialway.")


@dataclass(frozen=True, slots=True, eq=False)
class _Edge:
    """One direction: its ends (junction ids), its middle line (n, 2), how many lanes, and metres across them."""

    id: str
    start: str
    end: str
    line: NDArray[np.float64]
    lanes: int
    width: float
    kind: str
    name: str


def is_sumo(path: Path) -> bool:
    """True for a SUMO network, by its name and first bytes."""
    if not path.is_file() or not path.name.lower().endswith((".xml", ".xml.gz")):
        return False
    try:
        with unpacked(path) as file:
            head = file.read(1 << 16)
    except (OSError, EOFError, zlib.error, CityError):  # whoever reads it says so
        return False
    return b"<net " in head and (
        b"net_file.xsd" in head or b"<location" in head or path.name.lower().endswith(".net.xml")
    )


def read_sumo(path: Path, ledger: Ledger, *, local: bool = False) -> StreetLayer:
    """The streets of a network; projected where it says how (its offset is subtracted), else in its own metres.

    ``local`` keeps its own metres and names no CRS: for models without one that were made in the network's coordinates.

    Raises:
        CityError: not well-formed, cut off, with a DTD, without edges, or with coordinates that are no numbers.
    """
    edges: list[_Edge] = []
    nodes: dict[str, tuple[float, float]] = {}
    crs: pyproj.CRS | None = None
    offset = np.zeros(2)
    damage: ValueError | None = None
    try:
        for element in _elements(path):
            if element.tag == "location":
                crs, offset = _location(path, element)
            elif element.tag == "junction" and element.get("type") != "internal":
                with suppress(ValueError):  # streets end where their lanes end, then
                    nodes[element.get("id", "")] = _numbers(f"{element.get('x')},{element.get('y')}")[0]
            elif element.tag == "edge":
                try:
                    edge = _edge(element, ledger)
                except ValueError as error:
                    damage = damage or error
                    ledger.note("left out", "street: a shape or width that is no numbers", element.get("id", ""))
                else:
                    edges += [] if edge is None else [edge]
    except (ValueError, IndexError) as error:
        raise CityError(f"{path}: expected a SUMO network (.net.xml) with shapes in metres; found: {error}") from error
    if not edges and damage is not None:
        raise CityError(f"{path}: expected a SUMO network (.net.xml) with shapes in metres; found: {damage}")
    if not edges:
        raise CityError(f"{path}: expected a SUMO network with edges that are streets, found none")
    if local:
        crs, offset = None, np.zeros(2)
    streets = [
        RawStreet(group[0].id.removeprefix("-"), (_moved(_middle(group, nodes), offset),), _tags(group))
        for group in _pairs(edges)
    ]
    ledger.note("read", "streets", count=len(edges))
    ledger.note("noted", "opposite directions joined to one street", count=len(edges) - len(streets))
    return StreetLayer(str(path), tuple(_with_unique_ids(streets)), crs, crs is not None)


def _elements(path: Path) -> Iterator[ElementTree.Element]:
    """The elements directly below the root, one at a time, forgotten afterwards; DTDs are refused (they define entities)."""
    try:
        with unpacked(path) as file:
            parser: ElementTree.XMLPullParser[ElementTree.Element] = ElementTree.XMLPullParser(["start", "end"])
            depth, head = 0, b""
            root: ElementTree.Element | None = None
            while block := file.read(1 << 16):
                if root is None:
                    head += block
                    if b"<!DOCTYPE" in head.upper():
                        raise CityError(f"{path}: expected a SUMO network without a DTD, found one; remove the DOCTYPE")
                parser.feed(block)
                events: Iterator[Any] = parser.read_events()
                for event, element in events:
                    depth += 1 if event == "start" else -1
                    if root is None:
                        root = element
                        if root.tag != "net":
                            raise CityError(f"{path}: expected a SUMO network (<net>), found <{root.tag}>")
                    elif event == "end" and depth == 1:
                        yield element
                        root.clear()
            parser.close()
    except ElementTree.ParseError as error:
        raise CityError(f"{path}: expected a SUMO network, complete to its end; found: {error}") from error
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        raise CityError(f"{path}: expected gzip, complete to its end; found: {error}") from error
    if root is None:
        raise CityError(f"{path}: expected a SUMO network, found an empty file")


def _location(path: Path, element: ElementTree.Element) -> tuple[pyproj.CRS | None, NDArray[np.float64]]:
    """The CRS and the offset that was added to it; None and 0 where the network was not projected."""
    text = element.get("projParameter", "!")
    if text.strip() in ("", "!", "-", "."):
        return None, np.zeros(2)
    try:
        crs = pyproj.CRS.from_user_input(text)
    except ProjError as error:
        raise CityError(f"{path}: location: a PROJ string expected, found {text[:80]!r}") from error
    return crs, np.array(_numbers(element.get("netOffset", "0,0"))[0])


def _numbers(text: str) -> list[tuple[float, float]]:
    """``x,y x,y ...``, heights left out."""
    points = [tuple(float(one) for one in word.split(",")) for word in text.split()]
    if not all(len(point) in (2, 3) and np.max(np.abs(point)) <= limits.COORDINATE for point in points):  # nor is NaN
        raise ValueError(f"x,y expected, found {text[:60]!r}")
    return [(point[0], point[1]) for point in points]


def _edge(element: ElementTree.Element, ledger: Ledger) -> _Edge | None:
    """One direction of a street; None for an edge inside a junction and for one that is no street."""
    id_ = element.get("id", "")
    if element.get("function", "normal") != "normal" or id_.startswith(":"):
        return None
    kind = element.get("type", "")
    lanes = element.findall("lane")
    shapes = [shape for lane in lanes if len(shape := _numbers(lane.get("shape", ""))) > 1]
    own = _numbers(element.get("shape", ""))
    parts = kind.split("|")
    highway = next((part.removeprefix("highway.") for part in parts if part.startswith("highway.")), None)
    other = next((part for part in parts if part.startswith(_NOT_STREETS)), None)
    if highway is None and other is not None:
        ledger.note("left out", f"street: {other.split('.')[0]}", id_)
        return None
    if highway is None:
        highway = _kind_by_users(lanes, kind)
    if highway is None:
        ledger.note("left out", "street: neither for road vehicles nor for people on foot", id_)
        return None
    line = _mean_line(shapes) if shapes else np.array(own).reshape(-1, 2)
    if len(line) < 2 or not np.ptp(line, axis=0).any():
        ledger.note("left out", "street: no shape", id_)
        return None
    width = sum(float(lane.get("width", element.get("width", _LANE_WIDTH))) for lane in lanes) or _LANE_WIDTH
    start, end = element.get("from", ""), element.get("to", "")
    return _Edge(id_, start, end, line, max(len(lanes), 1), width, highway, element.get("name", ""))


def _kind_by_users(lanes: list[ElementTree.Element], kind: str) -> str | None:
    """``kind`` where a road vehicle may use a lane, else a footway or cycleway; None where neither may use any."""
    for users, answer in ((_ROAD_VEHICLES, kind), ({"pedestrian"}, "footway"), ({"bicycle"}, "cycleway")):
        if not lanes or any(_may_use(lane, users) for lane in lanes):
            return answer
    return None


def _may_use(lane: ElementTree.Element, users: Set[str]) -> bool:
    """Whether some of the users may use the lane: it lists who may (``allow``), or who may not, or nobody."""
    allow, disallow = lane.get("allow"), lane.get("disallow")
    if allow is not None:
        return not users.isdisjoint(allow.split()) or "all" in allow.split()
    return disallow is None or not ("all" in disallow.split() or users <= set(disallow.split()))


def _mean_line(lines: list[list[tuple[float, float]]] | list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """The mean of lines that run side by side: point by point, or at equal shares of their lengths."""
    if len({len(line) for line in lines}) == 1:
        return np.mean([np.asarray(line) for line in lines], axis=0)
    courses = []
    for line in lines:
        corners = np.asarray(line)
        metres = np.r_[0.0, np.cumsum(np.hypot(*np.diff(corners, axis=0).T))]
        courses.append((metres / max(float(metres[-1]), 1e-9), corners))
    at = np.unique(np.clip(np.round(np.concatenate([shares for shares, _ in courses]), 3), 0.0, 1.0))
    return np.mean([[np.interp(at, shares, axis) for axis in corners.T] for shares, corners in courses], axis=0).T


def _pairs(edges: list[_Edge]) -> list[list[_Edge]]:
    """Each edge alone or with the one that runs the other way: ``-id`` and ``id``, or the same ends and close by."""
    by_id = {edge.id: i for i, edge in enumerate(edges)}
    by_ends: dict[tuple[str, str], list[int]] = {}
    for i, edge in enumerate(edges):
        by_ends.setdefault((edge.start, edge.end), []).append(i)
    groups: list[list[_Edge]] = []
    taken = np.zeros(len(edges), dtype=bool)
    for i, edge in enumerate(edges):
        if taken[i]:
            continue
        taken[i] = True
        back = by_ends.get((edge.end, edge.start), []) if edge.start != edge.end else []
        other = edge.id[1:] if edge.id.startswith("-") else f"-{edge.id}"
        if other in by_id and by_id[other] in back:
            back = [by_id[other]]
        twin = next((j for j in back if not taken[j] and _are_close(edge.line, edges[j].line)), None)
        if twin is None:
            groups.append([edge])
        else:
            taken[twin] = True
            groups.append([edge, edges[twin]])
    return groups


def _are_close(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    """Whether the corners of each, or a thousand of them, lie within ``_APART`` metres of the other."""
    lines = LineString(a), LineString(b)
    shapely.prepare(lines)
    return all(
        shapely.dwithin(line, shapely.points(other[:: len(other) // _MOST_COMPARED + 1]), _APART).all()
        for line, other in zip(lines, (b, a), strict=True)
    )


def _middle(group: list[_Edge], nodes: dict[str, tuple[float, float]]) -> NDArray[np.float64]:
    """The middle line of a street, led into the junctions at its ends so that streets meet."""
    first = group[0]
    line = first.line if len(group) == 1 else _mean_line([first.line, group[1].line[::-1]])
    head = [nodes[first.start]] if first.start in nodes else []
    tail = [nodes[first.end]] if first.end in nodes else []
    whole = np.concatenate([np.array(part).reshape(-1, 2) for part in (head, line, tail)])
    return whole[np.r_[True, (np.abs(np.diff(whole, axis=0)) > 1e-6).any(axis=1)]]


def _moved(line: NDArray[np.float64], offset: NDArray[np.float64]) -> LineString:
    return LineString(line - offset)


def _tags(group: list[_Edge]) -> dict[str, str]:
    """OpenStreetMap's tags for both directions together. A footway has no lanes, and its width is not the sum of theirs."""
    tags = {"highway": group[0].kind or "road"}
    name = next((edge.name for edge in group if edge.name), "")
    if name:
        tags["name"] = name
    if tags["highway"] not in _WALKS:
        tags["lanes"] = str(sum(edge.lanes for edge in group))
        tags["width"] = f"{sum(edge.width for edge in group):.2f}".rstrip("0").rstrip(".")
    return tags


def _with_unique_ids(streets: list[RawStreet]) -> list[RawStreet]:
    """The streets; where ``id`` and ``-id`` are two streets, the second gets its sign back."""
    seen: set[str] = set()
    unique = []
    for street in streets:
        id_ = street.id if street.id not in seen else f"-{street.id}"
        seen.add(id_)
        unique.append(RawStreet(id_, street.lines, street.tags))
    return unique
