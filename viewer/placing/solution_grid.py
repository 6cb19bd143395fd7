"""The grid of points for which images are placed, and which of them serves a viewer: section 3.2.

The domain, where viewers can be, is an octree of cubes. Each leaf has its own points, so that neighbours of different sizes
need no care (section 3.2.2): whoever is in the leaf has one of them in the reverse pyramid, within the leaf's reach.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.kernels import kernel
from viewer.placing.directions import TURN, arcs_of
from viewer.placing.model_cells import ModelCells
from viewer.placing.rules import Fov

__all__ = ["DEEPEST", "Needs", "SolutionGrid", "codes_of", "cube_boxes", "domain_of", "mask_of"]

DEEPEST = 12
"""How many times a cube is halved at most."""
_HAIR = 1e-10
"""Metres, for each metre of coordinates, that a viewer may be out of a pyramid: less than what arcs of yaw are wider by."""


@dataclass(frozen=True, slots=True, eq=False)
class Needs:
    """For what a point is needed: the farthest that viewers are whom it serves, ``radii`` (r,) metres, for yaws from each of
    ``borders`` (r,) on to before the next; 0 where there is none. The first border is 0.

    ``hidden`` are bits, eight in a byte, the highest first: those of the model's cells that none of these viewers can see, for
    what stands before them. There may be none.
    """

    borders: NDArray[np.float64]
    radii: NDArray[np.float64]
    hidden: NDArray[np.uint8] = field(default_factory=lambda: np.zeros(0, dtype=np.uint8))


@dataclass(frozen=True, slots=True, eq=False)
class SolutionGrid:
    """Points (n, 3), metres, and the leaves of the octree over ``domain`` (2, 3) that they serve.

    ``fov`` is the level pyramid that points were chosen for. Leaf i is the cube of code ``codes[i]`` (ascending Morton codes of
    the smallest cubes, the leaf's first one) and halved ``depths[i]`` times; its viewers have a point within ``reaches[i]``
    metres, one of ``leaf_points[leaf_starts[i] : leaf_starts[i + 1]]``.
    """

    fov: Fov
    domain: NDArray[np.float64]
    points: NDArray[np.float64]
    codes: NDArray[np.int64]
    depths: NDArray[np.int64]
    reaches: NDArray[np.float64]
    leaf_starts: NDArray[np.int64]
    leaf_points: NDArray[np.int32]

    def __post_init__(self) -> None:
        for name in self.__slots__[1:]:
            getattr(self, name).setflags(write=False)

    @property
    def edge(self) -> float:
        """Of the root cube, whose lowest corner is the domain's."""
        return float(np.ptp(self.domain, axis=0).max())

    @property
    def radii(self) -> NDArray[np.float64]:
        """(n,) how far a viewer can be from each point that it serves."""
        radii = np.zeros(len(self.points))
        np.maximum.at(radii, self.leaf_points, np.repeat(self.reaches, np.diff(self.leaf_starts)))
        return radii

    @property
    def leaf_boxes(self) -> NDArray[np.float64]:
        """(m, 2, 3) the parts of the domain that the leaves are."""
        return cube_boxes(_steps(self.codes) >> (DEEPEST - self.depths)[:, None], self.depths, self.domain)

    def leaf_of(self, eye: NDArray[np.float64]) -> int:
        """The leaf that a viewer at ``eye`` (3,) is in, -1 outside of the domain."""
        if not ((eye >= self.domain[0]) & (eye <= self.domain[1])).all():
            return -1
        steps = ((eye - self.domain[0]) * ((1 << DEEPEST) / self.edge)).astype(np.int64)
        code = codes_of(np.minimum(steps, (1 << DEEPEST) - 1)[None])[0]
        return int(np.searchsorted(self.codes, code, side="right")) - 1

    def closest(self, eye: NDArray[np.float64], yaw: float) -> int:
        """The point that serves a viewer at ``eye`` (3,) who looks towards ``yaw``: the nearest of the leaf's in the reverse
        pyramid; -1 outside of the domain.
        """
        eye = np.asarray(eye, dtype=np.float64)
        leaf = self.leaf_of(eye)
        if leaf < 0:
            return -1
        some = self.leaf_points[self.leaf_starts[leaf] : self.leaf_starts[leaf + 1]]
        return int(_nearest(self.points, some, eye, yaw, self.fov.across, self.fov.up, float(self.reaches[leaf])))

    def needs(self) -> tuple[Needs, ...]:
        """What each point is needed for."""
        boxes, order = self.leaf_boxes, np.argsort(self.leaf_points, kind="stable")
        leaves = np.repeat(np.arange(len(self.codes)), np.diff(self.leaf_starts))[order]
        starts = np.searchsorted(self.leaf_points[order], np.arange(len(self.points) + 1))
        return tuple(
            _needs(self.points[n], boxes[leaves[first:end]], self.reaches[leaves[first:end]], self.fov)
            for n, (first, end) in enumerate(pairwise(starts.tolist()))
        )


def _needs(point: NDArray[np.float64], boxes: NDArray[np.float64], reaches: NDArray[np.float64], fov: Fov) -> Needs:
    """What a point is needed for that serves leaves with ``boxes`` (k, 2, 3)."""
    arcs = arcs_of(boxes, point, fov)
    ends = np.append(arcs.ravel(), 0.0)
    borders = np.unique(ends[ends < TURN])
    middles = 0.5 * (borders + np.append(borders[1:], TURN))[:, None]
    first, last = arcs.T
    inside = np.where(first <= last, (first <= middles) & (middles < last), (first <= middles) | (middles < last))
    radii = np.where(inside, reaches, 0.0).max(axis=1)
    kept = np.flatnonzero(np.diff(radii, prepend=-1.0))
    return Needs(borders[kept], radii[kept])


def mask_of(bits: NDArray[np.uint8], number: int) -> NDArray[np.bool_]:
    """(number,) what ``bits`` say of each of so many things, as :class:`Needs` has them: where they end, no."""
    found = np.zeros(number, dtype=np.bool_)
    said = np.unpackbits(bits)[:number]
    found[: len(said)] = said
    return found


def domain_of(cells: ModelCells) -> NDArray[np.float64]:
    """(2, 3) where viewers can be: the model's bounds, by a tenth of their longest side larger on all sides."""
    bounds = cells.bounds
    grown = 0.1 * float(np.ptp(bounds, axis=0).max())
    return np.asarray(bounds + np.array([[-grown], [grown]]))


def cube_boxes(cubes: NDArray[np.int64], depths: NDArray[np.int64], domain: NDArray[np.float64]) -> NDArray[np.float64]:
    """(c, 2, 3) the parts in ``domain`` (2, 3) of cubes (c, 3), counted from its lowest corner, that are halved ``depths`` (c,)
    times.
    """
    edges = (float(np.ptp(domain, axis=0).max()) * 0.5**depths)[:, None]
    low = domain[0] + cubes * edges
    return np.stack([np.minimum(low, domain[1]), np.minimum(low + edges, domain[1])], axis=1)


@kernel(nogil=True)
def codes_of(steps: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) Morton codes of (n, 3) smallest cubes."""
    codes = np.zeros(len(steps), dtype=np.int64)
    for n in range(len(steps)):
        for bit in range(DEEPEST):
            for axis in range(3):
                codes[n] |= (steps[n, axis] >> bit & 1) << (3 * bit + axis)
    return codes


def _steps(codes: NDArray[np.int64]) -> NDArray[np.int64]:
    """The inverse of :func:`codes_of`."""
    steps = np.zeros((len(codes), 3), dtype=np.int64)
    for bit in range(DEEPEST):
        for axis in range(3):
            steps[:, axis] |= (codes >> (3 * bit + axis) & 1) << bit
    return steps


@kernel(error_model="numpy", nogil=True)
def _nearest(
    points: NDArray[np.float64],
    some: NDArray[np.int32],
    eye: NDArray[np.float64],
    yaw: float,
    across: float,
    up: float,
    farthest: float,
) -> int:
    """Which of ``some`` points (k,) is the nearest in the reverse pyramid and no farther than ``farthest``; -1: none."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    nearest, found = (farthest * (1.0 + 1e-9)) ** 2, -1
    for n in some:
        x, y, z = eye[0] - points[n, 0], eye[1] - points[n, 1], eye[2] - points[n, 2]
        square = x * x + y * y + z * z
        if square <= nearest and (found < 0 or square < nearest):
            ahead = cos * x + sin * y
            hair = _HAIR * (1.0 + abs(points[n, 0]) + abs(points[n, 1]) + abs(points[n, 2]))
            if abs(z) <= up * ahead + hair and abs(cos * y - sin * x) <= across * ahead + hair:
                nearest, found = square, n
    return found
