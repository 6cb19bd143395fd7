"""The tour filmed: frame after frame of a walk at even times, drawn as a session draws them, in between what clients see."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from mmi.walks.walk import Walk
from viewer.report.video import VideoWriter
from viewer.window.mailbox import Mail
from viewer.window.session import Session
from viewer.window.stage import Stage, Streets

__all__ = ["FRAMES_PER_SECOND", "Filming"]

FRAMES_PER_SECOND = 30.0


class Filming:
    """A film of ``walk`` at ``path``, as the client of ``mail`` would see it. Belongs to the thread that draws.

    :meth:`step` draws a frame, and :meth:`close` ends it: the file is there only if all frames were drawn. Raises DatasetError
    where it cannot be written.
    """

    def __init__(self, client: str, stage: Stage, streets: Streets, mail: Mail, walk: Walk, path: Path) -> None:
        look = replace(mail.look, freeze=False, worst=False)
        self._session = Session(f"film {client}", stage, streets, Mail(look, mail.size))
        self._session.play(walk, "tour")
        self._steps = walk.frames(FRAMES_PER_SECOND)
        self._mail, self.path = Mail(look, mail.size), path
        self.done, self.frames = 0, len(self._steps)
        self._stack = ExitStack()
        self._stack.callback(self._session.close)
        self._video = self._stack.enter_context(VideoWriter(path, mail.size, FRAMES_PER_SECOND))

    def step(self) -> bool:
        """Draw the next frame; whether there are more. Raises what drawing and writing raise, and then nothing is left."""
        try:
            frame = self._session.frame(self._mail, self.done / FRAMES_PER_SECOND)
            self._video.add(frame.picture)
        except BaseException as error:
            self._stack.__exit__(type(error), error, error.__traceback__)
            raise
        self.done += 1
        if self.done < self.frames:
            return True
        self._stack.close()
        return False

    def abandon(self) -> None:
        """Give the film up: no part of it stays."""
        error = InterruptedError("the film is given up")
        self._stack.__exit__(InterruptedError, error, None)
