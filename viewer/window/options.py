"""What a studio is told, checked once, and what it says when it draws nothing for a client."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from mmi.foundation.errors import MmiError, ParameterError
from viewer.placed.rules import PlacedRules, Warp
from viewer.techniques.catalogue import TECHNIQUES, find_technique
from viewer.window.look import Look

__all__ = ["PLACED", "SINGLE", "StudioClosedError", "StudioFullError", "StudioOptions"]

SINGLE, PLACED = "single-mesh", "placed-images"
"""The techniques that need a folder of their own."""
_MOST_SESSIONS = 16


class StudioFullError(ParameterError):
    """As many clients as are drawn at once are there already."""


class StudioClosedError(MmiError):
    """The studio ends, or the client has left: nothing is drawn for it any more."""


@dataclass(frozen=True, slots=True)
class StudioOptions:
    """How a studio works. Raises ParameterError for what has no meaning.

    ``techniques`` that may be compared; at most ``sessions`` are drawn at once. ``cache`` bytes for cells in memory,
    ``samples`` of multisampling, ``look`` what clients see at first. ``single_mesh`` is a dataset of the same city and
    parameters, one layer a view, for the technique of that name, and ``placed`` what ``place-images`` wrote for the
    city, whose images ``warp`` moves. Films go into the folder ``films``, or one of their own that vanishes with the studio.
    """

    techniques: tuple[str, ...] = tuple(name for name in TECHNIQUES if name not in (SINGLE, PLACED))
    sessions: int = 4
    cache: int = 512 << 20
    samples: int = 0
    look: Look = field(default_factory=Look)
    single_mesh: Path | None = None
    placed: Path | None = None
    warp: Warp = "software"
    films: Path | None = None

    def __post_init__(self) -> None:
        if not 1 <= self.sessions <= _MOST_SESSIONS:
            raise ParameterError(f"sessions: 1 to {_MOST_SESSIONS} expected, found {self.sessions!r}")
        PlacedRules(self.placed, warp=self.warp)
        if not self.techniques:
            raise ParameterError("techniques: one or more expected, found none")
        names = [find_technique(name).name for name in self.techniques]
        for needy, folder, what in (
            (SINGLE, self.single_mesh, "a dataset of its own"),
            (PLACED, self.placed, "a folder that place-images wrote (--placed)"),
        ):
            if folder is not None and needy not in names:
                object.__setattr__(self, "techniques", (*self.techniques, needy))
            elif folder is None and needy in names:
                raise ParameterError(f"techniques: {needy} needs {what}, found none")
