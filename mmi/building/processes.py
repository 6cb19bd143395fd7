"""Worker processes that make cells, and what passes between them and the process that builds a dataset."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import numpy as np

from mmi.appearance.city_mesh import CityMesh
from mmi.building.cell import capture_layers
from mmi.building.halving import exceeded, halves
from mmi.cells.viewing_cells import ViewingCell
from mmi.city.codec import city_from_json, object_fingerprints
from mmi.city.model import City
from mmi.city.terrain import Terrain
from mmi.dataset.cell_files import write_cell
from mmi.dataset.folder import FORMAT_VERSION, DatasetFolder
from mmi.foundation.errors import DatasetError, MmiError
from mmi.foundation.json_forms import fingerprint
from mmi.foundation.processes import package_version, peak_memory, without_interrupts
from mmi.foundation.stopwatch import Stopwatch
from mmi.planning.parameters import BuildParameters
from mmi.planning.plan import CellPlan, plan_cell, prepare_city

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


def costs_over_budget(parameters: BuildParameters, entry: Mapping[str, Any]) -> dict[str, tuple[int, int]]:
    """The budgets that a cell of this entry exceeds."""
    layers = len({layer["index"] for sector in entry["layers"] for layer in sector})
    triangles = entry["near_triangles"] + entry["triangles"]
    return exceeded(parameters, layers=layers, triangles=triangles, stored_bytes=entry["bytes"])


class _Worker:
    """One process's city, prepared once, and its OpenGL context."""

    def __init__(self, folder: DatasetFolder, city: City, parameters: BuildParameters) -> None:
        from mmi.capture.renderer import Capturer  # here, so that a parent of workers does not load OpenGL

        self.folder = folder
        self.preparation = Stopwatch()
        with self.preparation.stage("preparation"):
            self.prepared = prepare_city(city, parameters)
            self.prints = _looks(self.prepared.mesh, object_fingerprints(city))
            self.atlas = hashlib.sha256(self.prepared.mesh.texture.data).hexdigest()
            self.terrain = _terrain_print(city.terrain)
            self.capturer = Capturer(self.prepared.mesh)

    def make(self, job: Job) -> Done:
        """Bring one cell up to date: its files if what it sees has changed, its record in any case."""
        watch, self.preparation = self.preparation, Stopwatch()  # the first cell's seconds include the preparation
        plan = plan_cell(self.prepared, job.cell, identify=self.capturer.identify, watch=watch)
        content = self._content(job, plan)
        record = self.folder.record(job.cell.id)
        captured = record is None or record.get("content") != content
        parts = job.halves()
        entry: dict[str, Any] = {"files": {}}
        if record is not None and not captured:
            entry, cut = record["entry"], bool(record["halves"])
        elif not (cut := bool(parts and exceeded(self.prepared.parameters, layers=len(plan.layers)))):
            layers = capture_layers(self.prepared, plan, self.capturer, watch=watch)
            entry = write_cell(self.folder, self.prepared, plan, layers, neighbours=job.neighbours, watch=watch)
            cut = bool(parts and costs_over_budget(self.prepared.parameters, entry))
        if cut and captured:
            self.folder.remove_cell(job.cell.id)
            entry = {"files": {}}
        values = {"inputs": job.inputs, "content": content, "entry": entry, "halves": cut}
        self.folder.write_record(job.cell.id, values)
        seconds, memory = watch.seconds, peak_memory(shared=False)
        return Done(job.cell.id, captured, parts if cut else [], seconds, os.getpid(), memory)

    def _content(self, job: Job, plan: CellPlan) -> str:
        """Fingerprint of everything that the cell's files and its entry are made from."""
        ids = [self.prepared.city.objects[i].id for i in plan.selection.objects]
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
    ends, processes = [], []
    try:
        for _ in range(workers):
            ours, theirs = context.Pipe()
            process = context.Process(target=_serve, args=(theirs, str(folder.path), parameters), daemon=True)
            with without_interrupts():
                process.start()
            theirs.close()
            ends.append(ours)
            processes.append(process)
        yield from _deal(folder, list(reversed(jobs)), ends)
    finally:
        for end in ends:
            end.close()  # a worker ends when its pipe does
        for process in processes:
            process.join(timeout=10.0)
            process.kill()


def _deal(folder: DatasetFolder, jobs: list[Job], ends: list[Connection]) -> Iterator[Done]:
    """Hand jobs (from the list's end) to whichever worker is free."""
    busy, idle = list(ends), list[Connection]()
    for end in ends:
        end.send(jobs.pop())
    while busy:
        for ready in wait(busy):
            end = busy[busy.index(ready)]  # type: ignore[arg-type]
            try:
                answer = end.recv()
            except (EOFError, OSError) as error:
                raise DatasetError(
                    f"{folder.path}: a worker process ended unexpectedly (out of memory?); run the same command again, "
                    "perhaps with fewer --workers: finished cells are kept"
                ) from error
            if isinstance(answer, BaseException):
                raise answer
            jobs += reversed(answer.halves)
            busy.remove(end)
            idle.append(end)
            while jobs and idle:
                busy.append(idle.pop())
                busy[-1].send(jobs.pop())
            yield answer


def _serve(jobs: Connection, path: str, parameters: BuildParameters) -> None:
    """The life of a worker process: one cell after another, until the pipe closes.

    It reads the city that the dataset's folder holds, so that nothing large is sent between processes.
    """
    os.environ["LP_NUM_THREADS"] = "1"  # software OpenGL: one thread a worker, as there is a worker a core
    worker: _Worker | None = None
    while True:
        try:
            job = jobs.recv()
        except (EOFError, OSError):
            return  # the parent has no more work, or is gone
        answer: Done | MmiError
        try:
            if worker is None:
                folder = DatasetFolder(Path(path))
                worker = _Worker(folder, city_from_json(folder.read("city.json"), name="city.json"), parameters)
            answer = worker.make(job)
        except MmiError as error:
            answer = error
        try:
            jobs.send(answer)
        except OSError:
            return
