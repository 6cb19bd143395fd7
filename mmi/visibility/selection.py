"""The pipeline of geometry extractors (paper section 5.2, figure 6): which of a city's objects a cell still deals with.

Visibility culling narrows ``objects``, segmentation marks some of them ``near``; a stage is a plain callable from one
:class:`Selection` to the next, and :func:`chain` makes one stage of several.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mmi.cells.viewing_cells import ViewingCell
from mmi.city.model import City

__all__ = ["Extractor", "Selection", "WallVisibility", "chain", "everything", "narrowed"]


@dataclass(frozen=True, slots=True, eq=False)
class WallVisibility:
    """What a cell may see of a city's walls (in the order of :func:`mmi.visibility.walls.walls_of`), and from where.

    ``lowest`` (w,) metres: nothing of a wall below this height can be seen (-inf: nothing hides it, inf: it is hidden).
    ``bits`` (w,) uint64: bit i is set where it may be seen from within bin i, of the ``bins`` equal stretches of the cell's
    outline (counter-clockwise from its first corner), or from inside through that.
    """

    lowest: NDArray[np.float64]
    bits: NDArray[np.uint64]
    bins: int

    def __post_init__(self) -> None:
        self.lowest.setflags(write=False)
        self.bits.setflags(write=False)


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """Objects of ``city`` as seen from ``cell``: indices into ``city.objects``, sorted, without repeats.

    ``objects`` (n,) is what may be visible; ``near`` (k,) are those of them that stay geometry; ``far`` is the rest.
    ``wall_visibility`` tells what of their walls may be visible, ``parallax`` (n,) how far they may part within themselves
    (radians; infinite for what was near already), where a stage found that out.
    """

    city: City
    cell: ViewingCell
    objects: NDArray[np.int64]
    near: NDArray[np.int64]
    wall_visibility: WallVisibility | None = None
    parallax: NDArray[np.float64] | None = None
    far: NDArray[np.int64] = field(init=False)

    def __post_init__(self) -> None:
        objects = np.unique(np.asarray(self.objects, dtype=np.int64))
        near = np.unique(np.asarray(self.near, dtype=np.int64))
        if objects.size and not (0 <= objects[0] and objects[-1] < len(self.city.objects)):
            raise IndexError(f"selection needs indices in [0, {len(self.city.objects)}), found {objects[[0, -1]]}")
        if not np.isin(near, objects).all():
            raise ValueError("near objects must be among the selected objects")
        far = np.setdiff1d(objects, near, assume_unique=True)
        for name, value in (("objects", objects), ("near", near), ("far", far)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)


Extractor = Callable[[Selection], Selection]


def chain(*extractors: Extractor) -> Extractor:
    """One extractor that applies ``extractors`` from left to right."""

    def run(selection: Selection) -> Selection:
        for extract in extractors:
            selection = extract(selection)
        return selection

    return run


def everything(city: City, cell: ViewingCell) -> Selection:
    """The start of every pipeline: all objects, none of them near."""
    return Selection(city, cell, np.arange(len(city.objects)), np.empty(0, dtype=np.int64))


def narrowed(selection: Selection, visible: NDArray[np.int64]) -> Selection:
    """The selection less all objects but those of ``visible`` (k,)."""
    return Selection(
        selection.city,
        selection.cell,
        np.intersect1d(selection.objects, visible),
        np.intersect1d(selection.near, visible),
    )
