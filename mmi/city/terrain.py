"""The ground as a height field: a square grid of heights, bilinear in between, level beyond its border.

One kind of terrain whatever it came from: triangulated surfaces, rasters and loose points are sampled into it
(``mmi.reading.read_city.terrain``). Along the lines of the grid it is piecewise linear, so a surface cut there follows it
exactly on them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from mmi.foundation.errors import CityError

__all__ = ["Terrain", "grid_triangles"]

_SAMPLE = 2.0
"""Metres between the points of an outline where the ground below it is looked at."""


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """``heights`` (rows, columns), metres: ``heights[j, i]`` is at ``origin + spacing * (i, j)``; at least 2 x 2, finite."""

    origin: tuple[float, float]
    spacing: float
    heights: NDArray[np.float64]

    def __post_init__(self) -> None:
        heights = np.ascontiguousarray(self.heights, dtype=np.float64)
        if heights.ndim != 2 or min(heights.shape) < 2 or not np.isfinite(heights).all():
            raise CityError(f"a terrain needs finite heights, 2 x 2 or more, found shape {heights.shape}")
        if not (self.spacing > 0.0 and np.isfinite([*self.origin, self.spacing]).all()):
            raise CityError(
                f"a terrain needs a finite origin and positive spacing, found {self.origin}, {self.spacing}"
            )
        heights.setflags(write=False)
        object.__setattr__(self, "heights", heights)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(min x, min y, max x, max y), metres."""
        rows, columns = self.heights.shape
        x, y = self.origin
        return x, y, x + self.spacing * (columns - 1), y + self.spacing * (rows - 1)

    @property
    def points(self) -> NDArray[np.float64]:
        """(rows, columns, 3) the points of the grid, metres."""
        y, x = np.indices(self.heights.shape)
        plan = np.array(self.origin) + self.spacing * np.stack([x, y], axis=-1)
        return np.concatenate([plan, self.heights[..., None]], axis=-1)

    def at(self, points: ArrayLike) -> NDArray[np.float64]:
        """Heights (...) at ``points`` (..., 2 or more: x, y first); beyond the border, those of its nearest point."""
        points = np.asarray(points, dtype=np.float64)
        last = np.array(self.heights.shape[::-1]) - 1
        place = np.clip((points[..., :2] - self.origin) / self.spacing, 0.0, last)
        corner = np.minimum(place.astype(np.int64), last - 1)
        s, t = np.moveaxis(place - corner, -1, 0)
        i, j = np.moveaxis(corner, -1, 0)
        h = self.heights
        low = h[j, i] * (1.0 - s) + h[j, i + 1] * s
        high = h[j + 1, i] * (1.0 - s) + h[j + 1, i + 1] * s
        return np.asarray(low * (1.0 - t) + high * t)

    def range_over(self, bounds: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lowest and highest ground (n,) in boxes (n, 4: min x, min y, max x, max y); exact to the squares that they touch."""
        boxes = np.asarray(bounds, dtype=np.float64).reshape(-1, 4)
        last = np.array(self.heights.shape[::-1]) - 1
        first = np.clip(np.floor((boxes[:, :2] - self.origin) / self.spacing), 0, last).astype(np.int64)
        end = np.clip(np.ceil((boxes[:, 2:] - self.origin) / self.spacing), 0, last).astype(np.int64)
        spans = [self.heights[a[1] : b[1] + 1, a[0] : b[0] + 1] for a, b in zip(first, end, strict=True)]
        return np.array([span.min() for span in spans]), np.array([span.max() for span in spans])

    def under(self, footprints: NDArray[np.object_]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lowest and highest ground (n,) under the outlines of polygons (n,), looked at every ``_SAMPLE`` metres."""
        heights, starts = self.at_corners(shapely.segmentize(footprints, _SAMPLE))
        return np.minimum.reduceat(heights, starts), np.maximum.reduceat(heights, starts)

    def at_corners(self, shapes: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Heights (n,) at the corners of shapes (k,), none of them empty, shape after shape, and where each begins (k,)."""
        points, of = shapely.get_coordinates(shapes, return_index=True)
        return self.at(points), np.searchsorted(of, np.arange(np.size(shapes)))


def grid_triangles(index: NDArray[np.int64]) -> NDArray[np.int64]:
    """(2 m, 3) triangles of the squares between points of a grid that are numbered ``index`` (rows, columns)."""
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    return np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
