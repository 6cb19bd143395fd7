"""Walking through a dataset of multi-mesh impostors, and measuring what a viewer sees.

Compare techniques with the geometry (:func:`compare_views`, :func:`compare_walk`), walk through a dataset in a notebook
(:func:`show_in_notebook`), or put a walk together: a scene (:func:`open_scene`), a technique (:func:`make_technique`), a cache
(:func:`cell_cache`), a :class:`Renderer`, and the :class:`FrameLoop`. The packages, from the ground up: plan, walks, scene,
cells, casting, techniques, drawing, measuring, runtime, report, window, serving, programs.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

from mmi.foundation.lazy_names import lazy_names

if TYPE_CHECKING:
    from mmi.walks.walk import Keyframe, Pose, Walk, read_walk, write_walk
    from viewer.caching.rules import CacheRules
    from viewer.casting.rules import CastRules
    from viewer.cells.scene_cache import cell_cache
    from viewer.computed import CAST_PIXEL, CastPixels, WarpedPicture, WarpedSamples
    from viewer.drawing.renderer import Renderer
    from viewer.plan import (
        Budget,
        CellKey,
        CellLayers,
        Costs,
        Done,
        Draw,
        Faces,
        Ground,
        ImageKey,
        Moving,
        Nailboards,
        Objects,
        Plan,
        Relief,
        ReliefPart,
        Request,
        Sky,
        Slot,
        Technique,
        Work,
    )
    from viewer.report.compare import compare_views, compare_walk
    from viewer.report.options import CompareOptions
    from viewer.runtime.calibration import calibrated
    from viewer.runtime.loop import FrameLoop, FrameTimes, replay
    from viewer.scene.scene import WalkScene, open_scene, scene_of_city
    from viewer.serving.notebook import show_in_notebook
    from viewer.techniques.catalogue import TECHNIQUES, TechniqueRules, make_technique
    from viewer.techniques.virtual_frames import FrameRules
    from viewer.walks.random_views import random_views
    from viewer.walks.tour import tour

__all__ = [
    "CAST_PIXEL",
    "TECHNIQUES",
    "Budget",
    "CacheRules",
    "CastPixels",
    "CastRules",
    "CellKey",
    "CellLayers",
    "CompareOptions",
    "Costs",
    "Done",
    "Draw",
    "Faces",
    "FrameLoop",
    "FrameRules",
    "FrameTimes",
    "Ground",
    "ImageKey",
    "Keyframe",
    "Moving",
    "Nailboards",
    "Objects",
    "Plan",
    "Pose",
    "Relief",
    "ReliefPart",
    "Renderer",
    "Request",
    "Sky",
    "Slot",
    "Technique",
    "TechniqueRules",
    "Walk",
    "WalkScene",
    "WarpedPicture",
    "WarpedSamples",
    "Work",
    "calibrated",
    "cell_cache",
    "compare_views",
    "compare_walk",
    "make_technique",
    "open_scene",
    "random_views",
    "read_walk",
    "replay",
    "scene_of_city",
    "show_in_notebook",
    "tour",
    "write_walk",
]

_HOMES = MappingProxyType(
    {
        "viewer.caching.rules": ("CacheRules",),
        "viewer.casting.rules": ("CastRules",),
        "viewer.cells.scene_cache": ("cell_cache",),
        "viewer.drawing.renderer": ("Renderer",),
        "viewer.computed": ("CAST_PIXEL", "CastPixels", "WarpedPicture", "WarpedSamples"),
        "viewer.plan": (
            "Budget",
            "CellKey",
            "CellLayers",
            "Costs",
            "Done",
            "Draw",
            "Faces",
            "Ground",
            "ImageKey",
            "Moving",
            "Nailboards",
            "Objects",
            "Plan",
            "Relief",
            "ReliefPart",
            "Request",
            "Sky",
            "Slot",
            "Technique",
            "Work",
        ),
        "viewer.report.compare": ("compare_views", "compare_walk"),
        "viewer.report.options": ("CompareOptions",),
        "viewer.runtime.calibration": ("calibrated",),
        "viewer.runtime.loop": ("FrameLoop", "FrameTimes", "replay"),
        "viewer.scene.scene": ("WalkScene", "open_scene", "scene_of_city"),
        "viewer.serving.notebook": ("show_in_notebook",),
        "viewer.techniques.catalogue": ("TECHNIQUES", "TechniqueRules", "make_technique"),
        "viewer.techniques.virtual_frames": ("FrameRules",),
        "viewer.walks.random_views": ("random_views",),
        "viewer.walks.tour": ("tour",),
        "mmi.walks.walk": ("Keyframe", "Pose", "Walk", "read_walk", "write_walk"),
    }
)

__getattr__ = lazy_names("viewer", _HOMES)


def __dir__() -> list[str]:
    return __all__
