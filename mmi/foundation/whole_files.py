"""Files that are there whole or not at all: written under a temporary name in the same folder, then renamed.

Everything that the project writes goes this way: datasets, cities, reports, pictures and films. And what is read whole is
read up to a size (:mod:`mmi.limits`), which is looked at before.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from mmi.foundation.errors import DatasetError, MmiError

__all__ = [
    "bytes_within",
    "check_size",
    "in_words",
    "is_leftover",
    "real_path",
    "whole_file",
    "whole_path",
    "write_whole",
]

_TEMPORARY = ".part-"


@contextmanager
def whole_path(path: Path, *, make_folder: bool = True) -> Iterator[Path]:
    """A temporary name beside ``path``, for a library that writes to a path itself; makes the folder first if it is to.

    What is written there becomes ``path`` when the block ends well and vanishes otherwise. What is raised passes through:
    OSError where a file cannot be written.
    """
    temporary = path.with_name(f"{path.name}{_TEMPORARY}{os.getpid()}")
    try:
        if make_folder:
            path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        temporary.replace(path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise


@contextmanager
def whole_file(path: Path, *, error: type[MmiError] = DatasetError, make_folder: bool = True) -> Iterator[BinaryIO]:
    """A file to write to, which becomes ``path`` when the block ends well and vanishes otherwise; makes the folder if it is to.

    Raises ``error`` where it cannot be written.
    """
    try:
        with whole_path(path, make_folder=make_folder) as temporary, temporary.open("wb") as file:
            yield file
    except OSError as reason:
        raise error(f"{path}: a writable file expected, found: {reason.strerror or reason}") from reason


def write_whole(path: Path, data: bytes, *, error: type[MmiError] = DatasetError) -> None:
    """Write ``path`` with these contents as :func:`whole_file` does; makes its folder. Raises ``error``."""
    with whole_file(path, error=error) as file:
        file.write(data)


def is_leftover(path: Path, of: str = "") -> bool:
    """Whether ``path`` is called like the temporary file of a process that was killed: of the file ``of``, or of any."""
    name, mark, process = path.name.rpartition(_TEMPORARY)
    return bool(mark) and process.isdigit() and of in ("", name)


def real_path(path: Path) -> Path:
    """The absolute path that links lead to, as far as they lead anywhere: Python's own ``resolve`` raises where they loop."""
    return Path(os.path.realpath(path))


def check_size(path: Path, most: int, error: type[MmiError]) -> None:
    """Raise ``error`` where the file has more than ``most`` bytes; a folder, or what is not there, is of no size.

    The line names the file, and what was expected and found.
    """
    try:
        size = path.stat().st_size if path.is_file() else 0
    except (OSError, ValueError):  # whoever opens it says why
        return
    if size > most:
        raise error(f"{path}: a file of at most {in_words(most)} expected, found {in_words(size)}")


def bytes_within(path: Path, most: int, error: type[MmiError]) -> bytes:
    """The bytes of a file, as :func:`check_size` lets them pass.

    Raises OSError where it cannot be read.
    """
    check_size(path, most, error)
    return path.read_bytes()


def in_words(number: int) -> str:
    """``1.5 GB``: bytes in the largest unit of a thousand that they fill."""
    for unit, name in ((10**9, "GB"), (10**6, "MB"), (10**3, "kB")):
        if number >= unit:
            return f"{number / unit:,.1f} {name}".replace(".0 ", " ")
    return f"{number} bytes"
