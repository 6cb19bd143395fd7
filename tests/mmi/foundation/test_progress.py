"""Progress where nobody watches: lines now and then, and none for short work."""

import io

from mmi.foundation.progress import ProgressLog, silent


class Clock:
    now = 100.0

    def __call__(self):
        return self.now


def log():
    clock, stream = Clock(), io.StringIO()
    return ProgressLog("cells", stream=stream, seconds=10.0, clock=clock), clock, stream


def test_short_work_writes_nothing():
    tell, clock, stream = log()
    for done in range(9):
        clock.now += 1.0
        tell(done, 9, "street")
    assert stream.getvalue() == ""


def test_a_line_comes_now_and_then_with_the_time_that_is_left():
    tell, clock, stream = log()
    for done in range(1001):
        tell(done, 1000, f"cell {done}")
        clock.now += 0.5
    lines = stream.getvalue().splitlines()
    assert len(lines) == 1001 // 20
    assert lines[0] == "cells: 20 of 1,000, about 8 min left (cell 20)"
    assert lines[-2] == "cells: 980 of 1,000, about 10 s left (cell 980)"
    assert lines[-1] == "cells: 1,000 of 1,000 (cell 1000)"


def test_other_work_is_told_from_where_it_began():
    """An hour of one kind says nothing about the time that another kind takes."""
    tell, clock, stream = log()
    tell(0, 4, "views timed")
    clock.now += 3600.0
    tell(4, 4, "views timed")
    tell(0, 4, "views scored")
    clock.now += 20.0
    tell(2, 4, "views scored")
    assert stream.getvalue().splitlines() == [
        "cells: 4 of 4 (views timed)",
        "cells: 2 of 4, about 20 s left (views scored)",
    ]


def test_nothing_is_known_of_the_time_before_anything_is_done():
    tell, clock, stream = log()
    tell(0, 4, "a")
    clock.now += 60.0
    tell(0, 4, "a")
    assert stream.getvalue() == "cells: 0 of 4 (a)\n"


def test_hours_are_told_as_hours(capsys):
    tell, clock, _ = log()
    tell = ProgressLog("cells", clock=clock)
    tell(0, 100, "a")
    clock.now += 3600.0
    tell(1, 100, "a")
    assert capsys.readouterr().err == "cells: 1 of 100, about 99.0 h left (a)\n"
    silent(1, 2, "a")
    assert capsys.readouterr().err == ""
