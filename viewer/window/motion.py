"""How a viewer moves: what is held, and how it has turned, come to a new place a moment later. No clock, no state.

On foot the eye is ``EYE_HEIGHT`` above the ground, follows it, and slides along walls. In free flight neither counts, and
forwards is where the viewer looks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from mmi.walks.walk import Pose
from viewer.window.commands import Held

__all__ = ["EYE_HEIGHT", "LONGEST", "STEEPEST", "Surface", "Walker", "moved"]

EYE_HEIGHT = 1.7
"""Metres from the ground to the eye of a walking viewer."""
LONGEST = 0.1
"""Seconds that a viewer moves on in a frame at most, however late that is."""
STEEPEST = math.radians(85.0)
"""The viewer looks up or down by no more."""
_SPEEDS = ((4.0, 12.0), (12.0, 60.0))
"""Metres a second, on foot and in free flight: as usual, and fast."""
_TURNING = math.radians(100.0)
"""Radians a second."""
_INERTIA = 0.06
"""Seconds in which the speed comes near to what is held."""
_STILL = 0.02
"""Metres a second; a viewer that is slower stands."""
_STEP = 0.6
"""Metres of height that the eye follows at once; farther up and down it glides."""
_GLIDE = 0.15
_FARTHEST = 1e5
"""Metres from the origin that a viewer stays within."""


class Surface(Protocol):
    """What a viewer walks on and against."""

    def ground(self, point: tuple[float, float]) -> float:
        """The height of the ground, metres."""
        ...

    def slide(self, start: tuple[float, float], end: tuple[float, float]) -> tuple[float, float]:
        """Where somebody comes to that goes from ``start`` towards ``end``."""
        ...

    def freed(self, point: tuple[float, float]) -> tuple[float, float]:
        """The point, or where it is within a building the nearest place outside."""
        ...


@dataclass(frozen=True, slots=True)
class Walker:
    """Where a viewer is, and its ``velocity`` (x, y, z), metres a second."""

    pose: Pose
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def moves(self) -> bool:
        """Whether it is still moving, whatever is held."""
        return self.velocity != (0.0, 0.0, 0.0)


def moved(
    walker: Walker,
    held: Held,
    turned: tuple[float, float],
    seconds: float,
    surface: Surface,
    *,
    fast: bool = False,
    fly: bool = False,
) -> Walker:
    """The walker ``seconds`` later (no more than ``LONGEST`` of them), turned by ``turned`` (yaw to the left, pitch up)."""
    seconds = min(max(seconds, 0.0), LONGEST)
    pose = walker.pose
    azimuth = math.remainder(pose.azimuth + turned[0] + held.turn * _TURNING * seconds, math.tau)
    pitch = min(max(pose.pitch + turned[1] + held.tilt * _TURNING * seconds, -STEEPEST), STEEPEST)
    wanted = _wanted(held, azimuth, pitch, _SPEEDS[fly][fast], fly)
    share = 1.0 - math.exp(-seconds / _INERTIA)
    vx, vy, vz = (now + share * (then - now) for now, then in zip(walker.velocity, wanted, strict=True))
    if wanted == (0.0, 0.0, 0.0) and math.hypot(vx, vy, vz) < _STILL:
        vx = vy = vz = 0.0
    x, y, z = pose.eye
    to = (x + vx * seconds, y + vy * seconds)
    if fly:
        z += vz * seconds
    else:
        free = surface.freed((x, y))
        if free != (x, y):
            to = free
        elif to != (x, y):
            to = surface.slide((x, y), to)
        target = surface.ground(to) + EYE_HEIGHT
        vz = 0.0
        if abs(target - z) > _STEP:
            target = z + (1.0 - math.exp(-seconds / _GLIDE)) * (target - z)
        if abs(target - z) > 1e-9:
            z = target
    eye = (_within(to[0]), _within(to[1]), _within(z))
    return Walker(Pose(eye, azimuth, pitch), (vx, vy, vz))


def _wanted(held: Held, azimuth: float, pitch: float, speed: float, fly: bool) -> tuple[float, float, float]:
    """The velocity that is asked for."""
    level, steep = (math.cos(pitch), math.sin(pitch)) if fly else (1.0, 0.0)
    cos, sin = math.cos(azimuth), math.sin(azimuth)
    x = held.forward * cos * level + held.right * sin
    y = held.forward * sin * level - held.right * cos
    z = held.forward * steep + held.up if fly else 0.0
    scale = speed / max(math.hypot(x, y, z), 1.0)
    return x * scale, y * scale, z * scale


def _within(value: float) -> float:
    return min(max(value, -_FARTHEST), _FARTHEST)
