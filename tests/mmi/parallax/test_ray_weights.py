"""What one ray's points part by, against a plain twin: rays from the reference, viewpoints all over the cell, angles in 3D."""

import math

import numpy as np
import pytest
import shapely
from cities import block, cell_along_x, city_of
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numba import njit
from oracles import viewpoints_within
from shapely.geometry import box
from solids import CELLS, SOLIDS, Solids, _cast, city_from, el, horseshoe

from mmi.cells.viewing_cells import ViewingCell
from mmi.city.model import CityObject, Prism
from mmi.parallax.ray_weights import same_ray_weights
from mmi.parallax.self_parallax import self_parallax
from mmi.visibility.horizon import horizon_visible, prepare_horizon
from mmi.visibility.walls import walls_of

QUAD = math.radians(1.0)


@njit(cache=True, error_model="numpy")
def _most(rays, slopes, walls, starts, prisms, eye, viewpoints, front_of, back_of, turn, hidden, ground):
    """The widest angle at a viewpoint between points of one ray, and what it is between.

    Rays start at ``eye`` (3,) and go towards ``rays`` (r, 2). Of the slopes at which both walls can be met, the ends, the most
    level and ``slopes`` (k,) (shares of the way) count. Y is on a wall of ``front_of`` that faces the eye. X is on one of
    ``back_of``, behind, on the ray turned by ``turn`` (2,) (azimuth, slope), faces the viewpoint and, with ``hidden``, is not
    hidden from it. The angle is between X and what of X's ray is as far away as Y.
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


def weights(city, cell, wall_visibility=None, *, quad=QUAD):
    """(n, n) symmetric: :func:`same_ray_weights` of all objects."""
    n = len(city.objects)
    pairs, found = same_ray_weights(cell, walls_of(city), np.arange(n), wall_visibility, quad=quad)
    table = np.zeros((n, n))
    table[pairs[:, 0], pairs[:, 1]] = found
    assert np.all(pairs[:, 0] < pairs[:, 1])
    return np.maximum(table, table.T)


def parallax(city, cell, wall_visibility=None, *, texel=0.0):
    return self_parallax(city, cell, walls_of(city), np.arange(len(city.objects)), wall_visibility, texel=texel)


def sight_of(city, cell):
    return horizon_visible(prepare_horizon(city), cell)[1]


def parted(near, far, viewpoints, *, azimuths, slopes=(0.0,)):
    """The closed form: the angle at (x, y) between the points ``near`` and ``far`` metres away (functions of the azimuth)."""
    found = 0.0
    for azimuth in azimuths:
        for slope in slopes:
            ray = np.array([math.cos(azimuth), math.sin(azimuth), slope])
            for x, y in viewpoints:
                p, q = near(azimuth) * ray - (x, y, 0.0), far(azimuth) * ray - (x, y, 0.0)
                found = max(found, math.atan2(np.linalg.norm(np.cross(p, q)), p @ q))
    return found


CLOSEST = 4.0
"""Metres from the cell: what is closer is always geometry."""
SLACK = 0.02
"""What the kernel may fall short by: its rays are a few a wall, and it takes distances at the reference's height for those at
any height of the eye band."""


SHORT = ViewingCell("0000-00", (-4.0, 0.0), (4.0, 0.0), 1.0, (1.5, 1.9))


class TestSafety:
    """Nothing that brute force finds exceeds the kernel's value."""

    @settings(max_examples=30, deadline=None, derandomize=True)
    @given(st.lists(SOLIDS, min_size=1, max_size=5), CELLS)
    def test_of_single_objects_seen_in_whole(self, solids, cell):
        city = city_from(solids, cell, clearance=CLOSEST)
        rng = np.random.default_rng(1)
        for i, value in enumerate(parallax(city, cell) if city.objects else []):
            found, between = most(city, cell, i, i, rng=rng)
            assert found <= (1.0 + SLACK) * value + 1e-6, between

    @settings(max_examples=30, deadline=None, derandomize=True)
    @given(st.lists(SOLIDS, min_size=1, max_size=6), CELLS)
    @example([("box", 2.0, 2.0, 0.0, 1.0, 10.0, 15.0, 0.0, 0)], SHORT)  # parts most at a slope of 0.5, from 0 to 1.2
    @example(  # parts most where the top of its front meets the foot of its back, between two rays
        [("box", 7.0, 9.0, 0.0, 52.0, 13.0, 1.0, 0.0, 0)],
        ViewingCell("0000-00", (-20.0, -0.0), (20.0, 0.0), 1.0, (1.5, 1.9)),
    )
    def test_of_single_objects_as_far_as_they_are_seen(self, solids, cell):
        city = city_from(solids, cell, clearance=CLOSEST)
        rng = np.random.default_rng(2)
        for i, value in enumerate(parallax(city, cell, sight_of(city, cell)) if city.objects else []):
            found, between = most(city, cell, i, i, rng=rng, hidden=True)
            assert found <= (1.0 + SLACK) * value + 1e-6, between

    @settings(max_examples=30, deadline=None, derandomize=True)
    @given(st.lists(SOLIDS, min_size=2, max_size=5), CELLS)
    def test_of_pairs_seen_in_whole(self, solids, cell):
        self.pairs(city_from(solids, cell, clearance=CLOSEST), cell, hidden=False)

    @settings(max_examples=30, deadline=None, derandomize=True)
    @given(st.lists(SOLIDS, min_size=2, max_size=6), CELLS)
    def test_of_pairs_as_far_as_they_are_seen(self, solids, cell):
        self.pairs(city_from(solids, cell, clearance=CLOSEST), cell, hidden=True)

    def pairs(self, city, cell, *, hidden):
        if len(city.objects) < 2:
            return
        rng = np.random.default_rng(3)
        table = weights(city, cell, sight_of(city, cell) if hidden else None)
        for i, j in np.argwhere(~np.eye(len(table), dtype=bool)):
            for turn in ((0.0, 0.0), tuple(rng.uniform(-0.98 * QUAD, 0.98 * QUAD, 2))):
                found, between = most(city, cell, i, j, rng=rng, hidden=hidden, turn=turn, rays=15)
                assert found <= (1.0 + SLACK) * table[i, j] + 1e-6, (i, j, turn, between)


class TestViewpoints:
    """The cell's corners are where parallax is largest; all four of them."""

    @pytest.mark.parametrize(
        ("east", "north", "with_sight"),
        [
            (1.0, 1.0, False),
            (-1.0, -1.0, False),
            (-1.0, 1.0, False),
            (1.0, -1.0, False),
            (1.0, 1.0, True),
            (-1.0, 1.0, True),
        ],
    )
    def test_a_box_hides_its_own_side(self, east, north, with_sight):
        (x0, x1), (y0, y1) = sorted((10.0 * east, -16.0 * east)), sorted((50.0 * north, 60.0 * north))
        city, cell = city_of(block("ahead", x0, y0, x1, y1, 12.0)), cell_along_x(30.0, 3.0)
        (value,) = parallax(city, cell, sight_of(city, cell) if with_sight else None)
        # From (15, 3), what is behind (10 * 50 / 60, 50) on its ray: the end of the side wall, (10, 60). Or mirrored.
        exact = math.atan2(15.0 - 10.0 * 50.0 / 60.0, 47.0) - math.atan2(5.0, 57.0)
        assert exact * (1.0 - 1e-6) <= value <= 1.01 * exact


class TestClosedForms:
    def test_a_box_that_is_as_wide_as_the_cell_shows_only_its_front(self):
        (value,) = parallax(city_of(block("wide", -21.0, 50.0, 21.0, 60.0, 12.0)), cell_along_x(40.0, 3.0))
        assert value == 0.0

    def test_a_box_off_to_the_side_hides_its_side(self):
        """Two sides face the cell, and neither hides anything that faces it; from the end of the cell a third one shows."""
        city = city_of(block("aside", 12.0, 30.0, 24.0, 44.0, 12.0))
        assert parallax(city, cell_along_x(20.0, 1.0)) == [0.0]
        (value,) = parallax(city, cell_along_x(100.0, 1.0))
        # Behind the front is the side at x = 24, up to (24, 44); it is seen from (x, 1).
        exact = max(
            math.atan2(x - 24.0 * 30.0 / 44.0, 29.0) - math.atan2(x - 24.0, 43.0) for x in np.linspace(24.0, 50.0, 300)
        )
        assert value == pytest.approx(exact, rel=0.02)

    def test_a_horseshoe_that_opens_towards_the_cell_shows_the_insides_of_its_arms(self):
        shape = shapely.affinity.translate(horseshoe(60.0, 10.0, 40.0, 5.0), -30.0, 40.0)
        city, cell = city_of(CityObject("u", (Prism(shape, 0.0, 20.0),))), cell_along_x(40.0, 3.0)
        (value,) = parallax(city, cell)
        # The right arm's front is at y = 40 from x = 25 to 30, its inside is at x = 25, from y = 40 to 80: all seen from C.
        # Behind the left part of its front lies nothing that faces the cell: walls outside face away from it.
        assert value == 0.0
        found, between = most(city, cell, 0, 0, rng=np.random.default_rng(0), rays=400)
        assert found == 0.0, between
        # From the reference at (20, 0) the left arm hides nothing, the right one the right part of the bar and of its inside.
        moved = ViewingCell("0000-00", (20.0, 0.0), (60.0, 0.0), 3.0, (1.5, 1.9))
        (value,) = parallax(city, moved)
        found, between = most(city, moved, 0, 0, rng=np.random.default_rng(0), rays=400)
        assert found > 0.0
        assert found * (1.0 - SLACK) <= value <= 1.05 * found, between

    def test_an_el_hides_part_of_its_inner_corner(self):
        shape = shapely.affinity.translate(el(40.0, 12.0, 15.0, 20.0), 5.0, 40.0)
        city, cell = city_of(CityObject("l", (Prism(shape, 0.0, 20.0),))), cell_along_x(40.0, 3.0)
        (value,) = parallax(city, cell)
        found, between = most(city, cell, 0, 0, rng=np.random.default_rng(0), rays=400)
        assert found > 0.0
        assert found * (1.0 - SLACK) <= value <= 1.05 * found, between

    @pytest.mark.parametrize("half_width", [0.2, 3.0])
    def test_walking_towards_a_tower_on_a_podium_parts_them_vertically(self, half_width):
        podium, tower = Prism(box(50, -10, 70, 10), 0.0, 30.0), Prism(box(70, -10, 90, 10), 0.0, 90.0)
        city, cell = city_of(CityObject("both", (podium, tower))), cell_along_x(20.0, half_width)
        (value,) = parallax(city, cell)
        azimuths = np.linspace(0.0, math.atan(10.0 / 70.0), 20)
        exact = parted(
            lambda azimuth: 50.0 / math.cos(azimuth),
            lambda azimuth: 70.0 / math.cos(azimuth),
            [(10.0, half_width), (10.0, -half_width), (-10.0, half_width)],
            azimuths=azimuths,
            slopes=(0.0, (30.0 - 1.7) / 50.0),
        )
        assert exact * 0.99 <= value <= 1.06 * exact

    @pytest.mark.parametrize("side", [-1.0, 1.0])
    def test_a_wall_behind_another_straight_ahead(self, side):
        low, high = sorted((side * 50.0, side * 52.0))
        far = sorted((side * 100.0, side * 102.0))
        city = city_of(block("front", low, -20.0, high, 20.0, 9.0), block("back", far[0], -40.0, far[1], 40.0, 40.0))
        cell = cell_along_x(20.0, 3.0)
        exact = parted(
            lambda azimuth: 50.0 / math.cos(azimuth),
            lambda azimuth: 100.0 / math.cos(azimuth),
            [(10.0, -3.0), (10.0, 3.0), (-10.0, 3.0)],
            azimuths=np.linspace(0.0, math.atan(0.4), 50),
        )
        assert 0.98 * exact <= weights(city, cell, quad=math.radians(0.1))[0, 1] <= 1.05 * exact

    def test_a_wall_behind_another_aside(self):
        city = city_of(block("front", -3.0, 30.0, 3.0, 31.0, 9.0), block("back", -6.0, 60.0, 6.0, 61.0, 9.0))
        cell = cell_along_x(40.0, 3.0)
        exact = parted(
            lambda azimuth: 30.0 / math.sin(azimuth),
            lambda azimuth: 60.0 / math.sin(azimuth),
            cell.corners,
            azimuths=np.linspace(math.atan2(30.0, 3.0), math.atan2(30.0, -3.0), 50),
        )
        assert 0.98 * exact <= weights(city, cell, quad=math.radians(0.1))[0, 1] <= 1.05 * exact

    def test_nothing_parts_where_the_viewer_cannot_leave_the_reference(self):
        cell = ViewingCell("0000-00", (-0.01, 0.0), (0.01, 0.0), 0.01, (1.7, 1.7))
        assert weights(city_of(block("a", -3, 30, 3, 31, 9), block("b", -6, 60, 6, 61, 9)), cell)[0, 1] < 1e-3


class TestRowHouses:
    CELL = cell_along_x(30.0, 3.0)

    def row(self, left, right):
        return city_of(block("left", 10.0, 30.0, 20.0, 40.0, left), block("right", 20.0, 30.0, 30.0, 40.0, right))

    def test_of_equal_height_their_wall_weighs_no_more_than_what_shrunken_occluders_leave_of_it(self):
        city = self.row(12.0, 12.0)
        value = weights(city, self.CELL, sight_of(city, self.CELL), quad=math.radians(0.25))[0, 1]
        left = 1.5 + 0.05  # metres of the wall, seen at 30 m from 5 m off its plane or more
        assert value < left * 20.0 / (27.0**2 + 20.0**2)
        assert most(city, self.CELL, 0, 1, rng=np.random.default_rng(0), hidden=True)[0] == 0.0

    def test_above_a_lower_one_the_wall_of_the_higher_shows(self):
        city = self.row(12.0, 25.0)
        value = weights(city, self.CELL, sight_of(city, self.CELL), quad=math.radians(0.25))[0, 1]
        found, between = most(city, self.CELL, 0, 1, rng=np.random.default_rng(0), hidden=True, rays=200)
        assert found > 0.01
        assert (1.0 - SLACK) * found <= value < 1.6 * found, between

    def test_without_sight_a_party_wall_counts_in_whole(self):
        assert weights(self.row(12.0, 12.0), self.CELL)[0, 1] > 0.05


class TestEdgeOn:
    """A wall that lies along a ray runs through many depths within a texel: as wide as that seen from elsewhere in the cell."""

    @pytest.mark.parametrize("off", [0.0, 0.01, 0.05])
    def test_it_weighs_what_it_spans_within_a_texel(self, off):
        city, cell = city_of(block("house", -40.0, -90.0, -off, -50.0, 14.0)), cell_along_x(40.0, 3.0)
        exact = math.atan2(20.0, 47.0) - math.atan2(20.0, 87.0)
        assert parallax(city, cell, texel=1.0 / 443.0)[0] > 0.5 * exact


class TestWallsWithoutLength:
    def test_they_add_nothing(self):
        """Corners that differ by rounding alone are one as seen from a reference that is far from the origin."""
        corner = np.nextafter(80.0, 81.0)
        once = [(60.0, 40.0), (80.0, 40.0), (80.0, 60.0), (60.0, 60.0)]
        twice = [(60.0, 40.0), (80.0, 40.0), (80.0, 60.0), (corner, 60.0), (corner, 60.0 + 1e-14), (60.0, 60.0)]
        cell = ViewingCell("0000-00", (-1020.0, 0.0), (-980.0, 0.0), 3.0, (1.5, 1.9))
        values = []
        for ring in (once, twice):
            city = city_of(CityObject("house", (Prism(shapely.Polygon(ring), 0.0, 12.0),)))
            walls = walls_of(city)
            lengths = np.hypot(*((walls.b - cell.reference[:2]) - (walls.a - cell.reference[:2])).T)
            assert (lengths > 0.0).all() == (ring is once)
            values.append(parallax(city, cell, texel=1.0 / 443.0)[0])
        assert values[1] == pytest.approx(values[0], rel=1e-9)


class TestDownwards:
    """Looking down, the steepest of the rays that meet both go down."""

    def test_close_to_the_end_of_the_cell(self):
        """10 % too little: what stands 4 m from the end of the cell, at its foot."""
        shape = shapely.affinity.translate(el(2.0, 0.8, 0.8, 1.2), 8.225, -1.225)
        city, cell = city_of(CityObject("l", (Prism(shape, 0.0, 2.5),))), cell_along_x(8.0, 1.0)
        found, between = most(city, cell, 0, 0, rng=np.random.default_rng(1))
        assert found <= (1.0 + SLACK) * parallax(city, cell)[0], between

    def test_from_a_drone_walking_towards_what_lies_below_parts_it_too(self):
        """From 40 m up: 0.49 degrees for 2.6."""
        city = city_of(block("mast", 50.0, -1.0, 52.0, 1.0, 38.0), block("wall", 100.0, -40.0, 102.0, 40.0, 38.0))
        cell = ViewingCell("0000-00", (-10.0, 0.0), (10.0, 0.0), 0.3, (40.0, 40.0))
        found, between = most(city, cell, 0, 1, rng=np.random.default_rng(0), hidden=True, rays=200)
        assert found > math.radians(1.0)
        assert found <= (1.0 + SLACK) * weights(city, cell, quad=math.radians(0.2))[0, 1], between


class TestWhatCounts:
    def test_what_meets_the_cell_is_infinite(self):
        city = city_of(block("beside", -5, 3, 5, 8, 9), block("in", 0, -1, 1, 1, 9), block("far", -5, 40, 5, 50, 9))
        inside, touching, far = parallax(city, cell_along_x(20.0, 3.0))[[1, 0, 2]]
        assert inside == touching == math.inf
        assert far < math.inf

    def test_walls_that_nobody_sees_count_for_nothing(self):
        city, cell = city_of(block("a", -10, 50, 10, 60, 12), block("b", -20, 90, 20, 99, 30)), cell_along_x(40.0, 3.0)
        wall_visibility = sight_of(city, cell)
        assert (parallax(city, cell) > 0.0).any()
        hidden = type(wall_visibility)(
            np.full_like(wall_visibility.lowest, np.inf), np.zeros_like(wall_visibility.bits), wall_visibility.bins
        )
        assert not parallax(city, cell, hidden).any()
        assert not weights(city, cell, hidden).any()

    def test_a_courtyard_behind_a_wall_counts_for_nothing(self):
        yard = shapely.affinity.translate(horseshoe(40.0, 10.0, 30.0, 10.0), 20.0, 40.0)
        yard = CityObject("yard", (Prism(yard, 0.0, 10.0),))
        screen, cell = block("screen", -200.0, 20.0, 200.0, 30.0, 30.0), cell_along_x(40.0, 3.0)
        assert parallax(city_of(yard), cell) > 0.0
        city = city_of(yard, screen)
        assert parallax(city, cell, sight_of(city, cell))[0] == 0.0
        assert not weights(city, cell, sight_of(city, cell)).any()

    @pytest.mark.parametrize("gap", [4.0, 20.0])
    def test_pairs_that_share_no_ray_and_are_farther_apart_than_a_quad_are_not_listed(self, gap):
        # 1 degree is 1.05 m at 60 m; a column and its neighbours are two degrees at most.
        city = city_of(block("a", -10.0, 60.0, 0.0, 70.0, 9.0), block("b", 2.0 * gap, 120.0, 50.0, 130.0, 9.0))
        assert not weights(city, cell_along_x(40.0, 3.0)).any()

    def test_pairs_within_a_quad_are_listed(self):
        city = city_of(block("a", -10.0, 60.0, 0.0, 70.0, 9.0), block("b", 1.0, 120.0, 50.0, 130.0, 9.0))
        assert weights(city, cell_along_x(40.0, 3.0))[0, 1] > 0.1

    def test_what_lies_above_the_other_by_more_than_a_quad_is_not_listed(self):
        def above(bottom):
            return city_of(block("low", -10, 60, 10, 70, 6.0), block("up", -10, 100, 10, 110, 60.0, bottom=bottom))

        edge = 1.7 + 4.3 / 60.0 * 100.0
        cell = cell_along_x(40.0, 3.0)
        assert weights(above(edge - 1.0), cell)[0, 1] > 0.1
        assert weights(above(edge + 0.5 * QUAD * 100.0), cell)[0, 1] > 0.1
        # Both are wider by a quad, and the underside reaches to the back wall.
        assert weights(above(1.7 + (4.3 / 60.0 + 2.3 * QUAD) * 110.0), cell)[0, 1] == 0.0

    def test_the_order_of_objects_does_not_matter(self):
        a, b = block("a", -10.0, 60.0, 0.0, 70.0, 9.0), block("b", -20.0, 120.0, 50.0, 130.0, 19.0)
        cell = cell_along_x(40.0, 3.0)
        assert weights(city_of(a, b), cell)[0, 1] == weights(city_of(b, a), cell)[0, 1] > 0.0
