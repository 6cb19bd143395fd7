"""How often Python's threads take turns: the loading thread is to disturb no frame, and a frame is not to wait for it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["turns_after"]


@contextmanager
def turns_after(seconds: float) -> Iterator[None]:
    """Within it, a thread that runs may keep the interpreter for so long when another one wants it."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(seconds)
    try:
        yield
    finally:
        sys.setswitchinterval(before)
