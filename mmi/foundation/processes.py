"""What a process knows of itself and its like: peak memory, the version of the package, starting others without Ctrl-C."""

from __future__ import annotations

import os
import resource
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from multiprocessing import resource_tracker
from pathlib import Path

__all__ = ["package_version", "peak_memory", "usable_cores", "without_interrupts"]


def package_version() -> str:
    """Of this project, which is part of every fingerprint."""
    return version("multi-mesh-impostors")


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Hold Ctrl-C back; a process started meanwhile never sees it: Ctrl-C is the parent's business."""
    resource_tracker.ensure_running()  # it lets Ctrl-C through again when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def peak_memory(*, shared: bool = True) -> int:
    """Bytes that this process has held at most; not ``shared``: less its pages of files (libraries), which are in memory once
    however many processes use them.
    """
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    status = Path("/proc/self/status")
    if shared or not status.exists():
        return peak
    files = next((line for line in status.read_text().splitlines() if line.startswith("RssFile:")), "RssFile: 0 kB")
    return peak - 1024 * int(files.split()[1])


def usable_cores() -> int:
    """Cores that this process may run on, which not every system tells apart from those that there are."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
