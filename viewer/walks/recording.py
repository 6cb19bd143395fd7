"""Walks that are played and walks that are recorded, a moment at a time: small state, and no clock."""

from __future__ import annotations

from dataclasses import dataclass, field

from mmi.walks.walk import Keyframe, Pose, Walk

__all__ = ["Playing", "Recording"]

_SPACING = 0.1
"""Seconds between the keyframes of a recording."""
_MOST_KEYFRAMES = 36_000
"""An hour of them."""
_SHORTEST = 1e-3


@dataclass(slots=True)
class Playing:
    """A ``walk`` that is played, of a kind (``tour`` or ``walk``), and how far it is, seconds from its beginning."""

    walk: Walk
    kind: str
    seconds: float = 0.0

    @property
    def pose(self) -> Pose:
        """Where the viewer is now."""
        return self.walk.pose(self.walk.keyframes[0].time + self.seconds)

    @property
    def over(self) -> bool:
        """Whether the walk has ended."""
        return self.seconds >= self.walk.seconds


@dataclass(slots=True)
class Recording:
    """Poses over the time that a session has spent: a keyframe every ``_SPACING`` seconds, and one where it jumps."""

    keyframes: list[Keyframe] = field(default_factory=list)
    seconds: float = 0.0
    _last: tuple[float, Pose] | None = None

    @property
    def full(self) -> bool:
        """Whether it is as long as it may be."""
        return len(self.keyframes) >= _MOST_KEYFRAMES

    def add(self, pose: Pose, seconds: float, *, jumped: bool = False) -> None:
        """``seconds`` after the last one the viewer is here; it ``jumped``, or went."""
        self.seconds += seconds
        if not self.keyframes:
            self.keyframes.append(Keyframe(self.seconds, pose))
        elif jumped:
            self._finish()
            self.keyframes.append(Keyframe(self.seconds, pose, cut=True))
        elif self.seconds >= self.keyframes[-1].time + _SPACING:
            self.keyframes.append(Keyframe(self.seconds, pose))
        self._last = (self.seconds, pose)

    def walk(self, name: str) -> Walk | None:
        """What was recorded, None if nothing was."""
        self._finish()
        if not self.keyframes:
            return None
        start = self.keyframes[0].time
        return Walk(name, tuple(Keyframe(one.time - start, one.pose, one.cut) for one in self.keyframes))

    def _finish(self) -> None:
        """A keyframe where the viewer was last."""
        if self._last is not None and self._last[0] >= self.keyframes[-1].time + _SHORTEST:
            self.keyframes.append(Keyframe(*self._last))
