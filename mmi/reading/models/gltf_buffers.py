"""The container and the bytes of a glTF file: chunks, buffers, accessors and encoded images, with every size checked."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.errors import CityError
from mmi.reading.models.pictures import contained_path
from mmi.reading.report import Ledger

__all__ = ["GltfFile", "open_gltf"]

_MAGIC, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942
_DTYPES: Mapping[int, np.dtype[Any]] = MappingProxyType(
    {
        code: np.dtype(name)
        for code, name in ((5120, "i1"), (5121, "u1"), (5122, "<i2"), (5123, "<u2"), (5125, "<u4"), (5126, "<f4"))
    }
)
_WIDTHS = MappingProxyType({"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4})
_MOST_ELEMENTS = 1 << 28


@dataclass(frozen=True, slots=True, eq=False)
class GltfFile:
    """A document and its buffers, in memory; ``path`` and ``ledger`` for files beside it and what is wrong with them."""

    path: Path
    document: dict[str, Any]
    buffers: tuple[bytes, ...]
    ledger: Ledger

    def view(self, index: object) -> tuple[memoryview, int]:
        """The bytes of a buffer view and its stride (0: packed)."""
        entry = self.document["bufferViews"][_index(index)]
        start, size = _index(entry.get("byteOffset", 0)), _index(entry["byteLength"])
        buffer = self.buffers[_index(entry["buffer"])]
        if start + size > len(buffer):
            raise ValueError(f"bytes {start} to {start + size} are wanted, its buffer has {len(buffer)}")
        return memoryview(buffer)[start : start + size], _index(entry.get("byteStride", 0))

    def accessor(self, index: object, *, integer: bool = False) -> NDArray[Any]:
        """(count, width): int64 if ``integer``, else float64, normalised where the accessor says so."""
        entry = self.document["accessors"][_index(index)]
        dtype, width = _DTYPES[entry["componentType"]], _WIDTHS[entry["type"]]
        count = _index(entry["count"])
        if count * width > _MOST_ELEMENTS:
            raise ValueError(f"an accessor of {count} elements; at most {_MOST_ELEMENTS // width} expected")
        if "bufferView" in entry:
            values = self._elements(entry["bufferView"], _index(entry.get("byteOffset", 0)), count, width, dtype)
        else:
            values = np.zeros((count, width), dtype)
        if "sparse" in entry:
            sparse = entry["sparse"]
            n = _index(sparse["count"])
            at, by = sparse["indices"], sparse["values"]
            kind = _DTYPES[at["componentType"]]
            places = self._elements(at["bufferView"], _index(at.get("byteOffset", 0)), n, 1, kind)[:, 0]
            values = values.copy()
            values[places] = self._elements(by["bufferView"], _index(by.get("byteOffset", 0)), n, width, dtype)
        if integer:
            return values.astype(np.int64)
        result = values.astype(np.float64)
        if entry.get("normalized") and dtype.kind in "iu":
            result = np.maximum(result / np.iinfo(dtype).max, -1.0)
        return result

    def _elements(self, view: object, offset: int, count: int, width: int, dtype: np.dtype[Any]) -> NDArray[Any]:
        data, stride = self.view(view)
        size = width * dtype.itemsize
        stride = stride or size
        if stride < size or (count and offset + (count - 1) * stride + size > len(data)):
            raise ValueError(
                f"{count} elements of {size} bytes from byte {offset} are wanted, the view has {len(data)}"
            )
        if count == 0:
            return np.empty((0, width), dtype)
        flat = np.ndarray((count, width), dtype, buffer=data, offset=offset, strides=(stride, dtype.itemsize))
        return flat.copy()

    def image(self, index: int) -> bytes | None:
        """The encoded picture; None, and a note, where its file is missing."""
        entry = self.document["images"][_index(index)]
        if "bufferView" in entry:
            return bytes(self.view(entry["bufferView"])[0])
        uri = str(entry["uri"])
        if uri.startswith("data:"):
            return _data_uri(uri)
        file = _beside(self.path, uri)
        if not file.is_file():
            self.ledger.note("left out", "picture: its file is missing", uri)
            return None
        return file.read_bytes()


def open_gltf(path: Path, ledger: Ledger) -> GltfFile:
    """The document of a .glb or .gltf with all of its buffers.

    Raises:
        CityError: not glTF 2.0, shorter than it says, or with buffers that are missing or outside its folder.
    """
    data = path.read_bytes()
    body = b""
    if data[:4] == b"glTF":
        data, body = _chunks(path, data)
    try:
        document = json.loads(data.decode("utf-8-sig"))
    except ValueError as error:
        raise CityError(f"{path}: expected glTF 2.0 (JSON), complete to its end; found: {error}") from error
    if not isinstance(document, dict) or not isinstance(document.get("asset"), dict):
        raise CityError(f"{path}: expected glTF 2.0 with an asset, found JSON without one")
    version = str(document["asset"].get("version", "none"))
    if not version.startswith("2."):
        raise CityError(
            f"{path}: expected glTF version 2, found {version}; convert it, for instance with Blender or `npx gltf-pipeline`"
        )
    buffers = []
    for i, entry in enumerate(document.get("buffers", [])):
        if "uri" not in entry:
            found = body
        elif str(entry["uri"]).startswith("data:"):
            found = _data_uri(str(entry["uri"]))
        else:
            file = _beside(path, str(entry["uri"]))
            if not file.is_file():
                raise CityError(f"{path}: its buffer {entry['uri']!r} is missing; expected that file beside it")
            found = file.read_bytes()
        if len(found) < _index(entry["byteLength"]):
            raise CityError(f"{path}: buffer {i}: {entry['byteLength']} bytes expected, found {len(found)}")
        buffers.append(found)
    return GltfFile(path, document, tuple(buffers), ledger)


def _chunks(path: Path, data: bytes) -> tuple[bytes, bytes]:
    """The JSON and the binary chunk of a GLB container."""
    if len(data) < 20:
        raise CityError(f"{path}: expected binary glTF with a header of 20 bytes, found {len(data)} bytes")
    _, version, size = struct.unpack_from("<III", data)
    if version != 2:
        raise CityError(f"{path}: expected glTF version 2, found {version}; convert it, for instance with Blender")
    if size > len(data):
        raise CityError(f"{path}: expected binary glTF of {size} bytes, found {len(data)}: the file is cut off")
    found: dict[int, bytes] = {}
    at = 12
    while at + 8 <= size:
        length, kind = struct.unpack_from("<II", data, at)
        if at + 8 + length > size:
            raise CityError(f"{path}: a chunk of {length} bytes at byte {at} does not fit the file's {size}")
        found.setdefault(kind, data[at + 8 : at + 8 + length])
        at += 8 + length
    if _JSON not in found:
        raise CityError(f"{path}: expected a JSON chunk, found none")
    return found[_JSON], found.get(_BIN, b"")


def _index(value: object) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise ValueError(f"a number >= 0 expected, found {value!r}")
    return value


def _data_uri(uri: str) -> bytes:
    head, _, text = uri.partition(",")
    return base64.b64decode(text, validate=True) if head.endswith(";base64") else unquote(text).encode("latin-1")


def _beside(path: Path, uri: str) -> Path:
    if "://" in uri:
        raise CityError(f"{path}: refers to {uri[:80]!r}; expected files in its own folder or below")
    return contained_path(path.parent, unquote(uri), path)
