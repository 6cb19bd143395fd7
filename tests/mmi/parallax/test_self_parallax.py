"""Self-parallax of objects of many walls: what is left out unseen does not change it, and it does not take for ever."""

import math
import time

import numpy as np
import pytest
import shapely
from cities import cell_along_x, city_of
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit
from solids import CELLS, SOLIDS, city_from

from mmi.city.model import CityObject, Prism
from mmi.parallax.ray_angles import RayViewpoints, angle_of, closest_to_level, on_ray, widest
from mmi.parallax.self_parallax import _ASIDE, _WITHIN, _along_wall, _where_edges_meet, self_parallax
from mmi.parallax.texels import texel_ratios
from mmi.visibility.horizon import horizon_visible, prepare_horizon
from mmi.visibility.visible_walls import visible_walls
from mmi.visibility.walls import walls_of

TEXEL = 1.0 / 443.0


@njit(cache=True, error_model="numpy")
def _every_pair(visible, texels):
    """The largest square of a chord over all walls, all rays and all pairs of hits of one object, with nothing left out."""
    a, b, viewers = visible.a, visible.b, visible.visible_from
    viewpoints = RayViewpoints(np.empty(viewers.shape[1]), np.empty(viewers.shape[1]), visible.rise)
    hits, walls = np.empty(len(a)), np.empty(len(a), dtype=np.int64)
    most = 0.0
    for w in range(len(a)):
        if not viewers[w].any():
            continue
        height = closest_to_level(visible.low[w], visible.top[w])
        most = max(most, _along_wall(a[w], b[w], height, texels[w], visible.viewpoints, viewers[w]))
        for ray in range(4 + len(_WITHIN)):
            t = 0.0 if ray < 2 else 1.0 if ray < 4 else _WITHIN[ray - 4]
            x, y = a[w, 0] + t * (b[w, 0] - a[w, 0]), a[w, 1] + t * (b[w, 1] - a[w, 1])
            turn = 0.0 if ray >= 4 else _ASIDE if ray % 2 else -_ASIDE
            x, y = x - turn * y, y + turn * x
            ux, uy = x / math.hypot(x, y), y / math.hypot(x, y)
            on_ray(ux, uy, visible.viewpoints, viewpoints)
            count = 0
            for i in range(len(a)):
                ca, cb = ux * a[i, 1] - uy * a[i, 0], ux * b[i, 1] - uy * b[i, 0]
                if (ca > 0.0) != (cb > 0.0):
                    s = ca / (ca - cb)
                    hit = ux * (a[i, 0] + s * (b[i, 0] - a[i, 0])) + uy * (a[i, 1] + s * (b[i, 1] - a[i, 1]))
                    if hit > 0.0:
                        hits[count], walls[count] = hit, i
                        count += 1
            for i in range(count):
                back, far = walls[i], hits[i]
                if not viewers[back].any():
                    continue
                if visible.open[back]:
                    level = visible.bottom[back] if visible.bottom[back] > -visible.rise else visible.top[back]
                    near = max(far - far * far * texels[back] / max(abs(level), 1e-6), hits[:count].min())
                    most = max(most, widest(near, far, level / far, level / far, viewpoints, viewers[back]))
                for j in range(count):
                    front, near = walls[j], hits[j]
                    facing = a[front, 0] * b[front, 1] - a[front, 1] * b[front, 0] < 0.0
                    low = max(visible.bottom[front] / near, visible.low[back] / far)
                    high = min(visible.top[front] / near, visible.top[back] / far)
                    if facing and near < far * (1.0 - 1e-6) and low <= high:
                        most = max(most, widest(near, far, low, high, viewpoints, viewers[back]))
    for front in range(len(a)):
        for back in range(len(a)):
            if a[front, 0] * b[front, 1] - a[front, 1] * b[front, 0] < 0.0 and viewers[back].any():
                top, bottom, low, high = visible.top[front], visible.bottom[front], visible.low[back], visible.top[back]
                most = _where_edges_meet(most, math.inf, front, back, top, low, visible, viewpoints)
                most = _where_edges_meet(most, math.inf, front, back, bottom, high, visible, viewpoints)
    return most


def with_nothing_left_out(city, cell, wall_visibility):
    walls = walls_of(city)
    parallax = []
    for i in range(len(city.objects)):
        visible = visible_walls(cell, walls, np.array([i]), wall_visibility)
        texels = TEXEL / texel_ratios(walls, walls.of(np.array([i])), cell)
        parallax.append(angle_of(_every_pair(visible, texels)))
    return np.array(parallax)


def star(points, x, y, outer=40.0, inner=30.0):
    """A prism of ``points`` walls around (x, y), every other corner farther in."""
    turn = np.linspace(0.0, 2.0 * math.pi, points, endpoint=False)
    r = np.where(np.arange(points) % 2, outer, inner)
    return Prism(shapely.Polygon(np.column_stack([x + r * np.cos(turn), y + r * np.sin(turn)])), 0.0, 12.0)


def in_one(city):
    """The city with all its objects made one."""
    return city_of(CityObject("all", tuple(prism for one in city.objects for prism in one.prisms)))


class TestAsWithNothingLeftOut:
    @settings(max_examples=40, deadline=None, derandomize=True)
    @given(st.lists(SOLIDS, min_size=2, max_size=12), CELLS, st.booleans())
    def test_of_solids_as_one_object(self, solids, cell, hidden):
        city = city_from(solids, cell, clearance=1.0)
        if city.objects:
            city = in_one(city)
            sight = horizon_visible(prepare_horizon(city), cell)[1] if hidden else None
            found = self_parallax(city, cell, walls_of(city), np.array([0]), sight, texel=TEXEL)
            assert found[0] == pytest.approx(with_nothing_left_out(city, cell, sight)[0], rel=1e-12, abs=1e-12)

    @settings(max_examples=30, deadline=None, derandomize=True)
    @given(st.integers(5, 60), st.floats(-math.pi, math.pi), st.floats(60.0, 150.0), CELLS)
    def test_of_a_star_in_any_direction(self, points, azimuth, distance, cell):
        """Also where azimuths run over from pi to -pi."""
        x, y = cell.reference[:2]
        star_there = star(2 * points, x + distance * math.cos(azimuth), y + distance * math.sin(azimuth))
        city = city_of(CityObject("star", (star_there,)))
        found = self_parallax(city, cell, walls_of(city), np.array([0]), None, texel=TEXEL)
        if found[0] < math.inf:
            assert found[0] == pytest.approx(with_nothing_left_out(city, cell, None)[0], rel=1e-12, abs=1e-12)

    @pytest.mark.parametrize("hidden", [False, True])
    def test_of_houses_all_around_the_cell(self, hidden):
        rng = np.random.default_rng(3)
        x, y = rng.uniform(-120.0, 120.0, (2, 60))
        away = np.abs(y) > 15.0
        prisms = [
            Prism(shapely.box(u, v, u + 8.0, v + 8.0), 0.0, h)
            for u, v, h in zip(x[away], y[away], rng.uniform(5.0, 30.0, away.sum()), strict=True)
        ]
        city, cell = city_of(CityObject("quarter", tuple(prisms))), cell_along_x(30.0, 3.0)
        sight = horizon_visible(prepare_horizon(city), cell)[1] if hidden else None
        found = self_parallax(city, cell, walls_of(city), np.array([0]), sight, texel=TEXEL)
        assert 0.1 < found[0] == pytest.approx(with_nothing_left_out(city, cell, sight)[0], rel=1e-12)


class TestTime:
    def test_of_two_thousand_walls(self):
        """With the cube of the walls it took more than a minute, 60 times as long."""
        city, cell = city_of(CityObject("star", (star(2000, 0.0, 100.0, 60.0, 45.0),))), cell_along_x(40.0)
        walls = walls_of(city)
        self_parallax(city, cell, walls, np.array([0])[:0], None, texel=TEXEL)  # compiles
        start = time.perf_counter()
        self_parallax(city, cell, walls, np.array([0]), None, texel=TEXEL)
        assert time.perf_counter() - start < 20.0
