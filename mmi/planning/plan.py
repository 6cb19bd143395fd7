"""From a city to the plan of a cell's impostor, told top to bottom (paper figure 6).

:func:`prepare_city` makes ready what all cells share. :func:`plan_cell` decides: what is visible from a cell, what of it stays
geometry, which of the rest can share a layer. Plans are captured and meshed by :mod:`mmi.building.cell`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import CityMesh, build_city_mesh
from mmi.cells.viewing_cells import ViewingCell
from mmi.city.model import City
from mmi.foundation.errors import ParameterError
from mmi.parallax.paper_weights import critical_zone_weights
from mmi.parallax.ray_weights import same_ray_weights
from mmi.planning.layering import assign_layers, boxes_of, event_graph
from mmi.planning.parameters import BuildParameters
from mmi.planning.rehearsal import rehearse
from mmi.planning.segmentation import near_by_distance, near_by_parallax, near_by_slope, near_by_triangles
from mmi.visibility.horizon import horizon_extractor, prepare_horizon
from mmi.visibility.item_buffer import Identify, item_buffer_extractor
from mmi.visibility.selection import Extractor, Selection, chain, everything
from mmi.visibility.walls import Walls, walls_of

if TYPE_CHECKING:
    pass

from mmi.foundation.stopwatch import Stopwatch

__all__ = ["CellPlan", "PreparedCity", "landmark_factors", "plan_cell", "prepare_city"]

_ALWAYS_NEAR = 4.0
"""Metres: what is closer to the cell than this is geometry whatever the triangle budget; a viewer could touch it."""
_FINEST_QUAD = 8
"""Texels: rays this close to each other count as one, since a mesh connects them."""


_COLUMNS = 30_000
"""Of rehearsed pictures, around the cell, at most."""
_REHEARSED = 10.0
"""Pixels of rehearsed pictures that a threshold is at most."""


@dataclass(frozen=True, slots=True, eq=False)
class PreparedCity:
    """What all cells of a city share, prepared once: geometry, walls, and the pipeline's first two extractors.

    ``visible`` is None where visibility needs a renderer (the item buffer).
    """

    city: City
    parameters: BuildParameters
    mesh: CityMesh
    walls: Walls
    visible: Extractor | None
    near: Extractor
    landmarks: dict[int, float]


@dataclass(frozen=True, slots=True, eq=False)
class CellPlan:
    """What :func:`plan_cell` decided for a cell.

    ``pairs`` (m, 2) are indices into the city's objects of far objects that can overlap in the image, ``weights`` (m,)
    their weights in radians (landmark factors not applied); ``graph`` is the graph of visibility events above the threshold;
    ``layers`` are its colours: arrays of object indices; ``missed`` is how thick a region they may miss together, in pixels,
    where that is bounded (:mod:`mmi.planning.rehearsal`).
    """

    selection: Selection
    pairs: NDArray[np.int64]
    weights: NDArray[np.float64]
    graph: nx.Graph
    layers: tuple[NDArray[np.int64], ...]
    missed: float | None


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


def prepare_city(city: City, parameters: BuildParameters) -> PreparedCity:
    """Prepare ``city``, whose long objects are cut already (:mod:`mmi.city.long_objects`), for planning and capturing its
    cells.

    Raises ParameterError for a landmark that is not there.
    """
    landmarks = landmark_factors(city, parameters)
    mesh, walls = build_city_mesh(city), walls_of(city)
    if parameters.near_triangles is None:
        nearby = near_by_distance(parameters.near_distance)
    else:
        nearby = chain(
            near_by_triangles(parameters.near_triangles, mesh.triangle_counts), near_by_distance(_ALWAYS_NEAR)
        )
    stages = [nearby, near_by_slope(parameters.steepest)]
    if parameters.weights == "same-ray":
        texel = 1.0 / parameters.camera.focal
        stages.append(near_by_parallax(walls, parameters.max_angle, texel=texel, factors=landmarks))
    return PreparedCity(
        city=city,
        parameters=parameters,
        mesh=mesh,
        walls=walls,
        visible=horizon_extractor(prepare_horizon(city)) if parameters.visibility == "horizon" else None,
        near=chain(*stages),
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
    with watch.stage("segmentation"):
        selection = prepared.near(selection)
    far = selection.far
    objects = [prepared.city.objects[i] for i in far]
    with watch.stage("weights"):
        if parameters.weights == "same-ray":
            quad = _FINEST_QUAD / parameters.camera.focal
            pairs, weights = same_ray_weights(cell, prepared.walls, far, selection.wall_visibility, quad=quad)
        else:
            signed = parameters.weights == "critical-zone"
            pairs, weights = critical_zone_weights(cell, objects, signed=signed)
    with watch.stage("layering"):
        factors = {int(i): prepared.landmarks[i] for i in far if i in prepared.landmarks}
        graph = event_graph(far, pairs, weights, threshold=parameters.max_angle, factors=factors)
        boxes = boxes_of(cell.reference, objects)
        layers = assign_layers(graph, boxes, strategy=parameters.layering)
    plan = CellPlan(selection, far[pairs], weights, graph, layers, None)
    if not parameters.bounded:
        return plan
    with watch.stage("rehearsal"):
        return _rehearsed(prepared, plan)


def _rehearsed(prepared: PreparedCity, plan: CellPlan) -> CellPlan:
    """The plan with those far objects made near of which its layers together would miss too much."""
    parameters, selection = prepared.parameters, plan.selection
    width, height = parameters.camera.border_pixel
    # Display pixels that are one here.
    coarse = max(parameters.max_error_px / _REHEARSED, 2.0 * math.pi / (_COLUMNS * width), 1.0)
    found = rehearse(
        selection.cell,
        prepared.walls,
        selection.objects,
        plan.layers,
        selection.wall_visibility,
        pixel=(coarse * width, coarse * height),
        limit=parameters.max_error_px / coarse,
    )
    demoted, missed = found.demoted, coarse * found.thickness
    graph = plan.graph.copy()
    graph.remove_nodes_from(demoted.tolist())
    pairs = ~np.isin(plan.pairs, demoted).any(axis=1)
    layers = (np.setdiff1d(layer, demoted, assume_unique=True) for layer in plan.layers)
    return replace(
        plan,
        selection=replace(selection, near=np.concatenate([selection.near, demoted])),
        pairs=plan.pairs[pairs],
        weights=plan.weights[pairs],
        graph=graph,
        layers=tuple(layer for layer in layers if layer.size),
        missed=missed,
    )
