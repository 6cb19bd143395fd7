"""Worker processes that make cells, and what passes between them and the process that builds a dataset."""

from __future__ import annotations

import hashlib
import os
import traceback
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np

from mmi.appearance.city_mesh import CityMesh
from mmi.building.cell import capture_cell
from mmi.building.cheaper import cheaper_as_geometry
from mmi.building.halving import exceeded, halves
from mmi.capture.layer_values import Impostor
from mmi.cells.viewing_cells import ViewingCell
from mmi.city.codec import city_from_json, object_fingerprints
from mmi.city.model import City
from mmi.city.terrain import Terrain
from mmi.dataset.cell_files import write_cell
from mmi.dataset.folder import DatasetFolder
from mmi.dataset.manifest import FORMAT_VERSION, CellEntry, CellRecord
from mmi.foundation.errors import DatasetError, FaultError, MmiError
from mmi.foundation.json_forms import fingerprint
from mmi.foundation.plug_ins import said
from mmi.foundation.processes import (
    give_memory_back,
    how_it_ended,
    package_version,
    peak_memory,
    quiet_libraries,
    without_interrupts,
)
from mmi.foundation.progress import Stopwatch
from mmi.planning.parameters import BuildParameters
from mmi.planning.plan import CellPlan, plan_cell, prepare_city, without_layers

__all__ = ["Done", "Job", "costs_over_budget", "run_jobs"]


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """A cell to be made; ``neighbours`` are those of whole cells, ``common`` is the fingerprint of what all cells share."""

    cell: ViewingCell
    neighbours: tuple[str, ...]
    common: str

    @property
    def inputs(self) -> str:
        """Fingerprint of everything that the cell depends on."""
        return fingerprint([self.common, _cell_values(self.cell), self.neighbours])

    def halves(self) -> list[Job]:
        """What it is cut into where it exceeds a budget; nothing where it is too short for that."""
        return [replace(self, cell=half) for half in halves(self.cell) or ()]


@dataclass(frozen=True, slots=True, eq=False)
class Done:
    """What became of a job: its cell is recorded. ``halves`` are to be made instead where it exceeded a budget."""

    cell: str
    captured: bool
    halves: list[Job]
    seconds: dict[str, float]
    process: int
    peak_memory_bytes: int


def _cell_values(cell: ViewingCell) -> list[Any]:
    return [cell.id, cell.p, cell.q, cell.half_width, cell.eye, cell.street, cell.rise]


def costs_over_budget(parameters: BuildParameters, entry: CellEntry) -> dict[str, tuple[int, int]]:
    """The budgets that a cell of this entry exceeds."""
    triangles = entry.near_triangles + entry.triangles
    return exceeded(parameters, layers=entry.layer_count, triangles=triangles, stored_bytes=entry.bytes)


class _Worker:
    """One process's city, prepared once, and its OpenGL context."""

    def __init__(self, folder: DatasetFolder, city: City, parameters: BuildParameters) -> None:
        from mmi.capture.renderer import Capturer  # here, so that a parent of workers does not load OpenGL

        self.folder = folder
        self.preparation = Stopwatch()
        with self.preparation.stage("preparation"):
            self.prepared = prepare_city(city, parameters)
            self.ids = [one.id for one in self.prepared.city.objects]
            self.prints = _looks(self.prepared.mesh, object_fingerprints(city))
            self.atlas = hashlib.sha256(self.prepared.mesh.texture.data).hexdigest()
            self.terrain = _terrain_print(city.terrain)
            self.capturer = Capturer(self.prepared.mesh)

    def make(self, job: Job) -> Done:
        """Bring one cell up to date: its files if what it sees has changed, its record in any case."""
        watch, self.preparation = self.preparation, Stopwatch()  # the first cell's seconds include the preparation
        plan = plan_cell(self.prepared, job.cell, identify=self.capturer.identify, watch=watch)
        content = self._content(job, plan)
        record, parts = self.folder.record(job.cell.id), job.halves()
        captured = record is None or record.content != content
        entry = self._captured(job, plan, watch, may_cut=bool(parts)) if record is None or captured else record.entry
        if entry is None and captured:
            self.folder.remove_cell(job.cell.id)
        self.folder.write_record(job.cell.id, CellRecord(job.inputs, content, entry))
        seconds, memory = watch.seconds, peak_memory(shared=False)
        return Done(job.cell.id, captured, parts if entry is None else [], seconds, os.getpid(), memory)

    def _captured(self, job: Job, plan: CellPlan, watch: Stopwatch, *, may_cut: bool) -> CellEntry | None:
        """Capture the cell and write its files; None where it exceeds a budget and is to be cut instead."""
        parameters = self.prepared.parameters
        if may_cut and exceeded(parameters, layers=len(plan.layers)):
            return None
        impostor = capture_cell(self.prepared, plan, self.capturer, watch=watch)
        entry = self._written(job, impostor, watch)
        if cheaper_as_geometry(parameters, entry):
            everything = without_layers(plan, range(len(plan.layers)))
            geometry = self._written(job, capture_cell(self.prepared, everything, self.capturer, watch=watch), watch)
            entry = replace(geometry, frame=entry.frame)  # which says what was compared
        return None if may_cut and costs_over_budget(parameters, entry) else entry

    def _written(self, job: Job, impostor: Impostor, watch: Stopwatch) -> CellEntry:
        """Write the cell's files; its entry."""
        parameters = self.prepared.parameters
        with watch.stage("writing"):
            return write_cell(
                self.folder,
                impostor,
                self.ids,
                camera=parameters.camera,
                neighbours=job.neighbours,
                costs=parameters.costs,
                quality=parameters.texture_quality,
                pictures=parameters.pictures == "all",
            )

    def _content(self, job: Job, plan: CellPlan) -> str:
        """Fingerprint of everything that the cell's files and its entry are made from."""
        ids = [self.ids[i] for i in plan.selection.objects]
        prints = [self.prints[i] for i in plan.selection.objects]
        settings = [
            FORMAT_VERSION,
            package_version(),
            self.prepared.parameters.as_dict(),
            self.prepared.city.ground,
            self.terrain,
            self.atlas,
        ]
        return fingerprint([settings, _cell_values(job.cell), job.neighbours, ids, prints])


def _terrain_print(terrain: Terrain | None) -> str:
    """Fingerprint of the ground: which triangles need captured depths depends on it, wherever it is."""
    if terrain is None:
        return ""
    place = hashlib.sha256(np.array([*terrain.origin, terrain.spacing, *terrain.heights.shape]).data)
    place.update(terrain.heights.data)
    return place.hexdigest()


def _looks(mesh: CityMesh, shapes: list[str]) -> list[str]:
    """Fingerprints of objects with what they look like, which depends on neighbours: walls between them have no windows."""
    ends, first = mesh.object_triangles, mesh.object_vertices[:-1]
    triangles = mesh.triangles - np.repeat(first, np.diff(ends)).astype(np.int32)[:, None]
    per_vertex = [np.ascontiguousarray(array) for array in (mesh.positions, mesh.uv, mesh.colors)]
    prints = []
    for i, shape in enumerate(shapes):
        digest = hashlib.sha256(shape.encode())
        for array in per_vertex:
            digest.update(array[mesh.object_vertices[i] : mesh.object_vertices[i + 1]].data)
        digest.update(triangles[ends[i] : ends[i + 1]].data)
        prints.append(digest.hexdigest())
    return prints


def run_jobs(
    folder: DatasetFolder, city: City, parameters: BuildParameters, jobs: list[Job], workers: int
) -> Iterator[Done]:
    """Make all ``jobs``; yields as they are done, in any order."""
    if not jobs:
        return
    if workers == 1:
        worker = _Worker(folder, city, parameters)
        with worker.capturer:
            waiting = list(reversed(jobs))
            while waiting:
                done = worker.make(waiting.pop())
                waiting += reversed(done.halves)
                yield done
        return
    context = get_context("spawn")
    give_memory_back()  # reading took more than is left
    crew: dict[Connection, BaseProcess] = {}
    try:
        for _ in range(workers):
            ours, theirs = context.Pipe()
            process = context.Process(target=_serve, args=(theirs, str(folder.path), parameters), daemon=True)
            with without_interrupts():
                process.start()
            theirs.close()
            crew[ours] = process
        yield from _deal(folder, list(reversed(jobs)), crew)
    finally:
        for end in crew:
            end.close()  # a worker ends when its pipe does
        for worked in crew.values():
            worked.join(timeout=10.0)
            worked.kill()


def _deal(folder: DatasetFolder, jobs: list[Job], crew: Mapping[Connection, BaseProcess]) -> Iterator[Done]:
    """Hand jobs (from the list's end) to whichever worker is free."""
    busy, idle = list[Connection](), list(crew)

    def hand_out() -> None:
        while jobs and idle:
            end = idle.pop()
            try:
                end.send(jobs.pop())
            except OSError as error:  # it ended while it had nothing to do
                raise _ended(folder, crew[end]) from error
            busy.append(end)

    hand_out()
    while busy:
        for ready in wait(busy):
            end = busy[busy.index(ready)]  # type: ignore[arg-type]
            try:
                answer = end.recv()
            except (EOFError, OSError) as error:
                raise _ended(folder, crew[end]) from error
            if isinstance(answer, _Fault):
                raise answer.kind(f"{folder.path}: {answer.what}; finished cells are kept") from RuntimeError(
                    answer.trace
                )
            if isinstance(answer, MmiError):
                raise answer
            jobs += reversed(answer.halves)
            busy.remove(end)
            idle.append(end)
            hand_out()
            yield answer


def _ended(folder: DatasetFolder, process: BaseProcess) -> DatasetError:
    """What to say of a worker process that is no more."""
    return DatasetError(
        f"{folder.path}: a worker process ended unexpectedly ({how_it_ended(process)}); run the same command again, "
        "perhaps with fewer --workers: finished cells are kept"
    )


@dataclass(frozen=True, slots=True)
class _Fault:
    """An error in a worker that is none of ours: what it was and where, its traceback, and what it becomes."""

    what: str
    trace: str
    kind: type[MmiError] = FaultError


def _fault(job: Job, error: Exception) -> _Fault:
    if isinstance(error, MemoryError):
        said_so = f"cell {job.cell.id}: memory ran out ({error}); try fewer --workers"
        return _Fault(said_so, traceback.format_exc(), DatasetError)
    place = traceback.extract_tb(error.__traceback__)[-1]
    where = f"{Path(place.filename).name}, line {place.lineno}"
    what = f"cell {job.cell.id}: {said(error)} ({where}); this is a fault of the program, please report it"
    return _Fault(what, traceback.format_exc())


def _as_ours(error: MmiError) -> MmiError:
    """The error as one of this project's own classes, which get through a pipe whatever a plug-in derives from them."""
    kind = next(one for one in type(error).__mro__ if one.__module__ == MmiError.__module__)
    made: MmiError = kind(str(error))
    return made


def _serve(jobs: Connection, path: str, parameters: BuildParameters) -> None:
    """The life of a worker process: one cell after another, until the pipe closes.

    It reads the city that the dataset's folder holds, so that nothing large is sent between processes.
    """
    quiet_libraries()
    os.environ["LP_NUM_THREADS"] = "1"  # software OpenGL: one thread a worker, as there is a worker a core
    worker: _Worker | None = None
    while True:
        try:
            job = jobs.recv()
        except (EOFError, OSError):
            return  # the parent has no more work, or is gone
        answer: Done | MmiError | _Fault
        try:
            if worker is None:
                folder = DatasetFolder(Path(path))
                worker = _Worker(folder, city_from_json(folder.read("city.json"), name="city.json"), parameters)
            answer = worker.make(job)
        except MmiError as error:
            answer = _as_ours(error)
        except Exception as error:
            answer = _fault(job, error)
        try:
            jobs.send(answer)
        except OSError:
            return
