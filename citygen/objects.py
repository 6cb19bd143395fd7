"""From buildings as arrays to the objects of a city: each on its ground, as a prism or as a house in the detail asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely
from numpy.typing import NDArray

from citygen.buildings import Buildings
from citygen.houses import house
from citygen.relief import ground_under
from mmi.city import CityObject, Prism, TriangleMesh
from mmi.terrain import Terrain

__all__ = ["make_objects", "party_walls", "triangle_count"]


def make_objects(
    buildings: Buildings,
    terrain: Terrain | None,
    *,
    details: Sequence[int],
    seed: int,
    first: int = 0,
    only: Sequence[int] | None = None,
) -> list[CityObject]:
    """The buildings (or those of the places ``only``) as objects ``building/<first + place>``, in ``details`` (n,) of 0 to 3.

    What is left to chance in a house depends on ``seed`` and its number alone.
    """
    low, high = ground_under(terrain, buildings.footprints)
    eaves = np.round(high + buildings.heights, 3).tolist()
    tiers = np.searchsorted(buildings.tier_owners, np.arange(len(eaves) + 1)).tolist()
    base = np.round(low, 3).tolist()
    tops = np.round(buildings.tier_heights + high[buildings.tier_owners], 3).tolist()
    walls: list[list[bool]] | None = None
    objects: list[CityObject] = []
    for i in range(len(eaves)) if only is None else only:
        name, footprint = f"building/{first + i}", buildings.footprints[i]
        upper = range(tiers[i], tiers[i + 1])
        if details[i] == 0:
            tiered = (Prism(buildings.tiers[k], base[i], tops[k]) for k in upper)
            objects.append(CityObject(name, (Prism(footprint, base[i], eaves[i]), *tiered)))
            continue
        if walls is None:
            walls = party_walls(buildings.footprints)
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
                blind=walls[i],
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
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    mesh = TriangleMesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.triangles + offset for mesh, offset in zip(meshes, offsets, strict=True)]),
        np.concatenate([mesh.textures for mesh in meshes]),
        np.concatenate([mesh.colors for mesh in meshes]),
        np.concatenate([mesh.uv for mesh in meshes]),
    )
    prisms = tuple(prism for one in storeys for prism in one.prisms)
    core = tuple(replace(prism, bottom=base) for one in storeys for prism in one.occluders)
    return CityObject(name, prisms, mesh, core)
