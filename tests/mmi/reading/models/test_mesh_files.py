"""3D models in: what trimesh and hand-written files put in comes out, with looks, the right way up, in the right pieces."""

from __future__ import annotations

import base64
import io
import json
import struct
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from cities import crossroads, real
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from mmi.city.model import PAINTED, PLAIN, TriangleMesh
from mmi.foundation.errors import CityError, ParameterError
from mmi.reading.models.gltf_reader import read_gltf
from mmi.reading.models.mesh_files import is_mesh, read_meshes, up_axis
from mmi.reading.models.raw_meshes import joined_meshes
from mmi.reading.models.triangle_soup import split_into_objects, welded
from mmi.reading.report import Ledger
from mmi.writing.gltf_writer import write_glb

RED, GREEN, BLUE, WHITE = (255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 255)


def picture() -> Image.Image:
    """2 x 2 pixels: red green above blue white."""
    return Image.fromarray(np.array([[RED, GREEN], [BLUE, WHITE]], dtype=np.uint8))


def encoded(image: Image.Image, kind: str = "PNG") -> bytes:
    file = io.BytesIO()
    image.save(file, kind)
    return file.getvalue()


def box(x, y, z, dx, dy, dz):
    """A closed box from its low corner."""
    return trimesh.creation.box(
        (dx, dy, dz), trimesh.transformations.translation_matrix((x + dx / 2, y + dy / 2, z + dz / 2))
    )


def mesh_of(*parts):
    whole = trimesh.util.concatenate(parts)
    return TriangleMesh(np.array(whole.vertices), np.array(whole.faces))


def area(mesh):
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()


def uv_at(mesh, point):
    """Texture coordinates of a point of the surface, and the texture of its triangle."""
    for corners, uv, texture in zip(mesh.vertices[mesh.triangles], mesh.uv, mesh.textures, strict=True):
        weights, *_ = np.linalg.lstsq(np.vstack([corners.T, np.ones(3)]), np.append(point, 1.0), rcond=None)
        if weights.min() > -1e-9 and np.allclose(weights @ corners, point, atol=1e-6):
            return weights @ uv, texture
    raise AssertionError(f"{point} lies on no triangle")


def color_at(layer, mesh, point):
    """The texel that a point of the surface shows: u right, v up, nearest."""
    (u, v), texture = uv_at(mesh, point)
    image = layer.textures[texture].image
    h, w, _ = image.shape
    return tuple(image[int((1.0 - v % 1.0) * h) % h, int(u % 1.0 * w) % w])


def write_gltf(path, *, material=None, attributes=None, node=None, mode=4, extras=None, more=None, indices=None):
    """A glTF with a quad (2 m wide, 1 m high, in the plane z = 0, Y up) and the picture, buffers inside."""
    arrays = {
        "POSITION": np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]], dtype="<f4"),
        "TEXCOORD_0": np.array([[0, 1], [1, 1], [1, 0], [0, 0]], dtype="<f4"),
    } | (attributes or {})
    order = np.array([0, 1, 2, 0, 2, 3] if indices is None else indices, dtype="<u2")
    blobs = [*(array.tobytes() for array in arrays.values()), order.tobytes(), encoded(picture())]
    views, body = [], b""
    for blob in blobs:
        views.append({"buffer": 0, "byteOffset": len(body), "byteLength": len(blob)})
        body += blob + b"\0" * (-len(blob) % 4)
    kinds = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
    accessors = [
        {"bufferView": i, "componentType": 5126, "count": len(a), "type": kinds[a.shape[1]]}
        for i, a in enumerate(arrays.values())
    ]
    accessors.append({"bufferView": len(arrays), "componentType": 5123, "count": len(order), "type": "SCALAR"})
    primitive = {"attributes": {n: i for i, n in enumerate(arrays)}, "indices": len(arrays), "mode": mode}
    document = {
        "asset": {"version": "2.0"} | ({"extras": extras} if extras else {}),
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "house", "mesh": 0} | (node or {})],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [
            {"byteLength": len(body), "uri": "data:application/octet-stream;base64," + base64.b64encode(body).decode()}
        ],
        "images": [{"bufferView": len(arrays) + 1, "mimeType": "image/png", "name": "front"}],
        "textures": [{"source": 0}],
    }
    if material is not None:
        document["materials"] = [material]
        primitive["material"] = 0
    path.write_text(json.dumps(document | (more or {})))
    return path


TEXTURED = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}


# ----------------------------------------------------------------------------------------------------- glTF


def test_boxes_of_a_scene_come_back_as_objects_with_their_colours_and_z_up(tmp_path):
    scene = trimesh.Scene()
    for name, at, color in (("a", (0, 0, 0), RED), ("b", (30, 5, 40), BLUE)):
        one = trimesh.creation.box((4.0, 10.0, 6.0))  # Y up: 10 m high
        one.visual = trimesh.visual.TextureVisuals(
            material=trimesh.visual.material.PBRMaterial(baseColorFactor=(*color, 255))
        )
        scene.add_geometry(one, node_name=name, transform=trimesh.transformations.translation_matrix(at))
    path = tmp_path / "two.glb"
    path.write_bytes(scene.export(file_type="glb"))
    ledger = Ledger()
    layer = read_meshes(path, ledger)
    assert [one.id for one in layer.items] == ["a", "b"]
    a, b = (one.mesh for one in layer.items)
    np.testing.assert_allclose(np.ptp(a.vertices, axis=0), (4.0, 6.0, 10.0))
    np.testing.assert_allclose(b.vertices.mean(axis=0), (30.0, -40.0, 5.0), atol=1e-5)
    assert area(a) == pytest.approx(2 * (4 * 6 + 4 * 10 + 6 * 10))
    assert (a.textures == PLAIN).all()
    assert {tuple(c) for c in a.colors} == {RED}
    assert {tuple(c) for c in b.colors} == {BLUE}
    normals = np.cross(*(a.vertices[a.triangles[:, k]] - a.vertices[a.triangles[:, 0]] for k in (1, 2)))
    outward = a.vertices[a.triangles].mean(axis=1) - a.vertices.mean(axis=0)
    assert ((normals * outward).sum(axis=1) > 0).all()
    assert ledger.count("read", "triangles of meshes") == 24


def test_a_mirrored_node_keeps_its_outside(tmp_path):
    path = write_gltf(tmp_path / "m.gltf", node={"scale": [-1.0, 1.0, 1.0]})
    mesh = read_meshes(path, Ledger()).items[0].mesh
    a, b, c = mesh.vertices[mesh.triangles[0]]
    assert np.cross(b - a, c - a)[1] < 0.0  # it faced +z of glTF, that is -y here, and still does


def test_pictures_stand_upright(tmp_path):
    layer = read_meshes(write_gltf(tmp_path / "q.gltf", material=TEXTURED), Ledger())
    mesh = layer.items[0].mesh
    assert layer.textures[0].name == "front"
    shown = [color_at(layer, mesh, (x, 0.0, z)) for z in (0.9, 0.1) for x in (0.1, 1.9)]
    assert shown == [RED, GREEN, BLUE, WHITE]


def test_texture_transform_turns_counter_clockwise_about_the_upper_left(tmp_path):
    """The example of the extension's text: offset (0, 1), a quarter turn and half the size stay inside the picture."""
    moved = {"offset": [0.0, 1.0], "rotation": np.pi / 2, "scale": [0.5, 0.5]}
    material = {
        "pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "extensions": {"KHR_texture_transform": moved}}}
    }
    mesh = read_meshes(write_gltf(tmp_path / "t.gltf", material=material), Ledger()).items[0].mesh
    # v down: (0, 1), (1, 1), (1, 0) become (0.5, 1), (0.5, 0.5), (0, 0.5).
    found = [uv_at(mesh, point)[0] for point in ((0, 0, 0), (2, 0, 0), (2, 0, 1))]
    np.testing.assert_allclose(found, [(0.5, 0.0), (0.5, 0.5), (0.0, 0.5)], atol=1e-6)


def test_linear_factors_and_vertex_colours_become_srgb(tmp_path):
    shades = np.full((4, 3), 0.5, dtype="<f4")
    material = {"pbrMetallicRoughness": {"baseColorFactor": [1.0, 0.5, 0.0, 1.0]}}
    path = write_gltf(tmp_path / "c.gltf", material=material, attributes={"COLOR_0": shades})
    mesh = read_meshes(path, Ledger()).items[0].mesh
    # 0.5 -> 188, 0.25 -> 137 (IEC 61966-2-1)
    assert {tuple(one) for one in mesh.colors} == {(188, 137, 0)}


def test_faces_without_material_and_those_called_painted_are_painted(tmp_path):
    for material in (None, {"name": "painted"}):
        mesh = read_meshes(write_gltf(tmp_path / "p.gltf", material=material), Ledger()).items[0].mesh
        assert (mesh.textures == PAINTED).all()


def test_alpha_counts_only_where_the_material_says_so(tmp_path):
    see_through = np.zeros((2, 2, 4), dtype=np.uint8)
    see_through[0] = (*RED, 255)
    see_through[1] = (*BLUE, 0)
    uri = "data:image/png;base64," + base64.b64encode(encoded(Image.fromarray(see_through))).decode()
    images = {"images": [{"uri": uri}]}
    ledger = Ledger()
    masked = read_meshes(
        write_gltf(tmp_path / "a.gltf", material=TEXTURED | {"alphaMode": "MASK"}, more=images), ledger
    )
    assert (masked.textures[0].image == RED).all()
    assert ledger.count("noted", "picture with alpha drawn opaque, on its mean colour") == 1
    opaque = read_meshes(write_gltf(tmp_path / "b.gltf", material=TEXTURED, more=images), Ledger())
    assert (opaque.textures[0].image[1] == BLUE).all()


def test_our_own_streets_terrain_crs_and_origin(tmp_path):
    path = write_gltf(
        tmp_path / "s.gltf",
        mode=3,
        indices=[0, 1, 2],
        node={"name": "Main Street", "extras": {"kind": "residential", "width": 7.0, "name": "Main Street"}},
        extras={"crs": "EPSG:32632", "origin": [500000.0, 5000000.0, 0.0]},
    )
    layer = read_meshes(path, Ledger())
    (street,) = layer.streets
    assert street.tags == {"highway": "residential", "width": "7.0", "name": "Main Street"}
    assert list(street.lines[0].coords)[:2] == [(500000.0, 5000000.0), (500002.0, 5000000.0)]
    assert layer.crs is not None
    assert layer.crs.to_epsg() == 32632
    ground = read_meshes(write_gltf(tmp_path / "g.gltf", node={"name": "terrain"}), Ledger())
    assert ground.terrain is not None
    assert ground.items == ()


def test_a_city_that_we_wrote_comes_back(tmp_path):
    city = replace(crossroads(), origin=(385000.0, 6671000.0, 0.0), crs="EPSG:32635")
    write_glb(city, tmp_path / "city.glb")
    layer = read_meshes(tmp_path / "city.glb", Ledger())
    assert layer.crs is not None
    assert layer.crs.to_epsg() == 32635
    assert len(layer.streets) == city.streets.number_of_edges()
    assert [one.id for one in layer.items] == [one.id for one in city.objects]
    for item, one in zip(layer.items, city.objects, strict=True):
        assert (item.mesh.textures == PAINTED).all()
        low, high = item.mesh.vertices.min(axis=0) - city.origin, item.mesh.vertices.max(axis=0) - city.origin
        assert (*low[:2], *high[:2]) == pytest.approx(one.footprint.bounds, abs=1e-3)
        assert (low[2], high[2]) == pytest.approx((one.base, one.top), abs=1e-3)


def test_strips_and_fans(tmp_path):
    for mode, order in ((5, [0, 1, 3, 2]), (6, [0, 1, 2, 3])):
        mesh = read_meshes(write_gltf(tmp_path / "s.gltf", mode=mode, indices=order), Ledger()).items[0].mesh
        assert area(mesh) == pytest.approx(2.0)
        a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
        assert (np.cross(b - a, c - a)[:, 1] < 0.0).all()


def test_lines_on_the_ground_are_streets_and_upright_ones_are_edges(tmp_path):
    flat = {"POSITION": np.array([[0, 0, 0], [9, 0, 0], [9, 0, -5], [0, 0, -5]], dtype="<f4")}
    for mode, order in ((1, [0, 1, 1, 2]), (2, [0, 1, 2, 3]), (3, [0, 1, 2])):
        layer = read_gltf(write_gltf(tmp_path / "l.gltf", mode=mode, indices=order, attributes=flat), Ledger())
        assert len(layer.streets) == 1
        ledger = Ledger()
        with pytest.raises(CityError, match="no triangles"):
            read_gltf(write_gltf(tmp_path / "e.gltf", mode=mode, indices=order), ledger)
        assert ledger.count("noted", "lines that draw the edges of a model: no streets") == 1


COPIES = {
    "translation": np.array([[0, 0, 0], [10, 0, 0], [0, 0, -20]], dtype="<f4"),
    "rotation": np.array(
        [[0, 0, 0, 1], [0, 0.5**0.5, 0, 0.5**0.5], [0, 0, 0, 1]], dtype="<f4"
    ),  # 90 degrees about y, up
    "scale": np.array([[1, 1, 1], [1, 1, 1], [2, 3, 1]], dtype="<f4"),
}


def instanced(path, keys=tuple(COPIES), *, node=None, drop=None, required=True):
    """The quad in three copies; the attributes of the instances are accessors behind those of the mesh."""
    attributes = {key.upper(): COPIES[key][: -1 if key == drop else None] for key in keys}
    write_gltf(path, attributes=attributes)
    document = json.loads(path.read_text())
    primitive = document["meshes"][0]["primitives"][0]
    moved = {key: primitive["attributes"].pop(key) for key in attributes}
    document["nodes"][0] |= {"extensions": {"EXT_mesh_gpu_instancing": {"attributes": moved}}} | (node or {})
    if required:
        document["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
    path.write_text(json.dumps(document))
    return path


def test_instances_of_a_mesh_are_copies_of_it(tmp_path):
    """x east, y up, z south becomes x east, y north, z up; the second copy is turned from the east to the north."""
    ledger = Ledger()
    layer = read_meshes(instanced(tmp_path / "x.gltf", node={"translation": [100, 0, 0]}), ledger)
    assert [one.id for one in layer.items] == ["house", "house#2", "house#3"]
    low = [one.mesh.vertices.min(axis=0).round(5).tolist() for one in layer.items]
    high = [one.mesh.vertices.max(axis=0).round(5).tolist() for one in layer.items]
    assert low == [[100, 0, 0], [110, 0, 0], [100, 20, 0]]
    assert high == [[102, 0, 1], [110, 2, 1], [104, 20, 3]]
    assert ledger.count("read", "instances of meshes (EXT_mesh_gpu_instancing)") == 3
    assert ledger.count("left out") == 0


def test_instances_need_no_attribute_but_one(tmp_path):
    for key in COPIES:
        assert len(read_gltf(instanced(tmp_path / "x.gltf", (key,), required=False), Ledger()).items) == 3
    with pytest.raises(CityError, match=r"x\.gltf.*instances expected, as many of each kind"):
        read_gltf(instanced(tmp_path / "x.gltf", drop="scale"), Ledger())
    with pytest.raises(CityError, match=r"x\.gltf.*instances expected"):
        read_gltf(instanced(tmp_path / "x.gltf", ()), Ledger())


@pytest.mark.parametrize(("scene", "shown"), [(0, "a"), (1, "b"), (None, "a")])
def test_the_scene_that_is_shown_counts_and_the_others_are_counted(tmp_path, scene, shown):
    nodes = [{"name": name, "mesh": 0} for name in "ab"]
    path = write_gltf(tmp_path / "x.gltf", more={"nodes": nodes, "scenes": [{"nodes": [0]}, {"nodes": [1]}]})
    document = json.loads(path.read_text()) | {"scene": scene}
    path.write_text(json.dumps({key: value for key, value in document.items() if value is not None}))
    ledger = Ledger()
    assert [one.id for one in read_gltf(path, ledger).items] == [shown]
    (line,) = ledger.report(source="", crs="", origin=(0, 0, 0)).left_out
    assert (line.what, line.examples) == ("mesh: not in the scene that is shown", ("b" if shown == "a" else "a",))


def test_a_scene_without_anything_says_what_is_elsewhere(tmp_path):
    path = write_gltf(tmp_path / "x.gltf", more={"scenes": [{}, {"nodes": [0]}]})
    with pytest.raises(CityError, match=r"no triangles in it; .*; left out: 1 mesh: not in the scene that is shown$"):
        read_gltf(path, Ledger())


def test_a_damaged_node_is_left_out_and_named(tmp_path):
    """Its mesh points at corners that are not there; the sound house before it and the one behind stay."""
    path = write_gltf(tmp_path / "x.gltf")
    document = json.loads(path.read_text())
    broken = json.loads(json.dumps(document["meshes"][0]))
    broken["primitives"].append({"attributes": {"POSITION": 99}})
    document["meshes"].append(broken)
    document["nodes"] = [{"name": name, "mesh": int(name == "bad")} for name in ("a", "bad", "b")]
    document["scenes"] = [{"nodes": [0, 1, 2]}]
    path.write_text(json.dumps(document))
    ledger = Ledger()
    assert [one.id for one in read_gltf(path, ledger).items] == ["a", "b"]
    (line,) = ledger.report(source="", crs="", origin=(0, 0, 0)).left_out
    assert (line.what, line.count, line.examples) == ("mesh: not as glTF describes it", 1, ("bad",))


@pytest.mark.parametrize("text", ["EPSG:25833", "EPSG:25833+5783"])
def test_a_vertical_system_beside_the_horizontal_one(tmp_path, text):
    layer = read_gltf(write_gltf(tmp_path / "x.gltf", extras={"crs": text}), Ledger())
    assert layer.crs.to_epsg() == 25833


def test_a_truncated_glb_says_so(tmp_path):
    path = tmp_path / "cut.glb"
    whole = trimesh.creation.box().export(file_type="glb")
    for size in (3, 15, 200, len(whole) - 10):
        path.write_bytes(whole[:size])
        with pytest.raises(CityError, match=r"cut\.glb"):
            read_meshes(path, Ledger())


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_a_damaged_glb_is_a_city_error_or_a_city(tmp_path_factory, data):
    whole = bytearray(trimesh.creation.box().export(file_type="glb"))
    size = struct.unpack_from("<I", whole, 12)[0]
    for _ in range(data.draw(st.integers(1, 4))):
        whole[data.draw(st.integers(12, 20 + size + 40))] = data.draw(st.integers(32, 126))
    path = tmp_path_factory.getbasetemp() / "damaged.glb"
    path.write_bytes(bytes(whole))
    try:
        read_meshes(path, Ledger())
    except CityError as error:
        assert "damaged.glb" in str(error)
        assert "\n" not in str(error)


@pytest.mark.parametrize(
    "uri", ["../secret.bin", "/etc/passwd", "https://example.org/a.bin", "a/%2e%2e/%2e%2e/secret.bin"]
)
def test_buffers_outside_the_folder_are_refused(tmp_path, uri):
    folder = tmp_path / "model"
    folder.mkdir()
    (tmp_path / "secret.bin").write_bytes(bytes(1000))
    path = write_gltf(folder / "x.gltf", more={"buffers": [{"byteLength": 10, "uri": uri}]})
    with pytest.raises(CityError, match="its own folder"):
        read_meshes(path, Ledger())


def test_missing_pictures_are_noted_and_compressed_files_refused(tmp_path):
    ledger = Ledger()
    layer = read_meshes(
        write_gltf(tmp_path / "x.gltf", material=TEXTURED, more={"images": [{"uri": "none.png"}]}), ledger
    )
    assert (layer.items[0].mesh.textures == PLAIN).all()
    assert ledger.count("left out", "picture: its file is missing") == 1
    path = write_gltf(tmp_path / "d.gltf", more={"extensionsRequired": ["KHR_draco_mesh_compression"]})
    with pytest.raises(CityError, match=r"KHR_draco_mesh_compression.*expected a plain file"):
        read_meshes(path, Ledger())


# ----------------------------------------------------------------------------------------------------- OBJ


def test_obj_groups_materials_pictures_and_polygons(tmp_path):
    picture().save(tmp_path / "my wall.png")
    (tmp_path / "m.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl wall\nKd 0 0 0\nmap_Kd -s 2 1 1 my wall.png\n")
    (tmp_path / "x.obj").write_text(
        "mtllib m.mtl\nv 0 0 0\nv 4 0 0\nv 4 2 0\nv 2 2 0\nv 2 4 0\nv 0 4 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
        "o floor\nusemtl red\nf 1 2 3 4 5 6\n"
        "o wall\nv 10 0 0\nv 14 0 0\nv 14 0 3\nv 10 0 3\nusemtl wall\nf -4/1 -3/2 -2/3 -1/4\n"
        "o bare\nv 20 0 0\nv 21 0 0\nv 21 0 5\nusemtl unknown\nf -3 -2 -1\n"
    )
    ledger = Ledger()
    layer = read_meshes(tmp_path / "x.obj", ledger, up="z")
    floor, wall, bare = (one.mesh for one in layer.items)
    assert [one.id for one in layer.items] == ["floor", "wall", "bare"]
    assert area(floor) == pytest.approx(12.0)  # an L: a fan would cover more
    assert {tuple(c) for c in floor.colors} == {RED}
    assert area(wall) == pytest.approx(12.0)
    assert uv_at(wall, (14.0, 0.0, 3.0))[0] == pytest.approx((2.0, 1.0))
    shown = [color_at(layer, wall, (x, 0.0, z)) for z in (2.9, 0.1) for x in (10.1, 11.9, 12.1)]
    assert shown == [RED, GREEN, RED, BLUE, WHITE, BLUE]  # it repeats after 2 m
    assert (bare.textures == PAINTED).all()
    assert ledger.count("noted", "material that no .mtl defines: painted") == 1


def test_obj_quad_with_an_inner_corner_is_cut_there(tmp_path):
    (tmp_path / "dart.obj").write_text("v 0 0 0\nv 4 0 0\nv 1 1 0\nv 0 4 0\nf 2 3 4 1\nf 1 2 3 4\n")
    mesh = read_meshes(tmp_path / "dart.obj", Ledger(), up="z").items[0].mesh
    assert area(mesh) == pytest.approx(4.0)  # the same dart twice: one is dropped


def test_obj_without_its_files_is_read_and_bad_ones_are_refused(tmp_path):
    ledger = Ledger()
    path = tmp_path / "x.obj"
    path.write_text("mtllib no.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n")
    assert (read_meshes(path, ledger).items[0].mesh.textures == PAINTED).all()
    assert ledger.count("left out", "materials: their .mtl is missing") == 1
    for text, what in (
        ("v 0 0 0\nv 1 0 0\nf 1 2 3\n", "cut off"),
        ("v 0 0 zero\n", "line 1"),
        ("v 0 0 0\nf 1 2 0\n", "line 2"),
        ("v 0 0 0\n", "with faces"),
        ("mtllib ../m.mtl\nv 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n", "its own folder"),
        ("v nan 0 0\nv 1 0 0\nv 0 0 1e30\nf 1 2 3\n", "numbers"),
    ):
        path.write_text(text)
        with pytest.raises(CityError, match=what):
            read_meshes(path, Ledger())


def test_corners_without_a_place_are_dropped_and_counted(tmp_path):
    path = tmp_path / "x.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 0 1\nv nan 0 0\nv 1e30 0 0\nf 1 2 3\nf 1 2 4\nf 2 3 5\n")
    ledger = Ledger()
    assert len(read_meshes(path, ledger).items[0].mesh.triangles) == 1
    assert ledger.count("left out") == 2


@pytest.mark.parametrize("turn", [0.0, 0.4])
def test_the_axis_that_points_up_is_found(turn):
    rng = np.random.default_rng(4)
    houses = [box(x, y, 0, 10, 8, rng.uniform(6, 20)) for x in range(0, 200, 20) for y in range(0, 200, 20)]
    city = trimesh.util.concatenate(houses)
    city.apply_transform(trimesh.transformations.rotation_matrix(turn, (0, 0, 1)))
    z_up = TriangleMesh(np.array(city.vertices), np.array(city.faces))
    y_up = TriangleMesh(z_up.vertices[:, [0, 2, 1]] * (1, 1, -1), z_up.triangles)
    assert (up_axis(z_up), up_axis(y_up)) == ("z", "y")


def test_y_up_is_turned_and_can_be_forced(tmp_path):
    path = tmp_path / "x.obj"
    path.write_text("v 0 0 0\nv 4 0 0\nv 0 9 0\nf 1 2 3\n")
    assert np.ptp(read_meshes(path, Ledger(), up="y").items[0].mesh.vertices, axis=0).tolist() == [4.0, 0.0, 9.0]
    assert np.ptp(read_meshes(path, Ledger(), up="z").items[0].mesh.vertices, axis=0).tolist() == [4.0, 9.0, 0.0]
    with pytest.raises(ParameterError):
        read_meshes(path, Ledger(), up="x")


# ----------------------------------------------------------------------------------------------------- others


@pytest.mark.parametrize("kind", ["ply", "stl", "off"])
def test_what_trimesh_reads(tmp_path, kind):
    path = tmp_path / f"x.{kind}"
    mesh = box(0, 0, 0, 4, 6, 10)
    if kind == "ply":
        mesh.visual.vertex_colors = np.tile((*GREEN, 255), (8, 1))
    mesh.export(path)
    assert is_mesh(path)
    item = read_meshes(path, Ledger(), up="z").items[0]
    assert area(item.mesh) == pytest.approx(2 * (24 + 40 + 60))
    assert np.ptp(item.mesh.vertices, axis=0) == pytest.approx((4, 6, 10))
    if kind == "ply":
        assert {tuple(c) for c in item.mesh.colors} == {GREEN}
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(CityError, match=f"x.{kind}"):
        read_meshes(path, Ledger())


def test_what_is_not_read_says_how_to_convert_it(tmp_path):
    path = tmp_path / "city.3ds"
    path.write_bytes(b"MM\0\0")
    assert is_mesh(path)
    with pytest.raises(CityError, match=r"assimp export city\.3ds city\.glb"):
        read_meshes(path, Ledger())
    assert not is_mesh(tmp_path / "none.geojson")


# ----------------------------------------------------------------------------------------------------- splitting


def boxes_of_a_town(n=12):
    rng = np.random.default_rng(7)
    return [box(20.0 * (i % 4), 20.0 * (i // 4), 0.0, *rng.uniform(5, 15, 2), rng.uniform(4, 30)) for i in range(n)]


@settings(max_examples=12, deadline=None)
@given(st.randoms(use_true_random=False))
def test_a_soup_of_boxes_is_split_into_them_in_any_order(random):
    houses = boxes_of_a_town()
    soup = trimesh.util.concatenate(houses).triangles  # no shared corners at all
    order = list(range(len(soup)))
    random.shuffle(order)
    turns = [random.randrange(3) for _ in order]
    corners = np.array([np.roll(soup[i], turn, axis=0) for i, turn in zip(order, turns, strict=True)]).reshape(-1, 3)
    places = list(range(len(corners)))
    random.shuffle(places)
    mesh = TriangleMesh(corners[places], np.argsort(places).reshape(-1, 3))
    models, ground = split_into_objects(mesh, Ledger())
    assert ground is None
    expected = [
        f"mesh/{np.round(h.bounds.mean(axis=0)[0]):.0f},{np.round(h.bounds.mean(axis=0)[1]):.0f}" for h in houses
    ]
    assert sorted(one.id for one in models) == sorted(expected)
    by_id = dict(zip(expected, houses, strict=True))
    for one in models:
        assert area(one.mesh) == pytest.approx(by_id[one.id].area)
        assert len(one.mesh.vertices) == 8
    # The same arrays whatever the order, but for the corner that a triangle starts with.
    still, _ = split_into_objects(mesh_of(*houses), Ledger())
    assert [one.id for one in still] == [one.id for one in models]
    for a, b in zip(still, models, strict=True):
        np.testing.assert_array_equal(a.mesh.vertices, b.mesh.vertices)
        np.testing.assert_array_equal(np.sort(a.mesh.triangles, axis=1), np.sort(b.mesh.triangles, axis=1))


def test_chimneys_and_dormers_go_with_their_house_and_bridges_join_nothing():
    house, other = box(0, 0, 0, 10, 10, 8), box(14, 0, 0, 10, 10, 8)
    chimney, dormer = box(2, 2, 8, 1, 1, 2), box(4, -0.6, 5, 2, 1, 2)
    bridge = box(9.98, 4, 5, 4.04, 2, 2)
    models, _ = split_into_objects(mesh_of(house, other, chimney, dormer, bridge), Ledger())
    assert len(models) == 2
    tops = sorted(one.mesh.vertices[:, 2].max() for one in models)
    assert tops == [8.0, 10.0]
    row = [box(10.0 * i, 0, 0.5 * i, 10, 10, 8) for i in range(4)]  # terraced houses on a slope stay four
    models, _ = split_into_objects(mesh_of(*row), Ledger(), tolerance=0.001)
    assert len(models) == 4


def test_degenerate_and_double_triangles_are_dropped_and_counted():
    one = mesh_of(box(0, 0, 0, 4, 4, 4))
    n = len(one.vertices)
    vertices = np.concatenate([one.vertices, one.vertices + 0.0004, [(0, 0, 0), (1, 0, 0), (2, 0, 0)]])
    triangles = np.concatenate(
        [one.triangles, one.triangles[:5, ::-1] + n, [(0, 0, 1)], [(2 * n, 2 * n + 1, 2 * n + 2)]]
    )
    ledger = Ledger()
    clean = welded(TriangleMesh(vertices, triangles), ledger)
    assert len(clean.triangles) == 12
    assert ledger.count("repaired", "triangle that is there twice dropped") == 5
    assert ledger.count("repaired", "triangle without area dropped") == 2


def grid_of_ground(size=200.0, step=10.0):
    """A grid of ground at z = 0 that shares its corners with the houses' feet where they fall on them."""
    x, y = np.meshgrid(np.arange(0, size + 1, step), np.arange(0, size + 1, step))
    n = x.shape[1]
    q = (np.arange(x.shape[0] - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([np.column_stack([q, q + 1, q + n]), np.column_stack([q + 1, q + n + 1, q + n])])
    return trimesh.Trimesh(np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()]), faces, process=False)


@pytest.mark.parametrize("lift", [0.0, 0.02])
def test_the_ground_is_taken_away_also_where_it_is_welded_to_houses(lift):
    houses = [box(20.0 + 40 * i, 20.0 + 40 * j, lift, 20, 10, 9 + i + j) for i in range(4) for j in range(4)]
    # A long block with a flat roof that is wider than what counts as wide.
    houses.append(box(20, 180, lift, 160, 10, 12))
    models, ground = split_into_objects(mesh_of(*houses, grid_of_ground()), Ledger())
    assert ground is not None
    # Floors that are welded to it are ground as well.
    assert 200.0**2 - 1.0 < area(ground) < 200.0**2 + 16 * 200.0 + 1600.0 + 1.0
    assert np.ptp(ground.vertices[:, 2]) <= lift
    assert len(models) == 17
    roofs = sorted(one.mesh.vertices[:, 2].max() for one in models)
    assert roofs == pytest.approx(sorted(h.bounds[1, 2] for h in houses))


def test_nodes_for_each_material_are_split_by_building_and_buildings_are_not(tmp_path):
    houses = boxes_of_a_town()
    walls, roofs = [], []
    for house in houses:
        up = np.abs(house.face_normals[:, 2]) > 0.5
        roofs.append(house.submesh([up], append=True))
        walls.append(house.submesh([~up], append=True))
    by_material, by_house = trimesh.Scene(), trimesh.Scene()
    by_material.add_geometry(trimesh.util.concatenate(walls), geom_name="walls")
    by_material.add_geometry(trimesh.util.concatenate(roofs), geom_name="roofs")
    for i, house in enumerate(houses):
        by_house.add_geometry(house, geom_name=f"house {i}")
    for scene, first in ((by_material, "mesh/"), (by_house, "house")):
        path = tmp_path / "x.obj"
        path.write_text(scene.export(file_type="obj", include_normals=False, mtl_name="x.mtl"))
        layer = read_meshes(path, Ledger(), up="z")
        assert len(layer.items) == len(houses)
        assert all(one.id.startswith(first) for one in layer.items)
        assert area(joined_meshes([one.mesh for one in layer.items])) == pytest.approx(sum(h.area for h in houses))


# ----------------------------------------------------------------------------------------------------- real


def test_braunschweig_one_mesh_becomes_a_city():
    folder = real("braunschweig_mesh_net")
    ledger = Ledger()
    layer = read_meshes(folder / "braunschweig_zup_aligned.obj", ledger)
    assert 200 < len(layer.items) < 320
    assert layer.terrain is not None
    assert layer.terrain.vertices[:, 2].max() == 0.0
    assert ledger.count("repaired", "triangle without area dropped") > 4000
    widest = max(np.ptp(one.mesh.vertices[:, :2], axis=0).max() for one in layer.items)
    assert widest < 250.0  # no chain of houses


@pytest.mark.parametrize(
    ("name", "objects"), [("ensemble_de_batiments_1", 20), ("palais_de_justice", 1), ("extrait_2_terrain_lyon_5", 4)]
)
def test_lyon_is_read_as_it_is(name, objects):
    layer = read_meshes(real("dirty_lyon_obj") / f"{name}.obj", Ledger())
    assert len(layer.items) == objects
    assert (layer.terrain is not None) == ("terrain" in name)


def test_the_railway_keeps_its_pictures():
    layer = read_meshes(real("textured_small") / "railway.glb", Ledger())
    textures = np.concatenate([one.mesh.textures for one in layer.items])
    assert len(layer.textures) == 28
    assert (textures >= 0).all()
    heights = [np.ptp(one.mesh.vertices[:, 2]) for one in layer.items]
    assert max(heights) < 7.0


def test_a_scene_that_is_not_in_the_file_is_named(tmp_path):
    path = write_gltf(tmp_path / "x.gltf", more={"scene": 7})
    with pytest.raises(CityError, match="scene 7 is to be shown, the file has 1"):
        read_gltf(path, Ledger())
