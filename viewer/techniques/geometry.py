"""Techniques that draw geometry only: what image-based ones are measured against (paper section 6.1).

``full`` draws every object of the city, ``visible`` the potentially visible set of the cell that the viewer is in, ``local``
its near objects alone, which bounds the frame rate of impostors from above, since they come on top.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from mmi.foundation.camera import View
from viewer.plan import Budget, Objects, Plan, Sky
from viewer.scene.follower import Follower
from viewer.scene.scene import WalkScene

__all__ = ["CellGeometry", "FullGeometry"]


class FullGeometry:
    """All objects, wherever the viewer is."""

    name = "full"

    def __init__(self, scene: WalkScene) -> None:
        self._scene = scene
        self._all = Objects("all", np.arange(len(scene.mesh.triangle_counts)))

    def plan(self, view: View, *, now: float, budget: Budget) -> Plan:  # noqa: ARG002
        """Draw the whole city."""
        return Plan((self._all, self._scene.ground_in(view), Sky()))


class CellGeometry:
    """The potentially visible objects of the viewer's cell, or only those that impostors leave as geometry."""

    def __init__(self, scene: WalkScene, which: Literal["visible", "local"]) -> None:
        self.name = which
        self._scene, self._follower = scene, Follower(scene)

    def plan(self, view: View, *, now: float, budget: Budget) -> Plan:  # noqa: ARG002
        """Draw the objects of the cell that the viewer is in."""
        place = self._follower.move(view.eye).cell
        objects = place.near if self.name == "local" else place.visible
        here = Objects(f"{self.name} {self._scene.name} {place.cell.id}", objects)
        return Plan((here, self._scene.ground_in(view), Sky()), place=place.cell.id)
