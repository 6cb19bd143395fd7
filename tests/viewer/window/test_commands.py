"""Messages of a page: what they come to, and that anything else is refused with a message and nothing worse."""

import json
import math
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mmi.foundation.errors import ParameterError
from mmi.walks.walk import Keyframe, Pose, Walk, walk_document
from viewer.window.commands import (
    Ack,
    AskMap,
    Film,
    GoTo,
    Held,
    Input,
    LookChange,
    Pick,
    PutAt,
    Save,
    Size,
    WalkCommand,
    parsed,
)

WALK = Walk(
    "a walk",
    (Keyframe(0.0, Pose((0.0, 0.0, 1.7), 0.0, 0.0)), Keyframe(2.0, Pose((4.0, 0.0, 1.7), math.radians(90.0), 0.0))),
)


@pytest.mark.parametrize(
    ("message", "command"),
    [
        (
            {"type": "input", "seq": 7, "held": {"forward": 1, "turn": -0.5}, "look": [0.1, -0.2], "fast": True},
            Input(7, Held(forward=1.0, turn=-0.5), (0.1, -0.2), True),
        ),
        ({"type": "input", "seq": 0}, Input(0)),
        ({"type": "size", "width": 1280, "height": 720}, Size(1280, 720)),
        ({"type": "go", "to": [3, -4.5]}, GoTo((3.0, -4.5))),
        ({"type": "pose", "pose": [1, 2, 3, 0.5, -0.25]}, PutAt(Pose((1.0, 2.0, 3.0), 0.5, -0.25))),
        ({"type": "ack", "frame": 12}, Ack(12)),
        ({"type": "walk", "do": "record"}, WalkCommand("record")),
        ({"type": "walk", "do": "replay", "walk": walk_document(WALK), "id": 4}, WalkCommand("replay", WALK, 4)),
        ({"type": "pick", "x": 5, "y": 6, "id": 1}, Pick(5, 6, 1)),
        ({"type": "map"}, AskMap()),
        ({"type": "save", "id": 2}, Save(2)),
        ({"type": "film"}, Film()),
    ],
)
def test_messages(message, command):
    assert parsed(json.dumps(message)) == command


def test_a_change_of_look_is_handed_on():
    command = parsed('{"type": "look", "look": {"mode": "side"}}')
    assert isinstance(command, LookChange)
    assert dict(command.fields) == {"mode": "side"}


def test_headings_come_down_to_one_turn():
    command = parsed(json.dumps({"type": "pose", "pose": [0, 0, 0, 7.0 * math.pi, 0]}))
    assert math.isclose(abs(command.pose.azimuth), math.pi)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "nonsense",
        "[" * 100_000,
        "null",
        "[]",
        '"input"',
        '{"type": 3}',
        '{"type": "quit"}',
        '{"type": "input"}',
        '{"type": "input", "seq": -1}',
        '{"type": "input", "seq": 1.5}',
        '{"type": "input", "seq": true}',
        '{"type": "input", "seq": 1, "held": {"forward": 1.1}}',
        '{"type": "input", "seq": 1, "held": {"jump": 1}}',
        '{"type": "input", "seq": 1, "held": []}',
        '{"type": "input", "seq": 1, "look": [0, NaN]}',
        '{"type": "input", "seq": 1, "look": [0, 1e400]}',
        '{"type": "input", "seq": 1, "look": [0]}',
        '{"type": "input", "seq": 1, "fast": 1}',
        '{"type": "input", "seq": 1, "extra": 1}',
        '{"type": "look", "look": 3}',
        '{"type": "size", "width": 63, "height": 64}',
        '{"type": "size", "width": 3841, "height": 64}',
        '{"type": "size", "width": 640.0, "height": 64}',
        '{"type": "go", "to": [1, 2, 3]}',
        '{"type": "go", "to": [1, "2"]}',
        '{"type": "pose", "pose": [0, 0, 0, 0]}',
        '{"type": "pose", "pose": [0, 0, 0, 0, 1.57]}',
        '{"type": "pose", "pose": [Infinity, 0, 0, 0, 0]}',
        '{"type": "walk", "do": "run"}',
        '{"type": "walk", "do": "replay", "walk": {}}',
        '{"type": "walk", "do": "tour", "walk": {}}',
        '{"type": "pick", "x": -1, "y": 0}',
        '{"type": "map", "id": "1"}',
    ],
)
def test_nonsense_is_refused(text):
    with pytest.raises(ParameterError, match="expected"):
        parsed(text)


def test_a_message_that_is_too_long_is_not_even_read():
    with pytest.raises(ParameterError, match="characters"):
        parsed('{"type": "map"}' + " " * 4_000_000)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
)
KINDS = ("input", "look", "size", "go", "pose", "ack", "walk", "pick", "map", "save", "film")
FIELDS = ("seq", "held", "look", "fast", "width", "height", "to", "pose", "frame", "do", "walk", "x", "y", "id")


@given(st.sampled_from(KINDS), st.dictionaries(st.sampled_from(FIELDS), JSON, max_size=4))
def test_whatever_comes_is_a_command_or_an_error_of_ours(kind, fields):
    with suppress(ParameterError):
        parsed(json.dumps({"type": kind, **fields}))


@given(st.text())
def test_any_text_at_all(text):
    with pytest.raises(ParameterError):
        parsed(text)
