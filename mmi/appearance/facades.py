"""The texture of buildings that have none: one generated atlas of walls, windows, doors, shops and roofs for a whole city.

Everything here is painted with NumPy from a fixed seed: no fonts, no files, no OpenGL. The atlas repeats sideways (u) and never
vertically (v); it stacks, from the top, one band of storeys per style and then one strip of blind wall and one of roof per
style, each with its edge rows repeated above and below so that mipmaps do not bleed. Row 0 of a band is the ground floor and
lies at its lower edge. Every storey ends in a moulding, so that a wall may stop after any of them. Light is not painted, except
for the shadows that small reliefs throw: ``mmi.appearance.city_mesh`` multiplies by tint and shading.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmi.appearance.facade_styles import CELL, STYLES, WIDTH, FloatImage, Style, noise, one_color

__all__ = [
    "BAY",
    "BAYS",
    "ROWS",
    "STOREY",
    "STYLES",
    "TEXTURE_SIZE",
    "blind_point",
    "blind_strip",
    "facade_texture",
    "glass_of",
    "ground_texture",
    "roof_strip",
    "storey_v",
]

BAY = 3.2
"""Width in metres that one bay (a window and the wall around it) stands for."""
STOREY = 3.2
"""Height in metres that one row of windows stands for."""
BAYS = 8
"""Bays side by side in the atlas: u = 1 is ``BAYS * BAY`` metres."""
ROWS = 12
"""Storeys in a style's band, the ground floor included."""
TEXTURE_SIZE = (4096, WIDTH)
"""(height, width) of the atlas in texels."""

_PAD = 16
_STRIP = 80
_BAND = ROWS * CELL + 2 * _PAD
_BLIND = len(STYLES) * _BAND
_ROOF = _BLIND + len(STYLES) * (_STRIP + 2 * _PAD)


def storey_v(style: ArrayLike, row: ArrayLike) -> NDArray[np.float64]:
    """v (down, [0, 1]) of the lower edge of storey ``row`` (0 .. ROWS, any shape) of the style of that index."""
    texel = np.asarray(style) * _BAND + _PAD + (ROWS - np.asarray(row)) * CELL
    return np.asarray(texel / TEXTURE_SIZE[0], dtype=np.float64)


def blind_strip(style: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """v of the upper and the lower edge of the strip for walls without windows, by index of style (any shape)."""
    return _strip(_BLIND, style)


def blind_point(style: ArrayLike) -> tuple[float, NDArray[np.float64]]:
    """u and v of a point of the strip for walls without windows, by index of style (any shape): one colour for a plain wall."""
    top, bottom = blind_strip(style)
    return 0.5, 0.5 * (top + bottom)


def roof_strip(style: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """v of the upper and the lower edge of the strip for roofs, by index of style (any shape)."""
    return _strip(_ROOF, style)


@cache
def facade_texture() -> NDArray[np.uint8]:
    """The atlas, (4096, 512, 3) uint8 sRGB, read-only: a constant, painted at the first call."""
    atlas = np.empty((*TEXTURE_SIZE, 3), dtype=np.uint8)
    top = 0
    for picture in _pictures(np.random.default_rng(1999)):  # one at a time: as floats, all would be 25 MB
        top = _stack(atlas, top, picture)
    atlas.setflags(write=False)
    return atlas


def glass_of(texture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(h, w): 255 where a city's ``texture`` (h, w, 3 or 4) shows glass of painted facades, else 0.

    Only the windows of upper storeys count, and none of the city's own pictures.
    """
    facade = facade_texture()
    height, width = facade.shape[:2]
    glass = np.zeros(texture.shape[:2], dtype=np.uint8)
    repeats, left = divmod(texture.shape[1], width)
    if len(texture) < height or left or not np.array_equal(texture[:height, :width, :3], facade):
        return glass
    for i, style in enumerate(STYLES):
        for row in range(1, ROWS):
            top = i * _BAND + _PAD + (ROWS - 1 - row) * CELL
            for y0, y1, x0, x1 in style.panes:
                for left in range(0, repeats * width, CELL):
                    glass[top + y0 : top + y1, left + x0 : left + x1] = 255
    return glass


def ground_texture() -> NDArray[np.uint8]:
    """A grain to multiply the ground's colours with, (256, 256, 3) uint8 sRGB, seamless in both directions."""
    rng = np.random.default_rng(1997)
    grain = sum(weight * noise(rng, 256, size, width=256) for weight, size in ((5.0, 1), (5.0, 5), (6.0, 31)))
    return np.repeat(np.clip(np.rint(230.0 + grain), 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def _pictures(rng: np.random.Generator) -> Iterator[FloatImage]:
    """All bands, then all strips of blind walls, then all roof strips, without their padding."""
    for style in STYLES:
        yield _band(style, rng)
    # A glass front's blind walls are concrete.
    for style in (*STYLES[:3], STYLES[2]):
        yield _blind(style.wall(rng, 4 * CELL), rng)
    for roof in (_zinc_roof, _tar_roof, _gravel_roof, _membrane_roof):
        yield roof(rng)


def _band(style: Style, rng: np.random.Generator) -> FloatImage:
    """All storeys of a style, the ground floor lowest."""
    band = style.wall(rng, ROWS * CELL)
    for row in range(ROWS):
        top = (ROWS - 1 - row) * CELL
        for bay in range(BAYS):
            cell = band[top : top + CELL, bay * CELL : (bay + 1) * CELL]
            (style.storey if row else style.ground)(cell, rng, row, bay)
    band *= (1.0 + 0.03 * noise(rng, ROWS * CELL, 24))[..., None]
    return band


def _stack(atlas: NDArray[np.uint8], top: int, picture: FloatImage) -> int:
    """Put ``picture`` into the atlas from row ``top`` on, with its edge rows repeated; the row where the next one starts.

    ``picture`` is rounded in place.
    """
    first, last = top + _PAD, top + _PAD + len(picture)
    np.rint(picture, out=picture)
    np.clip(picture, 0.0, 255.0, out=picture)
    atlas[first:last] = picture
    atlas[top:first], atlas[last : last + _PAD] = atlas[first], atlas[last - 1]
    return last + _PAD


def _strip(start: int, style: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    top = start + np.asarray(style) * (_STRIP + 2 * _PAD) + _PAD
    return np.asarray(top / TEXTURE_SIZE[0]), np.asarray((top + _STRIP) / TEXTURE_SIZE[0])


# ------------------------------------------------------------------------------------------------------ blind walls and roofs


def _blind(wall: FloatImage, rng: np.random.Generator) -> FloatImage:
    """A wall without windows: the mean colour of ``wall`` with streaks of rain, as high as a strip."""
    streaks = 0.022 * noise(rng, 1, 3) + 0.015 * noise(rng, 1, 17) + 0.01 * noise(rng, _STRIP, 6)
    red, green, blue = wall.mean(axis=(0, 1), dtype=np.float64).tolist()
    return one_color((red, green, blue), 1.0 + streaks)


def _zinc_roof(rng: np.random.Generator) -> FloatImage:
    roof = one_color((158.0, 168.0, 178.0), 1.0 + 0.03 * noise(rng, _STRIP, 7))
    roof[:, ::8] *= 1.12
    roof[:, 1::8] *= 0.84
    roof[::40] *= 0.9
    return roof


def _tar_roof(rng: np.random.Generator) -> FloatImage:
    roof = one_color((118.0, 112.0, 106.0), 1.0 + 0.05 * noise(rng, _STRIP, 2) + 0.05 * noise(rng, _STRIP, 13))
    roof[::10] *= 0.88
    return roof


def _gravel_roof(rng: np.random.Generator) -> FloatImage:
    return one_color((172.0, 168.0, 160.0), 1.0 + 0.06 * noise(rng, _STRIP, 1) + 0.04 * noise(rng, _STRIP, 17))


def _membrane_roof(rng: np.random.Generator) -> FloatImage:
    roof = one_color((198.0, 200.0, 200.0), 1.0 + 0.025 * noise(rng, _STRIP, 9))
    roof[::20] *= 0.9
    roof[:, ::64] *= 0.9
    return roof
