"""Work that a technique needs done once for a city, in a thread of its own while clients are shown something else."""

from __future__ import annotations

import threading
from collections.abc import Callable

__all__ = ["Preparation"]


class Preparation:
    """``make`` is called at once, in the background. Nobody waits for it: a studio that ends lets it go."""

    def __init__(self, make: Callable[[], object]) -> None:
        self._make = make
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="preparation", daemon=True)
        self._thread.start()

    def over(self) -> bool:
        """Whether it is done. Raises what went wrong."""
        if self._thread.is_alive():
            return False
        if self._error is not None:
            raise self._error
        return True

    def _run(self) -> None:
        try:
            self._make()
        except BaseException as error:  # whoever asks is told
            self._error = error
