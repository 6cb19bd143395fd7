"""Processes that find the images of points and make their pictures; with one worker it is this process itself."""

from __future__ import annotations

import os
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.errors import DatasetError, FaultError, MmiError
from mmi.foundation.processes import how_it_ended, peak_memory, quiet_libraries, without_interrupts
from viewer.layered.image_codec import encoded
from viewer.making.image_capture import ImageCapture
from viewer.making.models import Model, SharedMeshes, shared_meshes
from viewer.placed.folder import PlacedFolder, folder_of
from viewer.placing.model_cells import ModelCells
from viewer.placing.placements import Placements, placements_at
from viewer.placing.rules import PlacingRules
from viewer.placing.solution_grid import Needs

__all__ = ["Crew", "Made", "PicturesJob", "PointsJob", "crew_of"]


class PointsJob(NamedTuple):
    """Find the images of some ``points`` (k, 3), the first of which is the grid's point ``first``."""

    first: int
    points: NDArray[np.float64]
    needs: Sequence[Needs]


class PicturesJob(NamedTuple):
    """Make the image ``number`` of the folder at ``path`` and keep it."""

    path: Path
    number: int


class Made(NamedTuple):
    """An image that is kept, by its ``number``; its ``process`` has held ``memory`` bytes at most."""

    number: int
    process: int
    memory: int


@dataclass(frozen=True, slots=True)
class _Fault:
    """An error in a worker that is none of ours."""

    what: str
    trace: str


class _Worker:
    """What does jobs: it knows cells and rules, and, once pictures are asked for, the model, a folder and a renderer."""

    def __init__(self, meshes: SharedMeshes | Model, cells: ModelCells, rules: PlacingRules) -> None:
        self._meshes, self._cells, self._rules = meshes, cells, rules
        self._capture: ImageCapture | None = None
        self._folder: PlacedFolder | None = None

    def do(self, job: PointsJob | PicturesJob) -> tuple[int, list[Placements]] | Made:
        """Do a job. Raises what finding images, drawing and writing raise."""
        if isinstance(job, PointsJob):
            pairs = zip(job.points, job.needs, strict=True)
            return job.first, [placements_at(point, needs, self._cells, self._rules) for point, needs in pairs]
        if self._capture is None:
            some = self._meshes
            meshes = (some.mesh, some.ground) if isinstance(some, Model) else some.read()
            self._capture = ImageCapture(*meshes, self._cells)
        if self._folder is None or self._folder.path != job.path:
            self._folder = folder_of(job.path)
        image = self._capture.image(self._folder.solutions, job.number)
        self._folder.write_image(job.number, encoded(image))
        return Made(job.number, os.getpid(), peak_memory(shared=False))

    def close(self) -> None:
        """End the OpenGL context."""
        if self._capture is not None:
            self._capture.close()


class Crew:
    """Workers that do jobs, of :func:`crew_of`."""

    def __init__(self, worker: _Worker | None, processes: dict[Connection, BaseProcess], path: Path) -> None:
        self._worker, self._processes, self._path = worker, processes, path

    def do(self, jobs: Sequence[PointsJob | PicturesJob]) -> Iterator[Any]:
        """What comes of ``jobs``, in any order. Raises what they raise, and DatasetError where a process ends by itself."""
        if self._worker is not None:
            yield from map(self._worker.do, jobs)
            return
        waiting, busy, idle = list(reversed(jobs)), list[Connection](), list(self._processes)
        while busy or waiting:
            while waiting and idle:
                busy.append(idle.pop())
                try:
                    busy[-1].send(waiting.pop())
                except OSError as error:  # it ended while it had nothing to do
                    raise self._ended(busy[-1]) from error
            for ready in wait(busy):
                end = busy.pop(busy.index(ready))  # type: ignore[arg-type]
                try:
                    answer = end.recv()
                except (EOFError, OSError) as error:
                    raise self._ended(end) from error
                if isinstance(answer, _Fault):
                    raise FaultError(
                        f"{self._path}: {answer.what}; this is a fault of the program, please report it; what was finished "
                        "is kept"
                    ) from RuntimeError(answer.trace)
                if isinstance(answer, MmiError):
                    raise answer
                idle.append(end)
                yield answer

    def _ended(self, end: Connection) -> DatasetError:
        return DatasetError(
            f"{self._path}: a worker process ended unexpectedly ({how_it_ended(self._processes[end])}); run the same command "
            "again, perhaps with fewer --workers: what was finished is kept"
        )


@contextmanager
def crew_of(workers: int, path: Path, model: Model, cells: ModelCells, rules: PlacingRules) -> Iterator[Crew]:
    """``workers`` that place images of a model into the folder at ``path``; with one it is this process."""
    if workers == 1:
        worker = _Worker(model, cells, rules)
        try:
            yield Crew(worker, {}, path)
        finally:
            worker.close()
        return
    with shared_meshes(model, path) as meshes, _processes(workers, meshes, cells, rules) as processes:
        yield Crew(None, processes, path)


@contextmanager
def _processes(
    workers: int, meshes: SharedMeshes, cells: ModelCells, rules: PlacingRules
) -> Iterator[dict[Connection, BaseProcess]]:
    processes: dict[Connection, BaseProcess] = {}
    context = get_context("spawn")
    try:
        for _ in range(workers):
            ours, theirs = context.Pipe()
            process = context.Process(target=_serve, args=(theirs, meshes, cells, rules), daemon=True)
            with without_interrupts():
                process.start()
            theirs.close()
            processes[ours] = process
        yield processes
    finally:
        for end in processes:
            end.close()  # a worker ends when its pipe does
        for one in processes.values():
            one.join(timeout=10.0)
            one.kill()


def _serve(jobs: Connection, meshes: SharedMeshes, cells: ModelCells, rules: PlacingRules) -> None:
    """The life of a worker process: one job after another, until the pipe closes."""
    quiet_libraries()
    os.environ["LP_NUM_THREADS"] = "1"  # software OpenGL: one thread a worker, as there is a worker a core
    worker = _Worker(meshes, cells, rules)
    while True:
        try:
            job = jobs.recv()
        except (EOFError, OSError):
            return  # the parent has no more work, or is gone
        answer: Any
        try:
            answer = worker.do(job)
        except MmiError as error:
            answer = error
        except Exception as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{Path(place.filename).name}, line {place.lineno}"
            answer = _Fault(f"{type(error).__name__}: {error} ({where})", traceback.format_exc())
        try:
            jobs.send(answer)
        except OSError:
            return
