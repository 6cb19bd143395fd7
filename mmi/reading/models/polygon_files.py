"""PLY and OFF: files of one mesh, whose faces are polygons of any number of corners, also concave ones.

PLY is ASCII or binary, in either byte order, with elements and properties in any order; colours of points or faces are read.
OFF is ASCII, without its colours. Nothing else in the files is used.
Source: Greg Turk, The PLY Polygon File Format; http://www.geomview.org/docs/html/OFF.html.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mmi.city.model import PAINTED, PLAIN, TriangleMesh
from mmi.foundation.errors import CityError
from mmi.reading.models.raw_meshes import cut_polygons, number_of, placed_corners
from mmi.reading.raw_layers import ModelLayer, RawModel
from mmi.reading.report import Ledger

__all__ = ["read_polygon_file"]

# Names of types in a PLY header -> NumPy's letters.
_TYPES = (
    ("char", "i1"), ("int8", "i1"), ("uchar", "u1"), ("uint8", "u1"), ("short", "i2"), ("int16", "i2"), ("ushort", "u2"),
    ("uint16", "u2"), ("int", "i4"), ("int32", "i4"), ("uint", "u4"), ("uint32", "u4"), ("float", "f4"), ("float32", "f4"),
    ("double", "f8"), ("float64", "f8"),
)  # fmt: skip
_CORNERS = ("vertex_indices", "vertex_index")


@dataclass(frozen=True, slots=True)
class _Property:
    """A property of a PLY element: a number of type ``kind``, or as many as a number of type ``count`` before them says."""

    name: str
    kind: str
    count: str | None


@dataclass(frozen=True, slots=True)
class _Element:
    """A kind of element of a PLY file and how many follow."""

    name: str
    number: int
    properties: list[_Property]


@dataclass(frozen=True, slots=True, eq=False)
class _Polygons:
    """Points (n, 3), corners a face (k,), the corners of all faces in turn, and colours of points, of faces, or none."""

    points: NDArray[np.float64]
    sizes: NDArray[np.int64]
    corners: NDArray[np.int64]
    point_colors: NDArray[np.uint8] | None = None
    face_colors: NDArray[np.uint8] | None = None


_COMMENT = re.compile(rb"(?<!1\.)#")
"""``1.#IND`` is how some write what is no number."""
_Column = NDArray[np.float64] | tuple[NDArray[np.int64], NDArray[np.float64]]
"""The values of a property (n,), or of a list: how many each has (n,), and the values of all in turn."""


def read_polygon_file(path: Path, ledger: Ledger) -> ModelLayer:
    """The one mesh of a PLY or OFF file, in its own axes and units; its id is the file's name.

    Raises:
        CityError: damaged, or without faces.
    """
    data = path.read_bytes()
    kind, read = ("OFF", _off) if path.suffix.lower() == ".off" else ("PLY", _ply)
    try:
        with np.errstate(all="ignore"):
            found = read(data)
        if found.corners.size and not 0 <= found.corners.min() <= found.corners.max() < len(found.points):
            raise ValueError(f"corners of {len(found.points)} points, with numbers up to {found.corners.max()}")
        if (found.sizes < 0).any():
            raise ValueError("a face with fewer than no corners")
    except (ValueError, LookupError, OverflowError, MemoryError) as error:
        raise CityError(f"{path}: expected {kind}, complete and valid; found: {str(error)[:200]}") from error
    if not (found.sizes >= 3).any():
        raise CityError(f"{path}: expected {kind} with faces of three corners or more, found none")
    cut, face_of = cut_polygons(found.points, found.sizes, found.corners)
    points, keep = placed_corners(found.points, found.corners[cut], path.stem, ledger)
    if not keep.any():
        raise CityError(f"{path}: expected faces with corners that are numbers, found none")
    triangles = found.corners[cut][keep].astype(np.int32)
    colors: NDArray[np.uint8] | None = None
    if found.point_colors is not None:
        colors = np.rint(found.point_colors[triangles].astype(np.float64).mean(axis=1)).astype(np.uint8)
    elif found.face_colors is not None:
        colors = found.face_colors[face_of[keep]]
    textures = np.full(len(triangles), PAINTED if colors is None else PLAIN, dtype=np.int32)
    mesh = TriangleMesh(points, triangles, textures, colors)  # type: ignore[arg-type]
    return ModelLayer(str(path), (RawModel(path.stem, mesh),), None)


def _off(data: bytes) -> _Polygons:
    lines = [words for line in data.splitlines() if (words := _COMMENT.split(line)[0].split())]
    if not lines or not lines[0][0].upper().endswith(b"OFF"):
        raise ValueError("a first line that is not OFF")
    head = lines[0][1:]
    body = lines[1:]
    if not head:
        head, body = body[0], body[1:]
    count, faces = int(head[0]), int(head[1])
    if len(body) < count + faces:
        raise ValueError(f"{len(body)} lines for {count} points and {faces} faces")
    points = np.array([[number_of(word) for word in words[:3]] for words in body[:count]]).reshape(-1, 3)
    rings = [[int(word) for word in words[1 : int(words[0]) + 1]] for words in body[count : count + faces]]
    sizes = np.array([int(words[0]) for words in body[count : count + faces]], dtype=np.int64)
    if [len(ring) for ring in rings] != sizes.tolist():
        raise ValueError("a face with fewer corners than it says")
    return _Polygons(points, sizes, np.array([one for ring in rings for one in ring], dtype=np.int64))


def _ply(data: bytes) -> _Polygons:
    form, elements, body = _header(data)
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[form]
    take = _binary_reader(body, order) if order else _text_reader(body)
    found: dict[str, dict[str, _Column]] = {}
    kinds: dict[str, dict[str, str]] = {}
    for element in (one for one in elements if one.properties):
        found[element.name] = take(element)
        kinds[element.name] = {one.name: one.kind for one in element.properties}
        if {"vertex", "face"} <= set(found):
            break  # nothing that follows is used
    vertex, face = found["vertex"], found.get("face", {})
    corners = next((face[name] for name in _CORNERS if name in face), (np.zeros(0), np.zeros(0)))
    if not isinstance(corners, tuple):
        raise ValueError("corners that are no list")
    return _Polygons(
        np.column_stack([_numbers(vertex, name) for name in "xyz"]),
        corners[0].astype(np.int64),
        corners[1].astype(np.int64),
        _colors(vertex, kinds["vertex"]),
        _colors(face, kinds.get("face", {})),
    )


def _header(data: bytes) -> tuple[str, list[_Element], bytes]:
    """Format, elements, and what follows the header."""
    if not data.startswith(b"ply"):
        raise ValueError("a first line that is not ply")
    types = dict(_TYPES)
    form, elements, at = "", list[_Element](), 0
    while True:
        end = data.find(b"\n", at)
        if end < 0:
            raise ValueError("a header without an end")
        words = data[at:end].decode("ascii", errors="replace").split()
        at = end + 1
        if words[:1] == ["format"]:
            form = words[1]
        elif words[:1] == ["element"]:
            if int(words[2]) < 0:
                raise ValueError(f"element {words[1]} {words[2]} times")
            elements.append(_Element(words[1], int(words[2]), []))
        elif words[:2] == ["property", "list"]:
            elements[-1].properties.append(_Property(words[4], types[words[3]], types[words[2]]))
        elif words[:1] == ["property"]:
            elements[-1].properties.append(_Property(words[2], types[words[1]], None))
        elif words == ["end_header"]:
            return form, elements, data[at:]


def _numbers(columns: dict[str, _Column], name: str) -> NDArray[np.float64]:
    column = columns[name]
    if isinstance(column, tuple):
        raise ValueError(f"{name} that is a list")
    return column


def _colors(columns: dict[str, _Column], kinds: dict[str, str]) -> NDArray[np.uint8] | None:
    """sRGB (n, 3) of ``red``, ``green`` and ``blue``: whole numbers to 255, or shares of 1; None where they are not there."""
    names = ("red", "green", "blue")
    if not set(names) <= set(columns):
        return None
    values = np.column_stack([_numbers(columns, name) for name in names])
    if kinds["red"].startswith("f"):
        values = 255.0 * values
    return np.rint(np.clip(np.nan_to_num(values), 0.0, 255.0)).astype(np.uint8)


def _text_reader(body: bytes) -> Callable[[_Element], dict[str, _Column]]:
    """Takes one element after the other from text."""
    words = body.split()
    try:
        numbers = np.array(words, dtype=np.float64)
    except ValueError:
        numbers = np.array([number_of(word) for word in words])
    at = 0

    def take(element: _Element) -> dict[str, _Column]:
        nonlocal at
        width = len(element.properties)
        if all(one.count is None for one in element.properties):
            table = numbers[at : at + element.number * width].reshape(element.number, width)
            at += table.size
            return {one.name: table[:, i] for i, one in enumerate(element.properties)}
        parts: list[list[NDArray[np.float64]]] = [[] for _ in element.properties]
        for _ in range(element.number):
            for own, one in zip(parts, element.properties, strict=True):
                size = 1
                if one.count is not None:
                    size, at = int(numbers[at]), at + 1
                if not 0 <= size <= len(numbers) - at:
                    raise ValueError(f"the end of the file within {element.name}")
                own.append(numbers[at : at + size])
                at += size
        return {one.name: _joined(own, one) for own, one in zip(parts, element.properties, strict=True)}

    return take


def _binary_reader(body: bytes, order: str) -> Callable[[_Element], dict[str, _Column]]:
    """Takes one element after the other from bytes; quickly where all lists of an element are equally long."""
    at = 0

    def one_value(kind: str) -> int:
        nonlocal at
        value = np.frombuffer(body, dtype=order + kind, count=1, offset=at)[0]
        at += np.dtype(kind).itemsize
        return int(value)

    def take(element: _Element) -> dict[str, _Column]:
        nonlocal at
        start = at
        sizes: list[int] = []
        for one in element.properties if element.number else []:
            sizes.append(1 if one.count is None else one_value(one.count))
            at += sizes[-1] * np.dtype(one.kind).itemsize
        layout = [
            field
            for i, (one, size) in enumerate(zip(element.properties, sizes, strict=False))
            for field in (
                *([(f"n{i}", order + one.count)] if one.count else []),
                (f"v{i}", order + one.kind, (size,)),
            )
        ]
        whole = np.dtype(layout).itemsize * element.number
        if layout and whole <= len(body) - start and min(sizes) >= 0:
            table = np.frombuffer(body, dtype=np.dtype(layout), count=element.number, offset=start)
            if all((table[f"n{i}"] == sizes[i]).all() for i, one in enumerate(element.properties) if one.count):
                at = start + whole
                return {
                    one.name: (
                        table[f"v{i}"].astype(np.float64)[:, 0]
                        if one.count is None
                        else (
                            np.full(element.number, sizes[i], dtype=np.int64),
                            table[f"v{i}"].astype(np.float64).reshape(-1),
                        )
                    )
                    for i, one in enumerate(element.properties)
                }
        at = start
        parts: list[list[NDArray[np.float64]]] = [[] for _ in element.properties]
        for _ in range(element.number):
            for own, one in zip(parts, element.properties, strict=True):
                size = 1 if one.count is None else one_value(one.count)
                if size < 0:
                    raise ValueError(f"a list of {size} numbers in {element.name}")
                own.append(np.frombuffer(body, dtype=order + one.kind, count=size, offset=at).astype(np.float64))
                at += size * np.dtype(one.kind).itemsize
        return {one.name: _joined(own, one) for own, one in zip(parts, element.properties, strict=True)}

    return take


def _joined(parts: list[NDArray[np.float64]], one: _Property) -> _Column:
    values = np.concatenate(parts) if parts else np.zeros(0)
    return values if one.count is None else (np.array([len(part) for part in parts], dtype=np.int64), values)
