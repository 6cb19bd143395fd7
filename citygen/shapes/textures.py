"""The 34 pictures that generated cities are covered with, and which of them is which.

Facades reuse the painters of ``mmi.appearance.facade_styles``; walls, roofs, panes, doors and trims are painted here from a
seed, with NumPy alone. All sizes are powers of two, and every picture repeats sideways. A facade is eight bays wide
(``BAY``) and, above the ground floor, eight storeys high (``STOREY``); a ground floor is one storey high. ``PANES`` and
``DOORS`` are sheets of single panes, doors and shops. No light is painted except the shadows of small reliefs.
"""

from __future__ import annotations

from collections.abc import Iterator
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from mmi.appearance.facade_styles import CELL, STYLES, WIDTH, FloatImage, Style, noise, one_color
from mmi.city.model import Texture

__all__ = [
    "BAY",
    "DOORS",
    "FACADES",
    "GROUNDS",
    "NAMES",
    "PANES",
    "RAILING",
    "ROOFS",
    "ROOF_METRES",
    "SHUTTER",
    "STOREY",
    "TRIM",
    "WALLS",
    "WALL_METRES",
    "city_textures",
]

BAY = 3.2
"""Width in metres of one bay of a facade; a picture has eight."""
STOREY = 3.2
"""Height in metres of one storey of a facade; a picture of upper storeys has eight, of a ground floor one."""
WALL_METRES = (25.6, 12.8)
"""What a picture of wall without windows stands for, metres (width, height)."""
ROOF_METRES = 6.4
"""What a picture of roof stands for, metres (both ways)."""

_KINDS = ("stucco", "brick", "stone", "glass")
_ROOF_KINDS = ("tiles", "slate", "zinc", "gravel", "membrane")
_VARIANTS = 3

NAMES = (
    *(f"facade-{kind}-{i}" for kind in _KINDS for i in range(_VARIANTS)),
    *(f"ground-{kind}-{use}" for kind in _KINDS for use in ("shops", "homes")),
    *(f"wall-{kind}" for kind in _KINDS),
    *(f"roof-{kind}" for kind in _ROOF_KINDS),
    "panes",
    "doors",
    "shutter",
    "trim",
    "railing",
)
"""Names of the pictures, in their order."""

FACADES = MappingProxyType(
    {kind: tuple(NAMES.index(f"facade-{kind}-{i}") for i in range(_VARIANTS)) for kind in _KINDS}
)
"""Style -> pictures of its upper storeys, to choose from."""
GROUNDS = MappingProxyType(
    {kind: (NAMES.index(f"ground-{kind}-shops"), NAMES.index(f"ground-{kind}-homes")) for kind in _KINDS}
)
"""Style -> pictures of its ground floor: with shops, and with doors and windows only."""
WALLS = MappingProxyType({kind: NAMES.index(f"wall-{kind}") for kind in _KINDS})
"""Style -> picture of its wall without openings."""
ROOFS = MappingProxyType({kind: NAMES.index(f"roof-{kind}") for kind in _ROOF_KINDS})
"""Kind of roof -> its picture; v runs up the slope."""
PANES = NAMES.index("panes")
"""Sixteen panes, eight a row: the lower row windows with bars, the upper row single sheets of glass."""
DOORS = NAMES.index("doors")
"""Lower half: eight doors side by side; upper half: four shops side by side."""
SHUTTER = NAMES.index("shutter")
"""One leaf of a shutter."""
TRIM = NAMES.index("trim")
"""Pale stone for sills, cornices, slabs."""
RAILING = NAMES.index("railing")
"""Iron bars; a picture stands for 1.6 m of a railing of any height."""


def city_textures(seed: int) -> tuple[Texture, ...]:
    """All 34 pictures, in the order of ``NAMES``; the same for the same seed."""
    rng = np.random.default_rng([seed, 34])
    images = (np.clip(np.rint(image), 0, 255).astype(np.uint8) for image in _images(rng))
    return tuple(Texture(name, image) for name, image in zip(NAMES, images, strict=True))


def _images(rng: np.random.Generator) -> Iterator[FloatImage]:
    stucco, brick, concrete, glass = STYLES
    stone = Style("stone", _ashlar, stucco.storey, stucco.ground)
    for style in (stucco, brick, stone):
        for _ in range(_VARIANTS):
            yield _facade(style, rng)
    for style in (glass, glass, concrete):
        yield _facade(style, rng)
    homes = ((3, 7, 2, 3, 7, 3, 2, 7), (2, 0, 4, 7, 2, 3, 4, 7), (3, 7, 2, 3, 7, 3, 2, 7), (0, 2, 1, 3, 4, 5, 6, 7))
    for style, bays in zip((stucco, brick, stone, glass), homes, strict=True):
        yield _ground_floor(style, rng, tuple(range(8)))
        yield _ground_floor(style, rng, bays)
    for style in (stucco, brick, stone, concrete):
        wall = style.wall(rng, 256)
        yield wall * (1.0 + 0.012 * noise(rng, 256, 24))[..., None]
    yield from (_tiles(rng), _slate(rng), _zinc(rng), _gravel(rng), _membrane(rng))
    yield from (_panes(rng), _doors(rng), _shutter(rng), _trim(rng), _railing())


# ------------------------------------------------------------------------------------------------------------ facades


def _facade(style: Style, rng: np.random.Generator) -> FloatImage:
    """Eight storeys of eight bays, (512, 512, 3)."""
    image = style.wall(rng, 8 * CELL)
    for row in range(1, 9):
        top = (8 - row) * CELL
        for bay in range(8):
            style.storey(image[top : top + CELL, bay * CELL : (bay + 1) * CELL], rng, row, bay)
    image *= (1.0 + 0.03 * noise(rng, 8 * CELL, 24))[..., None]
    return image


def _ground_floor(style: Style, rng: np.random.Generator, bays: tuple[int, ...]) -> FloatImage:
    """One storey, (64, 512, 3): the bays of the style's painter in the order given."""
    image = style.wall(rng, CELL)
    for place, bay in enumerate(bays):
        style.ground(image[:, place * CELL : (place + 1) * CELL], rng, 0, bay)
    return image


def _ashlar(rng: np.random.Generator, height: int) -> FloatImage:
    """Blocks of cream limestone, 16 texels high and 32 wide, every second course moved by half a block."""
    courses = -(-height // 16)
    tone = np.repeat(np.repeat(rng.normal(1.0, 0.035, (courses, WIDTH // 32)), 16, axis=0), 32, axis=1)[:height]
    y = np.arange(height)[:, None]
    shift = 16 * (y // 16 % 2)
    tone = np.take_along_axis(tone, (np.arange(WIDTH)[None, :] + shift) % WIDTH, axis=1)
    wall = one_color((218.0, 204.0, 176.0), (tone + 0.015 * noise(rng, height, 2)).astype(np.float32))
    joint = (y % 16 == 15) | ((np.arange(WIDTH)[None, :] + shift) % 32 == 31)
    wall[joint] *= np.float32(0.84)
    return wall


# -------------------------------------------------------------------------------------------------------------- roofs


def _laid(
    rng: np.random.Generator, color: tuple[float, float, float], rows: int, columns: int, spread: float
) -> FloatImage:
    """(256, 256, 3) of ``rows`` x ``columns`` pieces, each of its own tone, every second row moved by half a piece."""
    tall, wide = 256 // rows, 256 // columns
    tone = np.repeat(np.repeat(rng.normal(1.0, spread, (rows, columns)), tall, axis=0), wide, axis=1)
    y, x = np.arange(256)[:, None], np.arange(256)[None, :]
    x = (x + wide // 2 * (y // tall % 2)) % 256
    tone = np.take_along_axis(tone, x, axis=1)
    tone = tone * (0.80 + 0.28 * ((y % tall) / tall))  # the lower edge of each row lies on top and catches light
    tone = tone * np.where(y % tall == 0, 0.72, 1.0) * np.where(x % wide == 0, 0.82, 1.0)
    return one_color(color, (tone + 0.03 * noise(rng, 256, 9, width=256)).astype(np.float32))


def _tiles(rng: np.random.Generator) -> FloatImage:
    image = _laid(rng, (186.0, 98.0, 70.0), 16, 16, 0.07)
    bulge = np.sin(np.pi * ((np.arange(256) % 16) + 0.5) / 16.0)
    image *= (0.86 + 0.18 * bulge)[None, :, None].astype(np.float32)
    return image


def _slate(rng: np.random.Generator) -> FloatImage:
    return _laid(rng, (98.0, 106.0, 120.0), 32, 16, 0.08)


def _zinc(rng: np.random.Generator) -> FloatImage:
    image = one_color((160.0, 170.0, 180.0), 1.0 + 0.03 * noise(rng, 256, 7, width=256))
    image[:, ::32] *= np.float32(1.14)
    image[:, 1::32] *= np.float32(0.82)
    image[:, 2::32] *= np.float32(0.9)
    image[::128] *= np.float32(0.86)
    return image


def _gravel(rng: np.random.Generator) -> FloatImage:
    grain = 0.09 * noise(rng, 256, 1, width=256) + 0.05 * noise(rng, 256, 3, width=256)
    return one_color((168.0, 163.0, 154.0), 1.0 + grain + 0.03 * noise(rng, 256, 33, width=256))


def _membrane(rng: np.random.Generator) -> FloatImage:
    image = one_color((150.0, 150.0, 148.0), 1.0 + 0.015 * noise(rng, 256, 5, width=256))
    image *= (1.0 + 0.015 * noise(rng, 256, 41, width=256))[..., None]
    image[::64] *= np.float32(0.82)
    return image


# ------------------------------------------------------------------------------------------------ panes, doors, trims


def _pane(rng: np.random.Generator, *, height: int, width: int, sky: float) -> FloatImage:
    """Glass: a dark room below, sky mirrored above, perhaps curtains, a blind or a lamp."""
    y, x = np.linspace(0.0, 1.0, height)[:, None, None], np.linspace(-1.0, 1.0, width)[None, :, None]
    fall = np.clip(y**0.8 + 0.14 * x * rng.choice([-1.0, 1.0]), 0.0, 1.0)
    above = np.array([150.0, 172.0, 194.0]) * sky + np.array([52.0, 60.0, 70.0]) * (1.0 - sky)
    image: NDArray[np.float64] = (above + (np.array([36.0, 42.0, 50.0]) - above) * fall) * rng.uniform(0.88, 1.1)
    dice = rng.random()
    if dice < 0.4:
        curtain = np.abs(x) > rng.uniform(0.3, 0.65)
        folds = 0.9 + 0.1 * np.cos(40.0 * x)
        image = np.where(curtain, 0.45 * image + 0.55 * np.array([218.0, 212.0, 200.0]) * folds, image)
    elif dice < 0.6:
        blind = y < rng.uniform(0.2, 0.7)
        image = np.where(blind, 0.25 * image + 0.75 * np.array([206.0, 202.0, 190.0]), image)
    elif dice < 0.68:
        image = 0.5 * image + 0.5 * np.array([250.0, 206.0, 140.0])
    return image.astype(np.float32)


def _panes(rng: np.random.Generator) -> FloatImage:
    """(256, 512, 3): see ``PANES``."""
    sheet = np.empty((256, 512, 3), dtype=np.float32)
    for i in range(8):
        upper = sheet[:128, 64 * i : 64 * i + 64]
        upper[:] = _pane(rng, height=128, width=64, sky=0.8)
        lower = sheet[128:, 64 * i : 64 * i + 64]
        lower[:] = _pane(rng, height=128, width=64, sky=0.5)
        for cell, frame in ((upper, (84.0, 90.0, 96.0)), (lower, (228.0, 225.0, 216.0))):
            cell[:3] = cell[-4:] = frame
            cell[:, :3] = cell[:, -3:] = frame
            cell[3:9, 3:-3] *= np.float32(0.66)  # the lintel's shadow
            cell[3:-4, 3:5] *= np.float32(0.78)
        lower[:, 30:34] = (228.0, 225.0, 216.0)
        for row in (32, 64, 96):
            lower[row : row + 2] = (228.0, 225.0, 216.0)
    return sheet


def _doors(rng: np.random.Generator) -> FloatImage:
    """(256, 512, 3): see ``DOORS``."""
    sheet = np.empty((256, 512, 3), dtype=np.float32)
    paints = (
        (92, 58, 36),
        (48, 74, 60),
        (58, 62, 84),
        (112, 40, 36),
        (64, 54, 46),
        (36, 48, 82),
        (120, 96, 60),
        (70, 74, 76),
    )
    for i, paint in enumerate(paints):
        door = sheet[128:, 64 * i : 64 * i + 64]
        door[:] = paint
        door[4:26, 5:-5] = _pane(rng, height=22, width=54, sky=0.5)
        door[14:16] = door[:4] = door[:, :4] = door[:, -4:] = np.array(paint) * 0.8
        for x in (8, 36):
            for y0, y1 in ((34, 62), (68, 120)):
                door[y0:y1, x : x + 20] *= np.float32(0.74)
                door[y0 + 2 : y1 - 2, x + 2 : x + 18] *= np.float32(1.3)
        door[28:, 31:33] = (24.0, 20.0, 18.0)
        door[76:80, 36:39] = (226.0, 196.0, 110.0)
        door[:5] *= np.float32(0.6)
    for i in range(4):
        shop = sheet[:128, 128 * i : 128 * i + 128]
        paint = paints[int(rng.integers(8))]
        shop[:] = paint
        shop[6:20, 10:-10] = np.array(paint) * 1.15
        shop[9:16, 28:-28:2] = (236.0, 224.0, 192.0)  # the name, too far away to read
        shop[24:112, 6:88] = 0.65 * _pane(rng, height=88, width=82, sky=0.25) + np.array([86.0, 75.0, 57.0])
        for _ in range(14):
            x, tall = int(rng.integers(8, 78)), int(rng.integers(6, 34))
            shop[110 - tall : 110, x : x + int(rng.integers(4, 10))] = rng.integers(60, 230, 3)
        shop[28:124, 94:122] = np.array(paint) * 0.8
        shop[32:116, 97:119] = _pane(rng, height=84, width=22, sky=0.3)
        shop[24:30, 6:122] *= np.float32(0.6)
    return sheet


def _shutter(rng: np.random.Generator) -> FloatImage:
    image = one_color((206.0, 208.0, 202.0), 1.0 + 0.02 * noise(rng, 128, 5, width=64))
    for row in range(8, 120, 6):
        image[row : row + 2, 6:-6] *= np.float32(0.66)
        image[row + 2 : row + 4, 6:-6] *= np.float32(0.88)
    image[:, :2] *= np.float32(0.8)
    image[62:66] = (206.0, 208.0, 202.0)
    return image


def _trim(rng: np.random.Generator) -> FloatImage:
    return one_color(
        (222.0, 214.0, 198.0), 1.0 + 0.03 * noise(rng, 128, 3, width=128) + 0.02 * noise(rng, 128, 21, width=128)
    )


def _railing() -> FloatImage:
    """Bars before a dim wall; a handrail above, a rail below."""
    image: NDArray[np.float32] = np.full((64, 128, 3), (122.0, 120.0, 116.0), dtype=np.float32)
    for x in range(2, 128, 8):
        image[:, x : x + 3] = (40.0, 42.0, 46.0)
    y, x_ = np.mgrid[:64, :128]
    ring = np.abs(np.hypot(y - 32.0, x_ % 32 - 16.0) - 10.0) < 1.8
    image[ring] = (40.0, 42.0, 46.0)
    image[:6] = image[-5:] = (34.0, 36.0, 40.0)
    return image
