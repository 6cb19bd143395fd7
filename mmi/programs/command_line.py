"""What the project's programs have in common: one line for whatever is raised, progress, option values."""

from __future__ import annotations

import argparse
import math
import re
import sys
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from mmi.foundation.errors import one_line
from mmi.foundation.processes import quiet_libraries
from mmi.foundation.progress import Progress, ProgressLog, silent
from mmi.programs.endings import Ending, ending_of, fault_line, leave, open_streams, unwritten

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress

__all__ = [
    "Parser",
    "ProgressBar",
    "names_option",
    "numbers_option",
    "path_option",
    "run_program",
    "size_option",
]


class Parser(argparse.ArgumentParser):
    """One line for a wrong command line, like for every other mistake."""

    def error(self, message: str) -> NoReturn:
        """Exit with status 2."""
        self.exit(2, f"{self.prog}: error: {message} (see {self.prog} --help)\n")


def run_program(
    parser: Parser, arguments: Sequence[str] | None, program: Callable[[argparse.Namespace], None], *, kept: str
) -> NoReturn:
    """Parse, run, and turn whatever is raised into one line and an exit status; ``kept`` is what Ctrl-C leaves behind.

    Every program has ``--debug``, which prints the traceback before that line, and lets libraries warn and log.
    """
    open_streams()
    _look_here_for_plug_ins()
    parser.add_argument(
        "--debug", action="store_true", help="print the traceback of an error, and what libraries warn of"
    )
    words = _with_negative_numbers(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in words
    ending = Ending(0)
    loud = quiet_libraries(threads=partial(_told_of_thread, parser.prog)) if not debug else None
    try:
        program(parser.parse_args(words))
    except BaseException as error:
        if debug and not isinstance(error, SystemExit):
            traceback.print_exception(error)
        ending = ending_of(error, kept=kept)
    finally:
        if loud is not None:
            loud()
    if ending.status == 0 and (broken := unwritten()) is not None:
        ending = ending_of(broken, kept=kept)
    leave(parser.prog, ending)


def _told_of_thread(program: str, error: BaseException) -> None:
    """A thread that ends by an error does not end the program, and gets a line."""
    print(f"{program}: {fault_line(error)}", file=sys.stderr, flush=True)


class ProgressBar:
    """Progress on standard error, as a context manager that yields what to call: done, total, and what was done.

    A bar on a terminal, a line now and then where output is redirected, nothing if ``quiet``. ``things`` is what is counted.
    """

    def __init__(self, things: str, *, quiet: bool = False) -> None:
        self._things, self._quiet = things, quiet
        self._bar: RichProgress | None = None

    def __enter__(self) -> Progress:
        if self._quiet:
            return silent
        if not sys.stderr.isatty():
            return ProgressLog(self._things)
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        self._bar = bar = Bar(
            TextColumn(self._things),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.description}", markup=False),
            console=Console(stderr=True),
            transient=True,
        )
        task = bar.add_task("preparing", total=None)
        bar.start()
        return lambda done, total, name: bar.update(task, completed=done, total=total, description=one_line(name))

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()


def _look_here_for_plug_ins() -> None:
    """Let modules of the current folder be imported, after all others, since ``my_module:function`` is mostly there.

    Python itself does so for scripts and ``python -m``, but not for installed programs. Processes that are started later have
    it from this one.
    """
    with suppress(OSError):  # the folder may be there no more
        here = str(Path.cwd())
        if here not in sys.path:
            sys.path.append(here)


def _with_negative_numbers(arguments: Sequence[str]) -> list[str]:
    """``--around -73.9,40.7`` as ``--around=-73.9,40.7``, since argparse takes numbers like these for options."""
    joined: list[str] = []
    for one in arguments:
        if joined and re.fullmatch(r"--[a-z-]+", joined[-1]) and re.fullmatch(r"-[\d.]+(,[-+\d.e]+)+", one):
            joined[-1] += f"={one}"
        else:
            joined.append(one)
    return joined


def size_option(text: str) -> tuple[int, int]:
    """``1920x1080`` -> (1920, 1080)."""
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise argparse.ArgumentTypeError(f"WIDTHxHEIGHT in pixels expected, such as 1920x1080, found {text!r}")
    return int(width), int(height)


def numbers_option(text: str, count: int, expected: str) -> list[float]:
    """``count`` finite numbers with commas between; ``expected`` says which, for the message."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        raise argparse.ArgumentTypeError(f"{expected} expected, found {text!r}")
    return values


def names_option(text: str) -> list[str]:
    """Names with commas between."""
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise argparse.ArgumentTypeError(f"names with commas between expected, found {text!r}")
    return names


def path_option(text: str) -> Path:
    """A path that is not empty, of letters that a file's name can have."""
    if not text or "\0" in text:
        raise argparse.ArgumentTypeError(
            f"a path expected, found {text!r}" if text else "a path expected, found nothing"
        )
    return Path(text)
