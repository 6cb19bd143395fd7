"""The worst region of a picture, next to what the dataset promises: where wrong pixels are thickest, and how thick.

Found in the background, since it takes longer than a frame, and only for a viewer who stands still. Pixels are those of the
picture; the promise is one of angles, told in them.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import find_objects, label

from mmi.foundation.camera import View
from mmi.foundation.thickness import largest_disc
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.measuring.view_errors import wrong_regions
from viewer.scene.scene import WalkScene
from viewer.window.answers.background import Background

__all__ = ["Promised", "WorstFinder", "promised", "thickest", "worst_region"]

_SAMPLING_PX = 2.0
"""What thickness may exceed the threshold by, as edges of pixels and of texels fall where they fall (docs/bound.md)."""
_INSIDE = 0.05
"""Metres outside of a cell that count as inside."""
_MARGIN = 6
"""Pixels between the region and its box."""
_LARGEST = 1.5
"""Radians; no angle that is shown is larger."""


class Promised(NamedTuple):
    """What the manifest promises of a view, in pixels of its picture: how thick wrong regions are, and how far what impostors
    show is displaced, at most. None where nothing is promised, and ``why`` says why.
    """

    thickness: float | None
    displacement: float | None
    why: str | None = None


def promised(scene: WalkScene, cell: str | None, view: View) -> Promised:
    """What is promised of ``view`` from ``cell``, None for no cell. Raises DatasetError for a cell that there is not.

    A cell promises for all viewpoints inside, and nothing of others: not of a viewer who flies, nor of one who has just
    left it.
    """
    if cell is None:
        return Promised(None, None, "The viewer is in no cell of the dataset.")
    entry = scene.dataset.cell(cell)
    if entry.promised_error_px is None:
        return Promised(None, None, f"Nothing is promised for cell {cell}: {entry.promise_withheld}.")
    place, (x, y, z) = entry.viewing_cell, view.eye.tolist()
    inside = shapely.distance(shapely.polygons(place.corners), shapely.points(x, y)) <= _INSIDE
    if not (inside and place.eye[0] - _INSIDE <= z <= place.eye[1] + _INSIDE):
        return Promised(None, None, f"The viewer is outside of cell {cell}: nothing is promised there.")
    threshold = view.focal * math.tan(scene.parameters.camera.angle_from_pixels(entry.promised_error_px))
    return Promised(threshold + _SAMPLING_PX, threshold)


def worst_region(
    truth: DrawnPicture,
    shown: DrawnPicture,
    view: View,
    promise: Promised,
    *,
    stopped: Callable[[], bool] = lambda: False,
) -> dict[str, Any] | None:
    """The thickest region in which ``shown`` shows other objects than ``truth``, both measured pictures of ``view``.

    Plain data: its ``box`` (x, y, width, height in pixels; None where nothing is wrong), ``thickness_px``, ``wrong_share``,
    the largest ``displacement_px`` of what impostors show, ``promised_px`` of both, and ``why`` where nothing is promised.
    None where ``stopped`` says to give up. Raises ValueError for pictures that were not measured or differ in size.
    """
    if shown.displacement is None:
        raise ValueError("two measured pictures expected, found one without displacement")
    wrong = wrong_regions(truth, shown).wrong
    found = thickest(wrong, stopped=stopped)
    if found is None:
        return None
    thickness, box = found
    angles = shown.displacement[np.isfinite(shown.displacement)]
    angle = min(float(angles.max(initial=0.0)), _LARGEST)
    return {
        "box": None if box is None else _grown(box, wrong.shape),
        "thickness_px": round(thickness, 2),
        "displacement_px": round(view.focal * math.tan(angle), 2),
        "wrong_share": round(float(wrong.mean()), 6),
        "promised_px": {"thickness": _rounded(promise.thickness), "displacement": _rounded(promise.displacement)},
        "why": promise.why,
    }


def thickest(
    wrong: NDArray[np.bool_], *, stopped: Callable[[], bool] = lambda: False
) -> tuple[float, tuple[int, int, int, int] | None] | None:
    """How thick the thickest part of ``wrong`` (h, w) is, as :func:`mmi.foundation.thickness.largest_disc` has it, and the box
    (x, y, width, height) of that disc; 0 and no box where nothing is wrong, None where ``stopped`` says to give up.

    A disc lies within one connected part, and is no thicker than the part's box. So parts are looked at by the size of their
    boxes, and the many small ones are not.
    """
    labels, count = label(wrong)
    if count == 0:
        return 0.0, None
    boxes = find_objects(labels)
    limits = np.array([min(rows.stop - rows.start, columns.stop - columns.start) for rows, columns in boxes])
    best, box = 0.0, None
    for number in np.argsort(-limits, kind="stable").tolist():
        if limits[number] <= best:
            break
        if stopped():
            return None
        rows, columns = boxes[number]
        thickness, (row, column) = largest_disc(labels[rows, columns] == number + 1)
        if thickness > best:
            left, top = columns.start + column - 0.5 * thickness, rows.start + row - 0.5 * thickness
            x, y = math.floor(left), math.floor(top)
            best, box = thickness, (x, y, math.ceil(left + thickness) - x, math.ceil(top + thickness) - y)
    return best, box


class WorstFinder:
    """Finds the worst region of the picture that was asked about last, in a thread of its own. To be closed."""

    def __init__(self) -> None:
        self._background = Background("worst region")
        self._asked: tuple[threading.Event, Future[dict[str, Any] | None]] | None = None

    def ask(
        self, truth: DrawnPicture, shown: DrawnPicture, view: View, promise: Promised
    ) -> Future[dict[str, Any] | None]:
        """What :func:`worst_region` says; whatever was asked before is given up, and resolves to None or is cancelled.

        The pictures must not change any more. Raises ParameterError after :meth:`close`.
        """
        self.give_up()
        stop = threading.Event()
        future = self._background.submit(lambda: worst_region(truth, shown, view, promise, stopped=stop.is_set))
        self._asked = (stop, future)
        return future

    def give_up(self) -> None:
        """The viewer has moved: nobody wants to know any more."""
        if self._asked is not None:
            stop, future = self._asked
            stop.set()
            future.cancel()
            self._asked = None

    def close(self) -> None:
        """Give up, and end the thread."""
        self.give_up()
        self._background.close()


def _grown(box: tuple[int, int, int, int], shape: tuple[int, ...]) -> list[int]:
    """The box with a margin, within the picture."""
    x, y, width, height = box
    left, top = max(x - _MARGIN, 0), max(y - _MARGIN, 0)
    right, bottom = min(x + width + _MARGIN, shape[1]), min(y + height + _MARGIN, shape[0])
    return [left, top, right - left, bottom - top]


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 2)
