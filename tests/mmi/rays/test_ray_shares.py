"""Rays are shared out so that each is worked on once, on no more threads than asked for."""

import threading

import numpy as np
import pytest

from mmi.rays.shares import Shares


@pytest.mark.parametrize("workers", [1, 2, 5])
@pytest.mark.parametrize("count", [0, 1, 1024, 1025, 100_003])
def test_every_ray_is_worked_on_once(workers, count):
    done, threads = np.zeros(count, dtype=int), set()

    def work(first, last):
        threads.add(threading.get_ident())
        done[first:last] += 1

    Shares(workers).run(work, count)
    assert (done == 1).all()
    assert len(threads) <= workers


def test_one_worker_is_the_caller():
    threads = set()
    Shares(1).run(lambda _first, _last: threads.add(threading.get_ident()), 100_000)
    assert threads == {threading.get_ident()}


def test_what_a_share_raises_is_raised():
    def fail(first, _last):
        if first:
            raise ValueError("no such ray")

    with pytest.raises(ValueError, match="no such ray"):
        Shares(3).run(fail, 100_000)


def test_callers_in_several_threads_share_the_workers():
    shares, sums = Shares(2), [0] * 4

    def call(k):
        def work(first, last):
            sums[k] += last - first

        shares.run(work, 5_000)

    callers = [threading.Thread(target=call, args=(k,)) for k in range(4)]
    for one in callers:
        one.start()
    for one in callers:
        one.join()
    assert sums == [5_000] * 4


def test_no_worker_is_refused():
    with pytest.raises(ValueError, match="at least 1 worker, found 0"):
        Shares(0)
