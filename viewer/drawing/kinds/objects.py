"""Geometry of some of the city's objects."""

from __future__ import annotations

from typing import Any

import numpy as np

from mmi.appearance.city_mesh import CityMesh
from viewer.drawing.kinds.lines import LineProgram
from viewer.drawing.kinds.meshes import DrawnMesh, MeshProgram
from viewer.drawing.style import NEAR_LINES
from viewer.plan import Objects

__all__ = ["ObjectsDrawer"]


class ObjectsDrawer:
    """Draws :class:`viewer.plan.Objects` of the city's mesh."""

    def __init__(self, context: Any, program: MeshProgram, mesh: CityMesh) -> None:  # noqa: ANN401
        owners = np.repeat(np.arange(len(mesh.triangle_counts)), np.diff(mesh.object_vertices))
        self._mesh = DrawnMesh(context, program, mesh, owners)

    @property
    def texture(self) -> Any:  # noqa: ANN401
        """The city's texture, for others that show its surfaces."""
        return self._mesh.texture

    def draw(self, draw: Objects, *, measured: bool) -> list[int]:
        """Draw all objects of the set with one call, or none where they have no triangles."""
        return self._mesh.draw(draw.key, draw.objects, measured=measured)

    def draw_lines(self, draw: Objects, program: LineProgram, *, measured: bool) -> None:
        """Draw the edges of all objects of the set."""
        self._mesh.draw_lines(draw.key, draw.objects, program, ink=NEAR_LINES, measured=measured)
