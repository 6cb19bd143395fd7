import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from viewer.gl import Frame
from viewer.quality import psnr, thickness, view_errors


def frame(ids, *, displacement=None, color=None):
    ids = np.asarray(ids, dtype=np.int32)
    moved = np.zeros(ids.shape, dtype=np.float32) if displacement is None else displacement
    picture = np.zeros((*ids.shape, 3), dtype=np.uint8) if color is None else color
    return Frame(picture, ids, np.ones(ids.shape, dtype=np.float32), moved, 0.0, 0, 0)


@given(st.integers(1, 12), st.integers(1, 30), st.integers(0, 5), st.integers(0, 5))
def test_a_rectangle_is_as_thick_as_its_shorter_side(short, more, row, column):
    region = np.zeros((50, 60), dtype=bool)
    region[row : row + short, column : column + short + more] = True
    assert thickness(region) == short
    assert thickness(region.T) == short


def test_a_disc_is_as_thick_as_its_diameter():
    y, x = np.mgrid[:60, :60]
    assert thickness(np.hypot(x - 30, y - 30) <= 10.3) == pytest.approx(20.6, abs=1.2)


def test_many_thin_lines_are_thin():
    region = np.zeros((40, 40), dtype=bool)
    region[::2] = True
    assert thickness(region) == 1.0
    assert thickness(np.zeros((4, 4), dtype=bool)) == 0.0


def test_a_hole_of_seven_pixels_is_seven_pixels():
    truth = np.full((40, 50), 3)
    shown = truth.copy()
    shown[10:17, 20:27] = -1
    errors = view_errors(frame(truth), frame(shown), focal=100.0)
    assert errors.thickness_px == 7.0
    assert errors.hole_share == errors.wrong_share == pytest.approx(49 / 2000)


def test_a_wrong_object_is_no_hole_and_neither_is_the_sky():
    truth, shown = np.full((10, 10), 3), np.full((10, 10), 3)
    shown[0, :5] = 8
    truth[1, :5] = -1
    errors = view_errors(frame(truth), frame(shown), focal=100.0)
    assert (errors.hole_share, errors.wrong_share) == (0.0, 0.1)


def test_displacement_in_pixels():
    moved = np.zeros((10, 10), dtype=np.float32)
    moved[4, 4] = np.arctan(5.0 / 443.4)
    errors = view_errors(frame(np.zeros((10, 10))), frame(np.zeros((10, 10)), displacement=moved), focal=443.4)
    assert errors.displacement_px == pytest.approx(5.0, rel=1e-5)
    assert errors.wrong_share == 0.0


def test_psnr_of_a_known_difference():
    a = np.full((4, 4, 3), 100, dtype=np.uint8)
    assert psnr(a, a) == float("inf")
    assert psnr(a, a + 10) == pytest.approx(20 * np.log10(25.5))


def test_frames_must_be_measured_and_of_one_size():
    ids = np.zeros((3, 3), dtype=np.int32)
    blind = Frame(np.zeros((3, 3, 3), dtype=np.uint8), None, None, None, 0.0, 0, 0)
    with pytest.raises(ValueError, match="measured"):
        view_errors(frame(ids), blind, focal=1.0)
    with pytest.raises(ValueError, match="one size"):
        view_errors(frame(ids), frame(np.zeros((4, 4))), focal=1.0)
