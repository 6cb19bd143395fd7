"""The pictures of a whole city in one texture, so that any set of objects is one draw.

At the top lie, where something needs them, the painted facades of ``mmi.appearance.facades``, repeated sideways to the atlas's
width so that they still wrap there; below them a white patch for surfaces of one colour, and the city's own pictures on
shelves, each with its edges repeated around it so that mipmaps do not bleed. Pictures do not wrap in an atlas: those that
surfaces repeat have copies side by side, and surfaces that need more than there is room for are cut (``cut_at_repeats``).
Clear texels of cut-outs (``mmi.appearance.cut_outs``) have the colour of the nearest that are not, so that filters mix in no
other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mmi.appearance import facades
from mmi.appearance.cut_outs import CLEAR_BELOW, dilated, with_solid_share
from mmi.city.model import Texture
from mmi.foundation.shelves import on_shelves

__all__ = ["COPIES", "Atlas", "cut_at_repeats", "pack_atlas", "reduced_picture"]

_PAD = 8
_WHITE = 16
COPIES = 1024
"""Texels a side that copies of a repeated picture may fill."""
_MOST_REPEATS = 64.0
_LARGEST = 8192  # texels a side: OpenGL 4 promises 16384, but with mipmaps this takes a third of a gigabyte already


@dataclass(frozen=True, slots=True, eq=False)
class Atlas:
    """``texture`` (h, w, 3) uint8. Picture i lies at ``boxes[i]`` (x, y, width, height), texels, ``copies[i]`` (across, down)
    of it side by side; ``white`` (u, v down) is a white point. Texture coordinates of facades are multiplied by
    ``facade_scale``. Where a picture is a cut-out, ``texture`` (h, w, 4) has an alpha as well.
    """

    texture: NDArray[np.uint8]
    boxes: NDArray[np.float64]
    copies: NDArray[np.int64]
    white: tuple[float, float]
    facade_scale: tuple[float, float]

    def place(self, picture: NDArray[np.int64], uv: NDArray[np.float64]) -> NDArray[np.float64]:
        """Coordinates (..., 2), v down, in the atlas of ``uv`` (..., 2), v up, in [0, copies], of ``picture`` (...)."""
        height, width = self.texture.shape[:2]
        box = self.boxes[picture]
        u = box[..., 0] + uv[..., 0] / self.copies[picture][..., 0] * box[..., 2]
        v = box[..., 1] + (1.0 - uv[..., 1] / self.copies[picture][..., 1]) * box[..., 3]
        return np.stack([u / width, v / height], axis=-1)


def pack_atlas(textures: Sequence[Texture], repeats: NDArray[np.float64], *, painted: bool) -> Atlas:
    """An atlas of ``textures``, reduced if they are too large, and of the facades if something is ``painted``.

    ``repeats`` (n, 2): copies of each picture, across and down, that hold whatever it covers.
    """
    facade = facades.facade_texture() if painted else np.empty((0, 64, 3), dtype=np.uint8)
    sizes = np.array([one.image.shape[1::-1] for one in textures], dtype=np.float64).reshape(-1, 2)
    scale = 1.0
    while True:
        reduced = np.maximum(np.rint(sizes * np.minimum(scale, COPIES * 4 / np.maximum(sizes, 1.0))), 1.0)
        copies = np.clip(np.minimum(np.ceil(repeats), COPIES // np.minimum(reduced, COPIES)), 1, None).astype(np.int64)
        taken = (reduced * copies).astype(np.int64)
        widest = int(taken[:, 0].max(initial=0)) + 2 * _PAD
        area = float(np.prod(taken + 2 * _PAD, axis=1).sum())
        width = facade.shape[1]
        while width < max(widest, min(math.sqrt(area), _LARGEST)):
            width *= 2
        top = facade.shape[0] + _WHITE
        outer, (_, shelves) = on_shelves(taken + 2 * _PAD, width)
        corners, end = outer + np.array([_PAD, top + _PAD]), top + shelves
        if max(width, end) <= _LARGEST:
            break
        scale *= 0.8
    height = -(-end // 64) * 64
    channels = 4 if any(one.is_cut_out for one in textures) else 3
    texture = np.full((height, width, channels), 255, dtype=np.uint8)
    texture[: facade.shape[0], :, :3] = np.tile(facade, (1, width // facade.shape[1], 1))
    for one, (x, y), size, count in zip(
        textures, corners.tolist(), reduced.astype(int).tolist(), copies.tolist(), strict=True
    ):
        image = reduced_picture(one, tuple(size))
        image = np.tile(image, (count[1], count[0], 1))
        padded = texture[y - _PAD : y + len(image) + _PAD, x - _PAD : x + image.shape[1] + _PAD]
        padded[..., : image.shape[2]] = np.pad(image, ((_PAD, _PAD), (_PAD, _PAD), (0, 0)), mode="edge")
    texture.setflags(write=False)
    return Atlas(
        texture=texture,
        boxes=np.hstack([corners, taken]).astype(np.float64),
        copies=copies,
        white=(0.5 * _WHITE / width, (facade.shape[0] + 0.5 * _WHITE) / height),
        facade_scale=(facade.shape[1] / width, facade.shape[0] / height),
    )


def reduced_picture(texture: Texture, size: tuple[int, int]) -> NDArray[np.uint8]:
    """The picture (h, w, 3 or 4) of a texture at ``size`` (width, height); clear texels of cut-outs look as those around."""
    image = dilated(texture.image) if texture.is_cut_out else texture.image
    return image if image.shape[1::-1] == size else _reduced(image, size)


def _reduced(image: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """The image (h, w, 3 or 4) at ``size`` (width, height); of a cut-out, as large a share stays clear.

    Colours and alpha are reduced each by themselves, or clear texels would become black.
    """
    colors = np.asarray(Image.fromarray(image[..., :3]).resize(size, Image.Resampling.BOX))
    if image.shape[2] == 3:
        return colors
    solid = np.where(image[..., 3] < CLEAR_BELOW, np.uint8(0), np.uint8(255))
    alpha, share = (
        np.asarray(Image.fromarray(one).resize(size, Image.Resampling.BOX)) for one in (image[..., 3].copy(), solid)
    )
    return np.dstack([colors, with_solid_share(alpha, share, tile=max(size))])


def cut_at_repeats(
    corners: NDArray[np.float64], uv: NDArray[np.float64], period: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Triangles (m, 3, 3) with ``uv`` (m, 3, 2), moved by whole repetitions into [0, period], and cut where they do not fit.

    ``period`` (m, 2), whole numbers. Returns the triangles, their coordinates there, and the triangle that each is a piece
    of. Where one has more than 64 periods, coordinates are squeezed to as many: at that size nobody sees the picture.
    """
    squeezed = np.minimum(1.0, _MOST_REPEATS * period / np.maximum(np.ptp(uv, axis=1), 1e-9))
    both = np.concatenate([corners, uv * squeezed[:, None, :]], axis=2)
    source = np.arange(len(both))
    for axis in (3, 4):
        done, sources = [], []
        while len(both):
            step = period[source, axis - 3]
            first = np.floor(both[:, :, axis].min(axis=1) + 1e-6) + step
            lines = np.ceil((both[:, :, axis].max(axis=1) - 1e-4 - first) / step)  # that cross it, or none
            across = lines > 0.0
            # In the middle: from one side, each cut would leave one more piece to the next.
            line = first + step * np.floor(0.5 * (lines - 1.0))
            done.append(both[~across])
            sources.append(source[~across])
            both, source = _cut(both[across], source[across], axis, line[across])
        both, source = np.concatenate([both, *done]), np.concatenate([source, *sources])
    order = np.argsort(source, kind="stable")
    both, source = both[order], source[order]
    placed = both[:, :, 3:] - np.floor(both[:, :, 3:].min(axis=1, keepdims=True) + 1e-6)
    return both[:, :, :3], np.clip(placed, 0.0, period[source][:, None, :]), source


def _cut(
    both: NDArray[np.float64], source: NDArray[np.int64], axis: int, line: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Triangles (m, 3, 5) cut where coordinate ``axis`` is ``line`` (m,), which each crosses: three of each, or two."""
    side = both[:, :, axis] > line[:, None]
    alone = np.where(side.sum(axis=1) == 1, side.argmax(axis=1), (~side).argmax(axis=1))  # the corner on its own side
    rows = np.arange(len(both))
    a, b, c = (both[rows, (alone + k) % 3] for k in range(3))

    def meet(p: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float64]:
        t = np.clip((line - p[:, axis]) / (q[:, axis] - p[:, axis]), 0.0, 1.0)
        point = p + t[:, None] * (q - p)
        point[:, axis] = line
        return point

    ab, ac = meet(a, b), meet(a, c)
    pieces = np.concatenate([np.stack(one, axis=1) for one in ((a, ab, ac), (ab, b, c), (ab, c, ac))])
    of = np.tile(source, 3)
    edges = pieces[:, 1:, :3] - pieces[:, :1, :3]
    filled = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) > 0.0
    return pieces[filled], of[filled]
