"""Walks: where a viewer is, and where it looks, at any time; recorded as keyframes in a file that people can edit.

Everything about paths is here, and nothing about cities: a walk is a value, the same keyframes give the same poses on any
machine. Angles are radians here and degrees in files (``schemas/walk.json``).
"""

from __future__ import annotations

import bisect
import itertools
import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from mmi.foundation.camera import Camera, View, view_towards
from mmi.foundation.errors import ParameterError
from mmi.foundation.json_forms import json_number, json_object, read_json, shown
from mmi.foundation.whole_files import write_whole

__all__ = ["Keyframe", "Pose", "Step", "Walk", "read_walk", "walk_document", "walk_from", "write_walk"]

_FORMAT, _VERSION = "mmi-walk", 1
_LARGEST = 1e7
"""The largest number of seconds, metres or radians in a walk; beyond it, differences of keyframes are lost in rounding."""
_SHORTEST = 1e-6
"""Seconds between keyframes that a viewer moves between."""
_MOST_FRAMES = 1_000_000
_DECIMALS = 9
"""Decimals of degrees in files: 90.0 reads better than 90.00000000000001."""


@dataclass(frozen=True, slots=True)
class Pose:
    """Where a viewer's eye is (x, y, z in metres) and where it looks.

    ``azimuth`` is counter-clockwise from +X, ``pitch`` upwards, both in radians.
    """

    eye: tuple[float, float, float]
    azimuth: float
    pitch: float

    def view(self, camera: Camera) -> View:
        """What ``camera`` sees from here. Raises ParameterError unless |pitch| is below a right angle."""
        return view_towards(np.array(self.eye), self.azimuth, self.pitch, focal=camera.focal, window=camera.window)


@dataclass(frozen=True, slots=True)
class Keyframe:
    """A pose at ``time`` (seconds). ``cut``: the viewer does not move here from the keyframe before, it jumps."""

    time: float
    pose: Pose
    cut: bool = False


@dataclass(frozen=True, slots=True)
class Step:
    """A frame of a walk. ``cut`` is true for the first one, and for the first one after each cut."""

    index: int
    time: float
    pose: Pose
    cut: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Leg:
    """What lies between two cuts: coordinates x, y, z, azimuth (unwrapped), pitch as a curve over ``start`` to ``end``.

    ``low`` and ``high`` (5,) are the bounds of its keyframes. There is no curve where there is one keyframe only.
    """

    start: float
    end: float
    curve: PchipInterpolator | None
    low: NDArray[np.float64]
    high: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Walk:
    """A path through a city: poses that the viewer passes at given times.

    Raises ParameterError unless there is a keyframe, all numbers are finite and at most 1e7, pitches are below a right
    angle, and every keyframe is later than the one before (by a microsecond; at a cut, it may have the same time). Messages
    count keyframes from 1.
    """

    name: str
    keyframes: tuple[Keyframe, ...]
    _legs: tuple[_Leg, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "keyframes", tuple(self.keyframes))
        if any("\ud800" <= letter <= "\udfff" for letter in self.name):
            raise ParameterError(f"a name of whole characters expected, found {self.name!r}")
        if not self.keyframes:
            raise ParameterError("at least one keyframe expected, found none")
        before = None
        for number, keyframe in enumerate(self.keyframes, 1):
            _check(keyframe, before, number)
            before = keyframe
        starts = [i for i, keyframe in enumerate(self.keyframes) if i == 0 or keyframe.cut]
        bounds = itertools.pairwise([*starts, len(self.keyframes)])
        object.__setattr__(self, "_legs", tuple(_leg(self.keyframes[a:b]) for a, b in bounds))

    @property
    def seconds(self) -> float:
        """Seconds from the first keyframe to the last."""
        return self.keyframes[-1].time - self.keyframes[0].time

    @property
    def metres(self) -> float:
        """Metres from keyframe to keyframe as the crow flies, jumps not counted."""
        pairs = itertools.pairwise(self.keyframes)
        return sum(math.dist(a.pose.eye, b.pose.eye) for a, b in pairs if not b.cut)

    def pose(self, time: float) -> Pose:
        """Where the viewer is at ``time`` (seconds); before and after the walk, where it begins and ends.

        Between cuts each coordinate is a monotone cubic (Fritsch & Butland 1984): the camera moves smoothly, never leaves
        the range of the keyframes on either side, and stays on the line where those lie on one. It turns the short way
        round; azimuths are from -pi to pi. At the time of a cut the viewer has jumped already.
        """
        return self._pose(self._place(time), time)

    def frames(self, frames_per_second: float) -> tuple[Step, ...]:
        """The walk in fixed steps from its first keyframe on, so that it is the same however long drawing takes.

        Raises ParameterError for a senseless rate, and for one that would give more than a million frames.
        """
        if not (math.isfinite(frames_per_second) and frames_per_second > 0.0):
            raise ParameterError(f"frames a second above 0 expected, found {frames_per_second!r}")
        last = self.seconds * frames_per_second
        if last >= _MOST_FRAMES:
            raise ParameterError(f"a walk of at most {_MOST_FRAMES} frames expected, found one of {last:.0f}")
        steps = []
        before = -1
        for index in range(math.floor(last + 1e-6) + 1):
            time = self.keyframes[0].time + index / frames_per_second
            place = self._place(time)
            steps.append(Step(index, time, self._pose(place, time), place != before))
            before = place
        return tuple(steps)

    def _place(self, time: float) -> int:
        """The leg that the viewer is on."""
        return max(bisect.bisect_right(self._legs, time, key=lambda leg: leg.start) - 1, 0)

    def _pose(self, place: int, time: float) -> Pose:
        leg = self._legs[place]
        values = leg.low
        if leg.curve is not None:
            values = np.clip(leg.curve(min(max(time, leg.start), leg.end)), leg.low, leg.high)
        x, y, z, azimuth, pitch = values.tolist()
        return Pose((x, y, z), math.remainder(azimuth, math.tau), pitch)


def read_walk(path: Path) -> Walk:
    """Read a walk that :func:`write_walk` or a person wrote.

    Raises ParameterError that names file, keyframe (counted from 1) and what was expected.
    """
    document = read_json(Path(path), "a walk")
    try:
        return walk_from(document)
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from error


def write_walk(walk: Walk, path: Path) -> None:
    """Write a walk as JSON (``schemas/walk.json``), one keyframe on each line, whole or not at all; makes its folder.

    Raises DatasetError where that is impossible.
    """
    document = walk_document(walk)
    rows = [json.dumps(row) for row in document.pop("keyframes")]
    head = json.dumps(document, ensure_ascii=False)
    text = f'{head[:-1]}, "keyframes": [\n ' + ",\n ".join(rows) + "\n]}\n"
    write_whole(Path(path), text.encode("utf-8", errors="backslashreplace"))


def walk_document(walk: Walk) -> dict[str, Any]:
    """What a file says of a walk, as plain data."""
    rows = []
    for keyframe in walk.keyframes:
        pose = keyframe.pose
        row: dict[str, Any] = {
            "time": float(keyframe.time),
            "eye": [float(value) for value in pose.eye],
            "azimuth": round(math.degrees(pose.azimuth), _DECIMALS),
            "pitch": round(math.degrees(pose.pitch), _DECIMALS),
        }
        rows.append(row | ({"cut": True} if keyframe.cut else {}))
    return {"format": _FORMAT, "version": _VERSION, "name": walk.name, "keyframes": rows}


def walk_from(document: object) -> Walk:
    """The walk that a file's JSON describes. Raises ParameterError that says where it does not."""
    top = json_object(document, "a walk", required=("format", "version", "name", "keyframes"))
    if top["format"] != _FORMAT:
        raise ParameterError(f'"format": "{_FORMAT}" expected, found {shown(top["format"])}')
    if isinstance(top["version"], bool) or top["version"] != _VERSION:
        raise ParameterError(f'"version": {_VERSION} expected, found {shown(top["version"])}')
    if not isinstance(top["name"], str):
        raise ParameterError(f'"name": a string expected, found {shown(top["name"])}')
    if not isinstance(top["keyframes"], list):
        raise ParameterError(f'"keyframes": a list expected, found {shown(top["keyframes"])}')
    return Walk(top["name"], tuple(_keyframe(value, number) for number, value in enumerate(top["keyframes"], 1)))


def _check(keyframe: Keyframe, before: Keyframe | None, number: int) -> None:
    """Raises ParameterError for a keyframe that cannot follow the one before."""
    pose = keyframe.pose
    if len(pose.eye) != 3:
        raise ParameterError(f"keyframe {number}: an eye (x, y, z) expected, found {pose.eye!r}")
    named = zip(("time", "eye", "eye", "eye", "azimuth"), (keyframe.time, *pose.eye, pose.azimuth), strict=True)
    for name, value in named:
        if not abs(value) <= _LARGEST:
            raise ParameterError(f"keyframe {number}: {name}: a number up to {_LARGEST:.0f} expected, found {value!r}")
    if not abs(round(math.degrees(pose.pitch), _DECIMALS)) < 90.0:  # and still so when written and read again
        raise ParameterError(
            f"keyframe {number}: pitch: less than 90 degrees up or down expected, found {math.degrees(pose.pitch):.12g}"
        )
    if before is None:
        return
    if keyframe.time < before.time + (0.0 if keyframe.cut else _SHORTEST):
        least = "at least" if keyframe.cut else "more than"
        raise ParameterError(
            f"keyframe {number}: time: {least} the {before.time!r} s of the one before expected, found {keyframe.time!r}"
        )


def _leg(keyframes: tuple[Keyframe, ...]) -> _Leg:
    times = [keyframe.time for keyframe in keyframes]
    values = np.array([(*keyframe.pose.eye, keyframe.pose.azimuth, keyframe.pose.pitch) for keyframe in keyframes])
    values[:, 3] = np.unwrap(values[:, 3])
    curve = None
    if len(keyframes) > 1:
        with np.errstate(all="ignore"):  # SciPy divides by slopes, which may be as small as they like
            curve = PchipInterpolator(times, values)
    return _Leg(times[0], times[-1], curve, values.min(axis=0), values.max(axis=0))


def _keyframe(value: object, number: int) -> Keyframe:
    where = f"keyframe {number}"
    row = json_object(value, where, required=("time", "eye", "azimuth", "pitch"), optional=("cut",))
    eye = row["eye"]
    if not (isinstance(eye, list) and len(eye) == 3):
        raise ParameterError(f"{where}: eye: three numbers [x, y, z] expected, found {shown(eye)}")
    x, y, z = (json_number(one, f"{where}: eye", most=_LARGEST) for one in eye)
    time, azimuth, pitch = (
        json_number(row[key], f"{where}: {key}", most=_LARGEST) for key in ("time", "azimuth", "pitch")
    )
    cut = row.get("cut", False)
    if not isinstance(cut, bool):
        raise ParameterError(f"{where}: cut: true or false expected, found {shown(cut)}")
    return Keyframe(time, Pose((x, y, z), math.radians(azimuth), math.radians(pitch)), cut)
