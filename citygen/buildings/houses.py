"""Houses on any footprint, in four styles, under four kinds of roof, in four degrees of detail.

0 is a prism; 1 has walls with pictures of windows and a real roof; 2 has windows and doors that are recesses, sills and
cornices; 3 has balconies, shutters, dormers and chimneys. From 1 on a house is a closed mesh: walls, roof and a floor at its
base, and trims that are closed bodies of their own. Its prisms contain it, trims included; its core lies within its walls.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from shapely.geometry import Polygon

from citygen.buildings.roofs import CAP, Roof, fill, raise_roof
from citygen.buildings.trims import Bodies, balconies, chimneys, cornices, dormers, overhang, roof_huts, shutters, sills
from citygen.buildings.walls import Look, Outline, Windows, outline_of, painted_walls, pierced_walls
from citygen.shapes.solids import Piece, compacted, join
from citygen.shapes.textures import BAY, ROOF_METRES, ROOFS, TRIM, WALL_METRES, WALLS
from mmi.city.model import CityObject, Prism
from mmi.foundation.errors import CityError

__all__ = ["ROOF_KINDS", "STYLES", "house"]

STYLES = ("stucco", "brick", "stone", "glass")
"""What walls are made of."""
ROOF_KINDS = ("flat", "gable", "hip", "mansard")
"""What may be on top; what an outline does not allow is replaced by the next simpler one."""

_WINDOWS = (Windows(1.2, 0.35, 0.5, 0.22), Windows(1.3, 0.9, 0.65, 0.18), Windows(1.25, 0.3, 0.5, 0.25))
_CURTAIN = Windows(2.75, 0.55, 0.25, 0.12)
_TINTS = (
    ((255, 252, 247), (255, 242, 214), (247, 229, 204), (250, 220, 200), (228, 236, 242), (240, 232, 190)),
    ((255, 255, 255), (229, 219, 214), (255, 255, 230), (209, 204, 204), (255, 237, 224), (240, 225, 225)),
    ((255, 255, 255), (250, 242, 230), (240, 236, 230), (255, 248, 232), (235, 228, 218), (246, 246, 240)),
    ((255, 255, 255), (224, 242, 250), (235, 255, 247), (214, 222, 235), (255, 247, 235), (240, 240, 240)),
)
_MOST_OPENINGS = (0, 0, 90, 170)  # by detail; a house with more keeps painted walls
_MOST_SILLS = 45  # openings of a house at detail 2 that has sills
_MOST_RISE = 6.5  # metres that a pitched roof rises at most
_PARAPET = 0.55
_Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class _Cover:
    """A roof as built: its piece, its shape, the kind that it turned out to be, its materials and how it starts."""

    piece: Piece
    kind: str
    top: float
    deck: float  # the lowest point of its surface
    slope: float
    limit: float
    tint: _Floats
    texture: int


def house(
    id: str,  # noqa: A002
    footprint: Polygon,
    *,
    base: float,
    eaves: float,
    style: str,
    roof: str,
    detail: int,
    rng: np.random.Generator,
    blind: Sequence[bool] | None = None,
) -> CityObject:
    """A house whose walls rise from ``base`` to ``eaves`` (heights, metres) around ``footprint``.

    ``style`` is one of ``STYLES``, ``roof`` of ``ROOF_KINDS``, ``detail`` 0 to 3. ``blind``: one flag an edge of the
    footprint's outer ring as given, for walls without windows. Textures are those of ``citygen.shapes.textures``. Raises
    CityError for other styles, roofs, details or heights, and for another number of flags.
    """
    edges = len(footprint.exterior.coords) - 1
    _check(id, style=style, roof=roof, detail=detail, base=base, eaves=eaves, edges=edges, flags=blind)
    if detail == 0:
        return CityObject(id, (Prism(footprint, base, eaves),))
    outline = outline_of(footprint, blind)
    look = _look(base, eaves, style, rng)
    if look.levels[1] - base < 2.4:
        outline = replace(outline, blind=np.ones_like(outline.blind))
    windows = _CURTAIN if style == "glass" else _WINDOWS[STYLES.index(style)]
    bays = np.maximum(1.0, np.rint(outline.room[~outline.blind] / BAY)).sum()
    pierced = detail >= 2 and bays * (len(look.levels) - 1) <= _MOST_OPENINGS[detail]
    modern = style == "glass"
    walls = pierced_walls(outline, look, windows, rng, modern=modern) if pierced else painted_walls(outline, look)
    cover = _cover(outline, look, roof, rng)
    pieces = [walls, _floor(outline, look), cover.piece]
    bodies: list[Bodies] = []
    if detail >= 2:
        with_sills = pierced and style != "glass" and (detail == 3 or bays * (len(look.levels) - 1) < _MOST_SILLS)
        bodies = _trims(
            outline, look, windows, footprint, cover, rng, detail=detail, pierced=pierced, with_sills=with_sills
        )
    pieces += [one.piece for one in bodies]
    mesh = compacted(join(pieces))
    top = max(cover.top, *(one.high for one in bodies)) if bodies else cover.top
    prisms = [Prism(footprint, base, top)]
    outside = [one for one in bodies if one.out > 0.0]
    if outside:
        around = overhang(outline, footprint, max(one.out for one in outside))
        prisms.append(Prism(around, min(one.low for one in outside) - 1e-3, max(one.high for one in outside) + 1e-3))
    inner = footprint.buffer(-windows.recess - 0.01, join_style="mitre") if pierced else footprint
    parts = [inner] if isinstance(inner, Polygon) else list(inner.geoms)
    solid = min(eaves, cover.deck)
    core = tuple(Prism(part, base, solid) for part in parts if not part.is_empty and part.area > 0.01)
    return CityObject(id, tuple(prisms), mesh, core if solid > base else ())


def _check(
    id: str,  # noqa: A002
    *,
    style: str,
    roof: str,
    detail: int,
    base: float,
    eaves: float,
    edges: int,
    flags: Sequence[bool] | None,
) -> None:
    if style not in STYLES:
        raise CityError(f"house {id}: a style of {', '.join(STYLES)} expected, found {style!r}")
    if roof not in ROOF_KINDS:
        raise CityError(f"house {id}: a roof of {', '.join(ROOF_KINDS)} expected, found {roof!r}")
    if detail not in range(4):
        raise CityError(f"house {id}: a detail of 0 to 3 expected, found {detail!r}")
    if not (math.isfinite(base) and math.isfinite(eaves) and base < eaves):
        raise CityError(f"house {id}: eaves above its base expected, found base {base!r}, eaves {eaves!r}")
    if flags is not None and len(flags) != edges:
        raise CityError(f"house {id}: {edges} flags of blind walls expected, one an edge, found {len(flags)}")


def _look(base: float, eaves: float, style: str, rng: np.random.Generator) -> Look:
    """What is left to chance, and the heights of floors: the ground floor is higher, those above are about 3.2 m high."""
    dice = rng.random(5)
    shops = bool(dice[0] < 0.55) and eaves - base > 6.5
    first = 4.0 if shops else 3.5
    upper = eaves - base - first
    if upper < 2.4:
        levels = np.array([base, eaves])
    else:
        levels = np.append(base, np.linspace(base + first, eaves, max(1, round(upper / 3.2)) + 1))
    choices = _TINTS[STYLES.index(style)]
    tint = np.array(choices[int(dice[1] * len(choices))]) * (0.92 + 0.08 * dice[2])
    return Look(style, tint, levels, shops, int(dice[3] * 3), int(dice[4] * 8))


def _floor(outline: Outline, look: Look) -> Piece:
    """The underside, at the base."""
    triangles = fill(outline.points, outline.ends)
    points = np.column_stack([outline.points, np.full(len(outline.points), look.levels[0])])
    m = len(triangles)
    uv = points[triangles[:, ::-1]][..., :2] / ROOF_METRES
    return Piece(
        points, triangles[:, ::-1], np.full(m, ROOFS["gravel"]), np.full((m, 3), 128.0), uv - uv.min(initial=0.0)
    )


# --------------------------------------------------------------------------------------------------------------- roof


def _cover(outline: Outline, look: Look, kind: str, rng: np.random.Generator) -> _Cover:
    """The roof asked for, or the next simpler one that the outline allows, down to a flat lid."""
    eaves = float(look.levels[-1])
    tint = np.full(3, 255.0) * rng.uniform(0.84, 1.0) + rng.uniform(-6.0, 6.0, 3)
    pitch = {"brick": 0.75, "stone": 0.8, "stucco": 0.55, "glass": 0.35}[look.style]
    material = {"brick": "tiles", "stone": "slate", "stucco": "tiles", "glass": "zinc"}[look.style]
    depth = _MOST_RISE / pitch
    pitched = ((0.0, eaves), (depth, eaves + _MOST_RISE))
    party = outline.party & outline.outer
    if kind == "mansard":
        profile = ((0.0, eaves), (1.1, eaves + 2.7), (9.0, eaves + 2.7 + 0.22 * 7.9))
        made, ends = _raised(outline, profile, party)
        if made is not None:
            faces = (ROOFS["zinc" if look.style == "glass" else "slate"], ROOFS["zinc"])
            return _dressed(made, outline, look, "mansard", faces, tint, slope=2.7 / 1.1, limit=2.7, ends=ends)
    for tried, upright in (("gable", _gable_ends(outline) if kind == "gable" else None), ("hip", party)):
        if kind not in ("gable", tried) or upright is None:
            continue
        made, ends = _raised(outline, pitched, upright)
        if made is not None and (tried == "hip" or ends is not None):
            faces = (ROOFS[material], ROOFS[material])
            return _dressed(made, outline, look, tried, faces, tint, slope=pitch, limit=_MOST_RISE, ends=ends)
    flat = ("gravel", "membrane", "zinc")[int(rng.integers(3))]
    made = None
    if eaves - look.levels[0] > 2.0 * _PARAPET:
        profile = ((0.0, eaves), (0.3, eaves), (0.3, eaves - _PARAPET))
        made = raise_roof(outline.points, outline.after, profile)
    if made is None:
        triangles = fill(outline.points, outline.ends)
        n, m = len(outline.points), len(triangles)
        made = Roof(
            np.column_stack([outline.points, np.full(n, eaves)]),
            np.zeros(n),
            triangles,
            np.full(m, CAP),
            np.full(m, CAP),
            0.0,
        )
    return _dressed(made, outline, look, "flat", (TRIM, WALLS[look.style]), tint, cap=ROOFS[flat])


def _raised(
    outline: Outline, profile: tuple[tuple[float, float], ...], ends: NDArray[np.bool_]
) -> tuple[Roof | None, NDArray[np.bool_] | None]:
    """A roof whose faces at ``ends`` stand upright, and these ends; where that is impossible, one that slopes everywhere."""
    if ends.any() and not ends.all():
        made = raise_roof(outline.points, outline.after, profile, speeds=np.where(ends, 0.0, 1.0))
        if made is not None:
            return made, ends
    return raise_roof(outline.points, outline.after, profile), None


def _gable_ends(outline: Outline) -> NDArray[np.bool_]:
    """Edges that become gables: of a rectangle one pair of opposite sides (blind ones, or the shorter), of others the ends
    of wings. Edges in one line are one side.
    """
    n = len(outline.points)
    ends = np.zeros(n, dtype=bool)
    if not outline.outer.all():
        return ends
    last = np.roll(outline.along, 1, axis=0)
    turn = last[:, 0] * outline.along[:, 1] - last[:, 1] * outline.along[:, 0]
    corners = np.flatnonzero(np.abs(turn) > 0.05)
    if len(corners) < 4:
        return ends
    side = np.searchsorted(corners, np.arange(n), side="right") - 1
    side %= len(corners)
    length = np.bincount(side, outline.length)
    blind = np.bincount(side, outline.length * outline.party) > 0.5 * length
    convex = turn[corners] > 0.5
    if len(corners) == 4:
        if not convex.all():
            return ends
        pair = (2.0 * blind[:2] + 2.0 * blind[2:], length[:2] + length[2:])
        first = int(np.lexsort((pair[1], -pair[0]))[0])
        return np.asarray(side % 2 == first)
    wing = (
        convex & np.roll(convex, -1) & (length < np.roll(length, 1)) & (length < np.roll(length, -1)) & (length < 16.0)
    )
    return np.asarray(wing[side])


def _dressed(
    made: Roof,
    outline: Outline,
    look: Look,
    kind: str,
    textures: tuple[int, ...],
    tint: _Floats,
    *,
    slope: float = 0.0,
    limit: float = 0.0,
    cap: int | None = None,
    ends: NDArray[np.bool_] | None = None,
) -> _Cover:
    """Pictures on a roof: up the slope of each face, over the cap from above, as wall on gables."""
    corners = made.vertices[made.triangles]
    edge = np.maximum(made.edge, 0)
    along = ((corners[..., :2] - outline.points[edge][:, None]) * outline.along[edge][:, None]).sum(axis=2)
    uv = np.stack([along, made.run[made.triangles]], axis=-1) / ROOF_METRES
    level = made.segment == CAP
    uv[level] = (corners[level][..., :2] - outline.points[0]) / ROOF_METRES
    texture = np.array([*textures, cap if cap is not None else ROOFS["zinc"]])[made.segment]
    color = np.broadcast_to(tint, (len(texture), 3)).copy()
    wall = texture == WALLS[look.style]
    if ends is not None:
        wall |= ends[edge] & ~level
    texture = np.where(wall, WALLS[look.style], texture)
    uv[wall] = np.stack([along[wall], corners[wall][..., 2] - look.levels[0]], axis=-1) / np.array(WALL_METRES)
    color[wall] = look.tint
    piece = Piece(made.vertices, made.triangles, texture, color, uv)
    heights = made.vertices[:, 2]
    return _Cover(piece, kind, float(heights.max()), float(heights.min()), slope, limit, tint, textures[0])


def _trims(
    outline: Outline,
    look: Look,
    windows: Windows,
    footprint: Polygon,
    cover: _Cover,
    rng: np.random.Generator,
    *,
    detail: int,
    pierced: bool,
    with_sills: bool,
) -> list[Bodies]:
    """All that detail 2 and 3 add to walls and roof."""
    eaves = float(look.levels[-1])
    flat = cover.kind == "flat"
    made = [cornices(outline, look, flat=flat)]
    if with_sills:
        made.append(sills(outline, look, windows))
    if flat and cover.deck < eaves:
        made.append(roof_huts(footprint, rng, deck=cover.deck, count=1 + int(footprint.area / 400.0)))
    if detail >= 3:
        with_rails = pierced and (look.style != "glass" or bool(rng.random() < 0.4))
        if with_rails:
            made.append(balconies(outline, look, rng))
        if pierced and look.style == "stucco" and rng.random() < 0.6:
            made.append(shutters(outline, look, windows, rng))
        if not flat and look.style != "glass":
            made.append(
                dormers(
                    outline,
                    look,
                    footprint,
                    slope=cover.slope,
                    limit=min(cover.limit, cover.top - eaves),
                    roof=cover.texture,
                    tint=cover.tint,
                )
            )
        if look.style != "glass":
            foot = cover.deck - 0.1 if flat else eaves - 0.1
            made.append(chimneys(outline, footprint, rng, foot=foot, top=cover.top + (1.4 if flat else 0.6)))
    return [one for one in made if one is not None]
