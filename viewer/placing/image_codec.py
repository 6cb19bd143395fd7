"""Layered images as bytes: how they lie on the disk.

    header      magic, window, samples, objects, focal length, least and largest 1 / depth, eye_from_world without its last row
    sections    the length of each, then zlib: counts of the pixels' samples, numbers of the objects, and per sample its object,
                1 / depth, two slopes and color, as what each is off from a prediction

A sample is predicted from one of its object in the pixel to the left and from one in the pixel above: 1 / depth along their
planes, slopes and colors as they are, the mean of both. Colors and objects are kept exactly. 1 / depth is kept in 65,535 steps
between the least and the largest, and is off by half a step at most; a point moves by that times the focal length times the
viewer's distance from the image's eye, less than 1/100 of a pixel where no sample is closer than the viewer may be. Slopes are
whole numbers of half steps below 64, and have six binary digits beyond. All arithmetic is in whole numbers: the same anywhere.

Reading trusts nothing: what does not fit is a DatasetError in one line.
"""

from __future__ import annotations

import math
import struct
import zlib
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View
from mmi.foundation.errors import DatasetError
from mmi.foundation.kernels import kernel
from viewer.placing.layered_image import LayeredImage

__all__ = ["decoded", "encoded"]

_MAGIC = b"layered1"
_HEADER = struct.Struct("<8s4i2I15d")
_LENGTH = struct.Struct("<I")
_STEPS = 65535
_LEAST_STEP = 2.0**-24
"""Steps are not below this share of the largest 1 / depth, so that slopes are not above ``_STEEPEST`` half steps."""
_STEEPEST = 1 << 26
_EXACT, _HALF = 64, 32
"""Slopes below the first, in half steps, are kept as they are; twice as steep a slope has a code larger by the second."""
_LARGEST_CODE = _EXACT + 21 * _HALF
_MOST_PIXELS, _MOST_LAYERS = 1 << 26, 255
_TURNED = 1e-6
"""By how much a rotation's rows may be off from perpendicular and of length 1."""


class _Coded(NamedTuple):
    """What samples are, or by how much they are off: places among the objects, steps of 1 / depth, codes of slopes, colors."""

    places: NDArray[np.int32]
    steps: NDArray[np.int32]
    slopes: NDArray[np.int32]
    colors: NDArray[np.uint8]


def encoded(image: LayeredImage) -> bytes:
    """An image's bytes, the same for the same image. Raises ValueError where a pixel has more than 255 samples."""
    counts = image.counts
    if counts.max() > _MOST_LAYERS:
        raise ValueError(f"at most {_MOST_LAYERS} samples a pixel expected, found {counts.max()}")
    near = 1.0 / image.depths.astype(np.float64)
    low, high = (float(near.min()), float(near.max())) if len(near) else (1.0, 1.0)
    step = _step(low, high)
    objects, places = np.unique(image.ids, return_inverse=True)
    whole = _Coded(
        places.reshape(-1).astype(np.int32),
        np.round((near - low) / step).astype(np.int32),
        _codes(np.round(2.0 * image.slopes.astype(np.float64) / step)),
        np.array(image.colors),
    )
    off = _room(len(near))
    _predict(image.starts, counts.shape[1], whole, off, False)
    numbers = (*image.view.window, len(near), len(objects), image.view.focal, low, high)
    parts = (
        counts.astype(np.uint8),
        objects.astype("<i4"),
        _shuffled(off.places),
        _shuffled(off.steps),
        _shuffled(off.slopes[:, 0]),
        _shuffled(off.slopes[:, 1]),
        np.ascontiguousarray(off.colors.T),
    )
    packed = [zlib.compress(part.tobytes(), 9) for part in parts]
    head = _HEADER.pack(_MAGIC, *numbers, *image.view.eye_from_world[:3].ravel())
    return head + b"".join(_LENGTH.pack(len(one)) + one for one in packed)


def decoded(data: bytes, where: str) -> LayeredImage:
    """The image whose bytes these are, of a file called ``where``.

    Raises DatasetError for what :func:`encoded` does not make.
    """
    if len(data) < _HEADER.size or not data.startswith(_MAGIC):
        raise DatasetError(f"{where}: a layered image expected, found {len(data)} bytes of something else")
    _, left, top, width, height, samples, objects, focal, low, high, *rows = _HEADER.unpack_from(data)
    if not (width > 0 and height > 0 and width * height <= _MOST_PIXELS):
        raise DatasetError(f"{where}: a picture of 1 to {_MOST_PIXELS} pixels expected, found {width} x {height}")
    if not (samples <= _MOST_LAYERS * width * height and objects <= samples):
        raise DatasetError(
            f"{where}: at most {_MOST_LAYERS} samples a pixel, and as many objects, expected, found {samples} and {objects}"
        )
    if not (math.isfinite(focal) and focal > 0.0 and 0.0 < low <= high < math.inf):
        raise DatasetError(
            f"{where}: a focal length and depths above 0 expected, found {focal:g}, {low:g} and {high:g}"
        )
    matrix = np.array([*rows, 0.0, 0.0, 0.0, 1.0]).reshape(4, 4)
    if not (np.isfinite(matrix).all() and abs(matrix[:3, :3] @ matrix[:3, :3].T - np.eye(3)).max() <= _TURNED):
        raise DatasetError(f"{where}: a rotation and a place expected as the image's view, found {matrix[:3].tolist()}")
    sections = _Sections(data, where)
    starts = np.zeros(width * height + 1, dtype=np.int64)
    np.cumsum(sections.next("counts", width * height), dtype=np.int64, out=starts[1:])
    if starts[-1] != samples:
        raise DatasetError(f"{where}: {samples} samples expected, as the header says, found {starts[-1]}")
    known = sections.next("objects", 4 * objects).view("<i4").astype(np.int32)
    off = _Coded(
        _unshuffled(sections.next("places", 4 * samples)),
        _unshuffled(sections.next("depths", 4 * samples)),
        np.stack([_unshuffled(sections.next("slopes", 4 * samples)) for _ in range(2)], axis=1),
        np.array(sections.next("colors", 3 * samples).reshape(3, samples).T, order="C"),
    )
    sections.end()
    starts, whole = starts.astype(np.int32), _room(samples)
    _predict(starts, width, whole, off, True)
    for name, values, least, most in (
        ("places", whole.places, 0, objects - 1),
        ("depths", whole.steps, 0, _STEPS),
        ("slopes", whole.slopes, -_LARGEST_CODE, _LARGEST_CODE),
    ):
        if samples and not (values.min() >= least and values.max() <= most):
            raise DatasetError(f"{where}: {name} of {least} to {most} expected, found {values.min()} to {values.max()}")
    same = np.ones(samples, dtype=bool)
    same[starts[:-1][starts[:-1] < samples]] = False
    if (np.diff(whole.steps)[same[1:]] > 0).any():
        raise DatasetError(f"{where}: samples from near to far expected, found others")
    step = _step(low, high)
    return LayeredImage(
        View(matrix, focal, (left, top, width, height)),
        starts,
        (1.0 / (low + step * whole.steps)).astype(np.float32),
        (0.5 * step * _half_steps(whole.slopes)).astype(np.float32),
        whole.colors,
        known[whole.places],
    )


class _Sections:
    """What comes after the header, one section after the other."""

    def __init__(self, data: bytes, where: str) -> None:
        self._data, self._where, self._at = data, where, _HEADER.size

    def next(self, name: str, size: int) -> NDArray[np.uint8]:
        """The bytes of the next one. Raises DatasetError unless there are ``size``."""
        start = self._at + _LENGTH.size
        length = _LENGTH.unpack_from(self._data, self._at)[0] if start <= len(self._data) else 0
        self._at = start + length
        if not 0 < length <= len(self._data) - start:
            raise DatasetError(f"{self._where}: {name} expected at byte {start}, found the file's end")
        reader = zlib.decompressobj()
        try:
            found = reader.decompress(self._data[start : self._at], size + 1)
        except zlib.error as error:
            raise DatasetError(f"{self._where}: {name} expected at byte {start}, found no zlib stream") from error
        if len(found) != size or not reader.eof or reader.unused_data:
            raise DatasetError(f"{self._where}: {size} bytes of {name} expected, found {len(found)} or more")
        return np.frombuffer(found, dtype=np.uint8)

    def end(self) -> None:
        """Raise DatasetError where more follows."""
        if self._at != len(self._data):
            raise DatasetError(f"{self._where}: {self._at} bytes expected, found {len(self._data)}")


def _step(low: float, high: float) -> float:
    return max((high - low) / _STEPS, _LEAST_STEP * high)


def _codes(half_steps: NDArray[np.float64]) -> NDArray[np.int32]:
    """Whole numbers -> their codes; ascending, and those below 64 are their own."""
    most = np.minimum(np.abs(half_steps), _STEEPEST)
    doublings = np.maximum(np.frexp(np.maximum(most, 1.0))[1] - 6, 0)
    codes = _HALF * doublings + np.round(most / 2.0**doublings)
    signed: NDArray[np.int32] = (np.sign(half_steps) * codes).astype(np.int32)
    return signed


def _half_steps(codes: NDArray[np.int32]) -> NDArray[np.float64]:
    """The numbers that codes stand for."""
    size = np.abs(codes)
    doublings = np.maximum(size // _HALF - 1, 0)
    found: NDArray[np.float64] = np.sign(codes) * (size - _HALF * doublings) * 2.0**doublings
    return found


def _room(count: int) -> _Coded:
    return _Coded(
        np.empty(count, np.int32),
        np.empty(count, np.int32),
        np.empty((count, 2), np.int32),
        np.empty((count, 3), np.uint8),
    )


def _shuffled(values: NDArray[np.int32]) -> NDArray[np.uint8]:
    """All lowest bytes, then all second ones, and so on, of numbers whose sign is their lowest bit."""
    folded = ((values << 1) ^ (values >> 31)).astype("<u4")
    return np.ascontiguousarray(folded.view(np.uint8).reshape(-1, 4).T)


def _unshuffled(data: NDArray[np.uint8]) -> NDArray[np.int32]:
    folded = np.ascontiguousarray(data.reshape(4, -1).T).reshape(-1).view("<u4")
    signed: NDArray[np.int32] = ((folded >> 1) ^ (0 - (folded & 1))).astype(np.uint32).view(np.int32)
    return signed


@kernel(error_model="numpy", nogil=True)
def _predict(starts: NDArray[np.int32], width: int, whole: _Coded, off: _Coded, decode: bool) -> None:
    """Find out by how much samples are off from their predictions, or with ``decode`` what samples are that are so much off."""
    for pixel in range(len(starts) - 1):
        aside = pixel - 1 if pixel % width > 0 else -1
        above = pixel - width
        for k in range(starts[pixel], starts[pixel + 1]):
            rank = k - starts[pixel]
            left, up = _of_rank(starts, aside, rank), _of_rank(starts, above, rank)
            place = whole.places[left] if left >= 0 else whole.places[up] if up >= 0 else 0
            if decode:
                whole.places[k] = off.places[k] + place
            else:
                off.places[k] = whole.places[k] - place
            place = whole.places[k]
            left, up = _like(starts, aside, left, place, whole.places), _like(starts, above, up, place, whole.places)
            weight = max((left >= 0) + (up >= 0), 1)
            twice, x, y, r, g, b = 0, 0, 0, 0, 0, 0
            for i in range(2):
                n = left if i == 0 else up
                if n >= 0:
                    code = whole.slopes[n, i]
                    doublings = min(max(abs(code) // _HALF - 1, 0), 24)
                    along = (abs(code) - _HALF * doublings) << doublings
                    twice += 2 * whole.steps[n] + (along if code > 0 else -along)
                    x, y = x + whole.slopes[n, 0], y + whole.slopes[n, 1]
                    r, g, b = r + whole.colors[n, 0], g + whole.colors[n, 1], b + whole.colors[n, 2]
            twice, x, y = twice // weight, x // weight, y // weight
            color = (r // weight, g // weight, b // weight)
            near = min(max(twice // 2, 0), _STEPS)
            if decode:
                whole.steps[k] = off.steps[k] + near
                whole.slopes[k, 0], whole.slopes[k, 1] = off.slopes[k, 0] + x, off.slopes[k, 1] + y
                for n in range(3):
                    whole.colors[k, n] = (off.colors[k, n] + color[n]) & 255
            else:
                off.steps[k] = whole.steps[k] - near
                off.slopes[k, 0], off.slopes[k, 1] = whole.slopes[k, 0] - x, whole.slopes[k, 1] - y
                for n in range(3):
                    off.colors[k, n] = (whole.colors[k, n] - color[n]) & 255


@kernel(error_model="numpy", nogil=True)
def _of_rank(starts: NDArray[np.int32], pixel: int, rank: int) -> int:
    """The sample of a ``rank`` in a pixel, or its last; -1 where there is none, or no such pixel."""
    if pixel < 0 or starts[pixel] == starts[pixel + 1]:
        return -1
    return int(min(starts[pixel] + rank, starts[pixel + 1] - 1))


@kernel(error_model="numpy", nogil=True)
def _like(starts: NDArray[np.int32], pixel: int, guess: int, place: int, places: NDArray[np.int32]) -> int:
    """The ``guess``, a sample in a pixel or -1, where that is of the object at ``place``, or else the first that is, or -1."""
    if guess < 0 or places[guess] == place:
        return guess
    for n in range(starts[pixel], starts[pixel + 1]):
        if places[n] == place:
            return n
    return -1
