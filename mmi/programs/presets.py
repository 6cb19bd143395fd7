"""Displays in words: ``build-impostors --for laptop`` stands for a display, a threshold that suits it, and budgets."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, fields

from mmi.foundation.camera import Camera
from mmi.planning.parameters import BuildParameters

__all__ = ["PRESETS", "Preset", "resolve", "too_coarse"]

_FOV = 60.0
"""Degrees across a display, unless told otherwise."""
_REFERENCE = Camera(1920, 1080, math.radians(_FOV))
"""The display that people have; thresholds of others are told in its pixels."""
_SEEN = 10.0
"""Pixels of it: errors that are larger are seen."""


@dataclass(frozen=True, slots=True)
class Preset:
    """What one word stands for: pixels, degrees, and budgets of a cell (None: no budget). Fields are the options' names."""

    name: str
    display: tuple[int, int]
    max_error: float
    max_triangles: int | None = None
    max_bytes: int | None = None
    fov: float = _FOV

    def words(self) -> str:
        """The options that it stands for, in words."""
        width, height = self.display
        text = f"{self.max_error:g} px of {width}x{height}"
        if self.max_triangles is not None and self.max_bytes is not None:
            text += f", cells of at most {self.max_triangles:,} triangles and {self.max_bytes / 1e6:g} MB"
        return text


_PAPER = Preset("paper", (512, 512), BuildParameters().max_error_px)
"""What holds where no preset is asked for: the paper's experiment."""
PRESETS = (
    Preset("phone", (1280, 720), 5.0, 20_000, 1_000_000),
    Preset("laptop", (1920, 1080), 5.0, 100_000, 3_000_000),
    Preset("desktop", (2560, 1440), 5.0, 500_000, 6_000_000),
    Preset("4k", (3840, 2160), 6.0, 500_000, 12_000_000),
)


def resolve(options: argparse.Namespace) -> None:
    """Fill in what was not said: from the preset ``options.preset``, or else as the paper has it."""
    preset = next((one for one in PRESETS if one.name == options.preset), _PAPER)
    for one in fields(Preset):
        if one.name != "name" and getattr(options, one.name) is None:
            setattr(options, one.name, getattr(preset, one.name))


def too_coarse(parameters: BuildParameters) -> str | None:
    """What to say of a threshold that is as wide as will be seen on the displays that people have; None where it is finer."""
    camera = parameters.camera
    pixels = _REFERENCE.pixels_from_angle(parameters.max_angle)
    if pixels <= _SEEN:
        return None
    return (
        f"note: {parameters.max_error_px:g} px of {camera.width}x{camera.height} are as wide as {pixels:.3g} px of "
        f"{_REFERENCE.width}x{_REFERENCE.height}, where they would be seen; --for laptop is {PRESETS[1].max_error:g} px there"
    )
