"""Where images of boxes are on the GPU: a few atlases, within a number of bytes; who was shown least recently gives way."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from viewer.caching.slots import Place, Slots
from viewer.plan import ImageKey, Slot

__all__ = ["TEXEL_BYTES", "Atlases"]

TEXEL_BYTES = 16
"""Colour, depth, object and depth buffer of a texel (``viewer.drawing.images``)."""
_SIDE = 1024
"""Texels of a side of an atlas, where the bytes suffice for one."""
_LEAST = 16


class Atlases:
    """Places for images of nodes, the largest of which have ``largest`` texels a side, in ``most_bytes`` at most.

    An atlas serves one generation; ``forget`` is told of a node whose place is given to another.
    """

    def __init__(self, owner: str, *, largest: int, most_bytes: int, forget: Callable[[int], None]) -> None:
        side = max(_SIDE, largest)
        while side > largest and side * side * TEXEL_BYTES > most_bytes:
            side //= 2
        self._owner, self._side, self._largest, self._forget = owner, side, largest, forget
        self._most = most_bytes // (side * side * TEXEL_BYTES)
        self._slots: list[Slots] = []
        self._generations: list[int] = []
        self._places: dict[int, tuple[int, Place]] = {}
        self._idle: dict[int, list[int]] | None = None
        self._idle_in = -1

    @property
    def bytes(self) -> int:
        """What all atlases take."""
        return len(self._slots) * self._side**2 * TEXEL_BYTES

    @property
    def images(self) -> tuple[ImageKey, ...]:
        """All atlases."""
        return tuple(self._key(number) for number in range(len(self._slots)))

    def take(
        self, node: int, size: tuple[int, int], generation: int, used: NDArray[np.int64], frame: int
    ) -> Slot | None:
        """A place of ``size`` texels for a node's image, instead of the one that it had.

        Where none is free, those of nodes that were ``used`` (n,) longest ago, and not in this ``frame``, are given up. None
        where that does not help.
        """
        self.drop(node)
        slot = self._free(node, size, generation)
        if frame != self._idle_in:
            self._idle_in, self._idle = frame, None
        while slot is None:
            one = self._longest_idle(generation, used, frame)
            if one is None:
                return None
            self.drop(one)
            self._forget(one)
            slot = self._free(node, size, generation)
        return slot

    def _longest_idle(self, generation: int, used: NDArray[np.int64], frame: int) -> int | None:
        """Of nodes that were not needed in this frame the one that was needed longest ago; those of a generation come first."""
        if self._idle is None:
            order = sorted(self._places, key=lambda one: (int(used[one]), one), reverse=True)
            self._idle = {}
            for one in order:
                self._idle.setdefault(self._generations[self._places[one][0]], []).append(one)
        for of in (generation, *(other for other in self._idle if other != generation)):
            waiting = self._idle.get(of, [])
            while waiting:
                one = waiting.pop()
                if one in self._places and used[one] < frame:
                    return one
        return None

    def drop(self, node: int) -> None:
        """Give back a node's place; nothing where it has none."""
        if node in self._places:
            number, place = self._places.pop(node)
            self._slots[number].give_back(place)

    def _free(self, node: int, size: tuple[int, int], generation: int) -> Slot | None:
        if max(size) > self._largest:
            return None
        for number, slots in enumerate(self._slots):
            if self._generations[number] != generation and slots.is_empty:
                self._generations[number] = generation
            if self._generations[number] == generation:
                place = slots.take(*size)
                if place is not None:
                    self._places[node] = (number, place)
                    return self._slot(number, place)
        if len(self._slots) >= self._most:
            return None
        self._slots.append(Slots(size=self._side, page=self._largest, least=min(_LEAST, self._largest)))
        self._generations.append(generation)
        return self._free(node, size, generation)

    def _slot(self, number: int, place: Place) -> Slot:
        return Slot(self._key(number), (self._side, self._side), place.corner)

    def _key(self, number: int) -> ImageKey:
        return ImageKey(self._owner, f"boxes {number}")
