"""A small city with cut-outs: trees of two crossing quads before houses, and railings."""

from __future__ import annotations

import numpy as np
from cities import block, streets
from shapely.geometry import box

from mmi.city.model import City, CityObject, Prism, Texture, TriangleMesh

LEAF = (60, 130, 40)
STEEL = (90, 95, 110)


def leaves(size=128, seed=8):
    """A crown with about half of its square covered, on a trunk; what is clear is black, as painting programs leave it."""
    rng = np.random.default_rng(seed)
    image = np.zeros((size, size, 4), dtype=np.uint8)
    y, x = np.mgrid[:size, :size] / size
    crown = np.hypot(x - 0.5, (y - 0.4) * 1.2) < 0.45
    blobs = np.kron(rng.random((size // 4, size // 4)), np.ones((4, 4))) < 0.65
    trunk = (abs(x - 0.5) < 0.04) & (y > 0.6)
    image[(crown & blobs) | trunk] = (*LEAF, 255)
    return Texture("leaves", image)


def railing(size=64):
    """Bars of a quarter of the width, and a rail along the top."""
    image = np.zeros((size, size, 4), dtype=np.uint8)
    image[:, np.arange(size) % 16 < 4] = (*STEEL, 255)
    image[: size // 8] = (*STEEL, 255)
    return Texture("railing", image)


def quad(lower_left, along, height, texture, repeats=(1.0, 1.0)):
    """An upright rectangle from ``lower_left`` (x, y, z) along (x, y): corners (4, 3) and coordinates (2, 3, 2)."""
    a = np.asarray(lower_left, dtype=float)
    b = a + np.array([*along, 0.0])
    up = np.array([0.0, 0.0, height])
    corners = np.array([a, b, b + up, a + up])
    at = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * repeats
    order = np.array([[0, 1, 2], [0, 2, 3]])
    return corners, order, at[order], texture


def mesh_of_quads(quads):
    """One mesh of them all."""
    corners, order, uv, textures = zip(*quads, strict=True)
    triangles = np.concatenate([one + 4 * i for i, one in enumerate(order)])
    return TriangleMesh(
        np.concatenate(corners),
        triangles.astype(np.int32),
        np.repeat(np.array(textures, dtype=np.int32), 2),
        None,
        np.concatenate(uv).astype(np.float32),
    )


def modelled(name, quads):
    """An object of such a mesh, bounded by its box."""
    mesh = mesh_of_quads(quads)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    low[:2], high[:2] = np.minimum(low[:2], high[:2] - 0.2), np.maximum(high[:2], low[:2] + 0.2)
    return CityObject(name, (Prism(box(*low[:2], *high[:2]), low[2], high[2]),), mesh, ())


def tree(name, x, y, size=8.0):
    """Two crossing quads with leaves (texture 0)."""
    half = 0.5 * size
    return modelled(
        name,
        [quad((x - half, y, 0.0), (size, 0.0), size, 0), quad((x, y - half, 0.0), (0.0, size), size, 0)],
    )


def street_of_trees():
    """Houses on both sides of a street of 200 m, trees before them, and a railing along one side."""
    objects = []
    for i, x in enumerate(range(-90, 90, 30)):
        objects.append(block(f"north/{i}", x, 18.0, x + 24.0, 30.0, 15.0 + i))
        objects.append(block(f"south/{i}", x, -30.0, x + 24.0, -18.0, 18.0 - i))
        objects.append(tree(f"tree/{i}", x + 12.0, 11.0, 8.0 + 0.5 * i))
    objects.append(modelled("railing", [quad((-90.0, -9.0, 0.0), (180.0, 0.0), 1.5, 1, (90.0, 1.0))]))
    return City(
        tuple(objects),
        streets([(-100.0, 0.0), (0.0, 0.0), (100.0, 0.0)], half_width=6.0),
        "EPSG:3067",
        (0.0, 0.0, 0.0),
        "trees.city",
        textures=(leaves(), railing()),
    )
