"""The container of binary glTF: a header of twelve bytes, a JSON chunk and, where there is data, a binary chunk.

Source: Khronos, glTF 2.0 specification, section 4 (GLB).
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from typing import Any

__all__ = ["BIN", "JSON", "glb_chunks", "glb_pieces", "glb_version", "is_glb", "padding"]

_MAGIC = b"glTF"
JSON, BIN = 0x4E4F534A, 0x004E4942
"""Kinds of chunks."""
_MOST_BYTES = 2**32 - 1  # what the header can say


def padding(size: int) -> int:
    """Bytes that are missing to a multiple of four after ``size`` bytes."""
    return -size % 4


def glb_pieces(
    document: Mapping[str, Any],
    blobs: Sequence[bytes | bytearray],
    *,
    sort_keys: bool = False,
    ascii_only: bool = False,
) -> list[bytes | bytearray]:
    """The pieces that make the file when they follow one another; ``blobs`` are those of the binary chunk.

    Empty lists at the document's top are left out, since glTF has no empty arrays. Each blob has a multiple of four bytes.
    Raises OverflowError where the file would have more bytes than its header can say (4 GiB).
    """
    filled = {key: value for key, value in document.items() if value != []}
    text = json.dumps(
        filled, sort_keys=sort_keys, ensure_ascii=ascii_only, allow_nan=False, separators=(",", ":")
    ).encode("utf-8", errors="backslashreplace")
    text += b" " * padding(len(text))
    body = sum(map(len, blobs))
    size = 12 + 8 + len(text) + (8 + body if body else 0)
    if size > _MOST_BYTES:
        raise OverflowError(f"a binary glTF of at most {_MOST_BYTES} bytes expected, found {size}")
    head = struct.pack("<4sIIII", _MAGIC, 2, size, len(text), JSON)
    return [head, text, *([struct.pack("<II", body, BIN), *blobs] if body else [])]


def is_glb(data: bytes) -> bool:
    """Whether ``data`` begins as binary glTF does."""
    return data[:4] == _MAGIC


def glb_version(data: bytes) -> int:
    """The version in the header; 2 is the only one that :func:`glb_chunks` reads. Raises ValueError for other files."""
    if len(data) < 20:
        raise ValueError(f"binary glTF with a header of 20 bytes expected, found {len(data)} bytes")
    if not is_glb(data):
        raise ValueError(f"binary glTF expected, found a file that starts with {data[:4]!r}")
    return int.from_bytes(data[4:8], "little")


def glb_chunks(data: bytes) -> list[tuple[int, bytes]]:
    """Kind and contents of every chunk; what follows the size that the header says is not looked at.

    Raises ValueError for a file that is no binary glTF 2.0, or shorter than it says.
    """
    version, size = glb_version(data), int.from_bytes(data[8:12], "little")
    if version != 2:
        raise ValueError(f"glTF version 2 expected, found version {version}")
    if size > len(data):
        raise ValueError(f"binary glTF of {size} bytes expected, found {len(data)}: the file is cut off")
    found: list[tuple[int, bytes]] = []
    at = 12
    while at + 8 <= size:
        length, kind = struct.unpack_from("<II", data, at)
        if at + 8 + length > size:
            raise ValueError(f"a chunk of {length} bytes at byte {at} does not fit the file's {size}")
        found.append((kind, data[at + 8 : at + 8 + length]))
        at += 8 + length
    if JSON not in dict(found):
        raise ValueError("a JSON chunk expected, found none")
    return found
