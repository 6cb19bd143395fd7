"""Triangles of the rectangles that a mesh is cut into, with all vertices that others have on their sides: there are no cracks.

A rectangle without any is two triangles; another is a fan: from one of its vertices, where that shows well enough what was
captured, and else from its middle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.kernels import kernel
from mmi.meshing.displacement import Captured, Vertices, displaced_by
from mmi.meshing.tears import UPPER_LEFT, Lattice, beside, surface_of, used_by, used_on_side

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
    captured: Captured, boxes: list[tuple[int, int, int, int]], corners: Lattice, tolerance: float
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64]]:
    """Vertices (n, 2) on the lattice of texel corners and in the middle of boxes, triangles (m, 3), and the vertices' 1/z (n,).

    ``boxes`` (x0, y0, x1, y1) do not overlap; of ``corners`` those of boxes are known. A corner has a vertex for each surface.
    ``tolerance`` is a chord (:func:`mmi.foundation.ray_chords.chord`).
    """
    height, width = captured.inverse.shape
    used = np.full((height + 1, width + 1, 4), -1, dtype=np.int32)
    for box in boxes:
        used_by(corners, box, used)
    count, longest = 0, 0
    for y in range(height + 1):
        for x in range(width + 1):
            for surface in range(4):
                if used[y, x, surface] == 0:
                    used[y, x, surface] = count
                    count += 1
    vertices = Vertices(np.empty((count + len(boxes), 2)), np.empty(count + len(boxes)))
    lattice, values = vertices.lattice, vertices.values
    for y in range(height + 1):
        for x in range(width + 1):
            for surface in range(4):
                at = used[y, x, surface]
                if at >= 0:
                    lattice[at, 0], lattice[at, 1], values[at] = x, y, corners.values[y, x, surface]
    for x0, y0, x1, y1 in boxes:
        longest = max(longest, x1 - x0 + y1 - y0)
    triangles = [(np.int32(0), np.int32(0), np.int32(0))]
    triangles.pop()
    ring = np.empty(2 * longest, dtype=np.int32)
    for box in boxes:
        x0, y0, x1, y1 = box
        around = _ring(corners, used, box, ring)
        if around == 4:
            triangles.append((ring[0], ring[1], ring[2]))
            triangles.append((ring[0], ring[2], ring[3]))
            continue
        # The middle is where it would be without the others' vertices: on the diagonal. Mostly, one of these will do instead.
        lattice[count, 0], lattice[count, 1] = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
        values[count] = 0.5 * (values[ring[0]] + values[used[y1, x1, surface_of(corners.surfaces[y1, x1], UPPER_LEFT)]])
        apex = _apex(captured, vertices, ring[:around], count, tolerance)
        if apex < 0:
            for k in range(around):
                triangles.append((ring[k], ring[(k + 1) % around], np.int32(count)))  # noqa: PERF401 (Numba)
            count += 1
            continue
        for k in range(apex + 1, apex + around - 1):
            triangles.append((ring[k % around], ring[(k + 1) % around], ring[apex]))  # noqa: PERF401 (Numba)
    rows = np.empty((len(triangles), 3), dtype=np.int32)
    for k in range(len(triangles)):
        rows[k, 0], rows[k, 1], rows[k, 2] = triangles[k]
    return lattice[:count], rows, values[:count]


@kernel()
def _ring(corners: Lattice, used: NDArray[np.int32], box: tuple[int, int, int, int], ring: NDArray[np.int32]) -> int:
    """Sets ``ring`` to the vertices of its own surfaces around a box, counter-clockwise as seen from the capture.

    The upper left one is the first. Returns how many they are.
    """
    x0, y0, x1, y1 = box
    around = 0
    for side in (2, 1, 3, 0):  # where y grows downwards
        level, forth = side < 2, side in (2, 1)
        fixed = (y0, y1, x0, x1)[side]
        start, end = (x0, x1) if level else (y0, y1)
        before, behind = beside(side)
        for step in range(end - start):
            k = start + step if forth else end - step
            x, y = (k, fixed) if level else (fixed, k)
            if step == 0:
                surface = surface_of(corners.surfaces[y, x], behind if forth else before)
            else:
                surface = used_on_side(corners, used, x, y, side)
            if surface >= 0:
                ring[around] = used[y, x, surface]
                around += 1
    return around


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
