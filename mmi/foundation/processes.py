"""What a process knows about itself (peak memory, cores, the version), how others are started without Ctrl-C and end, and
how libraries in it are kept quiet.
"""

from __future__ import annotations

import ctypes
import logging
import os
import resource
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import version
from multiprocessing import resource_tracker
from multiprocessing.process import BaseProcess
from pathlib import Path

__all__ = [
    "give_memory_back",
    "how_it_ended",
    "package_version",
    "peak_memory",
    "quiet_libraries",
    "usable_cores",
    "without_interrupts",
]


def package_version() -> str:
    """The version of this project, which is part of every fingerprint."""
    return version("multi-mesh-impostors")


@contextmanager
def without_interrupts() -> Iterator[None]:
    """Hold Ctrl-C back during the block. A process that is started in it never sees Ctrl-C: that is its parent's business."""
    resource_tracker.ensure_running()  # it lets Ctrl-C through again when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def how_it_ended(process: BaseProcess) -> str:
    """For a message, how a process ended that should not have: by which signal, or with which status."""
    process.join(timeout=1.0)
    code = process.exitcode
    if code is None or code >= 0:
        return f"with status {code}"
    return f"by signal {-code}" + (", which the system sends when memory runs out" if -code == signal.SIGKILL else "")


def give_memory_back() -> None:
    """Give the system back what was freed: after reading a city glibc keeps what lies before anything that is still there.

    Small things of Python's own are not given back by this.
    """
    with suppress(OSError, AttributeError):  # other systems' allocators have no such call
        ctypes.CDLL(None).malloc_trim(0)


def peak_memory(*, shared: bool = True) -> int:
    """Bytes that this process has held at most. Without ``shared``, pages of files such as libraries do not count: they are in
    memory once, however many processes use them.
    """
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    status = Path("/proc/self/status")
    if shared or not status.exists():
        return peak
    files = next((line for line in status.read_text().splitlines() if line.startswith("RssFile:")), "RssFile: 0 kB")
    return peak - 1024 * int(files.split()[1])


def usable_cores() -> int:
    """How many cores this process may run on; where the system does not say, how many there are."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def quiet_libraries(*, threads: Callable[[BaseException], None] = lambda _: None) -> Callable[[], None]:
    """From now on neither warnings nor logs of libraries reach standard error; returns what undoes it.

    Warnings that are to be errors still are. Logs go where whoever has set up logging wants them. Errors that end a thread go
    to ``threads``, and those of finalizers, which end nothing, to nobody. Mesa, which would complain where it cannot keep its
    shaders, is told not to keep any there.
    """
    if not _may_keep_shaders():
        os.environ.setdefault("MESA_SHADER_CACHE_DISABLE", "true")
    handler = logging.NullHandler()
    before = warnings.showwarning, threading.excepthook, sys.unraisablehook
    logging.getLogger().addHandler(handler)
    warnings.showwarning = lambda *_: None
    threading.excepthook = lambda args: threads(args.exc_value or args.exc_type())
    sys.unraisablehook = lambda _: None

    def undo() -> None:
        warnings.showwarning, threading.excepthook, sys.unraisablehook = before
        logging.getLogger().removeHandler(handler)

    return undo


def _may_keep_shaders() -> bool:
    """Whether the folder under which Mesa keeps compiled shaders is there, or can be made."""
    try:
        place = Path(os.environ.get("XDG_CACHE_HOME") or Path.home())
    except RuntimeError:  # a user without a home whom the system does not know
        return False
    folder = place if place.exists() else place.parent
    return folder.is_dir() and os.access(folder, os.W_OK)
