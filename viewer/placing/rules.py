"""What a user says of placed images, checked once: budgets, the pyramid of view and the weights of section 3.3.2.1."""

from __future__ import annotations

import math
from dataclasses import dataclass

from mmi.foundation.camera import Camera
from mmi.foundation.errors import ParameterError

__all__ = ["Fov", "FrameBudget", "PlacingRules", "fov_of"]


@dataclass(frozen=True, slots=True)
class Fov:
    """A pyramid of view: the tangents of half its angles, ``across`` and ``up``. Raises ParameterError unless both are from
    0.2 to 20.
    """

    across: float
    up: float

    def __post_init__(self) -> None:
        for name in ("across", "up"):
            value = getattr(self, name)
            if not 0.2 <= value <= 20.0:
                raise ParameterError(
                    f"{name}: the tangent of half an angle of view, from 0.2 to 20, expected, found {value!r}"
                )

    def for_pitches(self, most: float) -> Fov:
        """The level pyramid around all those that are turned up or down by at most ``most`` radians.

        A ray of the view, (1, s, t) ahead, aside and up, is turned to (cos p - t sin p, s, sin p + t cos p). Its slope aside is
        greatest at the upper corners of the view that is turned up most, and so is its slope up. Raises ParameterError where
        that view reaches the zenith.
        """
        highest = math.atan(self.up) + most
        if not 0.0 <= most < 0.5 * math.pi or highest >= math.atan(20.0):
            raise ParameterError(
                f"pitch: views that stay below {math.degrees(math.atan(20.0)):.0f} degrees expected, found up to "
                f"{math.degrees(highest):.0f}"
            )
        return Fov(self.across / (math.cos(most) - self.up * math.sin(most)), math.tan(highest))


def fov_of(camera: Camera) -> Fov:
    """What a display shows; of an odd number of pixels, the larger half of its window to both sides."""
    return Fov((camera.width + 1) // 2 / camera.focal, (camera.height + 1) // 2 / camera.focal)


@dataclass(frozen=True, slots=True)
class FrameBudget:
    """How long a frame may take, ``ms``, on a machine on which a frame takes ``fixed`` ms as such, a ``million`` triangles so
    many, and an ``image`` to be warped and drawn. Whether that is so is for the user to know: what a frame takes is not bounded
    by the triangles that are drawn alone. Raises ParameterError for what has no meaning, or leaves no triangles.
    """

    ms: float
    fixed: float
    million: float
    image: float

    def __post_init__(self) -> None:
        for name, least in (("ms", 1e-3), ("fixed", 0.0), ("million", 1e-3), ("image", 0.0)):
            value = getattr(self, name)
            if not least <= value <= 1e6:
                raise ParameterError(f"{name}: {least:g} to 1000000 milliseconds expected, found {value!r}")
        if self.triangles < 2:
            raise ParameterError(
                f"ms: more than {self.fixed + self.image:g}, as a frame with an image takes without triangles, expected, found "
                f"{self.ms:g}"
            )

    @property
    def triangles(self) -> int:
        """The budget P that keeps a frame with an image to so long."""
        return math.floor(1e6 * (self.ms - self.fixed - self.image) / self.million)


@dataclass(frozen=True, slots=True)
class PlacingRules:
    """How to place images; raises ParameterError for what has no meaning.

    No view draws more than ``budget`` triangles; images are chosen so that at most ``target`` are left where they were chosen
    for (the paper's geometry and optimization budgets P and P_opt). Views have the pyramid ``fov`` and any yaw, and are turned
    up or down by at most ``pitch`` radians. Cells are those of an octree of ``depth`` levels below its root. ``cost`` and
    ``benefit`` are the weights C and B of section 3.3.2.1, ``small`` and ``far`` those of the benefit, B1 and B2; subsets are
    judged by what they lead to within ``look_ahead`` more steps. A picture has what views that are turned by ``turn`` radians
    see beyond the subset, and reaches ``margin`` radians further to the sides than the view that it was chosen for, but not
    beyond 75 degrees: it serves views that are turned by so much.
    """

    budget: int
    target: int
    fov: Fov
    depth: int = 5
    pitch: float = 0.0
    cost: float = 0.4
    benefit: float = 0.6
    small: float = 0.1
    far: float = 0.9
    look_ahead: int = 2
    margin: float = math.radians(30.0)
    turn: float = math.radians(15.0)

    def __post_init__(self) -> None:
        if not 1 <= self.target <= self.budget:
            raise ParameterError(
                f"target: from 1 triangle to the budget of {self.budget:,} expected, found {self.target:,}"
            )
        for name, least, most in (
            ("depth", 1, 10),
            ("cost", 0.0, 1.0),
            ("benefit", 0.0, 1.0),
            ("small", 0.0, 1.0),
            ("far", 0.0, 1.0),
            ("look_ahead", 0, 3),
            ("margin", math.radians(5.0), math.radians(60.0)),
            ("turn", 0.0, math.radians(60.0)),
        ):
            value = getattr(self, name)
            if not least <= value <= most:
                raise ParameterError(f"{name}: a number from {least:g} to {most:g} expected, found {value!r}")
        half = math.degrees(math.atan(self.pyramid.across))
        if half > 70.0:
            raise ParameterError(
                f"a view, with its pitch, at most 140 degrees wide expected, found {2.0 * half:.0f}: it cannot be a picture"
            )

    @property
    def pyramid(self) -> Fov:
        """The level pyramid around all views of a yaw: what cells are culled by, whatever the pitch, to keep the budget."""
        return self.fov.for_pitches(self.pitch)

    @property
    def widest(self) -> float:
        """How far a picture reaches to the sides, radians."""
        return min(math.atan(self.pyramid.across) + self.margin, math.radians(75.0))

    @property
    def cell_triangles(self) -> int:
        """The most that a cell should hold: a twentieth of the target, so that subsets come close to it."""
        return max(1, self.target // 20)
