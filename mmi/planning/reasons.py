"""Why objects stay geometry, told from a plan: which of the rules of near objects hold for one of them.

The stages that make objects near (:mod:`mmi.planning.segmentation`, :mod:`mmi.planning.rehearsal`) keep no record of why they
did. What they compared is found again here, with the limits that they compared it with.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mmi.planning.plan import CellPlan, PreparedCity
from mmi.planning.segmentation import ALWAYS_NEAR, cell_distances, near_by_triangles

__all__ = ["NearReason", "near_reasons"]


@dataclass(frozen=True, slots=True)
class NearReason:
    """A rule that makes an object near: ``found`` of it passes ``limit``.

    ``rule`` is one of ``distance`` (metres to the cell: at most the limit), ``budget`` (among the nearest objects, of which
    all together have at most so many triangles; ``found`` is the object's), ``slope`` (its rise over its distance: above the
    limit), ``parallax`` (radians of itself that a picture misses: above the limit), ``layers`` (the thickest region that all
    layers together would have missed was above the limit in pixels, and this object had the largest part of it; ``found`` is
    infinite, as it was not kept), ``cost`` (the layer that it would be in, or all layers, cost more than the geometry;
    no figures), ``own`` (a near stage from outside the package says so).
    """

    rule: str
    found: float
    limit: float


def near_reasons(prepared: PreparedCity, plan: CellPlan, index: int) -> tuple[NearReason, ...]:
    """All rules that make object ``index`` near in ``plan``. Raises ValueError for an object that is not near."""
    selection, parameters = plan.selection, prepared.parameters
    if index not in selection.near:
        raise ValueError(f"a near object of cell {selection.cell.id} expected, found {index}")
    if index in plan.cheaper:
        return (NearReason("cost", math.nan, math.nan),)
    if parameters.chosen_near_stage.version is not None:
        return (NearReason("own", math.nan, math.nan),)
    place = int(np.searchsorted(selection.objects, index))
    distance = float(cell_distances(selection)[place])
    rise = selection.city.objects[index].top - selection.cell.eye[0]
    reasons = []
    budget = parameters.near_triangles
    closest = parameters.near_distance if budget is None else ALWAYS_NEAR
    if distance <= closest:
        reasons.append(NearReason("distance", distance, closest))
    if budget is not None:
        counts = prepared.mesh.triangle_counts
        none = replace(selection, near=np.empty(0, dtype=np.int64))
        if index in near_by_triangles(budget, counts)(none).near:
            reasons.append(NearReason("budget", float(counts[index]), float(budget)))
    if rise > parameters.steepest * distance:
        reasons.append(NearReason("slope", rise / distance if distance > 0.0 else math.inf, parameters.steepest))
    if selection.parallax is not None and math.isfinite(selection.parallax[place]):
        missed = float(selection.parallax[place]) * prepared.landmarks.get(index, 1.0)
        if missed > parameters.max_angle:
            reasons.append(NearReason("parallax", missed, parameters.max_angle))
    return tuple(reasons) or (NearReason("layers", math.inf, parameters.max_error_px),)
