"""Where a layer appears from the reference viewpoint: sectors of the panorama, windows in their image planes, texel sizes.

A panorama is cut into equal sectors of azimuth, each a level picture (paper section 5.1: six of 60 degrees). A layer is
captured only in the window that its objects cover, with texels small enough that from no viewpoint of the cell a texel
appears larger than a pixel of the display (Schaufler 1998, eq. 1: resolution in proportion to the object's size over its
distance, here its least distance to the cell).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from mmi.camera import View, level_view
from mmi.cells import ViewingCell
from mmi.city import City
from mmi.selection import Sight

__all__ = ["Walls", "layer_views", "texel_ratios", "walls_of"]


@dataclass(frozen=True, slots=True, eq=False)
class Walls:
    """Every wall of a city: from ``a`` (n, 2) to ``b`` (n, 2), between heights ``bottom`` and ``top`` (n,), metres.

    Sorted by object: object i owns walls ``first[i]`` to ``first[i + 1]``.
    """

    a: NDArray[np.float64]
    b: NDArray[np.float64]
    bottom: NDArray[np.float64]
    top: NDArray[np.float64]
    first: NDArray[np.int64]

    def of(self, objects: NDArray[np.int64]) -> NDArray[np.int64]:
        """Indices of the walls of ``objects``, object after object."""
        counts = self.first[objects + 1] - self.first[objects]
        starts = np.repeat(self.first[objects] - (np.cumsum(counts) - counts), counts)
        return starts + np.arange(counts.sum())


def walls_of(city: City) -> Walls:
    """The walls of all prisms of all objects, courtyards included."""
    prisms = [(i, prism) for i, one in enumerate(city.objects) for prism in one.prisms]
    rings, prism_of_ring = shapely.get_rings([prism.footprint for _, prism in prisms], return_index=True)
    coordinates, ring = shapely.get_coordinates(rings, return_index=True)
    joined = ring[1:] == ring[:-1]
    prism_of_wall = prism_of_ring[ring[:-1][joined]]
    owner = np.array([i for i, _ in prisms], dtype=np.int64)[prism_of_wall]
    bottom = np.array([prism.bottom for _, prism in prisms])[prism_of_wall]
    top = np.array([prism.top for _, prism in prisms])[prism_of_wall]
    first = np.searchsorted(owner, np.arange(len(city.objects) + 1))
    arrays = (coordinates[:-1][joined], coordinates[1:][joined], bottom, top, first)
    for array in arrays:
        array.setflags(write=False)
    return Walls(*arrays)


def texel_ratios(walls: Walls, index: NDArray[np.int64], cell: ViewingCell) -> NDArray[np.float64]:
    """How much finer than a display's pixels, at least 1, texels of walls ``index`` (k,) need to be, (k,).

    So that from nowhere in the cell they appear larger than a pixel: a texel at distance d from the reference covers
    d / focal metres; from the nearest point of the cell, at distance d', a pixel covers d' / focal. So it is the largest d / d'
    over a wall (taken at its ends, thirds and at the foot of the perpendicular; the ratio is smooth in between).
    """
    along = np.subtract(cell.q, cell.p) / cell.length
    axes = np.array([along, [-along[1], along[0]]])
    a = (walls.a[index] - cell.reference[:2]) @ axes.T
    step = (walls.b[index] - cell.reference[:2]) @ axes.T - a
    foot = np.clip(-np.sum(a * step, axis=1) / np.maximum(np.sum(step * step, axis=1), 1e-12), 0.0, 1.0)
    t = np.stack([*(np.full(len(a), at) for at in (0.0, 1 / 3, 2 / 3, 1.0)), foot])
    points = a + t[..., None] * step
    middle = (np.add(cell.p, cell.q) / 2.0 - cell.reference[:2]) @ axes.T
    outside = np.maximum(np.abs(points - middle) - [0.5 * cell.length, cell.half_width], 0.0)
    from_cell = np.maximum(np.hypot(outside[..., 0], outside[..., 1]), 1.0)
    ratios = np.max(np.hypot(points[..., 0], points[..., 1]) / from_cell, axis=0)
    return np.asarray(np.maximum(ratios, 1.0), dtype=np.float64)


def layer_views(
    walls: Walls,
    objects: NDArray[np.int64],
    cell: ViewingCell,
    *,
    sectors: int,
    focal: float,
    quad: int,
    sight: Sight | None = None,
) -> list[tuple[int, View]]:
    """(sector, view) for every sector that the objects appear in, as far as ``sight`` leaves something of their walls.

    ``focal`` is the display's; each view has texels as fine as the walls in it need (see :func:`texel_ratios`). Windows are
    whole quads of ``quad`` texels and reach one quad beyond the sector's borders, so that the meshes of neighbouring
    sectors overlap and no gap opens between them.
    """
    eye = cell.reference
    half = math.pi / sectors
    index = walls.of(objects)
    low = walls.bottom[index]
    if sight is not None:
        # Where roof or underside may be seen, that ends at walls which face away.
        ends = (walls.top[index] < cell.eye[1]) | (walls.bottom[index] > cell.eye[0])
        low = np.where(ends, low, np.maximum(low, sight.lowest[index]))
        shows = low < walls.top[index]
        index, low = index[shows], low[shows]
    ratios = texel_ratios(walls, index, cell)
    a, b = walls.a[index] - eye[:2], walls.b[index] - eye[:2]
    bottom, top = low - eye[2], walls.top[index] - eye[2]
    views = []
    for sector in range(sectors):
        azimuth = 2.0 * half * sector
        within = _project(a, b, bottom, top, azimuth, focal, math.tan(half) + 2.0 * quad / focal)[0]
        if not within.any():
            continue
        fine = focal * float(ratios[within].max())
        border = quad * (math.ceil(fine * math.tan(half) / quad) + 1)
        seen, u, v_low, v_high = _project(a, b, bottom, top, azimuth, fine, border / fine)
        if not seen.any():
            continue
        # With room for a rim of a texel (mmi.rims) all around.
        left = max(quad * math.floor((u.min() - 1.0) / quad), -border)
        right = min(quad * math.ceil((u.max() + 1.0) / quad), border)
        upper, lower = quad * math.floor((v_low.min() - 1.0) / quad), quad * math.ceil((v_high.max() + 1.0) / quad)
        window = (left, upper, max(right - left, quad), max(lower - upper, quad))
        views.append((sector, level_view(eye, azimuth, focal=fine, window=window)))
    return views


def _project(
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    bottom: NDArray[np.float64],
    top: NDArray[np.float64],
    azimuth: float,
    focal: float,
    spread: float,
) -> tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Walls clipped to |x| <= ``spread`` * depth: which remain (n,), their u (k, 2), least v (k, 2), largest v (k, 2)."""
    forward = np.array([math.cos(azimuth), math.sin(azimuth)])
    right = np.array([math.sin(azimuth), -math.cos(azimuth)])
    xa, da, xb, db = a @ right, a @ forward, b @ right, b @ forward
    start, end = np.zeros(len(a)), np.ones(len(a))
    with np.errstate(divide="ignore", invalid="ignore"):
        for fa, fb in (
            (spread * da - xa, spread * db - xb),
            (spread * da + xa, spread * db + xb),
            (da - 1e-3, db - 1e-3),
        ):
            crossing = fa / (fa - fb)
            start = np.where((fa < 0.0) & (fb >= 0.0), np.maximum(start, crossing), start)
            end = np.where((fa >= 0.0) & (fb < 0.0), np.minimum(end, crossing), end)
            end = np.where((fa < 0.0) & (fb < 0.0), -1.0, end)
    seen = start <= end
    t = np.stack([start, end], axis=1)[seen]
    x = xa[seen, None] + t * (xb - xa)[seen, None]
    depth = da[seen, None] + t * (db - da)[seen, None]
    v_top, v_bottom = -focal * top[seen, None] / depth, -focal * bottom[seen, None] / depth
    return seen, focal * x / depth, np.minimum(v_top, v_bottom), np.maximum(v_top, v_bottom)
