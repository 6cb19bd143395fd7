"""From buildings as arrays to the objects of a city: each on its ground, as a prism or as a house in the detail asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from citygen.buildings.development import Buildings
from citygen.buildings.houses import house
from citygen.streets.relief import ground_under
from mmi.city.model import CityObject, Prism
from mmi.city.terrain import Terrain
from mmi.reading.models.raw_meshes import joined_meshes

__all__ = ["Site", "make_objects", "party_walls", "site_of", "triangle_count"]


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """Buildings on their ground: ``base`` and ``eaves`` of each, ``tops`` of all tiers, metres; tiers ``first_tier[i]`` to
    ``first_tier[i + 1]`` are those of building i. ``walls`` are the :func:`party_walls`, empty where only prisms are wanted.
    """

    buildings: Buildings
    base: tuple[float, ...]
    eaves: tuple[float, ...]
    tops: tuple[float, ...]
    first_tier: tuple[int, ...]
    walls: Sequence[Sequence[bool]]


def site_of(buildings: Buildings, terrain: Terrain | None, *, meshed: bool) -> Site:
    """The buildings set on the ground; ``meshed`` says that they will be built in more detail than prisms."""
    low, high = ground_under(terrain, buildings.footprints)
    tiers = np.searchsorted(buildings.tier_owners, np.arange(len(low) + 1))
    heights = (low, high + buildings.heights, buildings.tier_heights + high[buildings.tier_owners])
    base, eaves, tops = (tuple(np.round(one, 3).tolist()) for one in heights)
    walls = party_walls(buildings.footprints) if meshed else ()
    return Site(buildings, base, eaves, tops, tuple(tiers.tolist()), walls)


def make_objects(
    site: Site,
    *,
    details: Sequence[int],
    seed: int,
    first: int = 0,
    only: Sequence[int] | None = None,
) -> list[CityObject]:
    """The buildings (or those of the places ``only``) as objects ``building/<first + place>``, in ``details`` (n,) of 0 to 3.

    What is left to chance in a house depends on ``seed`` and its number alone.
    """
    buildings, base, eaves, tops, tiers = site.buildings, site.base, site.eaves, site.tops, site.first_tier
    places = range(len(eaves)) if only is None else only
    parts: list[tuple[int, shapely.Polygon, float]] = []  # of those without detail: place, footprint, top
    for i in places:
        if details[i] == 0:
            parts.append((i, buildings.footprints[i], eaves[i]))
            parts += [(i, buildings.tiers[k], tops[k]) for k in range(tiers[i], tiers[i + 1])]
    solids: dict[int, list[Prism]] = {i: [] for i, _, _ in parts}
    prisms = Prism.each([one for _, one, _ in parts], [base[i] for i, _, _ in parts], [top for _, _, top in parts])
    for (i, _, _), prism in zip(parts, prisms, strict=True):
        solids[i].append(prism)
    objects: list[CityObject] = []
    for i in places:
        name, footprint = f"building/{first + i}", buildings.footprints[i]
        upper = range(tiers[i], tiers[i + 1])
        if details[i] == 0:
            objects.append(CityObject(name, tuple(solids[i])))
            continue
        style, roof = str(buildings.styles[i]), str(buildings.roofs[i])
        rng = np.random.default_rng((seed, 4, first + i))
        storeys = [
            house(
                name,
                footprint,
                base=base[i],
                eaves=eaves[i],
                style=style,
                roof="flat" if upper else roof,
                detail=details[i],
                rng=rng,
                blind=site.walls[i],
            )
        ]
        below = eaves[i]
        for k in upper:
            storeys.append(
                house(
                    name,
                    buildings.tiers[k],
                    base=below,
                    eaves=tops[k],
                    style=style,
                    roof=roof,
                    detail=details[i],
                    rng=rng,
                )
            )
            below = tops[k]
        objects.append(storeys[0] if len(storeys) == 1 else _stacked(name, storeys))
    return objects


def party_walls(footprints: NDArray[np.object_]) -> list[list[bool]]:
    """For each footprint, which edges of its outer ring another has, too, the other way round."""
    xy, owner = shapely.get_coordinates(shapely.get_exterior_ring(footprints), return_index=True)
    starts = np.flatnonzero(np.diff(owner) == 0)
    _, names = np.unique(np.round(1000.0 * xy) @ np.array([1.0, 1j]), return_inverse=True)
    a, b = names[starts].astype(np.int64), names[starts + 1].astype(np.int64)
    shared = np.isin(a * len(xy) + b, b * len(xy) + a)
    limits = np.searchsorted(owner[starts], np.arange(1, len(footprints)))
    return [part.tolist() for part in np.split(shared, limits)]


def triangle_count(one: CityObject) -> int:
    """Triangles of an object's mesh; of its prisms, walls and lids, if it has none."""
    if one.mesh is not None:
        return len(one.mesh.triangles)
    total = 0
    for prism in one.prisms:
        corners = int(shapely.get_num_coordinates(prism.footprint)) - 1 - len(prism.footprint.interiors)
        total += 2 * corners + 2 * (corners - 2 + 2 * len(prism.footprint.interiors))
    return total


def _stacked(name: str, storeys: Sequence[CityObject]) -> CityObject:
    """One object of houses on top of each other. Cores go down to the ground: those above stand within those below."""
    meshes = [one.mesh for one in storeys if one.mesh is not None]
    base = storeys[0].base
    prisms = tuple(prism for one in storeys for prism in one.prisms)
    core = tuple(replace(prism, bottom=base) for one in storeys for prism in one.occluders)
    return CityObject(name, prisms, joined_meshes(meshes), core)
