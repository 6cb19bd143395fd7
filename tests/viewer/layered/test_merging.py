from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from placed_pictures import Sheets, apart, hits, picture_of, view_at
from scipy.ndimage import binary_dilation

from viewer.layered import merging
from viewer.layered.layered_image import HALF
from viewer.layered.merging import merged, slopes_of
from viewer.layered.viewpoints import construction_views
from viewer.layered.warping import warped

RADIUS = 4.0


def nine(sheets):
    return [picture_of(view, sheets) for view in construction_views(view_at(), 8.0, RADIUS, 9, sheets.points)]


def layers(image):
    """The samples of each pixel: (pixel, object, depth)."""
    pixels = np.repeat(np.arange(len(image.starts) - 1), np.diff(image.starts))
    return list(zip(pixels, image.ids, image.depths, strict=True))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_first_layer_is_the_first_picture(seed):
    sheets = apart(np.random.default_rng(seed), 5)
    pictures = nine(sheets)
    image = merged(pictures, radius=RADIUS)
    first, there = image.starts[:-1], image.counts.ravel() > 0
    own = pictures[0]
    assert np.array_equal(there, np.isfinite(own.depth).ravel())
    assert image.depths[first[there]] == pytest.approx(own.depth.ravel()[there], rel=1e-6)
    assert np.array_equal(image.ids[first[there]], own.ids.ravel()[there])
    assert np.array_equal(image.colors[first[there]], own.color.reshape(-1, 3)[there])


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_samples_lie_on_what_rays_meet_and_none_is_there_twice(seed):
    sheets = apart(np.random.default_rng(seed), 5)
    image = merged(nine(sheets), radius=RADIUS)
    view = image.view
    u, v = np.meshgrid(*view.pixel_centres())
    # A pixel of a construction picture may reach over a sheet's border by half of it: sheets that go on there.
    larger = type(sheets)(sheets.corners - sheets.sides.sum(axis=1), 3.0 * sheets.sides)
    depths = hits(view, larger, u, v).reshape(5, -1)
    found = layers(image)
    for pixel, one, depth in found:
        assert depth == pytest.approx(depths[one, pixel], rel=0.02)
    assert len({(pixel, one) for pixel, one, _ in found}) == len(found)
    same = np.diff(np.repeat(np.arange(len(image.starts) - 1), np.diff(image.starts))) == 0
    assert (np.diff(image.depths)[same] >= 0.0).all()


def test_each_pictures_samples_are_kept():
    """What any construction picture sees well within a sheet is there."""
    sheets = apart(np.random.default_rng(7), 5)
    pictures = nine(sheets)
    image = merged(pictures, radius=RADIUS)
    known = {(pixel, one) for pixel, one, _ in layers(image)}
    left, top, width, height = image.view.window
    for picture in pictures:
        u, v = np.meshgrid(*picture.view.pixel_centres())
        there = np.isfinite(picture.depth)
        points = picture.view.unproject(u[there], v[there], picture.depth[there].astype(np.float64))
        x, y, _ = np.moveaxis(image.view.project(points), -1, 0)
        columns, rows = np.floor(x).astype(int) - left, np.floor(y).astype(int) - top
        seen = 0
        for column, row, one in zip(columns, rows, picture.ids[there], strict=True):
            if 0 <= column < width and 0 <= row < height and np.isfinite(pictures[0].depth[row, column]):
                seen += (row * width + column, one) in known
        inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        covered = np.isfinite(pictures[0].depth[rows[inside], columns[inside]]).sum()
        assert seen >= 0.9 * covered


def test_slopes_are_those_of_planes():
    sheets = apart(np.random.default_rng(3), 1)
    picture = picture_of(view_at(), sheets)
    u, v = np.meshgrid(*picture.view.pixel_centres())
    endless = type(sheets)(sheets.corners - 50.0 * sheets.sides.sum(axis=1), 101.0 * sheets.sides)
    near = 1.0 / hits(picture.view, endless, u, v)[0]
    right, down = 1.0 / hits(picture.view, endless, u + 1.0, v)[0], 1.0 / hits(picture.view, endless, u, v + 1.0)[0]
    slopes, there = slopes_of(picture), np.isfinite(picture.depth)
    for axis, change in ((1, right - near), (0, down - near)):
        told = there & (np.roll(there, 1, axis) | np.roll(there, -1, axis))  # by a neighbour on the sheet
        assert told.sum() > 20
        assert slopes[told, 1 - axis] == pytest.approx(change[told], abs=1e-6)


def test_no_pictures_no_image():
    with pytest.raises(ValueError, match="pictures, radius and tolerance expected, found 0"):
        merged([], radius=1.0)
    with pytest.raises(ValueError, match=r"found 1, 0\.0"):
        merged([picture_of(view_at(), apart(np.random.default_rng(0), 1))], radius=0.0)


def test_patches_end_where_another_picture_sees_past_them():
    """A floor, of which the image has one row of pixels, each as long as half of it: from above it must not begin too early."""
    floor = Sheets(np.array([[12.0, -3.0, -0.5]]), np.array([[[18.0, 0.0, 0.0], [0.0, 6.0, 0.0]]]))
    image = merged(nine(floor), radius=RADIUS)
    above = view_at((2.0, 0.0, 2.5), 0.0, -0.2, focal=160.0, window=(-96, -72, 192, 144))
    truth, shown = picture_of(above, floor).ids >= 0, warped(image, above).ids >= 0
    assert shown.sum() > 0.5 * truth.sum() > 500
    about = binary_dilation(truth, np.ones((5, 5)))
    assert not (shown & ~about).any()
    whole = warped(replace(image, reaches=np.full_like(image.reaches, HALF)), above).ids >= 0
    assert (whole & ~about).sum() > 500


def test_a_pixel_has_no_more_samples_than_there_may_be(monkeypatch):
    monkeypatch.setattr(merging, "MOST_LAYERS", 1)
    sheets = apart(np.random.default_rng(3), 6)
    some = merged(nine(sheets), radius=RADIUS)
    monkeypatch.undo()
    whole = merged(nine(sheets), radius=RADIUS)
    assert some.counts.max() == 1 < whole.counts.max()
    assert np.array_equal(some.counts, np.minimum(whole.counts, 1))
    ranks = np.arange(len(whole.depths)) - np.repeat(whole.starts[:-1], np.diff(whole.starts))
    assert np.array_equal(some.depths, whole.depths[ranks < 1])
