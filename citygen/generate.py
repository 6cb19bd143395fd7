"""From a name and a seed to a city, stage by stage: ground, streets, blocks, buildings, landmarks, objects.

Each stage draws from random numbers of its own, so that a change of one leaves the others' choices alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import networkx as nx
import numpy as np
import shapely
from numpy.typing import NDArray

from citygen import presets
from citygen.buildings.development import Buildings, Custom, develop, join_buildings, keep_buildings
from citygen.buildings.objects import Site, make_objects, site_of, triangle_count
from citygen.metropolis import metropolis
from citygen.shapes.textures import city_textures
from citygen.streets.blocks import carve_blocks
from citygen.streets.networks import Network, faces, manhattan_network, street_graph
from citygen.streets.relief import Hill, contour_field, ground_under, make_terrain
from citygen.streets.subdivision import subdivide
from mmi.city.model import City, CityObject
from mmi.city.terrain import Terrain
from mmi.foundation.errors import ParameterError

__all__ = ["generate", "steepen"]

_MODEL_TRIANGLES = 143_500
_Progress = Callable[[int, int, str], None]


def generate(
    preset: str,
    seed: int = 0,
    *,
    detail: int | None = None,
    buildings: int | None = None,
    progress: _Progress = lambda _done, _total, _what: None,
) -> City:
    """The city ``preset`` (of ``citygen.presets.PRESETS``) grown from ``seed``.

    ``detail`` of houses, 0 (prisms) to 3, by default the preset's; ``buildings`` only for ``metropolis``. ``progress`` is
    called with objects done, objects in all, and what is being done.

    Raises:
        ParameterError: an unknown preset, a detail or number out of range.
    """
    known = presets.PRESETS.get(preset)
    if known is None:
        raise ParameterError(f"a preset of {', '.join(presets.PRESETS)} expected, found {preset!r}")
    if seed < 0:
        raise ParameterError(f"seed: a whole number of at least 0 expected, found {seed}")
    if detail is not None and detail not in range(4):
        raise ParameterError(f"detail: 0 to 3 expected, found {detail}")
    if buildings is not None and not known.counted:
        raise ParameterError(f"buildings: only metropolis takes a number of buildings, not {preset}")
    detail = known.detail if detail is None else detail
    if preset == "metropolis":
        whole = metropolis(seed, buildings=buildings or 10_000, detail=detail or 0)
        objects: list[CityObject] = []
        for district in whole.districts:
            objects += district
            progress(len(objects), whole.buildings, "building")
        return _city(preset, tuple(objects), whole.streets, None, seed)
    if preset in {"forest", "living-room", "pipes"}:
        return _elsewhere(preset, seed)
    town = _TOWNS["radial" if preset == "traffic" else preset](seed)
    objects = _objects(town, detail, seed, progress)
    return _city(preset, tuple(objects), street_graph(town.network), town.terrain, seed)


def _city(
    source: str,
    objects: tuple[CityObject, ...],
    streets: nx.MultiGraph,
    terrain: Terrain | None,
    seed: int,
) -> City:
    bare = all(one.mesh is None for one in objects)
    return City(
        objects,
        streets,
        "local",
        (0.0, 0.0, 0.0),
        source,
        terrain=terrain,
        textures=() if bare else city_textures(seed),
    )


def _elsewhere(preset: str, seed: int) -> City:
    if preset == "forest":
        from citygen.scenes.forest import forest

        return forest(seed)
    if preset == "pipes":
        from citygen.scenes.pipes import pipes

        return pipes(seed)
    from citygen.scenes.living_room import living_room

    return living_room(seed)


# ------------------------------------------------------------------------------------------------------------ towns


@dataclass(frozen=True, slots=True, eq=False)
class _Town:
    """A town before its houses are built. ``church``: where one stands (x, y), its height and heading, or None.

    ``triangles``: how many the town should have if no detail is asked for.
    """

    network: Network
    buildings: Buildings
    terrain: Terrain | None
    church: tuple[tuple[float, float], float, float] | None = None
    triangles: int | None = None


def _stages(seed: int) -> list[np.random.Generator]:
    """Random numbers for relief, streets, land."""
    return [np.random.default_rng(one) for one in np.random.SeedSequence(seed).spawn(3)]


def _montmartre(seed: int) -> _Town:
    relief_rng, street_rng, land_rng = _stages(seed)
    top = (float(relief_rng.uniform(-60.0, 60.0)), float(relief_rng.uniform(20.0, 110.0)))
    hills = (
        Hill(top, 72.0, (310.0, 190.0), float(relief_rng.uniform(-0.3, 0.3))),
        Hill((top[0] - 260.0, top[1] + 30.0), 18.0, (160.0, 130.0)),
    )
    terrain = make_terrain((-760.0, -760.0, 760.0, 760.0), hills, relief_rng, roughness=5.0)
    network = subdivide(
        _outline(570.0, street_rng, wave=0.06),
        contour_field(terrain, plain=float(street_rng.uniform(-0.2, 0.2)), slope=0.07),
        street_rng,
        blocks=146,
        junctions=427,
        stubs=42,
        ranks=presets.LANES,
        kept_free=((*top, 52.0),),
        density=lambda p: 1.0 + 0.7 * float(np.exp(-0.5 * ((p[0] - top[0]) ** 2 + (p[1] - top[1]) ** 2) / 240.0**2)),
    )
    network = steepen(network, terrain)
    areas = faces(network)
    blocks, owners = carve_blocks(areas, network, pavement=1.8)
    high = terrain.at(shapely.get_coordinates(shapely.centroid(blocks))) > 0.55 * terrain.heights.max()
    built = _by_zone(blocks, [(presets.HILL_TOWN, high), (presets.PARIS, ~high)], land_rng)
    square = int(np.argmax(shapely.contains_xy(areas, *top)))
    built = keep_buildings(built, owners[built.blocks] != square)
    centre = shapely.maximum_inscribed_circle(blocks[owners == square][0]).coords[0]
    return _Town(network, built, terrain, (centre, 78.0, 0.5 * np.pi), _MODEL_TRIANGLES)


def _radial(seed: int) -> _Town:
    relief_rng, street_rng, land_rng = _stages(seed)
    terrain = make_terrain((-800.0, -800.0, 800.0, 800.0), (), relief_rng, roughness=7.0)

    plain = float(street_rng.uniform(0.0, 0.5 * np.pi))

    def field(points: NDArray[np.float64]) -> NDArray[np.float64]:
        """A grid in the middle, rings and rays around it, with a slow wobble farther out."""
        x, y = points.T
        r = np.hypot(x, y)
        cross = (r / 130.0) ** 2 * np.exp(4j * np.arctan2(y, x)) + np.exp(4j * plain)
        wobble = 0.25 * np.sin(x / 140.0) * np.cos(y / 170.0) * np.minimum(r / 400.0, 1.0)
        return np.asarray(np.angle(cross) / 4.0 + wobble)

    network = subdivide(
        _outline(640.0, street_rng, wave=0.03),
        field,
        street_rng,
        blocks=170,
        stubs=30,
        ranks=presets.LANES,
        kept_free=((0.0, 0.0, 58.0),),
        density=lambda p: 1.0 + 1.6 * float(np.exp(-0.5 * (p[0] ** 2 + p[1] ** 2) / 260.0**2)),
    )
    areas = faces(network)
    blocks, owners = carve_blocks(areas, network, pavement=2.0)
    distance = shapely.distance(blocks, shapely.Point(0.0, 0.0))
    old, outer = distance < 280.0, distance > 470.0
    zones = [(presets.OLD_TOWN, old), (presets.PARIS, ~old & ~outer), (presets.ROWS, outer)]
    built = _by_zone(blocks, zones, land_rng)
    square = int(np.argmax(shapely.contains_xy(areas, 0.0, 0.0)))
    built = keep_buildings(built, owners[built.blocks] != square)
    centre = shapely.maximum_inscribed_circle(blocks[owners == square][0]).coords[0]
    return _Town(network, built, terrain, (centre, 62.0, 0.0))


def _hamlet(seed: int) -> _Town:
    relief_rng, street_rng, land_rng = _stages(seed)
    terrain = make_terrain((-160.0, -140.0, 160.0, 140.0), (), relief_rng, roughness=12.0)
    network = subdivide(
        _outline(84.0, street_rng, wave=0.04) * (1.15, 0.85),
        contour_field(terrain, plain=0.2, slope=0.4),
        street_rng,
        blocks=3,
        stubs=3,
        ranks=presets.COUNTRY,
    )
    blocks, _ = carve_blocks(faces(network), network, pavement=1.0)
    built = develop(blocks, presets.COTTAGES, land_rng)
    # The dozen nearest to the middle.
    distance = shapely.distance(built.footprints, shapely.Point(0.0, 0.0))
    kept = np.zeros(len(distance), dtype=bool)
    kept[np.argsort(distance, kind="stable")[:12]] = True
    return _Town(network, keep_buildings(built, kept), terrain)


def _manhattan(seed: int) -> _Town:
    _, street_rng, land_rng = _stages(seed)
    network = manhattan_network(street_rng)
    areas = faces(network)
    park = int(np.argmax(shapely.area(areas)))
    blocks, owners = carve_blocks(areas, network, pavement=4.0)
    middle = shapely.distance(blocks, shapely.Point(land_rng.uniform(-250.0, 0.0), land_rng.uniform(-250.0, 0.0)))
    tall = (middle < 520.0) & (owners != park)
    other = ~tall & (owners != park)
    return _Town(network, _by_zone(blocks, [(presets.MIDTOWN, tall), (presets.UPTOWN, other)], land_rng), None)


_TOWNS = MappingProxyType(
    {"montmartre": _montmartre, "radial": _radial, "hamlet": _hamlet, "manhattan": _manhattan},
)


def _outline(radius: float, rng: np.random.Generator, *, wave: float) -> NDArray[np.float64]:
    """(n, 2) a rounded boundary, counter-clockwise, about the origin."""
    a = np.linspace(0.0, 2.0 * np.pi, 44, endpoint=False)
    phases = rng.uniform(0.0, 2.0 * np.pi, 3)
    r = np.full_like(a, radius)
    for k, phase in enumerate(phases, start=1):
        r += radius * wave / k * np.sin((k + 1) * a + phase)
    return np.stack([r * np.cos(a), r * np.sin(a)], axis=1)


def _by_zone(
    blocks: NDArray[np.object_], zones: Sequence[tuple[Custom, NDArray[np.bool_]]], rng: np.random.Generator
) -> Buildings:
    """Buildings on blocks (b,), each built by the custom of the zone that it is in."""
    return join_buildings(
        [
            (develop(blocks[inside], custom, zone_rng), np.flatnonzero(inside))
            for (custom, inside), zone_rng in zip(zones, rng.spawn(len(zones)), strict=True)
        ]
    )


def steepen(network: Network, terrain: Terrain, *, limit: float = 0.13) -> Network:
    """The network with stairs where a street of the lower ranks climbs more than ``limit`` (rise over run) on its way."""
    first, last = (terrain.at(network.nodes[network.ends[:, k]]) for k in (0, 1))
    steep = np.abs(last - first) > limit * shapely.length(network.lines)
    steep &= np.isin(network.kinds, ["residential", "living_street", "service"])
    return replace(
        network,
        kinds=np.where(steep, "steps", network.kinds),
        half_widths=np.where(steep, np.minimum(network.half_widths, 2.2), network.half_widths),
    )


# ----------------------------------------------------------------------------------------------------------- objects


def _objects(town: _Town, detail: int | None, seed: int, progress: _Progress) -> list[CityObject]:
    """The church, and the houses at one detail, or at details that together make the town's number of triangles."""
    objects: list[CityObject] = []
    if town.church is not None:
        objects.append(_church(town, 1 if detail is None else detail, seed))
    n = len(town.buildings.footprints)
    site = site_of(town.buildings, town.terrain, meshed=detail != 0)
    details = [1 if detail is None else detail] * n
    for start in range(0, n, _CHUNK):
        part = range(start, min(start + _CHUNK, n))
        objects += make_objects(site, details=details, seed=seed, only=part)
        progress(part.stop, n, "building")
    if detail is None and town.triangles is not None:
        _refine(objects, town, site, seed, progress)
    return objects


_CHUNK = 256
"""Buildings between two reports of progress."""
_FEW = 16
"""Buildings that are refined at a time."""
_CLOSE = 0.01
"""Share of a town's number of triangles that may be missing."""


def _church(town: _Town, detail: int, seed: int) -> CityObject:
    from citygen.buildings.church import church

    assert town.church is not None
    (x, y), height, heading = town.church
    ground, _ = ground_under(town.terrain, np.array([shapely.Point(x, y).buffer(36.0)]))
    rng = np.random.default_rng((seed, 5))
    return church("church", (x, y), base=float(ground[0]), height=height, heading=heading, detail=detail, rng=rng)


def _refine(objects: list[CityObject], town: _Town, site: Site, seed: int, progress: _Progress) -> None:
    """Replace houses by more detailed ones, those around the church first, until the town has its number of triangles."""
    assert town.triangles is not None and town.church is not None
    missing = town.triangles - sum(map(triangle_count, objects))
    n = len(town.buildings.footprints)
    order = np.argsort(shapely.distance(town.buildings.footprints, shapely.Point(town.church[0])), kind="stable")
    for level in (2, 3):
        for start in range(0, n, _FEW):
            some = order[start : start + _FEW].tolist()
            better = make_objects(site, details=[level] * n, seed=seed, only=some)
            for i, one in zip(some, better, strict=True):
                more = triangle_count(one) - triangle_count(objects[1 + i])
                if more <= missing:
                    objects[1 + i] = one
                    missing -= more
            progress(start + len(some), n, f"detail {level}")
            if missing < _CLOSE * town.triangles:
                return
