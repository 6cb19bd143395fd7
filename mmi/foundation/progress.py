"""How far long work has come, and how long it took: what functions that take a while call, a log of it for where there is no
terminal, and a watch for the stages of a build.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TextIO

from mmi.foundation.errors import one_line

__all__ = ["Progress", "ProgressLog", "Stopwatch", "silent"]

Progress = Callable[[int, int, str], None]
"""Called with how much is done, how much there is, and the name of what was done last or is being done."""

_SECONDS = 30.0
"""Between two lines of a log."""


def silent(done: int, total: int, name: str) -> None:
    """No progress is told."""


class ProgressLog:
    """A :data:`Progress` that writes a line to a stream now and then: how much is done, and how long the rest may take.

    ``things`` is what is counted. The first line comes after ``seconds``, and so do the others: short work writes none. Where
    less is done than before, or of another total, other work has begun, and the time that is left is told from there.
    ``clock`` tells seconds; a stream of None is what standard error is at that time.
    """

    def __init__(
        self,
        things: str,
        *,
        stream: TextIO | None = None,
        seconds: float = _SECONDS,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._things, self._stream, self._seconds, self._clock = things, stream, seconds, clock
        self._told = clock()
        self._since = (self._told, 0, 0)
        self._done = 0

    def __call__(self, done: int, total: int, name: str) -> None:
        """Write a line if it is time to."""
        now = self._clock()
        begun, first, whole = self._since
        if total != whole or done < self._done:
            begun, first = now, done
            self._since = (begun, first, total)
        self._done = done
        if now - self._told < self._seconds:
            return
        self._told = now
        left = (now - begun) * (total - done) / (done - first) if done > first else None
        rest = "" if left is None or done >= total else f", about {_duration(left)} left"
        print(
            f"{self._things}: {done:,} of {total:,}{rest} ({one_line(name)})",
            file=self._stream or sys.stderr,
            flush=True,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Stopwatch:
    """Seconds spent in each stage."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the body of a ``with`` statement under ``name``."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


def _duration(seconds: float) -> str:
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
