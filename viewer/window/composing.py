"""A session's pictures: the techniques that it compares, each with its frame loop, and what they come to in one picture.

panels     what has to be drawn for a look, and where in the window it goes
Pictures   draws that, and puts it together: side by side, under a swipe, in turns, or as a difference
"""

from __future__ import annotations

import math
import time as clock
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mmi.foundation.camera import View
from mmi.foundation.errors import ParameterError
from mmi.walks.walk import Pose
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.measuring.view_errors import WrongRegions, wrong_regions
from viewer.plan import CellLayers, Nailboards, Objects, Plan, Relief
from viewer.runtime.loop import Frame, FrameLoop
from viewer.techniques.catalogue import REFERENCE, find_technique, make_technique
from viewer.window.look import Look
from viewer.window.palettes import WRONG, depth_picture, difference_picture, objects_picture, wrong_picture
from viewer.window.stage import Painting, Stage, window_camera

__all__ = ["BLINK", "Panel", "Pictures", "Seen", "panels", "thick"]

BLINK = 0.5
"""Seconds that a blinking picture shows each technique."""
_TURNS = 1e-3
"""Seconds after which other threads may take the interpreter from a frame: a window answers while it draws."""
_NEVER_LATE = frozenset({"full", "visible", "local", "single-mesh", "multi-mesh"})
"""Techniques that do the same whatever time there is, and so need not know what things cost."""
_FRAME = 1.0 / 20.0
"""Seconds that a frame should take at most; updates get what drawing leaves of it, within the client's own budget."""
_SETTLED = 3
"""A view is settled when it was drawn so many times without anything being captured for it."""


@dataclass(frozen=True, slots=True)
class Panel:
    """A technique's part of the window: columns ``first`` to before ``end``.

    It is a picture of its own, or, where ``whole``, those columns of a picture of the whole window.
    """

    technique: str
    first: int
    end: int
    whole: bool = True


def panels(look: Look, size: tuple[int, int], *, blinked: bool = False) -> tuple[Panel, ...]:
    """The panels that ``look`` has in a window of ``size``; ``blinked``: it is the left technique's turn."""
    width = size[0]
    left, right = look.left, look.right
    match look.mode:
        case "side":
            half = width // 2
            return Panel(left, 0, half, whole=False), Panel(right, half, width, whole=False)
        case "swipe":
            cut = 0 if left == right else round(look.swipe * width)
            found = (Panel(left, 0, cut), Panel(right, cut, width))
            return tuple(one for one in found if one.first < one.end)
        case "blink":
            return (Panel(left if blinked else right, 0, width),)
        case "difference":
            return Panel(left, 0, width), Panel(right, 0, width)
        case _:
            return (Panel(right, 0, width),)


@dataclass(frozen=True, slots=True)
class Seen:
    """From where a picture is drawn: ``pose`` at ``time`` (seconds), in a window of ``size``.

    ``frozen`` is where the impostors' plan is held, if it is; ``inside``: impostors are meant to be seen from here. ``cut``:
    the viewer was put here. ``blinked``: it is the left technique's turn.
    """

    pose: Pose
    time: float
    size: tuple[int, int]
    frozen: Pose | None = None
    inside: bool = True
    cut: bool = False
    blinked: bool = False


@dataclass(slots=True, eq=False)
class _Line:
    """A technique as this session draws it."""

    loop: FrameLoop
    painting: Painting
    share: str
    quiet: int = 0
    """Frames since anything was captured."""


@dataclass(slots=True, eq=False)
class Pictures:
    """The pictures of one ``client``. ``drawn`` is what techniques drew in the last one, by the names that were asked for."""

    client: str
    stage: Stage
    drawn: list[tuple[str, Frame]] = field(default_factory=list)
    composing: float = 0.0
    """Seconds of the last picture that went into putting it together."""
    _lines: dict[str, _Line] = field(default_factory=dict)
    _last: list[_Line] = field(default_factory=list)

    @property
    def settled(self) -> bool:
        """Whether the last picture would be the same if it was drawn again."""
        return all(line.quiet >= _SETTLED for line in self._last)

    def unsettle(self) -> None:
        """Something has changed, so that all is drawn anew."""
        for line in self._lines.values():
            line.quiet = 0

    def close(self) -> None:
        """Let go of what there is on the stage."""
        for line in self._lines.values():
            self.stage.forget(line.share)

    def draw(self, look: Look, seen: Seen) -> NDArray[np.uint8]:
        """The picture (h, w, 3) that ``look`` has of what is ``seen``. Raises what drawing raises."""
        self.drawn, self._last, self.composing = [], [], 0.0
        width, height = seen.size
        if look.mode == "wrong":
            return self._wrong(look, seen)
        apart, measured = look.mode == "difference", look.show in ("depth", "objects")
        picture = np.empty((height, width, 3), dtype=np.uint8)
        pictures = []
        for panel in panels(look, seen.size, blinked=seen.blinked):
            into = np.empty_like(picture) if apart else picture[:, panel.first : panel.end]
            drawn = self._draw(panel, None if measured else into, look, seen, measured=measured)
            pictures.append(into)
            start = clock.perf_counter()
            if look.show == "depth" and drawn.depth is not None:
                into[...] = depth_picture(drawn.depth)
            elif look.show == "objects" and drawn.object_ids is not None:
                into[...] = objects_picture(drawn.object_ids)
            self.composing += clock.perf_counter() - start
        if not apart:
            return picture
        start = clock.perf_counter()
        picture = difference_picture(*pictures)
        self.composing += clock.perf_counter() - start
        return picture

    def panel_at(self, look: Look, seen: Seen, x: int) -> Panel:
        """The panel that column ``x`` of the window is in, the last one where there are several.

        Raises ParameterError for a column outside of the window.
        """
        if not 0 <= x < seen.size[0]:
            raise ParameterError(f"a column of a window {seen.size[0]} pixels wide expected, found {x}")
        shown = Look(right=look.right, mode="one") if look.mode == "wrong" else look
        return [one for one in panels(shown, seen.size, blinked=seen.blinked) if one.first <= x < one.end][-1]

    def measured(self, technique: str, panel: Panel, look: Look, seen: Seen) -> tuple[Frame, View]:
        """The measured picture of a technique as ``panel`` has it, whole, and the view that it was drawn from.

        What is said of the last picture stays.
        """
        size = (seen.size[0] if panel.whole else panel.end - panel.first, seen.size[1])
        drawn, last = self.drawn, self._last
        self.drawn, self._last = [], []
        try:
            whole, plain = Panel(technique, 0, size[0]), Look(budget_ms=look.budget_ms)
            self._draw(whole, None, plain, replace(seen, size=size), measured=True)
            frame = self.drawn[-1][1]
        finally:
            self.drawn, self._last = drawn, last
        return frame, seen.pose.view(window_camera(self.stage.main.camera, size))

    def _wrong(self, look: Look, seen: Seen) -> NDArray[np.uint8]:
        truth = self._draw(Panel(REFERENCE, 0, seen.size[0]), None, look, seen, measured=True)
        shown = self._draw(Panel(look.right, 0, seen.size[0]), None, look, seen, measured=True)
        start = clock.perf_counter()
        found = wrong_regions(truth, shown)
        kept = thick(found.wrong, self.threshold(look, seen.size))
        picture = wrong_picture(shown.color, WrongRegions(kept, kept & found.holes))
        thin = found.wrong & ~kept
        picture[thin] = picture[thin] // 2 + np.array(WRONG, dtype=np.uint8) // 2
        self.composing += clock.perf_counter() - start
        return picture

    def threshold(self, look: Look, size: tuple[int, int]) -> float:
        """Pixels of a window that a wrong region must be thick to count."""
        if look.threshold_px is not None:
            return look.threshold_px
        main = self.stage.main
        return window_camera(main.camera, size).pixels_from_angle(main.parameters.max_angle)

    def told(self) -> list[dict[str, Any]]:
        """What is said of each technique's last picture."""
        found = []
        for line, (name, frame) in zip(self._last, self.drawn, strict=True):
            megabytes = 1e-6 * self.stage.bytes_of(frame.plan, line.share)
            preparing = not self.stage.prepared(name)
            found.append(_told(name, frame) | {"memory_mb": round(megabytes, 3), "preparing": preparing})
        return found

    def _draw(
        self, panel: Panel, into: NDArray[np.uint8] | None, look: Look, seen: Seen, *, measured: bool
    ) -> DrawnPicture:
        name = panel.technique
        if (not seen.inside and find_technique(name).layered) or not self.stage.prepared(name):
            name = REFERENCE
        line = self._line(name)
        width, height = seen.size
        size = (width, height) if panel.whole else (panel.end - panel.first, height)
        camera = window_camera(self.stage.main.camera, size)
        painting, loop = line.painting, line.loop
        painting.size, painting.into, painting.measured = size, into, measured
        painting.columns = (panel.first, panel.end) if panel.whole and panel.end - panel.first < width else None
        layered = find_technique(name).layered
        painting.tint, painting.wireframe = look.show == "layers", look.wireframe
        painting.layer = look.layer if layered else None
        held = seen.frozen if layered else None
        painting.flying = None if held is None else seen.pose.view(camera)
        loop.camera = camera
        loop.updates = math.inf if look.budget_ms is None else 1e-3 * look.budget_ms
        frame = loop.frame(held or seen.pose, seen.time, cut=seen.cut, read=True)
        busy = frame.plan.requests or frame.plan.mix < 1.0 or frame.times.done.fresh
        line.quiet = 0 if busy or not self.stage.prepared(panel.technique) else line.quiet + 1
        self._last.append(line)
        self.drawn.append((panel.technique, frame))
        return frame.picture

    def _line(self, name: str) -> _Line:
        if name not in self._lines:
            share = f"{self.client} {name}"
            painting = Painting(self.stage, self.stage.main)
            technique = make_technique(name, self.stage.scenes, rules=self.stage.rules, owner=share)
            main = self.stage.main
            loop = FrameLoop(
                technique,
                painting,
                self.stage.share(share),
                camera=main.camera,
                budget=_FRAME,
                costs=None if name in _NEVER_LATE else self.stage.costs,
                turns=_TURNS,
            )
            self._lines[name] = _Line(loop, painting, share)
        return self._lines[name]


def thick(wrong: NDArray[np.bool_], pixels: float) -> NDArray[np.bool_]:
    """Those of (h, w) wrong pixels that lie in a wrong square of about so many ``pixels`` a side: thinner parts vanish."""
    side = round(pixels)
    if side <= 1 or not wrong.any():
        return wrong
    kept = ndimage.minimum_filter(wrong.view(np.uint8), side, mode="constant")
    found: NDArray[np.bool_] = ndimage.maximum_filter(kept, side, mode="constant", origin=-(1 - side % 2)).view(
        np.bool_
    )
    return found


def _told(name: str, frame: Frame) -> dict[str, Any]:
    """What is said of a technique's picture."""
    times, plan = frame.times, frame.plan
    return {
        "technique": name,
        "triangles": times.triangles,
        "draws": times.draws,
        "ms": {
            "plan": 1e3 * times.planning,
            "requests": 1e3 * times.done.requests.seconds,
            "draws": 1e3 * times.done.draws.seconds,
            "loading": 1e3 * (times.loading + times.waiting + times.uploading),
        },
        **_counted(plan),
    }


def _counted(plan: Plan) -> dict[str, int]:
    """How many layers are drawn as they are stored, are captured now, and were captured before; and near objects."""
    stored = sum(len(draw.names) for draw in plan.draws if isinstance(draw, CellLayers))
    reliefs = sum(len(draw.parts) for draw in plan.draws if isinstance(draw, Relief))
    reliefs += sum(len(draw.depths) for draw in plan.draws if isinstance(draw, Nailboards))
    captured = len(plan.requests)
    near = sum(len(draw.objects) for draw in plan.draws if isinstance(draw, Objects))
    return {"stored": stored, "captured": captured, "reused": max(reliefs - captured, 0), "near": near}
