"""A plant of pipes: a thousand pieces of a thousand triangles each, copies of a few, after the scenes that image caches and
layered depth images are measured with.

Racks of straight pieces, elbows and valves stand in rows with aisles between them. Copies differ by position, quarter turn
and paint; all are closed, and none surely hides anything, so they have no core.
"""

from __future__ import annotations

import networkx as nx
import numpy as np
from numpy.typing import NDArray
from shapely.geometry import box as rectangle

from citygen.scenes.paths import footways
from citygen.shapes.solids import Piece, join, lathe, painted, placed, tube
from mmi.appearance.facade_styles import noise, one_color
from mmi.city.model import PLAIN, City, CityObject, Prism, Texture, TriangleMesh

__all__ = ["PIECES", "pipes"]

PIECES = (10, 20, 5)
"""Pieces (across, along, up); each has a thousand triangles."""

_STEP = (5.0, 2.4, 1.5)  # metres between pieces
_LENGTH = 2.4  # metres of a piece
_PAINTS = ((176, 182, 188), (70, 112, 160), (196, 160, 60), (86, 140, 96), (168, 74, 62), (208, 206, 200))
_Floats = NDArray[np.float64]


def pipes(seed: int) -> City:
    """The plant, the same for the same seed: ``PIECES`` objects, a million triangles."""
    rng = np.random.default_rng([seed, 1000])
    across, along, up = PIECES
    kinds = (_straight(), _elbow(), _valve())
    i, j, k = (one.ravel() for one in np.meshgrid(np.arange(across), np.arange(along), np.arange(up), indexing="ij"))
    position = np.column_stack([_STEP[0] * i, _STEP[1] * j, 0.7 + _STEP[2] * k])
    # Runs go along; every fifth piece bends away, some others are valves.
    dice = rng.random(len(i))
    kind = np.where(j % 5 == 4, 1, np.where(dice < 0.25, 2, 0))
    quarter = np.where(kind == 1, 1 + 2 * rng.integers(2, size=len(i)), 1)
    paint = (i + 2 * k + rng.integers(2, size=len(i))) % len(_PAINTS)
    objects: list[CityObject | None] = [None] * len(i)
    for which, piece in enumerate(kinds):
        chosen = np.flatnonzero(kind == which)
        for n, one in zip(
            chosen.tolist(), _copies(piece, position[chosen], quarter[chosen], paint[chosen]), strict=True
        ):
            objects[n] = CityObject(f"pipe/{i[n]}-{j[n]}-{k[n]}", (_bounds(one.vertices),), one, ())
    return City(
        objects=tuple(one for one in objects if one is not None),
        streets=_aisles(),
        crs="local",
        origin=(0.0, 0.0, 0.0),
        source=f"pipes-{seed}",
        textures=(_steel(rng),),
    )


def _copies(
    piece: Piece, position: _Floats, quarter: NDArray[np.int64], paint: NDArray[np.int64]
) -> list[TriangleMesh]:
    """Copies of a piece; they share all that is equal."""
    triangles, textures = piece.triangles.astype(np.int32), piece.textures.astype(np.int32)
    uv = piece.uv.astype(np.float32)
    shades = piece.colors / 255.0
    bare = textures[:, None] == PLAIN
    colors = [np.rint(np.where(bare, piece.colors, shades * np.array(one))).astype(np.uint8) for one in _PAINTS]
    turned = np.stack([placed(piece, (0.0, 0.0, 0.0), heading=0.5 * np.pi * q).vertices for q in range(4)])
    vertices = turned[quarter] + position[:, None]
    return [
        TriangleMesh(own, triangles, textures, colors[p], uv) for own, p in zip(vertices, paint.tolist(), strict=True)
    ]


def _bounds(points: _Floats) -> Prism:
    low, high = points.min(axis=0), points.max(axis=0)
    return Prism(rectangle(low[0], low[1], high[0], high[1]), float(low[2]), float(high[2]))


def _aisles() -> nx.MultiGraph:
    """A loop around each pair of racks: two cross aisles and one between every two racks."""
    x = [(n + 0.5) * _STEP[0] for n in range(-1, PIECES[0])]
    y = (-3.5, _STEP[1] * PIECES[1] + 1.5)
    nodes = [(one, end) for one in x for end in y]
    ways = [(2 * n, 2 * n + 1, ()) for n in range(len(x))]
    ways += [(2 * n + end, 2 * n + 2 + end, ()) for n in range(len(x) - 1) for end in (0, 1)]
    return footways(nodes, ways, half_width=0.8)


def _steel(rng: np.random.Generator) -> Texture:
    image = one_color(
        (236.0, 236.0, 236.0), 1.0 + 0.03 * noise(rng, 128, 2, width=128) + 0.03 * noise(rng, 128, 15, width=128)
    )
    image[60:68] *= np.float32(0.9)
    return Texture("steel", np.clip(np.rint(image), 0, 255).astype(np.uint8))


# ------------------------------------------------------------------------------------------------------------- pieces


def _straight() -> Piece:
    """A pipe along x with a flange at either end: 20 rings of 25 corners."""
    h = 0.5 * _LENGTH
    rings = [(0.24, -h), (0.36, -h + 0.01), (0.36, -h + 0.08), (0.24, -h + 0.09)]
    rings += [(0.24, x) for x in np.linspace(-h + 0.25, h - 0.25, 12)]
    rings += [(0.24, h - 0.09), (0.36, h - 0.08), (0.36, h - 0.01), (0.24, h)]
    return _lying(lathe([(0.0, -h), *rings, (0.0, h)], 25, texture=0, repeats=(4.0, 6.0)))


def _lying(piece: Piece) -> Piece:
    """From around z to around x."""
    return Piece(piece.vertices[:, [2, 0, 1]], piece.triangles, piece.textures, piece.colors, piece.uv)


def _elbow() -> Piece:
    """A quarter bend upwards of 20 rings of 25 corners."""
    t = np.linspace(0.0, 0.5 * np.pi, 20)
    r = 0.75 * 0.5 * _LENGTH
    path = np.column_stack([-0.5 * _LENGTH + r * np.sin(t) * 1.3, np.zeros(20), r * (1.0 - np.cos(t))])
    radii = np.full(20, 0.24)
    radii[[1, 2, -3, -2]] = 0.34
    return tube(path, radii, 25, texture=0, repeats=(4.0, 6.0))


def _valve() -> Piece:
    """A body (480), a stem (120) and a wheel with a round rim (400)."""
    h = 0.5 * _LENGTH
    rings = [
        (0.24, -h),
        (0.24, -0.6),
        (0.36, -0.58),
        (0.36, -0.5),
        (0.3, -0.45),
        (0.42, -0.2),
        (0.42, 0.2),
        (0.3, 0.45),
    ]
    rings += [(0.36, 0.5), (0.36, 0.58), (0.24, 0.6), (0.24, h)]
    body = _lying(lathe([(0.0, -h), *rings, (0.0, h)], 20, texture=0, repeats=(4.0, 6.0)))
    stem = lathe([(0, 0.3), (0.16, 0.3), (0.16, 0.5), (0.05, 0.55), (0.05, 0.78), (0.03, 0.8), (0, 0.8)], 12, texture=0)
    a, b = 2.0 * np.pi * np.arange(20) / 20, 2.0 * np.pi * np.arange(10) / 10
    around = 0.3 + 0.04 * np.cos(b)[None]
    rim = np.stack(
        [around * np.cos(a)[:, None], around * np.sin(a)[:, None], np.broadcast_to(0.72 + 0.04 * np.sin(b), (20, 10))],
        axis=-1,
    )
    m, n = (one.ravel() for one in np.meshgrid(np.arange(20), np.arange(10), indexing="ij"))
    p, q, r, s = 10 * m + n, 10 * ((m + 1) % 20) + n, 10 * ((m + 1) % 20) + (n + 1) % 10, 10 * m + (n + 1) % 10
    faces = np.concatenate([np.column_stack([p, q, r]), np.column_stack([p, r, s])])
    wheel = Piece(rim.reshape(-1, 3), faces, np.full(400, PLAIN), np.full((400, 3), 255.0), np.zeros((400, 3, 2)))
    return join([body, stem, painted(wheel, (200, 90, 80))])
