"""A glTF file as users have it, with all of its buffers in memory: those inside the file, beside it, or in its own text."""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from mmi import limits
from mmi.foundation.errors import CityError
from mmi.foundation.whole_files import bytes_within
from mmi.gltf.codes import DTYPES, WIDTHS
from mmi.gltf.container import BIN, JSON, glb_chunks, glb_version, is_glb
from mmi.gltf.reading import buffer_view, elements, whole_number
from mmi.reading.pictures import contained_path, file_beside, picture_bytes
from mmi.reading.report import Ledger

__all__ = ["GltfFile", "open_gltf"]


@dataclass(frozen=True, slots=True, eq=False)
class GltfFile:
    """A document and its buffers, in memory; ``path`` and ``ledger`` for files beside it and what is wrong with them."""

    path: Path
    document: dict[str, Any]
    buffers: tuple[bytes, ...]
    ledger: Ledger

    def accessor(self, index: object, *, integer: bool = False) -> NDArray[Any]:
        """(count, width): int64 if ``integer``, else float64, normalised where the accessor says so."""
        entry = self.document["accessors"][whole_number(index)]
        component, kind = entry["componentType"], entry["type"]
        dtype, width = DTYPES[component], WIDTHS[kind]
        count = whole_number(entry["count"])
        most = (limits.ACCESSOR_ELEMENTS if "bufferView" in entry else limits.EMPTY_ACCESSOR_ELEMENTS) // width
        if count > most:
            raise ValueError(f"an accessor of {count} elements; at most {most} expected")
        values = (
            self._elements(entry, count, component, kind) if "bufferView" in entry else np.zeros((count, width), dtype)
        )
        if "sparse" in entry:
            sparse = entry["sparse"]
            n = whole_number(sparse["count"])
            places = self._elements(sparse["indices"], n, sparse["indices"]["componentType"], "SCALAR")[:, 0]
            values[places] = self._elements(sparse["values"], n, component, kind)
        if integer:
            return values.astype(np.int64)
        result = values.astype(np.float64)
        if entry.get("normalized") and dtype.kind in "iu":
            result = np.maximum(result / np.iinfo(dtype).max, -1.0)
        return result

    def _elements(self, place: dict[str, Any], count: int, component: int, kind: str) -> NDArray[Any]:
        """What lies where ``place`` says (its ``bufferView`` and ``byteOffset``)."""
        view = buffer_view(self.document, self.buffers, place["bufferView"])
        offset = whole_number(place.get("byteOffset", 0))
        return elements(view, offset=offset, count=count, component=component, kind=kind)

    def image(self, index: int) -> bytes | None:
        """The encoded picture; None, and a note, where its file is missing."""
        entry = self.document["images"][whole_number(index)]
        if "bufferView" in entry:
            return bytes(buffer_view(self.document, self.buffers, entry["bufferView"]).data)
        uri = str(entry["uri"])
        if uri.startswith("data:"):
            return _data_uri(uri)
        file = file_beside(self.path.parent, uri, self.ledger)
        if file is None:
            self.ledger.note("left out", "picture: its file is missing", uri)
            return None
        return picture_bytes(file, uri, self.ledger)


def open_gltf(path: Path, ledger: Ledger) -> GltfFile:
    """The document of a .glb or .gltf with all of its buffers.

    Raises:
        CityError: not glTF 2.0, shorter than it says, or with buffers that are missing or outside its folder.
    """
    data = path.read_bytes()
    body = b""
    if is_glb(data):
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
            found = bytes_within(file, limits.CITY_BYTES, CityError)
        if len(found) < whole_number(entry["byteLength"]):
            raise CityError(f"{path}: buffer {i}: {entry['byteLength']} bytes expected, found {len(found)}")
        buffers.append(found)
    return GltfFile(path, document, tuple(buffers), ledger)


def _chunks(path: Path, data: bytes) -> tuple[bytes, bytes]:
    """The JSON and the binary chunk of a GLB container."""
    try:
        version = glb_version(data)
        if version != 2:
            raise CityError(f"{path}: expected glTF version 2, found {version}; convert it, for instance with Blender")
        chunks = dict(reversed(glb_chunks(data)))  # the first of a kind counts
    except ValueError as error:
        raise CityError(f"{path}: {error}") from error
    return chunks[JSON], chunks.get(BIN, b"")


def _data_uri(uri: str) -> bytes:
    head, _, text = uri.partition(",")
    return base64.b64decode(text, validate=True) if head.endswith(";base64") else unquote(text).encode("latin-1")


def _beside(path: Path, uri: str) -> Path:
    if "://" in uri:
        raise CityError(f"{path}: refers to {uri[:80]!r}; expected files in its own folder or below")
    return contained_path(path.parent, unquote(uri), path)
