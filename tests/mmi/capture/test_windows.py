import math

import numpy as np
import pytest
from cities import block, cell_along_x, city_of, crossroads
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from shapely.geometry import box

from mmi.capture.windows import layer_views
from mmi.parallax.texels import texel_ratios
from mmi.visibility.selection import WallVisibility
from mmi.visibility.walls import Walls, walls_of

FOCAL = 443.4


def test_walls_belong_to_their_objects_courtyards_included():
    city = crossroads()
    walls = walls_of(city)
    yard = city.index()["block/13"]
    assert len(walls.of(np.array([0]))) == 4
    assert len(walls.of(np.array([yard]))) == 8
    both = walls.of(np.array([0, yard]))
    assert both.tolist() == [*walls.of(np.array([0])), *walls.of(np.array([yard]))]


def _views(city, objects, *, sectors=6, wall_visibility=None):
    walls, cell = walls_of(city), cell_along_x()
    return dict(
        layer_views(
            walls, np.array(objects), cell, sectors=sectors, focal=FOCAL, quad=16, wall_visibility=wall_visibility
        )
    )


def _sight(lowest):
    """Walls seen from everywhere down to ``lowest`` (w,)."""
    return WallVisibility(np.array(lowest, dtype=np.float64), np.full(len(lowest), 1, dtype=np.uint64), 1)


def _on_walls(city, count, rng):
    """(count, 2) random points of the walls of a city of boxes, and the wall of each (count,)."""
    walls = walls_of(city)
    index = rng.integers(0, len(walls.a), count)
    t = rng.uniform(size=(count, 1))
    return walls.a[index] * (1 - t) + walls.b[index] * t, index


def test_an_object_ahead_is_in_the_sector_that_faces_it_only():
    views = _views(city_of(block("a", 80.0, -5.0, 90.0, 5.0, 10.0)), [0])
    assert list(views) == [0]
    left, top, width, height = views[0].window
    focal = views[0].focal
    assert left <= -focal * 5 / 80 <= left + 16
    assert left + width - 16 <= focal * 5 / 80 <= left + width
    assert top <= -focal * (10 - 1.7) / 80 <= top + 16
    assert top + height - 16 <= focal * 1.7 / 80 <= top + height


@settings(max_examples=60, deadline=None)
@given(st.floats(-math.pi, math.pi), st.floats(50.0, 300.0), st.floats(1.0, 40.0), st.sampled_from([4, 6, 8]))
def test_every_point_of_a_layer_lies_in_some_window(azimuth, distance, size, sectors):
    x, y = distance * math.cos(azimuth), distance * math.sin(azimuth)
    city = city_of(block("a", x, y, x + size, y + size, 25.0))
    views = _views(city, [0], sectors=sectors)
    rng = np.random.default_rng(0)
    t = rng.uniform(size=(200, 1))
    corners = np.array([[x, y], [x + size, y], [x + size, y + size], [x, y + size], [x, y]])
    side = rng.integers(0, 4, 200)
    points = np.column_stack([corners[side] * (1 - t) + corners[side + 1] * t, rng.uniform(0.0, 25.0, 200)])
    found = np.zeros(200, dtype=bool)
    for view in views.values():
        u, v, depth = view.project(points).T
        left, top, width, height = view.window
        found |= (depth > 0) & (u >= left) & (u <= left + width) & (v >= top) & (v <= top + height)
    assert found.all()


def test_neighbouring_sectors_overlap_by_a_quad():
    city = city_of(block("ring", 60.0, -300.0, 70.0, 300.0, 10.0))
    views = _views(city, [0])
    border = views[0].focal * math.tan(math.radians(30.0))
    assert views[0].window[0] <= -border - 16
    assert views[0].window[0] + views[0].window[2] >= border + 16


@given(st.floats(60.0, 400.0), st.floats(-math.pi, math.pi), st.floats(2.0, 80.0), st.floats(2.0, 80.0))
@settings(max_examples=100, deadline=None)
def test_texels_are_no_larger_than_pixels_from_anywhere_in_the_cell(distance, azimuth, wide, deep):
    """On each wall by itself: a picture may hold some of an object's walls and not their neighbours."""
    cell = cell_along_x()
    x, y = distance * math.cos(azimuth), distance * math.sin(azimuth)
    assume(box(x, y, x + wide, y + deep).distance(box(-20.0, -3.0, 20.0, 3.0)) > 20.0)
    city = city_of(block("a", x, y, x + wide, y + deep, 10.0))
    rng = np.random.default_rng(1)
    points, index = _on_walls(city, 400, rng)
    ratios = texel_ratios(walls_of(city), index, cell)
    viewers = np.column_stack([rng.uniform(-20, 20, 400), rng.uniform(-3, 3, 400)])
    from_cell = np.hypot(*(points - viewers).T)
    texel = np.hypot(*points.T) / ratios
    assert np.all(texel <= from_cell * 1.02)
    assert ratios.min() >= 1.0


def test_either_end_of_a_wall_may_be_what_needs_the_finest_texels():
    """Walls in any direction, by themselves and the other way round, against points all along them."""
    rng = np.random.default_rng(3)
    a = rng.uniform(-150.0, 150.0, (20_000, 2))
    b = a + rng.normal(0.0, 20.0, a.shape)
    along = np.array([a + t * (b - a) for t in np.linspace(0.0, 1.0, 31)])
    from_cell = np.hypot(*np.moveaxis(np.maximum(np.abs(along) - [20.0, 3.0], 0.0), -1, 0))
    clear = from_cell.min(axis=0) > 20.0
    needed = (np.hypot(*np.moveaxis(along, -1, 0))[:, clear] / from_cell[:, clear]).max(axis=0)
    found = []
    for one, other in ((a[clear], b[clear]), (b[clear], a[clear])):
        walls = Walls(one, other, np.zeros(len(one)), np.ones(len(one)), np.array([0, len(one)]))
        found.append(texel_ratios(walls, np.arange(len(one)), cell_along_x()))
    np.testing.assert_allclose(*found, rtol=1e-9)
    assert np.max(needed / found[0]) < 1.05


@settings(max_examples=60, deadline=None)
@given(st.floats(60.0, 400.0), st.floats(-math.pi, math.pi), st.floats(2.0, 80.0), st.sampled_from([4, 6, 8]))
def test_every_picture_has_texels_as_fine_as_what_it_shows_needs(distance, azimuth, size, sectors):
    x, y = distance * math.cos(azimuth), distance * math.sin(azimuth)
    assume(box(x, y, x + size, y + 2.0).distance(box(-20.0, -3.0, 20.0, 3.0)) > 20.0)
    city = city_of(block("a", x, y, x + size, y + 2.0, 10.0), block("b", -x, -y, 10.0 - x, 10.0 - y, 10.0))
    rng = np.random.default_rng(2)
    points, _ = _on_walls(city, 400, rng)
    viewers = np.column_stack([rng.uniform(-20, 20, 400), rng.uniform(-3, 3, 400)])
    needed = FOCAL * np.hypot(*points.T) / np.hypot(*(points - viewers).T)
    for view in _views(city, [0, 1], sectors=sectors).values():
        u, _, depth = view.project(np.column_stack([points, np.full(400, 5.0)])).T
        left, _, width, _ = view.window
        shown = (depth > 0) & (u >= left) & (u <= left + width)
        assert np.all(needed[shown] <= view.focal * 1.02)
        assert view.focal >= FOCAL


def test_texels_are_as_fine_as_each_sector_needs_and_no_finer():
    """What lies ahead of the cell is seen from 30 m closer than from its middle; what lies beside it is not."""
    ahead, beside = block("ahead", 60.0, -5.0, 70.0, 5.0, 10.0), block("beside", -5.0, 200.0, 5.0, 210.0, 10.0)
    views = _views(city_of(ahead, beside), [0, 1], sectors=4)
    assert list(views) == [0, 1]
    alone = [_views(city_of(one), [0], sectors=4) for one in (ahead, beside)]
    assert views[0].focal == alone[0][0].focal == pytest.approx(FOCAL * 60.0 / 40.0, rel=0.01)
    assert views[1].focal == alone[1][1].focal < FOCAL * 1.05


# What the visibility of walls leaves


def test_windows_end_where_sight_does():
    city = city_of(block("a", 80.0, -5.0, 90.0, 5.0, 10.0))
    whole, upper = _views(city, [0])[0], _views(city, [0], wall_visibility=_sight([6.0] * 4))[0]
    top, height = upper.window[1], upper.window[3]
    assert (upper.window[0], top, upper.window[2]) == (whole.window[0], whole.window[1], whole.window[2])
    lower = (
        -upper.focal * (6.0 - 1.7) / 90.0
    )  # of the farther wall, which is lower in the picture as it lies above the eye
    assert top + height - 16 <= lower <= top + height
    assert height < whole.window[3]
    assert _views(city, [0], wall_visibility=_sight([-np.inf] * 4))[0].window == whole.window


def test_walls_out_of_sight_have_no_part_in_windows_and_texels():
    city = city_of(block("near", 45.0, -5.0, 55.0, 5.0, 10.0), block("far", 95.0, -40.0, 105.0, 40.0, 30.0))
    hidden = _sight([np.inf] * 4 + [-np.inf] * 4)
    assert _views(city, [0, 1], wall_visibility=hidden)[0].window == _views(city, [1])[0].window
    assert (
        _views(city, [0, 1], wall_visibility=hidden)[0].focal
        == _views(city, [1])[0].focal
        < _views(city, [0, 1])[0].focal
    )
    assert _views(city, [0], wall_visibility=hidden) == {}
    assert _views(city, [0], wall_visibility=_sight([10.0] * 8)) == {}  # its very top


def test_floating_prisms_have_windows_above_the_ground():
    views = _views(city_of(block("bridge", 80.0, -5.0, 90.0, 5.0, 20.0, bottom=15.0)), [0])
    assert views[0].window[1] + views[0].window[3] <= -64


@given(left=st.floats(-20.0, 20.0), width=st.floats(3.0, 30.0), top=st.floats(3.0, 40.0), away=st.floats(30.0, 200.0))
@settings(max_examples=60, deadline=None)
def test_there_is_room_for_a_texel_around_what_is_shown(left, width, top, away):
    """Where a house ends in a sector, what touches it may show in a rim of a texel."""
    for view in _views(city_of(block("house", left, away, left + width, away + 8.0, top)), [0]).values():
        x, y = np.meshgrid([left, left + width], [away, away + 8.0])
        corners = np.column_stack([x.ravel(), y.ravel(), np.full(4, top)])
        u, v, depth = view.project(corners).T
        inside = (depth > 1.0) & (np.abs(u) < view.focal * math.tan(math.pi / 6.0))
        assert (u[inside] - 1.0 >= view.window[0]).all()
        assert (u[inside] + 1.0 <= view.window[0] + view.window[2]).all()
        assert (v[inside] - 1.0 >= view.window[1]).all()
