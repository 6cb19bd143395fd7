"""What a user says of ray casting, checked once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from mmi.foundation.errors import ParameterError

__all__ = ["REUSE", "CastRules", "Reuse"]

Reuse = Literal["bound", "hits"]
"""By which rule what was cast from elsewhere is shown again; see :class:`CastRules`."""
REUSE: tuple[Reuse, ...] = ("bound", "hits")
_CASTERS = ("embree", "grid")


@dataclass(frozen=True, slots=True)
class CastRules:
    """How to cast; raises ParameterError for what has no meaning.

    Objects within ``near_field`` metres of the viewer, horizontally, are geometry (paper section 4.1: the near field). What was
    cast is shown again while it is off by ``limit_px`` pixels at most; None stands for the error that the city's impostors were
    built for. ``reuse`` says how that is known:

    ``bound``   from the distance to where it was cast: what is farther away than the near field moves by less. A true bound.
    ``hits``    from where its own surface is now: what else may have come before that is not known. A measurement.

    ``rays`` are cast in a frame at most, None: as many as the limit asks for; then the worst go first, and the report says what
    error was kept. While the viewer walks, so much is cast again in each frame, the worst first, that nothing becomes too wrong
    all at once; while it stands still, up to ``settling`` rays a frame for what is not exact.
    ``caster`` finds what a ray hits: Embree, or a regular grid (paper section 4.2).
    """

    near_field: float = 100.0
    limit_px: float | None = None
    reuse: Reuse = "bound"
    rays: int | None = None
    settling: int = 8192
    caster: Literal["embree", "grid"] = "embree"
    workers: int = 1

    def __post_init__(self) -> None:
        for name, least, most in (
            ("near_field", 1.0, 100_000.0),
            ("limit_px", 0.0, 1000.0),
            ("rays", 0, 1 << 30),
            ("settling", 0, 1 << 30),
            ("workers", 1, 1024),
        ):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and least <= value <= most):
                raise ParameterError(f"{name}: a number from {least:g} to {most:g} expected, found {value!r}")
        for name, among in (("reuse", REUSE), ("caster", _CASTERS)):
            if getattr(self, name) not in among:
                raise ParameterError(f"{name}: one of {', '.join(among)} expected, found {getattr(self, name)!r}")
