"""Horizon maps against rays, points of the city, and a twin that looks at every cell for every column."""

import math

import numpy as np
import pytest
from hills import hilly_city
from hypothesis import given, settings
from hypothesis import strategies as st
from triangle_soups import corners_of, hits_beyond, mesh_from, points_on

from mmi.appearance.city_mesh import build_city_mesh
from mmi.foundation.camera import Camera, View, view_towards
from mmi.foundation.errors import ParameterError
from mmi.rays.height_field import height_field
from mmi.rays.horizon_map import azimuths_of, horizon_of, is_above, sky

TURN = 2.0 * math.pi


def twin(field, eye, beyond, right, left, *, nearer=0.0):
    """The steepest slope of any finest cell that touches the wedge from ``right`` to ``left`` (radians, less than half a turn).

    ``nearer`` is a share by which distances are taken too short.
    """
    rows, columns = np.nonzero(np.isfinite(field.levels[0]))
    low = np.array(field.corner) + np.column_stack([columns, rows]) * field.step - np.asarray(eye)[:2]
    corners = low[:, None] + field.step * np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    touches = np.ones(len(low), dtype=bool)
    for turn, sign in ((right, 1.0), (left, -1.0)):
        across = math.cos(turn) * corners[..., 1] - math.sin(turn) * corners[..., 0]
        touches &= (sign * across).max(axis=1) >= 0.0
    middle = 0.5 * (right + left)
    touches &= (corners @ [math.cos(middle), math.sin(middle)]).max(axis=1) >= 0.0
    outside = np.maximum(np.maximum(low, -(low + field.step)), 0.0)
    near = np.maximum(np.hypot(*outside.T), beyond) * (1.0 - nearer)
    far = np.hypot(*np.abs(corners).max(axis=1).T)
    rise = field.levels[0][rows, columns] - eye[2]
    with np.errstate(divide="ignore"):
        slopes = np.where(rise > 0.0, rise / near, rise / far)
    return slopes[touches & (far >= beyond)].max(initial=-math.inf)


def horizontal(directions):
    return np.hypot(directions[:, 0], directions[:, 1])


def check_points(mesh, field, eye, beyond, rng, *, count=20_000, **options):
    """No point of the mesh beyond the near field is in the sky; that is stronger than any number of rays."""
    towards = points_on(corners_of(mesh), count, rng) - eye
    towards = towards[horizontal(towards) >= beyond]
    horizon = horizon_of(field, eye, beyond=beyond, **options)
    assert not sky(horizon, towards).any()
    return horizon


@pytest.fixture(scope="module")
def hills():
    mesh = build_city_mesh(hilly_city(5, count=40, size=160.0))
    return mesh, height_field(mesh, step=1.0)


EYES = [
    (0.0, 0.0, 30.0),
    (33.3, -71.1, 45.0),
    (-150.0, 10.0, 200.0),
    (900.0, 400.0, 25.0),
    (2.0, 1.0, 2.0),
    (0.0, 0.0, 1e5),
]


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize("beyond", [0.0, 12.0, 60.0])
@pytest.mark.parametrize("columns", [1, 2, 3, 7, 1000])
def test_no_point_of_the_city_is_in_the_sky(hills, eye, beyond, columns):
    check_points(*hills, np.array(eye), beyond, np.random.default_rng(columns), columns=columns)


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize("beyond", [0.0, 40.0])
@pytest.mark.parametrize("columns", [2, 16, 64, 700])
def test_slopes_are_those_of_the_twin(hills, eye, beyond, columns):
    """Never below the twin; nor above one whose columns are as much wider as a cell of a coarser level may be."""
    _, field = hills
    horizon = horizon_of(field, eye, beyond=beyond, columns=columns)
    width = TURN / columns
    for column in np.unique(np.linspace(0, columns - 1, 16).astype(int)):
        right, left = horizon.first + column * width, horizon.first + (column + 1) * width
        slope = horizon.slopes[column]
        assert slope >= twin(field, eye, beyond, right, left)
        if columns >= 16:
            wider = 1.5 * width
            most = twin(
                field, np.array(eye) - [0, 0, 2e-3], beyond, right - wider, left + wider, nearer=min(wider, 0.9)
            )
            assert slope <= max(most, most * (1.0 - wider)) + 1e-3


def test_narrow_columns_are_those_of_the_twin_exactly(hills):
    """Where no cell is narrower than a column, the descent ends at the finest cells only."""
    _, field = hills
    eye = np.array([4.0, -3.0, 31.0])
    horizon = horizon_of(field, eye, beyond=20.0, columns=4096)
    for column in range(0, 4096, 128):
        right, left = (horizon.first + (column + k) / horizon.per_radian for k in (0, 1))
        slope = twin(field, eye, 20.0, right, left)
        assert slope <= horizon.slopes[column]
        if np.isfinite(slope):
            hair = 2e-3 / 20.0
            assert horizon.slopes[column] <= twin(
                field, eye - [0, 0, 2e-3], 20.0, right - hair, left + hair, nearer=hair
            )


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.0, 1.0, 5.0, 11.0]),
    st.sampled_from([1, 5, 64, 777]),
    st.sampled_from([0.3, 1.0, 4.0, 100.0]),
    st.booleans(),
)
def test_no_ray_into_the_sky_hits_anything(seed, beyond, columns, step, whole):
    """Triangles anywhere, upright and aslant, many of them on the borders of cells (``whole``)."""
    rng = np.random.default_rng(seed)
    triangles = rng.normal(0.0, [8.0, 8.0, 4.0], (int(rng.integers(1, 12)), 3, 3)) + rng.normal(0.0, 6.0, 3)
    triangles[::2, 2, :2] = triangles[::2, 1, :2]
    if whole:
        triangles = np.round(triangles)
    triangles = triangles.astype(np.float32).astype(float)
    mesh = mesh_from(triangles)
    field = height_field(mesh, step=step)
    eye = np.round(rng.normal(0.0, 5.0, 3)) if whole else rng.normal(0.0, 5.0, 3)
    horizon = check_points(mesh, field, eye, beyond, rng, count=2_000, columns=columns)
    directions = rng.normal(size=(2_000, 3))
    directions[:1000, 2] *= 0.2
    above = sky(horizon, directions)
    assert not (above & hits_beyond(eye, directions, triangles, beyond)).any()


@pytest.fixture(scope="module")
def tower():
    """A slab of 2 x 20 metres, 30 high, whose face is 50 metres east of the origin."""
    a, b, c, d = (50, -10), (50, 10), (52, 10), (52, -10)
    walls = [[(*p, 0), (*q, 0), (*q, 30)] for p, q in ((a, b), (b, c), (c, d), (d, a))]
    walls += [[(*p, 0), (*q, 30), (*p, 30)] for p, q in ((a, b), (b, c), (c, d), (d, a))]
    roof = [[(*a, 30), (*b, 30), (*c, 30)], [(*a, 30), (*c, 30), (*d, 30)]]
    return height_field(mesh_from(walls + roof), step=0.5)


def test_a_tower_is_as_steep_as_it_looks(tower):
    horizon = horizon_of(tower, (0, 0, 0), beyond=10.0, columns=3600)
    assert horizon.slopes[0] == pytest.approx(30.0 / 50.0, rel=1e-3)
    filled = np.flatnonzero(np.isfinite(horizon.slopes))
    edge = math.degrees(math.atan2(10.5, 50.0)) * 10.0
    assert abs(np.sum(filled < 1800) - edge) <= 3
    assert abs(np.sum(filled >= 1800) - math.degrees(math.atan2(10.0, 50.0)) * 10.0) <= 3


def test_from_above_it_is_the_far_side_that_counts(tower):
    horizon = horizon_of(tower, (0, 0, 100), beyond=10.0, columns=3600)
    assert horizon.slopes[0] == pytest.approx(-70.0 / 52.5, rel=1e-2)
    assert sky(horizon, [(50.0, 0.0, -60.0), (50.0, 0.0, -71.0)]).tolist() == [True, False]


def test_the_near_field_is_left_out(tower):
    assert np.isfinite(horizon_of(tower, (0, 0, 0), beyond=50.0).slopes).any()
    assert (horizon_of(tower, (0, 0, 0), beyond=60.0).slopes == -math.inf).all()


@pytest.mark.parametrize("window", [(-0.3, 0.4), (math.pi - 0.2, math.pi + 0.2), (-9.0, -8.9), (6.2, 6.4), (2.0, -2.0)])
def test_a_window_holds_the_same_columns(hills, window):
    _, field = hills
    eye = (5.0, 3.0, 40.0)
    around = horizon_of(field, eye, beyond=20.0, columns=512)
    part = horizon_of(field, eye, beyond=20.0, columns=512, window=window)
    turns = np.linspace(-math.pi, math.pi, 5001)
    inside = (turns - window[0]) % TURN <= (window[1] - window[0]) % TURN
    assert 0 < len(part.slopes) <= 512 * ((window[1] - window[0]) % TURN) / TURN + 2
    for pitch in (-0.4, 0.0, 0.3):
        directions = np.column_stack([np.cos(turns), np.sin(turns), np.full(len(turns), pitch)])
        found = sky(part, directions)
        assert (found[inside] == sky(around, directions)[inside]).all()
        beside = (turns - window[0] + 0.02) % TURN > (window[1] - window[0]) % TURN + 0.04
        assert not found[beside].any()


def test_a_window_of_a_turn_is_all_around(tower):
    assert len(horizon_of(tower, (0, 0, 0), beyond=1.0, columns=90, window=(1.0, 1.0 + TURN)).slopes) == 90


def test_an_empty_field_is_all_sky():
    horizon = horizon_of(height_field(mesh_from(np.empty((0, 3, 3)))), (1, 2, 3), beyond=0.0)
    assert sky(horizon, np.random.default_rng(0).normal(size=(100, 3))).all()


def test_straight_up_and_down(tower):
    outside, under = (horizon_of(tower, (x, 0, 5), beyond=0.0, columns=8) for x in (0, 51))
    up_and_down = [(0, 0, 1), (0, 0, -1), (-0.0, -0.0, 1), (-0.0, 0.0, 1)]
    assert sky(outside, up_and_down)[0]
    assert sky(horizon_of(tower, (51, 0, 5), beyond=9.0, columns=8), [(0, 0, 1)]).all()
    assert not sky(under, up_and_down).any()
    assert (under.slopes == math.inf).all()


def test_no_direction_is_no_sky(tower):
    horizon = horizon_of(tower, (0, 0, 0), beyond=1.0, columns=8)
    assert not sky(horizon, [(math.nan, 0, 1), (0, math.nan, 1)]).any()


def test_pixels_of_any_view(hills):
    """The kernel alone, on directions in float32 of a view that is tilted and turned."""
    mesh, field = hills
    eye, corners = np.array([3.0, 2.0, 36.0]), corners_of(mesh)
    camera = Camera(24, 18, 1.2)
    tried = 0
    for azimuth, pitch, roll in (
        (0.2, 0.1, 0.0),
        (3.1, 0.3, 0.4),
        (-3.1, -0.3, -1.0),
        (-1.2, 1.4, 0.0),
        (2.0, -1.3, 0.2),
    ):
        level = view_towards(eye, azimuth, pitch, focal=camera.focal, window=camera.window)
        turn = np.eye(4)
        turn[:2, :2] = [[math.cos(roll), -math.sin(roll)], [math.sin(roll), math.cos(roll)]]
        view = View(turn @ level.eye_from_world, camera.focal, camera.window)
        directions = pixel_directions(view)
        window = azimuths_of(directions[[0, 23, -24, -1]])
        horizon = horizon_of(field, eye, beyond=15.0, window=window)
        above = np.array(
            [
                is_above(
                    horizon.slopes, horizon.first, horizon.per_radian, math.atan2(y, x), math.hypot(x, y), float(z)
                )
                for x, y, z in directions
            ]
        )
        hit = hits_beyond(eye, directions.astype(float), corners, 15.0)
        assert not (above & hit).any()
        missed = ~hits_beyond(eye, directions.astype(float), corners, 0.0) & (directions[:, 2] > 0.0)
        tried += missed.sum()
        assert (above & missed).sum() >= 0.8 * missed.sum()
    assert tried > 400


def pixel_directions(view: View):
    """(n, 3) float32 unit directions through the middles of a view's pixels, row by row."""
    left, top, width, height = view.window
    u, v = np.meshgrid(left + np.arange(width) + 0.5, top + np.arange(height) + 0.5)
    eye_space = np.stack([u, -v, np.full(u.shape, -view.focal)], axis=-1).reshape(-1, 3)
    directions = eye_space @ view.eye_from_world[:3, :3]
    return (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)


def test_azimuths_of_cones():
    start, end = azimuths_of([(1, -0.1, 0.3), (1, 0.2, 0.3), (2, 0.2, -0.3)])
    assert (start, end) == pytest.approx((math.atan2(-0.1, 1), math.atan2(0.2, 1)))
    start, end = azimuths_of([(-1, -0.1, 0.3), (-1, 0.2, 0.3)])
    assert (start % TURN, end % TURN) == pytest.approx((math.atan2(0.2, -1), math.atan2(-0.1, -1) + TURN))
    assert azimuths_of([(1, 0, 1), (-1, 1, 1), (-1, -1, 1)]) is None
    assert azimuths_of([(1, 0, 1), (0, 0, 1)]) is None
    assert azimuths_of([(1, 0, 1), (-1, 0, 1)]) is None
    assert azimuths_of(np.empty((0, 3))) is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"columns": 0}, "at least one column, found 0"),
        ({"beyond": -1.0}, "distance of 0 metres or more, found -1"),
        ({"beyond": math.nan}, "distance of 0 metres or more, found nan"),
        ({"eye": (0, 0)}, r"eye is a point \(x, y, z\) in metres, found \[0.0, 0.0\]"),
        ({"eye": (0, 0, math.inf)}, "eye is a point"),
    ],
)
def test_what_makes_no_horizon(tower, options, message):
    given = {"eye": (0, 0, 0), "beyond": 1.0, **options}
    with pytest.raises(ParameterError, match=message):
        horizon_of(tower, given.pop("eye"), **given)
