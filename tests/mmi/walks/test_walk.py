"""Walks: poses between keyframes, fixed steps, and the file."""

import itertools
import json
import math
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mmi.walks.walk
from mmi.foundation.camera import Camera
from mmi.foundation.errors import DatasetError, ParameterError
from mmi.walks.walk import Keyframe, Pose, Walk, read_walk, write_walk

SCHEMA = json.loads((Path(mmi.walks.walk.__file__).parent / "schemas" / "walk.json").read_text(encoding="utf-8"))
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)


def at(time, x, y=0.0, z=1.7, azimuth=0.0, pitch=0.0, cut=False):
    return Keyframe(time, Pose((x, y, z), math.radians(azimuth), math.radians(pitch)), cut)


def walk(*keyframes):
    return Walk("test", keyframes)


COORDINATES = st.floats(-1000.0, 1000.0)
POSES = st.builds(
    Pose,
    st.tuples(COORDINATES, COORDINATES, st.floats(0.0, 100.0)),
    st.floats(-10.0, 10.0),
    st.floats(-1.5707, 1.5707),
)
GAPS = st.lists(st.tuples(st.floats(0.01, 10.0), st.booleans(), POSES), min_size=1, max_size=12)


@st.composite
def walks(draw):
    time = draw(st.floats(-100.0, 100.0))
    keyframes = []
    for gap, cut, pose in draw(GAPS):
        time += 0.0 if cut and gap > 5.0 else gap
        keyframes.append(Keyframe(time, pose, cut))
    return Walk(draw(st.text(st.characters(codec="utf-8"))), tuple(keyframes))


# ------------------------------------------------------------------------------------------------------------ poses


def test_keyframes_are_passed_at_their_times():
    keyframes = (at(1.0, 0.0), at(2.0, 4.0, 1.0, azimuth=30.0), at(2.5, 5.0, 1.0, azimuth=50.0, pitch=-10.0))
    found = walk(*keyframes)
    for keyframe in keyframes:
        pose = found.pose(keyframe.time)
        assert pose.eye == pytest.approx(keyframe.pose.eye)
        assert (pose.azimuth, pose.pitch) == pytest.approx((keyframe.pose.azimuth, keyframe.pose.pitch))
    assert found.pose(-100.0) == keyframes[0].pose
    assert found.pose(100.0) == found.pose(2.5)
    assert found.seconds == 1.5
    assert found.metres == pytest.approx(math.hypot(4.0, 1.0) + 1.0)


def test_steady_keyframes_give_steady_speed_whatever_their_spacing():
    found = walk(*(at(time, 5.0 * time, -3.0 * time) for time in (0.0, 0.1, 2.0, 2.3, 9.0)))
    for time in np.linspace(0.0, 9.0, 91).tolist():
        assert found.pose(time).eye == pytest.approx((5.0 * time, -3.0 * time, 1.7))


@given(st.lists(st.tuples(st.floats(0.01, 5.0), st.floats(-50.0, 50.0)), min_size=2, max_size=8), st.floats(0.0, 6.28))
def test_keyframes_on_a_line_keep_the_viewer_on_it(gaps, direction):
    times = list(itertools.accumulate(gap for gap, _ in gaps))
    along = np.array([math.cos(direction), math.sin(direction)])
    keyframes = [
        at(time, *(np.array([7.0, -3.0]) + place * along)) for time, (_, place) in zip(times, gaps, strict=True)
    ]
    found = walk(*keyframes)
    for time in np.linspace(times[0], times[-1], 50):
        x, y = np.array(found.pose(float(time)).eye[:2]) - [7.0, -3.0]
        assert abs(x * along[1] - y * along[0]) < 1e-9


@settings(max_examples=40)
@given(walks(), st.floats(0.0, 0.999))
def test_no_coordinate_leaves_the_range_of_the_keyframes_around(found, share):
    for a, b in itertools.pairwise(found.keyframes):
        if a.time == b.time:  # a cut: a is not seen
            continue
        pose = found.pose(a.time + share * (b.time - a.time))
        bounds = [a.pose] if b.cut else [a.pose, b.pose]
        pitches = [one.pitch for one in bounds]
        assert min(pitches) - 1e-9 <= pose.pitch <= max(pitches) + 1e-9
        for value, *around in zip(pose.eye, *(one.eye for one in bounds), strict=True):
            assert min(around) - 1e-7 <= value <= max(around) + 1e-7
        turn = math.remainder(bounds[-1].azimuth - a.pose.azimuth, math.tau)
        turned = math.remainder(pose.azimuth - a.pose.azimuth, math.tau)
        if abs(turn) < 3.0:
            assert min(0.0, turn) - 1e-9 <= turned <= max(0.0, turn) + 1e-9


def test_the_camera_turns_the_short_way_round():
    found = walk(at(0.0, 0.0, azimuth=170.0), at(1.0, 0.0, azimuth=-170.0), at(2.0, 0.0, azimuth=-150.0))
    assert abs(math.degrees(found.pose(0.5).azimuth)) > 170.0
    assert math.degrees(found.pose(1.5).azimuth) == pytest.approx(-160.0, abs=2.0)
    assert -math.pi <= found.pose(0.6).azimuth <= math.pi


def test_a_cut_is_a_jump():
    found = walk(at(0.0, 0.0), at(1.0, 5.0), at(1.0, 100.0, cut=True), at(2.0, 105.0), at(4.0, 50.0, cut=True))
    assert found.pose(1.0 - 1e-9).eye[0] == pytest.approx(5.0, abs=1e-6)
    assert found.pose(1.0).eye[0] == 100.0
    assert found.pose(3.9).eye[0] == pytest.approx(105.0)  # waits for the cut
    assert found.pose(4.0).eye[0] == found.pose(9.0).eye[0] == 50.0
    assert found.metres == pytest.approx(10.0)
    assert found.seconds == 4.0


def test_a_leg_of_one_keyframe_stands_still():
    found = walk(at(0.0, 1.0), at(2.0, 7.0, cut=True), at(5.0, 9.0, cut=True))
    assert [found.pose(time).eye[0] for time in (0.0, 1.9, 2.0, 4.9, 5.0)] == [1.0, 1.0, 7.0, 7.0, 9.0]


def test_of_cuts_at_one_time_the_last_counts():
    found = walk(at(0.0, 1.0), at(2.0, 7.0, cut=True), at(2.0, 8.0, cut=True))
    assert found.pose(2.0).eye[0] == 8.0


def test_a_view_looks_where_its_pose_says():
    pose = Pose((3.0, -2.0, 1.7), 0.7, -0.2)
    camera = Camera(640, 360, 1.2)
    view = pose.view(camera)
    level, steep = math.cos(pose.pitch), math.sin(pose.pitch)
    target = np.array(pose.eye) + 12.0 * np.array([level * math.cos(0.7), level * math.sin(0.7), steep])
    assert view.project(target) == pytest.approx([0.0, 0.0, 12.0], abs=1e-9)
    assert view.eye == pytest.approx(pose.eye)
    assert view.window == camera.window
    assert view.focal == camera.focal


# ------------------------------------------------------------------------------------------------------------ steps


def test_frames_come_in_fixed_steps():
    found = walk(at(3.0, 0.0), at(4.0, 5.0), at(4.0, 50.0, cut=True), at(5.0, 55.0))
    steps = found.frames(10.0)
    assert [step.index for step in steps] == list(range(21))
    assert [step.time for step in steps] == pytest.approx([3.0 + 0.1 * i for i in range(21)])
    assert [step.index for step in steps if step.cut] == [0, 10]
    assert all(step.pose == found.pose(step.time) for step in steps)
    assert steps[-1].pose.eye[0] == pytest.approx(55.0)


def test_a_frame_is_a_cut_where_any_cut_came_before_it():
    found = walk(at(0.0, 0.0), at(0.61, 1.0, cut=True), at(0.63, 2.0, cut=True), at(1.0, 3.0))
    assert [step.cut for step in found.frames(5.0)] == [True, False, False, False, True, False]


def test_a_walk_of_one_keyframe_is_one_frame():
    (step,) = walk(at(7.0, 1.0)).frames(30.0)
    assert (step.index, step.time, step.cut) == (0, 7.0, True)


@pytest.mark.parametrize("rate", [0.0, -1.0, math.nan, math.inf, 1e9])
def test_senseless_frame_rates(rate):
    with pytest.raises(ParameterError, match="frames"):
        walk(at(0.0, 0.0), at(1.0, 1.0)).frames(rate)


# -------------------------------------------------------------------------------------------------------- what is one


@pytest.mark.parametrize(
    ("keyframes", "told"),
    [
        ([], "at least one keyframe expected, found none"),
        ([at(0.0, 0.0), at(0.0, 1.0)], "keyframe 2: time: more than the 0.0 s"),
        ([at(1.0, 0.0), at(0.5, 1.0, cut=True)], "keyframe 2: time: at least the 1.0 s"),
        ([at(0.0, math.nan)], "keyframe 1: eye: a number"),
        ([at(0.0, 0.0), at(math.inf, 0.0)], "keyframe 2: time: a number"),
        ([at(0.0, 0.0, azimuth=math.nan)], "keyframe 1: azimuth: a number"),
        ([at(0.0, 0.0, pitch=90.0)], "keyframe 1: pitch: less than 90 degrees up or down expected, found 90"),
        ([at(0.0, 0.0, pitch=math.nan)], "keyframe 1: pitch"),
        ([at(0.0, 0.0, z=1e300)], "keyframe 1: eye: a number"),
        ([Keyframe(0.0, Pose((0.0, 0.0), 0.0, 0.0))], "keyframe 1: an eye"),
    ],
)
def test_what_is_no_walk(keyframes, told):
    with pytest.raises(ParameterError, match=told):
        walk(*keyframes)


def test_walks_are_values():
    a, b = (walk(at(0.0, 0.0), at(1.0, 2.0)) for _ in range(2))
    assert a == b
    assert hash(a) == hash(b)
    assert a != walk(at(0.0, 0.0), at(1.0, 3.0))
    with pytest.raises(AttributeError):
        a.name = "other"


# --------------------------------------------------------------------------------------------------------- the file


@settings(max_examples=30)
@given(walks())
def test_a_walk_comes_back_from_its_file(tmp_path_factory, found):
    path = tmp_path_factory.mktemp("walk") / "walk.json"
    write_walk(found, path)
    assert list(VALIDATOR.iter_errors(json.loads(path.read_bytes()))) == []
    again = read_walk(path)
    assert again.name == found.name
    for a, b in zip(found.keyframes, again.keyframes, strict=True):
        assert (a.time, a.cut, a.pose.eye) == (b.time, b.cut, b.pose.eye)
        assert (a.pose.azimuth, a.pose.pitch) == pytest.approx((b.pose.azimuth, b.pose.pitch), abs=1e-10)
    data = path.read_bytes()
    write_walk(again, path)
    assert path.read_bytes() == data


def test_the_steepest_pitch_comes_back(tmp_path):
    pitch = math.radians(-89.9999999994)
    write_walk(walk(Keyframe(0.0, Pose((0.0, 0.0, 0.0), 0.0, pitch))), tmp_path / "walk.json")
    assert read_walk(tmp_path / "walk.json").keyframes[0].pose.pitch == pytest.approx(pitch, abs=1e-11)
    with pytest.raises(ParameterError, match="pitch"):  # written, it would be 90
        walk(Keyframe(0.0, Pose((0.0, 0.0, 0.0), 0.0, math.radians(89.9999999996))))


def test_the_file_is_for_people(tmp_path):
    path = tmp_path / "new" / "walk.json"
    write_walk(walk(at(0.0, 1.0, azimuth=45.0), at(0.5, 2.0, azimuth=90.0, pitch=-10.0, cut=True)), path)
    assert path.read_text() == (
        '{"format": "mmi-walk", "version": 1, "name": "test", "keyframes": [\n'
        ' {"time": 0.0, "eye": [1.0, 0.0, 1.7], "azimuth": 45.0, "pitch": 0.0},\n'
        ' {"time": 0.5, "eye": [2.0, 0.0, 1.7], "azimuth": 90.0, "pitch": -10.0, "cut": true}\n'
        "]}\n"
    )
    assert [one.name for one in path.parent.iterdir()] == ["walk.json"]


def test_a_file_with_a_byte_order_mark_and_integers_is_read(tmp_path):
    path = tmp_path / "walk.json"
    path.write_bytes(b"\xef\xbb\xbf" + json.dumps(document(time=[0, 2])).encode())
    assert [keyframe.time for keyframe in read_walk(path).keyframes] == [0.0, 2.0]


def test_a_failed_write_leaves_what_was_there(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("kept")
    for path in (tmp_path / "folder", tmp_path / "file" / "walk.json"):
        with pytest.raises(DatasetError, match="a writable file expected"):
            write_walk(walk(at(0.0, 0.0)), path)
    assert sorted(one.name for one in tmp_path.iterdir()) == ["file", "folder"]
    assert (tmp_path / "file").read_text() == "kept"


def document(**second):
    """A walk's JSON: two keyframes, fields of the second replaced (the times of both, where it is ``time``)."""
    times = second.pop("time", [0.0, 1.0])
    keyframes = [{"time": time, "eye": [0.0, 1.0, 2.0], "azimuth": 0.0, "pitch": 0.0} for time in times]
    keyframes[1].update(second)
    return {"format": "mmi-walk", "version": 1, "name": "n", "keyframes": keyframes}


def without(value, *way):
    part = value
    for key in way[:-1]:
        part = part[key]
    del part[way[-1]]
    return value


WRONG = {
    "top": ([], "a walk: a JSON object expected"),
    "null": (None, "a walk: a JSON object expected"),
    "no format": (without(document(), "format"), 'the key "format" expected'),
    "foreign": (document() | {"format": "other"}, '"format": "mmi-walk" expected'),
    "version": (document() | {"version": 2}, '"version": 1 expected, found 2'),
    "true version": (document() | {"version": True}, '"version": 1 expected, found True'),
    "name": (document() | {"name": 7}, '"name": a string expected'),
    "keyframes": (document() | {"keyframes": {}}, '"keyframes": a list expected'),
    "none": (document() | {"keyframes": []}, "at least one keyframe expected"),
    "more": (document() | {"extra": 1}, "found 'extra'"),
    "keyframe": (document() | {"keyframes": [5]}, "keyframe 1: a JSON object expected, found 5"),
    "misspelt": (document(cutt=True), "keyframe 2: the keys .* expected, found 'cutt'"),
    "no eye": (without(document(), "keyframes", 1, "eye"), 'keyframe 2: the key "eye" expected'),
    "flat eye": (document(eye=[0.0, 1.0]), "keyframe 2: eye: three numbers"),
    "eye": (document(eye="here"), "keyframe 2: eye: three numbers"),
    "eye of text": (document(eye=[0.0, 1.0, "2"]), "keyframe 2: eye: a number expected, found '2'"),
    "eye of truth": (document(eye=[0.0, True, 2.0]), "keyframe 2: eye: a number expected, found True"),
    "true time": (document(time=[0.0, True]), "keyframe 2: time: a number expected, found True"),
    "azimuth": (document(azimuth=None), "keyframe 2: azimuth: a number expected, found None"),
    "huge": (document(azimuth=1e300), "keyframe 2: azimuth: a number up to 10000000 expected"),
    "huge integer": (document(azimuth=10**1000), "keyframe 2: azimuth: a number up to 10000000 expected"),
    "pitch": (document(pitch=90), "keyframe 2: pitch: less than 90 degrees"),
    "cut": (document(cut=1), "keyframe 2: cut: true or false expected, found 1"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_file_is_refused_and_no_walk_by_the_schema_either(tmp_path, name):
    value, told = WRONG[name]
    path = tmp_path / "walk.json"
    path.write_text(json.dumps(value))
    with pytest.raises(ParameterError, match=told) as caught:
        read_walk(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < len(str(path)) + 200
    assert not VALIDATOR.is_valid(value)


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"", "JSON expected"),
        (b"{", "JSON expected"),
        (json.dumps(document(pitch=math.nan)).encode(), "keyframe 2: pitch: a number up to"),
        (json.dumps(document(eye=[0.0, 0.0, -math.inf])).encode(), "keyframe 2: eye: a number up to"),
        (json.dumps(document()).replace("1.0", "9" * 5000).encode(), "JSON expected"),
        (json.dumps(document(time=[1.0, 1.0])).encode(), "keyframe 2: time: more than the 1.0 s"),
        (json.dumps(document() | {"name": "\ud800"}).encode(), "a name of whole characters"),
        (json.dumps(document()).encode("utf-16"), "UTF-8 expected"),
        (b'{"name": "\xff"}', "UTF-8 expected, found byte 10"),
        (b"[" * 100_000, "JSON expected"),
    ],
)
def test_a_damaged_file_is_refused(tmp_path, data, told):
    path = tmp_path / "walk.json"
    path.write_bytes(data)
    with pytest.raises(ParameterError, match=told) as caught:
        read_walk(path)
    assert str(caught.value).startswith(f"{path}: ")


def test_no_file(tmp_path):
    for path in (tmp_path, tmp_path / "missing.json"):
        with pytest.raises(ParameterError, match="a walk's JSON file expected") as caught:
            read_walk(path)
        assert str(path) in str(caught.value)


def test_every_field_of_the_schema_is_described():
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    keyframe = SCHEMA["properties"]["keyframes"]["items"]
    for part in (SCHEMA, keyframe):
        assert part["additionalProperties"] is False
        assert all(value["description"] for value in part["properties"].values())
    assert keyframe["required"] == ["time", "eye", "azimuth", "pitch"]
