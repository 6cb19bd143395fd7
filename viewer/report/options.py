"""What a comparison is told: techniques, walks, what is measured and kept, checked once."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from mmi.foundation.camera import Camera
from mmi.foundation.errors import ParameterError
from mmi.foundation.plug_ins import PlugIn
from mmi.movers.movers import NOTHING_MOVES, Movers
from mmi.planning.parameters import BuildParameters
from viewer.caching.rules import CacheRules
from viewer.casting.rules import CastRules
from viewer.placed.rules import PlacedRules
from viewer.techniques.catalogue import TechniqueEntry, TechniqueRules, find_technique
from viewer.techniques.virtual_frames import FrameRules

__all__ = ["OF_CITIES", "CompareOptions"]

_USUAL = ("full", "visible", "local", "single-mesh", "multi-mesh")
"""What is compared if nobody says; one whose pictures depend on how long a view is held has to be asked for."""
OF_CITIES = ("full", "ray-cast", "image-cache")
"""What is compared if nobody says, where a city is drawn as it was read."""
_SAMPLES = (0, 2, 4, 8, 16)
_MOST_PIXELS = 8192
"""Of a display a side, and of its focal length, as in builds."""


@dataclass(frozen=True, slots=True)
class CompareOptions:
    """How to compare; raises ParameterError for what has no meaning.

    ``techniques`` are names of the package's techniques, or functions of one's own: themselves, ``package.module:function`` or
    plug-ins (:func:`viewer.techniques.catalogue.find_technique`); ``entries`` is what they come to.
    ``fade`` seconds of cross-fade at changes of cells; ``samples`` of multisampling in timed frames and videos; ``cache``
    bytes for cells in memory; ``scored`` views spread over a walk; ``keep`` worst views a technique as pictures; without
    ``flip`` that measure, by far the slowest, is left out; ``video`` is the suffix of a film of the walk; ``settle`` frames for
    which each random view is held, the last of which is scored; ``budget_ms`` milliseconds of a frame that updates may take at
    most: infinity leaves them what the frame leaves, 0 forbids them; ``movers`` is what moves in the city, which layered
    techniques show by the rules of ``mover_frames``; in random views it stands as it is at ``movers_time`` seconds. ``glint``:
    windows of painted facades mirror the sun. ``rays`` is how rays are cast, ``images`` how those of boxes are kept, ``placed``
    where placed images are. ``camera`` is the display that is compared on; None: the one that the dataset was built for, or for
    a city 512 x 512 pixels and 60 degrees. Objects of a city longer than ``longest_object`` metres are cut, as builds cut them;
    None cuts none.
    """

    techniques: tuple[str | Callable[..., Any] | PlugIn, ...] = _USUAL
    frames_per_second: float = 30.0
    fade: float = 0.0
    samples: int = 0
    cache: int = 512 << 20
    scored: int = 60
    keep: int = 6
    flip: bool = True
    video: str | None = None
    workers: int = 1
    settle: int = 1
    budget_ms: float = math.inf
    movers: Movers = NOTHING_MOVES
    mover_frames: FrameRules = field(default_factory=FrameRules)
    movers_time: float = 0.0
    glint: bool = False
    rays: CastRules = field(default_factory=CastRules)
    images: CacheRules = field(default_factory=CacheRules)
    placed: PlacedRules = field(default_factory=PlacedRules)
    camera: Camera | None = None
    longest_object: float | None = BuildParameters().longest_object
    entries: tuple[TechniqueEntry, ...] = field(init=False, repr=False, compare=False)

    @property
    def rules(self) -> TechniqueRules:
        """What techniques are told of all this."""
        return TechniqueRules(self.fade, self.rays, self.images, self.placed)

    def __post_init__(self) -> None:
        try:
            entries = tuple(find_technique(one) for one in self.techniques)
        except ParameterError as error:
            raise ParameterError(f"techniques: {error}") from error
        names = [entry.name for entry in entries]
        if not names or len(set(names)) < len(names):
            raise ParameterError(f"techniques: one or more expected, each once, found {', '.join(names)!r}")
        object.__setattr__(self, "entries", entries)
        for name, least, most in (
            ("frames_per_second", 1.0, 240.0),
            ("settle", 1, 10_000),
            ("movers_time", -1e7, 1e7),
            ("fade", 0.0, 10.0),
            ("cache", 1_000_000, 1 << 40),
            ("scored", 1, 100_000),
            ("keep", 0, 100),
            ("workers", 1, 1024),
        ):
            value = getattr(self, name)
            if not (math.isfinite(value) and least <= value <= most):
                raise ParameterError(f"{name}: a number from {least:g} to {most:g} expected, found {value!r}")
        if self.longest_object is not None and not 10.0 <= self.longest_object < math.inf:
            raise ParameterError(f"longest_object: 10 metres or more, or none, expected, found {self.longest_object!r}")
        shown = self.camera
        if shown is not None and max(shown.width, shown.height, shown.focal) > _MOST_PIXELS:
            raise ParameterError(
                f"camera: at most {_MOST_PIXELS} pixels a side and a focal length of at most {_MOST_PIXELS} pixels expected, "
                f"found {shown.width}x{shown.height} and {shown.focal:.0f}"
            )
        if not self.budget_ms >= 0.0:
            raise ParameterError(f"budget_ms: 0 or more expected, found {self.budget_ms!r}")
        if self.samples not in _SAMPLES:
            raise ParameterError(f"samples: one of {', '.join(map(str, _SAMPLES))} expected, found {self.samples!r}")
