"""Meshes that came with objects, as surfaces of the city's mesh: with pictures, of one colour, or painted.

Each triangle is shaded by itself. Painted ones (``mmi.city.model.PAINTED``) get a wall with storeys where they are steep, in
rows from the object's foot, and a roof elsewhere. Pictures are mostly photographs, which have their own light already: they are
shaded half as much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mmi.appearance import facades
from mmi.appearance.shading import Looks, contact, light
from mmi.appearance.texture_atlas import Atlas, cut_at_repeats
from mmi.city.model import PAINTED, CityObject, Texture

__all__ = ["Surfaces", "repeats_of", "strip_uv", "surfaces_of_models"]

_STEEP = 0.5  # vertical part of the normal below which a triangle is a wall
_NARROW = 1.2  # metres below which a wall has no room for a window
_ROOF_STRIP_METRES = 8.0


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """Vertices and triangles of some objects, with the object that each vertex belongs to, on their way into a city's mesh:
    colours are still factors, and texture coordinates float64.
    """

    positions: NDArray[np.float64]
    uv: NDArray[np.float64]
    colors: NDArray[np.float64]
    triangles: NDArray[np.int64]
    owners: NDArray[np.int64]  # (n,) of vertices


@dataclass(frozen=True, slots=True, eq=False)
class _Triangles:
    """All triangles of all meshes: ``corners`` (m, 3, 3), looks as in ``TriangleMesh``, unit ``normals``, ``owners``."""

    corners: NDArray[np.float64]
    textures: NDArray[np.int64]
    colors: NDArray[np.float64]
    uv: NDArray[np.float64]
    normals: NDArray[np.float64]
    owners: NDArray[np.int64]

    def of(self, chosen: NDArray[np.int64] | NDArray[np.bool_]) -> _Triangles:
        return _Triangles(*(getattr(self, name)[chosen] for name in self.__slots__))


def repeats_of(objects: Sequence[CityObject], textures: Sequence[Texture]) -> NDArray[np.float64]:
    """(n, 2) how many copies of each picture, across and down, hold any triangle that it covers; at least 1."""
    found = np.ones((len(textures), 2))
    for one in objects:
        if one.mesh is not None and len(one.mesh.triangles):
            covered = one.mesh.textures >= 0
            low, high = (end(one.mesh.uv[covered], axis=1) for end in (np.min, np.max))
            np.maximum.at(found, one.mesh.textures[covered], high - np.floor(low + 1e-6) - 1e-4)
    return found


def surfaces_of_models(
    objects: Sequence[CityObject], owners: NDArray[np.int64], looks: Looks, atlas: Atlas | None
) -> tuple[Surfaces, ...]:
    """The meshes of ``objects`` (each has one), whose places in the city are ``owners``; three vertices a triangle.

    What is painted comes first, then what has one colour, then what shows pictures. Without an ``atlas`` all is painted.
    """
    every = _gather(objects, owners)
    painted = every.of(every.textures == PAINTED)
    uv, colors = _painted(painted, looks)
    if atlas is None:
        return (_surfaces(painted, uv, colors),)
    colored = every.of((every.textures != PAINTED) & (every.textures < 0))
    pictured = every.of(every.textures >= 0)
    copies = atlas.copies[pictured.textures].astype(np.float64)
    corners, placed, source = cut_at_repeats(pictured.corners, pictured.uv, copies)
    cut = _Triangles(
        corners, *(getattr(pictured, name)[source] for name in ("textures", "colors", "uv", "normals", "owners"))
    )
    in_atlas = atlas.place(np.repeat(cut.textures[:, None], 3, axis=1), placed)
    white = np.broadcast_to(atlas.white, (len(colored.corners), 3, 2))
    return (
        _surfaces(painted, uv * atlas.facade_scale, colors),
        _surfaces(colored, white, colored.colors * light(colored.normals)),
        _surfaces(cut, in_atlas, cut.colors * (0.5 + 0.5 * light(cut.normals))),
    )


def _gather(objects: Sequence[CityObject], owners: NDArray[np.int64]) -> _Triangles:
    """All triangles that have an area."""
    meshes = [one.mesh for one in objects if one.mesh is not None]
    corners = np.concatenate([np.empty((0, 3, 3)), *(mesh.vertices[mesh.triangles] for mesh in meshes)])
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(cross, axis=1)
    every = _Triangles(
        corners,
        np.concatenate([np.empty(0, dtype=np.int64), *(mesh.textures for mesh in meshes)]),
        np.concatenate([np.empty((0, 3)), *(mesh.colors / 255.0 for mesh in meshes)]),
        np.concatenate([np.empty((0, 3, 2)), *(mesh.uv for mesh in meshes)]),
        cross / np.maximum(size, 1e-300)[:, None],
        np.repeat(owners, [len(mesh.triangles) for mesh in meshes]),
    )
    return every.of(size > 1e-12)


def _surfaces(triangles: _Triangles, uv: NDArray[np.float64], colors: NDArray[np.float64]) -> Surfaces:
    """``uv`` (m, 3, 2); ``colors`` (m, 3) of triangles or (m, 3, 3) of their corners."""
    m = len(triangles.corners)
    if colors.ndim == 2:
        colors = np.repeat(colors[:, None], 3, axis=1)
    return Surfaces(
        positions=triangles.corners.reshape(-1, 3),
        uv=np.asarray(uv, dtype=np.float64).reshape(-1, 2),
        colors=colors.reshape(-1, 3),
        triangles=np.arange(3 * m).reshape(-1, 3),
        owners=np.repeat(triangles.owners, 3),
    )


def _painted(triangles: _Triangles, looks: Looks) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """uv (m, 3, 2) in the texture of facades, and colours (m, 3 corners, 3), of triangles without looks of their own."""
    corners, normals, owners = triangles.corners, triangles.normals, triangles.owners
    if not len(corners):
        return np.empty((0, 3, 2)), np.empty((0, 3, 3))
    style = looks.style[owners]
    objects = int(owners.max()) + 1
    foot, top = np.full(objects, np.inf), np.full(objects, -np.inf)
    steep = np.abs(normals[:, 2]) < _STEEP
    np.minimum.at(foot, owners, corners[:, :, 2].min(axis=1))
    np.maximum.at(top, owners[steep], corners[steep, :, 2].max(axis=1))
    tall = np.where(np.isfinite(top) & np.isfinite(foot), top - foot, 1.0)
    storeys = np.maximum(np.rint(tall / facades.STOREY), 1.0)
    # A house with more storeys than the texture gets larger storeys: its triangles do not end between storeys.
    storey = (tall / np.minimum(storeys, facades.ROWS))[owners]
    above = corners[:, :, 2] - foot[owners][:, None]
    along = np.stack([-normals[:, 1], normals[:, 0]], axis=1)  # to the right, seen from outside
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-9)[:, None]
    # From a corner of the object itself: far away, the least turn from one triangle of a wall to the next would be metres.
    corner = np.full((objects, 2), np.inf)
    np.minimum.at(corner, owners, corners[:, :, :2].min(axis=1))
    metres = np.einsum("mcx,mx->mc", corners[:, :, :2] - corner[owners][:, None], along)
    row_height = facades.storey_v(style, np.ones(len(style))) - facades.storey_v(style, np.zeros(len(style)))
    wall_v = facades.storey_v(style, np.zeros(len(style)))[:, None] + row_height[:, None] * above / storey[:, None]
    strip_top, strip_bottom = facades.blind_strip(style)
    share = np.clip(above / np.maximum(tall[owners], 1e-9)[:, None], 0.0, 1.0)
    blind = (np.ptp(metres, axis=1) < _NARROW)[:, None]
    wall_v = np.where(blind, strip_bottom[:, None] + share * (strip_top - strip_bottom)[:, None], wall_v)
    wall = np.stack(
        [metres / (facades.BAYS * facades.BAY) + (looks.bay[owners] / facades.BAYS)[:, None], wall_v], axis=-1
    )
    if looks.plain:
        wall[..., 0], wall[..., 1] = facades.blind_point(style[:, None])

    flat = np.flatnonzero(~steep)
    by_owner = flat[np.argsort(owners[flat], kind="stable")]
    used, roof = np.unique(owners[by_owner], return_inverse=True)
    strips = facades.roof_strip(looks.style[used])
    points = corners[by_owner, :, :2].reshape(-1, 2)
    wall[by_owner] = strip_uv(points, np.repeat(roof, 3), *strips).reshape(-1, 3, 2)
    tint = looks.tint[owners]
    tint = np.where(steep[:, None], tint, 0.5 + 0.5 * tint)  # slate is not the colour of the wall below
    colors = (tint * light(normals))[:, None, :] * contact(above)[..., None]
    return wall, colors


def strip_uv(
    points: NDArray[np.float64], roof: NDArray[np.int64], v_top: NDArray[np.float64], v_bottom: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n, 2) points of the roofs ``roof`` (n,), sorted -> uv that fit each roof into its strip of the atlas, coarser where the
    roof is larger. ``v_top`` and ``v_bottom`` (k,) are the edges of the strips.
    """
    if not len(points):
        return np.empty((0, 2))
    starts = np.searchsorted(roof, np.arange(len(v_top)))
    offset = points - np.minimum.reduceat(points, starts)[roof]
    metres = np.maximum(_ROOF_STRIP_METRES, np.maximum.reduceat(offset[:, 1], starts))[roof]
    height = (v_bottom - v_top)[roof]
    aspect = facades.TEXTURE_SIZE[0] / facades.TEXTURE_SIZE[1]
    return np.column_stack([offset[:, 0] / metres * height * aspect, v_bottom[roof] - offset[:, 1] / metres * height])
