"""A city of any size, a district at a time: downtown in the middle, courtyards around, rows of houses, suburbs.

Streets are made for the whole city at once; buildings only when their district is asked for, so that a city of a million
buildings can go to a file without ever being in memory.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import networkx as nx
import numpy as np
import shapely
from numpy.typing import NDArray

from citygen import presets
from citygen.buildings.development import Buildings, Custom, develop, join_buildings
from citygen.buildings.objects import make_objects, site_of
from citygen.streets.blocks import carve_blocks
from citygen.streets.networks import Network, faces, lattice_network, street_graph
from mmi.city.model import CityObject
from mmi.foundation.errors import ParameterError

__all__ = ["Metropolis", "metropolis"]

_ZONES: tuple[tuple[float, Custom], ...] = (
    (0.22, presets.DOWNTOWN),
    (0.58, presets.PARIS),
    (0.82, presets.ROWS),
    (1.0, presets.SUBURB),
)
"""Customs, and how far out they reach: shares of the city's radius."""
_PER_BLOCK = 14.6
"""Buildings on a block, on average over the city: a little less than the true number, so that there are enough blocks."""
_DISTRICT = 64
"""Blocks that are built at a time."""
_LEAST, _MOST = 1_000, 1_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Metropolis:
    """``buildings`` in all, in ``districts`` (iterable once), and the ``blocks`` they stand on."""

    streets: nx.MultiGraph
    blocks: int
    buildings: int
    districts: Iterator[list[CityObject]]


def metropolis(seed: int, *, buildings: int, detail: int) -> Metropolis:
    """A city of exactly ``buildings`` buildings, 1,000 to 1,000,000, from the middle outwards.

    Raises:
        ParameterError: another number.
    """
    if not _LEAST <= buildings <= _MOST:
        raise ParameterError(f"buildings: {_LEAST} to {_MOST} expected, found {buildings}")
    street_seed, land_seed = np.random.SeedSequence(seed).spawn(2)
    count = buildings / _PER_BLOCK + 12.0
    rows = max(4, math.ceil(math.sqrt(count * 118.0 / 84.0)))
    columns = max(3, math.ceil(count / rows))
    network = lattice_network(np.random.default_rng(street_seed), columns=columns, rows=rows)
    areas = faces(network)
    order, zones = _from_the_middle(areas)
    areas = areas[order]
    districts = _districts(areas, zones, network, land_seed, buildings=buildings, detail=detail, seed=seed)
    return Metropolis(street_graph(network), len(areas), buildings, districts)


def _from_the_middle(areas: NDArray[np.object_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """An order of faces (f,) in rings about the middle, and for each in that order its zone."""
    xy = shapely.get_coordinates(shapely.centroid(areas))
    xy = xy - 0.5 * (xy.min(axis=0) + xy.max(axis=0))
    # Distance as a share of that to the border, between a circle's and a square's.
    share = (np.abs(xy / np.abs(xy).max(axis=0)) ** 2.6).sum(axis=1) ** (1.0 / 2.6)
    ring = np.floor(np.hypot(*xy.T) / 500.0)
    order = np.lexsort((np.arctan2(xy[:, 1], xy[:, 0]), ring))
    zones = np.searchsorted([reach for reach, _ in _ZONES[:-1]], share[order], side="right")
    return order, zones


def _districts(
    areas: NDArray[np.object_],
    zones: NDArray[np.int64],
    network: Network,
    land_seed: np.random.SeedSequence,
    *,
    buildings: int,
    detail: int,
    seed: int,
) -> Iterator[list[CityObject]]:
    """Objects of district after district until there are ``buildings``."""
    blocks, owners = carve_blocks(areas, network, pavement=2.5)
    zones = zones[owners]
    starts = range(0, len(blocks), _DISTRICT)
    done = 0
    for start, own in zip(starts, land_seed.spawn(len(starts)), strict=True):
        part = slice(start, start + _DISTRICT)
        built = _district(blocks[part], zones[part], np.random.default_rng(own))
        n = min(len(built.footprints), buildings - done)
        yield make_objects(
            site_of(built, None, meshed=detail > 0), details=[detail] * n, seed=seed, first=done, only=range(n)
        )
        done += n
        if done == buildings:
            return
    raise ParameterError(f"buildings: room for {buildings} expected, found {done}; try another seed")


def _district(blocks: NDArray[np.object_], zones: NDArray[np.int64], rng: np.random.Generator) -> Buildings:
    """Buildings on some blocks, by the customs of the zones that they are in."""
    return join_buildings(
        [
            (develop(blocks[zones == zone], custom, zone_rng), np.flatnonzero(zones == zone))
            for (zone, (_, custom)), zone_rng in zip(enumerate(_ZONES), rng.spawn(len(_ZONES)), strict=True)
            if (zones == zone).any()
        ]
    )
