"""The model's cells: the leaves of an octree, of which each has its own triangles, so that culling a cell draws none of them.

The octree is a loose one (Ulrich, "Loose octrees", 2000): a triangle belongs to the deepest node of at most the wanted depth
that is not smaller than it and that holds the middle of its bounds. A large triangle so makes a cell of an inner node and does
not blow up a leaf. Cells that hold too many are divided further, by the middles of their triangles. Which box a cell has
follows from what it holds, so that boxes may overlap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mmi.city.ranges import numbers_in
from mmi.foundation.errors import ParameterError
from viewer.placing.rules import PlacingRules

__all__ = ["ModelCells", "cells_for", "model_cells"]

_BITS = 18
"""Levels of the octree that middles are told apart by; a code has three bits for each, and a leading one."""


@dataclass(frozen=True, slots=True, eq=False)
class ModelCells:
    """Cells of a model: ``boxes`` (n, 2, 3) are the tight bounds of what each holds, in the model's frame, metres.

    Cell i holds ``triangles[starts[i] : starts[i + 1]]``, ascending; every triangle of the model is in one cell.
    """

    boxes: NDArray[np.float64]
    triangles: NDArray[np.int32]
    starts: NDArray[np.int64]

    def __post_init__(self) -> None:
        for name in self.__slots__:
            getattr(self, name).setflags(write=False)

    @property
    def counts(self) -> NDArray[np.int64]:
        """(n,) triangles of each cell."""
        return np.diff(self.starts)

    @property
    def bounds(self) -> NDArray[np.float64]:
        """(2, 3) of the whole model."""
        return np.stack([self.boxes[:, 0].min(axis=0), self.boxes[:, 1].max(axis=0)])

    def triangles_of(self, cells: NDArray[np.integer]) -> NDArray[np.int32]:
        """The triangles of some ``cells`` (k,), each of them once, ascending."""
        return np.sort(self.triangles[numbers_in(self.starts[cells], self.starts[cells + 1])])


def cells_for(positions: NDArray[np.floating], triangles: NDArray[np.integer], rules: PlacingRules) -> ModelCells:
    """The cells that images are placed with by ``rules``, and walked with. Those of a model that may be drawn whole hold as
    much as they do. Raises what :func:`model_cells` raises.
    """
    whole = len(triangles) <= rules.target
    return model_cells(positions, triangles, depth=rules.depth, most=len(triangles) if whole else rules.cell_triangles)


def model_cells(
    positions: NDArray[np.floating], triangles: NDArray[np.integer], *, depth: int = 5, most: int
) -> ModelCells:
    """The cells of ``triangles`` (t, 3) with corners in ``positions`` (v, 3): nodes down to ``depth`` below the root.

    A node that would hold more than ``most`` is divided further. Raises ParameterError where that does not help, as triangles
    lie on top of each other, where there are none, or where corners are not finite.
    """
    if not len(triangles):
        raise ParameterError("a model: some triangles expected, found none")
    low, high = _bounds(positions, triangles)
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        raise ParameterError("a model: finite corners expected, found others")
    origin = low.min(axis=0)
    edge = float((high.max(axis=0) - origin).max()) or 1.0
    codes = _codes((0.5 * low + 0.5 * high - origin) / edge)
    extents = (high - low).max(axis=1)
    with np.errstate(divide="ignore"):
        own = np.floor(np.log2(edge / np.maximum(extents, edge * 2.0**-_BITS))).clip(0, depth).astype(np.int64)
    levels = own.copy()
    while True:
        keys = (own << (3 * _BITS + 1)) | (1 << (3 * levels)) | (codes >> (3 * (_BITS - levels)))
        order = np.argsort(keys, kind="stable")
        firsts = np.flatnonzero(np.diff(keys[order], prepend=-1))
        counts = np.diff(firsts, append=len(order))
        full = np.repeat(counts > most, counts)
        if not full.any():
            break
        crowded = order[full]
        if (levels[crowded] == _BITS).any():
            at = crowded[levels[crowded] == _BITS][0]
            raise ParameterError(
                f"cells of at most {most:,} triangles: expected, found {int(counts.max()):,} on top of each other near "
                f"{', '.join(f'{x:.1f}' for x in 0.5 * (low[at] + high[at]))}; a larger budget is needed"
            )
        levels[crowded] += 1
    boxes = np.stack([np.minimum.reduceat(low[order], firsts), np.maximum.reduceat(high[order], firsts)], axis=1)
    return ModelCells(boxes.astype(np.float64), order.astype(np.int32), np.append(firsts, len(order)).astype(np.int64))


def _bounds(
    positions: NDArray[np.floating], triangles: NDArray[np.integer]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(t, 3) lowest and (t, 3) highest coordinates of triangles."""
    a, b, c = (positions[triangles[:, k]].astype(np.float64) for k in range(3))
    return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


def _codes(places: NDArray[np.float64]) -> NDArray[np.int64]:
    """(n,) Morton codes of ``_BITS`` bits for each coordinate of places (n, 3) in the unit cube."""
    steps = (places * (1 << _BITS)).astype(np.int64).clip(0, (1 << _BITS) - 1)
    codes = np.zeros(len(steps), dtype=np.int64)
    for axis in range(3):
        spread = steps[:, axis]
        for shift, mask in (
            (32, 0x1F00000000FFFF),
            (16, 0x1F0000FF0000FF),
            (8, 0x100F00F00F00F00F),
            (4, 0x10C30C30C30C30C3),
            (2, 0x1249249249249249),
        ):
            spread = (spread | (spread << shift)) & mask
        codes |= spread << axis
    return codes
