"""The rays from a viewpoint through boxes: where they lie, and how far apart two points of one ray within a box can be.

Corners of a box do not bound what its inside does: the middle of the near face is often worse. So bounds use depths that hold
for every point. Along any axis, the points of a ray have depths in proportion to their distances, with the same factor of at
most 1; that is all that :mod:`mmi.validity.ray_pairs` asks of a unit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["BoxRays", "Extents", "box_rays", "cosines_with", "disparity", "extents", "offsets", "pick", "spread_of"]

_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
_COUNTED = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 0, 1], [0, 1, 1], [1, 1, 1]], dtype=np.float64)
"""The axes that each unit counts."""
_UNIT, _AXIS = np.nonzero(_COUNTED)
_FIRST = np.searchsorted(_UNIT, np.arange(7))
_OTHERS = _COUNTED[_UNIT] * (np.arange(3) != _AXIS[:, None])
"""Of each unit and axis that it counts: those, where a unit's axes begin, and the other axes."""
_UNUSABLE = 1e9
"""A unit that may change by so much from one ray to its neighbour bounds nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class BoxRays:
    """Rays through n boxes: within ``spread`` (n,) radians of ``directions`` (n, 3), unit vectors.

    ``near`` and ``far`` (n,) bound two points of a ray in a box, in the unit in which they part least (a metre or more):
    at least ``near``, at most ``far``. ``depths`` (n, 2) are the least and greatest depth along ``directions``. A box that
    holds the viewpoint has rays all around and ``near`` 0.
    """

    directions: NDArray[np.float64]
    spread: NDArray[np.float64]
    near: NDArray[np.float64]
    far: NDArray[np.float64]
    depths: NDArray[np.float64]


def box_rays(captured: ArrayLike, boxes: ArrayLike) -> BoxRays:
    """The rays from ``captured`` (3,) or (n, 3) through ``boxes`` (n, 2, 3), whose least and greatest corners they are."""
    low, high = offsets(captured, boxes)
    nearest = np.maximum(np.maximum(low, -high), 0.0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    length = np.linalg.norm(middle, axis=-1)
    directions = np.divide(middle, length[:, None], out=np.zeros_like(middle), where=length[:, None] > 0.0)
    reach = np.sum(half * np.abs(directions), axis=-1)
    inside = ~np.any(nearest > 0.0, axis=-1)
    depths = np.stack((length - reach, length + reach), axis=-1)
    found = extents(low, high)
    near = np.vstack((np.maximum(depths[:, 0], 0.0), found.near))
    far = np.vstack((depths[:, 1], np.minimum(found.far, found.near + found.chord)))
    near, far = pick(np.argmin(disparity(near, far), axis=0), near, far)
    spread = np.where(inside, math.pi, spread_of(low, high, directions))
    return BoxRays(directions, spread, np.where(inside, 0.0, near), np.where(inside, depths[:, 1], far), depths)


def offsets(captured: ArrayLike, boxes: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and greatest corners (n, 3) of boxes, from the viewpoint."""
    eye = np.asarray(captured, dtype=np.float64)
    both = np.asarray(boxes, dtype=np.float64)
    return both[:, 0] - eye, both[:, 1] - eye


def cosines_with(
    directions: NDArray[np.float64], spread: NDArray[np.float64], movement: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and greatest cosine (n,) of ``movement``, (3,) or (n, 3), with rays within ``spread`` of ``directions`` (n, 3)."""
    length = np.linalg.norm(movement, axis=-1)
    along = np.sum(directions * movement, axis=-1)
    cosine = np.divide(along, length, out=np.zeros(np.broadcast(along, length).shape), where=length > 0.0)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    return np.cos(np.minimum(angle + spread, math.pi)), np.cos(np.maximum(angle - spread, 0.0))


def spread_of(
    low: NDArray[np.float64], high: NDArray[np.float64], directions: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The greatest angle between a direction and a corner: below a right angle the cone holds the box, else pi."""
    corners = np.where(_CORNERS == 0, low[:, None, :], high[:, None, :])
    along = np.sum(corners * directions[:, None, :], axis=-1)
    aside = np.linalg.norm(corners - along[..., None] * directions[:, None, :], axis=-1)
    spread = np.max(np.arctan2(aside, along), axis=-1)
    return np.where(spread < 0.5 * math.pi, spread, math.pi)


class Extents(NamedTuple):
    """Where n boxes lie in seven units: depths along x, y, z, distances in the planes xy, xz, yz, and in space; each (7, n).

    A point of a box is at least ``near`` and at most ``far`` away, two points of one ray in it at most ``chord`` apart.
    """

    near: NDArray[np.float64]
    far: NDArray[np.float64]
    chord: NDArray[np.float64]


def extents(low: NDArray[np.float64], high: NDArray[np.float64], widened: float = 0.0) -> Extents:
    """The extents of boxes with corners ``low`` and ``high`` (n, 3), from the viewpoint.

    A ray stays in a box for at most size / |u_i| metres, with |u_i| at least that of the corner that is nearest along i and
    farthest aside. With ``widened`` (radians), a point may also be drawn at the distance of another whose ray is that far from
    its own. A unit is the length k of a ray's projection, and changes by a factor of at most 1 + x, x = widened / (k -
    widened), from one ray to the other; the directions of the projections differ by at most x.
    """
    nearest, farthest = np.maximum(np.maximum(low, -high), 0.0).T, np.maximum(np.abs(low), np.abs(high)).T
    close, away = nearest * nearest, farthest * farthest
    near, far = np.sqrt(_COUNTED @ close), np.sqrt(_COUNTED @ away)
    turn, scale = np.full(near.shape, widened), np.ones(near.shape)
    if widened > 0.0:
        # The last unit is the distance, which no turn changes.
        least = near[:6] / np.maximum(np.sqrt(_COUNTED[:6] @ close + (1.0 - _COUNTED[:6]) @ away), 1e-300) - widened
        turn[:6] = np.divide(widened, least, out=np.full(least.shape, _UNUSABLE), where=least > 0.0)
        scale[:6] = 1.0 + turn[:6]
    aslant = np.sqrt(close[_AXIS] + _OTHERS @ away)
    length = ((high - low).T[_AXIS] + (far * turn)[_UNIT]) * aslant
    chords = np.divide(length, nearest[_AXIS], out=np.full(length.shape, math.inf), where=nearest[_AXIS] > 0.0)
    chord = np.minimum.reduceat(chords, _FIRST) * scale + near * (scale - 1.0 / scale)
    return Extents(near / scale, far * scale, chord)


def disparity(near: NDArray[np.float64], far: NDArray[np.float64]) -> NDArray[np.float64]:
    """1 / near - 1 / far per unit, infinite where ``near`` is 0: for short ways, points part in proportion to it."""
    return np.divide(1.0, near, out=np.full(near.shape, math.inf), where=near > 0.0) - 1.0 / np.maximum(far, 1e-300)


def pick(best: NDArray[np.int64], *each: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Of arrays (u, n), the entries in the rows ``best`` (n,), each (n,)."""
    return tuple(np.take_along_axis(one, best[None], axis=0)[0] for one in each)
