"""Scores of techniques: each view drawn by the technique and by the geometry, with one measuring renderer.

Where layers were captured from, and so what their captures cannot have seen, is known for each cell: a view's disocclusion
mask compares its surfaces with the geometry as seen from there. Drawing goes on while earlier views are compared, in other
processes where there may be some (FLIP keeps all other threads of its process waiting).
"""

from __future__ import annotations

import heapq
import math
import os
import signal
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import active_children, get_context
from multiprocessing.process import BaseProcess
from types import TracebackType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View
from mmi.foundation.errors import CaptureError
from mmi.foundation.processes import how_it_ended, quiet_libraries, without_interrupts
from mmi.walks.walk import Pose
from viewer.cells.cell_cache import CellCache
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.drawing.renderer import Renderer
from viewer.measuring.disocclusion import disocclusion_mask, panorama_views
from viewer.measuring.view_errors import ViewErrors, WrongRegions, view_errors, wrong_regions
from viewer.plan import Ground, Moving, Plan
from viewer.scene.scene import WalkScene

__all__ = ["Judge", "Scored", "WorstView"]

_PENDING = 8
"""At most this many views wait to be compared; each of them holds two pictures."""


@dataclass(frozen=True, slots=True)
class Scored:
    """A technique's errors in one view; ``time`` in seconds where the view is part of a walk."""

    technique: str
    cell: str
    pose: Pose
    time: float | None
    errors: ViewErrors


@dataclass(frozen=True, slots=True, eq=False)
class WorstView:
    """A view that is among a technique's worst, with its pictures."""

    scored: Scored
    truth: NDArray[np.uint8]
    shown: NDArray[np.uint8]
    regions: WrongRegions


class Judge:
    """Draws views, compares them, and keeps the worst. Use as a context manager.

    ``keep`` views are kept as pictures for each technique; ``flip`` also takes the slowest of the measures; ``workers``
    processes compare, or this one where that is 1.
    """

    def __init__(
        self,
        scene: WalkScene,
        renderer: Renderer,
        cache: CellCache,
        *,
        keep: int = 8,
        flip: bool = True,
        workers: int = 1,
    ) -> None:
        self._scene, self._renderer, self._cache, self._camera = scene, renderer, cache, scene.camera
        self._keep, self._flip = keep, flip
        self._panorama: tuple[str, dict[int, tuple[View, NDArray[np.float32]]]] = ("", {})
        self._pool: ProcessPoolExecutor | None = None
        self._processes: list[BaseProcess] = []
        if workers > 1:
            # No more than can be busy at a time.
            processes = min(workers, _PENDING + 1)
            others = active_children()
            self._pool = ProcessPoolExecutor(processes, get_context("spawn"), initializer=_leave_it_to_the_parent)
            with without_interrupts():  # a task that meets no idle process starts one: all of them at once, here
                for _ in range(processes):
                    self._pool.submit(os.getpid)
            self._processes = [process for process in active_children() if process not in others]
        self._pending: list[tuple[_Where, DrawnPicture, DrawnPicture, Future[ViewErrors]]] = []
        self._worst: dict[str, list[tuple[float, float, int, WorstView]]] = {}
        self._scored: list[Scored] = []
        self._order = 0

    def __enter__(self) -> Judge:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def truth(self, plan: Plan, pose: Pose, cell: str) -> tuple[DrawnPicture, NDArray[np.bool_]]:
        """The geometry's measured picture, and what of it cannot be seen from the reference viewpoint of ``cell``."""
        view = pose.view(self._camera)
        picture = self._renderer.draw(plan, view, measured=True)
        assert picture.depth is not None
        return picture, disocclusion_mask(picture.depth, view, self._captured(plan, pose, cell))

    def score(
        self,
        technique: str,
        plan: Plan,
        pose: Pose,
        truth: tuple[DrawnPicture, NDArray[np.bool_]],
        *,
        cell: str,
        time: float | None = None,
    ) -> DrawnPicture:
        """Draw a ``plan`` of the technique of this name and have it compared with ``truth``. Returns the picture."""
        picture, hidden = truth
        self._cache.want(plan.cells)
        self._cache.require(plan.cells)
        shown = self._renderer.draw(plan, pose.view(self._camera), measured=True)
        where = _Where(technique, cell, pose, time)
        task = (picture, shown, self._camera.focal, hidden, self._flip)
        if self._pool is None:
            self._settle(where, picture, shown, _compare(*task))
        else:
            with self._while_alive():
                self._pending.append((where, picture, shown, self._pool.submit(_compare, *task)))
        if len(self._pending) > _PENDING:
            self._settle_first()
        return shown

    def results(self) -> list[Scored]:
        """All scores so far, in the order in which they were asked for."""
        while self._pending:
            self._settle_first()
        return list(self._scored)

    def worst(self, technique: str) -> Iterator[WorstView]:
        """The technique's worst views: thickest wrong region first, then the larger share of wrong pixels."""
        self.results()
        for *_, view in sorted(self._worst.get(technique, []), key=lambda one: (-one[0], -one[1], one[2])):
            yield view

    @contextmanager
    def _while_alive(self) -> Iterator[None]:
        try:
            yield
        except BrokenProcessPool as error:
            # When one ends the others are told to (SIGTERM): the one to blame is another one, if there is any.
            for process in self._processes:
                process.join(timeout=1.0)
            ended = [process for process in self._processes if process.exitcode not in (None, 0)]
            ended.sort(key=lambda process: process.exitcode == -signal.SIGTERM)
            how = f" ({how_it_ended(ended[0])})" if ended else ""
            raise CaptureError(f"a process that compares pictures ended unexpectedly{how}") from error

    def _settle_first(self) -> None:
        where, truth, shown, future = self._pending.pop(0)
        with self._while_alive():
            errors = future.result()
        self._settle(where, truth, shown, errors)

    def _settle(self, where: _Where, truth: DrawnPicture, shown: DrawnPicture, errors: ViewErrors) -> None:
        scored = Scored(*where, errors)
        self._scored.append(scored)
        if not self._keep or not errors.wrong_share:
            return
        view = WorstView(scored, truth.color, shown.color, wrong_regions(truth, shown))
        kept = self._worst.setdefault(scored.technique, [])
        self._order += 1
        heapq.heappush(kept, (errors.thickness_px, errors.wrong_share, self._order, view))
        if len(kept) > self._keep:
            heapq.heappop(kept)

    def _captured(self, full: Plan, pose: Pose, cell: str) -> list[tuple[View, NDArray[np.float32]]]:
        """The geometry as seen from the cell's reference viewpoint, as far as ``pose`` may look there."""
        if self._panorama[0] != cell:
            self._panorama = (cell, {})
        known = self._panorama[1]
        reference = self._scene.cell(cell).cell.reference
        views = panorama_views(reference, camera=self._camera)
        captured = []
        for i, view in enumerate(views):
            ahead = -view.eye_from_world[2, :2]
            turned = abs(math.remainder(math.atan2(ahead[1], ahead[0]) - pose.azimuth, 2.0 * math.pi))
            if turned > self._camera.fov:
                continue
            if i not in known:
                tiles = self._scene.ground_in(view)
                draws = tuple(
                    tiles if isinstance(draw, Ground) else draw for draw in full.draws if not isinstance(draw, Moving)
                )
                depth = self._renderer.draw(Plan(draws), view, measured=True).depth
                assert depth is not None
                known[i] = (view, depth)
            captured.append(known[i])
        return captured


class _Where(NamedTuple):
    """What :class:`Scored` says besides errors."""

    technique: str
    cell: str
    pose: Pose
    time: float | None


def _compare(
    truth: DrawnPicture, shown: DrawnPicture, focal: float, disoccluded: NDArray[np.bool_], flip: bool
) -> ViewErrors:
    return view_errors(truth, shown, focal=focal, disoccluded=disoccluded, flip=flip)


def _leave_it_to_the_parent() -> None:
    """Ctrl-C is the business of the process that started this one, and so is what people read."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    quiet_libraries()
