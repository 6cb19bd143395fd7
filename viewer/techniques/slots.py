"""Places of small pictures in one large one: squares of a few sizes, given out and taken back."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["Place", "Slots"]


class Place(NamedTuple):
    """A square of ``side`` texels whose upper left corner is at ``corner`` (x, y)."""

    side: int
    corner: tuple[int, int]


class Slots:
    """Squares in an image of ``size`` texels a side, which is cut into pages of ``page`` texels a side.

    Squares have ``page`` texels a side, or half, a quarter and so on of them down to ``least``; a page holds squares of one
    size. One that has become empty serves squares of any size again.
    """

    def __init__(self, *, size: int, page: int, least: int) -> None:
        self.size, self._page, self._least = size, page, least
        self._pages = [(x, y) for y in range(0, size, page) for x in range(0, size, page)][::-1]
        self._free: dict[tuple[int, int], set[Place]] = {}
        self._sides: dict[tuple[int, int], int] = {}

    def side(self, needed: int) -> int | None:
        """Of the sides that there are, the smallest that is at least ``needed``; None where none is."""
        side = self._least
        while side < needed:
            side *= 2
        return side if side <= self._page else None

    def take(self, needed: int) -> Place | None:
        """A free square with a side of at least ``needed`` texels, or None where none is left."""
        side = self.side(needed)
        if side is None:
            return None
        for page, free in self._free.items():
            if self._sides[page] == side and free:
                place = min(free)
                free.remove(place)
                return place
        if not self._pages:
            return None
        page = self._pages.pop()
        steps = range(0, self._page, side)
        self._sides[page] = side
        self._free[page] = {Place(side, (page[0] + x, page[1] + y)) for y in steps for x in steps}
        return self.take(needed)

    def give_back(self, place: Place) -> None:
        """Let others have a square that was taken."""
        x, y = place.corner
        page = (x - x % self._page, y - y % self._page)
        self._free[page].add(place)
        if len(self._free[page]) == (self._page // place.side) ** 2:
            del self._free[page], self._sides[page]
            self._pages.append(page)
