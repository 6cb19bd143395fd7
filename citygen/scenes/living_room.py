"""A furnished living room, 8 x 6 m: a scene of small things that stand in, on, under and through one another.

Books in a shelf, chairs under a table, fruit in a bowl, a lamp that hangs into the room, plants, a sofa with cushions. Walls,
floor and ceiling are objects of their own; a path leads around the table. Nothing has a core but the walls.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from shapely.geometry import box as rectangle

from citygen.scenes.paths import footways
from citygen.shapes.solids import Piece, box, hexahedra, hull_prism, join, lathe, object_of, placed, tube
from mmi.appearance.facade_styles import FloatImage, noise, one_color
from mmi.city.model import PLAIN, City, CityObject, Prism, Texture

__all__ = ["living_room"]

_WIDE, _LONG, _HIGH = 8.0, 6.0, 2.7
_WOOD, _CLOTH, _PLASTER, _PARQUET, _SPINE, _PICTURE, _LEAF = range(7)
_OAK = (206, 168, 122)
_DARK = (132, 92, 66)
_GROUND = -0.01
"""The plain around the room is lower than its floor by this, metres: of two surfaces in one plane, any may be seen."""


def living_room(seed: int) -> City:
    """The room, the same for the same seed: its corner is the origin, its floor at height 0."""
    rng = np.random.default_rng([seed, 7])
    objects = [
        *_shell(),
        *_shelf(rng),
        *_dining(rng),
        *_seats(rng),
        *_media(),
        *_plants(rng),
        *_pictures(rng),
    ]
    nodes = [(1.2, 2.2), (1.2, 4.4), (5.9, 4.4), (5.9, 2.2), (4.1, 2.2), (4.1, 4.4)]
    ways = [(0, 1, ()), (1, 5, ()), (5, 2, ()), (2, 3, ()), (3, 4, ()), (0, 4, ()), (4, 5, ())]
    return City(
        objects=tuple(objects),
        streets=footways(nodes, ways, half_width=0.25),
        crs="local",
        origin=(0.0, 0.0, 0.0),
        source=f"living-room-{seed}",
        textures=_textures(rng),
        ground=_GROUND,
    )


def _textures(rng: np.random.Generator) -> tuple[Texture, ...]:
    """Wood, cloth, plaster, parquet, the spine of a book, a landscape, a leaf."""
    stretch = np.cumsum(noise(rng, 256, 9, width=256)[:1].repeat(256, axis=0), axis=1)
    grain = 0.05 * np.sin(0.35 * stretch + 0.02 * np.arange(256)[:, None]) + 0.03 * noise(rng, 256, 2, width=256)
    wood = one_color((236.0, 232.0, 226.0), (1.0 + grain).astype(np.float32))
    y, x = np.mgrid[:128, :128]
    weave = 0.06 * np.where((x // 2 + y // 2) % 2 == 0, 1.0, -1.0) + 0.03 * noise(rng, 128, 3, width=128)
    cloth = one_color((238.0, 238.0, 238.0), (1.0 + weave).astype(np.float32))
    plaster = one_color((240.0, 236.0, 226.0), 1.0 + 0.012 * noise(rng, 256, 2, width=256))
    parquet = one_color((196.0, 152.0, 104.0), (1.0 + 0.6 * grain).astype(np.float32))
    tone = rng.normal(1.0, 0.07, (8, 4)).repeat(32, axis=0).repeat(64, axis=1)
    parquet *= tone[..., None].astype(np.float32)
    parquet[::32] *= np.float32(0.7)
    parquet[:, ::64] *= np.float32(0.8)
    spine = one_color((230.0, 230.0, 230.0), 1.0 + 0.03 * noise(rng, 128, 3, width=32))
    for row, tall in ((16, 4), (24, 20), (52, 3), (104, 8)):
        spine[row : row + tall, 5:-5] = (250.0, 236.0, 180.0)
    sky = np.linspace(1.0, 0.0, 128)[:, None, None]
    picture: FloatImage = (
        sky * np.array([120.0, 168.0, 214.0]) + (1.0 - sky) * np.array([236.0, 206.0, 170.0])
    ).astype(np.float32)
    picture = np.repeat(picture, 128, axis=1)
    for level, color in ((70, (110, 130, 142)), (88, (92, 124, 92)), (106, (66, 96, 60))):
        hill = level + 9.0 * np.sin(np.arange(128) / 17.0 + level) + 4.0 * np.sin(np.arange(128) / 6.0)
        picture[np.arange(128)[:, None] > hill[None]] = color
    leaf = one_color((230.0, 236.0, 220.0), 1.0 + 0.08 * noise(rng, 64, 3, width=64))
    leaf[:, 31:33] *= np.float32(1.1)
    images = [wood, cloth, plaster, parquet, spine, picture, leaf]
    names = ("wood", "cloth", "plaster", "parquet", "spine", "picture", "leaf")
    return tuple(
        Texture(name, np.clip(np.rint(image), 0, 255).astype(np.uint8))
        for name, image in zip(names, images, strict=True)
    )


# ------------------------------------------------------------------------------------------------------------ the room


def _shell() -> list[CityObject]:
    """Floor, ceiling, four walls of 20 cm with a door and a window in them."""
    w, d, h, t = _WIDE, _LONG, _HIGH, 0.2
    made = [
        _solid("floor", [((-t, -t, -t), (w + t, d + t, 0.0))], _PARQUET, 2.0, (255, 255, 255)),
        _solid("ceiling", [((-t, -t, h), (w + t, d + t, h + t))], _PLASTER, 2.0, (255, 255, 252)),
        _solid("wall/west", [((-t, -t, 0.0), (0.0, d + t, h))], _PLASTER, 2.0, (238, 242, 232)),
    ]
    window = [((-0.0, d, 0.0), (2.4, d + t, h)), ((5.6, d, 0.0), (w, d + t, h))]
    window += [((2.4, d, 0.0), (5.6, d + t, 0.9)), ((2.4, d, 2.3), (5.6, d + t, h))]
    door = [((w, -t, 0.0), (w + t, 3.6, h)), ((w, 4.6, 0.0), (w + t, d + t, h)), ((w, 3.6, 2.05), (w + t, 4.6, h))]
    made.append(_solid("wall/north", window, _PLASTER, 2.0, (255, 252, 244)))
    made.append(_solid("wall/east", door, _PLASTER, 2.0, (244, 236, 224)))
    made.append(_solid("wall/south", [((0.0, -t, 0.0), (w, 0.0, h))], _PLASTER, 2.0, (255, 252, 244)))
    bars = [((2.4, d + 0.06, 0.9), (5.6, d + 0.12, 0.96)), ((2.4, d + 0.06, 2.24), (5.6, d + 0.12, 2.3))]
    bars += [((x, d + 0.06, 0.9), (x + 0.06, d + 0.12, 2.3)) for x in (2.4, 3.97, 5.54)]
    made.append(object_of("window", [_boxes(bars, _WOOD, (250, 250, 246))]))
    made.append(object_of("door", [box((8.05, 3.6, 0.0), (8.11, 4.6, 2.05), texture=_WOOD, color=(236, 232, 222))]))
    wave = np.linspace(0.0, 1.0, 25)
    for name, x0 in (("curtain/left", 1.75), ("curtain/right", 5.55)):
        folds = np.column_stack([x0 + 0.7 * wave, 5.86 + 0.05 * np.sin(40.0 * wave)])
        near, far = folds, folds + np.array([0.0, 0.02])
        below = np.stack([near[:-1], near[1:], far[1:], far[:-1]], axis=1)
        corners = np.empty((len(below), 8, 3))
        corners[:, :4, :2] = corners[:, 4:, :2] = below
        corners[:, :4, 2], corners[:, 4:, 2] = 0.05, 2.5
        made.append(object_of(name, [hexahedra(corners, texture=_CLOTH, metres=0.5, color=(206, 120, 96))]))
    return made


def _shelf(rng: np.random.Generator) -> list[CityObject]:
    """A shelf on the west wall, and a book or two for every 4 cm of it; some lean."""
    depth, y0, y1 = 0.32, 1.0, 3.4
    levels = (0.05, 0.42, 0.79, 1.16, 1.53, 1.90)
    parts = [((0.0, y, 0.0), (depth, y + 0.03, 2.2)) for y in (y0 - 0.03, 0.5 * (y0 + y1) - 0.015, y1)]
    parts += [((0.0, y0, z), (depth, y1, z + 0.025)) for z in (*levels, 2.175)]
    parts.append(((0.0, y0, 0.0), (0.015, y1, 2.2)))
    made = [object_of("shelf", [_boxes(parts, _WOOD, _OAK)])]
    inks = (
        (150, 44, 40),
        (38, 70, 110),
        (44, 92, 66),
        (196, 160, 84),
        (86, 62, 50),
        (220, 212, 196),
        (92, 60, 104),
        (40, 44, 48),
    )
    number = 0
    for level in levels:
        for left, right in ((y0 + 0.01, 0.5 * (y0 + y1) - 0.02), (0.5 * (y0 + y1) + 0.02, y1 - 0.01)):
            y, end = left, right - rng.uniform(0.0, 0.35)
            while True:
                thick, tall, deep = rng.uniform(0.02, 0.05), rng.uniform(0.19, 0.31), rng.uniform(0.15, 0.24)
                if y + thick > end:
                    break
                ink = np.array(inks[int(rng.integers(len(inks)))]) * rng.uniform(0.85, 1.1)
                low, high = (0.02, y, level + 0.0255), (0.02 + deep, y + thick - 0.002, level + 0.0255 + tall)
                book = box(low, high, texture=_SPINE, metres=None, color=np.clip(ink, 0, 255))
                made.append(object_of(f"book/{number}", [book]))
                number, y = number + 1, y + thick
    return made


def _dining(rng: np.random.Generator) -> list[CityObject]:
    """A table with six chairs that reach under it, a bowl with fruit, and a lamp above."""
    x, y, w, d = 2.6, 3.3, 2.0, 1.0
    parts = [((x - w / 2, y - d / 2, 0.71), (x + w / 2, y + d / 2, 0.75))]
    parts += [
        ((cx - 0.035, cy - 0.035, 0.0), (cx + 0.035, cy + 0.035, 0.715))
        for cx in (x - 0.9, x + 0.9)
        for cy in (y - 0.4, y + 0.4)
    ]
    made = [object_of("table", [_boxes(parts, _WOOD, _OAK)])]
    seats = [(x - 0.5, y - 0.62, 0.0), (x + 0.5, y - 0.62, 0.0), (x - 0.5, y + 0.62, np.pi), (x + 0.5, y + 0.62, np.pi)]
    seats += [(x - 1.1, y, -0.5 * np.pi), (x + 1.1, y, 0.5 * np.pi)]
    for number, (cx, cy, turn) in enumerate(seats):
        wiggle = rng.uniform(-0.1, 0.1)
        made.append(
            object_of(f"chair/{number}", [placed(one, (cx, cy, 0.0), heading=turn + wiggle) for one in _chair()])
        )
    bowl = lathe(
        [(0, 0.751), (0.08, 0.751), (0.13, 0.79), (0.17, 0.85), (0.16, 0.85), (0.12, 0.80), (0.07, 0.775), (0, 0.77)],
        24,
        color=(216, 226, 232),
    )
    made.append(object_of("bowl", [placed(bowl, (x, y, 0.0))]))
    for number, angle in enumerate(np.arange(5) * 2.0 * np.pi / 5):
        color = ((206, 60, 44), (226, 156, 50), (150, 180, 70))[int(rng.integers(3))]
        at = (x + 0.07 * np.cos(angle), y + 0.07 * np.sin(angle), 0.825)
        made.append(object_of(f"fruit/{number}", [placed(_ball(0.042, 14, color=color), at)]))
    made.append(_lamp("lamp/table", x, y, 1.55))
    return made


def _chair() -> list[Piece]:
    """Facing +y, its seat's middle at the origin."""
    legs = [((cx - 0.02, cy - 0.02, 0.0), (cx + 0.02, cy + 0.02, 0.44)) for cx in (-0.19, 0.19) for cy in (-0.19, 0.19)]
    posts = [((cx - 0.02, -0.215, 0.44), (cx + 0.02, -0.175, 0.92)) for cx in (-0.19, 0.19)]
    slats = [((-0.18, -0.205, z), (0.18, -0.185, z + 0.07)) for z in (0.58, 0.70, 0.82)]
    seat = placed(_cushion(0.44, 0.44, 0.05, color=(96, 122, 140)), (0.0, 0.0, 0.455))
    return [_boxes([*legs, *posts, *slats], _WOOD, _DARK), seat]


def _seats(rng: np.random.Generator) -> list[CityObject]:
    """A sofa against the south wall with cushions, an armchair, a low table on a rug, a floor lamp."""
    grey = (128, 136, 146)
    sofa = [
        placed(_cushion(2.2, 0.95, 0.30, color=grey), (6.0, 0.62, 0.24)),
        placed(_cushion(2.2, 0.28, 0.75, color=grey), (6.0, 0.24, 0.48)),
        placed(_cushion(0.26, 0.95, 0.55, color=grey), (4.82, 0.62, 0.36)),
        placed(_cushion(0.26, 0.95, 0.55, color=grey), (7.18, 0.62, 0.36)),
        placed(_cushion(1.05, 0.75, 0.18, color=(146, 154, 164)), (5.46, 0.70, 0.44)),
        placed(_cushion(1.05, 0.75, 0.18, color=(146, 154, 164)), (6.54, 0.70, 0.44)),
        _boxes([((x, y, 0.0), (x + 0.06, y + 0.06, 0.12)) for x in (4.95, 7.0) for y in (0.25, 0.95)], _WOOD, _DARK),
    ]
    made = [object_of("sofa", sofa)]
    for number, (x, color) in enumerate(((5.15, (196, 92, 70)), (5.55, (214, 176, 96)), (6.85, (82, 116, 110)))):
        pillow = placed(_cushion(0.42, 0.16, 0.40, color=color), (x, 0.45, 0.70), heading=rng.uniform(-0.3, 0.3))
        made.append(object_of(f"pillow/{number}", [pillow]))
    chair = [
        placed(_cushion(0.8, 0.8, 0.28, color=(172, 120, 84)), (0.0, 0.0, 0.28)),
        placed(_cushion(0.8, 0.22, 0.75, color=(172, 120, 84)), (0.0, -0.36, 0.55)),
        placed(_cushion(0.2, 0.8, 0.45, color=(150, 104, 72)), (-0.42, 0.0, 0.36)),
        placed(_cushion(0.2, 0.8, 0.45, color=(150, 104, 72)), (0.42, 0.0, 0.36)),
        _boxes([((x, y, 0.0), (x + 0.05, y + 0.05, 0.16)) for x in (-0.34, 0.29) for y in (-0.34, 0.29)], _WOOD, _DARK),
    ]
    made.append(object_of("armchair", [placed(one, (7.15, 2.35, 0.0), heading=1.9) for one in chair]))
    made.append(_solid("rug", [((4.6, 1.15, 0.001), (7.0, 2.1, 0.015))], _CLOTH, 0.6, (170, 74, 66)))
    made.append(
        object_of(
            "low table",
            [
                _boxes([((5.4, 1.3, 0.36), (6.5, 1.9, 0.40)), ((5.45, 1.35, 0.14), (6.45, 1.85, 0.16))], _WOOD, _DARK),
                _boxes(
                    [((x, y, 0.0), (x + 0.04, y + 0.04, 0.37)) for x in (5.42, 6.44) for y in (1.32, 1.84)],
                    _WOOD,
                    _DARK,
                ),
            ],
        )
    )
    vase = lathe(
        [(0, 0.401), (0.05, 0.401), (0.08, 0.48), (0.06, 0.58), (0.03, 0.64), (0.045, 0.68), (0, 0.68)],
        20,
        color=(70, 110, 150),
    )
    made.append(object_of("vase", [placed(vase, (5.75, 1.62, 0.0))]))
    for number in range(3):
        z = 0.4005 + 0.012 * number
        magazine = placed(
            box((-0.11, -0.14, 0.0), (0.11, 0.14, 0.011), texture=_PICTURE, metres=None),
            (6.2, 1.6, z),
            heading=0.4 * number,
        )
        made.append(object_of(f"magazine/{number}", [magazine]))
    stand = [
        lathe(
            [(0, 0.0), (0.16, 0.0), (0.16, 0.02), (0.02, 0.04), (0.015, 0.06), (0.015, 1.5), (0, 1.5)],
            20,
            color=(60, 60, 62),
        ),
        lathe(
            [(0, 1.45), (0.10, 1.45), (0.24, 1.40), (0.13, 1.75), (0.02, 1.76), (0, 1.74)],
            28,
            texture=_CLOTH,
            repeats=(6, 3),
            color=(250, 232, 190),
        ),
    ]
    made.append(object_of("lamp/floor", [placed(one, (4.45, 0.4, 0.0)) for one in stand]))
    return made


def _media() -> list[CityObject]:
    """A sideboard with a screen, speakers and a record player; a clock above."""
    low = [
        ((5.9, 5.52, 0.1), (7.9, 5.94, 0.5)),
        ((6.0, 5.6, 0.0), (6.1, 5.9, 0.11)),
        ((7.7, 5.6, 0.0), (7.8, 5.9, 0.11)),
    ]
    doors = [((x, 5.50, 0.13), (x + 0.62, 5.53, 0.47)) for x in (5.94, 6.59, 7.24)]
    made = [object_of("sideboard", [_boxes([*low, *doors], _WOOD, _OAK)])]
    screen = [
        ((6.3, 5.75, 0.56), (7.5, 5.79, 1.26)),
        ((6.7, 5.66, 0.501), (7.1, 5.86, 0.52)),
        ((6.86, 5.77, 0.51), (6.94, 5.80, 0.60)),
    ]
    made.append(object_of("screen", [_boxes(screen, PLAIN, (26, 28, 32))]))
    for number, x in enumerate((6.02, 7.62)):
        made.append(
            object_of(f"speaker/{number}", [box((x, 5.62, 0.501), (x + 0.18, 5.86, 0.83), texture=_WOOD, color=_DARK)])
        )
    return made


def _plants(rng: np.random.Generator) -> list[CityObject]:
    """Pots with plants, one of them in the shelf's way."""
    made = []
    for number, (x, y, tall, count) in enumerate(
        ((0.45, 5.45, 1.5, 260), (7.55, 5.0, 0.9, 150), (0.45, 0.5, 1.1, 180))
    ):
        r = 0.16 if tall > 1.0 else 0.13
        pot = lathe(
            [(0, 0.0), (r * 0.75, 0.0), (r, 0.28), (r, 0.32), (r * 0.88, 0.32), (r * 0.86, 0.27), (0, 0.27)],
            24,
            color=(186, 104, 74),
        )
        stems = 5
        lean = rng.normal(0.0, 0.16 * tall, (stems, 2))
        s = np.linspace(0.0, 1.0, 4)
        paths = np.concatenate(
            [(s**1.6)[None, :, None] * lean[:, None], np.tile(0.25 + (tall - 0.25) * s, (stems, 1))[..., None]], axis=2
        )
        stalks = tube(paths, np.array([0.014, 0.012, 0.009, 0.004]), 6, color=(96, 104, 60))
        leaves = _foliage(paths, count, 0.16 * tall, rng)
        made.append(object_of(f"plant/{number}", [placed(one, (x, y, 0.0)) for one in (pot, stalks, leaves)]))
    return made


def _foliage(paths: NDArray[np.float64], count: int, size: float, rng: np.random.Generator) -> Piece:
    """Leaves of two triangles each that grow from stems (n, 4, 3)."""
    stem, s = rng.integers(len(paths), size=count), rng.uniform(1.0, 3.0, count)
    low = np.minimum(s.astype(np.int64), 2)
    part = (s - low)[:, None]
    foot = paths[stem, low] * (1.0 - part) + paths[stem, low + 1] * part
    azimuth = rng.uniform(0.0, 2.0 * np.pi, count)
    out = np.column_stack([np.cos(azimuth), np.sin(azimuth), rng.uniform(-0.3, 0.8, count)])
    side = np.column_stack([-np.sin(azimuth), np.cos(azimuth), np.zeros(count)])
    long = size * rng.uniform(0.6, 1.1, (count, 1))
    tip, middle = foot + long * out, foot + 0.5 * long * (out + np.array([0.0, 0.0, 0.25]))
    corners = np.stack([foot, middle + 0.22 * long * side, tip, middle - 0.22 * long * side], axis=1).reshape(-1, 3)
    first = 4 * np.arange(count)[:, None]
    triangles = np.concatenate([first + np.array([0, 1, 2]), first + np.array([0, 2, 3])])
    shade = np.array([86.0, 138.0, 70.0]) * rng.uniform(0.7, 1.2, (count, 1))
    uv = np.array([(0.5, 0.0), (0.95, 0.5), (0.5, 1.0), (0.05, 0.5)])
    uvs = np.concatenate([np.tile(uv[[0, 1, 2]], (count, 1, 1)), np.tile(uv[[0, 2, 3]], (count, 1, 1))])
    return Piece(corners, triangles, np.full(2 * count, _LEAF), np.clip(np.tile(shade, (2, 1)), 0, 255), uvs)


def _pictures(rng: np.random.Generator) -> list[CityObject]:
    """Framed pictures on the south and west walls, a clock on the east one."""
    made = []
    for number, (x, z, w, h) in enumerate(((1.3, 1.3, 1.0, 0.7), (2.7, 1.4, 0.6, 0.8), (6.0, 1.45, 1.4, 0.8))):
        frame = box(
            (x - w / 2 - 0.05, 0.001, z - 0.05), (x + w / 2 + 0.05, 0.03, z + h + 0.05), texture=_WOOD, color=_DARK
        )
        canvas = box(
            (x - w / 2, 0.01, z),
            (x + w / 2, 0.035, z + h),
            texture=_PICTURE,
            metres=None,
            color=rng.uniform(205.0, 255.0, 3),
        )
        made.append(object_of(f"picture/{number}", [frame, canvas]))
    face = lathe(
        [(0, 0.0), (0.16, 0.0), (0.18, 0.02), (0.18, 0.04), (0.15, 0.035), (0, 0.035)], 32, color=(240, 238, 230)
    )
    upright = Piece(
        face.vertices[:, [2, 0, 1]] * np.array([-1.0, -1.0, 1.0]), face.triangles, face.textures, face.colors, face.uv
    )
    made.append(object_of("clock", [placed(upright, (_WIDE - 0.001, 2.4, 1.9))]))
    return made


# -------------------------------------------------------------------------------------------------------------- things


def _solid(
    id: str,  # noqa: A002
    boxes: Sequence[tuple[ArrayLike, ArrayLike]],
    texture: int,
    metres: float,
    color: ArrayLike,
) -> CityObject:
    """An object that is filled: boxes, which are its prisms and its core."""
    pieces = [box(low, high, texture=texture, metres=metres, color=color) for low, high in boxes]
    core = []
    for low, high in boxes:
        (x0, y0, z0), (x1, y1, z1) = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
        core.append(Prism(rectangle(x0, y0, x1, y1), float(z0), float(z1)))
    mesh = object_of(id, pieces).mesh
    return CityObject(id, tuple(hull_prism(join([piece]).vertices) for piece in pieces), mesh, tuple(core))


def _boxes(parts: Sequence[tuple[ArrayLike, ArrayLike]], texture: int, color: ArrayLike) -> Piece:
    low, high = np.array([np.asarray(a) for a, _ in parts]), np.array([np.asarray(b) for _, b in parts])
    return box(low, high, texture=texture, metres=1.0, color=color)


def _ball(radius: float, segments: int, *, color: ArrayLike) -> Piece:
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, segments // 2 + 1)
    profile = np.column_stack([np.cos(angle), np.sin(angle)]) * radius
    profile[[0, -1], 0] = 0.0
    return lathe(profile, segments, color=color)


def _cushion(wide: float, deep: float, high: float, *, color: ArrayLike) -> Piece:
    """A box with round edges: a ball whose coordinates are pushed outwards."""
    ball = lathe(
        np.column_stack([np.sin(np.linspace(0.0, np.pi, 11)), -np.cos(np.linspace(0.0, np.pi, 11))])
        * ([[0.0, 1.0]] + [[1.0, 1.0]] * 9 + [[0.0, 1.0]]),
        20,
        texture=_CLOTH,
        repeats=(6.0, 3.0),
        color=color,
    )
    pushed = np.sign(ball.vertices) * np.abs(ball.vertices) ** 0.4
    scaled = pushed / np.abs(pushed).max(axis=0) * 0.5 * np.array([wide, deep, high])
    return Piece(scaled, ball.triangles, ball.textures, ball.colors, ball.uv)


def _lamp(id: str, x: float, y: float, z: float) -> CityObject:  # noqa: A002
    """A shade that hangs from the ceiling on a cord."""
    shade = lathe(
        [(0, z + 0.18), (0.05, z + 0.17), (0.24, z), (0.25, z), (0.06, z + 0.20), (0, z + 0.21)],
        28,
        color=(232, 180, 80),
    )
    cord = tube([(0.0, 0.0, z + 0.2), (0.0, 0.0, 2.3), (0.0, 0.0, _HIGH)], 0.006, 6, color=(40, 40, 40))
    return object_of(id, [placed(shade, (x, y, 0.0)), placed(cord, (x, y, 0.0))])
