"""One client: what its websocket says goes to the studio, and what the studio shows goes back, at the client's own pace.

Two things happen side by side on the server's loop. Messages are read, at a bounded rate, and told to the studio at once: the
latest input wins. Frames are asked for while fewer than two are under way, encoded in other threads, and sent in order; a
client that draws slowly, or not at all, gets frames slowly, or none, and holds up nobody. Whatever it says or does, only its
own connection ends.
"""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from aiohttp import WSMsgType, web

from mmi.appearance.layer_colors import layer_color
from mmi.foundation.errors import MmiError, ParameterError
from viewer.serving.encoding import Encoder, message
from viewer.serving.pace import Allowance, Flow, Quality
from viewer.serving.waiting import WaitingRoom
from viewer.window.commands import (
    SMALLEST_SIZE,
    Ack,
    AskMap,
    Command,
    Film,
    LookChange,
    Pick,
    Save,
    Size,
    WalkCommand,
    parsed,
)

if TYPE_CHECKING:
    from viewer.window.session import ShownFrame
    from viewer.window.studio import Studio

__all__ = ["MOST_BYTES", "Client"]

MOST_BYTES = 1 << 20
"""The longest message: a recorded walk of an hour."""
_MESSAGES, _MESSAGES_WAITING = 500.0, 20.0
"""Messages a second, of clients that are drawn for and of others.

A page sends one for each frame that its screen shows, and one for each frame that it has drawn.
"""
_BYTES = 128.0 * 1024.0
"""Bytes a second of them."""
_RESIZES = 0.1
"""Seconds between changes of the size: a window that is dragged has a new one in each frame of the screen."""
_ANSWERS = 4
"""Replies that a client may wait for at once."""
_STRIKES = 8
"""Senseless messages in a row that are answered; after them the connection ends."""
_STILL = 0.35
"""Seconds without a new frame after which a picture of poor quality is sent once more."""
_FINE = 92
_STALLED = 20.0
"""Seconds without an acknowledgement after which a client gives up its place where others wait."""
_IDLE = 300.0
"""Seconds without a sign of life of its user after which it does so."""
_FIRST_PIXELS = 1280 * 720
"""A larger window is drawn smaller until its page has drawn a frame: who takes none costs little."""
_PATIENCE = 10.0
"""Seconds in which a client has to say how large its window is."""


class Client:
    """A connection from the handshake on; ``run`` returns when it ends.

    ``publish`` is told the address of a film that was made for it; ``complain``, in a line, what should not have happened.
    """

    def __init__(
        self,
        name: str,
        socket: web.WebSocketResponse,
        studio: Studio,
        encoder: Encoder,
        room: WaitingRoom,
        publish: Callable[[str], None],
        complain: Callable[[str], None],
    ) -> None:
        self._name, self._socket, self._studio, self._encoder, self._room = name, socket, studio, encoder, room
        self._publish, self._complain = publish, complain
        self._loop = asyncio.get_running_loop()
        self._flow, self._quality = Flow(), Quality()
        self._way = 0.0
        """Seconds that the last frame took from here to the client's screen, and the word of it back."""
        self._fixed: int | None = None
        self._lossless = False
        self._heard = asyncio.Event()
        """Set where the client said something that its frames may have waited for."""
        self._said_at = self._loop.time()
        """When its user last did something."""
        self._size: Size | None = None
        self._drawn: Size | None = None
        """Its window's size, and that of what is drawn for it."""
        self._proved = False
        """Whether it has drawn a frame."""
        self._resizing: asyncio.TimerHandle | None = None
        self._resized_at = 0.0
        self._inside = False
        self._answers: set[asyncio.Task[None]] = set()
        self._mentions: set[asyncio.Task[None]] = set()

    async def run(self) -> None:
        """Serve the client until it goes, is sent away or the server stops."""
        showing = asyncio.create_task(self._show())
        reading = asyncio.create_task(self._read())
        try:
            await asyncio.wait((showing, reading), return_when=asyncio.FIRST_COMPLETED)
        finally:
            tasks = (showing, reading, *self._answers, *self._mentions)
            for task in tasks:
                task.cancel()
            if self._resizing is not None:
                self._resizing.cancel()
            ended = await asyncio.gather(*tasks, return_exceptions=True)
        for error in ended:
            if isinstance(error, Exception) and not isinstance(error, ConnectionError):
                self._complain(f"a page was let go: {_in_words(error)}")

    # ------------------------------------------------------------------------------------------------------ messages

    async def _read(self) -> None:
        messages, volume = Allowance(_MESSAGES, _MESSAGES), Allowance(_BYTES, MOST_BYTES + _BYTES)
        waiting, strikes = Allowance(_MESSAGES_WAITING, 2.0 * _MESSAGES_WAITING), Allowance(0.5, _STRIKES)
        async for received in self._socket:
            now = self._loop.time()
            pace = messages if self._inside else waiting
            wait = max(pace.spend(1.0, now), volume.spend(len(received.data or ""), now))
            if wait > 0.0:  # who floods is read slowly: what it sends waits on its own side
                await asyncio.sleep(wait)
            try:
                if received.type is not WSMsgType.TEXT:
                    raise ParameterError("a message: JSON text expected, found bytes")
                self._heed(parsed(received.data))
            except MmiError as error:
                if not strikes.take(now):
                    await self._socket.close(code=1008, message=b"messages of the viewer's page expected")
                    return
                await self._tell({"type": "error", "text": str(error)})

    def _heed(self, command: Command) -> None:
        """Do what a message says. Raises MmiError for what has no meaning."""
        now = self._loop.time()
        match command:
            case Ack():
                seconds = self._flow.acknowledge(command.frame, now)
                if seconds is not None:
                    self._quality.acknowledged(seconds)
                    self._way = seconds
                    if not self._proved:
                        self._proved = True
                        self._resize_soon(now)
                    self._heard.set()
                return
            case Size():
                self._size = command
                self._resize_soon(now)
            case Pick() | AskMap() | Save() | Film() | WalkCommand():
                if len(self._answers) >= _ANSWERS:
                    raise ParameterError(f"requests: at most {_ANSWERS} at once expected")
                if self._inside:
                    task = asyncio.create_task(self._answer(command))
                    self._answers.add(task)
                    task.add_done_callback(self._answered)
            case _:
                if self._inside:
                    self._studio.tell(self._name, command)
                    if isinstance(command, LookChange):  # one that has a meaning, or the studio would have refused it
                        self._fixed = command.fields.get("quality", self._fixed)
                        self._lossless = command.fields.get("lossless", self._lossless)
        self._said_at = now
        self._heard.set()

    def _resize_soon(self, now: float) -> None:
        if self._inside and self._resizing is None:
            self._resizing = self._loop.call_later(max(self._resized_at + _RESIZES - now, 0.0), self._resize)

    def _resize(self) -> None:
        self._resizing, self._resized_at = None, self._loop.time()
        if self._inside and self._proved and self._size is not None and self._size != self._drawn:
            self._drawn = self._size
            with suppress(MmiError):  # the studio is closed: its frames say so
                self._studio.tell(self._name, self._size)

    async def _answer(self, command: Pick | AskMap | Save | Film | WalkCommand) -> None:
        def told(done: int, of: int) -> None:  # by the thread that draws
            progress = {"type": "progress", "done": done, "of": of, "for": command.id}
            with suppress(RuntimeError):  # the loop has ended
                self._loop.call_soon_threadsafe(self._mention, progress)

        known = {} if command.id is None else {"for": command.id}
        try:
            found = await asyncio.wrap_future(self._studio.answer(self._name, command, told))
        except Exception as error:
            if not isinstance(error, MmiError):
                self._complain(f"a page got no answer: {_in_words(error)}")
            found = {"type": "error", "text": _in_words(error)}
        if found["type"] == "saved":
            await self._send_saved(found["frame"], known)
            return
        if found["type"] == "film":
            self._publish(found["url"])
        await self._tell({**found, **known})

    def _answered(self, task: asyncio.Task[None]) -> None:
        self._answers.discard(task)
        error = None if task.cancelled() else task.exception()
        if error is not None and not isinstance(error, ConnectionError):
            self._complain(f"a page got no answer: {_in_words(error)}")

    async def _send_saved(self, shown: ShownFrame, known: Mapping[str, Any]) -> None:
        """Send a picture to be kept: without loss, and with where it was taken from in a text of its own."""
        views = ", ".join(one["technique"] for one in shown.header["views"])
        texts = {"pose": json.dumps(shown.header["pose"]), "techniques": views, "Software": "view-impostors"}
        encoded = await asyncio.wrap_future(self._encoder.png(shown.picture, texts, small=True))
        header = {**shown.header, **known, "saved": True, "format": encoded.format}
        await self._socket.send_bytes(message(header, encoded.data))

    def _mention(self, progress: Mapping[str, Any]) -> None:
        """Tell how far something is, unless the client still has to take in how far it was before."""
        if self._inside and not self._mentions:
            task = asyncio.create_task(self._tell(progress))
            self._mentions.add(task)
            task.add_done_callback(self._mentions.discard)

    async def _tell(self, reply: Mapping[str, Any]) -> None:
        await self._socket.send_json(reply)

    async def _news(self, seconds: float | None = None) -> bool:
        """Whether the client says anything within ``seconds``."""
        self._heard.clear()
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await self._heard.wait()
        return self._heard.is_set()

    # -------------------------------------------------------------------------------------------------------- frames

    async def _show(self) -> None:
        while self._size is None:
            if not await self._news(_PATIENCE):
                return
        while True:
            async with self._room.place(self._name, self._tell_waiting):
                self._drawn = self._size if self._proved else _at_most(self._size, _FIRST_PIXELS)
                self._studio.join(self._name, (self._drawn.width, self._drawn.height))
                self._inside, self._said_at = True, self._loop.time()
                self._fixed, self._lossless = None, False  # as the studio begins, too
                try:
                    about = self._studio.about()
                    colors = {layer: layer_color(layer)[0] for layer in about["layers"]}
                    await self._tell({"type": "hello", **about, "layer_colors": colors})
                    await self._send_frames()
                finally:
                    self._inside = False
                    self._studio.leave(self._name)
            left = self._loop.time()
            await self._tell({"type": "waiting", "before": None})
            while self._said_at < left or not self._flow.all_drawn:  # until its user comes back to it
                await self._news()

    async def _tell_waiting(self, before: int) -> None:
        await self._tell({"type": "waiting", "before": before})

    async def _send_frames(self) -> None:
        """Send frames; returns where the client gives up its place to somebody who waits."""
        sending: asyncio.Task[None] | None = None
        again: ShownFrame | None = None
        try:
            while True:
                while not self._flow.has_room:
                    if not await self._news(_STALLED) and self._room.anybody_waits:
                        return
                self._flow.ask()
                pending = asyncio.wrap_future(self._studio.ask(self._name))
                try:
                    while not (await asyncio.wait((pending,), timeout=_STILL))[0]:
                        if again is not None and self._flow.all_drawn and not self._lossless:
                            self._flow.ask()
                            sending, again = await self._send_after(sending, again, fine=True), None
                        if self._room.anybody_waits and self._loop.time() > self._said_at + _IDLE:
                            self._flow.drop()
                            return
                    shown = pending.result()
                except Exception as error:
                    self._flow.drop()
                    if not isinstance(error, MmiError):
                        self._complain(f"a frame was not drawn: {_in_words(error)}")
                    await self._tell({"type": "error", "text": _in_words(error)})
                    await asyncio.sleep(_STILL)
                    continue
                finally:
                    pending.cancel()
                again = shown if self._now_poor else None
                sending = await self._send_after(sending, shown)
        finally:
            if sending is not None:
                sending.cancel()
                await asyncio.gather(sending, return_exceptions=True)

    @property
    def _now_poor(self) -> bool:
        """Whether frames are sent that would be better where the connection was."""
        return self._fixed is None and not self._lossless and self._quality.value < self._quality.best

    async def _send_after(
        self, before: asyncio.Task[None] | None, shown: ShownFrame, *, fine: bool = False
    ) -> asyncio.Task[None]:
        """Have a frame encoded, and sent once the one before it was."""
        quality = _FINE if fine else self._quality.value if self._fixed is None else self._fixed
        lossless = self._lossless
        encoding = self._encoder.png(shown.picture) if lossless else self._encoder.jpeg(shown.picture, quality)
        if before is not None:
            await before

        async def send() -> None:
            encoded = await asyncio.wrap_future(encoding)
            more = {
                "frame": self._flow.send(self._loop.time()),
                "format": encoded.format,
                "quality": None if lossless else quality,
                "ms": {**shown.header["ms"], "encode": 1e3 * encoded.seconds, "way": 1e3 * self._way},
            }
            await self._socket.send_bytes(message({**shown.header, **more}, encoded.data))

        return asyncio.create_task(send())


def _at_most(size: Size, pixels: int) -> Size:
    """``size``, or one of the same shape (as far as the smallest window has it) with no more than so many pixels."""
    share = min(math.sqrt(pixels / (size.width * size.height)), 1.0)
    return Size(max(int(share * size.width), SMALLEST_SIZE[0]), max(int(share * size.height), SMALLEST_SIZE[1]))


def _in_words(error: BaseException) -> str:
    return str(error) if isinstance(error, MmiError) else f"{type(error).__name__}: {error}"
