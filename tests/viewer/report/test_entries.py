"""What reports say of a comparison, value by value."""

import pytest

from viewer.plan import Done, Work
from viewer.report.entries import gpu_times, technique_of
from viewer.techniques.catalogue import TECHNIQUES


def test_times_of_the_gpu_are_told_for_all_pictures_or_not_at_all():
    assert gpu_times([0.002, 0.004])["p50"] == 3.0
    assert gpu_times([0.002, None]) is None, "a share of the pictures is no sample of them"
    assert gpu_times([None]) is None


def test_what_is_sent_and_captured_is_the_mean_of_frames_and_late_is_more_than_a_tenth_over():
    """Of four frames one captures something, and one takes more than 1.1 times 20 ms."""
    drawn = Done(draws=Work(0.01, 100, 4))
    capturing = Done(Work(0.01, 1000, 3, requests=2, pixels=4096), Work(0.01, 100, 4))
    told = technique_of(
        TECHNIQUES["multi-mesh"],
        None,
        seconds=[0.01, 0.02, 0.0215, 0.0225],
        gpu=[None] * 4,
        done=[drawn, drawn, drawn, capturing],
        target=0.02,
    )
    assert told["late_share"] == 0.25
    sent = {name: told[name] for name in ("triangles", "draws", "requests", "captured_pixels")}
    assert sent == pytest.approx({"triangles": 350.0, "draws": 4.75, "requests": 0.5, "captured_pixels": 1024.0})
