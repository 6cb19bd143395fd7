"""What a viewer has cast so far: a map of all directions, and from where each of them was cast (paper section 5).

The paper's map is a cylinder. This one goes up to the zenith and down: a row is a height above the horizon, a column an
azimuth, and both are as far apart as the smallest pixels of the display, those in its corners, so that no two pixels of a level
view need the same texel. Memory that no direction has needed is not taken.

A texel keeps what its ray has hit, not a colour: the point, and where in the city's texture it is. So it is known how wrong it
is when it is shown from elsewhere, and the renderer gives it the colour that it gives to geometry. A *record* is a place that
rays were cast from (the paper's confidence record); record 0 stands for what nobody has cast.
"""

from __future__ import annotations

import math
import mmap
import sys
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View
from mmi.foundation.kernels import kernel
from viewer.casting.angles import angle_of

__all__ = ["PIXEL_LEVELS", "SAMPLE", "TEXEL", "Found", "Panorama", "Texels", "smallest_pixel", "store", "texel_of"]

_APART = 1e-6
"""Metres below which two places are one: who turns on the spot stays where it is, to rounding."""
PIXEL_LEVELS = 1.5
"""Mipmap levels by which a pixel off the middle shows more detail for each halving of the cosine of how far off it looks: it
is smaller by the cosine along circles around the middle, and by its square away from it.
"""
_MOST_COLUMNS = 16_384
"""Enough for 2560 pixels and 60 degrees. A map of all directions takes 4.8 GB at most, where all of them have been seen."""
_MOST_RECORDS = 4096
"""Of older ones nothing is shown again."""


TEXEL = np.dtype(
    [
        ("record", "<i4"),
        ("object", "<i4"),
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("u", "<f4"),
        ("v", "<f4"),
        ("level", "<f4"),
        ("tint", "<u4"),
    ]
)
"""What is known of a direction: the ``record`` of where it was cast, the ``object`` that was hit, -1 for none, and the point in
the world (for none, the direction). Texture coordinates and ``tint`` are those of the point, ``level`` is the mipmap level at
which a pixel in the middle of the picture would show it.
"""

SAMPLE = np.dtype(
    [
        ("x", "<u2"),
        ("y", "<u2"),
        ("depth", "<f4"),
        ("u", "<f4"),
        ("v", "<f4"),
        ("level", "<f4"),
        ("tint", "<u4"),
        ("object", "<i4"),
    ]
)
"""``CAST_PIXEL`` (:mod:`viewer.computed`) without arrays in it, which kernels read and write faster."""


class Texels(NamedTuple):
    """All texels, row by row from straight down to straight up; ``step`` is radians of a column and of a row.

    ``map`` (columns * rows,) of ``TEXEL``.
    """

    columns: int
    rows: int
    step: float
    map: NDArray[np.void]


class Found(NamedTuple):
    """The ``state`` of each pixel (h, w), and lists of the open ones, those that are ``REUSED`` or ``CAST``, with room for all
    (h * w,): the ``pixel``, its place in the picture; the ``texel`` that shows it best (-1: none does); and the ``error`` in
    pixels that showing it may make, infinite where there is none.
    """

    state: NDArray[np.uint8]
    pixel: NDArray[np.int32]
    texel: NDArray[np.int32]
    error: NDArray[np.float32]


def smallest_pixel(view: View) -> float:
    """Radians of a side of the smallest pixel of a view, that in its farthest corner."""
    left, top, width, height = view.window
    aside, above = max(abs(left), abs(left + width)) / view.focal, max(abs(top), abs(top + height)) / view.focal
    return 1.0 / ((1.0 + aside * aside + above * above) * view.focal)


def _unwritten(count: int) -> NDArray[np.void]:
    """(count,) of ``TEXEL``, all zeros, which are not in memory before they are written.

    NumPy asks for large arrays in pages of two megabytes, of which each is filled as soon as a texel in it is: for a picture of
    320 x 200 pixels and 170 degrees that is all of the map, and takes seconds. On Linux these are small pages. Raises
    MemoryError where there is no room.
    """
    if sys.platform != "linux":
        return np.zeros(count, dtype=TEXEL)
    try:
        memory = mmap.mmap(-1, count * TEXEL.itemsize, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    except OSError as error:
        raise MemoryError(f"{count * TEXEL.itemsize} bytes for what rays have found") from error
    with suppress(OSError):  # there are kernels without large pages
        memory.madvise(mmap.MADV_NOHUGEPAGE)
    return np.frombuffer(memory, dtype=TEXEL)


class Panorama:
    """The map of one viewer, whose smallest pixels are ``pixel`` radians wide."""

    def __init__(self, pixel: float) -> None:
        columns = min(max(math.ceil(2.0 * math.pi / pixel), 8), _MOST_COLUMNS)
        step = 2.0 * math.pi / columns
        rows = math.ceil(math.pi / step) + 1
        self.texels = Texels(columns, rows, step, _unwritten(columns * rows))
        self._found: Found | None = None
        self._eyes = np.zeros((0, 3))
        self._dropped = 0

    def room(self, height: int, width: int) -> Found:
        """Room for what is found of a picture's pixels, the same for pictures of one size: new memory takes time."""
        found = self._found
        if found is None or found.state.shape != (height, width):
            count = height * width
            pixel, texel = np.empty(count, dtype=np.int32), np.empty(count, dtype=np.int32)
            state, error = np.empty((height, width), dtype=np.uint8), np.empty(count, dtype=np.float32)
            self._found = found = Found(state, pixel, texel, error)
        return found

    def distances(self, eye: NDArray[np.float64]) -> NDArray[np.float32]:
        """(records,) metres from ``eye`` (3,) to where each was cast; infinite for record 0 and those that are too old."""
        found = np.full(1 + self._dropped + len(self._eyes), np.inf, dtype=np.float32)
        if len(self._eyes):
            away = np.linalg.norm(self._eyes - eye, axis=1)
            found[-len(self._eyes) :] = np.where(away <= _APART, 0.0, away)
        return found

    def record_at(self, eye: NDArray[np.float64]) -> int:
        """The record for what is cast from ``eye`` (3,): a new one where the viewer has moved since the last.

        What was cast from the very place that a viewer comes back to has its record again.
        """
        away = np.linalg.norm(self._eyes - eye, axis=1)
        if len(away) and away.min() <= _APART:
            return 1 + self._dropped + int(np.argmin(away))
        self._eyes = np.vstack([self._eyes, eye])
        if len(self._eyes) > _MOST_RECORDS:
            self._eyes = self._eyes[1:]
            self._dropped += 1
        return self._dropped + len(self._eyes)


@kernel(error_model="numpy", nogil=True, inline="always")
def texel_of(dx: float, dy: float, dz: float, columns: int, rows: int, step: float) -> tuple[int, int]:
    """Column and row of the texel of a direction of any length but 0."""
    per_column = 1.0 / step
    column = int((angle_of(dy, dx) + math.pi) * per_column)
    row = int((angle_of(dz, math.sqrt(dx * dx + dy * dy)) + 0.5 * math.pi) * per_column)
    return min(column, columns - 1), min(row, rows - 1)


@kernel(error_model="numpy", nogil=True)
def store(
    record: int,
    directions: NDArray[np.float64],
    ahead: NDArray[np.float64],
    points: NDArray[np.float32],
    samples: NDArray[np.void],
    texels: Texels,
) -> None:
    """Keep what rays in unit ``directions`` (n, 3) have hit, under ``record``: ``points`` (n, 3) that ``samples`` (n,) of
    ``SAMPLE`` show. For a ray that has hit nothing the sample's object is -1, and the point is its direction.

    The pixels that the rays went through are those of a picture that looks ``ahead`` (3,).
    """
    for k in range(len(samples)):
        sample = samples[k]
        dx, dy, dz = directions[k, 0], directions[k, 1], directions[k, 2]
        column, row = texel_of(dx, dy, dz, texels.columns, texels.rows, texels.step)
        texel = texels.map[row * texels.columns + column]
        texel.record, texel.object = record, sample.object
        texel.x, texel.y, texel.z = points[k, 0], points[k, 1], points[k, 2]
        texel.u, texel.v, texel.tint = sample.u, sample.v, sample.tint
        cosine = dx * ahead[0] + dy * ahead[1] + dz * ahead[2]
        texel.level = sample.level - PIXEL_LEVELS * math.log2(cosine)
