"""From street lines with tags to the street graph of a city: which count, how wide, where they meet, where they stop.

OpenStreetMap ways meet where they share a node. Other lines meet where they touch or cross at the same level, to 0.1 m.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType

import networkx as nx
import numpy as np
import pyproj
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString
from shapely.geometry.base import BaseGeometry

from mmi import limits
from mmi.city.model import CityObject
from mmi.city.terrain import Terrain
from mmi.foundation.errors import CityError
from mmi.reading.along_lines import nearest_places, points_along
from mmi.reading.coordinates import LocalFrame, to_local_frame
from mmi.reading.maps.crossings import streets_tangled
from mmi.reading.maps.heights import parse_metres
from mmi.reading.raw_layers import RawStreet, StreetLayer, is_yes
from mmi.reading.report import Ledger

__all__ = ["OUTDOORS", "graph_from_lines", "half_width", "moved_lines", "refusal", "street_kind"]

_LANE_WIDTH = 3.0
_SNAP = 0.1
_SHORTEST = 1.0
OUTDOORS = (-math.inf, 2.5)
"""Heights above the ground, metres: where an object reaches between them, a street has no headroom."""
_MARGIN = 200.0

_HALF_WIDTHS = MappingProxyType({
    "motorway": 8.0, "trunk": 7.0, "primary": 5.0, "secondary": 4.5, "tertiary": 4.0,
    "motorway_link": 4.0, "trunk_link": 4.0, "primary_link": 3.0, "secondary_link": 3.0, "tertiary_link": 3.0,
    "unclassified": 3.0, "residential": 3.0, "living_street": 3.0, "road": 3.0, "service": 2.0, "street": 3.0,
    "pedestrian": 3.0, "track": 1.5, "footway": 1.5, "path": 1.0, "steps": 1.5, "cycleway": 1.5, "bridleway": 1.5,
})  # fmt: skip
_DRIVE = frozenset({
    "motorway", "motorway_link", "trunk", "trunk_link", "primary", "primary_link", "secondary", "secondary_link", "tertiary",
    "tertiary_link", "unclassified", "residential", "living_street", "road", "street",
})  # fmt: skip
_NO_WALK = frozenset({"motorway", "motorway_link"})
_BARRED = frozenset({"no", "private"})
_ALLOWED = frozenset({"yes", "designated", "permissive"})
_WALK_IF_ALLOWED = frozenset({"cycleway", "trunk", "trunk_link"})
_NO_STREETS = frozenset(
    {"construction", "corridor", "crossing", "elevator", "platform", "proposed", "raceway", "rest_area", "services"}
)
# BD TOPO's NATURE and the like, where they differ from OpenStreetMap.
_TRANSLATED = MappingProxyType(
    {
        "escalier": "steps",
        "sentier": "path",
        "chemin": "track",
        "autoroute": "motorway",
        "type autoroutier": "motorway",
    }
)


def street_kind(tags: dict[str, str]) -> str:
    """The OpenStreetMap highway value, ``"street"`` where the file speaks another language."""
    value = tags.get("highway", "").lower()
    value = _TRANSLATED.get(value, value)
    return value if value in _HALF_WIDTHS else "street"


def half_width(tags: dict[str, str]) -> float:
    """Metres from the centre line to the edge: half the tagged width, else 1.5 m a lane, else by kind."""
    width = parse_metres(tags["width"]) if "width" in tags else None
    if width is not None and 1.0 <= width <= 80.0:
        return width / 2.0
    lanes = tags.get("lanes", "")
    if re.fullmatch(r"\d+", lanes) and 1 <= int(lanes) <= 12:
        return int(lanes) * _LANE_WIDTH / 2.0
    return _HALF_WIDTHS[street_kind(tags)]


def refusal(tags: dict[str, str], network: str, *, osm: bool) -> str | None:
    """Why a street is not used for ``network`` (drive, walk, all), or None if it is."""
    value = tags.get("highway", "").lower()
    if (osm and value not in _HALF_WIDTHS) or value in _NO_STREETS:
        return "not a street (construction, platform, elevator, ...)"
    kind = street_kind(tags)
    if is_yes(tags.get("area")) and not re.fullmatch(r"[\d.,]+", tags["area"]):
        return "an area"
    if is_yes(tags.get("tunnel")):
        return "tunnel"
    if is_yes(tags.get("covered")) or is_yes(tags.get("indoor")):
        return "covered or indoors"
    if tags.get("layer", "").startswith("-") and tags["layer"].strip("-0. "):
        return "below the ground (negative layer)"
    # The tag of one kind of traffic says more than ``vehicle``, and that more than ``access``, which is for all of them.
    access, on_foot = (tags.get(key, "").lower() for key in ("access", "foot"))
    by_car = (tags.get("motor_vehicle") or tags.get("vehicle", "")).lower()
    barred = access in _BARRED
    drive = kind in _DRIVE and by_car not in _BARRED and (by_car in _ALLOWED or not barred)
    walk = kind not in _NO_WALK and on_foot not in {*_BARRED, "use_sidepath"}
    if (barred or kind in _WALK_IF_ALLOWED) and on_foot not in _ALLOWED:
        walk = False
    if kind == "footway" and tags.get("footway", "").lower() in {"sidewalk", "crossing"}:
        walk = False  # the street beside or below is walked instead
    used = {"drive": drive, "walk": walk, "all": drive or walk}[network]
    if used:
        return None
    return f"access={access}" if barred else f"not for --network {network}"


@dataclass(frozen=True, slots=True, eq=False)
class _Piece:
    """A stretch of the used street ``street`` (an index)."""

    street: int
    line: LineString


def moved_lines(layer: StreetLayer, crs: pyproj.CRS | None, frame: LocalFrame) -> list[list[LineString]]:
    """The lines of each street of ``layer`` from ``crs`` (None: the frame's own units) into ``frame``."""
    flat = to_local_frame([line for item in layer.items for line in item.lines], crs, frame)
    ends = np.cumsum([len(item.lines) for item in layer.items])
    return [list(own) for own in np.split(flat, ends[:-1])]


def graph_from_lines(
    layer: StreetLayer,
    shapes: Sequence[Sequence[LineString]],
    objects: Sequence[CityObject],
    ledger: Ledger,
    *,
    network: str,
    ground: Terrain | float,
    window: BaseGeometry | None,
    clear: tuple[float, float] = OUTDOORS,
) -> nx.MultiGraph:
    """The street graph of ``City.streets``. ``shapes`` are the lines of ``layer.items`` in metres.

    Streets end at the ``window`` (the clip box, or None), 200 m outside the buildings' bounding box, and where they run into
    an object that stands less than 2.5 m above the ground; or, more generally, into one that reaches between the heights
    ``clear`` (metres above the ground). Stretches under 1 m are dropped.

    Raises:
        CityError: no street is left; says which kinds there were.
    """
    osm = any(item.nodes is not None for item in layer.items)
    used: list[RawStreet] = []
    lines: list[Sequence[LineString]] = []
    unused: Counter[str] = Counter()
    for item, own in zip(layer.items, shapes, strict=True):
        reason = refusal(item.tags, network, osm=osm)
        if reason is None and not (np.abs(shapely.bounds(own)) <= limits.STREET_REACH).all():  # nor is NaN, or infinity
            ledger.note("left out", f"street: it reaches further than {limits.STREET_REACH / 1e3:,.0f} km", item.id)
            unused["out of reach"] += 1
        elif reason is None:
            used.append(item)
            lines.append(own)
            if is_yes(item.tags.get("bridge")):
                ledger.note("noted", "bridge kept on the ground", item.id, metres=float(shapely.length(own).sum()))
        else:
            ledger.note("left out", f"street: {reason}", item.id)
            unused[item.tags.get("highway", reason) if reason.startswith("not for") else reason] += 1
    if not used:
        kinds = ", ".join(f"{n} {reason}" for reason, n in unused.most_common(4))
        raise CityError(
            f"{layer.file}: no streets for --network {network}; found only {kinds or 'no lines'}; "
            "try another --network, or --streets FILE"
        )
    pieces = _split_at_nodes(used, lines) if osm else _split_where_touching(used, lines, layer.file)
    survivors = {piece.street for piece in pieces}
    for i, item in enumerate(used):
        if i not in survivors:
            ledger.note("left out", "street: repeats another or too short", item.id)
    pieces = _clip(pieces, used, _window_around(objects, window), ledger)
    pieces = _cut_at_objects(pieces, used, objects, ledger, ground=ground, clear=clear)
    pieces = _without_scraps(pieces, used, ledger)
    if not pieces:
        raise CityError(
            f"{layer.file}: no streets left for --network {network}: expected some within {_MARGIN:g} m of the "
            f"buildings and outside them{ledger.why_left_out('street')}"
        )
    return _graph(pieces, used)


def _split_at_nodes(used: Sequence[RawStreet], lines: Sequence[Sequence[LineString]]) -> list[_Piece]:
    """Split OpenStreetMap ways at nodes that used ways share, or that one visits twice."""
    visits: Counter[int] = Counter()
    for item in used:
        for nodes in item.nodes or ():
            # Ends count twice: they are split points whether shared or not. A ring meets itself only there.
            visits.update(nodes)
            visits.update((nodes[0], nodes[-1]))
    pieces: list[_Piece] = []
    for i, (item, own) in enumerate(zip(used, lines, strict=True)):
        for nodes, line in zip(item.nodes or (), own, strict=True):
            coords = shapely.get_coordinates(line)
            cuts = [k for k, node in enumerate(nodes) if visits[node] > 1]
            for start, stop in pairwise(cuts):
                stretch = _line(coords[start : stop + 1])
                if stretch is not None:
                    pieces.append(_Piece(i, stretch))
    return pieces


def _line(coords: NDArray[np.float64]) -> LineString | None:
    """A line without repeated points, or None if only one is left."""
    keep = np.ones(len(coords), dtype=np.bool_)
    keep[1:] = (np.diff(coords, axis=0) != 0).any(axis=1)
    return LineString(coords[keep]) if keep.sum() > 1 else None


def _split_where_touching(used: Sequence[RawStreet], lines: Sequence[Sequence[LineString]], file: str) -> list[_Piece]:
    """Split lines where they cross or touch others of their level, on a grid of 0.1 m; repeated stretches become one.

    Raises CityError where they cross too often for that; ``file`` is where they are from.
    """
    flat = np.array([line for own in lines for line in own], dtype=object)
    street = np.array([i for i, own in enumerate(lines) for _ in own], dtype=np.intp)
    levels = np.array([_level(used[i].tags) for i in street])
    found: list[tuple[int, float, LineString]] = []
    for level in np.unique(levels):
        here = np.flatnonzero(levels == level)
        if streets_tangled(flat[here]):
            raise CityError(
                f"{file}: streets that cross at most {limits.STREET_CROSSINGS:,} times, or once for each of their edges, "
                f"expected, found that {len(here)} of them cross more often or lie side by side"
            )
        noded = shapely.get_parts(shapely.union_all(flat[here], grid_size=_SNAP))
        noded = noded[shapely.get_type_id(noded) == 1]
        source, along = nearest_places(flat[here], shapely.line_interpolate_point(noded, 0.5, normalized=True))
        noded = _along_their_sources(noded, flat[here], source, along)
        found += zip(here[source].tolist(), along.tolist(), noded, strict=True)
    found.sort(key=lambda one: one[:2])
    return [_Piece(int(street[source_]), line) for source_, _, line in found]


def _along_their_sources(
    pieces: NDArray[np.object_], sources: NDArray[np.object_], source: NDArray[np.intp], along: NDArray[np.float64]
) -> NDArray[np.object_]:
    """The pieces (n,), each in the direction of its source, on which its middle is ``along`` (n,) metres from the start.

    A union may have turned a stretch round: run along the source, so that reading it again gives the same.
    """
    ahead = 0.25 * shapely.length(pieces)
    before, after = (points_along(sources, source, along + shift) for shift in (-ahead, ahead))
    first, last = (
        shapely.get_coordinates(shapely.line_interpolate_point(pieces, share, normalized=True))
        for share in (0.25, 0.75)
    )
    as_it_is = ((before - first) ** 2 + (after - last) ** 2).sum(axis=1)
    turned = ((before - last) ** 2 + (after - first) ** 2).sum(axis=1)
    return np.where(turned < as_it_is, shapely.reverse(pieces), pieces)


def _level(tags: dict[str, str]) -> float:
    """Height rank of a street: its layer tag, else 1 for bridges, else 0."""
    layer = tags.get("layer", "")
    if re.fullmatch(r"[+-]?\d+(\.\d+)?", layer):
        return float(layer)
    return 1.0 if is_yes(tags.get("bridge")) else 0.0


def _window_around(objects: Sequence[CityObject], window: BaseGeometry | None) -> BaseGeometry:
    """Where streets may be: the buildings' bounding box and a margin, within ``window``."""
    x0, y0, x1, y1 = shapely.total_bounds(np.array([one.footprint for one in objects], dtype=object))
    around = shapely.box(x0 - _MARGIN, y0 - _MARGIN, x1 + _MARGIN, y1 + _MARGIN)
    return around if window is None else around.intersection(window)


def _clip(pieces: list[_Piece], used: Sequence[RawStreet], window: BaseGeometry, ledger: Ledger) -> list[_Piece]:
    """What of the pieces lies within ``window``."""
    shapes = np.array([piece.line for piece in pieces], dtype=object)
    shapely.prepare(window)
    inside = shapely.covered_by(shapes, window)
    kept: list[_Piece] = []
    for piece, whole in zip(pieces, inside, strict=True):
        kept += (
            [piece]
            if whole
            else [_Piece(piece.street, part) for part in _in_order(piece.line, piece.line.intersection(window))]
        )
    gone = _metres_by_street(pieces)
    for i, metres in _metres_by_street(kept).items():
        gone[i] -= metres
    survivors = {piece.street for piece in kept}
    for i, metres in gone.items():
        if i not in survivors:
            ledger.note("left out", "street: outside the city's window", used[i].id, metres=metres)
        elif metres > 0.01:
            ledger.note("repaired", "street cut at the city's window", used[i].id, metres=metres)
    return kept


def _in_order(line: LineString, rest: BaseGeometry) -> list[LineString]:
    """The lines of ``rest``, which is part of ``line``, from its start to its end."""
    parts = [part for part in getattr(rest, "geoms", [rest]) if isinstance(part, LineString) and part.length > 0]
    if len(parts) < 2:
        return parts
    middles = shapely.line_interpolate_point(parts, 0.5, normalized=True)
    _, along = nearest_places(np.array([line], dtype=object), middles)
    return [parts[i] for i in np.argsort(along, kind="stable")]


def _metres_by_street(pieces: Iterable[_Piece]) -> dict[int, float]:
    total: dict[int, float] = {}
    for piece in pieces:
        total[piece.street] = total.get(piece.street, 0.0) + piece.line.length
    return total


def _cut_at_objects(
    pieces: list[_Piece],
    used: Sequence[RawStreet],
    objects: Sequence[CityObject],
    ledger: Ledger,
    *,
    ground: Terrain | float,
    clear: tuple[float, float],
) -> list[_Piece]:
    """What of the pieces lies outside the objects that reach between the heights ``clear`` above the ground."""
    if not pieces:
        return pieces
    prisms = [prism for one in objects for prism in one.prisms]
    walls = np.array([prism.footprint for prism in prisms], dtype=object)
    below = ground.range_over(shapely.bounds(walls))[1] if isinstance(ground, Terrain) else np.full(len(walls), ground)
    low, high = np.array([(prism.bottom, prism.top) for prism in prisms]).T
    walls = walls[(low < below + clear[1]) & (high > below + clear[0])]
    shapes = np.array([piece.line for piece in pieces], dtype=object)
    hit, by = shapely.STRtree(walls).query(shapes, predicate="intersects")
    blockers: dict[int, list[int]] = {}
    for i, wall in zip(hit.tolist(), by.tolist(), strict=True):
        blockers.setdefault(i, []).append(wall)
    kept: list[_Piece] = []
    for i, piece in enumerate(pieces):
        if i in blockers:
            outside = piece.line.difference(shapely.union_all(walls[sorted(blockers[i])]))
            kept += [_Piece(piece.street, part) for part in _in_order(piece.line, outside)]
        else:
            kept.append(piece)
    before, after = _metres_by_street(pieces), _metres_by_street(kept)
    for street, metres in before.items():
        inside = metres - after.get(street, 0.0)
        if street not in after:
            ledger.note("left out", "street: inside buildings", used[street].id, metres=inside)
        elif inside > 0.01:
            ledger.note("repaired", "street cut where it runs through buildings", used[street].id, metres=inside)
    return kept


def _without_scraps(pieces: list[_Piece], used: Sequence[RawStreet], ledger: Ledger) -> list[_Piece]:
    """Without stretches under 1 m that lead nowhere: a short link between two junctions stays."""
    ends = Counter(end for piece in pieces for end in _ends(piece.line))
    kept: list[_Piece] = []
    for piece in pieces:
        first, last = _ends(piece.line)
        if piece.line.length >= _SHORTEST or (first != last and ends[first] > 1 and ends[last] > 1):
            kept.append(piece)
        else:
            ledger.note(
                "repaired",
                f"stretch of street under {_SHORTEST:g} m dropped",
                used[piece.street].id,
                metres=piece.line.length,
            )
    survivors = {piece.street for piece in kept}
    for i in sorted({piece.street for piece in pieces} - survivors):
        ledger.note("left out", f"street: all stretches under {_SHORTEST:g} m", used[i].id)
    return kept


def _ends(line: LineString) -> tuple[tuple[float, float], tuple[float, float]]:
    """Start and end of a line, to the millimetre."""
    coords = np.round(shapely.get_coordinates(line)[[0, -1]], 3) + 0.0
    return (coords[0, 0], coords[0, 1]), (coords[1, 0], coords[1, 1])


def _graph(pieces: Sequence[_Piece], used: Sequence[RawStreet]) -> nx.MultiGraph:
    """Nodes numbered and edges indexed in reading order; each line runs from its lower-numbered node."""
    numbers: dict[tuple[float, float], int] = {}
    graph = nx.MultiGraph()
    for index, piece in enumerate(pieces):
        ends = _ends(piece.line)
        for end in ends:
            if end not in numbers:
                numbers[end] = len(numbers)
                graph.add_node(numbers[end], x=float(end[0]), y=float(end[1]))
        a, b = numbers[ends[0]], numbers[ends[1]]
        coords = np.round(shapely.get_coordinates(piece.line), 3) + 0.0
        tags = used[piece.street].tags
        graph.add_edge(
            min(a, b),
            max(a, b),
            geometry=LineString(coords if a <= b else coords[::-1]),
            kind=street_kind(tags),
            half_width=half_width(tags),
            name=tags.get("name", ""),
            index=index,
        )
    return graph
