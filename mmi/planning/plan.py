"""From a city to the plan of a cell's impostor, told top to bottom (paper figure 6).

:func:`prepare_city` makes ready what all cells share. :func:`plan_cell` decides: what is visible from a cell, what of it stays
geometry, which of the rest can share a layer. Plans are captured and meshed by :mod:`mmi.building.cell`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from typing import Any

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import CityMesh, build_city_mesh
from mmi.cells.viewing_cells import ViewingCell
from mmi.city.model import City
from mmi.foundation.errors import ParameterError
from mmi.foundation.progress import Stopwatch
from mmi.planning.choices import blaming, function_of
from mmi.planning.layering import assign_layers, boxes_of, event_graph
from mmi.planning.mesh_rehearsal import rehearse_meshes
from mmi.planning.parameters import BuildParameters
from mmi.planning.rehearsal import rehearse
from mmi.planning.segmentation import NearSettings
from mmi.planning.weighing import FarField, weigh
from mmi.visibility.horizon import horizon_extractor, prepare_horizon
from mmi.visibility.item_buffer import Identify, item_buffer_extractor
from mmi.visibility.selection import Extractor, Selection, everything
from mmi.visibility.walls import Walls, walls_of

__all__ = ["CellPlan", "PreparedCity", "landmark_factors", "plan_cell", "prepare_city", "without_layers"]

_COLUMNS = 30_000
"""A rehearsed picture has at most so many columns around the cell; pixels are made wider where it would have more."""
_MESH_COLUMNS = 8_000
"""The same where meshes are drawn, with a depth for every pixel of every layer."""
_REHEARSED = 10.0
"""In a rehearsed picture the threshold is at most so many pixels; pixels are made larger where it would be more."""


@dataclass(frozen=True, slots=True, eq=False)
class PreparedCity:
    """What all cells of a city share, prepared once: geometry, walls, and the pipeline's first two extractors.

    ``visible`` is None where visibility needs a renderer (the item buffer). ``weigh`` is the weight function
    (:mod:`mmi.planning.weighing`).
    """

    city: City
    parameters: BuildParameters
    mesh: CityMesh
    walls: Walls
    visible: Extractor | None
    near: Extractor
    weigh: Callable[..., Any]
    landmarks: dict[int, float]


@dataclass(frozen=True, slots=True, eq=False)
class CellPlan:
    """What :func:`plan_cell` decided for a cell.

    ``pairs`` (m, 2) are indices into the city's objects of far objects that can overlap in the image, ``weights`` (m,)
    their weights in radians (landmark factors not applied); ``graph`` is the graph of visibility events above the threshold;
    ``layers`` are its colours: arrays of object indices; ``missed`` is how thick a region they may miss together, in pixels,
    where that is bounded (:mod:`mmi.planning.rehearsal`), or measured (:mod:`mmi.planning.mesh_rehearsal`); ``cheaper`` (k,)
    are near objects whose layers cost more than they do (:func:`without_layers`).
    """

    selection: Selection
    pairs: NDArray[np.int64]
    weights: NDArray[np.float64]
    graph: nx.Graph
    layers: tuple[NDArray[np.int64], ...]
    missed: float | None
    cheaper: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    @property
    def detailed(self) -> bool:
        """Whether there are meshes in sight, near or far: objects that are not the prisms around them."""
        objects = self.selection.city.objects
        return any(objects[i].mesh is not None for i in self.selection.objects)


def landmark_factors(city: City, parameters: BuildParameters) -> dict[int, float]:
    """Index of each landmark, or of each of its parts -> its factor. Raises ParameterError for a landmark that is not there."""
    named: dict[str, list[int]] = {}
    for i, one in enumerate(city.objects):
        for name in {one.id, one.part_of or one.id}:
            named.setdefault(name, []).append(i)
    for name, _ in parameters.landmarks:
        if name not in named:
            raise ParameterError(f"landmark {name}: an object of {city.source} expected, found none of this id")
    return {i: factor for name, factor in parameters.landmarks for i in named[name]}


def prepare_city(city: City, parameters: BuildParameters, *, mesh: CityMesh | None = None) -> PreparedCity:
    """Prepare ``city``, whose long objects are cut already (:mod:`mmi.city.long_objects`), for planning and capturing its
    cells.

    ``mesh`` is the city's mesh where that is there already: for a detailed city, making it takes most of the time. Raises
    ParameterError for a landmark that is not there.
    """
    landmarks = landmark_factors(city, parameters)
    mesh, walls = build_city_mesh(city) if mesh is None else mesh, walls_of(city)
    near_stage = function_of(parameters.chosen_near_stage)
    with blaming(parameters.chosen_near_stage, what="near stage"):
        near = near_stage(NearSettings(parameters, walls, mesh.triangle_counts, landmarks))
    return PreparedCity(
        city=city,
        parameters=parameters,
        mesh=mesh,
        walls=walls,
        visible=horizon_extractor(prepare_horizon(city)) if parameters.visibility == "horizon" else None,
        near=near,
        weigh=function_of(parameters.chosen_weights),
        landmarks=landmarks,
    )


def plan_cell(
    prepared: PreparedCity, cell: ViewingCell, *, identify: Identify | None = None, watch: Stopwatch | None = None
) -> CellPlan:
    """Visible, near and far objects of a cell, and the layers of the far ones (paper sections 4.1, 4.2, 5.3, 5.4).

    ``identify`` draws the item buffer where ``parameters.visibility`` asks for it. Raises ParameterError if it is missing.
    """
    parameters, watch = prepared.parameters, watch or Stopwatch()
    visible = prepared.visible
    if visible is None:
        if identify is None:
            raise ParameterError("visibility by item buffer needs a renderer, found none")
        visible = item_buffer_extractor(identify, resolution=parameters.camera.width)
    with watch.stage("visibility"):
        selection = visible(everything(prepared.city, cell))
    with watch.stage("segmentation"), blaming(parameters.chosen_near_stage, what="near stage"):
        selection = prepared.near(selection)
    far = selection.far
    objects = [prepared.city.objects[i] for i in far]
    with watch.stage("weights"):
        field = FarField(prepared.city, cell, far, prepared.walls, selection.wall_visibility, parameters.camera)
        pairs, weights = weigh(parameters.chosen_weights, prepared.weigh, field)
    with watch.stage("layering"):
        factors = {int(i): prepared.landmarks[i] for i in far if i in prepared.landmarks}
        graph = event_graph(far, pairs, weights, threshold=parameters.max_angle, factors=factors)
        boxes = boxes_of(cell.reference, objects)
        layers = assign_layers(graph, boxes, strategy=parameters.chosen_layering)
    plan = CellPlan(selection, far[pairs], weights, graph, layers, None)
    if not parameters.bounded:
        return plan
    with watch.stage("rehearsal"):
        return _rehearsed(prepared, plan)


def _rehearsed(prepared: PreparedCity, plan: CellPlan) -> CellPlan:
    """The plan with those far objects made near of which its layers together would miss too much."""
    parameters, selection = prepared.parameters, plan.selection
    width, height = parameters.camera.border_pixel
    columns = _MESH_COLUMNS if plan.detailed else _COLUMNS
    # Display pixels that are one here.
    coarse = max(parameters.max_error_px / _REHEARSED, 2.0 * math.pi / (columns * width), 1.0)
    cell, objects, limit = selection.cell, selection.objects, parameters.max_error_px / coarse
    pixel = (coarse * width, coarse * height)
    if plan.detailed:
        found = rehearse_meshes(cell, prepared.mesh, objects, plan.layers, pixel=pixel, limit=limit)
    else:
        visibility = selection.wall_visibility
        found = rehearse(cell, prepared.walls, objects, plan.layers, visibility, pixel=pixel, limit=limit)
    return replace(_with_near(plan, found.demoted), missed=coarse * found.thickness)


def without_layers(plan: CellPlan, dropped: Collection[int]) -> CellPlan:
    """The plan without those of its layers (numbers): what is in them is near, since it costs less as geometry."""
    if not dropped:
        return plan
    objects = np.sort(np.concatenate([plan.layers[k] for k in sorted(dropped)]))
    left = _with_near(plan, objects)
    # Nothing is missed where everything is drawn.
    missed = plan.missed if left.layers or plan.missed is None else 0.0
    return replace(left, missed=missed, cheaper=np.union1d(plan.cheaper, objects))


def _with_near(plan: CellPlan, objects: NDArray[np.int64]) -> CellPlan:
    """The plan with some far objects near, and without the layers that have no others."""
    selection, graph = plan.selection, plan.graph.copy()
    graph.remove_nodes_from(objects.tolist())
    pairs = ~np.isin(plan.pairs, objects).any(axis=1)
    layers = (np.setdiff1d(layer, objects, assume_unique=True) for layer in plan.layers)
    return replace(
        plan,
        selection=replace(selection, near=np.concatenate([selection.near, objects])),
        pairs=plan.pairs[pairs],
        weights=plan.weights[pairs],
        graph=graph,
        layers=tuple(layer for layer in layers if layer.size),
    )
