"""Layered images as bytes: how they lie on the disk.

    header      magic, window, samples, objects, focal length, least and largest 1 / depth, eye_from_world without its last row
    sections    the length of each, then zlib: counts of the pixels' samples, numbers of the objects, and per sample its object,
                1 / depth, two slopes and four reaches; and at last a picture of all colors, in WebP

Objects and reaches are kept exactly, colors to 3 of 255. 1 / depth is kept in 4,095 steps between the least and the largest,
off by half a step at most; a point moves by that times the focal length times the viewer's distance from the image's eye: by
1/18 of a pixel at most, of 512 at 60 degrees, where no sample is closer than the viewer may be. Slopes are off by two steps or
1/32, and patches' borders by 1/9 of a pixel then, or by 1/64 of what they cover.

Objects are predicted from the pixel to the left or above, and so is 1 / depth, of the same object, along a plane. A slope is
mostly what 1 / depth differs by from a neighbour, and it is enough to say on which side that is. Colors of the first layer lie
in their picture as in the image, those of further layers below as long as these are in many pixels; the rest follow each other.
Arithmetic is in whole numbers: the same anywhere. Reading trusts nothing: what does not fit is a DatasetError in one line.
"""

from __future__ import annotations

import io
import struct
import zlib
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mmi.foundation.camera import View
from mmi.foundation.errors import DatasetError
from mmi.foundation.kernels import kernel
from viewer.layered.layered_image import HALF, MOST_LAYERS, LayeredImage

__all__ = ["decoded", "encoded"]

_MAGIC = b"layered1"
_HEADER = struct.Struct("<8s4i2I15d")
_LENGTH = struct.Struct("<I")
_STEPS = (1 << 12) - 1
_LEAST_STEP = 2.0**-24
"""Steps are not below this share of the largest 1 / depth, so that there is a largest code of slopes."""
_COARSE = 2
"""Steps of 1 / depth that a slope may be off by, or its ``_SHARE``-th part, if that is more."""
_SHARE = 32
_LEFT, _RIGHT, _CODED = 0, 1, 2
"""How a slope is told: by the neighbour on one side or on the other, or by its code, from 2 on."""
_EXACT, _HALF = 64, 32
"""Slopes below the first, in ``_COARSE`` steps, are their own codes; of twice a slope they are larger by the second."""
_LARGEST = 1 << 24
_LARGEST_CODE = _EXACT + 19 * _HALF
_MOST_PIXELS = 1 << 26
_MOST = 1e9
"""Depths, distances and focal lengths are not above it, nor depths and focal lengths below its reciprocal."""
_TURNED = 1e-6
"""By how much a rotation's rows may be off from perpendicular and of length 1."""
_COLORS = 6
"""Colors are kept as multiples of it."""
_FULL = 0.05
"""The share of pixels that a layer is in from which on its colors are a picture."""


class _Coded(NamedTuple):
    """What samples are, and how they are told: places among the objects, steps of 1 / depth, and of slopes per pixel.

    ``off`` are places and steps less what was predicted (m, 2), ``told`` says how slopes are told (m, 2).
    """

    places: NDArray[np.int32]
    steps: NDArray[np.int32]
    slopes: NDArray[np.int32]
    off: NDArray[np.int32]
    told: NDArray[np.int32]


def encoded(image: LayeredImage) -> bytes:
    """An image's bytes, the same for the same image. Raises ValueError where a pixel has more than 255 samples."""
    counts = image.counts
    if counts.max() > MOST_LAYERS:
        raise ValueError(f"at most {MOST_LAYERS} samples a pixel expected, found {counts.max()}")
    near = 1.0 / image.depths.astype(np.float64)
    low, high = (float(near.min()), float(near.max())) if len(near) else (1.0, 1.0)
    step = _step(low, high)
    objects, places = np.unique(image.ids, return_inverse=True)
    coded = _room(len(near))
    coded.places[:], coded.steps[:] = places.reshape(-1), np.round((near - low) / step)
    most = float(_LARGEST * _COARSE)
    coded.slopes[:] = np.clip(np.round(image.slopes.astype(np.float64) / step), -most, most)
    _predict(image.starts, counts.shape[1], coded, False)
    _tell_slopes(image.starts, counts.shape[1], coded, False)
    numbers = (*image.view.window, len(near), len(objects), image.view.focal, low, high)
    parts = (
        counts.astype(np.uint8),
        objects.astype("<i4"),
        *(_shuffled(values) for values in (*coded.off.T, *coded.told.T)),
        np.ascontiguousarray(image.reaches.T),
    )
    packed = [zlib.compress(part.tobytes(), 6) for part in parts] + [_colors_packed(image)]
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
    if not (samples <= MOST_LAYERS * width * height and objects <= samples):
        raise DatasetError(
            f"{where}: at most {MOST_LAYERS} samples a pixel, and as many objects, expected, found {samples} and {objects}"
        )
    if not (1.0 / _MOST <= focal <= _MOST and 1.0 / _MOST <= low <= high <= _MOST):
        raise DatasetError(
            f"{where}: a focal length and depths of at most {_MOST:g} expected, found {focal:g}, {low:g} and {high:g}"
        )
    matrix = np.array([*rows, 0.0, 0.0, 0.0, 1.0]).reshape(4, 4)
    turned = matrix[:3, :3]
    if not (abs(turned).max() <= 2.0 and abs(turned @ turned.T - np.eye(3)).max() <= _TURNED):
        raise DatasetError(f"{where}: a rotation expected in the image's view, found {turned.tolist()}")
    if not abs(matrix[:3, 3]).max() <= _MOST:
        raise DatasetError(f"{where}: a place of at most {_MOST:g} m expected, found {matrix[:3, 3].tolist()}")
    sections = _Sections(data, where)
    starts = np.zeros(width * height + 1, dtype=np.int64)
    np.cumsum(sections.unpacked("counts", width * height), dtype=np.int64, out=starts[1:])
    if starts[-1] != samples:
        raise DatasetError(f"{where}: {samples} samples expected, as the header says, found {starts[-1]}")
    known = sections.unpacked("objects", 4 * objects).view("<i4").astype(np.int32)
    coded, starts = _room(samples), starts.astype(np.int32)
    for column in (coded.off[:, 0], coded.off[:, 1], coded.told[:, 0], coded.told[:, 1]):
        column[:] = _unshuffled(sections.unpacked("samples", 4 * samples))
    reaches = np.array(sections.unpacked("reaches", 4 * samples).reshape(4, samples).T, order="C")
    colors = _colors_unpacked(sections.packed("colors"), starts, width, where)
    sections.end()
    _predict(starts, width, coded, True)
    same = np.ones(samples, dtype=bool)
    same[starts[:-1][starts[:-1] < samples]] = False
    for name, values, least, most in (
        ("places", coded.places, 0, objects - 1),
        ("depths", coded.steps, 0, _STEPS),
        ("depths from near to far", np.diff(coded.steps)[same[1:]], -_STEPS, 0),
        ("slopes", coded.told, -_LARGEST_CODE, _LARGEST_CODE),
        ("reaches", reaches, 0, HALF),
    ):
        if values.size and not (values.min() >= least and values.max() <= most):
            raise DatasetError(f"{where}: {name} of {least} to {most} expected, found {values.min()} to {values.max()}")
    _tell_slopes(starts, width, coded, True)
    step = _step(low, high)
    return LayeredImage(
        View(matrix, focal, (left, top, width, height)),
        starts,
        (1.0 / (low + step * coded.steps)).astype(np.float32),
        (step * coded.slopes).astype(np.float32),
        reaches,
        colors,
        known[coded.places],
    )


class _Sections:
    """What comes after the header, one section after the other."""

    def __init__(self, data: bytes, where: str) -> None:
        self._data, self._where, self._at = data, where, _HEADER.size

    def packed(self, name: str) -> bytes:
        """The bytes of the next one. Raises DatasetError where there are none."""
        start = self._at + _LENGTH.size
        length = _LENGTH.unpack_from(self._data, self._at)[0] if start <= len(self._data) else 0
        self._at = start + length
        if not 0 < length <= len(self._data) - start:
            raise DatasetError(f"{self._where}: {name} expected at byte {start}, found the file's end")
        return self._data[start : self._at]

    def unpacked(self, name: str, size: int) -> NDArray[np.uint8]:
        """What the next one unpacks into. Raises DatasetError unless that is ``size`` bytes."""
        reader = zlib.decompressobj()
        try:
            found = reader.decompress(self.packed(name), size + 1)
        except zlib.error as error:
            raise DatasetError(f"{self._where}: {name} expected, found what zlib cannot unpack") from error
        if len(found) != size or not reader.eof or reader.unused_data:
            raise DatasetError(f"{self._where}: {size} bytes of {name} expected, found {len(found)} or more")
        return np.frombuffer(found, dtype=np.uint8)

    def end(self) -> None:
        """Raise DatasetError where more follows."""
        if self._at != len(self._data):
            raise DatasetError(f"{self._where}: {self._at} bytes expected, found {len(self._data)}")


def _step(low: float, high: float) -> float:
    return max((high - low) / _STEPS, _LEAST_STEP * high)


def _room(count: int) -> _Coded:
    one, two = np.zeros(count, np.int32), np.zeros((count, 2), np.int32)
    return _Coded(one, one.copy(), two, two.copy(), two.copy())


def _shuffled(values: NDArray[np.int32]) -> NDArray[np.uint8]:
    """All lowest bytes, then all second ones, and so on, of numbers whose sign is their lowest bit."""
    folded = ((values << 1) ^ (values >> 31)).astype("<u4")
    return np.ascontiguousarray(folded.view(np.uint8).reshape(-1, 4).T)


def _unshuffled(data: NDArray[np.uint8]) -> NDArray[np.int32]:
    folded = np.ascontiguousarray(data.reshape(4, -1).T).reshape(-1).view("<u4")
    signed: NDArray[np.int32] = ((folded >> 1) ^ (0 - (folded & 1))).astype(np.uint32).view(np.int32)
    return signed


def _places_of_colors(starts: NDArray[np.int32], width: int) -> tuple[NDArray[np.int64], int]:
    """Where samples have their colors in a picture ``width`` pixels wide, counted row by row, and how many rows it has."""
    counts = np.diff(starts)
    pixels = np.repeat(np.arange(len(counts)), counts)
    layers = np.arange(len(pixels)) - starts[pixels]
    of_layers = np.bincount(layers, minlength=1)
    full = 1 + int(np.cumprod(of_layers[1:] >= _FULL * len(counts)).sum())
    found = layers * len(counts) + pixels
    rest = layers >= full
    found[rest] = full * len(counts) + np.arange(int(rest.sum()))
    return found, full * (len(counts) // width) + -(-int(rest.sum()) // width)


def _colors_packed(image: LayeredImage) -> bytes:
    """A picture of all colors; where there are none, the last one goes on."""
    width = image.view.window[2]
    places, height = _places_of_colors(image.starts, width)
    picture = np.zeros((width * height, 3), dtype=np.uint8)
    latest = np.zeros(width * height, dtype=np.int64)
    latest[places] = places
    picture[places] = np.minimum((image.colors.astype(np.int32) + _COLORS // 2) // _COLORS * _COLORS, 255)
    file = io.BytesIO()
    whole = Image.fromarray(picture[np.maximum.accumulate(latest)].reshape(height, width, 3))
    whole.save(file, "WEBP", lossless=True, quality=50, method=3)
    return file.getvalue()


def _colors_unpacked(data: bytes, starts: NDArray[np.int32], width: int, where: str) -> NDArray[np.uint8]:
    places, height = _places_of_colors(starts, width)
    try:
        with Image.open(io.BytesIO(data), formats=("WEBP",)) as picture:
            if picture.size != (width, height) or picture.mode != "RGB":
                raise DatasetError(
                    f"{where}: a color picture of {width} x {height} expected, found {picture.mode}, "
                    f"{picture.size[0]} x {picture.size[1]}"
                )
            found = np.asarray(picture).reshape(-1, 3)[places]
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise DatasetError(f"{where}: colors in WebP expected, found what cannot be read") from error
    return found


@kernel(error_model="numpy", nogil=True)
def _predict(starts: NDArray[np.int32], width: int, coded: _Coded, decode: bool) -> None:
    """Find out by how much places and steps are off from what is predicted, or with ``decode`` what they are."""
    places, steps = coded.places, coded.steps
    for pixel in range(len(starts) - 1):
        aside = pixel - 1 if pixel % width > 0 else -1
        above = pixel - width
        corner = above - 1 if aside >= 0 else -1
        for k in range(starts[pixel], starts[pixel + 1]):
            rank = k - starts[pixel]
            left, up = _of_rank(starts, aside, rank), _of_rank(starts, above, rank)
            place = places[left] if left >= 0 else places[up] if up >= 0 else 0
            if decode:
                places[k] = coded.off[k, 0] + place
            else:
                coded.off[k, 0] = places[k] - place
            place = places[k]
            left, up = _like(starts, aside, left, place, places), _like(starts, above, up, place, places)
            predicted = 0
            if left >= 0 and up >= 0:
                beyond = _like(starts, corner, _of_rank(starts, corner, rank), place, places)
                least, most = min(steps[left], steps[up]), max(steps[left], steps[up])
                predicted = (least + most) // 2
                if beyond >= 0:
                    spread = most - least + 16
                    predicted = min(max(steps[left] + steps[up] - steps[beyond], least - spread), most + spread)
            elif left >= 0 or up >= 0:
                predicted = steps[left] if left >= 0 else steps[up]
            elif rank > 0:
                predicted = steps[k - 1]
            if rank > 0:
                predicted = min(predicted, steps[k - 1])
            if decode:
                steps[k] = coded.off[k, 1] + predicted
            else:
                coded.off[k, 1] = steps[k] - predicted


@kernel(error_model="numpy", nogil=True)
def _tell_slopes(starts: NDArray[np.int32], width: int, coded: _Coded, decode: bool) -> None:
    """Find out how slopes are told, or with ``decode`` what they are."""
    for pixel in range(len(starts) - 1):
        for k in range(starts[pixel], starts[pixel + 1]):
            for axis in range(2):
                sides = (pixel - 1, pixel + 1) if axis == 0 else (pixel - width, pixel + width)
                if axis == 0 and pixel % width == 0:
                    sides = (-1, sides[1])
                if axis == 0 and pixel % width == width - 1:
                    sides = (sides[0], -1)
                if decode:
                    told = coded.told[k, axis]
                    if told in (_LEFT, _RIGHT):
                        n = _nearest(starts, sides[told], k, coded)
                        change = coded.steps[n] - coded.steps[k] if n >= 0 else 0
                        coded.slopes[k, axis] = -change if told == _LEFT else change
                    else:
                        code = told - _CODED if told > 0 else told
                        doublings = max(abs(code) // _HALF - 1, 0)
                        size = (abs(code) - _HALF * doublings) * _COARSE << doublings
                        coded.slopes[k, axis] = size if code > 0 else -size
                    continue
                one, other = _nearest(starts, sides[0], k, coded), _nearest(starts, sides[1], k, coded)
                left = coded.steps[k] - coded.steps[one] if one >= 0 else 0
                right = coded.steps[other] - coded.steps[k] if other >= 0 else 0
                slope = coded.slopes[k, axis]
                most = max(_COARSE, abs(slope) // _SHARE)
                if abs(left - slope) <= most and abs(left - slope) <= 2 * abs(right - slope):
                    coded.told[k, axis] = _LEFT
                elif abs(right - slope) <= most:
                    coded.told[k, axis] = _RIGHT
                else:
                    size, doublings = (abs(slope) + _COARSE // 2) // _COARSE, 0
                    while size >= _EXACT:
                        size, doublings = (size + 1) // 2, doublings + 1
                    code = size + _HALF * doublings
                    coded.told[k, axis] = code + _CODED if slope >= 0 or code == 0 else -code


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


@kernel(error_model="numpy", nogil=True)
def _nearest(starts: NDArray[np.int32], pixel: int, k: int, coded: _Coded) -> int:
    """The sample in a pixel that is nearest to sample ``k`` of the same object; -1 where there is none, or no such pixel."""
    found = -1
    if 0 <= pixel < len(starts) - 1:
        for n in range(starts[pixel], starts[pixel + 1]):
            if coded.places[n] == coded.places[k]:
                away = abs(coded.steps[n] - coded.steps[k])
                if found < 0 or away < abs(coded.steps[found] - coded.steps[k]):
                    found = n
    return found
