"""Walls of houses: painted ones with a picture of their windows, and pierced ones whose windows and doors are recesses.

A pierced wall is a grid of cells, each at the wall's face or pushed in by the depth of the recesses, with reveals between
cells of different depth: a closed sheet by construction. Only its corners touch the next wall, floor or roof, so walls
with any number of bays fit together: its lowest and highest rows lead from many points to two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LinearRing, Polygon

from citygen.shapes.solids import Piece, join
from citygen.shapes.textures import BAY, DOORS, FACADES, GROUNDS, PANES, STOREY, WALL_METRES, WALLS

__all__ = ["Look", "Outline", "Windows", "bays_of", "outline_of", "painted_walls", "pierced_walls"]

_RECT = np.array([(0, 1), (2, 1), (2, 3), (0, 3)])  # corners of a quad in (u, v, u, v)
_RECT.setflags(write=False)
_NARROW = 1.8  # metres below which a wall has no room for a window
_PIER = 0.3  # metres of wall beside the outermost windows at least
_CORNER = 0.29  # metres, a little more than the deepest recess
_Floats = NDArray[np.float64]
_Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """The corners of a footprint (n, 2), the inside to the left of each edge i from corner i to corner ``after[i]``.

    ``along`` and ``inward`` (n, 2) are unit vectors, ``length`` (n,) metres. ``party`` (n,): edges where the next house stands;
    ``blind``: those and the ones too short for windows; ``outer``: edges of the outer ring. Bays begin ``first`` (n,) metres
    from an edge's start and fill ``room`` (n,): at sharp corners recesses of two walls would meet. ``ends``: where each
    ring's points end.
    """

    points: _Floats
    after: _Ints
    along: _Floats
    inward: _Floats
    length: _Floats
    party: NDArray[np.bool_]
    blind: NDArray[np.bool_]
    outer: NDArray[np.bool_]
    first: _Floats
    room: _Floats
    ends: _Ints


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """What one house looks like: style, colour of its walls, heights of its floors (base first, eaves last), and choices."""

    style: str
    tint: _Floats
    levels: _Floats
    shops: bool
    facade: int
    first_bay: int


@dataclass(frozen=True, slots=True)
class Windows:
    """Sizes of a style's windows, metres: ``width``, ``sill`` above the floor, ``head`` below the ceiling, ``recess``."""

    width: float
    sill: float
    head: float
    recess: float


def outline_of(footprint: Polygon, blind: Sequence[bool] | None) -> Outline:
    """Corners and edges of a footprint; ``blind`` has a flag an edge of its exterior ring as that is given."""
    loops = [_loop(footprint.exterior, counter_clockwise=True)]
    loops += [_loop(hole, counter_clockwise=False) for hole in footprint.interiors]
    points = loops[0] if len(loops) == 1 else np.concatenate(loops)
    ends = np.cumsum([len(loop) for loop in loops])
    n, outside = len(points), len(loops[0])
    flags = np.zeros(n, dtype=bool)
    if blind is not None:
        given = np.asarray(blind, dtype=bool)
        flags[:outside] = given if footprint.exterior.is_ccw else given[::-1]
    after = np.arange(1, n + 1)
    after[ends - 1] = np.concatenate([[0], ends[:-1]])
    along = points[after] - points
    length = np.hypot(along[:, 0], along[:, 1])
    along = along / length[:, None]
    inward = np.column_stack([-along[:, 1], along[:, 0]])
    before = np.empty(n, dtype=np.int64)
    before[after] = np.arange(n)
    last = along[before]
    sine = last[:, 0] * along[:, 1] - last[:, 1] * along[:, 0]
    cosine = (last * along).sum(axis=1)
    # The cotangent of half the angle inside, which is the tangent of half the turn.
    kept = np.maximum(_CORNER * sine / np.maximum(1.0 + cosine, 1e-3) - _PIER, 0.0)
    room = length - kept - kept[after]
    return Outline(
        points, after, along, inward, length, flags, flags | (room < _NARROW), np.arange(n) < outside, kept, room, ends
    )


def _loop(ring: LinearRing, *, counter_clockwise: bool) -> _Floats:
    points = shapely.get_coordinates(ring)[:-1]
    # Turned as shapely turns a ring: its first point stays.
    return points if ring.is_ccw == counter_clockwise else np.roll(points[::-1], 1, axis=0)


def bays_of(length: float) -> int:
    """How many bays a wall of that length has."""
    return max(1, round(length / BAY))


def painted_walls(outline: Outline, look: Look) -> Piece:
    """Every wall as a rectangle of pictures for the ground floor and one for what is above, with whole bays."""
    n, levels = len(outline.points), look.levels
    heights = levels if len(levels) == 2 else levels[[0, 1, -1]]
    rows = len(heights) - 1
    points = np.empty((rows + 1, n, 3))
    points[..., :2], points[..., 2] = outline.points, heights[:, None]
    a, b = np.arange(n), outline.after
    quads = np.empty((rows, n, 4), dtype=np.int64)
    uv, textures = np.empty((rows, n, 4, 2)), np.empty((rows, n), dtype=np.int64)
    start = (look.first_bay + 3 * a) % 8 / 8.0
    u0 = np.where(outline.blind, 0.0, start)
    u1 = np.where(
        outline.blind, outline.length / WALL_METRES[0], start + np.maximum(1.0, np.rint(outline.length / BAY)) / 8.0
    )
    uv[..., [0, 3], 0], uv[..., [1, 2], 0] = u0[:, None], u1[:, None]
    for row in range(rows):
        if row:
            texture, v0, v1 = FACADES[look.style][look.facade], 0.0, (len(levels) - 2) / 8.0
        else:
            texture, v0, v1 = GROUNDS[look.style][0 if look.shops else 1], 0.5 / 64.0, 1.0 - 0.5 / 64.0
        textures[row] = np.where(outline.blind, WALLS[look.style], texture)
        low, high = ((heights[row + one] - heights[0]) / WALL_METRES[1] for one in (0, 1))
        uv[row, :, :2, 1] = np.where(outline.blind, low, v0)[:, None]
        uv[row, :, 2:, 1] = np.where(outline.blind, high, v1)[:, None]
        for corner, (one, level) in enumerate(((a, row), (b, row), (b, row + 1), (a, row + 1))):
            quads[row, :, corner] = one + level * n
    halves = [0, 1, 2, 0, 2, 3]
    return Piece(
        points.reshape(-1, 3),
        quads[..., halves].reshape(-1, 3),
        np.repeat(textures.ravel(), 2),
        np.broadcast_to(look.tint, (2 * rows * n, 3)),
        uv[..., halves, :].reshape(-1, 3, 2),
    )


def pierced_walls(outline: Outline, look: Look, windows: Windows, rng: np.random.Generator, *, modern: bool) -> Piece:
    """Every wall with recessed windows, doors and shops; blind walls have none."""
    pieces, levels = [], look.levels
    for i in range(len(outline.points)):
        ends = (outline.points[i], outline.points[outline.after[i]], outline.inward[i])
        length = float(outline.length[i])
        spread = (float(outline.first[i]), float(outline.room[i]))
        bays = 0 if outline.blind[i] else bays_of(spread[1])
        shops = look.shops and bool(outline.outer[i])
        doors = np.zeros(bays, dtype=bool)
        if bays and outline.outer[i]:
            doors[int(rng.integers(bays)) :: 5] = True
        pieces.append(_ground_floor(ends, length, spread, look, windows, doors, rng, shops=shops, modern=modern))
        if len(levels) > 2:
            pieces.append(_upper_floors(ends, length, spread, bays, look, windows, rng, modern=modern))
    return join(pieces)


# ------------------------------------------------------------------------------------------------------------ pierced


def _ground_floor(
    ends: tuple[_Floats, _Floats, _Floats],
    length: float,
    spread: tuple[float, float],
    look: Look,
    windows: Windows,
    doors: NDArray[np.bool_],
    rng: np.random.Generator,
    *,
    shops: bool,
    modern: bool,
) -> Piece:
    """Shops that nearly fill their bays, or windows; ``doors`` (bays,) are doors."""
    bays = len(doors)
    bay = spread[1] / max(bays, 1)
    low, high = float(look.levels[0]), float(look.levels[1])
    shop = shops and bay > 2.4
    width = min(2.6 if shop else windows.width, bay - 0.6)
    floor, sill, head = low + 0.12, low + 1.05, high - (0.75 if high - low > 3.4 else 0.4)
    tall = doors | shop
    rects = np.zeros((bays, 2, 4))
    textures = np.where(tall, DOORS, PANES)
    pick = rng.integers(8, size=bays)
    rects[:, 1] = np.column_stack(
        [pick / 8.0, np.full(bays, 0.5 * modern), (pick + 1) / 8.0, np.full(bays, 0.5 + 0.5 * modern)]
    )
    share = (sill - floor) / (head - floor)
    first = np.where(shop & ~doors, pick % 4 / 4.0, pick / 8.0)
    span = np.where(shop & ~doors, 0.25, 0.125)
    v0 = np.where(shop & ~doors, 0.5, 0.0)
    lower = np.column_stack([first, v0, first + span, v0 + 0.5 * share])
    upper = np.column_stack([first, v0 + 0.5 * share, first + span, v0 + 0.5])
    rects[tall, 0], rects[tall, 1] = lower[tall], upper[tall]
    widths = np.where(doors & shop, 1.7, np.where(doors & (width > 1.5), 1.5, width))
    return _pierced(
        ends,
        length,
        spread,
        look,
        np.array([low, floor, sill, head, high]),
        widths,
        np.stack([tall, np.ones(bays, dtype=bool)]),
        np.stack([textures, textures]),
        rects.transpose(1, 0, 2),
        windows.recess,
    )


def _upper_floors(
    ends: tuple[_Floats, _Floats, _Floats],
    length: float,
    spread: tuple[float, float],
    bays: int,
    look: Look,
    windows: Windows,
    rng: np.random.Generator,
    *,
    modern: bool,
) -> Piece:
    """One window in each bay of each storey."""
    floors, ceilings = look.levels[1:-1], look.levels[2:]
    storeys = len(floors)
    scale = (ceilings - floors) / STOREY
    inner = np.column_stack([floors + windows.sill * scale, ceilings - windows.head * scale]).ravel()
    width = min(windows.width, spread[1] / max(bays, 1) - 0.6)
    rows = 2 * storeys - 1
    open_ = np.zeros((rows, bays), dtype=bool)
    open_[::2] = True
    rects = np.zeros((rows, bays, 4))
    pick = rng.integers(8, size=(storeys, bays)) / 8.0
    rects[::2] = np.stack(
        [pick, np.full_like(pick, 0.5 * modern), pick + 0.125, np.full_like(pick, 0.5 + 0.5 * modern)], axis=-1
    )
    levels = np.concatenate([[floors[0]], inner, [ceilings[-1]]])
    return _pierced(
        ends,
        length,
        spread,
        look,
        levels,
        np.full(bays, width),
        open_,
        np.full((rows, bays), PANES),
        rects,
        windows.recess,
    )


def _pierced(
    ends: tuple[_Floats, _Floats, _Floats],
    length: float,
    spread: tuple[float, float],
    look: Look,
    z: _Floats,
    widths: _Floats,
    opened: NDArray[np.bool_],
    textures: _Ints,
    rects: _Floats,
    recess: float,
) -> Piece:
    """A wall with no bays, or with a column of openings in each.

    ``opened``, ``textures`` (rows, bays), ``rects`` (rows, bays, 4: u, v, u, v). ``z``: bottom, the limits of the rows,
    top; the rows lie between ``z[1]`` and ``z[-2]``.
    """
    a, b, inward = ends
    rows, bays = opened.shape
    middle = spread[0] + (np.arange(bays) + 0.5) * (spread[1] / max(bays, 1))
    breaks = np.empty(2 * bays + 2)
    breaks[0], breaks[-1] = 0.0, length
    breaks[1:-1:2], breaks[2:-1:2] = middle - 0.5 * widths, middle + 0.5 * widths
    size = (rows + 1) * len(breaks)
    xy = a + (b - a) * (breaks / length)[:, None]
    xy[0], xy[-1] = a, b
    vertices = np.empty((2 * size + 4, 3))
    grid = vertices[:size].reshape(rows + 1, len(breaks), 3)
    grid[..., :2], grid[..., 2] = xy, z[1:-1, None]
    vertices[size:-4] = vertices[:size]
    vertices[size:-4, :2] += recess * inward
    vertices[-4:, :2], vertices[-4:, 2] = (a, b, b, a), z[[0, 0, -1, -1]]
    flat = np.empty((2 * size + 4, 2))
    flat[:-4, 0], flat[-4:, 0] = np.tile(breaks, 2 * (rows + 1)), (0.0, length, length, 0.0)
    flat[:, 1] = vertices[:, 2] - look.levels[0]
    flat[size:-4] += recess
    flat /= WALL_METRES
    quads, fans, panes = _wall_faces(rows, bays, opened.tobytes())
    corners = quads[:, [0, 1, 2, 0, 2, 3]]
    uv = flat[corners]  # (quads, two triangles' corners, 2)
    texture = np.full(len(quads), WALLS[look.style])
    color = np.empty((len(quads), 3))
    color[:] = look.tint
    color[rows * (2 * bays + 1) :] *= 0.86  # less of the sky reaches into a recess
    texture[panes], color[panes] = textures[opened], 255.0
    uv[panes] = rects[opened][:, _RECT[[0, 1, 2, 0, 2, 3]]]
    m = len(fans)
    return Piece(
        vertices,
        np.concatenate([corners.reshape(-1, 3), fans]),
        np.concatenate([np.repeat(texture, 2), np.full(m, WALLS[look.style])]),
        np.concatenate([np.repeat(color, 2, axis=0), np.broadcast_to(look.tint, (m, 3))]),
        np.concatenate([uv.reshape(-1, 3, 2), flat[fans]]),
    )


@lru_cache(maxsize=4096)
def _wall_faces(rows: int, bays: int, pattern: bytes) -> tuple[_Ints, _Ints, _Ints]:
    """Faces of a pierced wall: quads (n, 4), the cells first; triangles (m, 3) below and above them; the panes' quads.

    ``pattern``: bytes of ``opened`` (rows, bays). Vertices are the grid's at the face, the grid's behind, and four corners.
    """
    opened = np.frombuffer(pattern, dtype=bool).reshape(rows, bays)
    columns = 2 * bays + 1
    grid = np.arange((rows + 1) * (columns + 1)).reshape(rows + 1, columns + 1)
    behind, corner = grid + grid.size, 2 * grid.size
    deep = np.zeros((rows + 2, columns), dtype=np.int64)
    deep[1:-1, 1::2] = opened
    level = deep[1:-1] * grid.size
    cells = np.stack(
        [grid[:-1, :-1] + level, grid[:-1, 1:] + level, grid[1:, 1:] + level, grid[1:, :-1] + level], axis=-1
    )
    # Reveals: between neighbours in a row, and between rows.
    sides, below = deep[1:-1, 1:] - deep[1:-1, :-1], deep[1:] - deep[:-1]
    r, c = np.nonzero(sides)
    upright = np.column_stack([grid[r, c + 1], behind[r, c + 1], behind[r + 1, c + 1], grid[r + 1, c + 1]])
    upright[sides[r, c] < 0] = upright[sides[r, c] < 0][:, ::-1]
    p, q = np.nonzero(below)
    ledge = np.column_stack([grid[p, q], grid[p, q + 1], behind[p, q + 1], behind[p, q]])
    ledge[below[p, q] < 0] = ledge[below[p, q] < 0][:, ::-1]
    # Many points to two, below and above: a fan from each corner to the half of the points that is nearer.
    half = columns // 2
    near_a, near_b = np.arange(half), np.arange(half, columns)
    first, last = grid[0], grid[-1]
    fans = np.concatenate(
        [
            np.column_stack([np.full(half, corner), first[near_a + 1], first[near_a]]),
            np.column_stack([np.full(columns - half, corner + 1), first[near_b + 1], first[near_b]]),
            [(corner, corner + 1, first[half]), (corner + 3, last[half], corner + 2)],
            np.column_stack([np.full(half, corner + 3), last[near_a], last[near_a + 1]]),
            np.column_stack([np.full(columns - half, corner + 2), last[near_b], last[near_b + 1]]),
        ]
    )
    rr, cc = np.nonzero(opened)
    found = (np.concatenate([cells.reshape(-1, 4), upright, ledge]), fans, rr * columns + 2 * cc + 1)
    for one in found:
        one.setflags(write=False)
    return found
