"""The grid lists each triangle in the cells that it has a part in, and a walk passes the cells that its ray passes."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from soups import random_directions, random_soup, soup_mesh

from mmi.rays.brute_force import brute_force
from mmi.rays.grid import build_grid
from mmi.rays.grid_caster import grid_caster


def clipped(polygon, low, high):
    """The part of a polygon (n, 3) in a box, by Sutherland and Hodgman; empty if there is none."""
    for axis in range(3):
        for sign, limit in ((1.0, high[axis]), (-1.0, -low[axis])):
            inside = limit - sign * polygon[:, axis]
            points = []
            for k in range(len(polygon)):
                a, b = inside[k - 1], inside[k]
                if (a >= 0.0) != (b >= 0.0):
                    points.append(polygon[k - 1] + a / (a - b) * (polygon[k] - polygon[k - 1]))
                if b >= 0.0:
                    points.append(polygon[k])
            polygon = np.array(points).reshape(-1, 3)
            if not len(polygon):
                return polygon
    return polygon


def cells_with_a_part(grid, triangle, slack):
    """Numbers of the cells, enlarged by a share ``slack`` on each side, that a triangle (3, 3) has a part in."""
    found = set()
    for x, y, z in np.ndindex(*grid.size):
        low = grid.low + (np.array([x, y, z]) - slack) * grid.cell
        if len(clipped(triangle, low, low + (1.0 + 2.0 * slack) * grid.cell)):
            found.add((x * grid.size[1] + y) * grid.size[2] + z)
    return found


@pytest.mark.parametrize("seed", range(4))
def test_triangles_are_listed_in_the_cells_that_they_pass(seed):
    rng = np.random.default_rng(seed)
    soup = random_soup(rng, 25, size=(0.3, 1.0, 3.0, 8.0)[seed]).astype(np.float32)
    grid = build_grid(soup.reshape(-1, 9), cells_a_triangle=6.0)
    listed = [set() for _ in soup]
    for c in range(len(grid.starts) - 1):
        for i in grid.entries[grid.starts[c] : grid.starts[c + 1]]:
            listed[i].add(c)
    for i, triangle in enumerate(soup.astype(np.float64)):
        assert cells_with_a_part(grid, triangle, 0.0) <= listed[i] <= cells_with_a_part(grid, triangle, 2e-3)


def test_cells_list_the_first_drawn_first():
    grid = build_grid(random_soup(np.random.default_rng(0), 200).astype(np.float32).reshape(-1, 9))
    for c in range(len(grid.starts) - 1):
        assert (np.diff(grid.entries[grid.starts[c] : grid.starts[c + 1]]) > 0).all()


@pytest.mark.parametrize("count", [1, 10, 1000, 20_000])
def test_there_are_about_as_many_cells_as_asked_for(count):
    soup = random_soup(np.random.default_rng(1), count, size=0.01).astype(np.float32).reshape(-1, 9)
    cells = len(build_grid(soup, cells_a_triangle=2.0).starts) - 1
    assert cells <= 2 * count
    assert count < 100 or cells > count


def test_long_triangles_make_the_grid_coarser():
    soup = np.random.default_rng(1).uniform(-100.0, 100.0, (3000, 9)).astype(np.float32)
    grid = build_grid(soup)
    assert len(grid.entries) <= 20 * len(soup)


def test_a_flat_city_has_one_layer_of_cells():
    soup = random_soup(np.random.default_rng(1), 500, size=1.0, spread=(100.0, 100.0, 0.0)).astype(np.float32)
    soup[..., 2] = 4.0
    assert build_grid(soup.reshape(-1, 9)).size[2] == 1


def test_triangles_without_area_are_in_no_cell():
    soup = np.array([[0, 0, 0, 1, 1, 1, 2, 2, 2], [3, 3, 3, 3, 3, 3, 3, 3, 3]], dtype=np.float32)
    assert len(build_grid(soup).entries) == 0


def plain_walk(grid, mesh, origin, direction, nearest):
    """The walk of Amanatides and Woo in plain words: (triangle, cells passed)."""
    high = grid.low + grid.cell * grid.size
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = np.stack([(grid.low - origin) / direction, (high - origin) / direction])
    enter = max(nearest, np.nanmax(np.where(direction == 0.0, -np.inf, sides.min(axis=0))))
    if enter > np.nanmin(np.where(direction == 0.0, np.inf, sides.max(axis=0))):
        return -1, []
    cell = [
        min(max(math.floor((origin[k] + enter * direction[k] - grid.low[k]) / grid.cell), 0), grid.size[k] - 1)
        for k in range(3)
    ]
    best, hit, passed = math.inf, -1, []
    while all(0 <= cell[k] < grid.size[k] for k in range(3)):
        passed.append((cell[0] * grid.size[1] + cell[1]) * grid.size[2] + cell[2])
        inside = grid.entries[grid.starts[passed[-1]] : grid.starts[passed[-1] + 1]]
        if len(inside):
            corners = mesh.positions[mesh.triangles[inside]]
            found = brute_force(soup_mesh(corners)).first_hits(origin, direction[None], nearest=nearest)
            if found.distance[0] < best:
                best, hit = found.distance[0], inside[found.triangle[0]]
        leave = [
            (grid.low[k] + (cell[k] + (direction[k] > 0.0)) * grid.cell - origin[k]) / direction[k]
            if direction[k] != 0.0
            else math.inf
            for k in range(3)
        ]
        axis = leave.index(min(leave))
        if best <= leave[axis]:
            break
        cell[axis] += 1 if direction[axis] > 0.0 else -1
    return hit, passed


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from([0.0, 2.0, 6.0]))
def test_the_walk_is_that_of_amanatides_and_woo(seed, nearest):
    rng = np.random.default_rng(seed)
    mesh = soup_mesh(random_soup(rng, 60))
    caster = grid_caster(mesh, workers=1)
    origins, directions = rng.uniform(-4.0, 14.0, (20, 3)), random_directions(rng, 20)
    hits = caster.first_hits(origins, directions, nearest=nearest)
    for origin, direction, found in zip(origins, directions, hits.triangle, strict=True):
        hit, passed = plain_walk(caster.grid, mesh, origin, direction, nearest)
        assert hit == found
        boxes = np.stack(np.unravel_index(np.array(passed, dtype=int), tuple(caster.grid.size)), axis=1)
        assert len(set(passed)) == len(passed)
        assert (np.abs(np.diff(boxes, axis=0)).sum(axis=1) == 1).all()
