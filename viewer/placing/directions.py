"""What a view shows of boxes, and the yaws in which a point sees them: the view-directions set of section 3.3.1.

A level pyramid of view F(yaw) is bounded by four planes through the eye, and has nothing behind. A box is *seen* unless it lies
wholly beyond one of the four or behind the eye. Each of these half-spaces moves forward with an eye that moves within the
pyramid, so that an eye in g + F(yaw) sees no box that g does not see with the same yaw (section 3.1, enclosed view frusta).

Yaws are radians counter-clockwise from +X. The yaws in which a point sees a box are one arc: [lowest bearing - a, highest
bearing + a] for the sides, where a is half the angle across; a corner column of the box that is h above the eye and r away is
below the upper plane within acos(h / (r up)) of its bearing. The arc is the hull of what passes, and so never too small.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.kernels import kernel
from viewer.placing.rules import Fov

__all__ = ["TURN", "Ranges", "arc_holds", "arcs_of", "distances_to", "ranges_of", "seen_from", "sees", "write_arcs"]

TURN = 2.0 * math.pi
_HAIR = 1e-9
"""Radians that arcs are wider than computed at both ends, and the part of a box by which it is larger."""


def seen_from(boxes: NDArray[np.float64], eye: NDArray[np.float64], yaw: float, fov: Fov) -> NDArray[np.bool_]:
    """(n,) which of ``boxes`` (n, 2, 3) a level view of ``fov`` from ``eye`` (3,) towards ``yaw`` shows, as said above."""
    seen = np.empty(len(boxes), dtype=np.bool_)
    _write_seen(boxes, np.asarray(eye, dtype=np.float64), math.cos(yaw), math.sin(yaw), fov.across, fov.up, seen)
    return seen


def arcs_of(boxes: NDArray[np.float64], eye: NDArray[np.float64], fov: Fov) -> NDArray[np.float64]:
    """(n, 2) the yaws in which ``eye`` (3,) sees each of ``boxes`` (n, 2, 3): from the first on to before the second.

    Both are from 0 to a turn; an arc whose first is greater goes on over 0. One that is never seen has two zeros.
    """
    arcs = np.empty((len(boxes), 2))
    write_arcs(boxes, np.arange(len(boxes)), np.asarray(eye, dtype=np.float64), fov.across, fov.up, arcs)
    return arcs


def arc_holds(arcs: NDArray[np.float64], yaw: float) -> NDArray[np.bool_]:
    """(n,) whether arcs (n, 2) hold ``yaw`` (any)."""
    yaw = yaw % TURN
    first, last = arcs[:, 0], arcs[:, 1]
    return np.asarray(np.where(first <= last, (first <= yaw) & (yaw < last), (first <= yaw) | (yaw < last)))


def distances_to(boxes: NDArray[np.float64], point: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) metres from ``point`` (3,) to the nearest of each of ``boxes`` (n, 2, 3); 0 within."""
    apart = np.maximum(np.maximum(boxes[:, 0] - point, point - boxes[:, 1]), 0.0)
    return np.asarray(np.sqrt((apart**2).sum(axis=1)))


@dataclass(frozen=True, slots=True, eq=False)
class Ranges:
    """The directions around a point, cut where what it sees changes: range i is from ``borders[i]`` (r,), radians, to before
    the next, the last to a full turn; the first border is 0. Thing k is seen from range ``spans[k, 0]`` to before
    ``spans[k, 1]``, over the last range and on from the first where the former is greater.
    """

    borders: NDArray[np.float64]
    spans: NDArray[np.int64]

    @property
    def middles(self) -> NDArray[np.float64]:
        """(r,) the yaw in the middle of each range."""
        return np.asarray(0.5 * (self.borders + np.append(self.borders[1:], TURN)))

    def at(self, yaw: float) -> int:
        """The range of a yaw."""
        return int(np.searchsorted(self.borders, yaw % TURN, side="right")) - 1

    def totals(self, weights: NDArray[np.int64], some: NDArray[np.integer] | None = None) -> NDArray[np.int64]:
        """(r,) the sum of the ``weights`` of all things, or of ``some`` (k,) with a weight each, that a range sees."""
        spans = self.spans if some is None else self.spans[some]
        steps = np.zeros(len(self.borders) + 1, dtype=np.int64)
        np.add.at(steps, spans[:, 0], weights)
        np.add.at(steps, spans[:, 1], -weights)
        steps[0] += weights[spans[:, 0] > spans[:, 1]].sum()
        return np.cumsum(steps[:-1])

    def seen_in(self, index: int) -> NDArray[np.int64]:
        """(k,) the things that range ``index`` sees, ascending."""
        first, last = self.spans.T
        return np.flatnonzero(
            np.where(first <= last, (first <= index) & (index < last), (first <= index) | (index < last))
        )

    def seen_near(self, index: int, turn: float) -> NDArray[np.int64]:
        """(k,) the things seen in some range from ``turn`` radians before the middle of range ``index`` to as much after it."""
        lowest, highest = self.at(self.middles[index] - turn), self.at(self.middles[index] + turn)
        number = len(self.borders)
        first, last = self.spans.T
        lengths = np.where(first <= last, last - first, last - first + number)
        begins = (first - lowest) % number <= (highest - lowest) % number
        return np.flatnonzero((lengths > 0) & (begins | ((lowest - first) % number < lengths)))


def ranges_of(arcs: NDArray[np.float64], borders: NDArray[np.float64]) -> Ranges:
    """The ranges between the ends of ``arcs`` (n, 2), cut at further ``borders`` (k,) too, radians from 0 to a turn."""
    ends = np.concatenate([np.zeros(1), arcs.ravel(), borders])
    all_borders = np.unique(ends[ends < TURN])
    return Ranges(all_borders, np.searchsorted(all_borders, arcs))


@kernel(error_model="numpy", nogil=True)
def write_arcs(
    boxes: NDArray[np.float64],
    some: NDArray[np.int64],
    eye: NDArray[np.float64],
    across: float,
    up: float,
    arcs: NDArray[np.float64],
) -> None:
    """Write the arcs (k, 2) of ``some`` (k,) of the boxes (n, 2, 3)."""
    half = math.atan(across)
    for k in range(len(some)):
        box = boxes[some[k]]
        hair = _HAIR * (1.0 + abs(eye[0]) + abs(eye[1]) + abs(eye[2]))
        x0, x1 = box[0, 0] - eye[0] - hair, box[1, 0] - eye[0] + hair
        y0, y1 = box[0, 1] - eye[1] - hair, box[1, 1] - eye[1] + hair
        height = max(box[0, 2] - eye[2], eye[2] - box[1, 2]) - hair
        arcs[k, 0], arcs[k, 1] = 0.0, TURN
        if x0 <= 0.0 <= x1 and y0 <= 0.0 <= y1:
            farthest = math.sqrt(max(x0 * x0, x1 * x1) + max(y0 * y0, y1 * y1))
            if height > up * farthest:
                arcs[k, 1] = 0.0
            continue
        middle_x, middle_y = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
        middle = math.atan2(middle_y, middle_x)
        lowest, highest, first, last = 4.0, -4.0, 4.0, -4.0
        for corner in range(4):
            x, y = x1 if corner & 1 else x0, y1 if corner & 2 else y0
            bearing = math.atan2(middle_x * y - middle_y * x, middle_x * x + middle_y * y)
            lowest, highest = min(lowest, bearing), max(highest, bearing)
            slope = height / (up * math.sqrt(x * x + y * y))
            if slope <= 1.0:
                beside = math.acos(max(slope, 0.0))
                first, last = min(first, bearing - beside), max(last, bearing + beside)
        # A box that is wide of 90 degrees and half the view is beyond no side of views that face away: it is not behind there.
        if highest - lowest < 0.5 * math.pi + half:
            first, last = max(first, lowest - half), min(last, highest + half)
        first, last = first - _HAIR, last + _HAIR
        if first >= last:
            arcs[k, 1] = 0.0
        elif last - first < TURN:
            arcs[k, 0], arcs[k, 1] = (middle + first) % TURN, (middle + last) % TURN


@kernel(error_model="numpy", nogil=True)
def _write_seen(
    boxes: NDArray[np.float64],
    eye: NDArray[np.float64],
    cos: float,
    sin: float,
    across: float,
    up: float,
    seen: NDArray[np.bool_],
) -> None:
    """Write which boxes (n, 2, 3) are seen."""
    for n in range(len(boxes)):
        seen[n] = sees(boxes[n], eye, cos, sin, across, up)


@kernel(error_model="numpy", nogil=True)
def sees(box: NDArray[np.float64], eye: NDArray[np.float64], cos: float, sin: float, across: float, up: float) -> bool:
    """Whether a level view from ``eye`` (3,) shows a ``box`` (2, 3); ``cos`` and ``sin`` are those of its yaw."""
    ahead, left, right = (
        0.0,
        0.0,
        0.0,
    )  # the most of a box ahead of the eye, and right of the left side, left of the right
    for axis in range(2):
        low, high = box[0, axis] - eye[axis], box[1, axis] - eye[axis]
        along, aside = (cos, sin) if axis == 0 else (sin, -cos)
        ahead += max(along * low, along * high)
        left += max((across * along + aside) * low, (across * along + aside) * high)
        right += max((across * along - aside) * low, (across * along - aside) * high)
    return bool(
        ahead >= 0.0
        and left >= 0.0
        and right >= 0.0
        and box[0, 2] - eye[2] <= up * ahead
        and eye[2] - box[1, 2] <= up * ahead
    )
