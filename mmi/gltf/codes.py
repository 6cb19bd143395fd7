"""The numbers and names of glTF 2.0 that readers and writers use, by what they mean.

Source: Khronos, glTF 2.0 specification (sections 3.6 and 5); the extensions KHR_materials_unlit and EXT_texture_webp.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

__all__ = [
    "CLAMP",
    "DTYPES",
    "FLOAT",
    "GENERATOR",
    "INDICES",
    "LINEAR",
    "LINES",
    "LINE_LOOP",
    "LINE_STRIP",
    "REPEAT",
    "TRIANGLES",
    "TRIANGLE_FAN",
    "TRIANGLE_STRIP",
    "TRILINEAR",
    "UINT16",
    "UINT32",
    "UNLIT",
    "VERTICES",
    "WEBP",
    "WIDTHS",
]

GENERATOR = "multi-mesh-impostors"
"""What ``asset.generator`` says of files that this project writes."""

UINT16, UINT32, FLOAT = 5123, 5125, 5126
DTYPES: Mapping[int, np.dtype[Any]] = MappingProxyType(
    {
        5120: np.dtype("i1"),
        5121: np.dtype("u1"),
        5122: np.dtype("<i2"),
        UINT16: np.dtype("<u2"),
        UINT32: np.dtype("<u4"),
        FLOAT: np.dtype("<f4"),
    }
)
"""Component type -> the type of a number, little-endian."""
WIDTHS: Mapping[str, int] = MappingProxyType({"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4})
"""Type of an accessor -> numbers an element."""

VERTICES, INDICES = 34962, 34963
"""What a buffer view is for: its ``target``."""
LINES, LINE_LOOP, LINE_STRIP, TRIANGLES, TRIANGLE_STRIP, TRIANGLE_FAN = 1, 2, 3, 4, 5, 6
"""What a primitive is made of: its ``mode``."""
REPEAT, CLAMP = 10497, 33071
"""What a sampler does beyond the edges of a picture: ``wrapS`` and ``wrapT``."""
LINEAR, TRILINEAR = 9729, 9987
"""How a sampler filters: ``magFilter`` and ``minFilter`` (linear within and between mipmaps)."""

UNLIT, WEBP = "KHR_materials_unlit", "EXT_texture_webp"
