"""The JSON Schemas that come with the package, held against what a build writes."""

import copy
import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import pytest
from cities import city_of, crossroads, two_blocks

import mmi.dataset.folder
from mmi.building.dataset import build_dataset
from mmi.foundation.camera import Camera
from mmi.planning.parameters import BuildParameters

PARAMETERS = BuildParameters(near_distance=30.0, camera=Camera(128, 128, 1.0), cell_length=80.0)


SCHEMAS = Path(mmi.dataset.folder.__file__).parent / "schemas"


def schema(name):
    found = json.loads((SCHEMAS / f"{name}.json").read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(found)
    assert found["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    return found


VALIDATORS = {name: jsonschema.Draft202012Validator(schema(name)) for name in ("manifest", "build")}


def complaints(name, value):
    return list(VALIDATORS[name].iter_errors(value))


@pytest.fixture(scope="module")
def documents(tmp_path_factory):
    """{name of the schema: what a build of one of the crossroads' cells wrote}."""
    out = tmp_path_factory.mktemp("dataset") / "out"
    build_dataset(crossroads(), out, PARAMETERS, max_cells=1)
    return {name: json.loads((out / f"{name}.json").read_bytes()) for name in ("manifest", "build")}


def objects(value, at=()):
    """The way to every JSON object in ``value``, itself included; of a list only to the first that holds anything."""
    if isinstance(value, dict):
        yield at
        for key, one in value.items():
            yield from objects(one, (*at, key))
    elif isinstance(value, list) and any(value):
        first = next(i for i, one in enumerate(value) if one)
        yield from objects(value[first], (*at, first))


def part(value, way):
    for key in way:
        value = value[key]
    return value


@pytest.mark.parametrize("name", ["manifest", "build"])
def test_what_a_build_writes_is_as_described(documents, name):
    assert complaints(name, documents[name]) == []


def test_a_cell_without_layers_landmarks_a_triangle_budget_and_a_single_layer_are_as_described(tmp_path):
    build_dataset(city_of(two_blocks().objects[0]), tmp_path / "a", replace(PARAMETERS, near_distance=500.0))
    settings = replace(PARAMETERS, near_triangles=0, landmarks=(("back", 2.0),))
    build_dataset(two_blocks(), tmp_path / "b", settings)
    bare, full = (json.loads((tmp_path / out / "manifest.json").read_bytes()) for out in "ab")
    build_dataset(crossroads(), tmp_path / "c", replace(PARAMETERS, layering="single"), max_cells=1)
    single = json.loads((tmp_path / "c" / "manifest.json").read_bytes())
    assert single["cells"][0]["promised_error_px"] is None
    assert "exr" not in bare["cells"][0]["files"]
    assert full["parameters"]["landmarks"] == [["back", 2.0]]
    assert complaints("manifest", bare) == complaints("manifest", full) == complaints("manifest", single) == []


@pytest.mark.parametrize("name", ["manifest", "build"])
def test_every_field_is_wanted_and_no_other_is_let_in(documents, name):
    for way in objects(documents[name]):
        more = copy.deepcopy(documents[name])
        part(more, way)["another"] = 1.5
        assert complaints(name, more), f"an unknown field is let into {way}"
        for key in part(documents[name], way):
            if way == ("stages",) or key == "exr":  # a build that finds all cells complete has no stages
                continue
            less = copy.deepcopy(documents[name])
            del part(less, way)[key]
            assert complaints(name, less), f"{(*way, key)} is not missed"


@pytest.mark.parametrize("name", ["manifest", "build"])
def test_no_field_takes_any_value(documents, name):
    for way in objects(documents[name]):
        for key in part(documents[name], way):
            for wrong in (None, [None], True):
                if wrong is None and key in (
                    "near_triangles",
                    "longest_object",
                    "promised_error_px",
                    "promise_withheld",
                    "missed_px",
                    "max_layers",
                    "max_triangles",
                    "max_bytes",
                ):
                    continue
                other = copy.deepcopy(documents[name])
                part(other, way)[key] = wrong
                assert complaints(name, other), f"{(*way, key)} may be {wrong!r}"


@pytest.mark.parametrize(
    ("way", "wrong"),
    [
        (("format_version",), 1),
        (("checksum",), "0" * 63),
        (("city", "files", "glb", "sha256"), "abc"),
        (("city", "files", "json", "name"), "../city.json"),
        (("cells", 0, "files", "exr", "name"), "/etc/passwd"),
        (("cells", 0, "axis"), [[0.0, 0.0]]),
        (("cells", 0, "half_width"), -1.0),
        (("cells", 0, "bytes"), 1.5),
        (("parameters", "weights"), "tight"),
        (("parameters", "camera", "fov"), 60.0),
        (("totals", "cells"), "8"),
        (("parameters", "layering"), "none"),
        (("cells", 0, "promised_error_px"), 0.0),
    ],
)
def test_wrong_values_are_noticed(documents, way, wrong):
    other = copy.deepcopy(documents["manifest"])
    assert type(part(other, way)) is not type(None)
    part(other, way[:-1])[way[-1]] = wrong
    (complaint,) = complaints("manifest", other)
    assert tuple(complaint.absolute_path)[: len(way)] == way


def described(one, schema, way):
    """Complaints about properties that no description explains; a $ref to a described one explains too."""
    for key, value in one.get("properties", {}).items():
        target = schema["$defs"][value["$ref"].rsplit("/", 1)[1]] if "$ref" in value else value
        if not (value.get("description") or target.get("description") or target.get("properties")):
            yield (*way, key)
        yield from described(value, schema, (*way, key))
    for key in ("items", "additionalProperties"):
        if isinstance(one.get(key), dict):
            yield from described(one[key], schema, (*way, key))


@pytest.mark.parametrize("name", ["manifest", "build"])
def test_every_field_is_described(name):
    found = schema(name)
    parts = {name: found, **found.get("$defs", {})}
    assert [way for key, one in parts.items() for way in described(one, found, (key,))] == []
