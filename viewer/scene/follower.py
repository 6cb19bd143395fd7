"""Keeping track of a viewer: the cell it is in, where it is heading, and when it came there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viewer.scene.scene import CellContents, WalkScene

__all__ = ["Follower", "Move"]

_STILL = 1e-3
"""A movement of fewer metres has no direction."""
_LONGEST_STEP = 10.0
"""Where more metres lie between two frames the viewer did not walk: it was put elsewhere."""


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """Where the viewer is now.

    ``entered`` says that it was in another cell before, or nowhere; ``jumped`` that it cannot have walked here. ``ahead``
    are cells that it may come to, soonest first.
    """

    cell: CellContents
    entered: bool
    jumped: bool
    ahead: tuple[str, ...]


class Follower:
    """The state of a viewer who moves through the cells of a scene."""

    def __init__(self, scene: WalkScene) -> None:
        self._scene = scene
        self._cell: CellContents | None = None
        self._eye: NDArray[np.float64] | None = None
        self._heading: tuple[float, float] | None = None

    def move(self, eye: NDArray[np.float64]) -> Move:
        """Take in that the viewer is at ``eye`` (3,) now. Returns where that is."""
        current = None if self._cell is None else self._cell.cell.id
        whereabouts = self._scene.whereabouts
        name = whereabouts.cell_at(eye, current=current)
        entered = self._cell is None or name != current
        if self._cell is None or entered:
            self._cell = self._scene.cell(name)
        jumped = self._eye is None
        if self._eye is not None:
            x, y = (eye - self._eye)[:2].tolist()
            length = float(np.hypot(x, y))
            jumped = length > _LONGEST_STEP
            if jumped:
                self._heading = None
            elif length > _STILL:
                self._heading = (x / length, y / length)
        self._eye = np.array(eye)
        return Move(self._cell, entered, jumped, whereabouts.ahead(eye, name, self._heading))
