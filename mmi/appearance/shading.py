"""Light, and the looks that an object without its own gets: one sun, the open sky, a style and a tint by its id.

Light is baked into vertex colours, which multiply textures (both are sRGB bytes, multiplied as they are).
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from mmi.appearance import facades
from mmi.city.model import CityObject

__all__ = ["SKYLIGHT", "SKY_GAIN", "SKY_SHARES", "SUN", "SUNLIGHT", "Looks", "contact", "light", "looks_of"]

SUN = np.array([-0.45, -0.62, 0.64]) / math.sqrt(0.45**2 + 0.62**2 + 0.64**2)
"""(3,) towards it: south-west, on an afternoon."""
SUNLIGHT = np.array([0.44, 0.41, 0.35])
"""(3,) what it adds to a surface that faces it."""
SKYLIGHT = np.array([0.70, 0.72, 0.76])
"""(3,) what the sky adds to a surface, before it is multiplied by what of it the surface faces."""
SKY_SHARES = (0.80, 0.20)
"""What of the sky every surface faces, and what goes with the upward part of its normal; times ``SKY_GAIN``."""
SKY_GAIN = 1.02
_CONTACT = 0.24  # light lost at the foot of a wall, fading with height
_CONTACT_HEIGHT = 5.0

_TINTS = tuple(
    np.array(tints)
    for tints in (
        (
            (1.0, 0.99, 0.97),
            (1.0, 0.95, 0.84),
            (0.97, 0.90, 0.80),
            (0.93, 0.93, 0.92),
            (1.0, 0.92, 0.86),
            (0.90, 0.93, 0.95),
        ),
        (
            (1.0, 1.0, 1.0),
            (0.90, 0.86, 0.84),
            (1.0, 1.0, 0.90),
            (0.82, 0.80, 0.80),
            (1.0, 0.93, 0.88),
            (0.95, 1.0, 1.0),
        ),
        (
            (1.0, 1.0, 1.0),
            (0.92, 0.92, 0.94),
            (1.0, 0.97, 0.91),
            (0.86, 0.87, 0.88),
            (0.97, 0.93, 0.90),
            (0.94, 0.97, 0.95),
        ),
        (
            (1.0, 1.0, 1.0),
            (0.88, 0.95, 0.98),
            (0.92, 1.0, 0.97),
            (0.84, 0.87, 0.92),
            (1.0, 0.97, 0.92),
            (0.94, 0.94, 0.94),
        ),
    )
)  # per style, six to choose from

# Share of the four styles, cumulated, for houses, wide low buildings, tall ones and towers.
_STYLE_SHARES = np.array(
    [[0.55, 0.88, 1.0, 1.0], [0.35, 0.60, 0.90, 1.0], [0.10, 0.30, 0.70, 1.0], [0.0, 0.10, 0.40, 1.0]]
)


@dataclass(frozen=True, slots=True, eq=False)
class Looks:
    """What an object's id, height and area decide: ``style`` (k,) index, ``tint`` (k, 3) factor, ``bay`` (k,) 0..7.

    Objects with the same number in ``whole`` (k,) are parts of one. ``plain``: no wall has windows or doors.
    """

    whole: NDArray[np.int64]
    style: NDArray[np.int64]
    tint: NDArray[np.float64]
    bay: NDArray[np.int64]
    plain: bool


def looks_of(objects: Sequence[CityObject], *, plain: bool = False) -> Looks:
    """Styles, tints and first bays, from digests of the ids, so that other objects change nothing.

    Parts of one object (``CityObject.part_of``) look as the whole did.
    """
    names, whole = np.unique([one.part_of or one.id for one in objects], return_inverse=True)
    digests = b"".join(hashlib.blake2b(str(name).encode(), digest_size=8).digest() for name in names)
    dice = np.frombuffer(digests, dtype=np.uint8).reshape(-1, 8).astype(np.int64)[whole]
    base, top = np.full(len(names), np.inf), np.full(len(names), -np.inf)
    np.minimum.at(base, whole, [one.base for one in objects])
    np.maximum.at(top, whole, [one.top for one in objects])
    height = (top - base)[whole]
    area = np.bincount(whole, shapely.area([one.footprint for one in objects]), minlength=len(names))[whole]
    size = np.where(height > 60.0, 3, np.where(height > 30.0, 2, np.where(area > 1800.0, 1, 0))).astype(np.int64)
    style = (dice[:, :1] / 256.0 >= _STYLE_SHARES[size]).sum(axis=1)
    tint = np.stack(_TINTS)[style, dice[:, 1] % 6] * (0.93 + 0.07 * dice[:, 2:3] / 255.0)
    return Looks(whole, style, tint, dice[:, 3] % facades.BAYS, plain)


def light(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) unit normals -> (n, 3) factors: the sun's cosine, and as much of the sky as the surface faces."""
    sky = SKY_SHARES[0] + SKY_SHARES[1] * normals[:, 2:]
    return np.minimum(SUNLIGHT * np.maximum(normals @ SUN, 0.0)[:, None] + SKYLIGHT * sky * SKY_GAIN, 1.0)


def contact(above_ground: NDArray[np.float64]) -> NDArray[np.float64]:
    """Factor by height above ground in metres: streets are darker than roofs."""
    return 1.0 - _CONTACT * np.exp(-np.maximum(above_ground, 0.0) / _CONTACT_HEIGHT)
