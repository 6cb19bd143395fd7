"""What a client has told since its last frame, merged: turns add up, of all else the latest counts. For any thread."""

from __future__ import annotations

import threading
from collections.abc import Collection
from dataclasses import dataclass, field, replace

from mmi.foundation.errors import ParameterError
from mmi.foundation.json_forms import shown
from viewer.window.commands import Command, GoTo, Held, Input, LookChange, PutAt, Size
from viewer.window.look import Look

__all__ = ["Mail", "Mailbox"]


@dataclass(frozen=True, slots=True)
class Mail:
    """What is held now, by how much the viewer has turned (yaw, pitch), the look and size, and where it was put, if it was."""

    look: Look
    size: tuple[int, int]
    seq: int = 0
    held: Held = field(default_factory=Held)
    turned: tuple[float, float] = (0.0, 0.0)
    fast: bool = False
    put: GoTo | PutAt | None = None


class Mailbox:
    """Takes commands in, and gives out what they come to. ``techniques`` are the names that a look may have."""

    def __init__(self, look: Look, size: tuple[int, int], techniques: Collection[str]) -> None:
        self._lock = threading.Lock()
        self._mail = Mail(look, size)
        self._techniques = tuple(techniques)
        self._fresh = True
        self._check(look)

    @property
    def fresh(self) -> bool:
        """Whether something came since mail was last taken."""
        return self._fresh

    def post(self, command: Command) -> None:
        """Take a command in; what is no business of a mailbox is passed over.

        Raises ParameterError for a look that has no meaning.
        """
        with self._lock:
            mail = self._mail
            match command:
                case Input():
                    yaw, pitch = (a + b for a, b in zip(mail.turned, command.look, strict=True))
                    if command.seq < mail.seq:
                        return
                    after = replace(mail, seq=command.seq, held=command.held, turned=(yaw, pitch), fast=command.fast)
                case LookChange():
                    after = replace(mail, look=self._check(mail.look.changed(command.fields)))
                case Size():
                    after = replace(mail, size=(command.width, command.height))
                case GoTo() | PutAt():
                    after = replace(mail, put=command, turned=(0.0, 0.0))
                case _:
                    return
            # A key that is held on is no news: the viewer moves anyway.
            self._fresh = self._fresh or replace(after, seq=mail.seq) != mail
            self._mail = after

    def peek(self) -> Mail:
        """What there is now, which stays for the next time."""
        return self._mail

    def take(self) -> Mail:
        """What there is now. What is held and the look stay for the next time."""
        with self._lock:
            mail, self._fresh = self._mail, False
            self._mail = replace(mail, turned=(0.0, 0.0), put=None)
            return mail

    def _check(self, look: Look) -> Look:
        for name in (look.left, look.right):
            if name not in self._techniques:
                raise ParameterError(f"technique: one of {', '.join(self._techniques)} expected, found {shown(name)}")
        return look
