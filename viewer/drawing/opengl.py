"""The OpenGL context of a renderer: headless through EGL, in software (Mesa) or on a GPU."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import moderngl

from mmi.foundation.errors import CaptureError

__all__ = ["finisher", "is_software", "open_context"]

_SOFTWARE = ("llvmpipe", "softpipe", "swrast", "software rasterizer")


def open_context() -> Any:  # noqa: ANN401
    """A context of its own, to be released. Raises CaptureError where there is none to be had."""
    try:
        return moderngl.create_standalone_context(require=330, backend="egl")  # type: ignore[arg-type]
    except Exception as error:  # moderngl raises bare Exceptions
        raise CaptureError(
            f"no OpenGL 3.3 context through EGL ({error}); on Debian or Ubuntu, "
            "'apt-get install libegl1 libgl1-mesa-dri' brings software rendering"
        ) from error


def is_software(device: str) -> bool:
    """Whether a renderer of this name (``GL_RENDERER``) draws on the processor."""
    return any(name in device.lower() for name in _SOFTWARE)


def finisher(context: Any) -> Callable[[], object]:  # noqa: ANN401
    """What waits until everything is drawn, and lets Python's other threads run meanwhile if that is possible.

    Most of a frame is spent waiting there, which is the time that cells are loaded in (``viewer.cells.cell_cache``).
    ``glFinish`` as ctypes calls it lets them run; moderngl's does not, and stands in where the library is not found.
    """
    for name in ("libOpenGL.so.0", "libGL.so.1"):
        with suppress(OSError, AttributeError):
            finish = ctypes.CDLL(name).glFinish
            finish.restype, finish.argtypes = None, ()
            return finish

    def with_lock() -> None:
        context.finish()
        time.sleep(0.0)  # lets other threads in

    return with_lock
