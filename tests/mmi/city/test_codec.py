"""A city as JSON and back: nothing is lost, and what is damaged is told from what is whole."""

from __future__ import annotations

import base64
import dataclasses
import json
import math
import random
import resource
import zlib

import networkx as nx
import numpy as np
import pytest
from cities import block, city_of, crossroads
from model_cities import model_city
from shapely.geometry import box

from mmi.city.codec import city_from_json, city_to_json, object_fingerprints
from mmi.city.long_objects import cut_objects
from mmi.city.model import City, CityObject, Prism, Texture, TriangleMesh
from mmi.foundation.errors import CityError
from mmi.foundation.json_forms import canonical_json, fingerprint

ARRAYS = ("vertices", "triangles", "textures", "colors", "uv")


def cored_city():
    """A house with a core, one without anything inside, and a mesh of no triangles."""
    city = model_city()
    empty = TriangleMesh(np.empty((0, 3)), np.empty((0, 3)))
    more = (
        CityObject("cored", (Prism(box(80, 0, 90, 9), 0.0, 9.0),), core=(Prism(box(81, 1, 89, 8), 0.0, 7.5),)),
        CityObject("glass", (Prism(box(100, 0, 110, 9), 0.0, 9.0),), core=()),
        CityObject("nothing", (Prism(box(120, 0, 130, 9), 0.0, 9.0),), empty),
    )
    return dataclasses.replace(city, objects=(*city.objects, *more))


def assert_same(one: City, other: City) -> None:
    assert [(o.id, o.part_of) for o in one.objects] == [(o.id, o.part_of) for o in other.objects]
    for a, b in zip(one.objects, other.objects, strict=True):
        for mine, theirs in ((a.prisms, b.prisms), (a.core, b.core)):
            assert (mine is None) == (theirs is None)
            for p, q in zip(mine or (), theirs or (), strict=True):
                assert (p.footprint.wkb, p.bottom, p.top) == (q.footprint.wkb, q.bottom, q.top)
        assert (a.mesh is None) == (b.mesh is None)
        for name in ARRAYS if a.mesh is not None else ():
            mine, theirs = getattr(a.mesh, name), getattr(b.mesh, name)
            assert (mine.dtype, mine.tobytes(), mine.shape) == (theirs.dtype, theirs.tobytes(), theirs.shape)
    for a, b in zip(one.textures, other.textures, strict=True):
        assert (a.name, a.image.tolist()) == (b.name, b.image.tolist())
    assert (one.terrain is None) == (other.terrain is None)
    if one.terrain is not None and other.terrain is not None:
        assert one.terrain.heights.tolist() == other.terrain.heights.tolist()
        assert (one.terrain.origin, one.terrain.spacing) == (other.terrain.origin, other.terrain.spacing)
    assert (one.crs, one.origin, one.source, one.ground) == (other.crs, other.origin, other.source, other.ground)
    assert one.facades == other.facades
    assert sorted(one.streets.nodes(data=True)) == sorted(other.streets.nodes(data=True))
    mine, theirs = (
        sorted((e["index"], a, b, e["kind"], e["name"], e["half_width"], e["geometry"].wkt) for a, b, e in edges)
        for edges in (one.streets.edges(data=True), other.streets.edges(data=True))
    )
    assert mine == theirs


@pytest.mark.parametrize(
    "make",
    [
        crossroads,
        model_city,
        cored_city,
        lambda: city_of(block("a", 0, 9, 9, 18, 7.0)),
        lambda: cut_objects(crossroads(), 40.0),
        lambda: cut_objects(dataclasses.replace(crossroads(), facades="plain"), 40.0),
    ],
)
def test_a_stored_city_comes_back_and_is_stored_as_the_same_bytes(make):
    city = make()
    data = city_to_json(city)
    again = city_from_json(data, name="city.json")
    assert_same(city, again)
    assert city_to_json(again) == data
    assert object_fingerprints(again) == object_fingerprints(city)


def test_a_city_without_anything():
    city = City((), nx.MultiGraph(), "EPSG:32631", (0.0, 0.0, 0.0), "empty", 3.5)
    data = city_to_json(city)
    assert city_to_json(city_from_json(data, name="x")) == data


def test_arrays_that_are_no_slices_of_memory_are_stored_alike():
    image = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    turned = np.asfortranarray(image)
    one, other = (
        city_to_json(dataclasses.replace(model_city(), textures=(Texture("a", i), Texture("b", i))))
        for i in (image, turned)
    )
    assert one == other


def changed(part, **changes):
    mesh = dataclasses.replace(model_city().objects[2].mesh, **{part: changes["to"]})
    city = model_city()
    return dataclasses.replace(
        city, objects=(*city.objects[:2], dataclasses.replace(city.objects[2], mesh=mesh), *city.objects[3:])
    )


def test_fingerprints_tell_which_object_looks_different():
    before = object_fingerprints(model_city())
    mesh = model_city().objects[2].mesh
    for part, to in (("vertices", mesh.vertices + np.array([0.0, 0.0, 1e-9])), ("uv", mesh.uv + np.float32(0.5))):
        after = object_fingerprints(changed(part, to=to))
        assert [a != b for a, b in zip(before, after, strict=True)] == [False, False, True, False, False]


def test_painted_facades_leave_no_trace_and_plain_ones_change_every_fingerprint():
    """Datasets from before there were plain facades stay as they are, and a build that changes them does all again."""
    painted, plain = (dataclasses.replace(model_city(), facades=kind) for kind in ("painted", "plain"))
    assert b"facades" not in city_to_json(painted)
    assert object_fingerprints(painted) == [fingerprint(one) for one in json.loads(city_to_json(painted))["objects"]]
    assert not set(object_fingerprints(painted)) & set(object_fingerprints(plain))
    assert len(set(object_fingerprints(plain))) == len(plain.objects)
    with pytest.raises(CityError, match="facades painted or plain expected, found 'brick'"):
        dataclasses.replace(model_city(), facades="brick")


# Damage


def read(stored):
    """The city, or None where it is refused as it should be: with a CityError that names the file."""
    data = stored if isinstance(stored, bytes) else canonical_json(stored)
    try:
        return city_from_json(data, name="city.json")
    except CityError as error:
        assert str(error)
        return None


def array_of(values, kind, *, shape=None):
    packed = np.asarray(values).astype(kind)
    data = base64.b64encode(zlib.compress(packed.tobytes())).decode()
    return {"kind": packed.dtype.str, "shape": list(packed.shape if shape is None else shape), "data": data}


def damaged(path, value):
    """The stored city of models with ``value`` where ``path`` leads; without it, with that left out."""
    stored = json.loads(city_to_json(cored_city()))
    place = stored
    for step in path[:-1]:
        place = place[step]
    if value is KeyError:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    return stored


MESH = ("objects", 2, "mesh")
DAMAGES = [
    ((*MESH, "vertices"), array_of(np.full((8, 3), math.nan), "<f8")),
    ((*MESH, "vertices"), array_of(np.zeros((4, 3)), "<f8")),
    ((*MESH, "vertices"), array_of(np.zeros(24), "<f8")),
    ((*MESH, "vertices", "data"), "%%%"),
    ((*MESH, "vertices", "data"), "AAAA"),
    ((*MESH, "vertices", "data"), base64.b64encode(zlib.compress(b"12345")).decode()),
    ((*MESH, "vertices", "data"), "päckchen"),
    ((*MESH, "vertices", "data"), 7),
    ((*MESH, "vertices", "kind"), "|O"),
    ((*MESH, "vertices", "kind"), "nonsense"),
    ((*MESH, "vertices", "kind"), ["<f8"]),
    ((*MESH, "vertices", "kind"), None),
    ((*MESH, "vertices", "shape"), [8, 4]),
    ((*MESH, "vertices", "shape"), [1e300, 3]),
    ((*MESH, "vertices", "shape"), [10**30, 3]),
    ((*MESH, "vertices", "shape"), 24),
    ((*MESH, "triangles"), array_of(np.full((12, 3), 99), "<i4")),
    ((*MESH, "triangles"), array_of(np.full((12, 3), math.nan), "<f8")),
    ((*MESH, "triangles"), array_of(np.full((12, 3), 1e300), "<f8")),
    ((*MESH, "textures"), array_of(np.full(12, 2), "<i4")),
    ((*MESH, "textures"), array_of(np.full(12, math.inf), "<f4")),
    ((*MESH, "textures"), array_of(np.zeros(11), "<i4")),
    ((*MESH, "colors"), array_of(np.full((12, 3), 999), "<i4")),
    ((*MESH, "uv"), array_of(np.full((12, 3, 2), math.inf), "<f4")),
    ((*MESH, "uv"), KeyError),
    (MESH, 5),
    (("objects", 2, "id"), ""),
    (("objects", 2, "id"), 5),
    (("objects", 2, "id"), ["a"]),
    (("objects", 2, "id"), "open"),
    (("objects", 2, "prisms"), []),
    (("objects", 2, "prisms"), None),
    (("objects", 2, "prisms", 0, "rings"), []),
    (("objects", 2, "prisms", 0, "rings"), [[[0.0, 0.0], [1.0, 0.0]]]),
    (("objects", 2, "prisms", 0, "rings"), [[[0, 0], [1, 1], [1, 0], [0, 1], [0, 0]]]),
    (("objects", 2, "prisms", 0, "top"), -5.0),
    (("objects", 2, "prisms", 0, "top"), "high"),
    (("objects", 5, "core", 0, "bottom"), 99.0),
    (("objects", 5, "core"), {"a": 1}),
    (("objects",), {"a": 1}),
    (("objects",), KeyError),
    (("terrain",), KeyError),
    (("terrain", "heights"), array_of([[1.0, 2.0]], "<f8")),
    (("terrain", "heights"), array_of([[1.0, math.nan], [0.0, 0.0]], "<f8")),
    (("terrain", "spacing"), 0.0),
    (("terrain", "origin"), [0.0]),
    (("terrain", "origin"), [0.0, 1.0, 2.0]),
    (("textures",), []),
    (("textures", 0, "image"), array_of(np.zeros((4, 8)), "|u1")),
    (("textures", 0, "image"), array_of(np.zeros((4, 8, 3)), "<f4")),
    (("textures", 0, "image"), array_of(np.zeros((0, 8, 3)), "|u1")),
    (("streets", 0, "line"), [[0.0, 0.0]]),
    (("streets", 0, "line"), "a line"),
    (("streets", 0, "ends"), [0]),
    (("streets", 0, "ends"), [[0], [1]]),
    (("streets", 0, "key"), [1]),
    (("streets", 0, "index"), KeyError),
    (("junctions", 0), [0, 1.0]),
    (("junctions", 0), ["a", "b", "c"]),
    (("origin",), None),
    (("ground",), []),
]


@pytest.mark.parametrize(
    ("path", "value"), DAMAGES, ids=lambda one: "/".join(map(str, one)) if type(one) is tuple else ""
)
def test_what_is_damaged_is_refused(path, value):
    assert read(damaged(path, value)) is None


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"[]",
        b"null",
        b"\xff\xfe",
        b"[" * 100_000,
        city_to_json(cored_city())[:-20],
        city_to_json(cored_city()).replace(b'"junctions":[[0,', b'"junctions":[[Infinity,'),
        city_to_json(cored_city()).replace(b'"junctions":[[0,', b'"junctions":[[NaN,'),
    ],
    ids=["empty", "list", "null", "no text", "deep", "cut short", "infinite", "not a number"],
)
def test_what_is_no_stored_city_is_refused(data):
    assert read(data) is None


def leaves(value, path=()):
    """Paths of everything in a stored city."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in items:
        yield (*path, key)
        yield from leaves(part, (*path, key))


@pytest.mark.parametrize("seed", range(4))
def test_random_damage_is_refused_or_harmless(seed):
    """Parts are lost, replaced and mixed up; and where that is read all the same, it can be stored again."""
    rng = random.Random(seed)
    whole = json.loads(city_to_json(cored_city()))
    paths = list(leaves(whole))
    odd = [None, True, -1, 0, 1e9, 10**25, "", "x", [], {}, [[]], [0.5], {"data": "", "kind": "<f8", "shape": [0]}]
    refused = 0
    for _ in range(150):
        path = rng.choice(paths)
        value = rng.choice([*odd, KeyError])
        if rng.random() < 0.3:  # something from elsewhere in the file
            value = whole
            for step in rng.choice(paths):
                value = value[step]
        stored = json.loads(json.dumps(whole))
        place = stored
        for step in path[:-1]:
            place = place[step]
        if value is KeyError:
            del place[path[-1]]
        else:
            place[path[-1]] = value
        city = read(stored)
        refused += city is None
    assert refused > 30


@pytest.mark.parametrize("seed", range(2))
def test_flipped_bytes_are_refused_or_harmless(seed):
    rng = random.Random(seed)
    whole = city_to_json(cored_city())
    for _ in range(150):
        data = bytearray(whole)
        for _ in range(rng.choice([1, 1, 3])):
            data[rng.randrange(len(data))] = rng.randrange(256)
        read(bytes(data))


def test_a_street_of_one_point_is_refused_in_one_line():
    document = json.loads(city_to_json(crossroads()))
    document["streets"][0]["line"] = [[0.0, 0.0]]
    with pytest.raises(CityError, match="a city stored by build-impostors expected") as refused:
        city_from_json(canonical_json(document), name="city.json")
    assert "\n" not in str(refused.value)


def test_an_array_is_not_unpacked_beyond_its_shape():
    """What is packed may be a thousand times as large as the file: no more of it is unpacked than the shape says."""
    document = json.loads(city_to_json(model_city()))
    image = document["textures"][0]["image"]
    packing = zlib.compressobj(9)
    pieces = [packing.compress(bytes(1_000_000)) for _ in range(200)]
    image["data"] = base64.b64encode(b"".join(pieces) + packing.flush()).decode()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(CityError, match="an array of 96 bytes expected, found more"):
        city_from_json(canonical_json(document), name="city.json")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 150_000  # kB
