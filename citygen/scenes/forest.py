"""A wood of a hundred trees with a path through it: about 105,000 polygons, after the scene of Schaufler and Stürzlinger 1996.

Four kinds of trees; each has a trunk and branches, closed tubes, and leaves that are single triangles. Nothing in it surely
hides what is behind it, so the trees have no core.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from citygen.scenes.paths import footways
from citygen.shapes.solids import Piece, object_of, tube
from mmi.appearance.facade_styles import noise, one_color
from mmi.city.model import City, CityObject, Texture

__all__ = ["TREES", "forest"]

TREES = 100
"""Trees in a forest."""

_TRIANGLES = 1050  # of each tree
_SIZE = 90.0  # metres of the wood, both ways
_APART = 4.5  # metres between trunks
_CLEAR = 2.6  # metres from the middle of the path to the nearest trunk
_BARK, _WHITE_BARK, _LEAVES = range(3)
_Floats = NDArray[np.float64]

# Height, radius of the trunk, height of the lowest branch and length of the longest as shares of the height, how much
# branches rise, size of leaves in metres, colour of the leaves, bark.
_KINDS = (
    ("oak", 13.0, 0.34, 0.28, 0.42, 0.55, 0.80, (88, 122, 52), _BARK),
    ("birch", 14.0, 0.17, 0.30, 0.24, 0.70, 0.55, (128, 156, 66), _WHITE_BARK),
    ("spruce", 18.0, 0.26, 0.08, 0.24, -0.22, 0.85, (48, 88, 58), _BARK),
    ("beech", 16.0, 0.30, 0.35, 0.36, 0.85, 0.70, (104, 142, 60), _BARK),
)


def forest(seed: int) -> City:
    """The wood, the same for the same seed."""
    rng = np.random.default_rng([seed, 105])
    way = _path(rng)
    places = _places(rng, way)
    objects = tuple(_tree(f"tree/{i}", place, rng) for i, place in enumerate(places))
    ends = [0, 10, 20, 30, len(way) - 1]
    nodes = [(float(way[i, 0]), float(way[i, 1])) for i in ends]
    ways = [(i, i + 1, way[ends[i] + 1 : ends[i + 1]]) for i in range(len(ends) - 1)]
    return City(
        objects=objects,
        streets=footways(nodes, ways, half_width=1.0),
        crs="local",
        origin=(0.0, 0.0, 0.0),
        source=f"forest-{seed}",
        textures=_textures(rng),
    )


def _textures(rng: np.random.Generator) -> tuple[Texture, ...]:
    """Brown bark, white bark with dark scars, and a tuft of leaves; (256, 128), (256, 128) and (128, 128)."""
    ridges = 0.16 * noise(rng, 256, 3, width=128) + 0.12 * np.sin(np.arange(128) * 2 * np.pi / 16)[None, :]
    brown = one_color((112.0, 92.0, 74.0), (1.0 + ridges).astype(np.float32))
    white = one_color((222.0, 218.0, 208.0), 1.0 + 0.04 * noise(rng, 256, 3, width=128))
    for _ in range(40):
        y, x = int(rng.integers(250)), int(rng.integers(110))
        white[y : y + int(rng.integers(1, 5)), x : x + int(rng.integers(6, 18))] *= np.float32(0.35)
    tuft = one_color((226.0, 232.0, 214.0), (1.0 + 0.16 * noise(rng, 128, 5, width=128)).astype(np.float32))
    tuft *= (1.0 + 0.10 * noise(rng, 128, 1, width=128))[..., None]
    images = (np.clip(np.rint(image), 0, 255).astype(np.uint8) for image in (brown, white, tuft))
    return tuple(Texture(name, image) for name, image in zip(("bark", "birch", "leaves"), images, strict=True))


def _path(rng: np.random.Generator) -> _Floats:
    """(41, 2) points of a winding path from west to east."""
    x = np.linspace(-0.5, 0.5, 41) * _SIZE
    phase = rng.uniform(0.0, 2.0 * np.pi, 2)
    return np.column_stack([x, 9.0 * np.sin(x / 13.0 + phase[0]) + 4.0 * np.sin(x / 6.0 + phase[1])])


def _places(rng: np.random.Generator, way: _Floats) -> _Floats:
    """(TREES, 2) places for trunks, away from the path and from one another."""
    chosen = np.empty((0, 2))
    while len(chosen) < TREES:
        place = rng.uniform(-0.5 * _SIZE, 0.5 * _SIZE, 2)
        if np.hypot(*(way - place).T).min() < _CLEAR + 0.3 * _SIZE / 40:
            continue
        if not len(chosen) or np.hypot(*(chosen - place).T).min() > _APART:
            chosen = np.vstack([chosen, place])
    return chosen


def _tree(id: str, place: _Floats, rng: np.random.Generator) -> CityObject:  # noqa: A002
    _, height, radius, lowest, reach, rise, leaf, color, bark = _KINDS[int(rng.integers(len(_KINDS)))]
    size = rng.uniform(0.75, 1.2)
    height, radius = height * size, radius * size
    t = np.linspace(0.0, 1.0, 7)
    bend = rng.normal(0.0, 0.025 * height, 2)
    trunk_path = np.column_stack([np.outer(t**2, bend), height * t])
    flare = np.array([1.5, 1.0, 0.85, 0.68, 0.5, 0.3, 0.08])
    pieces = [tube(trunk_path, radius * flare, 7, texture=bark, repeats=(1.0, height / 2.0))]
    count = 16
    up = lowest + (0.97 - lowest) * (np.arange(count) + rng.uniform(0.0, 0.8, count)) / count
    azimuth = 2.399963 * np.arange(count) + rng.uniform(-0.4, 0.4, count)
    spruce = rise < 0.0
    shape = (
        (1.0 - up) ** 0.9 + 0.06 if spruce else np.sin(np.pi * (0.12 + 0.86 * (up - lowest) / (1.0 - lowest))) ** 0.7
    )
    length = reach * height * shape * rng.uniform(0.8, 1.15, count)
    starts = np.column_stack([np.interp(up, t, trunk_path[:, i]) for i in range(3)])
    out = np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    s = np.array([0.0, 0.5, 1.0])
    lift = length[:, None] * (rise * s + 0.25 * (s**2 if not spruce else -s * s + s))
    along = np.concatenate(
        [starts[:, None, :2] + (length[:, None] * s)[..., None] * out[:, None], (starts[:, None, 2] + lift)[..., None]],
        axis=2,
    )
    thick = radius * np.interp(up, t, flare) * 0.42
    taper = np.array([1.0, 0.6, 0.2])
    pieces.append(tube(along, thick[:, None] * taper, 4, texture=bark, repeats=(1.0, 2.0)))
    wood = sum(len(piece.triangles) for piece in pieces)
    pieces.append(_leaves(along, length, _TRIANGLES - wood, leaf * size, color, rng, hanging=spruce))
    moved = np.array([*place, -0.05])
    return object_of(
        id, [Piece(one.vertices + moved, one.triangles, one.textures, one.colors, one.uv) for one in pieces]
    )


def _leaves(
    branches: _Floats,
    length: _Floats,
    count: int,
    size: float,
    color: tuple[int, int, int],
    rng: np.random.Generator,
    *,
    hanging: bool,
) -> Piece:
    """Triangles around the outer parts of branches (b, 3, 3), more on longer ones."""
    weight = length + 0.3 * length.mean()
    branch = rng.choice(len(branches), size=count, p=weight / weight.sum())
    s = rng.uniform(0.25, 1.08, count) * 2.0
    low = np.minimum(s.astype(np.int64), 1)
    part = (s - low)[:, None]
    centre = branches[branch, low] * (1.0 - part) + branches[branch, low + 1] * part
    spread = (0.10 if hanging else 0.26) * length[branch] + 0.15
    centre = centre + rng.normal(0.0, 1.0, (count, 3)) * spread[:, None] * np.array(
        [1.0, 1.0, 0.55 if hanging else 0.75]
    )
    centre[:, 2] = np.maximum(centre[:, 2], 0.6)
    a = rng.normal(size=(count, 3)) + np.array([0.0, 0.0, -0.8 if hanging else 0.2])
    a /= np.linalg.norm(a, axis=1)[:, None]
    b = np.cross(a, rng.normal(size=(count, 3)))
    b /= np.linalg.norm(b, axis=1)[:, None]
    scale = size * rng.uniform(0.7, 1.25, (count, 1))
    corners = np.stack(
        [centre - 0.6 * scale * a, centre + scale * (0.5 * a - 0.6 * b), centre + scale * (0.5 * a + 0.6 * b)], axis=1
    )
    corners[..., 2] = np.maximum(corners[..., 2], 0.2)
    # Leaves inside and below get less light.
    height = (centre[:, 2] - centre[:, 2].min()) / max(float(np.ptp(centre[:, 2])), 1e-9)
    shade = (0.72 + 0.28 * height) * rng.uniform(0.82, 1.12, count)
    colors = np.clip(shade[:, None] * np.array(color) * rng.uniform(0.94, 1.06, (count, 3)), 0.0, 255.0)
    uv = rng.uniform(0.0, 1.0, (count, 1, 2)) + np.array([(0.25, 0.0), (0.0, 0.5), (0.5, 0.5)])
    return Piece(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), np.full(count, _LEAVES), colors, uv)
