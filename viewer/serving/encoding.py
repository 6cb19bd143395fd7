"""Pictures as bytes: JPEG for what moves, PNG where every pixel counts, and the message that a frame is sent in.

Encoding happens outside of the thread that draws and of the loop that serves, in two threads for JPEG, which let the others
run meanwhile, and one for PNG, which takes twenty times as long and must not hold up other clients' frames.
"""

from __future__ import annotations

import io
import json
import struct
import time as clock
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

import numpy as np
import simplejpeg
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

__all__ = ["Encoded", "Encoder", "jpeg", "message", "opened", "png"]

_LENGTH = struct.Struct("<I")
_FINE = 90
"""From this quality on colours are stored for every pixel, not for every fourth."""


def jpeg(picture: NDArray[np.uint8], quality: int) -> bytes:
    """``picture`` (h, w, 3) as JPEG, 4:2:0 below quality 90."""
    data: bytes = simplejpeg.encode_jpeg(
        picture, quality=quality, colorspace="RGB", colorsubsampling="420" if quality < _FINE else "444", fastdct=True
    )
    return data


def png(picture: NDArray[np.uint8], texts: Mapping[str, str] | None = None, *, small: bool = False) -> bytes:
    """``picture`` (h, w, 3) as PNG, pixel for pixel; ``texts`` go into tEXt chunks. ``small`` takes its time."""
    info = PngInfo()
    for key, text in (texts or {}).items():
        info.add_text(key, text)
    sink = io.BytesIO()
    Image.fromarray(picture).save(sink, "PNG", compress_level=6 if small else 1, pnginfo=info)
    return sink.getvalue()


def message(header: Mapping[str, Any], body: bytes) -> bytes:
    """A frame as one binary message: the header's length (uint32, little-endian), the header as JSON, the picture."""
    head = json.dumps(header, separators=(",", ":"), allow_nan=False).encode()
    return b"".join((_LENGTH.pack(len(head)), head, body))


def opened(data: bytes) -> tuple[dict[str, Any], bytes]:
    """(header, picture) of such a message."""
    (length,) = _LENGTH.unpack_from(data)
    start = _LENGTH.size
    return json.loads(data[start : start + length]), data[start + length :]


@dataclass(frozen=True, slots=True)
class Encoded:
    """A picture's bytes, their ``format`` ("jpeg", "png"), and the seconds that encoding took."""

    data: bytes
    format: str
    seconds: float


class Encoder:
    """The threads that encode, as a context manager."""

    def __init__(self) -> None:
        self._fast = ThreadPoolExecutor(2, thread_name_prefix="jpeg")
        self._slow = ThreadPoolExecutor(1, thread_name_prefix="png")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for pool in (self._fast, self._slow):
            pool.shutdown(wait=True, cancel_futures=True)

    def jpeg(self, picture: NDArray[np.uint8], quality: int) -> Future[Encoded]:
        """See :func:`jpeg`."""
        return self._fast.submit(_timed, "jpeg", lambda: jpeg(picture, quality))

    def png(
        self, picture: NDArray[np.uint8], texts: Mapping[str, str] | None = None, *, small: bool = False
    ) -> Future[Encoded]:
        """See :func:`png`."""
        return self._slow.submit(_timed, "png", lambda: png(picture, texts, small=small))


def _timed(name: str, encode: Callable[[], bytes]) -> Encoded:
    start = clock.perf_counter()
    return Encoded(encode(), name, clock.perf_counter() - start)
