"""Mending outlines where that is unambiguous: invalid rings, slivers, duplicates, overlaps.

All functions take and give geometry in metres. What cannot be decided is left as it is and noted.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon
from shapely.geometry.base import BaseGeometry

from mmi.reading.maps.crossings import Tangles
from mmi.reading.report import Ledger

__all__ = ["SLIVER_AREA", "clean_outlines", "cut_overlaps", "find_duplicates", "solid_polygons"]

SLIVER_AREA = 1.0
"""Outlines below this are left out, m2."""

_SLIVER_WIDTH = 0.1
_OVERLAP_AREA = 0.05
_SAME_PLACE = 0.01
_FEW = 1000
"""Points of an outline with which it takes 30 ms at most to tell whether it is valid, however it runs."""


def solid_polygons(geometry: BaseGeometry) -> list[Polygon]:
    """The polygons in ``geometry`` that are at least 1 m2 in area and 0.1 m in mean width, in their order."""
    return [
        part
        for part in _polygons(geometry)
        if part.area >= SLIVER_AREA and 2.0 * part.area >= _SLIVER_WIDTH * part.exterior.length
    ]


def _polygons(geometry: BaseGeometry) -> list[Polygon]:
    """Every polygon in a geometry, however deep in collections."""
    if isinstance(geometry, Polygon):
        return [] if geometry.is_empty else [geometry]
    parts = getattr(geometry, "geoms", ())
    return [polygon for part in parts for polygon in _polygons(part)]


def clean_outlines(ids: Sequence[str], outlines: NDArray[np.object_], ledger: Ledger) -> list[tuple[Polygon, ...]]:
    """The valid polygons of each outline, none where nothing of substance is left (counted with the reason).

    Repeated points go; invalid polygons are rebuilt by ``make_valid`` (holes are cut out, overlapping parts united, spikes
    dropped); pieces that are slivers go. An outline that is too intricate for that is left out (``Tangles``).
    """
    lean = shapely.remove_repeated_points(outlines, tolerance=0.0)
    points = shapely.get_num_coordinates(lean)
    thinner = points < shapely.get_num_coordinates(outlines)
    sound = points <= _FEW
    sound[sound] = shapely.is_valid(lean[sound])
    tangles = Tangles()
    cleaned: list[tuple[Polygon, ...]] = []
    for id_, outline, is_valid, is_thinner in zip(ids, lean, sound, thinner, strict=True):
        if is_thinner:
            ledger.note("repaired", "repeated points removed", id_)
        why = None if is_valid else tangles.why(outline)
        if why is not None:
            ledger.note("left out", f"building: {why}", id_)
            cleaned.append(())
            continue
        if not (is_valid or outline.is_valid):
            outline = shapely.make_valid(outline, method="structure", keep_collapsed=False)
            ledger.note("repaired", "invalid outline rebuilt", id_)
        every = _polygons(outline)
        solid = solid_polygons(outline)
        if not solid:
            ledger.note("left out", f"building: sliver under {SLIVER_AREA:g} m2 or {_SLIVER_WIDTH:g} m wide", id_)
        elif len(solid) < len(every):
            ledger.note("repaired", "slivers of an outline dropped", id_, count=len(every) - len(solid))
        cleaned.append(tuple(solid))
    return cleaned


def find_duplicates(
    outlines: Sequence[Sequence[Polygon]], spans: Sequence[tuple[object, ...]], known: Sequence[bool]
) -> dict[int, int]:
    """Outlines that repeat another one to the centimetre and have the same ``spans`` entry: index -> index of the one kept.

    The first with a ``known`` height is kept, else the first.
    """
    groups: dict[tuple[object, ...], list[int]] = {}
    for i, polygons in enumerate(outlines):
        if polygons:
            snapped = shapely.transform(shapely.multipolygons(polygons), lambda xy: np.round(xy / _SAME_PLACE) + 0.0)
            groups.setdefault((shapely.to_wkb(snapped.normalize()), spans[i]), []).append(i)
    twins: dict[int, int] = {}
    for members in groups.values():
        kept = next((i for i in members if known[i]), members[0])
        twins.update((i, kept) for i in members if i != kept)
    return twins


def cut_overlaps(
    polygons: Sequence[Polygon], bottoms: NDArray[np.float64], tops: NDArray[np.float64], owners: NDArray[np.intp]
) -> tuple[list[list[Polygon]], list[tuple[int, int]], NDArray[np.bool_]]:
    """Take from each prism what lies inside prisms of other owners that reach at least as low and as high.

    The solid that the prisms fill together stays the same (slivers aside), so this is safe. Of two prisms of the same
    span the later gives way. n prisms: ``polygons``, ``bottoms`` (n,), ``tops`` (n,), ``owners`` (n,) indices of objects.

    Returns:
        What is left of each prism; the pairs (i < j) that overlap in plan and in height with neither inside the other's span,
        which stay as they are; which prisms were cut (n,).
    """
    shapes = np.asarray(polygons, dtype=object)
    first, second = shapely.STRtree(shapes).query(shapes, predicate="intersects")
    once = (first < second) & (owners[first] != owners[second])
    once &= (bottoms[first] < tops[second]) & (bottoms[second] < tops[first])
    order = np.lexsort((second[once], first[once]))
    a, b = first[once][order], second[once][order]
    shared = shapely.area(shapely.intersection(shapes[a], shapes[b]))
    a, b = a[shared > _OVERLAP_AREA], b[shared > _OVERLAP_AREA]
    a_holds_b = (bottoms[a] <= bottoms[b]) & (tops[a] >= tops[b])
    b_holds_a = (bottoms[b] <= bottoms[a]) & (tops[b] >= tops[a]) & ~a_holds_b
    cutters: dict[int, list[int]] = {}
    for inner, outer in zip(
        np.concatenate([b[a_holds_b], a[b_holds_a]]), np.concatenate([a[a_holds_b], b[b_holds_a]]), strict=True
    ):
        cutters.setdefault(int(inner), []).append(int(outer))
    left = [[polygon] for polygon in polygons]
    cut = np.zeros(len(shapes), dtype=np.bool_)
    for inner, outers in sorted(cutters.items()):
        left[inner] = solid_polygons(shapes[inner].difference(shapely.union_all(shapes[sorted(outers)])))
        cut[inner] = True
    neither = ~a_holds_b & ~b_holds_a
    return left, list(zip(a[neither].tolist(), b[neither].tolist(), strict=True)), cut
