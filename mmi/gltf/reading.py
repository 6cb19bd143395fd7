"""Typed arrays out of the buffers of a glTF file: no size, offset or index in the file is believed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.gltf.codes import DTYPES, WIDTHS

__all__ = ["BufferView", "buffer_view", "elements", "whole_number"]


class BufferView(NamedTuple):
    """The bytes of a buffer view and the bytes from one element to the next, 0 where elements follow one another."""

    data: memoryview
    stride: int


def whole_number(value: object) -> int:
    """``value`` as an index or size. JSON has other numbers as well, and Python would count negative ones from the end.

    Raises ValueError.
    """
    if type(value) is not int or value < 0:
        raise ValueError(f"a whole number >= 0 expected, found {value!r}")
    return value


def buffer_view(document: Mapping[str, Any], buffers: Sequence[bytes], index: object) -> BufferView:
    """The bytes that the buffer view of this index stands for.

    Raises ValueError or LookupError where the document has none, or its buffer is shorter.
    """
    entry = document["bufferViews"][whole_number(index)]
    start, size = whole_number(entry.get("byteOffset", 0)), whole_number(entry["byteLength"])
    buffer = buffers[whole_number(entry["buffer"])]
    if start + size > len(buffer):
        raise ValueError(f"bytes {start} to {start + size} wanted, the buffer has {len(buffer)}")
    return BufferView(memoryview(buffer)[start : start + size], whole_number(entry.get("byteStride", 0)))


def elements(view: BufferView, *, offset: int, count: int, component: int, kind: str) -> NDArray[Any]:
    """(count, width) a copy of the elements of type ``kind`` (``VEC3``), of numbers of this component type.

    Raises ValueError where the view does not hold as many, KeyError for a type that glTF does not have.
    """
    dtype, width = DTYPES[component], WIDTHS[kind]
    size = width * dtype.itemsize
    stride = view.stride or size
    if stride < size or (count and offset + (count - 1) * stride + size > len(view.data)):
        raise ValueError(
            f"{count} times {kind} from byte {offset} wanted, the view has {len(view.data)} bytes "
            f"({stride} from one to the next, {size} each)"
        )
    if count == 0:
        return np.empty((0, width), dtype)
    strides = (stride, dtype.itemsize)
    return np.ndarray((count, width), dtype, buffer=view.data, offset=offset, strides=strides).copy()
