from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec

import networkx as nx
import numpy as np
import pytest
from cities import HELSINKI, block, city_of, crossroads
from cityjson_checks import check_cityjson
from hypothesis import given, settings
from hypothesis import strategies as st
from model_cities import BOX_TRIANGLES, ORIGIN, box_corners, chequers, dressed_box, model_city
from PIL import Image
from shapely.geometry import Polygon, box

from mmi.city.model import City, CityObject, Prism, TriangleMesh
from mmi.city.triangulate import triangulate
from mmi.city.welding import is_closed
from mmi.foundation.errors import CityError, ParameterError
from mmi.reading.read_city import read_city
from mmi.writing.cityjson_writer import CityJSONSeqWriter, write_cityjson


def written(city, folder, name="city.json"):
    path = folder / name
    write_cityjson(city, path)
    if path.suffix == ".json":
        return json.loads(path.read_text(encoding="utf-8"))
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def metres(document, transform=None):
    transform = transform or document["transform"]
    return np.array(document["vertices"]).reshape(-1, 3) * transform["scale"] + transform["translate"]


def enclosed(vertices, solid):
    """Volume by the divergence theorem over whole polygons, holes and all."""
    rings = [ring for shell in solid["boundaries"] for surface in shell for ring in surface]
    a = vertices[[index for ring in rings for index in ring]]
    b = vertices[[index for ring in rings for index in ring[1:] + ring[:1]]]
    first = vertices[[ring[0] for ring in rings for _ in ring]]
    start = a.mean(axis=0)
    return ((first - start) * np.cross(a - start, b - start)).sum() / 6.0


def solids_of(document, id_):
    """The Solids of an object, those of CompositeSolids too."""
    found = []
    for one in document["CityObjects"][id_].get("geometry", ()):
        if one["type"] == "Solid":
            found.append(one)
        elif one["type"] == "CompositeSolid":
            found += [one | {"type": "Solid", "boundaries": boundaries} for boundaries in one["boundaries"]]
    return found


def gathered(lines):
    """A CityJSONSeq as one document without looks, vertices not shared."""
    document = lines[0] | {"CityObjects": {}, "vertices": []}
    for line in lines[1:]:
        shift = len(document["vertices"])

        def moved(nested, by=shift):
            return [moved(one) for one in nested] if isinstance(nested, list) else nested + by

        for id_, one in line["CityObjects"].items():
            geometry = [shape | {"boundaries": moved(shape["boundaries"])} for shape in one.get("geometry", ())]
            document["CityObjects"][id_] = one | {"geometry": geometry}
        document["vertices"] += line["vertices"]
    return document


@pytest.mark.parametrize("name", ["city.json", "city.jsonl"])
def test_everything_holds_together(name, tmp_path):
    content = written(model_city(), tmp_path, name)
    if name == "city.json":
        assert check_cityjson(content) == []
    else:
        assert content[0]["type"] == "CityJSON"
        assert content[0]["CityObjects"] == {}
        for line in content[1:]:
            assert list(line["CityObjects"]) == [line["id"]]
            assert check_cityjson(line, transform=content[0]["transform"]) == []
        content = gathered(content)
    assert list(content["CityObjects"])[:5] == ["way/1", "way/2", "dressed", "open", "street/1"]
    kinds = [one["type"] for one in content["CityObjects"].values()]
    assert kinds == ["Building"] * 5 + ["Road"] * 2 + ["TINRelief"]
    lods = {id_: [shape["lod"] for shape in one["geometry"]] for id_, one in content["CityObjects"].items()}
    assert lods["way/2"] == ["1.2"]
    assert content["CityObjects"]["way/2"]["geometry"][0]["type"] == "CompositeSolid"
    assert lods["dressed"] == lods["open"] == ["2"]
    assert lods["street/0"] == ["0"]
    assert lods["terrain"] == ["1"]


@pytest.mark.parametrize("name", ["city.json", "city.jsonl"])
def test_solids_enclose_what_the_prisms_do(name, tmp_path):
    city = model_city()
    content = written(city, tmp_path, name)
    document = content if name == "city.json" else gathered(content)
    vertices = metres(document)
    for one in city.objects:
        if one.mesh is None:
            found = [enclosed(vertices, solid) for solid in solids_of(document, one.id)]
            assert found == pytest.approx([p.footprint.area * (p.top - p.bottom) for p in one.prisms])
    assert enclosed(vertices, solids_of(document, "dressed")[0]) == pytest.approx(12.5 * 11.0 * 8.0)


def test_courtyards_stay_rings(tmp_path):
    document = written(model_city(), tmp_path)
    (solid,) = solids_of(document, "way/1")
    floor, roof, *walls = solid["boundaries"][0]
    assert [len(ring) for ring in roof] == [len(ring) for ring in floor] == [4, 4]
    assert len(walls) == 8
    assert all(len(wall) == 1 and len(wall[0]) == 4 for wall in walls)
    vertices = metres(document) - ORIGIN
    rebuilt = Polygon(vertices[roof[0]], [vertices[roof[1]]])
    assert rebuilt.equals(model_city().objects[0].footprint)
    names = [solid["semantics"]["surfaces"][value]["type"] for value in solid["semantics"]["values"][0]]
    assert names == ["GroundSurface", "RoofSurface", *["WallSurface"] * 8]


def test_open_meshes_are_surfaces(tmp_path):
    document = written(model_city(), tmp_path)
    (shape,) = document["CityObjects"]["open"]["geometry"]
    assert shape["type"] == "MultiSurface"
    assert len(shape["boundaries"]) == 10
    names = [shape["semantics"]["surfaces"][value]["type"] for value in shape["semantics"]["values"]]
    assert names == ["RoofSurface"] * 2 + ["WallSurface"] * 8


def test_looks_come_back(tmp_path):
    city = model_city()
    document = written(city, tmp_path)
    mesh = dressed_box()
    (solid,) = solids_of(document, "dressed")
    looks = document["appearance"]
    files = [one["image"] for one in looks["textures"]]
    assert files == ["city.appearances/glass_front.png", "city.appearances/bricks.png"]
    assert all(one["wrapMode"] == "wrap" for one in looks["textures"])
    order = {1: 0, 0: 1}
    for place, number in ((0, 1), (1, 0)):
        with Image.open(tmp_path / files[place]) as picture:
            assert (np.asarray(picture) == city.textures[number].image).all()
    values = solid["texture"]["default"]["values"][0]
    for row, (surface, texture) in enumerate(zip(values, mesh.textures.tolist(), strict=True)):
        if texture < 0:
            assert surface == [[None]]
        else:
            assert surface[0][0] == order[texture]
            found = np.array([looks["vertices-texture"][i] for i in surface[0][1:]], dtype=np.float32)
            assert (found == mesh.uv[row]).all(), "the same numbers in single precision"
    vertices = metres(document) - ORIGIN
    corners = vertices[np.array(solid["boundaries"][0])[:, 0]]
    assert corners == pytest.approx(mesh.vertices[mesh.triangles], abs=1e-9)
    colors = [
        None if i is None else looks["materials"][i]["diffuseColor"] for i in solid["material"]["default"]["values"][0]
    ]
    bytes_ = [None if one is None else [round(255 * part) for part in one] for one in colors]
    assert bytes_ == [[90, 60, 30]] * 2 + [None] * 4 + [[255, 200, 100]] * 2 + [None] * 4


def test_streets_and_ground(tmp_path):
    city = model_city()
    document = written(city, tmp_path)
    vertices = metres(document) - ORIGIN
    road = document["CityObjects"]["street/0"]
    assert road["attributes"] == {"name": "street 0", "highway": "street", "width": 5.0}
    line = vertices[road["geometry"][0]["boundaries"][0]]
    assert line[:, :2].tolist() == pytest.approx(np.array([(-20, 0), (0, 0), (30, 4)]))
    assert line[:, 2] == pytest.approx(city.ground_at(line), abs=0.0006)
    assert line[:, 2].max() > 0.9
    # Objects come first and keep their ids; a street whose name is taken gives way.
    assert document["CityObjects"]["street/1"]["type"] == "Building"
    assert document["CityObjects"]["street/1+"]["attributes"] == {"name": "", "highway": "residential", "width": 5.0}
    tin = document["CityObjects"]["terrain"]["geometry"][0]
    assert tin["type"] == "CompositeSurface"
    corners = vertices[np.array(tin["boundaries"])[:, 0]]
    assert len(corners) == 2 * 3 * 2
    assert corners[..., 2] == pytest.approx(city.ground_at(corners), abs=0.0006)
    up = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (up[:, 2] > 0).all()
    assert up[:, 2].sum() / 2 == pytest.approx(120 * 80)


def test_metadata(tmp_path):
    head = written(model_city(), tmp_path)
    assert head["metadata"]["referenceSystem"] == "https://www.opengis.net/def/crs/EPSG/0/3067"
    assert head["metadata"]["title"] == "models.city"
    found = metres(head)
    assert head["metadata"]["geographicalExtent"] == pytest.approx([*found.min(axis=0), *found.max(axis=0)])
    assert written(model_city(), tmp_path, "c.jsonl")[0]["metadata"] == head["metadata"]
    local = written(replace(crossroads(), crs="local"), tmp_path)
    assert "referenceSystem" not in local["metadata"]
    with pytest.raises(CityError, match="a name such as EPSG:32635 expected"):
        written(replace(crossroads(), crs="+proj=tmerc +lat_0=40 +lon_0=3.3 +ellps=GRS80"), tmp_path, "lost.json")
    assert not (tmp_path / "lost.json").exists()


def test_same_city_same_bytes(tmp_path):
    for name in ("city.json", "city.jsonl"):
        for folder in ("a", "b"):
            written(model_city(), tmp_path / folder, name)
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_texture_files_of_odd_names(tmp_path):
    names = ["../wall", "wall", "WALL.jpg", "", "Straße 1.png"]
    triangle = [[0, 0, 1], [1, 0, 1], [0, 1, 1]]
    mesh = TriangleMesh(np.tile(triangle, (5, 1)) * 1.0, np.arange(15).reshape(5, 3), np.arange(5))
    one = CityObject("a", (Prism(box(0, 0, 1, 1), 0.0, 2.0),), mesh)
    textures = tuple(chequers(name, (i, i, i)) for i, name in enumerate(names))
    city = City((one,), nx.MultiGraph(), "local", (0.0, 0.0, 0.0), "made", textures=textures)
    document = written(city, tmp_path)
    files = [texture["image"] for texture in document["appearance"]["textures"]]
    stems = ["_wall", "wall", "WALL-2", "texture", "Stra_e_1"]
    assert files == [f"city.appearances/{stem}.png" for stem in stems]
    assert sorted(path.name for path in (tmp_path / "city.appearances").iterdir()) == sorted(f"{s}.png" for s in stems)


def test_progress_is_told(tmp_path):
    heard = []
    write_cityjson(crossroads(), tmp_path / "a.jsonl", progress=lambda done, count: heard.append((done, count)))
    write_cityjson(crossroads(), tmp_path / "a.json", progress=lambda done, count: heard.append((done, count)))
    assert heard == [(16, 16)] * 2


def test_refusals_leave_nothing(tmp_path):
    with pytest.raises(ParameterError, match=r"\.json or \.jsonl expected, found '.gml'"):
        write_cityjson(crossroads(), tmp_path / "city.gml")
    (tmp_path / "file").write_text("")
    with pytest.raises(CityError, match="a writable file expected"):
        write_cityjson(crossroads(), tmp_path / "file" / "city.json")
    options = {"crs": "local", "origin": (0.0, 0.0, 0.0), "source": "made"}
    with (
        pytest.raises(CityError, match="must be unique, found a twice"),
        CityJSONSeqWriter(tmp_path / "twice.jsonl", **options) as writer,
    ):
        writer.add([block("a", 0, 0, 1, 1, 2.0), block("a", 0, 0, 1, 1, 2.0)])
    with (
        pytest.raises(CityError, match="object dressed refers to texture 1 of 0"),
        CityJSONSeqWriter(tmp_path / "bare.jsonl", **options) as writer,
    ):
        writer.add(model_city().objects)
    with pytest.raises(KeyboardInterrupt), CityJSONSeqWriter(tmp_path / "stopped.jsonl", **options):
        raise KeyboardInterrupt
    with pytest.raises(ParameterError, match="only inside its with block"):
        CityJSONSeqWriter(tmp_path / "closed.jsonl", **options).add([block("a", 0, 0, 1, 1, 2.0)])
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_failed_write_keeps_what_was_there(tmp_path):
    path = tmp_path / "city.jsonl"
    write_cityjson(crossroads(), path)
    before = path.read_bytes()
    with pytest.raises(ZeroDivisionError):
        write_cityjson(model_city(), path, progress=lambda done, _: done // 0)
    assert path.read_bytes() == before


def test_the_writer_takes_a_stream(tmp_path):
    """Objects that are made as they are asked for, before and after streets."""
    made = (block(f"b/{i}", 10.0 * i, 5.0, 10.0 * i + 8.0, 13.0, 6.0) for i in range(4100))
    with CityJSONSeqWriter(tmp_path / "s.jsonl", crs="local", origin=(1.0, 2.0, 3.0), source="") as writer:
        writer.add_streets(crossroads().streets, crossroads().ground_at)
        writer.add(made)
    lines = [json.loads(line) for line in (tmp_path / "s.jsonl").read_text().splitlines()]
    assert [line["id"] for line in lines[1:]] == [f"street/{i}" for i in range(4)] + [f"b/{i}" for i in range(4100)]
    assert lines[0]["metadata"] == {"title": ""}
    assert metres(lines[-1], lines[0]["transform"]).max(axis=0) == pytest.approx([40999.0, 15.0, 9.0])


# -------------------------------------------------------------------------------------------------------- rounding


def test_slivers_vanish_and_solids_stay_closed(tmp_path):
    """Edges, slots and spikes below a millimetre."""
    house = box(0, 0, 10, 10)
    notched = house.difference(Polygon([(4, 10), (4.0002, 10), (4.0001, 5)]))  # a slot of 0.2 mm
    dotted = Polygon([(20, 0), (30, 0), (30.0002, 0.0001), (30, 10), (20, 10), (20, 0.0001)])
    needle = Polygon([(50, 0), (60, 0), (60, 0.0002)])
    pinched = Polygon([(70, 0), (80, 0), (80, 10), (75.0001, 10), (75.00005, 0.0003), (75, 10), (70, 10)])
    shapes = {"notched": notched, "dotted": dotted, "needle": needle, "pinched": pinched}
    objects = [CityObject(name, (Prism(shape, 0.0, 9.0),)) for name, shape in shapes.items()]
    objects.append(CityObject("flat", (Prism(house, 0.0, 0.0003),)))
    document = written(city_of(*objects), tmp_path)
    assert check_cityjson(document) == []
    assert "geometry" not in document["CityObjects"]["needle"]
    assert "geometry" not in document["CityObjects"]["flat"]
    for name in ("notched", "dotted", "pinched"):
        volumes = [enclosed(metres(document), solid) for solid in solids_of(document, name)]
        assert sum(volumes) == pytest.approx(900.0, abs=0.1)


def test_meshes_stay_closed_when_they_collapse(tmp_path):
    """A box with a fin 0.2 mm thick on it, and one so thin that all of it is gone."""
    fin = box_corners(4.0, 5.0, 8.0, 6.0, 5.0002, 12.0)
    base = box_corners(0, 0, 0, 10, 10, 8)
    gone = TriangleMesh(fin, BOX_TRIANGLES)
    both = TriangleMesh(np.concatenate([base, fin]), np.concatenate([BOX_TRIANGLES, BOX_TRIANGLES + 8]))
    shape = (Prism(box(0, 0, 10, 10), 0.0, 12.0),)
    document = written(city_of(CityObject("fin", shape, both), CityObject("gone", shape, gone)), tmp_path)
    assert check_cityjson(document) == []
    assert [one["type"] for one in document["CityObjects"]["fin"]["geometry"]] == ["MultiSurface"]
    assert len(document["CityObjects"]["fin"]["geometry"][0]["boundaries"]) == 12 + 4, (
        "south and north; the sides are gone"
    )
    assert [one["type"] for one in document["CityObjects"]["gone"]["geometry"]] == ["MultiSurface"]


def test_collapsed_triangles_do_not_open_a_solid(tmp_path):
    """Two corners of a roof 0.2 mm apart become one."""
    corners = np.array([(0, 0, 0), (9, 0, 0), (9, 9, 0), (0, 9, 0), (4, 4, 7), (4.0002, 4, 7)])
    sides = [[0, 3, 2], [0, 2, 1], [0, 1, 5], [0, 5, 4], [1, 2, 5], [2, 3, 4], [2, 4, 5], [3, 0, 4]]
    mesh = TriangleMesh(corners, np.array(sides))
    assert is_closed(mesh.vertices, mesh.triangles)
    document = written(city_of(CityObject("roof", (Prism(box(0, 0, 9, 9), 0.0, 7.0),), mesh)), tmp_path)
    assert check_cityjson(document) == []
    (solid,) = solids_of(document, "roof")
    assert len(solid["boundaries"][0]) == 6
    assert enclosed(metres(document), solid) == pytest.approx(189.0, rel=1e-3)


def test_separate_parts_are_separate_solids(tmp_path):
    two = np.concatenate([box_corners(0, 0, 0, 10, 10, 8), box_corners(20, 0, 0, 30, 10, 8)])
    mesh = TriangleMesh(two, np.concatenate([BOX_TRIANGLES, BOX_TRIANGLES + 8]))
    inside_out = TriangleMesh(mesh.vertices, mesh.triangles[:, ::-1])
    shape = (Prism(box(0, 0, 30, 10), 0.0, 8.0),)
    document = written(city_of(CityObject("two", shape, mesh), CityObject("in", shape, inside_out)), tmp_path)
    assert [enclosed(metres(document), solid) for solid in solids_of(document, "two")] == pytest.approx([800.0] * 2)
    assert [one["type"] for one in document["CityObjects"]["in"]["geometry"]] == ["MultiSurface"]


def test_detailed_meshes_are_lod_3(tmp_path):
    angles = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    rim = np.column_stack([5 * np.cos(angles), 5 * np.sin(angles)])
    points, caps, _ = triangulate([Polygon(rim)])
    k = np.arange(60)
    walls = [np.stack([k, (k + 1) % 60, (k + 1) % 60 + 60], 1), np.stack([k, (k + 1) % 60 + 60, k + 60], 1)]
    low, high = (np.column_stack([points, np.full(60, z)]) for z in (0.0, 7.0))
    drum = TriangleMesh(np.concatenate([low, high]), np.concatenate([caps[:, ::-1], caps + 60, *walls]))
    assert is_closed(drum.vertices, drum.triangles)
    one = CityObject("drum", (Prism(box(-5, -5, 5, 5), 0.0, 7.0),), drum)
    document = written(city_of(one), tmp_path)
    assert check_cityjson(document) == []
    assert solids_of(document, "drum")[0]["lod"] == "3"


def star(points, radii, turn):
    angles = np.arange(points) * 2.0 * np.pi / points + turn
    return np.column_stack([np.cos(angles), np.sin(angles)]) * np.resize(radii, points)[:, None]


PRISMS = st.builds(
    lambda outer, inner, count, turn, holes, bottom, height: Prism(
        Polygon(
            star(count, outer, turn) * 10.0,
            [star(3 + k, inner, turn) + 3.0 * star(3, [1.0], turn)[k] for k in range(holes)],
        ),
        bottom,
        bottom + height,
    ),
    st.lists(st.floats(0.9, 2.0), min_size=3, max_size=7),
    st.lists(st.floats(0.05, 1.0), min_size=3, max_size=5),
    st.integers(6, 14),
    st.floats(0.0, 6.0),
    st.integers(0, 3),
    st.floats(-50.0, 50.0),
    st.floats(0.01, 300.0),
)


@settings(max_examples=40, deadline=None)
@given(st.lists(PRISMS, min_size=1, max_size=3))
def test_random_prisms_become_whole_solids(tmp_path_factory, prisms):
    document = written(city_of(CityObject("a", tuple(prisms))), tmp_path_factory.mktemp("random"))
    assert check_cityjson(document) == []
    solids = solids_of(document, "a")
    assert len(solids) == len(prisms)
    for prism, solid in zip(prisms, solids, strict=True):
        exact = prism.footprint.area * (prism.top - prism.bottom)
        slack = 0.001 * (prism.footprint.length * (prism.top - prism.bottom) + prism.footprint.area)
        assert enclosed(metres(document), solid) == pytest.approx(exact, abs=slack)
        assert len(solid["boundaries"][0][1]) == 1 + len(prism.footprint.interiors)


# ------------------------------------------------------------------------------------------------------ real cities


def test_helsinki(tmp_path):
    city, _ = read_city(HELSINKI)
    head, *lines = written(city, tmp_path, "city.jsonl")
    for one, line in list(zip(city.objects, lines, strict=False))[::8]:
        assert check_cityjson(line, transform=head["transform"], self_intersections=False) == []
        vertices = metres(line, head["transform"])
        found = sum(enclosed(vertices, solid) for solid in solids_of(line, one.id))
        exact = sum(prism.footprint.area * (prism.top - prism.bottom) for prism in one.prisms)
        walls = sum(prism.footprint.length * (prism.top - prism.bottom) for prism in one.prisms)
        assert found == pytest.approx(exact, abs=0.001 * (walls + sum(prism.footprint.area for prism in one.prisms)))
    roads = [line for line in lines if line["id"] in line["CityObjects"] and line["id"].startswith("street/")]
    total = 0.0
    for road in roads:
        (shape,) = road["CityObjects"][road["id"]]["geometry"]
        flat = metres(road, head["transform"])[shape["boundaries"][0], :2]
        total += np.linalg.norm(np.diff(flat, axis=0), axis=1).sum()
    assert len(roads) == city.streets.number_of_edges()
    assert total == pytest.approx(
        sum(edge["geometry"].length for _, _, edge in city.streets.edges(data=True)), rel=1e-4
    )


CJIO = """
import json, sys
from cjio import cityjson

text = open(sys.argv[1]).read()
documents = map(json.loads, text.splitlines() if sys.argv[1].endswith("l") else [text])
read = cityjson.CityJSON(j=next(documents))
for feature in documents:
    read.add_cityjsonfeature(feature)
read.decompress()
bbox = read.calculate_bbox()
read.triangulate(sloppy=True)
print(json.dumps({"model": read.j, "epsg": read.get_epsg(), "bbox": bbox}))
"""


def read_by_cjio(path):
    """What cjio makes of a file, triangulated; in a process of its own, for it changes how everybody writes JSON."""
    if find_spec("cjio") is None:
        pytest.skip("needs cjio")
    done = subprocess.run([sys.executable, "-c", CJIO, path], capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def test_cjio_reads_it(tmp_path):
    path = tmp_path / "city.json"
    write_cityjson(model_city(), path)
    found = read_by_cjio(path)
    model = found["model"]
    assert len(model["CityObjects"]) == 8
    assert found["epsg"] == 3067
    assert found["bbox"] == pytest.approx(model["metadata"]["geographicalExtent"])
    vertices = np.array(model["vertices"])
    yard = model["CityObjects"]["way/1"]["geometry"][0]["boundaries"][0]
    corners = vertices[np.array(yard)[:, 0]]
    sizes = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    assert sizes.sum() == pytest.approx(2 * (400 - 56) + 12 * (80 + 30)), (
        "floor, roof, walls outside and in the courtyard"
    )


def test_cjio_reads_the_sequence(tmp_path):
    head, *_ = written(model_city(), tmp_path, "city.jsonl")
    found = read_by_cjio(tmp_path / "city.jsonl")
    assert len(found["model"]["CityObjects"]) == 8
    assert len(found["model"]["appearance"]["textures"]) == 2
    assert found["bbox"] == pytest.approx(head["metadata"]["geographicalExtent"])


def test_an_empty_city(tmp_path):
    city = City((), nx.MultiGraph(), "local", (0.0, 0.0, 0.0), "nothing")
    document = written(city, tmp_path)
    assert document["CityObjects"] == {}
    assert document["vertices"] == []
    assert "geographicalExtent" not in document["metadata"]
    assert check_cityjson(document) == []
    assert len(written(city, tmp_path, "nothing.jsonl")) == 1


def test_large_ground_is_cut_into_tiles(tmp_path):
    terrain = model_city().terrain
    heights = np.add.outer(np.arange(3.0), np.arange(300.0))
    city = replace(crossroads(), terrain=replace(terrain, heights=heights, spacing=1.0))
    document = written(city, tmp_path)
    assert [id_ for id_ in document["CityObjects"] if id_.startswith("terrain")] == ["terrain/0-0", "terrain/0-1"]
    count = sum(len(document["CityObjects"][f"terrain/0-{k}"]["geometry"][0]["boundaries"]) for k in (0, 1))
    assert count == 2 * 2 * 299


def test_a_city_without_textures_has_no_folder_of_them(tmp_path):
    written(crossroads(), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["city.json"]
