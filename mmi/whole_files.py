"""Files that are there whole or not at all: written under a temporary name in the same folder, then renamed."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mmi.errors import CityError, MmiError

__all__ = ["png_bytes", "whole_file"]


@contextmanager
def whole_file(path: Path, *, error: type[MmiError] = CityError) -> Iterator[BinaryIO]:
    """A file to write to, which becomes ``path`` when the block ends well and vanishes otherwise; makes its folder.

    Raises ``error`` where it cannot be written.
    """
    temporary = path.with_name(f"{path.name}.part-{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("wb") as file:
            yield file
        temporary.replace(path)
    except BaseException as reason:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        if isinstance(reason, OSError):
            raise error(f"{path}: a writable file expected, found: {reason.strerror or reason}") from reason
        raise


def png_bytes(pixels: NDArray[np.uint8], *, quick: bool = False) -> bytes:
    """Pixels (h, w, 3) as PNG; the same pixels give the same bytes. ``quick``: rather than small."""
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(buffer, format="png", compress_level=1 if quick else -1)
    return buffer.getvalue()
