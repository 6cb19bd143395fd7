"""Meshes of loose triangles, and rays at them, to hold casters against each other."""

import numpy as np

from mmi.appearance.city_mesh import CityMesh


def soup_mesh(corners, *, uv=None, texture=None):
    """A city mesh of one object from the corners (m, 3, 3) of its triangles and their ``uv`` (m, 3, 2); white, unless given a
    ``texture``.
    """
    corners = np.asarray(corners, dtype=np.float32).reshape(-1, 3, 3)
    count = len(corners)
    return CityMesh(
        positions=corners.reshape(-1, 3),
        uv=np.zeros((3 * count, 2), np.float32) if uv is None else np.asarray(uv, np.float32).reshape(-1, 2),
        colors=np.full((3 * count, 3), 255, np.uint8),
        triangles=np.arange(3 * count, dtype=np.int32).reshape(-1, 3),
        object_vertices=np.array([0, 3 * count]),
        object_triangles=np.array([0, count]),
        texture=np.full((1, 1, 3), 255, np.uint8) if texture is None else texture,
    )


def random_soup(rng, count, *, size=1.0, spread=(10.0, 10.0, 3.0)):
    """(m, 3, 3) random triangles of about a ``size``, in a box of ``spread``."""
    return rng.random((count, 1, 3)) * np.array(spread) + size * rng.normal(size=(count, 3, 3))


def random_directions(rng, count, *, flatness=1.0):
    """(n, 3) random unit vectors; with a small ``flatness`` nearly level."""
    along = rng.normal(size=(count, 3)) * (1.0, 1.0, flatness)
    return along / np.linalg.norm(along, axis=1, keepdims=True)
