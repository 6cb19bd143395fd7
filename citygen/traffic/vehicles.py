"""What drives: shapes of cars, a van, a bus and trucks, each part in one colour, standing on z = 0 and heading along +x."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from citygen.shapes.solids import Piece, box, compacted, hexahedra, join, lathe, placed
from mmi.city.model import TriangleMesh

__all__ = ["KINDS", "VehicleKind", "vehicle_mesh"]

_GLASS = (52, 62, 72)
_TYRE = (34, 34, 36)


@dataclass(frozen=True, slots=True)
class VehicleKind:
    """``form`` is ``car``, ``van``, ``bus`` or ``truck``; ``length`` and ``width`` metres; ``share`` of the traffic."""

    name: str
    form: str
    length: float
    width: float
    share: float
    color: tuple[int, int, int]


KINDS = (
    VehicleKind("car-red", "car", 4.2, 1.75, 0.2, (170, 40, 38)),
    VehicleKind("car-blue", "car", 4.4, 1.78, 0.2, (44, 74, 130)),
    VehicleKind("car-silver", "car", 4.6, 1.8, 0.25, (186, 190, 194)),
    VehicleKind("van-white", "van", 5.4, 1.95, 0.13, (232, 232, 228)),
    VehicleKind("truck-green", "truck", 8.4, 2.3, 0.1, (62, 104, 78)),
    VehicleKind("truck-orange", "truck", 7.6, 2.3, 0.07, (208, 122, 46)),
    VehicleKind("bus-yellow", "bus", 10.8, 2.4, 0.05, (222, 184, 70)),
)
"""All that drive."""


def vehicle_mesh(kind: VehicleKind) -> TriangleMesh:
    """Its shape; every part is a closed body."""
    half, side, color = 0.5 * kind.length, 0.5 * kind.width, np.array(kind.color)
    dark = 0.55 * color
    parts: list[Piece] = []
    if kind.form == "car":
        parts.append(_slab(-half, half, side, 0.28, 0.82, front=0.10, back=0.06, color=color))
        parts.append(
            _slab(-0.40 * kind.length, 0.17 * kind.length, 0.93 * side, 0.81, 1.32, front=0.75, back=0.45, color=_GLASS)
        )
        parts.append(_slab(-0.30 * kind.length, 0.0, 0.80 * side, 1.31, 1.43, front=0.12, back=0.1, color=color))
        wheels, radius = (-0.30 * kind.length, 0.31 * kind.length), 0.32
        parts += _lights(half, side, 0.62)
    elif kind.form == "van":
        parts.append(_slab(-half, half, side, 0.35, 1.05, front=0.08, back=0.0, color=color))
        parts.append(_slab(-half, half - 0.75, side, 1.04, 2.2, front=0.55, back=0.0, color=color))
        parts.append(_slab(half - 1.6, half - 0.72, side + 0.01, 1.15, 1.8, front=0.36, back=0.0, color=_GLASS))
        wheels, radius = (-0.29 * kind.length, 0.31 * kind.length), 0.36
        parts += _lights(half, side, 0.75)
    elif kind.form == "bus":
        parts.append(_slab(-half, half, side, 0.35, 1.25, front=0.03, back=0.03, color=color))
        parts.append(_slab(-half + 0.04, half - 0.04, side - 0.02, 1.24, 2.4, front=0.12, back=0.06, color=_GLASS))
        parts.append(_slab(-half + 0.05, half - 0.12, side, 2.39, 2.95, front=0.08, back=0.06, color=color))
        wheels, radius = (-0.27 * kind.length, 0.30 * kind.length), 0.48
        parts += _lights(half, side, 0.8)
    else:
        cab = 1.9
        parts.append(
            _slab(-half + 0.05, half - 0.2, 0.42 * kind.width, 0.55, 0.85, front=0.0, back=0.0, color=(60, 60, 62))
        )
        parts.append(_slab(half - cab, half, side, 0.45, 1.55, front=0.05, back=0.0, color=color))
        parts.append(_slab(half - cab + 0.02, half - 0.05, side - 0.02, 1.54, 2.25, front=0.22, back=0.0, color=_GLASS))
        parts.append(_slab(half - cab, half - 0.25, side, 2.24, 2.5, front=0.1, back=0.0, color=color))
        parts.append(_slab(-half, half - cab - 0.15, side, 0.84, 3.3, front=0.0, back=0.0, color=(226, 224, 218)))
        parts.append(_slab(-half - 0.01, half - cab - 0.14, side + 0.01, 1.7, 2.3, front=0.0, back=0.0, color=color))
        wheels, radius = (-0.30 * kind.length, 0.34 * kind.length), 0.48
        parts += _lights(half, side, 0.7)
    tyre = _wheel(radius, 0.24, dark)
    parts += [placed(tyre, (x, y, radius)) for x in wheels for y in (-side + 0.1, side - 0.1)]
    return compacted(join(parts))


def _slab(
    x0: float, x1: float, side: float, low: float, high: float, *, front: float, back: float, color: ArrayLike
) -> Piece:
    """A body from ``x0`` to ``x1`` whose ends lean inwards towards its top, by ``front`` and ``back`` metres."""
    lean = 0.12 * min(1.0, front + back) * side
    below = [(x0, -side), (x1, -side), (x1, side), (x0, side)]
    above = [(x0 + back, -side + lean), (x1 - front, -side + lean), (x1 - front, side - lean), (x0 + back, side - lean)]
    corners = [(x, y, low) for x, y in below] + [(x, y, high) for x, y in above]
    return hexahedra(np.array([corners]), color=color)


def _lights(half: float, side: float, z: float) -> list[Piece]:
    made = []
    for x, color in ((half - 0.07, (246, 240, 214)), (-half - 0.01, (150, 24, 24))):
        y = np.array([-0.82, 0.52]) * side
        low = np.column_stack([np.full(2, x), y, np.full(2, z - 0.09)])
        made.append(box(low, low + np.array([0.08, 0.3 * side, 0.14]), color=color))
    return made


def _wheel(radius: float, width: float, hub: NDArray[np.float64]) -> Piece:
    """Around y, with its middle at the origin."""
    h = 0.5 * width
    tyre = lathe(
        [(0, -h), (radius * 0.9, -h), (radius, -0.7 * h), (radius, 0.7 * h), (radius * 0.9, h), (0, h)], 14, color=_TYRE
    )
    cap = lathe(
        [(0, -h - 0.012), (0.55 * radius, -h - 0.01), (0.55 * radius, h + 0.01), (0, h + 0.012)],
        10,
        color=0.5 * hub + 90.0,
    )
    both = join([tyre, cap])
    return Piece(both.vertices[:, [1, 2, 0]], both.triangles, both.textures, both.colors, both.uv)
