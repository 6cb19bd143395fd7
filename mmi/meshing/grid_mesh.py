"""Depth textures -> grid meshes, as coarse as the error that they may add allows (paper section 5.1, DESIGN section 4).

The window is cut into rectangles of whole texels, and these are cut further until the surface drawn lies close enough to what
was captured: seen from the cell's corners no texel is displaced by more than a tolerance. Flat walls stay large rectangles, as
planes are linear in 1/z and a triangle shows them exactly; cuts fall on corners and silhouettes, where depth bends or jumps.
Rectangles shrink to what they hold of the captured surfaces; silhouettes themselves come from the texture's coverage, so the
mesh reaches a texel beyond them.

Vertices sit on capture rays, on the plane through the texels around them that belong to one surface. Rectangles meet others
along parts of their sides; each is triangulated with all vertices on its outline, so there are no cracks
(``mmi.meshing.triangulation``). Only where two surfaces are farther apart than may be joined do they have vertices of their own
(``mmi.meshing.tears``).

Texture coordinates are stored per vertex, and a graphics card interpolates them perspectively, which over a triangle whose
corners differ in depth is not what the capture saw. Rectangles are cut until the difference is about a texel.
(The viewer of this project uses projective coordinates, for which there is no difference.)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mmi.capture.layer_values import DepthTexture, GridMesh
from mmi.foundation.kernels import kernel
from mmi.foundation.ray_chords import chord
from mmi.meshing.displacement import Captured, as_seen
from mmi.meshing.tears import (
    JOINED,
    LOWER_LEFT,
    LOWER_RIGHT,
    UNKNOWN,
    UPPER_LEFT,
    UPPER_RIGHT,
    Lattice,
    Tears,
    beside,
    filled,
    may_join,
    range_of,
    surface_of,
    surfaces_at,
    used_by,
    used_on_side,
)
from mmi.meshing.triangulation import UV_ERROR, stretch, triangulated
from mmi.parallax.from_anywhere import Viewers

__all__ = ["grid_mesh"]

_LARGEST = 64  # texels: the rectangles that cutting begins with
_REACH = 3  # texels around a vertex that its depth is fitted to
_ONE_SURFACE = 0.01  # relative difference of depths between neighbouring texels of one surface, at most


def grid_mesh(
    texture: DepthTexture,
    *,
    viewpoints: NDArray[np.float64],
    tolerance: float,
    viewers: Viewers,
    widest: float,
    all_jumps: bool = False,
) -> GridMesh:
    """The mesh of one depth texture, off by at most about ``tolerance`` radians as seen from ``viewpoints`` (k, 3).

    A rectangle between its four corners is off by no more than that; vertices of others on its sides may add as much again.
    Where depth jumps from one texel to the next, the mesh stretches between the two, and texels next to the jump may be
    displaced by as much as it is; a jump that some of the ``viewers`` may see wider than ``widest`` radians tears it instead
    (:mod:`mmi.meshing.tears`), and where ``all_jumps`` count also a surface along which the capture looks.
    :func:`mmi.meshing.displacement.displacement` bounds what remains. Raises ValueError where nothing is covered.
    """
    if not texture.coverage.any():
        raise ValueError("a depth texture that shows something expected, found an empty one")
    left, top, width, height = texture.view.window
    captured = as_seen(texture, viewpoints)
    tears = Tears(filled(captured.inverse), viewers, 2.0 * np.sin(0.5 * min(widest, np.pi)), all_jumps)
    lattice, triangles, values = _mesh(captured, tears, 2.0 * np.sin(0.5 * tolerance))
    vertices = texture.view.unproject(left + lattice[:, 0], top + lattice[:, 1], 1.0 / values)
    uv = lattice / np.array([width, height])
    return GridMesh(vertices.astype(np.float32), uv.astype(np.float32), triangles)


@kernel(error_model="numpy")
def _value(inverse: NDArray[np.float64], x: int, y: int, least: float, most: float) -> float:
    """1/z at the corner (x, y) of texels: on the plane of the texels around it that belong to the nearest one's surface.

    The nearest is one of those with 1/z from ``least`` to ``most``. Of equally near texels, the front-most counts. Where
    nothing is within reach, the nearest in growing squares counts.
    """
    height, width = inverse.shape
    reach, seed_x, seed_y = 1, -1, -1
    while seed_x < 0:
        best, front = 1e300, 0.0
        for j in range(max(y - reach, 0), min(y + reach, height)):
            for i in range(max(x - reach, 0), min(x + reach, width)):
                if inverse[j, i] > 0.0 and least <= inverse[j, i] <= most:
                    square = (i + 0.5 - x) ** 2 + (j + 0.5 - y) ** 2
                    if square < best - 1e-9 or (square < best + 1e-9 and inverse[j, i] > front):
                        best, front, seed_x, seed_y = min(square, best), inverse[j, i], i, j
        if reach > height and reach > width:
            return 0.0
        reach *= 2
    seed = inverse[seed_y, seed_x]
    # Grown from the seed within a square around it, over texels that differ little from a neighbour.
    size = 2 * _REACH + 1
    taken = np.zeros((size, size), dtype=np.bool_)
    queue = np.empty((size * size, 2), dtype=np.int64)
    taken[_REACH, _REACH] = True
    queue[0, 0], queue[0, 1] = seed_x, seed_y
    count, at = 1, 0
    sx = sy = sxx = sxy = syy = sw = sxw = syw = 0.0
    low, high = seed, seed
    while at < count:
        i, j = queue[at]
        at += 1
        w = inverse[j, i]
        dx, dy = i + 0.5 - x, j + 0.5 - y
        sx, sy, sw = sx + dx, sy + dy, sw + w
        sxx, sxy, syy = sxx + dx * dx, sxy + dx * dy, syy + dy * dy
        sxw, syw = sxw + dx * w, syw + dy * w
        low, high = min(low, w), max(high, w)
        for turn in range(4):
            ni, nj = i + (turn == 0) - (turn == 1), j + (turn == 2) - (turn == 3)
            ti, tj = ni - seed_x + _REACH, nj - seed_y + _REACH
            if not (0 <= ti < size and 0 <= tj < size and 0 <= ni < width and 0 <= nj < height) or taken[tj, ti]:
                continue
            other = inverse[nj, ni]
            if other > 0.0 and abs(other - w) < _ONE_SURFACE * max(other, w):
                taken[tj, ti] = True
                queue[count, 0], queue[count, 1] = ni, nj
                count += 1
    found = _plane_at_origin(float(count), sx, sy, sxx, sxy, syy, sw, sxw, syw)
    spread = high - low
    # As far beyond the texels as the corner lies beyond them.
    far = max(abs(seed_x + 0.5 - x), abs(seed_y + 0.5 - y)) / _REACH
    return min(max(found, low - spread * max(far, 1.0), 0.5 * low), high + spread * max(far, 1.0))


@kernel(error_model="numpy")
def _known(lattice: Lattice, captured: Captured, tears: Tears, x: int, y: int, texel: int) -> float:
    """1/z at the corner (x, y) of texels on the surface of one of the texels around it; kept in the ``lattice``."""
    surfaces, values = lattice
    if surfaces[y, x] == UNKNOWN:
        surfaces[y, x] = surfaces_at(x, y, tears, captured.intrinsics)
    at = surface_of(surfaces[y, x], texel)
    if values[y, x, at] == 0.0:
        least, most = range_of(x, y, tears, surfaces[y, x], at)
        torn = surfaces[y, x] != JOINED
        value = _value(captured.inverse, x, y, least if torn else 0.0, most if torn else np.inf)
        # Beyond the texels around it a plane may lead far away from them: no farther than what is joined.
        if most > 0.0 and not (
            may_join(x, y, value, least, tears, captured.intrinsics)
            and may_join(x, y, value, most, tears, captured.intrinsics)
        ):
            value = min(max(value, least), most)
        values[y, x, at] = value
    return values[y, x, at]


@kernel()
def _plane_at_origin(
    n: float, sx: float, sy: float, sxx: float, sxy: float, syy: float, sw: float, sxw: float, syw: float
) -> float:
    """a of the least-squares plane w = a + b x + c y with these moments; the mean where the texels span no plane."""
    mx, my, mw = sx / n, sy / n, sw / n
    cxx, cxy, cyy = sxx / n - mx * mx, sxy / n - mx * my, syy / n - my * my
    cxw, cyw = sxw / n - mx * mw, syw / n - my * mw
    det = cxx * cyy - cxy * cxy
    if det > 1e-3:
        return mw - ((cxw * cyy - cyw * cxy) * mx + (cyw * cxx - cxw * cxy) * my) / det
    if cxx > 1e-4 and cxx >= cyy:
        return mw - cxw / cxx * mx
    if cyy > 1e-4:
        return mw - cyw / cyy * my
    return mw


@kernel(error_model="numpy")
def _trimmed(covered: NDArray[np.bool_], box: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
    """The part of a box (x0, y0, x1, y1) that holds covered texels; (0, 0, 0, 0) where none is."""
    x0, y0, x1, y1 = box
    left, top, right, bottom = x1, y1, x0, y0
    for j in range(y0, y1):
        for i in range(x0, x1):
            if covered[j, i]:
                left, right, top, bottom = min(left, i), max(right, i + 1), min(top, j), max(bottom, j + 1)
    return (left, top, right, bottom) if right > left else (0, 0, 0, 0)


@kernel(error_model="numpy")
def _worst(
    captured: Captured, box: tuple[int, int, int, int], corners: tuple[float, float, float, float], tolerance: float
) -> tuple[int, int]:
    """A texel of the box that two triangles between its corners' 1/z displace by more than the tolerance; (-1, -1) for none.

    The one that is off most, relative to its own 1/z. The diagonal runs from upper left to lower right.
    """
    x0, y0, x1, y1 = box
    upper_left, upper_right, lower_left, lower_right = corners
    inverse, offsets = captured.inverse, captured.offsets
    most, at = 0.0, (-1, -1)
    # What is certainly within the tolerance needs no angles.
    reach = 0.0
    for k in range(len(offsets)):
        reach = max(reach, (offsets[k, 0] ** 2 + offsets[k, 1] ** 2 + offsets[k, 2] ** 2) ** 0.5)
    for j in range(y0, y1):
        t = (j + 0.5 - y0) / (y1 - y0)
        for i in range(x0, x1):
            w = inverse[j, i]
            if w == 0.0:
                continue
            s = (i + 0.5 - x0) / (x1 - x0)
            if s > t:
                drawn = upper_left + s * (upper_right - upper_left) + t * (lower_right - upper_right)
            else:
                drawn = upper_left + t * (lower_left - upper_left) + s * (lower_right - lower_left)
            off = abs(drawn - w)
            if off <= most * w:
                continue
            closest = 1.0 - reach * max(w, drawn)
            if closest > 0.0 and reach * off < tolerance * closest * closest:
                continue
            if chord(i + 0.5, j + 0.5, w, drawn, captured.intrinsics, offsets) > tolerance:
                most, at = off / w, (i, j)
    return at


@kernel(error_model="numpy")
def _stretched(box: tuple[int, int, int, int], corners: tuple[float, float, float, float]) -> tuple[bool, bool]:
    """Whether a box is to be cut in x, and in y, since perspective interpolation along its sides or diagonal is off by too
    much.
    """
    wide, high = float(box[2] - box[0]), float(box[3] - box[1])
    upper_left, upper_right, lower_left, lower_right = corners
    across = max(stretch(wide, upper_left, upper_right), stretch(wide, lower_left, lower_right))
    down = max(stretch(high, upper_left, lower_left), stretch(high, upper_right, lower_right))
    diagonal = stretch((wide * wide + high * high) ** 0.5, upper_left, lower_right)
    if max(across, down, diagonal) <= UV_ERROR:
        return False, False
    return across >= down, across < down


@kernel(error_model="numpy")
def _cut(inverse: NDArray[np.float64], box: tuple[int, int, int, int], at: tuple[int, int]) -> tuple[bool, int]:
    """Where to cut a box with a displaced texel: (whether across x, the coordinate of the cut).

    The cut goes where 1/z bends or jumps most along the row and the column of that texel; where it is smooth, beside the texel.
    """
    x0, y0, x1, y1 = box
    i, j = at
    bend_x, cut_x, bend_y, cut_y = 0.0, -1, 0.0, -1
    for x in range(x0 + 1, x1):
        a, b = inverse[j, x - 1], inverse[j, x]
        if a == 0.0 or b == 0.0:
            continue
        before = inverse[j, x - 2] if x - 2 >= x0 and inverse[j, x - 2] > 0.0 else a
        after = inverse[j, x + 1] if x + 1 < x1 and inverse[j, x + 1] > 0.0 else b
        bend = abs((b - a) - 0.5 * ((a - before) + (after - b)))
        if bend > bend_x:
            bend_x, cut_x = bend, x
    for y in range(y0 + 1, y1):
        a, b = inverse[y - 1, i], inverse[y, i]
        if a == 0.0 or b == 0.0:
            continue
        before = inverse[y - 2, i] if y - 2 >= y0 and inverse[y - 2, i] > 0.0 else a
        after = inverse[y + 1, i] if y + 1 < y1 and inverse[y + 1, i] > 0.0 else b
        bend = abs((b - a) - 0.5 * ((a - before) + (after - b)))
        if bend > bend_y:
            bend_y, cut_y = bend, y
    least = 1e-3 * inverse[j, i]
    if bend_x > least and bend_x >= bend_y:
        return True, cut_x
    if bend_y > least:
        return False, cut_y
    # Smooth within, so it is the corners that belong to something else: cut off the side closest to the texel.
    gaps = (i - x0, x1 - 1 - i, j - y0, y1 - 1 - j)
    best, across, where = 1 << 30, True, -1
    for side in range(4):
        cut = (i + 1, i, j + 1, j)[side]
        inside = (x0 < cut < x1) if side < 2 else (y0 < cut < y1)
        if inside and gaps[side] < best:
            best, across, where = gaps[side], side < 2, cut
    return across, where


@kernel(error_model="numpy")
def _cut_beside(
    box: tuple[int, int, int, int],
    lattice: Lattice,
    used: NDArray[np.int32],
    captured: Captured,
    tolerance: float,
) -> tuple[bool, int]:
    """Where to cut a box of which a side has a vertex farther from the straight line than the tolerance: as :func:`_cut`.

    First a strip of one texel along that side, then that strip at the vertex. The coordinate is -1 where nothing is to be
    cut.
    """
    x0, y0, x1, y1 = box
    most, found = 0.0, (True, -1)
    for side in range(4):
        level = side < 2  # along a row
        fixed = (y0, y1, x0, x1)[side]
        start, end = (x0, x1) if level else (y0, y1)
        thick = y1 - y0 if level else x1 - x0
        before, behind = beside(side)
        ends = (start, fixed, end, fixed) if level else (fixed, start, fixed, end)
        first = lattice.values[ends[1], ends[0], surface_of(lattice.surfaces[ends[1], ends[0]], behind)]
        last = lattice.values[ends[3], ends[2], surface_of(lattice.surfaces[ends[3], ends[2]], before)]
        for k in range(start + 1, end):
            x, y = (k, fixed) if level else (fixed, k)
            surface = used_on_side(lattice, used, x, y, side)
            if surface < 0:
                continue
            value = lattice.values[y, x, surface]
            straight = first + (last - first) * (k - start) / (end - start)
            off = abs(straight - value) / straight
            if off <= max(most, 1e-6):
                continue
            if chord(x, y, straight, value, captured.intrinsics, captured.offsets) > tolerance:
                most = off
                strip = fixed + 1 if side % 2 == 0 else fixed - 1
                found = (not level, strip) if thick > 1 else (level, k)
    return found


@kernel(error_model="numpy")
def _halves(box: tuple[int, int, int, int], across: bool, where: int) -> list[tuple[int, int, int, int]]:
    """The two parts of a box that is cut at a coordinate, across x or across y."""
    x0, y0, x1, y1 = box
    if across:
        return [(x0, y0, where, y1), (where, y0, x1, y1)]
    return [(x0, y0, x1, where), (x0, where, x1, y1)]


@kernel(error_model="numpy")
def _mesh(
    captured: Captured, tears: Tears, tolerance: float
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64]]:
    """Vertices on the lattice of texel corners (n, 2), triangles (m, 3), and the vertices' 1/z (n,)."""
    inverse = captured.inverse
    height, width = inverse.shape
    covered = np.zeros((height, width), dtype=np.bool_)  # and a texel beyond: filtering reaches that far
    for j in range(height):
        for i in range(width):
            if inverse[j, i] > 0.0:
                covered[max(j - 1, 0) : j + 2, max(i - 1, 0) : i + 2] = True
    lattice = Lattice(np.full((height + 1, width + 1), UNKNOWN, np.uint8), np.zeros((height + 1, width + 1, 4)))
    used = np.full((height + 1, width + 1, 4), -1, dtype=np.int32)
    stack = [(0, 0, 0, 0)]
    stack.pop()
    for y in range(0, height, _LARGEST):
        for x in range(0, width, _LARGEST):
            stack.append((x, y, min(x + _LARGEST, width), min(y + _LARGEST, height)))  # noqa: PERF401 (Numba)
    leaves = [(0, 0, 0, 0)]
    leaves.pop()
    while stack:
        while stack:
            box = _trimmed(covered, stack.pop())
            x0, y0, x1, y1 = box
            if x1 == x0:
                continue
            corners = (
                _known(lattice, captured, tears, x0, y0, LOWER_RIGHT),
                _known(lattice, captured, tears, x1, y0, LOWER_LEFT),
                _known(lattice, captured, tears, x0, y1, UPPER_RIGHT),
                _known(lattice, captured, tears, x1, y1, UPPER_LEFT),
            )
            across, where = True, -1
            in_x, in_y = _stretched(box, corners)
            if in_x and x1 - x0 > 1:
                across, where = True, (x0 + x1) // 2
            elif in_y and y1 - y0 > 1:
                across, where = False, (y0 + y1) // 2
            at = _worst(captured, box, corners, tolerance)
            if at[0] >= 0 and (x1 - x0 > 1 or y1 - y0 > 1):
                across, where = _cut(inverse, box, at)
            if where < 0:
                leaves.append(box)
            else:
                stack.extend(_halves(box, across, where))
        # Vertices of others on a leaf's sides pull its surface towards theirs: where that is too far, it is cut there.
        used[:] = -1
        for box in leaves:
            used_by(lattice, box, used)
        kept = [(0, 0, 0, 0)]
        kept.pop()
        for box in leaves:
            across, where = _cut_beside(box, lattice, used, captured, tolerance)
            if where < 0:
                kept.append(box)
            else:
                stack.extend(_halves(box, across, where))
        leaves = kept
    return triangulated(captured, leaves, lattice, tolerance)
