"""How far a mesh draws captured texels from where they are, as seen from anywhere in a cell."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mmi.capture.layer_values import DepthTexture, GridMesh
from mmi.foundation.ray_chords import chord, frame_of, may_exceed

__all__ = ["as_seen", "displaced_by", "displacement"]


def displacement(texture: DepthTexture, mesh: GridMesh, viewpoints: NDArray[np.float64]) -> float:
    """The largest angle between where a captured texel is and where the mesh draws it, from any of ``viewpoints`` (k, 3);
    radians.
    """
    inverse, frame, offsets = as_seen(texture, viewpoints)
    depth = texture.view.project(mesh.vertices.astype(np.float64))[:, 2]
    lattice = mesh.uv.astype(np.float64) * np.array(texture.view.window[2:])
    chord = _displacement(inverse, frame, offsets, lattice, 1.0 / depth, mesh.triangles)
    return float(2.0 * np.arcsin(min(0.5 * chord, 1.0)))


def as_seen(
    texture: DepthTexture, viewpoints: NDArray[np.float64]
) -> tuple[NDArray[np.float64], tuple[float, float, float], NDArray[np.float64]]:
    """What :func:`chord` needs: 1/z (h, w), 0 where nothing was hit, and what :func:`frame_of` says of the view."""
    inverse = np.where(texture.coverage, 1.0 / texture.depth.astype(np.float64), 0.0)
    return inverse, *frame_of(texture.view, viewpoints)


@njit(cache=True, error_model="numpy")
def displaced_by(
    inverse: NDArray[np.float64],
    lattice: NDArray[np.float64],
    values: NDArray[np.float64],
    corners: tuple[int, int, int],
    frame: tuple[float, float, float],
    offsets: NDArray[np.float64],
    reach: float,
    least: float,
) -> float:
    """``least``, or the largest chord over the captured texels whose centres lie in a triangle, if that is more.

    ``corners`` are places in ``lattice`` (n, 2), texels, and in ``values`` (n,), 1/z; no viewpoint is farther than ``reach``
    metres from the capture.
    """
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
                least = max(least, chord(x, y, inverse[j, i], drawn, frame, offsets))
    return least


@njit(cache=True, error_model="numpy")
def _displacement(
    inverse: NDArray[np.float64],
    frame: tuple[float, float, float],
    offsets: NDArray[np.float64],
    lattice: NDArray[np.float64],
    values: NDArray[np.float64],
    triangles: NDArray[np.int32],
) -> float:
    """The largest chord (see :func:`chord`) over all captured texels, each drawn by the triangle that its centre lies in."""
    most, reach = 0.0, (offsets**2).sum(axis=1).max() ** 0.5
    for k in range(len(triangles)):
        corners = (triangles[k, 0], triangles[k, 1], triangles[k, 2])
        most = displaced_by(inverse, lattice, values, corners, frame, offsets, reach, most)
    return most
