"""Near and far geometry: which of the visible objects stay geometry (paper section 5.4, figure 8).

Objects stay geometry for what a picture of them would get wrong (:func:`near_by_parallax`), or for being close: distances
are from the footprint to the cell's rectangle in the ground plane, so that what is near is near from wherever the viewer
may be. All are extractors (paper figure 6): they add to a selection's near objects and never remove one.

A *near stage* is a function that makes one extractor of :class:`NearSettings`, once for all cells of a city: those of
this module are :func:`near_stage_by_parallax` and :func:`near_stage_by_distance`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from mmi.foundation.errors import ParameterError
from mmi.parallax.critical_zone import cell_region
from mmi.parallax.self_parallax import self_parallax
from mmi.planning.parameters import BuildParameters
from mmi.visibility.selection import Extractor, Selection, chain
from mmi.visibility.walls import Walls

__all__ = [
    "ALWAYS_NEAR",
    "NearSettings",
    "cell_distances",
    "near_by_distance",
    "near_by_parallax",
    "near_by_slope",
    "near_by_triangles",
    "near_stage_by_distance",
    "near_stage_by_parallax",
]

ALWAYS_NEAR = 4.0
"""Metres: what is closer to the cell than this is geometry whatever the triangle budget; a viewer could touch it."""


@dataclass(frozen=True, slots=True, eq=False)
class NearSettings:
    """What a near stage is told: the build's parameters, and of the city its walls, how many triangles each object has
    (``triangle_counts`` (n_objects,)), and the factors of its landmarks (object -> factor).
    """

    parameters: BuildParameters
    walls: Walls
    triangle_counts: NDArray[np.int64]
    landmarks: Mapping[int, float]


def near_stage_by_distance(settings: NearSettings) -> Extractor:
    """Near is what is close (within a distance, or a budget of triangles) or rises steeply. Keeps no bound on the error."""
    parameters = settings.parameters
    steep = near_by_slope(parameters.steepest)
    if parameters.near_triangles is None:
        return chain(near_by_distance(parameters.near_distance), steep)
    budget = near_by_triangles(parameters.near_triangles, settings.triangle_counts)
    return chain(budget, near_by_distance(ALWAYS_NEAR), steep)


def near_stage_by_parallax(settings: NearSettings) -> Extractor:
    """Near is also what may show more of itself than the threshold that a picture of it misses."""
    parameters = settings.parameters
    texel = 1.0 / parameters.camera.focal
    parallax = near_by_parallax(settings.walls, parameters.max_angle, texel=texel, factors=settings.landmarks)
    return chain(near_stage_by_distance(settings), parallax)


def near_by_distance(distance: float) -> Extractor:
    """Near is what comes within ``distance`` metres of the cell's rectangle (0: what touches or overlaps it).

    Raises ParameterError for a distance that is negative or not finite.
    """
    if not (math.isfinite(distance) and distance >= 0.0):
        raise ParameterError(f"the near distance needs to be 0 m or more, found {distance!r}")

    def extract(selection: Selection) -> Selection:
        return _with_near(selection, selection.objects[cell_distances(selection) <= distance])

    return extract


def near_by_slope(steepest: float) -> Extractor:
    """Near is what rises above ``steepest`` (height over distance) as seen from the closest point of the cell.

    Towers overhead would need a capture as tall as the tangent of their elevation. Raises ParameterError for a slope
    that is not positive.
    """
    if not steepest > 0.0:
        raise ParameterError(f"the steepest slope of far objects needs to be positive, found {steepest!r}")

    def extract(selection: Selection) -> Selection:
        tops = np.array([selection.city.objects[i].top for i in selection.objects])
        rises = tops - selection.cell.eye[0]
        return _with_near(selection, selection.objects[rises > steepest * cell_distances(selection)])

    return extract


def near_by_parallax(
    walls: Walls, threshold: float, *, texel: float, factors: Mapping[int, float] | None = None
) -> Extractor:
    """Near is what may show more than ``threshold`` radians of itself that a picture from the reference viewpoint misses.

    ``walls`` are those of the selection's city, ``texel`` is the angle of a texel in radians
    (:func:`mmi.parallax.self_parallax.self_parallax`); ``factors`` (object -> factor) raise what landmarks miss.
    """

    def extract(selection: Selection) -> Selection:
        far = selection.far
        missed = self_parallax(selection.city, selection.cell, walls, far, selection.wall_visibility, texel=texel)
        raised = np.array([(factors or {}).get(int(i), 1.0) for i in far])
        parallax = np.full(len(selection.objects), math.inf)
        parallax[np.searchsorted(selection.objects, far)] = missed
        return replace(_with_near(selection, far[missed * raised > threshold]), parallax=parallax)

    return extract


def near_by_triangles(budget: int, triangles: ArrayLike) -> Extractor:
    """Near are the nearest objects, as many as ``budget`` triangles draw; ``triangles`` (n_objects,) counts each object's.

    Ties in distance go to the lower index. The first object that no longer fits ends the near geometry, even if a
    farther one would fit: near is a neighbourhood, not a knapsack. Raises ParameterError for a negative budget, and
    ValueError where ``triangles`` does not fit the city.
    """
    if budget < 0:
        raise ParameterError(f"the near triangle budget needs to be 0 or more, found {budget!r}")
    counts = np.array(triangles, dtype=np.int64)

    def extract(selection: Selection) -> Selection:
        if counts.shape != (len(selection.city.objects),):
            raise ValueError(
                f"one triangle count per object expected ({len(selection.city.objects)}), found {counts.shape}"
            )
        nearest = selection.objects[np.argsort(cell_distances(selection), kind="stable")]
        return _with_near(selection, nearest[np.cumsum(counts[nearest]) <= budget])

    return extract


def cell_distances(selection: Selection) -> NDArray[np.float64]:
    """(n,) metres from each selected object's footprint to the cell's rectangle."""
    region = cell_region(selection.cell)
    footprints = [selection.city.objects[i].footprint for i in selection.objects]
    return np.asarray(shapely.distance(footprints, region), dtype=np.float64)


def _with_near(selection: Selection, more: NDArray[np.int64]) -> Selection:
    return replace(selection, near=np.concatenate([selection.near, more]))
