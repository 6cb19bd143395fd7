"""Files that are packed (gzip, bzip2), and how much may come out of them.

A few kilobytes can unpack into gigabytes. What does is refused while it is unpacked: text and maps shrink to a tenth or a
thirtieth, what is made to do harm to a thousandth.
"""

from __future__ import annotations

import bz2
import gzip
import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from mmi import limits
from mmi.foundation.errors import CityError
from mmi.foundation.whole_files import check_size, in_words

__all__ = ["Unpacked", "most_unpacked", "too_large", "unpacked"]

_PIECE = 1 << 20
"""Bytes that are read at a time."""


class Unpacked:
    """What is in a file, packed or not, from its start."""

    def __init__(self, path: Path, file: IO[bytes], most: int) -> None:
        self._path, self._file, self._most, self._count = path, file, most, 0

    def read(self, size: int) -> bytes:
        """The next ``size`` bytes, fewer at the end.

        Raises CityError where more come out of the file than may; OSError, EOFError and zlib.error where it is damaged.
        """
        data = self._file.read(size)
        self._count += len(data)
        if self._count > self._most:
            raise too_large(self._path, self._most)
        return data

    def read_all(self, most: int) -> bytes:
        """All that is in it, from the start; it raises as ``read`` does, also for more than ``most`` bytes."""
        self._file.seek(0)
        self._count, whole = 0, io.BytesIO()
        while data := self.read(_PIECE):  # a file makes room for as much as it is asked for, whether it has it or not
            whole.write(data)
            if self._count > most:
                raise too_large(self._path, most)
        return whole.getvalue()


@contextmanager
def unpacked(path: Path) -> Iterator[Unpacked]:
    """The file open for reading, unpacked where it ends in ``.gz`` or ``.bz2``.

    Raises CityError where it is too large (``limits.CITY_BYTES``), OSError where it cannot be opened.
    """
    check_size(path, limits.CITY_BYTES, CityError)
    opener: Any = {".gz": gzip.open, ".bz2": bz2.open}.get(path.suffix.lower())
    most = limits.CITY_BYTES if opener is None else most_unpacked(path)
    with path.open("rb") if opener is None else opener(path, "rb") as file:
        yield Unpacked(path, file, most)


def most_unpacked(path: Path) -> int:
    """How many bytes may come out of a packed file. Raises CityError where the file itself is too large."""
    check_size(path, limits.CITY_BYTES, CityError)
    return min(limits.UNPACKED_BYTES, max(limits.EXPANSION * path.stat().st_size, limits.UNPACKED_ANYWAY))


def too_large(path: Path, most: int) -> CityError:
    """What is to be raised where more than ``most`` bytes come out of it."""
    return CityError(f"{path}: at most {in_words(most)} expected to come out of it, found more; cut the city out of it")
