"""Triangles of the rectangles that a mesh is cut into, with all vertices that others have on their sides: there are no cracks.

A rectangle without any is two triangles; another is a fan: from one of its vertices, where that shows well enough what was
captured, and else from its middle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.kernels import kernel
from mmi.meshing.displacement import Captured, Vertices, displaced_by

__all__ = ["UV_ERROR", "stretch", "triangulated"]

UV_ERROR = 1.0
"""Texels by which perspective interpolation may be off."""


@kernel(error_model="numpy")
def stretch(length: float, one: float, other: float) -> float:
    """Texels by which perspective interpolation of texture coordinates is off halfway between two vertices, of these 1/z.

    With n texels between them and depths z0 and z1, that is n |z0 - z1| / (2 (z0 + z1)).
    """
    return 0.5 * length * abs(one - other) / (one + other)


@kernel(error_model="numpy")
def triangulated(
    captured: Captured, boxes: list[tuple[int, int, int, int]], known: NDArray[np.float64], tolerance: float
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64]]:
    """Vertices (n, 2) on the lattice of texel corners and in the middle of boxes, triangles (m, 3), and the vertices' 1/z (n,).

    ``boxes`` (x0, y0, x1, y1) do not overlap; ``known`` (h + 1, w + 1) is 1/z at texel corners, at least at those of boxes.
    ``tolerance`` is a chord (:func:`mmi.foundation.ray_chords.chord`).
    """
    height, width = captured.inverse.shape
    used = np.full((height + 1, width + 1), -1, dtype=np.int32)
    for x0, y0, x1, y1 in boxes:
        used[y0, x0] = used[y0, x1] = used[y1, x0] = used[y1, x1] = 0
    count, longest = 0, 0
    for y in range(height + 1):
        for x in range(width + 1):
            if used[y, x] == 0:
                used[y, x] = count
                count += 1
    vertices = Vertices(np.empty((count + len(boxes), 2)), np.empty(count + len(boxes)))
    lattice, values = vertices.lattice, vertices.values
    for y in range(height + 1):
        for x in range(width + 1):
            if used[y, x] >= 0:
                lattice[used[y, x], 0], lattice[used[y, x], 1], values[used[y, x]] = x, y, known[y, x]
    for x0, y0, x1, y1 in boxes:
        longest = max(longest, x1 - x0 + y1 - y0)
    triangles = [(np.int32(0), np.int32(0), np.int32(0))]
    triangles.pop()
    ring = np.empty(2 * longest, dtype=np.int32)
    for x0, y0, x1, y1 in boxes:
        around = 0  # counter-clockwise as seen from the capture, where y grows downwards
        for y in range(y0, y1):
            if used[y, x0] >= 0:
                ring[around] = used[y, x0]
                around += 1
        for x in range(x0, x1):
            if used[y1, x] >= 0:
                ring[around] = used[y1, x]
                around += 1
        for y in range(y1, y0, -1):
            if used[y, x1] >= 0:
                ring[around] = used[y, x1]
                around += 1
        for x in range(x1, x0, -1):
            if used[y0, x] >= 0:
                ring[around] = used[y0, x]
                around += 1
        if around == 4:
            triangles.append((ring[0], ring[1], ring[2]))
            triangles.append((ring[0], ring[2], ring[3]))
            continue
        # The middle is where it would be without the others' vertices: on the diagonal. Mostly, one of these will do instead.
        lattice[count, 0], lattice[count, 1] = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
        values[count] = 0.5 * (known[y0, x0] + known[y1, x1])
        apex = _apex(captured, vertices, ring[:around], count, tolerance)
        if apex < 0:
            for k in range(around):
                triangles.append((ring[k], ring[(k + 1) % around], np.int32(count)))  # noqa: PERF401 (Numba)
            count += 1
            continue
        for k in range(apex + 1, apex + around - 1):
            triangles.append((ring[k % around], ring[(k + 1) % around], ring[apex]))  # noqa: PERF401 (Numba)
    corners_of = np.empty((len(triangles), 3), dtype=np.int32)
    for k in range(len(triangles)):
        corners_of[k, 0], corners_of[k, 1], corners_of[k, 2] = triangles[k]
    return lattice[:count], corners_of, values[:count]


@kernel(error_model="numpy")
def _apex(captured: Captured, vertices: Vertices, ring: NDArray[np.int32], middle: int, tolerance: float) -> int:
    """The place in a rectangle's ``ring`` of a vertex from which a fan shows it as well as one from its middle; -1 for none.

    The fan is as good where it stays within the tolerance, or displaces no more than the fan from the middle does. It has two
    triangles less.
    """
    around, lattice, values = len(ring), vertices.lattice, vertices.values
    limit, reach = 0.0, (captured.offsets**2).sum(axis=1).max() ** 0.5
    for apex in range(around):
        # No triangle may be a line (of its own sides, none has a third vertex), and none too long for its texture.
        allowed = True
        tip = lattice[ring[apex]]
        for k in range(apex + 1, apex + around - 1):
            one, next_one = ring[k % around], ring[(k + 1) % around]
            far = np.hypot(lattice[one, 0] - tip[0], lattice[one, 1] - tip[1])
            allowed &= _area(lattice, one, next_one, ring[apex]) > 0.0
            allowed &= stretch(far, values[one], values[ring[apex]]) <= UV_ERROR
        if not allowed:
            continue
        if limit == 0.0:
            limit = tolerance
            for k in range(around):
                of_middle = (ring[k], ring[(k + 1) % around], middle)
                limit = displaced_by(captured, vertices, of_middle, reach, limit)
        within = True
        for k in range(apex + 1, apex + around - 1):
            corners = (ring[k % around], ring[(k + 1) % around], ring[apex])
            within &= displaced_by(captured, vertices, corners, reach, limit) <= limit
        if within:
            return apex
    return -1


@kernel(error_model="numpy")
def _area(lattice: NDArray[np.float64], a: int, b: int, c: int) -> float:
    """Twice the area of a triangle, positive if counter-clockwise as seen from the capture."""
    return (lattice[b, 1] - lattice[a, 1]) * (lattice[c, 0] - lattice[a, 0]) - (lattice[b, 0] - lattice[a, 0]) * (
        lattice[c, 1] - lattice[a, 1]
    )
