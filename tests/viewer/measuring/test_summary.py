import dataclasses
import json

import pytest

from viewer.measuring.summary import frame_summary, settling_summary, summarise
from viewer.measuring.view_errors import ViewErrors


def errors(**changed):
    fields = {name.name: 0.0 for name in dataclasses.fields(ViewErrors)}
    return ViewErrors(**{**fields, **changed})


def test_shares_and_pictures_are_means_over_views():
    views = [
        errors(hole_share=0.0, wrong_share=0.1, ssim=0.9, flip_mean=0.1, flip_p95=0.2, psnr_db=30.0),
        errors(hole_share=0.02, wrong_share=0.3, ssim=0.7, flip_mean=0.3, flip_p95=0.6, psnr_db=40.0),
    ]
    entry = summarise(views)
    assert entry["hole_share"] == pytest.approx(0.01)
    assert entry["wrong_share"] == pytest.approx(0.2)
    assert entry["ssim"] == pytest.approx(0.8)
    assert entry["psnr_db"] == pytest.approx(35.0)
    assert entry["flip"] == {"mean": pytest.approx(0.2), "p95": pytest.approx(0.4), "masked": 0.0}


def test_thickness_is_spread_over_views():
    """Of 0, 1, ..., 100 the 99th percentile is 99; one thick view more moves the largest alone."""
    entry = summarise([errors(thickness_px=float(i)) for i in (*range(100), 400)])
    assert entry["wrong_thickness_px"] == {"p50": 50.0, "p99": 99.0, "max": 400.0}
    assert summarise([errors(thickness_px=1.0), errors(thickness_px=2.0)])["wrong_thickness_px"] == {
        "p50": 1.5,
        "p99": pytest.approx(1.99),
        "max": 2.0,
    }


def test_displacement_is_spread_over_what_views_call_p99():
    views = [
        errors(displacement_p50_px=0.5, displacement_p99_px=float(i), displacement_max_px=float(50 + i))
        for i in range(101)
    ]
    assert summarise(views)["displacement_px"] == {"p50": 50.0, "p99": 99.0, "max": 150.0}


def test_flip_masked_is_over_the_views_that_have_a_mask():
    views = [errors(flip_masked=None), errors(flip_masked=0.2), errors(flip_masked=0.4)]
    assert summarise(views)["flip"]["masked"] == pytest.approx(0.3)
    assert summarise(views[:1])["flip"] == {"mean": 0.0, "p95": 0.0, "masked": None}


def test_flip_that_was_not_asked_for_is_null():
    assert summarise([errors(flip_mean=None, flip_p95=None, flip_masked=None)])["flip"] is None


def test_equal_pictures_have_no_psnr():
    same, other = errors(psnr_db=float("inf")), errors(psnr_db=32.0)
    assert summarise([same, other, same])["psnr_db"] == 32.0
    assert summarise([same, same])["psnr_db"] is None
    assert summarise([same, same])["psnr_worst_db"] is None


def test_the_worst_psnr_is_the_lowest_of_a_view():
    views = [errors(psnr_db=one) for one in (50.0, 31.5, float("inf"), 44.5)]
    assert summarise(views)["psnr_worst_db"] == 31.5
    assert summarise(views)["psnr_db"] == pytest.approx(42.0)


def test_when_views_settled_is_told_of_those_that_did():
    """Ten views, held for 8 frames: 0 to 6 frames, and three that had not settled."""
    found = settling_summary([*range(7), None, None, None], [2] * 10, [3] * 7 + [7, 8, 9], held=8)
    assert found["alike_frames"] == {"p50": 3.0, "p99": pytest.approx(5.94), "max": 6.0}
    assert found["settled_frames"] == {"p50": 2.0, "p99": 2.0, "max": 2.0}
    assert (found["unlike"], found["unsettled"]) == (3, 0)
    assert found["layers"] == {"p50": 3.0, "max": 9.0}
    # 4, 5 and 6 frames for 3 layers; and the view of 7 layers that took 8 frames at least. The others may yet.
    assert found["later_than_layers"] == 4


def test_views_of_which_none_settled_have_no_quantiles():
    found = settling_summary([None], [None], [0], held=1)
    assert found == {
        "alike_frames": None,
        "unlike": 1,
        "settled_frames": None,
        "unsettled": 1,
        "layers": {"p50": 0.0, "max": 0.0},
        "later_than_layers": 1,
    }


def test_frame_times_in_milliseconds():
    """0, 1, ..., 100 ms in any order."""
    seconds = [((37 * i) % 101) * 1e-3 for i in range(101)]
    expected = {"p50": 50.0, "p95": 95.0, "p99": 99.0, "max": 100.0}
    assert frame_summary(seconds) == {name: pytest.approx(value) for name, value in expected.items()}
    assert frame_summary([0.02]) == {"p50": 20.0, "p95": 20.0, "p99": 20.0, "max": 20.0}


def test_all_is_ready_for_json():
    whole = {
        "errors": summarise([errors(psnr_db=float("inf"), flip_masked=None), errors()]),
        "times": frame_summary([0.01, 0.02]),
        "settling": settling_summary([1, None], [1, None], [2, 3], held=2),
    }
    assert json.loads(json.dumps(whole, allow_nan=False)) == whole


def test_nothing_to_summarise_is_refused():
    with pytest.raises(ValueError, match="one view at least"):
        summarise([])
    with pytest.raises(ValueError, match="one view at least"):
        settling_summary([], [], [], held=1)
    with pytest.raises(ValueError, match="one frame at least"):
        frame_summary([])
