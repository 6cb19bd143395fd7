"""Bookkeeping of what clients ask for and can take, with made-up clocks."""

import pytest

from viewer.serving.pace import Allowance, Flow, Quality


def test_an_allowance_is_spent_and_fills_again():
    allowance = Allowance(10.0, 3)
    assert [allowance.take(0.0) for _ in range(4)] == [True, True, True, False]
    assert allowance.wait(0.0) == pytest.approx(0.1)
    assert not allowance.take(0.05)
    assert allowance.take(0.11)
    assert [allowance.take(100.0) for _ in range(4)] == [True, True, True, False], "no more than the burst is kept"


def test_debts_are_waited_for_so_that_the_rate_holds():
    allowance = Allowance(10.0, 5)
    now = 0.0
    for _ in range(105):
        now += allowance.spend(1.0, now)
    assert now == pytest.approx(10.0)


def test_a_clock_that_goes_back_gives_nothing():
    allowance = Allowance(1.0, 1)
    assert allowance.take(10.0)
    assert not allowance.take(5.0)


def test_two_frames_are_under_way_at_most():
    flow = Flow()
    flow.ask()
    assert flow.has_room
    assert flow.send(1.0) == 1
    flow.ask()
    assert not flow.has_room
    assert not flow.all_drawn
    assert flow.acknowledge(1, 1.25) == 0.25
    assert flow.has_room
    assert flow.all_drawn
    flow.drop()
    flow.ask()
    assert flow.send(2.0) == 2


def test_an_acknowledgement_is_for_all_frames_before_it():
    flow = Flow()
    for now in (1.0, 2.0):
        flow.ask()
        flow.send(now)
    assert flow.acknowledge(2, 5.0) == 3.0
    assert flow.all_drawn
    assert flow.acknowledge(1, 6.0) is None


@pytest.mark.parametrize("number", [0, 2, 10**15, -1])
def test_acknowledgements_of_what_was_never_sent_count_for_nothing(number):
    flow = Flow()
    flow.ask()
    flow.send(0.0)
    assert flow.acknowledge(number, 1.0) is None
    assert not flow.all_drawn


def qualities(seconds):
    quality = Quality()
    for one in seconds:
        quality.acknowledged(one)
        yield quality.value


def test_quality_stays_where_acknowledgements_are_as_fast_as_ever():
    assert set(qualities([0.02, 0.03] * 100)) == {80}
    assert set(qualities([0.3, 0.31] * 100)) == {80}, "a long way is not a narrow one"


def test_quality_falls_where_frames_queue_up_and_rises_again():
    narrow = list(qualities([0.03] * 5 + [0.4] * 60))
    assert narrow[4] == 80
    assert narrow[-1] == 35
    assert list(qualities([0.03] * 5 + [0.4] * 60 + [0.03] * 200))[-1] == 80


def test_a_connection_that_became_longer_is_not_taken_for_narrow_for_ever():
    assert list(qualities([0.01] * 100 + [0.2] * 5000))[-1] == 80
