"""Any technique with objects that move: its plans, and in each the movers that the view may show.

They are composed with the rest by depth, as all that a plan draws: layers and reliefs have the depths of the surfaces that they
show. So a mover vanishes behind a far building and stands before it, whatever draws that.
"""

from __future__ import annotations

from dataclasses import replace

from mmi.foundation.camera import Camera, View
from mmi.movers.movers import Movers
from viewer.plan import Budget, Draw, Ground, Moving, Plan, Sky, Technique
from viewer.scene.movers_seen import movers_in
from viewer.scene.skyline import Skyline, unhidden
from viewer.techniques.virtual_frames import FrameRules, FrameTally, VirtualFrames

__all__ = ["WithMovers"]

_LEAST = 1e-9
"""Seconds of updates that are left to a technique at least: none at all would forbid what it has captured."""


class WithMovers:
    """A ``technique`` with ``movers``: as images where ``rules`` allow it, as geometry without rules.

    Movers that a ``skyline`` hides are left out; without one, all that are within the view are drawn. ``at`` is the time
    (seconds) at which movers stand still, None where they move as time goes by.
    """

    def __init__(
        self,
        technique: Technique,
        movers: Movers,
        camera: Camera,
        *,
        rules: FrameRules | None = None,
        skyline: Skyline | None = None,
        at: float | None = None,
    ) -> None:
        self.name = technique.name
        self.technique = technique
        """What draws all else."""
        self._movers, self._skyline, self._at = movers, skyline, at
        self._hidden = 0
        self._frames = None if rules is None else VirtualFrames(movers, camera, rules, owner=technique.name)
        self._tally = FrameTally()

    @property
    def tally(self) -> FrameTally:
        """What was drawn so far."""
        tally = self._tally if self._frames is None else self._frames.tally
        return tally._replace(hidden=self._hidden)

    def plan(self, view: View, *, now: float, budget: Budget) -> Plan:
        """The technique's plan with movers; it is told what they leave of the budget."""
        time = now if self._at is None else self._at
        seen = movers_in(view, self._movers, time)
        if self._skyline is not None and len(seen.which):
            shows = unhidden(self._skyline, view.eye, seen.corners)
            self._hidden += int((~shows).sum())
            seen = seen.of(shows)
        if self._frames is None:
            geometry = len(seen.which)
            self._tally = self._tally._replace(frames=self._tally.frames + 1, geometry=self._tally.geometry + geometry)
            plan = self.technique.plan(view, now=now, budget=budget)
            return _composed(plan, (Moving(seen.which, seen.poses),) if geometry else ())
        chosen = self._frames.choose(view, seen, time=time, budget=budget)
        taken = chosen.updating + chosen.drawing
        rest = replace(budget, frame=max(budget.frame - taken, 0.0), updates=max(budget.updates - chosen.updating, 0.0))
        plan = self.technique.plan(view, now=now, budget=rest)
        return replace(_composed(plan, chosen.draws), requests=(*chosen.requests, *plan.requests))


def _composed(plan: Plan, draws: tuple[Draw, ...]) -> Plan:
    """The plan with these draws as well, in what fades too."""
    return replace(
        plan, draws=_among(plan.draws, draws), fading=_among(plan.fading, draws) if plan.mix < 1.0 else plan.fading
    )


def _among(draws: tuple[Draw, ...], more: tuple[Draw, ...]) -> tuple[Draw, ...]:
    """Before ground and sky, which much hides, and after what may hide movers."""
    place = next((i for i, draw in enumerate(draws) if isinstance(draw, Ground | Sky)), len(draws))
    return (*draws[:place], *more, *draws[place:])
