"""What takes a reply: walks, a saved picture, what is at a pixel, a film. In the thread that draws, or begun there.

A film is drawn a frame at a time, in between what clients see. One is made at a time.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from mmi.city.model import City
from mmi.foundation.errors import ParameterError
from viewer.scene.scene import WalkScene
from viewer.window.answers.background import Background
from viewer.window.answers.city_map import CityMap
from viewer.window.answers.picking import Picker, seen_at
from viewer.window.commands import AskMap, Command, Film, Pick, Save, WalkCommand
from viewer.window.filming import Filming
from viewer.window.mailbox import Mail
from viewer.window.options import StudioClosedError
from viewer.window.session import Session, ShownFrame
from viewer.window.stage import Stage, Streets

__all__ = ["Answers", "Told"]

Told = Callable[[int, int], None]
"""Is told (done, of all) while something takes longer, by the thread that draws."""
_FILMED = 150.0
"""Metres of a tour that is filmed."""
_TELLING = 10
"""Frames of a film after which its client hears how far it is."""


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    """A film that a client has asked for."""

    client: str
    filming: Filming
    future: Future[dict[str, Any]]
    told: Told | None


class Answers:
    """Answers the clients of a studio. Films go into the folder ``films``, or one of their own that vanishes on closing."""

    def __init__(self, scene: WalkScene, city: City, stage: Stage, streets: Streets, *, films: Path | None) -> None:
        self._scene, self._city, self._stage, self._streets = scene, city, stage, streets
        self._picker = Picker(scene)
        self._films = films
        self._own_films: TemporaryDirectory[str] | None = None
        self._background = Background("map")
        self._map: CityMap | None = None
        self._lock = threading.Lock()
        self._job: _Job | None = None
        self._made = 0

    def close(self) -> None:
        """Let go of everything."""
        self._picker.close()
        self._background.close()
        if self._own_films is not None:
            self._own_films.cleanup()

    @property
    def films(self) -> Path:
        """The folder that films are in, for any thread."""
        with self._lock:
            if self._films is None:
                self._own_films = TemporaryDirectory(prefix="view-impostors-")
                self._films = Path(self._own_films.name)
            return self._films

    @property
    def filming(self) -> bool:
        """Whether a film is being made."""
        return self._job is not None

    def answer(
        self, session: Session, mail: Mail, command: Command, future: Future[dict[str, Any]], told: Told | None
    ) -> None:
        """Answer a command of a session, whose client's last ``mail`` is this: now or, where that takes longer, later."""
        if not future.set_running_or_notify_cancel():
            return
        try:
            match command:
                case WalkCommand():
                    future.set_result(session.command(command))
                case Save():
                    shown = session.last or session.frame(mail, time.perf_counter())
                    saved = ShownFrame(shown.picture, shown.header | {"saved": True})
                    future.set_result({"type": "saved", "frame": saved})
                case Pick():
                    self._pick(session, command, future)
                case AskMap():
                    x, y, _ = session.walker.pose.eye
                    _hand_on(self._background.submit(lambda: self._told_map((x, y))), future)
                case Film():
                    self._begin_film(session, mail, future, told)
                case _:
                    raise ParameterError(f"a command that has an answer expected, found {type(command).__name__}")
        except Exception as error:
            future.set_exception(error)

    def _pick(self, session: Session, command: Pick, future: Future[dict[str, Any]]) -> None:
        """Find out what is at a pixel; why it is drawn as it is takes longer, and is found out elsewhere."""
        frame, view, column = session.measured_at(command.x)
        seen = seen_at(frame.picture, view, column, command.y)
        cell = (frame.plan.place or session.cell) if session.inside else None

        told = {"type": "picked", "x": command.x, "y": command.y}
        _hand_on(self._picker.explained(seen, cell), future, told)

    def _told_map(self, around: tuple[float, float]) -> dict[str, Any]:
        """In the background, since a large city takes a while."""
        if self._map is None:
            self._map = CityMap(self._scene, self._city)
        return {"type": "map", **self._map.told(around)}

    def _begin_film(self, session: Session, mail: Mail, future: Future[dict[str, Any]], told: Told | None) -> None:
        if self._job is not None:
            raise ParameterError("one film at a time: one is being made already")
        self._made += 1
        path = self.films / f"{self._scene.dataset.path.name}-tour-{self._made}.mp4"
        walk = self._streets.tour(_FILMED)
        filming = Filming(session.client, self._stage, self._streets, mail, walk, path)
        self._job = _Job(session.client, filming, future, told)

    def film(self, is_there: Callable[[str], bool]) -> None:
        """Draw the next frame of the film that is being made, if one is and its client is still there."""
        job = self._job
        if job is None:
            return
        try:
            if not is_there(job.client):
                raise StudioClosedError("nothing is filmed for this client any more")
            more = job.filming.step()
            if job.told is not None and (not more or job.filming.done % _TELLING == 0):
                job.told(job.filming.done, job.filming.frames)
        except Exception as error:
            self._job = None
            job.filming.abandon()
            job.future.set_exception(error)
        else:
            if not more:
                self._job = None
                job.future.set_result({"type": "film", "url": f"/films/{job.filming.path.name}"})

    def end_film(self) -> None:
        """Give up the film that is being made, if one is."""
        self.film(lambda _: False)


def _hand_on(found: Future[dict[str, Any]], future: Future[dict[str, Any]], more: dict[str, Any] | None = None) -> None:
    """Let ``future`` have what is ``found``, and ``more``."""

    def told(found: Future[dict[str, Any]]) -> None:
        if found.cancelled():
            future.set_exception(StudioClosedError("the viewer ends"))
        elif (error := found.exception()) is not None:
            future.set_exception(error)
        else:
            future.set_result({**(more or {}), **found.result()})

    found.add_done_callback(told)
