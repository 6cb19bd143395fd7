"""Names that stay different: a name that is taken gets a number, in time that grows with the number of names only."""

from __future__ import annotations

__all__ = ["UniqueNames"]


class UniqueNames:
    """The names that are taken so far."""

    def __init__(self) -> None:
        self._taken: set[str] = set()
        self._next: dict[str, int] = {}

    def free(self, name: str) -> str:
        """``name``, or the first of ``name#2``, ``name#3``, ... that is not taken."""
        if name not in self._taken:
            return name
        # Names are never given back: what was taken when this name came last still is.
        number = self._next.get(name, 2)
        while (numbered := f"{name}#{number}") in self._taken:
            number += 1
        self._next[name] = number
        return numbered

    def take(self, name: str) -> None:
        """From now on ``name`` is taken."""
        self._taken.add(name)
