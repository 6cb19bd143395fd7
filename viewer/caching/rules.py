"""What a user says of the image cache, checked once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from mmi.foundation.errors import ParameterError

__all__ = ["KEEP", "CacheRules", "Keep"]

Keep = Literal["sphere", "frustum"]
"""Which images are kept up to date."""
KEEP: tuple[Keep, ...] = ("sphere", "frustum")


@dataclass(frozen=True, slots=True)
class CacheRules:
    """How to keep images of boxes; raises ParameterError for what has no meaning.

    An image is shown while no point of its box is off by more than ``error_px`` of the display's smallest pixels, those at its
    borders (paper section 3). Boxes are halved until they hold ``leaf_triangles`` or fewer, at ``depth`` levels at most (None:
    as many as it takes). Images have at most ``largest`` texels a side (the paper's 256), and all together take at most
    ``bytes`` on the GPU; those shown least recently give way. ``keep`` says whether all around the viewer images are kept up to
    date ("sphere", the paper's choice: who turns finds them there), or only what is in view ("frustum").
    A box is an image where showing that is predicted to take less time than its triangles, and is captured from them unless
    images of boxes within are predicted to take less; with ``eager``, as in the paper, it is an image wherever it can be one,
    and only leaves are captured from triangles.
    """

    error_px: float = 1.0
    leaf_triangles: int = 1000
    depth: int | None = None
    largest: int = 256
    bytes: int = 512 << 20
    keep: Keep = "sphere"
    eager: bool = False

    def __post_init__(self) -> None:
        for name, least, most in (
            ("error_px", 0.01, 1000.0),
            ("leaf_triangles", 1, 1 << 30),
            ("depth", 0, 64),
            ("largest", 16, 1024),
            ("bytes", 0, 1 << 40),
        ):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and least <= value <= most):
                raise ParameterError(f"{name}: a number from {least} to {most} expected, found {value!r}")
        if self.keep not in KEEP:
            raise ParameterError(f"keep: one of {', '.join(KEEP)} expected, found {self.keep!r}")
        if self.largest & (self.largest - 1):
            raise ParameterError(f"largest: a power of two expected, found {self.largest}")
