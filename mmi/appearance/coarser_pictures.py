"""Coarser versions of pictures for surfaces that repeat them often, so that these need not be cut into many pieces.

In an atlas a picture does not wrap: it has as many copies side by side as fill a square of so many texels, and a triangle that
repeats it more often is cut (:mod:`mmi.appearance.texture_atlas`). A pavement whose picture is half a metre wide would become
hundreds of pieces. A version of the picture with half the texels a side has twice the copies each way in the same square, and
whoever repeats a picture so often has it small, with texels finer than anyone sees. So a triangle gets the finest version that
it need not be cut in, but none whose texels are larger than ``_FINE``. Versions that spare few pieces are not made.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mmi.appearance.texture_atlas import COPIES, reduced_picture
from mmi.city.model import CityObject, Texture

__all__ = ["with_coarser_pictures"]

_FINE = 0.04
"""Metres: no texel of a coarser version is larger on a surface. It is a pixel of the paper's display at 18 m."""
_LEAST = 4
"""Texels: no version is narrower."""
_LEVELS = 9
_WORTH = 512
"""Pieces that a version has to spare: it takes up to a million texels."""


def with_coarser_pictures(
    objects: Sequence[CityObject], textures: Sequence[Texture]
) -> tuple[list[CityObject], list[Texture]]:
    """``objects``, which have meshes, and pictures: those of ``textures``, and coarser ones behind them that meshes show now.

    Texture coordinates stay, since they count repetitions.
    """
    meshes = [one.mesh for one in objects if one.mesh is not None]
    if not textures or not meshes:
        return list(objects), list(textures)
    picture = np.concatenate([mesh.textures for mesh in meshes]).astype(np.int64)
    shown = np.flatnonzero(picture >= 0)
    uv = np.concatenate([mesh.uv[mesh.textures >= 0] for mesh in meshes]).astype(np.float64)
    corners = np.concatenate([mesh.vertices[mesh.triangles[mesh.textures >= 0]] for mesh in meshes])
    level = _levels(picture[shown], uv, corners, np.array([one.image.shape[1::-1] for one in textures]))
    versions, original = list(textures), picture[shown]
    for k, coarser in sorted(set(zip(original[level > 0].tolist(), level[level > 0].tolist(), strict=True))):
        one, size = textures[k], np.maximum(np.array(textures[k].image.shape[1::-1]) >> coarser, 1)
        versions.append(Texture(f"{one.name}, coarser {coarser}", reduced_picture(one, (int(size[0]), int(size[1])))))
        picture[shown[(original == k) & (level == coarser)]] = len(versions) - 1
    ends = np.cumsum([len(mesh.triangles) for mesh in meshes])
    parts = np.split(picture.astype(np.int32), ends[:-1])
    changed = iter(replace(mesh, textures=part) for mesh, part in zip(meshes, parts, strict=True))
    return [one if one.mesh is None else replace(one, mesh=next(changed)) for one in objects], versions


def _levels(
    picture: NDArray[np.int64], uv: NDArray[np.float64], corners: NDArray[np.float64], sizes: NDArray[np.int64]
) -> NDArray[np.int64]:
    """(m,) how often the picture of each triangle is halved."""
    need = np.ceil(uv.max(axis=1) - np.floor(uv.min(axis=1) + 1e-6) - 1e-4)
    size = np.maximum(sizes[picture][:, None, :] >> np.arange(_LEVELS)[None, :, None], 1)
    copies = np.maximum(COPIES // np.minimum(size, COPIES), 1)
    pieces = np.ceil(need[:, None, :] / copies).prod(axis=2).astype(np.int64)
    a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    texels = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) * sizes[picture].prod(axis=1)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    texel = np.sqrt(area / np.maximum(texels, 1e-12))[:, None] * 2.0 ** np.arange(_LEVELS)
    allowed = (texel <= _FINE) & (size.min(axis=2) >= _LEAST)
    allowed[:, 0] = True
    fewest = np.where(allowed, pieces, np.iinfo(np.int64).max).min(axis=1, keepdims=True)
    level = (allowed & (pieces == fewest)).argmax(axis=1)
    for coarser in range(_LEVELS - 1, 0, -1):
        own = np.flatnonzero(level == coarser)
        spared = np.bincount(picture[own], weights=(pieces[own, 0] - pieces[own, coarser]), minlength=len(sizes))
        level[own[spared[picture[own]] < _WORTH]] = coarser - 1
    return level
