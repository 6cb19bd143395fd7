"""How far a viewer may be from the lattice point that serves it: what the grid's guarantee stands on.

Section 3.2 takes points of a cubic grid and its star-shapes, spheres of two grid widths around them. Here points are layers of
triangles, where every other layer is shifted so that its points are over the middles of triangles (hexagonal close packing),
stretched upwards as the view is: they leave the same gaps with a third less points. And the distance is not estimated but
proven: :func:`reach` halves boxes of (eye, yaw) until in each of them one point is in the reverse pyramid of all of the box.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.errors import ParameterError
from mmi.foundation.kernels import kernel
from viewer.placing.rules import Fov

__all__ = ["Lattice", "lattice_for", "reach"]

_ROW = 0.5 * math.sqrt(3.0)


@dataclass(frozen=True, slots=True)
class Lattice:
    """Points at (i + s, sqrt(3) / 2 j + t, layer k): rows of triangles of edge 1, layers ``layer`` apart.

    ``s`` is a half where j is odd, and where k is odd a half more; ``t`` is a third of a row's distance where k is odd.
    """

    layer: float

    def places(self, numbers: NDArray[np.integer]) -> NDArray[np.float64]:
        """(n, 3) where the points of ``numbers`` (n, 3), i, j and k, are."""
        i, j, k = numbers.T
        odd = k & 1
        return np.stack([i + 0.5 * (j & 1) + 0.5 * odd, _ROW * (j + odd / 3.0), self.layer * k], axis=1)

    def spans(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """First numbers (n, 3) and those after the last of the points in boxes between ``low`` and ``high`` (n, 3)."""
        steps = np.array([1.0, _ROW, self.layer])
        first, last = np.floor(low / steps), np.ceil(high / steps) + 1.0
        first[:, :2] -= 1.0
        return first.astype(np.int64), last.astype(np.int64)

    def within(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.int64]:
        """(n, 3) numbers of all points in a box between two corners (3,)."""
        (first,), (last,) = self.spans(low[None], high[None])
        ranges = [np.arange(a, b) for a, b in zip(first, last, strict=True)]
        numbers = np.stack(np.meshgrid(*ranges, indexing="ij"), axis=-1).reshape(-1, 3)
        places = self.places(numbers)
        return numbers[((places >= low) & (places <= high)).all(axis=1)]

    @property
    def period(self) -> NDArray[np.float64]:
        """(3,) A box at the origin that has in it an eye's place relative to the points: lower ones are mirrored."""
        return np.array([1.0, _ROW, self.layer])


def lattice_for(fov: Fov) -> Lattice:
    """A lattice whose layers are as far apart as suits the proportions of a view."""
    return Lattice(min(max(1.05 * fov.up / fov.across, 0.3), 2.0))


def reach(lattice: Lattice, fov: Fov, *, height: float = math.inf, precision: float = 0.02) -> float:
    """A distance within which every eye has, for every yaw, a lattice point in its reverse pyramid; unit: the triangles' edge.

    With ``height``, every eye that is at most so far above or below layer 0. The distance exceeds the smallest such by at most
    ``precision`` of it. Raises ParameterError where the view is so narrow that none can be told with some million boxes.
    """
    far = 3.0
    period = np.minimum(lattice.period, [math.inf, math.inf, height])
    while True:
        numbers = lattice.within(-far * np.ones(3), period + far)
        places = lattice.places(numbers)
        places = places[np.argsort(((places - 0.5 * period) ** 2).sum(axis=1), kind="stable")]
        found = float(_bound(places, period, fov.across, fov.up, far, precision))
        if found < math.inf:
            return found
        if far > 60.0:
            raise ParameterError(f"a view that a grid can serve: a wider one expected, found tangents {fov}")
        far *= 1.6


_MOST_BOXES = 300_000


@kernel(error_model="numpy", nogil=True)
def _bound(
    places: NDArray[np.float64], period: NDArray[np.float64], across: float, up: float, far: float, precision: float
) -> float:
    """The bound of :func:`reach`, infinite where it is farther than ``far``, up to which the ``places`` (m, 3) are complete.

    A third of a turn has all yaws, as the lattice has that symmetry around each of its points.
    """
    cuts = (4, 4, 4, 16)
    sizes = (period[0], period[1], period[2], 2.0 * math.pi / 3.0)
    boxes = np.empty((_MOST_BOXES, 8))
    count, worst = 0, 0.0  # a distance that is needed
    open_ = [(0.0, 0) for _ in range(0)]
    for n in range(cuts[0] * cuts[1] * cuts[2] * cuts[3]):
        rest = n
        for axis in range(4):
            boxes[count, 4 + axis] = 0.5 * sizes[axis] / cuts[axis]
            boxes[count, axis] = (2.0 * (rest % cuts[axis]) + 1.0) * boxes[count, 4 + axis]
            rest //= cuts[axis]
        worst = max(worst, _needed(places, boxes[count], across, up))
        heapq.heappush(open_, (-_enough(places, boxes[count], across, up), count))
        count += 1
    while True:
        loosest, n = heapq.heappop(open_)
        if worst > far or -loosest <= (1.0 + precision) * worst or count + 1 >= _MOST_BOXES:
            return -loosest if max(-loosest, worst) <= far else np.inf
        axis, widest = 0, 0.0
        for one in range(4):
            width = boxes[n, 4 + one] * (worst if one == 3 else 1.0)
            if width > widest:
                axis, widest = one, width
        boxes[count] = boxes[n]
        half = 0.5 * boxes[n, 4 + axis]
        for side, one in ((-1.0, n), (1.0, count)):
            boxes[one, axis] += side * half
            boxes[one, 4 + axis] = half
            worst = max(worst, _needed(places, boxes[one], across, up))
            heapq.heappush(open_, (-_enough(places, boxes[one], across, up), one))
        count += 1


@kernel(error_model="numpy", nogil=True)
def _needed(places: NDArray[np.float64], box: NDArray[np.float64], across: float, up: float) -> float:
    """How far the nearest point that serves the middle of a box (x, y, z, yaw and half its sizes) is from it."""
    cos, sin = math.cos(box[3]), math.sin(box[3])
    nearest = np.inf
    for k in range(len(places)):
        x, y, z = box[0] - places[k, 0], box[1] - places[k, 1], box[2] - places[k, 2]
        square = x * x + y * y + z * z
        if square < nearest:
            ahead = cos * x + sin * y
            if abs(z) <= up * ahead and abs(cos * y - sin * x) <= across * ahead:
                nearest = square
    return math.sqrt(nearest)


@kernel(error_model="numpy", nogil=True)
def _enough(places: NDArray[np.float64], box: NDArray[np.float64], across: float, up: float) -> float:
    """The distance from all of a box at most to a point that serves all of it: the nearest such, infinite without one."""
    cos, sin = np.array([math.cos(box[3] - box[7]), math.cos(box[3] + box[7])]), np.empty(2)
    sin[0], sin[1] = math.sin(box[3] - box[7]), math.sin(box[3] + box[7])
    flat = math.sqrt(box[4] * box[4] + box[5] * box[5])
    skew = flat * math.sqrt(1.0 + across * across)
    nearest = np.inf
    for k in range(len(places)):
        x, y, z = box[0] - places[k, 0], box[1] - places[k, 1], box[2] - places[k, 2]
        farthest = (abs(x) + box[4]) ** 2 + (abs(y) + box[5]) ** 2 + (abs(z) + box[6]) ** 2
        if farthest >= nearest:
            continue
        serves = True
        # The direction of a yaw between two others is a sum of theirs with weights that add up to 1 or more: what is linear
        # in it and nowhere negative at both ends is, in between, no less than the lesser of them. So it is for every eye.
        height = (abs(z) + box[6]) / up
        for end in range(2):
            ahead, aside = cos[end] * x + sin[end] * y, cos[end] * y - sin[end] * x
            rim = across * ahead - abs(aside)
            if ahead - flat < height or rim < skew:
                serves = False
                break
        if serves:
            nearest = farthest
    return math.sqrt(nearest)
