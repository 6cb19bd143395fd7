import math

import numpy as np
from cities import block, cell_along_x, city_of, crossroads
from hypothesis import given, settings
from hypothesis import strategies as st

from mmi.sectors import layer_views, texel_focal, walls_of

FOCAL = 443.4


def test_walls_belong_to_their_objects_courtyards_included():
    city = crossroads()
    walls = walls_of(city)
    yard = city.index()["block/13"]
    assert len(walls.of(np.array([0]))) == 4
    assert len(walls.of(np.array([yard]))) == 8
    both = walls.of(np.array([0, yard]))
    assert both.tolist() == [*walls.of(np.array([0])), *walls.of(np.array([yard]))]


def _views(city, objects, *, sectors=6):
    return dict(layer_views(walls_of(city), np.array(objects), cell_along_x(), sectors=sectors, focal=FOCAL, quad=16))


def test_an_object_ahead_is_in_the_sector_that_faces_it_only():
    views = _views(city_of(block("a", 80.0, -5.0, 90.0, 5.0, 10.0)), [0])
    assert list(views) == [0]
    left, top, width, height = views[0].window
    assert left <= -FOCAL * 5 / 80 <= left + 16
    assert left + width - 16 <= FOCAL * 5 / 80 <= left + width
    assert top <= -FOCAL * (10 - 1.7) / 80 <= top + 16
    assert top + height - 16 <= FOCAL * 1.7 / 80 <= top + height


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
    border = FOCAL * math.tan(math.radians(30.0))
    assert views[0].window[0] <= -border - 16
    assert views[0].window[0] + views[0].window[2] >= border + 16


@given(st.floats(60.0, 400.0), st.floats(-math.pi, math.pi))
@settings(max_examples=50, deadline=None)
def test_texels_are_no_larger_than_pixels_from_anywhere_in_the_cell(distance, azimuth):
    cell = cell_along_x()
    x, y = distance * math.cos(azimuth), distance * math.sin(azimuth)
    city = city_of(block("a", x, y, x + 15.0, y + 10.0, 10.0))
    focal = texel_focal(walls_of(city), np.array([0]), cell, FOCAL)
    rng = np.random.default_rng(1)
    viewers = np.column_stack([rng.uniform(-20, 20, 400), rng.uniform(-3, 3, 400)])
    side = rng.integers(0, 4, 400)
    corners = np.array([[x, y], [x + 15.0, y], [x + 15.0, y + 10.0], [x, y + 10.0], [x, y]])
    t = rng.uniform(size=(400, 1))
    points = corners[side] * (1 - t) + corners[side + 1] * t
    texel = np.hypot(*points.T) / focal
    pixel = np.hypot(*(points - viewers).T) / FOCAL
    assert np.all(texel <= pixel * 1.02)
    assert focal >= FOCAL


def test_floating_prisms_have_windows_above_the_ground():
    views = _views(city_of(block("bridge", 80.0, -5.0, 90.0, 5.0, 20.0, bottom=15.0)), [0])
    assert views[0].window[1] + views[0].window[3] <= -64
