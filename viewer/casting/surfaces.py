"""Surfaces that rays have hit, as pixels for the renderer: texture coordinates, mipmap level and tint, as geometry has them.

The level of a pixel is that of the texture's change from pixel to pixel over the plane of its triangle, which OpenGL estimates
from neighbouring fragments of it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import CityMesh
from mmi.foundation.kernels import kernel
from mmi.rays.hits import Hits
from viewer.casting.open_pixels import Rays
from viewer.casting.panorama import PIXEL_LEVELS, SAMPLE, Texels
from viewer.computed import CAST_PIXEL

__all__ = ["LEVEL_BIAS", "Surfaces", "cast_pixels", "shown_again", "surfaces_of"]

LEVEL_BIAS = -0.75
"""That of the renderer's meshes (``viewer.drawing.kinds.meshes``)."""
_GRAZING = 1e-9


class Surfaces(NamedTuple):
    """A city's mesh for kernels: its arrays, the ``owners`` (m,) of triangles, and the texture's ``size`` (width, height)."""

    positions: NDArray[np.float32]
    uv: NDArray[np.float32]
    colors: NDArray[np.uint8]
    triangles: NDArray[np.int32]
    owners: NDArray[np.int32]
    size: tuple[float, float]


def surfaces_of(mesh: CityMesh) -> Surfaces:
    """The surfaces of all objects."""
    owners = np.repeat(np.arange(len(mesh.triangle_counts), dtype=np.int32), mesh.triangle_counts)
    height, width = mesh.texture.shape[:2]
    return Surfaces(mesh.positions, mesh.uv, mesh.colors, mesh.triangles, owners, (float(width), float(height)))


def cast_pixels(
    pixels: NDArray[np.int32],
    width: int,
    first_column: int,
    directions: NDArray[np.float64],
    hits: Hits,
    rays: Rays,
    surfaces: Surfaces,
) -> tuple[NDArray[np.void], NDArray[np.float32]]:
    """``CAST_PIXEL`` (n,) for ``pixels`` (n,), places in a picture of ``width`` columns from a view's ``first_column`` on, that
    show what rays in unit ``directions`` (n, 3) have hit; and the points (n, 3), world.

    Where a ray has hit nothing, the object is -1 and the point is its direction.
    """
    samples, points = np.zeros(len(pixels), dtype=CAST_PIXEL), directions.astype(np.float32)
    found = (hits.triangle, hits.distance, hits.weights)
    _look(pixels, width, first_column, directions, found, rays, surfaces, points, samples.view(SAMPLE))
    return samples, points


def shown_again(
    pixels: NDArray[np.int32],
    width: int,
    first_column: int,
    places: NDArray[np.int32],
    near_objects: NDArray[np.bool_],
    rays: Rays,
    texels: Texels,
) -> NDArray[np.void]:
    """``CAST_PIXEL`` as :func:`cast_pixels` has them, for those of ``pixels`` (n,) that show something of the panorama's
    ``places`` (n,): no near objects (all objects,), as they are drawn where they are now.
    """
    samples = np.empty(len(pixels), dtype=CAST_PIXEL)
    return samples[: _show(pixels, width, first_column, places, near_objects, rays, texels, samples.view(SAMPLE))]


@kernel(error_model="numpy", nogil=True)
def _show(
    pixels: NDArray[np.int32],
    width: int,
    first_column: int,
    places: NDArray[np.int32],
    near_objects: NDArray[np.bool_],
    rays: Rays,
    texels: Texels,
    samples: NDArray[np.void],
) -> int:
    """Fill in samples from the first on; how many there are."""
    axes, eye = rays.axes, rays.eye
    count = 0
    for k in range(len(places)):
        texel = texels.map[places[k]]
        if texel.object < 0 or near_objects[texel.object]:
            continue
        sample = samples[count]
        count += 1
        x, y, z = texel.x - eye[0], texel.y - eye[1], texel.z - eye[2]
        depth = -(axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z)
        cosine = depth / math.sqrt(x * x + y * y + z * z)
        sample.x, sample.y = first_column + pixels[k] % width, pixels[k] // width
        sample.depth, sample.u, sample.v = depth, texel.u, texel.v
        sample.level = texel.level + PIXEL_LEVELS * math.log2(max(cosine, 1e-6))
        sample.tint, sample.object = texel.tint, texel.object
    return count


@kernel(error_model="numpy", nogil=True)
def _look(
    pixels: NDArray[np.int32],
    width: int,
    first_column: int,
    directions: NDArray[np.float64],
    hits: tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]],
    rays: Rays,
    surfaces: Surfaces,
    points: NDArray[np.float32],
    samples: NDArray[np.void],
) -> None:
    """Fill in samples, which are zeros, and where rays have hit something the points."""
    axes, eye, (triangles, distances, weights) = rays.axes, rays.eye, hits
    e1, e2, p, s = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    normal, changed = np.empty(3), np.empty(3)
    for k in range(len(pixels)):
        triangle, sample = triangles[k], samples[k]
        if triangle < 0:
            sample.object = -1
            continue
        a, b, c = surfaces.triangles[triangle]
        wb, wc = float(weights[k, 0]), float(weights[k, 1])
        wa, away = 1.0 - wb - wc, float(distances[k])
        tint = 255 << 24
        for n in range(3):
            value = wa * surfaces.colors[a, n] + wb * surfaces.colors[b, n] + wc * surfaces.colors[c, n]
            tint |= int(min(max(value + 0.5, 0.0), 255.0)) << (8 * n)
            e1[n] = float(surfaces.positions[b, n]) - float(surfaces.positions[a, n])
            e2[n] = float(surfaces.positions[c, n]) - float(surfaces.positions[a, n])
            p[n] = away * directions[k, n]
            points[k, n] = eye[n] + p[n]
        depth = -(axes[2, 0] * p[0] + axes[2, 1] * p[1] + axes[2, 2] * p[2])
        normal[0] = e1[1] * e2[2] - e1[2] * e2[1]
        normal[1] = e1[2] * e2[0] - e1[0] * e2[2]
        normal[2] = e1[0] * e2[1] - e1[1] * e2[0]
        area = normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]
        facing = normal[0] * p[0] + normal[1] * p[1] + normal[2] * p[2]
        u1 = float(surfaces.uv[b, 0]) - float(surfaces.uv[a, 0])
        v1 = float(surfaces.uv[b, 1]) - float(surfaces.uv[a, 1])
        u2 = float(surfaces.uv[c, 0]) - float(surfaces.uv[a, 0])
        v2 = float(surfaces.uv[c, 1]) - float(surfaces.uv[a, 1])
        sample.x, sample.y = first_column + pixels[k] % width, pixels[k] // width
        sample.u = float(surfaces.uv[a, 0]) + wb * u1 + wc * u2
        sample.v = float(surfaces.uv[a, 1]) + wb * v1 + wc * v2
        sample.depth, sample.tint, sample.object = depth, tint, surfaces.owners[triangle]
        largest = 0.0
        if area > 0.0 and abs(facing) > _GRAZING * math.sqrt(area) * depth and depth > 0.0:
            for axis in range(2):  # a pixel to the right, and one up: of the point at ``depth``, along the plane
                slope = (normal[0] * axes[axis, 0] + normal[1] * axes[axis, 1] + normal[2] * axes[axis, 2]) / facing
                for n in range(3):
                    changed[n] = depth / rays.focal * (axes[axis, n] - p[n] * slope)
                s[0] = changed[1] * e2[2] - changed[2] * e2[1]
                s[1] = changed[2] * e2[0] - changed[0] * e2[2]
                s[2] = changed[0] * e2[1] - changed[1] * e2[0]
                db = (s[0] * normal[0] + s[1] * normal[1] + s[2] * normal[2]) / area
                s[0] = e1[1] * changed[2] - e1[2] * changed[1]
                s[1] = e1[2] * changed[0] - e1[0] * changed[2]
                s[2] = e1[0] * changed[1] - e1[1] * changed[0]
                dc = (s[0] * normal[0] + s[1] * normal[1] + s[2] * normal[2]) / area
                du, dv = (db * u1 + dc * u2) * surfaces.size[0], (db * v1 + dc * v2) * surfaces.size[1]
                largest = max(largest, du * du + dv * dv)
        sample.level = 0.5 * math.log2(largest) + LEVEL_BIAS if largest > 0.0 else 0.0
