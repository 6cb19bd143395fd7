"""What stands at a pixel, also behind an impostor: the object, what the dataset keeps of it, what was decided and why.

A measured picture tells which object a pixel shows; the manifest whether it is near or in which layers. Weights and reasons are
in no dataset: the cell is planned again when somebody asks, in a process of its own. Answers are plain data for JSON.

A dataset keeps of an object its id, its solids and its mesh. Attributes that its source has (use, year, name) are not kept: the
id is that of the source, where they can be looked up.
"""

from __future__ import annotations

import math
import re
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

import numpy as np

from mmi.dataset.manifest import CellEntry
from mmi.foundation.camera import View
from mmi.foundation.errors import ParameterError
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.scene.scene import WalkScene
from viewer.window.answers.background import within
from viewer.window.answers.replanning import Replanner

__all__ = ["Picker", "Seen", "seen_at"]

_GROUND, _SKY = -2, -1
_PATIENCE = 2.0
"""Seconds after which somebody who clicked is told that the answer takes longer."""
_OSM = re.compile(r"((?:node|way|relation)/\d+)(#\d+)?")
_NOT_KEPT = "The dataset keeps the id and the geometry, no other attributes: look them up in {source} by this id."
_WAIT = "The cell is still being planned again; the first time takes longest. Click once more in a moment."


@dataclass(frozen=True, slots=True)
class Seen:
    """What a measured picture shows at a pixel: ``object_id`` as in :class:`viewer.drawing.drawn_picture.DrawnPicture`.

    ``point`` is where, metres in the city's frame, and ``distance`` metres from the eye; None for the sky. ``displaced_px`` is
    how far an impostor draws it from where it was captured, None where it is geometry.
    """

    object_id: int
    point: tuple[float, float, float] | None
    distance: float | None
    displaced_px: float | None


def seen_at(picture: DrawnPicture, view: View, x: int, y: int) -> Seen:
    """What a measured ``picture`` of ``view`` shows at column ``x`` and row ``y`` from the upper left.

    Raises ParameterError for a pixel outside of it, ValueError for a picture that was not measured.
    """
    if picture.object_ids is None or picture.depth is None or picture.displacement is None:
        raise ValueError("a measured picture expected")
    height, width = picture.object_ids.shape
    if not (0 <= x < width and 0 <= y < height):
        raise ParameterError(f"a pixel of a picture of {width} x {height} expected, found {x}, {y}")
    found, depth = int(picture.object_ids[y, x]), float(picture.depth[y, x])
    if not math.isfinite(depth):
        return Seen(found, None, None, None)
    left, top, _, _ = view.window
    point = view.unproject(np.array([left + x + 0.5]), np.array([top + y + 0.5]), np.array([depth]))[0]
    angle = float(picture.displacement[y, x])
    displaced = view.focal * math.tan(min(angle, 1.5)) if math.isfinite(angle) else None
    here = (float(point[0]), float(point[1]), float(point[2]))
    return Seen(found, here, float(np.linalg.norm(point - view.eye)), displaced)


class Picker:
    """Answers clicks on pictures of a ``scene``. To be closed."""

    def __init__(self, scene: WalkScene) -> None:
        self._scene = scene
        self._names = tuple(sorted(scene.objects, key=scene.objects.__getitem__))
        self._planner = Replanner(scene.dataset)

    def close(self) -> None:
        """Give up what is being found out."""
        self._planner.close()

    def prepare(self) -> None:
        """Make ready for the first question, in the background: for a large city that takes seconds."""
        self._planner.prepare()

    def told(self, seen: Seen, cell: str | None) -> dict[str, Any]:
        """What is known at once of what was ``seen`` by a viewer in ``cell`` (None: in none), without the plan.

        ``what`` is object, ground, sky or mover. Raises DatasetError for a cell that there is not.
        """
        found: dict[str, Any] = {
            "what": self._what(seen.object_id),
            "distance_m": _rounded(seen.distance, 2),
            "point": None if seen.point is None else [round(one, 3) for one in seen.point],
            "cell": cell,
        }
        if found["what"] == "mover":
            return {**found, "id": self._scene.movers.ids[seen.object_id - len(self._names)]}
        if found["what"] != "object":
            return found
        name, box = self._names[seen.object_id], self._scene.boxes[seen.object_id]
        entry = None if cell is None else self._scene.dataset.cell(cell)
        return {
            **found,
            "id": name,
            "link": None if (osm := _OSM.fullmatch(name)) is None else f"https://www.openstreetmap.org/{osm[1]}",
            "shown_as": "geometry" if seen.displaced_px is None else "impostor",
            "displaced_px": _rounded(seen.displaced_px, 2),
            "base_m": _rounded(float(box[0, 2]), 2),
            "top_m": _rounded(float(box[1, 2]), 2),
            "height_m": _rounded(float(box[1, 2] - box[0, 2]), 2),
            "triangles": int(self._scene.mesh.triangle_counts[seen.object_id]),
            "attributes": {},
            "attributes_note": _NOT_KEPT.format(source=self._scene.dataset.manifest.city.source or "the source"),
            **_part(entry, name),
        }

    def explained(self, seen: Seen, cell: str | None, *, patience: float = _PATIENCE) -> Future[dict[str, Any]]:
        """What :meth:`told` says and, as ``why`` and ``kept``, what the planner says; resolved within ``patience`` seconds.

        Never raises for what cannot be planned again: ``why`` says so in words then.
        """
        known = self.told(seen, cell)
        if known["what"] != "object" or cell is None:
            done: Future[dict[str, Any]] = Future()
            done.set_result(known)
            return done
        asked = self._planner.ask(cell, seen.object_id)
        answer: Future[dict[str, Any]] = Future()

        def tell(found: Future[dict[str, Any]]) -> None:
            if not answer.set_running_or_notify_cancel():
                return
            if found.cancelled():
                answer.set_result({**known, "why": {"planned": False, "answer": "The viewer has ended."}})
            elif (error := found.exception()) is not None:
                answer.set_exception(error)
            else:
                answer.set_result({**known, **found.result()})

        within(
            patience, asked, lambda: {"why": {"planned": False, "waiting": True, "answer": _WAIT}}
        ).add_done_callback(tell)
        return answer

    def _what(self, object_id: int) -> str:
        if object_id < 0:
            return {_GROUND: "ground", _SKY: "sky"}.get(object_id, "sky")
        return "object" if object_id < len(self._names) else "mover"


def _part(entry: CellEntry | None, name: str) -> dict[str, Any]:
    """The part that an object has in a cell: ``role`` near, far, hidden, or none outside of all cells; and in which layers."""
    if entry is None:
        return {"role": "none", "layers": []}
    if name in entry.near:
        return {"role": "near", "layers": []}
    if name not in entry.far:
        return {"role": "hidden", "layers": []}
    place = entry.far.index(name)
    shown = [(one.index, sector, one.name) for sector, one in entry.pictures if place in one.objects]
    layers = [
        {
            "layer": layer,
            "sectors": sorted({sector for index, sector, _ in shown if index == layer}),
            "pictures": [picture for index, _, picture in shown if index == layer],
        }
        for layer in sorted({index for index, _, _ in shown})
    ]
    return {"role": "far", "layers": layers}


def _rounded(value: float | None, digits: int) -> float | None:
    """For JSON, which knows no infinity."""
    return None if value is None or not math.isfinite(value) else round(value, digits)
