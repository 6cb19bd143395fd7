"""Work that must not keep pictures waiting: a thread of its own that does one job after another, and can be told to give up.

The thread ends with the program, whatever it does then.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from typing import Any, TypeVar

from mmi.foundation.errors import ParameterError

__all__ = ["Background", "within"]

_MOST_WAITING = 16
_T = TypeVar("_T")


class Background:
    """Does jobs in the order in which they were given, in a thread that is started with the first one.

    At most so many wait: who clicks faster than can be answered is told so.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._jobs: queue.Queue[tuple[Future[Any], Callable[[], Any]] | None] = queue.Queue(_MOST_WAITING)
        self._thread: threading.Thread | None = None
        self._closed = threading.Event()

    @property
    def closed(self) -> bool:
        """Whether it was told to give up."""
        return self._closed.is_set()

    def submit(self, job: Callable[[], _T]) -> Future[_T]:
        """Have ``job`` done; its result, or what it raised. A job that has not begun can be cancelled.

        Raises ParameterError where too many wait, or after :meth:`close`.
        """
        if self._closed.is_set():
            raise ParameterError(f"{self._name}: closed")
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name=self._name, daemon=True)
            self._thread.start()
        future: Future[_T] = Future()
        try:
            self._jobs.put_nowait((future, job))
        except queue.Full:
            raise ParameterError(f"{self._name}: at most {_MOST_WAITING} at a time; try again in a moment") from None
        return future

    def close(self) -> None:
        """Cancel what waits, and do not wait for what is being done."""
        self._closed.set()
        with suppress(queue.Empty):
            while True:
                waiting = self._jobs.get_nowait()
                if waiting is not None:
                    waiting[0].cancel()
        if self._thread is not None:
            self._jobs.put(None)

    def _work(self) -> None:
        while True:
            waiting = self._jobs.get()
            if waiting is None:
                return
            future, job = waiting
            del waiting
            if not future.set_running_or_notify_cancel():
                continue
            try:
                result = job()
            except BaseException as error:
                future.set_exception(error)
            else:
                future.set_result(result)
            del future, job


def within(seconds: float, asked: Future[_T], otherwise: Callable[[], _T]) -> Future[_T]:
    """What ``asked`` resolves to, or after so many ``seconds`` what ``otherwise`` returns, while the work goes on."""
    first: Future[_T] = Future()

    def late() -> None:
        with suppress(InvalidStateError):
            first.set_result(otherwise())

    timer = threading.Timer(seconds, late)
    timer.daemon = True

    def done(found: Future[_T]) -> None:
        timer.cancel()
        with suppress(InvalidStateError):
            if found.cancelled():
                first.cancel()
            elif (error := found.exception()) is not None:
                first.set_exception(error)
            else:
                first.set_result(found.result())

    timer.start()
    asked.add_done_callback(done)
    return first
