"""Ways and relations of OpenStreetMap become lines and outlines: nodes are looked up, rings joined, courtyards cut out.

Rings of multipolygons are joined by node id, because an extract cuts relations at its edge: rings that close are used, and
what is missing is counted by reason, which an area assembler that only skips cannot tell.
"""

from __future__ import annotations

from dataclasses import dataclass

import shapely
from shapely.geometry import LineString, Polygon
from shapely.geometry.base import BaseGeometry

from mmi.reading.maps.crossings import Tangles
from mmi.reading.raw_layers import RawStreet
from mmi.reading.report import Ledger

__all__ = ["Relation", "Way", "join_rings", "outline_of_relation", "polygon_of_way", "street_of_way"]

_ASTRAY = "coordinates outside the world"


@dataclass(frozen=True, slots=True)
class Relation:
    """A building relation: its tags and the ids of its outer and inner member ways."""

    id: str
    tags: dict[str, str]
    outer: tuple[int, ...]
    inner: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Way:
    """A way's node ids and their (longitude, latitude), None where the file lacks the node, or places it nowhere on earth.

    ``astray``: of the latter kind is one of them.
    """

    nodes: tuple[int, ...]
    places: tuple[tuple[float, float] | None, ...]
    astray: bool = False


def street_of_way(id_: str, way: Way, tags: dict[str, str], ledger: Ledger) -> RawStreet | None:
    """The located stretches of a highway: split where nodes are missing, None if no two neighbours are known."""
    if len(set(way.nodes)) < 2:
        ledger.note("left out", "street: fewer than two points", id_)
        return None
    runs: list[list[tuple[int, tuple[float, float]]]] = [[]]
    for node, place in zip(way.nodes, way.places, strict=True):
        if place is None:
            runs.append([])
        elif not runs[-1] or runs[-1][-1][1] != place:
            runs[-1].append((node, place))
    runs = [run for run in runs if len(run) > 1]
    if not runs:
        ledger.note("left out", f"street: {_ASTRAY if way.astray else 'its nodes are missing from the file'}", id_)
        return None
    if None in way.places:
        ledger.note(
            "repaired", f"street shortened where {f'it has {_ASTRAY}' if way.astray else 'nodes are missing'}", id_
        )
    lines = tuple(LineString([place for _, place in run]) for run in runs)
    return RawStreet(id_, lines, tags, tuple(tuple(node for node, _ in run) for run in runs))


def polygon_of_way(id_: str, way: Way, ledger: Ledger) -> Polygon | None:
    """The area inside a closed way, or None with the reason in the ledger."""
    places = [place for place in way.places if place is not None]
    if len(places) < len(way.places):
        ledger.note("left out", f"building: {_ASTRAY if way.astray else 'nodes missing from the file'}", id_)
    elif len(way.nodes) < 4 or way.nodes[0] != way.nodes[-1]:
        ledger.note("left out", "building: outline not closed", id_)
    else:
        return Polygon(places)
    return None


def join_rings(ways: list[tuple[int, ...]]) -> tuple[list[tuple[int, ...]], int]:
    """Join node-id chains end to end into closed rings, in the order given; also the number of chains left over."""
    rings = [way for way in ways if len(way) > 3 and way[0] == way[-1]]
    chains = [list(way) for way in ways if len(way) > 1 and way[0] != way[-1]]
    free = [True] * len(chains)
    ending: dict[int, list[int]] = {}  # at each node the chains that end there, the first one last
    for i in reversed(range(len(chains))):
        for end in (chains[i][0], chains[i][-1]):
            ending.setdefault(end, []).append(i)
    left_over = 0
    for first, chain in enumerate(chains):
        if not free[first]:
            continue
        free[first], used = False, 1
        while chain[0] != chain[-1]:
            waiting = ending[chain[-1]]
            while waiting and not free[waiting[-1]]:
                waiting.pop()
            if not waiting:
                break
            match = waiting.pop()
            free[match], other = False, chains[match]
            chain += other[1:] if other[0] == chain[-1] else other[-2::-1]
            used += 1
        if chain[0] == chain[-1] and len(chain) > 3:
            rings.append(tuple(chain))
        else:
            left_over += used
    return rings, left_over


def outline_of_relation(
    relation: Relation, ways: dict[int, Way], tangles: Tangles, ledger: Ledger
) -> BaseGeometry | None:
    """Outer rings less inner rings, or None with the reason in the ledger; ``tangles`` has looked at those before."""
    places = {
        node: place
        for number in (*relation.outer, *relation.inner)
        if number in ways
        for node, place in zip(ways[number].nodes, ways[number].places, strict=True)
    }

    def areas(numbers: tuple[int, ...]) -> tuple[list[Polygon], int]:
        whole = [ways[n].nodes for n in numbers if n in ways and None not in ways[n].places]
        rings, left_over = join_rings(whole)
        return [Polygon([places[node] for node in ring]) for ring in rings], left_over + len(numbers) - len(whole)

    outers, broken_outers = areas(relation.outer)
    inners, broken_inners = areas(relation.inner)
    if not outers:
        astray = any(ways[number].astray for number in relation.outer if number in ways)
        why = f"relation with {_ASTRAY}" if astray else "relation whose outer ring is incomplete"
        ledger.note("left out", f"building: {why}", relation.id)
        return None
    if broken_outers:
        ledger.note("repaired", "relation with incomplete outer rings: complete ones kept", relation.id)
    if broken_inners:
        ledger.note("repaired", "relation with an incomplete courtyard: courtyard filled", relation.id)
    tangled = tangles.why(shapely.geometrycollections([*outers, *inners]))
    if tangled is not None:
        ledger.note("left out", f"building: {tangled}", relation.id)
        return None
    outline, courtyards = (
        shapely.union_all(
            [
                one if one.is_valid else shapely.make_valid(one, method="structure", keep_collapsed=False)
                for one in rings
            ]
        )
        for rings in (outers, inners)
    )
    return outline.difference(courtyards) if inners else outline
