"""Work that must not keep pictures waiting: a thread of its own that does one job after another, and can be told to give up.

The thread ends with the program, whatever it does then.
"""

from __future__ import annotations

import threading
from collections import deque
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
        self._changed = threading.Condition()  # guards the next ones
        self._jobs: deque[tuple[Future[Any], Callable[[], Any]]] = deque()
        self._thread: threading.Thread | None = None
        self._closed = False

    @property
    def closed(self) -> bool:
        """Whether it was told to give up."""
        return self._closed

    def submit(self, job: Callable[[], _T]) -> Future[_T]:
        """Have ``job`` done; its result, or what it raised. A job that has not begun can be cancelled.

        Raises ParameterError where too many wait, or after :meth:`close`.
        """
        future: Future[_T] = Future()
        with self._changed:
            if self._closed:
                raise ParameterError(f"{self._name}: closed")
            self._jobs = deque(waiting for waiting in self._jobs if not waiting[0].cancelled())
            if len(self._jobs) >= _MOST_WAITING:
                raise ParameterError(f"{self._name}: at most {_MOST_WAITING} at a time; try again in a moment")
            self._jobs.append((future, job))
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name=self._name, daemon=True)
                self._thread.start()
            self._changed.notify()
        return future

    def close(self) -> None:
        """Cancel what waits, and do not wait for what is being done."""
        with self._changed:
            self._closed = True
            waiting, self._jobs = self._jobs, deque()
            self._changed.notify()
        for future, _ in waiting:
            future.cancel()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._jobs or self._closed)
                if self._closed:
                    return
                future, job = self._jobs.popleft()
            if future.set_running_or_notify_cancel():
                try:
                    future.set_result(job())
                except BaseException as error:
                    future.set_exception(error)
            del future, job  # so that nothing is kept while it waits


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
