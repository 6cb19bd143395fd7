"""PLY and OFF: polygons of any shape, text and bytes in either order, colours, and damage that is refused."""

import struct

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from mmi.city.model import PAINTED, PLAIN
from mmi.foundation.errors import CityError
from mmi.reading.models.polygon_files import read_polygon_file
from mmi.reading.report import Ledger

U = [(0, 20), (0, 0), (30, 0), (30, 20), (20, 20), (20, 8), (10, 8), (10, 20)]
"""A U of 480 m2, counter-clockwise; a fan from its first corner would leave it."""
POINTS = [(x, y, z) for z in (0, 12) for x, y in U]
FACES = [list(range(7, -1, -1)), list(range(8, 16)), *([k, (k + 1) % 8, (k + 1) % 8 + 8, k + 8] for k in range(8))]


def ply(path, form, *, points=POINTS, faces=FACES, colors=None, kind="uchar", of="vertex"):
    """A PLY file with an element before the points, a property and an element that nobody needs, and colours if wanted."""
    rgb = [f"property {kind} {one}" for one in ("red", "green", "blue")] if colors else []
    head = [
        "ply", f"format {form} 1.0", "comment by hand", "element camera 1", "property float view",
        f"element vertex {len(points)}", "property double z", "property float x", "property float y",
        *(rgb if of == "vertex" else []),
        f"element face {len(faces)}", "property uchar flags", "property list uchar int vertex_indices",
        *(rgb if of == "face" else []),
        "element edge 1", "property int a", "property int b", "end_header",
    ]  # fmt: skip
    order = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}[form]
    letter = {"uchar": "B", "float": "f"}[kind]
    rows = [("f", [1.5])]
    for i, (x, y, z) in enumerate(points):
        rows.append(("dff", [z, x, y]))
        rows += [(3 * letter, colors[i])] if colors and of == "vertex" else []
    for i, face in enumerate(faces):
        rows.append((f"BB{len(face)}i", [7, len(face), *face]))
        rows += [(3 * letter, colors[i])] if colors and of == "face" else []
    rows.append(("ii", [0, 1]))
    if order is None:
        body = "\n".join(" ".join(map(str, row)) for _, row in rows).encode()
    else:
        body = b"".join(struct.pack(order + letters, *row) for letters, row in rows)
    path.write_bytes("\n".join(head).encode() + b"\n" + body)
    return path


def off(path, head="OFF\n16 10 0"):
    rows = [*(" ".join(map(str, one)) for one in POINTS), *(f"{len(one)} {' '.join(map(str, one))}" for one in FACES)]
    path.write_text("\n".join([head, "# a comment", "", *(f"{row}  # more" for row in rows)]))
    return path


def the_mesh(path):
    (one,) = read_polygon_file(path, Ledger()).items
    assert one.id == path.stem
    return one.mesh


def check_u(mesh):
    """It is closed and as large as the U that it is."""
    solid = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)
    assert solid.is_watertight
    assert solid.volume == pytest.approx(480 * 12)
    assert solid.area == pytest.approx(2 * 480 + 12 * (30 + 2 * 20 + 3 * 10 + 2 * 12))


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_concave_polygons_of_ply(tmp_path, form):
    check_u(the_mesh(ply(tmp_path / "u.ply", form)))


@pytest.mark.parametrize("head", ["OFF\n16 10 0", "OFF 16 10 0", "off\r\n16 10 0"])
def test_concave_polygons_of_off(tmp_path, head):
    check_u(the_mesh(off(tmp_path / "u.off", head)))


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize(("kind", "white"), [("uchar", 255), ("float", 1.0)])
def test_colours_of_points_and_of_faces(tmp_path, form, kind, white):
    square, faces = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [[0, 1, 2], [0, 2, 3]]
    red, blue = (white, 0, 0), (0, 0, white)
    path = tmp_path / "c.ply"
    mesh = the_mesh(ply(path, form, points=square, faces=faces, colors=[red, blue], kind=kind, of="face"))
    assert mesh.colors.tolist() == [[255, 0, 0], [0, 0, 255]]
    assert (mesh.textures == PLAIN).all()
    mesh = the_mesh(ply(path, form, points=square, faces=faces, colors=[red, red, red, blue], kind=kind))
    assert mesh.colors.tolist() == [[255, 0, 0], [170, 0, 85]]
    assert (the_mesh(ply(path, form, points=square, faces=faces)).textures == PAINTED).all()


@pytest.mark.parametrize("word", ["nan", "-nan(ind)", "1.#QNAN", "-1.#IND", "1.#INF"])
def test_a_number_that_is_none_costs_its_faces(tmp_path, word):
    """As C writes them; the triangles that have no such corner stay."""
    rows = (("12 0 0\n", f"12 0 {word}\n"), ("0 0 12  #", f"{word} 0 12  #"))  # the tenth point; this PLY has z first
    for path, (row, bad) in zip((ply(tmp_path / "x.ply", "ascii"), off(tmp_path / "x.off")), rows, strict=True):
        plain, text = the_mesh(path), path.read_text()
        assert text.count(f"\n{row}") == 1
        path.write_text(text.replace(f"\n{row}", f"\n{bad}"))
        mesh = the_mesh(path)
        corners = plain.vertices[plain.triangles]
        sound = ~(corners == (0, 0, 12)).all(axis=2).any(axis=1)
        assert mesh.vertices[mesh.triangles].tolist() == corners[sound].tolist()
        assert 0 < sound.sum() < len(sound)


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_triangles_are_those_that_trimesh_reads(tmp_path, encoding):
    ball = trimesh.creation.icosphere(subdivisions=2)
    path = tmp_path / "ball.ply"
    path.write_bytes(trimesh.exchange.ply.export_ply(ball, encoding=encoding))
    theirs = trimesh.load(path, process=False)
    mesh = the_mesh(path)
    assert (mesh.triangles == theirs.faces).all()
    assert mesh.vertices == pytest.approx(theirs.vertices)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"ply\n", b"plx\n"),
        (b"format ascii", b"format morse"),
        (b"end_header", b"end_of_it"),
        (b"property double z", b"property double q"),
        (b"property double z", b"property long z"),
        (b"element vertex 16", b"element vertex 99"),
        (b"element vertex 16", b"element vertex -1"),
        (b"element face 10", b"element face 900000000000"),
        (b"list uchar int vertex_indices", b"list uchar int neighbours"),
        (b"7 8 7 6 5", b"7 -8 7 6 5"),
        (b"7 8 7 6 5", b"7 8 99 6 5"),
    ],
)
def test_damage_is_refused_in_one_line(tmp_path, old, new):
    path = ply(tmp_path / "x.ply", "ascii")
    assert old in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(old, new, 1))
    with pytest.raises(CityError, match=r"x\.ply: expected PLY") as caught:
        read_polygon_file(path, Ledger())
    assert "\n" not in str(caught.value)


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_damaged_bytes_are_a_city_error_or_a_mesh(tmp_path_factory, data):
    form = data.draw(st.sampled_from(["ascii", "binary_little_endian", "binary_big_endian"]))
    path = ply(tmp_path_factory.mktemp("damage") / "x.ply", form)
    whole = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(whole[: data.draw(st.integers(0, len(whole)))] if data.draw(st.booleans()) else whole)
    try:
        mesh = the_mesh(path)
    except CityError as error:
        assert str(path) in str(error)
    else:
        assert np.isfinite(mesh.vertices).all()
