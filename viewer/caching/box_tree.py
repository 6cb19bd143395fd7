"""A hierarchy of nearly cubic boxes over triangles, each listed in every box that it meets (section 4).

A node's box is halved in the middle of its longest side, the box of each half likewise, and again: as many times as the node
has sides longer than half of its longest, but twice at least. So a node that is about a cube has up to 8 children, and a flat
one 4; a half that lists no more than an eighth of what a leaf may is halved no more. A box is the bounds of what there is on
its side of the planes, which may be much less than the half, and is what is halved next. Planes belong to both sides: what lies
in one goes to its lower side alone, and what only touches one to its own. The rest is clipped (Sutherland and Hodgman,
"Reentrant polygon clipping", 1974) in double precision.

Triangles that are large for their box would be in most of its children, and in most of theirs. So a node is divided only where
its children list at most twice as many triangles as it does, and as long as no division on the way down to them has used up
what they may grow by: children of a node that lists n triangles, and may grow g times, may grow g n / s times where they list
s. All leaves together list at most as many times the triangles as the root may grow.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmi.city.ranges import numbers_in
from mmi.foundation.errors import ParameterError
from mmi.foundation.kernels import kernel

__all__ = ["BoxTree", "box_tree"]

_GROWTH = 4.0
"""How many times the triangles of a mesh all leaves together list at most."""
_GROWTH_AT_ONCE = 2.0
_DEEPEST = 40
_MOST_CORNERS = 28
"""Of a clipped triangle in memory: clipping by each of six planes adds one, or half as many again if all were rounded badly."""


@dataclass(frozen=True, slots=True, eq=False)
class BoxTree:
    """Boxes of triangles, numbered level by level: node 0 is the root, and a node's children follow each other.

    ``boxes`` (n, 2, 3) are the lowest and the highest coordinates of the parts of triangles that a node holds, as those of the
    mesh; siblings have no volume in common, and a node without triangles, the only one of an empty mesh, has zeros.
    ``parents`` (n,), -1 for the root; ``children`` (n, 2) are the first child and the one after the last, equal for a leaf;
    nodes of level k are ``levels[k]`` to ``levels[k + 1] - 1``. ``references`` (m,) are triangles, those of a leaf ascending;
    node i holds those of ``ranges[i]``, first and one after the last: what its children hold, one after the other.
    """

    boxes: NDArray[np.float64]
    parents: NDArray[np.int32]
    children: NDArray[np.int32]
    levels: NDArray[np.int64]
    ranges: NDArray[np.int64]
    references: NDArray[np.int32]

    def __post_init__(self) -> None:
        for name in self.__slots__:
            getattr(self, name).setflags(write=False)

    @property
    def is_leaf(self) -> NDArray[np.bool_]:
        """(n,) Whether a node has no children."""
        return np.equal(self.children[:, 0], self.children[:, 1])

    @property
    def triangle_counts(self) -> NDArray[np.int64]:
        """(n,) How many references a node holds: a triangle in several leaves counts several times."""
        return self.ranges[:, 1] - self.ranges[:, 0]

    def children_of(self, nodes: NDArray[np.int64]) -> NDArray[np.int64]:
        """The children of some ``nodes`` (k,), one family after the other."""
        return numbers_in(*self.children[nodes].T)

    def triangles_of(self, nodes: ArrayLike) -> NDArray[np.int32]:
        """The triangles of a node, or of some ``nodes`` (k,), ascending, each once."""
        found = np.sort(self.references[numbers_in(*self.ranges[np.atleast_1d(nodes)].T)])
        first = np.ones(len(found), dtype=np.bool_)
        np.not_equal(found[1:], found[:-1], out=first[1:])
        return found[first]  # np.unique takes several times as long


def box_tree(
    positions: NDArray[np.floating],
    triangles: NDArray[np.integer],
    *,
    leaf_triangles: int = 1000,
    depth: int | None = None,
) -> BoxTree:
    """The tree of ``triangles`` (m, 3), corners in ``positions`` (k, 3) of any unit.

    A node that lists at most ``leaf_triangles`` is not divided, nor is one ``depth`` levels below the root, or one that
    division would not help (see above). Triangles without area are listed as others are; those with a corner that is not
    finite are in no box. Raises ParameterError where ``leaf_triangles`` is below 1 or ``depth`` below 0.
    """
    if leaf_triangles < 1:
        raise ParameterError(f"leaf triangles: 1 or more expected, found {leaf_triangles}")
    if depth is not None and depth < 0:
        raise ParameterError(f"depth: 0 or more expected, found {depth}")
    mesh = _Mesh(
        np.ascontiguousarray(positions, dtype=np.float32 if positions.dtype == np.float32 else np.float64),
        np.ascontiguousarray(triangles, dtype=np.int32),
    )
    there = np.flatnonzero(np.isfinite(mesh.positions).all(axis=1)[mesh.triangles].all(axis=1)).astype(np.int32)
    level, growth = _root(mesh, there), np.array([_GROWTH])
    generations: list[_Generation] = []
    owners = np.array([-1])
    while len(owners):
        counts = np.diff(level.starts)
        deeper = len(generations) < (_DEEPEST if depth is None else min(depth, _DEEPEST))
        tried = np.flatnonzero((counts > leaf_triangles) & (np.ptp(level.boxes, axis=1).max(axis=1) > 0.0) & deeper)
        halves, of = _divided(mesh, level.only(tried), leaf_triangles=leaf_triangles)
        within = np.bincount(of, np.diff(halves.starts), minlength=len(tried))
        helps = within <= np.minimum(growth[tried], _GROWTH_AT_ONCE) * counts[tried]
        helps &= np.bincount(of, minlength=len(tried)) > 1
        family = np.bincount(tried[of[helps[of]]], minlength=len(counts))
        leaves = level.only(np.flatnonzero(family == 0))
        generations.append(
            _Generation(level.boxes, owners, family, np.where(family == 0, counts, 0), leaves.references)
        )
        kept = np.flatnonzero(helps[of])
        owners = tried[of[kept]]
        growth = growth[owners] * counts[owners] / within[of[kept]]
        level = halves.only(kept)
    return _assembled(generations)


class _Mesh(NamedTuple):
    """Triangles (m, 3) with corners in ``positions`` (k, 3)."""

    positions: NDArray[np.floating]
    triangles: NDArray[np.int32]


class _Level(NamedTuple):
    """Parts of space and what is in them: part i holds ``references[starts[i] : starts[i + 1]]``, ascending.

    ``cells`` (n, 2, 3) is as far as a part reaches, to the planes that it is halved by and without an end elsewhere; ``boxes``
    (n, 2, 3) are the bounds of the parts of triangles that are in them.
    """

    references: NDArray[np.int32]
    starts: NDArray[np.int64]
    cells: NDArray[np.float64]
    boxes: NDArray[np.float64]

    def only(self, some: NDArray[np.int64]) -> _Level:
        """Those with the numbers ``some`` (k,)."""
        firsts, ends = self.starts[some], self.starts[some + 1]
        starts = np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(ends - firsts)])
        return _Level(self.references[numbers_in(firsts, ends)], starts, self.cells[some], self.boxes[some])


class _Generation(NamedTuple):
    """The nodes of a level: their boxes, their ``owners`` (n,) in the level above, how many children each has, and how many
    triangles it lists where it has none; ``references`` are those, one leaf after the other.
    """

    boxes: NDArray[np.float64]
    owners: NDArray[np.int64]
    family: NDArray[np.int64]
    listed: NDArray[np.int64]
    references: NDArray[np.int32]


def _root(mesh: _Mesh, there: NDArray[np.int32]) -> _Level:
    """All of space, with the triangles ``there``."""
    everywhere = np.array([[[-np.inf] * 3, [np.inf] * 3]])
    if not len(there):
        return _Level(there, np.zeros(2, dtype=np.int64), everywhere, np.zeros((1, 2, 3)))
    space = _Level(there, np.array([0, len(there)]), everywhere, everywhere)
    return _halved(mesh, space, np.zeros(1, dtype=np.int64), np.array([np.inf]))[0]


def _divided(mesh: _Mesh, level: _Level, *, leaf_triangles: int) -> tuple[_Level, NDArray[np.int64]]:
    """The children of all parts, those without content left out, and whose they are."""
    sides = np.ptp(level.boxes, axis=1)
    times = np.maximum((2.0 * sides > sides.max(axis=1, keepdims=True)).sum(axis=1), 2)
    owners = np.arange(len(times))
    for k in range(3):
        wanted = (times[owners] > k) & (8 * np.diff(level.starts) > leaf_triangles)
        if not wanted.any():
            break
        longest = np.ptp(level.boxes, axis=1).argmax(axis=1)
        ends = level.boxes[np.arange(len(longest)), :, longest]
        level, halved = _halved(mesh, level, longest, np.where(wanted, 0.5 * ends[:, 0] + 0.5 * ends[:, 1], np.inf))
        owners = owners[halved]
    return level, owners


def _halved(
    mesh: _Mesh, level: _Level, axes: NDArray[np.int64], planes: NDArray[np.float64]
) -> tuple[_Level, NDArray[np.int64]]:
    """The parts below and above ``planes`` (n,), coordinates along ``axes`` (n,), without empty ones; and what they were."""
    each = np.arange(len(axes))
    cells = np.repeat(level.cells, 2, axis=0)
    cells[2 * each, 1, axes] = np.minimum(level.cells[each, 1, axes], planes)
    cells[2 * each + 1, 0, axes] = planes
    boxes = np.repeat(np.array([[[np.inf] * 3, [-np.inf] * 3]]), len(cells), axis=0)
    sides = np.empty(len(level.references), dtype=np.uint8)
    counts = np.zeros(len(cells), dtype=np.int64)
    _sort_out(mesh, level, axes, planes, sides, counts, boxes)
    ends = np.cumsum(counts)
    references = np.empty(counts.sum(), dtype=np.int32)
    _deal(level, sides, ends - counts, references)
    kept = np.flatnonzero(counts)
    starts = np.concatenate([np.zeros(1, dtype=np.int64), ends[kept]])
    around = level.boxes[kept // 2]  # a part that is clipped anew may stand out by a rounding
    boxes = np.clip(boxes[kept], around[:, :1], around[:, 1:])
    return _Level(references, starts, cells[kept], boxes), kept // 2


_BELOW, _ABOVE = 1, 2


@kernel(error_model="numpy", nogil=True)
def _sort_out(
    mesh: _Mesh,
    level: _Level,
    axes: NDArray[np.int64],
    planes: NDArray[np.float64],
    sides: NDArray[np.uint8],
    counts: NDArray[np.int64],
    boxes: NDArray[np.float64],
) -> None:
    """Write on which ``sides`` of its part's plane each reference is; ``counts`` (2 n,) and ``boxes`` (2 n, 2, 3) grow by them,
    those below part i's plane in row 2 i and those above in the next.
    """
    piece, other = np.empty((_MOST_CORNERS, 3)), np.empty((_MOST_CORNERS, 3))
    low, high = np.empty(3), np.empty(3)
    for i in range(len(axes)):
        axis, plane, cell = axes[i], planes[i], level.cells[i]
        for r in range(level.starts[i], level.starts[i + 1]):
            a, b, c = mesh.triangles[level.references[r]]
            whole = True
            for n in range(3):
                low[n] = min(mesh.positions[a, n], mesh.positions[b, n], mesh.positions[c, n])
                high[n] = max(mesh.positions[a, n], mesh.positions[b, n], mesh.positions[c, n])
                whole &= cell[0, n] <= low[n] and high[n] <= cell[1, n]
            if whole and (high[axis] <= plane or low[axis] >= plane):  # most are
                sides[r] = _BELOW if high[axis] <= plane else _ABOVE
                half = 2 * i + sides[r] - _BELOW
                for n in range(3):
                    boxes[half, 0, n] = min(boxes[half, 0, n], low[n])
                    boxes[half, 1, n] = max(boxes[half, 1, n], high[n])
            else:
                halves = boxes[2 * i : 2 * i + 2]
                sides[r] = _sort_out_cut(mesh, level.references[r], cell, axis, plane, halves, piece, other)
            counts[2 * i] += sides[r] & _BELOW
            counts[2 * i + 1] += sides[r] // _ABOVE


@kernel(error_model="numpy", nogil=True)
def _sort_out_cut(
    mesh: _Mesh,
    triangle: int,
    cell: NDArray[np.float64],
    axis: int,
    plane: float,
    boxes: NDArray[np.float64],
    piece: NDArray[np.float64],
    other: NDArray[np.float64],
) -> int:
    """On which sides of a plane what a cell (2, 3) holds of a triangle is; ``boxes`` (2, 2, 3) of the two grow by it.

    ``piece`` and ``other`` are room for its corners.
    """
    piece, other, count = _clip_to_cell(mesh, triangle, cell, piece, other)
    lowest = highest = piece[0, axis]
    for k in range(1, count):
        lowest, highest = min(lowest, piece[k, axis]), max(highest, piece[k, axis])
    if highest <= plane:
        _grow(boxes[0], piece, count)
        return _BELOW
    if lowest >= plane:
        _grow(boxes[1], piece, count)
        return _ABOVE
    _grow(boxes[0], other, _clip(piece, count, axis, plane, 1.0, other))
    _grow(boxes[1], other, _clip(piece, count, axis, plane, -1.0, other))
    return _BELOW | _ABOVE


@kernel(nogil=True)
def _deal(level: _Level, sides: NDArray[np.uint8], starts: NDArray[np.int64], references: NDArray[np.int32]) -> None:
    """Write the references of each part's two halves from their ``starts`` (2 n,) on, in the order that they have."""
    for i in range(len(level.starts) - 1):
        below, above = starts[2 * i], starts[2 * i + 1]
        for r in range(level.starts[i], level.starts[i + 1]):
            if sides[r] & _BELOW:
                references[below] = level.references[r]
                below += 1
            if sides[r] & _ABOVE:
                references[above] = level.references[r]
                above += 1


@kernel(error_model="numpy", nogil=True)
def _clip_to_cell(
    mesh: _Mesh, triangle: int, cell: NDArray[np.float64], piece: NDArray[np.float64], other: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
    """What of a triangle lies in a cell (2, 3): corners in one of two arrays, which comes first, and how many.

    Where roundings leave nothing of it, its corners moved to where they are in the cell stand for it.
    """
    count = 3
    for k in range(3):
        for axis in range(3):
            piece[k, axis] = mesh.positions[mesh.triangles[triangle, k], axis]
    for axis in range(3):
        for end in range(2):
            plane, sign = cell[end, axis], 2.0 * end - 1.0
            out = False
            for k in range(count):
                out |= sign * piece[k, axis] > sign * plane
            if out:
                count = _clip(piece, count, axis, plane, sign, other)
                piece, other = other, piece
    if count == 0:
        count = 3
        for k in range(3):
            for axis in range(3):
                at = float(mesh.positions[mesh.triangles[triangle, k], axis])
                piece[k, axis] = min(max(at, cell[0, axis]), cell[1, axis])
    return piece, other, count


@kernel(error_model="numpy", nogil=True)
def _clip(
    polygon: NDArray[np.float64], count: int, axis: int, plane: float, sign: float, clipped: NDArray[np.float64]
) -> int:
    """Write the part of a polygon below a plane, or with ``sign`` -1 above it; how many corners it has."""
    found, last = 0, count - 1
    for k in range(count):
        here, before = sign * (polygon[k, axis] - plane), sign * (polygon[last, axis] - plane)
        if here < 0.0 < before or before < 0.0 < here:
            share = before / (before - here)
            for n in range(3):
                clipped[found, n] = polygon[last, n] + share * (polygon[k, n] - polygon[last, n])
            clipped[found, axis] = plane
            found += 1
        if here <= 0.0:
            for n in range(3):
                clipped[found, n] = polygon[k, n]
            found += 1
        last = k
    return found


@kernel(error_model="numpy", nogil=True)
def _grow(box: NDArray[np.float64], polygon: NDArray[np.float64], count: int) -> None:
    """Make a box large enough for a polygon."""
    for k in range(count):
        for n in range(3):
            box[0, n] = min(box[0, n], polygon[k, n])
            box[1, n] = max(box[1, n], polygon[k, n])


def _assembled(generations: list[_Generation]) -> BoxTree:
    """Nodes numbered level by level, references in the order of the leaves from the first child down to the last."""
    levels = np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum([len(one.boxes) for one in generations])])
    counts = [one.listed for one in generations]
    for k in range(len(counts) - 1, 0, -1):
        inside = np.bincount(generations[k].owners, counts[k], minlength=len(counts[k - 1]))
        counts[k - 1] = counts[k - 1] + inside.astype(np.int64)
    starts = [np.zeros(1, dtype=np.int64)]
    for k in range(1, len(counts)):
        above, before = generations[k - 1].family, np.cumsum(counts[k]) - counts[k]
        owners, eldest = generations[k].owners, np.cumsum(above) - above
        starts.append(starts[-1][owners] + before - before[eldest[owners]])
    start, family = np.concatenate(starts), np.concatenate([one.family for one in generations])
    offsets = np.append(0, levels)
    listed = np.concatenate([one.references for one in generations])
    number = np.concatenate([one.listed for one in generations])
    references = np.empty_like(listed)
    references[np.repeat(start - np.cumsum(number) + number, number) + np.arange(len(listed))] = listed
    return BoxTree(
        boxes=np.concatenate([one.boxes for one in generations]),
        parents=np.concatenate([one.owners + at for one, at in zip(generations, offsets, strict=False)]).astype(
            np.int32
        ),
        children=(1 + np.stack([np.cumsum(family) - family, np.cumsum(family)], axis=1)).astype(np.int32),
        levels=levels,
        ranges=np.stack([start, start + np.concatenate(counts)], axis=1),
        references=references,
    )
