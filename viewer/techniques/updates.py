"""What dynamic updates are made of: the layers of a cell as things that can be captured again, and what a capture covers.

Pure geometry on boxes. Which layers are captured when is decided in ``viewer.techniques.dynamic``.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View
from mmi.validity.layers import LayerParallax, layer_parallax
from viewer.plan import RELIEF_QUAD, ImageKey, Objects, Relief, ReliefPart
from viewer.scene.frustum import box_corners
from viewer.scene.scene import WalkScene

__all__ = ["CaptureWindow", "CapturedLayer", "LayerUnit", "Piece", "capture_window", "layer_units", "spans_of"]

_PIECE_TRIANGLES = 4000
"""A layer of more triangles is captured in pieces of about so many."""
_BEHIND = 0.1
"""Metres of depth: what is nearer is not in front of a view."""


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """Some objects of a layer, which are captured together: ``rows`` (k,) of the layer's own list."""

    draw: Objects
    rows: NDArray[np.int64]
    triangles: int


@dataclass(frozen=True, slots=True, eq=False)
class LayerUnit:
    """A layer of a sector, as something that can be captured again: ``pictures`` are its names in the dataset.

    ``boxes`` (k, 2, 3) are those of its objects, ``corners`` (k, 8, 3) theirs. ``parallax`` tells the stored layer's errors,
    ``stored_triangles`` what it has, and ``depth`` how near it comes to the reference viewpoint, metres.
    """

    name: str
    pictures: tuple[str, ...]
    boxes: NDArray[np.float64]
    corners: NDArray[np.float64]
    parallax: LayerParallax
    pieces: tuple[Piece, ...]
    stored_triangles: int
    depth: float


def layer_units(scene: WalkScene, cell: str) -> tuple[LayerUnit, ...]:
    """All layers of a cell, a sector after the other. Raises DatasetError where it is none of the dataset's."""
    entry = scene.dataset.cell(cell)
    far = np.array([scene.objects[one] for one in entry.far], dtype=np.int64)
    reference = np.array(entry.reference)
    units = []
    for sector, pictures in enumerate(entry.layers):
        ordered = sorted(pictures, key=lambda one: one.index)
        for index, group in itertools.groupby(ordered, key=lambda one: one.index):
            some = list(group)
            objects = far[sorted({place for one in some for place in one.objects})]
            objects = objects[scene.mesh.triangle_counts[objects] > 0]
            name = f"s{sector}.l{index}"
            boxes = scene.boxes[objects]
            units.append(
                LayerUnit(
                    name=name,
                    pictures=tuple(one.name for one in some),
                    boxes=boxes,
                    corners=box_corners(boxes[:, 0], boxes[:, 1]),
                    parallax=layer_parallax(reference, boxes, widened=scene.camera.angle_from_pixels(RELIEF_QUAD)),
                    pieces=tuple(_pieces(scene, f"{scene.name} {cell} {name}", objects, reference)),
                    stored_triangles=sum(one.triangles for one in some),
                    depth=min(one.depth[0] for one in some),
                )
            )
    return tuple(units)


def _pieces(scene: WalkScene, name: str, objects: NDArray[np.int64], reference: NDArray[np.float64]) -> Iterator[Piece]:
    """Objects next to each other as the reference viewpoint sees them, of few triangles together."""
    counts = scene.mesh.triangle_counts[objects]
    middle = (scene.boxes[objects].mean(axis=1) - reference)[:, :2]
    ahead = middle.sum(axis=0)
    aside = np.arctan2(ahead[0] * middle[:, 1] - ahead[1] * middle[:, 0], middle @ ahead)
    order = np.argsort(aside, kind="stable")
    parts = max(1, -(-int(counts.sum()) // _PIECE_TRIANGLES))
    before = np.cumsum(counts[order]) - counts[order]
    part = np.minimum(before * parts // max(int(counts.sum()), 1), parts - 1)
    for number in np.unique(part):
        rows = np.sort(order[part == number])
        yield Piece(Objects(f"layer {name} {number}", objects[rows]), rows, int(counts[rows].sum()))


class CaptureWindow(NamedTuple):
    """What of a view shows some boxes: a ``window`` of its image plane, and their ``bounds`` there, which may be larger.

    ``bounds`` are left, top, right, bottom in pixels, infinite for what the eye is beside. ``whole``: there is nothing of them
    outside of the window, not behind the eye either.
    """

    window: tuple[int, int, int, int]
    bounds: tuple[float, float, float, float]
    whole: bool


def capture_window(view: View, corners: NDArray[np.float64], *, margin: int) -> CaptureWindow | None:
    """What shows boxes of ``corners`` (k, 8, 3) in ``view``, as far as ``margin`` pixels beyond it; None where nothing does."""
    seen = view.project(corners)
    in_front: NDArray[np.bool_] = seen[..., 2] > _BEHIND
    some, every = np.asarray(in_front.any(axis=1)), np.asarray(in_front.all(axis=1))
    if not some.any():
        return None
    if bool(np.all(every[some])):
        low, high = seen[some, :, :2].min(axis=(0, 1)), seen[some, :, :2].max(axis=(0, 1))
    else:
        low, high = np.full(2, -np.inf), np.full(2, np.inf)
    left, top, width, height = view.window
    inner = np.array([left - margin, top - margin], dtype=np.float64)
    outer = np.array([left + width + margin, top + height + margin], dtype=np.float64)
    first, last = np.maximum(np.floor(low) - 1.0, inner), np.minimum(np.ceil(high) + 1.0, outer)
    if (last - first < 1.0).any():
        return None
    (x, y), (right, bottom) = first.astype(int).tolist(), last.astype(int).tolist()
    whole = bool(some.all() and (low >= first).all() and (high <= last).all())
    return CaptureWindow((x, y, right - x, bottom - y), (*low.tolist(), *high.tolist()), whole)


def spans_of(view: View, corners: NDArray[np.float64]) -> NDArray[np.int64]:
    """(columns, 2) between which rows of ``view`` boxes of ``corners`` (k, 8, 3) show, in columns of ``RELIEF_QUAD`` texels.

    As :class:`viewer.plan.ReliefPart` has them: rows count from the top of the window, and a column with nothing has none.
    """
    left, top, width, height = view.window
    columns = -(-width // RELIEF_QUAD)
    seen = view.project(corners)
    in_front: NDArray[np.bool_] = seen[..., 2] > _BEHIND
    some, every = np.asarray(in_front.any(axis=1)), np.asarray(in_front.all(axis=1))
    if not every[some].all():
        return np.tile(np.array([[0, height]]), (columns, 1))
    low, high = seen[some, :, :2].min(axis=1) - [left, top], seen[some, :, :2].max(axis=1) - [left, top]
    rows = np.clip(np.column_stack([np.floor(low[:, 1]) - 1.0, np.ceil(high[:, 1]) + 1.0]), 0, height).astype(int)
    first = np.clip(np.floor((low[:, 0] - 1.0) / RELIEF_QUAD), 0, columns - 1).astype(int)
    last = np.clip(np.floor((high[:, 0] + 1.0) / RELIEF_QUAD), 0, columns - 1).astype(int)
    spans = np.tile(np.array([[height, 0]]), (columns, 1))
    counts = last - first + 1
    owner = np.repeat(np.arange(len(counts)), counts)
    column = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts - first, counts)
    np.minimum.at(spans[:, 0], column, rows[owner, 0])
    np.maximum.at(spans[:, 1], column, rows[owner, 1])
    empty = spans[:, 0] >= spans[:, 1]
    spans[empty] = _beside(spans, empty)
    return spans


def _beside(spans: NDArray[np.int64], empty: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(m, 2) for columns with nothing: no rows, in the middle of the nearest column that has some."""
    full = np.flatnonzero(~empty)
    if not full.size:
        return np.zeros((len(spans), 2), dtype=np.int64)
    places = np.flatnonzero(empty)
    right = np.minimum(np.searchsorted(full, places), len(full) - 1)
    leftward = np.maximum(right - 1, 0)
    nearer = np.where(np.abs(full[leftward] - places) < np.abs(full[right] - places), full[leftward], full[right])
    return np.repeat(spans[nearer].sum(axis=1, keepdims=True) // 2, 2, axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class CapturedLayer:
    """A layer's picture on the GPU: captured as ``part``, which shows its ``place``.

    ``parallax`` tells its errors, ``depth`` how near the layer comes, metres.
    """

    image: ImageKey
    part: ReliefPart
    place: CaptureWindow
    parallax: LayerParallax
    depth: float

    @property
    def view(self) -> View:
        """What it was captured as."""
        return self.part.view

    @property
    def draw(self) -> Relief:
        """What shows it."""
        return Relief(self.image, (self.part,))

    @property
    def triangles(self) -> int:
        """Of what shows it."""
        columns, rows = self.part.grid
        return 2 * columns * rows

    def aligned(self, view: View) -> bool:
        """Whether ``view`` looks from the same point through the same image plane: a texel is a pixel of it."""
        return self.view.focal == view.focal and np.array_equal(self.view.eye_from_world, view.eye_from_world)

    def covers(self, view: View) -> bool:
        """Whether it has all of the layer that ``view`` may show; never true in vain."""
        if self.place.whole:
            return True
        left, top, width, height = view.window
        mine = self.place.window
        if self.aligned(view):
            low, high = np.array([left, top]), np.array([left + width, top + height])
        else:
            u = left + width * np.array([0.0, 0.5, 1.0, 1.0, 1.0, 0.5, 0.0, 0.0])
            v = top + height * np.array([0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 0.5])
            rays = np.stack([u / view.focal, -v / view.focal, -np.ones(8)], axis=1)
            turned = rays @ view.eye_from_world[:3, :3] @ self.view.eye_from_world[:3, :3].T
            if (turned[:, 2] > -1e-3).any():
                return False
            at = self.view.focal * turned[:, :2] / -turned[:, 2:] * np.array([1.0, -1.0])
            # What is seen at the edge of the view is seen elsewhere by as much as the eye has moved.
            moved = float(np.linalg.norm(view.eye - self.view.eye))
            edge = float(np.hypot(at, self.view.focal).max()) / self.view.focal
            shift = self.view.focal * edge * edge * moved / max(self.depth - moved, 1e-3)
            low, high = at.min(axis=0) - shift, at.max(axis=0) + shift
        low = np.maximum(low, self.place.bounds[:2])
        high = np.minimum(high, self.place.bounds[2:])
        if (low >= high).any():
            return True
        return bool(
            low[0] >= mine[0] and low[1] >= mine[1] and high[0] <= mine[0] + mine[2] and high[1] <= mine[1] + mine[3]
        )
