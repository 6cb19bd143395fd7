"""Judging with pictures that nobody drew: who compares, in what order scores come, and what is said when a process dies."""

import os
import signal
import time

import numpy as np
import pytest

from mmi.foundation.errors import CaptureError
from mmi.walks.walk import Pose
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.measuring.judge import Judge
from viewer.plan import Plan

POSE = Pose((0.0, 0.0, 1.7), 0.0, 0.0)


def picture(wrong=0):
    """Of one object, all but the first ``wrong`` pixels, which show the sky."""
    ids = np.zeros((16, 16), dtype=np.int32)
    ids.ravel()[:wrong] = -1
    color = np.full((16, 16, 3), 90, dtype=np.uint8)
    return DrawnPicture(
        color, ids, np.ones((16, 16), np.float32), np.full((16, 16), np.nan, np.float32), 0.001, None, 1, 1
    )


class Painter:
    """Draws a picture that is wrong in one more pixel each time."""

    def __init__(self):
        self.drawn = 0

    def draw(self, plan, view, *, measured):  # noqa: ARG002
        self.drawn += 1
        return picture(self.drawn)


class Nothing:
    def want(self, cells):
        pass

    def require(self, cells):
        pass


def judge_of(scene, workers):
    return Judge(scene, Painter(), Nothing(), keep=2, flip=False, workers=workers)


def score(judge, times):
    truth = picture(), np.zeros((16, 16), dtype=bool)
    for _ in range(times):
        judge.score("multi-mesh", Plan(()), POSE, truth, cell="0001-01")


@pytest.mark.parametrize("workers", [1, 2])
def test_scores_come_in_the_order_in_which_they_were_asked_for(scene, workers):
    with judge_of(scene, workers) as judge:
        score(judge, 12)
        found = judge.results()
        kept = [view.scored.errors.hole_share for view in judge.worst("multi-mesh")]
    assert [one.errors.hole_share * 256 for one in found] == list(range(1, 13))
    assert kept == [12 / 256, 11 / 256]


def test_a_process_that_dies_is_told_of_with_its_reason(scene):
    with judge_of(scene, 2) as judge:
        assert len(judge._processes) == 2, "all are started at once, where Ctrl-C is held back"
        score(judge, 2)
        judge.results()
        os.kill(judge._processes[1].pid, signal.SIGKILL)
        end = time.monotonic() + 60.0
        with pytest.raises(CaptureError, match=r"ended unexpectedly \(by signal 9, which the system sends when memory"):
            while time.monotonic() < end:
                score(judge, 1)
                judge.results()
                time.sleep(0.01)
