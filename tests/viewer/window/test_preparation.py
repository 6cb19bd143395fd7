import threading

import pytest

from viewer.window.preparation import Preparation


def waited(one):
    one._thread.join(timeout=10.0)
    return one


def test_it_is_over_when_it_is_done():
    may = threading.Event()
    one = Preparation(lambda: may.wait(10.0))
    assert not one.over()
    may.set()
    assert waited(one).over()


def test_whoever_asks_is_told_what_went_wrong():
    def fail():
        raise ValueError("no rays today")

    one = waited(Preparation(fail))
    for _ in range(2):
        with pytest.raises(ValueError, match="no rays today"):
            one.over()
