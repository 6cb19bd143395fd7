"""What a technique is: views in, plans out. A plan says what to draw, and draws nothing (DESIGN section 5).

    Technique.plan(view, now, budget) -> Plan
    Plan   = what must be in memory, what to draw, perhaps over what was drawn before (cross-fade)
    Draw   = Sky | Ground | Objects | CellLayers        (a closed union; ``viewer.gl`` draws each kind)

Techniques, paths and the frame loop are plain Python and run without OpenGL: the same walk gives the same plans.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mmi.camera import View

__all__ = ["Budget", "CellLayers", "Draw", "Ground", "Objects", "Plan", "Sky", "Technique"]


@dataclass(frozen=True, slots=True)
class Sky:
    """The sky's gradient, behind everything."""


@dataclass(frozen=True, slots=True)
class Ground:
    """The ground with its streets."""


@dataclass(frozen=True, slots=True, eq=False)
class Objects:
    """Geometry of some of the city's objects. ``key`` names the set: the same key means the same ``objects`` (n,) indices."""

    key: str
    objects: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class CellLayers:
    """Impostor layers of a cell: ``names`` as in the dataset (``s0.l2``), in drawing order."""

    dataset: str
    cell: str
    names: tuple[str, ...]


Draw = Sky | Ground | Objects | CellLayers


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """One frame.

    ``draws`` in order. ``cells`` must be in memory for it, ``ahead`` are cells worth loading next, most urgent first.
    Where ``mix`` is below 1, the picture of ``fading`` is mixed in: ``mix`` of draws, 1 - ``mix`` of fading.
    """

    draws: tuple[Draw, ...]
    cells: tuple[str, ...] = ()
    ahead: tuple[str, ...] = ()
    fading: tuple[Draw, ...] = ()
    mix: float = 1.0


@dataclass(frozen=True, slots=True)
class Budget:
    """Time for a frame, and what the last one took; seconds."""

    frame: float = 1.0 / 30.0
    last_frame: float = 0.0


class Technique(Protocol):
    """A way to draw a city."""

    name: str

    def plan(self, view: View, *, now: float, budget: Budget) -> Plan:
        """The frame for ``view`` at time ``now`` (seconds). May keep state between calls: views come in order."""
        ...
