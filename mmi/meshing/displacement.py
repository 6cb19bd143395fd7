"""How far a mesh draws captured texels from where they are: at most, for all viewers of a cell; or for some viewpoints."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.capture.layer_values import DepthTexture, GridMesh
from mmi.foundation.kernels import kernel
from mmi.foundation.ray_chords import Intrinsics, chord, intrinsics_of, may_exceed
from mmi.parallax.from_anywhere import Viewers, parted_at_most, surely_within

__all__ = ["Captured", "Vertices", "as_seen", "displaced_by", "displacement"]


_HALF = 0.499
"""Of a texel, from its centre to its sides, less what texture coordinates are rounded by."""


class Captured(NamedTuple):
    """What was captured and who looks at it: ``inverse`` (h, w) is 1/z of texels, 0 where nothing was hit; ``intrinsics`` those
    of the capture's view, and ``offsets`` (k, 3) the viewpoints in its eye space, metres.
    """

    inverse: NDArray[np.float64]
    intrinsics: Intrinsics
    offsets: NDArray[np.float64]


class Vertices(NamedTuple):
    """Of a mesh: ``lattice`` (n, 2), texels from the window's corner, and ``values`` (n,), 1/z."""

    lattice: NDArray[np.float64]
    values: NDArray[np.float64]


def displacement(texture: DepthTexture, mesh: GridMesh, viewers: Viewers, *, least: float = 0.0) -> float:
    """An angle that no viewer sees exceeded between where a captured texel is and where the mesh draws any part of it; radians.

    Less than ``least`` is not looked for: it is what is said then, and that takes a fraction of the time.
    """
    depth = texture.view.project(mesh.vertices.astype(np.float64))[:, 2]
    lattice = mesh.uv.astype(np.float64) * np.array(texture.view.window[2:])
    inverse = np.where(texture.coverage, 1.0 / texture.depth.astype(np.float64), 0.0)
    left, top = texture.view.window[:2]
    intrinsics = Intrinsics(float(left), float(top), texture.view.focal)
    chord = _displacement(
        inverse, intrinsics, Vertices(lattice, 1.0 / depth), mesh.triangles, viewers, 2.0 * np.sin(0.5 * least)
    )
    return float(2.0 * np.arcsin(min(0.5 * chord, 1.0)))


def as_seen(texture: DepthTexture, viewpoints: NDArray[np.float64]) -> Captured:
    """What a texture has captured, as ``viewpoints`` (k, 3) in the world look at it."""
    inverse = np.where(texture.coverage, 1.0 / texture.depth.astype(np.float64), 0.0)
    return Captured(inverse, *intrinsics_of(texture.view, viewpoints))


@kernel(error_model="numpy")
def displaced_by(
    captured: Captured, vertices: Vertices, corners: tuple[int, int, int], reach: float, least: float
) -> float:
    """``least``, or the largest chord over the captured texels whose centres lie in a triangle, if that is more.

    ``corners`` are three of the ``vertices``; no viewpoint is farther than ``reach`` metres from the capture.
    """
    inverse, lattice, values = captured.inverse, vertices.lattice, vertices.values
    height, width = inverse.shape
    (ax, ay), (bx, by), (cx, cy) = lattice[corners[0]], lattice[corners[1]], lattice[corners[2]]
    a, b, c = values[corners[0]], values[corners[1]], values[corners[2]]
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if area == 0.0:
        return least
    for j in range(max(int(min(ay, by, cy)), 0), min(int(np.ceil(max(ay, by, cy))), height)):
        for i in range(max(int(min(ax, bx, cx)), 0), min(int(np.ceil(max(ax, bx, cx))), width)):
            if inverse[j, i] == 0.0:
                continue
            x, y = i + 0.5, j + 0.5
            s = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
            t = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
            if s < -1e-9 or t < -1e-9 or s + t > 1.0 + 1e-9:
                continue
            drawn = a + s * (b - a) + t * (c - a)
            near, far = 1.0 / max(drawn, inverse[j, i]), 1.0 / min(drawn, inverse[j, i])
            if far - near > 1e-9 * near and may_exceed(least * least, near, far, reach):
                least = max(least, chord(x, y, inverse[j, i], drawn, captured.intrinsics, captured.offsets))
    return least


@kernel(error_model="numpy")
def _displacement(
    inverse: NDArray[np.float64],
    intrinsics: Intrinsics,
    vertices: Vertices,
    triangles: NDArray[np.int32],
    viewers: Viewers,
    most: float,
) -> float:
    """A chord that the displacement of no part of a texel exceeds, by all triangles that show some of it; not below ``most``.

    Within a texel, all of which shows what was captured at its centre, a triangle draws 1/z of a range. Seen from anywhere,
    points of a ray are the farther apart the more their 1/z differ, so the ends of the range tell.
    """
    height, width = inverse.shape
    blur = np.sqrt(0.5) / intrinsics.focal  # from a texel's centre to its corners
    corners, reach = np.empty((3, 3)), viewers.reach
    for k in range(len(triangles)):
        for turn in range(3):
            vertex = triangles[k, turn]
            corners[turn, 0], corners[turn, 1] = vertices.lattice[vertex]
            corners[turn, 2] = vertices.values[vertex]
        (ax, ay, a), (bx, by, b), (cx, cy, c) = corners[0], corners[1], corners[2]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        low, high = min(a, b, c), max(a, b, c)
        across = ((b - a) * (cy - ay) - (c - a) * (by - ay)) / area
        down = ((bx - ax) * (c - a) - (cx - ax) * (b - a)) / area
        slope = _HALF * (abs(across) + abs(down))
        for j in range(max(int(min(ay, by, cy)), 0), min(int(np.ceil(max(ay, by, cy))), height)):
            for i in range(max(int(min(ax, bx, cx)), 0), min(int(np.ceil(max(ax, bx, cx))), width)):
                w = inverse[j, i]
                if w == 0.0:
                    continue
                drawn = a + across * (i + 0.5 - ax) + down * (j + 0.5 - ay)
                # A cheap look first: all of the texel, but no more than the triangle has.
                least, largest = min(max(drawn - slope, low), high), max(min(drawn + slope, high), low)
                if surely_within(most, w, least, reach) and surely_within(most, w, largest, reach):
                    continue
                least, largest = _drawn_within(corners, i, j)
                ux, uy = (intrinsics.left + i + 0.5) / intrinsics.focal, -(intrinsics.top + j + 0.5) / intrinsics.focal
                if least < w and not surely_within(most, w, least, reach):
                    most = max(most, parted_at_most(ux, uy, w, least, blur, viewers, most))
                if largest > w and not surely_within(most, w, largest, reach):
                    most = max(most, parted_at_most(ux, uy, w, largest, blur, viewers, most))
    return most


@kernel(error_model="numpy")
def _drawn_within(corners: NDArray[np.float64], i: int, j: int) -> tuple[float, float]:
    """The least and the largest 1/z of a triangle with these ``corners`` (3, 3), x and y in texels and 1/z, within a texel.

    A linear function is least and largest at corners of what both share: where sides of the triangle are in the texel or leave
    it, and corners of the texel in the triangle. Infinity and 0 where both share nothing.
    """
    least, largest = np.inf, 0.0
    x, y = i + 0.5, j + 0.5
    for turn in range(3):
        ax, ay, a = corners[turn]
        bx, by, b = corners[(turn + 1) % 3]
        enter, leave = 0.0, 1.0
        for axis in range(2):
            start, step = (ax - x, bx - ax) if axis == 0 else (ay - y, by - ay)
            if abs(step) < 1e-9:
                if abs(start) > _HALF:
                    leave = -1.0
                continue
            one, other = (-_HALF - start) / step, (_HALF - start) / step
            enter, leave = max(enter, min(one, other)), min(leave, max(one, other))
        if enter <= leave:
            for t in (enter, leave):
                least, largest = min(least, a + t * (b - a)), max(largest, a + t * (b - a))
    (ax, ay, a), (bx, by, b), (cx, cy, c) = corners[0], corners[1], corners[2]
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    for corner in range(4):
        px, py = x + (_HALF if corner & 1 else -_HALF) - ax, y + (_HALF if corner & 2 else -_HALF) - ay
        s, t = (px * (cy - ay) - py * (cx - ax)) / area, ((bx - ax) * py - (by - ay) * px) / area
        if s >= 0.0 and t >= 0.0 and s + t <= 1.0:
            drawn = a + s * (b - a) + t * (c - a)
            least, largest = min(least, drawn), max(largest, drawn)
    return least, largest
