"""All directions from all points of a grid, put to the test: how many triangles the views there draw.

No view of a viewer shows a cell that his point does not show in the same direction, so that the guarantee (section 3.1) is a
statement on points and directions alone, and can be checked to the end. Placing counts by arcs of yaw that it has computed for
cells. Here nothing of that is used, only the test that views are culled by (:func:`viewer.placing.directions.sees`): what it
says of a box changes only where one of the box's four columns of corners passes one of the view's planes. These yaws are solved
for, and between each two of them the test is asked once. So all yaws are judged, and not a sample of them.

Boxes are made larger by half of what placing makes them larger by, which is more than a viewer may be out of his point's
pyramid and than what numbers are rounded by; a cell counts where it begins and where it ends.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.kernels import kernel
from mmi.foundation.progress import Progress, silent
from viewer.placing.directions import TURN, sees
from viewer.placing.model_cells import ModelCells
from viewer.placing.placements import Placements
from viewer.placing.rules import PlacingRules
from viewer.placing.solution_grid import SolutionGrid

__all__ = ["GridChecked", "check_grid"]

_HAIR = 5e-10
"""Metres, for each metre of coordinates, that boxes are made larger by on all sides."""
_COLUMN = 8
"""Yaws in which a column of corners passes a plane."""


@dataclass(frozen=True, slots=True)
class GridChecked:
    """What views from all ``points`` draw: ``most`` triangles in any of the ``ranges`` of yaw between which that changes.

    ``over`` of these draw more than the ``budget``. Yaws in which a point serves no viewer are not looked at.
    """

    points: int
    ranges: int
    most: int
    over: int
    budget: int

    @property
    def kept(self) -> bool:
        """Whether the budget is kept in all directions."""
        return self.over == 0


def check_grid(
    cells: ModelCells,
    grid: SolutionGrid,
    placements: Sequence[Placements],
    rules: PlacingRules,
    progress: Progress = silent,
) -> GridChecked:
    """Count the triangles in cells in view from all points, without those that the image for a direction replaces, and those
    hidden from all whom the point serves: that they are is taken as given.
    """
    fov, counts = rules.pyramid, cells.counts
    leaf_boxes, order = grid.leaf_boxes, np.argsort(grid.leaf_points, kind="stable")
    leaves = np.repeat(np.arange(len(grid.codes)), np.diff(grid.leaf_starts))[order]
    starts = np.searchsorted(grid.leaf_points[order], np.arange(len(grid.points) + 1))
    ranges = most = over = 0
    for n, (first, end) in enumerate(pairwise(starts.tolist())):
        one = placements[n]
        removed = np.tile(one.hides(len(counts)), (len(one.images) + 1, 1))  # the last: no image
        for k, image in enumerate(one.images):
            removed[k, image.cells] = True
        found = _count(
            np.concatenate([cells.boxes, leaf_boxes[leaves[first:end]]]),
            counts,
            grid.points[n],
            fov.across,
            fov.up,
            one.borders,
            one.serving,
            removed,
            rules.budget,
        )
        ranges, most, over = ranges + found[0], max(most, found[1]), over + found[2]
        progress(n + 1, len(grid.points), "points")
    return GridChecked(len(grid.points), ranges, most, over, rules.budget)


@kernel(error_model="numpy", nogil=True)
def _count(
    boxes: NDArray[np.float64],
    counts: NDArray[np.int64],
    eye: NDArray[np.float64],
    across: float,
    up: float,
    borders: NDArray[np.float64],
    serving: NDArray[np.int32],
    removed: NDArray[np.bool_],
    budget: int,
) -> tuple[int, int, int]:
    """How many ranges of yaw there are from ``eye`` (3,) that viewers need, the most that one of them draws, how many draw
    more than the budget.

    The last of ``boxes`` (n, 2, 3), those without ``counts`` (m,), are where viewers are. Image k replaces the cells
    ``removed[k]`` (m,), and serves yaws from ``borders`` (b,) on as ``serving`` (b,) says.
    """
    opened, opening, closed, closing = _spans(boxes, eye, across, up)
    seen = np.zeros(len(counts), dtype=np.bool_)
    ranges, most, over = 0, 0, 0
    total, viewers, i, j, border = 0, 0, 0, 0, 0
    image, fresh, now = serving[0], False, 0.0
    while j < len(closed):
        begin = opened[i] if i < len(opened) else np.inf
        turn = borders[border + 1] if border + 1 < len(borders) else np.inf
        end = closed[j]
        # Of what is at the same yaw, cells that begin come first, and cells that end last: both count there.
        is_begin, is_turn = begin <= min(turn, end), turn <= end
        then = begin if is_begin else turn if is_turn else end
        if fresh and viewers > 0 and (then > now or not is_begin):
            ranges += 1
            most = max(most, total)
            over += total > budget
        fresh, now = True, then
        if is_begin:
            n, i = opening[i], i + 1
            if n >= len(counts):
                viewers += 1
            else:
                seen[n] = True
                total += 0 if removed[image, n] else counts[n]
        elif is_turn:
            border += 1
            image, total = serving[border], 0
            for n in range(len(counts)):
                if seen[n] and not removed[image, n]:
                    total += counts[n]
        else:
            n, j = closing[j], j + 1
            if n >= len(counts):
                viewers -= 1
            else:
                seen[n] = False
                total -= 0 if removed[image, n] else counts[n]
    return ranges, most, over


@kernel(error_model="numpy", nogil=True)
def _spans(
    boxes: NDArray[np.float64], eye: NDArray[np.float64], across: float, up: float
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
    """The yaws from which on ``boxes`` (n, 2, 3) are seen, ascending, of which box each is, and the same of those to which.

    All are from 0 to a turn; a box that is seen over 0 has two spans.
    """
    beside, hair = math.atan(across), _HAIR * (1.0 + abs(eye[0]) + abs(eye[1]) + abs(eye[2]))
    first, last = np.empty(4 * len(boxes)), np.empty(4 * len(boxes))
    owners, found = np.empty(4 * len(boxes), dtype=np.int64), 0
    box, yaws = np.empty((2, 3)), np.empty(4 * _COLUMN + 2)
    for n in range(len(boxes)):
        box[0], box[1] = boxes[n, 0] - hair, boxes[n, 1] + hair
        height = max(box[0, 2] - eye[2], eye[2] - box[1, 2])
        yaws[0], yaws[1], number = 0.0, TURN, 2
        for corner in range(4):
            x, y = box[corner & 1, 0] - eye[0], box[corner >> 1, 1] - eye[1]
            bearing, slope = math.atan2(y, x), height / (up * math.sqrt(x * x + y * y))
            for side in (-1.0, 1.0):
                yaws[number] = (bearing + side * 0.5 * math.pi) % TURN  # beside the eye
                yaws[number + 1] = (bearing + side * beside) % TURN  # on a side of the view, ahead and behind
                yaws[number + 2] = (bearing + side * beside + math.pi) % TURN
                number += 3
                if 0.0 < slope <= 1.0:
                    yaws[number] = (bearing + side * math.acos(slope)) % TURN  # on its lower or upper border
                    number += 1
        yaws[:number].sort()
        was = False
        for k in range(number - 1):
            middle = 0.5 * (yaws[k] + yaws[k + 1])
            is_seen = sees(box, eye, math.cos(middle), math.sin(middle), across, up)
            if is_seen and not was:
                if found == len(first):
                    first, last = np.append(first, first), np.append(last, last)
                    owners = np.append(owners, owners)
                first[found], owners[found] = yaws[k], n
                found += 1
            if is_seen:
                last[found - 1] = yaws[k + 1]
            was = is_seen
    begins, ends = np.argsort(first[:found]), np.argsort(last[:found])
    return first[begins], owners[begins], last[ends], owners[ends]
