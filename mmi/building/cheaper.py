"""What costs less as geometry than as a layer, found once a cell's layers are there (``geometry`` of the parameters).

Plain prisms have so few triangles that the mesh of a layer may have more than all that it shows. What is in such a layer stays
geometry, which leaves less that can be wrong. A layer is held against its objects by triangles and texels. What its files take
is known for a cell as a whole only, and so is the draw that a cell without layers saves: whole cells are held against their
geometry by the figures of their entries in the manifest (:func:`cheaper_as_geometry`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from mmi.building.halving import exceeded
from mmi.capture.layer_values import Layer
from mmi.dataset.manifest import CellEntry
from mmi.planning.frame_costs import FrameLoad
from mmi.planning.parameters import BuildParameters
from mmi.planning.plan import CellPlan, PreparedCity, without_layers

__all__ = ["cheaper_as_geometry", "without_dear_layers"]


def without_dear_layers(
    prepared: PreparedCity, plan: CellPlan, layers: Sequence[Layer]
) -> tuple[CellPlan, list[Layer]]:
    """The plan and its captured ``layers`` without those that cost more than what is in them; the rest numbered anew."""
    costs, counts = prepared.parameters.costs, prepared.mesh.triangle_counts
    dear = set()
    for index, objects in enumerate(plan.layers):
        own = [one for one in layers if one.index == index]
        triangles = sum(len(one.mesh.triangles) for one in own)
        layer = FrameLoad(triangles, 0, sum(one.texture.depth.size for one in own))
        if layer.cost(costs) >= FrameLoad(int(counts[objects].sum()), 0).cost(costs):
            dear.add(index)
    kept = [index for index in range(len(plan.layers)) if index not in dear]
    numbers = {index: number for number, index in enumerate(kept)}
    left = [replace(one, index=numbers[one.index]) for one in layers if one.index in numbers]
    return without_layers(plan, dear), left


def cheaper_as_geometry(parameters: BuildParameters, entry: CellEntry) -> bool:
    """Whether a cell with this entry is to be stored as geometry: that costs less, and no budget forbids it."""
    frame = entry.frame
    less = parameters.geometry == "cheaper" and entry.pictures and frame.geometry.cost < frame.layers.cost
    return bool(less) and not exceeded(parameters, layers=0, triangles=frame.geometry.triangles)
