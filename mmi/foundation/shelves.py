"""Pictures side by side in one larger picture: on shelves, each as high as its first picture, the highest pictures first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["on_shelves"]


def on_shelves(sizes: NDArray[np.int64], width: int) -> tuple[NDArray[np.int64], tuple[int, int]]:
    """Where pictures of ``sizes`` (n, 2) (width, height) go: upper left corners (n, 2), and the width and height in use.

    A shelf ends where the next picture would pass ``width``; a picture that is wider has a shelf to itself. Pictures of the
    same height keep their order.
    """
    corners = np.zeros((len(sizes), 2), dtype=np.int64)
    x = y = shelf = used = 0
    for i in np.argsort(-sizes[:, 1], kind="stable").tolist():
        wide, high = sizes[i].tolist()
        if x + wide > width:
            x, y, shelf = 0, y + shelf, 0
        corners[i] = x, y
        x, shelf = x + wide, max(shelf, high)
        used = max(used, x)
    return corners, (used, y + shelf)
