"""How far a mesh draws captured texels from where they are, as seen from anywhere in a cell."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mmi.capture.layer_values import DepthTexture, GridMesh
from mmi.foundation.kernels import kernel
from mmi.foundation.ray_chords import Intrinsics, chord, intrinsics_of, may_exceed

__all__ = ["Captured", "Vertices", "as_seen", "displaced_by", "displacement"]


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


def displacement(texture: DepthTexture, mesh: GridMesh, viewpoints: NDArray[np.float64]) -> float:
    """The largest angle between where a captured texel is and where the mesh draws it, from any of ``viewpoints`` (k, 3);
    radians.
    """
    depth = texture.view.project(mesh.vertices.astype(np.float64))[:, 2]
    lattice = mesh.uv.astype(np.float64) * np.array(texture.view.window[2:])
    chord = _displacement(as_seen(texture, viewpoints), Vertices(lattice, 1.0 / depth), mesh.triangles)
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
def _displacement(captured: Captured, vertices: Vertices, triangles: NDArray[np.int32]) -> float:
    """The largest chord (see :func:`chord`) over all captured texels, each drawn by the triangle that its centre lies in."""
    most, reach = 0.0, (captured.offsets**2).sum(axis=1).max() ** 0.5
    for k in range(len(triangles)):
        corners = (triangles[k, 0], triangles[k, 1], triangles[k, 2])
        most = displaced_by(captured, vertices, corners, reach, most)
    return most
