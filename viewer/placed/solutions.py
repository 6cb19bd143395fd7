"""What was found for a model: the grid, the images of its points, and for which model, display and budget that holds.

As bytes: a magic, the length of a JSON header, the header, arrays packed with zlib one after the other, and the SHA-256 of all
that. Reading trusts nothing: what does not fit is a DatasetError in one line.
"""

from __future__ import annotations

import hashlib
import json
import math
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import pairwise
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.appearance.city_mesh import CityMesh
from mmi.foundation.camera import Camera, View, level_view
from mmi.foundation.errors import DatasetError, ParameterError
from mmi.foundation.json_forms import canonical_json
from viewer.placing.placements import Placement, Placements
from viewer.placing.rules import Fov, PlacingRules
from viewer.placing.solution_grid import DEEPEST, SolutionGrid

__all__ = ["PlacedImage", "Solutions", "print_of", "solutions_from", "solutions_of", "solutions_to_bytes"]

_MAGIC = b"placed01"
_LENGTH = struct.Struct("<I")
_MOST_BYTES = 1 << 30
"""Of an array that is read."""
_HEADER_BYTES = 1 << 16
_ARRAYS: Mapping[str, tuple[str, int]] = MappingProxyType(
    {
        "domain": ("<f8", 2),
        "points": ("<f8", 2),
        "codes": ("<i8", 1),
        "depths": ("<i8", 1),
        "reaches": ("<f8", 1),
        "leaf_starts": ("<i8", 1),
        "leaf_points": ("<i4", 1),
        "border_starts": ("<i8", 1),
        "borders": ("<f8", 1),
        "serving": ("<i4", 1),
        "counts": ("<i8", 1),
        "image_starts": ("<i8", 1),
        "yaws": ("<f8", 1),
        "windows": ("<f8", 2),
        "nears": ("<f8", 1),
        "distances": ("<f8", 1),
        "cell_starts": ("<i8", 1),
        "cells": ("<i4", 1),
        "hidden": ("|u1", 2),
    }
)
"""Type and number of dimensions of each, in the order that they have in the file; without occluders there is no last one."""
_KEYS = ("arrays", "camera", "model", "pictures", "rules", "source")


class PlacedImage(NamedTuple):
    """An image by its ``point`` (3,), ``radius`` metres within which the point serves viewers, and what it replaces."""

    point: NDArray[np.float64]
    radius: float
    placement: Placement


@dataclass(frozen=True, slots=True, eq=False)
class Solutions:
    """What was found for the model called ``source`` whose triangles and looks have the fingerprint ``model``.

    No view of ``camera`` within the grid's domain draws more of them than the budget of ``rules``. ``points`` has the images of
    each point of the grid, which are made of ``pictures`` pictures. ``occluders`` is the fingerprint of what hides cells from
    viewers, empty where nothing is taken to hide any.
    """

    source: str
    model: str
    camera: Camera
    pictures: int
    rules: PlacingRules
    grid: SolutionGrid
    points: tuple[Placements, ...]
    images: tuple[PlacedImage, ...]
    """All images, those of a point after each other."""
    firsts: NDArray[np.int64]
    """(n + 1,) the number of each point's first image, and how many there are."""
    occluders: str = ""

    def serving(self, point: int, yaw: float) -> int:
        """The number of the image for a point and a yaw, -1 where none is needed."""
        found = self.points[point].at(yaw)
        return found if found < 0 else int(self.firsts[point]) + found

    def view(self, number: int) -> View:
        """What an image's own picture shows."""
        image, focal = self.images[number], self.camera.focal
        left, bottom, right, top = image.placement.window
        low = math.floor(left * focal) - 1, math.floor(-top * focal) - 1
        high = math.ceil(right * focal) + 1, math.ceil(-bottom * focal) + 1
        window = (*low, high[0] - low[0], high[1] - low[1])
        return level_view(image.point, image.placement.yaw, focal=focal, window=window)


def solutions_of(
    *,
    source: str,
    model: str,
    camera: Camera,
    pictures: int,
    rules: PlacingRules,
    grid: SolutionGrid,
    points: Sequence[Placements],
    occluders: str = "",
) -> Solutions:
    """All of it together."""
    radii = grid.radii
    images = tuple(
        PlacedImage(grid.points[n], float(radii[n]), one) for n, some in enumerate(points) for one in some.images
    )
    firsts = np.concatenate([[0], np.cumsum([len(some.images) for some in points])]).astype(np.int64)
    return Solutions(source, model, camera, pictures, rules, grid, tuple(points), images, firsts, occluders)


def print_of(mesh: CityMesh) -> str:
    """The fingerprint of a model's triangles and of what they look like."""
    digest = hashlib.sha256()
    for array in (mesh.positions, mesh.triangles, mesh.uv, mesh.colors, mesh.object_triangles, mesh.texture):
        digest.update(str(array.shape).encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def solutions_to_bytes(solutions: Solutions) -> bytes:
    """As they are kept: the same bytes for the same solutions."""
    arrays = _arrays_of(solutions)
    packed = {name: zlib.compress(arrays[name].tobytes(), 6) for name in arrays}
    rules = asdict(solutions.rules)
    hiding = {"occluders": solutions.occluders} if solutions.occluders else {}
    header = canonical_json(
        {
            "source": solutions.source,
            "model": solutions.model,
            "camera": [solutions.camera.width, solutions.camera.height, solutions.camera.fov],
            "pictures": solutions.pictures,
            "rules": rules,
            "arrays": [[name, list(arrays[name].shape), len(packed[name])] for name in arrays],
            **hiding,
        }
    )
    whole = b"".join([_MAGIC, _LENGTH.pack(len(header)), header, *packed.values()])
    return whole + hashlib.sha256(whole).digest()


def solutions_from(data: bytes, where: str) -> Solutions:
    """The solutions whose bytes these are, of a file called ``where``.

    Raises DatasetError for what :func:`solutions_to_bytes` does not make.
    """
    start = len(_MAGIC) + _LENGTH.size
    if len(data) < start + 32 or not data.startswith(_MAGIC):
        raise DatasetError(f"{where}: solutions of place-images expected, found {len(data)} bytes of something else")
    if hashlib.sha256(data[:-32]).digest() != data[-32:]:
        raise DatasetError(f"{where}: damaged: its checksum is another; run place-images again")
    length = _LENGTH.unpack_from(data, len(_MAGIC))[0]
    if length > min(len(data) - start - 32, _HEADER_BYTES):
        raise DatasetError(f"{where}: a header of up to {_HEADER_BYTES} bytes expected, found {length}")
    try:
        header = json.loads(data[start : start + length])
        if not isinstance(header, dict) or sorted({*header} - {"occluders"}) != sorted(_KEYS):
            raise ValueError(f"the keys {', '.join(_KEYS)} expected")
        hiding = header.get("occluders", "none")
        if not isinstance(hiding, str) or not hiding:
            raise ValueError("occluders: text expected")
        names = list(_ARRAYS) if "occluders" in header else list(_ARRAYS)[:-1]
        arrays = _unpacked(names, header["arrays"], data[start + length : -32])
        return _assembled(header, arrays)
    except (ValueError, TypeError, KeyError, IndexError, OverflowError, RecursionError, zlib.error) as error:
        raise DatasetError(f"{where}: solutions of place-images expected, found others ({error})") from error
    except ParameterError as error:
        raise DatasetError(f"{where}: {error}") from error


def _arrays_of(solutions: Solutions) -> dict[str, NDArray[Any]]:
    grid, points = solutions.grid, solutions.points
    placed = [one.placement for one in solutions.images]
    found: dict[str, Any] = {
        "domain": grid.domain,
        "points": grid.points,
        "codes": grid.codes,
        "depths": grid.depths,
        "reaches": grid.reaches,
        "leaf_starts": grid.leaf_starts,
        "leaf_points": grid.leaf_points,
        "border_starts": _starts([len(one.borders) for one in points]),
        "borders": _joined([one.borders for one in points]),
        "serving": _joined([one.serving for one in points]),
        "counts": _joined([one.counts for one in points]),
        "image_starts": solutions.firsts,
        "yaws": [one.yaw for one in placed],
        "windows": np.array([one.window for one in placed]).reshape(-1, 4),
        "nears": [one.near for one in placed],
        "distances": [one.distance for one in placed],
        "cell_starts": _starts([len(one.cells) for one in placed]),
        "cells": _joined([one.cells for one in placed]),
    }
    if solutions.occluders:
        found["hidden"] = np.stack([one.hidden for one in points])
    return {name: np.ascontiguousarray(found[name], dtype=_ARRAYS[name][0]) for name in found}


def _starts(counts: Sequence[int]) -> NDArray[np.int64]:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def _joined(arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    return np.concatenate([np.zeros(0), *arrays])


def _unpacked(names: Sequence[str], listed: object, data: bytes) -> dict[str, NDArray[Any]]:
    """The arrays of these ``names``, of the sizes that the header says. Raises ValueError."""
    if not isinstance(listed, list) or [one[0] for one in listed] != names:
        raise ValueError(f"the arrays {', '.join(names)} expected")
    found, at = {}, 0
    for name, shape, length in listed:
        dtype, dimensions = _ARRAYS[name]
        if len(shape) != dimensions or not all(type(n) is int and 0 <= n <= _MOST_BYTES for n in (*shape, length)):
            raise ValueError(f"{name}: {dimensions} dimensions expected, found {shape}")
        size = math.prod(shape) * np.dtype(dtype).itemsize
        if size > _MOST_BYTES or length > len(data) - at:
            raise ValueError(f"{name}: at most {_MOST_BYTES} bytes expected, found {size}")
        unpacker = zlib.decompressobj()
        values = unpacker.decompress(data[at : at + length], size + 1)
        if len(values) != size:
            raise ValueError(f"{name}: {size} bytes expected, found others")
        found[name], at = np.frombuffer(values, dtype=dtype).reshape(shape), at + length
    return found


def _assembled(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Solutions:
    """Solutions whose parts fit together. Raises ValueError where they do not, ParameterError for rules without meaning."""
    width, height, fov = header["camera"]
    if not (type(width) is int and type(height) is int and isinstance(fov, int | float)):
        raise ValueError("camera: whole numbers of pixels, and an angle, expected")
    told = dict(header["rules"])
    told["fov"] = Fov(**told["fov"])
    if set(told) != {one.name for one in fields(PlacingRules)}:
        raise ValueError("other rules expected")
    for name in ("source", "model"):
        if not isinstance(header[name], str):
            raise ValueError(f"{name}: text expected")
    if type(header["pictures"]) is not int:
        raise ValueError("pictures: a whole number expected")
    n, leaves, images = len(arrays["points"]), len(arrays["codes"]), len(arrays["yaws"])
    for name, values in arrays.items():
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            raise ValueError(f"{name}: finite numbers expected")
    for name, shape in {
        "domain": (2, 3),
        "points": (n, 3),
        "depths": (leaves,),
        "reaches": (leaves,),
        "windows": (images, 4),
        "nears": (images,),
        "distances": (images,),
        "serving": arrays["borders"].shape,
        "counts": arrays["borders"].shape,
    }.items():
        if arrays[name].shape != shape:
            raise ValueError(f"{name}: an array of {shape} expected, found {arrays[name].shape}")
    for name, groups, total in (
        ("leaf_starts", leaves, len(arrays["leaf_points"])),
        ("border_starts", n, len(arrays["borders"])),
        ("image_starts", n, images),
        ("cell_starts", images, len(arrays["cells"])),
    ):
        starts = arrays[name]
        if starts.shape != (groups + 1,) or starts[0] != 0 or starts[-1] != total or (np.diff(starts) < 0).any():
            raise ValueError(f"{name}: {groups} ranges of {total} expected")
    _check(arrays, n)
    hidden = arrays.get("hidden", np.zeros((n, 0), dtype=np.uint8))
    if len(hidden) != n:
        raise ValueError(f"hidden: bits for {n} points expected, found for {len(hidden)}")
    grid = SolutionGrid(
        PlacingRules(**told).pyramid,
        *(arrays[name] for name in ("domain", "points", "codes", "depths", "reaches", "leaf_starts", "leaf_points")),
    )
    placed = [
        Placement(yaw, arrays["cells"][first:end], tuple(window), near, distance)
        for yaw, window, near, distance, (first, end) in zip(
            arrays["yaws"].tolist(),
            arrays["windows"].tolist(),
            arrays["nears"].tolist(),
            arrays["distances"].tolist(),
            pairwise(arrays["cell_starts"].tolist()),
            strict=True,
        )
    ]
    points = [
        Placements(
            tuple(placed[first:end]),
            arrays["borders"][low:high],
            arrays["serving"][low:high],
            arrays["counts"][low:high],
            bits,
        )
        for (first, end), (low, high), bits in zip(
            pairwise(arrays["image_starts"].tolist()), pairwise(arrays["border_starts"].tolist()), hidden, strict=True
        )
    ]
    return solutions_of(
        source=header["source"],
        model=header["model"],
        camera=Camera(width, height, fov),
        pictures=header["pictures"],
        rules=PlacingRules(**told),
        grid=grid,
        points=points,
        occluders=header.get("occluders", ""),
    )


def _check(arrays: Mapping[str, NDArray[Any]], n: int) -> None:
    """Raise ValueError where numbers lead nowhere, or what should ascend does not."""
    if not (np.diff(arrays["codes"]) > 0).all() or not ((arrays["depths"] >= 0) & (arrays["depths"] <= DEEPEST)).all():
        raise ValueError("codes: ascending ones of leaves expected")
    some = arrays["leaf_points"]
    if len(some) and not (some.min() >= 0 and some.max() < n):
        raise ValueError(f"leaf_points: numbers of {n} points expected")
    for (low, high), (first, end) in zip(
        pairwise(arrays["border_starts"].tolist()), pairwise(arrays["image_starts"].tolist()), strict=True
    ):
        borders, serving = arrays["borders"][low:high], arrays["serving"][low:high]
        if not len(borders) or borders[0] != 0.0 or not (np.diff(borders) > 0.0).all():
            raise ValueError("borders: ascending ones from 0 on expected")
        if not (serving.min() >= -1 and serving.max() < end - first):
            raise ValueError(f"serving: numbers of {end - first} images expected")
    windows = arrays["windows"]
    if not ((windows[:, :2] < windows[:, 2:]).all() and (np.abs(windows) <= 100.0).all()):
        raise ValueError("windows: left, bottom, right and top expected")
    if not ((arrays["nears"] > 0.0).all() and (arrays["distances"] > 0.0).all()):
        raise ValueError("nears: distances above 0 expected")
    cells, starts = arrays["cells"], arrays["cell_starts"]
    rises = np.diff(cells) > 0
    rises[starts[1:-1][(starts[1:-1] > 0) & (starts[1:-1] < len(cells))] - 1] = True
    if len(cells) and not (rises.all() and cells.min() >= 0):
        raise ValueError("cells: ascending numbers expected")
