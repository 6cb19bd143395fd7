"""Which cell a viewer is in, and which cells it may come to next.

Plain geometry on the cells' rectangles, for all cells at once. Who the viewer is, how it moves and what is loaded for it is
decided elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import InitVar, dataclass, field

import numpy as np
from numpy.typing import NDArray

from mmi.cells.viewing_cells import ViewingCell
from mmi.foundation.errors import ParameterError

__all__ = ["HYSTERESIS", "Whereabouts"]

HYSTERESIS = 0.5
"""Metres that a viewer may be outside of its cell before it counts as being in another one."""
_AHEAD = 10.0
"""Cells near the point this many metres in front of a viewer that moves are the most urgent."""


@dataclass(frozen=True, slots=True, eq=False)
class Whereabouts:
    """The cells of a dataset on the map.

    ``neighbours`` maps ids of cells to those of their neighbours; ids that no cell has are ignored. Raises ParameterError
    where there are no cells, or two of one id.
    """

    cells: tuple[ViewingCell, ...]
    neighbours: InitVar[Mapping[str, Sequence[str]]]
    _places: Mapping[str, int] = field(init=False, repr=False)
    """Ids to indices into ``cells``."""
    _adjacent: tuple[tuple[int, ...], ...] = field(init=False, repr=False)
    """The neighbours of each cell, as indices."""
    _axes: NDArray[np.float64] = field(init=False, repr=False)
    """(6, n): x and y of p, of the unit vector from p to q, length, half width."""

    def __post_init__(self, neighbours: Mapping[str, Sequence[str]]) -> None:
        cells = tuple(self.cells)
        places = {cell.id: i for i, cell in enumerate(cells)}
        if not cells:
            raise ParameterError("at least one cell expected, found none")
        if len(places) < len(cells):
            raise ParameterError(f"cells of {len(cells)} different ids expected, found {len(places)}")
        p, q = np.array([cell.p for cell in cells]), np.array([cell.q for cell in cells])
        lengths = np.array([cell.length for cell in cells])
        axes = np.vstack([p.T, (q - p).T / lengths, lengths, [cell.half_width for cell in cells]])
        axes.setflags(write=False)
        adjacent = tuple(
            tuple(places[name] for name in neighbours.get(cell.id, ()) if name in places) for cell in cells
        )
        object.__setattr__(self, "cells", cells)
        object.__setattr__(self, "_places", places)
        object.__setattr__(self, "_adjacent", adjacent)
        object.__setattr__(self, "_axes", axes)

    @property
    def adjacency(self) -> dict[str, tuple[str, ...]]:
        """Ids of cells to those of their neighbours among the cells."""
        ids = [cell.id for cell in self.cells]
        return {one: tuple(ids[i] for i in around) for one, around in zip(ids, self._adjacent, strict=True)}

    def distances(self, eye: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) metres from (x, y) of ``eye`` (2,) or (3,) to each cell's rectangle, 0 inside."""
        return self._distances(*self._offsets(eye))

    def cell_at(self, eye: NDArray[np.float64], *, current: str | None) -> str:
        """The cell that a viewer at ``eye`` (3,) is in, who was in ``current`` before.

        It stays in that as long as it is within ``HYSTERESIS`` of its rectangle, so that no step back and forth across a
        boundary changes cells twice. Otherwise it is in the cell whose axis is nearest, of those that contain it, or where
        none does, in the one whose rectangle is nearest; of equals in the first.

        A cell's bound on errors holds for views from inside of its rectangle. Views from the last ``HYSTERESIS`` metres
        before a change of cells are up to that far outside, where the bound may be passed. Error angles grow about as the
        distance from the cell's reference viewpoint does: half a metre beyond the end of a 40 m cell adds some 2.5 %, half
        a metre beside a narrow one more. Views from off the streets, and from gaps between cells that buildings cut short,
        are farther outside, and no bound holds for them.

        Raises ParameterError where ``current`` is none of the cells.
        """
        beyond, beside = self._offsets(eye)
        distances = self._distances(beyond, beside)
        if current is not None and distances[self._place(current)] <= HYSTERESIS:
            return current
        inside = distances == 0.0
        nearest = np.where(inside, np.hypot(beyond, beside), np.inf) if inside.any() else distances
        return self.cells[int(np.argmin(nearest))].id

    def ahead(
        self, eye: NDArray[np.float64], cell: str, heading: tuple[float, float] | None, *, reach: float = 60.0
    ) -> tuple[str, ...]:
        """The cells worth loading next for a viewer at ``eye`` (3,) in ``cell``, most urgent first, without ``cell`` itself.

        Those that come within ``reach`` metres of the viewer and that it can walk to through such cells, the nearest first
        to a point 10 m ahead of it. ``heading`` is a direction (x, y) of any length; without one it is the viewer itself
        that cells are near to. Equals are in the order of ``cells``. Raises ParameterError where ``cell`` is none of the
        cells.
        """
        start = self._place(cell)
        close = self.distances(eye) <= reach
        found, waiting = {start}, [start]
        while waiting:
            fresh = [i for i in self._adjacent[waiting.pop()] if close[i] and i not in found]
            found.update(fresh)
            waiting += fresh
        point = np.array(eye[:2], dtype=np.float64)
        speed = 0.0 if heading is None else math.hypot(*heading)
        if heading is not None and speed > 0.0:
            point += _AHEAD / speed * np.array(heading)
        urgency = self.distances(point)
        return tuple(self.cells[i].id for i in sorted(found - {start}, key=lambda i: (urgency[i], i)))

    def _offsets(self, eye: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(n,) metres beyond the ends of each axis (0 between them), and (n,) beside the line through it, both >= 0."""
        p_x, p_y, along_x, along_y, length, _ = self._axes
        x, y = float(eye[0]) - p_x, float(eye[1]) - p_y
        along = x * along_x + y * along_y
        return np.maximum(np.maximum(-along, along - length), 0.0), np.abs(x * along_y - y * along_x)

    def _distances(self, beyond: NDArray[np.float64], beside: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) metres to each rectangle from what :meth:`_offsets` says."""
        found: NDArray[np.float64] = np.hypot(beyond, np.maximum(beside - self._axes[5], 0.0))
        return found

    def _place(self, cell: str) -> int:
        if cell not in self._places:
            raise ParameterError(f"one of {len(self.cells)} cells expected, found {cell!r}")
        return self._places[cell]
