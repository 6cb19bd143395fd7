"""What of a capture fits into a frame: what capturing a layer and showing it take, and orders for as much as there is room for.

Costs are those of the budget (:class:`viewer.plan.Costs`); which layer is captured next is for ``viewer.techniques.dynamic``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mmi.foundation.camera import View
from viewer.plan import Budget, Costs, ImageKey, ReliefPart, Request, Slot
from viewer.techniques.updates import CaptureWindow, LayerUnit, Piece, bounds_in, capture_window

__all__ = ["Draft", "Room", "fitting", "together"]

_PROGRESS = 0.15
"""The share of a frame's time that is left for updates at least while the viewer stands."""
_NARROWEST = 32
"""Texels: a capture is not cut into narrower strips."""


class Draft(NamedTuple):
    """What a capture would be."""

    image: ImageKey
    part: ReliefPart
    place: CaptureWindow

    def cost(self, costs: Costs) -> float:
        """Seconds that drawing it takes, not capturing it."""
        return costs.of_draws(triangles=self.part.triangles, draws=1, relief=self.part.pixels) - costs.frame


class Room:
    """What is left of a frame for updates: for captures, and for showing them where the viewer moves.

    The frame is ``predicted`` to take so many seconds as it is, and ``plain`` with stored layers only. Showing a capture takes
    longer than showing the stored layer does, and that is time for updates as well. A viewer who stands ``still`` sees the
    picture settle whatever showing it takes, and something is left for captures even where all frames are late.
    """

    def __init__(self, budget: Budget, predicted: float, plain: float, *, still: bool) -> None:
        self.costs = budget.costs
        self._updates = budget.updates - (0.0 if still else max(predicted - plain, 0.0))
        self._frame = max(budget.frame - predicted, _PROGRESS * budget.frame if still else 0.0)
        self._most = min(self._updates, self._frame)

    def fits_ever(self, seconds: float) -> bool:
        """Whether there was room for so much when the frame began."""
        return seconds <= self._most

    def fits(self, seconds: float) -> bool:
        """Whether there is room for so much now."""
        return seconds <= min(self._updates, self._frame)

    def take(self, seconds: float) -> None:
        """Use it."""
        self._updates -= seconds
        self._frame -= seconds


def fitting(
    draft: Draft, unit: LayerUnit, strips: tuple[int, ...], room: Room, *, showing: float
) -> tuple[list[Request], tuple[int, ...]]:
    """Requests for upright strips of a capture as far as there is room, and the widths of those that are left.

    ``strips`` are the widths of what is to be captured, texels, the last one at the right border. There is to be room for the
    seconds of ``showing`` it, too.
    """
    asked: list[Request] = []
    left = list(strips)
    while left:
        right = draft.place.window[2] - sum(left[1:])
        request, cost = _request(draft, (unit,), right - left[0], right, room.costs)
        if request is None or room.fits(cost + showing):
            room.take(cost)
            asked += [] if request is None else [request]
            del left[0]
        elif not room.fits_ever(cost + showing) and left[0] > _NARROWEST:
            left[:1] = [left[0] - left[0] // 2, left[0] // 2]
        else:
            break
    return asked, tuple(left)


def together(draft: Draft, units: Sequence[LayerUnit], room: Room) -> tuple[tuple[Request, ...], bool]:
    """The one order for a capture of several layers in the same image, and whether there is room for it, which it takes."""
    request, cost = _request(draft, units, 0, draft.part.view.window[2], room.costs)
    if not room.fits(cost):
        return (), False
    room.take(cost)
    return () if request is None else (request,), True


def _request(
    draft: Draft, units: Sequence[LayerUnit], first: int, last: int, costs: Costs
) -> tuple[Request | None, float]:
    """The order to draw what of some layers is between two columns of a capture, and its cost; None where nothing is seen."""
    left, top, width, height = draft.part.view.window
    strip = draft.part.view.cropped((left + first, top, last - first, height))
    chosen = [
        (piece, place) for unit in units for piece in unit.pieces if (place := _seen(strip, unit, piece)) is not None
    ]
    if not chosen:
        return None, 0.0
    windows = np.array([place.window for _, place in chosen])
    x, y = windows[:, :2].min(axis=0).tolist()
    right, lower = (windows[:, :2] + windows[:, 2:]).max(axis=0).tolist()
    into = Slot(draft.image, (width, height), (x - left, y - top))
    view = strip.cropped((x, y, right - x, lower - y))
    request = Request(into, view, tuple(piece.draw for piece, _ in chosen), clear=False)
    triangles = sum(piece.triangles for piece, _ in chosen)
    return request, costs.of_request(triangles=triangles, draws=len(chosen), pixels=request.pixels)


def _seen(view: View, unit: LayerUnit, piece: Piece) -> CaptureWindow | None:
    return capture_window(view, bounds_in(view, unit.boxes[piece.rows]), margin=0)
