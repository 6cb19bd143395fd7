"""Techniques by name: the datasets that they need, and the cache that their cells come from.

full, visible, local      geometry only                                     (viewer.techniques.geometry)
multi-mesh                the dataset that is compared                      (viewer.techniques.layered)
single-mesh               the same city and parameters, one layer a view; built where it is not there yet
"""

from __future__ import annotations

from collections.abc import Mapping

from mmi.foundation.errors import ParameterError
from viewer.plan import Technique
from viewer.scene.scene import WalkScene
from viewer.techniques.geometry import CellGeometry, FullGeometry
from viewer.techniques.layered import LayeredImpostors

__all__ = ["LAYERED", "TECHNIQUES", "make_technique"]

LAYERED = ("single-mesh", "multi-mesh")
TECHNIQUES = ("full", "visible", "local", *LAYERED)


def make_technique(name: str, scenes: Mapping[str, WalkScene], *, fade: float = 0.0) -> Technique:
    """A fresh technique, which knows of no viewer yet. ``scenes``: ``multi-mesh``, and ``single-mesh`` where that is asked for.

    Raises ParameterError for an unknown name.
    """
    main = scenes["multi-mesh"]
    match name:
        case "full":
            return FullGeometry(main)
        case "visible" | "local":
            return CellGeometry(main, name)
        case "single-mesh" | "multi-mesh":
            return LayeredImpostors(scenes[name], fade=fade)
    raise ParameterError(f"technique {name!r}: one of {', '.join(TECHNIQUES)} expected")
