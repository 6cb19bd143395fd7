"""Jobs in a thread of their own: order, errors, a bounded number, giving up, and answers that come in time."""

import threading
import time
from concurrent.futures import Future

import pytest

from mmi.foundation.errors import ParameterError
from viewer.window.answers.background import Background, within


@pytest.fixture
def background():
    made = Background("test")
    yield made
    made.close()


def test_jobs_are_done_one_after_the_other_elsewhere(background):
    done = []
    futures = [background.submit(lambda i=i: done.append((i, threading.current_thread().name)) or i) for i in range(9)]
    assert [one.result(5.0) for one in futures] == list(range(9))
    assert done == [(i, "test") for i in range(9)]


def test_what_a_job_raises_is_told_and_the_next_one_is_done(background):
    failed = background.submit(lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        failed.result(5.0)
    assert background.submit(lambda: 7).result(5.0) == 7


def test_too_many_are_refused_and_a_cancelled_one_is_not_begun(background):
    started, go = threading.Event(), threading.Event()
    first = background.submit(lambda: started.set() or go.wait(5.0))
    started.wait(5.0)
    begun = []
    waiting = [background.submit(lambda i=i: begun.append(i)) for i in range(16)]
    with pytest.raises(ParameterError, match="at most 16 at a time"):
        background.submit(lambda: None)
    assert waiting[3].cancel()
    go.set()
    assert first.result(5.0)
    waiting[-1].result(5.0)
    assert begun == [i for i in range(16) if i != 3]


def test_closing_cancels_what_waits_and_does_not_wait(background):
    go = threading.Event()
    background.submit(lambda: go.wait(5.0))
    waiting = background.submit(lambda: None)
    start = time.monotonic()
    background.close()
    assert time.monotonic() - start < 1.0
    assert waiting.cancelled()
    with pytest.raises(ParameterError, match="closed"):
        background.submit(lambda: None)
    go.set()


def test_an_answer_comes_in_time_whether_or_not_the_work_is_done():
    quick, slow = Future(), Future()
    quick.set_result("done")
    assert within(5.0, quick, lambda: "late").result(1.0) == "done"
    assert within(0.05, slow, lambda: "late").result(5.0) == "late"
    slow.set_result("done after all")  # and nobody minds
    failing, given_up = Future(), Future()
    failing.set_exception(ValueError("no"))
    with pytest.raises(ValueError, match="no"):
        within(5.0, failing, lambda: "late").result(1.0)
    given_up.cancel()
    assert within(5.0, given_up, lambda: "late").cancelled()
