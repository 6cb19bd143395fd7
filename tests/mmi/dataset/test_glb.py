from __future__ import annotations

import io
import json
import struct

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from mmi.dataset.glb import GlbContents, GlbImage, GlbNode, GlbPrimitive, glb_bytes, read_glb
from mmi.foundation.errors import DatasetError


def picture(kind: str, shade: int) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(np.full((4, 8, 3), shade, dtype=np.uint8)).save(buffer, kind)
    return buffer.getvalue()


def strip(n: int, *, seed: int = 0, **options) -> GlbPrimitive:
    """A fan of n vertices with everything that a primitive can have."""
    rng = np.random.default_rng(seed)
    triangles = np.column_stack([np.zeros(n - 2), np.arange(1, n - 1), np.arange(2, n)]).astype(np.int32)
    positions = rng.normal(scale=300.0, size=(n, 3)).astype(np.float32)
    uv = rng.uniform(-3, 9, size=(n, 2)).astype(np.float32)
    if options.get("masked"):  # in the steps that they are stored in
        uv = (rng.integers(0, 65536, size=(n, 2)) / 65535.0).astype(np.float32)
    colors = rng.integers(0, 256, size=(n, 3), dtype=np.uint8)
    return GlbPrimitive(positions, triangles, **({"uv": uv, "colors": colors, "image": 0} | options))


def contents() -> GlbContents:
    nodes = (
        GlbNode("way/1", (strip(5), strip(7, seed=1, image=1, colors=None, masked=True)), {"height": 12.5, "id": "ä"}),
        GlbNode("layer 0-2", (strip(4, seed=2, image=2, masked=True),)),
        GlbNode("bare", (strip(3, seed=3, uv=None, colors=None, image=None),), {"objects": [3, 1]}),
        GlbNode("nothing"),
    )
    images = (GlbImage(picture("PNG", 10), repeat=True), GlbImage(picture("WEBP", 90)), GlbImage(picture("JPEG", 200)))
    return GlbContents(nodes, images, {"cell": "0017-03"})


def parsed(data: bytes) -> tuple[dict, bytes]:
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def rebuilt(document: dict, body: bytes) -> bytes:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(body), 0x004E4942) + body
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


def assert_same(a: GlbContents, b: GlbContents) -> None:
    assert a.images == b.images
    assert a.extras == b.extras
    assert [(n.name, n.extras, len(n.primitives)) for n in a.nodes] == [
        (n.name, n.extras, len(n.primitives)) for n in b.nodes
    ]
    for one, two in zip(
        (p for n in a.nodes for p in n.primitives), (p for n in b.nodes for p in n.primitives), strict=True
    ):
        assert (one.image, one.masked) == (two.image, two.masked)
        for name in ("positions", "triangles", "uv", "colors"):
            left, right = getattr(one, name), getattr(two, name)
            assert (left is None) == (right is None)
            if left is not None:
                assert left.dtype == right.dtype
                assert np.array_equal(left, right), name


def test_what_is_written_is_read_back(tmp_path):
    data = glb_bytes(contents())
    assert_same(read_glb(data), contents())
    path = tmp_path / "cell.glb"
    path.write_bytes(data)
    assert_same(read_glb(path), contents())
    assert glb_bytes(read_glb(path)) == data


@given(st.lists(st.integers(3, 12), max_size=4), st.booleans(), st.booleans(), st.sampled_from([None, 0, 2]))
@settings(max_examples=40, deadline=None)
def test_any_contents_come_back(sizes, colored, masked, image):
    colors = {} if colored else {"colors": None}
    made = tuple(
        GlbNode(f"n{i}", (strip(n, seed=i, image=image, masked=masked, **colors),)) for i, n in enumerate(sizes)
    )
    given_contents = GlbContents(made, contents().images)
    assert_same(read_glb(glb_bytes(given_contents)), given_contents)


def test_the_same_contents_give_the_same_bytes_and_sorted_keys():
    data = glb_bytes(contents())
    assert data == glb_bytes(contents())
    document, _ = parsed(data)
    assert list(document) == sorted(document)
    assert document["asset"] == {"version": "2.0", "generator": "multi-mesh-impostors"}
    assert document["extensionsUsed"] == ["KHR_materials_unlit", "EXT_texture_webp"]
    assert document["extensionsRequired"] == ["EXT_texture_webp"]


def test_data_is_aligned_and_positions_have_bounds():
    document, body = parsed(glb_bytes(contents()))
    assert len(body) == document["buffers"][0]["byteLength"]
    assert all(view["byteOffset"] % 4 == 0 for view in document["bufferViews"])
    assert all(accessor["byteOffset"] % 4 == 0 for accessor in document["accessors"])
    # Primitives share views: positions, uv of either kind, colours, indices, and one for each image.
    assert len(document["bufferViews"]) == 5 + 3
    for node, entry in zip(contents().nodes, document["meshes"], strict=False):
        for primitive, written in zip(node.primitives, entry["primitives"], strict=True):
            accessor = document["accessors"][written["attributes"]["POSITION"]]
            assert np.array_equal(np.float32(accessor["min"]), primitive.positions.min(axis=0))
            assert np.array_equal(np.float32(accessor["max"]), primitive.positions.max(axis=0))
    wraps = [document["samplers"][texture["sampler"]]["wrapS"] for texture in document["textures"]]
    assert wraps == [10497, 33071, 33071]
    assert [m.get("alphaMode") for m in document["materials"]] == [None, "MASK", "MASK", None]
    assert all(m["extensions"] == {"KHR_materials_unlit": {}} for m in document["materials"])


def test_other_programs_see_the_city_with_y_up():
    data = glb_bytes(contents())
    loaded = trimesh.load(io.BytesIO(data), file_type="glb")
    assert sorted(len(mesh.vertices) for mesh in loaded.geometry.values()) == [3, 4, 5, 7]
    assert sorted(len(mesh.faces) for mesh in loaded.geometry.values()) == [1, 2, 3, 5]
    z_up = np.concatenate([p.positions for node in contents().nodes for p in node.primitives]).astype(float)
    turned = np.column_stack([z_up[:, 0], z_up[:, 2], -z_up[:, 1]])
    assert np.allclose(loaded.bounds, [turned.min(axis=0), turned.max(axis=0)], atol=1e-3)


@pytest.mark.parametrize(("n", "component"), [(65535, 5123), (65536, 5125)])
def test_indices_grow_to_32_bits_when_they_must(n, component):
    big = GlbContents((GlbNode("big", (strip(n),)),), contents().images)
    data = glb_bytes(big)
    document, _ = parsed(data)
    assert document["accessors"][document["meshes"][0]["primitives"][0]["indices"]]["componentType"] == component
    assert_same(read_glb(data), big)


def test_all_color_bytes_survive_linear_light():
    colors = np.repeat(np.arange(256, dtype=np.uint8)[:, None], 3, axis=1)
    one = GlbContents((GlbNode("c", (strip(256, colors=colors),)),), contents().images)
    data = glb_bytes(one)
    assert np.array_equal(read_glb(data).nodes[0].primitives[0].colors, colors)
    document, body = parsed(data)
    accessor = document["accessors"][document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]
    view = document["bufferViews"][accessor["bufferView"]]
    linear = np.frombuffer(body, "<u2", 4 * 256, view["byteOffset"]).reshape(256, 4)
    assert linear[[0, 188, 255], 0] / 65535 == pytest.approx([0.0, 0.5029, 1.0], abs=1e-4)  # sRGB 188 is half the light
    assert (linear[:, 3] == 65535).all()


@given(st.lists(st.tuples(st.floats(0, 1, width=32), st.floats(0, 1, width=32)), min_size=3, max_size=3))
@settings(max_examples=60, deadline=None)
def test_texture_coordinates_of_what_is_masked_are_stored_in_two_bytes_each(corners):
    """To half a step of 1 / 65535: less than a hundredth of a texel of pictures of a thousand texels."""
    uv = np.array(corners, dtype=np.float32)
    data = glb_bytes(GlbContents((GlbNode("l", (strip(3, uv=uv, colors=None, masked=True),)),), contents().images))
    found = read_glb(data).nodes[0].primitives[0].uv
    assert found.dtype == np.float32 and found.min() >= 0.0 and found.max() <= 1.0
    np.testing.assert_allclose(found, uv, atol=0.5 / 65535 + 1e-7)
    document, body = parsed(data)
    accessor = document["accessors"][document["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"]]
    assert (accessor["componentType"], accessor["normalized"], accessor["type"]) == (5123, True, "VEC2")
    view = document["bufferViews"][accessor["bufferView"]]
    assert (view["byteStride"], view["byteLength"]) == (4, 3 * 4)
    stored = np.frombuffer(body, "<u2", 6, view["byteOffset"]).reshape(3, 2) / 65535.0
    np.testing.assert_allclose(found, stored, atol=1e-7)


def test_texture_coordinates_of_either_kind_go_together():
    """Layers beside buildings, whose textures repeat: of the former in two bytes, of the latter in four."""
    document, _ = parsed(glb_bytes(contents()))
    of = [
        document["accessors"][one["attributes"]["TEXCOORD_0"]]
        for mesh in document["meshes"]
        for one in mesh["primitives"]
        if "TEXCOORD_0" in one["attributes"]
    ]
    assert [(one["componentType"], one.get("normalized", False)) for one in of] == [
        (5126, False), (5123, True), (5123, True),
    ]  # fmt: skip


@given(st.integers(0, 10**9), st.integers(1, 255))
@settings(max_examples=300, deadline=None)
def test_a_damaged_byte_is_a_clear_error_or_harmless(where, change):
    data = bytearray(glb_bytes(contents()))
    data[where % len(data)] ^= change
    try:
        read_glb(bytes(data), name="cells/0017-03.glb")
    except DatasetError as error:
        assert str(error).startswith("cells/0017-03.glb: ")
        assert "\n" not in str(error)


@given(st.integers(0, 10**9))
@settings(max_examples=60, deadline=None)
def test_a_file_cut_short_is_refused(where):
    data = glb_bytes(contents())
    with pytest.raises(DatasetError, match=r"^cut\.glb: damaged"):
        read_glb(data[: where % len(data)], name="cut.glb")


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("accessors", 0, "count"), 10**12),
        (("accessors", 0, "count"), -1),
        (("accessors", 0, "count"), True),
        (("accessors", 0, "byteOffset"), 10**9),
        (("accessors", 0, "componentType"), 5120),
        (("accessors", 0, "bufferView"), 99),
        (("accessors", 0, "bufferView"), -1),
        (("bufferViews", 0, "byteLength"), 10**12),
        (("bufferViews", 0, "byteOffset"), -4),
        (("nodes", 0, "children"), [1, 99]),
        (("nodes", 0, "children"), 3),
        (("nodes", 0, "matrix"), None),
        (("nodes", 1, "name"), 7),
        (("nodes", 1, "extras"), [1]),
        (("nodes", 1, "mesh"), "0"),
        (("meshes", 0, "primitives", 0, "attributes"), {}),
        (("meshes", 0, "primitives", 0, "indices"), 0),
        (("materials", 0, "pbrMetallicRoughness", "baseColorTexture", "index"), 3),
        (("textures", 0, "source"), 1),
        (("scenes",), []),
        (("images", 0, "bufferView"), 0),
    ],
)
def test_no_size_or_index_in_the_file_is_believed(path, value):
    document, body = parsed(glb_bytes(contents()))
    assert_same(read_glb(rebuilt(document, body)), contents())
    target = document
    for key in path[:-1]:
        target = target[key]
    target[path[-1]] = value
    with pytest.raises(DatasetError, match=r"^x\.glb: damaged, or not a binary glTF written by this project"):
        read_glb(rebuilt(document, body), name="x.glb")


def test_a_size_beyond_the_file_is_refused_before_anything_is_read():
    document, body = parsed(glb_bytes(contents()))
    document["accessors"][0]["count"] = 10**12
    with pytest.raises(DatasetError, match=r"1000000000000 times VEC3 from byte 0 wanted, the view has \d+ bytes"):
        read_glb(rebuilt(document, body))


def test_triangles_beyond_the_vertices_are_refused():
    document, body = parsed(glb_bytes(contents()))
    accessor = document["accessors"][document["meshes"][0]["primitives"][0]["indices"]]
    start = document["bufferViews"][accessor["bufferView"]]["byteOffset"] + accessor["byteOffset"]
    damaged = body[:start] + b"\x05\x00" + body[start + 2 :]
    with pytest.raises(DatasetError, match="triangle indices below 5 expected, found 5"):
        read_glb(rebuilt(document, damaged))


def test_other_files_are_refused(tmp_path):
    missing = tmp_path / "missing.glb"
    with pytest.raises(DatasetError, match=r"missing\.glb: cannot be read \(No such file"):
        read_glb(missing)
    for data in (b"", b"glTF", b"PK\x03\x04" * 10, b"glTF\x01\0\0\0" + b"\0" * 40, b"[" * 100):
        with pytest.raises(DatasetError, match="damaged, or not"):
            read_glb(data)
    nested = b"[" * 100_000
    deep = struct.pack("<IIIII", 0x46546C67, 2, 20 + len(nested), len(nested), 0x4E4F534A) + nested
    with pytest.raises(DatasetError, match="damaged, or not"):
        read_glb(deep)


def test_nonsense_is_refused_before_it_is_written():
    triangle = np.array([[0, 1, 2]], dtype=np.int32)
    points = np.zeros((3, 3), dtype=np.float32)
    with pytest.raises(ValueError, match="both not empty"):
        GlbPrimitive(points, triangle[:0])
    with pytest.raises(ValueError, match=r"indices in \[0, 3\)"):
        GlbPrimitive(points, triangle + 1)
    with pytest.raises(ValueError, match="finite positions"):
        GlbPrimitive(points + np.nan, triangle)
    with pytest.raises(ValueError, match=r"uv of shape \(3, 2\)"):
        GlbPrimitive(points, triangle, uv=points)
    for outside in (-1e-4, 1.001):
        uv = np.full((3, 2), outside, dtype=np.float32)
        with pytest.raises(ValueError, match=r"texture coordinates in \[0, 1\] expected where alpha masks"):
            GlbPrimitive(points, triangle, uv=uv, masked=True)
        GlbPrimitive(points, triangle, uv=uv)
    with pytest.raises(ValueError, match="PNG, JPEG or WebP"):
        GlbImage(b"GIF89a")
    with pytest.raises(ValueError, match="image index below 0 expected, found 0"):
        GlbContents((GlbNode("a", (strip(3),)),))


def test_empty_contents_are_a_file_too():
    data = glb_bytes(GlbContents(()))
    assert read_glb(data).nodes == ()
    assert len(data) % 4 == 0
