"""What a technique is: views in, plans out. A plan says what to capture and what to draw, and does neither (DESIGN section 5).

    Technique.plan(view, now, budget) -> Plan
    Plan    = what must be in memory, what to capture into images first, what to draw then, perhaps over what was drawn before
    Request = draws into an image that stays on the GPU under its key; orders: all are executed, in order, before any draw
    Draw    = Sky | Ground | Objects | Faces | CellLayers | Relief | Nailboards | Moving | CastPixels | WarpedPicture |
              WarpedSamples (closed; ``viewer.drawing.renderer``; the last three are of ``viewer.computed``)
    finish  = what a plan does once it knows the depths of what was drawn: it returns further draws

Techniques, walks and the choice of what to load and to capture are plain Python and run without OpenGL. A technique knows
nothing but the views and the budgets that it was given, in order, and a budget is plain data: the same walk with the same
budgets, those of a recording say, gives the same plans.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View
from viewer.computed import CastPixels, WarpedPicture, WarpedSamples

__all__ = [
    "RELIEF_QUAD",
    "Budget",
    "CellKey",
    "CellLayers",
    "Costs",
    "Done",
    "Draw",
    "Faces",
    "Finish",
    "Ground",
    "ImageKey",
    "Moving",
    "Nailboards",
    "Objects",
    "Plan",
    "Relief",
    "ReliefPart",
    "Request",
    "Sky",
    "Slot",
    "Technique",
    "Work",
]


RELIEF_QUAD = 16
"""Texels from node to node of a relief's grid: smaller quads cost more to draw than they gain."""


class CellKey(NamedTuple):
    """A cell of a dataset; ``dataset`` is the name that a scene gives it, such as ``multi-mesh``."""

    dataset: str
    cell: str


class ImageKey(NamedTuple):
    """An image that stays on the GPU until a plan drops it. ``owner`` is the technique that had it captured."""

    owner: str
    name: str


@dataclass(frozen=True, slots=True)
class Sky:
    """The sky's gradient, wherever nothing was drawn before."""


@dataclass(frozen=True, slots=True)
class Ground:
    """Some ``tiles`` of the ground with its streets (objects of the ground's mesh), on a plain surface that has no end."""

    tiles: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Objects:
    """Geometry of some of the city's objects. ``key`` names the set: the same key means the same ``objects`` (n,) indices.

    An empty key names none: such a set is drawn once, and what drawing needs of it is not kept.
    """

    key: str
    objects: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Faces:
    """Geometry of some ``triangles`` (n,) of the city's mesh, by their numbers, whatever objects they belong to.

    ``key`` names the set as that of :class:`Objects` does. Of what is outside of the box ``clip`` (2, 3) nothing is drawn.
    """

    key: str
    triangles: NDArray[np.int32]
    clip: NDArray[np.float64] | None = None


@dataclass(frozen=True, slots=True)
class CellLayers:
    """Impostor layers of a cell: ``names`` as in the dataset (``s0.l2``), in drawing order."""

    cell: CellKey
    names: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ReliefPart:
    """What was captured as ``view``, into its image at ``corner`` (x, y; texels from the upper left).

    ``moved`` (4, 4) is world now from world then, for what has moved since and took its picture along; None where nothing did.
    Where no texel near tells a depth, the relief has that of ``filling``, metres along the axis of ``view``. ``spans``
    (columns, 2) say where something may be in each column of ``RELIEF_QUAD`` texels, of which the last may be narrower: from
    which row to which; None for everywhere.
    """

    view: View
    corner: tuple[int, int]
    filling: float
    moved: NDArray[np.float64] | None = None
    spans: NDArray[np.int64] | None = None

    @property
    def grid(self) -> tuple[int, int]:
        """How many columns and rows of quads its relief has, of two triangles each."""
        _, _, width, height = self.view.window
        highest = height if self.spans is None else max(int((self.spans[:, 1] - self.spans[:, 0]).max()), 1)
        return -(-width // RELIEF_QUAD), -(-highest // RELIEF_QUAD)

    @property
    def triangles(self) -> int:
        """Of its relief."""
        columns, rows = self.grid
        return 2 * columns * rows

    @property
    def pixels(self) -> int:
        """How many pixels of what was captured its relief has."""
        _, _, width, height = self.view.window
        return width * height if self.spans is None else RELIEF_QUAD * int((self.spans[:, 1] - self.spans[:, 0]).sum())


@dataclass(frozen=True, slots=True, eq=False)
class Relief:
    """Parts of a captured image, each drawn as a regular grid that its depths displace (paper section 5.5).

    Every pixel has the depth of the surface point that its texel captured, so that the z-buffer composes what was captured
    with all else. Seen from where it was captured a part is that very picture, texel for pixel.
    """

    image: ImageKey
    parts: tuple[ReliefPart, ...]

    @property
    def pixels(self) -> int:
        """Pixels of all parts, as they were captured."""
        return sum(part.pixels for part in self.parts)


@dataclass(frozen=True, slots=True, eq=False)
class Nailboards:
    """n parts of a captured image, each on a quadrilateral across the axis along which it was captured, with depth.

    A pixel has the depth of the surface point that its texel captured, so that what several boards show is in the right order
    (Schaufler 1997, "Nailboards"); where it appears is decided by the quadrilateral alone, which takes two triangles.
    ``captures`` (n, 4, 4) are eye_from_world of what was captured, ``windows`` (n, 4) of that image plane at ``focal`` are at
    ``corners`` (n, 2) of the image, ``depths`` (n,) metres along the axis is where the quadrilaterals stand, and ``fresh`` (n,)
    says which were captured in this frame.
    """

    image: ImageKey
    focal: float
    captures: NDArray[np.float64]
    windows: NDArray[np.int64]
    corners: NDArray[np.int64]
    depths: NDArray[np.float64]
    fresh: NDArray[np.bool_]

    @property
    def pixels(self) -> int:
        """Pixels of all parts, as they were captured."""
        return int(self.windows[:, 2:].prod(axis=1).sum())


@dataclass(frozen=True, slots=True, eq=False)
class Moving:
    """Geometry of some of the objects that move: ``which`` (k,) of them, with ``poses`` (k, 4, 4), world from object.

    In measured pictures their ids follow those of the city's objects, in the order that they have in their file.
    """

    which: NDArray[np.int64]
    poses: NDArray[np.float64]


Draw = (
    Sky
    | Ground
    | Objects
    | Faces
    | CellLayers
    | Relief
    | Nailboards
    | Moving
    | CastPixels
    | WarpedPicture
    | WarpedSamples
)
"""What a plan is made of: a closed union, of which the renderer draws each kind."""


class Slot(NamedTuple):
    """A place in an image of ``size`` (width, height): what begins at ``corner`` (x, y), texels from the upper left."""

    image: ImageKey
    size: tuple[int, int]
    corner: tuple[int, int] = (0, 0)


@dataclass(frozen=True, slots=True, eq=False)
class Request:
    """An order to draw ``draws`` as ``view`` sees them into a place of an image, which is as large as the view's window.

    The image keeps colour (premultiplied, alpha is coverage), depth along the axis of ``view`` and object ids. Without
    ``clear`` it also keeps what is there, and draws are added to that: a picture may be captured a part at a time. An image
    that is asked for in another size begins anew.
    """

    into: Slot
    view: View
    draws: tuple[Draw, ...]
    clear: bool = True

    @property
    def pixels(self) -> int:
        """Pixels of the place."""
        return self.view.window[2] * self.view.window[3]


Finish = Callable[[NDArray[np.float32], int], tuple[Draw, ...]]
"""What a plan does with the depths (h, w), metres along the view's axis and infinite for sky, of what its draws have shown: it
returns what is drawn over that, and does not keep them. Where a frame takes some of the view's columns only, the second number
is the first of them.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """One frame.

    ``drops`` are images that are not needed any more; then ``requests`` are executed, in order. ``draws`` in order: what is
    likely to hide the rest first. ``place`` is the cell that the viewer is in. The layers of ``cells`` must be in memory for
    it, ``ahead`` are cells worth loading next, most urgent first. Where ``mix`` is below 1, the picture of ``fading`` is mixed
    in: ``mix`` of draws, 1 - ``mix`` of fading. ``finish`` is asked for further draws when ``draws`` have been drawn, and again
    where a plan is drawn again, which it should then complete in the same way.
    """

    draws: tuple[Draw, ...]
    place: str = ""
    cells: tuple[CellKey, ...] = ()
    ahead: tuple[CellKey, ...] = ()
    fading: tuple[Draw, ...] = ()
    mix: float = 1.0
    requests: tuple[Request, ...] = ()
    drops: tuple[ImageKey, ...] = ()
    finish: Finish | None = None

    def same_as(self, other: Plan) -> bool:
        """Whether both say the same (sets of objects by their key), what they finish with aside: for replayed walks."""
        return _told(self) == _told(other)


class Work(NamedTuple):
    """What was done in ``seconds``: ``triangles`` in ``draws`` calls; some of them were reliefs, of ``relief`` pixels in all.

    Where it was done for ``requests``, they captured ``pixels`` of images.
    """

    seconds: float = 0.0
    triangles: int = 0
    draws: int = 0
    pixels: int = 0
    requests: int = 0
    relief: int = 0


class Done(NamedTuple):
    """What a frame's ``requests`` and its ``draws`` took, apart from each other, and the seconds that it took to ``finish``.

    ``fresh`` are the pixels whose surfaces were found in this frame, in ``finding`` of those seconds.
    """

    requests: Work = Work()
    draws: Work = Work()
    finish: float = 0.0
    fresh: int = 0
    finding: float = 0.0


class Costs(NamedTuple):
    """Seconds that things take on a machine: a frame, a draw, a triangle, a request, a captured pixel, a pixel of a relief.

    ``frame`` is what a frame takes whatever it draws: the making of its plan, ground and sky, loading. ``captured`` is what a
    triangle takes in a request, where more of them are outside of what is seen. Plain numbers, so that a recording has them
    (:mod:`viewer.runtime.cost_model` finds and refines them). The ones given here are those of software OpenGL on two cores,
    for those who have no better ones.
    """

    frame: float = 2e-3
    draw: float = 5e-5
    triangle: float = 1e-7
    request: float = 2e-4
    pixel: float = 8e-9
    relief: float = 2e-8
    captured: float = 1e-7

    def of_draws(self, *, triangles: int, draws: int, relief: int = 0) -> float:
        """Seconds that a frame is predicted to take, requests aside; ``relief`` is the pixels of its reliefs as captured."""
        return self.frame + self.draw * draws + self.triangle * triangles + self.relief * relief

    def of_request(self, *, triangles: int, draws: int, pixels: int, relief: int = 0) -> float:
        """Seconds that a request is predicted to take; ``relief`` is the pixels of reliefs that it draws."""
        return self.request + self.draw * draws + self.captured * triangles + self.relief * relief + self.pixel * pixels


@dataclass(frozen=True, slots=True)
class Budget:
    """Time for a frame, in seconds, what things cost, and what was ``done`` in the last frame; None before the first.

    A whole frame should take at most ``frame``. ``updates`` is what requests may take of it at most; 0 forbids them.
    """

    frame: float = 1.0 / 30.0
    updates: float = math.inf
    costs: Costs = field(default_factory=Costs)
    done: Done | None = None


class Technique(Protocol):
    """A way to draw a city."""

    @property
    def name(self) -> str:
        """What reports call it: ``multi-mesh``."""
        ...

    def plan(self, view: View, *, now: float, budget: Budget) -> Plan:
        """The frame for ``view`` at time ``now`` (seconds). May keep state between calls: views come in order."""
        ...


def _told(plan: Plan) -> tuple[object, ...]:
    """The plan in values that can be compared."""
    requests = [
        (request.into, _told_view(request.view), _told_draws(request.draws), request.clear) for request in plan.requests
    ]
    draws, fading = _told_draws(plan.draws), _told_draws(plan.fading)
    return requests, draws, fading, plan.place, plan.cells, plan.ahead, plan.mix, plan.drops


def _told_draws(draws: Iterable[Draw]) -> list[object]:
    return [_told_draw(draw) for draw in draws]


def _told_draw(draw: Draw) -> object:
    match draw:
        case Objects():
            return "objects", draw.key or draw.objects.tobytes()
        case Faces():
            return "faces", draw.key or draw.triangles.tobytes(), _told_array(draw.clip)
        case Nailboards():
            told = (draw.captures, draw.windows, draw.corners, draw.depths, draw.fresh)
            return "nailboards", draw.image, draw.focal, [one.tobytes() for one in told]
        case Relief():
            parts = [
                (_told_view(one.view), one.corner, one.filling, _told_array(one.moved), _told_array(one.spans))
                for one in draw.parts
            ]
            return "relief", draw.image, parts
        case CastPixels():
            return "cast", draw.samples.tobytes()
        case WarpedPicture():
            return "warped", draw.color.tobytes(), draw.depth.tobytes()
        case WarpedSamples():
            return "samples", draw.key
        case Moving():
            return "moving", draw.which.tobytes(), draw.poses.tobytes()
        case _:
            return draw


def _told_view(view: View) -> object:
    return view.eye_from_world.tobytes(), view.focal, view.window


def _told_array(array: NDArray[np.generic] | None) -> bytes | None:
    return None if array is None else array.tobytes()
