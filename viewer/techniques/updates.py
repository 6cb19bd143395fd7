"""What dynamic updates are made of: the layers of a cell as things that can be captured again, and what a capture covers.

Pure geometry on boxes. Which layers are captured when is decided in ``viewer.techniques.dynamic``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.foundation.camera import View
from mmi.foundation.kernels import kernel
from mmi.validity.layers import LayerParallax
from viewer.plan import RELIEF_QUAD, ImageKey, Objects, Relief, ReliefPart
from viewer.scene.scene import WalkScene

__all__ = [
    "CaptureWindow",
    "CapturedLayer",
    "CellUnits",
    "LayerUnit",
    "Piece",
    "bounds_in",
    "capture_window",
    "cell_units",
    "spans_of",
]

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
    """A layer of a sector, as something that can be captured again: objects whose middles lie in the sector.

    ``boxes`` (k, 2, 3) are those of its objects, ``depth`` is how near it comes to the reference viewpoint, metres.
    """

    name: str
    boxes: NDArray[np.float64]
    pieces: tuple[Piece, ...]
    depth: float


@dataclass(frozen=True, slots=True, eq=False)
class CellUnits:
    """All units of a cell: each object that the cell sees far away is in one of them.

    ``boxes`` (n, 2, 3) are those of all ``units``, one after the other; ``starts`` (len(units) + 1,) say where each begins.
    ``owners`` maps each stored picture of a layer to the units, by their place, that have objects which it shows.
    """

    units: tuple[LayerUnit, ...]
    boxes: NDArray[np.float64]
    starts: NDArray[np.int64]
    owners: Mapping[str, tuple[int, ...]]


def cell_units(scene: WalkScene, cell: str) -> CellUnits:
    """The layers of a cell, as what can be captured again. Raises DatasetError where it is none of the dataset's.

    An object may show in several sectors, and counts for the one that its middle is in, whole. One that no stored picture
    shows, since it is hidden from the reference viewpoint, joins the layer of its sector that is about as far away.
    """
    entry = scene.dataset.cell(cell)
    far = np.array([scene.objects[one] for one in entry.far], dtype=np.int64)
    boxes = scene.boxes[far]
    reference, sectors = np.array(entry.reference), len(entry.layers)
    middle = boxes.mean(axis=1) - reference if len(far) else np.empty((0, 3))
    sector = np.rint(np.arctan2(middle[:, 1], middle[:, 0]) * sectors / (2.0 * np.pi)).astype(np.int64) % sectors
    layer = np.full(len(far), -1, dtype=np.int64)
    for _, one in reversed(entry.pictures):
        layer[list(one.objects)] = one.index
    drawn = scene.mesh.triangle_counts[far] > 0
    _join(layer, sector, np.linalg.norm(middle, axis=1), drawn)
    unit = np.full(len(far), -1, dtype=np.int64)
    units = []
    for number, (own_sector, index) in enumerate(
        sorted({*zip(sector[drawn].tolist(), layer[drawn].tolist(), strict=True)})
    ):
        chosen = np.flatnonzero(drawn & (sector == own_sector) & (layer == index))
        unit[chosen] = number
        name, own = f"s{own_sector}.l{index}", boxes[chosen]
        nearest = np.linalg.norm(np.clip(reference, own[:, 0], own[:, 1]) - reference, axis=1).min()
        pieces = tuple(_pieces(scene, f"{scene.name} {cell} {name}", far[chosen], reference))
        units.append(LayerUnit(name, own, pieces, float(nearest)))
    counts = [len(one.boxes) for one in units]
    return CellUnits(
        units=tuple(units),
        boxes=np.concatenate([np.empty((0, 2, 3)), *(one.boxes for one in units)]),
        starts=np.cumsum([0, *counts]),
        owners={one.name: tuple(sorted({*unit[list(one.objects)].tolist()} - {-1})) for _, one in entry.pictures},
    )


def _join(
    layer: NDArray[np.int64], sector: NDArray[np.int64], distance: NDArray[np.float64], drawn: NDArray[np.bool_]
) -> None:
    """Let objects of no ``layer`` (n,) join that of the object of one in the same sector which is most nearly as far away."""
    for one in np.flatnonzero((layer < 0) & drawn).tolist():
        others = np.flatnonzero((layer >= 0) & (sector == sector[one]))
        if len(others):
            layer[one] = layer[others[np.argmin(np.abs(distance[others] - distance[one]))]]


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


def bounds_in(view: View, boxes: NDArray[np.float64]) -> NDArray[np.float64]:
    """(k, 4) left, top, right, bottom of ``boxes`` (k, 2, 3) in pixels from the principal point of ``view``.

    Infinite for a box that the eye is beside, NaN for one that is behind it or has no extent.
    """
    found: NDArray[np.float64] = _bounds(boxes, view.eye_from_world, view.focal)
    return found


@kernel(error_model="numpy")
def _bounds(boxes: NDArray[np.float64], eye_from_world: NDArray[np.float64], focal: float) -> NDArray[np.float64]:
    bounds = np.empty((len(boxes), 4))
    m = eye_from_world
    for k in range(len(boxes)):
        left, top, right, bottom, behind = np.inf, np.inf, -np.inf, -np.inf, 0
        for corner in range(8):
            x, y, z = boxes[k, corner & 1, 0], boxes[k, (corner >> 1) & 1, 1], boxes[k, corner >> 2, 2]
            depth = -(m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3])
            if not depth > _BEHIND:
                behind += 1
                continue
            u = focal * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / depth
            v = -focal * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / depth
            left, right, top, bottom = min(left, u), max(right, u), min(top, v), max(bottom, v)
        if behind == 8:
            left = top = right = bottom = np.nan
        elif behind > 0:
            left, top, right, bottom = -np.inf, -np.inf, np.inf, np.inf
        bounds[k] = left, top, right, bottom
    return bounds


def capture_window(view: View, bounds: NDArray[np.float64], *, margin: int) -> CaptureWindow | None:
    """What shows boxes of ``bounds`` (k, 4) in ``view``, as far as ``margin`` pixels beyond it; None where nothing does."""
    x, y, right, bottom, whole, extent, any_shown = _window(bounds, view.window, margin)
    if not any_shown or right - x < 1.0 or bottom - y < 1.0:
        return None
    return CaptureWindow((int(x), int(y), int(right - x), int(bottom - y)), extent, bool(whole))


@kernel(error_model="numpy")
def _window(
    bounds: NDArray[np.float64], window: tuple[int, int, int, int], margin: int
) -> tuple[float, float, float, float, bool, tuple[float, float, float, float], bool]:
    """Left, top, right, bottom of the window, nothing where they cross; whether nothing lies outside; and of all boxes.

    Last, whether any box is shown at all: boxes to the left and to the right of a view have one around both that is.
    """
    inner_x, inner_y = window[0] - margin, window[1] - margin
    outer_x, outer_y = window[0] + window[2] + margin, window[1] + window[3] + margin
    left, top, right, bottom, whole, any_shown = np.inf, np.inf, -np.inf, -np.inf, True, False
    for k in range(len(bounds)):
        if np.isnan(bounds[k, 0]):
            whole = False
        else:
            left, top = min(left, bounds[k, 0]), min(top, bounds[k, 1])
            right, bottom = max(right, bounds[k, 2]), max(bottom, bounds[k, 3])
            across = bounds[k, 0] < outer_x and bounds[k, 2] > inner_x
            any_shown = any_shown or (across and bounds[k, 1] < outer_y and bounds[k, 3] > inner_y)
    first_x, first_y = max(np.floor(left) - 1.0, inner_x), max(np.floor(top) - 1.0, inner_y)
    last_x, last_y = min(np.ceil(right) + 1.0, outer_x), min(np.ceil(bottom) + 1.0, outer_y)
    whole = whole and left >= first_x and top >= first_y and right <= last_x and bottom <= last_y
    return first_x, first_y, last_x, last_y, whole, (left, top, right, bottom), any_shown


def spans_of(view: View, bounds: NDArray[np.float64]) -> NDArray[np.int64]:
    """(columns, 2) between which rows of ``view`` boxes of ``bounds`` (k, 4) show, in columns of ``RELIEF_QUAD`` texels.

    As :class:`viewer.plan.ReliefPart` has them: rows count from the top of the window, and a column with nothing has none.
    """
    left, top, width, height = view.window
    found: NDArray[np.int64] = _spans(bounds - np.array([left, top, left, top]), width, height, RELIEF_QUAD)
    return found


@kernel(error_model="numpy")
def _spans(bounds: NDArray[np.float64], width: int, height: int, quad: int) -> NDArray[np.int64]:
    columns = -(-width // quad)
    spans = np.empty((columns, 2), dtype=np.int64)
    spans[:, 0], spans[:, 1] = height, 0
    for k in range(len(bounds)):
        if np.isnan(bounds[k, 0]) or bounds[k, 0] - 1.0 >= width or bounds[k, 2] + 1.0 <= 0.0:
            continue
        upper = int(min(max(np.floor(bounds[k, 1]) - 1.0, 0.0), height))
        lower = int(min(max(np.ceil(bounds[k, 3]) + 1.0, 0.0), height))
        first = int(min(max(np.floor((bounds[k, 0] - 1.0) / quad), 0.0), columns - 1))
        last = int(min(max(np.floor((bounds[k, 2] + 1.0) / quad), 0.0), columns - 1))
        for column in range(first, last + 1):
            spans[column, 0], spans[column, 1] = min(spans[column, 0], upper), max(spans[column, 1], lower)
    middle = height // 2  # a column with nothing ends in the middle of the last one that has something
    for column in range(columns):
        if spans[column, 0] < spans[column, 1]:
            middle = (spans[column, 0] + spans[column, 1]) // 2
        else:
            spans[column] = middle
    return spans


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

    def aligned(self, view: View) -> bool:
        """Whether ``view`` looks from the same point through the same image plane: a texel is a pixel of it."""
        return self.view.focal == view.focal and np.array_equal(self.view.eye_from_world, view.eye_from_world)

    def covers(self, view: View) -> bool:
        """Whether it has all of the layer that ``view`` may show; never true in vain."""
        if self.place.whole:
            return True
        low_x, low_y, high_x, high_y = _reach(
            self.view.eye_from_world,
            self.view.focal,
            view.eye_from_world,
            view.focal,
            view.window,
            self.depth,
            self.aligned(view),
        )
        if not math.isfinite(low_x):
            return False
        left, top, right, bottom = self.place.bounds
        low_x, low_y, high_x, high_y = max(low_x, left), max(low_y, top), min(high_x, right), min(high_y, bottom)
        if low_x >= high_x or low_y >= high_y:
            return True
        x, y, width, height = self.place.window
        return low_x >= x and low_y >= y and high_x <= x + width and high_y <= y + height


@kernel(error_model="numpy")
def _reach(
    captured: NDArray[np.float64],
    focal: float,
    seen: NDArray[np.float64],
    seen_focal: float,
    window: tuple[int, int, int, int],
    depth: float,
    aligned: bool,
) -> tuple[float, float, float, float]:
    """Left, top, right, bottom of what a view of ``window`` shows, in the image plane of a capture, pixels.

    Both are told by their ``eye_from_world``; what was captured is ``depth`` metres from where it was, or more. Infinite where
    the view may show what lies beside the capture's eye or behind it. ``aligned``: both look the same way from the same place.
    """
    left, top = float(window[0]), float(window[1])
    width, height = float(window[2]), float(window[3])
    if aligned:
        return left, top, left + width, top + height
    low_x, low_y, high_x, high_y, edge = np.inf, np.inf, -np.inf, -np.inf, focal
    for k in range(9):
        if k == 4:
            continue
        x, y = (left + 0.5 * width * (k % 3)) / seen_focal, -(top + 0.5 * height * (k // 3)) / seen_focal
        u, v, w = 0.0, 0.0, 0.0  # the ray in the frame of the capture
        for i in range(3):
            world = x * seen[0, i] + y * seen[1, i] - seen[2, i]
            u += captured[0, i] * world
            v += captured[1, i] * world
            w += captured[2, i] * world
        if w > -1e-3:
            return -np.inf, -np.inf, np.inf, np.inf
        u, v = focal * u / -w, focal * v / w
        low_x, low_y, high_x, high_y = min(low_x, u), min(low_y, v), max(high_x, u), max(high_y, v)
        edge = max(edge, np.hypot(u, focal), np.hypot(v, focal))
    moved = 0.0
    for i in range(3):
        one, other = 0.0, 0.0
        for j in range(3):
            one -= captured[j, i] * captured[j, 3]
            other -= seen[j, i] * seen[j, 3]
        moved += (one - other) ** 2
    moved = np.sqrt(moved)
    # What is seen at the edge of the view is seen elsewhere by as much as the eye has moved.
    shift = focal * (edge / focal) ** 2 * moved / max(depth - moved, 1e-3)
    return low_x - shift, low_y - shift, high_x + shift, high_y + shift
