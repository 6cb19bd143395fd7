import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmi.foundation.camera import Camera, level_view, view_towards
from viewer.measuring.disocclusion import disocclusion_mask, panorama_views

CAMERA = Camera(240, 160, math.radians(60.0))
NEAR_WALL = ((-4.0, 10.0), (5.0, 12.0))
FAR_WALL = ((-60.0, 30.0), (60.0, 30.0))
HEIGHT = 1.7


def crossing(eye, direction, wall):
    """How many times ``direction`` (..., 2) a ray from ``eye`` (2,) goes to meet a wall: infinite where it does not."""
    a, b = np.array(wall[0]), np.array(wall[1])
    along, off = b - a, a - eye
    across = direction[..., 0] * along[1] - direction[..., 1] * along[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (off[0] * along[1] - off[1] * along[0]) / across
        s = (off[0] * direction[..., 1] - off[1] * direction[..., 0]) / across
    return np.where((t > 1e-9) & (s >= 0.0) & (s <= 1.0), t, np.inf)


def rendered(view, walls=(), *, ground=False):
    """Depth (h, w) of endless upright ``walls``, and of the ground at height 0, by meeting each pixel's ray with them."""
    u, v = view.pixel_centres()
    ray = view.unproject(u[None, :], v[:, None], np.ones(1)) - view.eye  # at depth 1, so that t is depth
    depth = np.full(ray.shape[:2], np.inf)
    for wall in walls:
        depth = np.minimum(depth, crossing(view.eye[:2], ray[..., :2], wall))
    if ground:
        down = ray[..., 2] < 0.0
        depth[down] = np.minimum(depth[down], -view.eye[2] / ray[..., 2][down])
    return depth


def captured_from(eye, walls=(), *, ground=False, camera=CAMERA):
    return [(view, rendered(view, walls, ground=ground)) for view in panorama_views(np.array(eye), camera=camera)]


def hidden_from(eye, points, walls, *, turned=0.0):
    """Brute force: whether something stands on the line from ``eye`` (2,), turned by an angle, to each of points (n, 2)."""
    way = points - eye
    cos, sin = math.cos(turned), math.sin(turned)
    direction = way @ np.array([[cos, sin], [-sin, cos]])
    first = np.min([crossing(eye, direction, wall) for wall in walls], axis=0)
    return first < 1.0 - 0.02


@settings(max_examples=25, deadline=None)
@given(st.floats(-6.0, 6.0), st.floats(-4.0, 4.0), st.floats(-0.4, 0.4))
def test_what_a_near_wall_hid_is_what_rays_say(x, y, turn):
    walls = (NEAR_WALL, FAR_WALL)
    eye, reference = np.array([x, y, HEIGHT]), np.array([0.0, 0.0, HEIGHT])
    view = level_view(eye, math.pi / 2 + turn, focal=CAMERA.focal, window=CAMERA.window)
    depth = rendered(view, walls)
    tall = Camera(CAMERA.width, 3 * CAMERA.height, CAMERA.fov)
    mask = disocclusion_mask(depth, view, captured_from(reference, walls, camera=tall))
    row = CAMERA.height // 2
    u, v = view.pixel_centres()
    finite = np.flatnonzero(np.isfinite(depth[row]))
    points = view.unproject(u[finite], v[row], depth[row, finite])[:, :2]
    # What a line two captured pixels to the left and to the right of the point's says as well is sure.
    votes = np.array(
        [hidden_from(reference[:2], points, walls, turned=k / CAMERA.focal) for k in np.linspace(-2.0, 2.0, 9)]
    )
    assert mask[:, finite][:, votes.all(axis=0)].all()
    assert not mask[:, finite][:, ~votes.any(axis=0)].any()
    assert not mask[~np.isfinite(depth)].any()


def test_a_step_aside_shows_a_strip_of_known_width():
    """A wall from x = -2 to 2 at 10 m hides -6 to 6 of one at 30 m. From x = 3 it hides -12 to 0: what is new is 0 to 6."""
    walls = (((-2.0, 10.0), (2.0, 10.0)), FAR_WALL)
    view = level_view(np.array([3.0, 0.0, HEIGHT]), math.pi / 2, focal=CAMERA.focal, window=CAMERA.window)
    mask = disocclusion_mask(rendered(view, walls), view, captured_from((0.0, 0.0, HEIGHT), walls))
    u, _ = view.pixel_centres()
    seen_at = 3.0 + 30.0 * u[mask[80]] / CAMERA.focal
    metres_a_pixel = 30.0 / CAMERA.focal
    assert (seen_at.min(), seen_at.max()) == (
        pytest.approx(0.0, abs=2.5 * metres_a_pixel),
        pytest.approx(6.0, abs=2.5 * metres_a_pixel),
    )
    assert np.diff(np.flatnonzero(mask[80])).max() == 1


@pytest.mark.parametrize("pitch", [0.0, 0.2, -0.3])
def test_from_the_same_viewpoint_nothing_is_new(pitch):
    walls = (NEAR_WALL, FAR_WALL)
    eye = np.array([1.0, -2.0, HEIGHT])
    for azimuth in np.linspace(0.0, 2.0 * math.pi, 7):
        view = view_towards(eye, azimuth, pitch, focal=CAMERA.focal, window=CAMERA.window)
        mask = disocclusion_mask(rendered(view, walls, ground=True), view, captured_from(eye, walls, ground=True))
        assert not mask.any()


@settings(max_examples=15, deadline=None)
@given(st.floats(-8.0, 8.0), st.floats(-8.0, 8.0), st.floats(0.0, 6.2))
def test_open_ground_is_never_hidden_however_slanted(x, y, azimuth):
    view = level_view(np.array([x, y, HEIGHT]), azimuth, focal=CAMERA.focal, window=CAMERA.window)
    depth = rendered(view, ground=True)
    assert not disocclusion_mask(depth, view, captured_from((0.0, 0.0, HEIGHT), ground=True)).any()


def test_a_street_seen_along_its_walls_is_not_hidden():
    """Facades seen at a small angle, depths far apart from pixel to pixel: from nowhere in the street are they new."""
    walls = (((-6.0, -1e5), (-6.0, 1e5)), ((6.0, -1e5), (6.0, 1e5)))
    for y in (-9.0, 0.5, 9.0):
        view = level_view(np.array([2.0, y, HEIGHT]), math.pi / 2, focal=CAMERA.focal, window=CAMERA.window)
        depth = rendered(view, walls, ground=True)
        assert not disocclusion_mask(depth, view, captured_from((0.0, 0.0, HEIGHT), walls, ground=True)).any()


def test_points_that_no_window_contains_are_not_counted():
    """Behind a capture that looks the other way, points would project into its window mirrored, as if before its wall."""
    view = level_view(np.array([0.0, 0.0, HEIGHT]), math.pi / 2, focal=CAMERA.focal, window=CAMERA.window)
    depth = rendered(view, (FAR_WALL,))
    close = np.full(depth.shape, 0.5)
    ahead = level_view(view.eye, math.pi / 2, focal=CAMERA.focal, window=CAMERA.window)
    away = level_view(view.eye, -math.pi / 2, focal=CAMERA.focal, window=CAMERA.window)
    assert disocclusion_mask(depth, view, [(ahead, close)]).all()
    assert not disocclusion_mask(depth, view, [(away, close)]).any()
    assert not disocclusion_mask(depth, view, []).any()
    # A window of some rows: what is above and below is not counted.
    low = ahead.cropped((CAMERA.window[0], 20, CAMERA.width, 10))
    rows = np.flatnonzero(disocclusion_mask(depth, view, [(low, close[:10])]).all(axis=1))
    assert list(rows) == list(range(100, 110))


def test_one_window_that_sees_a_point_is_enough():
    view = level_view(np.array([0.0, 0.0, HEIGHT]), math.pi / 2, focal=CAMERA.focal, window=CAMERA.window)
    depth = rendered(view, (FAR_WALL,))
    hiding, seeing = (view, np.full(depth.shape, 0.5)), (view, depth)
    assert disocclusion_mask(depth, view, [hiding, hiding]).all()
    assert not disocclusion_mask(depth, view, [hiding, seeing]).any()
    assert not disocclusion_mask(depth, view, [seeing, hiding]).any()


def test_tolerance_is_metres_and_a_share_of_the_depth():
    view = level_view(np.array([0.0, 0.0, HEIGHT]), math.pi / 2, focal=CAMERA.focal, window=CAMERA.window)
    depth = np.full((CAMERA.height, CAMERA.width), 100.0)
    for nearer, expected in ((0.54, False), (0.56, True)):
        captured = [(view, depth - nearer)]
        assert disocclusion_mask(depth, view, captured).all() == expected
    assert disocclusion_mask(depth, view, [(view, depth - 0.06)], relative=0.0).all()
    assert not disocclusion_mask(depth, view, [(view, depth - 3.0)], tolerance=4.0).any()


@settings(deadline=None)
@given(
    st.integers(32, 200),
    st.integers(16, 64),
    st.floats(0.3, 2.9),
    st.lists(st.floats(-3.2, 3.2), min_size=1, max_size=20),
)
def test_a_panorama_leaves_no_gap(width, height, fov, azimuths):
    camera = Camera(width, height, fov)
    eye = np.array([3.0, -5.0, HEIGHT])
    views = panorama_views(eye, camera=camera)
    assert len(views) >= 2.0 * math.pi / fov - 1e-6
    assert len(views) < 2.0 * math.pi / fov + 1.0
    assert all(contained(eye, azimuth, views) for azimuth in azimuths)


def contained(eye, azimuth, views):
    """Whether a point 50 m ahead is hidden from captures that see nothing beyond half a metre: where one contains it."""
    captured = [(view, np.full(view.window[:1:-1], 0.5)) for view in views]
    view = level_view(eye, azimuth, focal=1e18, window=(0, 0, 1, 1))
    return disocclusion_mask(np.full((1, 1), 50.0), view, captured).all()


@pytest.mark.parametrize("width", [60, 61])
def test_nothing_falls_between_abutting_windows(width):
    eye = np.array([3.0, -5.0, HEIGHT])
    for count in (*range(3, 13), 61):
        views = panorama_views(eye, camera=Camera(width, 20, 2.0 * math.pi / count))
        assert len(views) == count
        assert all(contained(eye, (2 * i + 1) * math.pi / count, views) for i in range(count))


def test_sixty_degrees_take_six_views():
    views = panorama_views(np.zeros(3), camera=Camera(512, 512, math.radians(60.0)))
    assert len(views) == 6
    assert {view.window for view in views} == {(-256, -256, 512, 512)}


def test_a_depth_of_another_size_is_refused():
    view = level_view(np.zeros(3), 0.0, focal=CAMERA.focal, window=CAMERA.window)
    right = np.ones((CAMERA.height, CAMERA.width))
    with pytest.raises(ValueError, match="240x160 pixels expected, found 160x240"):
        disocclusion_mask(right.T, view, [])
    with pytest.raises(ValueError, match="240x160 pixels expected, found 240x80"):
        disocclusion_mask(right, view, [(view, right[:80])])
