"""What was walked through, and what it promises in pixels of the display that pictures were drawn for.

A dataset's threshold T is an angle: what T pixels subtend at the centre of the display that it was built for. How far surfaces
are displaced is an angle too, so that T is as many times as many pixels as the focal length is, on any display.

How thick wrong regions are is counted in pixels wherever they are in a picture, and away from the centre pixels are finer. A
promise of it holds where each picture of the display is a part of one of the display built for, larger or smaller: where it
sees no farther aside, up or down. Then T grows with the focal length. Of the two pixels for rasters one is the display's own,
and the other one is a texel: larger by as much where the display is finer than the textures, and no smaller than a pixel
elsewhere. On a display that sees farther nothing is promised of thickness.
"""

from __future__ import annotations

import math
from typing import Any

from mmi.foundation.camera import Camera
from mmi.foundation.whole_files import real_path
from viewer.scene.scene import WalkScene

__all__ = ["display_of", "promised_thickness", "source_of"]

_SAME = 1.0 + 1e-9
"""Fields of view that differ by less are the same."""


def display_of(camera: Camera) -> dict[str, Any]:
    """A display for the report."""
    return {"width": camera.width, "height": camera.height, "fov_deg": math.degrees(camera.fov)}


def source_of(scene: WalkScene) -> dict[str, Any]:
    """What the report says of the dataset, or of the city that was drawn without one, which promises nothing."""
    if scene.built is None:
        return {
            "kind": "city",
            "name": scene.source,
            "city": scene.source,
            "cells": len(scene.whereabouts.cells),
            "built_for": None,
            "max_error_px": None,
            "promised_px": None,
            "promising_cells": None,
        }
    cells, parameters = scene.built.manifest.cells, scene.parameters
    promising = sum(one.promised_error_px is not None for one in cells)
    threshold = parameters.max_error_px
    same = scene.camera == parameters.camera
    return {
        "kind": "dataset",
        "name": real_path(scene.built.path).name,
        "city": scene.source,
        "cells": len(cells),
        "built_for": {**display_of(parameters.camera), "max_error_px": threshold},
        "max_error_px": threshold if same else scene.camera.pixels_from_angle(parameters.max_angle),
        "promised_px": promised_thickness(threshold, parameters.camera, scene.camera) if promising else None,
        "promising_cells": promising,
    }


def promised_thickness(threshold: float, built_for: Camera, shown: Camera) -> float | None:
    """Pixels of the display ``shown`` that no wrong region is thicker than, for ``threshold`` pixels of the one ``built_for``.

    None where ``shown`` sees farther aside, up or down, so that the promise does not hold there.
    """
    finer = shown.focal / built_for.focal
    if shown.width > finer * built_for.width * _SAME or shown.height > finer * built_for.height * _SAME:
        return None
    return finer * threshold + 1.0 + max(finer, 1.0)
