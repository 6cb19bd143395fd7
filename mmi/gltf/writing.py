"""Typed arrays into buffer views: one view for each kind of vertex data and of indices, all of them in one buffer.

Each array begins at a multiple of four bytes and has an accessor of its own, whose index is what a mesh refers to.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.srgb import linear_from_srgb
from mmi.gltf.codes import FLOAT, INDICES, UINT16, UINT32, VERTICES
from mmi.gltf.container import padding

__all__ = ["BufferViews"]

# Kind of data -> bytes from vertex to vertex (0: packed), target, component type, type.
_LAYOUT: Mapping[str, tuple[int, int, int, str]] = MappingProxyType(
    {
        "positions": (12, VERTICES, FLOAT, "VEC3"),
        "coordinates": (8, VERTICES, FLOAT, "VEC2"),
        "coordinates in [0, 1]": (4, VERTICES, UINT16, "VEC2"),
        "colors": (8, VERTICES, UINT16, "VEC4"),
        "indices of 16 bits": (0, INDICES, UINT16, "SCALAR"),
        "indices of 32 bits": (0, INDICES, UINT32, "SCALAR"),
    }
)


class BufferViews:
    """The arrays of a glTF while it grows. Methods that take an array return the index of its accessor."""

    def __init__(self) -> None:
        self._accessors: list[dict[str, Any]] = []
        self._views: dict[str, bytearray] = {}

    def positions(self, points: NDArray[np.floating[Any]], *, shortest: bool = False) -> int:
        """Points (n, 3), at least one, and their least and largest coordinates: as doubles, or if ``shortest`` with the fewest
        decimals that are the same numbers in single precision.
        """
        single = points.astype("<f4")
        low, high = (
            [float(str(value)) for value in end] if shortest else end.tolist()
            for end in (single.min(axis=0), single.max(axis=0))
        )
        return self._add("positions", single, {"min": low, "max": high})

    def coordinates(self, uv: NDArray[np.floating[Any]]) -> int:
        """Texture coordinates (n, 2), v down."""
        return self._add("coordinates", uv.astype("<f4"))

    def unit_coordinates(self, uv: NDArray[np.floating[Any]]) -> int:
        """Texture coordinates (n, 2) in [0, 1], v down, in steps of 1 / 65535: half as many bytes."""
        steps = np.rint(65535.0 * uv.astype(np.float64)).astype("<u2")
        return self._add("coordinates in [0, 1]", steps, {"normalized": True})

    def colors(self, srgb: NDArray[np.uint8]) -> int:
        """Colours (n, 3) in sRGB bytes, as glTF wants them: linear, with an alpha of 1. All bytes survive in 16 bits."""
        linear = np.ones((len(srgb), 4))
        linear[:, :3] = linear_from_srgb(srgb)
        return self._add("colors", np.rint(65535.0 * linear).astype("<u2"), {"normalized": True})

    def indices(self, index: NDArray[np.integer[Any]], vertices: int) -> int:
        """Indices (n,) of so many ``vertices``, in 16 bits where they fit."""
        if vertices <= 65535:  # the index 65535 itself would restart the primitive
            return self._add("indices of 16 bits", index.astype("<u2"))
        return self._add("indices of 32 bits", index.astype("<u4"))

    def entries(self, images: Iterable[bytes]) -> tuple[dict[str, Any], list[bytes | bytearray], int]:
        """What the document says of the arrays and of encoded ``images``: ``accessors``, ``bufferViews`` and ``buffers``.

        Then the blobs of the one buffer, each a multiple of four bytes; and the index of the first image's view.
        """
        places = {name: i for i, name in enumerate(self._views)}
        views: list[dict[str, Any]] = []
        blobs: list[bytes | bytearray] = []
        start = 0

        def add(data: bytes | bytearray, more: dict[str, int]) -> None:
            nonlocal start
            views.append({"buffer": 0, "byteOffset": start, "byteLength": len(data)} | more)
            padded = data + b"\0" * padding(len(data)) if padding(len(data)) else data
            blobs.append(padded)
            start += len(padded)

        for name, data in self._views.items():
            stride, target, _, _ = _LAYOUT[name]
            add(data, ({"byteStride": stride} if stride else {}) | {"target": target})
        for image in images:
            add(image, {})
        document = {
            "accessors": [one | {"bufferView": places[one["bufferView"]]} for one in self._accessors],
            "bufferViews": views,
            "buffers": [{"byteLength": start}] if start else [],
        }
        return document, blobs, len(places)

    def _add(self, view: str, array: NDArray[Any], more: dict[str, Any] | None = None) -> int:
        """Adds data to a view, which has its number only in the end."""
        _, _, component, kind = _LAYOUT[view]
        data = self._views.setdefault(view, bytearray())
        entry = {"bufferView": view, "byteOffset": len(data), "componentType": component}
        self._accessors.append(entry | {"count": len(array), "type": kind} | (more or {}))
        data += array.tobytes()
        data += b"\0" * padding(len(data))
        return len(self._accessors) - 1
