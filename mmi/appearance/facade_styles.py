"""How the storeys of each style of facade are painted: windows, balconies, doors, shops, and the walls around them.

A painter works in place on one cell, one bay wide and one storey high, (64, 64, 3) float32 sRGB, row 0 at its top, with about 5
cm a texel. It draws every storey so that a wall may end above it: each starts with a moulding. Light and tint are not painted,
except for the shadows that small reliefs throw. ``mmi.appearance.facades`` stacks the results into the atlas.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

__all__ = ["CELL", "STYLES", "WIDTH", "FloatImage", "Style", "noise", "one_color"]

CELL = 64
"""Texels of a bay's width and of a storey's height."""
WIDTH = 512
"""Texels of the atlas's width, which every wall and roof spans."""

FloatImage = NDArray[np.float32]
"""(height, width, 3) sRGB, [0, 255] and a little beyond; float32, because a band of storeys is large."""
_Color = tuple[float, float, float]
_Surface = Callable[[np.random.Generator, int], FloatImage]
_Painter = Callable[[FloatImage, np.random.Generator, int, int], None]


@dataclass(frozen=True, slots=True)
class Style:
    """A kind of building.

    ``wall`` paints (height, WIDTH, 3) from a generator and a height; ``storey`` and ``ground`` paint a cell from a
    generator, the row (0 is the ground floor) and the bay. ``panes`` are rectangles of glass (from and to row, from and to
    column) in the cells of upper storeys.
    """

    name: str
    wall: _Surface
    storey: _Painter
    ground: _Painter
    panes: tuple[tuple[int, int, int, int], ...] = ()


def noise(rng: np.random.Generator, height: int, size: int, *, width: int = WIDTH) -> NDArray[np.float32]:
    """(height, width) of zero mean and unit deviation, in blots of about ``size`` texels, seamless in both directions."""
    grain = rng.standard_normal((height, width))
    uniform_filter(grain, size, output=grain, mode="wrap")
    grain -= grain.mean()
    grain /= grain.std()
    return grain.astype(np.float32)


def one_color(color: _Color, factor: NDArray[np.float32]) -> FloatImage:
    """``color`` times ``factor`` (height, width): a surface before anything is painted on it."""
    return factor[..., None] * np.array(color, dtype=np.float32)


def _fill(image: FloatImage, y0: int, y1: int, x0: int, x1: int, color: _Color) -> None:
    image[y0:y1, x0:x1] = color


def _shade(image: FloatImage, y0: int, y1: int, x0: int, x1: int, factor: float) -> None:
    image[y0:y1, x0:x1] *= factor


def _mix(image: FloatImage, y0: int, y1: int, x0: int, x1: int, color: _Color, share: float) -> None:
    image[y0:y1, x0:x1] += share * (np.asarray(color) - image[y0:y1, x0:x1])


def _pick(rng: np.random.Generator, colors: tuple[_Color, ...]) -> _Color:
    return colors[int(rng.integers(len(colors)))]


def _glazing(
    cell: FloatImage, rng: np.random.Generator, y0: int, y1: int, x0: int, x1: int, *, sky: float = 0.5
) -> None:
    """A pane: a dark room below, sky mirrored above (``sky``, how much of it), some curtains, blinds and lamps."""
    height, width = y1 - y0, x1 - x0
    fall = np.linspace(0.0, 1.0, height)[:, None, None] ** 0.8
    slant = np.linspace(-0.12, 0.12, width)[None, :, None] * rng.choice([-1.0, 1.0])
    mirrored = np.array([142.0, 163.0, 184.0]) * sky + np.array([48.0, 56.0, 66.0]) * (1.0 - sky)
    pane = mirrored + (np.array([38.0, 44.0, 52.0]) - mirrored) * np.clip(fall + slant, 0.0, 1.0)
    cell[y0:y1, x0:x1] = pane * rng.uniform(0.85, 1.1)
    dice = rng.random()
    if dice < 0.35:  # curtains drawn to the sides
        side = max(2, int(width * rng.uniform(0.18, 0.38)))
        _mix(cell, y0, y1, x0, x0 + side, (214, 208, 196), 0.55)
        _mix(cell, y0, y1, x1 - side, x1, (214, 208, 196), 0.55)
        cell[y0:y1, x0 + 1 : x0 + side : 3] *= 0.9
        cell[y0:y1, x1 - side + 1 : x1 : 3] *= 0.9
    elif dice < 0.55:  # a blind let down part of the way
        _mix(cell, y0, y0 + max(2, int(height * rng.uniform(0.2, 0.7))), x0, x1, (208, 204, 192), 0.7)
    elif dice < 0.63:  # somebody is at home
        _mix(cell, y0, y1, x0, x1, (250, 206, 140), 0.55)
        _mix(cell, y0 + height // 5, y0 + height // 5 + 2, x0 + width // 3, x1 - width // 3, (255, 240, 200), 0.8)


def _recess(cell: FloatImage, y0: int, y1: int, x0: int, x1: int) -> None:
    """The shadow that an opening's upper and left edges throw into it."""
    _shade(cell, y0, y0 + 3, x0, x1, 0.68)
    _shade(cell, y0, y1, x0, x0 + 1, 0.75)


def _frame(
    cell: FloatImage, y0: int, y1: int, x0: int, x1: int, color: _Color, *, across: tuple[int, ...] = ()
) -> None:
    """A window's frame, two texels wide, with one upright in the middle and bars at the rows ``across``."""
    middle = (x0 + x1) // 2
    for a, b, c, d in ((y0, y0 + 1, x0, x1), (y1 - 2, y1, x0, x1), (y0, y1, x0, x0 + 2), (y0, y1, x1 - 2, x1)):
        _fill(cell, a, b, c, d, color)
    _fill(cell, y0, y1, middle - 1, middle + 1, color)
    for y in across:
        _fill(cell, y, y + 1, x0, x1, color)


def _railing(cell: FloatImage, y0: int, y1: int, x0: int, x1: int) -> None:
    iron: _Color = (44, 46, 50)
    for x in range(x0, x1, 3):
        _mix(cell, y0, y1, x, x + 1, iron, 0.85)
    _fill(cell, y0, y0 + 2, x0, x1, iron)
    _fill(cell, y1 - 2, y1 - 1, x0, x1, iron)
    middle = (y0 + y1) // 2
    _mix(cell, middle - 2, middle + 2, x0, x1, iron, 0.35)


def _shop(cell: FloatImage, rng: np.random.Generator, *, x0: int, x1: int, top: int) -> None:
    """A shop: fascia board, lit window with wares, sometimes an awning, and a door or a stall riser."""
    paint = _pick(rng, ((38, 62, 52), (96, 34, 38), (36, 48, 82), (52, 50, 50), (150, 112, 62), (74, 92, 96)))
    _fill(cell, top, 64, x0, x1, paint)
    _shade(cell, top + 8, top + 10, x0, x1, 0.6)
    _mix(cell, top + 3, top + 6, x0 + 8, x1 - 8, (235, 222, 190), 0.75)  # the name, too far away to read
    for x in range(x0 + 10 + int(rng.integers(3)), x1 - 9, 5):
        _fill(cell, top + 3, top + 6, x, x + 1, paint)
    window = (top + 11, 55, x0 + 3, x1 - 3)
    _glazing(cell, rng, *window, sky=0.25)
    _mix(cell, *window, (244, 214, 164), rng.uniform(0.15, 0.5))
    for _ in range(9):
        x, tall = int(rng.integers(x0 + 5, x1 - 9)), int(rng.integers(3, 13))
        wares = (float(rng.integers(60, 240)), float(rng.integers(60, 210)), float(rng.integers(50, 200)))
        _mix(cell, 54 - tall, 54, x, x + int(rng.integers(2, 6)), wares, 0.6)
    _shade(cell, top + 11, top + 14, x0 + 3, x1 - 3, 0.65)
    door = x0 + 4 if rng.random() < 0.5 else x1 - 20
    _fill(cell, top + 13, 64, door, door + 16, paint)
    _glazing(cell, rng, top + 15, 57, door + 2, door + 14, sky=0.3)
    _fill(cell, 40, 43, door + 12, door + 13, (220, 200, 140))
    if rng.random() < 0.55:
        cloth = _pick(rng, ((172, 48, 44), (46, 94, 76), (214, 196, 160), (52, 74, 120)))
        _fill(cell, top + 8, top + 19, x0 - 1, x1 + 1, cloth)
        for x in range(x0 - 1, x1 + 1, 8):
            _mix(cell, top + 8, top + 19, x, x + 4, (238, 232, 218), 0.75)
        _shade(cell, top + 8, top + 10, x0 - 1, x1 + 1, 1.08)
        _shade(cell, top + 16, top + 19, x0 - 1, x1 + 1, 0.85)
        _shade(cell, top + 19, top + 26, x0, x1, 0.55)


def _door(cell: FloatImage, rng: np.random.Generator, *, top: int, arched: bool) -> None:
    wood = _pick(rng, ((92, 58, 36), (48, 74, 60), (58, 62, 84), (112, 40, 36), (64, 54, 46)))
    _shade(cell, top - 3, 64, 17, 47, 1.06)
    _fill(cell, top, 64, 20, 44, wood)
    _glazing(cell, rng, top, top + 9, 21, 43, sky=0.35)
    for x in (22, 33):
        for y0, y1 in ((top + 12, top + 24), (top + 26, 60)):
            _shade(cell, y0, y1, x, x + 9, 0.78)
            _shade(cell, y0 + 1, y1 - 1, x + 1, x + 8, 1.25)
    _fill(cell, top + 10, 64, 31, 33, (24, 20, 18))
    _fill(cell, top + 26, top + 28, 34, 36, (226, 196, 110))
    if arched:
        y, x = np.mgrid[top : top + 9, 20:44]
        cell[top : top + 9, 20:44][((x - 31.5) / 12.0) ** 2 + ((top + 9 - y) / 9.0) ** 2 > 1.0] = (206, 198, 182)
    _shade(cell, top, top + 2, 20, 44, 0.7)
    _fill(cell, 62, 64, 17, 47, (168, 164, 156))


# ------------------------------------------------------------------------------------------- stucco and stone


def _stucco_wall(rng: np.random.Generator, height: int) -> FloatImage:
    shade = 1.0 + 0.018 * noise(rng, height, 2) + 0.02 * noise(rng, height, 11)
    wall = one_color((232.0, 225.0, 211.0), shade)
    wall[15::16] *= 0.96
    return wall


def _stucco_storey(cell: FloatImage, rng: np.random.Generator, row: int, bay: int) -> None:
    balcony = row in (2, 5, 8)
    shutters = bay in (1, 4) and not balcony
    _shade(cell, 0, 3, 0, 64, 1.07)
    _shade(cell, 3, 4, 0, 64, 0.9)
    _shade(cell, 4, 7, 0, 64, 0.76 if row in (1, 4, 7) else 0.87)
    _shade(cell, 9, 62, 15, 49, 1.06)  # architrave
    _shade(cell, 10, 62, 48, 49, 0.8)
    _shade(cell, 8, 11, 13, 51, 1.08)
    _shade(cell, 11, 12, 13, 51, 0.7)
    _fill(cell, 13, 60, 20, 44, (206, 202, 192))
    _glazing(cell, rng, 13, 60, 20, 44)
    _frame(cell, 13, 60, 20, 44, (224, 220, 210), across=(24, 36, 48))
    _recess(cell, 13, 60, 20, 44)
    if shutters:
        paint = _pick(rng, ((222, 216, 204), (138, 150, 146), (120, 132, 142)))
        for x0 in (8, 45):
            _fill(cell, 13, 60, x0, x0 + 11, paint)
            cell[15:58:3, x0 + 2 : x0 + 9] *= 0.78
            _shade(cell, 13, 60, x0 + 10, x0 + 11, 0.7)
    if balcony:
        _railing(cell, 41, 60, 0, 64)
        _fill(cell, 60, 63, 0, 64, (216, 210, 198))
        _shade(cell, 63, 64, 0, 64, 0.55)
    else:
        _railing(cell, 47, 60, 19, 45)
        _shade(cell, 60, 62, 15, 49, 1.05)
        _shade(cell, 62, 64, 16, 50, 0.74)


def _stucco_ground(cell: FloatImage, rng: np.random.Generator, row: int, bay: int) -> None:
    for y in range(10 + row, 64, 9):
        _shade(cell, y, y + 1, 0, 64, 0.8)
        _shade(cell, y + 1, y + 2, 0, 64, 1.04)
    if bay in (0, 1, 4, 6):
        _shop(cell, rng, x0=3, x1=61, top=11)
    elif bay in (2, 5):
        _door(cell, rng, top=18, arched=True)
    else:
        _shade(cell, 14, 50, 16, 48, 1.06)
        _glazing(cell, rng, 17, 48, 20, 44)
        _frame(cell, 17, 48, 20, 44, (224, 220, 210), across=(27, 38))
        _recess(cell, 17, 48, 20, 44)
        _railing(cell, 32, 49, 20, 45)
        _shade(cell, 49, 51, 17, 47, 1.08)
        _shade(cell, 51, 53, 17, 48, 0.75)
    _shade(cell, 0, 5, 0, 64, 1.08)
    _shade(cell, 5, 8, 0, 64, 0.72)
    _shade(cell, 59, 64, 0, 64, 0.82)


# ------------------------------------------------------------------------------------------------------ brick


def _brick_wall(rng: np.random.Generator, height: int) -> FloatImage:
    bricks = (-(-height // 3), WIDTH // 8)
    tone, hue = rng.normal(1.0, 0.06, bricks), rng.normal(0.0, 4.0, bricks)
    colors = tone[..., None] * np.array([172.0, 108.0, 84.0]) + hue[..., None] * np.array([0.4, 1.0, 1.0])
    wall = np.repeat(np.repeat(colors.astype(np.float32), 3, axis=0), 8, axis=1)[:height]
    y, x = np.ogrid[:height, :WIDTH]
    mortar = (y % 3 == 2) | ((x + 4 * (y // 3 % 2)) % 8 == 7)
    wall[mortar] = wall[mortar] * np.float32(0.7) + np.float32(0.3) * np.array([174.0, 162.0, 148.0], dtype=np.float32)
    wall *= (1.0 + 0.025 * noise(rng, height, 19))[..., None]
    return wall


def _brick_storey(cell: FloatImage, rng: np.random.Generator, row: int, bay: int) -> None:
    stone: _Color = (206, 196, 178)
    _shade(cell, 0, 3, 0, 64, 1.14)
    _shade(cell, 3, 5, 0, 64, 0.72)
    if row in (1, 6, 11):
        _fill(cell, 0, 3, 0, 64, stone)
    left, right = (17, 47) if bay % 4 != 3 else (20, 44)
    _fill(cell, 9, 15, left - 3, right + 3, stone)
    _shade(cell, 14, 15, left - 3, right + 3, 0.8)
    _glazing(cell, rng, 15, 52, left, right)
    white: _Color = (226, 224, 216) if bay % 3 else (70, 74, 72)
    _frame(cell, 15, 52, left, right, white)
    _fill(cell, 32, 35, left, right, white)
    _shade(cell, 35, 37, left + 2, right - 2, 0.75)
    _recess(cell, 15, 52, left, right)
    _fill(cell, 52, 56, left - 3, right + 3, stone)
    _shade(cell, 56, 58, left - 2, right + 4, 0.66)
    if rng.random() < 0.14:  # an air conditioner under the sash
        _fill(cell, 42, 53, left + 6, left + 21, (186, 184, 178))
        cell[44:51:2, left + 8 : left + 19] *= 0.75
        _shade(cell, 53, 57, left + 6, left + 22, 0.6)


def _brick_ground(cell: FloatImage, rng: np.random.Generator, row: int, bay: int) -> None:
    stone = np.array([186.0, 168.0, 146.0])
    if bay in (1, 5, 6):
        _shop(cell, rng, x0=3, x1=61, top=10)
    else:
        cell[40 + row :] = 0.25 * cell[40 + row :] + 0.75 * stone
        if bay in (0, 3):
            _door(cell, rng, top=15, arched=False)
            _fill(cell, 9, 13, 13, 51, (206, 196, 178))
            _shade(cell, 13, 15, 13, 51, 0.7)
        else:
            _brick_storey(cell, rng, 0, bay)
    _fill(cell, 0, 5, 0, 64, (206, 196, 178))
    _shade(cell, 5, 8, 0, 64, 0.68)
    _shade(cell, 59, 64, 0, 64, 0.8)


# --------------------------------------------------------------------------------------------------- concrete


def _concrete_wall(rng: np.random.Generator, height: int) -> FloatImage:
    shade = 1.0 + 0.012 * noise(rng, height, 1) + 0.025 * noise(rng, height, 15)
    wall = one_color((216.0, 214.0, 208.0), shade)
    wall[:, ::64] *= 0.8
    wall[:, 1::64] *= 1.03
    return wall


def _concrete_storey(cell: FloatImage, rng: np.random.Generator, row: int, bay: int) -> None:
    _shade(cell, 0, 2, 0, 64, 1.08)
    _shade(cell, 2, 3, 0, 64, 0.82)
    loggia = bay % 4 == 2
    top, bottom = (8, 60) if loggia else (14, 46)
    for x in range(0, 64, 32):
        _glazing(cell, rng, top, bottom, x, x + 32, sky=0.62)
    for x in (0, 31, 63) if loggia else (0, 20, 42, 63):
        _fill(cell, top, bottom, x, x + 2, (92, 96, 100))
    _fill(cell, top, top + 1, 0, 64, (92, 96, 100))
    _shade(cell, top, top + 4, 0, 64, 0.62)
    if loggia:
        _shade(cell, top, bottom, 0, 64, 0.8)
        panel = (198, 202, 204) if row % 3 else (176, 150, 112)
        _fill(cell, 42, 60, 2, 62, panel)
        cell[42:60, 2:62:10] *= 0.82
        _fill(cell, 41, 43, 1, 63, (110, 114, 118))
        _shade(cell, 60, 64, 0, 64, 0.72)
    else:
        _shade(cell, bottom, bottom + 2, 0, 64, 1.1)
        _shade(cell, bottom + 2, bottom + 4, 0, 64, 0.8)
        for x in rng.integers(2, 60, 3):
            _shade(cell, bottom + 4, 64, int(x), int(x) + 2, 0.95)


def _concrete_ground(cell: FloatImage, rng: np.random.Generator, row: int, bay: int) -> None:
    _shade(cell, 0, 8 + row, 0, 64, 0.97)
    if bay in (0, 4, 5):
        _shop(cell, rng, x0=4, x1=60, top=9)
    else:
        _glazing(cell, rng, 11, 60, 6, 32, sky=0.4)
        _glazing(cell, rng, 11, 60, 32, 58, sky=0.4)
        for x in (6, 31, 56):
            _fill(cell, 11, 60, x, x + 2, (64, 68, 72))
        _fill(cell, 22, 23, 6, 58, (64, 68, 72))
        if bay == 2:
            _fill(cell, 22, 62, 18, 46, (58, 62, 66))
            for x in (20, 33):
                _glazing(cell, rng, 24, 60, x, x + 11, sky=0.3)
            _fill(cell, 40, 46, 30, 31, (212, 212, 212))
            _fill(cell, 16, 20, 12, 52, (178, 178, 176))
        _shade(cell, 11, 17, 6, 58, 0.6)
    _shade(cell, 0, 64, 0, 5, 0.93)
    _shade(cell, 60, 64, 0, 64, 0.8)


# ------------------------------------------------------------------------------------------------------ glass


def _glass_wall(rng: np.random.Generator, height: int) -> FloatImage:
    return one_color((150.0, 166.0, 180.0), 1.0 + 0.03 * noise(rng, height, 30))


def _glass_storey(cell: FloatImage, rng: np.random.Generator, row: int, bay: int) -> None:
    rise = row / 12  # higher panes mirror more sky
    for x in (0, 32):
        sky = np.array([128.0, 154.0, 178.0]) * (0.72 + 0.42 * rise) * rng.uniform(0.93, 1.05)
        ramp = np.linspace(1.08, 0.78, 48)[:, None, None]
        cell[0:48, x : x + 32] = sky * ramp
        cloud = np.linspace(0.0, 1.0, 32)[None, :, None] * (1 if (bay + row) % 2 else -1)
        cell[0:48, x : x + 32] *= 1.0 + 0.05 * cloud
        dice = rng.random()
        if dice < 0.2:
            _mix(cell, 4, 4 + int(rng.integers(8, 34)), x + 2, x + 32, (206, 208, 204), 0.5)
        elif dice < 0.32:
            _mix(cell, 3, 48, x + 2, x + 32, (246, 226, 176), 0.32)
            for lamp in (x + 6, x + 18):
                _mix(cell, 7, 9, lamp, lamp + 9, (255, 250, 226), 0.75)
        _mix(cell, 38, 48, x + 2, x + 32, (52, 60, 68), 0.35)
    _fill(cell, 48, 64, 0, 64, (118, 136, 152))
    _shade(cell, 48, 64, 0, 64, 0.9 + 0.12 * rise)
    for x in (0, 32):
        _fill(cell, 0, 64, x, x + 2, (206, 210, 214))
        _shade(cell, 0, 64, x + 2, x + 3, 0.75)
    for y in (0, 48):
        _fill(cell, y, y + 2, 0, 64, (196, 202, 206))
        _shade(cell, y + 2, y + 4, 0, 64, 0.78)


def _glass_ground(cell: FloatImage, rng: np.random.Generator, row: int, bay: int) -> None:
    _fill(cell, row, 10, 0, 64, (202, 206, 210))
    _shade(cell, 8, 10, 0, 64, 0.75)
    for x in (0, 32):
        _glazing(cell, rng, 10, 61, x, x + 32, sky=0.45)
        _mix(cell, 10, 61, x, x + 32, (240, 220, 178), 0.18)
        _fill(cell, 10, 61, x, x + 2, (176, 180, 184))
    _shade(cell, 10, 16, 0, 64, 0.6)
    if bay in (1, 5):
        _fill(cell, 24, 64, 14, 50, (84, 90, 96))
        for x in (16, 33):
            _glazing(cell, rng, 26, 62, x, x + 15, sky=0.3)
            _fill(cell, 40, 50, x + (13 if x == 16 else 1), x + (14 if x == 16 else 2), (226, 226, 226))
        _fill(cell, 19, 23, 8, 56, (214, 216, 218))
        _shade(cell, 23, 26, 10, 54, 0.6)
    _fill(cell, 61, 64, 0, 64, (120, 122, 124))


def _grid(rows: Sequence[tuple[int, int]], columns: Sequence[tuple[int, int]]) -> tuple[tuple[int, int, int, int], ...]:
    """A pane in each of ``rows`` and ``columns`` (from, to)."""
    return tuple((*row, *column) for row in rows for column in columns)


_SASHES = ((22, 31), (33, 42))
"""Columns of panes on both sides of a window's upright."""

STYLES = (
    Style("stucco", _stucco_wall, _stucco_storey, _stucco_ground, _grid(((16, 24), (25, 36), (37, 47)), _SASHES)),
    Style("brick", _brick_wall, _brick_storey, _brick_ground, _grid(((18, 32), (37, 50)), _SASHES)),
    Style("concrete", _concrete_wall, _concrete_storey, _concrete_ground, _grid(((18, 41),), ((2, 20), (44, 63)))),
    Style("glass", _glass_wall, _glass_storey, _glass_ground, _grid(((4, 38),), ((3, 32), (35, 64)))),
)
"""The styles of the atlas, from its top."""
