"""The viewer's server: a few files of its own, one websocket a client, and films that its clients had made. Nothing else.

    serve(Studio(dataset, options), ServerOptions(), started=print)      until Ctrl-C
    with Studio(dataset, options) as studio, ServerThread(studio, ServerOptions()) as address:
        ...                                                              beside other work: a notebook, a window, tests

Files are read when the server starts, into a table: what a request names is a key of that table and never a path.
"""

from __future__ import annotations

import asyncio
import hashlib
import logging
import socket as sockets
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass
from importlib import resources
from itertools import count
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Self

from aiohttp import web

from mmi.foundation.errors import DatasetError, ParameterError
from mmi.foundation.json_forms import shown
from viewer.serving.access import Door, content_policy, is_loopback, new_token, refusal, token_fits
from viewer.serving.client import MOST_BYTES, Client
from viewer.serving.encoding import Encoder
from viewer.serving.waiting import WaitingRoom

if TYPE_CHECKING:
    from viewer.window.studio import Studio

__all__ = ["Server", "ServerOptions", "ServerThread", "serve"]

_KINDS = MappingProxyType(
    {
        "html": "text/html; charset=utf-8",
        "js": "text/javascript; charset=utf-8",
        "css": "text/css; charset=utf-8",
        "svg": "image/svg+xml",
    }
)
_HEADERS = MappingProxyType(
    {
        "Cache-Control": "no-cache",
        "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
        "Cross-Origin-Opener-Policy": "same-origin",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Referrer-Policy": "no-referrer",
        "Server": "view-impostors",
        "X-Content-Type-Options": "nosniff",
    }
)
"""What every answer says; the page has a policy of its own."""
_MOST_CONNECTIONS = 256
_MOST_SOCKETS = 64
_SILENCE = 15.0
"""Seconds after which a connection on which nothing is asked is closed, and a silent websocket is asked for a sign of life."""
_SHUTDOWN = 1.0
"""Seconds that answers get to end when the server stops."""
_GOODBYE = 0.3
"""Seconds that websockets get to say goodbye then."""
_DENIED = "Open the address that view-impostors printed when it started: it holds the token that this page asks for.\n"


@dataclass(frozen=True, slots=True)
class ServerOptions:
    """Where the server listens, and whom it answers.

    ``host`` is a name or an address of this machine; ``port`` 0 is any free one. ``token`` is what clients must show; where
    other machines can reach the host, one is made if none is given. ``framed_by`` are origins whose pages may hold this one
    in a frame. ``places`` clients are drawn for at once. Raises ParameterError.
    """

    host: str = "127.0.0.1"
    port: int = 0
    token: str | None = None
    framed_by: tuple[str, ...] = ()
    places: int = 4

    def __post_init__(self) -> None:
        if not 0 <= self.port <= 65535:
            raise ParameterError(f"port: 0 to 65535 expected, found {self.port}")
        if not self.host or any(letter.isspace() or letter in "/@?#" for letter in self.host):
            raise ParameterError(f"host: a name or an address of this machine expected, found {self.host!r}")
        try:
            self.host.encode("idna")
        except UnicodeError:  # an empty or endless part of a name, which no look-up takes
            raise ParameterError(
                f"host: a name or an address of this machine expected, found {shown(self.host)}"
            ) from None
        if self.token is None and not is_loopback(self.host):
            object.__setattr__(self, "token", new_token())
        self.door()

    def door(self) -> Door:
        """Who may come in."""
        names = {"localhost", self.host.lower()}
        if not is_loopback(self.host):
            names |= {sockets.gethostname().lower(), sockets.getfqdn().lower()}
        return Door(frozenset(names), is_loopback(self.host), self.token, self.framed_by)


class Server:
    """The server on the running asyncio loop, as an async context manager; ``address`` is where its page is.

    It serves the page from the start, and clients once ``open`` says that the studio was entered.
    """

    def __init__(
        self, studio: Studio, options: ServerOptions, *, complain: Callable[[str], None] | None = None
    ) -> None:
        self._studio, self._options = studio, options
        self._opened = asyncio.Event()
        self._complain = _to_stderr if complain is None else complain
        self._door = options.door()
        self._files = _files()
        self._films: dict[str, Path] = {}
        self._names = count(1)
        self._sockets: set[web.WebSocketResponse] = set()
        self._port = options.port

    @property
    def address(self) -> str:
        """The page's address, with the token where one is asked for."""
        host = self._options.host
        if host in ("0.0.0.0", "::"):
            host = _own_name()
        elif ":" in host:
            host = f"[{host}]"
        token = "" if self._options.token is None else f"?token={self._options.token}"
        return f"http://{host}:{self._port}/{token}"

    async def __aenter__(self) -> Self:
        """Listen. Raises DatasetError where the address cannot be had."""
        self._encoder = Encoder()
        self._room = WaitingRoom(self._options.places)
        server = web.Server(
            self._answer,
            access_log=None,
            logger=_silent(),
            keepalive_timeout=_SILENCE,
            lingering_time=0.0,
            handler_cancellation=True,
        )
        self._runner = web.ServerRunner(server, handle_signals=False, shutdown_timeout=_SHUTDOWN)
        await self._runner.setup()

        options = self._options
        try:
            self._listener = await asyncio.get_running_loop().create_server(
                lambda: _Gate(server), options.host, options.port
            )
        except OSError as error:
            await self._runner.cleanup()
            reason = error.strerror or error
            where = f"{options.host}, port {options.port}"
            raise DatasetError(f"{where}: an address to listen at expected, found: {reason}") from None
        self._port = self._listener.sockets[0].getsockname()[1]
        return self

    def open(self) -> None:
        """The studio can be asked from now on."""
        self._opened.set()

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop listening, and send the clients away."""
        self._listener.close()
        closing = [one.close(code=1001, message=b"the viewer was ended") for one in self._sockets]
        with suppress(TimeoutError):
            async with asyncio.timeout(_GOODBYE):
                await asyncio.gather(*closing, return_exceptions=True)
        await self._runner.cleanup()
        self._encoder.__exit__(kind, error, trace)

    # ------------------------------------------------------------------------------------------------------ answers

    async def _answer(self, request: web.BaseRequest) -> web.StreamResponse:
        """What every request comes to."""
        headers = request.headers
        wants_socket = request.path == "/socket"
        refused = refusal(
            self._door,
            hosts=headers.getall("Host", ()),
            origins=headers.getall("Origin", ()),
            site=headers.get("Sec-Fetch-Site"),
            mode=headers.get("Sec-Fetch-Mode"),
            socket=wants_socket,
        )
        if refused is None and request.method not in ("GET", "HEAD"):
            return _plain(405, "GET expected\n")
        if refused is not None:
            return _plain(403, f"{refused}\n")
        offered = request.query.get("token")
        cookie = f"viewer-{self._port}"
        open_to_all = request.path in self._files and request.path != "/"
        if not open_to_all and not token_fits(self._door, (offered, request.cookies.get(cookie))):
            return _plain(403, _DENIED)
        if wants_socket:
            return await self._serve_socket(request)
        response = self._found(request)
        response.headers["Content-Security-Policy"] = content_policy(self._door, headers["Host"])
        if offered is not None and self._door.token is not None:
            response.set_cookie(cookie, self._door.token, path="/", httponly=True, samesite="Strict")
        return response

    def _found(self, request: web.BaseRequest) -> web.StreamResponse:
        file = self._files.get(request.path)
        if file is not None:
            if request.headers.get("If-None-Match") == file.tag:
                return web.Response(status=304, headers={**_HEADERS, "ETag": file.tag})
            return web.Response(body=file.data, headers={**_HEADERS, "Content-Type": file.kind, "ETag": file.tag})
        film = self._films.get(request.path)
        if film is not None and film.is_file():
            return web.FileResponse(film, headers={**_HEADERS, "Content-Type": "video/mp4"})
        return _plain(404, "The viewer has no such page.\n")

    async def _serve_socket(self, request: web.BaseRequest) -> web.StreamResponse:
        if len(self._sockets) >= _MOST_SOCKETS:
            return _plain(503, "too many pages are open\n")
        socket = web.WebSocketResponse(heartbeat=_SILENCE, compress=False, max_msg_size=MOST_BYTES, timeout=_SHUTDOWN)
        if not socket.can_prepare(request).ok:
            return _plain(400, "a websocket's handshake expected\n")
        await self._opened.wait()
        await socket.prepare(request)
        self._sockets.add(socket)
        try:
            name = f"client {next(self._names)}"
            await Client(
                name, socket, self._studio, self._encoder, self._room, publish=self._publish, complain=self._complain
            ).run()
        finally:
            self._sockets.discard(socket)
            with suppress(ConnectionError):
                await socket.close()
        return socket

    def _publish(self, url: str) -> None:
        """Serve a film of the studio's from now on."""
        self._films[url] = self._studio.films / url.rpartition("/")[2]


class ServerThread:
    """The server in a thread with a loop of its own, as a context manager that gives the page's address."""

    def __init__(self, studio: Studio, options: ServerOptions) -> None:
        self._studio, self._options = studio, options
        self._thread = threading.Thread(target=self._run, name="viewer's server", daemon=True)
        self._started: Future[str] = Future()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ended: asyncio.Event | None = None

    def __enter__(self) -> str:
        """Start it. Raises DatasetError where the address cannot be had."""
        self._thread.start()
        return self._started.result()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop it."""
        if self._loop is not None and self._ended is not None:
            self._loop.call_soon_threadsafe(self._ended.set)
        self._thread.join()

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except BaseException as error:  # whoever started it is told
            if not self._started.done():
                self._started.set_exception(error)

    async def _serve(self) -> None:
        self._loop, self._ended = asyncio.get_running_loop(), asyncio.Event()
        async with Server(self._studio, self._options) as server:
            server.open()
            self._started.set_result(server.address)
            await self._ended.wait()


def serve(studio: Studio, options: ServerOptions, *, started: Callable[[str], None]) -> None:
    """Serve until KeyboardInterrupt, which is raised on; ``started`` is called with the page's address.

    The studio is entered here, while a browser opens the page already. Raises DatasetError where the address cannot be had, and
    what entering the studio raises.
    """

    async def until_interrupted() -> None:
        loop = asyncio.get_running_loop()
        async with AsyncExitStack() as stack:
            server = await stack.enter_async_context(Server(studio, options))
            started(server.address)
            entering = loop.run_in_executor(None, studio.__enter__)
            try:
                await asyncio.shield(entering)
                server.open()
                await asyncio.Event().wait()
            finally:  # clients leave before their studio does
                await stack.aclose()
                await asyncio.wait((entering,))
                if entering.exception() is None:
                    await loop.run_in_executor(None, studio.__exit__, None, None, None)

    asyncio.run(until_interrupted())


@dataclass(frozen=True, slots=True)
class _File:
    data: bytes
    kind: str
    tag: str


def _files() -> dict[str, _File]:
    """The page's files by their paths; the page itself is at /."""
    found = {}
    for one in (resources.files("viewer.serving") / "page").iterdir():
        kind = _KINDS.get(one.name.rpartition(".")[2])
        if kind is not None:
            data = one.read_bytes()
            tag = f'"{hashlib.sha256(data).hexdigest()[:32]}"'
            found["/" if one.name == "index.html" else f"/{one.name}"] = _File(data, kind, tag)
    return found


class _Gate(asyncio.Protocol):
    """A new connection, which is handed on to ``server``, or closed at once where there are too many."""

    def __init__(self, server: web.Server) -> None:
        self._server = server

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Hand it on."""
        assert isinstance(transport, asyncio.Transport)
        if len(self._server.connections) >= _MOST_CONNECTIONS:
            transport.abort()
            return
        handler = self._server()
        transport.set_protocol(handler)
        handler.connection_made(transport)


def _plain(status: int, text: str) -> web.Response:
    response = web.Response(status=status, text=text, headers=dict(_HEADERS))
    if status != 404:
        response.force_close()
    return response


def _own_name() -> str:
    """The name of this machine, where names are found by it, else an address that leads here from here."""
    name = sockets.gethostname()
    try:
        sockets.getaddrinfo(name, None)
    except OSError:
        return "127.0.0.1"
    return name


def _to_stderr(line: str) -> None:
    print(f"view-impostors: {line}", file=sys.stderr, flush=True)


def _silent() -> logging.Logger:
    """A logger for what clients do wrong, of which nobody wants to read."""
    logger = logging.Logger("viewer.serving")
    logger.addHandler(logging.NullHandler())
    return logger
