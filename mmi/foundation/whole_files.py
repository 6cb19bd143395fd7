"""Files that are there whole or not at all: written under a temporary name in the same folder, then renamed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from mmi.foundation.errors import CityError, DatasetError, MmiError

__all__ = ["whole_file", "write_whole"]


@contextmanager
def whole_file(path: Path, *, error: type[MmiError] = CityError) -> Iterator[BinaryIO]:
    """A file to write to, which becomes ``path`` when the block ends well and vanishes otherwise; makes its folder.

    Raises ``error`` where it cannot be written.
    """
    temporary = path.with_name(f"{path.name}.part-{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("wb") as file:
            yield file
        temporary.replace(path)
    except BaseException as reason:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        if isinstance(reason, OSError):
            raise error(f"{path}: a writable file expected, found: {reason.strerror or reason}") from reason
        raise


def write_whole(path: Path, data: bytes) -> None:
    """Write a file under a temporary name and rename it; makes its folder. Raises DatasetError where that is impossible."""
    with whole_file(path, error=DatasetError) as file:
        file.write(data)
