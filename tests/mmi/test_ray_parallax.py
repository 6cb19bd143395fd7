"""What one ray's points part by, against a plain twin: rays from the reference, viewpoints all over the cell, angles in 3D."""

import math

import numpy as np
import pytest
import shapely
from cities import block, cell_along_x, city_of
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit
from oracles import viewpoints_within
from shapely.geometry import box
from solids import CELLS, SOLIDS, Solids, _cast, city_from, el, horseshoe

from mmi.cells import ViewingCell
from mmi.city import CityObject, Prism
from mmi.ray_parallax import same_ray_weights, self_parallax
from mmi.sectors import walls_of
from mmi.visibility import horizon_visible, prepare_horizon

QUAD = math.radians(1.0)


@njit(cache=True, error_model="numpy")
def _most(rays, slopes, walls, starts, prisms, eye, viewpoints, front_of, back_of, turn, hidden, ground):
    """The widest angle at a viewpoint between points of one ray, and what it is between.

    Rays start at ``eye`` (3,) and go towards ``rays`` (r, 2); of the slopes at which both walls can be met, both ends, the most
    level and ``slopes`` (k,) (shares of the way) count. Y is on a wall of object ``front_of`` that faces the eye; X is on a wall
    of ``back_of``, behind, on the ray turned by ``turn`` (2,) (azimuth, slope), faces the viewpoint and, with ``hidden``, is
    not hidden from it. The angle is between X and what of X's ray is as far away as Y.
    """
    most, between = 0.0, np.zeros(9)
    m, x = np.empty((1, 3)), np.empty((1, 3))
    count = len(slopes)
    for r in range(len(rays)):
        ux, uy = rays[r]
        vx, vy = ux * math.cos(turn[0]) - uy * math.sin(turn[0]), ux * math.sin(turn[0]) + uy * math.cos(turn[0])
        for f in range(len(walls)):
            if walls[f, 5] != front_of:
                continue
            ax, ay, bx, by = walls[f, 0] - eye[0], walls[f, 1] - eye[1], walls[f, 2] - eye[0], walls[f, 3] - eye[1]
            ca, cb = ux * ay - uy * ax, ux * by - uy * bx
            if (ca > 0.0) == (cb > 0.0) or ax * by - ay * bx >= 0.0:
                continue
            s = ca / (ca - cb)
            near = ux * (ax + s * (bx - ax)) + uy * (ay + s * (by - ay))
            if near <= 0.0:
                continue
            fp = int(walls[f, 4])
            f_low, f_high = (prisms[fp, 0] - eye[2]) / near, (prisms[fp, 1] - eye[2]) / near
            for b in range(len(walls)):
                if walls[b, 5] != back_of or b == f:
                    continue
                ax, ay, bx, by = walls[b, 0] - eye[0], walls[b, 1] - eye[1], walls[b, 2] - eye[0], walls[b, 3] - eye[1]
                ca, cb = vx * ay - vy * ax, vx * by - vy * bx
                if (ca > 0.0) == (cb > 0.0):
                    continue
                s = ca / (ca - cb)
                far = vx * (ax + s * (bx - ax)) + vy * (ay + s * (by - ay))
                if far <= near * (1.0 + 2e-6):
                    continue
                bp = int(walls[b, 4])
                low = max(f_low + turn[1], (prisms[bp, 0] - eye[2]) / far)
                high = min(f_high + turn[1], (prisms[bp, 1] - eye[2]) / far)
                if low > high:
                    continue
                for k in range(count + 3):
                    slope = low if k == 0 else high if k == 1 else min(max(0.0, low), high)
                    if k > 2:
                        slope = low + slopes[k - 3] * (high - low)
                    for v in range(len(viewpoints)):
                        mx, my, mz = viewpoints[v, 0] - eye[0], viewpoints[v, 1] - eye[1], viewpoints[v, 2] - eye[2]
                        if (ax - mx) * (by - ay) - (ay - my) * (bx - ax) >= 0.0:
                            continue
                        px, py, pz = vx * near - mx, vy * near - my, slope * near - mz
                        qx, qy, qz = vx * far - mx, vy * far - my, slope * far - mz
                        dot = px * qx + py * qy + pz * qz
                        cx, cy, cz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
                        angle = math.atan2(math.sqrt(cx * cx + cy * cy + cz * cz), dot)
                        if angle <= most:
                            continue
                        if hidden:
                            m[0], x[0, 0], x[0, 1], x[0, 2] = viewpoints[v], qx, qy, qz
                            t, _ = _cast(m, x, walls, starts, prisms, ground)
                            if t[0] < 1.0 - 1e-7:
                                continue
                        most = angle
                        between[0], between[1], between[2] = near, far, slope
                        between[3], between[4], between[5] = viewpoints[v]
                        between[6], between[7], between[8] = math.atan2(vy, vx), f, b
    return most, between


def rays_at(city, cell, objects, count, rng):
    """(k, 2) unit directions from the reference to points of the objects' walls, many just beside their ends."""
    solids = Solids(city)
    walls = solids.walls[np.isin(solids.walls[:, 5], objects)]
    ends = walls[:, :2] - cell.reference[:2]
    w = rng.integers(0, len(walls), count)
    inner = walls[w, :2] + rng.random((count, 1)) * (walls[w, 2:4] - walls[w, :2]) - cell.reference[:2]
    azimuth = np.concatenate(
        [np.arctan2(ends[:, 1], ends[:, 0]) + off for off in (-2e-7, 2e-7)] + [np.arctan2(inner[:, 1], inner[:, 0])]
    )
    return np.column_stack([np.cos(azimuth), np.sin(azimuth)])


def eyes(cell, rng, count=250):
    """Viewpoints: on the outline with its corners, and a few inside, in all of the eye band."""
    ring = shapely.linearrings(cell.corners)
    at = shapely.line_interpolate_point(ring, np.linspace(0.0, 1.0, count, endpoint=False), normalized=True)
    xy = np.concatenate([cell.corners, shapely.get_coordinates(at), viewpoints_within(cell, count // 3, rng)[:, :2]])
    z = rng.choice([cell.eye[0], cell.eye[1], 0.5 * sum(cell.eye)], len(xy))
    return np.column_stack([xy, z])


def most(city, cell, front, back, *, rng, hidden=False, turn=(0.0, 0.0), rays=40, level=False):
    """What the twin finds for X of ``back`` behind Y of ``front``; ``level``: viewpoints at the reference's height only."""
    solids, points = Solids(city), eyes(cell, rng)
    if level:
        points[:, 2] = cell.reference[2]
    return _most(
        rays_at(city, cell, [front, back], rays, rng),
        rng.random(2),
        solids.walls,
        solids.starts,
        solids.prisms,
        np.array(cell.reference),
        points,
        front,
        back,
        np.array(turn),
        hidden,
        city.ground,
    )
