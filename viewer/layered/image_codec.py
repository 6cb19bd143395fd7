"""Layered images as bytes: how they lie on the disk.

    header     magic, window, samples, objects, focal length, least and largest 1 / depth, eye_from_world without its last row
    objects    how many bytes they take, and their numbers, packed with zlib
    the rest   pixels' counts and all about the samples, as :mod:`viewer.layered.sample_models` tells it

Objects and reaches are kept exactly, colors to 3 of 255, and exactly where a surface is even. 1 / depth is kept in 3,071 steps
between the least and the largest, off by half a step at most; a point moves by that times the focal length times the viewer's
distance from the image's eye: by 1/13 of a pixel at most, of 512 at 60 degrees, where no sample is closer than the viewer may
be. Slopes are off by two steps or 1/32, and patches' borders by 1/6 of a pixel then, or by 1/64 of what they cover.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View
from mmi.foundation.errors import DatasetError
from viewer.layered.layered_image import MOST_LAYERS, LayeredImage
from viewer.layered.range_coder import ended, reading, writing
from viewer.layered.sample_models import (
    LARGEST,
    Samples,
    room_for,
    tell_colors,
    tell_counts,
    tell_depths,
    tell_reaches,
    tell_slopes,
)

__all__ = ["decoded", "encoded"]

_MAGIC = b"layered2"
_HEADER = struct.Struct("<8s4i2I15d")
_LENGTH = struct.Struct("<I")
_STEPS = 3071
_LEAST_STEP = 2.0**-24
"""Steps are not below this share of the largest 1 / depth, so that there is a largest code of slopes."""
_MOST_PIXELS = 1 << 26
_MOST = 1e9
"""Depths, distances and focal lengths are not above it, nor depths and focal lengths below its reciprocal."""
_TURNED = 1e-6
"""By how much a rotation's rows may be off from perpendicular and of length 1."""
_MOST_OF_A_SAMPLE, _MOST_OF_A_PIXEL = 1024, 64
"""Bytes that these take at most, if nothing is as expected."""
_LEAST_BYTES = 1.0 / 8192.0
"""Bytes that each of them takes at least, if everything is."""


def encoded(image: LayeredImage) -> bytes:
    """An image's bytes, the same for the same image. Raises ValueError where a pixel has more than 255 samples."""
    counts = image.counts.astype(np.int32)
    if counts.max() > MOST_LAYERS:
        raise ValueError(f"at most {MOST_LAYERS} samples a pixel expected, found {counts.max()}")
    near = 1.0 / image.depths.astype(np.float64)
    low, high = (float(near.min()), float(near.max())) if len(near) else (1.0, 1.0)
    step = _step(low, high)
    objects, places = np.unique(image.ids, return_inverse=True)
    samples = room_for(image.starts)
    samples.places[:], samples.steps[:] = places.reshape(-1), np.round((near - low) / step)
    samples.slopes[:] = np.clip(np.round(image.slopes.astype(np.float64) / step), -LARGEST, LARGEST)
    samples.reaches[:], samples.colors[:] = image.reaches, image.colors
    coder = writing(_MOST_OF_A_PIXEL * counts.size + _MOST_OF_A_SAMPLE * len(near) + _LENGTH.size)
    tell_counts(coder, counts)
    tell_depths(coder, counts.shape[1], len(objects), samples)
    tell_slopes(coder, samples)
    tell_reaches(coder, samples)
    tell_colors(coder, len(objects), samples)
    numbers = (*image.view.window, len(near), len(objects), image.view.focal, low, high)
    head = _HEADER.pack(_MAGIC, *numbers, *image.view.eye_from_world[:3].ravel())
    packed = zlib.compress(objects.astype("<i4").tobytes(), 9)
    return head + _LENGTH.pack(len(packed)) + packed + coder.data[: ended(coder)].tobytes()


def decoded(data: bytes, where: str) -> LayeredImage:
    """The image whose bytes these are, of a file called ``where``.

    Raises DatasetError for what :func:`encoded` does not make.
    """
    if len(data) < _HEADER.size or not data.startswith(_MAGIC):
        raise DatasetError(f"{where}: a layered image expected, found {len(data)} bytes of something else")
    _, left, top, width, height, count, objects, focal, low, high, *rows = _HEADER.unpack_from(data)
    if not (width > 0 and height > 0 and width * height <= _MOST_PIXELS):
        raise DatasetError(f"{where}: a picture of 1 to {_MOST_PIXELS} pixels expected, found {width} x {height}")
    if not (count <= MOST_LAYERS * width * height and min(count, 1) <= objects <= count):
        raise DatasetError(
            f"{where}: at most {MOST_LAYERS} samples a pixel, and as many objects, expected, found {count} and {objects}"
        )
    if not _LEAST_BYTES * (width * height + count) <= len(data):
        raise DatasetError(
            f"{where}: more than {len(data)} bytes expected of {count} samples of {width} x {height} pixels"
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
    known, at = _objects(data, objects, where)
    samples = _samples(data[at:], (height, width), count, objects, where)
    step = _step(low, high)
    return LayeredImage(
        View(matrix, focal, (left, top, width, height)),
        samples.starts,
        (1.0 / (low + step * samples.steps)).astype(np.float32),
        (step * samples.slopes).astype(np.float32),
        samples.reaches.astype(np.uint8),
        samples.colors.astype(np.uint8),
        known[samples.places],
    )


def _objects(data: bytes, count: int, where: str) -> tuple[NDArray[np.int32], int]:
    """So many numbers of objects, and where what comes after them begins. Raises DatasetError."""
    start = _HEADER.size + _LENGTH.size
    length = _LENGTH.unpack_from(data, _HEADER.size)[0] if start <= len(data) else 0
    if not 0 < length <= len(data) - start:
        raise DatasetError(f"{where}: objects expected at byte {start}, found the file's end")
    reader = zlib.decompressobj()
    try:
        found = reader.decompress(data[start : start + length], 4 * count + 1)
    except zlib.error as error:
        raise DatasetError(f"{where}: objects expected, found what zlib cannot unpack") from error
    if len(found) != 4 * count or not reader.eof or reader.unused_data:
        raise DatasetError(f"{where}: {4 * count} bytes of objects expected, found {len(found)} or more")
    return np.frombuffer(found, dtype="<i4").astype(np.int32), start + length


def _samples(data: bytes, shape: tuple[int, int], count: int, objects: int, where: str) -> Samples:
    """So many samples of pixels (h, w), of so many objects. Raises DatasetError."""
    coder, counts = reading(data), np.zeros(shape, np.int32)
    tell_counts(coder, counts)
    sums = np.cumsum(counts, dtype=np.int64)
    if counts.max() > MOST_LAYERS or sums[-1] != count:
        raise DatasetError(
            f"{where}: {count} samples expected, as the header says, found {sums[-1]}, up to {counts.max()} in a pixel"
        )
    samples = room_for(np.concatenate([[0], sums]).astype(np.int32))
    tell_depths(coder, shape[1], objects, samples)
    same = np.ones(count, dtype=bool)
    firsts = samples.starts[:-1]
    same[firsts[firsts < count]] = False
    for name, values, least, most in (
        ("depths", samples.steps, 0, _STEPS),
        ("depths from near to far", np.diff(samples.steps)[same[1:]], -_STEPS, 0),
    ):
        if values.size and not (values.min() >= least and values.max() <= most):
            raise DatasetError(f"{where}: {name} of {least} to {most} expected, found {values.min()} to {values.max()}")
    tell_slopes(coder, samples)
    tell_reaches(coder, samples)
    tell_colors(coder, objects, samples)
    if ended(coder) != len(data):
        raise DatasetError(f"{where}: {ended(coder)} bytes of samples expected, found {len(data)}")
    return samples


def _step(low: float, high: float) -> float:
    return max((high - low) / _STEPS, _LEAST_STEP * high)
