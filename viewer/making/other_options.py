"""Where a folder of placed images was made with other options than a command says, in the words of these options."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import Camera
from viewer.placed.solutions import Solutions
from viewer.placing.rules import PlacingRules

__all__ = ["other_options"]

_WEIGHTS = ("cost", "benefit", "small", "far")
_NAMED = ("budget", "target", "fov", "depth", "pitch", *_WEIGHTS)
"""What rules have that an option says; of a display that is another, they have another ``fov``."""


def other_options(
    known: Solutions, told: Mapping[str, Any], domain: NDArray[np.float64], anywhere: NDArray[np.float64]
) -> list[tuple[str, str]]:
    """What ``known`` was made with, and what ``told`` says instead: fields of solutions, of which the name of the model's file
    makes no difference. Viewers are in ``domain`` (2, 3), which without heights is ``anywhere``.

    Of another model nothing else is said: what options mean depends on it.
    """
    if known.model != told["model"]:
        return [(f"{known.source}, read as it was then", f"{told['source']}, or other triangles of it")]
    of, found = known.rules, told["rules"]
    pairs = [
        (_display(known.camera), _display(told["camera"])),
        (_fov(known.camera), _fov(told["camera"])),
        *((f"--{option} {_of(of, names)}", f"--{option} {_of(found, names)}") for option, names in _RULES),
        (f"--pitch {math.degrees(of.pitch):g}", f"--pitch {math.degrees(found.pitch):g}"),
        (f"--pictures {known.pictures}", f"--pictures {told['pictures']}"),
        (_heights(known.grid.domain, anywhere), _heights(domain, anywhere)),
    ]
    different = [(one, other) for one, other in pairs if one != other]
    if known.occluders != told["occluders"]:
        one, other = (f"{'' if hides else 'no '}--hidden" for hides in (known.occluders, told["occluders"]))
        different.append((one, other if one != other else "a city that hides something else"))
    if any(getattr(of, one.name) != getattr(found, one.name) for one in fields(PlacingRules) if one.name not in _NAMED):
        different.append(("the rules of then", "others"))
    return different


_RULES = (("budget", ("budget",)), ("optimize", ("target",)), ("octree-depth", ("depth",)), ("weights", _WEIGHTS))


def _of(rules: PlacingRules, names: tuple[str, ...]) -> str:
    return ",".join(f"{getattr(rules, one):g}" if one in _WEIGHTS else f"{getattr(rules, one)}" for one in names)


def _display(camera: Camera) -> str:
    return f"--display {camera.width}x{camera.height}"


def _fov(camera: Camera) -> str:
    return f"--fov {math.degrees(camera.fov):.9g}"


def _heights(domain: NDArray[np.float64], anywhere: NDArray[np.float64]) -> str:
    if np.array_equal(domain, anywhere):
        return "no --heights"
    low, high = domain[:, 2].tolist()
    return f"--heights {low:.9g},{high:.9g}"
