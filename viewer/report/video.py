"""Videos from frames: MP4 (H.264) by PyAV, or animated WebP by Pillow. A file is written whole or not at all."""

from __future__ import annotations

from contextlib import ExitStack, suppress
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Self

import av
import av.error
import numpy as np
from av.container import OutputContainer
from av.video.frame import VideoFrame
from av.video.reformatter import ColorRange, Colorspace
from av.video.stream import VideoStream
from numpy.typing import NDArray
from PIL import Image

from mmi.foundation.errors import DatasetError, ParameterError
from mmi.foundation.whole_files import whole_path

__all__ = ["VideoWriter"]

_ENCODERS = ("libx264", "mpeg4")
"""Encoders, the best one first; not every build of PyAV has that."""
_RATE_FACTOR = "20"
"""The quality of H.264: differences from the frames can hardly be seen."""
_BITS_A_PIXEL = 0.3
"""The bits that a pixel gets from the encoder that knows no constant quality."""
_BT709 = 1
"""The number of BT.709, which players expect of HD video, in FFmpeg's lists of spaces, primaries and transfer functions."""


class VideoWriter:
    """A context manager that takes frames of ``size`` (width, height) and leaves a video at ``path`` when it succeeds.

    The suffix decides: ``.mp4`` keeps a few frames in memory, ``.webp`` all of them. Odd sizes get one more row or column,
    since H.264 wants even ones. Raises ParameterError for another suffix, DatasetError where the file cannot be written;
    ValueError where there was no frame. Whatever is raised, no part of a file stays.
    """

    def __init__(self, path: Path, size: tuple[int, int], frames_per_second: float) -> None:
        if path.suffix.lower() not in (".mp4", ".webp"):
            raise ParameterError(f"{path}: a video's name that ends in .mp4 or .webp expected, found {path.suffix!r}")
        if min(size) < 1 or not 0.001 <= frames_per_second <= 1000.0:
            raise ParameterError(
                f"{path}: pixels and 0.001 to 1000 frames a second expected, found {size} at {frames_per_second}"
            )
        self._path = path
        self._size = size
        rate = Fraction(frames_per_second).limit_denominator(1001)
        self._sink: _Mp4 | _WebP = _Mp4(rate) if path.suffix.lower() == ".mp4" else _WebP(rate)
        self._frames = 0
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        """Open the temporary file."""
        width, height = (extent + extent % 2 for extent in self._size)
        try:
            with ExitStack() as stack:
                temporary = stack.enter_context(whole_path(self._path))
                stack.callback(self._close)
                self._sink.open(temporary, width, height)
                self._stack = stack.pop_all()
        except (OSError, av.error.FFmpegError) as error:
            raise self._cannot_write(error) from error
        return self

    def add(self, pixels: NDArray[np.uint8]) -> None:
        """The next frame, (height, width, 3) sRGB. Raises ValueError for one of another size."""
        width, height = self._size
        if pixels.shape != (height, width, 3) or pixels.dtype != np.uint8:
            raise ValueError(f"a frame ({height}, {width}, 3) uint8 expected, found {pixels.shape} {pixels.dtype}")
        even = np.pad(pixels, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
        try:
            self._sink.add(even)
        except (OSError, av.error.FFmpegError) as error:
            raise self._cannot_write(error) from error
        self._frames += 1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Finish and rename the file, or remove it where something went wrong."""
        try:
            with self._stack.pop_all() as stack:
                # Errors leave through the stack, so that the file vanishes.
                if kind is not None:
                    stack.__exit__(kind, error, trace)
                elif self._frames == 0:
                    raise ValueError(f"{self._path}: at least one frame expected, found none")
                else:
                    self._sink.finish()
        except (OSError, av.error.FFmpegError) as failure:
            raise self._cannot_write(failure) from failure

    def _close(self) -> None:
        """Let go of the encoder; whatever it says to that, the file is as it is."""
        with suppress(OSError, av.error.FFmpegError):
            self._sink.close()

    def _cannot_write(self, error: Exception) -> DatasetError:
        return DatasetError(f"{self._path}: a writable file expected, found: {getattr(error, 'strerror', '') or error}")


class _Mp4:
    """Encodes each frame as it comes."""

    def __init__(self, rate: Fraction) -> None:
        self._rate = rate
        self._container: OutputContainer | None = None
        self._stream: VideoStream | None = None

    def open(self, path: Path, width: int, height: int) -> None:
        path.touch()  # FFmpeg would tell of a missing folder only with the first packet
        encoder = next(name for name in _ENCODERS if name in av.codecs_available)
        self._container = av.open(path, "w", format="mp4", options={"movflags": "+faststart"})
        stream = self._container.add_stream(encoder, rate=self._rate)
        assert isinstance(stream, VideoStream), f"{encoder} encodes video"
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        if encoder == "libx264":
            stream.options = {"crf": _RATE_FACTOR}
        else:
            stream.bit_rate = int(_BITS_A_PIXEL * width * height * self._rate) + 1
        context = stream.codec_context
        context.colorspace, context.color_range = _BT709, int(ColorRange.MPEG)
        context.color_primaries = context.color_trc = _BT709
        self._stream = stream

    def add(self, pixels: NDArray[np.uint8]) -> None:
        frame = VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format="rgb24")
        self._encode(
            frame.reformat(format="yuv420p", dst_colorspace=Colorspace.ITU709, dst_color_range=ColorRange.MPEG)
        )

    def finish(self) -> None:
        self._encode(None)
        self.close()

    def close(self) -> None:
        container, self._container = self._container, None
        if container is not None:
            container.close()

    def _encode(self, frame: VideoFrame | None) -> None:
        assert self._stream is not None and self._container is not None, "frames come between open and close"
        for packet in self._stream.encode(frame):
            self._container.mux(packet)


class _WebP:
    """Keeps all frames: Pillow writes them at once."""

    def __init__(self, rate: Fraction) -> None:
        self._rate = rate
        self._path = Path()
        self._frames: list[Image.Image] = []

    def open(self, path: Path, _width: int, _height: int) -> None:
        path.touch()
        self._path = path

    def add(self, pixels: NDArray[np.uint8]) -> None:
        self._frames.append(Image.fromarray(pixels))

    def finish(self) -> None:
        # Whole milliseconds a frame that do not add up to a drift.
        starts = [round(1000 * i / self._rate) for i in range(len(self._frames) + 1)]
        durations = [max(1, int(step)) for step in np.diff(starts)]
        first, *others = self._frames
        first.save(
            self._path, format="webp", save_all=True, append_images=others, duration=durations, loop=0, quality=80
        )

    def close(self) -> None:
        self._frames.clear()
