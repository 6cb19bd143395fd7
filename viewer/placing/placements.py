"""The images of a point: for every yaw that the point is needed for and that shows too much, one that replaces enough.

Section 3.3: the yaw that shows most is given the best subset of its cells (viewer.placing.subsets) for an image; the image
serves that yaw and all others that stay within the budget with it, and which its picture is wide enough for; then the yaw that
shows most of those left. Each yaw has one image at most. So that an image serves more yaws, it also has what views that are
turned a little see of cells behind the nearest of the subset, and between its lower and its upper border. Cells that a viewer
can be at, those that the sphere around the point meets within which it serves viewers, are never part of an image. Cells that
are hidden from all these viewers are not drawn for them, do not count, and are not part of images either.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.errors import ParameterError
from viewer.placing.directions import TURN, Ranges, arcs_of, distances_to, ranges_of
from viewer.placing.model_cells import ModelCells
from viewer.placing.rules import PlacingRules
from viewer.placing.solution_grid import Needs, mask_of
from viewer.placing.subsets import best_subset

__all__ = ["Placement", "Placements", "placements_at"]

_CUTS = np.radians(np.arange(0.0, 360.0, 5.0))
"""Ranges are no wider than this, half of which any picture reaches further than its view."""


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """An image: what a level picture from the point towards ``yaw`` shows of ``cells`` (k,), ascending, within ``window``.

    The window is (left, bottom, right, top) in tangents from the middle of the picture; it holds all that views served by the
    image can see of the cells. ``near`` is a depth, metres, before which there is nothing of them in the window, and
    ``distance`` that of the nearest of them.
    """

    yaw: float
    cells: NDArray[np.int32]
    window: tuple[float, float, float, float]
    near: float
    distance: float


@dataclass(frozen=True, slots=True, eq=False)
class Placements:
    """All images of a point: yaws from ``borders[i]`` on to before the next are served by image ``serving[i]``, -1 for none.

    The first border is 0. ``counts`` are the most triangles that a view there draws as such, in cells that it sees and the
    image does not replace, and 0 where the point is not needed. Of cells that are ``hidden``, bits as in
    :class:`viewer.placing.solution_grid.Needs`, it draws none.
    """

    images: tuple[Placement, ...]
    borders: NDArray[np.float64]
    serving: NDArray[np.int32]
    counts: NDArray[np.int64]
    hidden: NDArray[np.uint8] = field(default_factory=lambda: np.zeros(0, dtype=np.uint8))

    def hides(self, cells: int) -> NDArray[np.bool_]:
        """(cells,) which of all cells are hidden."""
        return mask_of(self.hidden, cells)

    def at(self, yaw: float) -> int:
        """The image for a yaw, radians; -1 where none is needed."""
        return int(self.serving[np.searchsorted(self.borders, yaw % TURN, side="right") - 1])


def placements_at(point: NDArray[np.float64], needs: Needs, cells: ModelCells, rules: PlacingRules) -> Placements:
    """The images of ``point`` (3,).

    Raises ParameterError where a yaw that the point is needed for shows more than the budget within the sphere: the point is
    not one of a grid that was made for these rules.
    """
    fov, hidden = rules.pyramid, mask_of(needs.hidden, len(cells.boxes))
    counts = np.where(hidden, 0, cells.counts)
    ranges = ranges_of(arcs_of(cells.boxes, point, fov), np.append(needs.borders, _CUTS))
    radii = needs.radii[np.searchsorted(needs.borders, ranges.borders, side="right") - 1]
    distances = np.where(hidden, 0.0, distances_to(cells.boxes, point))  # as near as what no image may have
    seen = np.where(radii > 0.0, ranges.totals(counts), 0)
    left, serving = seen.copy(), np.full(len(seen), -1, dtype=np.int32)
    open_ = (seen > rules.budget) & (radii > 0.0)
    images: list[Placement] = []
    while open_.any():
        fullest = int(np.where(open_, seen, -1).argmax())
        image = _image(point, fullest, ranges, float(radii[fullest]), distances, int(seen[fullest]), cells, rules)
        without = np.asarray(seen - ranges.totals(counts[image.cells], image.cells))
        served = open_ & (without <= rules.budget) & (radii < image.distance) & _wide_enough(image, ranges, rules)
        serving[served], left[served] = len(images), without[served]
        images.append(image)
        open_ &= ~served
    firsts = np.flatnonzero(np.diff(serving, prepend=-2))
    most = np.maximum.reduceat(left, firsts)
    return Placements(tuple(images), ranges.borders[firsts], serving[firsts], most, needs.hidden)


def _image(
    point: NDArray[np.float64],
    index: int,
    ranges: Ranges,
    radius: float,
    distances: NDArray[np.float64],
    seen: int,
    cells: ModelCells,
    rules: PlacingRules,
) -> Placement:
    """The best image for what range ``index`` sees beyond ``radius``; ``seen`` triangles are in its view."""
    some = ranges.seen_in(index)
    some = some[distances[some] > radius]
    if seen - cells.counts[some].sum() > rules.budget:
        raise ParameterError(
            f"the point {', '.join(f'{x:.1f}' for x in point)}: at most {rules.budget:,} triangles within {radius:.3g} m in "
            f"each view expected, found {seen - cells.counts[some].sum():,}"
        )
    fov, yaw = rules.pyramid, float(ranges.middles[index])
    extents, depths = _on_screen(cells.boxes[some] - point, yaw)
    chosen = best_subset(
        np.clip(extents, *np.outer([-1.0, 1.0], [fov.across, fov.across, fov.up, fov.up])),
        distances[some],
        cells.counts[some],
        enough=seen - rules.target,
        seen=seen,
        size=(2.0 * fov.across, 2.0 * fov.up),
        farthest=float(np.ptp(cells.bounds, axis=0).max()),
        rules=rules,
    )
    nearest = float(distances[some[chosen]].min())
    aside = np.setdiff1d(ranges.seen_near(index, rules.turn), some)
    aside = aside[distances[aside] >= nearest]
    bottom, top = (extents[chosen, 2].min(), extents[chosen, 3].max())
    bottom = -math.inf if bottom == extents[:, 2].min() else bottom
    top = math.inf if top == extents[:, 3].max() else top
    further, behind = _on_screen(cells.boxes[aside] - point, yaw)
    kept = (further[:, 2] >= bottom) & (further[:, 3] <= top) & (behind > 0.0)
    extents, depths = np.concatenate([extents[chosen], further[kept]]), np.append(depths[chosen], behind[kept])
    most = _largest(rules)
    low, high = extents[:, [0, 2]].min(axis=0), extents[:, [1, 3]].max(axis=0)
    return Placement(
        yaw=yaw,
        cells=np.sort(np.append(some[chosen], aside[kept])).astype(np.int32),
        window=_window(np.clip(low, -most, most), np.clip(high, -most, most)),
        near=max(float(depths.min()), nearest / math.hypot(1.0, *most)),
        distance=nearest,
    )


def _window(low: NDArray[np.float64], high: NDArray[np.float64]) -> tuple[float, float, float, float]:
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _largest(rules: PlacingRules) -> NDArray[np.float64]:
    """(2,) how far a picture reaches, across and up: tangents.

    A view that is turned by d shows, at the angle b to its side, what is at most cos(b) times the slope of its upper border
    up, and that is at b + d in the picture: cos(b) / cos(b + d) times the slope, most where both are as large as they can be.
    """
    half = math.atan(rules.pyramid.across)
    return np.array([math.tan(rules.widest), rules.pyramid.up * math.cos(half) / math.cos(rules.widest)])


def _on_screen(boxes: NDArray[np.float64], yaw: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(k, 4) lowest and highest coordinates across, rightwards, and up of boxes (k, 2, 3) seen from the origin, tangents, and
    (k,) their lowest depths. Of a box that reaches to beside the eye or behind, they may be infinite.
    """
    corner = np.arange(8)
    x, y, z = boxes[:, corner & 1, 0], boxes[:, corner >> 1 & 1, 1], boxes[:, corner >> 2, 2]
    cos, sin = math.cos(yaw), math.sin(yaw)
    depth, across = cos * x + sin * y, sin * x - cos * y
    ahead = depth > 0.0
    behind = ~ahead.all(axis=1)
    extents = []
    for one in (across, z):
        for sign in (1.0, -1.0):
            lowest = np.where(ahead, sign * one / np.where(ahead, depth, 1.0), np.inf).min(axis=1)
            extents.append(sign * np.where(behind & (sign * one < 0.0).any(axis=1), -np.inf, lowest))
    return np.stack(extents, axis=1), depth.min(axis=1)


def _wide_enough(image: Placement, ranges: Ranges, rules: PlacingRules) -> NDArray[np.bool_]:
    """(r,) of which ranges the picture has all that views show of its cells.

    It has for those turned by the margin at most; and for all others where it is not cut on the side that they turn to.
    """
    across, up = _largest(rules)
    margin = rules.widest - math.atan(rules.pyramid.across)
    left, bottom, right, top = image.window
    ends = np.stack([ranges.borders, np.append(ranges.borders[1:], TURN)]) - image.yaw
    turned = (ends + math.pi) % TURN - math.pi
    whole_height = -up < bottom and top < up
    most_left = 0.5 * math.pi if whole_height and left > -across else margin
    most_right = 0.5 * math.pi if whole_height and right < across else margin
    return np.asarray(((turned <= most_left) & (turned >= -most_right)).all(axis=0))
