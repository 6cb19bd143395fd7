"""How thick a region of a picture is: the diameter of the largest disc inside it.

What a viewer notices of wrong pixels is how thick the regions are that they form; shares of a picture say little.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

__all__ = ["largest_disc", "thickness"]


def thickness(region: NDArray[np.bool_]) -> float:
    """Diameter in pixels of the largest disc inside ``region`` (h, w); 0 where it is empty. See :func:`largest_disc`."""
    return largest_disc(region)[0]


def largest_disc(region: NDArray[np.bool_]) -> tuple[float, tuple[float, float]]:
    """Diameter and centre (row, column) in pixels of the largest disc inside ``region`` (h, w), pixels taken as unit squares.

    Discs are centred on pixel centres, edges and corners, so that a strip n pixels wide is n thick for even n as well. What
    the border of the picture cuts off counts as far as it is seen. A slanted strip or a disc, made of the pixels whose
    centres it covers, has steps for an edge, and is as thick as what fits between the steps: up to 2 px less.
    """
    if not region.any():
        return 0.0, (0.0, 0.0)
    padded = np.pad(region, 1)
    # Centres, edges and corners of all pixels on a lattice of half pixels: inside where all pixels around are.
    lattice = np.zeros((2 * region.shape[0] + 1, 2 * region.shape[1] + 1), dtype=bool)
    lattice[1::2, 1::2] = region
    lattice[0::2, 1::2] = padded[:-1, 1:-1] & padded[1:, 1:-1]
    lattice[1::2, 0::2] = padded[1:-1, :-1] & padded[1:-1, 1:]
    lattice[0::2, 0::2] = padded[:-1, :-1] & padded[1:, :-1] & padded[:-1, 1:] & padded[1:, 1:]
    distances = distance_transform_edt(lattice)
    row, column = np.unravel_index(int(np.argmax(distances)), distances.shape)
    return float(distances[row, column]), (0.5 * row, 0.5 * column)
