"""Pixels, angles and rays: the display that an error in pixels refers to, and the pinhole views that captures use.

The only place where pixels become angles. Matrices are ``target_from_source`` and multiply column vectors; the eye looks
down -Z with +Y up; image coordinates run right (u) and down (v) in pixels from the principal point, so that the pixel in
column i and row j covers [i, i + 1) x [j, j + 1) and may well have negative indices.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.errors import ParameterError

__all__ = ["Camera", "View", "level_view", "level_views_around", "view_towards"]


_LARGEST = 1 << 20
"""Pixels that a display has at most across, and up."""


@dataclass(frozen=True, slots=True)
class Camera:
    """The display: ``width`` x ``height`` pixels; ``fov`` is the horizontal field of view in radians.

    An angle in pixels is what it covers at the centre of the picture, where a pixel subtends most.
    """

    width: int
    height: int
    fov: float

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise ParameterError(f"a display needs at least 1x1 pixels, found {self.width}x{self.height}")
        if not max(self.width, self.height) <= _LARGEST:
            raise ParameterError(
                f"a display of at most {_LARGEST} pixels a side expected, found {self.width}x{self.height}"
            )
        if not 0.0 < self.fov < math.pi:
            raise ParameterError(f"a field of view lies between 0 and 180 degrees, found {math.degrees(self.fov):g}")

    @property
    def focal(self) -> float:
        """Focal length in pixels."""
        return 0.5 * self.width / math.tan(0.5 * self.fov)

    @property
    def window(self) -> tuple[int, int, int, int]:
        """The whole picture as a window of the image plane: (left, top, width, height), the principal point in its middle."""
        return (-(self.width // 2), -(self.height // 2), self.width, self.height)

    @property
    def border_pixel(self) -> tuple[float, float]:
        """What a pixel subtends at the left or right border: radians of azimuth, and slope. Elsewhere it is more."""
        aside = math.cos(0.5 * self.fov)
        return aside * aside / self.focal, aside / self.focal

    def angle_from_pixels(self, pixels: float) -> float:
        """Radians that ``pixels`` subtend at the centre of the picture."""
        return math.atan(pixels / self.focal)

    def pixels_from_angle(self, angle: float) -> float:
        """Pixels that ``angle`` (radians) covers from the centre of the picture.

        Pixels grow without bound towards a right angle, so that more than 1.5 radians count as 1.5.
        """
        return self.focal * math.tan(min(angle, 1.5))


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A pinhole picture: ``eye_from_world`` (4, 4), ``focal`` pixels, and the ``window`` of the image plane that it shows.

    ``window`` is (left, top, width, height) in pixels from the principal point.
    """

    eye_from_world: NDArray[np.float64]
    focal: float
    window: tuple[int, int, int, int]

    def __post_init__(self) -> None:
        matrix = np.array(self.eye_from_world, dtype=np.float64)
        if matrix.shape != (4, 4):
            raise ParameterError(f"eye_from_world needs shape (4, 4), found {matrix.shape}")
        if self.window[2] < 1 or self.window[3] < 1 or not self.focal > 0.0:
            raise ParameterError(f"a view needs a window and a focal length, found {self.window}, {self.focal}")
        matrix.setflags(write=False)
        object.__setattr__(self, "eye_from_world", matrix)

    @property
    def world_from_eye(self) -> NDArray[np.float64]:
        """(4, 4), the inverse of ``eye_from_world``."""
        rotation = self.eye_from_world[:3, :3].T
        matrix = np.eye(4)
        matrix[:3, :3] = rotation
        matrix[:3, 3] = -rotation @ self.eye_from_world[:3, 3]
        return matrix

    @property
    def eye(self) -> NDArray[np.float64]:
        """(3,) the viewpoint in the world, metres."""
        return -self.eye_from_world[:3, :3].T @ self.eye_from_world[:3, 3]

    def cropped(self, window: tuple[int, int, int, int]) -> View:
        """The same picture through another window of its image plane."""
        return View(self.eye_from_world, self.focal, window)

    def project(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """World points (..., 3) -> (..., 3): u, v in pixels from the principal point and depth in metres.

        Points behind the eye have negative depth and meaningless u, v; those at depth 0 give infinities.
        """
        eye = points @ self.eye_from_world[:3, :3].T + self.eye_from_world[:3, 3]
        depth = -eye[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            u = self.focal * eye[..., 0] / depth
            v = -self.focal * eye[..., 1] / depth
        return np.stack([u, v, depth], axis=-1)

    def unproject(
        self, u: NDArray[np.float64], v: NDArray[np.float64], depth: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """The inverse of :meth:`project`: u, v (pixels) and depth (metres), each (...) -> world points (..., 3)."""
        u, v, depth = np.broadcast_arrays(u, v, depth)
        eye = np.stack([u / self.focal * depth, -v / self.focal * depth, -depth], axis=-1)
        return (eye - self.eye_from_world[:3, 3]) @ self.eye_from_world[:3, :3]

    def pixel_centres(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """u (width,) and v (height,) of the window's pixel centres."""
        left, top, width, height = self.window
        return np.arange(left, left + width) + np.float64(0.5), np.arange(top, top + height) + np.float64(0.5)


def view_towards(
    eye: NDArray[np.float64], azimuth: float, pitch: float, *, focal: float, window: tuple[int, int, int, int]
) -> View:
    """A view from ``eye`` (3,) towards ``azimuth`` (radians, counter-clockwise from +X), turned up by ``pitch`` (radians).

    Verticals stay upright in the middle of the picture: there is no roll. Raises ParameterError unless |pitch| is below a
    right angle.
    """
    if not abs(pitch) < 0.5 * math.pi:
        raise ParameterError(f"a pitch between -90 and 90 degrees expected, found {math.degrees(pitch):g}")
    cos, sin, level, steep = math.cos(azimuth), math.sin(azimuth), math.cos(pitch), math.sin(pitch)
    rotation = np.array([[sin, -cos, 0.0], [-cos * steep, -sin * steep, level], [-cos * level, -sin * level, -steep]])
    eye_from_world = np.eye(4)
    eye_from_world[:3, :3] = rotation
    eye_from_world[:3, 3] = -rotation @ np.asarray(eye, dtype=np.float64)
    return View(eye_from_world, focal, window)


def level_view(eye: NDArray[np.float64], azimuth: float, *, focal: float, window: tuple[int, int, int, int]) -> View:
    """:func:`view_towards` with a level line of sight."""
    return view_towards(eye, azimuth, 0.0, focal=focal, window=window)


def level_views_around(
    eye: NDArray[np.float64], count: int, *, focal: float, window: tuple[int, int, int, int]
) -> tuple[View, ...]:
    """``count`` level views from ``eye`` (3,), evenly spread all around: the first towards +X, then counter-clockwise."""
    return tuple(level_view(eye, 2.0 * math.pi / count * i, focal=focal, window=window) for i in range(count))
