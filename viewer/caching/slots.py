"""Places of small pictures in one large one: rectangles of a few sizes, given out and taken back."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["Place", "Slots"]

_Size = tuple[int, int]


class Place(NamedTuple):
    """A rectangle of ``size`` (width, height) texels whose upper left corner is at ``corner`` (x, y)."""

    size: tuple[int, int]
    corner: tuple[int, int]


class Slots:
    """Rectangles in an image of ``size`` texels a side, which is cut into pages of ``page`` texels a side.

    Sides of rectangles are ``page`` texels long, or half, a quarter and so on of them down to ``least``; a page holds
    rectangles of one size. One that has become empty serves rectangles of any size again.
    """

    def __init__(self, *, size: int, page: int, least: int) -> None:
        self.size, self._page, self._least = size, page, least
        self._pages = [(x, y) for y in range(0, size, page) for x in range(0, size, page)][::-1]
        self._free: dict[tuple[int, int], set[Place]] = {}
        self._sizes: dict[tuple[int, int], _Size] = {}

    @property
    def is_empty(self) -> bool:
        """Whether nobody has a rectangle."""
        return not self._free

    def size_for(self, width: int, height: int) -> _Size | None:
        """Of the sizes that there are, the smallest that has room for so many texels; None where none has."""
        if max(width, height) > self._page:
            return None
        return self._side(width), self._side(height)

    def take(self, width: int, height: int) -> Place | None:
        """A free rectangle with room for so many texels, or None where none is left."""
        size = self.size_for(width, height)
        if size is None:
            return None
        for page, free in self._free.items():
            if self._sizes[page] == size and free:
                place = min(free)
                free.remove(place)
                return place
        if not self._pages:
            return None
        x, y = page = self._pages.pop()
        self._sizes[page] = size
        columns, rows = (range(0, self._page, side) for side in size)
        self._free[page] = {Place(size, (x + column, y + row)) for row in rows for column in columns}
        return self.take(width, height)

    def give_back(self, place: Place) -> None:
        """Let others have a rectangle that was taken."""
        x, y = place.corner
        page = (x - x % self._page, y - y % self._page)
        self._free[page].add(place)
        if len(self._free[page]) == self._page**2 // (place.size[0] * place.size[1]):
            del self._free[page], self._sizes[page]
            self._pages.append(page)

    def _side(self, needed: int) -> int:
        side = self._least
        while side < needed:
            side *= 2
        return side
