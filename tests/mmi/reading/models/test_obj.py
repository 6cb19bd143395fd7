"""OBJ files as other programs write them: names in any encoding, several .mtl files, colours of vertices."""

import json

import numpy as np
import pytest
from PIL import Image

from mmi.city.model import PLAIN
from mmi.foundation.errors import CityError
from mmi.reading.models.mesh_files import read_meshes
from mmi.reading.models.obj import read_obj
from mmi.reading.names import readable_name
from mmi.reading.read_city import read_city
from mmi.reading.read_options import ReadOptions
from mmi.reading.report import Ledger

RED, BLUE = (230, 26, 26), (26, 26, 230)


def box_lines(k, material):
    """A box of 10 m, 20 m east of the one before."""
    x, first = 20 * k, 8 * k
    corners = [(x, 0), (x + 10, 0), (x + 10, 10), (x, 10)]
    points = [f"v {a} {b} {z}" for z in (0, 10) for a, b in corners]
    sides = ["4 3 2 1", "5 6 7 8", "1 2 6 5", "2 3 7 6", "3 4 8 7", "4 1 5 8"]
    faces = ["f " + " ".join(str(first + int(one)) for one in side.split()) for side in sides]
    return [*(line.encode() for line in points), b"usemtl " + material, *(line.encode() for line in faces)]


def town(path, names, materials):
    """A file of boxes with names and materials in bytes; its .mtl has red and blue."""
    lines = [b"mtllib town.mtl"]
    for k, name in enumerate(names):
        lines += [b"o " + name, *box_lines(k, materials[k % 2])]
    path.write_bytes(b"\n".join(lines))
    red, blue = materials
    (path.parent / "town.mtl").write_bytes(
        b"newmtl " + red + b"\nKd 0.9 0.1 0.1\nnewmtl " + blue + b"\nKd 0.1 0.1 0.9\n"
    )
    return path


def colours(layer):
    """The one colour of each object."""
    found = [np.unique(one.mesh.colors, axis=0) for one in layer.items]
    assert all(len(one) == 1 for one in found)
    assert all((one.mesh.textures == PLAIN).all() for one in layer.items)
    return [tuple(one[0].tolist()) for one in found]


NAMES = ["建物", "東", "予", "表", "能", "十"]
"""The last four end in a backslash in Shift-JIS."""


@pytest.mark.parametrize("encoding", ["utf-8", "shift_jis", "gbk", "euc_jp", "big5"])
def test_names_stay_different_in_any_encoding(tmp_path, encoding):
    names = [one.encode(encoding) for one in NAMES]
    path = town(tmp_path / "town.obj", names, ("表".encode(encoding), "青".encode(encoding)))
    layer = read_meshes(path, Ledger(), up="z")
    ids = [one.id for one in layer.items]
    assert len(set(ids)) == len(ids) == len(names)
    assert colours(layer) == [RED, BLUE] * (len(names) // 2)
    assert json.loads(json.dumps(ids, ensure_ascii=False).encode("utf-8")) == ids
    assert all(one.isprintable() for one in ids)


def test_two_names_that_read_alike_get_numbers(tmp_path):
    names = ["é".encode(), "é".encode("cp1252"), b"a"]
    path = town(tmp_path / "town.obj", names, (b"red", b"blue"))
    assert [one.id for one in read_meshes(path, Ledger(), up="z").items] == ["é", "é#2", "a"]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        (b"Hof", "Hof"),
        ("Höfe".encode(), "Höfe"),
        ("Höfe".encode("cp1252"), "Höfe"),
        (b"\x93\x8f", r"\x93\x8f"),
        ("東 x".encode("shift_jis"), r"“Œ x"),
    ],
)
def test_bytes_become_text_that_can_be_read(name, text):
    assert readable_name(name) == text
    readable_name(name).encode("utf-8")


def test_a_backslash_still_continues_a_line(tmp_path):
    path = tmp_path / "x.obj"
    path.write_bytes(b"v 0 0 \\\n0\nv 4 0 0\r\nv 4 4 \\\r\n 0\nv 0 4 0\nf 1 2\\\n 3 4\n")
    (one,) = read_obj(path, Ledger()).items
    assert one.mesh.vertices.tolist() == [[0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0]]


def test_a_byte_order_mark_is_no_part_of_the_first_line(tmp_path):
    path = town(tmp_path / "town.obj", [b"a", b"b"], (b"red", b"blue"))
    for file in (path, tmp_path / "town.mtl"):
        file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    assert colours(read_obj(path, Ledger())) == [RED, BLUE]


def test_a_picture_whose_name_is_no_utf8_is_found(tmp_path):
    name = "表.png".encode("shift_jis")
    Image.new("RGB", (2, 2), (0, 90, 0)).save(tmp_path / "x.png")
    try:
        (tmp_path / "x.png").rename(tmp_path / name.decode("utf-8", errors="surrogateescape"))
    except (OSError, UnicodeError):
        pytest.skip("this file system has no such names")
    (tmp_path / "x.obj").write_bytes(
        b"mtllib x.mtl\nusemtl m\nv 0 0 0\nv 4 0 0\nv 0 4 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n"
    )
    (tmp_path / "x.mtl").write_bytes(b"newmtl m\nmap_Kd " + name + b"\n")
    ledger = Ledger()
    layer = read_obj(tmp_path / "x.obj", ledger)
    assert [one.name for one in layer.textures] == ["•\\.png"]
    assert ledger.count("left out") == 0


@pytest.mark.parametrize(
    ("line", "missing"),
    [
        ("red.mtl blue.mtl", []),
        ("my blue.mtl red.mtl", []),
        ("red.mtl  my blue.mtl", []),
        ("red.mtl gone.mtl blue.mtl", ["gone.mtl"]),
        ("red.mtl blue.mtl very gone.mtl", ["very gone.mtl"]),
        ("both red and blue.mtl", []),
    ],
)
def test_several_mtl_files_on_one_line(tmp_path, line, missing):
    path = town(tmp_path / "town.obj", [b"a", b"b"], (b"red", b"blue"))
    red, blue = (tmp_path / "town.mtl").read_text().split("newmtl ")[1:]
    for name, text in (("red", red), ("blue", blue), ("my blue", blue)):
        (tmp_path / f"{name}.mtl").write_text(f"newmtl {text}")
    (tmp_path / "town.mtl").rename(tmp_path / "both red and blue.mtl")
    path.write_text(path.read_text().replace("town.mtl", line))
    ledger = Ledger()
    assert colours(read_obj(path, ledger)) == [RED, BLUE]
    (*lost,) = ledger.report(source="", crs="", origin=(0, 0, 0)).left_out
    assert [one.examples[0] for one in lost] == missing


@pytest.mark.parametrize(
    "line", ["/home/user/Town.mtl", '"town.mtl"', r"C:\models\town.mtl", "TOWN.MTL", "../x/town.mtl"]
)
def test_mtl_files_are_found_beside_the_file(tmp_path, line):
    path = town(tmp_path / "town.obj", [b"a", b"b"], (b"red", b"blue"))
    path.write_text(path.read_text().replace("mtllib town.mtl", f"mtllib {line}"))
    ledger = Ledger()
    assert colours(read_obj(path, ledger)) == [RED, BLUE]
    assert ledger.count("left out") == 0


def test_mtl_files_outside_the_folder_are_refused(tmp_path):
    path = town(tmp_path / "town.obj", [b"a", b"b"], (b"red", b"blue"))
    path.write_text(path.read_text().replace("town.mtl", "town.mtl ../x.mtl"))
    with pytest.raises(CityError, match="expected files in its own folder or below"):
        read_obj(path, Ledger())


@pytest.mark.parametrize(
    ("damage", "left_out"),
    [
        ("v -1.#IND 0 0\nf 1 2 17", "triangle: corners that are no numbers or farther than 1e+08 m"),
        ("v -nan(ind) 0 0\nf 1 2 17", "triangle: corners that are no numbers or farther than 1e+08 m"),
        ("v zero 0 0", "line: no OBJ"),
        ("v 1 2", "line: no OBJ"),
        ("f 1 x 2", "line: no OBJ"),
        ("f 1 0 2", "line: no OBJ"),
        ("f 1 -99 2", "line: no OBJ"),
        ("f 1 2 99999999999999999999", "line: no OBJ"),
        ("vt u 0", "line: no OBJ"),
        ("f 1 2 99", "face: points that are not in the file"),
        ("f 1/1 2/9 3/1", "face: texture coordinates that are not in the file"),
    ],
)
def test_one_bad_line_costs_what_it_says(tmp_path, damage, left_out):
    """Of two houses of 16 corners together none is lost."""
    path = town(tmp_path / "town.obj", [b"a", b"b"], (b"red", b"blue"))
    plain = read_obj(path, Ledger())
    path.write_text(f"vt 0 0\n{path.read_text()}\n{damage}\n")
    ledger = Ledger()
    found = read_obj(path, ledger)
    corners = [[one.mesh.vertices[one.mesh.triangles].tolist() for one in layer.items] for layer in (found, plain)]
    assert corners[0] == corners[1]
    assert ledger.count("left out", left_out) == ledger.count("left out") == 1


def test_a_bad_point_moves_no_city(tmp_path):
    """It would spread it from where it is to the origin of its coordinate system."""
    path = town(tmp_path / "town.obj", [b"a", b"b"], (b"red", b"blue"))
    lines = [line.split() for line in path.read_text().splitlines()]
    moved = [f"v {float(x[1]) + 391000} {float(x[2]) + 5818000} {x[3]}" if x[0] == "v" else " ".join(x) for x in lines]
    path.write_text("\n".join([*moved, "v nan 0 0", "f 9 10 17"]))
    city, report = read_city(path, ReadOptions(crs="EPSG:25833", up="z"))
    assert [one.id for one in city.objects] == ["a", "b"]
    assert [one.count for one in report.left_out if "no numbers" in one.what] == [1]


def test_points_behind_a_bad_one_keep_their_numbers(tmp_path):
    path = tmp_path / "x.obj"
    path.write_text("v 0 0 0\nv zero 0 0\nv 4 0 0\nv 0 4 0\nf 1 3 4\nf 1 4 3\n")
    assert read_obj(path, Ledger()).items[0].mesh.vertices.tolist() == [[0, 0, 0], [4, 0, 0], [0, 4, 0]]


def test_a_file_of_which_most_is_missing_is_refused(tmp_path):
    path = tmp_path / "x.obj"
    path.write_text("v 0 0 0\nv 4 0 0\nv 0 4 0\nf 1 2 3\nf 1 2 4\n")
    with pytest.raises(CityError, match="a face needs points number 4, the file has 3: is it cut off"):
        read_obj(path, Ledger())
    path.write_text("v 0 0 0\nv 4 0 0\nv 0 4 0\nv x\nf 1 2 3\n")
    with pytest.raises(CityError, match="line 4: expected OBJ, found 'v x'"):
        read_obj(path, Ledger())


@pytest.mark.parametrize(
    ("white", "grey", "noted"),
    [
        ("255 255 255", "51 51 51", True),
        ("1 1 1", "0.2 0.2 0.2", False),
        ("1.5 1.0 1.5", "0.2 0.2 0.2", False),  # brighter than white
    ],
)
def test_colours_of_vertices_as_bytes_or_shares(tmp_path, white, grey, noted):
    path = tmp_path / "x.obj"
    corners = ["0 0 0", "4 0 0", "0 4 0"]
    points = [f"v {corner} {colour}" for colour in (white, grey) for corner in corners]
    path.write_text("\n".join([*points, "f 1 2 3", "f 4 5 6"]))
    ledger = Ledger()
    (one,) = read_obj(path, ledger).items
    assert one.mesh.colors.tolist() == [[255, 255, 255], [51, 51, 51]]
    assert ledger.count("noted", "colours of vertices from 0 to 255 instead of 0 to 1") == noted


@pytest.mark.parametrize(
    ("red", "blue", "found", "noted"),
    [
        ("200 40 40", "0 0 255", [[200, 40, 40], [0, 0, 255]], True),
        ("0.8 0.2 0", "0 0 1", [[204, 51, 0], [0, 0, 255]], False),
        ("2 1.5 1", "0 0 1", [[255, 255, 255], [0, 0, 255]], False),  # brighter than white
    ],
)
def test_colours_of_materials_as_bytes_or_shares(tmp_path, red, blue, found, noted):
    """All colours of a file tell: one of 0 and 1 is the same in both."""
    path = town(tmp_path / "town.obj", [b"a", b"b"], (b"red", b"blue"))
    (tmp_path / "town.mtl").write_text(f"newmtl red\nKd {red}\nnewmtl blue\nKd {blue}\n")
    ledger = Ledger()
    assert colours(read_obj(path, ledger)) == [tuple(one) for one in found]
    assert ledger.count("noted", "colours of materials from 0 to 255 instead of 0 to 1") == noted
