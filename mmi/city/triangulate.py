"""Polygons with holes filled with triangles, many at a time: roofs, floors, faces of models."""

from __future__ import annotations

import itertools

import mapbox_earcut
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mmi.city.outlines import outlines_of

__all__ = ["triangulate"]


def triangulate(polygons: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Points (n, 2) of the rings of ``polygons`` (k,), triangles (m, 3) that fill them, and the polygon of each point (n,).

    Triangles are counter-clockwise. Points and triangles are in the order of the polygons.
    """
    outlines = outlines_of(polygons)
    points, ring = outlines.points[outlines.starts], outlines.edge_rings
    of = outlines.polygon[ring]
    ends = np.flatnonzero(np.append(ring[1:] != ring[:-1], True)[: len(ring)]) + 1  # of rings
    bounds = np.searchsorted(of, np.arange(of[-1] + 2 if len(of) else 1))  # of polygons
    near = points - np.repeat(points[bounds[:-1]], np.diff(bounds), axis=0)  # near zero, where float64 is finest
    spans = itertools.pairwise(zip(bounds.tolist(), np.searchsorted(ends, bounds, side="right").tolist(), strict=True))
    filled = [np.empty((0, 3), dtype=np.int64)]
    for (start, first_ring), (end, last_ring) in spans:
        of_rings = (ends[first_ring:last_ring] - start).astype(np.uint32)
        filled.append(mapbox_earcut.triangulate_float64(near[start:end], of_rings).reshape(-1, 3) + np.int64(start))
    triangles = np.concatenate(filled)
    p, q, r = (near[triangles[:, i]] for i in range(3))
    # Earcut promises no winding.
    turned = (q[:, 0] - p[:, 0]) * (r[:, 1] - p[:, 1]) < (q[:, 1] - p[:, 1]) * (r[:, 0] - p[:, 0])
    triangles[turned] = triangles[turned][:, ::-1]
    return points, triangles, of
