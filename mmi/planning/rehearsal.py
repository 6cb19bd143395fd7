"""A plan is rehearsed before anything is captured: viewpoints around the cell look for what its layers will miss.

The weights bound the strip that opens behind one surface (docs/bound.md). But strips may lie side by side, and a region is
as thick as all of them together: a row of houses whose common front faces away from the reference viewpoint, each narrower
than the threshold, or strips of several layers. So each plan is looked at as a whole.

From a viewpoint M the walls are met column by column of azimuth, front to back, which tells what M sees: a point X of a far
object, say. X will be there if the layer's picture has it: if the texel that X falls into, seen from the reference viewpoint
C, shows X's own wall, or its object within a pixel of X as M sees it. If not it is missed, and what is missed makes a picture.
Walls that face C with nothing of their layer before them are captured anyway, and not looked for. Where the largest disc
(:mod:`mmi.planning.missed_regions`) exceeds the limit, the object that covers most of it stays geometry.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.cells.viewing_cells import ViewingCell
from mmi.foundation.kernels import kernel
from mmi.planning.missed_regions import WORTH_KNOWING, thickest_region
from mmi.visibility.horizon_sweep import BINS
from mmi.visibility.selection import WallVisibility
from mmi.visibility.visible_walls import around, seen_from
from mmi.visibility.walls import Walls

__all__ = ["Rehearsal", "rehearse"]

_STEEPEST = 10.0
"""What is steeper than this slope, up or down, is not looked at."""
_CLOSEST = 1e-3
"""Metres: nothing counts as closer to a viewpoint."""
_OTHER, _OPEN, _MISSED = 0, 1, 2
"""States of a pixel of a wall: hidden from M or captured; not yet known; missed."""


class _Panorama(NamedTuple):
    """What rays meet, nearest first: column c has entries ``starts[c]`` to ``starts[c + 1]`` of ``distances`` (m,), metres, and
    ``walls`` (m,).
    """

    starts: NDArray[np.int64]
    distances: NDArray[np.float64]
    walls: NDArray[np.int64]


class _Walls(NamedTuple):
    """``bottom``, ``top`` (n,) metres above the eye; ``owner`` (n,), the object it belongs to; whether a wall ``faces`` (n,)
    the reference viewpoint with its outside.
    """

    bottom: NDArray[np.float64]
    top: NDArray[np.float64]
    owner: NDArray[np.int64]
    faces: NDArray[np.bool_]


class _Picture(NamedTuple):
    """Which object is ``missed`` (columns, rows), -1 for none; only rows within ``spans`` (columns, 2) count.

    Row ``down`` begins at eye level; each is a slope of ``row``.
    """

    missed: NDArray[np.int32]
    spans: NDArray[np.int64]
    down: int
    row: float


@dataclass(frozen=True, slots=True, eq=False)
class Rehearsal:
    """``demoted`` (k,): far objects that have to stay geometry, sorted.

    ``thickness``: no region that is missed then is thicker; pixels.
    """

    demoted: NDArray[np.int64]
    thickness: float


def rehearse(
    cell: ViewingCell,
    walls: Walls,
    objects: NDArray[np.int64],
    layers: tuple[NDArray[np.int64], ...],
    wall_visibility: WallVisibility | None,
    *,
    pixel: tuple[float, float],
    limit: float,
) -> Rehearsal:
    """Which objects of ``layers`` have to stay geometry for no missed region to be thicker than ``limit`` pixels.

    ``objects`` (n,) are all that may be visible, sorted, those of ``layers`` among them; what ``wall_visibility`` says is
    hidden from somewhere is not looked for there. ``pixel`` is the width of a pixel (and of a texel) in radians of azimuth,
    and its height as a slope.
    """
    x, y, eye = cell.reference
    index = walls.of(objects)
    owner = np.repeat(np.arange(len(objects)), walls.first[objects + 1] - walls.first[objects])
    # Nearest first, as rays meet them, more or less: what rays meet is sorted soon.
    order = np.argsort(_distances(walls.a[index] - (x, y), walls.b[index] - (x, y)), kind="stable")
    index, owner = index[order], owner[order]
    layer = np.full(len(objects), -1, dtype=np.int64)
    for i, members in enumerate(layers):
        layer[np.searchsorted(objects, members)] = i
    a, b = walls.a[index] - (x, y), walls.b[index] - (x, y)
    bottom, top = walls.bottom[index] - eye, walls.top[index] - eye
    columns = math.ceil(2.0 * math.pi / pixel[0])
    far = np.flatnonzero(layer[owner] >= 0)
    rays = _rays(columns)
    captured = _panorama(a[far], b[far], far, rays, np.ones(columns, dtype=np.bool_))
    faces = _faces(a, b)
    behind = _behind(faces, captured, layer[owner])
    bins = BINS if wall_visibility is None else wall_visibility.bins
    seen = seen_from(
        np.full(len(index), 2**64 - 1, dtype=np.uint64) if wall_visibility is None else wall_visibility.bits[index],
        bins,
    )
    buffer, spans = np.empty(0, dtype=np.int32), np.empty((columns, 2), dtype=np.int64)
    demoted: list[int] = []
    thickest = WORTH_KNOWING * limit
    for k, viewpoint in enumerate(around(cell.corners - (x, y), seen.shape[1])):
        from_m = a - viewpoint, b - viewpoint
        front = _faces(*from_m)
        sought = behind & seen[:, k] & front & (layer[owner] >= 0)
        if not sought.any():
            continue
        wanted = from_m[0][sought], from_m[1][sought]
        # Backs hide nothing that their fronts do not, but for roofs and undersides that M sees.
        hiding = np.flatnonzero(front | (bottom > 0.0) | (top < 0.0))
        met = _panorama(from_m[0][hiding], from_m[1][hiding], hiding, rays, _columns_of(*wanted, columns))
        nearest = np.maximum(_distances(*wanted), 1.0)
        up, down = (
            math.ceil(min(max(float((height[sought] / nearest).max()), 0.0), _STEEPEST) / pixel[1]) + 1
            for height in (top, -bottom)
        )
        if buffer.size < columns * (up + down):
            buffer = np.empty(columns * (up + down), dtype=np.int32)
        missed = buffer[: columns * (up + down)].reshape(columns, up + down)
        while True:
            picture = _Picture(missed, spans, down, pixel[1])
            _look(_Walls(bottom, top, owner, faces), layer, sought, met, viewpoint, captured, rays, picture)
            thick, inside = thickest_region(missed, spans, thickest)
            if thick <= limit:
                break
            names, counts = np.unique(inside, return_counts=True)
            worst = int(names[np.argmax(counts)])
            layer[worst] = -1
            demoted.append(worst)
        thickest = max(thickest, thick)
    return Rehearsal(objects[np.sort(np.array(demoted, dtype=np.int64))], thickest)


def _faces(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(n,): the walls from ``a`` to ``b`` (n, 2) that show their outside to the origin."""
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] < 0.0, dtype=np.bool_)


def _distances(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) from the origin to the segments from ``a`` to ``b`` (n, 2)."""
    step = b - a
    t = np.clip(-np.sum(a * step, axis=1) / np.maximum(np.sum(step * step, axis=1), 1e-12), 0.0, 1.0)
    return np.asarray(np.hypot(*(a + t[:, None] * step).T), dtype=np.float64)


@kernel(error_model="numpy")
def _columns_from(ax: float, ay: float, bx: float, by: float, columns: int) -> tuple[int, int]:
    """The first column whose centre ray meets a wall, from 0, and how many do."""
    scale = columns / (2.0 * math.pi)
    start, width = math.atan2(ay, ax), math.atan2(ax * by - ay * bx, ax * bx + ay * by)
    start, width = min(start, start + width), abs(width)
    begin = math.ceil(start * scale - 0.5)
    return begin % columns, max(math.ceil((start + width) * scale - 0.5) - begin, 0)


@kernel(error_model="numpy")
def _columns_of(a: NDArray[np.float64], b: NDArray[np.float64], columns: int) -> NDArray[np.bool_]:
    """(columns,): whose centre rays meet a wall from ``a`` to ``b`` (n, 2)."""
    meet = np.zeros(columns, dtype=np.bool_)
    for w in range(len(a)):
        begin, many = _columns_from(a[w, 0], a[w, 1], b[w, 0], b[w, 1], columns)
        for k in range(many):
            meet[(begin + k) % columns] = True
    return meet


@kernel(error_model="numpy")
def _behind(
    faces: NDArray[np.bool_],
    captured: _Panorama,
    layer: NDArray[np.int64],
) -> NDArray[np.bool_]:
    """(n,): walls that their layer's capture may lack: another is in front somewhere, or they face away or lie along a ray."""
    starts, _, walls = captured
    met = np.zeros(len(faces), dtype=np.bool_)
    behind = ~faces
    for c in range(len(starts) - 1):
        for k in range(starts[c], starts[c + 1]):
            w = walls[k]
            met[w] = True
            for before in range(starts[c], k):
                if layer[walls[before]] == layer[w]:
                    behind[w] = True
    return behind | ~met


@kernel(error_model="numpy")
def _rays(columns: int) -> NDArray[np.float64]:
    """(columns, 2): the directions of the centres of the columns."""
    rays = np.empty((columns, 2))
    for c in range(columns):
        azimuth = (c + 0.5) * 2.0 * math.pi / columns
        rays[c, 0], rays[c, 1] = math.cos(azimuth), math.sin(azimuth)
    return rays


@kernel(error_model="numpy")
def _panorama(
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    index: NDArray[np.int64],
    rays: NDArray[np.float64],
    wanted: NDArray[np.bool_],
) -> _Panorama:
    """What the ``rays`` of the ``wanted`` columns meet, nearest first: where a column starts, distances, walls.

    Walls from ``a`` to ``b`` (n, 2), metres from where the rays start, are named by ``index`` (n,).
    """
    columns = len(wanted)
    n = len(a)
    begin, many = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    starts = np.zeros(columns + 1, dtype=np.int64)
    for w in range(n):
        begin[w], many[w] = _columns_from(a[w, 0], a[w, 1], b[w, 0], b[w, 1], columns)
        for k in range(many[w]):
            c = (begin[w] + k) % columns
            starts[c + 1] += wanted[c]
    starts = np.cumsum(starts)
    place = starts[:-1].copy()
    distances, walls = np.empty(starts[-1]), np.empty(starts[-1], dtype=np.int64)
    for w in range(n):
        ex, ey = b[w, 0] - a[w, 0], b[w, 1] - a[w, 1]
        cross = a[w, 0] * ey - a[w, 1] * ex
        for k in range(many[w]):
            c = (begin[w] + k) % columns
            if wanted[c]:
                distance = cross / (rays[c, 0] * ey - rays[c, 1] * ex)
                distances[place[c]] = distance if distance > _CLOSEST else _CLOSEST
                walls[place[c]] = index[w]
                place[c] += 1
    for c in range(columns):
        for k in range(starts[c] + 1, starts[c + 1]):
            distance, wall, i = distances[k], walls[k], k
            while i > starts[c] and distances[i - 1] > distance:
                distances[i], walls[i] = distances[i - 1], walls[i - 1]
                i -= 1
            distances[i], walls[i] = distance, wall
    return _Panorama(starts, distances, walls)


@kernel(error_model="numpy")
def _row(height: float, down: int) -> int:
    """The first row whose centre is not below ``height``, in rows above the eye, where row ``down`` begins."""
    return math.ceil(height - 0.5) + down


@kernel(error_model="numpy")
def _look(
    known: _Walls,
    layer: NDArray[np.int64],
    sought: NDArray[np.bool_],
    met: _Panorama,
    viewpoint: NDArray[np.float64],
    captured: _Panorama,
    rays: NDArray[np.float64],
    picture: _Picture,
) -> None:
    """Draws the picture of what is missed.

    What is ``sought`` (n,) are walls, as long as their objects are in a ``layer``. ``viewpoint`` (2,) is where it is, metres
    from the reference, and ``met`` those walls that its rays meet; ``captured`` are those that rays from the reference meet.
    """
    bottom, top, owner, faces = known
    missed, spans, down, row = picture
    columns, rows = missed.shape
    starts, distances, walls = met
    captured_starts, captured_distances, captured_walls = captured
    turn = 2.0 * math.pi / columns
    taken, state = np.empty(rows, dtype=np.bool_), np.empty(rows, dtype=np.uint8)
    for c in range(columns):
        spans[c] = 0, 0
        last, least, most = -1, rows, 0  # the last of what is sought, and the rows where it may be
        for entry in range(starts[c], starts[c + 1]):
            distance, w = distances[entry], walls[entry]
            if sought[w] and layer[owner[w]] >= 0:
                last = entry
                least = min(least, max(_row(bottom[w] / distance / row, down), 0))
                most = max(most, min(_row(top[w] / distance / row, down), rows))
        if least >= most:
            continue
        ux, uy = rays[c]
        taken[least:most] = False
        from_row, to_row = least, least  # between which all is taken
        for entry in range(starts[c], last + 1):
            if to_row - from_row == most - least:
                break
            distance, w = distances[entry], walls[entry]
            lowest = max(_row(bottom[w] / distance / row, down), least)
            highest = min(_row(top[w] / distance / row, down), most)
            if from_row <= lowest <= to_row:
                lowest = to_row
            if from_row <= highest <= to_row:
                highest = min(highest, from_row)
            first, end = rows, 0
            for r in range(lowest, highest):
                state[r] = _OTHER if taken[r] else _OPEN
                if not taken[r]:
                    taken[r] = True
                    first, end = min(first, r), r + 1
            if from_row == to_row and first < end:
                from_row = to_row = first
            while to_row < most and taken[to_row]:
                to_row += 1
            while from_row > least and taken[from_row - 1]:
                from_row -= 1
            mine = layer[owner[w]]
            if first >= end or mine < 0 or not sought[w]:
                continue
            x, y = distance * ux + viewpoint[0], distance * uy + viewpoint[1]
            scale = math.hypot(x, y) / distance / row  # rows here for a slope from the reference
            texel = math.floor(math.atan2(y, x) / turn) % columns
            for k in range(captured_starts[texel], captured_starts[texel + 1]):
                other, t = captured_walls[k], captured_distances[k]
                if layer[owner[other]] != mine:
                    continue
                begin = max(_row(bottom[other] / t * scale, down), first)
                stop = min(_row(top[other] / t * scale, down), end)
                if begin >= stop:
                    continue
                there, lag = other == w and faces[w], 0.0
                if not there and owner[other] == owner[w]:
                    px, py = t * rays[texel, 0] - viewpoint[0], t * rays[texel, 1] - viewpoint[1]
                    there = abs(math.atan2(ux * py - uy * px, ux * px + uy * py)) <= turn
                    lag = abs(1.0 - t / max(scale * row * math.hypot(px, py), _CLOSEST))  # so much of a slope it is off
                for r in range(begin, stop):
                    if state[r] == _OPEN:
                        state[r] = _OTHER if there and lag * abs(r + 0.5 - down) <= 1.0 else _MISSED
            for r in range(first, end):
                if state[r] != _OTHER:
                    low, high = spans[c]
                    if low == high:
                        low, high = r, r
                    missed[c, high:r] = -1
                    missed[c, r + 1 : low] = -1
                    missed[c, r] = owner[w]
                    spans[c, 0], spans[c, 1] = min(low, r), max(high, r + 1)
