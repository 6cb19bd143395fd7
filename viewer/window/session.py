"""One client's view: its walker and its look, the techniques that it compares, and one frame when asked.

A session belongs to the thread that draws. What its client tells comes as :class:`viewer.window.mailbox.Mail`; what time it is
comes from outside as well, so that a film is made as a window is.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mmi.cells.whereabouts import HYSTERESIS
from mmi.foundation.camera import Camera, View
from mmi.foundation.errors import ParameterError
from mmi.walks.walk import Pose, Walk, walk_document
from viewer.runtime.loop import Frame
from viewer.techniques.catalogue import REFERENCE
from viewer.walks.recording import Playing, Recording
from viewer.window.answers.worst_region import WorstFinder, promised
from viewer.window.commands import GoTo, PutAt, WalkCommand
from viewer.window.composing import BLINK, Pictures, Seen
from viewer.window.mailbox import Mail
from viewer.window.motion import EYE_HEIGHT, LONGEST, Walker, moved
from viewer.window.stage import Stage, Streets, window_camera

__all__ = ["Session", "ShownFrame"]

_TOUR = 600.0
"""Metres of a tour."""
_ABOVE = 1.0
"""Metres above and below a cell's eyes at which a viewer counts as outside of it."""
_AGAIN = 0.2
"""Seconds after a frame that failed until somebody who moves on is drawn again."""
_FIRST = 1.0 / 60.0
"""Seconds that pass before the first frame after a time without any."""


@dataclass(frozen=True, slots=True, eq=False)
class ShownFrame:
    """A frame: its ``picture`` (h, w, 3) uint8, top row first, which nobody writes to again, and what is said of it."""

    picture: NDArray[np.uint8]
    header: dict[str, Any]


def _nothing() -> None:
    """Nobody waits."""


@dataclass(slots=True, eq=False)
class Session:
    """One viewer. ``client`` names it, ``mail`` is how it begins."""

    client: str
    stage: Stage
    streets: Streets
    mail: Mail
    walker: Walker = field(init=False)
    frozen: Pose | None = None
    """Where the impostors' plan is held, while that is asked for."""
    playing: Playing | None = None
    recording: Recording | None = None
    recorded: Walk | None = None
    last: ShownFrame | None = None
    """What was shown last."""
    number: int = 0
    failed: bool = False
    pictures: Pictures = field(init=False)
    wake: Callable[[], None] = _nothing
    """Is called, by any thread, when the session has become due."""
    _finder: WorstFinder | None = None
    _finding: bool = False
    _asked: int = 0
    _found: dict[str, Any] | None = None
    _worst: dict[str, Any] | None = None
    _last: float | None = None
    _now: float = 0.0
    _jumped: bool = True
    _blinked: bool = False
    _blink_since: float = 0.0
    _still: bool = False
    _shown_still: bool = False

    def __post_init__(self) -> None:
        self.walker = Walker(self.streets.start)
        self.pictures = Pictures(self.client, self.stage)

    # ------------------------------------------------------------------------------------------------- what is due

    def due(self, now: float) -> bool:
        """Whether there would be something new to see without any more mail."""
        at = self.due_at(now)
        return at is not None and at <= now

    def due_at(self, now: float) -> float | None:
        """When there will be something new to see without any more mail; None for never."""
        held = self.mail.held
        if self.failed:  # who stands would see the same error again; who moves comes to where there is none
            moves = self.playing is not None or self.walker.moves or not held.nothing
            return self._last + _AGAIN if moves and self._last is not None else None
        if (
            self.number == 0
            or self.playing is not None
            or self.walker.moves
            or not (held.nothing and self._shown_still)
        ):
            return now
        if not self.pictures.settled or (self.mail.look.worst and self._found is not self._worst):
            return now
        return self._blink_since + BLINK if self.mail.look.mode == "blink" else None

    # ----------------------------------------------------------------------------------------------------- a frame

    def frame(self, mail: Mail, now: float) -> ShownFrame:
        """The next frame, at ``now`` seconds of any clock. Raises what drawing raises."""
        start = clock.perf_counter()
        self._take(mail)
        self._pass_time(mail, now)
        look, size = self.mail.look, self.mail.size
        seen = self._seen()
        inside = seen.inside
        picture = self.pictures.draw(look, seen)
        self._jumped = False
        frames, composing = self.pictures.drawn, self.pictures.composing
        cell = next((one.plan.place for _, one in frames if one.plan.place), "") or self.cell
        self.number += 1
        self._shown_still = self._still
        self.failed = False
        drawing = sum(one.times.drawing for _, one in frames)
        other = composing + sum(
            one.times.planning + one.times.loading + one.times.waiting + one.times.uploading for _, one in frames
        )
        pose = self.walker.pose
        header = {
            "frame": self.number,
            "seq": mail.seq,
            "width": size[0],
            "height": size[1],
            "pose": [*pose.eye, pose.azimuth, pose.pitch],
            "cell": cell,
            "inside": inside,
            "still": self._still,
            "views": self.pictures.told(),
            "ms": {
                "render": 1e3 * drawing,
                "read": 1e3 * max(clock.perf_counter() - start - drawing - other, 0.0),
                "compose": 1e3 * composing,
            },
            "budget_ms": look.budget_ms,
            "recording": self.recording is not None,
            "playing": None if self.playing is None else self.playing.kind,
            "frozen": self.frozen is not None,
            "worst": self._worst if look.worst else None,
            "promised_px": self._promised(),
        }
        picture.setflags(write=False)
        self.last = ShownFrame(picture, header)
        return self.last

    def measured_at(self, x: int) -> tuple[Frame, View, int]:
        """The measured picture that column ``x`` of the window is of: its frame, the view that it was drawn from, and the
        column in it. Raises ParameterError for a column outside of the window.
        """
        look, seen = self.mail.look, self._seen()
        panel = self.pictures.panel_at(look, seen, x)
        frame, view = self.pictures.measured(panel.technique, panel, look, seen)
        return frame, view, x if panel.whole else x - panel.first

    def find_worst(self) -> None:
        """Have the worst region of the picture that is shown found, if somebody wants to know it and the viewer stands.

        It is told with a later frame, which is due then.
        """
        look, seen = self.mail.look, self._seen()
        if not (look.worst and self._shown_still and self.pictures.settled) or self._finding or self.frozen is not None:
            return
        self._finding = True
        panel = self.pictures.panel_at(look, seen, seen.size[0] - 1)
        truth, view = self.pictures.measured(REFERENCE, panel, look, seen)
        shown, _ = self.pictures.measured(look.right, panel, look, seen)
        promise = promised(self.stage.main, shown.plan.place or None, view)
        if self._finder is None:
            self._finder = WorstFinder()
        future = self._finder.ask(truth.picture, shown.picture, view, promise)
        number = self._asked = self._asked + 1
        first = 0 if panel.whole else panel.first

        def found(future: Future[dict[str, Any] | None]) -> None:
            if future.cancelled() or future.exception() is not None or number != self._asked:
                return
            worst = future.result()
            if worst is not None and worst["box"] is not None:
                worst = {**worst, "box": [worst["box"][0] + first, *worst["box"][1:]]}
            self._found = worst
            self.wake()

        future.add_done_callback(found)

    def _forget_worst(self) -> None:
        self._finding, self._found, self._asked = False, None, self._asked + 1
        if self._finder is not None:
            self._finder.give_up()

    def _seen(self) -> Seen:
        return Seen(self.walker.pose, self._now, self.mail.size, self.frozen, self.inside, self._jumped, self._blinked)

    @property
    def inside(self) -> bool:
        """Whether the viewer is where impostors are meant to be seen from."""
        if self.frozen is not None:
            return True
        eye = np.array(self.walker.pose.eye)
        whereabouts = self.stage.main.whereabouts
        cells = whereabouts.cells
        away = whereabouts.distances(eye)
        place = int(np.argmin(away))
        if away[place] > HYSTERESIS:
            return False
        low, high = cells[place].eye
        return bool(low - _ABOVE <= eye[2] <= high + _ABOVE)

    @property
    def camera(self) -> Camera:
        """The camera of the window."""
        return window_camera(self.stage.main.camera, self.mail.size)

    # ------------------------------------------------------------------------------------------------------- walks

    def command(self, command: WalkCommand) -> dict[str, Any]:
        """Do what is said about walks; the reply. Raises ParameterError where there is no walk to replay."""
        self._shown_still = False  # the next frame says what is played and recorded
        match command.do:
            case "record":
                self.recording = Recording()
                self.recording.add(self.walker.pose, 0.0)
            case "stop":
                self.playing = None
                if self.recording is not None:
                    self.recorded = self.recording.walk("a recorded walk")
                    self.recording = None
                    return {"type": "walk", "walk": None if self.recorded is None else walk_document(self.recorded)}
                return {"type": "walk", "walk": None}
            case "tour":
                self.play(self.streets.tour(_TOUR), "tour")
            case _:
                walk = command.walk or self.recorded
                if walk is None:
                    raise ParameterError("a walk to replay expected, found none: record one first, or send one")
                self.play(walk, "walk")
        return {"type": "walk", "walk": None}

    def play(self, walk: Walk, kind: str) -> None:
        """Play a walk from its beginning on."""
        self.playing = Playing(walk, kind)
        self._put(self.playing.pose)

    def close(self) -> None:
        """Let go of what the session has on the stage."""
        self.pictures.close()
        if self._finder is not None:
            self._finder.close()

    # ------------------------------------------------------------------------------------------------ what happens

    def _take(self, mail: Mail) -> None:
        before, self.mail = self.mail, mail
        if (mail.size, mail.look) != (before.size, before.look):
            self.pictures.unsettle()
            self._forget_worst()
        if mail.look.mode != before.look.mode:
            self._blinked = False
        if mail.look.freeze:
            self.frozen = self.frozen or self.walker.pose
        elif self.frozen is not None:  # back to where the flight began
            frozen, self.frozen = self.frozen, None
            if not mail.look.fly and mail.put is None:
                self._put(frozen)

    def _pass_time(self, mail: Mail, now: float) -> None:
        """Move the walker by the time since the last frame."""
        active = self.number == 0 or not self._still or not mail.held.nothing or mail.turned != (0.0, 0.0)
        seconds = 0.0 if self._last is None else min(now - self._last, LONGEST)
        if self._still and active:  # it stood, and nobody looked at the clock
            seconds = min(seconds, _FIRST)
        self._last = now
        self._now += max(seconds, 0.0)
        before = self.walker.pose
        if mail.put is not None:
            self.playing = None
            self._put(self._place(mail.put))
        busy = not mail.held.nothing or mail.turned != (0.0, 0.0)
        if self.playing is not None and busy:
            self.playing = None
        if self.playing is not None:
            playing = self.playing
            playing.seconds += seconds
            after = playing.pose
            self._jumped = self._jumped or math.dist(after.eye, before.eye) > 10.0
            self.walker = Walker(after)
            if playing.over:
                self.playing = None
        else:
            self.walker = moved(
                self.walker, mail.held, mail.turned, seconds, self.streets, fast=mail.fast, fly=self._flies
            )
        self._still = self.walker.pose == before and not self._jumped and self.playing is None
        if self.recording is not None and (not self._still or seconds > 0.0):
            self.recording.add(self.walker.pose, seconds, jumped=self._jumped)
            if self.recording.full:
                self.recorded, self.recording = self.recording.walk("a recorded walk"), None
        if self.mail.look.mode == "blink" and now - self._blink_since >= BLINK:
            self._blinked, self._blink_since = not self._blinked, now
        if not self._still:
            self.pictures.unsettle()
            self._forget_worst()
        self._worst = self._found

    def _promised(self) -> dict[str, float | None] | None:
        """What is promised of this view, pixels of the window; None for nothing."""
        seen = self._seen()
        if not seen.inside or seen.frozen is not None:
            return None
        found = promised(self.stage.main, self.cell, seen.pose.view(self.camera))
        if found.thickness is None or found.displacement is None:
            return None
        return {"thickness": round(found.thickness, 2), "displacement": round(found.displacement, 2)}

    @property
    def _flies(self) -> bool:
        return self.mail.look.fly or self.frozen is not None

    def _put(self, pose: Pose) -> None:
        self.walker, self._jumped = Walker(pose), True

    def _place(self, put: GoTo | PutAt) -> Pose:
        if isinstance(put, PutAt):
            return put.pose
        x, y = self.streets.nearest_place(put.to)
        pose = self.walker.pose
        return Pose((x, y, self.streets.ground((x, y)) + EYE_HEIGHT), pose.azimuth, 0.0)

    @property
    def cell(self) -> str:
        """The cell that the viewer is in, or the nearest one."""
        eye = np.array(self.walker.pose.eye)
        return self.stage.main.whereabouts.cell_at(eye, current=None)
