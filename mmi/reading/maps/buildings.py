"""From outlines with tags to the objects of a city: parts into buildings, heights, overlaps, blocks.

Simple 3D Buildings (https://wiki.openstreetmap.org/wiki/Simple_3D_Buildings): the parts of a building replace its outline;
where they do not cover it, the outline stays.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import networkx as nx
import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon

from mmi.city.model import CityObject, Prism
from mmi.foundation.errors import CityError
from mmi.reading.maps.heights import OPEN_ROOF_HEIGHT, Heights, heights_from_neighbours, heights_from_tags, settle_span
from mmi.reading.maps.repair import clean_outlines, cut_overlaps, find_duplicates, solid_polygons
from mmi.reading.raw_layers import BuildingLayer, RawBuilding, is_yes
from mmi.reading.report import Ledger

__all__ = ["merge_blocks", "objects_from_outlines"]

_UNBUILT = frozenset({"no", "proposed", "planned", "demolished", "razed", "abandoned:building"})
_WALL_GAP = 0.1
_SHARED_WALL = 0.5
_PART_SHARE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class _Outline:
    """A clean outline in metres: its polygons and what its tags say."""

    id: str
    polygons: tuple[Polygon, ...]
    heights: Heights
    is_part: bool


def objects_from_outlines(
    layer: BuildingLayer, shapes: NDArray[np.object_], ledger: Ledger, *, ground: float
) -> tuple[CityObject, ...]:
    """One object for each building, in the order of reading. ``shapes`` are the geometries of ``layer.items`` in metres.

    Raises:
        CityError: no outline has a height at all, or none is left.
    """
    outlines = _clean(layer, shapes, ledger)
    if not outlines:
        why = ledger.why_left_out("building")
        raise CityError(
            f"{layer.file}: no buildings left; expected at least one above the ground, of 1 m2 or more{why}"
        )
    outlines = _without_twins(outlines, ledger)
    owner = _owners(outlines)
    tops = _tops(layer, outlines, owner, ledger)
    spans = [settle_span(one.id, one.heights, top, ledger) for one, top in zip(outlines, tops, strict=True)]
    prisms: list[tuple[int, Polygon, float, float]] = []
    parts_of: dict[int, list[int]] = {}
    for part, building in enumerate(owner):
        if building != part:
            parts_of.setdefault(building, []).append(part)
    for i, one in enumerate(outlines):
        if owner[i] != i:
            ledger.note("kept", "building parts as prisms of their building", one.id)
            continue
        remains = one.polygons
        if i in parts_of:
            covered = shapely.union_all([polygon for part in parts_of[i] for polygon in outlines[part].polygons])
            remains = tuple(piece for polygon in remains for piece in solid_polygons(polygon.difference(covered)))
            if remains:
                ledger.note("noted", "building outline kept where its parts leave a gap", one.id)
            below = _storeys_below(one.polygons, spans[i][0], [(outlines[p].polygons, spans[p]) for p in parts_of[i]])
            if below:
                ledger.note("repaired", "storeys below parts that would float, from the building's outline", one.id)
            prisms += [(i, polygon, ground + bottom, ground + top) for polygon, bottom, top in below]
        for member, polygons in [(i, remains)] + [(part, outlines[part].polygons) for part in parts_of.get(i, [])]:
            prisms += [(i, polygon, ground + spans[member][0], ground + spans[member][1]) for polygon in polygons]
    return _objects([one.id for one in outlines], prisms, ledger)


def _storeys_below(
    outline: tuple[Polygon, ...], base: float, parts: list[tuple[tuple[Polygon, ...], tuple[float, float]]]
) -> list[tuple[Polygon, float, float]]:
    """(polygon, bottom, top) of what a building needs below parts that stand on nothing; empty where few do.

    Mappers often draw upper storeys as parts (``building:min_level``) and leave those below to the outline. Where more
    than half of the outline would hang in the air, its storeys go on down to ``base``; less is taken for an overhang.
    """
    whole = shapely.union_all(list(outline))
    filled = shapely.union_all([polygon for polygons, (low, _) in parts if low <= base for polygon in polygons])
    below: list[tuple[Polygon, float, float]] = []
    for polygons, (low, _) in sorted(parts, key=lambda part: part[1]):
        if low > base:
            for polygon in polygons:
                hanging = polygon.intersection(whole).difference(filled)
                below += [(piece, base, low) for piece in solid_polygons(hanging)]
            filled = shapely.union_all([filled, *polygons])
    return below if sum(piece.area for piece, _, _ in below) > 0.5 * whole.area else []


def _clean(layer: BuildingLayer, shapes: NDArray[np.object_], ledger: Ledger) -> list[_Outline]:
    """The outlines that stand above the ground and are not too small."""
    standing: list[int] = []
    for i, item in enumerate(layer.items):
        reason = _not_standing(item)
        if reason is None:
            standing.append(i)
        else:
            ledger.note("left out", f"building: {reason}", item.id)
    ids = [layer.items[i].id for i in standing]
    outlines: list[_Outline] = []
    for i, polygons in zip(standing, clean_outlines(ids, shapes[standing], ledger), strict=True):
        item = layer.items[i]
        if polygons:
            heights = heights_from_tags(
                item.id, item.tags, ledger, height_label=layer.height_label, levels_label=layer.levels_label
            )
            is_part = "building" not in item.tags and is_yes(item.tags.get("building:part"))
            outlines.append(_Outline(item.id, polygons, heights, is_part))
    return outlines


def _not_standing(item: RawBuilding) -> str | None:
    """Why an outline is no building above the ground, or None."""
    kind = item.tags.get("building", "yes").lower()
    if kind in _UNBUILT or not is_yes(kind):
        return f"building={kind}"
    if item.tags.get("location", "").lower() == "underground" or is_yes(item.tags.get("underground")):
        return "underground"
    if re.fullmatch(r"-\d+(\.\d+)?", item.tags.get("layer", "")) and "height" not in item.tags:
        return "underground (negative layer, no height)"
    return None


def _without_twins(outlines: list[_Outline], ledger: Ledger) -> list[_Outline]:
    """Without outlines that repeat another one (a part may well repeat its building)."""
    spans = [(one.is_part, one.heights.bottom, one.heights.top if one.is_part else None) for one in outlines]
    twins = find_duplicates(
        [one.polygons for one in outlines], spans, [one.heights.top is not None for one in outlines]
    )
    for twin in sorted(twins):
        ledger.note("left out", "building: same outline as another", outlines[twin].id)
    return [one for i, one in enumerate(outlines) if i not in twins]


def _owners(outlines: Sequence[_Outline]) -> list[int]:
    """For each outline the index of the building that it is a part of: the one that covers most of it (half at least)."""
    owner = list(range(len(outlines)))
    parts = [i for i, one in enumerate(outlines) if one.is_part]
    buildings = [i for i, one in enumerate(outlines) if not one.is_part]
    if not parts or not buildings:
        return owner
    part_shapes = np.array([shapely.multipolygons(outlines[i].polygons) for i in parts], dtype=object)
    building_shapes = np.array([shapely.multipolygons(outlines[i].polygons) for i in buildings], dtype=object)
    for shape in (part_shapes, building_shapes):
        bad = ~shapely.is_valid(shape)  # two polygons of one outline may overlap
        shape[bad] = shapely.make_valid(shape[bad], method="structure", keep_collapsed=False)
    p, b = shapely.STRtree(building_shapes).query(part_shapes, predicate="intersects")
    share = shapely.area(shapely.intersection(part_shapes[p], building_shapes[b])) / shapely.area(part_shapes[p])
    best: dict[int, tuple[float, int]] = {}
    for part, building, covered in zip(p.tolist(), b.tolist(), np.round(share, 6).tolist(), strict=True):
        if covered >= _PART_SHARE and (covered, -building) > best.get(part, (0.0, 0)):
            best[part] = (covered, -building)
    for part, (_, building) in best.items():
        owner[parts[part]] = buildings[-building]
    return owner


def _tops(layer: BuildingLayer, outlines: list[_Outline], owner: list[int], ledger: Ledger) -> list[float]:
    """Height of every outline, metres: its own, its building's, the neighbours' median.

    Raises:
        CityError: nothing has a height.
    """
    xy = shapely.get_coordinates(shapely.centroid([shapely.multipolygons(one.polygons) for one in outlines]))
    known = np.array([one.heights.top is not None for one in outlines])
    if not known.any():
        looked = " and ".join(label for label in (layer.height_label, layer.levels_label) if label) or "any column"
        raise CityError(
            f"{layer.file}: none of {len(outlines)} buildings has a height: expected metres or levels, found nothing in "
            f"{looked}; name the column with --height-column or --levels-column, or use a file that has heights"
        )
    tops = np.array([one.heights.top if one.heights.top is not None else np.nan for one in outlines])
    # What floats high up says little about how high the houses around are.
    grounded = np.array([(one.heights.bottom or 0.0) < 2.5 for one in outlines])
    reference = known & grounded if (known & grounded).any() else known
    lonely = np.flatnonzero(~known)
    tops[lonely] = heights_from_neighbours(xy[lonely], xy[reference], tops[reference])
    if known.mean() < 0.1:
        ledger.warn(f"only {known.mean():.1%} of the buildings have a height: the others are guessed from them")
    for i in lonely.tolist():
        heights = outlines[i].heights
        if heights.open_roof:
            tops[i] = (heights.bottom or 0.0) + OPEN_ROOF_HEIGHT
            ledger.note("inferred", f"height of an open roof, taken as {OPEN_ROOF_HEIGHT:g} m", outlines[i].id)
        elif owner[i] != i:
            tops[i] = tops[owner[i]]
            ledger.note("inferred", "height of a part from its building", outlines[i].id)
        else:
            ledger.note("inferred", "height from the median of 8 neighbours", outlines[i].id)
    return [float(top) for top in tops]


def _objects(
    ids: Sequence[str], prisms: Sequence[tuple[int, Polygon, float, float]], ledger: Ledger
) -> tuple[CityObject, ...]:
    """Objects from (index of its outline, polygon, bottom, top), overlaps between objects cut away."""
    owners = np.array([prism[0] for prism in prisms], dtype=np.intp)
    bottoms, tops = np.array([prism[2] for prism in prisms]), np.array([prism[3] for prism in prisms])
    left, interleaved, cut = cut_overlaps([prism[1] for prism in prisms], bottoms, tops, owners)
    for a, b in interleaved:
        ledger.note(
            "noted", "overlap of buildings of different spans left as it is", f"{ids[owners[a]]} and {ids[owners[b]]}"
        )
    own: dict[int, list[Prism]] = {}
    was_cut: dict[int, bool] = {}
    for owner, polygons, bottom, top, is_cut in zip(
        owners.tolist(), left, bottoms.tolist(), tops.tolist(), cut, strict=True
    ):
        own.setdefault(owner, []).extend(Prism(polygon, bottom, top) for polygon in polygons)
        was_cut[owner] = was_cut.get(owner, False) or bool(is_cut)
    objects: list[CityObject] = []
    for owner, solids in sorted(own.items()):
        if not solids:
            ledger.note("left out", "building: inside another one", ids[owner])
            continue
        if was_cut[owner]:
            ledger.note("repaired", "overlap cut away from the lower building", ids[owner])
        objects.append(CityObject(ids[owner], tuple(solids)))
    return tuple(objects)


def merge_blocks(objects: Sequence[CityObject], ledger: Ledger) -> tuple[CityObject, ...]:
    """Touching buildings as one object: those that share at least 0.5 m of wall, gaps up to 0.1 m counting as shared.

    A block has the prisms of its members and the smallest of their ids (numbers compared as numbers).
    """
    shapes = np.array([one.footprint for one in objects], dtype=object)
    wide = shapely.buffer(shapes, _WALL_GAP, join_style="mitre")
    a, b = shapely.STRtree(shapes).query(shapes, predicate="dwithin", distance=_WALL_GAP)
    a, b = a[a < b], b[a < b]
    wall = shapely.length(shapely.intersection(shapely.boundary(shapes[a]), wide[b]))
    touching = nx.Graph()
    touching.add_nodes_from(range(len(objects)))
    touching.add_edges_from(zip(a[wall >= _SHARED_WALL].tolist(), b[wall >= _SHARED_WALL].tolist(), strict=True))
    blocks: list[CityObject] = []
    for members in sorted(sorted(one) for one in nx.connected_components(touching)):
        if len(members) == 1:
            blocks.append(objects[members[0]])
            continue
        id_ = min((objects[i].id for i in members), key=_natural)
        ledger.note("kept", "buildings merged into blocks", id_, count=len(members))
        blocks.append(CityObject(id_, tuple(prism for i in members for prism in objects[i].prisms)))
    return tuple(blocks)


def _natural(id_: str) -> tuple[tuple[Literal[0, 1], int, str], ...]:
    """Sort key under which way/9 comes before way/10."""
    return tuple(
        (0, int(piece), "") if piece.isdecimal() else (1, 0, piece) for piece in re.split(r"(\d+)", id_) if piece
    )
