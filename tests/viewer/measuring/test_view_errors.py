import dataclasses

import flip_evaluator
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from mmi.foundation.thickness import thickness
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.measuring.view_errors import beyond_resampling, flip_map, pop, psnr, ssim, view_errors, wrong_regions


def frame(ids, *, displacement=None, color=None):
    ids = np.asarray(ids, dtype=np.int32)
    moved = np.full(ids.shape, np.nan, dtype=np.float32) if displacement is None else displacement
    picture = np.zeros((*ids.shape, 3), dtype=np.uint8) if color is None else color
    return DrawnPicture(picture, ids, np.ones(ids.shape, dtype=np.float32), moved, 0.0, None, 0, 0)


def plain(color, size=(16, 20)):
    return np.broadcast_to(np.array(color, dtype=np.uint8), (*size, 3)).copy()


def noise(seed, size=(40, 50)):
    return np.random.default_rng(seed).integers(0, 256, (*size, 3), dtype=np.uint8)


def errors_of(truth, shown, **options):
    """Without FLIP, for what object ids tell."""
    return view_errors(frame(truth), frame(shown), focal=100.0, flip=False, **options)


# ------------------------------------------------------------------------------------------------------- thickness


@given(st.integers(1, 12), st.integers(1, 30), st.integers(0, 5), st.integers(0, 5))
def test_a_rectangle_is_as_thick_as_its_shorter_side(short, more, row, column):
    region = np.zeros((50, 60), dtype=bool)
    region[row : row + short, column : column + short + more] = True
    assert thickness(region) == short
    assert thickness(region.T) == short


@given(st.floats(2.0, 30.0), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_a_disc_is_as_thick_as_its_diameter_but_for_the_steps_of_its_edge(diameter, right, down):
    y, x = np.mgrid[:40, :40]
    region = np.hypot(x - 20 - right, y - 20 - down) <= diameter / 2
    # A pixel reaches half a diagonal from its centre, and centres of discs are tried half a pixel apart.
    assert diameter - 1.5 * np.sqrt(2) <= thickness(region) <= diameter + np.sqrt(2)


def test_a_disc_of_seven_pixels_is_seven_where_it_takes_all_that_it_touches():
    y, x = np.mgrid[-10:11, -10:11]
    nearest = np.hypot(np.maximum(np.abs(x) - 0.5, 0.0), np.maximum(np.abs(y) - 0.5, 0.0))
    assert thickness(nearest < 3.5) == 7.0
    # Of the pixels whose centres it covers, a smaller disc is all that fits: to the corner at (2.5, 1.5).
    assert thickness(np.hypot(x, y) < 3.6) == pytest.approx(2 * np.hypot(2.5, 1.5))


def test_many_thin_lines_are_thin():
    region = np.zeros((40, 40), dtype=bool)
    region[::2] = True
    assert thickness(region) == 1.0
    assert thickness(np.zeros((4, 4), dtype=bool)) == 0.0


def test_a_long_strip_two_pixels_wide_is_two_thick():
    truth = np.full((40, 120), 3)
    shown = truth.copy()
    shown[20:22, 10:110] = -2
    assert errors_of(truth, shown).thickness_px == 2.0


def test_a_region_at_the_border_counts_as_far_as_it_is_seen():
    region = np.zeros((30, 40), dtype=bool)
    region[:5, -9:] = True
    assert thickness(region) == 5.0
    assert thickness(np.ones((30, 40), dtype=bool)) == 30.0
    assert thickness(np.ones((1, 1), dtype=bool)) == 1.0


# --------------------------------------------------------------------------------------------------- wrong surfaces


def test_a_hole_of_seven_pixels_is_seven_pixels():
    truth = np.full((40, 50), 3)
    shown = truth.copy()
    shown[10:17, 20:27] = -1
    errors = errors_of(truth, shown)
    assert errors.thickness_px == 7.0
    assert errors.hole_share == errors.wrong_share == pytest.approx(49 / 2000)


def test_a_wrong_object_is_no_hole_and_neither_is_the_sky():
    truth, shown = np.full((10, 10), 3), np.full((10, 10), 3)
    shown[0, :5] = 8
    truth[1, :5] = -1
    errors = errors_of(truth, shown)
    assert (errors.hole_share, errors.wrong_share) == (0.0, 0.1)


def test_a_picture_shifted_by_three_pixels_is_wrong_in_strips_of_three():
    truth = np.tile(np.repeat(np.arange(6), 10), (50, 1))
    shown = np.roll(truth, 3, axis=1)
    errors = errors_of(truth, shown)
    assert errors.thickness_px == 3.0
    assert errors.wrong_share == pytest.approx(6 * 3 / 60)
    assert errors.hole_share == 0.0


def test_the_regions_are_those_that_the_figures_tell():
    ids = np.random.default_rng(1).integers(-2, 3, (2, 30, 40))
    truth, shown = frame(ids[0]), frame(ids[1])
    regions, errors = wrong_regions(truth, shown), view_errors(truth, shown, focal=100.0, flip=False)
    assert regions.wrong.mean() == errors.wrong_share
    assert regions.holes.mean() == errors.hole_share
    assert (regions.wrong >= regions.holes).all()
    assert thickness(regions.wrong) == errors.thickness_px
    for (row, column), wrong in np.ndenumerate(regions.wrong):
        a, b = ids[:, row, column]
        assert (wrong, regions.holes[row, column]) == (a != b, a >= 0 > b)
    with pytest.raises(ValueError, match="read-only"):
        regions.wrong[0, 0] = True


def test_wrong_objects_in_the_right_colours_are_wrong_and_look_alike():
    picture = noise(1)
    truth, shown = np.zeros((40, 50)), np.zeros((40, 50))
    shown[5:15, 5:15] = 7
    errors = view_errors(frame(truth, color=picture), frame(shown, color=picture), focal=100.0)
    assert (errors.wrong_share, errors.thickness_px) == (0.05, 10.0)
    assert (errors.flip_mean, errors.flip_p95, errors.ssim) == (0.0, 0.0, 1.0)
    assert errors.psnr_db == float("inf")


def test_right_objects_in_wrong_colours_are_right_and_look_different():
    ids, picture = np.zeros((40, 50)), noise(1)
    errors = view_errors(frame(ids, color=picture), frame(ids, color=255 - picture), focal=100.0)
    assert errors.wrong_share == errors.hole_share == errors.thickness_px == 0.0
    assert errors.flip_mean > 0.3
    assert errors.ssim < 0.2


# ----------------------------------------------------------------------------------------------- beyond resampling


def stripes(width, shift, size=(40, 60)):
    """Vertical stripes ``width`` pixels wide, each an object of its own, moved ``shift`` pixels to the right."""
    return np.tile((np.arange(size[1]) - shift) // width + 100, (size[0], 1))


def beyond(truth, shown):
    return beyond_resampling(frame(truth), frame(shown))


@pytest.mark.parametrize("width", [1, 2, 3, 10])
def test_stripes_that_are_off_by_a_pixel_are_forgiven(width):
    truth, shown = stripes(width, 0), stripes(width, 1)
    inside = np.s_[:, 1:-1]  # what comes in from outside the picture, the geometry does not show
    assert (truth != shown)[inside].any()
    assert not beyond(truth, shown).wrong[inside].any()
    assert not beyond(truth.T, shown.T).wrong[1:-1].any()
    assert thickness(beyond(truth, shown).wrong) <= 1.0


@pytest.mark.parametrize("width", [1, 2, 3, 10])
@pytest.mark.parametrize("shift", [2, -2, 3])
def test_stripes_that_are_off_by_two_pixels_are_as_wrong_as_before(width, shift):
    truth, shown = stripes(width, 0), stripes(width, shift)
    assert np.array_equal(beyond(truth, shown).wrong, truth != shown)
    assert np.array_equal(beyond(truth.T, shown.T).wrong, (truth != shown).T)
    assert thickness(beyond(truth, shown).wrong) >= min(abs(shift), width)


def test_houses_a_pixel_wide_that_are_off_by_a_pixel_are_thick_and_forgiven():
    """What the measure is for: side by side they form a region, and none is off by more than a pixel."""
    truth = np.full((40, 60), -1)
    truth[10:30, 20:25] = np.arange(5)
    truth[10:30, 25:40], truth[10:30, 5:20] = 50, 60
    shown = truth.copy()
    shown[:, 6:41] = truth[:, 5:40]
    assert errors_of(truth, shown).thickness_px == 6.0
    assert not beyond(truth, shown).wrong.any()


@pytest.mark.parametrize("through", [-1, -2, 7])
def test_a_hole_of_seven_pixels_stays_seven_pixels(through):
    truth = np.full((40, 50), 3)
    truth[:3] = -1  # sky, ground and the other object are in the picture, but not next to the hole
    truth[-3:], truth[:, :3] = -2, 7
    shown = truth.copy()
    shown[10:17, 20:27] = through
    found = beyond(truth, shown)
    assert thickness(found.wrong) == 7.0
    assert found.wrong.sum() == 49
    assert np.array_equal(found.holes, found.wrong & (through < 0))


def test_an_outline_against_the_sky_may_be_off_by_a_pixel_and_not_by_two():
    truth = np.full((40, 50), -1)
    truth[20:, :] = 3
    for lower, wrong in ((1, 0), (-1, 0), (2, 2 * 50), (-2, 2 * 50)):
        shown = np.full((40, 50), -1)
        shown[20 + lower :, :] = 3
        found = beyond(truth, shown)
        assert (found.wrong.sum(), found.holes.sum()) == (wrong, wrong if lower > 0 else 0)


def test_an_object_that_is_lacking_or_invented_is_not_forgiven_however_thin_it_is():
    truth, shown = np.full((40, 50), 3), np.full((40, 50), 3)
    truth[:, 30] = 8
    shown[:, 10:12] = 9
    for a, b in ((truth, shown), (shown, truth)):
        assert np.array_equal(beyond(a, b).wrong, truth != shown)


def test_a_slanted_edge_may_be_off_by_a_pixel_both_ways():
    y, x = np.mgrid[:40, :40]
    truth = np.where(x < y, 3, 4)
    for right, wrong in ((1, False), (2, False), (3, True)):
        assert beyond(truth, np.where(x - right < y, 3, 4)).wrong[5:-5, 5:-5].any() == wrong


def test_an_object_that_is_off_by_its_width_loses_a_pixel_where_both_places_meet():
    """The limit of the measure: of eight wrong pixels in a row, the two in the middle could be an edge that is one off."""
    truth, shown = np.full((40, 50), 3), np.full((40, 50), 3)
    truth[:, 10:14] = shown[:, 14:18] = 4
    assert errors_of(truth, shown).thickness_px == 8.0
    found = beyond(truth, shown)
    assert np.flatnonzero(found.wrong[20]).tolist() == [10, 11, 12, 15, 16, 17]
    assert thickness(found.wrong) == 3.0


@given(st.integers(0, 10_000), st.integers(1, 9), st.integers(1, 9), st.integers(2, 30))
def test_what_is_forgiven_is_what_the_definition_says(seed, height, width, objects):
    truth, shown = np.random.default_rng(seed).integers(-2, objects, (2, height, width))
    found = beyond(truth, shown)
    for (row, column), wrong in np.ndenumerate(found.wrong):
        around = np.s_[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
        a, b = truth[row, column], shown[row, column]
        forgiven = a in shown[around] and b in truth[around]
        assert (wrong, found.holes[row, column]) == (a != b and not forgiven, a >= 0 > b and not forgiven)
    swapped = beyond(shown, truth)
    assert np.array_equal(found.wrong, swapped.wrong)


def test_unmeasured_frames_and_frames_of_two_sizes_are_not_compared():
    measured = frame(np.zeros((4, 5)))
    with pytest.raises(ValueError, match="object ids"):
        beyond_resampling(measured, dataclasses.replace(measured, object_ids=None))
    with pytest.raises(ValueError, match="one size"):
        beyond_resampling(measured, frame(np.zeros((5, 4))))


# ----------------------------------------------------------------------------------------------------- displacement


def test_displacement_in_pixels_of_known_shifts():
    moved = np.full((10, 10), np.nan, dtype=np.float32)
    moved[4, :] = np.arctan(np.arange(10) / 443.4)
    errors = view_errors(
        frame(np.zeros((10, 10))), frame(np.zeros((10, 10)), displacement=moved), focal=443.4, flip=False
    )
    assert errors.displacement_p50_px == pytest.approx(4.5, rel=1e-5)
    assert errors.displacement_p99_px == pytest.approx(8.91, rel=1e-5)
    assert errors.displacement_max_px == pytest.approx(9.0, rel=1e-5)
    assert errors.wrong_share == 0.0


def test_pixels_without_an_impostor_have_no_displacement():
    moved = np.full((10, 10), np.nan, dtype=np.float32)
    moved[0, 0] = np.arctan(0.02)
    some = view_errors(
        frame(np.zeros((10, 10))), frame(np.zeros((10, 10)), displacement=moved), focal=100.0, flip=False
    )
    assert some.displacement_p50_px == some.displacement_max_px == pytest.approx(2.0, rel=1e-5)
    none = errors_of(np.zeros((10, 10)), np.zeros((10, 10)))
    assert none.displacement_p50_px == none.displacement_p99_px == none.displacement_max_px == 0.0


# ------------------------------------------------------------------------------------------------- pictures: FLIP


def test_flip_is_that_of_the_same_pictures_in_files(tmp_path):
    a, b = noise(1, (24, 30)), noise(2, (24, 30))
    for name, picture in (("a.png", a), ("b.png", b)):
        Image.fromarray(picture).save(tmp_path / name)
    expected, mean, _ = flip_evaluator.evaluate(
        str(tmp_path / "a.png"), str(tmp_path / "b.png"), "LDR", applyMagma=False
    )
    assert flip_map(a, b) == pytest.approx(expected[..., 0], abs=1e-6)
    errors = view_errors(frame(np.zeros((24, 30)), color=a), frame(np.zeros((24, 30)), color=b), focal=100.0)
    assert errors.flip_mean == pytest.approx(mean, abs=1e-5)
    assert errors.flip_p95 == pytest.approx(np.percentile(expected, 95), abs=1e-6)


def test_flip_takes_red_for_red():
    """Green and blue are the farthest colours there are: what FLIP calls 1 (Andersson et al. 2020)."""
    red, green, blue = plain((255, 0, 0)), plain((0, 255, 0)), plain((0, 0, 255))
    assert flip_map(green, blue) == pytest.approx(1.0, abs=1e-4)
    # With red and blue exchanged, the first of these would be the last.
    assert flip_map(red, green).mean() == pytest.approx(0.98667, abs=1e-4)
    assert flip_map(red, green).mean() < flip_map(green, blue).mean() - 0.01


def test_flip_where_disoccluded():
    ids = np.zeros((60, 80))
    truth = plain((100, 100, 100), (60, 80))
    shown = truth.copy()
    shown[20:40, 30:50] = 255
    mask = np.zeros((60, 80), dtype=bool)
    mask[25:35, 35:45] = True
    errors = view_errors(frame(ids, color=truth), frame(ids, color=shown), focal=100.0, disoccluded=mask)
    assert errors.flip_masked == pytest.approx(flip_map(truth, shown)[25:35, 35:45].mean(), rel=1e-6)
    assert errors.flip_masked > 4 * errors.flip_mean
    for nothing in (None, np.zeros((60, 80), dtype=bool)):
        empty = view_errors(frame(ids, color=truth), frame(ids, color=shown), focal=100.0, disoccluded=nothing)
        assert empty == dataclasses.replace(errors, flip_masked=None)


def test_without_flip_all_else_is_the_same():
    truth, shown = frame(np.zeros((40, 50)), color=noise(1)), frame(np.ones((40, 50)), color=noise(2))
    mask = np.ones((40, 50), dtype=bool)
    whole = view_errors(truth, shown, focal=100.0, disoccluded=mask)
    quick = view_errors(truth, shown, focal=100.0, disoccluded=mask, flip=False)
    assert quick == dataclasses.replace(whole, flip_mean=None, flip_p95=None, flip_masked=None)
    assert whole.flip_masked == pytest.approx(whole.flip_mean)


def test_pop_is_what_the_technique_changes_beyond_the_motion():
    a, b, c = (frame(np.zeros((40, 50)), color=noise(seed)) for seed in (1, 2, 3))
    change = float(flip_map(a.color, b.color).mean())
    assert pop(a, b, c, c) == pytest.approx(change, rel=1e-6)
    assert pop(c, c, a, b) == pytest.approx(-change, rel=1e-6)
    assert pop(a, b, a, b) == 0.0


# --------------------------------------------------------------------------------------------- pictures: SSIM, PSNR


def test_psnr_of_a_known_difference():
    a = np.full((4, 4, 3), 100, dtype=np.uint8)
    assert psnr(a, a) == float("inf")
    assert psnr(a, a + 10) == pytest.approx(20 * np.log10(25.5))


@pytest.mark.parametrize("size", [(16, 20), (11, 11), (3, 40), (1, 1)])
def test_ssim_of_plain_pictures(size):
    """No variance: what is left of SSIM is (2 a b + C) / (a^2 + b^2 + C) with C = (0.01 * 255)^2."""
    a, b, c = 100.0, 160.0, 2.55**2
    expected = (2 * a * b + c) / (a * a + b * b + c)
    assert ssim(plain((100, 100, 100), size), plain((160, 160, 160), size)) == pytest.approx(expected, rel=1e-6)
    one_channel = ssim(plain((100, 100, 100), size), plain((160, 100, 100), size))
    assert one_channel == pytest.approx((expected + 2.0) / 3.0, rel=1e-6)


def test_ssim_of_one_window():
    """Weighted means, variances and covariance of the 11 x 11 window, written out (Wang et al. 2004, eq. 13 to 16)."""
    a, b = noise(1, (11, 11)), noise(2, (11, 11))
    bell = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    weights = np.outer(bell, bell) / bell.sum() ** 2
    values = []
    for channel in range(3):
        x, y = a[..., channel].astype(float), b[..., channel].astype(float)
        mx, my = (weights * x).sum(), (weights * y).sum()
        vx, vy = (weights * (x - mx) ** 2).sum(), (weights * (y - my) ** 2).sum()
        vxy = (weights * (x - mx) * (y - my)).sum()
        c, d = 2.55**2, 7.65**2
        values.append((2 * mx * my + c) * (2 * vxy + d) / ((mx * mx + my * my + c) * (vx + vy + d)))
    assert ssim(a, b) == pytest.approx(np.mean(values), rel=1e-6)


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 13), st.integers(1, 13))
def test_pictures_smaller_than_any_window_are_measured(height, width):
    a, b = noise(1, (height, width)), noise(2, (height, width))
    ids = np.zeros((height, width))
    same = view_errors(frame(ids, color=a), frame(ids, color=a), focal=100.0)
    assert (same.flip_mean, same.ssim) == (0.0, pytest.approx(1.0))
    other = view_errors(frame(ids, color=a), frame(ids, color=b), focal=100.0)
    assert 0.0 < other.flip_mean <= 1.0
    assert -1.0 <= other.ssim < 1.0


# ------------------------------------------------------------------------------------------------------ what is refused


def test_frames_must_be_measured_and_of_one_size():
    ids = np.zeros((3, 3), dtype=np.int32)
    blind = DrawnPicture(np.zeros((3, 3, 3), dtype=np.uint8), None, None, None, 0.0, None, 0, 0)
    with pytest.raises(ValueError, match="measured"):
        view_errors(frame(ids), blind, focal=1.0)
    with pytest.raises(ValueError, match="without displacement"):
        view_errors(frame(ids), dataclasses.replace(frame(ids), displacement=None), focal=1.0)
    with pytest.raises(ValueError, match="one size"):
        view_errors(frame(ids), frame(np.zeros((4, 4))), focal=1.0)
    with pytest.raises(ValueError, match=r"color of size \(3, 3\)"):
        view_errors(frame(ids), frame(ids, color=np.empty((0, 0, 3), dtype=np.uint8)), focal=1.0)
    with pytest.raises(ValueError, match=r"disoccluded of size \(3, 3\)"):
        view_errors(frame(ids), frame(ids), focal=1.0, disoccluded=np.ones((3, 4), dtype=bool))
    with pytest.raises(ValueError, match="one size"):
        flip_map(plain((0, 0, 0)), plain((0, 0, 0), (3, 3)))
