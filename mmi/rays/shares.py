"""Rays shared out to threads: every caster works on a range of rays at a time, and lets other threads run meanwhile.

Threads of Python rather than Numba's own: kernels and Embree let go of the interpreter's lock, any thread of the caller may
cast while another draws or casts as well (Numba's own threads stop the process when two callers use them at a time), and a
caster never takes more cores than it was told to.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

__all__ = ["Shares"]

_SMALLEST = 1024
"""Rays in a share, at least: they take some milliseconds, of which handing them out takes little."""
_LARGEST = 8192
"""Rays in a share, at most: what is kept of them while they are cast stays in a core's cache."""
_PER_WORKER = 8
"""Shares for each worker, but where they would be smaller than that, so that none waits long for the last."""


class Shares:
    """Threads that work through ranges of rays."""

    def __init__(self, workers: int) -> None:
        """``workers``: how many threads; one means that of the caller. Raises ValueError if there is none."""
        if workers < 1:
            raise ValueError(f"a caster needs at least 1 worker, found {workers}")
        self._workers = workers
        self._threads = ThreadPoolExecutor(workers - 1, thread_name_prefix="rays") if workers > 1 else None

    def run(self, work: Callable[[int, int], None], count: int) -> None:
        """Call ``work(first, last)`` for ranges that make up ``count`` rays, and wait. Raises what any of them raises."""
        size = min(max(_SMALLEST, -(-count // (self._workers * _PER_WORKER))), _LARGEST)
        ranges = iter([(first, min(first + size, count)) for first in range(0, count, size)])

        def work_through() -> None:
            for first, last in ranges:
                work(first, last)

        helpers = min(self._workers, -(-count // size)) - 1
        others = [] if self._threads is None else [self._threads.submit(work_through) for _ in range(helpers)]
        work_through()
        for one in others:
            one.result()
