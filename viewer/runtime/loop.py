"""The frame loop: plans are made, what they need is brought in, they are drawn, and all of it is timed.

Where the viewer is comes from a walk and its fixed steps, never from the clock, so that a walk replayed gives the same plans
and pictures on any machine. What a frame took is the time from asking for its plan to the finished picture, loading
included.
"""

from __future__ import annotations

import time
from bisect import bisect_left, insort
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from mmi.foundation.camera import Camera, View
from viewer.cells.cell_cache import CellCache
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.drawing.thread_turns import turns_after
from viewer.plan import Budget, Plan, Technique
from viewer.walks.walk import Step

__all__ = ["FrameTimes", "Painter", "run_walk"]

_UPLOADING = 0.1
"""Share of a usual frame's time that uploads of cells ahead may take in one."""
_RECENT = 1024
"""Frames whose median says what a frame takes."""
_DEAR = 1.2
"""Times that, from which on a frame is dear enough: uploads of cells ahead wait for another one."""
_SWITCH_INTERVAL = 1.0
"""Seconds after which the loading thread may take the interpreter from a frame: what reads files may not give it back for
milliseconds. It gets it while OpenGL draws."""


class Painter(Protocol):
    """What draws plans: a renderer, or a test's double of one."""

    def draw(self, plan: Plan, view: View, *, read: bool = True) -> DrawnPicture:
        """Draw ``plan`` as ``view`` sees it."""
        ...


@dataclass(frozen=True, slots=True)
class FrameTimes:
    """One frame of a walk: seconds ``total``, of which ``drawing``, ``uploading`` cells ahead and ``waiting`` for cells.

    ``gpu`` is what the GPU says of the drawing. ``entered``: the viewer is in another cell than in the last frame.
    ``loading`` is what a walk waits for before its first frame and where it is cut, as behind a loading screen: its cell and
    the one that it will most likely come to next; no part of ``total``.
    """

    time: float
    cell: str
    entered: bool
    cut: bool
    total: float
    drawing: float
    gpu: float | None
    uploading: float
    waiting: float
    loading: float
    triangles: int
    draws: int


def run_walk(
    steps: Sequence[Step],
    technique: Technique,
    painter: Painter,
    cache: CellCache,
    *,
    camera: Camera,
    budget: float = 1.0 / 30.0,
    read: bool = False,
    shown: Callable[[Step, View, Plan, DrawnPicture], None] | None = None,
) -> list[FrameTimes]:
    """Draw every step of a walk with a technique; what each frame took.

    ``budget`` is the time that a frame should take, in seconds. Each frame follows the last at once. ``shown`` gets each frame
    after it was timed, with its colours if ``read``. Raises DatasetError where a cell's files are missing or damaged.
    """
    times: list[FrameTimes] = []
    last, place = 0.0, ""
    recent: deque[float] = deque()
    ranked: list[float] = []  # the same, sorted
    with turns_after(_SWITCH_INTERVAL):
        for step in steps:
            view = step.pose.view(camera)
            start = time.perf_counter()
            plan = technique.plan(view, now=step.time, budget=Budget(budget, last))
            cache.want(plan.cells, plan.ahead)
            planned = time.perf_counter() - start
            loading = cache.require((*plan.cells, *plan.ahead[:1]), counted=False) if step.cut else 0.0
            waiting = cache.require(plan.cells)
            picture = painter.draw(plan, view, read=read)
            spent = planned + waiting + picture.seconds
            usual = ranked[len(ranked) // 2] if ranked else spent
            uploading = cache.spend(_UPLOADING * usual) if spent <= _DEAR * usual else 0.0
            total = spent + uploading
            times.append(
                FrameTimes(
                    time=step.time,
                    cell=plan.place,
                    entered=plan.place != place and not step.cut,
                    cut=step.cut,
                    total=total,
                    drawing=picture.seconds,
                    gpu=picture.gpu_seconds,
                    uploading=uploading,
                    waiting=waiting,
                    loading=loading,
                    triangles=picture.triangles,
                    draws=picture.draws,
                )
            )
            last, place = total, plan.place
            if len(recent) == _RECENT:
                del ranked[bisect_left(ranked, recent.popleft())]
            recent.append(spent)
            insort(ranked, spent)
            if shown is not None:
                shown(step, view, plan, picture)
    return times
