"""Impostor layers that are captured again at run time, in order of error angle, while frame time allows (paper section 5.5).

What is captured again is a layer of a sector: its objects, whole, also those that the stored layer has never seen, through
the frame's own projection, so that for a viewer who stands still a texel is a pixel. The picture is drawn as a relief
(:class:`viewer.plan.Relief`) as long as its error angle is below both the stored layer's and the bound that the dataset was
built for, and it has all that the view may show of the layer. A stored picture is drawn as long as something that it shows may
be seen and was not captured. What fits into a frame the budget's costs tell: the frame that draws as it does now is predicted,
and what is left of it goes to the layers of the largest error angles by the time that their captures take, the nearest first
among equals. A layer that takes longer is captured in strips over several frames, and replaces what is shown when it is whole.

The paper orders by the error angle alone. Its layers take about equally long; of layers that do not, the worst may be one for
which all others wait, or one that is never whole before it is out of date (``benchmarks/orders.py``).

For a viewer who stands still all layers go into one picture (:mod:`viewer.techniques.held_picture`), which is given up when the
viewer moves.

With a budget of nothing for updates the plans are those of ``multi-mesh``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View
from mmi.foundation.errors import ParameterError
from mmi.validity.layers import LayerParallax, layer_errors, layer_parallax
from viewer.plan import RELIEF_QUAD, Budget, CellLayers, Costs, Draw, Ground, ImageKey, Plan, ReliefPart, Request
from viewer.scene.scene import WalkScene
from viewer.techniques.capturing import Draft, Room, fitting
from viewer.techniques.held_picture import HeldPicture
from viewer.techniques.layered import LayeredImpostors
from viewer.techniques.updates import (
    CapturedLayer,
    CellUnits,
    LayerUnit,
    bounds_in,
    capture_window,
    cell_units,
    spans_of,
)

__all__ = ["ORDERS", "Candidate", "DynamicImpostors"]

_WORTH_PX = 0.5
"""While the viewer moves, a layer whose error angle covers fewer pixels is left as it is."""
_MARGIN = 16
"""Pixels beyond the view that a capture has, for a viewer who turns; and as much as it turns in so many frames:"""
_FORESEEN = 8
_WIDEST_MARGIN = 192
_SHORTEST = 1e-6
"""Seconds; no capture takes less."""
_DRAWS = 6
"""Draws of a frame with stored layers: near objects, layers of both kinds, ground, backdrop, sky."""


class Candidate(NamedTuple):
    """A layer that may be captured again: its place among the cell's, its error angle now, and how near it is, metres."""

    unit: int
    error: float
    depth: float
    asked: int
    """The number of the frame in which it was last captured, -1 for never."""
    seconds: float = 0.0
    """What is left of capturing it takes about as long."""


_Order = Callable[[Sequence[Candidate], int], Sequence[Candidate]]


def _by_error(some: Sequence[Candidate], _: int) -> Sequence[Candidate]:
    return sorted(some, key=lambda one: (-one.error, one.depth, one.unit))


def _by_error_and_time(some: Sequence[Candidate], _: int) -> Sequence[Candidate]:
    """The largest error angle by the time of the capture: so what waits costs least, as all errors together (Smith 1956)."""
    return sorted(some, key=lambda one: (-one.error / max(one.seconds, _SHORTEST), one.depth, one.unit))


def _front_to_back(some: Sequence[Candidate], _: int) -> Sequence[Candidate]:
    return sorted(some, key=lambda one: (one.depth, one.unit))


def _round_robin(some: Sequence[Candidate], _: int) -> Sequence[Candidate]:
    return sorted(some, key=lambda one: (one.asked, one.unit))


def _at_random(some: Sequence[Candidate], frame: int) -> Sequence[Candidate]:
    return [some[i] for i in np.random.default_rng([frame, 16]).permutation(len(some))]


ORDERS: Mapping[str, _Order] = MappingProxyType(
    {
        "error-angle": _by_error,
        "error-by-time": _by_error_and_time,
        "front-to-back": _front_to_back,
        "round-robin": _round_robin,
        "random": _at_random,
    }
)
"""In what order layers are captured again: the paper's by error angle, the same by the time that captures take, and others
that they are measured against."""


def _errors(some: Mapping[int, LayerParallax], view: View) -> dict[int, float]:
    """The error angle of each of some pictures of layers as ``view`` sees it, radians."""
    return dict(zip(some, layer_errors(list(some.values()), view.eye).tolist(), strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class _Pending:
    """A capture that is not whole yet: what it will be, and the widths of upright strips that are still to be drawn."""

    draft: Draft
    layer: CapturedLayer
    strips: tuple[int, ...]


@dataclass(slots=True, eq=False)
class _Place:
    """The cell that the viewer is in, and what was captured of its layers; units by their place in ``units``."""

    name: str
    cell: CellUnits
    stored_triangles: Mapping[str, int]
    reference: NDArray[np.float64]
    near_triangles: int
    parallax: dict[int, LayerParallax]
    captured: dict[int, CapturedLayer]
    pending: dict[int, _Pending]
    asked: dict[int, int]
    held: HeldPicture | None = None

    @property
    def units(self) -> tuple[LayerUnit, ...]:
        """What can be captured again."""
        return self.cell.units


class DynamicImpostors:
    """Near geometry, and for the rest stored layers or, where there was time, layers as they are seen from here.

    ``fade`` is that of :class:`viewer.techniques.layered.LayeredImpostors`, ``order`` one of :data:`ORDERS`. Raises
    ParameterError for an unknown order.
    """

    name = "multi-mesh-dynamic"

    def __init__(self, scene: WalkScene, *, fade: float = 0.0, order: str = "error-by-time") -> None:
        if order not in ORDERS:
            raise ParameterError(f"order {order!r}: one of {', '.join(ORDERS)} expected")
        self.owner = self.name
        """Whose images are captured: several viewers who are drawn in turns by one renderer need one each."""
        self._scene, self._order = scene, ORDERS[order]
        self._stored = LayeredImpostors(scene, fade=fade)
        self._limit = scene.parameters.max_angle
        self._worth = scene.camera.angle_from_pixels(_WORTH_PX)
        self._place: _Place | None = None
        self._last: View | None = None
        self._frame = 0

    def plan(self, view: View, *, now: float, budget: Budget) -> Plan:
        """Draw the viewer's cell, and capture what is most wrong of it as far as the budget allows."""
        stored = self._stored.plan(view, now=now, budget=budget)
        last, self._last = self._last, view
        self._frame += 1
        drops = self._move_to(stored.place)
        place = self._place
        if budget.updates <= 0.0 or place is None:
            return replace(stored, drops=(*drops, *self._forget()))
        layers = next(draw for draw in stored.draws if isinstance(draw, CellLayers))
        every = np.split(bounds_in(view, place.cell.boxes), place.cell.starts[1:-1]) if place.units else []
        bounds = {i: some for i, some in enumerate(every) if capture_window(view, some, margin=0) is not None}
        seen = list(bounds)
        stored_errors = _errors({i: self._parallax(place, i) for i in seen}, view)
        drops += self._expire(place, view)
        shown, errors = self._valid(place, view, stored_errors)
        still = last is None or np.array_equal(last.eye_from_world, view.eye_from_world)
        drops += self._hold(place, view, bounds, still=still)
        held = place.held
        done = set() if held is None else held.done  # grows as layers are added to it
        shown = {i: one for i, one in shown.items() if i not in done}
        candidates = [
            Candidate(
                i,
                errors[i],
                place.units[i].depth,
                place.asked.get(i, -1),
                _time(place, i, view, bounds[i], budget.costs),
            )
            for i in seen
            if (i not in done if still else errors[i] > self._worth)
        ]
        plain = self._predicted(stored, layers, place, {}, budget.costs)
        predicted = self._predicted(stored, _kept(layers, place, seen, {*shown, *done}), place, shown, budget.costs)
        for i in sorted(shown, key=lambda i: stored_errors[i] - errors[i]):
            if still or predicted <= min(budget.frame, plain + budget.updates):
                break
            del shown[i]  # the stored layer takes less time
            predicted = self._predicted(stored, _kept(layers, place, seen, shown), place, shown, budget.costs)
        room = Room(budget, predicted, plain, still=still)
        gone: list[ImageKey] = []
        if held is not None:
            order = [one.unit for one in self._order(candidates, self._frame)]
            requests = held.add(order, place.units, room)
            place.asked |= dict.fromkeys(done.intersection(order), self._frame)
            shown = {i: one for i, one in shown.items() if i not in done}
        else:
            margin = _margin(last or view, view)
            requests, fresh, gone = self._update(place, view, candidates, bounds, margin, room, shown)
            fresh_errors = _errors({i: place.captured[i].parallax for i in fresh}, view)
            shown |= {i: place.captured[i] for i in fresh if fresh_errors[i] <= errors[i]}
        kept = _kept(layers, place, seen, {*shown, *done})
        draws = _composed(stored.draws, kept, () if held is None else held.draws, shown)
        return replace(stored, draws=draws, requests=requests, drops=(*drops, *gone))

    # ------------------------------------------------------------------------------------------------ what is valid

    def _move_to(self, name: str) -> tuple[ImageKey, ...]:
        """Come to a cell; the images of the one before are not needed any more."""
        if self._place is not None and self._place.name == name:
            return ()
        drops = self._forget()
        entry = self._scene.dataset.cell(name)
        near = [self._scene.objects[one] for one in entry.near]
        self._place = _Place(
            name=name,
            cell=cell_units(self._scene, name),
            stored_triangles={one.name: one.triangles for _, one in entry.pictures},
            reference=np.array(entry.reference),
            parallax={},
            near_triangles=int(self._scene.mesh.triangle_counts[near].sum()),
            captured={},
            pending={},
            asked={},
        )
        return drops

    def _forget(self) -> tuple[ImageKey, ...]:
        """Forget all that was captured: the images to drop."""
        place = self._place
        if place is None:
            return ()
        images = [one.image for one in place.captured.values()] + [one.layer.image for one in place.pending.values()]
        images += [place.held.image] if place.held is not None and place.held.begun else []
        place.captured.clear()
        place.pending.clear()
        place.held = None
        return tuple(images)

    def _hold(
        self, place: _Place, view: View, bounds: Mapping[int, NDArray[np.float64]], *, still: bool
    ) -> tuple[ImageKey, ...]:
        """Begin the picture of a viewer who stands still, or forget that of one who did: the image to drop."""
        held = place.held
        if held is not None and still:
            return ()
        place.held = None
        if still and bounds:
            every = np.concatenate(list(bounds.values()))
            farthest = max(place.units[i].depth for i in bounds)
            part = ReliefPart(view, (0, 0), max(farthest, 1.0), spans=spans_of(view, every))
            place.held = HeldPicture(ImageKey(self.owner, f"view {self._frame}"), part)
        return () if held is None or not held.begun else (held.image,)

    def _parallax(self, place: _Place, unit: int) -> LayerParallax:
        """That of a stored layer."""
        if unit not in place.parallax:
            place.parallax[unit] = self._seen_from(place.reference, place.units[unit].boxes)
        return place.parallax[unit]

    def _seen_from(self, eye: NDArray[np.float64], boxes: NDArray[np.float64]) -> LayerParallax:
        return layer_parallax(eye, boxes, widened=self._scene.camera.angle_from_pixels(RELIEF_QUAD))

    def _expire(self, place: _Place, view: View) -> tuple[ImageKey, ...]:
        """Forget captures whose error angle has passed the bound, wherever they are."""
        made = {i: one.parallax for i, one in place.captured.items()}
        begun = {i: one.layer.parallax for i, one in place.pending.items()}
        gone = [place.captured.pop(i).image for i, error in _errors(made, view).items() if error > self._limit]
        gone += [place.pending.pop(i).layer.image for i, error in _errors(begun, view).items() if error > self._limit]
        return tuple(gone)

    def _valid(
        self, place: _Place, view: View, stored: Mapping[int, float]
    ) -> tuple[dict[int, CapturedLayer], dict[int, float]]:
        """What is shown as it was captured, and the error angle of what is shown of each layer: ``stored`` has stored ones'."""
        there = {i: place.captured[i] for i in stored if i in place.captured and place.captured[i].covers(view)}
        now = _errors({i: one.parallax for i, one in there.items()}, view)
        better = {i: one for i, one in there.items() if now[i] <= stored[i]}
        return better, {**stored, **{i: now[i] for i in better}}

    # ----------------------------------------------------------------------------------------------- what is captured

    def _predicted(
        self, stored: Plan, kept: CellLayers, place: _Place, shown: Mapping[int, CapturedLayer], costs: Costs
    ) -> float:
        """Seconds that the frame is predicted to take without updates; ``kept`` are stored layers that it draws."""
        triangles = place.near_triangles + sum(place.stored_triangles[name] for name in kept.names)
        triangles += sum(one.part.triangles for one in shown.values())
        for draw in stored.draws:
            if isinstance(draw, Ground):
                triangles += int(self._scene.ground.triangle_counts[list(draw.tiles)].sum())
        reliefs = [one.draw for one in shown.values()] + list(() if place.held is None else place.held.draws)
        relief = sum(one.pixels for one in reliefs)
        return costs.of_draws(triangles=triangles, draws=_DRAWS + len(reliefs), relief=relief)

    def _update(
        self,
        place: _Place,
        view: View,
        candidates: Sequence[Candidate],
        bounds: Mapping[int, NDArray[np.float64]],
        margin: int,
        room: Room,
        shown: Collection[int],
    ) -> tuple[tuple[Request, ...], list[int], list[ImageKey]]:
        """Requests for which there is ``room``, the layers that are whole with them, and images that they replace.

        Captures of layers that are ``shown`` already take no more time to show.
        """
        requests: list[Request] = []
        fresh: list[int] = []
        gone: list[ImageKey] = []
        late = False
        for one in self._order(candidates, self._frame):
            if late and not room.fits(one.seconds):
                continue  # what is left of the time may do for others, which is told quickly
            unit, pending = place.units[one.unit], place.pending.get(one.unit)
            if pending is not None and not pending.layer.covers(view):
                gone.append(place.pending.pop(one.unit).layer.image)
                pending = None
            draft = self._drafted(unit, view, bounds[one.unit], margin) if pending is None else pending.draft
            strips = (draft.place.window[2],) if pending is None else pending.strips
            showing = 0.0 if one.unit in shown else draft.cost(room.costs)
            asked, waiting = fitting(draft, unit, strips, room, showing=showing)
            requests += asked
            if waiting:
                if asked or pending is not None:
                    layer = self._captured(draft, unit, bounds[one.unit]) if pending is None else pending.layer
                    place.pending[one.unit] = _Pending(draft, layer, waiting)
                late = True
                continue
            room.take(showing)
            place.pending.pop(one.unit, None)
            if one.unit in place.captured:
                gone.append(place.captured[one.unit].image)
            layer = self._captured(draft, unit, bounds[one.unit]) if pending is None else pending.layer
            place.captured[one.unit], place.asked[one.unit] = layer, self._frame
            fresh.append(one.unit)
        return tuple(requests), fresh, gone

    def _drafted(self, unit: LayerUnit, view: View, bounds: NDArray[np.float64], margin: int) -> Draft:
        """What a capture of a layer as the viewer sees it now would be."""
        place = capture_window(view, bounds, margin=margin)
        assert place is not None, "what is not in the view is no candidate"
        seen = view.cropped(place.window)
        part = ReliefPart(seen, (0, 0), max(unit.depth, 1.0), spans=spans_of(seen, bounds))
        return Draft(ImageKey(self.owner, f"{unit.name} {self._frame}"), part, place)

    def _captured(self, draft: Draft, unit: LayerUnit, bounds: NDArray[np.float64]) -> CapturedLayer:
        """What is there when all of it was captured; ``bounds`` (k, 4) are those of the layer's boxes as they are seen now."""
        eye = draft.part.view.eye
        left, top, width, height = draft.place.window
        inside = (bounds[:, :2] < [left + width, top + height]).all(axis=1) & (bounds[:, 2:] > [left, top]).all(axis=1)
        boxes = unit.boxes[inside]
        nearest = np.linalg.norm(np.clip(eye, boxes[:, 0], boxes[:, 1]) - eye, axis=1).min()
        return CapturedLayer(*draft, self._seen_from(eye, boxes), float(nearest))


def _time(place: _Place, unit: int, view: View, bounds: NDArray[np.float64], costs: Costs) -> float:
    """Seconds that capturing a layer takes, or what is left of it."""
    pieces, pending = place.units[unit].pieces, place.pending.get(unit)
    window = capture_window(view, bounds, margin=0) if pending is None else pending.draft.place
    assert window is not None, "what is not in the view is no candidate"
    share = 1.0 if pending is None else sum(pending.strips) / window.window[2]
    triangles = sum(piece.triangles for piece in pieces)
    pixels = window.window[2] * window.window[3]
    return share * costs.of_request(triangles=triangles, draws=len(pieces), pixels=pixels)


def _kept(layers: CellLayers, place: _Place, seen: Collection[int], captured: Collection[int]) -> CellLayers:
    """The stored layers that are still needed: those of which something may be seen that was not ``captured``."""
    missing = {i for i in seen if i not in captured}
    names = (name for name in layers.names if not missing.isdisjoint(place.cell.owners[name]))
    return CellLayers(layers.cell, tuple(names))


def _composed(
    draws: Sequence[Draw], kept: CellLayers, held: Sequence[Draw], shown: Mapping[int, CapturedLayer]
) -> tuple[Draw, ...]:
    """``draws`` with what was captured, the nearest first, and the stored layers that are ``kept``."""
    found: list[Draw] = []
    for draw in draws:
        if isinstance(draw, CellLayers):
            found += [*held, *(one.draw for one in sorted(shown.values(), key=lambda one: (one.depth, one.image)))]
            draw = kept
        found.append(draw)
    return tuple(found)


def _margin(last: View, view: View) -> int:
    """Pixels beyond the view that a capture should have for a viewer who turns as it did since the ``last`` frame."""
    cosine = float(np.clip(last.eye_from_world[2, :3] @ view.eye_from_world[2, :3], -1.0, 1.0))
    return min(_MARGIN + math.ceil(_FORESEEN * math.acos(cosine) * view.focal), _WIDEST_MARGIN)
