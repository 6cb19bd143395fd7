"""Mutants tried in children that are forked after the imports, each under limits of processor time and memory.

A child takes one mutant after the other, of whichever formats, and tells what became of each and what it cost: what is loaded
when something is read for the first time is loaded once. One that ends without having told (a crash, a limit) is replaced by
another, which goes on behind the mutant that ended it. The parent never reads a mutant, nor starts threads.
"""

from __future__ import annotations

import faulthandler
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
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from fuzz.formats import Format, mutant_of

from mmi.foundation.errors import MmiError

Job = tuple[Format, int]
"""A format and the number of a mutant."""
Seeds = dict[str, dict[str, bytes]]
"""What each format begins from: name of the format -> name of a file -> its bytes."""
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
    """What became of a mutant; ``told`` is its message, or the end of its traceback."""

    form: str
    number: int
    outcome: str
    told: str
    seconds: float = 0.0
    """Processor time; zero where it never came back, as for the next."""
    megabytes: float = 0.0
    """Memory beyond what was held before, at its most."""


def tried(jobs: Iterable[Job], seeds: Seeds, run: int) -> Iterator[Tried]:
    """Try these mutants of a run, in order, in one child after the other."""
    todo = list(jobs)
    while todo:
        done = 0
        for one in _in_a_child(todo, seeds, run):
            done += 1
            yield one
        if not done:
            raise RuntimeError(f"{todo[0][0].name}: a child told nothing")
        todo = todo[done:]


def _in_a_child(todo: list[Job], seeds: Seeds, run: int) -> Iterator[Tried]:
    reading, writing = os.pipe()
    folder = Path(tempfile.mkdtemp(prefix="fuzz-", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    child = fork()
    if child == 0:
        os.close(reading)
        _work(todo, seeds, run, writing, folder)
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
                    form, number = todo[place]
                    yield Tried(form.name, number, *json.loads(line))
                    place, since = place + 1, time.monotonic()
            elif time.monotonic() - since > WALL_SECONDS:
                os.kill(child, signal.SIGKILL)
                killed = True
    finally:
        os.close(reading)
        _, status = os.waitpid(child, 0)
        shutil.rmtree(folder, ignore_errors=True)
    if place < len(todo):
        form, number = todo[place]
        ending = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
        if killed or ending == signal.SIGXCPU:
            yield Tried(form.name, number, HANG, "waited in vain" if killed else f"{CPU_SECONDS} s of processor time")
        else:
            yield Tried(form.name, number, CRASH, f"signal {ending}, status {status}")


def _work(todo: list[Job], seeds: Seeds, run: int, writing: int, folder: Path) -> None:
    """The child: never returns."""
    try:
        silence = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(silence, stream)
        faulthandler.disable()
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        warnings.simplefilter("ignore")  # programs print none, and tests would raise them
        for form, number in todo:
            inside = folder / "mutant"
            inside.mkdir()
            mutant = mutant_of(form, seeds[form.name], run, number)
            _limit()
            seconds, held = time.process_time(), _most_memory(reset=True)
            try:
                outcome, told = _try(form, mutant, inside)
            finally:
                resource.setrlimit(
                    resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.getrlimit(resource.RLIMIT_AS)[1])
                )
            cost = (time.process_time() - seconds, _most_memory() - held)
            os.write(writing, json.dumps([outcome, told, *cost]).encode() + b"\n")
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


def _most_memory(*, reset: bool = False) -> float:
    """The most memory that this process has held, in megabytes, since it was last reset (where the system can)."""
    if reset:
        with suppress(OSError):
            Path("/proc/self/clear_refs").write_text("5")
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(one.split()[1]) / 1024 for one in lines if one.startswith("VmHWM"))


def _try(form: Format, mutant: dict[str, bytes], inside: Path) -> tuple[str, str]:
    for name, data in mutant.items():
        path = inside / name
        path.parent.mkdir(parents=True, exist_ok=True)
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
