"""What osmium cannot be trusted with in OpenStreetMap's PBF: texts with a zero byte, at which it reads beyond its memory.

osmium keeps tags as texts that end in a zero byte, one after the other. A text that holds one itself shifts those behind it,
and reading goes on where no tags are. All texts of a block stand in its table of strings, which is looked through first.
Source: https://wiki.openstreetmap.org/wiki/PBF_Format.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from pathlib import Path

from mmi.reading.unpacked import most_unpacked, too_large

__all__ = ["refuse_zero_bytes"]

_MOST_HEADER, _MOST_BLOB = 64 << 10, 32 << 20
"""Bytes of a header, and of a block packed or unpacked, as the format allows."""
_RAW, _RAW_SIZE, _ZLIB = 1, 2, 3
"""Fields of a blob: a block as it is, the size of a packed one, a block packed by zlib."""


def refuse_zero_bytes(path: Path) -> None:
    """Look through the tables of strings of all blocks of ``path``.

    Raises:
        CityError: more comes out of the blocks than may.
        ValueError: a text with a zero byte; a block that is damaged, too large, or packed by anything but zlib.
    """
    most, count = most_unpacked(path), 0
    with path.open("rb") as file:
        while head := file.read(4):
            size = _number_up_to(head, _MOST_HEADER)
            header = list(_fields(_exactly(file.read(size), size)))
            sizes = [value for key, value in header if key == 3 and isinstance(value, int)]
            kinds = [value for key, value in header if key == 1]
            if not sizes or sizes[-1] > _MOST_BLOB:
                raise ValueError("a block without a size, or larger than 32 MiB")
            blob = _exactly(file.read(sizes[-1]), sizes[-1])
            if kinds[-1:] == [b"OSMData"]:
                for block in _unpacked(blob):
                    count += len(block)
                    if count > most:
                        raise too_large(path, most)
                    _look_through(block)


def _number_up_to(head: bytes, most: int) -> int:
    size = int.from_bytes(head, "big")
    if len(head) < 4 or size > most:
        raise ValueError(f"a header of {size} bytes in place of one of at most {most}")
    return size


def _exactly(data: bytes, size: int) -> bytes:
    if len(data) < size:
        raise ValueError(f"its end {size - len(data)} bytes before that of a block")
    return data


def _unpacked(blob: bytes) -> Iterator[bytes]:
    for key, value in _fields(blob):
        if key == _RAW and isinstance(value, bytes):
            yield value
        elif key == _ZLIB and isinstance(value, bytes):
            yield zlib.decompressobj().decompress(value, _MOST_BLOB)
        elif key != _RAW_SIZE:
            raise ValueError("a block that is not packed by zlib (osmium cat OLD.osm.pbf -o NEW.osm.pbf packs it so)")


def _look_through(block: bytes) -> None:
    for key, table in _fields(block):
        # A table without an empty text but its first has one zero byte, as the length of that.
        if key == 1 and isinstance(table, bytes) and table.count(0) > table.startswith(b"\n\0"):
            for _, text in _fields(table):
                if isinstance(text, bytes) and 0 in text:
                    raise ValueError(f"a zero byte in the text {text[:40].decode('utf-8', 'backslashreplace')!r}")


def _fields(message: bytes) -> Iterator[tuple[int, int | bytes]]:
    """(number, value) of the fields of a message of protocol buffers: numbers, and bytes for all that has a length."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        kind = key & 7
        if kind == 0:
            value, at = _varint(message, at)
            yield key >> 3, value
            continue
        size = {1: 8, 5: 4}.get(kind, -1)
        if kind == 2:
            size, at = _varint(message, at)
        if size < 0 or at + size > len(message):
            raise ValueError("a damaged block")
        yield key >> 3, message[at : at + size]
        at += size


def _varint(message: bytes, at: int) -> tuple[int, int]:
    """A number in sevens of bits, and where it ends."""
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(message):
            break
        byte = message[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ValueError("a damaged block")
