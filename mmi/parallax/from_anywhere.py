"""How far apart two points of one capture ray are seen from anywhere in a cell, at most.

Evaluated at the corners of a cell, an angle is a lower bound: beside a long cell it may be largest from between two corners,
and an eye may be higher or lower than the reference. Here is an upper bound. For points P and Q of one ray from C, seen from M,

    sin PMQ = |(M - C) x (Q - P)| / (|P - M| |Q - M|),

since P - M and Q - M differ by Q - P, which is parallel to P - C. Over a box of viewpoints the numerator is convex in M (the
length of a linear function), so that it is largest at a corner; each distance is at least that to the nearest point of the
box. Both need not happen at one M. So the cell is cut into boxes of a few metres, and the bound is the largest of theirs.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.cells.viewing_cells import ViewingCell
from mmi.foundation.camera import View
from mmi.foundation.kernels import kernel

__all__ = ["Viewers", "parted_at_most", "surely_within", "viewers_of"]

_SIDE = 3.0
"""Metres: boxes that the cell is cut into are no longer and no wider."""
_OPPOSITE = 2.0
"""The chord between opposite directions: what is said where nothing better is known."""


class Viewers(NamedTuple):
    """Where viewers of a cell may be, from a capture: boxes ``low`` to ``high`` (k, 3), metres from the capture's eye.

    Their axes are those of the cell (along, to the left, up), which ``turn`` (3, 3) turns the capture's eye space to. The
    first box is all of the cell; box i is cut into the boxes 2 i + 1 and 2 i + 2, if there are so many. Nobody is farther than
    ``reach`` metres from the capture's eye.
    """

    turn: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    reach: float


def viewers_of(cell: ViewingCell, view: View) -> Viewers:
    """The viewers of ``cell``, eyes anywhere in its eye band, as a capture with ``view`` needs them."""
    along = np.subtract(cell.q, cell.p) / cell.length
    axes = np.array([[along[0], along[1], 0.0], [-along[1], along[0], 0.0], [0.0, 0.0, 1.0]])
    middle = axes @ (np.array([*np.add(cell.p, cell.q) / 2.0, 0.0]) - view.eye)
    half = np.array([0.5 * cell.length, cell.half_width])
    low = np.array([[*(middle[:2] - half), cell.eye[0] - view.eye[2]]])
    high = np.array([[*(middle[:2] + half), cell.eye[1] - view.eye[2]]])
    lows, highs = [low], [high]
    while (longest := (high - low)[0, :2]).max() > _SIDE:
        axis = int(np.argmax(longest))
        low, high = np.repeat(low, 2, axis=0), np.repeat(high, 2, axis=0)
        cut = 0.5 * (low[::2, axis] + high[::2, axis])
        high[::2, axis], low[1::2, axis] = cut, cut
        lows.append(low)
        highs.append(high)
    low, high = np.concatenate(lows), np.concatenate(highs)
    farthest = np.maximum(np.abs(low[0]), np.abs(high[0]))
    return Viewers(axes @ view.world_from_eye[:3, :3], low, high, float(np.linalg.norm(farthest)))


@kernel(error_model="numpy")
def surely_within(limit: float, one: float, other: float, reach: float) -> bool:
    """Whether no viewer sees two points of a ray, of these 1/z, farther apart than the chord ``limit``, by a cheap test.

    The sine is at most reach |P - Q| / ((|P| - reach) (|Q| - reach)), and that is largest straight ahead, where |P| = z.
    """
    closest = 1.0 - reach * max(one, other)
    if closest <= 0.0:
        return one == other
    sine = reach * abs(one - other) / (closest * closest)
    return sine < 0.5 and sine * (1.0 + sine * sine) <= limit  # 2 sin(a / 2) <= sin a (1 + sin^2 a) below 30 degrees


@kernel(error_model="numpy")
def parted_at_most(
    ux: float, uy: float, one: float, other: float, blur: float, viewers: Viewers, enough: float
) -> float:
    """The chord between the directions to two points of a ray that no viewer sees exceeded.

    The ray is (``ux``, ``uy``, -1) in the capture's eye space, or any whose first two numbers differ from these by no more
    than ``blur`` (as a vector); the points have 1/z ``one`` and ``other``. Less effort is made where it is at most ``enough``.
    """
    if one == other:
        return 0.0
    near, far = 1.0 / max(one, other), 1.0 / min(one, other)
    turn = viewers.turn
    dx = turn[0, 0] * ux + turn[0, 1] * uy - turn[0, 2]
    dy = turn[1, 0] * ux + turn[1, 1] * uy - turn[1, 2]
    dz = turn[2, 0] * ux + turn[2, 1] * uy - turn[2, 2]
    # Depth first through the boxes; of what cannot exceed what is known, or enough, no parts are looked at.
    boxes, most, box = len(viewers.low), 0.0, 0
    while True:
        chord = _from_box(dx, dy, dz, near, far, blur, viewers, box)
        if chord > max(most, enough) and 2 * box + 1 < boxes:
            box = 2 * box + 1
            continue
        most = max(most, chord)
        while box > 0 and box % 2 == 0:
            box = (box - 1) // 2
        if box == 0:
            return most
        box += 1


@kernel(error_model="numpy")
def _from_box(
    dx: float, dy: float, dz: float, near: float, far: float, blur: float, viewers: Viewers, box: int
) -> float:
    """:func:`parted_at_most` for the viewers of one box; the ray in the cell's axes."""
    low, high = viewers.low[box], viewers.high[box]
    least_near, least_far = _away(dx, dy, dz, near, low, high), _away(dx, dy, dz, far, low, high)
    least_near, least_far = least_near - near * blur, least_far - far * blur
    length = (far - near) * math.sqrt(dx * dx + dy * dy + dz * dz)
    if least_near <= 0.0 or least_far <= 0.0:
        return _OPPOSITE
    if least_near <= length and _away(dx, dy, dz, 0.5 * (near + far), low, high) - far * blur < 0.5 * length:
        return _OPPOSITE  # a right angle and more, maybe: a viewer in the sphere around both
    aside, reach = 0.0, 0.0
    for k in range(8):
        x = high[0] if k & 1 else low[0]
        y = high[1] if k & 2 else low[1]
        z = high[2] if k & 4 else low[2]
        cx, cy, cz = y * dz - z * dy, z * dx - x * dz, x * dy - y * dx
        aside = max(aside, cx * cx + cy * cy + cz * cz)
        reach = max(reach, x * x + y * y + z * z)
    sine = (far - near) * (math.sqrt(aside) + math.sqrt(reach) * blur) / (least_near * least_far)
    return math.sqrt(2.0 * (1.0 - math.sqrt(1.0 - sine * sine))) if sine < 1.0 else _OPPOSITE


@kernel(error_model="numpy")
def _away(dx: float, dy: float, dz: float, z: float, low: NDArray[np.float64], high: NDArray[np.float64]) -> float:
    """Metres from the point at depth ``z`` of a ray to the nearest of a box."""
    x = max(low[0] - z * dx, 0.0, z * dx - high[0])
    y = max(low[1] - z * dy, 0.0, z * dy - high[1])
    h = max(low[2] - z * dz, 0.0, z * dz - high[2])
    return math.sqrt(x * x + y * y + h * h)
