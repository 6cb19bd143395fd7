"""Ray casting of the far field (Wimmer, Giegl & Schmalstieg 1998): near geometry, and a surface for each pixel that it leaves.

What a frame takes depends on the pixels that near objects leave open, hardly on the size of the city. It needs no cells.
"""

from __future__ import annotations

import math
from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View, level_view
from mmi.planning.parameters import BuildParameters
from mmi.rays.horizon_map import Horizon, azimuths_of, horizon_of
from viewer.casting.far_field import far_field_of
from viewer.casting.frame import CastTally, cast_frame
from viewer.casting.near_set import NearSet
from viewer.casting.open_pixels import rays_of
from viewer.casting.panorama import Panorama, smallest_pixel
from viewer.casting.rules import CastRules
from viewer.computed import CastPixels
from viewer.plan import Budget, Draw, Objects, Plan, Sky
from viewer.scene.frustum import boxes_within_view
from viewer.scene.scene import WalkScene

__all__ = ["RayCasting", "limit_px"]

_FIRST_RAY = 2e-6
"""Seconds that a ray is believed to take before the first was cast."""
_FIRST_RAYS = 2048
"""That belief counts like so many rays: where frames cast a few, what they take says little of what thousands would."""
_FORGETTING = 0.02
"""What frames say counts less by this share with each frame that comes after."""
_OTHER = 1.1
"""A panorama is begun anew where pixels become larger or smaller by more than this."""
_STANDING = 1e-6
"""Metres that a viewer moves from frame to frame who stands still."""


def limit_px(scene: WalkScene, rules: CastRules) -> float:
    """Pixels that what was cast before may be off by.

    If the rules do not say, it is the angle that the scene's dataset was built for, or that builds allow by themselves.
    """
    if rules.limit_px is not None:
        return rules.limit_px
    built = BuildParameters() if scene.built is None else scene.parameters
    return scene.camera.pixels_from_angle(built.camera.angle_from_pixels(built.max_error_px))


class RayCasting:
    """Near objects as geometry, the far field as rays, sky and what was cast before."""

    name = "ray-cast"

    def __init__(self, scene: WalkScene, rules: CastRules | None = None) -> None:
        self._scene, self._rules = scene, rules or CastRules()
        self._far = far_field_of(scene, self._rules)
        self._pixel = smallest_pixel(View(np.eye(4), scene.camera.focal, scene.camera.window))
        self._panorama = Panorama(self._pixel)
        scene.workshop.once(("compiled", self._rules.caster), self._compile)
        self._seconds, self._rays = 0.0, 0.0
        self._last: NDArray[np.float64] | None = None
        self._told: tuple[object, ...] = ()
        self.tally = CastTally()
        """What pixels were so far."""
        self.latest = CastTally()
        """What those of the last picture were."""

    def plan(self, view: View, *, now: float, budget: Budget) -> Plan:  # noqa: ARG002
        """Draw near objects, ground and sky, and finish with what rays find."""
        eye = view.eye
        near = self._far.neighbourhoods.around(eye)
        horizon = self._far.threads.submit(self._horizon, view)  # while what is near is drawn
        flags = near.flags
        limit = limit_px(self._scene, self._rules)
        moved = math.inf if self._last is None else float(np.linalg.norm(eye - self._last))
        self._last = eye
        told = (view.eye_from_world.tobytes(), view.focal, view.window)
        still, self._told = told == self._told, told
        pixel = smallest_pixel(view)
        if not 1.0 / _OTHER < pixel / self._pixel < _OTHER:  # another display
            self._pixel, self._panorama = pixel, Panorama(pixel)
        panorama, most = self._panorama, self._rules.rays
        ray_seconds = self._learnt(budget)
        if np.isfinite(budget.updates):
            affordable = int(budget.updates / ray_seconds)
            most = affordable if most is None else min(most, affordable)

        found: dict[tuple[int, int], CastPixels] = {}  # by the columns that were asked for

        def finish(depths: NDArray[np.float32], first_column: int) -> tuple[Draw, ...]:
            columns = first_column, depths.shape[1]
            if columns in found:  # drawn again, it is the same frame
                return (found[columns],)
            shown, tally = cast_frame(
                depths,
                first_column,
                rays_of(view, first_column),
                horizon.result(),
                panorama,
                self._far,
                flags,
                self._rules,
                limit_px=limit,
                most=most,
                share=0.0 if moved <= _STANDING else self._share(moved, limit / view.focal),
                settling=self._rules.settling if still else 0,
            )
            self.latest, self.tally = tally, self.tally.plus(tally)
            found[columns] = shown
            return (shown,)

        return Plan((_in_view(near, self._scene, view), self._scene.ground_in(view), Sky()), finish=finish)

    def _learnt(self, budget: Budget) -> float:
        """Seconds that a ray takes, by what the budget says of the last frame, so that recorded budgets allow the same rays."""
        if budget.done is not None:
            self._seconds += budget.done.finding - _FORGETTING * self._seconds
            self._rays += self.latest.rays - _FORGETTING * self._rays
        return (_FIRST_RAYS * _FIRST_RAY + self._seconds) / (_FIRST_RAYS + self._rays)

    def _horizon(self, view: View) -> Horizon:
        window = azimuths_of(_corners(view))
        return horizon_of(self._far.heights, view.eye, beyond=self._rules.near_field, window=window)

    def _compile(self) -> None:
        """Cast a few rays, so that nothing has to be compiled in a frame."""
        eye = self._scene.whereabouts.cells[0].reference
        view = level_view(eye, 0.0, focal=8.0, window=(-8, -8, 16, 16))
        horizon = self._horizon(view)
        nothing = np.full((16, 16), np.inf, dtype=np.float32)
        near = self._far.neighbourhoods.around(eye).flags
        panorama = Panorama(smallest_pixel(view))
        for _ in range(2):  # the second time it finds what was cast
            cast_frame(
                nothing, 0, rays_of(view), horizon, panorama, self._far, near, self._rules, limit_px=1.0, most=None
            )

    def _share(self, moved: float, limit: float) -> float:
        """The share of all that was cast to cast again on a way of ``moved`` metres, before it is off by ``limit``.

        That is the tangent of an angle; what was cast is good for as long as it takes to walk ``near_field`` times its sine.
        """
        good = self._rules.near_field * math.sin(math.atan(limit))
        return moved / good if moved < good else 0.0


def _in_view(near: NearSet, scene: WalkScene, view: View) -> Objects:
    """Near objects that the view may show. A viewer who walks and looks ahead sees the same for a while."""
    boxes = scene.boxes[near.objects]
    shows = boxes_within_view(boxes, view)
    told = blake2b(np.packbits(shows).tobytes(), digest_size=8).hexdigest()
    return Objects(f"{near.key} {told}", near.objects[shows])


def _corners(view: View) -> NDArray[np.float64]:
    """(4, 3) directions to the corners of a view."""
    left, top, width, height = view.window
    u, v = np.array([left, left + width] * 2), np.array([top, top, top + height, top + height])
    return view.unproject(u.astype(np.float64), v.astype(np.float64), np.ones(4)) - view.eye
