"""The ground that towns stand on: hills and waves as a height field, and the field of directions that contours give streets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from citygen.streets.subdivision import Field
from mmi.city.terrain import Terrain

__all__ = ["Hill", "contour_field", "ground_under", "make_terrain"]


@dataclass(frozen=True, slots=True)
class Hill:
    """A round or long rise: ``height`` and ``radii`` at which it has fallen by two fifths, metres; ``angle`` of the first."""

    centre: tuple[float, float]
    height: float
    radii: tuple[float, float]
    angle: float = 0.0


def make_terrain(
    bounds: tuple[float, float, float, float],
    hills: tuple[Hill, ...],
    rng: np.random.Generator,
    *,
    roughness: float,
    spacing: float = 8.0,
) -> Terrain:
    """Ground over ``bounds`` (min x, min y, max x, max y): hills, and random waves ``roughness`` metres high.

    Waves are long (150 m or more), so the ground has no pits smaller than a building. The lowest point is at height 0.
    """
    columns, rows = (int(np.ceil((bounds[k + 2] - bounds[k]) / spacing)) + 1 for k in (0, 1))
    x, y = np.meshgrid(bounds[0] + spacing * np.arange(columns), bounds[1] + spacing * np.arange(rows))
    heights = np.zeros_like(x)
    for hill in hills:
        cos, sin = np.cos(hill.angle), np.sin(hill.angle)
        dx, dy = x - hill.centre[0], y - hill.centre[1]
        u, v = (cos * dx + sin * dy) / hill.radii[0], (cos * dy - sin * dx) / hill.radii[1]
        heights += hill.height * np.exp(-0.5 * (u * u + v * v))
    for length in np.geomspace(150.0, 900.0, 9):
        angle, phase = rng.uniform(0.0, 2.0 * np.pi, 2)
        wave = np.sin(2.0 * np.pi * (np.cos(angle) * x + np.sin(angle) * y) / length + phase)
        heights += roughness / 3.0 * (length / 900.0) * wave
    return Terrain((bounds[0], bounds[1]), spacing, np.round(heights - heights.min(), 3))


def contour_field(terrain: Terrain, *, plain: float, slope: float) -> Field:
    """Directions along contours where the ground rises more than ``slope`` a metre, towards ``plain`` (radians) elsewhere."""
    north, east = (np.asarray(np.gradient(terrain.heights, terrain.spacing, axis=k)) for k in (0, 1))
    # A cross looks the same after a quarter turn: average four times the angles.
    weight = (np.square(north) + np.square(east)) / slope**2
    angles = np.angle(weight * np.exp(4j * np.arctan2(north, east)) + np.exp(4j * plain)) / 4.0
    last = np.array(angles.shape[::-1]) - 1

    def field(points: NDArray[np.float64]) -> NDArray[np.float64]:
        places = np.rint((points - terrain.origin) / terrain.spacing)
        i, j = np.minimum(np.maximum(places, 0), last).astype(np.int64).T
        return np.asarray(angles[j, i])

    return field


def ground_under(
    terrain: Terrain | None, footprints: NDArray[np.object_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lowest and highest ground (n,) under the outlines of footprints (n,), metres; 0 without terrain."""
    if terrain is None or not len(footprints):
        return np.zeros(len(footprints)), np.zeros(len(footprints))
    return terrain.under(footprints)
