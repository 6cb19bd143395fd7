"""A plain software rasteriser: what a mesh looks like, without OpenGL. An oracle, so it shares no code with the project."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def draw(projected, attributes, triangles, left, top, width, height):
    """Depth (h, w) and perspectively interpolated attributes (h, w, k) of triangles, at pixel centres.

    ``projected`` (n, 3) are u, v and depth; ``triangles`` (m, 3); attributes of uncovered pixels are NaN, depth inf.
    """
    depth = np.full((height, width), np.inf)
    values = np.full((height, width, attributes.shape[1]), np.nan)
    for t in range(len(triangles)):
        a, b, c = triangles[t]
        ax, ay, az = projected[a]
        bx, by, bz = projected[b]
        cx, cy, cz = projected[c]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0 or az <= 0.0 or bz <= 0.0 or cz <= 0.0:
            continue
        i0 = max(int(np.floor(min(ay, by, cy) - top - 0.5)), 0)
        i1 = min(int(np.ceil(max(ay, by, cy) - top)), height - 1)
        j0 = max(int(np.floor(min(ax, bx, cx) - left - 0.5)), 0)
        j1 = min(int(np.ceil(max(ax, bx, cx) - left)), width - 1)
        for i in range(i0, i1 + 1):
            y = top + i + 0.5
            for j in range(j0, j1 + 1):
                x = left + j + 0.5
                wa = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
                wb = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
                wc = 1.0 - wa - wb
                if wa < -1e-9 or wb < -1e-9 or wc < -1e-9:
                    continue
                inverse = wa / az + wb / bz + wc / cz
                if 1.0 / inverse < depth[i, j]:
                    depth[i, j] = 1.0 / inverse
                    for k in range(attributes.shape[1]):
                        total = wa / az * attributes[a, k] + wb / bz * attributes[b, k] + wc / cz * attributes[c, k]
                        values[i, j, k] = total / inverse
    return depth, values


def bilinear(image, uv):
    """``image`` (h, w, c) sampled at uv (..., 2) in [0, 1], clamped at the border."""
    height, width = image.shape[:2]
    x = np.clip(uv[..., 0] * width - 0.5, 0.0, width - 1.0)
    y = np.clip(uv[..., 1] * height - 0.5, 0.0, height - 1.0)
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    x1, y1 = np.minimum(x0 + 1, width - 1), np.minimum(y0 + 1, height - 1)
    fx, fy = (x - x0)[..., None], (y - y0)[..., None]
    image = image.astype(float)
    upper = image[y0, x0] * (1 - fx) + image[y0, x1] * fx
    lower = image[y1, x0] * (1 - fx) + image[y1, x1] * fx
    return upper * (1 - fy) + lower * fy


def psnr(a, b):
    """Peak signal-to-noise ratio of two 8-bit pictures, decibels."""
    error = np.mean((np.asarray(a, dtype=float) - np.asarray(b, dtype=float)) ** 2)
    return np.inf if error == 0 else 10.0 * np.log10(255.0**2 / error)
