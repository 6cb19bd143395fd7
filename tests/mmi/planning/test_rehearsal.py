"""What layers will be found to miss, against rays cast at the same prisms by brute force."""

import math

import numpy as np
import pytest
import shapely
from cities import block, cell_along_x, city_of
from solids import Solids, city_from, solids_from

from mmi.cells.viewing_cells import ViewingCell
from mmi.foundation.thickness import thickness
from mmi.planning.rehearsal import rehearse
from mmi.visibility.selection import WallVisibility
from mmi.visibility.visible_walls import around
from mmi.visibility.walls import walls_of

PIXEL = 0.011
BINS = 32
SEEN = 0b1 | 1 << 9 | 1 << 16 | 1 << 25
"""The bins of viewpoints that count: fewer for the sake of time."""
CELL = cell_along_x(40.0, 3.0)


def rehearsed(city, layers, limit, cell=CELL, pixel=PIXEL):
    walls = walls_of(city)
    everything = np.full(len(walls.a), -np.inf), np.full(len(walls.a), SEEN, dtype=np.uint64)
    wall_visibility = WallVisibility(*everything, BINS)
    return rehearse(
        cell, walls, np.arange(len(city.objects)), layers, wall_visibility, pixel=(pixel, pixel), limit=limit
    )


def walls_under(city, points, owners):
    """(n,) which wall of its owner each point is on, counted over the city."""
    found = np.full(len(points), -1)
    count = 0
    for i, one in enumerate(city.objects):
        edges = np.concatenate(
            [
                np.stack([ring[:-1], ring[1:]], axis=1)
                for ring in (np.array(p.footprint.exterior.coords) for p in one.prisms)
            ]
        )
        mine = np.flatnonzero(owners == i)
        away = shapely.distance(shapely.linestrings(edges)[:, None], shapely.points(points[mine, :2])[None])
        found[mine] = count + np.argmin(away, axis=0)
        count += len(edges)
    return found


def behind(city, members, eye, columns):
    """(w,) the walls of a layer that are not in front of all others on all rays from the eye, or show it their inside."""
    walls = walls_of(city)
    a, b = walls.a - eye, walls.b - eye
    azimuth = (np.arange(columns)[:, None] + 0.5) * 2.0 * math.pi / columns
    rays = np.cos(azimuth), np.sin(azimuth)
    side_a, side_b = (rays[0] * end[:, 1] - rays[1] * end[:, 0] for end in (a, b))
    with np.errstate(divide="ignore", invalid="ignore"):
        s = side_a / (side_a - side_b)
        along = rays[0] * (a[:, 0] + s * (b - a)[:, 0]) + rays[1] * (a[:, 1] + s * (b - a)[:, 1])
    distance = np.where(((side_a > 0.0) != (side_b > 0.0)) & (along > 0.0), along, np.inf)
    distance[:, ~np.isin(np.repeat(np.arange(len(city.objects)), np.diff(walls.first)), members)] = np.inf
    covered = ((distance > distance.min(axis=1, keepdims=True)) & np.isfinite(distance)).any(axis=0)
    inside = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] >= 0.0
    return covered | inside | ~np.isfinite(distance).any(axis=0)


def missed(city, cell, layers, viewpoint, pixel=PIXEL):
    """(columns, rows) bool: what layers miss from a viewpoint (2,) relative to the reference; rows of equal slope."""
    columns = math.ceil(2.0 * math.pi / pixel)
    turn = 2.0 * math.pi / columns
    azimuth, slope = np.meshgrid((np.arange(columns) + 0.5) * turn, (np.arange(-20, 150) + 0.5) * pixel, indexing="ij")
    rays = np.stack([np.cos(azimuth), np.sin(azimuth), slope], axis=-1).reshape(-1, 3)
    eye = np.array(cell.reference)
    from_m = eye + np.array([*viewpoint, 0.0])
    far, owner = Solids(city).cast(np.broadcast_to(from_m, rays.shape), rays)
    layer_of = np.full(len(city.objects), -1)
    for i, members in enumerate(layers):
        layer_of[members] = i
    lost = np.zeros(len(rays), dtype=bool)
    for i, members in enumerate(layers):
        index = np.flatnonzero((owner >= 0) & (layer_of[owner] == i))
        points = from_m + far[index, None] * rays[index]
        offsets = points - eye
        texel = (np.floor(np.arctan2(offsets[:, 1], offsets[:, 0]) / turn) + 0.5) * turn
        there = np.stack(
            [np.cos(texel), np.sin(texel), offsets[:, 2] / np.hypot(offsets[:, 0], offsets[:, 1])], axis=-1
        )
        reach, hit = Solids(city, members).cast(np.broadcast_to(eye, there.shape), there)
        met = hit == owner[index]
        shown = eye + np.where(met, reach, 1.0)[:, None] * there - from_m
        apart = np.arctan2(shown[:, 1], shown[:, 0]) - np.arctan2(rays[index, 1], rays[index, 0])
        close = np.abs((apart + math.pi) % (2.0 * math.pi) - math.pi) <= turn
        close &= np.abs(shown[:, 2] / np.hypot(shown[:, 0], shown[:, 1]) - rays[index, 2]) <= pixel
        wall = walls_under(city, points, owner[index])
        same = wall == walls_under(city, shown + from_m, np.where(met, hit, -1))
        lost[index] = behind(city, members, eye[:2], columns)[wall] & ~(met & (close | same))
    return lost.reshape(azimuth.shape)


def across_the_seam(region):
    """The region with the seam of the panorama where nothing is missed."""
    free = np.flatnonzero(~region.any(axis=1))
    return np.roll(region, -int(free[0]), axis=0)


def viewpoints_of(cell):
    """Where walls may be seen from, metres from the reference: two viewpoints in each bin and one where it ends."""
    points = around(cell.corners - np.array(cell.reference[:2]), 2 * BINS)
    return [points[(2 * i + k) % len(points)] for i in range(BINS) if SEEN >> i & 1 for k in range(3)]


def thickest(city, cell, layers, pixel=PIXEL):
    return max(
        thickness(across_the_seam(missed(city, cell, layers, viewpoint, pixel))) for viewpoint in viewpoints_of(cell)
    )


def tall(seed):
    """A random city of prisms whose roofs nobody sees."""
    solids = [
        (*one[:6], min(max(one[6], 6.0), 25.0), 0.0, one[8]) for one in solids_from(np.random.default_rng(seed), 12)
    ]
    return city_from(solids, CELL, clearance=16.0)


@pytest.mark.parametrize("seed", range(6))
def test_what_is_missed_is_what_rays_tell(seed):
    city = tall(seed)
    far = np.arange(len(city.objects))
    layers = (far,) if seed % 2 else (far[::2], far[1::2])
    true = thickest(city, CELL, layers)
    assert true > 2.0
    found = rehearsed(city, layers, 1.2 * true)
    assert found.demoted.size == 0 and found.thickness == true
    found = rehearsed(city, layers, 0.9 * true)
    assert found.demoted.size and found.thickness <= 0.9 * true
    left = tuple(np.setdiff1d(layer, found.demoted) for layer in layers)
    assert thickest(city, CELL, left) <= 0.9 * true


def facing_away(count=8, wide=4.0):
    """A row of narrow houses down the street, their common front just out of sight of the middle of the cell."""
    # The fronts lie on a line that passes the middle of the cell, (0, -4), on their far side.
    houses = [
        block(f"house/{i}", 60.0 + wide * i, -6.0, 60.0 + wide * (i + 1), 2.0 + i % 2, 9.0 + i % 3)
        for i in range(count)
    ]
    return city_of(*houses)


def test_narrow_strips_side_by_side_are_one_region():
    city = facing_away()
    cell = ViewingCell("0000-00", (-20.0, -4.0), (20.0, -4.0), 6.0, (1.5, 1.9))
    layers = (np.arange(len(city.objects)),)
    pixel = 0.002
    whole = thickest(city, cell, layers, pixel)
    single = max(
        thickness(across_the_seam(missed(city_of(one), cell, (np.array([0]),), viewpoint, pixel)))
        for one in city.objects
        for viewpoint in viewpoints_of(cell)
    )
    assert whole > 1.5 * single
    found = rehearsed(city, layers, 1.1 * single, cell, pixel)
    assert 0 < found.demoted.size < len(city.objects)
    assert thickest(city, cell, (np.setdiff1d(layers[0], found.demoted),), pixel) <= 1.1 * single


def test_nothing_is_demoted_where_nothing_is_missed():
    city = city_of(block("house", 40.0, -5.0, 50.0, 5.0, 10.0))
    found = rehearsed(city, (np.array([0]),), 3.0)
    assert found.demoted.size == 0 and found.thickness <= 3.0


def test_no_layers_miss_nothing():
    city = city_of(block("house", 40.0, -5.0, 50.0, 5.0, 10.0))
    assert rehearsed(city, (), 3.0).demoted.size == 0
    nobody = rehearse(CELL, walls_of(city), np.empty(0, dtype=np.int64), (), None, pixel=(PIXEL, PIXEL), limit=3.0)
    assert nobody.demoted.size == 0


def test_a_region_across_the_seam_of_the_panorama_is_whole():
    houses = [block(f"{i}", 60.0, -20.0 + 5.0 * i, 66.0, -15.0 + 5.0 * i, 12.0) for i in range(8)]
    city = city_of(block("screen", 40.0, -9.0, 40.1, 2.5, 12.0), *houses)
    layers = (np.arange(len(city.objects)),)
    region = missed(city, CELL, layers, CELL.corners[2])
    assert region[0].any() and region[-1].any()
    true = thickest(city, CELL, layers)
    assert rehearsed(city, layers, 1.2 * true).thickness == true
