"""The walls of a city as arrays, sorted by object: what visibility, parallax and windows are computed over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mmi.city.model import City
from mmi.city.outlines import outlines_of
from mmi.city.ranges import numbers_in

__all__ = ["Walls", "walls_of"]


@dataclass(frozen=True, slots=True, eq=False)
class Walls:
    """Every wall of a city: from ``a`` (n, 2) to ``b`` (n, 2), between heights ``bottom`` and ``top`` (n,), metres.

    Sorted by object: object i owns walls ``first[i]`` to ``first[i + 1]``.
    """

    a: NDArray[np.float64]
    b: NDArray[np.float64]
    bottom: NDArray[np.float64]
    top: NDArray[np.float64]
    first: NDArray[np.int64]

    def of(self, objects: NDArray[np.int64]) -> NDArray[np.int64]:
        """Indices of the walls of ``objects``, object after object."""
        return numbers_in(self.first[objects], self.first[objects + 1])


def walls_of(city: City) -> Walls:
    """The walls of all prisms of all objects, courtyards included."""
    prisms = [(i, prism) for i, one in enumerate(city.objects) for prism in one.prisms]
    outlines = outlines_of([prism.footprint for _, prism in prisms])
    prism_of_wall = outlines.polygon[outlines.edge_rings]
    owner = np.array([i for i, _ in prisms], dtype=np.int64)[prism_of_wall]
    bottom = np.array([prism.bottom for _, prism in prisms])[prism_of_wall]
    top = np.array([prism.top for _, prism in prisms])[prism_of_wall]
    first = np.searchsorted(owner, np.arange(len(city.objects) + 1))
    arrays = (*outlines.edges, bottom, top, first)
    for array in arrays:
        array.setflags(write=False)
    return Walls(*arrays)
