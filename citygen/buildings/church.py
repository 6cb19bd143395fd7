"""A domed church on a hill, in the manner of the Sacré-Coeur: the landmark of a generated city.

Nave, transept, portico and stairs, an apse with chapels, one ovoid dome on a drum with a colonnade, four lesser ones, and a
bell tower behind. Every part is a closed body. It is designed 60 m long (the portico at -x, the apse at +x), 40 m wide and of
height 1, then stretched, turned and moved; details only refine what is round, and add columns and windows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from shapely.geometry import Polygon

from citygen.shapes.solids import Piece, box, compacted, extrusion, hexahedra, hull_prism, join, lathe, placed
from citygen.shapes.textures import DOORS, PANES, ROOFS, TRIM, WALLS
from mmi.city.model import CityObject, Prism
from mmi.foundation.errors import CityError

__all__ = ["church"]

_SEGMENTS = (12, 20, 34, 52)  # around the great dome, by detail
_STONE = (255, 253, 248)
_PALE = (255, 255, 252)
_SHADE = (214, 210, 202)


@dataclass(slots=True)
class _Works:
    """A church being built: bodies by part, and solids that surely are filled."""

    height: float
    turn: float
    segments: int
    detail: int
    pieces: list[list[Piece]] = field(default_factory=list)
    filled: list[tuple[NDArray[np.float64], float, float]] = field(default_factory=list)

    def add(self, pieces: Sequence[Piece]) -> None:
        self.pieces.append(list(pieces))


def church(
    id: str,  # noqa: A002
    centre: ArrayLike,
    *,
    base: float,
    height: float,
    heading: float,
    detail: int,
    rng: np.random.Generator,
) -> CityObject:
    """A church of 60 x 40 m around ``centre`` (x, y), its cross ``height`` metres above ``base``.

    ``heading`` radians: where the apse points, counter-clockwise from +x. ``detail`` 0 to 3: some 2,000 to 30,000
    triangles. Textures are those of ``citygen.shapes.textures``. Raises CityError for other details, or a height that is
    not positive.
    """
    if detail not in range(4) or not height > 0.0:
        raise CityError(f"church {id}: detail 0 to 3 and a positive height expected, found {detail!r} and {height!r}")
    works = _Works(height, heading, _SEGMENTS[detail], detail)
    _body(works)
    _portico(works)
    _apse(works)
    _great_dome(works)
    for x in (-12.5, 10.5):
        for y in (-11.5, 11.5):
            _turret(works, x, y)
    _bell_tower(works)
    position = np.array([*np.asarray(centre, dtype=np.float64)[:2], base])
    tint = rng.uniform(0.94, 1.0)
    moved = [[placed(piece, position, heading=heading) for piece in part] for part in works.pieces]
    mesh = compacted(join([piece for part in moved for piece in part]))
    tinted = type(mesh)(
        mesh.vertices, mesh.triangles, mesh.textures, np.rint(mesh.colors * tint).astype(np.uint8), mesh.uv
    )
    prisms = tuple(hull_prism(np.concatenate([piece.vertices for piece in part])) for part in moved)
    c, s = np.cos(heading), np.sin(heading)
    turned = np.array([[c, s], [-s, c]])
    core = tuple(
        Prism(Polygon(outline @ turned + position[:2]), base + low, base + high) for outline, low, high in works.filled
    )
    return CityObject(id, prisms, tinted, core)


# -------------------------------------------------------------------------------------------------------------- parts


def _body(works: _Works) -> None:
    """Nave, transept, their roofs, the crossing's tower, and windows."""
    h = works.height
    wall, ridge, tower = 0.27 * h, 0.32 * h, 0.42 * h
    nave, transept, crossing = (-20.0, -10.5, 17.0, 10.5), (-9.5, -20.0, 8.5, 20.0), (-10.5, -10.0, 9.5, 10.0)
    parts = []
    for x0, y0, x1, y1 in (nave, transept):
        parts.append(_block(works, x0, y0, x1, y1, 0.0, wall))
        parts.append(_hipped(x0 - 0.4, y0 - 0.4, x1 + 0.4, y1 + 0.4, wall, ridge))
        parts.append(box((x0 - 0.6, y0 - 0.6, wall - 0.7), (x1 + 0.6, y1 + 0.6, wall - 0.01), texture=TRIM, metres=3.0))
    parts.append(_block(works, *crossing, 0.0, tower))
    parts.append(box((-11.0, -10.5, tower - 0.8), (10.0, 10.5, tower + 0.3), texture=TRIM, metres=3.0, color=_PALE))
    k = 3 + 2 * works.detail
    for side in (-1.0, 1.0):
        for x in (-17.0, -13.0, 11.0, 14.5):
            parts += _window(works, x, side * 10.5, 1.6, 0.06 * h, 0.20 * h, 0.0 if side < 0 else np.pi, k)
        for x in (-6.0, -0.5, 5.0):
            parts += _window(works, x, side * 20.0, 2.2, 0.06 * h, 0.21 * h, 0.0 if side < 0 else np.pi, k)
        for x in (-6.0, -2.5, 1.0, 4.5):
            parts += _window(works, x, side * 10.0, 1.4, 0.345 * h, 0.40 * h, 0.0 if side < 0 else np.pi, k)
    works.add(parts)


def _portico(works: _Works) -> None:
    """Three arches, a pediment and a flight of stairs."""
    h = works.height
    top = 0.24 * h
    parts = [_block(works, -26.0, -12.0, -19.5, 12.0, 0.0, top)]
    parts.append(box((-26.5, -12.5, top - 0.9), (-19.0, 12.5, top), texture=TRIM, metres=3.0, color=_PALE))
    parts.append(_hipped(-26.0, -8.0, -19.6, 8.0, top - 0.01, top + 0.06 * h))
    k = 5 + 3 * works.detail
    for y in (-7.5, 0.0, 7.5):
        parts += _window(works, -26.0, y, 3.8, 1.3, 0.17 * h, -0.5 * np.pi, k, door=True)
    for y in (-10.5, 10.5):  # plinths with statues
        parts.append(box((-28.2, y - 1.2, 0.0), (-26.05, y + 1.2, 0.13 * h), texture=TRIM, metres=3.0))
        statue = lathe(
            [
                (0, 0.0),
                (0.8, 0.01),
                (0.9, 0.8),
                (0.55, 1.8),
                (0.75, 2.4),
                (0.5, 3.0),
                (0.25, 3.2),
                (0.35, 3.5),
                (0, 3.8),
            ],
            max(6, works.segments // 3),
            texture=ROOFS["zinc"],
            color=(150, 205, 180),
        )
        parts.append(placed(statue, (-27.1, y, 0.13 * h - 0.01)))
    steps = np.arange(8)
    reach, rise = -30.0 + 0.5 * steps, 0.16 * (steps + 1)
    low = np.column_stack([reach, np.full(8, -9.0), np.zeros(8)])
    parts.append(
        box(low, np.column_stack([np.full(8, -25.9), np.full(8, 9.0), rise]), texture=TRIM, metres=3.0, color=_SHADE)
    )
    works.add(parts)


def _apse(works: _Works) -> None:
    """A round end with a half dome, and five chapels around it."""
    h, n = works.height, works.segments
    wall = 0.22 * h
    body = _drum(works, 17.0, 0.0, 8.5, 0.0, wall, n)
    roof = placed(_dome(8.8, wall - 0.01, 0.12 * h, n, texture=ROOFS["zinc"]), (17.0, 0.0, 0.0))
    rim = placed(_ring(9.0, wall - 0.6, 0.6, n), (17.0, 0.0, 0.0))
    works.add([body, roof, rim])
    for angle in np.radians([-72.0, -36.0, 0.0, 36.0, 72.0]):
        x, y = 17.0 + 8.8 * np.cos(angle), 8.8 * np.sin(angle)
        m = max(8, n // 2)
        chapel = _drum(works, x, y, 2.7, 0.0, 0.15 * h, m)
        works.add([chapel, placed(_dome(2.9, 0.15 * h - 0.01, 0.05 * h, m, texture=ROOFS["zinc"]), (x, y, 0.0))])


def _great_dome(works: _Works) -> None:
    """Drum, colonnade, ovoid dome, lantern and cross above the crossing."""
    h, n = works.height, works.segments
    x = -0.5
    low, high = 0.42 * h + 0.2, 0.59 * h
    parts = [
        _drum(works, x, 0.0, 8.2, low, high, n),
        placed(_ring(9.3, low - 0.01, 0.8, n), (x, 0.0, 0.0)),
        placed(_ring(9.4, high - 0.8, 0.9, n), (x, 0.0, 0.0)),
        placed(_dome(8.9, high, 0.30 * h, n), (x, 0.0, 0.0)),
        placed(_drum(works, 0.0, 0.0, 1.9, 0.885 * h, 0.935 * h, n // 2, solid=False), (x, 0.0, 0.0)),
        placed(_dome(2.2, 0.935 * h, 0.04 * h, n // 2), (x, 0.0, 0.0)),
        box((x - 0.15, -0.15, 0.97 * h), (x + 0.15, 0.15, h), texture=TRIM, metres=3.0),
        box((x - 0.13, -0.9, 0.983 * h), (x + 0.13, 0.9, 0.988 * h), texture=TRIM, metres=3.0),
    ]
    count = (8, 16, 20, 24)[works.detail]
    column = _column(0.42, low + 0.7, high - 0.75, (6, 6, 8, 12)[works.detail])
    for angle in 2.0 * np.pi * (np.arange(count) + 0.5) / count:
        if works.detail:
            parts.append(placed(column, (x + 8.75 * np.cos(angle), 8.75 * np.sin(angle), 0.0)))
        turn = angle + np.pi / count
        parts += _window(
            works,
            x + 8.19 * np.cos(np.pi / n) * np.cos(turn),
            8.19 * np.cos(np.pi / n) * np.sin(turn),
            1.2,
            low + 1.6,
            high - 1.6,
            turn + 0.5 * np.pi,
            3 + 2 * works.detail,
        )
    works.add(parts)


def _turret(works: _Works, x: float, y: float) -> None:
    h, n = works.height, max(8, works.segments * 5 // 8)
    low, high = 0.27 * h, 0.42 * h
    parts = [
        _block(works, x - 3.6, y - 3.6, x + 3.6, y + 3.6, 0.0, low + 1.0),
        _drum(works, x, y, 2.9, low, high, n),
        placed(_ring(3.4, low + 0.9, 0.6, n), (x, y, 0.0)),
        placed(_ring(3.4, high - 0.6, 0.65, n), (x, y, 0.0)),
        placed(_dome(3.1, high, 0.14 * h, n), (x, y, 0.0)),
        placed(_column(0.35, 0.545 * h, 0.59 * h, 8), (x, y, 0.0)),
    ]
    count = 4 if works.detail == 0 else 8
    for i in range(count):
        turn = 2.0 * np.pi * (i + 0.5) / count
        reach = 2.89 * np.cos(np.pi / n)
        parts += _window(
            works,
            x + reach * np.cos(turn),
            y + reach * np.sin(turn),
            1.0,
            low + 2.2,
            high - 1.0,
            turn + 0.5 * np.pi,
            3 + works.detail,
        )
    works.add(parts)


def _bell_tower(works: _Works) -> None:
    """Square, behind the apse, with tall openings below a small dome."""
    h, n = works.height, max(8, works.segments * 5 // 8)
    x = 25.5
    high = 0.66 * h
    parts = [_block(works, x - 4.2, -4.2, x + 4.2, 4.2, 0.0, high)]
    levels = np.array([0.40 * h, 0.52 * h, high])
    low, above = np.array([(x - 4.6, -4.6, -0.7)] * 3), np.array([(x + 4.6, 4.6, 0.05)] * 3)
    low[:, 2] += levels
    above[:, 2] += levels
    parts.append(box(low, above, texture=TRIM, metres=3.0))
    for side in range(4):
        turn = 0.5 * np.pi * side
        cx, cy = x + 4.2 * np.sin(turn), -4.2 * np.cos(turn)
        for shift in (-1.7, 1.7):
            dx, dy = shift * np.cos(turn), shift * np.sin(turn)
            parts += _window(works, cx + dx, cy + dy, 1.9, 0.54 * h, 0.64 * h, turn, 3 + 2 * works.detail)
            parts += _window(works, cx + dx, cy + dy, 1.5, 0.42 * h, 0.50 * h, turn, 3 + 2 * works.detail)
    parts.append(_drum(works, x, 0.0, 3.4, high, 0.73 * h, n))
    parts.append(placed(_ring(3.8, 0.73 * h - 0.6, 0.65, n), (x, 0.0, 0.0)))
    parts.append(placed(_dome(3.6, 0.73 * h, 0.13 * h, n), (x, 0.0, 0.0)))
    parts.append(placed(_column(0.35, 0.85 * h, 0.895 * h, 8), (x, 0.0, 0.0)))
    works.add(parts)


# -------------------------------------------------------------------------------------------------------------- bodies


def _block(works: _Works, x0: float, y0: float, x1: float, y1: float, low: float, high: float) -> Piece:
    outline = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    works.filled.append((outline, low, high))
    return extrusion(outline, low, high, texture=WALLS["stone"], metres=(25.6, 12.8), color=_STONE)


def _drum(
    works: _Works, x: float, y: float, radius: float, low: float, high: float, segments: int, *, solid: bool = True
) -> Piece:
    angle = 2.0 * np.pi * np.arange(segments) / segments
    outline = np.array([x, y]) + radius * np.column_stack([np.cos(angle), np.sin(angle)])
    if solid:
        works.filled.append((outline, low, high))
    return extrusion(outline, low, high, texture=WALLS["stone"], metres=(25.6, 12.8), color=_STONE)


def _hipped(x0: float, y0: float, x1: float, y1: float, low: float, high: float) -> Piece:
    """A low roof with a narrow top."""
    inset = 0.42 * min(x1 - x0, y1 - y0)
    below = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    above = below + inset * np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])
    corners = np.concatenate([np.column_stack([below, np.full(4, low)]), np.column_stack([above, np.full(4, high)])])
    return hexahedra(corners[None], texture=ROOFS["zinc"], metres=6.4, color=(232, 238, 240))


def _dome(radius: float, low: float, rise: float, segments: int, *, texture: int = TRIM) -> Piece:
    """Ovoid: steep at its foot, pointed at the top."""
    t = np.linspace(0.0, 1.0, max(4, segments // 2) + 1)[:-1]
    swell = np.cos(0.5 * np.pi * t**1.15) ** 0.8 * (1.0 + 0.10 * np.sin(np.pi * t))
    profile = np.concatenate([[(0.0, low)], np.column_stack([radius * swell, low + rise * t]), [(0.0, low + rise)]])
    return lathe(profile, segments, texture=texture, repeats=(8.0, 5.0), color=_PALE)


def _ring(radius: float, low: float, rise: float, segments: int) -> Piece:
    profile = [(0, low), (radius - 0.3, low), (radius, low + 0.4 * rise), (radius, low + rise), (0, low + rise)]
    return lathe(profile, segments, texture=TRIM, repeats=(12.0, 2.0), color=_PALE)


def _column(radius: float, low: float, high: float, segments: int) -> Piece:
    foot, r = 0.06 * (high - low), radius
    profile = [(0, low), (1.3 * r, low), (1.3 * r, low + foot), (r, low + 1.5 * foot), (0.85 * r, high - 1.5 * foot)]
    profile += [(1.3 * r, high - 0.5 * foot), (1.3 * r, high), (0, high)]
    return lathe(profile, segments, texture=TRIM, repeats=(2.0, 4.0), color=_PALE)


def _window(
    works: _Works,
    x: float,
    y: float,
    width: float,
    low: float,
    high: float,
    turn: float,
    arc: int,
    *,
    door: bool = False,
) -> list[Piece]:
    """Glass (or a door) under a round arch, a little before its wall, framed in stone from detail 1 on.

    ``turn`` 0 faces -y, counter-clockwise from there; ``arc``: pieces of the round.
    """
    made = []
    frame = [(0.3, 0.16, TRIM, _PALE)] if works.detail else []
    for grow, out, texture, color in (
        *frame,
        (0.0, 0.2, DOORS if door else PANES, (170, 170, 190) if not door else (255, 255, 255)),
    ):
        r = 0.5 * width + grow
        spring = high - 0.5 * width
        angle = np.linspace(0.0, np.pi, arc + 1)
        x_, z_ = r * np.cos(angle), spring + r * np.sin(angle)
        outline = np.concatenate([[(-r, low - grow), (r, low - grow)], np.column_stack([x_, z_])])
        flat = extrusion(outline, -0.05, out, texture=texture, metres=(8.0 * width, 2.0 * (high - low)), color=color)
        uv = flat.uv
        uv[..., 0] = 0.0625 + (uv[..., 0] if grow == 0.0 else 3.0 * uv[..., 0])
        uv[..., 1] -= (low - grow) / (2.0 * (high - low))
        upright = flat.vertices[:, [0, 2, 1]] * np.array([1.0, -1.0, 1.0])
        stood = Piece(upright, flat.triangles, flat.textures, flat.colors, uv)
        made.append(placed(stood, (x, y, 0.0), heading=turn))
    return made
