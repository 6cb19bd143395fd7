"""Mutants tried in children that are forked after the imports, each under limits of processor time and memory.

A child takes one mutant after the other and tells what became of each, so that a start costs little; one that ends without
having told (a crash, a limit) is replaced by another, which goes on behind the mutant that ended it. The parent never reads a
mutant, nor starts threads.
"""

from __future__ import annotations

import json
import os
import resource
import select
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from fuzz.formats import Format, mutant_of

from mmi.foundation.errors import MmiError

ACCEPTED, REFUSED, TRACEBACK, HANG, MEMORY, ABSURD, CRASH = OUTCOMES = (
    "accepted", "refused", "traceback", "hang", "memory", "absurd", "crash"
)  # fmt: skip
FAILURES = (TRACEBACK, HANG, MEMORY, ABSURD, CRASH)
CPU_SECONDS = 20
MEMORY_BYTES = 2 << 30
WALL_SECONDS = 180.0
"""A mutant that takes this long without using the processor waits for something that does not come."""


class AbsurdError(Exception):
    """Something was accepted that nobody should have accepted."""


@dataclass(frozen=True, slots=True)
class Tried:
    """What became of the mutant of this number; ``told`` is its message, or the end of its traceback."""

    number: int
    outcome: str
    told: str


def tried(form: Format, seeds: dict[str, bytes], run: int, numbers: Iterable[int]) -> Iterator[Tried]:
    """Try these mutants of a run, in order, in one child after the other."""
    todo = list(numbers)
    while todo:
        done, ended = 0, None
        for one in _in_a_child(form, seeds, run, todo):
            done += 1
            ended = one
            yield one
        if ended is None:
            raise RuntimeError(f"{form.name}: a child told nothing")
        todo = todo[done:]


def _in_a_child(form: Format, seeds: dict[str, bytes], run: int, todo: list[int]) -> Iterator[Tried]:
    reading, writing = os.pipe()
    folder = Path(tempfile.mkdtemp(prefix="fuzz-", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    child = fork()
    if child == 0:
        os.close(reading)
        _work(form, seeds, run, todo, writing, folder)
    os.close(writing)
    place, rest, since, killed = 0, b"", time.monotonic(), False
    try:
        while True:
            ready, _, _ = select.select([reading], [], [], 1.0)
            if ready:
                data = os.read(reading, 1 << 16)
                if not data:
                    break
                rest += data
                *lines, rest = rest.split(b"\n")
                for line in lines:
                    outcome, told = json.loads(line)
                    yield Tried(todo[place], outcome, told)
                    place, since = place + 1, time.monotonic()
            elif time.monotonic() - since > WALL_SECONDS:
                os.kill(child, signal.SIGKILL)
                killed = True
    finally:
        os.close(reading)
        _, status = os.waitpid(child, 0)
        shutil.rmtree(folder, ignore_errors=True)
    if place < len(todo):
        number = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
        if killed or number == signal.SIGXCPU:
            yield Tried(todo[place], HANG, "waited in vain" if killed else f"{CPU_SECONDS} s of processor time")
        else:
            yield Tried(todo[place], CRASH, f"signal {number}, status {status}")


def _work(form: Format, seeds: dict[str, bytes], run: int, todo: list[int], writing: int, folder: Path) -> None:
    """The child: never returns."""
    try:
        silence = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(silence, stream)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        warnings.simplefilter("ignore")  # programs print none, and tests would raise them
        for number in todo:
            inside = folder / "x"
            inside.mkdir()
            _limit()
            try:
                outcome, told = _try(form, mutant_of(form, seeds, run, number), inside)
            finally:
                resource.setrlimit(
                    resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.getrlimit(resource.RLIMIT_AS)[1])
                )
            os.write(writing, json.dumps([outcome, told]).encode() + b"\n")
            shutil.rmtree(inside, ignore_errors=True)
    finally:
        os._exit(0)


def _limit() -> None:
    """Another 20 s of processor time, another 2 GB."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    _, most = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_CPU, (int(used.ru_utime + used.ru_stime) + CPU_SECONDS + 1, most))
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    _, most = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY_BYTES, most))


def _try(form: Format, mutant: dict[str, bytes], inside: Path) -> tuple[str, str]:
    for name, data in mutant.items():
        path = inside / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data)
    try:
        form.attempt(inside, expect)
    except MmiError as error:
        told = str(error)
        return (REFUSED, told[:300]) if "\n" not in told else (TRACEBACK, f"a message of several lines: {told[:300]!r}")
    except AbsurdError as error:
        return ABSURD, f"{error}"[:300]
    except MemoryError:
        return MEMORY, _last_lines()
    except BaseException:
        told = _last_lines()
        return (MEMORY if "MemoryError" in told else TRACEBACK), told
    return ACCEPTED, ""


def expect(holds: bool, what: str) -> None:
    """Raises AbsurdError unless this holds."""
    if not holds:
        raise AbsurdError(what)


def _last_lines() -> str:
    """The exception, and where in this project it came from."""
    kind, error, trace = sys.exc_info()
    frames = [one for one in traceback.extract_tb(trace) if "/site-packages/" not in one.filename]
    places = " < ".join(f"{Path(one.filename).name}:{one.lineno}" for one in reversed(frames[-4:]))
    return f"{kind.__name__}: {str(error)[:160]} at {places}"


def fork() -> int:
    """A child, as ``os.fork`` makes one; Python warns of threads, of which the child uses none."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()
