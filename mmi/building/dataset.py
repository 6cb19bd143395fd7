"""A dataset of a whole city: which cells are to be made, made by worker processes, resumable at any moment.

A cell's record (see :mod:`mmi.dataset.folder`) carries three fingerprints. ``inputs`` covers parameters, cell and street
neighbourhood, and the city; while it is current nothing needs to be looked at. ``content`` covers what the cell's files
were made from: parameters, cell, the objects that are visible from it, and hills. When the city has changed, a cell is planned
again, which is cheap, and only if its content differs is it captured again.

A cell that exceeds a budget is cut in halves (:mod:`mmi.building.halving`). Its record then has no entry, and it has no files.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mmi.building.cell_choice import CellChoice, choose_cells
from mmi.building.city_costs import CityCosts, city_costs, triangles_as_read
from mmi.building.halving import whole_of, with_halves_joined
from mmi.building.workers import Done, Job, costs_over_budget, run_jobs
from mmi.city.codec import city_to_json
from mmi.city.long_objects import cut_objects
from mmi.city.model import City
from mmi.dataset.city_files import city_glb
from mmi.dataset.folder import DatasetFolder, build_folder
from mmi.dataset.manifest import FORMAT_VERSION, CellRecord, CityEntry, CityFiles, Manifest, manifest_to_json
from mmi.foundation.errors import DatasetError, ParameterError
from mmi.foundation.json_forms import fingerprint, readable_json
from mmi.foundation.processes import package_version, peak_memory
from mmi.planning.parameters import BuildParameters

__all__ = ["BuildSummary", "build_dataset"]


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
    parts: int
    """Objects that are parts of longer ones (:mod:`mmi.city.long_objects`)."""
    cut: int
    """Cells that were cut in halves to keep the budgets."""
    over_budget: dict[str, dict[str, tuple[int, int]]]
    """Cells that exceed a budget and are too short to be cut: id -> budget -> (what it costs, what it may cost)."""
    removed: int
    """Cells of an earlier build with other parameters or another city, or parts of such, that were not asked for now."""
    withheld: dict[str, str]
    """Cells whose errors are not bounded: id -> why, in words."""
    costs: CityCosts


def build_dataset(
    city: City,
    out: Path,
    parameters: BuildParameters | None = None,
    *,
    cells: Sequence[str] | CellChoice | None = None,
    max_cells: int | None = None,
    workers: int = 1,
    progress: Callable[[int, int, str], None] | None = None,
) -> BuildSummary:
    """Build, resume or bring up to date the dataset in folder ``out``.

    The bytes depend on city and parameters alone (``build.json`` aside). Cells of earlier builds that are still current
    stay in the dataset, asked for or not. ``cells`` are ids, or what :func:`~mmi.building.cell_choice.choose_cells`
    returned, around a place for instance; ``max_cells`` are spread over the city. ``progress`` is called with (cells done,
    cells to do, what was done last), first before the city is prepared.

    Raises ParameterError, CaptureError, DatasetError.
    """
    parameters = parameters or BuildParameters()
    if workers < 1:
        raise ParameterError(f"a number of workers of at least 1 expected, found {workers}")
    start = time.perf_counter()
    chosen = (
        cells if isinstance(cells, CellChoice) else choose_cells(city, parameters, cells=cells, max_cells=max_cells)
    )
    graph, names = chosen.graph, chosen.names
    read, city = city, cut_objects(city, parameters.longest_object)
    with build_folder(Path(out)) as folder:
        stored = city_to_json(city)
        settings = {"format": FORMAT_VERSION, "version": package_version(), "parameters": parameters.as_dict()}
        common = fingerprint([settings, hashlib.sha256(stored).hexdigest()])
        jobs = [Job(graph.nodes[name]["cell"], tuple(sorted(graph.neighbors(name))), common) for name in graph]
        current, pending = _divided(folder, jobs, set(names))
        shared = _write_shared(folder, city, stored)

        done: list[Done] = []
        to_do = len(pending)
        if progress is not None and pending:
            progress(0, to_do, "the city")
        for one in run_jobs(folder, city, parameters, pending, min(workers, max(len(pending), 1))):
            done.append(one)
            to_do += len(one.halves)
            if progress is not None:
                progress(len(done), to_do, one.cell)

        present = current | {one.cell for one in done}
        stale = folder.stray_cells(present)
        for name in stale:
            folder.remove_cell(name)
        records = [_recorded(folder, name) for name in sorted(present)]
        entries = with_halves_joined([record.entry for record in records if record.entry is not None])
        manifest = Manifest(shared, parameters, tuple(entries))
        folder.write("manifest.json", manifest_to_json(manifest))
        complete = len({whole_of(name) for name in current} & set(names) - {whole_of(job.cell.id) for job in pending})
        parts = sum(one.part_of is not None for one in city.objects)
        summary = _summary(
            done,
            complete,
            parameters,
            manifest,
            time.perf_counter() - start,
            workers,
            parts,
            len({whole_of(name) for name in stale} - {whole_of(name) for name in present}),
            city_costs(
                manifest,
                objects_read=len(read.objects),
                triangles_read=triangles_as_read(read, shared.triangles, city),
                all_metres=graph.graph["report"].cell_length,
            ),
        )
        folder.write("build.json", readable_json(_build_json(summary)))
    return summary


def _divided(folder: DatasetFolder, jobs: list[Job], wanted: set[str]) -> tuple[set[str], list[Job]]:
    """The cells whose records are current, halves of cut ones too, and what is still to be done for ``wanted`` cells."""
    current, pending, open_jobs = set(), [], list(reversed(jobs))
    while open_jobs:
        job = open_jobs.pop()
        record = folder.record(job.cell.id)
        if record is not None and record.inputs == job.inputs:
            current.add(job.cell.id)
            open_jobs += reversed(job.halves() if record.entry is None else [])
        elif whole_of(job.cell.id) in wanted:
            pending.append(job)
    return current, pending


def _recorded(folder: DatasetFolder, name: str) -> CellRecord:
    record = folder.record(name, check=False)
    if record is None:
        raise DatasetError(
            f"{folder.path / 'cells' / name}.json: written, but damaged since; run the same command again"
        )
    return record


def _write_shared(folder: DatasetFolder, city: City, stored: bytes) -> CityEntry:
    """The manifest's entry ``city``; writes the two files that all cells share."""
    geometry, triangles = city_glb(city)
    return CityEntry(
        source=city.source,
        crs=city.crs,
        origin=city.origin,
        ground=city.ground,
        objects=len(city.objects),
        triangles=triangles,
        files=CityFiles(json=folder.write("city.json", stored), glb=folder.write("city.glb", geometry)),
    )


# ------------------------------------------------------------------------------------------------------- summaries


def _summary(
    done: list[Done],
    complete: int,
    parameters: BuildParameters,
    manifest: Manifest,
    seconds: float,
    workers: int,
    parts: int,
    removed: int,
    costs: CityCosts,
) -> BuildSummary:
    stages: dict[str, float] = {}
    peaks: dict[int, int] = {os.getpid(): peak_memory()}
    for one in done:
        peaks[one.process] = max(peaks.get(one.process, 0), one.peak_memory_bytes)
        for stage, spent in one.seconds.items():
            stages[stage] = stages.get(stage, 0.0) + spent
    built = sum(one.captured and not one.halves for one in done)
    cut = sum(bool(one.halves) for one in done)
    over = {entry.id: costs_over_budget(parameters, entry) for entry in manifest.cells}
    return BuildSummary(
        built=built,
        complete=complete,
        unchanged=len(done) - built - cut,
        cells=len(manifest.cells),
        bytes=manifest.bytes,
        seconds=seconds,
        peak_memory_bytes=sum(peaks.values()),
        workers=workers,
        stages=stages,
        parts=parts,
        cut=cut,
        over_budget={cell: costs for cell, costs in over.items() if costs},
        removed=removed,
        withheld={entry.id: entry.promise_withheld for entry in manifest.cells if entry.promise_withheld is not None},
        costs=costs,
    )


def _build_json(summary: BuildSummary) -> dict[str, Any]:
    return {
        "program": "build-impostors",
        "format_version": FORMAT_VERSION,
        "version": package_version(),
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
