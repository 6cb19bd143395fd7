"""Images placed for a model, in a folder (section 3, figure 2): the grid, the images of its points, then their pictures.

What was made is kept: the solutions as one file, each image as its own, under a name that says what it was made from, so that a
run that was stopped goes on from there. The bytes depend on model, display and rules alone, whatever the number of workers.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import Camera
from mmi.foundation.errors import DatasetError, ParameterError
from mmi.foundation.processes import peak_memory
from mmi.foundation.progress import Progress, silent
from viewer.layered.viewpoints import COUNTS
from viewer.making.hidden_cells import hidden_cells, print_of_occluders
from viewer.making.models import Model
from viewer.making.other_options import other_options
from viewer.making.workers import PicturesJob, PointsJob, crew_of
from viewer.placed.folder import PlacedFolder, folder_of, placing_folder, read_solutions, write_manifest
from viewer.placed.solutions import Solutions, print_of, solutions_of
from viewer.placing.model_cells import cells_for
from viewer.placing.placements import Placements
from viewer.placing.refining import solution_grid
from viewer.placing.rules import FrameBudget, PlacingRules
from viewer.placing.solution_grid import domain_of

__all__ = ["PlacingSummary", "place_images"]

_AT_ONCE = 16
"""Points that a worker is given at a time."""


@dataclass(frozen=True, slots=True)
class PlacingSummary:
    """What there is, ``made`` images of it now, their ``bytes``, the ``largest_count`` of triangles, seconds of each stage."""

    folder: PlacedFolder
    triangles: int
    cells: int
    points: int
    images: int
    made: int
    bytes: int
    largest_count: int
    stages: dict[str, float]
    peak_memory_bytes: int
    workers: int


def place_images(
    model: Model,
    out: Path,
    *,
    camera: Camera,
    rules: PlacingRules,
    heights: tuple[float, float] | None = None,
    hidden: bool = False,
    pictures: int = 9,
    workers: int = 1,
    frame: FrameBudget | None = None,
    replacing: bool = False,
    progress: Progress = silent,
) -> PlacingSummary:
    """Place images for ``model`` into the folder ``out``, or go on with that.

    ``rules`` are for the display of ``camera``; viewers' eyes are at ``heights``, from the lowest to the highest, metres in the
    model's frame, or anywhere around the model. Cells that the city surely hides from all whom a point serves do not count, and
    are not drawn, if ``hidden`` says so. The manifest says what ``frame`` the budget is from, if it is from one. Images that
    the folder has for other options or another model stay, and are an error, unless ``replacing`` says that these may go.
    ``progress`` is called with (images done, all of them, what was done last), before that with points.

    Raises ParameterError, DatasetError.
    """
    if pictures not in COUNTS:
        raise ParameterError(f"pictures: one of {', '.join(map(str, COUNTS))} expected, found {pictures}")
    if workers < 1:
        raise ParameterError(f"workers: 1 or more expected, found {workers}")
    if heights is not None and not (np.isfinite(heights).all() and heights[0] < heights[1]):
        raise ParameterError(f"heights: a lower and a higher one expected, found {heights[0]:g} and {heights[1]:g}")
    stages: dict[str, float] = {}
    start = time.perf_counter()
    cells = cells_for(model.mesh.positions, model.mesh.triangles, rules)
    stages["cells"] = time.perf_counter() - start
    told: dict[str, Any] = {
        "source": model.city.source,
        "model": print_of(model.mesh),
        "camera": camera,
        "pictures": pictures,
        "rules": rules,
        "occluders": print_of_occluders(model.city) if hidden else "",
    }
    anywhere = domain_of(cells)
    domain = anywhere.copy()
    if heights is not None:
        domain[:, 2] = heights
    with placing_folder(out) as path, ExitStack() as stack:
        known = _known(path, told, domain, anywhere, replacing=replacing)
        crew = stack.enter_context(crew_of(workers, path, model, cells, rules))
        if known is None:
            start = time.perf_counter()
            progress(0, 1, "the grid")
            grid = solution_grid(cells, rules, domain)
            stages["grid"] = time.perf_counter() - start
            start = time.perf_counter()
            found: dict[int, Placements] = {}
            needs = grid.needs()
            if hidden:
                bits = hidden_cells(model.city, cells, grid, progress)
                needs = tuple(replace(one, hidden=own) for one, own in zip(needs, bits, strict=True))
                stages["hidden"] = time.perf_counter() - start
                start = time.perf_counter()
            jobs = [
                PointsJob(first, grid.points[first : first + _AT_ONCE], needs[first : first + _AT_ONCE])
                for first in range(0, len(grid.points), _AT_ONCE)
            ]
            for first, some in crew.do(jobs):
                found.update(enumerate(some, first))
                progress(len(found), len(grid.points), "points")
            known = solutions_of(**told, grid=grid, points=[found[n] for n in range(len(grid.points))])
            stages["points"] = time.perf_counter() - start
        folder = folder_of(path, known)
        numbers = [number for number in range(len(known.images)) if not folder.has_image(number)]
        start = time.perf_counter()
        peaks = {os.getpid(): peak_memory()}
        for done, one in enumerate(crew.do([PicturesJob(path, number) for number in numbers]), 1):
            peaks[one.process] = max(one.memory, peaks.get(one.process, 0))
            progress(len(known.images) - len(numbers) + done, len(known.images), f"image {one.number}")
        stages["pictures"] = time.perf_counter() - start
        size = write_manifest(folder, frame)
    return PlacingSummary(
        folder=folder,
        triangles=len(model.mesh.triangles),
        cells=len(cells.counts),
        points=len(known.points),
        images=len(known.images),
        made=len(numbers),
        bytes=size,
        largest_count=max((int(one.counts.max()) for one in known.points), default=0),
        stages=stages,
        peak_memory_bytes=sum(peaks.values()),
        workers=workers,
    )


def _known(
    path: Path, told: Mapping[str, Any], domain: NDArray[np.float64], anywhere: NDArray[np.float64], *, replacing: bool
) -> Solutions | None:
    """The solutions of the folder at ``path`` for what is ``told``, None where it has none, or a damaged file of them.

    Raises ParameterError where it has others, unless they are to be replaced.
    """
    try:
        known = read_solutions(path)
    except DatasetError:  # what is missing or damaged is found anew
        return None
    different = other_options(known, told, domain, anywhere)
    if not different:
        return known
    if replacing:
        return None
    theirs, ours = (", ".join(some) for some in zip(*different, strict=True))
    raise ParameterError(
        f"{path}: {theirs} expected, which the images there were made with, found {ours}; nothing was changed; with --replace "
        "they are made anew"
    )
