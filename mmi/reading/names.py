"""Names: bytes of an unknown encoding become text that is valid Unicode, and names that are equal get numbers."""

from __future__ import annotations

__all__ = ["UniqueNames", "readable_name", "valid_text"]


def readable_name(name: bytes) -> str:
    r"""The bytes as text: UTF-8, else Windows-1252, else with ``\x93`` for each byte that is not ASCII.

    Different bytes of one encoding give different texts. What was written in another encoding (Shift-JIS, GBK) cannot be
    told, so it comes out as letters of Windows-1252 or as numbers.
    """
    for encoding in ("utf-8", "cp1252"):
        try:
            return name.decode(encoding)
        except UnicodeDecodeError:
            pass
    return name.decode("ascii", errors="backslashreplace")


def valid_text(text: str) -> str:
    r"""The text with halves of surrogate pairs, which JSON can name and no encoding has, written out as ``\ud800``."""
    return text.encode("utf-8", errors="backslashreplace").decode("utf-8")


class UniqueNames:
    """The names that are taken so far. The time to find a free one does not grow with their number."""

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
