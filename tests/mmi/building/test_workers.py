"""Worker processes that die or fail: what was wrong is said in one line, whichever way it went, and nothing is lost."""

import os
import pickle
import signal
import time
from dataclasses import replace
from multiprocessing import get_context

import pytest
from cities import city_of, crossroads, two_blocks

from mmi.building.cell_choice import choose_cells
from mmi.building.dataset import build_dataset
from mmi.building.workers import Job, _as_ours, _deal, _fault
from mmi.dataset.folder import DatasetFolder, build_folder
from mmi.dataset.reading import open_dataset
from mmi.foundation.camera import Camera
from mmi.foundation.errors import CityError, DatasetError, FaultError
from mmi.planning.parameters import BuildParameters

PARAMETERS = BuildParameters(near_distance=30.0, camera=Camera(128, 128, 1.0), cell_length=80.0)


def _obey(orders, how):
    """A worker that takes one job and then does as ``how`` says; one that waits for a job never gets to that."""
    if how == "dies at once":
        os.kill(os.getpid(), signal.SIGKILL)
    job = orders.recv()
    if how == "dies with a job":
        os.kill(os.getpid(), signal.SIGKILL)
    if how == "leaves":
        os._exit(3)
    try:
        raise KeyError("a table without this row")
    except KeyError as error:
        orders.send(_fault(job, error))
    time.sleep(60.0)


def _jobs(count):
    chosen = choose_cells(crossroads(), PARAMETERS)
    return [Job(chosen.graph.nodes[name]["cell"], (), "common") for name in chosen.names[:count]]


@pytest.mark.parametrize(
    ("how", "expected"),
    [
        (
            "dies at once",
            r"a worker process ended unexpectedly \(by signal 9, which the system sends when memory runs out\)",
        ),
        ("dies with a job", r"a worker process ended unexpectedly \(by signal 9, .*finished cells are kept"),
        ("leaves", r"a worker process ended unexpectedly \(with status 3\)"),
        (
            "fails",
            r"cell \S+: KeyError: 'a table without this row' \(test_workers\.py, line \d+\); this is a fault of the program",
        ),
    ],
)
def test_the_end_of_a_worker_is_an_error_that_says_how(tmp_path, how, expected):
    """Also of one that ends while it has nothing to do: sending to it must not look like a reader of our output that left."""
    context = get_context("fork")
    ours, theirs = context.Pipe()
    process = context.Process(target=_obey, args=(theirs, how), daemon=True)
    process.start()
    theirs.close()
    if how == "dies at once":
        process.join()
    try:
        with pytest.raises(FaultError if how == "fails" else DatasetError, match=expected) as raised:
            list(_deal(DatasetFolder(tmp_path), _jobs(1), {ours: process}))
    finally:
        process.kill()
    assert "\n" not in str(raised.value)


def test_memory_that_runs_out_is_said_as_such():
    (job,) = _jobs(1)
    try:
        raise MemoryError("cannot allocate an array")
    except MemoryError as error:
        assert (
            _fault(job, error).what
            == f"cell {job.cell.id}: memory ran out (cannot allocate an array); try fewer --workers"
        )


def test_a_cell_without_layers_keeps_no_file_of_those_that_it_had(tmp_path):
    """With fewer objects around, a cell may have no layers any more: its EXR goes with them."""
    out = tmp_path / "out"
    settings = replace(PARAMETERS, near_distance=20.0)
    build_dataset(two_blocks(), out, settings, max_cells=1)
    (cell,) = open_dataset(out).manifest.cells
    assert (out / "cells" / f"{cell.id}.exr").exists()
    one = city_of(
        next(one for one in two_blocks().objects if one.id in cell.near) if cell.near else two_blocks().objects[0]
    )
    build_dataset(one, out, replace(settings, near_distance=500.0), max_cells=1)
    (cell,) = open_dataset(out).manifest.cells
    assert cell.files.exr is None
    assert not list((out / "cells").glob("*.exr"))


def test_a_lock_that_another_build_removes_is_none(tmp_path, monkeypatch):
    """A build opens the lock's file, the one before it ends and removes the file: what is locked then keeps nobody out."""
    import fcntl

    import mmi.dataset.folder

    real, removed = fcntl.flock, []

    def flock(file, operation):
        if not removed:
            removed.append(file)
            (tmp_path / "out" / ".lock").unlink()
        real(file, operation)

    monkeypatch.setattr(mmi.dataset.folder.fcntl, "flock", flock)
    with build_folder(tmp_path / "out"):
        assert removed and (tmp_path / "out" / ".lock").exists()
        with (
            pytest.raises(DatasetError, match="another build-impostors is writing here"),
            build_folder(tmp_path / "out"),
        ):
            pass
    assert not (tmp_path / "out" / ".lock").exists()


class _OwnError(CityError):
    """An error as a plug-in may define it: a pipe could not make it again from its text."""

    def __init__(self, one, other):
        super().__init__(f"{one} {other}")
        self.helper = lambda: one


def test_an_error_that_a_plug_in_defines_gets_through_a_pipe():
    found = pickle.loads(pickle.dumps(_as_ours(_OwnError("no", "streets"))))
    assert type(found) is CityError and str(found) == "no streets"
