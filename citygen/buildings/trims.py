"""What is put on a house after its walls and roof: sills, cornices, balconies, shutters, dormers, chimneys.

Each is a closed body of its own that reaches a little into the house, so that there is no gap. All of one kind are made at
once, in the frame of the wall they belong to: x along it, ``out`` away from it, z up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from shapely.geometry import Polygon

from citygen.buildings.walls import Look, Outline, Windows
from citygen.shapes.solids import Piece, hexahedra, join, painted
from citygen.shapes.textures import BAY, PANES, RAILING, ROOF_METRES, ROOFS, SHUTTER, TRIM, WALL_METRES, WALLS

__all__ = ["Bodies", "balconies", "chimneys", "cornices", "dormers", "overhang", "roof_huts", "shutters", "sills"]

_INTO = 0.03  # metres that trims reach into the wall
_Floats = NDArray[np.float64]
_Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Bodies:
    """Closed bodies, and how far they stand out from the walls and reach up and down, metres."""

    piece: Piece
    out: float
    low: float
    high: float


def sills(outline: Outline, look: Look, windows: Windows) -> Bodies | None:
    """A slab of stone below every upper window."""
    edge, middle, floor, ceiling, width, _ = _upper_windows(outline, look, windows)
    if not len(edge):
        return None
    level = floor + windows.sill * (ceiling - floor) / BAY
    half = 0.5 * width + 0.12
    return _bodies(outline, edge, middle - half, middle + half, level - 0.14, level, 0.13, texture=TRIM)


def cornices(outline: Outline, look: Look, *, flat: bool) -> Bodies | None:
    """A moulding under the eaves and one above the ground floor, mitred at the corners."""
    open_ = np.flatnonzero(~outline.party)
    if not len(open_):
        return None
    eaves, base = look.levels[-1], look.levels[0]
    below = 0.3 if flat else 0.0
    bands = [(eaves - below - 0.32, eaves - below, 0.16 if look.style == "glass" else 0.34)]
    if len(look.levels) > 2 and look.style != "glass":
        bands.append((look.levels[1] - 0.2, look.levels[1] + 0.05, 0.14))
    bands = [band for band in bands if band[0] > base + 0.1]
    if not bands:
        return None
    low, high, out = (np.repeat(column, len(open_)) for column in np.array(bands).T)
    edge = np.tile(open_, len(bands))
    start, end = _mitres(outline)
    # Between two corners inwards a short one would fold.
    roomy = outline.length[edge] + (start[edge] + end[edge]) * out > 0.05
    low, high, out, edge = low[roomy], high[roomy], out[roomy], edge[roomy]
    if not len(edge):
        return None
    return _bodies(
        outline,
        edge,
        np.full(len(edge), 1e-3),  # bodies of neighbouring walls do not share edges
        outline.length[edge] - 1e-3,
        low,
        high,
        out,
        texture=TRIM,
        skew=(start[edge], end[edge]),
        into=0.0,  # at a sharp corner it would come out of the next wall
    )


def balconies(outline: Outline, look: Look, rng: np.random.Generator) -> Bodies | None:
    """Along the whole front in two storeys (stucco and stone), or before one bay in three."""
    fronts = np.flatnonzero(~outline.blind & outline.outer & (outline.length > 4.0))
    floors = look.levels[1:-1]
    if not len(fronts) or not len(floors):
        return None
    if look.style in ("stucco", "stone"):
        chosen = floors[sorted({min(1, len(floors) - 1), max(0, len(floors) - 2)})]
        edge = np.repeat(fronts, len(chosen))
        x0, x1, out = np.full(len(edge), 0.35), outline.length[edge] - 0.35, 0.75
        levels = np.tile(chosen, len(fronts))
    else:
        of, middle, wide, bay = _bays(outline, fronts)
        keep = bay % 3 == rng.integers(3)
        of, middle, wide = of[keep], middle[keep], wide[keep]
        if not len(of):
            return None
        edge, levels = np.repeat(of, len(floors)), np.tile(floors, len(of))
        x0, x1 = (np.repeat(middle + side * (0.5 * wide - 0.3), len(floors)) for side in (-1.0, 1.0))
        out = 1.1
    level = levels - 0.02
    slab = _place(outline, edge, x0, x1, -_INTO, out, level - 0.16, level)
    front = _place(outline, edge, x0, x1, out - 0.06, out - 0.01, level - 0.01, level + 1.0)
    left = _place(outline, edge, x0 + 0.01, x0 + 0.06, -_INTO, out - 0.02, level - 0.01, level + 1.0)
    right = _place(outline, edge, x1 - 0.06, x1 - 0.01, -_INTO, out - 0.02, level - 0.01, level + 1.0)
    rails = hexahedra(np.concatenate([front, left, right]), texture=RAILING, metres=(1.6, 1.0))
    return Bodies(
        join([hexahedra(slab, texture=TRIM, metres=3.0), rails]),
        out,
        float(level.min()) - 0.16,
        float(level.max()) + 1.0,
    )


def shutters(outline: Outline, look: Look, windows: Windows, rng: np.random.Generator) -> Bodies | None:
    """A leaf on either side of every upper window that has room for it, all of one colour."""
    edge, middle, floor, ceiling, width, bay = _upper_windows(outline, look, windows)
    room = bay > width + 1.3
    edge, middle, floor, ceiling, width = edge[room], middle[room], floor[room], ceiling[room], width[room]
    if not len(edge):
        return None
    scale = (ceiling - floor) / BAY
    low, high = floor + windows.sill * scale, ceiling - windows.head * scale
    leaf = 0.5 * width
    x0 = np.concatenate([middle - 2.0 * leaf + 0.02, middle + leaf + 0.02])
    x1 = np.concatenate([middle - leaf - 0.02, middle + 2.0 * leaf - 0.02])
    edge, low, high = np.tile(edge, 2), np.tile(low, 2), np.tile(high, 2)
    corners = _place(outline, edge, x0, x1, -_INTO, 0.06, low, high)
    colors = ((150, 172, 158), (132, 152, 176), (240, 236, 226), (168, 140, 110))
    piece = hexahedra(corners, texture=SHUTTER, metres=None, color=colors[int(rng.integers(len(colors)))])
    return Bodies(piece, 0.06, float(low.min()), float(high.max()))


def dormers(
    outline: Outline, look: Look, footprint: Polygon, *, slope: float, limit: float, roof: int, tint: ArrayLike
) -> Bodies | None:
    """Windows that stand on a roof that rises by ``slope`` up to ``limit`` metres above the eaves, above every second bay."""
    eaves = look.levels[-1]
    steep = slope > 1.5
    front = 0.25 if steep else 0.9
    bottom = eaves + slope * front - 0.15 if not steep else eaves + 0.2
    top = min(bottom + 1.7, eaves + limit - 0.3)
    back = (top - eaves) / slope + 0.3
    edges = np.flatnonzero(~outline.blind & outline.outer)
    edge, middle, _, bay = _bays(outline, edges)
    keep = (middle > back + 0.8) & (middle < outline.length[edge] - back - 0.8) & (bay % 2 == 1)
    edge, middle = edge[keep], middle[keep]
    if top - bottom < 1.0 or not len(edge):
        return None
    low, high = np.full(len(edge), bottom), np.full(len(edge), top)
    body = _place(outline, edge, middle - 0.65, middle + 0.65, -back, -front, low, high)
    # On a ridge that is nearer than its roof needs it would look out on the other side.
    reach = _place(outline, edge, middle - 0.8, middle + 0.8, -2.0 * back, -0.01, low, high)
    fits = shapely.covers(footprint, shapely.polygons(reach[:, :4, :2]))
    body, edge, middle, low, high = body[fits], edge[fits], middle[fits], low[fits], high[fits]
    if not len(body):
        return None
    lid = _place(outline, edge, middle - 0.8, middle + 0.8, -back, -front + 0.12, high - 0.02, high + 0.12)
    lid[:, [0, 1, 4, 5], 2] -= 0.08  # down towards the street
    walls = hexahedra(body, texture=WALLS[look.style], metres=WALL_METRES, color=look.tint)
    face = _place(outline, edge, middle - 0.5, middle + 0.5, -back, -front + 0.04, low + 0.2, high - 0.12)
    pane = painted(hexahedra(face, texture=PANES, metres=None), (255, 255, 255))
    pane.uv[..., 0] = (pane.uv[..., 0] + 3.0) / 8.0
    pane.uv[..., 1] = pane.uv[..., 1] / 2.0
    lids = hexahedra(lid, texture=roof, metres=ROOF_METRES, color=tint)
    return Bodies(join([walls, pane, lids]), 0.0, bottom, top + 0.12)


def chimneys(
    outline: Outline, footprint: Polygon, rng: np.random.Generator, *, foot: float, top: float
) -> Bodies | None:
    """One or two stacks with pots at the blind walls, or else at any, from ``foot`` inside the roof to ``top``."""
    walls = np.flatnonzero(outline.outer & (outline.length > 4.0))
    party = walls[outline.party[walls]]
    walls = party if len(party) else walls
    if not len(walls):
        return None
    edge = rng.permutation(walls)[:2]
    middle = outline.length[edge] * rng.uniform(0.3, 0.7, len(edge))
    lows, highs = np.full(len(edge), foot), np.full(len(edge), top)
    stack = _place(outline, edge, middle - 0.7, middle + 0.7, -1.05, -0.4, lows, highs)
    fits = shapely.covers(footprint, shapely.polygons(stack[:, :4, :2]))
    stack, edge, middle, highs = stack[fits], edge[fits], middle[fits], highs[fits]
    if not len(stack):
        return None
    pots_of, shift = np.repeat(edge, 3), np.tile([-0.4, 0.0, 0.4], len(edge))
    at, on = np.repeat(middle, 3) + shift, np.repeat(highs, 3)
    pots = _place(outline, pots_of, at - 0.11, at + 0.11, -0.85, -0.6, on - 0.02, on + 0.4)
    bricks = hexahedra(stack, texture=WALLS["brick"], metres=WALL_METRES, color=(225, 215, 210))
    clay = hexahedra(pots, texture=ROOFS["tiles"], metres=ROOF_METRES)
    return Bodies(join([bricks, clay]), 0.0, foot, top + 0.4)


def roof_huts(footprint: Polygon, rng: np.random.Generator, *, deck: float, count: int) -> Bodies | None:
    """Stair heads and machines on a flat roof."""
    inner = footprint.buffer(-3.0, join_style="mitre")
    if inner.is_empty:
        return None
    x0, y0, x1, y1 = inner.bounds
    at = np.column_stack([rng.uniform(x0, x1, 4 * count), rng.uniform(y0, y1, 4 * count)])
    at = at[shapely.contains_xy(inner, at)][:count]
    if not len(at):
        return None
    size = rng.uniform(0.7, 1.6, (len(at), 2))
    high = deck + rng.uniform(1.2, 2.8, len(at))
    x = at[:, :1] + size[:, :1] * np.array([-1, 1, 1, -1])
    y = at[:, 1:] + size[:, 1:] * np.array([-1, -1, 1, 1])
    low = np.stack([x, y, np.full_like(x, deck - 0.1)], axis=-1)
    corners = np.concatenate([low, np.stack([x, y, np.repeat(high[:, None], 4, axis=1)], axis=-1)], axis=1)
    piece = hexahedra(corners, texture=ROOFS["zinc"], metres=ROOF_METRES)
    return Bodies(piece, 0.0, deck - 0.1, float(high.max()))


def overhang(outline: Outline, footprint: Polygon, out: float) -> Polygon:
    """The footprint with what stands out from its walls by up to ``out`` metres, but not beyond blind ones."""
    edge = np.flatnonzero(~outline.party)
    start, end = _mitres(outline)
    a, b = outline.points[edge], outline.points[outline.after[edge]]
    away = -outline.inward[edge] * out
    more0, more1 = np.maximum(start[edge], 0.0) * out, np.maximum(end[edge], 0.0) * out
    c, d = b + away + outline.along[edge] * more1[:, None], a + away - outline.along[edge] * more0[:, None]
    strips = shapely.polygons(np.stack([a, d, c, b], axis=1))
    whole = shapely.union_all([footprint, *strips]).buffer(1e-3, join_style="mitre")
    return whole if isinstance(whole, Polygon) else whole.convex_hull


# ---------------------------------------------------------------------------------------------------------- mechanics


def _bays(outline: Outline, edges: _Ints) -> tuple[_Ints, _Floats, _Floats, _Ints]:
    """Of every bay of some walls: its edge, where along it its middle is, its width, its number."""
    counts = np.maximum(1, np.rint(outline.room[edges] / BAY)).astype(np.int64)
    edge, bay = np.repeat(edges, counts), np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    wide = outline.room[edge] / np.repeat(counts, counts)
    return edge, outline.first[edge] + (bay + 0.5) * wide, wide, bay


def _upper_windows(
    outline: Outline, look: Look, windows: Windows
) -> tuple[_Ints, _Floats, _Floats, _Floats, _Floats, _Floats]:
    """Of every window above the ground floor: its edge, the middle along it, floor, ceiling, its width and its bay's."""
    floors, ceilings = look.levels[1:-1], look.levels[2:]
    edge, middle, wide, _ = _bays(outline, np.flatnonzero(~outline.blind))
    k, n = len(edge), len(floors)
    width = np.minimum(windows.width, wide - 0.6)
    repeated = [np.repeat(one, n) for one in (middle, width, wide)]
    return np.repeat(edge, n), repeated[0], np.tile(floors, k), np.tile(ceilings, k), repeated[1], repeated[2]


def _mitres(outline: Outline) -> tuple[_Floats, _Floats]:
    """(n,) by how much a trim grows at the start and the end of each edge for a metre that it stands out."""
    n = len(outline.points)
    before = np.empty(n, dtype=np.int64)
    before[outline.after] = np.arange(n)
    last, own = outline.along[before], outline.along
    sine = last[:, 0] * own[:, 1] - last[:, 1] * own[:, 0]
    cosine = (last * own).sum(axis=1)
    # Where its neighbour has no trim, or the corner is too sharp, it is cut off square.
    start = np.where(outline.party[before] | outline.party, 0.0, sine / np.maximum(1.0 + cosine, 1e-6))
    start = np.where(np.abs(start) > 2.0, 0.0, start)
    return start, start[outline.after]


def _place(
    outline: Outline,
    edge: _Ints,
    x0: _Floats,
    x1: _Floats,
    inner: ArrayLike,
    outer: ArrayLike,
    low: _Floats,
    high: _Floats,
    *,
    skew: tuple[_Floats, _Floats] = (np.zeros(1), np.zeros(1)),
) -> _Floats:
    """Corners (n, 8, 3) of bodies before the walls ``edge``, between distances out of the wall; ``skew``: their mitres."""
    n = len(edge)
    o0, o1 = np.broadcast_to(inner, (n,)), np.broadcast_to(outer, (n,))
    s0, s1 = np.broadcast_to(skew[0], (n,)), np.broadcast_to(skew[1], (n,))
    x = np.stack([x0 - s0 * o1, x1 + s1 * o1, x1 + s1 * o0, x0 - s0 * o0], axis=1)
    out = np.stack([o1, o1, o0, o0], axis=1)
    xy = (
        outline.points[edge][:, None]
        + x[..., None] * outline.along[edge][:, None]
        - out[..., None] * outline.inward[edge][:, None]
    )
    corners = np.empty((n, 8, 3))
    corners[:, :4, :2] = corners[:, 4:, :2] = xy
    corners[:, :4, 2], corners[:, 4:, 2] = low[:, None], high[:, None]
    return corners


def _bodies(
    outline: Outline,
    edge: _Ints,
    x0: _Floats,
    x1: _Floats,
    low: _Floats,
    high: _Floats,
    out: ArrayLike,
    *,
    texture: int,
    skew: tuple[_Floats, _Floats] = (np.zeros(1), np.zeros(1)),
    into: float = _INTO,
) -> Bodies:
    corners = _place(outline, edge, x0, x1, -into, out, low, high, skew=skew)
    return Bodies(
        hexahedra(corners, texture=texture, metres=3.0), float(np.max(out)), float(low.min()), float(high.max())
    )
