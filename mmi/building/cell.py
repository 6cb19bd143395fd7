"""One cell from plan to impostor (paper sections 4 and 5.1): layers are captured into depth textures, and these are meshed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import triangles_of
from mmi.building.cheaper import without_dear_layers
from mmi.capture.covered_pieces import covered_pieces
from mmi.capture.layer_values import DepthTexture, GridMesh, Impostor, Layer, Promise
from mmi.capture.rims import touching, with_rims
from mmi.capture.unseen import seen_of_meshes, without_unseen
from mmi.capture.windows import layer_views
from mmi.cells.viewing_cells import ViewingCell
from mmi.foundation.progress import Stopwatch
from mmi.meshing.displacement import displacement
from mmi.meshing.grid_mesh import grid_mesh
from mmi.meshing.ordering import CapturedLayer, out_of_order
from mmi.parallax.from_anywhere import viewers_of
from mmi.planning.mesh_rehearsal import MESH_VIEWPOINTS
from mmi.planning.parameters import BuildParameters
from mmi.planning.plan import CellPlan, PreparedCity, plan_cell

if TYPE_CHECKING:
    from mmi.capture.renderer import Capturer

__all__ = ["build_cell", "capture_cell", "capture_layers"]

_MESH_SHARES = (0.5, 0.25, 0.125)
"""Of the threshold: what a mesh may displace where depth does not jump, as cut at first, and where that is not enough."""

_WORTH_KNOWING = 0.25
"""Of the threshold: displacements that are surely less are not told apart."""

_RIM_SHARE = 0.25
"""Of the threshold: what a rim may be off the surface that it continues."""


def capture_layers(
    prepared: PreparedCity, plan: CellPlan, capturer: Capturer, *, watch: Stopwatch | None = None
) -> Iterator[Layer]:
    """The depth textures and grid meshes of a plan's layers, each sector of one after the other (paper section 5.1)."""
    parameters, watch, cell = prepared.parameters, watch or Stopwatch(), plan.selection.cell
    viewpoints = np.column_stack([cell.corners, np.full(4, cell.reference[2])])
    wall_visibility, half_width = plan.selection.wall_visibility, math.tan(math.pi / parameters.sectors)
    tolerance = _RIM_SHARE * parameters.max_angle
    samples = parameters.supersample if parameters.pictures == "all" else 1  # of colour, which meshes do not depend on
    with watch.stage("windows"):
        pairs = touching(prepared.city, plan.selection.objects)
        seen = None
        if wall_visibility is not None:
            seen = seen_of_meshes(prepared.city, cell, plan.selection.far, prepared.walls, wall_visibility)
    for index, objects in enumerate(plan.layers):
        with watch.stage("windows"):
            views = layer_views(
                prepared.walls,
                objects,
                cell,
                sectors=parameters.sectors,
                focal=parameters.camera.focal,
                quad=parameters.quad,
                wall_visibility=wall_visibility,
            )
        from_here = [view for _, view in views]
        detailed = any(prepared.city.objects[i].mesh is not None for i in objects)
        ends = pairs[np.isin(pairs[:, 0], objects) & ~np.isin(pairs[:, 1], objects)]
        with (
            closing(capturer.captures(objects, from_here, supersample=samples)) as textures,
            closing(capturer.captures(np.unique(ends[:, 1]), from_here)) as rims,  # a texel wide: no subsamples
        ):
            for sector, _ in views:
                with watch.stage("capture"):
                    whole, rim = next(textures), next(rims, None)
                with watch.stage("meshing"):
                    if seen is not None:
                        whole = without_unseen(whole, prepared.walls, seen)
                    if rim is not None:
                        whole = with_rims(whole, rim, ends, viewpoints=viewpoints, tolerance=tolerance)
                    pieces = covered_pieces(whole, quad=parameters.quad, half_width=half_width)
                for piece, texture in enumerate(pieces):
                    with watch.stage("meshing"):
                        mesh, displaced = _meshed(texture, cell, viewpoints, parameters, detailed=detailed)
                        shown = objects[np.isin(objects, texture.object_ids, kind="table")]
                    yield Layer(index, sector, piece, shown, texture, mesh, displaced)


def _meshed(
    texture: DepthTexture,
    cell: ViewingCell,
    viewpoints: NDArray[np.float64],
    parameters: BuildParameters,
    *,
    detailed: bool,
) -> tuple[GridMesh, float]:
    """The mesh of a picture, and an angle (radians) that no viewer in the cell sees any of it displaced by more than.

    Where something is to be bounded, that is the threshold at most, wherever tearing the mesh and cutting it finer can do it.
    Prisms show nothing that changes by more than the threshold from texel to texel and goes on: what is left of that is torn,
    unless there are ``detailed`` meshes, whose roofs do.
    """
    limit, viewers = parameters.max_angle, viewers_of(cell, texture.view)
    widest = limit if parameters.bounded else math.pi
    found: list[tuple[GridMesh, float]] = []
    for share in _MESH_SHARES if parameters.bounded else _MESH_SHARES[:1]:
        mesh = grid_mesh(
            texture,
            viewpoints=viewpoints,
            tolerance=share * limit,
            viewers=viewers,
            widest=widest,
            all_jumps=bool(found) and not detailed,
        )
        found.append((mesh, displacement(texture, mesh, viewers, least=_WORTH_KNOWING * limit)))
        if found[-1][1] <= limit:
            break
    return min(found, key=lambda one: one[1])


def capture_cell(
    prepared: PreparedCity, plan: CellPlan, capturer: Capturer, *, watch: Stopwatch | None = None
) -> Impostor:
    """The impostor that a plan describes, its triangles in the order in which they can be drawn.

    Where the parameters ask for it, it has no layers that cost more than what is in them (:mod:`mmi.building.cheaper`).
    """
    watch, selection = watch or Stopwatch(), plan.selection
    layers = list(capture_layers(prepared, plan, capturer, watch=watch))
    visible = int(prepared.mesh.triangle_counts[selection.objects].sum())
    if prepared.parameters.geometry == "cheaper":
        plan, layers = without_dear_layers(prepared, plan, layers)
        selection = plan.selection
    with watch.stage("ordering"):
        ordered = _in_order(prepared, plan, layers)
    return Impostor(
        cell=selection.cell,
        near=selection.near,
        far=selection.far,
        layers=ordered,
        sectors=prepared.parameters.sectors,
        near_triangles=int(prepared.mesh.triangle_counts[selection.near].sum()),
        visible_triangles=visible,
        promise=_promise(prepared, plan, ordered),
    )


def build_cell(
    prepared: PreparedCity, cell: ViewingCell, capturer: Capturer, *, watch: Stopwatch | None = None
) -> Impostor:
    """A cell's multi-mesh impostor (paper section 4)."""
    plan = plan_cell(prepared, cell, identify=capturer.identify, watch=watch)
    return capture_cell(prepared, plan, capturer, watch=watch)


def _in_order(prepared: PreparedCity, plan: CellPlan, layers: Sequence[Layer]) -> tuple[Layer, ...]:
    """The layers with the triangles last that need captured depths (:mod:`mmi.meshing.ordering`)."""
    cell, city = plan.selection.cell, prepared.city
    flags = out_of_order(
        [CapturedLayer(one.index, one.texture.view, one.mesh, one.texture.depth) for one in layers],
        max_angle=prepared.parameters.max_angle,
        eye_height=max(float(cell.reference[2] - city.ground_at(cell.reference)), 0.0),
        solids=prepared.mesh.positions[triangles_of(prepared.mesh, plan.selection.near)] - cell.reference,
        terrain=city.terrain,
    )
    ordered = []
    for layer, late in zip(layers, flags, strict=True):
        triangles = layer.mesh.triangles[np.argsort(late, kind="stable")]
        mesh = replace(layer.mesh, triangles=triangles)
        ordered.append(replace(layer, mesh=mesh, in_order=int(np.count_nonzero(~late))))
    return tuple(ordered)


def _promise(prepared: PreparedCity, plan: CellPlan, layers: Sequence[Layer]) -> Promise:
    """What can be promised of these layers: the threshold where all that is shown is bounded, else nothing."""
    parameters = prepared.parameters
    camera, limit = parameters.camera, parameters.max_error_px
    displaced = camera.pixels_from_angle(max((one.displacement for one in layers), default=0.0))
    withheld = None
    if not plan.layers:
        pass  # where all is geometry, nothing is wrong
    elif not parameters.bounded:
        withheld = f"weights {parameters.weights} with layering {parameters.layering} keep no bound"
    elif displaced > limit:
        withheld = f"a mesh may displace what it shows by {displaced:.1f} px, {limit:g} px were asked for"
    elif plan.missed is not None and plan.missed > limit:
        withheld = f"layers miss a region {plan.missed:.1f} px thick, {limit:g} px were asked for"
    elif plan.detailed:
        withheld = (
            f"detailed meshes are in sight: what layers miss is measured from {MESH_VIEWPOINTS} viewpoints, not bounded"
        )
    return Promise(
        error_px=limit if withheld is None else None,
        withheld=withheld,
        largest_weight_px=camera.pixels_from_angle(_largest_weight(plan)),
        missed_px=plan.missed,
        displacement_px=displaced,
    )


def _largest_weight(plan: CellPlan) -> float:
    """Radians: the largest weight of a pair that shares a layer, or self-parallax."""
    layer_of = {int(i): index for index, objects in enumerate(plan.layers) for i in objects}
    together = np.array([layer_of[int(a)] == layer_of[int(b)] for a, b in plan.pairs], dtype=bool)
    largest = float(np.max(plan.weights[together], initial=0.0))
    selection = plan.selection
    if selection.parallax is not None:
        largest = float(np.max(selection.parallax[np.isin(selection.objects, selection.far)], initial=largest))
    return largest
