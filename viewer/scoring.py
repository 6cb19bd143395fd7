"""Scores of techniques: each view drawn by the technique and by the geometry, with one measuring renderer.

Where layers were captured from, and so what their captures cannot have seen, is known for each cell: a view's disocclusion
mask compares its surfaces with the geometry as seen from there. Drawing goes on while earlier views are compared in threads.
"""

from __future__ import annotations

import heapq
import math
import os
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from mmi.camera import Camera, View
from viewer.disocclusion import disocclusion_mask, panorama_views
from viewer.frame import Frame
from viewer.gl import Renderer
from viewer.quality import ViewErrors, WrongRegions, view_errors, wrong_regions
from viewer.scene import Scene
from viewer.streaming import CellCache
from viewer.technique import Budget, Plan, Technique
from viewer.walk import Pose

__all__ = ["Judge", "Scored", "WorstView"]

_PENDING = 8
"""Views that wait to be compared; each holds two frames."""


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
    """Draws, compares, and keeps the worst. Use as a context manager.

    ``keep`` views are kept as pictures for each technique; ``flip`` also takes the slowest of the measures.
    """

    def __init__(
        self, scene: Scene, renderer: Renderer, cache: CellCache, *, camera: Camera, keep: int = 8, flip: bool = True
    ) -> None:
        self._scene, self._renderer, self._cache, self._camera = scene, renderer, cache, camera
        self._keep, self._flip = keep, flip
        self._panorama: tuple[str, dict[int, tuple[View, NDArray[np.float32]]]] = ("", {})
        self._pool = ThreadPoolExecutor(len(os.sched_getaffinity(0)))
        self._pending: list[Future[tuple[Scored, WrongRegions, Frame, Frame]]] = []
        self._worst: dict[str, list[tuple[float, float, int, WorstView]]] = {}
        self._scored: list[Scored] = []
        self._order = 0

    def __enter__(self) -> Judge:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._pool.shutdown(cancel_futures=True)

    def truth(self, plan: Plan, pose: Pose, cell: str) -> tuple[Frame, NDArray[np.bool_]]:
        """The geometry's measured frame, and what of it cannot be seen from the reference viewpoint of ``cell``."""
        view = pose.view(self._camera)
        frame = self._renderer.draw(plan, view, measured=True)
        assert frame.depth is not None
        return frame, disocclusion_mask(frame.depth, view, self._captured(plan, pose, cell))

    def score(
        self,
        technique: Technique,
        plan: Plan,
        pose: Pose,
        truth: tuple[Frame, NDArray[np.bool_]],
        *,
        cell: str,
        time: float | None = None,
    ) -> Frame:
        """Draw a technique's ``plan`` and compare it with ``truth``; the frame."""
        self._cache.want(plan.cells)
        self._cache.require(plan.cells)
        shown = self._renderer.draw(plan, pose.view(self._camera), measured=True)
        self._pending.append(self._pool.submit(self._compare, technique.name, cell, pose, time, truth, shown))
        if len(self._pending) > _PENDING:
            self._settle(self._pending.pop(0))
        return shown

    def results(self) -> list[Scored]:
        """All scores so far, in the order in which they were asked for."""
        while self._pending:
            self._settle(self._pending.pop(0))
        return list(self._scored)

    def worst(self, technique: str) -> Iterator[WorstView]:
        """The technique's worst views: thickest wrong region first, then the larger share of wrong pixels."""
        self.results()
        for *_, view in sorted(self._worst.get(technique, []), key=lambda one: (-one[0], -one[1], one[2])):
            yield view

    def _compare(
        self,
        technique: str,
        cell: str,
        pose: Pose,
        time: float | None,
        truth: tuple[Frame, NDArray[np.bool_]],
        shown: Frame,
    ) -> tuple[Scored, WrongRegions, Frame, Frame]:
        frame, hidden = truth
        errors = view_errors(frame, shown, focal=self._camera.focal, disoccluded=hidden, flip=self._flip)
        return Scored(technique, cell, pose, time, errors), wrong_regions(frame, shown), frame, shown

    def _settle(self, future: Future[tuple[Scored, WrongRegions, Frame, Frame]]) -> None:
        scored, regions, truth, shown = future.result()
        self._scored.append(scored)
        view = WorstView(scored, truth.color, shown.color, regions)
        kept = self._worst.setdefault(scored.technique, [])
        self._order += 1
        if scored.errors.wrong_share > 0.0:
            heapq.heappush(kept, (scored.errors.thickness_px, scored.errors.wrong_share, self._order, view))
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
                draws = tuple(tiles if type(draw) is type(tiles) else draw for draw in full.draws)
                depth = self._renderer.draw(Plan(draws), view, measured=True).depth
                assert depth is not None
                known[i] = (view, depth)
            captured.append(known[i])
        return captured


def settled(technique: Technique, pose: Pose, camera: Camera, *, now: float = 0.0) -> Plan:
    """A technique's plan for one pose."""
    return technique.plan(pose.view(camera), now=now, budget=Budget())
