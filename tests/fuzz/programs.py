"""The programs on datasets, walks and movers that were edited: one line where they refuse, and nothing opened beside it.

A folder holds a dataset and, beside its files, ``walk.json`` and ``movers.json``, or the city that it was built from. What the
programs write goes into a folder next to it. A fault of a program (status 1) is a failure here, as a traceback is elsewhere.
"""

from __future__ import annotations

import io
import os
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from unittest.mock import patch

import numpy as np
from fuzz.datasets import Expect, try_dataset

from mmi.foundation.errors import MmiError
from mmi.inspection import inspect as _pictures  # noqa: F401 (loaded before the fork)
from mmi.programs.build_impostors import build_impostors
from mmi.programs.inspect_layers import inspect_layers
from mmi.walks.walk import read_walk
from viewer.programs import compare_impostors as comparer
from viewer.programs.view_impostors import view_impostors
from viewer.report import compare as _report  # noqa: F401
from viewer.serving import server
from viewer.window.session import ShownFrame
from viewer.window.studio import Studio

BUILD = [
    "--display",
    "64x64",
    "--near-distance",
    "30",
    "--cell-length",
    "80",
    "--max-cells",
    "1",
    "--workers",
    "1",
    "--quiet",
]
"""How the seed of a build that is resumed was built."""
_MOST_FRAMES = 40
_SECONDS = 60.0


class RefusedError(MmiError):
    """A program ended with status 2, and this line."""


def try_inspecting(folder: Path, expect: Expect) -> None:
    """Plots of a cell."""
    _run(folder, expect, inspect_layers, "inspect-layers", [folder, "-o", "OUT"])


def try_comparing(folder: Path, expect: Expect) -> None:
    """A view by techniques that read cells in all three ways."""
    some = ["--views", "1", "--techniques", "local,multi-mesh,multi-mesh-dynamic"]
    _compare(folder, expect, some)


def try_comparing_walk(folder: Path, expect: Expect) -> None:
    """A few frames of the walk, among what moves; a walk that takes longer is as long as it says."""
    try:
        walk = read_walk(folder / "walk.json")
        if 2.0 * (walk.keyframes[-1].time - walk.keyframes[0].time) > _MOST_FRAMES:
            return
    except MmiError:  # the program shall say it
        pass
    movers = ["--movers", folder / "movers.json", "--path", folder / "walk.json", "--fps", "2"]
    _compare(folder, expect, [*movers, "--techniques", "full"])


def _compare(folder: Path, expect: Expect, more: list[object]) -> None:
    with patch.object(comparer, "usable_cores", return_value=1):
        often = [folder, "-o", "OUT", "--no-flip", "--worst", "1", "--quiet", *more]
        _run(folder, expect, comparer.compare_impostors, "compare-impostors", often)


def try_viewing(folder: Path, expect: Expect) -> None:
    """The first frame of a page."""
    shown: list[ShownFrame] = []

    def serve(studio: Studio, *_: object, **__: object) -> None:
        with studio:
            studio.join("page", (64, 48))
            shown.append(studio.ask("page").result(_SECONDS))
            studio.leave("page")

    with patch.object(server, "serve", serve):
        _run(folder, expect, view_impostors, "view-impostors", [folder, "--no-browser"])
    expect(shown[0].picture.shape == (48, 64, 3) and shown[0].picture.dtype == np.uint8, "a frame of another kind")


def try_resuming(folder: Path, expect: Expect) -> None:
    """A build into a dataset that is there, and what it left."""
    arguments = [folder / "x.city.json", "-o", folder / "out", *BUILD]
    _run(folder, expect, build_impostors, "build-impostors", arguments)
    try_dataset(folder / "out", expect)


def _run(
    folder: Path, expect: Expect, program: Callable[[list[str]], object], name: str, arguments: list[object]
) -> None:
    """The program in this process; raises RefusedError where it refuses."""
    opened = _opened()
    with tempfile.TemporaryDirectory(prefix="made-", dir=folder.parent) as made:
        words = [made if one == "OUT" else str(one) for one in arguments]
        opened.clear()
        err, status = io.StringIO(), None
        with patch.multiple(sys, stdout=io.StringIO(), stderr=err):
            try:
                program(words)
            except SystemExit as left:
                status = left.code
        own = (os.fspath(folder), made)
        beside = {one for one in opened if one.startswith(os.fspath(folder.parent)) and not one.startswith(own)}
        beside |= {one for one in opened if one == "/etc/hostname"}
        expect(not beside, f"{name}: opened {sorted(beside)}")
    lines = err.getvalue().splitlines()
    if status in (0, None):
        expect(status == 0, f"{name}: no status")
        return
    told = lines[-1] if lines else "nothing"
    line = status == 2 and told.startswith(f"{name}: error: ") and sum(": error: " in one for one in lines) == 1
    if not line or "Traceback" in err.getvalue():
        raise AssertionError(f"{name}: status {status}: {' | '.join(lines[-3:])}")
    raise RefusedError(told.replace(os.fspath(folder.parent), ""))


@cache
def _opened() -> list[str]:
    """The names of all files and folders that Python opens, makes, moves or removes in this process from now on."""
    found: list[str] = []
    events = {"open", "os.listdir", "os.scandir", "os.mkdir", "os.remove", "os.rename", "os.rmdir", "os.symlink"}

    def heard(event: str, values: tuple[object, ...]) -> None:
        if event in events:
            found.extend(os.path.normpath(one) for one in values[:2] if isinstance(one, str) and "/" in one)

    sys.addaudithook(heard)
    return found
