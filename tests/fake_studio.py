"""A studio without OpenGL, for tests of the server and the page: it shows a picture of stripes that move with the viewer.

It keeps what clients told it, so that tests can look, and does what a studio promises: a client's next frame is made only while
its future waits, and only where something changed.
"""

import math
import threading
import time
from concurrent.futures import Future
from dataclasses import asdict, dataclass

import numpy as np

from mmi.foundation.errors import MmiError

LOOK = {
    "mode": "swipe", "left": "full", "right": "multi-mesh", "swipe": 0.5, "show": "picture", "wireframe": False, "layer": None,
    "freeze": False, "worst": False, "budget_ms": 5.0, "threshold_px": None, "lossless": False, "fly": False, "quality": None,
}  # fmt: skip


@dataclass(frozen=True)
class Shown:
    picture: np.ndarray
    header: dict


class FakeStudio:
    """See the module. ``seconds`` is what drawing takes; ``broken`` makes frames fail."""

    def __init__(self, *, seconds=0.0, most=4, films=None):
        self.seconds, self.most, self.films, self.broken = seconds, most, films, False
        self.clients, self.told, self.left = {}, [], []
        self.drawn = 0
        self._changed = threading.Condition()
        self._running = False

    def __enter__(self):
        self._running = True
        self._thread = threading.Thread(target=self._draw, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_):
        with self._changed:
            self._running = False
            self._changed.notify()
        self._thread.join()

    def about(self):
        return {
            "dataset": "crossroads", "techniques": ["full", "visible", "multi-mesh"], "display": [512, 512],
            "fov_degrees": 60.0,
            "max_error_px": 10.0, "cells": 5, "layers": [0, 1, 2], "promise_px": {"thickness": 12.0, "displacement": 10.0},
            "pose": [0.0, 0.0, 1.7, 0.0, 0.0], "look": LOOK, "credits": "nobody's city", "device": "a fake",
        }  # fmt: skip

    def join(self, client, size):
        with self._changed:
            assert len(self.clients) < self.most
            self.clients[client] = {
                "size": size, "look": dict(LOOK), "held": {}, "pose": [0.0, 0.0, 1.7, 0.0, 0.0],
                "seq": 0, "new": True, "ask": None,
                "fast": False, "at": time.perf_counter(),
            }  # fmt: skip

    def leave(self, client):
        with self._changed:
            self.clients.pop(client, None)
            self.left.append(client)

    def tell(self, client, command):
        with self._changed:
            self.told.append((client, command))
            one = self.clients.get(client)
            if one is None:
                return
            match type(command).__name__:
                case "Input":
                    one["seq"], one["held"], one["fast"] = command.seq, asdict(command.held), command.fast
                    one["pose"][3] += command.look[0]
                    one["pose"][4] += command.look[1]
                case "LookChange":
                    one["look"] |= command.fields
                case "Size":
                    one["size"] = (command.width, command.height)
                case "GoTo":
                    one["pose"][:2] = command.to
                case "PutAt":
                    one["pose"] = [*command.pose.eye, command.pose.azimuth, command.pose.pitch]
            one["new"] = True
            self._changed.notify()

    def ask(self, client):
        future = Future()
        with self._changed:
            if client in self.clients:
                self.clients[client]["ask"] = future
            self._changed.notify()
        return future

    def answer(self, client, command, told=None):
        future = Future()
        kind = type(command).__name__
        self.told.append((client, command))
        if kind == "Pick":
            future.set_result(
                {
                    "type": "picked", "what": "object", "id": "way/42#0", "link": "https://www.openstreetmap.org/way/42",
                    "distance_m": 84.25, "shown_as": "impostor", "displaced_px": 1.5, "height_m": 21.0, "base_m": 0.0,
                    "top_m": 21.0, "triangles": 36, "attributes": {}, "attributes_note": "Nothing is kept.", "role": "far",
                    "layers": [{"layer": 2, "sectors": [1], "pictures": ["s1.l2"]}], "cell": "0001-00",
                    "why": {
                        "planned": True, "answer": "It is in layer 2 of 3.", "threshold_px": 10.0, "missed_px": 2.0,
                        "reasons": [], "neighbours": [{"id": "way/43#0", "weight_px": 14.5, "apart": True, "layer": 1}],
                    },
                }
            )  # fmt: skip
        elif kind == "AskMap":
            future.set_result({"type": "map", "footprints": [], "cells": []})
        elif kind == "Save":
            one = self.clients[client]
            width, height = one["size"]
            picture = stripes(one["pose"], width, height, one["look"]["swipe"])
            future.set_result({"type": "saved", "frame": Shown(picture, header(one) | {"saved": True})})
        elif kind == "Film" and self.films is not None:
            told(3, 9)
            (self.films / "tour.mp4").write_bytes(b"a film")
            future.set_result({"type": "film", "url": "/films/tour.mp4"})
        else:
            future.set_exception(MmiError(f"{kind}: the fake studio cannot"))
        return future

    def _draw(self):
        with self._changed:
            while self._running:
                waiting = [
                    one for one in self.clients.values()
                    if one["ask"] is not None and (one["new"] or any(one["held"].values()))
                ]  # fmt: skip
                if not waiting:
                    self._changed.wait(0.1)
                    continue
                for one in waiting:
                    self._one(one)

    def _one(self, one):
        future, one["ask"] = one["ask"], None
        now = time.perf_counter()
        passed, one["at"], one["new"] = min(now - one["at"], 0.1), now, False
        if not future.set_running_or_notify_cancel():
            one["new"] = True
            return
        if self.broken:
            future.set_exception(MmiError("a frame that could not be drawn"))
            return
        if self.seconds:
            self._changed.wait_for(lambda: not self._running, self.seconds)
        self.drawn += 1
        x, y, z, heading, pitch = one["pose"]
        step = one["held"].get("forward", 0.0) * passed * (20.0 if one["fast"] else 5.0)
        heading += one["held"].get("turn", 0.0) * passed
        one["pose"] = [x + step * math.cos(heading), y + step * math.sin(heading), z, heading, pitch]
        width, height = one["size"]
        future.set_result(Shown(stripes(one["pose"], width, height, one["look"]["swipe"]), header(one)))


def stripes(pose, width, height, swipe):
    """A picture that says where it was taken from: stripes by the place and heading, another colour right of the swipe."""
    picture = np.empty((height, width, 3), dtype=np.uint8)
    across = (np.arange(width) + 10.0 * pose[0] + 400.0 * pose[3]) / 40.0
    picture[:] = (128 + 90 * np.sign(np.sin(across)))[None, :, None]
    picture[: height // 2, :, 2] = 200
    picture[:, round(swipe * width) :, 0] //= 2
    return picture


def header(one):
    width, height = one["size"]
    views = [
        {
            "technique": one["look"][side], "triangles": 1000, "draws": 10, "memory_mb": 10.0, "stored": 3,
            "captured": 1, "reused": 2,
            "near": 4, "ms": {"plan": 0.1, "requests": 0.0, "draws": 5.0, "loading": 0.0},
        }
        for side in ("left", "right")
    ]  # fmt: skip
    return {
        "seq": one["seq"], "width": width, "height": height, "pose": one["pose"], "cell": "0001-00",
        "inside": abs(one["pose"][0]) < 50.0,
        "still": not any(one["held"].values()), "views": views, "ms": {"render": 5.0, "read": 1.0, "compose": 0.5},
        "budget_ms": one["look"]["budget_ms"], "recording": False, "playing": None, "frozen": False, "worst": None,
    }  # fmt: skip
