"""How a program ends: its exit status, and the one line that says why, whatever was raised.

Status 0 is for what was done, 2 for mistakes in arguments or files and for what the machine does not have, 130 for Ctrl-C, and
1 for a fault of the program, which asks to be reported. Nothing here raises, whatever the streams are.
"""

from __future__ import annotations

import errno
import os
import select
import sys
import traceback
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import NoReturn, TextIO

from mmi.foundation.errors import FaultError, MmiError, one_line
from mmi.foundation.plug_ins import said
from mmi.foundation.processes import package_version

__all__ = ["Ending", "ending_of", "fault_line", "leave", "open_streams", "unwritten"]

_LONGEST = 2000
"""Letters of a message; what libraries say may be whole files."""
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO})
_MEMORY = (
    "error: memory ran out{}; expected a machine with more of it, or less to do: a part of the city, fewer --workers, a "
    "smaller --display or --cache"
)


@dataclass(frozen=True, slots=True)
class Ending:
    """An exit status, and what is said on standard error after the program's name: a line, or nothing."""

    status: int
    line: str = ""


def open_streams() -> None:
    """Let standard input, output and error be there, and take any text.

    Where whoever started the program has closed one, the next file that is opened would get its number, and what libraries
    write to it would go into that file: it becomes one that leads nowhere. Letters that a stream does not have come as codes.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest number that is free, which is this one
            os.set_inheritable(number, True)
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, mode, closefd=False))
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            with suppress(OSError, ValueError):
                reconfigure(errors="backslashreplace")


def ending_of(error: BaseException, *, kept: str) -> Ending:
    """How a program ends that raised ``error``; ``kept`` is what Ctrl-C leaves behind."""
    if isinstance(error, SystemExit):  # argparse has said why
        if isinstance(error.code, str):
            return Ending(1, f"error: {_short(error.code)}")
        return Ending(error.code or 0)
    if isinstance(error, KeyboardInterrupt):
        return Ending(130, f"interrupted; {kept}")
    if isinstance(error, MemoryError):
        reason = _short(str(error))
        return Ending(2, _MEMORY.format(f" ({reason})" if reason else ""))
    if isinstance(error, FaultError):
        return Ending(1, f"error: {_short(str(error))}")
    if isinstance(error, MmiError):
        return Ending(2, f"error: {one_line(str(error))}")
    if isinstance(error, OSError):
        return _of_the_system(error)
    return Ending(1, fault_line(error))


def _of_the_system(error: OSError) -> Ending:
    """A file that cannot be used; what names no file is standard output, which every program writes, in most cases."""
    name = error.filename
    if name is None:
        pending = unwritten() is not None
        if isinstance(error, BrokenPipeError) and (pending or _nobody_reads()):
            return Ending(0)  # whoever read it has left: say nothing more, to nobody
        if pending or error.errno in _FULL:
            name = "standard output" if pending else "standard output or a temporary file"
    where = "" if name is None else f"{os.fsdecode(name) if isinstance(name, bytes) else name}: "
    return Ending(2, f"error: {one_line(f'{where}{error.strerror or said(error)}')}")


def _nobody_reads() -> bool:
    """Whether standard output is a pipe that has no other end any more; where it is unbuffered, nothing else tells."""
    watched = select.poll()
    try:
        watched.register(sys.stdout.fileno(), select.POLLOUT)
        return any(event & select.POLLERR for _, event in watched.poll(0))
    except (OSError, ValueError):
        return False


def fault_line(error: BaseException) -> str:
    """What is said of an error that nobody foresaw: what it was, where, and how to report it."""
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    try:
        version = package_version()
    except PackageNotFoundError:
        version = "of an unknown version"
    python = ".".join(map(str, sys.version_info[:3]))
    return (
        f"error: {_short(said(error))}{where}; this is a fault of the program, please report this line and the command: "
        f"multi-mesh-impostors {version}, Python {python}; --debug prints the traceback"
    )


def _short(text: str) -> str:
    line = one_line(text)
    return line if len(line) <= _LONGEST else f"{line[:_LONGEST]}..."


def unwritten() -> OSError | None:
    """What keeps standard output from being written, if anything does; all that was printed so far is written now."""
    try:
        sys.stdout.flush()
    except OSError as error:
        return error
    except ValueError:  # it is closed
        pass
    return None


def leave(program: str, ending: Ending) -> NoReturn:
    """Say the line, and exit with the status.

    What is left in streams that cannot be written is dropped: otherwise Python would complain of it, with a status of its own.
    """
    _try(sys.stderr, f"{program}: {ending.line}\n" if ending.line else "")
    _try(sys.stdout, "")
    sys.exit(ending.status)


def _try(stream: TextIO, text: str) -> None:
    try:
        stream.write(text)
        stream.flush()
    except (OSError, ValueError):
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
