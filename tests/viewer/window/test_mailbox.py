"""Mailboxes: what adds up, what is replaced, and what is news."""

import pytest

from mmi.foundation.errors import ParameterError
from mmi.walks.walk import Pose
from viewer.window.commands import GoTo, Held, Input, LookChange, PutAt, Size
from viewer.window.look import Look
from viewer.window.mailbox import Mailbox

NAMES = ("full", "multi-mesh")


@pytest.fixture
def box():
    found = Mailbox(Look(), (640, 360), NAMES)
    assert found.fresh
    found.take()
    assert not found.fresh
    return found


def test_turns_add_up_and_the_latest_of_all_else_counts(box):
    box.post(Input(1, Held(forward=1.0), (0.25, 0.5)))
    box.post(Input(2, Held(right=1.0), (0.25, -1.0), fast=True))
    box.post(Size(100, 200))
    box.post(Size(300, 400))
    box.post(LookChange({"mode": "side"}))
    box.post(LookChange({"swipe": 0.25}))
    box.post(GoTo((1.0, 2.0)))
    mail = box.take()
    assert (mail.seq, mail.held, mail.turned, mail.fast) == (2, Held(right=1.0), (0.0, 0.0), True)  # put, after turning
    assert (mail.size, mail.look, mail.put) == ((300, 400), Look(mode="side", swipe=0.25), GoTo((1.0, 2.0)))
    box.post(Input(3, Held(), (0.25, 0.5)))
    box.post(Input(4, Held(), (0.25, 0.5)))
    assert box.take().turned == (0.5, 1.0)


def test_what_is_held_stays_and_turns_do_not(box):
    box.post(Input(1, Held(forward=1.0), (0.25, 0.5)))
    box.post(PutAt(Pose((0.0, 0.0, 0.0), 0.0, 0.0)))
    assert box.take().put is not None
    again = box.take()
    assert (again.held, again.turned, again.put) == (Held(forward=1.0), (0.0, 0.0), None)


def test_late_messages_are_passed_over(box):
    box.post(Input(5, Held(forward=1.0)))
    box.post(Input(4, Held(), (1.0, 1.0)))
    assert box.take().held == Held(forward=1.0)


def test_what_says_nothing_new_is_no_news(box):
    box.post(Input(1, Held(forward=1.0)))
    box.take()
    box.post(Input(2, Held(forward=1.0)))
    assert not box.fresh
    assert box.take().seq == 2  # but the next frame says that it was heard
    box.post(Size(640, 360))
    box.post(LookChange({"mode": "swipe"}))
    assert not box.fresh
    box.post(LookChange({"mode": "one"}))
    assert box.fresh


def test_looks_are_checked_at_once_and_nothing_changes(box):
    for fields in ({"left": "nothing"}, {"mode": "nothing"}, {"nothing": 1}):
        with pytest.raises(ParameterError, match="nothing"):
            box.post(LookChange(fields))
    assert box.take().look == Look()
    with pytest.raises(ParameterError, match="technique"):
        Mailbox(Look(), (64, 64), ("full",))
