"""The file of moving objects: a round trip, its schema, and one line for every mistake."""

from __future__ import annotations

import json
import re
from importlib.resources import files

import jsonschema
import numpy as np
import pytest
from closed_meshes import is_closed
from hypothesis import given, settings
from hypothesis import strategies as st
from moving import block, movers_of

from mmi.foundation.errors import DatasetError, ParameterError
from mmi.movers.movers_file import read_movers, write_movers

SCHEMA = json.loads((files("mmi.movers") / "schemas" / "movers.json").read_text(encoding="utf-8"))
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)

MESH = {
    "vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.5]],
    "triangles": [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
    "colors": [[255, 0, 0], [0, 255, 0], [0, 0, 255], [9, 9, 9]],
}
GOOD = {
    "format": "mmi-traffic",
    "version": 2,
    "crs": "EPSG:32635",
    "origin": [385940.0, 6672290.0, 0.0],
    "meshes": {"tent": MESH},
    "objects": [
        {"id": "a", "mesh": "tent", "poses": [[0, 1, 2, 3, 90]]},
        {"id": "b", "mesh": "tent", "stays": False, "poses": [[0, 1, 2, 3, 90], [0.5, 1, 2, 3, 90, 5, -5]]},
    ],
}


def read(tmp_path, document):
    path = tmp_path / "moving.json"
    path.write_text(document if isinstance(document, str) else json.dumps(document), encoding="utf-8")
    return read_movers(path)


def changed(*place, to):
    """``GOOD`` with another value at a place; REMOVED takes it away."""
    document = json.loads(json.dumps(GOOD))
    inside = document
    for key in place[:-1]:
        inside = inside[key]
    inside[place[-1]] = to
    return document


def test_a_file_that_a_person_wrote(tmp_path):
    found = read(tmp_path, GOOD)
    VALIDATOR.validate(GOOD)
    assert found.ids == ("a", "b")
    assert found.names == ("tent",)
    assert is_closed(found.meshes[0])
    assert found.meshes[0].colors.tolist() == MESH["colors"]
    assert (found.crs, found.origin) == ("EPSG:32635", (385940.0, 6672290.0, 0.0))
    assert found.stays.tolist() == [True, False]
    assert found.starts.tolist() == [0, 1, 3]
    assert np.allclose(np.degrees(found.angles), [[90, 0, 0], [90, 0, 0], [90, 5, -5]])


def test_what_may_be_absent(tmp_path):
    least = {
        "format": "mmi-traffic",
        "version": 2,
        "meshes": {"tent": {key: MESH[key] for key in ("vertices", "triangles")}},
        "objects": [{"id": "a", "mesh": "tent", "poses": [[0, 0, 0, 0, 0]]}],
    }
    VALIDATOR.validate(least)
    found = read(tmp_path, least)
    assert (found.crs, found.origin, found.stays.tolist()) == ("local", (0.0, 0.0, 0.0), [True])
    assert len(set(map(tuple, found.meshes[0].colors.tolist()))) == 1
    nothing = {"format": "mmi-traffic", "version": 2, "meshes": {}, "objects": []}
    VALIDATOR.validate(nothing)
    assert read(tmp_path, nothing).ids == ()


number = st.floats(-1e4, 1e4)


@settings(max_examples=40)
@given(
    st.lists(st.lists(st.tuples(number, number, number, number, number, number), min_size=1, max_size=5), max_size=4)
)
def test_what_is_written_can_be_read(tmp_path_factory, tracks):
    rows = [[(0.5 * i, *row) for i, row in enumerate(track)] for track in tracks]
    path = tmp_path_factory.mktemp("movers") / "new" / "m.json"
    before = movers_of(rows, stays=[i % 2 == 0 for i in range(len(rows))], mesh=block(high=(2.0, 1.0004, 1.5)))
    write_movers(before, path)
    VALIDATOR.validate(json.loads(path.read_text(encoding="utf-8")))
    after = read_movers(path)
    assert (after.ids, after.names, after.crs, after.origin) == (before.ids, before.names, before.crs, before.origin)
    assert np.array_equal(after.kinds, before.kinds)
    assert np.array_equal(after.stays, before.stays)
    for moment in (-1.0, 0.0, 0.25, 0.5, 1.2, 9.0):
        assert np.allclose(after.poses(moment), before.poses(moment), atol=2e-3)
    written = path.read_bytes()
    write_movers(after, path)
    assert path.read_bytes() == written


def test_times_still_grow_when_rounded(tmp_path):
    times = [0.0005, 0.0015, 0.0025]  # halves, which are rounded to even numbers
    write_movers(movers_of([[(time, 0, 0, 0, 0) for time in times]]), tmp_path / "m.json")
    assert np.allclose(read_movers(tmp_path / "m.json").times, times)


@pytest.mark.parametrize(
    ("document", "said"),
    [
        ("{", "a traffic file's JSON expected"),
        ("[" * 100_000, "a traffic file's JSON expected"),
        ([], "a JSON object expected, found []"),
        (changed("format", to="mmi-walk"), '"format": "mmi-traffic" expected'),
        (changed("version", to=1), '"version": 2 expected, found 1, which had no shapes; write it anew with citygen'),
        (changed("version", to=True), '"version": 2 expected, found True'),
        (changed("crs", to=""), '"crs": the name of a coordinate system expected'),
        (changed("origin", to=[0, 0]), '"origin": three numbers [x, y, z] expected'),
        (changed("origin", to=[0, 0, "x"]), '"origin": a number expected'),
        (changed("meshes", to=[]), '"meshes": a JSON object of meshes by name expected'),
        (changed("objects", to={}), '"objects": a list expected'),
        (changed("meshes", "tent", to=3), "mesh 'tent': a JSON object expected"),
        (changed("meshes", "tent", "vertices", 1, to=[0, 0]), "mesh 'tent': vertices: vertex 2: 3 numbers expected"),
        (changed("meshes", "tent", "vertices", 1, 1, to=None), "mesh 'tent': vertices: vertex 2: numbers up to"),
        (changed("meshes", "tent", "vertices", 1, 1, to=10**400), "mesh 'tent': vertices: vertex 2: numbers up to"),
        (changed("meshes", "tent", "triangles", 2, 0, to=4), "triangle 3: whole numbers from 0 to 3 expected"),
        (changed("meshes", "tent", "triangles", 2, 0, to=-1), "triangle 3: whole numbers from 0 to 3 expected"),
        (changed("meshes", "tent", "triangles", 2, 0, to=2**32), "triangle 3: whole numbers from 0 to 3 expected"),
        (changed("meshes", "tent", "triangles", 2, 0, to=1.0), "triangle 3: whole numbers from 0 to 3 expected"),
        (changed("meshes", "tent", "triangles", to=[]), "triangles: a list of at least one triangle expected"),
        (changed("meshes", "tent", "colors", 0, 0, to=256), "colour 1: whole numbers from 0 to 255 expected"),
        (changed("meshes", "tent", "colors", to=[[0, 0, 0]]), "colors: one for each of 4 triangles expected, found 1"),
        (changed("meshes", "tent", "texture", to="x"), "mesh 'tent': the keys vertices, triangles, colors expected"),
        (changed("objects", 1, to=None), "object 2: a JSON object expected, found None"),
        (changed("objects", 1, to={"id": "b"}), 'object b: the key "mesh" expected'),
        (changed("objects", 1, "id", to=""), "object 2: id: a name expected, found ''"),
        (changed("objects", 1, "id", to="a"), "object a: an id of its own expected, found it twice"),
        (changed("objects", 1, "mesh", to="tank"), "object b: mesh: a name among ['tent'] expected, found 'tank'"),
        (changed("objects", 1, "mesh", to=[]), "object b: mesh: a name among ['tent'] expected, found []"),
        (changed("objects", 1, "stays", to=1), "object b: stays: true or false expected, found 1"),
        (changed("objects", 1, "speed", to=1), "object b: the keys id, mesh, poses, stays expected, found 'speed'"),
        (changed("objects", 1, "poses", to=[]), "object b: poses: a list of at least one pose expected, found []"),
        (changed("objects", 1, "poses", 0, to=[0, 0, 0]), "object b: poses: pose 1: 5 or 7 numbers expected"),
        (changed("objects", 1, "poses", 0, to=[0] * 6), "object b: poses: pose 1: 5 or 7 numbers expected"),
        (changed("objects", 1, "poses", 0, 4, to="1"), "object b: poses: pose 1: numbers up to 10000000 expected"),
        (changed("objects", 1, "poses", 0, 4, to=True), "object b: poses: pose 1: numbers up to 10000000 expected"),
        (changed("objects", 1, "poses", 0, 4, to=float("nan")), "object b: poses: pose 1: numbers up to 10000000"),
        (changed("objects", 1, "poses", 0, 4, to=float("inf")), "object b: poses: pose 1: numbers up to 10000000"),
        (changed("objects", 1, "poses", 1, 0, to=0.0005), "object b: pose 2: time: at least 0.001 s after"),
        (changed("objects", 1, "poses", 1, 0, to=-1), "object b: pose 2: time: at least 0.001 s after the 0 s"),
    ],
)
def test_every_mistake_is_one_line(tmp_path, document, said):
    with pytest.raises(ParameterError) as caught:
        read(tmp_path, document)
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'moving.json'}: ")
    assert message.count("moving.json") == 1
    assert "\n" not in message
    assert len(message) < 400
    assert re.search(re.escape(said), message), message


@pytest.mark.parametrize(
    "document",
    [
        changed("version", to=1),
        changed("objects", 1, "poses", 0, to=[0] * 6),
        changed("objects", 1, "poses", 0, 4, to="1"),
        changed("objects", 1, "poses", to=[]),
        changed("objects", 1, "speed", to=1),
        changed("meshes", "tent", "triangles", 2, 0, to=-1),
        changed("meshes", "tent", "colors", 0, 0, to=256),
    ],
)
def test_the_schema_refuses_what_can_be_said_in_one(document):
    with pytest.raises(jsonschema.ValidationError):
        VALIDATOR.validate(document)


def test_the_schema_is_one():
    jsonschema.Draft202012Validator.check_schema(SCHEMA)


def test_a_file_that_is_not_there_or_no_text(tmp_path):
    with pytest.raises(
        ParameterError, match=r"nowhere\.json: a traffic file's JSON file expected, found: No such file"
    ):
        read_movers(tmp_path / "nowhere.json")
    (tmp_path / "raw.json").write_bytes(b"\xff\xfe")
    with pytest.raises(ParameterError, match="in UTF-8 expected, found byte 0 is none"):
        read_movers(tmp_path / "raw.json")
    with pytest.raises(ParameterError, match="up to 256000000 bytes expected, found more"):
        read_movers("/dev/zero")
    (tmp_path / "file").write_text("")
    with pytest.raises(DatasetError, match="a writable file expected"):
        write_movers(movers_of([]), tmp_path / "file" / "m.json")
