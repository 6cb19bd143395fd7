"""What reports say of a comparison, value by value."""

from viewer.report.entries import gpu_times


def test_times_of_the_gpu_are_told_for_all_pictures_or_not_at_all():
    assert gpu_times([0.002, 0.004])["p50"] == 3.0
    assert gpu_times([0.002, None]) is None, "a share of the pictures is no sample of them"
    assert gpu_times([None]) is None
