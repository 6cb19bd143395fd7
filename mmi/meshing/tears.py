"""Where a mesh is torn: corners of texels at which surfaces meet in the picture that are too far apart to be joined.

A mesh that joins two surfaces draws a sheet between them, which nobody captured. Seen from somewhere in the cell the sheet is
as wide as the jump of depth, and may cover what really stands there. Weights keep jumps between surfaces that the cell sees
below the threshold (docs/bound.md), but a picture also holds what they say nothing about: an end of a party wall that nobody
sees, or the rim of a neighbour. So each corner of texels is looked at: those of the four texels around it that lie within the
threshold of each other, from anywhere in the cell, share a vertex, and the others have their own. Between those nothing is
drawn. What is behind shows, which is right unless a surface of the layer was missed there, and what is missed is bounded.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.kernels import kernel
from mmi.foundation.ray_chords import Intrinsics
from mmi.parallax.from_anywhere import Viewers, parted_at_most, surely_within

__all__ = [
    "JOINED",
    "LOWER_LEFT",
    "LOWER_RIGHT",
    "UNKNOWN",
    "UPPER_LEFT",
    "UPPER_RIGHT",
    "Lattice",
    "Tears",
    "beside",
    "filled",
    "may_join",
    "range_of",
    "surface_of",
    "surfaces_at",
    "used_by",
    "used_on_side",
]

UPPER_LEFT, UPPER_RIGHT, LOWER_LEFT, LOWER_RIGHT = 0, 1, 2, 3
"""The texels around a corner."""
JOINED, UNKNOWN = 0, 255
"""Surfaces at a corner of texels: all four texels are of one; not looked at yet (see :func:`surfaces_at`)."""


_BENT = 0.1
"""A surface goes on where 1/z changes as it does beside, but for this share."""


class Tears(NamedTuple):
    """What tearing goes by: ``surface`` (h, w), the 1/z of :func:`filled`; ``limit``, the largest chord across which a mesh
    joins surfaces, seen by ``viewers``. Surfaces that go on are joined across any, unless ``all_jumps`` count.
    """

    surface: NDArray[np.float64]
    viewers: Viewers
    limit: float
    all_jumps: bool


class Lattice(NamedTuple):
    """What is known of the corners of texels: ``surfaces`` (h + 1, w + 1) uint8 (:func:`surfaces_at`), and 1/z of each in
    ``values`` (h + 1, w + 1, 4), by the first texel of a surface.
    """

    surfaces: NDArray[np.uint8]
    values: NDArray[np.float64]


@kernel()
def filled(inverse: NDArray[np.float64]) -> NDArray[np.float64]:
    """``inverse`` (h, w), 1/z or 0, with the empty texels next to covered ones: each belongs to the front-most beside it.

    Those above, below and at the sides go first, then those across corners.
    """
    height, width = inverse.shape
    surface = inverse.copy()
    for j in range(height):
        for i in range(width):
            if inverse[j, i] > 0.0:
                continue
            beside, across = 0.0, 0.0
            for y in range(max(j - 1, 0), min(j + 2, height)):
                for x in range(max(i - 1, 0), min(i + 2, width)):
                    if x == i or y == j:
                        beside = max(beside, inverse[y, x])
                    else:
                        across = max(across, inverse[y, x])
            surface[j, i] = beside if beside > 0.0 else across
    return surface


@kernel()
def surface_of(surfaces: int, texel: int) -> int:
    """Which surface a texel around a corner belongs to (:func:`surfaces_at`): that of the first texel on it."""
    return (surfaces >> (2 * texel)) & 3


@kernel(error_model="numpy")
def may_join(x: int, y: int, one: float, other: float, tears: Tears, intrinsics: Intrinsics) -> bool:
    """Whether two points, of these 1/z, are within the limit, on any ray through the texels around the corner (x, y)."""
    if surely_within(tears.limit, one, other, tears.viewers.reach):
        return True
    ux, uy = (intrinsics.left + x) / intrinsics.focal, -(intrinsics.top + y) / intrinsics.focal
    blur = np.sqrt(2.0) / intrinsics.focal
    return parted_at_most(ux, uy, one, other, blur, tears.viewers, tears.limit) <= tears.limit


@kernel()
def _goes_on(surface: NDArray[np.float64], i: int, j: int, across: int, down: int) -> bool:
    """Whether the texel (i, j) and the one ``across`` and ``down`` from it lie on one slanted surface, or one shows nothing.

    1/z is linear on planes: between both it changes as it does on either side of them, or, where two planes meet, by
    something in between.
    """
    height, width = surface.shape
    if not (0 <= i and i + across < width and 0 <= j and j + down < height):
        return True
    one, other = surface[j, i], surface[j + down, i + across]
    if one == 0.0 or other == 0.0:
        return True
    step, least, most = other - one, np.inf, -np.inf
    if i >= across and j >= down and surface[j - down, i - across] > 0.0:
        least = most = one - surface[j - down, i - across]
    if i + 2 * across < width and j + 2 * down < height and surface[j + 2 * down, i + 2 * across] > 0.0:
        beyond = surface[j + 2 * down, i + 2 * across] - other
        least, most = min(least, beyond), max(most, beyond)
    return least - _BENT * abs(step) <= step <= most + _BENT * abs(step)


@kernel(error_model="numpy")
def surfaces_at(x: int, y: int, tears: Tears, intrinsics: Intrinsics) -> int:
    """Which texels around the corner (x, y) share a vertex: two bits for each, the first texel of its surface.

    From the front-most on, a surface takes what is within the limit of its front-most texel. Empty texels go with the
    front-most surface. A surface along which the capture looks may change by more from texel to texel, and is not torn.
    """
    surface = tears.surface
    height, width = surface.shape
    values, of = np.zeros(4), np.zeros(4, dtype=np.int64)
    least, most = np.inf, 0.0
    for texel in range(4):
        i, j = x - 1 + texel % 2, y - 1 + texel // 2
        if 0 <= i < width and 0 <= j < height:
            values[texel] = surface[j, i]
            if values[texel] > 0.0:
                least, most = min(least, values[texel]), max(most, values[texel])
    if most == 0.0 or may_join(x, y, least, most, tears, intrinsics):
        return JOINED
    if not tears.all_jumps:
        level = _goes_on(surface, x - 1, y - 1, 1, 0) and _goes_on(surface, x - 1, y, 1, 0)
        if level and _goes_on(surface, x - 1, y - 1, 0, 1) and _goes_on(surface, x, y - 1, 0, 1):
            return JOINED
    of[:] = -1
    first = True
    while True:
        front = -1
        for texel in range(4):
            if of[texel] < 0 and values[texel] > 0.0 and (front < 0 or values[texel] > values[front]):
                front = texel
        if front < 0:
            break
        name = -1
        for texel in range(4):
            if of[texel] >= 0 or (values[texel] == 0.0 and not first):
                continue
            within = values[texel] == 0.0 or texel == front
            if within or may_join(x, y, values[front], values[texel], tears, intrinsics):
                name = texel if name < 0 else name
                of[texel] = name
        first = False
    return of[0] | of[1] << 2 | of[2] << 4 | of[3] << 6


@kernel()
def range_of(x: int, y: int, tears: Tears, surfaces: int, of: int) -> tuple[float, float]:
    """The least and the largest 1/z of the texels around the corner (x, y) whose surface is ``of``."""
    height, width = tears.surface.shape
    least, most = np.inf, 0.0
    for texel in range(4):
        i, j = x - 1 + texel % 2, y - 1 + texel // 2
        if surface_of(surfaces, texel) == of and 0 <= i < width and 0 <= j < height and tears.surface[j, i] > 0.0:
            least, most = min(least, tears.surface[j, i]), max(most, tears.surface[j, i])
    return least, most


@kernel()
def beside(side: int) -> tuple[int, int]:
    """The texels of a rectangle before and behind a point of its side, in the direction in which x or y grow.

    Sides are the upper, the lower, the left and the right one. At its first end there is only that behind, at its last only
    that before.
    """
    before = (LOWER_LEFT, UPPER_LEFT, UPPER_RIGHT, UPPER_LEFT)[side]
    behind = (LOWER_RIGHT, UPPER_RIGHT, LOWER_RIGHT, LOWER_LEFT)[side]
    return before, behind


@kernel()
def used_by(lattice: Lattice, box: tuple[int, int, int, int], used: NDArray[np.int32]) -> None:
    """Sets ``used`` (h + 1, w + 1, 4) to 0 for the surfaces that a rectangle has at its corners."""
    x0, y0, x1, y1 = box
    surfaces = lattice.surfaces
    used[y0, x0, surface_of(surfaces[y0, x0], LOWER_RIGHT)] = 0
    used[y0, x1, surface_of(surfaces[y0, x1], LOWER_LEFT)] = 0
    used[y1, x0, surface_of(surfaces[y1, x0], UPPER_RIGHT)] = 0
    used[y1, x1, surface_of(surfaces[y1, x1], UPPER_LEFT)] = 0


@kernel()
def used_on_side(lattice: Lattice, used: NDArray[np.int32], x: int, y: int, side: int) -> int:
    """Which surface at a point within a side of a rectangle is ``used`` (not negative) and the rectangle's; -1 for none."""
    surfaces = lattice.surfaces[y, x]
    if surfaces == UNKNOWN:
        return -1
    before, behind = beside(side)
    one, other = surface_of(surfaces, before), surface_of(surfaces, behind)
    return one if used[y, x, one] >= 0 else other if used[y, x, other] >= 0 else -1
