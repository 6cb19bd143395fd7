"""What a user says of walks with placed images, checked once."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from mmi.foundation.errors import ParameterError

__all__ = ["WARPS", "PlacedRules", "Warp"]

Warp = Literal["software", "points"]
"""What warps images; see :class:`PlacedRules`."""
WARPS: tuple[Warp, ...] = ("software", "points")


@dataclass(frozen=True, slots=True)
class PlacedRules:
    """Where placed images are and how they are shown; raises ParameterError for what has no meaning.

    ``folder`` is what ``place-images`` wrote, None for none. Images in memory take ``bytes`` at most, besides the one that is
    shown. ``warp`` says what moves their samples to where they are in a view:

    ``software``   ``threads`` threads, in occlusion-compatible order; cracks between neighbours are closed.
    ``points``     the renderer, which draws each sample as a point with depth.
    """

    folder: Path | None = None
    bytes: int = 512 << 20
    threads: int = 1
    warp: Warp = "software"

    def __post_init__(self) -> None:
        for name, least, most in (("bytes", 0, 1 << 40), ("threads", 1, 64)):
            value = getattr(self, name)
            if not least <= value <= most:
                raise ParameterError(f"{name}: a number from {least} to {most} expected, found {value!r}")
        if self.warp not in WARPS:
            raise ParameterError(f"warp: one of {', '.join(WARPS)} expected, found {self.warp!r}")
