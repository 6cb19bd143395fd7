"""Tiles of the ground, on a plain surface that has no end."""

from __future__ import annotations

from typing import Any

import numpy as np

from mmi.appearance.city_mesh import CityMesh
from viewer.drawing.backdrop import backdrop
from viewer.drawing.kinds.meshes import GROUND_ID, DrawnMesh, MeshProgram
from viewer.plan import Ground

__all__ = ["GroundDrawer"]


class GroundDrawer:
    """Draws :class:`viewer.plan.Ground`: tiles are objects of the ground's mesh."""

    def __init__(self, context: Any, program: MeshProgram, ground: CityMesh) -> None:  # noqa: ANN401
        self._tiles, self._backdrop = (
            DrawnMesh(context, program, mesh, np.full(len(mesh.positions), GROUND_ID))
            for mesh in (ground, backdrop(ground))
        )

    def draw(self, draw: Ground, *, measured: bool) -> list[int]:
        """Draw the tiles, and the backdrop below them."""
        return [
            *self._tiles.draw(draw.tiles, np.array(draw.tiles, dtype=np.int64), measured=measured),
            *self._backdrop.draw("all", np.zeros(1, dtype=np.int64), measured=measured),
        ]
