"""Techniques that draw a cell's near objects and impostor layers for the rest (paper section 5).

``multi-mesh`` and ``single-mesh`` are one technique on two datasets: the second was built with ``--layering single``, one
textured mesh a view (Sillion, Drettakis & Bodelet 1997), the baseline of the paper's section 6.1.
"""

from __future__ import annotations

from mmi.foundation.camera import View
from viewer.plan import Budget, CellKey, CellLayers, Draw, Objects, Plan, Sky
from viewer.scene.follower import Follower
from viewer.scene.scene import CellContents, WalkScene

__all__ = ["LayeredImpostors"]


class LayeredImpostors:
    """Near geometry and layers of the cell that the viewer is in.

    ``fade`` seconds after a change of cells the new cell's picture has replaced the old one's; 0 switches at once.
    """

    def __init__(self, scene: WalkScene, *, fade: float = 0.0) -> None:
        self.name = scene.name
        self._scene, self._fade, self._follower = scene, fade, Follower(scene)
        self._place: CellContents | None = None
        self._left: tuple[CellContents, float] | None = None

    def plan(self, view: View, *, now: float, budget: Budget) -> Plan:  # noqa: ARG002
        """Draw the viewer's cell, mixed with the one before as long as that fades."""
        move = self._follower.move(view.eye)
        if move.jumped:
            self._left = None
        elif move.entered and self._place is not None and self._fade > 0.0:
            self._left = (self._place, now)
        self._place = move.cell
        fading: tuple[Draw, ...] = ()
        cells: tuple[CellKey, ...] = (self._key(move.cell),)
        mix = 1.0
        if self._left is not None:
            left, since = self._left
            mix = (now - since) / self._fade
            if 0.0 <= mix < 1.0:
                fading, cells = self._draws(left, view), (*cells, self._key(left))
            else:
                self._left, mix = None, 1.0
        ahead = tuple(CellKey(self.name, name) for name in move.ahead)
        return Plan(self._draws(move.cell, view), move.cell.cell.id, cells, ahead, fading, mix)

    def _key(self, place: CellContents) -> CellKey:
        return CellKey(self.name, place.cell.id)

    def _draws(self, place: CellContents, view: View) -> tuple[Draw, ...]:
        near = Objects(f"local {self.name} {place.cell.id}", place.near)
        layers = CellLayers(self._key(place), place.layers_in(view))
        return near, layers, self._scene.ground_in(view), Sky()
