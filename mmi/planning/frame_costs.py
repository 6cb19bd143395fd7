"""What a frame of a cell costs, so that layers and geometry can be held against each other.

Who draws a cell as an impostor draws its near objects and its layers; who draws it as geometry, all objects that may be
visible. Both are counted in all directions: a viewer leaves out what is behind, of the one as of the other. Near objects are
one draw, the layers of a cell another, since they share an atlas (``viewer.cells``). Texels and bytes are those of layers: the
city's geometry is there once, whatever is drawn of it.

A cost is a number of triangles. How many of them a draw, texels and bytes are worth depends on the machine, and
:class:`FrameCosts` says it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

from mmi.foundation.errors import ParameterError

__all__ = ["MOST", "FrameCosts", "FrameLoad"]

MOST = 1e12
"""Triangles that one draw, a thousand texels or a thousand bytes are worth, at most: costs of frames stay finite."""


@dataclass(frozen=True, slots=True)
class FrameCosts:
    """How many triangles can be drawn in the time that goes for a draw, for a thousand texels, and for a thousand bytes.

    The defaults let triangles decide, and the rest only where they hardly differ. Raises ParameterError for numbers that are
    negative or larger than ``MOST``.
    """

    draw: float = 100.0
    kilotexel: float = 0.1
    kilobyte: float = 1.0

    def __post_init__(self) -> None:
        for one in fields(self):
            value = getattr(self, one.name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= MOST:
                raise ParameterError(
                    f"costs: a number of triangles from 0 to {MOST:g} for a {one.name} expected, found {value!r}"
                )
            object.__setattr__(self, one.name, float(value))


@dataclass(frozen=True, slots=True)
class FrameLoad:
    """What a frame draws, and what of it was loaded for this cell alone."""

    triangles: int
    draws: int
    texels: int = 0
    bytes: int = 0

    def cost(self, costs: FrameCosts) -> float:
        """The same as a number of triangles."""
        return (
            self.triangles
            + costs.draw * self.draws
            + costs.kilotexel * self.texels / 1e3
            + costs.kilobyte * self.bytes / 1e3
        )
