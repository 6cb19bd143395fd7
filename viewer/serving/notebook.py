"""A viewer in a notebook's cell: a studio and a server in threads of the kernel, and a frame that shows the server's page.

    from viewer import show_in_notebook
    show_in_notebook("out/helsinki")

It ends with the kernel, or when it is closed. Nothing of Jupyter is imported: what a cell shows is an object that says how it
looks in HTML.
"""

from __future__ import annotations

import atexit
import html
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self

from mmi.foundation.errors import ParameterError
from viewer.serving.access import new_token
from viewer.serving.server import ServerOptions, ServerThread
from viewer.window.studio import Studio, StudioOptions

__all__ = ["NOTEBOOKS", "NotebookViewer", "show_in_notebook"]

NOTEBOOKS = (
    "http://localhost:*",
    "http://127.0.0.1:*",
    "https://localhost:*",
    "https://127.0.0.1:*",
    "vscode-webview:",
)
"""Origins whose pages may hold the viewer: notebooks on this machine, and those that come through a tunnel to it."""
_HEIGHT = 600
_LEAST, _MOST = 200, 4000
"""Pixels of a frame's height."""


class NotebookViewer:
    """A running viewer, which a notebook shows as a frame ``height`` pixels high; ``address`` is its page's.

    Close it with ``close()`` or as a context manager; the kernel's end closes it as well. It listens on this machine only, and
    its page asks for a token, which the address holds. Raises what ``Studio`` and ``ServerThread`` raise.
    """

    def __init__(self, studio: Studio, options: ServerOptions, *, height: int = _HEIGHT) -> None:
        if not _LEAST <= height <= _MOST:
            raise ParameterError(f"height: {_LEAST} to {_MOST} pixels expected, found {height!r}")
        self._height = height
        with ExitStack() as stack:
            stack.enter_context(studio)
            self.address = stack.enter_context(ServerThread(studio, options))
            self._running: ExitStack | None = stack.pop_all()
        atexit.register(self.close)

    def close(self) -> None:
        """End the viewer; its frame shows nothing any more."""
        atexit.unregister(self.close)
        running, self._running = self._running, None
        if running is not None:
            running.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"a viewer at {self.address}" if self._running is not None else "a viewer that was closed"

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        if self._running is None:
            return "<p>This viewer was closed.</p>"
        address = html.escape(self.address, quote=True)
        return (
            f'<iframe src="{address}" title="The viewer" width="100%" height="{self._height}" '
            'style="border: 0" allow="fullscreen; gamepad; clipboard-write"></iframe>'
            f'<p><a href="{address}" target="_blank" rel="noopener">Open the viewer in a page of its own.</a> '
            "It ends with the notebook's kernel; where nothing shows, run the cell again.</p>"
        )


def show_in_notebook(
    dataset: Path | str,
    *,
    height: int = _HEIGHT,
    port: int = 0,
    techniques: tuple[str, ...] | None = None,
    framed_by: tuple[str, ...] = NOTEBOOKS,
) -> NotebookViewer:
    """The viewer of ``dataset`` as the last value of a notebook's cell.

    ``height`` is the frame's, in pixels. The browser asks the kernel's machine for the page, by the name 127.0.0.1: where
    the notebook comes through a tunnel from another machine, tunnel a ``port`` of your choice as well. ``framed_by`` are the
    origins that notebooks are served from, by default this machine's. ``techniques`` are those to compare, by default all.

    Raises DatasetError, ParameterError, and CaptureError where there is no OpenGL.
    """
    studio = Studio(Path(dataset), StudioOptions() if techniques is None else StudioOptions(techniques=techniques))
    options = ServerOptions(port=port, token=new_token(), framed_by=framed_by)
    return NotebookViewer(studio, options, height=height)
