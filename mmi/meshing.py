"""Depth textures -> grid meshes: a regular grid over the window, lifted to depth (paper section 5.1, DESIGN section 4).

Vertices sit on capture rays, at depths fitted to the texels around them in 1/z, in which planes are linear. Quads without
coverage go (parts of split ones too); silhouettes come from the texture's coverage, so the grid reaches just beyond them.

Texture coordinates are stored per vertex, and a graphics card interpolates them perspectively, which over a quad whose
corners differ in depth is not what the capture saw. Such quads are split until the difference is below a tenth of a texel.
Splitting keeps 1/z linear along every grid edge, so that a quad split more finely than its neighbour still shares the
neighbour's edge as a line in space: no cracks.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mmi.impostor import DepthTexture, GridMesh

__all__ = ["covered_windows", "grid_mesh"]

_FINEST = 8  # a quad is split into at most this many a side
_UV_ERROR = 0.1  # texels
_PART = 4096  # texels: a picture of its own costs about as much as so many empty texels


def covered_windows(texture: DepthTexture, *, quad: int) -> list[tuple[int, int, int, int]]:
    """The parts of the texture's window that hold something, from left to right, in whole quads; none where nothing does.

    Empty columns of quads separate parts, each with its own upper and lower edge, unless more than ``_PART`` texels are
    not saved by that.
    """
    left, top, _, _ = texture.view.window
    keep = _blocks_with_coverage(texture.coverage, quad)
    columns = np.flatnonzero(keep.any(axis=0))
    if not columns.size:
        return []
    spans: list[tuple[int, int, int, int]] = []  # first and last column, first and last row
    for run in np.split(columns, np.flatnonzero(np.diff(columns) > 1) + 1):
        rows = np.flatnonzero(keep[:, run[0] : run[-1] + 1].any(axis=1))
        span = (int(run[0]), int(run[-1]), int(rows[0]), int(rows[-1]))
        while spans:
            last = spans[-1]
            both = (last[0], span[1], min(last[2], span[2]), max(last[3], span[3]))
            if (_area(both) - _area(last) - _area(span)) * quad * quad > _PART:
                break
            spans.pop()
            span = both
        spans.append(span)
    return [(left + c0 * quad, top + r0 * quad, (c1 - c0 + 1) * quad, (r1 - r0 + 1) * quad) for c0, c1, r0, r1 in spans]


def _area(span: tuple[int, int, int, int]) -> int:
    return (span[1] - span[0] + 1) * (span[3] - span[2] + 1)


def grid_mesh(texture: DepthTexture, *, quad: int = 16) -> GridMesh:
    """The mesh of one depth texture.

    ``quad`` is the side of a grid cell in texels, a multiple of 8; the window's size must be a multiple of it, and
    something covered. Raises ValueError if not.
    """
    left, top, width, height = texture.view.window
    covered = texture.coverage
    if quad % _FINEST or width % quad or height % quad or not covered.any():
        raise ValueError(f"a covered window of whole quads of {quad} texels expected, found {width} x {height}")
    inverse = _fit(texture.depth, quad)
    inverse = _spread(inverse)
    shown = _blocks_with_coverage(covered, quad // _FINEST)
    lattice, weights, triangles = _triangulate(inverse, shown, _splits(inverse, quad))
    uv = lattice / np.array([width, height]) * (quad / _FINEST)
    u = left + lattice[:, 0] * (quad / _FINEST)
    v = top + lattice[:, 1] * (quad / _FINEST)
    vertices = texture.view.unproject(u, v, 1.0 / weights)
    return GridMesh(vertices.astype(np.float32), uv.astype(np.float32), triangles)


@njit(cache=True)
def _fit(depth: NDArray[np.float32], quad: int) -> NDArray[np.float64]:
    """1/z at the grid's vertices (rows + 1, columns + 1): a plane fitted to the texels of the four quads around each.

    NaN where none of them is covered. Extrapolation is held within one range of the texels' 1/z beyond their extremes.
    """
    rows, columns = depth.shape[0] // quad, depth.shape[1] // quad
    # Sums over each quad of 1, x, y, xx, xy, yy, w, xw, yw, with x, y from the quad's upper left corner in quads.
    sums = np.zeros((rows, columns, 9))
    low = np.full((rows, columns), np.inf)
    high = np.zeros((rows, columns))
    for i in range(rows * quad):
        r = i // quad
        y = (i - r * quad + 0.5) / quad
        for j in range(columns * quad):
            z = np.float64(depth[i, j])
            if not np.isfinite(z):
                continue
            c = j // quad
            x = (j - c * quad + 0.5) / quad
            w = 1.0 / z
            s = sums[r, c]
            s[0] += 1.0
            s[1] += x
            s[2] += y
            s[3] += x * x
            s[4] += x * y
            s[5] += y * y
            s[6] += w
            s[7] += x * w
            s[8] += y * w
            low[r, c] = min(low[r, c], w)
            high[r, c] = max(high[r, c], w)
    inverse = np.full((rows + 1, columns + 1), np.nan)
    for i in range(rows + 1):
        for j in range(columns + 1):
            n = sx = sy = sxx = sxy = syy = sw = sxw = syw = 0.0
            smallest, largest = np.inf, 0.0
            for r in range(max(i - 1, 0), min(i + 1, rows)):
                for c in range(max(j - 1, 0), min(j + 1, columns)):
                    s = sums[r, c]
                    if s[0] == 0.0:
                        continue
                    dx, dy = c - j, r - i  # the quad's corner, seen from the vertex
                    n += s[0]
                    sx += s[1] + dx * s[0]
                    sy += s[2] + dy * s[0]
                    sxx += s[3] + 2.0 * dx * s[1] + dx * dx * s[0]
                    sxy += s[4] + dx * s[2] + dy * s[1] + dx * dy * s[0]
                    syy += s[5] + 2.0 * dy * s[2] + dy * dy * s[0]
                    sw += s[6]
                    sxw += s[7] + dx * s[6]
                    syw += s[8] + dy * s[6]
                    smallest = min(smallest, low[r, c])
                    largest = max(largest, high[r, c])
            if n == 0.0:
                continue
            inverse[i, j] = _plane_at_origin(n, sx, sy, sxx, sxy, syy, sw, sxw, syw)
            spread = largest - smallest
            inverse[i, j] = min(max(inverse[i, j], max(smallest - spread, 0.5 * smallest)), largest + spread)
    return inverse


@njit(cache=True)
def _plane_at_origin(
    n: float, sx: float, sy: float, sxx: float, sxy: float, syy: float, sw: float, sxw: float, syw: float
) -> float:
    """a of the least-squares plane w = a + b x + c y with these moments; the mean where the texels span no plane."""
    mx, my, mw = sx / n, sy / n, sw / n
    cxx, cxy, cyy = sxx / n - mx * mx, sxy / n - mx * my, syy / n - my * my
    cxw, cyw = sxw / n - mx * mw, syw / n - my * mw
    det = cxx * cyy - cxy * cxy
    if det > 1e-6:
        return mw - ((cxw * cyy - cyw * cxy) * mx + (cyw * cxx - cxw * cxy) * my) / det
    if cxx > 1e-4 and cxx >= cyy:
        return mw - cxw / cxx * mx
    if cyy > 1e-4:
        return mw - cyw / cyy * my
    return mw


@njit(cache=True)
def _blocks_with_coverage(covered: NDArray[np.bool_], side: int) -> NDArray[np.bool_]:
    """(rows, columns): blocks of ``side`` texels that hold a covered one, or touch one (filtering reaches beyond)."""
    height, width = covered.shape
    blocks = np.zeros((height // side, width // side), dtype=np.bool_)
    for i in range(height):
        for j in range(width):
            if covered[i, j]:
                upper, lower = max(i - 1, 0) // side, min(i + 1, height - 1) // side
                left, right = max(j - 1, 0) // side, min(j + 1, width - 1) // side
                blocks[upper, left] = blocks[upper, right] = blocks[lower, left] = blocks[lower, right] = True
    return blocks


def _spread(inverse: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vertices without a depth take the mean of their neighbours', as far as there are any, ring by ring."""
    inverse = inverse.copy()
    while np.isnan(inverse).any():
        padded = np.pad(inverse, 1, constant_values=np.nan)
        rows, columns = inverse.shape
        around = np.stack([padded[i : i + rows, j : j + columns] for i in range(3) for j in range(3)])
        known = ~np.isnan(around)
        count = known.sum(axis=0)
        mean = np.where(known, around, 0.0).sum(axis=0) / np.maximum(count, 1)
        inverse = np.where(np.isnan(inverse) & (count > 0), mean, inverse)
    return inverse


def _splits(inverse: NDArray[np.float64], quad: int) -> NDArray[np.int64]:
    """(rows, columns): into how many (1, 2, 4 or 8) a quad is cut each way.

    Halfway between two vertices whose coordinates differ by n texels and whose depths are z0 and z1, perspective
    interpolation is off by n |z0 - z1| / (2 (z0 + z1)) texels. That is worst on the diagonal, and cutting a quad by k each
    way divides both n and the difference of depths.
    """
    corners = np.stack([inverse[:-1, :-1], inverse[:-1, 1:], inverse[1:, :-1], inverse[1:, 1:]])
    high, low = corners.max(axis=0), corners.min(axis=0)
    needed = np.sqrt(0.5 * quad * (high - low) / (high + low) / _UV_ERROR)
    return np.asarray(2 ** np.ceil(np.log2(np.clip(needed, 1.0, _FINEST))), dtype=np.int64)


@njit(cache=True)
def _triangulate(
    inverse: NDArray[np.float64], shown: NDArray[np.bool_], splits: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]]:
    """Vertices on a lattice of 1/8 quads (n, 2), their 1/z (n,) and triangles (m, 3), where ``shown`` on that lattice."""
    rows, columns = splits.shape
    index = np.full((rows * _FINEST + 1, columns * _FINEST + 1), -1, dtype=np.int32)
    most = 0
    for r in range(rows):
        for c in range(columns):
            most += (splits[r, c] + 1) ** 2
    lattice = np.empty((most, 2))
    weights = np.empty(most)
    corners = np.empty((2 * most, 3), dtype=np.int32)
    n = m = 0
    for r in range(rows):
        for c in range(columns):
            k = splits[r, c]
            step = _FINEST // k
            for b in range(k):
                for a in range(k):
                    top, left = r * _FINEST + b * step, c * _FINEST + a * step
                    if not shown[top : top + step, left : left + step].any():
                        continue
                    for corner in range(4):
                        i, j = top + step * (corner // 2), left + step * (corner % 2)
                        if index[i, j] < 0:
                            s, t = (a + corner % 2) / k, (b + corner // 2) / k
                            upper = inverse[r, c] * (1.0 - s) + inverse[r, c + 1] * s
                            lower = inverse[r + 1, c] * (1.0 - s) + inverse[r + 1, c + 1] * s
                            lattice[n, 0], lattice[n, 1] = j, i
                            weights[n] = upper * (1.0 - t) + lower * t
                            index[i, j] = n
                            n += 1
                    corners[m, 0], corners[m, 1] = index[top, left], index[top + step, left]
                    corners[m, 2] = index[top + step, left + step]
                    corners[m + 1, 0], corners[m + 1, 1] = index[top, left], index[top + step, left + step]
                    corners[m + 1, 2] = index[top, left + step]
                    m += 2
    return lattice[:n], weights[:n], corners[:m].copy()
