"""What a technique is: views in, plans out. A plan says what to draw, and draws nothing (DESIGN section 5).

    Technique.plan(view, now, budget) -> Plan
    Plan   = what must be in memory, what to draw, perhaps over what was drawn before (cross-fade)
    Draw   = Sky | Ground | Objects | CellLayers        (a closed union; ``viewer.drawing.renderer`` draws each kind)

Techniques, walks and the choice of what to load are plain Python and run without OpenGL: the same walk gives the same plans.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View

__all__ = ["Budget", "CellKey", "CellLayers", "Draw", "Ground", "Objects", "Plan", "Sky", "Technique"]


class CellKey(NamedTuple):
    """A cell of a dataset; ``dataset`` is the name that a scene gives it, such as ``multi-mesh``."""

    dataset: str
    cell: str


@dataclass(frozen=True, slots=True)
class Sky:
    """The sky's gradient, wherever nothing was drawn before."""


@dataclass(frozen=True, slots=True)
class Ground:
    """Some ``tiles`` of the ground with its streets (objects of the ground's mesh), on a plain surface that has no end."""

    tiles: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Objects:
    """Geometry of some of the city's objects. ``key`` names the set: the same key means the same ``objects`` (n,) indices."""

    key: str
    objects: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class CellLayers:
    """Impostor layers of a cell: ``names`` as in the dataset (``s0.l2``), in drawing order."""

    cell: CellKey
    names: tuple[str, ...]


Draw = Sky | Ground | Objects | CellLayers
"""What a plan is made of: a closed union, of which the renderer draws each kind."""


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """One frame.

    ``draws`` in order: what is likely to hide the rest first. ``place`` is the cell that the viewer is in. The layers of
    ``cells`` must be in memory for it, ``ahead`` are cells worth loading next, most urgent first. Where ``mix`` is below 1,
    the picture of ``fading`` is mixed in: ``mix`` of draws, 1 - ``mix`` of fading.
    """

    draws: tuple[Draw, ...]
    place: str = ""
    cells: tuple[CellKey, ...] = ()
    ahead: tuple[CellKey, ...] = ()
    fading: tuple[Draw, ...] = ()
    mix: float = 1.0

    def same_as(self, other: Plan) -> bool:
        """Whether both say the same (sets of objects by their key): for replayed walks."""
        return _told(self) == _told(other)


@dataclass(frozen=True, slots=True)
class Budget:
    """Time for a frame, and what the last one took; seconds."""

    frame: float = 1.0 / 30.0
    last_frame: float = 0.0


class Technique(Protocol):
    """A way to draw a city."""

    @property
    def name(self) -> str:
        """What reports call it: ``multi-mesh``."""
        ...

    def plan(self, view: View, *, now: float, budget: Budget) -> Plan:
        """The frame for ``view`` at time ``now`` (seconds). May keep state between calls: views come in order."""
        ...


def _told(plan: Plan) -> tuple[object, ...]:
    def key(draw: Draw) -> object:
        return ("objects", draw.key) if isinstance(draw, Objects) else draw

    draws, fading = ([key(draw) for draw in some] for some in (plan.draws, plan.fading))
    return draws, fading, plan.place, plan.cells, plan.ahead, plan.mix
