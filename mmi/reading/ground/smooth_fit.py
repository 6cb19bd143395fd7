"""A smooth ground through heights of which some are wrong: a thin plate, fitted robustly, level across streets.

The plate bends as little as the heights allow: the sum of squared misfits is weighed against the integral of its squared second
derivatives, which an inclined plane has none of. Misfits count by the loss of Geman and McClure, under which a height far off
the plate (of a basement, of a bridge) has no pull at all; its scale starts as wide as all heights and narrows to that of the
misfits (graduated non-convexity), so that the result does not hang on a first guess. Each step is one sparse linear system.

Source: Terzopoulos, The computation of visible-surface representations, 1988 (thin plate on a grid); Geman & McClure,
Statistical methods for tomographic image reconstruction, 1987 (the loss); Blake & Zisserman, Visual Reconstruction, 1987.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import csc_matrix, csr_matrix, diags, identity, kron, vstack
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from mmi.city.terrain import Terrain

__all__ = ["Fit", "fitted_ground"]

_FINEST, _MOST_SQUARES = 5.0, 160
"""Metres between grid lines at the finest, and squares along the longer side: bounds the time for any number of heights."""
_STEPS, _SETTLED = 12, 0.005
"""Systems that are solved at most, and metres: once the scale is narrow, no point of the ground changes more in the last."""
_SHORTEST, _REACH = 12.0, 0.6
"""Metres below which the plate does not follow heights; where places lie farther apart, this share of the distance between
them."""
_CROWD = 6
"""Neighbours that tell how far apart places lie."""
_LEVEL = 1e-4
"""Pull to level ground, as a share of the plate's stiffness: what decides where heights leave a tilt open."""
_SURE, _DEVIATIONS = 0.1, 3.0
"""Metres that misfits always may have, and deviations (from the median) at which a height counts a quarter."""
_ASIDE, _EVERY, _ACROSS = 4.0, 8.0, 1.0
"""Metres from a street's middle to its edges; metres between places along it; how much the levels of both edges weigh there,
where a place with a height weighs 1."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A fitted ground. ``misfits`` (n,) are the heights less the ground, metres; ``wrong`` (n,) have no say in it."""

    terrain: Terrain
    misfits: NDArray[np.float64]
    wrong: NDArray[np.bool_]


def fitted_ground(
    outlines: NDArray[np.object_],
    heights: NDArray[np.float64],
    *,
    bounds: tuple[float, float, float, float],
    streets: NDArray[np.object_],
) -> Fit:
    """The ground over ``bounds`` whose lowest point at each outline (n,) of a building is as high as its foot (n,), metres.

    A foot is level, so on a slope it meets the ground where this is lowest. ``streets`` (k,) are lines across which the ground
    is to be level. No point of it is outside of the range of the heights that are not wrong.
    """
    x0, y0, x1, y1 = bounds
    spacing = max(_FINEST, max(x1 - x0, y1 - y0) / _MOST_SQUARES)
    size = math.ceil((x1 - x0) / spacing - 1e-9) + 1, math.ceil((y1 - y0) / spacing - 1e-9) + 1
    origin = (float(x0), float(y0))
    corners, of = shapely.get_coordinates(outlines, return_index=True)
    starts = np.searchsorted(of, np.arange(len(outlines)))
    places = shapely.get_coordinates(shapely.centroid(outlines))
    apart = _apart(places)
    # A plate of stiffness k through n heights a square metre follows what is longer than (k / n) ** (1/4).
    stiffness = max(_SHORTEST, _REACH * apart) ** 4 / apart**2
    fixed = _bending(size, spacing, stiffness) + _level_across(streets, origin, spacing, size)
    middle = float(np.median(heights))
    target = heights - middle
    scale, least = max(float(np.ptp(target)), _SURE), _SURE
    ground = np.zeros(size[0] * size[1])
    for step in range(_STEPS):
        here = _bilinear(places, origin, spacing, size)
        misfits = target - (here @ ground if step else 0.0)
        if step:
            least = max(_SURE, _DEVIATIONS * 1.4826 * float(np.median(np.abs(misfits))))
            scale = max(0.4 * scale, least)
        weights = (scale**2 / (scale**2 + misfits**2)) ** 2
        system = fixed + here.T @ diags(weights) @ here
        before, ground = ground, _solved(system, here.T @ (weights * target))
        # The lowest corner of each outline, by the ground as it is now.
        levels = _bilinear(corners, origin, spacing, size) @ ground
        order = np.lexsort((levels, of))
        places = corners[order[starts]]
        if scale == least and np.abs(ground - before).max() < _SETTLED:
            break
    misfits = target - _bilinear(places, origin, spacing, size) @ ground
    wrong = np.abs(misfits) > 2.0 * least
    sound = target[~wrong] if not wrong.all() else target
    ground = np.clip(ground, sound.min(), sound.max())
    terrain = Terrain(origin, spacing, ground.reshape(size[::-1]) + middle)
    return Fit(terrain, heights - terrain.at(places), wrong)


def _apart(places: NDArray[np.float64]) -> float:
    """Metres between places, as a square lattice of the density that half of them have around them would have."""
    distance, _ = cKDTree(places).query(places, k=min(_CROWD + 1, len(places)))
    distance = np.atleast_2d(distance.T).T[:, -1]
    neighbours = max(min(_CROWD, len(places) - 1), 1)
    return max(float(np.median(distance)) * math.sqrt(math.pi / neighbours), 1.0)


def _bending(size: tuple[int, int], spacing: float, stiffness: float) -> csc_matrix:
    """The quadratic form of a thin plate on a grid of ``size`` (columns, rows), with a slight pull to level ground."""
    columns, rows = size
    first = [diags([-1.0, 1.0], [0, 1], shape=(n - 1, n)) for n in size]
    second = [diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(max(n - 2, 0), n)) for n in size]
    one = [identity(n) for n in size]
    # Integrals over the squares: a second difference is h^2 of a derivative, over an area of h^2.
    bends = vstack([
        kron(one[1], second[0]),
        kron(second[1], one[0]),
        math.sqrt(2.0) * kron(first[1], first[0]),
    ])  # fmt: skip
    tilts = vstack([kron(one[1], first[0]), kron(first[1], one[0])])
    level = _LEVEL / max(columns, rows) ** 2
    return csc_matrix(stiffness / spacing**2 * (bends.T @ bends + level * (tilts.T @ tilts)))


def _level_across(
    streets: NDArray[np.object_], origin: tuple[float, float], spacing: float, size: tuple[int, int]
) -> csc_matrix:
    """The quadratic form of the differences between both edges of the streets."""
    lines = streets[shapely.length(streets) > _EVERY] if len(streets) else streets
    number = size[0] * size[1]
    if not len(lines):
        return csc_matrix((number, number))
    length = shapely.length(lines)
    count = np.floor(length / _EVERY).astype(np.int64)
    of = np.repeat(np.arange(len(lines)), count)
    along = (np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count) + 0.5) * (length / count)[of]
    before, after = (
        shapely.get_coordinates(shapely.line_interpolate_point(lines[of], along + shift)) for shift in (-1.0, 1.0)
    )
    ahead = after - before
    run = np.linalg.norm(ahead, axis=1)
    bound = np.array(origin) + spacing * (np.array(size) - 1)
    middle = 0.5 * (before + after)
    fine = (run > 1.0) & (middle > origin).all(axis=1) & (middle < bound).all(axis=1)
    middle = middle[fine]
    aside = _ASIDE * (ahead[fine] / run[fine][:, None])[:, ::-1] * (-1.0, 1.0)
    both = _bilinear(middle + aside, origin, spacing, size) - _bilinear(middle - aside, origin, spacing, size)
    return csc_matrix(_ACROSS * both.T @ both)


def _bilinear(
    places: NDArray[np.float64], origin: tuple[float, float], spacing: float, size: tuple[int, int]
) -> csr_matrix:
    """(n, columns * rows) what each point of the grid adds to the heights at ``places`` (n, 2)."""
    last = np.array(size) - 1
    place = np.clip((places - origin) / spacing, 0.0, last)
    corner = np.minimum(place.astype(np.int64), last - 1)
    (s, t), (i, j) = (place - corner).T, corner.T
    shares = np.stack([(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t], axis=1)
    node = (j * size[0] + i)[:, None] + np.array([0, 1, size[0], size[0] + 1])
    rows = np.repeat(np.arange(len(places)), 4)
    return csr_matrix((shares.ravel(), (rows, node.ravel())), shape=(len(places), size[0] * size[1]))


def _solved(system: csc_matrix, right: NDArray[np.float64]) -> NDArray[np.float64]:
    factors = splu(
        csc_matrix(system), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    return np.asarray(factors.solve(right), dtype=np.float64)
