"""Geometry of the city: some of its objects, or some triangles whatever they belong to, perhaps clipped to a box."""

from __future__ import annotations

from typing import Any

import numpy as np

from mmi.appearance.city_mesh import CityMesh
from mmi.foundation.camera import View
from viewer.drawing.kinds.lines import LineProgram
from viewer.drawing.kinds.meshes import DrawnMesh, MeshProgram
from viewer.drawing.programs import Programs
from viewer.drawing.style import NEAR_LINES
from viewer.plan import Faces, Objects

__all__ = ["ObjectsDrawer"]

_CLIP_DISTANCES = tuple(range(0x3000, 0x3006))
"""GL_CLIP_DISTANCE0 and the five after it."""


class ObjectsDrawer:
    """Draws :class:`viewer.plan.Objects` and :class:`viewer.plan.Faces` of the city's mesh."""

    def __init__(self, programs: Programs, program: MeshProgram, mesh: CityMesh) -> None:
        owners = np.repeat(np.arange(len(mesh.triangle_counts)), np.diff(mesh.object_vertices))
        self._made_by, self._context, self._program = programs, programs.context, program
        self._mesh = DrawnMesh(programs.context, program, mesh, owners)
        self._clipped: MeshProgram | None = None

    @property
    def texture(self) -> Any:  # noqa: ANN401
        """The city's texture, for others that show its surfaces."""
        return self._mesh.texture

    def draw(self, draw: Objects, *, measured: bool) -> list[int]:
        """Draw all objects of the set with one call, or none where they have no triangles."""
        return self._mesh.draw(draw.key, draw.objects, measured=measured)

    def draw_faces(self, draw: Faces, view: View, *, measured: bool) -> list[int]:
        """Draw all triangles of the set with one call, none where there are none."""
        if draw.clip is None:
            return self._mesh.draw_faces(draw.key, draw.triangles, measured=measured)
        if self._clipped is None:
            flags = {"glint": self._program.glint, "cut_outs": self._program.cut_outs}
            self._clipped = MeshProgram.made_by(self._made_by, **flags, clipped=True)
        low, high = (draw.clip - view.eye).astype("<f4")
        self._clipped.programs[measured].set({"low": low.tobytes(), "high": high.tobytes()})
        for one in _CLIP_DISTANCES:
            self._context.enable_direct(one)
        try:
            return self._mesh.draw_faces(draw.key, draw.triangles, measured=measured, program=self._clipped)
        finally:
            for one in _CLIP_DISTANCES:
                self._context.disable_direct(one)

    def draw_lines(self, draw: Objects, program: LineProgram, *, measured: bool) -> None:
        """Draw the edges of all objects of the set."""
        self._mesh.draw_lines(draw.key, draw.objects, program, ink=NEAR_LINES, measured=measured)
