"""Who is drawn for, and who waits: a few clients are in at once, the others stand in line.

Nobody is let in faster than at a steady rate after a burst, since each newcomer costs cells to load and frames to draw: tabs
that open and close all the time must not take the drawing from those who look.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

from viewer.serving.pace import Allowance

__all__ = ["WaitingRoom"]

_TOLD_EVERY = 2.0
"""Seconds after which who waits is told how many are before it, where that changed."""


class WaitingRoom:
    """Places for ``most`` clients at once, on one asyncio loop; ``rate`` newcomers a second after a ``burst``."""

    def __init__(self, most: int = 4, *, rate: float = 0.5, burst: int = 4) -> None:
        self._free = most
        self._line: dict[str, asyncio.Future[None]] = {}
        self._pace = Allowance(rate, burst)
        self._timer: asyncio.TimerHandle | None = None

    @property
    def anybody_waits(self) -> bool:
        """Whether somebody would take a place that becomes free."""
        return bool(self._line)

    @asynccontextmanager
    async def place(self, name: str, tell: Callable[[int], Awaitable[None]]) -> AsyncIterator[None]:
        """A place, once there is one; ``tell`` is awaited with how many stand before this client, where it has to wait."""
        turn = asyncio.get_running_loop().create_future()
        self._line[name] = turn
        self._admit()
        try:
            told = -1
            while not turn.done():
                before = list(self._line).index(name)
                if before != told:
                    await tell(before)
                    told = before
                await asyncio.wait((turn,), timeout=_TOLD_EVERY)
            yield
        finally:
            self._line.pop(name, None)
            if turn.done() and not turn.cancelled():
                self._free += 1
            self._admit()

    def _admit(self) -> None:
        """Let in who is first in line, as long as there are places and nobody came in too recently."""
        loop = asyncio.get_running_loop()
        while self._line and self._free > 0:
            if not self._pace.take(loop.time()):
                if self._timer is None:
                    self._timer = loop.call_later(self._pace.wait(loop.time()) + 0.001, self._later)
                return
            first = next(iter(self._line))
            turn = self._line.pop(first)
            if not turn.done():
                self._free -= 1
                turn.set_result(None)

    def _later(self) -> None:
        self._timer = None
        self._admit()
