"""Why a build decided what it did: cells planned again, and what a plan says of an object in words. Plain data for JSON.

The dataset keeps what the plan of a cell led to; weights and reasons it does not keep.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mmi.appearance.city_mesh import CityMesh
from mmi.building.planned_again import planned_again, prepared_again
from mmi.dataset.city_files import read_city_mesh
from mmi.dataset.reading import Dataset
from mmi.foundation.camera import Camera
from mmi.planning.plan import CellPlan, PreparedCity
from mmi.planning.reasons import NearReason, near_reasons

__all__ = ["Explainer", "explanation"]

_MOST_PLANS = 8
_MOST_NEIGHBOURS = 12
_STEEPEST = math.radians(80.0)
"""Angles beyond count as this when they are told in pixels."""


class Explainer:
    """Plans cells of a ``dataset`` again and explains them. The city is read and prepared with the first question; the plans
    of the cells that were asked about last are kept.
    """

    def __init__(self, dataset: Dataset) -> None:
        self._dataset = dataset
        self._prepared: PreparedCity | None = None
        self._plans: dict[str, CellPlan] = {}

    def prepare(self) -> None:
        """Prepare the city ahead of the first question. Raises what :meth:`explain` does."""
        self._city()

    def explain(self, cell: str, index: int) -> dict[str, Any]:
        """What :func:`explanation` says of object ``index`` in ``cell``.

        Raises DatasetError where the dataset is damaged or was built by another version.
        """
        prepared = self._city()
        if cell not in self._plans:
            plan = planned_again(self._dataset, prepared, self._dataset.cell(cell))
            while len(self._plans) >= _MOST_PLANS:
                self._plans.pop(next(iter(self._plans)))
            self._plans[cell] = plan
        return explanation(prepared, self._plans[cell], index)

    def _city(self) -> PreparedCity:
        if self._prepared is None:
            city = self._dataset.city()
            counted = self._dataset.manifest.parameters.near_triangles is not None
            mesh = read_city_mesh(self._dataset)[0] if counted else _no_mesh(len(city.objects))
            self._prepared = prepared_again(self._dataset, city, mesh=mesh)
        return self._prepared


def explanation(prepared: PreparedCity, plan: CellPlan, index: int) -> dict[str, Any]:
    """What ``plan`` says of object ``index``, as plain data.

    ``kept``: what the dataset keeps of it. ``why``: ``answer`` in words, ``reasons`` for being near, ``layer`` and the
    ``neighbours`` that weigh most, heaviest first, of ``weighed``; weights in pixels of the display, ``apart`` where the two
    must not share a layer because their weight is above ``threshold_px``; ``missed_px`` is what a picture of a far object
    misses of it at most, None where that is not known.
    """
    selection, parameters = plan.selection, prepared.parameters
    why: dict[str, Any] = {"planned": True, "threshold_px": parameters.max_error_px, "reasons": [], "neighbours": []}
    if index in selection.near:
        reasons = near_reasons(prepared, plan, index)
        why["reasons"] = [_reason(one, parameters.camera) for one in reasons]
        why["answer"] = f"It stays geometry: {'; and '.join(one['text'] for one in why['reasons'])}."
    elif index in selection.far:
        why |= _weighed(prepared, plan, index)
    else:
        why["answer"] = (
            "Nothing of it can be seen from this cell, which therefore has neither geometry nor a layer of it."
        )
    return {"why": why, "kept": _kept(prepared, index)}


def _weighed(prepared: PreparedCity, plan: CellPlan, index: int) -> dict[str, Any]:
    """The layer of a far object, and what it is weighed against."""
    camera = prepared.parameters.camera
    layer_of = {int(one): layer for layer, members in enumerate(plan.layers) for one in members}
    own = (plan.pairs == index).any(axis=1)
    others, weights = plan.pairs[own].sum(axis=1) - index, plan.weights[own]
    factors = np.array([prepared.landmarks.get(int(one), 1.0) for one in others])
    weights = weights * factors * prepared.landmarks.get(index, 1.0)
    apart = [plan.graph.has_edge(index, int(one)) for one in others]
    neighbours = [
        {
            "id": prepared.city.objects[int(others[i])].id,
            "weight_px": round(_pixels(float(weights[i]), camera), 2),
            "apart": apart[i],
            "layer": layer_of.get(int(others[i])),
        }
        for i in np.argsort(-weights, kind="stable")[:_MOST_NEIGHBOURS].tolist()
    ]
    layer, threshold = layer_of.get(index), prepared.parameters.max_error_px
    rest = (
        f"of the {len(others)} far objects that it can overlap, {sum(apart)} weigh more than {threshold:g} px with it"
    )
    answer = (
        f"It is in layer {layer} of {len(plan.layers)} (from 0): {rest} and are in other layers."
        if any(apart)
        else f"It is in layer {layer} of {len(plan.layers)} (from 0): {rest}, so that it may share a layer with any of them."
    )
    parallax = None
    if plan.selection.parallax is not None:
        missed = float(plan.selection.parallax[np.searchsorted(plan.selection.objects, index)])
        parallax = round(_pixels(missed, camera), 2)
    return {
        "layer": layer,
        "neighbours": neighbours,
        "weighed": len(others),
        "apart": sum(apart),
        "missed_px": parallax,
        "answer": answer,
    }


def _reason(reason: NearReason, camera: Camera) -> dict[str, Any]:
    """A reason in words and numbers."""
    found, limit = reason.found, reason.limit
    if reason.rule == "parallax":
        found, limit = _pixels(found, camera), _pixels(limit, camera)
    text = {
        "distance": f"it comes within {found:.1f} m of the cell, and up to {limit:g} m is near",
        "budget": f"it is among the nearest objects, which are near as long as they have {limit:.0f} triangles or fewer",
        "slope": f"its top rises {found:.2f} times as high as it is far from the cell, and above {limit:g} times is near",
        "parallax": f"from within the cell it may show {found:.1f} px of itself that a picture of it misses, "
        f"more than {limit:.1f} px",
        "layers": "all layers together would miss a region thicker than "
        f"{limit:g} px, and it has the largest part of that",
        "cost": "the layer that it would be in costs more to draw than all that is in it",
        "own": "a function from outside the package decides so",
    }[reason.rule]
    numbers = {
        name: round(value, 3) if math.isfinite(value) else None for name, value in (("found", found), ("limit", limit))
    }
    return {"rule": reason.rule, **numbers, "text": text}


def _kept(prepared: PreparedCity, index: int) -> dict[str, Any]:
    """What the dataset keeps of an object."""
    one = prepared.city.objects[index]
    return {
        "part_of": one.part_of,
        "base_m": round(one.base, 2),
        "top_m": round(one.top, 2),
        "height_m": round(one.height, 2),
        "footprint_m2": round(float(one.footprint.area), 1),
        "solids": len(one.prisms),
        "detailed": one.mesh is not None,
    }


def _no_mesh(objects: int) -> CityMesh:
    """A mesh of so many objects without triangles: most plans count none, and a detailed city's mesh takes long to read."""
    ends = np.zeros(objects + 1, dtype=np.int64)
    nothing = np.zeros((0, 3), dtype=np.float32)
    return CityMesh(
        positions=nothing,
        uv=np.zeros((0, 2), dtype=np.float32),
        colors=nothing.astype(np.uint8),
        triangles=nothing.astype(np.int32),
        object_vertices=ends,
        object_triangles=ends.copy(),
        texture=np.zeros((1, 1, 3), dtype=np.uint8),
    )


def _pixels(angle: float, camera: Camera) -> float:
    return float(camera.pixels_from_angle(min(angle, _STEEPEST)))
