"""One cell from plan to impostor (paper sections 4 and 5.1): layers are captured into depth textures, and these are meshed."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from mmi.capture.covered_parts import covered_parts
from mmi.capture.layer_values import Impostor, Layer
from mmi.capture.rims import touching, with_rims
from mmi.capture.unseen import without_unseen
from mmi.capture.windows import layer_views
from mmi.cells.viewing_cells import ViewingCell
from mmi.foundation.stopwatch import Stopwatch
from mmi.meshing.displacement import displacement
from mmi.meshing.grid_mesh import grid_mesh
from mmi.planning.plan import CellPlan, PreparedCity, plan_cell

if TYPE_CHECKING:
    from mmi.capture.renderer import Capturer

__all__ = ["build_cell", "capture_layers"]

_MESH_SHARE = 0.5
"""Of the threshold: what a mesh may displace where depth does not jump."""

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
    with watch.stage("windows"):
        pairs = touching(prepared.city, plan.selection.objects)
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
        textures = capturer.captures(objects, from_here, supersample=parameters.supersample)
        ends = pairs[np.isin(pairs[:, 0], objects) & ~np.isin(pairs[:, 1], objects)]
        rims = capturer.captures(np.unique(ends[:, 1]), from_here)  # a texel wide: no subsamples
        for sector, _ in views:
            with watch.stage("capture"):
                whole, rim = next(textures), next(rims, None)
            with watch.stage("meshing"):
                if wall_visibility is not None:
                    whole = without_unseen(whole, prepared.walls, wall_visibility)
                if rim is not None:
                    whole = with_rims(whole, rim, ends, viewpoints=viewpoints, tolerance=tolerance)
                parts = covered_parts(whole, quad=parameters.quad, half_width=half_width)
            del whole, rim
            for part, texture in enumerate(parts):
                with watch.stage("meshing"):
                    mesh = grid_mesh(texture, viewpoints=viewpoints, tolerance=_MESH_SHARE * parameters.max_angle)
                    shown = objects[np.isin(objects, texture.object_ids, kind="table")]
                    displaced = displacement(texture, mesh, viewpoints)
                yield Layer(index, sector, part, shown, texture, mesh, displaced)
        textures.close()
        rims.close()


def build_cell(
    prepared: PreparedCity, cell: ViewingCell, capturer: Capturer, *, watch: Stopwatch | None = None
) -> Impostor:
    """A cell's multi-mesh impostor (paper section 4), its layers sorted by sector."""
    plan = plan_cell(prepared, cell, identify=capturer.identify, watch=watch)
    layers = capture_layers(prepared, plan, capturer, watch=watch)
    by_sector = tuple(sorted(layers, key=lambda layer: (layer.sector, layer.index, layer.part)))
    return Impostor(cell, plan.selection.near, plan.selection.far, by_sector)
