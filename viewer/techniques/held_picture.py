"""The picture of a viewer who stands still: all layers in one image, through the frame's own projection, added as time allows.

It is drawn as one relief, however many layers are in it, and as many layers as there is time for are added at once: a request
takes some time as such, and every pixel that is cleared and shaded takes some.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from viewer.plan import ImageKey, Relief, ReliefPart, Request
from viewer.techniques.capturing import Draft, Room, fitting, together
from viewer.techniques.updates import CaptureWindow, LayerUnit

__all__ = ["HeldPicture"]

_EVERYWHERE = (-math.inf, -math.inf, math.inf, math.inf)


@dataclass(slots=True, eq=False)
class HeldPicture:
    """An image to which layers are added: ``done`` are those that are in it, by their place among the cell's.

    ``part`` is the whole frame. ``strips`` are the widths of what is still to be drawn of others, as
    :func:`viewer.techniques.capturing.fitting` has them; ``begun``: something is there.
    """

    image: ImageKey
    part: ReliefPart
    done: set[int] = field(default_factory=set)
    strips: dict[int, tuple[int, ...]] = field(default_factory=dict)
    begun: bool = False

    @property
    def draws(self) -> tuple[Relief, ...]:
        """What shows it."""
        return (Relief(self.image, (self.part,)),) if self.begun else ()

    def add(self, order: Sequence[int], units: Sequence[LayerUnit], room: Room) -> tuple[Request, ...]:
        """Requests that add layers, the first of ``order`` first: as many as there is ``room`` for at once, then one by one."""
        window = self.part.view.window
        draft = Draft(self.image, self.part, CaptureWindow(window, _EVERYWHERE, whole=False))
        requests: list[Request] = []
        count = len(order)
        while count:
            asked, fits = together(draft, [units[i] for i in order[:count]], room)
            if fits:
                requests += asked
                self.done |= set(order[:count])
                break
            count //= 2
        for i in order[count:]:
            some, self.strips[i] = fitting(draft, units[i], self.strips.get(i, (window[2],)), room, showing=0.0)
            requests += some
            if not self.strips[i]:
                self.done.add(i)
        self.begun = self.begun or bool(requests)
        return tuple(requests)
