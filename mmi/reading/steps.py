"""How far a reading is: what ``read_city`` tells the function that it is given as ``progress``. Nothing here prints."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

__all__ = ["Progress", "counted_step", "step"]

Progress = Callable[[int, int, str], None]
"""Is called with (done, of how many, what the step does), from 0 to all, for one step after the other."""

_Thing = TypeVar("_Thing")


@contextmanager
def step(progress: Progress | None, what: str) -> Iterator[None]:
    """A step of which only the beginning and the end are told; of a step that fails, no end."""
    if progress is not None:
        progress(0, 1, what)
    yield
    if progress is not None:
        progress(1, 1, what)


def counted_step(progress: Progress | None, what: str, things: Sequence[_Thing]) -> Iterator[_Thing]:
    """The things one by one, each counted when the next one is asked for."""
    if progress is not None:
        progress(0, len(things), what)
    for done, thing in enumerate(things, 1):
        yield thing
        if progress is not None:
            progress(done, len(things), what)
