"""How much a client may ask for, and how much it can take: pure bookkeeping, with the time given.

Allowance     messages, bytes or anything else at a rate, with a burst: a bucket that fills by itself
Flow          frames that are under way to a client: it acknowledges what it has drawn
Quality       of JPEG: falls where frames queue up on their way, rises where they do not
"""

from __future__ import annotations

from dataclasses import dataclass, field

__all__ = ["Allowance", "Flow", "Quality"]


@dataclass(slots=True)
class Allowance:
    """``rate`` a second of something, and up to ``burst`` at once after a pause."""

    rate: float
    burst: float
    _left: float = field(init=False)
    _at: float | None = None

    def __post_init__(self) -> None:
        self._left = self.burst

    def spend(self, amount: float, now: float) -> float:
        """Take ``amount``; the seconds to wait until there is that much. They are debts: who does not wait owes more."""
        self._fill(now)
        self._left -= amount
        return max(-self._left / self.rate, 0.0)

    def take(self, now: float) -> bool:
        """Take one if there is one."""
        self._fill(now)
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True

    def wait(self, now: float) -> float:
        """The seconds until there is one."""
        self._fill(now)
        return max((1.0 - self._left) / self.rate, 0.0)

    def _fill(self, now: float) -> None:
        if self._at is not None:
            self._left = min(self._left + self.rate * max(now - self._at, 0.0), self.burst)
        self._at = now


@dataclass(slots=True)
class Flow:
    """Frames under way: from when one is asked for until the client says that it drew it, at most ``most``."""

    most: int = 2
    _last: int = 0
    _asked: int = 0
    _sent: dict[int, float] = field(default_factory=dict)

    @property
    def has_room(self) -> bool:
        """Whether another frame may be asked for."""
        return self._asked + len(self._sent) < self.most

    @property
    def all_drawn(self) -> bool:
        """Whether the client has drawn all that was sent."""
        return not self._sent

    def ask(self) -> None:
        """A frame is asked for."""
        self._asked += 1

    def drop(self) -> None:
        """One that was asked for does not come."""
        self._asked -= 1

    def send(self, now: float) -> int:
        """One that was asked for goes on its way; its number."""
        self._asked -= 1
        self._last += 1
        self._sent[self._last] = now
        return self._last

    def acknowledge(self, number: int, now: float) -> float | None:
        """The client drew this frame, and has done with all before it.

        Returns the seconds that it was on its way; None for a number that is under way no more, or was never sent.
        """
        at = self._sent.get(number)
        if at is None:
            return None
        for earlier in [one for one in self._sent if one <= number]:
            del self._sent[earlier]
        return max(now - at, 0.0)


@dataclass(slots=True)
class Quality:
    """The JPEG quality that a connection can take.

    A frame on a slow connection comes late because others are before it. So what counts is how much later it is acknowledged
    than the fastest one lately: the way there and back, and drawing in the page, are the same for all.
    """

    best: int = 80
    least: int = 35
    late: float = 0.080
    early: float = 0.030
    _now: float = field(init=False)
    _fastest: float | None = None
    _smooth: float = 0.0

    def __post_init__(self) -> None:
        self._now = float(self.best)

    @property
    def value(self) -> int:
        """The quality of the next frame."""
        return round(self._now)

    def acknowledged(self, seconds: float) -> None:
        """A frame was acknowledged ``seconds`` after it was sent."""
        # The fastest one is forgotten slowly, so that a connection that changed is not judged by what it was.
        self._fastest = seconds if self._fastest is None else min(seconds, self._fastest * 1.002 + 1e-5)
        self._smooth += 0.25 * (seconds - self._fastest - self._smooth)
        if self._smooth > self.late:
            self._now = max(self._now - 3.0, self.least)
        elif self._smooth < self.early:
            self._now = min(self._now + 0.5, self.best)
