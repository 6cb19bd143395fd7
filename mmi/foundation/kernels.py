"""Compiled functions: what Numba translates, and where the translations are kept.

They are kept beside the modules or in the user's cache folder, or in ``NUMBA_CACHE_DIR`` where that is set, so that only
the first process waits for the compiler. Where none of these can be written, as in a container whose files are read-only and
which has no home, every process compiles for itself.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from numba import config, njit

__all__ = ["kernel"]

_Function = TypeVar("_Function", bound=Callable[..., Any])


def kernel(
    *, error_model: str = "python", fastmath: bool = False, nogil: bool = False, inline: str = "never"
) -> Callable[[_Function], _Function]:
    """A decorator: the function, compiled by Numba when it is first called with arguments of a kind, without Python's objects.

    The options are Numba's. In the error model ``numpy`` a division by zero gives what it gives in NumPy, and no exception.
    """

    def compiled(function: _Function) -> _Function:
        translated: Any = njit  # its types differ between versions
        options = {"error_model": error_model, "fastmath": fastmath, "nogil": nogil, "inline": inline}
        beside = Path(function.__code__.co_filename).parent
        keep = bool(getattr(config, "CACHE_DIR", "")) or _has_a_home() or _is_writable(beside)
        made: _Function
        try:
            made = translated(function, cache=keep, **options)
        except RuntimeError:  # nowhere to keep it
            made = translated(function, **options)
        return made

    return compiled


def _has_a_home() -> bool:
    """False for a user without ``HOME`` whom the system does not know: Numba would make a folder called ``~`` here."""
    try:
        Path.home()
    except RuntimeError:
        return bool(os.environ.get("XDG_CACHE_HOME"))
    return True


def _is_writable(folder: Path) -> bool:
    return os.access(folder / "__pycache__" if (folder / "__pycache__").is_dir() else folder, os.W_OK)
