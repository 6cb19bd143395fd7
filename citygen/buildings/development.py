"""What stands on blocks: footprints, storeys and looks, by the customs of a quarter; whole arrays of buildings at a time.

Three customs: houses round the edge of a block with courtyards behind (Europe), towers that step back above a podium
(Manhattan), and detached houses in gardens.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from citygen.streets.blocks import chamfer, cut_lots, grow, subtract_cores, weld
from citygen.streets.ragged import oriented_boxes
from mmi.foundation.errors import CityError

__all__ = ["Buildings", "Custom", "develop", "join_buildings", "keep_buildings"]

_GROUND_FLOOR = 0.9
"""Metres that the lowest storey is higher than the others."""
_THINNEST = 1.7
"""Metres of area over length of outline: a piece of land with less carries no building (such as a strip 3.4 m wide)."""
_LARGE_YARD = 4500.0
"""Square metres: in a larger courtyard there are houses, too."""


@dataclass(frozen=True, slots=True)
class Custom:
    """How a quarter is built.

    ``form`` is ``"perimeter"``, ``"tower"`` or ``"detached"``. ``lot`` square metres; ``depth`` of houses from the street,
    metres; ``storeys`` mean, standard deviation, least and most; ``storey`` metres; ``vacant``, ``chamfered`` (blocks) and
    ``tall`` are shares, ``tallest`` the most storeys of a tall one. ``styles`` and ``roofs`` with weights, see
    ``citygen.buildings.houses``.
    """

    form: str
    lot: float
    depth: float
    storeys: tuple[float, float, int, int]
    styles: tuple[tuple[str, float], ...]
    roofs: tuple[tuple[str, float], ...]
    storey: float = 3.1
    vacant: float = 0.03
    chamfered: float = 0.0
    tall: float = 0.0
    tallest: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Buildings:
    """``n`` buildings: ``footprints`` (n,), ``blocks`` (n,) they stand on, ``heights`` (n,) of walls, metres above the highest
    ground, ``styles`` and ``roofs`` (n,).

    Towers have tiers on top: ``tiers`` (k,) footprints within that of their building ``tier_owners`` (k,), sorted, lowest
    first, whose walls end at ``tier_heights`` (k,).
    """

    footprints: NDArray[np.object_]
    blocks: NDArray[np.int64]
    heights: NDArray[np.float64]
    styles: NDArray[np.str_]
    roofs: NDArray[np.str_]
    tiers: NDArray[np.object_]
    tier_owners: NDArray[np.int64]
    tier_heights: NDArray[np.float64]

    def __post_init__(self) -> None:
        n, k = len(self.footprints), len(self.tiers)
        lengths = [len(one) for one in (self.blocks, self.heights, self.styles, self.roofs)]
        if lengths != [n] * 4 or [len(self.tier_owners), len(self.tier_heights)] != [k, k]:
            raise CityError(f"{n} buildings with {k} tiers need arrays of these lengths, found {lengths}")


def develop(blocks: NDArray[np.object_], custom: Custom, rng: np.random.Generator) -> Buildings:
    """Buildings on blocks (b,), in the order of blocks."""
    land_rng, height_rng, look_rng, tier_rng = rng.spawn(4)
    if custom.form == "detached":
        footprints, owners = _detached(blocks, custom, land_rng)
    else:
        footprints, owners = _attached(blocks, custom, land_rng)
    n = len(footprints)
    mean, spread, least, most = custom.storeys
    storeys = mean + height_rng.normal(0.0, 0.7 * spread, len(blocks))[owners] + height_rng.normal(0.0, spread, n)
    storeys = np.clip(np.rint(storeys), least, most)
    tall = height_rng.random(n) < custom.tall
    reach = height_rng.exponential(0.28, n)
    tiers, tier_owners, tier_heights = _NO_TIERS
    if custom.form == "tower":
        storeys = np.where(tall, np.minimum(storeys, 9), storeys)
        floors = np.where(tall, 14.0 + np.minimum(reach, 1.0) * (custom.tallest - 14.0), np.minimum(storeys, 9))
        tiers, tier_owners, tier_heights = _tiers(footprints, storeys, floors, custom.storey, tier_rng)
    return Buildings(
        footprints,
        owners,
        storeys * custom.storey + _GROUND_FLOOR,
        _choose(custom.styles, n, look_rng),
        _choose(custom.roofs, n, look_rng),
        tiers,
        tier_owners,
        tier_heights,
    )


def keep_buildings(buildings: Buildings, kept: NDArray[np.bool_]) -> Buildings:
    """Those of the buildings that ``kept`` (n,) says, with their tiers."""
    tiers = kept[buildings.tier_owners]
    number = np.cumsum(kept) - 1
    return replace(
        buildings,
        footprints=buildings.footprints[kept],
        blocks=buildings.blocks[kept],
        heights=buildings.heights[kept],
        styles=buildings.styles[kept],
        roofs=buildings.roofs[kept],
        tiers=buildings.tiers[tiers],
        tier_owners=number[buildings.tier_owners[tiers]],
        tier_heights=buildings.tier_heights[tiers],
    )


def join_buildings(parts: list[tuple[Buildings, NDArray[np.int64]]]) -> Buildings:
    """All buildings of several parts, in the order of their blocks; each part comes with the numbers of its blocks."""
    starts = np.cumsum([0, *(len(part.footprints) for part, _ in parts)])
    blocks = np.concatenate([numbers[part.blocks] for part, numbers in parts])
    order = np.argsort(blocks, kind="stable")
    place = np.argsort(order, kind="stable")
    owners = place[np.concatenate([part.tier_owners + s for (part, _), s in zip(parts, starts, strict=False)])]
    tiers = np.argsort(owners, kind="stable")
    return Buildings(
        np.concatenate([part.footprints for part, _ in parts])[order],
        blocks[order],
        np.concatenate([part.heights for part, _ in parts])[order],
        np.concatenate([part.styles for part, _ in parts])[order],
        np.concatenate([part.roofs for part, _ in parts])[order],
        np.concatenate([part.tiers for part, _ in parts])[tiers],
        owners[tiers],
        np.concatenate([part.tier_heights for part, _ in parts])[tiers],
    )


_NO_TIERS = (np.zeros(0, dtype=object), np.zeros(0, dtype=np.int64), np.zeros(0))


def _choose(weights: tuple[tuple[str, float], ...], n: int, rng: np.random.Generator) -> NDArray[np.str_]:
    names, shares = zip(*weights, strict=True)
    return np.asarray(rng.choice(np.array(names), n, p=np.array(shares) / sum(shares)), dtype=np.str_)


# ---------------------------------------------------------------------------------------------------- wall to wall


def _attached(
    blocks: NDArray[np.object_], custom: Custom, rng: np.random.Generator
) -> tuple[NDArray[np.object_], NDArray[np.int64]]:
    """Houses wall to wall along the edges of their block, with what lies deeper left open."""
    corner_rng, lot_rng, depth_rng, vacant_rng = rng.spawn(4)
    cut = corner_rng.random(len(blocks)) < custom.chamfered
    shaped = blocks.copy()
    shaped[cut] = chamfer(blocks[cut], corner_rng.uniform(2.0, 4.0, int(cut.sum())))
    lots, owners = cut_lots(shaped, custom.lot * lot_rng.uniform(0.75, 1.35, len(blocks)), lot_rng)

    # Three depths in a block, so that courtyards have corners; an L or U where a lot lies on several streets.
    depths = custom.depth * depth_rng.uniform(0.9, 1.1, len(blocks))[:, None] * np.array([0.86, 1.0, 1.22])
    cores = grow(shaped[:, None], -depths)
    cores[shapely.area(cores) < 60.0] = shapely.Polygon()
    choice = depth_rng.choice(3, len(lots), p=[0.25, 0.5, 0.25])
    around = cores[owners, choice]
    # In a large courtyard, houses stand by themselves.
    behind = (shapely.area(around) > _LARGE_YARD) & shapely.covers(around, lots) & (depth_rng.random(len(lots)) < 0.6)
    free = grow(lots[behind], -3.5)
    pieces, whole = subtract_cores(lots, around)
    pieces, owners = np.concatenate([pieces, free]), np.concatenate([owners[whole], owners[behind]])
    sound = (shapely.get_type_id(pieces) == 3) & _is_thick(pieces)
    order = np.argsort(owners[sound], kind="stable")
    pieces, owners = pieces[sound][order], owners[sound][order]

    yard = grow(pieces, -0.62 * custom.depth)
    roomy = (shapely.area(pieces) > 2.6 * custom.lot) & (shapely.area(yard) > 90.0) & (shapely.get_type_id(yard) == 3)
    pieces[roomy] = shapely.difference(pieces[roomy], yard[roomy])
    pieces = weld(pieces)
    built = _is_thick(pieces) & (shapely.area(pieces) > 32.0) & shapely.is_valid(pieces)
    built &= vacant_rng.random(len(pieces)) >= custom.vacant
    return pieces[built], owners[built]


def _is_thick(polygons: NDArray[np.object_]) -> NDArray[np.bool_]:
    return np.asarray(shapely.area(polygons) > _THINNEST * 0.5 * shapely.length(polygons))


def _tiers(
    footprints: NDArray[np.object_],
    podium: NDArray[np.float64],
    floors: NDArray[np.float64],
    storey: float,
    rng: np.random.Generator,
) -> tuple[NDArray[np.object_], NDArray[np.int64], NDArray[np.float64]]:
    """Set-backs of towers with more ``floors`` than their ``podium``: one or two tiers that step back from the walls below."""
    tops = np.stack([np.rint(podium + (floors - podium) * rng.uniform(0.4, 0.75, len(podium))), np.rint(floors)])
    single = rng.random(len(podium)) < 0.45
    owner = np.tile(np.arange(len(podium)), (2, 1))
    steps = np.stack([rng.uniform(2.0, 4.5, len(podium)), rng.uniform(5.0, 8.5, len(podium))])
    wanted = np.stack([~single, np.ones_like(single)]) & (floors > podium + 3) & (tops > podium)
    wanted[0] &= tops[0] < tops[1]
    shapes = grow(footprints[owner[wanted]], -steps[wanted])
    shapes = shapely.simplify(shapes, 0.3)
    sound = (shapely.get_type_id(shapes) == 3) & (shapely.area(shapes) > 130.0) & shapely.is_valid(shapes)
    owners, heights = owner[wanted][sound], (tops[wanted] * storey + _GROUND_FLOOR)[sound]
    order = np.lexsort((heights, owners))
    return shapes[sound][order], owners[order], heights[order]


# -------------------------------------------------------------------------------------------------------- detached


_L_SHAPE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.55], [0.45, 0.55], [0.45, 1.0], [0.0, 1.0]]) - 0.5
_RECTANGLE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.5, 1.0], [0.0, 1.0], [0.0, 0.5]]) - 0.5
"""As many corners as the L has; two of them lie in the middle of a side and are left out at the end."""


def _detached(
    blocks: NDArray[np.object_], custom: Custom, rng: np.random.Generator
) -> tuple[NDArray[np.object_], NDArray[np.int64]]:
    """A house in the middle of each lot, square to it, with a garden around."""
    lot_rng, shape_rng = rng.spawn(2)
    lots, owners = cut_lots(blocks, np.full(len(blocks), custom.lot), lot_rng)
    n = len(lots)
    _, along, _ = oriented_boxes(lots)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    size = np.stack(
        [custom.depth * shape_rng.uniform(0.75, 1.1, n), custom.depth * shape_rng.uniform(0.8, 1.5, n)], axis=1
    )
    bent = shape_rng.random(n) < 0.35
    size[bent] *= 1.2
    size = np.where(shape_rng.random(n)[:, None] < 0.5, size, size[:, ::-1])
    flip = shape_rng.choice([-1.0, 1.0], (n, 2))
    local = np.where(bent[:, None, None], _L_SHAPE, _RECTANGLE) * flip[:, None, :]
    xy = shapely.get_coordinates(shapely.centroid(lots))
    garden = grow(lots, -2.5)
    houses = np.full(n, None, dtype=object)
    for scale in (1.0, 0.85, 0.7):  # smaller where the lot is
        offset = local * (scale * size)[:, None, :]
        place = xy[:, None] + offset[..., :1] * along[:, None] + offset[..., 1:] * across[:, None]
        tried = shapely.polygons(np.round(place, 3))
        houses = np.where((houses == None) & shapely.covers(garden, tried), tried, houses)  # noqa: E711
    built = (houses != None) & (shape_rng.random(n) >= custom.vacant)  # noqa: E711
    return shapely.simplify(houses[built], 0.01), owners[built]
