"""What drawing takes on this machine before anything of a walk was drawn: frames of known work, timed in less than a second.

The frames draw a part of the city from a place in it: more and fewer triangles, in one call and in many, as captures of large
and small windows and as reliefs of them. They take turns, so that a noisy moment of the machine meets all of them, and of what
each took the median counts. Costs that explain them are fitted (:func:`viewer.runtime.cost_model.fitted`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mmi.foundation.camera import View
from mmi.walks.walk import Pose
from viewer.plan import Costs, Done, Draw, ImageKey, Objects, Plan, Relief, ReliefPart, Request, Sky, Slot, Work
from viewer.runtime.cost_model import fitted
from viewer.runtime.loop import Painter
from viewer.scene.scene import WalkScene

__all__ = ["CAUTION", "calibrated"]

CAUTION = 1.3
"""Costs are so many times what was found. The first frames of a walk cover more of the view than those drawn here, and what is
drawn for the first time takes longer; costs that are too high are lowered by a few frames, too low ones make them late."""
_SECONDS = 0.6
"""Of drawing; what comes on top is the first time that each frame is drawn, and making their sets of objects."""
_ROUNDS = 9
"""Each frame is drawn so often at most, and twice at least."""
_TRIANGLES = 30_000
"""A frame draws at most about as many, because all of them together are to take less than a second."""
_FEWEST = 5_000
"""A frame has about as many where that is possible: small cities are drawn several times."""
_SPLIT = 16
"""Draws into which what one draws is cut, to tell what a draw costs."""
_SMALL = 32
"""Pixels a side of a small capture."""
_OWNER = "calibration"


def calibrated(painter: Painter, scene: WalkScene) -> Costs:
    """What things cost where ``painter`` draws ``scene``, whose meshes it has. Nothing that is captured for it stays."""
    plans, view = _plans(scene)
    done: list[list[Done]] = [[] for _ in plans]
    for plan in plans:
        painter.draw(plan, view, read=False)  # sets of objects are made, shaders compiled
    spent = 0.0
    for number in range(_ROUNDS):
        if number >= 2 and spent * (number + 1) / number > _SECONDS:
            break
        for plan, found in zip(plans, done, strict=True):
            picture = painter.draw(plan, view, read=False)
            found.append(picture.done)
            spent += picture.seconds
    images = dict.fromkeys(request.into.image for plan in plans for request in plan.requests)
    painter.draw(Plan((Sky(),), drops=tuple(images)), view, read=False)
    costs = fitted(
        [_typical([one.draws for one in some]) for some in done],
        [_typical([one.requests for one in some]) for some in done],
    )
    return Costs(*(CAUTION * cost for cost in costs))


def _plans(scene: WalkScene) -> tuple[list[Plan], View]:
    """Frames of known work, and the view that they are drawn from: along a cell in the middle of the dataset."""
    cells = scene.whereabouts.cells
    cell = cells[len(cells) // 2]
    eye = cell.reference
    pose = Pose(
        (float(eye[0]), float(eye[1]), float(eye[2])), math.atan2(cell.q[1] - cell.p[1], cell.q[0] - cell.p[0]), 0.0
    )
    view = pose.view(scene.camera)
    ground = scene.ground_in(view)
    seen = _at_most(scene, _in_front(scene, view, scene.cell(cell.id).visible))
    some = Objects(f"{_OWNER} seen", seen)
    few = Objects(f"{_OWNER} few", seen[:: max(1, len(seen) // 4)])
    far = Objects(f"{_OWNER} all", _at_most(scene, np.arange(len(scene.mesh.triangle_counts))))
    again = (far,) * min(max(_FEWEST // max(int(scene.mesh.triangle_counts[far.objects].sum()), 1), 1), _SPLIT)
    split = [Objects(f"{_OWNER} {i}", part) for i, part in enumerate(np.array_split(seen, _SPLIT)) if len(part)]
    left, top, width, height = view.window
    half = view.cropped((left + width // 4, top + height // 4, max(width // 2, 1), max(height // 2, 1)))
    small = view.cropped((-min(_SMALL, width) // 2, -min(_SMALL, height) // 2, min(_SMALL, width), min(_SMALL, height)))
    large = _captured("large", view, some)
    middle = _captured("middle", half, some)
    smalls = [_captured(f"small {i}", small, few) for i in range(8)]
    empty = _captured("empty", view)
    frames: list[tuple[tuple[Draw, ...], Sequence[Request]]] = [
        ((), smalls),
        ((few, ground), (large,)),
        ((some,), (middle,)),
        (again, (_captured("far", view, *again),)),
        (tuple(split), (_captured("split", half, *split),)),
        ((_relief(large),), (large,)),
        ((_relief(middle), few), (middle, empty)),
    ]
    return [Plan((*draws, Sky()), requests=tuple(requests)) for draws, requests in frames], view


def _at_most(scene: WalkScene, objects: np.ndarray) -> np.ndarray:
    """The first of ``objects`` (n,) as far as they have no more than about ``_TRIANGLES``."""
    return objects[: 1 + int(np.searchsorted(np.cumsum(scene.mesh.triangle_counts[objects]), _TRIANGLES))]


def _in_front(scene: WalkScene, view: View, objects: np.ndarray) -> np.ndarray:
    """``objects`` (n,), the nearest to what ``view`` looks at first: together they cover what they are seen through."""
    middle = scene.boxes[objects].mean(axis=1) @ view.eye_from_world[:3, :3].T + view.eye_from_world[:3, 3]
    aside = np.hypot(middle[:, 0], middle[:, 1])
    return objects[np.argsort(np.where(middle[:, 2] < 0.0, aside / -middle[:, 2], math.inf), kind="stable")]


def _captured(name: str, view: View, *draws: Draw) -> Request:
    return Request(Slot(ImageKey(_OWNER, name), view.window[2:]), view, draws)


def _relief(request: Request) -> Relief:
    return Relief(request.into.image, (ReliefPart(request.view, (0, 0), 100.0),))


def _typical(works: Sequence[Work]) -> Work:
    """The one that took the median time of some that did the same."""
    return sorted(works, key=lambda work: work.seconds)[len(works) // 2]
