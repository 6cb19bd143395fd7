"""The studio: the one thread that owns OpenGL, and the sessions that are drawn there in turns.

    with Studio(dataset, options) as studio:
        studio.join(client, size)
        studio.tell(client, command)            from any thread; returns at once
        studio.ask(client).result()             the next frame that shows something new
        studio.answer(client, command).result()
        studio.leave(client)

The thread draws a client's frame only while somebody waits for it, and never waits for a client. An error in a frame is the
answer to who asked for it; the session goes on.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from concurrent.futures import Future
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any

from mmi.dataset.reading import open_dataset
from mmi.foundation.errors import MmiError, ParameterError
from mmi.foundation.processes import usable_cores
from viewer.placed.rules import PlacedRules
from viewer.scene.scene import WalkScene, open_scene
from viewer.techniques.catalogue import MAIN
from viewer.window.answering import Answers, Told
from viewer.window.commands import Command, WalkCommand
from viewer.window.mailbox import Mailbox
from viewer.window.options import SINGLE, StudioClosedError, StudioFullError, StudioOptions
from viewer.window.session import Session, ShownFrame
from viewer.window.stage import Stage, Streets

__all__ = ["Studio", "StudioClosedError", "StudioFullError", "StudioOptions"]

_MOST_WAITING = 8
"""Futures of one client that wait for frames or answers at a time."""


@dataclass(slots=True, eq=False)
class _Seat:
    """A client: what it has told, its session, which only the thread touches, and who waits for what."""

    mailbox: Mailbox
    session: Session | None = None
    frames: deque[Future[ShownFrame]] = field(default_factory=deque)
    answers: deque[tuple[Command, Future[dict[str, Any]], Told | None]] = field(default_factory=deque)

    def abandon(self) -> None:
        """Tell all who wait that nothing will come."""
        error = StudioClosedError("nothing is drawn for this client any more")
        for frame in self.frames:
            _refuse(frame, error)
        for _, answer, _ in self.answers:
            _refuse(answer, error)
        self.frames.clear()
        self.answers.clear()


class Studio:
    """Draws a dataset for several clients. A context manager; its methods may be called from any thread.

    Raises DatasetError and ParameterError where the dataset or an option is wrong, and on entering CaptureError where there is
    no OpenGL.
    """

    def __init__(self, dataset: Path, options: StudioOptions | None = None) -> None:
        self.options = options or StudioOptions()
        found = open_dataset(dataset)
        if found.manifest.parameters.layering == "single":
            raise ParameterError(
                f"{dataset}: a dataset of several layers expected, found one built with --layering single"
            )
        city = found.city()
        self.scene: WalkScene = open_scene(found, name=MAIN, city=city)
        scenes = {MAIN: self.scene}
        if self.options.single_mesh is not None:
            scenes[SINGLE] = open_scene(open_dataset(self.options.single_mesh), name=SINGLE, like=self.scene)
        self._streets = Streets(self.scene, city)
        placed = PlacedRules(self.options.placed, threads=max(1, usable_cores() // 2), warp=self.options.warp)
        self._stage = Stage(scenes, capacity=self.options.cache, samples=self.options.samples, placed=placed)
        self._answers = Answers(self.scene, city, self._stage, self._streets, films=self.options.films)
        self._lock = threading.Condition()
        self._seats: dict[str, _Seat] = {}
        self._gone: list[Session] = []
        self._film_next = False
        self._closed = False
        self._ready: Future[None] = Future()
        self._thread = threading.Thread(target=self._work, name="drawing", daemon=True)
        Mailbox(self.options.look, (64, 64), self.options.techniques)  # raises for a look that names others

    def __enter__(self) -> Studio:
        self._thread.start()
        self._ready.result()
        self.about()  # which takes a while for a large city, and is asked for by threads that should not wait
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def films(self) -> Path:
        """The folder that films are in."""
        return self._answers.films

    def close(self) -> None:
        """End the thread, and tell all who wait. Films of a folder of their own vanish."""
        with self._lock:
            self._closed = True
            self._lock.notify_all()
        if self._thread.is_alive():
            self._thread.join()
        self._answers.close()
        for seat in self._seats.values():
            seat.abandon()
        self._seats.clear()

    def about(self) -> dict[str, Any]:
        """What a page is told first. Whoever gets it may change it."""
        return deepcopy(self._about)

    @cached_property
    def _about(self) -> dict[str, Any]:
        camera, parameters = self.scene.camera, self.scene.parameters
        manifest = self.scene.dataset.manifest
        pose = self._streets.start
        promises = [entry.promised_error_px for entry in manifest.cells]
        promise = None if None in promises else max(one for one in promises if one is not None)
        indices = sorted({one.index for entry in manifest.cells for _, one in entry.pictures})
        return {
            "dataset": self.scene.dataset.path.name,
            "techniques": list(self.options.techniques),
            "display": [camera.width, camera.height],
            "fov_degrees": math.degrees(camera.fov),
            "max_error_px": parameters.max_error_px,
            "cells": len(manifest.cells),
            "layers": indices,
            "promise_px": {"thickness": promise, "displacement": promise},
            "pose": [*pose.eye, pose.azimuth, pose.pitch],
            "look": self.options.look.plain(),
            "credits": "© OpenStreetMap contributors" if ".osm" in manifest.city.source else "",
            "device": self.device,
        }

    @property
    def device(self) -> str:
        """Name of what draws, once the studio was entered."""
        return self._stage.renderer.device

    # ----------------------------------------------------------------------------------------------- any thread

    def join(self, client: str, size: tuple[int, int]) -> None:
        """Take a client in, with a window of ``size``. Raises StudioFullError, ParameterError for one that is there."""
        with self._lock:
            self._check_open()
            if client in self._seats:
                raise ParameterError(f"a new client expected, found {client!r} again")
            if len(self._seats) >= self.options.sessions:
                raise StudioFullError(f"at most {self.options.sessions} views are drawn at once")
            self._seats[client] = _Seat(Mailbox(self.options.look, size, self.options.techniques))

    def leave(self, client: str) -> None:
        """Let a client go; nothing where it is not there."""
        with self._lock:
            seat = self._seats.pop(client, None)
            if seat is None:
                return
            if seat.session is not None:
                self._gone.append(seat.session)
            seat.abandon()
            self._lock.notify_all()

    def tell(self, client: str, command: Command) -> None:
        """Take a command in. Raises ParameterError for one that has no meaning, and for a client who is not there."""
        with self._lock:
            seat = self._seat(client)
            if isinstance(command, WalkCommand):
                self._queue(seat, command, None)
            else:
                seat.mailbox.post(command)
            self._lock.notify_all()

    def ask(self, client: str) -> Future[ShownFrame]:
        """The client's next frame, once there is one that shows something new. Raises ParameterError as :meth:`tell`."""
        future: Future[ShownFrame] = Future()
        with self._lock:
            seat = self._seat(client)
            if len(seat.frames) >= _MOST_WAITING:
                raise ParameterError(f"at most {_MOST_WAITING} frames to be asked for at a time")
            seat.frames.append(future)
            self._lock.notify_all()
        return future

    def answer(self, client: str, command: Command, told: Told | None = None) -> Future[dict[str, Any]]:
        """The reply to a command that has one. ``told`` hears how far that is. Raises ParameterError as :meth:`tell`."""
        with self._lock:
            future = self._queue(self._seat(client), command, told)
            self._lock.notify_all()
        return future

    def _queue(self, seat: _Seat, command: Command, told: Told | None) -> Future[dict[str, Any]]:
        if len(seat.answers) >= _MOST_WAITING:
            raise ParameterError(f"at most {_MOST_WAITING} replies to be asked for at a time")
        future: Future[dict[str, Any]] = Future()
        seat.answers.append((command, future, told))
        return future

    def _seat(self, client: str) -> _Seat:
        self._check_open()
        if client not in self._seats:
            raise ParameterError(f"a client who has joined expected, found {client!r}")
        return self._seats[client]

    def _check_open(self) -> None:
        if self._closed:
            raise StudioClosedError("the viewer ends")

    # ---------------------------------------------------------------------------------------- the drawing thread

    def _work(self) -> None:
        try:
            with self._stage:
                self._ready.set_result(None)
                try:
                    while self._turn():
                        pass
                finally:
                    self._answers.end_film()
        except BaseException as error:
            if not self._ready.done():
                self._ready.set_exception(error)
                return
            with self._lock:
                self._closed = True
                for seat in self._seats.values():
                    seat.abandon()
            raise

    def _turn(self) -> bool:
        """Do the next thing for the client whose turn it is, or wait for one. False when the studio ends."""
        with self._lock:
            while True:
                if self._closed:
                    return False
                gone, self._gone = self._gone, []
                found = None if self._film_next and self._answers.filming else self._next()
                if gone or found is not None or self._answers.filming:
                    break
                self._lock.wait(self._patience())
            if found is not None:  # to the end of the queue: others come first now
                self._seats[found] = seat = self._seats.pop(found)
                answer = seat.answers.popleft() if seat.answers else None
        for session in gone:
            session.close()
        self._film_next = found is not None  # a film and those who look on take turns
        if found is None:
            self._answers.film(self._is_there)
            return True
        try:
            if seat.session is None:
                seat.session = Session(found, self._stage, self._streets, seat.mailbox.peek(), wake=self._wake)
        except Exception as error:
            self._fail(seat, error)
            return True
        if answer is not None:
            assert seat.session is not None
            self._answers.answer(seat.session, seat.mailbox.peek(), *answer)
        else:
            self._draw(seat)
        with self._lock:
            if self._seats.get(found) is not seat and seat.session not in self._gone and seat.session is not None:
                self._gone.append(seat.session)  # it left meanwhile
        return True

    def _wake(self) -> None:
        with self._lock:
            self._lock.notify_all()

    def _is_there(self, client: str) -> bool:
        with self._lock:
            return client in self._seats and not self._closed

    def _next(self) -> str | None:
        now = time.perf_counter()
        for client, seat in self._seats.items():
            while seat.frames and seat.frames[0].cancelled():
                seat.frames.popleft()
            if seat.answers:
                return client
            if seat.frames and (seat.session is None or seat.mailbox.fresh or seat.session.due(now)):
                return client
        return None

    def _patience(self) -> float | None:
        """Seconds until somebody's next frame is due; None for as long as nobody tells anything."""
        now = time.perf_counter()
        waiting = [seat.session for seat in self._seats.values() if seat.frames and seat.session is not None]
        times = [at for at in (session.due_at(now) for session in waiting) if at is not None]
        return max(min(times) - now, 1e-3) if times else None

    def _draw(self, seat: _Seat) -> None:
        session = seat.session
        assert session is not None
        mail = seat.mailbox.take()
        try:
            frame = session.frame(mail, time.perf_counter())
        except Exception as error:
            session.failed = True
            self._fail(seat, error)
            return
        with self._lock:
            waiting = seat.frames.popleft() if seat.frames else None
        if waiting is not None and waiting.set_running_or_notify_cancel():
            waiting.set_result(frame)
        try:
            session.find_worst()
        except MmiError:  # the frame was drawn: what is wrong with it is only not told
            return

    def _fail(self, seat: _Seat, error: Exception) -> None:
        """Tell whoever waits for a frame what went wrong."""
        with self._lock:
            waiting = seat.frames.popleft() if seat.frames else None
        if waiting is not None:
            _refuse(waiting, error)


def _refuse(future: Future[Any], error: Exception) -> None:
    if future.set_running_or_notify_cancel():
        future.set_exception(error)
