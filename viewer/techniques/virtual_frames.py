"""Virtual frames: images of objects that move, which move along and stay as long as they are not seen to be wrong.

Duckstein 1998: what an image of an object is wrong by is what the viewer's place relative to the object has changed since it
was captured. Two calculations decide how long it stays:

    common         in every frame, how wrong the image is now; a wrong one is captured again at once
    predictive     once, for how many frames it will stay right if each is like the last (section 3); it is captured only if
                   these are enough, and looked at again when they are over

Images are reliefs with the depths that were captured, so that what moves is composed with all else by the z-buffer. Their
error counts what they hide as well. All of this follows from views, times and budgets, and draws nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import Camera, View
from mmi.foundation.errors import ParameterError
from mmi.movers.movers import Movers
from mmi.validity.images import Relief as Depths
from mmi.validity.images import error_angle, safe_distance
from mmi.validity.movement import frames_at_equal_steps, relative_viewpoint
from viewer.caching.slots import Place, Slots
from viewer.plan import Budget, Draw, ImageKey, Moving, Relief, ReliefPart, Request, Slot
from viewer.scene.movers_seen import SeenMovers

__all__ = ["CALCULATIONS", "LARGEST", "Chosen", "FrameRules", "FrameTally", "VirtualFrames"]

CALCULATIONS = ("predictive", "common")
LARGEST = (64, 128, 256, 512)
_Calculation = Literal["predictive", "common"]
_ATLAS, _LEAST = 1024, 16
"""Texels a side: of the image that holds all pictures, or four times the largest where that is more, and of a place in it."""
_MARGIN = 1
"""Texels around what is captured, so that filters meet nothing there."""
_SHRUNK = 0.5
"""A picture that is shown at less than this share of its size would flicker."""
_AHEAD = 0.5
"""Metres of depth that all of an object must have to be captured."""
_UPDATES = 0.25
"""The share of a frame's time that captures take at most."""
_MOST_FRAMES = 1_000
_SAFE = Depths()
"""Nothing is known of what is hidden: any two points of an object on one ray may stand for each other."""


@dataclass(frozen=True, slots=True)
class FrameRules:
    """When an object is an image. Raises ParameterError for what has no meaning.

    ``limit_px``: pixels that an image may be wrong by. ``calculation``: one of ``CALCULATIONS``. ``least_frames``: a capture is
    predicted to be shown in so many frames after its own at least. ``nearest``: objects closer than so many metres are
    geometry. ``coarsest``: a picture may be magnified so much. ``largest``: objects are geometry whose picture would have more
    texels a side, one of ``LARGEST``. ``thrifty``: only what is predicted to save time is captured.
    """

    limit_px: float = 1.0
    calculation: _Calculation = "predictive"
    least_frames: int = 2
    nearest: float = 15.0
    coarsest: float = 1.2
    largest: int = 128
    thrifty: bool = True

    def __post_init__(self) -> None:
        if self.calculation not in CALCULATIONS:
            raise ParameterError(f"calculation: one of {', '.join(CALCULATIONS)} expected, found {self.calculation!r}")
        if self.largest not in LARGEST:
            raise ParameterError(f"largest: one of {', '.join(map(str, LARGEST))} expected, found {self.largest!r}")
        for name, least, most in (
            ("limit_px", 0.01, 100.0),
            ("least_frames", 1, _MOST_FRAMES),
            ("nearest", 0.0, 1e6),
            ("coarsest", 1.0, 4.0),
        ):
            if not least <= getattr(self, name) <= most:
                raise ParameterError(f"{name}: {least:g} to {most:g} expected, found {getattr(self, name)!r}")


class FrameTally(NamedTuple):
    """What was drawn so far: objects as ``geometry``, as images that were ``captured`` in that frame or ``reused``; those
    within the view that were left out are ``hidden``.

    ``shown`` frames that ``ended`` images were valid for, their own counted; an image that still is does not count yet.
    """

    frames: int = 0
    geometry: int = 0
    captured: int = 0
    reused: int = 0
    ended: int = 0
    shown: int = 0
    hidden: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Chosen:
    """How objects are drawn in a frame, and what it is predicted to take of it: seconds of requests, and of draws."""

    requests: tuple[Request, ...]
    draws: tuple[Draw, ...]
    updating: float
    drawing: float


@dataclass(frozen=True, slots=True, eq=False)
class _Picture:
    """An image of an object: captured as ``view`` into ``place``, when the object stood as ``pose`` (4, 4)."""

    place: Place
    view: View
    pose: NDArray[np.float64]
    filling: float
    frame: int


class _Now(NamedTuple):
    """Of the objects that may show: where the eye is in the frame of each (``eyes`` (k, 3)), how each has ``moved`` (k, 4, 4)
    since the last frame, world now from world then, and the viewer: by ``step`` to ``eye`` (3,). ``low`` and ``high`` (k, 2)
    bound them in the view, which ``sizes`` (k,) are the diagonals of, in pixels, where they are wholly ``ahead`` (k,).
    """

    eyes: NDArray[np.float64]
    moved: NDArray[np.float64]
    eye: NDArray[np.float64]
    step: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    sizes: NDArray[np.float64]
    ahead: NDArray[np.bool_]


class VirtualFrames:
    """Images of ``movers``, for a ``camera``. ``owner`` is the technique that shows them."""

    def __init__(self, movers: Movers, camera: Camera, rules: FrameRules, *, owner: str) -> None:
        n = len(movers.ids)
        self._movers, self._rules = movers, rules
        self._limit = camera.angle_from_pixels(rules.limit_px)
        self._image = ImageKey(owner, "movers")
        self._size = max(_ATLAS, 4 * rules.largest)
        self._slots = Slots(size=self._size, page=rules.largest, least=_LEAST)
        self._pictures: dict[int, _Picture] = {}
        self._eyes, self._sizes, self._safe = np.zeros((n, 3)), np.zeros(n), np.zeros(n)
        self._until, self._shown = np.full(n, -1, dtype=np.int64), np.full(n, -1, dtype=np.int64)
        self._pixels, self._counts = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
        self._last: tuple[float, NDArray[np.float64]] | None = None
        self._frame = 0
        self._triangles = np.array([len(mesh.triangles) for mesh in movers.meshes], dtype=np.int64)[movers.kinds]
        self.tally = FrameTally()
        """What was drawn so far."""

    def choose(self, view: View, seen: SeenMovers, *, time: float, budget: Budget) -> Chosen:
        """How to draw the movers that ``view`` may show at ``time`` (seconds)."""
        self._frame += 1
        now = self._look(view, seen, time, budget)
        valid = self._valid(seen.which, now)
        self._shown[seen.which[valid]] = self._frame
        wanted = np.flatnonzero(~valid)
        fresh, updating = self._capture(view, seen, now, wanted, budget) if budget.updates > 0.0 else ({}, 0.0)
        images = valid.copy()
        images[list(fresh)] = True
        self._counts[seen.which[images]] += 1
        geometry = Moving(seen.which[~images], seen.poses[~images])
        reliefs = self._reliefs(seen, np.flatnonzero(images))
        self._count(len(geometry.which), len(fresh), int(valid.sum()))
        self._last = (time, view.eye)
        costs = budget.costs
        shapes = len(np.unique(self._movers.kinds[geometry.which]))
        drawing = costs.draw * (shapes + len(reliefs)) + costs.triangle * int(self._triangles[geometry.which].sum())
        drawing += costs.relief * int(self._pixels[seen.which[images]].sum())
        draws = ((geometry,) if shapes else ()) + reliefs
        return Chosen(tuple(fresh.values()), draws, updating, drawing)

    def _look(self, view: View, seen: SeenMovers, time: float, budget: Budget) -> _Now:
        """What the calculations need to know. In the first frame the viewer is taken to stand, and objects to go on."""
        before, eye = (time - budget.frame, view.eye) if self._last is None else self._last
        uv = view.project(seen.corners)
        ahead = np.asarray((uv[..., 2] > _AHEAD).all(axis=1))
        pixels = np.where(ahead[:, None, None], uv[..., :2], 0.0)
        low, high = pixels.min(axis=1), pixels.max(axis=1)
        moved = seen.poses @ _inverses(self._movers.poses(before, seen.which))
        eyes = relative_viewpoint(seen.poses, view.eye)
        return _Now(eyes, moved, view.eye, view.eye - eye, low, high, np.hypot(*(high - low).T), ahead)

    # ------------------------------------------------------------------------------------------------ what is valid

    def _valid(self, which: NDArray[np.int64], now: _Now) -> NDArray[np.bool_]:
        """(k,) which objects have an image that may be shown."""
        sizes = self._sizes[which]
        scale = np.divide(now.sizes, sizes, out=np.zeros(len(which)), where=sizes > 0.0)
        held = now.ahead & (scale <= self._rules.coarsest) & (scale >= _SHRUNK)
        places = np.flatnonzero(held)
        some = which[places]
        if self._rules.calculation == "common":
            angles = error_angle(now.eyes[places], self._eyes[some], self._movers.boxes[some], _SAFE)
            held[places] = angles <= self._limit
            return held
        left = self._safe[some] - np.linalg.norm(now.eyes[places] - self._eyes[some], axis=1)
        over = (self._frame > self._until[some]) & (left >= 0.0)
        self._until[some[over]] = self._frame + self._predicted(left[over], places[over], now)
        held[places] = (left >= 0.0) & (self._frame <= self._until[some])  # whatever was predicted, left counts
        return held

    def _predicted(self, distance: NDArray[np.float64], places: NDArray[np.intp], now: _Now) -> NDArray[np.int64]:
        """Whole frames (m,) in which the eyes of objects at ``places`` (m,) stay within ``distance`` (m,), if all are alike."""
        return frames_at_equal_steps(distance, now.moved[places], now.eye, now.step, most=_MOST_FRAMES)

    # --------------------------------------------------------------------------------------------- what is captured

    def _capture(
        self, view: View, seen: SeenMovers, now: _Now, places: NDArray[np.intp], budget: Budget
    ) -> tuple[dict[int, Request], float]:
        """Requests by place among the ``seen``, the nearest first, and what they are predicted to take, seconds."""
        places = places[now.ahead[places] & (seen.distances[places] >= self._rules.nearest)]
        low = np.floor(now.low[places]).astype(np.int64) - _MARGIN
        sizes = np.ceil(now.high[places]).astype(np.int64) + _MARGIN - low
        fits = sizes.max(axis=1, initial=0) <= self._rules.largest
        places, low, sizes = places[fits], low[fits], sizes[fits]
        which, costs = seen.which[places], budget.costs
        safe = safe_distance(now.eyes[places], self._movers.boxes[which], _SAFE, self._limit)
        frames = self._predicted(safe, places, now)
        pixels = sizes.prod(axis=1)
        cost = costs.request + costs.draw + costs.captured * self._triangles[which] + costs.pixel * pixels
        good = np.ones(len(places), dtype=bool)
        if self._rules.calculation == "predictive":
            good = frames >= self._rules.least_frames
            if self._rules.thrifty:
                gain = costs.triangle * self._triangles[which] - costs.relief * pixels
                good &= gain * frames > cost
        room = min(budget.updates, _UPDATES * budget.frame)
        requests: dict[int, Request] = {}
        updating = 0.0
        for i in np.flatnonzero(good).tolist():
            if updating + cost[i] > room:
                break
            place = self._room(int(which[i]), int(sizes[i].max()))
            if place is None:
                continue
            updating += float(cost[i])
            here = int(places[i])
            (left, top), (width, height) = low[i].tolist(), sizes[i].tolist()
            picture = _Picture(
                place=place,
                view=view.cropped((left, top, width, height)),
                pose=seen.poses[here],
                filling=float(view.project(seen.corners[here].mean(axis=0))[2]),
                frame=self._frame,
            )
            one = int(which[i])
            self._pictures[one] = picture
            self._eyes[one], self._sizes[one] = now.eyes[here], now.sizes[here]
            self._safe[one], self._until[one] = safe[i], self._frame + int(frames[i])
            self._shown[one], self._counts[one] = self._frame, 0
            self._pixels[one] = pixels[i]
            slot = Slot(self._image, (self._size, self._size), place.corner)
            requests[here] = Request(slot, picture.view, (Moving(which[i : i + 1], seen.poses[here][None]),))
        return requests, updating

    def _room(self, one: int, needed: int) -> Place | None:
        """A place for a picture of this object, perhaps that of one which is not shown now; None where there is none."""
        if one in self._pictures:
            self._forget(one)
        place = self._slots.take(needed, needed)
        if place is not None:
            return place
        idle = [other for other in self._pictures if self._shown[other] < self._frame - 1]
        for other in sorted(idle, key=lambda other: (self._shown[other], other)):
            self._forget(other)
            place = self._slots.take(needed, needed)
            if place is not None:
                return place
        return None

    def _forget(self, one: int) -> None:
        """Give back the place of an object's picture, which counts as ended."""
        picture = self._pictures.pop(one)
        self._slots.give_back(picture.place)
        self._sizes[one] = 0.0
        self.tally = self.tally._replace(ended=self.tally.ended + 1, shown=self.tally.shown + int(self._counts[one]))

    # ------------------------------------------------------------------------------------------------- what is drawn

    def _reliefs(self, seen: SeenMovers, places: NDArray[np.intp]) -> tuple[Relief, ...]:
        """The images of the objects at ``places``, those of places of one size together: all parts of a relief share a grid."""
        parts: dict[int, list[ReliefPart]] = {}
        then = [self._pictures[one] for one in seen.which[places].tolist()]
        if not then:
            return ()
        moved = seen.poses[places] @ _inverses(np.array([picture.pose for picture in then]))
        for picture, way in zip(then, moved, strict=True):
            part = ReliefPart(
                picture.view, picture.place.corner, picture.filling, None if picture.frame == self._frame else way
            )
            parts.setdefault(picture.place.size[0], []).append(part)
        return tuple(Relief(self._image, tuple(parts[side])) for side in sorted(parts, reverse=True))

    def _count(self, geometry: int, captured: int, reused: int) -> None:
        tally = self.tally
        self.tally = tally._replace(
            frames=tally.frames + 1,
            geometry=tally.geometry + geometry,
            captured=tally.captured + captured,
            reused=tally.reused + reused,
        )


def _inverses(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """(k, 4, 4) model_from_world of rigid ``poses``."""
    turned = np.swapaxes(poses[:, :3, :3], 1, 2)
    found = np.zeros_like(poses)
    found[:, :3, :3], found[:, 3, 3] = turned, 1.0
    found[:, :3, 3] = -np.einsum("nij,nj->ni", turned, poses[:, :3, 3])
    return found
