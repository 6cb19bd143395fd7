"""What is drawn into, and read back: framebuffers of one size, for pictures that are measured and for those that are not.

A frame may take some columns of the picture only: what lies beside them is neither drawn nor read.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import moderngl
import numpy as np
from numpy.typing import NDArray

from mmi.foundation.kernels import kernel
from viewer.drawing.programs import FAR, NEAR, Programs

__all__ = ["Measures", "Targets"]

_SKY_DEPTH = 1e29
"""Metres from which on a depth stands for the sky's."""
_SKY_LEFT = np.float32(2.0**8)
"""The sky is drawn this far before the far plane (``viewer.drawing.programs.SCREEN_VERTEX``), of 2^31."""
_NEAR, _NEAR_SHARE, _PER_UNIT = np.float32(NEAR), np.float32(NEAR / FAR), np.float32((1.0 - NEAR / FAR) / 2.0**31)
_NOTHING = np.float32(np.inf)


class Measures(NamedTuple):
    """What a measured picture says of each pixel, as in :class:`viewer.drawing.drawn_picture.DrawnPicture`; (h, w) each."""

    object_ids: NDArray[np.int32]
    depth: NDArray[np.float32]
    displacement: NDArray[np.float32]


class Targets:
    """Framebuffers of ``size`` (width, height), and with ``measured`` one for pictures that are measured."""

    def __init__(self, programs: Programs, size: tuple[int, int], *, measured: bool) -> None:
        self.size = size
        self._context, self._programs = programs.context, programs
        self._columns = (0, size[0])
        self._measured = measured
        self._whole: dict[bool, Any] = {}
        self._colors: dict[bool, Any] = {}
        self._lines: dict[bool, Any] = {}
        self._probe: Any = None
        self._depths = np.empty((0, 0), np.uint32), np.empty((0, 0), np.float32)
        self._make(measured=False)
        self.resolved: Any = self._context.texture(size, 4)
        """Colours without samples, after :meth:`resolve`."""
        self._resolving = self._context.framebuffer([self.resolved])

    def release(self) -> None:
        """Free it."""
        for whole in self._whole.values():
            for part in (*whole.color_attachments, whole.depth_attachment, whole):
                part.release()
        for thing in (*self._colors.values(), *self._lines.values(), self._resolving, self.resolved):
            thing.release()
        if self._probe is not None:
            for part in (*self._probe.color_attachments, self._probe.depth_attachment, self._probe):
                part.release()

    def limit(self, columns: tuple[int, int] | None) -> None:
        """From now on draw and read only columns from the first to before the second, or all of them (None)."""
        first, end = columns or (0, self.size[0])
        if not 0 <= first < end <= self.size[0]:
            raise ValueError(f"columns within {self.size[0]} expected, found {columns}")
        if (first, end) == self._columns:
            return
        self._columns = (first, end)
        for target in (*self._whole.values(), *self._colors.values(), *self._lines.values()):
            target.scissor = self._scissor

    @property
    def first_column(self) -> int:
        """The first of the columns that are drawn."""
        return self._columns[0]

    def clear(self, *, measured: bool) -> None:
        """Begin a picture."""
        if measured and self._measured and True not in self._whole:  # few windows ever show what is measured
            self._make(measured=True)
        whole = self._whole[measured]
        whole.use()
        whole.clear(0.0, 0.0, 0.0, 1.0)
        self._context.enable_only(moderngl.DEPTH_TEST)

    def use_color(self, *, measured: bool) -> None:
        """Draw on into the colours alone."""
        self._colors[measured].use()

    def use_lines(self, *, measured: bool) -> None:
        """Draw on into the colours, where nothing that was drawn is in front; what was measured stays."""
        if measured not in self._lines:
            whole = self._whole[measured]
            self._lines[measured] = self._context.framebuffer([whole.color_attachments[0]], whole.depth_attachment)
            self._lines[measured].scissor = self._scissor
        self._lines[measured].use()

    def resolve(self, *, measured: bool) -> None:
        """Copy the colours into ``resolved``, samples of a pixel averaged."""
        self._context.copy_framebuffer(self._resolving, self._colors[measured])

    def color(self, *, measured: bool, into: NDArray[np.uint8] | None = None) -> NDArray[np.uint8]:
        """(h, w, 3) sRGB, the top row first; ``into`` such an array where one is given."""
        source = self._whole[measured]
        if self._programs.smooth(measured):
            self.resolve(measured=measured)
            source = self._resolving
        found = self._read(source, 0, 3, "u1").reshape(self.size[1], -1, 3)
        if into is None:
            return np.ascontiguousarray(found)
        into[...] = found
        return into

    def depths(self, *, measured: bool) -> NDArray[np.float32]:
        """(h, w) metres along the axis to what was drawn so far, as exact as the depth buffer, infinite for sky; top row first.

        Of a multisampled picture, those of one sample a pixel. The array is the next picture's as well: new memory takes time.
        """
        source = self._whole[measured]
        if self._programs.smooth(measured):
            if self._probe is None:
                self._probe = self._context.framebuffer(
                    [self._context.renderbuffer(self.size, 4)], self._context.depth_renderbuffer(self.size)
                )
            self._context.copy_framebuffer(self._probe, source)
            source = self._probe
        (first, end), height = self._columns, self.size[1]
        if self._depths[0].shape != (height, end - first):
            self._depths = np.empty((height, end - first), np.uint32), np.empty((height, end - first), np.float32)
        shares, metres = self._depths  # whole numbers are read twice as fast as fractions
        source.read_into(shares, (first, 0, end - first, height), components=1, attachment=-1, alignment=1, dtype="u4")
        _along_axis(shares, metres)
        self._whole[measured].use()
        return metres

    def measures(self) -> Measures:
        """What the measured picture says besides colours, the top row first."""
        whole = self._whole[True]
        ids = np.ascontiguousarray(self._read(whole, 1, 1, "i4"))
        return Measures(ids, *_surfaces(self._read(whole, 2, 2, "f4").reshape(*ids.shape, 2)))

    @property
    def _scissor(self) -> tuple[int, int, int, int] | None:
        first, end = self._columns
        return None if (first, end) == (0, self.size[0]) else (first, 0, end - first, self.size[1])

    def _make(self, *, measured: bool) -> None:
        whole = self._whole[measured] = self._framebuffer(measured)
        colors = self._colors[measured] = self._context.framebuffer([whole.color_attachments[0]])
        whole.scissor = colors.scissor = self._scissor

    def _framebuffer(self, measured: bool) -> Any:  # noqa: ANN401
        context, size = self._context, self.size
        if not measured:
            samples = self._programs.samples
            return context.framebuffer(
                [context.renderbuffer(size, 4, samples=samples)], context.depth_renderbuffer(size, samples=samples)
            )
        return context.framebuffer(
            [
                context.renderbuffer(size, 4),
                context.renderbuffer(size, 1, dtype="i4"),
                context.renderbuffer(size, 2, dtype="f4"),
            ],
            context.depth_renderbuffer(size),
        )

    def _read(self, source: Any, attachment: int, components: int, dtype: str) -> NDArray[Any]:  # noqa: ANN401
        first, end = self._columns
        data = source.read(
            viewport=(first, 0, end - first, self.size[1]),
            components=components,
            attachment=attachment,
            alignment=1,
            dtype="f1" if dtype == "u1" else dtype,
        )
        return np.frombuffer(data, dtype=dtype).reshape(self.size[1], -1)[::-1]


@kernel(error_model="numpy", nogil=True)
def _surfaces(surface: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Depth and displacement (h, w) of what was drawn as (h, w, 2); infinite and NaN where there are none."""
    height, width, _ = surface.shape
    depth, displacement = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    for i in range(height):
        for j in range(width):
            depth[i, j] = np.inf if surface[i, j, 0] > _SKY_DEPTH else surface[i, j, 0]
            displacement[i, j] = np.nan if surface[i, j, 1] < 0.0 else surface[i, j, 1]
    return depth, displacement


@kernel(error_model="numpy", nogil=True)
def _along_axis(buffer: NDArray[np.uint32], found: NDArray[np.float32]) -> None:
    """Metres along the axis of what a depth buffer holds, of 2^32 at the far plane and the lowest row first, into ``found``
    (h, w), the top row first; infinite where nothing, or only sky, was drawn.
    """
    height = len(buffer)
    for i in range(height):
        _row_along_axis(buffer[height - 1 - i], found[i])


@kernel(error_model="numpy", nogil=True)
def _row_along_axis(buffer: NDArray[np.uint32], found: NDArray[np.float32]) -> None:
    """The same for a row (w,): compilers see through a single loop without branches, and take eight pixels at a time.

    What is left to the far plane is exact, so that single precision suffices.
    """
    for j in range(len(found)):
        left = np.float32(np.int32(np.uint32(~buffer[j]) >> 1))
        metres = _NEAR / (_NEAR_SHARE + _PER_UNIT * left)
        found[j] = metres if left > _SKY_LEFT else _NOTHING
