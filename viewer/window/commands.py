"""What a page tells the viewer: each kind of message as a value, and the text of a message as one of these.

What comes in is not trusted: every number is finite and bounded, unknown kinds and fields are refused, and messages say what
was expected. Angles are radians, lengths metres in the city's frame, places in the picture pixels from its upper left corner.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from mmi.foundation.errors import ParameterError
from mmi.foundation.json_forms import json_number, json_object, shown
from mmi.walks.walk import Pose, Walk, walk_from

__all__ = [
    "LARGEST_SIZE",
    "SMALLEST_SIZE",
    "Ack",
    "AskMap",
    "Command",
    "Film",
    "GoTo",
    "Held",
    "Input",
    "LookChange",
    "Pick",
    "PutAt",
    "Save",
    "Size",
    "WalkCommand",
    "parsed",
]

SMALLEST_SIZE, LARGEST_SIZE = (64, 64), (3840, 2160)
"""Width and height of a window, pixels."""
_LONGEST = 4_000_000
"""Characters of a message, which may hold a walk."""
_MOST_FIELDS = 64
_FARTHEST = 1e7
_MOST_TURN = 100.0
_LAST_NUMBER = 2**53
_STEEPEST = math.radians(89.0)
_DOINGS = ("record", "stop", "tour", "replay")


@dataclass(frozen=True, slots=True)
class Held:
    """What is held down, each from -1 to 1: to walk ``forward``, ``right``, ``up``; to ``turn`` left and to ``tilt`` up."""

    forward: float = 0.0
    right: float = 0.0
    up: float = 0.0
    turn: float = 0.0
    tilt: float = 0.0

    @property
    def nothing(self) -> bool:
        """Whether nothing is held."""
        return self == Held()


@dataclass(frozen=True, slots=True)
class Input:
    """The state of keys, sticks and mouse, message ``seq`` of its client.

    ``look`` (yaw, pitch) is by how much the viewer has turned since the last message: counter-clockwise as seen from above,
    and up. ``fast``: it runs.
    """

    seq: int
    held: Held = field(default_factory=Held)
    look: tuple[float, float] = (0.0, 0.0)
    fast: bool = False


@dataclass(frozen=True, slots=True)
class LookChange:
    """Fields of :class:`viewer.window.look.Look` with new values, which are not checked yet."""

    fields: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Size:
    """The window's size in pixels."""

    width: int
    height: int


@dataclass(frozen=True, slots=True)
class GoTo:
    """Put the viewer onto the street nearest to (x, y)."""

    to: tuple[float, float]


@dataclass(frozen=True, slots=True)
class PutAt:
    """Put the viewer right there."""

    pose: Pose


@dataclass(frozen=True, slots=True)
class Ack:
    """The page has drawn this frame."""

    frame: int


@dataclass(frozen=True, slots=True)
class WalkCommand:
    """``record`` a walk, ``stop`` what is recorded or played, play a ``tour``, or ``replay`` the last one or ``walk``."""

    do: str
    walk: Walk | None = None
    id: int | None = None


@dataclass(frozen=True, slots=True)
class Pick:
    """What is at a pixel?"""

    x: int
    y: int
    id: int | None = None


@dataclass(frozen=True, slots=True)
class AskMap:
    """What is on the map?"""

    id: int | None = None


@dataclass(frozen=True, slots=True)
class Save:
    """The picture that is shown, without loss."""

    id: int | None = None


@dataclass(frozen=True, slots=True)
class Film:
    """A film of the tour."""

    id: int | None = None


Command = Input | LookChange | Size | GoTo | PutAt | Ack | WalkCommand | Pick | AskMap | Save | Film
"""All kinds of messages."""


def parsed(text: str) -> Command:
    """The command that a message's ``text`` says. Raises ParameterError where it says none."""
    if len(text) > _LONGEST:
        raise ParameterError(f"a message of at most {_LONGEST} characters expected, found {len(text)}")
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ParameterError(f"a message in JSON expected, found {shown(text)}") from error
    if not isinstance(value, dict) or not isinstance(value.get("type"), str):
        raise ParameterError(f'a JSON object with a "type" expected, found {shown(value)}')
    kind = value["type"]
    if kind not in _KINDS:
        raise ParameterError(f"type: one of {', '.join(_KINDS)} expected, found {shown(kind)}")
    required, optional, make = _KINDS[kind]
    return make(json_object(value, kind, required=("type", *required), optional=optional))


def _input(value: dict[str, Any]) -> Command:
    names = ("forward", "right", "up", "turn", "tilt")
    held = json_object(value.get("held", {}), "input: held", required=(), optional=names)
    numbers = {name: json_number(one, f"input: held: {name}", most=1.0) for name, one in held.items()}
    return Input(
        _whole(value["seq"], "input: seq", 0, _LAST_NUMBER),
        Held(**numbers),
        _pair(value.get("look", [0.0, 0.0]), "input: look", _MOST_TURN),
        _flag(value.get("fast", False), "input: fast"),
    )


def _look(value: dict[str, Any]) -> Command:
    look = value["look"]
    if not isinstance(look, dict) or len(look) > _MOST_FIELDS:
        raise ParameterError(f"look: a JSON object of at most {_MOST_FIELDS} fields expected, found {shown(look)}")
    return LookChange(MappingProxyType(dict(look)))


def _size(value: dict[str, Any]) -> Command:
    return Size(
        _whole(value["width"], "size: width", SMALLEST_SIZE[0], LARGEST_SIZE[0]),
        _whole(value["height"], "size: height", SMALLEST_SIZE[1], LARGEST_SIZE[1]),
    )


def _go(value: dict[str, Any]) -> Command:
    return GoTo(_pair(value["to"], "go: to", _FARTHEST))


def _pose(value: dict[str, Any]) -> Command:
    pose = value["pose"]
    if not (isinstance(pose, list) and len(pose) == 5):
        raise ParameterError(f"pose: five numbers [x, y, z, heading, pitch] expected, found {shown(pose)}")
    x, y, z = (json_number(one, "pose", most=_FARTHEST) for one in pose[:3])
    azimuth = math.remainder(json_number(pose[3], "pose: heading", most=_FARTHEST), math.tau)
    pitch = json_number(pose[4], "pose: pitch", most=_STEEPEST)
    return PutAt(Pose((x, y, z), azimuth, pitch))


def _ack(value: dict[str, Any]) -> Command:
    return Ack(_whole(value["frame"], "ack: frame", 0, _LAST_NUMBER))


def _walk(value: dict[str, Any]) -> Command:
    do = value["do"]
    if do not in _DOINGS:
        raise ParameterError(f"walk: do: one of {', '.join(_DOINGS)} expected, found {shown(do)}")
    walk = None
    if "walk" in value:
        if do != "replay":
            raise ParameterError(f"walk: a walk with replay only expected, found one with {do}")
        walk = walk_from(value["walk"])
    return WalkCommand(do, walk, _id(value))


def _pick(value: dict[str, Any]) -> Command:
    return Pick(
        _whole(value["x"], "pick: x", 0, LARGEST_SIZE[0] - 1),
        _whole(value["y"], "pick: y", 0, LARGEST_SIZE[1] - 1),
        _id(value),
    )


_Make = Callable[[dict[str, Any]], Command]
_KINDS: Mapping[str, tuple[tuple[str, ...], tuple[str, ...], _Make]] = MappingProxyType(
    {
        "input": (("seq",), ("held", "look", "fast"), _input),
        "look": (("look",), (), _look),
        "size": (("width", "height"), (), _size),
        "go": (("to",), (), _go),
        "pose": (("pose",), (), _pose),
        "ack": (("frame",), (), _ack),
        "walk": (("do",), ("walk", "id"), _walk),
        "pick": (("x", "y"), ("id",), _pick),
        "map": ((), ("id",), lambda value: AskMap(_id(value))),
        "save": ((), ("id",), lambda value: Save(_id(value))),
        "film": ((), ("id",), lambda value: Film(_id(value))),
    }
)
"""For each type: fields that it must have, fields that it may have, and what makes the command of them."""


def _whole(value: object, where: str, least: int, most: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise ParameterError(f"{where}: a whole number from {least} to {most} expected, found {shown(value)}")
    return value


def _pair(value: object, where: str, most: float) -> tuple[float, float]:
    if not (isinstance(value, list) and len(value) == 2):
        raise ParameterError(f"{where}: two numbers expected, found {shown(value)}")
    return json_number(value[0], where, most=most), json_number(value[1], where, most=most)


def _flag(value: object, where: str) -> bool:
    if not isinstance(value, bool):
        raise ParameterError(f"{where}: true or false expected, found {shown(value)}")
    return value


def _id(value: dict[str, Any]) -> int | None:
    return _whole(value["id"], "id", 0, _LAST_NUMBER) if "id" in value else None
