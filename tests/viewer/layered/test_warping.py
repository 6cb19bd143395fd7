import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from placed_pictures import apart, hits, picture_of, view_at

from viewer.layered.layered_image import HALF, NOTHING
from viewer.layered.merging import merged
from viewer.layered.viewpoints import construction_views
from viewer.layered.warping import REACH, between, warped

RADIUS = 4.0


def image_of(sheets, count=9):
    return merged(
        [picture_of(view, sheets) for view in construction_views(view_at(), 8.0, RADIUS, count, sheets.points)],
        radius=RADIUS,
    )


def z_buffered(image, view):
    """The same patches, each against all pixels' centres, and the nearest kept: no order, no bounds. Without closing cracks."""
    matrix = between(image.view, view)
    width, height = view.window[2:]
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    depth, ids = np.full((height, width), np.inf), np.full((height, width), NOTHING)
    second = np.full((height, width), np.inf)
    pixels = np.repeat(np.arange(len(image.starts) - 1), np.diff(image.starts))
    for k, pixel in enumerate(pixels):
        u, v = pixel % image.view.window[2] + 0.5, pixel // image.view.window[2] + 0.5
        near, slope = 1.0 / float(image.depths[k]), image.slopes[k].astype(float)
        h = matrix @ [u, v, 1.0, near]
        a, b = matrix @ [1.0, 0.0, 0.0, slope[0]], matrix @ [0.0, 1.0, 0.0, slope[1]]
        left, right, up, down = 0.5 * image.reaches[k] / HALF + REACH - 0.5
        if not h[2] > REACH * (abs(a[2]) + abs(b[2])):
            continue
        with np.errstate(all="ignore"):
            s, t, one = np.einsum(
                "ij,j...->i...", np.linalg.inv(np.column_stack([a, b, h])), np.array([x, y, np.ones_like(x)])
            )
            s, t = s / one, t / one
            there = near + s * slope[0] + t * slope[1]
            found = (h[2] + s * a[2] + t * b[2]) / there
        inside = (-left <= s) & (s <= right) & (-up <= t) & (t <= down) & (there > 0.0)
        found = np.where(inside, found, np.inf)
        second = np.where(found < depth, depth, np.minimum(second, found))
        ids = np.where(found < depth, image.ids[k], ids)
        depth = np.minimum(depth, found)
    return depth, ids, second


def test_points_go_where_views_project_them():
    one, other = (
        view_at((1.0, 2.0, 3.0), 0.4, 0.1),
        view_at((0.0, 2.5, 2.0), 0.6, -0.2, window=(-30, -10, 50, 33), focal=61.0),
    )
    points = np.random.default_rng(0).uniform((8.0, -3.0, 0.0), (20.0, 10.0, 6.0), (50, 3))
    x, y, depth = one.project(points).T
    left, top = one.window[:2]
    found = between(one, other) @ np.array([x - left, y - top, np.ones(50), 1.0 / depth])
    left, top = other.window[:2]
    assert np.column_stack([found[0] / found[2] + left, found[1] / found[2] + top, found[2] * depth]) == pytest.approx(
        other.project(points)
    )


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_to_the_own_view_it_is_the_first_picture(seed):
    sheets = apart(np.random.default_rng(seed), 5)
    picture = picture_of(view_at(), sheets)
    found = warped(image_of(sheets), view_at())
    assert np.array_equal(found.ids, picture.ids)
    assert np.array_equal(found.color, picture.color)
    there = picture.ids != NOTHING
    assert found.depth[there] == pytest.approx(picture.depth[there], rel=1e-6)
    assert np.isinf(found.depth[~there]).all()


EYES = st.tuples(
    st.floats(-3.0, 4.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.floats(-0.4, 0.4), st.floats(-0.3, 0.3)
)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), EYES)
def test_the_order_alone_shows_what_is_nearest(seed, eye):
    image = image_of(apart(np.random.default_rng(seed), 4))
    view = view_at(eye[:3], *eye[3:])
    found = warped(image, view)
    depth, ids, second = z_buffered(image, view)
    # Patches reach a little over pixels' borders so that they meet: what is within that may be covered by a neighbour.
    clear = (second > depth * 1.02) & np.isfinite(depth)
    off = (found.ids != ids) & clear
    assert off.mean() < 0.002
    same = clear & ~off
    assert found.depth[same] == pytest.approx(depth[same], rel=1e-3)
    assert not (np.isfinite(depth) & ~np.isfinite(found.depth)).any()


@pytest.mark.parametrize("eye", [(3.0, 1.0, 1.0), (-3.0, 1.0, -1.0), (0.0, 2.0, 0.5)])
def test_what_no_picture_missed_is_seen_as_it_is(eye):
    """One large sheet, slanted: wherever the eye is, no crack is in it, and depths are those of the sheet."""
    rng = np.random.default_rng(5)
    one = apart(rng, 1)
    large = type(one)(one.corners - 3.0 * one.sides.sum(axis=1), 7.0 * one.sides)
    image, view = image_of(large, 1), view_at(eye)
    truth = picture_of(view, large)
    found = warped(image, view)
    u, v = np.meshgrid(*view.pixel_centres())
    margin = np.stack([hits(view, large, u + dx, v + dy)[0] for dx in (-3, 3) for dy in (-3, 3)])
    left, top, width, height = view_at().window
    points = view.unproject(u, v, np.where(np.isfinite(truth.depth), truth.depth, 1.0).astype(np.float64))
    x, y, _ = np.moveaxis(view_at().project(points), -1, 0)
    seen = (x > left + 1) & (x < left + width - 1) & (y > top + 1) & (y < top + height - 1)
    inside = np.isfinite(margin).all(axis=0) & np.isfinite(truth.depth) & seen
    assert inside.sum() > 200
    assert (found.ids[inside] == 0).all()
    assert found.depth[inside] == pytest.approx(truth.depth[inside], rel=1e-3)


@pytest.mark.parametrize("threads", [2, 3, 40])
def test_threads_change_nothing(threads):
    image, view = image_of(apart(np.random.default_rng(2), 5)), view_at((2.0, 1.0, -1.0), 0.1)
    for one, other in zip(warped(image, view), warped(image, view, threads=threads), strict=True):
        assert np.array_equal(one, other)


def test_an_eye_amid_the_samples_is_no_error():
    image = image_of(apart(np.random.default_rng(4), 5))
    for x in (12.0, 20.0, 60.0):
        found = warped(image, view_at((x, 0.3, 0.2), np.pi if x > 15.0 else 0.0))
        assert (found.depth > 0.0).all()
        assert np.array_equal(np.isfinite(found.depth), found.ids != NOTHING)
