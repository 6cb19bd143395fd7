"""Pictures of parallelograms, by rays through the middles of pixels: for layered images, without OpenGL."""

from typing import NamedTuple

import numpy as np

from mmi.foundation.camera import view_towards
from viewer.layered.layered_image import NOTHING, Picture

WINDOW = (-24, -18, 48, 36)
FOCAL = 40.0


class Sheets(NamedTuple):
    """Parallelograms: corners (n, 3) and sides (n, 2, 3); each is an object of its own."""

    corners: np.ndarray
    sides: np.ndarray

    @property
    def points(self):
        """(4 n, 3) all corners."""
        shares = np.array([(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)])
        return (self.corners[:, None] + np.einsum("kj,njc->nkc", shares, self.sides)).reshape(-1, 3)


def apart(rng, count):
    """``count`` sheets ahead of the origin, looking along +x: slanted, large, and one behind the other so that none meet."""
    corners, sides = [], []
    for k in range(count):
        x = 10.0 + 6.0 * k
        middle = np.array([x, *rng.uniform(-0.4 * x, 0.4 * x, 2)])
        normal = np.array([1.0, *rng.uniform(-1.0, 1.0, 2)])
        one = np.cross(normal, [0.0, 0.0, 1.0])
        other = np.cross(normal, one)
        ways = np.array([one / np.linalg.norm(one), other / np.linalg.norm(other)]) * rng.uniform(2.0, 3.0, (2, 1))
        corners.append(middle - ways.sum(axis=0) / 2.0)
        sides.append(ways)
    return Sheets(np.array(corners), np.array(sides))


def view_at(eye=(0.0, 0.0, 0.0), azimuth=0.0, pitch=0.0, *, window=WINDOW, focal=FOCAL):
    return view_towards(np.array(eye, dtype=np.float64), azimuth, pitch, focal=focal, window=window)


def hits(view, sheets, u, v):
    """Depths (n, ...) at which rays through image points ``u``, ``v`` (...) meet each sheet, infinite for none."""
    ways = view.unproject(u, v, np.ones_like(u)) - view.eye
    found = []
    for corner, (one, other) in zip(sheets.corners, sheets.sides, strict=True):
        matrix = np.stack(np.broadcast_arrays(ways, -one, -other), axis=-1)
        with np.errstate(all="ignore"):
            depth, s, t = np.moveaxis(
                np.linalg.solve(matrix, np.broadcast_to(corner - view.eye, ways.shape)[..., None])[..., 0], -1, 0
            )
        inside = (depth > 0.0) & (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
        found.append(np.where(inside, depth, np.inf))
    return np.array(found)


def color_of(ids):
    """(..., 3) uint8: a color for each object, and black for nothing."""
    some = np.stack([37 * ids + 40, 91 * ids + 11, 53 * ids + 90], axis=-1) % 256
    return np.where((ids >= 0)[..., None], some, 0).astype(np.uint8)


def picture_of(view, sheets):
    """What a renderer draws."""
    u, v = np.meshgrid(*view.pixel_centres())
    depths = hits(view, sheets, u, v)
    depth = depths.min(axis=0).astype(np.float32)
    ids = np.where(np.isfinite(depth), depths.argmin(axis=0), NOTHING).astype(np.int32)
    return Picture(view, color_of(ids), depth, ids)
