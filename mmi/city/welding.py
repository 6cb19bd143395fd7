"""Corners that lie in one place made one, and what that says of a mesh: whether it is closed, and its volume."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["is_closed", "volume", "weld"]


def weld(vertices: ArrayLike) -> NDArray[np.int64]:
    """(n,) for each of ``vertices`` (n, d) the number of its place: equal coordinates, equal numbers, from 0 without gaps."""
    points = np.asarray(vertices)
    order = np.lexsort(points.T)
    new = np.ones(len(points), dtype=bool)
    new[1:] = (points[order[1:]] != points[order[:-1]]).any(axis=1)
    place = np.empty(len(points), dtype=np.int64)
    place[order] = np.cumsum(new) - 1
    return place


def is_closed(vertices: ArrayLike, triangles: ArrayLike) -> bool:
    """Whether every directed edge has its opposite exactly once, equal vertices taken as one; nothing encloses nothing.

    ``vertices`` (n, 3), ``triangles`` (m, 3) indices. Triangles with two equal corners are no triangles.
    """
    corners = weld(vertices)[np.asarray(triangles, dtype=np.int64).reshape(-1, 3)]
    following = np.roll(corners, -1, axis=1)
    whole = (corners != following).all(axis=1)
    a, b = corners[whole].reshape(-1), following[whole].reshape(-1)
    if not len(a):
        return False
    count = int(max(a.max(), b.max())) + 1
    there, back = np.sort(a * count + b), np.sort(b * count + a)
    return bool((there[1:] != there[:-1]).all() and (there == back).all())


def volume(vertices: ArrayLike, triangles: ArrayLike) -> float:
    """Cubic metres that closed ``triangles`` (m, 3) of ``vertices`` (n, 3) enclose; negative where they face inwards."""
    chosen = np.asarray(triangles, dtype=np.int64).reshape(-1, 3)
    points = np.asarray(vertices, dtype=np.float64).reshape(-1, 3)
    if not len(chosen):
        return 0.0
    a, b, c = np.moveaxis((points - points[chosen[0, 0]])[chosen], 1, 0)
    return float((a * np.cross(b, c)).sum() / 6.0)
