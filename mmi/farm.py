"""A dataset of a whole city: which cells are to be made, made by worker processes, resumable at any moment.

A cell's record (see :mod:`mmi.dataset`) carries three fingerprints. ``inputs`` covers parameters, cell and street
neighbourhood, and the city; while it is current nothing needs to be looked at. ``content`` covers what the cell's files
were made from: parameters, cell and the objects that are visible from it. When the city has changed, a cell is planned
again, which is cheap, and only if its content differs is it captured again.
"""

from __future__ import annotations

import hashlib
import os
import resource
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from multiprocessing import get_context, resource_tracker
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np

from mmi.build import CellPlan, Stopwatch, capture_layers, landmark_factors, plan_cell, prepare_scene
from mmi.cellfiles import city_glb, write_cell
from mmi.cells import ViewingCell, spread, viewing_cells
from mmi.city import City
from mmi.dataset import FORMAT_VERSION, DatasetFolder, build_folder, readable_json, with_checksum
from mmi.errors import DatasetError, MmiError, ParameterError
from mmi.io.stored import city_from_json, city_to_json, fingerprint, object_fingerprints
from mmi.parameters import BuildParameters
from mmi.surfaces import CityMesh

__all__ = ["BuildSummary", "build_dataset", "cells_to_build", "without_interrupts"]


@dataclass(frozen=True, slots=True)
class BuildSummary:
    """What a build did: cells made now, found complete, and kept because nothing that they see has changed."""

    built: int
    complete: int
    unchanged: int
    cells: int
    bytes: int
    seconds: float
    peak_memory_bytes: int
    workers: int
    stages: dict[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    cell: ViewingCell
    neighbours: tuple[str, ...]
    inputs: str


@dataclass(frozen=True, slots=True, eq=False)
class _Done:
    cell: str
    captured: bool
    seconds: dict[str, float]
    process: int
    peak_memory_bytes: int


def cells_to_build(
    city: City, parameters: BuildParameters, *, cells: Sequence[str] | None = None, max_cells: int | None = None
) -> tuple[nx.Graph, list[str]]:
    """The graph of all viewing cells, and the ids asked for: all, those named, or ``max_cells`` spread over the city.

    Raises ParameterError for an unknown cell or landmark, or where there are no cells at all.
    """
    landmark_factors(city, parameters)
    graph = viewing_cells(city, max_length=parameters.cell_length, eye=parameters.eye)
    if not len(graph):
        raise ParameterError(f"{city.source}: streets with room for a viewing cell expected, found none")
    if cells is not None:
        unknown = [cell for cell in cells if cell not in graph]
        if unknown:
            some = ", ".join(list(graph)[:3])
            raise ParameterError(f"cell {unknown[0]}: one of the {len(graph)} cells ({some}, ...) expected")
        return graph, sorted(set(cells))
    if max_cells is not None:
        if max_cells < 1:
            raise ParameterError(f"a number of cells of at least 1 expected, found {max_cells}")
        return graph, sorted(spread(graph, max_cells))
    return graph, sorted(graph)


def build_dataset(
    city: City,
    out: Path,
    parameters: BuildParameters | None = None,
    *,
    cells: Sequence[str] | None = None,
    max_cells: int | None = None,
    workers: int = 1,
    progress: Callable[[int, int, str], None] | None = None,
) -> BuildSummary:
    """Build, resume or bring up to date the dataset in folder ``out``.

    The bytes depend on city and parameters alone (``build.json`` aside). Cells of earlier builds that are still current
    stay in the dataset, asked for or not. ``progress`` is called with (cells done, cells to do, cell).

    Raises ParameterError, CaptureError, DatasetError.
    """
    parameters = parameters or BuildParameters()
    if workers < 1:
        raise ParameterError(f"a number of workers of at least 1 expected, found {workers}")
    start = time.perf_counter()
    graph, names = cells_to_build(city, parameters, cells=cells, max_cells=max_cells)
    with build_folder(Path(out)) as folder:
        stored = city_to_json(city)
        settings = {"format": FORMAT_VERSION, "version": _version(), "parameters": parameters.as_dict()}
        city_print = fingerprint(stored.decode())
        jobs = [_job(graph, name, fingerprint([settings, city_print])) for name in graph]
        current = {job.cell.id for job in jobs if _is_current(folder, job)}
        wanted = set(names) - current
        pending = [job for job in jobs if job.cell.id in wanted]
        shared = _write_shared(folder, city, stored)

        done: list[_Done] = []
        for one in _run(folder, city, parameters, pending, min(workers, max(len(pending), 1))):
            done.append(one)
            if progress is not None:
                progress(len(done), len(pending), one.cell)

        present = current | {one.cell for one in done}
        for stale in set(folder.recorded_cells()) - present:
            folder.remove_cell(stale)
        entries = [_recorded(folder, name)["entry"] for name in sorted(present)]
        manifest = _manifest(parameters, shared, entries)
        folder.write("manifest.json", readable_json(manifest))
        summary = _summary(done, len(current & set(names)), manifest, time.perf_counter() - start, workers)
        folder.write("build.json", readable_json(_build_json(summary)))
    return summary


def _version() -> str:
    return version("multi-mesh-impostors")


def _job(graph: nx.Graph, name: str, common: str) -> _Job:
    cell: ViewingCell = graph.nodes[name]["cell"]
    neighbours = tuple(sorted(graph.neighbors(name)))
    return _Job(cell, neighbours, fingerprint([common, _cell_values(cell), neighbours]))


def _cell_values(cell: ViewingCell) -> list[Any]:
    return [cell.id, cell.p, cell.q, cell.half_width, cell.eye, cell.street]


def _is_current(folder: DatasetFolder, job: _Job) -> bool:
    record = folder.record(job.cell.id)
    return record is not None and record.get("inputs") == job.inputs


def _recorded(folder: DatasetFolder, name: str) -> dict[str, Any]:
    record = folder.record(name, check=False)
    if record is None:
        raise DatasetError(
            f"{folder.path / 'cells' / name}.json: written, but damaged since; run the same command again"
        )
    return record


def _write_shared(folder: DatasetFolder, city: City, stored: bytes) -> dict[str, Any]:
    """The manifest's entry ``city``; writes the two files that all cells share."""
    geometry, triangles = city_glb(city)
    return {
        "source": city.source,
        "crs": city.crs,
        "origin": list(city.origin),
        "ground": city.ground,
        "objects": len(city.objects),
        "triangles": triangles,
        "files": {"json": folder.write("city.json", stored), "glb": folder.write("city.glb", geometry)},
    }


# ------------------------------------------------------------------------------------------------------- workers


class _Worker:
    """One process's city, prepared once, and its OpenGL context."""

    def __init__(self, folder: DatasetFolder, city: City, parameters: BuildParameters) -> None:
        from mmi.capture import Capturer  # here, so that a parent of workers does not load OpenGL

        self.folder = folder
        self.preparation = Stopwatch()
        with self.preparation.stage("preparation"):
            self.scene = prepare_scene(city, parameters)
            self.prints = _looks(self.scene.mesh, object_fingerprints(city))
            self.capturer = Capturer(self.scene.mesh)

    def make(self, job: _Job) -> _Done:
        """Bring one cell up to date: its files if what it sees has changed, its record in any case."""
        watch, self.preparation = self.preparation, Stopwatch()  # the first cell's seconds include the preparation
        plan = plan_cell(self.scene, job.cell, identify=self.capturer.identify, watch=watch)
        content = self._content(job, plan)
        record = self.folder.record(job.cell.id)
        captured = record is None or record.get("content") != content
        if captured:
            layers = capture_layers(self.scene, plan, self.capturer, watch=watch)
            entry = write_cell(self.folder, self.scene, plan, layers, neighbours=job.neighbours, watch=watch)
        else:
            entry = record["entry"] if record is not None else {}
        self.folder.write_record(job.cell.id, {"inputs": job.inputs, "content": content, "entry": entry})
        return _Done(job.cell.id, captured, watch.seconds, os.getpid(), _peak_memory(shared=False))

    def _content(self, job: _Job, plan: CellPlan) -> str:
        """Fingerprint of everything that the cell's files and its entry are made from."""
        ids = [self.scene.city.objects[i].id for i in plan.selection.objects]
        prints = [self.prints[i] for i in plan.selection.objects]
        settings = [FORMAT_VERSION, _version(), self.scene.parameters.as_dict(), self.scene.city.ground]
        return fingerprint([settings, _cell_values(job.cell), job.neighbours, ids, prints])


def _looks(mesh: CityMesh, shapes: list[str]) -> list[str]:
    """Fingerprints of objects with what they look like, which depends on neighbours: walls between them are blind."""
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


def _run(
    folder: DatasetFolder, city: City, parameters: BuildParameters, jobs: list[_Job], workers: int
) -> Iterator[_Done]:
    """Make all ``jobs``; yields as they are done, in any order."""
    if not jobs:
        return
    if workers == 1:
        worker = _Worker(folder, city, parameters)
        with worker.capturer:
            for job in jobs:
                yield worker.make(job)
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


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Hold Ctrl-C back; a process started meanwhile never sees it: Ctrl-C is the parent's business."""
    resource_tracker.ensure_running()  # it lets Ctrl-C through again when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _deal(folder: DatasetFolder, jobs: list[_Job], ends: list[Connection]) -> Iterator[_Done]:
    """Hand jobs (from the list's end) to whichever worker is free."""
    busy = list(ends)
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
            if jobs:
                end.send(jobs.pop())
            else:
                busy.remove(end)
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
        answer: _Done | MmiError
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


def _peak_memory(*, shared: bool = True) -> int:
    """Bytes that this process has held at most; not ``shared``: less its pages of files (libraries), which are in memory once
    however many processes use them.
    """
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    status = Path("/proc/self/status")
    if shared or not status.exists():
        return peak
    files = next((line for line in status.read_text().splitlines() if line.startswith("RssFile:")), "RssFile: 0 kB")
    return peak - 1024 * int(files.split()[1])


# ------------------------------------------------------------------------------------------------------- summaries


def _manifest(parameters: BuildParameters, shared: dict[str, Any], entries: list[dict[str, Any]]) -> dict[str, Any]:
    """What is in the dataset; see schemas/manifest.json."""
    size = sum(entry["bytes"] for entry in entries) + sum(file["bytes"] for file in shared["files"].values())
    return with_checksum(
        {
            "format_version": FORMAT_VERSION,
            "city": shared,
            "parameters": parameters.as_dict(),
            "cells": entries,
            "totals": {"cells": len(entries), "bytes": size},
        }
    )


def _summary(done: list[_Done], complete: int, manifest: dict[str, Any], seconds: float, workers: int) -> BuildSummary:
    stages: dict[str, float] = {}
    peaks: dict[int, int] = {os.getpid(): _peak_memory()}
    for one in done:
        peaks[one.process] = max(peaks.get(one.process, 0), one.peak_memory_bytes)
        for stage, spent in one.seconds.items():
            stages[stage] = stages.get(stage, 0.0) + spent
    built = sum(one.captured for one in done)
    return BuildSummary(
        built=built,
        complete=complete,
        unchanged=len(done) - built,
        cells=manifest["totals"]["cells"],
        bytes=manifest["totals"]["bytes"],
        seconds=seconds,
        peak_memory_bytes=sum(peaks.values()),
        workers=workers,
        stages=stages,
    )


def _build_json(summary: BuildSummary) -> dict[str, Any]:
    return {
        "program": "build-impostors",
        "format_version": FORMAT_VERSION,
        "version": _version(),
        "totals": {
            "cells": summary.cells,
            "built": summary.built,
            "complete": summary.complete,
            "unchanged": summary.unchanged,
            "seconds": summary.seconds,
            "peak_memory_bytes": summary.peak_memory_bytes,
            "workers": summary.workers,
        },
        "stages": summary.stages,
    }
