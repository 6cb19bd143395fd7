"""Walks that are recorded a moment at a time, and played so."""

import math

import pytest

from mmi.walks.walk import Keyframe, Pose, Walk
from viewer.walks.recording import Playing, Recording


def at(x, azimuth=0.0):
    return Pose((x, 0.0, 1.7), azimuth, 0.0)


def test_a_recording_is_where_the_viewer_was():
    recording = Recording()
    recording.add(at(0.0), 0.0)
    for i in range(1, 101):
        recording.add(at(0.04 * i), 0.01)
    walk = recording.walk("a walk")
    assert walk.seconds == pytest.approx(1.0)
    assert walk.name == "a walk"
    assert len(walk.keyframes) < 15
    for i in range(101):
        assert walk.pose(0.01 * i).eye[0] == pytest.approx(0.04 * i, abs=1e-6)


def test_jumps_are_cuts():
    recording = Recording()
    recording.add(at(0.0), 0.0)
    recording.add(at(1.0), 0.05)
    recording.add(at(500.0), 0.05, jumped=True)
    recording.add(at(501.0), 0.25)
    walk = recording.walk("a walk")
    assert [keyframe.cut for keyframe in walk.keyframes] == [False, False, True, False]
    assert walk.pose(0.07).eye[0] == pytest.approx(1.0)
    assert walk.pose(0.1).eye[0] == pytest.approx(500.0)
    assert walk.metres == pytest.approx(2.0)


def test_jumps_at_once_after_one_another():
    recording = Recording()
    for i in range(5):
        recording.add(at(100.0 * i), 0.0, jumped=i > 0)
    assert [one.pose.eye[0] for one in recording.walk("a walk").keyframes][-1] == 400.0


def test_nothing_and_one_place():
    assert Recording().walk("nothing") is None
    recording = Recording()
    recording.add(at(3.0), 0.0)
    assert recording.walk("one").keyframes == (Keyframe(0.0, at(3.0)),)


def test_a_recording_ends_some_time():
    recording = Recording()
    count = 0
    while not recording.full:
        recording.add(at(0.0), 0.2)
        count += 1
    assert count == pytest.approx(36_000, abs=1)


def test_playing():
    walk = Walk("a walk", (Keyframe(10.0, at(0.0)), Keyframe(12.0, at(8.0, math.pi / 2.0))))
    playing = Playing(walk, "walk")
    assert (playing.pose, playing.over) == (at(0.0), False)
    playing.seconds = 1.0
    assert playing.pose == walk.pose(11.0)
    playing.seconds = 2.5
    assert (playing.pose, playing.over) == (walk.pose(12.0), True)
