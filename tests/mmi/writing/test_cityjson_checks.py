from __future__ import annotations

import copy
import json

import pytest
from cityjson_checks import check_cityjson
from model_cities import model_city
from solid_checks import NAMES

from mmi.foundation.errors import CityError
from mmi.writing.cityjson_writer import write_cityjson


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("checks") / "city.json"
    write_cityjson(model_city(), path)
    return json.loads(path.read_text(encoding="utf-8"))


@pytest.fixture
def document(whole):
    return copy.deepcopy(whole)


def geometry(document, id_):
    return document["CityObjects"][id_]["geometry"][0]


def names(document):
    return {one.name for one in check_cityjson(document)}


def test_whole(document):
    assert check_cityjson(document) == []


@pytest.mark.parametrize(
    ("code", "spoil"),
    [
        (102, lambda shell: shell[3][0].insert(1, shell[3][0][0])),
        (302, lambda shell: (shell.pop(), shell)),
        (307, lambda shell: shell[2][0].reverse()),
        (101, lambda shell: shell[2][0].__delitem__(slice(2, None))),
    ],
)
def test_geometry_is_judged_where_it_lies(document, code, spoil):
    shape = geometry(document, "street/1")
    spoil(shape["boundaries"][0])
    del shape["semantics"]
    (found,) = check_cityjson(document)
    assert (found.code, found.name) == (code, NAMES[code])
    assert found.where.startswith("street/1, geometry 0: shell 0")


def test_surfaces_outside_solids_are_judged_too(document):
    geometry(document, "open")["boundaries"][4][0].append(geometry(document, "open")["boundaries"][4][0][0])
    assert {102} == {one.code for one in check_cityjson(document) if one.code}


def test_solids_of_composites_are_judged(document):
    shape = geometry(document, "way/1")
    shape["type"] = "CompositeSolid"
    shape["boundaries"] = [shape["boundaries"]]
    shape["semantics"]["values"] = [shape["semantics"]["values"]]
    assert check_cityjson(document) == []
    shape["boundaries"][0][0].pop()
    assert names(document) == {"SHELL_NOT_CLOSED", "semantics"}


def test_indices(document):
    geometry(document, "street/0")["boundaries"][0][0] = len(document["vertices"])
    assert "wrong_vertex_index" in names(document)


def test_vertices_for_nothing_and_twice(document):
    document["vertices"].append([7, 7, 7])
    assert names(document) == {"unused_vertices"}
    document["vertices"][-1] = document["vertices"][0]
    assert names(document) == {"unused_vertices", "duplicate_vertices"}


@pytest.mark.parametrize(
    ("name", "spoil"),
    [
        ("semantics", lambda one: one["semantics"]["values"][0].pop()),
        ("semantics", lambda one: one["semantics"]["values"][0].__setitem__(0, 3)),
        ("materials", lambda one: one["material"]["default"]["values"][0].append(0)),
        ("materials", lambda one: one["material"]["default"]["values"][0].__setitem__(0, 9)),
        ("materials", lambda one: one["material"].__setitem__("whole", {"value": 9})),
        ("textures", lambda one: one["texture"]["default"]["values"][0].pop()),
        ("textures", lambda one: one["texture"]["default"]["values"][0][4][0].pop()),
        ("textures", lambda one: one["texture"]["default"]["values"][0][4][0].__setitem__(0, 2)),
        ("textures", lambda one: one["texture"]["default"]["values"][0][4][0].__setitem__(1, 10**6)),
    ],
)
def test_looks_that_fit_nothing(document, name, spoil):
    spoil(geometry(document, "dressed"))
    assert names(document) == {name}


def test_families(document):
    document["CityObjects"]["way/1"]["children"] = ["way/2"]
    assert names(document) == {"parents_children_consistency"}
    document["CityObjects"]["way/2"]["parents"] = ["way/1"]
    assert check_cityjson(document) == []
    document["CityObjects"]["way/2"]["parents"] = ["way/1", "gone"]
    assert names(document) == {"parents_children_consistency"}


def test_no_cityjson():
    with pytest.raises(CityError, match="found type 'FeatureCollection'"):
        check_cityjson({"type": "FeatureCollection"})
    with pytest.raises(CityError, match="with a transform expected"):
        check_cityjson({"type": "CityJSONFeature", "CityObjects": {}, "vertices": []})
