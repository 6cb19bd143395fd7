"""What a user says of walks with placed images, checked once."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mmi.foundation.errors import ParameterError

__all__ = ["PlacedRules"]


@dataclass(frozen=True, slots=True)
class PlacedRules:
    """Where placed images are and how they are shown; raises ParameterError for what has no meaning.

    ``folder`` is what ``place-images`` wrote, None for none. Images in memory take ``bytes`` at most, besides the one that is
    shown; they are warped by ``threads`` threads.
    """

    folder: Path | None = None
    bytes: int = 512 << 20
    threads: int = 1

    def __post_init__(self) -> None:
        for name, least, most in (("bytes", 0, 1 << 40), ("threads", 1, 64)):
            value = getattr(self, name)
            if not least <= value <= most:
                raise ParameterError(f"{name}: a number from {least} to {most} expected, found {value!r}")
