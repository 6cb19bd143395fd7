"""What the horizon sweep says about walls (``WallVisibility``) against rays: what a ray sees is above the lowest and in a
bin.
"""

import math

import numpy as np
import pytest
import shapely
from cities import block, cell_along_x, city_of, crossroads
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import viewpoints_within
from solids import CELLS, SOLIDS, Solids, city_from

from mmi.visibility.horizon import horizon_visible, prepare_horizon
from mmi.visibility.horizon_sweep import BINS
from mmi.visibility.walls import walls_of


def sights(city, cell, *, count, rng):
    """Random visible points of walls: points X (n, 3), their walls (n,), and viewpoints M (n, 3) that see them."""
    solids = Solids(city)
    w = rng.integers(0, len(solids.walls), count)
    ax, ay, bx, by = solids.walls[w, :4].T
    bottom, top = solids.prisms[solids.walls[w, 4].astype(int), :2].T
    t = np.where(rng.random(count) < 0.3, rng.choice([1e-4, 1.0 - 1e-4], count), rng.random(count))
    # Many low: there it is decided what the lowest is.
    z = bottom + (top - bottom) * np.where(rng.random(count) < 0.5, rng.random(count) ** 3, rng.random(count))
    x = np.column_stack([ax + t * (bx - ax), ay + t * (by - ay), z])
    m = viewpoints_within(cell, count, rng)
    outline = rng.random(count) < 0.5
    ring = shapely.linearrings(cell.corners)
    at = shapely.line_interpolate_point(ring, rng.random(count), normalized=True)
    m[outline, :2] = shapely.get_coordinates(at)[outline]
    m[rng.random(count) < 0.3, 2] = cell.eye[1]
    facing = (ax - m[:, 0]) * (by - ay) - (ay - m[:, 1]) * (bx - ax) < -1e-6
    seen = facing & solids.clear(m, x)
    return x[seen], w[seen], m[seen]


def behind(cell, x, m):
    """(n,) in [0, 1): where on the outline the lines from ``x`` through ``m`` leave the cell's rectangle behind ``m``."""
    corners = cell.corners
    along, across = corners[1] - corners[0], corners[2] - corners[1]
    long, wide = np.hypot(*along), np.hypot(*across)
    axes = np.array([along / long, across / wide])
    p, d = (m[:, :2] - corners[0]) @ axes.T, (m[:, :2] - x[:, :2]) @ axes.T
    size = np.array([long, wide])
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(d > 0.0, (size - p) / d, np.where(d < 0.0, -p / d, np.inf))
    t = np.maximum(t.min(axis=1), 0.0)
    q = np.clip(p + t[:, None] * d, 0.0, size)
    leaves = np.argmin(np.stack([q[:, 1], long - q[:, 0], wide - q[:, 1], q[:, 0]]), axis=0)
    at = np.choose(leaves, [q[:, 0], long + q[:, 1], long + wide + long - q[:, 0], 2.0 * long + wide + wide - q[:, 1]])
    return (at / (2.0 * (long + wide))) % 1.0


def check(city, cell, *, count, seed, **options):
    visible, wall_visibility = horizon_visible(prepare_horizon(city, **options), cell)
    x, w, m = sights(city, cell, count=count, rng=np.random.default_rng(seed))
    owners = Solids(city).walls[w, 5].astype(int)
    assert np.isin(owners, visible).all()
    too_low = wall_visibility.lowest[w] - x[:, 2]
    worst = int(np.argmax(too_low)) if len(w) else 0
    assert not len(w) or too_low[worst] <= 1e-6, (
        f"wall {w[worst]} of {owners[worst]}: {x[worst]} is seen from {m[worst]}, lowest is {wall_visibility.lowest[w[worst]]}"
    )
    place = np.floor(behind(cell, x, m) * wall_visibility.bins).astype(int)
    bits = wall_visibility.bits[w]
    found = np.zeros(len(w), dtype=bool)
    # Where there are more viewpoints than bins, a viewpoint's stretch of the outline reaches into the next bin.
    for step in (0,) if wall_visibility.bins < BINS else (-1, 0, 1):
        found |= (bits >> ((place + step) % wall_visibility.bins).astype(np.uint64)) & np.uint64(1) == 1
    missed = np.flatnonzero(~found)
    assert not len(missed), (
        f"{len(missed)} of {len(w)}; wall {w[missed[0]]}: {x[missed[0]]} is seen from {m[missed[0]]}, "
        f"bin {place[missed[0]]} of {wall_visibility.bins}, bits {int(bits[missed[0]]):b}"
    )
    return wall_visibility, len(w)


@settings(max_examples=120, deadline=None)
@given(
    st.lists(SOLIDS, min_size=1, max_size=10), CELLS, st.sampled_from([0.5, 1.5, 3.0]), st.sampled_from([64, 512, 2048])
)
def test_no_ray_sees_a_wall_below_its_lowest_or_from_another_bin(solids, cell, shrink, columns):
    city = city_from(solids, cell, clearance=0.1)
    if city.objects:
        check(city, cell, count=4000, seed=3, shrink=shrink, columns=columns)


@pytest.mark.parametrize("seed", range(6))
def test_the_same_in_streets_that_hide_a_lot(seed):
    """Blocks with narrow gaps along the cell, and taller ones behind them."""
    rng = np.random.default_rng(seed)
    objects = []
    for side in (-1, 1):
        for row, (away, least) in enumerate([(5.0, 3.0), (25.0, 6.0), (50.0, 10.0)]):
            x = -60.0
            while x < 60.0:
                wide = rng.uniform(3.0, 25.0)
                y0, y1 = sorted((side * away, side * (away + rng.uniform(8.0, 15.0))))
                objects.append(block(f"{side}/{row}/{x:.2f}", x, y0, x + wide, y1, rng.uniform(least, 3.0 * least)))
                x += wide + rng.choice([0.0, 0.3, 4.0])
    cell = cell_along_x(30.0, 3.5)
    wall_visibility, seen = check(city_of(*objects), cell, count=60000, seed=seed)
    assert seen > 1000
    assert np.count_nonzero(np.isinf(wall_visibility.lowest) & (wall_visibility.lowest > 0)) > 30  # a lot is hidden
    assert np.count_nonzero(np.isfinite(wall_visibility.lowest)) > 10


def test_the_crossroads():
    wall_visibility, _ = check(crossroads(), cell_along_x(40.0, 3.0), count=100_000, seed=0)
    assert wall_visibility.bins == len(
        np.flatnonzero(np.bitwise_or.reduce(wall_visibility.bits) >> np.arange(64, dtype=np.uint64) & np.uint64(1))
    )


def test_walls_are_counted_as_elsewhere():
    city = crossroads()
    walls, solids = walls_of(city), Solids(city)
    wall_visibility = horizon_visible(prepare_horizon(city), cell_along_x())[1]
    assert wall_visibility.lowest.shape == wall_visibility.bits.shape == (len(solids.walls),)
    np.testing.assert_array_equal(np.column_stack([walls.a, walls.b]), solids.walls[:, :4])
    np.testing.assert_array_equal(np.repeat(np.arange(len(city.objects)), np.diff(walls.first)), solids.walls[:, 5])


class TestUseful:
    """Safe is not enough: a visibility that says everything is visible would pass what is above."""

    def lowest(self, city, cell, side, **options):
        """Of the wall of object 1 at y = ``side``."""
        walls = walls_of(city)
        index = np.arange(walls.first[1], walls.first[2])
        (wall,) = index[(walls.a[index, 1] == side) & (walls.b[index, 1] == side)]
        return horizon_visible(prepare_horizon(city, **options), cell)[1].lowest[wall]

    @pytest.mark.parametrize("low", [4.0, 8.0, 15.0])
    def test_a_low_house_hides_the_foot_of_a_tall_one(self, low):
        city = city_of(block("low", -200.0, 20.0, 200.0, 40.0, low), block("tall", -10.0, 50.0, 10.0, 60.0, 60.0))
        cell = cell_along_x(20.0, 3.0)
        # From the far side of the cell at the highest eye, over the front edge of the low roof: 23 m and 53 m away.
        exact = 1.9 + (low - 1.9) * 53.0 / 23.0
        found = self.lowest(city, cell, 50.0, shrink=0.5, columns=4096)
        assert 0.93 * exact < found <= exact + 1e-9

    def test_a_wall_that_faces_away_is_hidden(self):
        city = city_of(block("low", -9.0, 20.0, 9.0, 30.0, 4.0), block("tall", -10.0, 50.0, 10.0, 60.0, 60.0))
        assert self.lowest(city, cell_along_x(20.0, 3.0), 60.0) == math.inf

    def test_nothing_hides_what_stands_alone(self):
        city = city_of(block("aside", 100.0, 20.0, 110.0, 30.0, 4.0), block("tall", -10.0, 50.0, 10.0, 60.0, 60.0))
        assert self.lowest(city, cell_along_x(20.0, 3.0), 50.0) == -math.inf

    def test_a_tall_house_hides_all_of_a_low_one(self):
        city = city_of(block("tall", -200.0, 20.0, 200.0, 40.0, 30.0), block("low", -10.0, 50.0, 10.0, 60.0, 20.0))
        assert self.lowest(city, cell_along_x(20.0, 3.0), 50.0) == math.inf

    def test_what_is_seen_through_a_gap_has_the_bins_of_the_gap(self):
        """Through a gap in front of the middle, a narrow tower far away is seen from around the middle only."""
        city = city_of(
            block("left", -200.0, 10.0, -2.0, 20.0, 50.0),
            block("tower", -1.0, 400.0, 1.0, 402.0, 60.0),
            block("right", 2.0, 10.0, 200.0, 20.0, 50.0),
        )
        cell = cell_along_x(40.0, 3.0)
        walls = walls_of(city)
        (wall,) = [w for w in range(walls.first[1], walls.first[2]) if walls.a[w, 1] == walls.b[w, 1] == 400.0]
        wall_visibility = horizon_visible(prepare_horizon(city, shrink=0.5, columns=4096), cell)[1]
        around = np.flatnonzero(
            wall_visibility.bits[wall] >> np.arange(wall_visibility.bins, dtype=np.uint64) & np.uint64(1)
        )
        middles = (around + 0.5) / wall_visibility.bins * 92.0  # metres from the corner (-20, -3)
        assert len(around)
        x = np.where(
            middles < 40.0,
            middles - 20.0,
            np.where(middles < 46.0, 20.0, np.where(middles < 86.0, 66.0 - middles, -20.0)),
        )
        assert np.abs(x).max() < 6.0
