"""What a cell may cost: budgets of layers, triangles and bytes, and cells cut in halves until they keep them.

The error is never traded: a shorter cell has less parallax, so fewer objects stay geometry, fewer layers keep the bound, and
texels need to be less fine. A cell that costs more than the user allows is therefore cut in the middle of its axis, and its
halves again, down to ``SHORTEST``. Halves of ``0017-00`` are ``0017-00a`` and ``0017-00b``.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, product

from mmi.cells.viewing_cells import ViewingCell
from mmi.dataset.manifest import CellEntry
from mmi.planning.parameters import BuildParameters

__all__ = ["SHORTEST", "exceeded", "halves", "whole_of", "with_halves_joined"]

SHORTEST = 5.0
"""Metres: cells are not cut into shorter ones."""
_MEETING = 1e-3
"""Metres: ends of cells this close to each other are as close as the closest."""


def exceeded(
    parameters: BuildParameters, *, layers: int, triangles: int = 0, stored_bytes: int = 0
) -> dict[str, tuple[int, int]]:
    """The budgets that a cell exceeds: name -> (what it costs, what it may cost)."""
    costs = (
        ("layers", layers, parameters.max_layers),
        ("triangles", triangles, parameters.max_triangles),
        ("bytes", stored_bytes, parameters.max_bytes),
    )
    return {name: (cost, limit) for name, cost, limit in costs if limit is not None and cost > limit}


def halves(cell: ViewingCell) -> tuple[ViewingCell, ViewingCell] | None:
    """The two halves of a cell; None where they would be too short."""
    if cell.length < 2.0 * SHORTEST:
        return None
    return cell.part(0.0, 0.5, f"{cell.id}a"), cell.part(0.5, 1.0, f"{cell.id}b")


def whole_of(cell: str) -> str:
    """The id of the cell that a half, a quarter, ... was cut from; its own where it is whole."""
    return cell.rstrip("ab")


def with_halves_joined(entries: Sequence[CellEntry]) -> list[CellEntry]:
    """The manifest's ``entries`` of cells with their neighbours as they are after cells were cut.

    Entries name the neighbours that whole cells have. Of two neighbours, the parts that meet are neighbours; of one
    cell's parts, those that follow each other.
    """
    parts: dict[str, list[CellEntry]] = defaultdict(list)
    for entry in entries:
        parts[whole_of(entry.id)].append(entry)
    if len(parts) == len(entries):
        return list(entries)
    joined: dict[str, set[str]] = {entry.id: set() for entry in entries}
    for whole, own in parts.items():
        for one, other in combinations(own, 2):
            if _gap(one, other) <= _MEETING:
                joined[one.id].add(other.id)
                joined[other.id].add(one.id)
        for neighbour in own[0].neighbours:
            if neighbour not in parts:
                for one in own:  # not built: whoever builds it finds it named
                    joined[one.id].add(neighbour)
                continue
            pairs = list(product(own, parts[neighbour]))
            closest = min(_gap(one, other) for one, other in pairs)
            for one, other in pairs:
                if _gap(one, other) <= closest + _MEETING and whole != neighbour:
                    joined[one.id].add(other.id)
    return [replace(entry, neighbours=tuple(sorted(joined[entry.id]))) for entry in entries]


def _gap(one: CellEntry, other: CellEntry) -> float:
    """Metres between the closest ends of two cells' axes."""
    return min(math.dist(a, b) for a, b in product(one.axis, other.axis))
