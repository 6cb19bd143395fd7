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
from collections.abc import Sequence
from typing import Any

from mmi.foundation.camera import Camera
from mmi.foundation.whole_files import real_path
from viewer.measuring.judge import Scored
from viewer.scene.scene import WalkScene

__all__ = ["display_of", "promised_thickness", "source_of", "verdict_of"]

_SAME = 1.0 + 1e-9
"""Fields of view that differ by less are the same."""
_ROUNDING_PX = 1e-3
"""Pixels by which a measured displacement may pass the threshold: depths are read back as float32."""


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


def verdict_of(
    scene: WalkScene, scored: Sequence[Scored] | None, *, glint: bool = False, movers: bool = False
) -> dict[str, Any] | None:
    """Whether the views of multi-mesh that were ``scored`` keep what the dataset promises; None where it was not compared.

    A view counts where its cell promises something, and breaks the promise where a wrong region is thicker than T + 2 pixels
    (:func:`promised_thickness`; on a display that sees farther that is not promised), or a surface is displaced by more than T.
    With ``glint`` or ``movers``, which are not part of the promise, no view counts.
    """
    if scene.built is None or not scored:
        return None
    source = source_of(scene)
    thickness, threshold = source["promised_px"], source["max_error_px"]
    promising = {one.id for one in scene.built.manifest.cells if one.promised_error_px is not None}
    counted = [] if glint or movers else [one.errors for one in scored if one.cell in promising]
    broken = [
        one
        for one in counted
        if one.displacement_max_px > threshold + _ROUNDING_PX
        or (thickness is not None and one.thickness_px > thickness + _ROUNDING_PX)
    ]
    if counted:
        why = None
    elif glint or movers:
        why = f"{'windows that mirror the sun' if glint else 'objects that move'} are no part of what is promised"
    elif not promising:
        why = "no cell promises anything"
    else:
        why = "no view is in a cell that promises something"
    found: dict[str, Any] = {
        "kept": not broken if counted else None,
        "views": len(counted),
        "broken": len(broken),
        "other_views": len(scored) - len(counted),
        "thickness_px": max((one.thickness_px for one in counted), default=None),
        "displacement_px": max((one.displacement_max_px for one in counted), default=None),
        "why": why,
    }
    return found | {"line": _verdict_line(found, thickness, threshold)}


def _verdict_line(found: dict[str, Any], thickness: float | None, threshold: float) -> str:
    """The verdict in one line."""
    if found["kept"] is None:
        return f"promise not checked: {found['why']}"
    views = f"{found['views']:,} {'view' if found['views'] == 1 else 'views'}"
    region = f"worst region {found['thickness_px']:.3g} px "
    if thickness is None:
        region += "(nothing promised on a display that sees farther)"
    else:
        region += f"({'T + 2 =' if math.isclose(thickness, threshold + 2.0) else 'promised'} {thickness:.3g})"
    measures = f"{region}, displacement {found['displacement_px']:.3g} px (T = {threshold:.3g})"
    if found["kept"]:
        text = f"promise kept: {measures}, {views}"
    else:
        text = f"promise BROKEN in {found['broken']:,} of {views}: {measures}"
    if found["other_views"]:
        text += f"; {found['other_views']:,} more in cells that promise nothing"
    return text
