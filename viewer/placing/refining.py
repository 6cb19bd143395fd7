"""Choosing the grid's points: cubes of viewers' places are made smaller until images can be placed from all their points.

A cube at level n is served by the points of a lattice (viewer.placing.coverage) whose triangles have the edge
``spacing * 2 ** (-n / 3)``; it is halved at every third level. It *holds* if from each of its points, in every yaw in which the
point has some of the cube in its pyramid, at most ``target`` triangles are in cells in view that the sphere of the lattice's
reach around the point meets: no viewer whom the point serves is beyond that sphere, so that all other cells may become an
image (section 5's rule, with a proven radius instead of the star-shape's). A cube that does not hold goes a level down.
Whether it does depends on nothing but the cube, so that the grid is the same in whatever order cubes are looked at.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.city.ranges import numbers_in
from mmi.foundation.errors import ParameterError
from mmi.foundation.kernels import kernel
from viewer.placing.coverage import Lattice, lattice_for, reach
from viewer.placing.directions import TURN, write_arcs
from viewer.placing.model_cells import ModelCells
from viewer.placing.rules import Fov, PlacingRules
from viewer.placing.solution_grid import DEEPEST, SolutionGrid, codes_of, cube_boxes

__all__ = ["solution_grid"]

_FIRST_SPACING = 0.5
"""Of the edge of the root."""
_STEPS = 3
"""Levels of the lattice from one halving of the cubes to the next."""
_MOST_POINTS = 200_000
_AT_ONCE = 1024
"""Cubes."""


class _Leaves(NamedTuple):
    """Cubes (c, 3) of a level that hold, and the ``numbers`` (p, 3) of the points that serve the cubes ``owners`` (p,)."""

    level: int
    spacing: float
    reach: float
    cubes: NDArray[np.int64]
    owners: NDArray[np.int64]
    numbers: NDArray[np.int64]


def solution_grid(cells: ModelCells, rules: PlacingRules, domain: NDArray[np.float64]) -> SolutionGrid:
    """The grid for viewers in ``domain`` (2, 3), metres.

    Raises ParameterError where cubes would be smaller than a 4096th of the domain, or points more than 200,000: it says where
    there are how many triangles within what distance.
    """
    domain = np.array(domain, dtype=np.float64)
    if domain.shape != (2, 3) or not np.isfinite(domain).all() or not (domain[0] < domain[1]).any():
        raise ParameterError(f"the domain of viewers: a finite box expected, found {domain.tolist()}")
    edge, middle, fov = float(np.ptp(domain, axis=0).max()), domain.mean(axis=0), rules.pyramid
    lattice = lattice_for(fov)
    cubes = np.zeros((1, 3), dtype=np.int64)
    found: list[_Leaves] = []
    level = total = 0
    while len(cubes):
        spacing = _FIRST_SPACING * edge * 2.0 ** (-level / _STEPS)
        radius = spacing * reach(lattice, fov, height=0.5 * float(np.ptp(domain[:, 2])) / spacing)
        boxes = cube_boxes(cubes, np.full(len(cubes), level // _STEPS), domain)
        owners, numbers = _serving(lattice, boxes, spacing, radius, middle, fov)
        order, starts = _grouped(numbers)
        points = middle + spacing * lattice.places(numbers[order[starts[:-1]]])
        bad = np.zeros(len(cubes), dtype=np.bool_)
        _judge(
            points,
            starts,
            owners[order],
            boxes,
            radius,
            cells.boxes,
            cells.counts,
            fov.across,
            fov.up,
            rules.target,
            bad,
        )
        kept, renumbered = ~bad[owners], np.cumsum(~bad) - 1
        found.append(_Leaves(level, spacing, radius, cubes[~bad], renumbered[owners[kept]], numbers[kept]))
        total += len(_grouped(numbers[kept])[1]) - 1
        cubes, level = cubes[bad], level + 1
        if len(cubes) and (total > _MOST_POINTS or level == _STEPS * (DEEPEST + 1)):
            raise ParameterError(_too_many(boxes[bad][0], radius, cells, rules, total))
        if level % _STEPS == 0:
            cubes = (2 * cubes[:, None] + _CORNERS).reshape(-1, 3)
            low = domain[0] + cubes * (edge * 0.5 ** (level // _STEPS))
            cubes = cubes[(low <= domain[1] + 1e-9 * edge).all(axis=1)]
    return _assembled(found, lattice, fov, domain)


_CORNERS = np.array([[n & 1, n >> 1 & 1, n >> 2] for n in range(8)])


def _too_many(box: NDArray[np.float64], radius: float, cells: ModelCells, rules: PlacingRules, total: int) -> str:
    """What to say of a cube that never holds."""
    apart = np.maximum(np.maximum(cells.boxes[:, 0] - box[1], box[0] - cells.boxes[:, 1]), 0.0)
    near = int(cells.counts[np.linalg.norm(apart, axis=1) <= radius].sum())
    return (
        f"target: more than {rules.target:,} triangles, or smaller cells, expected: {near:,} are within {radius:.3g} m of "
        f"{', '.join(f'{x:.1f}' for x in box.mean(axis=0))}, and the grid has {total:,} points already"
    )


def _assembled(found: list[_Leaves], lattice: Lattice, fov: Fov, domain: NDArray[np.float64]) -> SolutionGrid:
    """The grid of all levels: leaves by their codes, points by level and number."""
    middle = domain.mean(axis=0)
    places, codes, owners, served = [], [], [], []
    leaves = total = 0
    for one in found:
        order, starts = _grouped(one.numbers)
        index = np.empty(len(order), dtype=np.int64)
        index[order] = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
        places.append(middle + one.spacing * lattice.places(one.numbers[order[starts[:-1]]]))
        codes.append(codes_of(one.cubes << (DEEPEST - one.level // _STEPS)))
        owners.append(one.owners + leaves)
        served.append(index + total)
        leaves, total = leaves + len(one.cubes), total + len(starts) - 1
    sizes = [len(one.cubes) for one in found]
    code = np.concatenate(codes)
    sort = np.argsort(code)
    rank = np.empty_like(sort)
    rank[sort] = np.arange(len(sort))
    owner, point = rank[np.concatenate(owners)], np.concatenate(served)
    pairs = np.lexsort((point, owner))
    return SolutionGrid(
        fov=fov,
        domain=domain,
        points=np.concatenate(places),
        codes=code[sort],
        depths=np.repeat([one.level // _STEPS for one in found], sizes)[sort],
        reaches=np.repeat([one.reach for one in found], sizes)[sort],
        leaf_starts=np.searchsorted(owner[pairs], np.arange(len(sort) + 1)),
        leaf_points=point[pairs].astype(np.int32),
    )


def _grouped(numbers: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The order (p,) that brings equal rows of ``numbers`` (p, 3) together, and where each group begins in it, and p."""
    order = np.lexsort(numbers.T)
    changed = (np.diff(numbers[order], axis=0, prepend=numbers[order[:1]] - 1) != 0).any(axis=1)
    return order, np.append(np.flatnonzero(changed), len(order))


def _serving(
    lattice: Lattice, boxes: NDArray[np.float64], spacing: float, radius: float, middle: NDArray[np.float64], fov: Fov
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The numbers (p, 3) of points that can have some of the boxes (c, 2, 3) in view within ``radius``, and of which (p,)."""
    scaled, grown = (boxes - middle) / spacing, radius / spacing * (1.0 + 1e-9)
    steep = grown * fov.up / math.hypot(1.0, fov.up)  # as high above a point as a viewer can be
    owners, numbers = [], []
    margin = np.array([grown, grown, steep])
    for first in range(0, len(boxes), _AT_ONCE):
        some = scaled[first : first + _AT_ONCE]
        low, high = lattice.spans(some[:, 0] - margin, some[:, 1] + margin)
        counts = (high - low).prod(axis=1)
        owner = np.repeat(np.arange(len(some)), counts)
        rank = numbers_in(np.zeros_like(counts), counts)
        sizes = (high - low)[owner]
        each = low[owner] + np.stack(
            [rank % sizes[:, 0], rank // sizes[:, 0] % sizes[:, 1], rank // (sizes[:, 0] * sizes[:, 1])], axis=1
        )
        places, box = lattice.places(each), some[owner]
        apart = np.maximum(np.maximum(box[:, 0] - places, places - box[:, 1]), 0.0)
        farthest = np.maximum(np.abs(box[:, 0] - places), np.abs(box[:, 1] - places))
        flat = np.minimum(np.hypot(farthest[:, 0], farthest[:, 1]), grown)
        kept = ((apart**2).sum(axis=1) <= grown * grown) & (apart[:, 2] <= np.minimum(steep, fov.up * flat + 1e-9))
        owners.append(owner[kept] + first)
        numbers.append(each[kept])
    return np.concatenate(owners), np.concatenate(numbers)


@kernel(error_model="numpy", nogil=True)
def _judge(
    points: NDArray[np.float64],
    starts: NDArray[np.int64],
    owners: NDArray[np.int64],
    cubes: NDArray[np.float64],
    radius: float,
    boxes: NDArray[np.float64],
    counts: NDArray[np.int64],
    across: float,
    up: float,
    target: int,
    bad: NDArray[np.bool_],
) -> None:
    """Mark which of the ``cubes`` (c, 2, 3) do not hold; point k serves the cubes ``owners[starts[k] : starts[k + 1]]``.

    ``boxes`` (n, 2, 3) and ``counts`` (n,) are the model's cells.
    """
    near, arc = np.empty(len(boxes), dtype=np.int64), np.empty((1, 2))
    for k in range(len(points)):
        asked = False
        for pair in range(starts[k], starts[k + 1]):
            asked |= not bad[owners[pair]]
        if not asked:
            continue
        found, sum_ = 0, 0
        for n in range(len(boxes)):
            square = 0.0
            for axis in range(3):
                apart = max(boxes[n, 0, axis] - points[k, axis], points[k, axis] - boxes[n, 1, axis], 0.0)
                square += apart * apart
            if math.sqrt(square) <= radius:  # as distances_to rounds
                near[found] = n
                found += 1
                sum_ += counts[n]
        if sum_ <= target:
            continue
        ranges = _full_ranges(boxes, counts, near[:found], points[k], across, up, target)
        if len(ranges) == 0:
            continue
        for pair in range(starts[k], starts[k + 1]):
            cube = owners[pair]
            if not bad[cube]:
                write_arcs(cubes, owners[pair : pair + 1], points[k], across, up, arc)
                bad[cube] = _meets(arc[0], ranges)


@kernel(error_model="numpy", nogil=True)
def _full_ranges(
    boxes: NDArray[np.float64],
    counts: NDArray[np.int64],
    some: NDArray[np.int64],
    point: NDArray[np.float64],
    across: float,
    up: float,
    target: int,
) -> NDArray[np.float64]:
    """(r, 2) ranges of yaw, first and last, in which more than ``target`` triangles of ``some`` cells (k,) are in view."""
    arcs = np.empty((len(some), 2))
    write_arcs(boxes, some, point, across, up, arcs)
    yaws, steps = np.empty(2 * len(some)), np.empty(2 * len(some), dtype=np.int64)
    seen = 0
    for n in range(len(some)):
        count = counts[some[n]]
        yaws[2 * n], yaws[2 * n + 1] = arcs[n]
        steps[2 * n], steps[2 * n + 1] = count, -count
        if arcs[n, 0] > arcs[n, 1]:
            seen += count
    order = np.argsort(yaws)
    ranges, found = np.empty((len(order) + 1, 2)), 0
    last = 0.0
    for n in range(len(order) + 1):
        yaw = yaws[order[n]] if n < len(order) else TURN
        if yaw > last and seen > target:
            ranges[found, 0], ranges[found, 1] = last, yaw
            found += 1
        last = yaw
        if n < len(order):
            seen += steps[order[n]]
    return ranges[:found]


@kernel(nogil=True)
def _meets(arc: NDArray[np.float64], ranges: NDArray[np.float64]) -> bool:
    """Whether an arc (2,), which may go on over 0, has yaws in common with some of the ranges (r, 2)."""
    for n in range(len(ranges)):
        if arc[0] <= arc[1]:
            if ranges[n, 0] < arc[1] and ranges[n, 1] > arc[0]:
                return True
        elif ranges[n, 0] < arc[1] or ranges[n, 1] > arc[0]:
            return True
    return False
