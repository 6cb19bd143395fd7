from __future__ import annotations

import json
import shutil
import struct
import subprocess
from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
import trimesh
from cities import HELSINKI, city_of, crossroads
from hypothesis import given, settings
from hypothesis import strategies as st
from model_cities import BOX_TRIANGLES, ORIGIN, box_corners, dressed_box, model_city
from shapely import affinity
from shapely.geometry import Polygon, box
from solid_checks import check_mesh

from mmi.city.model import City, CityObject, Prism, TriangleMesh
from mmi.city.welding import is_closed, volume
from mmi.foundation.errors import CityError
from mmi.foundation.srgb import srgb_from_linear
from mmi.reading.read_city import read_city
from mmi.writing.gltf_writer import write_glb

VALIDATE = """
const validator = require("gltf-validator"), fs = require("fs");
validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1])))
  .then((report) => console.log(JSON.stringify(report.issues)));
"""


def written(city, folder):
    path = folder / "city.glb"
    write_glb(city, path)
    return path


def opened(path):
    """The JSON and the binary chunk, read by hand."""
    data = path.read_bytes()
    magic, version, size, text, kind = struct.unpack_from("<4sIIII", data)
    assert (magic, version, size, kind) == (b"glTF", 2, len(data), 0x4E4F534A)
    document = json.loads(data[20 : 20 + text])
    return document, data[28 + text :]


def array(document, body, number):
    accessor = document["accessors"][number]
    view = document["bufferViews"][accessor["bufferView"]]
    dtype = {5123: "<u2", 5125: "<u4", 5126: "<f4"}[accessor["componentType"]]
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor["type"]]
    start = view["byteOffset"] + accessor["byteOffset"]
    return np.frombuffer(body, dtype, accessor["count"] * width, start).reshape(-1, width)


def primitives(document, name):
    """Material name -> primitive."""
    (node,) = [one for one in document["nodes"] if one["name"] == name]
    entries = document["meshes"][node["mesh"]]["primitives"]
    return {document["materials"][one["material"]]["name"]: one for one in entries}


def corners_of(document, body, entry):
    """(m, 3, 3) in the city's frame."""
    x, y, z = array(document, body, entry["attributes"]["POSITION"]).T
    points = np.stack([x, -z, y], axis=1)
    return points[array(document, body, entry["indices"]).reshape(-1, 3)]


def as_mesh(corners):
    return TriangleMesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


def test_nodes_and_what_the_file_says_of_itself(tmp_path):
    document, _ = opened(written(model_city(), tmp_path))
    extras = {"crs": "EPSG:3067", "origin": list(ORIGIN), "source": "models.city"}
    assert document["asset"]["extras"] == extras
    names = [node["name"] for node in document["nodes"]]
    assert names == ["way/1", "way/2", "dressed", "open", "street/1", "street 0", "street/1", "terrain"]
    assert document["nodes"][0]["extras"] == {"id": "way/1"}
    assert document["nodes"][5]["extras"] == {"name": "street 0", "kind": "street", "width": 5.0}
    assert document["nodes"][6]["extras"] == {"name": "", "kind": "residential", "width": 5.0}
    assert document["scenes"][0]["nodes"] == list(range(8))
    assert len(document["bufferViews"]) <= 5 + 2


def test_prisms_come_closed(tmp_path):
    city = model_city()
    document, body = opened(written(city, tmp_path))
    for one in city.objects:
        if one.mesh is None and one.id != "street/1":
            found = primitives(document, one.id)
            assert list(found) == ["painted"]
            corners = corners_of(document, body, found["painted"])
            exact = sum(prism.footprint.area * (prism.top - prism.bottom) for prism in one.prisms)
            assert volume(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)) == pytest.approx(exact)
            if len(one.prisms) == 1:
                assert check_mesh(as_mesh(corners)) == []


def test_looks_by_material(tmp_path):
    mesh = dressed_box()
    document, body = opened(written(model_city(), tmp_path))
    found = primitives(document, "dressed")
    assert set(found) == {"plain", "painted", "bricks", "glass/front.png"}
    for name, texture in (("plain", -1), ("painted", -2), ("bricks", 0), ("glass/front.png", 1)):
        rows = mesh.textures == texture
        corners = corners_of(document, body, found[name])
        assert corners == pytest.approx(mesh.vertices[mesh.triangles[rows]], abs=1e-5)
        index = array(document, body, found[name]["indices"]).reshape(-1, 3)
        material = document["materials"][found[name]["material"]]["pbrMetallicRoughness"]
        assert ("TEXCOORD_0" in found[name]["attributes"]) == ("baseColorTexture" in material) == (texture >= 0)
        if texture >= 0:
            uv = array(document, body, found[name]["attributes"]["TEXCOORD_0"])[index]
            assert np.stack([uv[..., 0], 1.0 - uv[..., 1]], axis=-1) == pytest.approx(mesh.uv[rows], abs=1e-6)
            source = document["textures"][material["baseColorTexture"]["index"]]["source"]
            assert document["images"][source]["name"] == name
        if name in {"plain", "glass/front.png"}:
            assert ("COLOR_0" in found[name]["attributes"]) == (name == "plain")
        if name in {"plain", "bricks"}:
            linear = array(document, body, found[name]["attributes"]["COLOR_0"])[index][..., :3] / 65535.0
            assert (srgb_from_linear(linear) == mesh.colors[rows][:, None]).all()
    assert set(primitives(document, "open")) == {"plain"}


def test_pictures_are_inside(tmp_path):
    city = model_city()
    scene = trimesh.load(written(city, tmp_path))
    shown = {
        one.visual.material.name: np.asarray(one.visual.material.baseColorTexture)
        for one in scene.geometry.values()
        if getattr(one.visual, "material", None) is not None and one.visual.material.baseColorTexture is not None
    }
    for texture in city.textures:
        assert (shown[texture.name] == texture.image).all()


def test_trimesh_finds_the_same_city(tmp_path):
    city = model_city()
    scene = trimesh.load(written(city, tmp_path))
    low, high = scene.bounds
    assert low[[0, 2]] == pytest.approx([-40.0, -40.0])  # x, and -y at the north
    assert high == pytest.approx([80.0, 30.0, 50.0])
    area = 0.0
    for node in scene.graph.nodes_geometry:
        one = scene.geometry[scene.graph[node][1]]
        if isinstance(one, trimesh.Trimesh):
            area += one.area
    ground = sum(
        np.linalg.norm(np.cross([40, 0, b - a], [40, 40, c - a])) / 2
        + np.linalg.norm(np.cross([40, 40, c - a], [0, 40, d - a])) / 2
        for j in range(2)
        for i in range(3)
        for a, b, c, d in [city.terrain.heights[[j, j, j + 1, j + 1], [i, i + 1, i + 1, i]]]
    )
    prisms = [prism for one in city.objects if one.mesh is None for prism in one.prisms]
    solid = sum(2 * p.footprint.area + p.footprint.length * (p.top - p.bottom) for p in prisms)
    boxes = 2 * 12.5 * 11 + 2 * (12.5 + 11) * 8 + 10 * 10 + 4 * 10 * 5
    assert area == pytest.approx(ground + solid + boxes, rel=1e-6)


def test_streets_and_ground(tmp_path):
    city = model_city()
    document, body = opened(written(city, tmp_path))
    (entry,) = primitives(document, "street 0").values()
    assert entry["mode"] == 3
    x, y, z = array(document, body, entry["attributes"]["POSITION"]).T
    assert np.stack([x, -z], axis=1) == pytest.approx(np.array([(-20, 0), (0, 0), (30, 4)]))
    assert y == pytest.approx(city.ground_at(np.stack([x, -z], axis=1)), abs=1e-5)
    corners = corners_of(document, body, primitives(document, "terrain")["terrain"])
    assert len(corners) == 12
    assert corners[..., 2] == pytest.approx(city.ground_at(corners), abs=1e-5)
    up = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    assert (up > 0).all()


def test_large_ground_has_wide_indices(tmp_path):
    city = crossroads()
    terrain = replace(model_city().terrain, heights=np.zeros((300, 300)), spacing=2.0)
    document, body = opened(written(replace(city, terrain=terrain), tmp_path))
    entry = primitives(document, "terrain")["terrain"]
    assert document["accessors"][entry["indices"]]["componentType"] == 5125
    corners = corners_of(document, body, entry)
    assert len(corners) == 2 * 299 * 299
    assert np.ptp(corners[..., 0]) == 598.0


def test_same_city_same_bytes(tmp_path):
    assert written(model_city(), tmp_path / "a").read_bytes() == written(model_city(), tmp_path / "b").read_bytes()


def test_what_vanishes_in_single_precision_leaves_no_hole(tmp_path):
    """Far out, vertices a millimetre apart fall together."""
    far = box_corners(3e5, 3e5, 0, 3e5 + 0.001, 3e5 + 10, 10)
    near = box_corners(0, 0, 0, 10, 10, 10)
    shape = (Prism(box(0, 0, 10, 10), 0.0, 10.0),)
    both = TriangleMesh(np.concatenate([near, far]), np.concatenate([BOX_TRIANGLES, BOX_TRIANGLES + 8]))
    objects = (CityObject("both", shape, both), CityObject("point", shape, TriangleMesh(far * 0.0, BOX_TRIANGLES)))
    document, body = opened(written(city_of(*objects), tmp_path))
    corners = corners_of(document, body, primitives(document, "both")["painted"])
    assert is_closed(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    assert len(corners) == 12 + 4
    assert "mesh" not in document["nodes"][1]


def test_refusals_leave_nothing(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(CityError, match="a writable file expected"):
        write_glb(crossroads(), tmp_path / "file" / "city.glb")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_an_empty_city(tmp_path):
    document, body = opened(written(City((), nx.MultiGraph(), "local", (0.0, 0.0, 0.0), "nothing"), tmp_path))
    assert body == b""
    assert "nodes" not in document


@settings(max_examples=30, deadline=None)
@given(
    st.integers(3, 12),
    st.floats(0.0, 6.0),
    st.integers(0, 2),
    st.floats(0.1, 80.0),
    st.booleans(),
    st.floats(-300.0, 300.0),
)
def test_random_prisms_come_closed(tmp_path_factory, count, turn, holes, height, midpoints, away):
    angles = np.arange(count) * 2.0 * np.pi / count
    outline = np.stack([np.cos(angles), np.sin(angles)], axis=1) * np.resize([20.0, 12.0, 25.0], count)[:, None]
    if midpoints:  # corners on straight walls
        outline = np.stack([outline, (outline + np.roll(outline, -1, axis=0)) / 2], axis=1).reshape(-1, 2)
    yards = [box(-2.0 + 2.5 * k, -1.0, -0.5 + 2.5 * k, 1.0).exterior.coords for k in range(holes)]
    shape = affinity.translate(affinity.rotate(Polygon(outline, yards), turn, use_radians=True), away, away)
    prism = Prism(shape, 1.0, 1.0 + height)
    document, body = opened(written(city_of(CityObject("a", (prism,))), tmp_path_factory.mktemp("random")))
    corners = corners_of(document, body, primitives(document, "a")["painted"])
    triangles = np.arange(3 * len(corners)).reshape(-1, 3)
    assert is_closed(corners.reshape(-1, 3), triangles)
    assert volume(corners.reshape(-1, 3), triangles) == pytest.approx(shape.area * height, rel=1e-4)


# ------------------------------------------------------------------------------------------------- other programs


def issues(path):
    """What the Khronos validator says; skips where it is not (``npm install gltf-validator``, NODE_PATH)."""
    if shutil.which("node") is None:
        pytest.skip("needs node and its package gltf-validator")
    done = subprocess.run(["node", "-e", VALIDATE, str(path)], capture_output=True, text=True, timeout=60, check=False)
    if "Cannot find module" in done.stderr:
        pytest.skip("needs node's package gltf-validator (npm install gltf-validator; NODE_PATH=.../node_modules)")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_khronos_validator_finds_nothing(tmp_path):
    found = issues(written(model_city(), tmp_path))
    assert found["messages"] == []


def test_helsinki(tmp_path):
    city, _ = read_city(HELSINKI)
    path = written(city, tmp_path)
    document, body = opened(path)
    for one in city.objects[::5]:
        corners = corners_of(document, body, primitives(document, one.id)["painted"])
        triangles = np.arange(3 * len(corners)).reshape(-1, 3)
        exact = sum(prism.footprint.area * (prism.top - prism.bottom) for prism in one.prisms)
        assert volume(corners.reshape(-1, 3), triangles) == pytest.approx(exact, rel=1e-4)
        if len(one.prisms) == 1:
            assert is_closed(corners.reshape(-1, 3), triangles)
    lines = [entry for mesh in document["meshes"] for entry in mesh["primitives"] if entry.get("mode") == 3]
    assert len(lines) == city.streets.number_of_edges()
    assert issues(path)["messages"] == []
