import math
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmi.foundation.camera import Camera, View, view_towards
from mmi.rays.horizon_map import is_above
from viewer.casting.open_pixels import CAST, COVERED, REUSED, SKY, TILE, classify, rays_of
from viewer.casting.panorama import SAMPLE, Found, Panorama, smallest_pixel, store

CAMERA = Camera(80, 60, math.radians(70.0))
VIEW = View(np.eye(4), CAMERA.focal, CAMERA.window)
NEAR = 50.0
NOBODY = np.zeros(4, dtype=np.bool_)


class Classified(NamedTuple):
    state: np.ndarray
    texel: np.ndarray
    error: np.ndarray


def classified(depths, view, horizon, panorama, *, errors=None, near_objects=NOBODY, limit=5.0, own=False, rows=(0, 1)):
    """States, and the texels and errors of open pixels, as pictures (h, w). ``rows``: the first of tiles, and each n-th."""
    room = (np.full(depths.size, 77, kind) for kind in (np.int32, np.int32, np.float32))
    found = Found(np.full(depths.shape, 9, np.uint8), *room)
    begin = 3 if rows[1] > 1 else 0
    end, sky = classify(
        depths.astype(np.float32),
        *rows,
        rays_of(view),
        NEAR,
        *horizon,
        panorama.texels,
        np.array([np.inf] if errors is None else errors, dtype=np.float32),
        near_objects,
        limit,
        own,
        found,
        begin,
    )
    some = slice(begin, end)
    listed = np.sort(found.pixel[some])
    assert np.array_equal(listed, np.flatnonzero(np.isin(found.state, (REUSED, CAST)))), "open ones, each once"
    assert sky == (found.state == SKY).sum()
    assert (np.delete(found.pixel, some) == 77).all(), "nothing beside the list is touched"
    texel, error = np.zeros(depths.shape, np.int32), np.zeros(depths.shape, np.float32)
    texel.reshape(-1)[found.pixel[some]], error.reshape(-1)[found.pixel[some]] = found.texel[some], found.error[some]
    return Classified(found.state, texel, error)


def directions(view):
    """(h, w, 3) unit directions through the middles of pixels."""
    u, v = view.pixel_centres()
    points = view.unproject(u[None, :], v[:, None], np.ones((len(v), len(u)))) - view.eye
    return points / np.linalg.norm(points, axis=2, keepdims=True)


@settings(max_examples=80, deadline=None)
@given(
    seed=st.integers(0, 100_000),
    pitch=st.floats(-1.4, 1.4),
    azimuth=st.floats(-4.0, 4.0),
    columns=st.sampled_from([7, 64, 720]),
)
def test_pixels_are_covered_sky_or_cast_as_each_of_them_says(seed, pitch, azimuth, columns):
    """Tiles that are looked at as a whole come to the same."""
    rng = np.random.default_rng(seed)
    view = view_towards(np.array([3.0, 4.0, 2.0]), azimuth, pitch, focal=CAMERA.focal, window=CAMERA.window)
    depths = np.full((60, 80), np.inf)
    for _ in range(rng.integers(0, 6)):
        i, j = rng.integers(0, 60), rng.integers(0, 80)
        depths[i : i + rng.integers(1, 60), j : j + rng.integers(1, 60)] = rng.choice([5.0, 49.0, 60.0, 900.0])
    slopes = rng.choice([-np.inf, -0.1, 0.0, 0.2, 1.0, np.inf], columns) + rng.uniform(0.0, 0.05, columns)
    horizon = (slopes, -math.pi, columns / (2.0 * math.pi))
    found = classified(depths, view, horizon, Panorama(smallest_pixel(VIEW)))
    rays = directions(view)
    ahead = -(rays @ view.eye_from_world[2, :3])
    for i in range(60):
        for j in range(80):
            x, y, z = rays[i, j]
            above = is_above(*horizon, math.atan2(y, x), math.hypot(x, y), z)
            if depths[i, j] / ahead[i, j] <= NEAR:
                expected = COVERED
            elif above:
                expected = SKY if np.isinf(depths[i, j]) else COVERED
            else:
                expected = CAST
            assert found.state[i, j] == expected, (i, j)
    assert (found.error[found.state == CAST] == np.inf).all()
    assert (found.texel[found.state == CAST] == -1).all()


OPEN = np.full((60, 80), np.inf)
WALL = (np.full(4, np.inf), -math.pi, 4 / (2.0 * math.pi))  # nothing is above it


def filled(eye, *, distance=200.0, which=1):
    """A panorama with what a view from ``eye`` has cast: a sphere around it."""
    panorama = Panorama(smallest_pixel(VIEW))
    view = view_towards(eye, 0.5, 0.1, focal=CAMERA.focal, window=CAMERA.window)
    rays = directions(view).reshape(-1, 3)
    count = len(rays)
    samples = np.zeros(count, dtype=SAMPLE)
    samples["object"] = which
    store(
        panorama.record_at(eye),
        np.ascontiguousarray(rays),
        -view.eye_from_world[2, :3],
        (rays if which < 0 else eye + distance * rays).astype(np.float32),
        samples,
        panorama.texels,
    )
    return panorama, view


EYE = np.array([5.0, -3.0, 1.7])


@pytest.mark.parametrize("which", [1, -1])
def test_what_was_cast_from_here_is_shown_again(which):
    panorama, view = filled(EYE, which=which)
    found = classified(OPEN, view, WALL, panorama, errors=[np.inf, 0.0])
    assert (found.state == REUSED).all()
    assert len(np.unique(found.texel)) > 0.95 * found.texel.size


def test_turning_on_the_spot_needs_only_what_comes_into_view():
    panorama, _ = filled(EYE)
    turned = view_towards(EYE, 0.6, 0.05, focal=CAMERA.focal, window=CAMERA.window)
    found = classified(OPEN, turned, WALL, panorama, errors=[np.inf, 0.0])
    inside = np.zeros((60, 80), dtype=bool)
    first = view_towards(EYE, 0.5, 0.1, focal=CAMERA.focal, window=CAMERA.window)
    seen = first.project(EYE + directions(turned) * 100.0)
    inside = (np.abs(seen[..., 0]) < 39.0) & (np.abs(seen[..., 1]) < 29.0)
    assert inside.mean() > 0.7
    assert (found.state[inside] == REUSED).all()
    outside = (np.abs(seen[..., 0]) > 42.0) | (np.abs(seen[..., 1]) > 32.0)
    assert (found.state[outside] == CAST).all()


def test_what_may_be_off_by_more_than_the_limit_is_cast_and_known_meanwhile():
    panorama, view = filled(EYE)
    found = classified(OPEN, view, WALL, panorama, errors=[np.inf, 6.0], limit=5.0)
    assert (found.state == CAST).all()
    assert (found.texel >= 0).all()
    assert (found.error == 6.0).all()


def test_a_record_that_must_not_be_shown_is_as_if_it_were_not_there():
    panorama, view = filled(EYE)
    found = classified(OPEN, view, WALL, panorama, errors=[np.inf, np.inf])
    assert (found.state == CAST).all()
    assert (found.texel == -1).all()


def test_texels_are_reprojected():
    """From three metres beside, each pixel shows the texel whose point it sees."""
    panorama, view = filled(EYE, distance=60.0)
    beside = view_towards(EYE + 3.0 * view.eye_from_world[0, :3], 0.5, 0.1, focal=CAMERA.focal, window=CAMERA.window)
    found = classified(OPEN, beside, WALL, panorama, errors=[np.inf, 3.0])
    shown = found.state == REUSED
    assert shown.mean() > 0.9
    texels = panorama.texels.map[found.texel[shown]]
    points = np.stack([texels[name] for name in "xyz"], axis=-1).astype(np.float64)
    rays = points - beside.eye
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    off = CAMERA.focal * np.linalg.norm(rays - directions(beside)[shown], axis=1)
    assert np.percentile(off, 95) < 0.9
    moved = 3.0 * CAMERA.focal / 60.0
    assert moved > 2.8, "without reprojection it would be off by more"


def test_points_of_near_objects_are_drawn_anyway_or_not_there():
    panorama, view = filled(EYE, which=2)
    near = np.array([False, False, True, False])
    found = classified(OPEN, view, WALL, panorama, errors=[np.inf, 0.0], near_objects=near)
    assert (found.state == CAST).all()
    found = classified(np.full((60, 80), 190.0), view, WALL, panorama, errors=[np.inf, 0.0], near_objects=near)
    assert (found.state == REUSED).all(), "nothing stands before what is drawn"


def test_own_errors_count_where_they_are_asked_for():
    panorama, view = filled(EYE, distance=60.0)
    beside = view_towards(EYE + 3.0 * view.eye_from_world[0, :3], 0.5, 0.1, focal=CAMERA.focal, window=CAMERA.window)
    found = classified(OPEN, beside, WALL, panorama, errors=[np.inf, 0.0], own=True, limit=2.0)
    shown = found.state == REUSED
    assert 0.5 < shown.mean() < 1.0
    assert (found.error[shown] <= 2.0).all()


def test_only_the_rows_of_tiles_that_were_asked_for_are_touched():
    panorama, view = filled(EYE)
    found = classified(OPEN, view, WALL, panorama, errors=[np.inf, 0.0], rows=(1, 2))
    mine = np.isin(np.arange(60) // TILE, (1, 3))
    assert (found.state[mine] == REUSED).all()
    assert (found.state[~mine] == 9).all()
