"""What the weight of a pair of far objects is: the functions behind ``--weights``, all of one form.

A weight function takes a :class:`FarField` and returns pairs (m, 2), indices into its ``objects``, and their weights (m,) in
radians. Pairs that it does not list weigh nothing. ``examples/a_weight_of_ones_own.py`` is one from outside the package.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mmi.cells.viewing_cells import ViewingCell
from mmi.city.model import City
from mmi.foundation.camera import Camera
from mmi.foundation.errors import ParameterError
from mmi.parallax.paper_weights import critical_zone_weights
from mmi.parallax.ray_weights import same_ray_weights
from mmi.planning.choices import Choice, blaming
from mmi.visibility.selection import WallVisibility
from mmi.visibility.walls import Walls

__all__ = ["FarField", "critical_zone", "critical_zone_unsigned", "same_ray", "weigh"]

_FINEST_QUAD = 8
"""Texels: rays this close to each other count as one, since a mesh connects them."""


@dataclass(frozen=True, slots=True, eq=False)
class FarField:
    """What a weight function is told: a cell, and the far objects that it may see.

    ``objects`` (n,) are indices into ``city.objects``, sorted. ``walls`` are those of the whole city; ``wall_visibility`` says
    what of them the cell may see, None where that is not known. ``camera`` is the display that errors are counted on.
    """

    city: City
    cell: ViewingCell
    objects: NDArray[np.int64]
    walls: Walls
    wall_visibility: WallVisibility | None
    camera: Camera


def same_ray(far: FarField) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """How far points of one capture ray part (:mod:`mmi.parallax.ray_weights`), which bounds what a layer gets wrong."""
    quad = _FINEST_QUAD / far.camera.focal
    return same_ray_weights(far.cell, far.walls, far.objects, far.wall_visibility, quad=quad)


def critical_zone(far: FarField) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The paper's weights (:mod:`mmi.parallax.paper_weights`), with signed angles."""
    return critical_zone_weights(far.cell, [far.city.objects[i] for i in far.objects])


def critical_zone_unsigned(far: FarField) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The paper's weights with unsigned angles, which do not see left and right change places."""
    return critical_zone_weights(far.cell, [far.city.objects[i] for i in far.objects], signed=False)


def weigh(choice: Choice, function: Callable[..., Any], far: FarField) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """What the ``function`` of a choice says of ``far``, checked where it is from outside the package.

    Raises ParameterError where such a function fails, or returns something else than pairs of different objects, each once,
    and a weight for each.
    """
    n, name = len(far.objects), f"weights {choice.name}"
    with blaming(choice, what="weights"):
        pairs, weights = function(far)
        pairs, weights = np.asarray(pairs).reshape(-1, 2), np.asarray(weights, dtype=np.float64)
    if choice.version is None:
        return pairs, weights
    if pairs.size or weights.size:
        if weights.shape != (len(pairs),):
            raise ParameterError(f"{name}: one for each of {len(pairs)} pairs expected, found shape {weights.shape}")
        if pairs.dtype.kind not in "iu" or pairs.min() < 0 or pairs.max() >= n or (pairs[:, 0] == pairs[:, 1]).any():
            raise ParameterError(f"{name}: pairs of two different numbers from 0 to {n - 1} expected, found others")
        if len(np.unique(np.sort(pairs, axis=1), axis=0)) < len(pairs):
            raise ParameterError(f"{name}: each pair once expected, found one again")
        if not (weights >= 0.0).all():
            raise ParameterError(f"{name}: numbers of 0 or more expected, found {weights.min()}")
    return pairs.astype(np.int64), weights
