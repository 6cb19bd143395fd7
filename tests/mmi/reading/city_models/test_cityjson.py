"""CityJSON in: what the writer wrote comes back, old versions too, and every damage is one line."""

from __future__ import annotations

import json
from copy import deepcopy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from model_cities import ORIGIN, box_corners, model_city
from PIL import Image

from mmi.city.model import PAINTED, PLAIN
from mmi.foundation.errors import CityError, MmiError
from mmi.reading.city_models.cityjson import is_cityjson, read_cityjson
from mmi.reading.read_city import read_city
from mmi.reading.read_options import ReadOptions
from mmi.reading.report import Ledger
from mmi.writing.cityjson_writer import write_cityjson

FACES = [[[0, 3, 2, 1]], [[4, 5, 6, 7]], [[0, 1, 5, 4]], [[1, 2, 6, 5]], [[2, 3, 7, 6]], [[3, 0, 4, 7]]]


def corners_of(mesh):
    return mesh.vertices[mesh.triangles]


def areas(mesh):
    corners = corners_of(mesh)
    return 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)


def solid(faces=FACES, lod="2", **more):
    return {"type": "Solid", "lod": lod, "boundaries": [faces], **more}


def document(**objects):
    """A document of objects in a pool of the corners of two boxes: 10 x 10 x 6, and one beside it of 10 x 10 x 3."""
    points = np.concatenate([box_corners(0, 0, 0, 10, 10, 6), box_corners(30, 0, 0, 40, 10, 3)])
    return {
        "type": "CityJSON",
        "version": "1.1",
        "transform": {"scale": [0.001] * 3, "translate": [385000.0, 6672000.0, 10.0]},
        "metadata": {"referenceSystem": "https://www.opengis.net/def/crs/EPSG/0/3067"},
        "CityObjects": objects,
        "vertices": np.rint(points * 1000).astype(int).tolist(),
    }


SECOND = [[[k + 8 for k in ring] for ring in face] for face in FACES]


def building(*geometry, **more):
    return {"type": "Building", "geometry": list(geometry), **more}


def saved(content, folder, name="city.json"):
    path = folder / name
    if isinstance(content, list):
        path.write_text("\n".join(json.dumps(line) for line in content))
    else:
        path.write_text(json.dumps(content))
    return path


def read(content, folder, *, lod=None, name="city.json"):
    ledger = Ledger()
    return read_cityjson(saved(content, folder, name), ledger, lod=lod), ledger


def size(item):
    return np.ptp(item.mesh.vertices, axis=0).tolist()


# ------------------------------------------------------------------------------------------- what the writer wrote


@pytest.mark.parametrize("name", ["city.json", "city.jsonl"])
def test_a_city_comes_back(name, tmp_path):
    city = model_city()
    write_cityjson(city, tmp_path / name)
    ledger = Ledger()
    layer = read_cityjson(tmp_path / name, ledger)
    assert layer.crs.to_epsg() == 3067
    assert [item.id for item in layer.items] == [one.id for one in city.objects]
    back = dict(zip([item.id for item in layer.items], layer.items, strict=True))
    for one in city.objects:
        mesh = back[one.id].mesh
        points = mesh.vertices - ORIGIN
        x0, y0, x1, y1 = one.footprint.bounds
        assert [*points.min(axis=0), *points.max(axis=0)] == pytest.approx([x0, y0, one.base, x1, y1, one.top])
        if one.mesh is None:
            exact = sum(
                2 * prism.footprint.area + prism.footprint.length * (prism.top - prism.bottom) for prism in one.prisms
            )
            assert areas(mesh).sum() == pytest.approx(exact)
            assert (mesh.textures == PAINTED).all()
        else:
            assert corners_of(mesh) - ORIGIN == pytest.approx(corners_of(one.mesh), abs=1e-6)
            assert (mesh.colors == np.where(one.mesh.textures[:, None] >= 0, 255, one.mesh.colors)).all()
            assert ((mesh.textures < 0) == (one.mesh.textures < 0)).all()
            assert (mesh.textures[mesh.textures < 0] == one.mesh.textures[mesh.textures < 0]).all()
            bare = one.mesh.textures < 0
            assert (mesh.uv == np.where(bare[:, None, None], 0.0, one.mesh.uv)).all()
            for mine, theirs in zip(mesh.textures[~bare], one.mesh.textures[~bare], strict=True):
                assert (layer.textures[mine].image == city.textures[theirs].image).all()
    assert [street.tags["highway"] for street in layer.streets] == ["street", "residential"]
    lines = [edge["geometry"] for _, _, edge in city.streets.edges(data=True)]
    for street, line in zip(layer.streets, lines, strict=True):
        assert np.array(street.lines[0].coords) - ORIGIN[:2] == pytest.approx(np.array(line.coords), abs=1e-6)
    ground = layer.terrain.vertices - ORIGIN
    assert ground[:, 2] == pytest.approx(city.terrain.at(ground), abs=0.0011)
    assert areas(layer.terrain).sum() >= 120 * 80
    assert ledger.count("read", "buildings") == 5


def test_reading_both_kinds_gives_the_same(tmp_path):
    found = []
    for name in ("city.json", "city.jsonl"):
        write_cityjson(model_city(), tmp_path / name)
        found.append(read_cityjson(tmp_path / name, Ledger()))
    for one, two in zip(found[0].items, found[1].items, strict=True):
        assert corners_of(one.mesh) == pytest.approx(corners_of(two.mesh))
        assert (one.mesh.colors == two.mesh.colors).all()
        assert one.mesh.uv == pytest.approx(two.mesh.uv)


# ------------------------------------------------------------------------------------------------- which picture corner


def picture(folder, name="pic.png"):
    """Four colours: red lower left, green lower right, blue upper right, white upper left."""
    image = np.array([[[255, 255, 255], [0, 0, 255]], [[255, 0, 0], [0, 255, 0]]], dtype=np.uint8)
    folder.mkdir(parents=True, exist_ok=True)
    Image.fromarray(image).save(folder / name)
    return image


def textured(uv_key="vertices-texture", *, values=None, image="pic.png"):
    """One box whose south wall, from (0, 0, 0) to (10, 0, 6), shows a whole picture upright."""
    value = [[[0, 0, 1, 2, 3]]]
    bare = [[[None]]]
    shells = [bare[0], bare[0], value[0], *[bare[0]] * 3]
    geometry = solid(texture={"look": {"values": [shells]}} if values is None else values([shells]))
    made = document(a=building(geometry))
    made["appearance"] = {
        "textures": [{"type": "PNG", "image": image}],
        uv_key: [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]],
    }
    return made


def shown(layer, item, place):
    """The colour of the item's picture at the corner that stands at ``place``."""
    (row, corner) = np.argwhere(
        (np.abs(corners_of(item.mesh) - place).max(axis=2) < 1e-6) & (item.mesh.textures[:, None] >= 0)
    )[0]
    image = layer.textures[item.mesh.textures[row]].image
    u, v = item.mesh.uv[row, corner]
    return image[round((1.0 - v) * (len(image) - 1)), round(u * (image.shape[1] - 1))].tolist()


OLD = {
    "2.0": ("vertices-texture", lambda shells: {"look": {"values": shells}}),
    "0.5": ("vertices-texture", lambda shells: {"look": {"values": shells}}),
    "0.1": ("vertex-texture", lambda shells: shells),
}


@pytest.mark.parametrize("version", OLD)
def test_pictures_stand_upright(version, tmp_path):
    key, values = OLD[version]
    picture(tmp_path)
    layer, _ = read(textured(key, values=values), tmp_path)
    (item,) = layer.items
    at = np.array([385000.0, 6672000.0, 10.0])
    assert shown(layer, item, at) == [255, 0, 0], "red is the lower left corner"
    assert shown(layer, item, np.add(at, (10, 0, 0))) == [0, 255, 0]
    assert shown(layer, item, np.add(at, (10, 0, 6))) == [0, 0, 255]
    assert shown(layer, item, np.add(at, (0, 0, 6))) == [255, 255, 255]
    assert (item.mesh.textures >= 0).sum() == 2
    assert (item.mesh.textures[item.mesh.textures < 0] == PAINTED).all()


@pytest.mark.parametrize("folder", [".", "appearances", "appearance"])
def test_pictures_are_looked_for_beside_the_file(folder, tmp_path):
    picture(tmp_path / folder)
    layer, _ = read(textured(), tmp_path)
    assert len(layer.textures) == 1


def test_pictures_that_are_not_there_or_damaged_are_noted(tmp_path):
    layer, ledger = read(textured(), tmp_path)
    assert layer.textures == ()
    assert (layer.items[0].mesh.textures == PAINTED).all()
    assert ledger.count("left out", "picture: it is not there") == 1
    (tmp_path / "pic.png").write_bytes(b"no picture")
    _, ledger = read(textured(), tmp_path)
    assert ledger.count("left out", "picture: it cannot be decoded") == 1
    _, ledger = read(textured(image="https://example.org/pic.png"), tmp_path)
    assert ledger.count("left out", "picture: it is not there") == 1


def test_colours(tmp_path):
    values = [[0, 1, None, 7, 0, 0]]
    made = document(
        a=building(solid(material={"x": {"values": values}})), b=building(solid(SECOND, material={"x": {"value": 1}}))
    )
    made["appearance"] = {"materials": [{"name": "red", "diffuseColor": [1.0, 0.5, -3]}, {"name": "no colour"}]}
    layer, _ = read(made, tmp_path)
    a, b = (item.mesh for item in layer.items)
    assert a.textures.tolist() == [PLAIN] * 2 + [PAINTED] * 6 + [PLAIN] * 4
    assert a.colors[0].tolist() == a.colors[-1].tolist() == [255, 128, 0]
    assert (a.colors[2:8] == 255).all()
    assert (b.textures == PAINTED).all()


# ------------------------------------------------------------------------------------------------ families and levels


PARENTS = {
    "1.0": ({"children": ["p"]}, {"parents": ["a"]}),
    "children only": ({"children": ["p"]}, {}),
    "parents only": ({}, {"parents": ["a"]}),
    "0.6": ({}, {"parent": "a"}),
    "0.5": ({"Parts": ["p"]}, {}),
    "installation, 0.5": ({"Installations": ["p"]}, {}),
    "also in a group": ({"children": ["p"], "parents": ["g"]}, {"parents": ["g", "a"]}),
}


@pytest.mark.parametrize("form", PARENTS)
def test_parts_belong_to_their_parents(form, tmp_path):
    whole, part = PARENTS[form]
    made = document(
        p={"type": "BuildingPart", "geometry": [solid()]} | part,
        a={"type": "Building"} | whole,
        b=building(solid(SECOND), **({"parents": ["g"]} if "group" in form else {})),
        g={"type": "CityObjectGroup", "children": ["a", "b", "p"]},
    )
    layer, _ = read(made, tmp_path)
    assert {item.id: size(item) for item in layer.items} == {"a": [10, 10, 6], "b": [10, 10, 3]}


def test_parents_that_go_in_circles_end(tmp_path):
    made = document(a=building(solid(), parents=["b"]), b=building(solid(SECOND), parents=["a"]))
    layer, _ = read(made, tmp_path)
    assert sum(len(item.mesh.triangles) for item in layer.items) == 24


LEVELS = {None: 6, "3": 6, "2": 3, "1": 3, "2.2": 3, "0": 3}


@pytest.mark.parametrize("lod", LEVELS)
def test_levels_of_detail(lod, tmp_path):
    made = document(a=building(solid(SECOND, "2.2"), solid(FACES, "3.0"), {"type": "MultiPoint", "boundaries": [0]}))
    layer, ledger = read(made, tmp_path, lod=lod)
    assert size(layer.items[0])[2] == LEVELS[lod]
    assert ledger.count("noted") == (1 if lod in ("1", "0") else 0)


def test_parts_are_taken_at_their_own_level_where_nothing_else_shows_them(tmp_path):
    parts = {
        "p": {"type": "BuildingPart", "parents": ["a"], "geometry": [solid(FACES, "1"), solid(FACES, "2")]},
        "q": {"type": "BuildingPart", "parents": ["a"], "geometry": [solid(SECOND, "1")]},
    }
    layer, _ = read(document(a={"type": "Building"}, **parts), tmp_path)
    assert size(layer.items[0]) == [40, 10, 6]
    # What the whole shows at that level, its parts are not added to.
    layer, _ = read(document(a=building(solid(FACES, "2")), q=parts["q"]), tmp_path)
    assert size(layer.items[0]) == [10, 10, 6]
    layer, _ = read(
        document(a=building(solid(FACES, "1")), q=parts["q"] | {"geometry": [solid(SECOND, "2")]}), tmp_path
    )
    assert size(layer.items[0]) == [10, 10, 3], "the coarse whole gives way to its finer part"


def test_only_footprints_are_left_out(tmp_path):
    flat = {"type": "MultiSurface", "lod": "0", "boundaries": [[[0, 1, 2, 3]]]}
    made = document(a=building(flat), b=building(solid(SECOND)), c={"type": "Building"})
    layer, ledger = read(made, tmp_path)
    assert [item.id for item in layer.items] == ["b"]
    assert ledger.count("left out", "building: only footprints, without a height") == 1
    assert ledger.count("left out", "building: no geometry") == 1


def test_a_reason_names_the_geometry_that_there_is(tmp_path):
    points = {"type": "MultiPoint", "lod": "1", "boundaries": [0, 1]}
    _, ledger = read(document(a=building(points), b=building(solid(SECOND))), tmp_path)
    assert ledger.count("left out", "building: no surfaces (MultiPoint)") == 1


def test_parts_that_are_not_there_are_counted_with_their_building(tmp_path):
    part = {"type": "BuildingPart", "parents": ["a"], "geometry": [solid(SECOND)]}
    made = document(a={"type": "Building", "children": ["p", "gone", "lost"]}, p=part, b=building(solid()))
    layer, ledger = read(made, tmp_path)
    assert [item.id for item in layer.items] == ["a", "b"]
    (line,) = ledger.report(source="", crs="", origin=(0, 0, 0)).left_out
    assert (line.what, line.count, line.examples) == ("part: not in the file", 2, ("a",))


def test_footprints_with_a_height_are_prisms(tmp_path):
    """The height of a building or of its part; where there is a solid, it counts."""
    flat = {"type": "MultiSurface", "lod": "0", "boundaries": [[[0, 3, 2, 1]]]}
    other = {"type": "MultiSurface", "lod": "0", "boundaries": [[[8, 9, 10, 11]]]}
    made = document(
        a=building(flat, attributes={"measuredHeight": 25.0}),
        b=building(solid(SECOND), flat, attributes={"measuredHeight": 25.0}),
        c={"type": "Building", "attributes": {"storeysAboveGround": 2}},
        d={"type": "BuildingPart", "parents": ["c"], "geometry": [flat], "attributes": {"measuredHeight": 5}},
        e={"type": "BuildingPart", "parents": ["c"], "geometry": [other]},
    )
    layer, ledger = read(made, tmp_path)
    assert [size(item) for item in layer.items] == [[10, 10, 25], [10, 10, 3], [40, 10, pytest.approx(6.4)]]
    assert [len(item.mesh.triangles) for item in layer.items] == [12, 12, 24]
    assert ledger.count("left out") == 0
    assert {one.what: one.count for one in ledger.report(source="", crs="", origin=(0, 0, 0)).inferred} == {
        "height of a footprint from measuredHeight": 2,
        "height of a footprint from storeysAboveGround x 3.2 m": 1,
    }
    city, _ = read_city(tmp_path / "city.json", ReadOptions(network="all"))
    assert all(one.core for one in city.objects), "they are solid"


def test_footprints_of_a_sequence(tmp_path):
    """Points of prisms do not shift those of the features behind."""
    flat = {"type": "MultiSurface", "lod": "0", "boundaries": [[[0, 3, 2, 1]]]}
    high = building(flat, attributes={"measuredHeight": 25.0})
    features = [
        document(**{name: one}) | {"type": "CityJSONFeature"} for name, one in (("a", high), ("b", building(solid())))
    ]
    layer, _ = read([document(), *features, features[0]], tmp_path, name="city.jsonl")
    assert [(item.id, size(item)) for item in layer.items] == [
        ("a", [10, 10, 25]), ("b", [10, 10, 6]), ("a#2", [10, 10, 25]),
    ]  # fmt: skip


TURN = [0, -1, 0, 100, 1, 0, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1]
"""A quarter turn, twice as high, 100 m to the east."""


def instance(number=0, reference=0, matrix=TURN):
    return {"type": "GeometryInstance", "template": number, "boundaries": [reference], "transformationMatrix": matrix}


def with_templates(**objects):
    """A document with two templates: a box of 4 x 2 x 3 m with a red material and a floor of it."""
    made = document(**objects)
    made["geometry-templates"] = {
        "templates": [
            {"type": "Solid", "lod": "2", "boundaries": [FACES], "material": {"m": {"value": 0}}},
            {"type": "MultiSurface", "lod": "1", "boundaries": [[[0, 3, 2, 1]]]},
        ],
        "vertices-templates": [*box_corners(0, 0, 0, 4, 2, 3).tolist(), [9.0, 9.0, 9.0]],
    }
    made["appearance"] = {"materials": [{"name": "red", "diffuseColor": [1, 0, 0]}]}
    return made


def test_templates_are_placed_with_their_matrix(tmp_path):
    """Reference 1 is 10 m to the east of the corner of all; the floor of the other template is too coarse to count."""
    made = with_templates(
        a=building(instance(reference=1), instance(1)), b=building(solid(SECOND)), c=building(instance())
    )
    layer, ledger = read(made, tmp_path)
    low = [item.mesh.vertices.min(axis=0) - (385000.0, 6672000.0, 10.0) for item in layer.items]
    high = [item.mesh.vertices.max(axis=0) - (385000.0, 6672000.0, 10.0) for item in layer.items]
    assert np.round(low, 6).tolist() == [[108, 0, 0], [30, 0, 0], [98, 0, 0]]
    assert np.round(high, 6).tolist() == [[110, 4, 6], [40, 10, 3], [100, 4, 6]]
    assert [set(map(tuple, item.mesh.colors.tolist())) for item in layer.items][::2] == [{(255, 0, 0)}] * 2
    assert ledger.count("read", "instances of templates") == 3
    assert ledger.count("left out") == 0


def test_templates_of_a_sequence_are_painted(tmp_path):
    features = [document(**{name: building(instance())}) | {"type": "CityJSONFeature"} for name in "ab"]
    layer, _ = read([with_templates(), *features], tmp_path, name="city.jsonl")
    assert [size(item) for item in layer.items] == [[pytest.approx(2), pytest.approx(4), pytest.approx(6)]] * 2
    assert all((item.mesh.textures == PAINTED).all() for item in layer.items)


@pytest.mark.parametrize(
    ("bad", "why"),
    [
        (instance(7), "template 7 of 2"),
        (instance(-1), "template -1 of 2"),
        (instance(True), "template True of 2"),
        (instance(reference=99), "vertex 99 of 16"),
        (instance(matrix=[1, 2, 3]), "reshape"),
        (instance(matrix=[float("nan")] * 16), "16 finite numbers"),
        (instance(matrix=[1e300] * 16), "finite coordinates"),
        (instance() | {"boundaries": []}, "object b"),
        ({"type": "GeometryInstance"}, "'template'"),
    ],
)
def test_damaged_instances_are_left_out(bad, why, tmp_path):
    layer, ledger = read(with_templates(a=building(solid()), b=building(bad)), tmp_path)
    assert [item.id for item in layer.items] == ["a"]
    assert ledger.count("left out", f"building: {NOT_AS_DESCRIBED}") == 1
    with pytest.raises(CityError, match=f"object b: .*{why}|{why}"):
        read(with_templates(b=building(bad)), tmp_path)


@pytest.mark.parametrize("templates", [None, [], {}, {"templates": 5}, {"templates": [{}], "vertices-templates": []}])
def test_damaged_templates_are_left_out(templates, tmp_path):
    made = with_templates(a=building(solid()), b=building(instance())) | {"geometry-templates": templates}
    layer, ledger = read(made, tmp_path)
    assert [item.id for item in layer.items] == ["a"]
    assert ledger.count("left out", f"building: {NOT_AS_DESCRIBED}") == 1
    lines = [made | {"CityObjects": {}}, made | {"type": "CityJSONFeature"}]
    assert [item.id for item in read(lines, tmp_path, name="c.jsonl")[0].items] == ["a"]


def test_buildings_of_extensions_are_told_by_their_names(tmp_path):
    made = document(
        a=building(solid()) | {"type": "+GenericBuilding"},
        b=building(solid(SECOND)) | {"type": "+NoiseBuilding"},
        c=building(solid()) | {"type": "+NoiseCityFurnitureSegment"},
        d=building(solid()) | {"type": "+BuildingRoomExtra"},
        e={"type": "Building"},
        f=building(solid(SECOND)) | {"type": "+MyBuildingPart", "parents": ["e"]},
    )
    layer, ledger = read(made, tmp_path)
    assert [item.id for item in layer.items] == ["a", "b", "e"]
    assert {one.what: one.count for one in ledger.report(source="", crs="", origin=(0, 0, 0)).left_out} == {
        "+NoiseCityFurnitureSegment: no building": 1,
        "+BuildingRoomExtra: no building": 1,
    }


@pytest.mark.parametrize("kind", ["MultiSurface", "CompositeSurface", "Solid", "MultiSolid", "CompositeSolid"])
def test_kinds_of_geometry(kind, tmp_path):
    nested = {"Solid": [FACES, [SECOND[0]]], "MultiSolid": [[FACES], [SECOND]], "CompositeSolid": [[FACES], [SECOND]]}
    shape = {"type": kind, "lod": 2, "boundaries": nested.get(kind, FACES)}
    layer, _ = read(document(a=building(shape)), tmp_path)
    assert len(layer.items[0].mesh.triangles) == (24 if kind in ("MultiSolid", "CompositeSolid") else 12)


def test_pictures_count_more_than_solids_of_the_same_level(tmp_path):
    picture(tmp_path)
    made = textured()
    made["CityObjects"]["a"]["geometry"].insert(0, solid(SECOND, "2"))
    layer, _ = read(made, tmp_path)
    assert size(layer.items[0])[2] == 6


# ----------------------------------------------------------------------------------------------------- all else


REFERENCES = {
    "urn:ogc:def:crs:EPSG::7415": 28992,
    "https://www.opengis.net/def/crs/EPSG/0/7415": 28992,
    "EPSG:3067": 3067,
    "http://www.opengis.net/def/crs/EPSG/9.9/3067": 3067,
}


@pytest.mark.parametrize("name", REFERENCES)
def test_reference_systems(name, tmp_path):
    layer, _ = read(document(a=building(solid())) | {"metadata": {"referenceSystem": name}}, tmp_path)
    assert layer.crs.to_epsg() == REFERENCES[name]


def test_reference_systems_of_old(tmp_path):
    layer, _ = read(document(a=building(solid())) | {"metadata": {"crs": {"epsg": 7415}}}, tmp_path)
    assert layer.crs.to_epsg() == 28992
    for metadata in ({}, {"crs": None}, None):
        layer, _ = read(document(a=building(solid())) | {"metadata": metadata}, tmp_path)
        assert layer.crs is None


def test_a_crs_that_is_named_replaces_one_that_nobody_understands(tmp_path):
    made = document(a=building(solid())) | {"metadata": {"referenceSystem": "urn:adv:crs:ETRS89_UTM32*DE_DHHN92_NH"}}
    path = saved(made, tmp_path)
    with pytest.raises(CityError, match=r"city\.json: referenceSystem: an EPSG code expected.*--crs"):
        read_city(path)
    assert read_city(path, ReadOptions(crs="EPSG:3067"))[0].crs == "EPSG:3067"


def test_sequences_have_points_and_looks_of_their_own(tmp_path):
    picture(tmp_path)
    picture(tmp_path, "other.png")
    Image.fromarray(np.full((2, 2, 3), 9, dtype=np.uint8)).save(tmp_path / "other.png")
    first, second = textured(), textured(image="other.png")
    second["vertices"] = np.add(second["vertices"], (100000, 0, 0)).tolist()
    head = {key: first[key] for key in ("type", "version", "transform", "metadata")}
    lines = [head | {"CityObjects": {}, "vertices": []}]
    for id_, one in (("a", first), ("b", second)):
        own = {"type": "CityJSONFeature", "id": id_, "CityObjects": {id_: one["CityObjects"]["a"]}}
        lines.append(own | {key: one[key] for key in ("vertices", "appearance")})
    lines.append(lines[1] | {"id": "c", "CityObjects": {"c": building(solid())}, "appearance": {}})
    layer, _ = read(lines, tmp_path, name="city.jsonl")
    a, b, c = layer.items
    at = np.array([385000.0, 6672000.0, 10.0])
    assert shown(layer, a, at) == [255, 0, 0]
    assert shown(layer, a, np.add(at, (10, 0, 6))) == [0, 0, 255]
    assert shown(layer, b, np.add(at, (100, 0, 0))) == [9, 9, 9]
    assert b.mesh.uv == pytest.approx(a.mesh.uv)
    assert (c.mesh.textures == PAINTED).all()
    assert is_cityjson(tmp_path / "city.jsonl")


def test_what_is_cityjson(tmp_path):
    made = document(a=building(solid()))
    late = {"vertices": [[0, 0, 0]] * 3000} | {key: made[key] for key in ("CityObjects", "type")}
    assert is_cityjson(saved(made, tmp_path))
    assert is_cityjson(saved(late, tmp_path))
    assert not is_cityjson(saved({"type": "FeatureCollection", "features": []}, tmp_path))
    (tmp_path / "empty").write_bytes(b"")
    assert not is_cityjson(tmp_path / "empty")


# ---------------------------------------------------------------------------------------------------------- damage


def at(content, *keys):
    for key in keys:
        content = content[key]
    return content


def damage(*keys, to):
    """The small document with one value replaced (or removed)."""
    made = deepcopy(document(a=building(solid()), b=building(solid(SECOND))))
    made["appearance"] = {"textures": [{"image": "pic.png"}], "vertices-texture": [[0, 0], [1, 0], [1, 1]]}
    holder = at(made, *keys[:-1])
    if to is KeyError:
        del holder[keys[-1]]
    else:
        holder[keys[-1]] = to
    return made


GEOMETRY = ("CityObjects", "b", "geometry", 0)
FACE = (*GEOMETRY, "boundaries", 0, 1, 0)
NOT_AS_DESCRIBED = "geometry that is not as CityJSON describes it"
DAMAGES = {
    "index too large": (damage(*FACE, 2, to=16), "object b: .*vertex 16 of 16"),
    "index below 0": (damage(*FACE, 2, to=-1), "object b"),
    "index of dots": (damage(*FACE, 2, to=9.0), "object b"),
    "index true": (damage(*FACE, 2, to=True), "object b"),
    "index text": (damage(*FACE, 2, to="9"), "object b"),
    "index huge": (damage(*FACE, 2, to=10**30), "object b"),
    "index a list": (damage(*FACE, 2, to=[9]), "object b"),
    "nested too little": (damage(*GEOMETRY, "boundaries", to=SECOND), "object b"),
    "nested too much": (damage(*GEOMETRY, "boundaries", to=[[SECOND]]), "object b"),
    "no boundaries": (damage(*GEOMETRY, "boundaries", to=KeyError), "object b: .*boundaries"),
    "no type of geometry": (damage(*GEOMETRY, "type", to=KeyError), "object b"),
    "type of geometry a list": (damage(*GEOMETRY, "type", to=["Solid"]), "object b"),
    "geometry a number": (damage("CityObjects", "b", "geometry", to=7), "object b"),
    "object a list": (damage("CityObjects", "b", to=[]), "object b"),
    "no type": (damage("CityObjects", "b", "type", to=KeyError), "object b"),
    "parents a number": (damage("CityObjects", "b", "parents", to=5), None),
    "children numbers": (damage("CityObjects", "b", "children", to=[[1]]), None),
    "texture out of range": (damage(*GEOMETRY, "texture", to={"x": {"values": [[[[3, 0, 1, 2, 0]]] * 6]}}), None),
    "texture a word": (damage(*GEOMETRY, "texture", to="brick"), None),
    "vertex NaN": (damage("vertices", 11, 1, to=float("nan")), "object b: .*vertices: 11: three finite numbers"),
    "vertex infinite": (damage("vertices", 11, 1, to=float("inf")), "object b: .*vertices: 11"),
    "vertex 1e300": (damage("vertices", 11, 1, to=1e300), "object b: .*vertices: 11"),
    "vertex of 400 digits": (damage("vertices", 11, 1, to=10**400), "object b: .*vertices: 11"),
    "vertex of two": (damage("vertices", 11, to=[1, 2]), "object b: .*vertices: 11"),
    "vertex text": (damage("vertices", 11, to="none"), "object b: .*vertices: 11"),
    "vertices flat": (damage("vertices", to=[1, 2, 3, 4, 5, 6]), "object a: .*vertex 7 of 6"),
    "vertices text": (damage("vertices", to="none"), "object a: .*vertex 7 of 0"),
    "no vertices": (damage("vertices", to=[]), "object a"),
    "scale of two": (damage("transform", "scale", to=[1, 1]), "transform"),
    "scale of one": (damage("transform", "scale", to=[1]), "transform"),
    "scale of text": (damage("transform", "scale", to="big"), "transform"),
    "no translate": (damage("transform", "translate", to=KeyError), "transform"),
    "transform a list": (damage("transform", to=[1]), "transform"),
    "no objects": (damage("CityObjects", to=KeyError), "CityObjects expected, found NoneType"),
    "objects a list": (damage("CityObjects", to=[1]), "CityObjects expected, found list"),
    "unknown EPSG": (damage("metadata", "referenceSystem", to="EPSG:99999"), "referenceSystem: an EPSG code"),
    "metadata a list": (damage("metadata", to=[1]), "CityJSON of its specification expected"),
    "appearance a list": (damage("appearance", to=[1]), None),
    "texture without image": (damage("appearance", "textures", 0, to={}), None),
    "texture coordinates NaN": (damage("appearance", "vertices-texture", 1, to=[0, float("nan")]), None),
    "texture coordinates flat": (damage("appearance", "vertices-texture", to=[0, 1, 2, 3]), None),
    "picture outside": (damage("appearance", "textures", 0, to={"image": "../secret.png"}), None),
    "picture at the root": (damage("appearance", "textures", 0, to={"image": "/etc/hostname"}), None),
    "attributes a list": (damage("CityObjects", "b", to={"type": "Road", "attributes": [1], "geometry": [
        {"type": "MultiLineString", "lod": "0", "boundaries": [[0, 1]]}]}), "object b"),
}  # fmt: skip


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_told_in_one_line(name, tmp_path):
    content, wanted = DAMAGES[name]
    path = saved(content, tmp_path)
    if wanted is None:
        assert len(read_cityjson(path, Ledger()).items) == 2
        return
    if wanted.startswith("object b"):
        ledger = Ledger()
        assert [one.id for one in read_cityjson(path, ledger).items] == ["a"], "the sound one stays"
        (line,) = [one for one in ledger.report(source="", crs="", origin=(0, 0, 0)).left_out if "geometry" in one.what]
        assert (line.what.partition(": ")[2], line.count, line.examples) == (NOT_AS_DESCRIBED, 1, ("b",))
        alone = {name: one for name, one in content["CityObjects"].items() if name != "a"}
        path = saved(content | {"CityObjects": alone}, tmp_path)
    with pytest.raises(CityError, match=wanted) as caught:
        read_cityjson(path, Ledger())
    text = str(caught.value)
    assert text.startswith(str(path))
    assert "\n" not in text
    assert len(text) < 300 + len(str(path))


@pytest.mark.parametrize("end", [1, 60, 700, -3])
def test_truncated_files(end, tmp_path):
    path = saved(document(a=building(solid())), tmp_path)
    text = path.read_bytes()
    path.write_bytes(text[:end])
    with pytest.raises(CityError, match="damaged JSON"):
        read_cityjson(path, Ledger())
    lines = "\n".join([json.dumps(document()), json.dumps(document(a=building(solid())))[:end]])
    path.write_text(lines)
    with pytest.raises(CityError, match="damaged JSON"):
        read_cityjson(path, Ledger())


@pytest.mark.parametrize("text", ["[]", "7", "null", '"CityJSON"', "{}\n[]", "[" * 100000, "\ufeff{}", ""])
def test_other_json(text, tmp_path):
    path = tmp_path / "city.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(CityError) as caught:
        read_cityjson(path, Ledger())
    assert "\n" not in str(caught.value)


def test_ids_that_repeat_in_a_sequence(tmp_path):
    head = document()
    line = document(a=building(solid())) | {"type": "CityJSONFeature", "id": "a"}
    layer, ledger = read([head, line, line], tmp_path, name="city.jsonl")
    assert [one.id for one in layer.items] == ["a", "a#2"]
    assert ledger.count("repaired", "repeated id made unique") == 1


def test_nothing_of_a_damaged_building_stays(tmp_path):
    """Its sound part comes first, and is gone with the rest; a road and a sound building beside it stay."""
    wrong = deepcopy(solid(SECOND))
    wrong["boundaries"][0][0][0][0] = 99
    made = document(
        bad=building(solid()),
        part={"type": "BuildingPart", "parents": ["bad"], "geometry": [wrong]},
        good=building(solid(SECOND)),
        road={"type": "Road", "geometry": [{"type": "MultiLineString", "lod": "0", "boundaries": [[0, 8]]}]},
    )
    layer, ledger = read(made, tmp_path)
    assert [(one.id, len(one.mesh.triangles)) for one in layer.items] == [("good", 12)]
    assert len(layer.streets) == 1
    assert ledger.count("left out", f"building: {NOT_AS_DESCRIBED}") == 1


def test_building_without_area_are_left_out(tmp_path):
    made = document(a=building(solid([[[0, 1, 0]], [[2, 2, 2]]])), b=building(solid(SECOND)))
    layer, ledger = read(made, tmp_path)
    assert [item.id for item in layer.items] == ["b"]
    assert ledger.count("left out", "building: no surface with an area") == 1


def small():
    """All that the reader looks at, in 3 kB."""
    made = textured()
    made["CityObjects"]["p"] = {"type": "BuildingPart", "parents": ["a"], "geometry": [solid(SECOND)]}
    made["CityObjects"]["g"] = {"type": "TINRelief", "geometry": [
        {"type": "CompositeSurface", "lod": "1", "boundaries": [[[0, 1, 9]], [[0, 9, 8]]]}]}  # fmt: skip
    made["CityObjects"]["r"] = {"type": "Road", "attributes": {"name": "x"}, "geometry": [
        {"type": "MultiLineString", "lod": "0", "boundaries": [[0, 8, 9]]}]}  # fmt: skip
    made["appearance"]["materials"] = [{"diffuseColor": [0.1, 0.2, 0.3]}]
    made["CityObjects"]["p"]["geometry"][0]["material"] = {"m": {"value": 0}}
    return made


@settings(max_examples=400, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 9999), st.integers(0, 2), st.integers(32, 126)), min_size=1, max_size=3))
def test_bytes_changed_by_chance_raise_nothing_else(tmp_path_factory, changes):
    folder = tmp_path_factory.getbasetemp() / "fuzz_cityjson"
    if not folder.exists():
        picture(folder)
    text = bytearray(json.dumps(small(), separators=(",", ":")).encode())
    for place, kind, letter in changes:
        k = place % len(text)
        text[k : k + (kind != 1)] = b"" if kind == 0 else bytes([letter])
    (folder / "city.json").write_bytes(text)
    try:
        read_cityjson(folder / "city.json", Ledger())
    except MmiError as error:
        assert "\n" not in str(error)


WRONG = [None, True, -1, 3, 1.5, 1e308, 10**400, "", "x", [], [[]], [0], [None], {}, {"a": 1}, float("nan")]


def places(content, path=()):
    yield path
    if isinstance(content, dict | list):
        for key in content if isinstance(content, dict) else range(min(len(content), 3)):
            yield from places(content[key], (*path, key))


PLACES = [path for path in places(small()) if path]


@settings(max_examples=250, deadline=None)
@given(st.sampled_from(PLACES), st.sampled_from(WRONG), st.integers(0, 15))
def test_values_changed_by_chance_raise_nothing_else(tmp_path_factory, path, value, whole):
    folder = tmp_path_factory.getbasetemp() / "fuzz_cityjson"
    if not folder.exists():
        picture(folder)
    made = deepcopy(small())
    at(made, *path[:-1])[path[-1]] = value
    file = saved(made, folder)
    try:
        if whole == 0:
            read_city(file, ReadOptions(network="all"))
        else:
            read_cityjson(file, Ledger())
    except MmiError as error:
        assert "\n" not in str(error)


def test_the_small_file_is_sound(tmp_path):
    picture(tmp_path)
    layer, _ = read(small(), tmp_path)
    assert [len(item.mesh.triangles) for item in layer.items] == [24]
    assert len(layer.terrain.triangles) == 2
    assert len(layer.streets) == 1


def test_ids_that_repeat_in_one_file(tmp_path):
    """JSON's readers keep the last of them; what is no city object stays as they read it."""
    path = saved(document(a=building(solid()), b=building(solid(SECOND)), c=building(solid())), tmp_path)
    text = path.read_text().replace('"b":', '"a":').replace('"c":', '"a":')
    path.write_text(text.replace('"version": "1.1"', '"version": "9", "version": "1.1"'))
    ledger = Ledger()
    layer = read_cityjson(path, ledger)
    assert [one.id for one in layer.items] == ["a", "a#2", "a#3"]
    assert [size(one)[2] for one in layer.items] == pytest.approx([6.0, 3.0, 6.0])
    assert ledger.count("repaired", "repeated id made unique") == 2
