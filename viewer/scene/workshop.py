"""Things that are made once of a scene, when they are first asked for, and shared by all techniques of all its viewers."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

__all__ = ["Workshop"]

_Made = TypeVar("_Made")


class Workshop:
    """Keeps what was made, as long as its scene is there. Any thread may ask."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._made: dict[Hashable, Any] = {}

    def once(self, key: Hashable, make: Callable[[], _Made]) -> _Made:
        """What ``make`` makes, which is called by the first who asks for ``key``; others wait for it."""
        with self._lock:
            if key not in self._made:
                self._made[key] = make()
            made: _Made = self._made[key]
            return made
