"""What is larger than it may be is refused in one line, or left out and counted, before it is read."""

from __future__ import annotations

import bz2
import gzip
import io
import json
import tracemalloc
import zlib

import numpy as np
import pytest
from PIL import Image

from mmi import limits
from mmi.dataset.folder import is_ours
from mmi.dataset.reading import open_dataset
from mmi.foundation.errors import CityError, DatasetError, ParameterError
from mmi.foundation.json_forms import read_json
from mmi.foundation.whole_files import bytes_within, in_words
from mmi.reading.city_models.faces import Faces
from mmi.reading.maps.osm_pbf import refuse_zero_bytes
from mmi.reading.maps.sumo import read_sumo
from mmi.reading.models.gltf_reader import read_gltf
from mmi.reading.pictures import PictureShelf, picture_bytes
from mmi.reading.read_city import read_city
from mmi.reading.read_options import ReadOptions
from mmi.reading.report import Ledger
from mmi.reading.unpacked import unpacked
from viewer.walks.random_views import random_views


def left_out(ledger):
    return [one.what for one in ledger.report(source="", crs="", origin=(0, 0, 0)).left_out]


@pytest.mark.parametrize(
    "name", ["a.osm", "a.osm.pbf", "a.geojson", "a.json", "a.gml", "a.glb", "a.obj", "a.ply", "a.stl"]
)
def test_files_of_cities_are_refused_by_their_size(tmp_path, monkeypatch, name):
    monkeypatch.setattr(limits, "CITY_BYTES", 3000)
    (tmp_path / name).write_bytes(b" " * 3001)
    with pytest.raises(CityError, match=rf"{name}: a file of at most 3 kB expected, found 3 kB$"):
        read_city(tmp_path / name)
    other = tmp_path / "other.osm"
    other.write_text("<osm/>")
    for option in ("streets", "terrain"):
        with pytest.raises(CityError, match=rf"{name}: a file of at most 3 kB"):
            read_city(other, ReadOptions(**{option: tmp_path / name}))


def test_bytes_are_told_in_words():
    assert [in_words(one) for one in (999, 1000, 1_500_000, 64 << 30)] == ["999 bytes", "1 kB", "1.5 MB", "68.7 GB"]


def test_a_file_just_within_its_limit_is_read(tmp_path):
    (tmp_path / "a").write_bytes(b"four")
    assert bytes_within(tmp_path / "a", 4, CityError) == b"four"
    with pytest.raises(DatasetError, match="a: a file of at most 3 bytes expected, found 4 bytes"):
        bytes_within(tmp_path / "a", 3, DatasetError)


@pytest.mark.parametrize(("suffix", "packed"), [(".gz", gzip.compress), (".bz2", bz2.compress)])
def test_what_unpacks_into_too_much_is_refused(tmp_path, monkeypatch, suffix, packed):
    monkeypatch.setattr(limits, "UNPACKED_ANYWAY", 1 << 20)
    path = tmp_path / f"a.osm{suffix}"
    path.write_bytes(packed(b"<osm>" + b" " * (4 << 20)))
    assert path.stat().st_size * limits.EXPANSION < 4 << 20
    with pytest.raises(CityError, match=rf"a.osm{suffix}: at most 1 MB expected to come out of it, found more"):
        read_city(path)


def test_a_network_that_unpacks_into_too_much_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(limits, "UNPACKED_ANYWAY", 1 << 20)
    path = tmp_path / "a.net.xml.gz"
    path.write_bytes(gzip.compress(b"<net ><location/>" + b" " * (4 << 20)))
    with pytest.raises(CityError, match=r"a.net.xml.gz: at most 1 MB expected to come out of it, found more"):
        read_sumo(path, Ledger())


def test_what_is_read_whole_is_read_up_to_a_size(tmp_path):
    path = tmp_path / "a.osm.gz"
    path.write_bytes(gzip.compress(b"0123456789"))
    with unpacked(path) as file:
        assert (file.read(4), file.read_all(10), file.read(1)) == (b"0123", b"0123456789", b"")
        with pytest.raises(CityError, match="at most 9 bytes expected to come out of it"):
            file.read_all(9)


def field(number, value):
    """A field of a message as protocol buffers write it: a number, or bytes."""

    def varint(one):
        return bytes([one & 127 | 128]) + varint(one >> 7) if one > 127 else bytes([one])

    return varint(number << 3 | (0 if isinstance(value, int) else 2)) + (
        varint(value) if isinstance(value, int) else varint(len(value)) + value
    )


def test_blocks_that_unpack_into_too_much_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(limits, "UNPACKED_ANYWAY", 1 << 20)
    path = tmp_path / "a.osm.pbf"
    block = field(2, 1 << 16) + field(3, zlib.compress(field(9, b" " * ((1 << 16) - 4))))
    header = field(1, b"OSMData") + field(3, len(block))
    path.write_bytes(16 * (len(header).to_bytes(4, "big") + header + block))
    assert path.stat().st_size * limits.EXPANSION < 1 << 20
    refuse_zero_bytes(path)  # a megabyte, just
    path.write_bytes(17 * (len(header).to_bytes(4, "big") + header + block))
    with pytest.raises(CityError, match=r"a.osm.pbf: at most 1 MB expected to come out of it, found more"):
        read_city(path)


def picture(width, height, color=0):
    data = io.BytesIO()
    Image.new("RGB", (width, height), color).save(data, "PNG")
    return data.getvalue()


def test_pictures_are_left_out_by_their_pixels_and_bytes(tmp_path, monkeypatch):
    monkeypatch.setattr(limits, "PICTURE_PIXELS", 100)
    monkeypatch.setattr(limits, "PICTURES_PIXELS", 250)
    ledger = Ledger()
    shelf = PictureShelf(ledger)
    sizes = [(10, 10), (11, 10), (10, 9), (10, 7), (10, 6)]
    places = [shelf.place(picture(*size, color=i), str(i), alpha=False) for i, size in enumerate(sizes)]
    assert places == [0, None, 1, None, 2]
    assert left_out(ledger) == ["picture: more than 100 pixels", "picture: beyond 250 pixels in all"]
    monkeypatch.setattr(limits, "PICTURE_BYTES", 5)
    (tmp_path / "a.png").write_bytes(b"123456")
    assert picture_bytes(tmp_path / "a.png", "a", ledger) is None
    assert left_out(ledger)[2:] == ["picture: more than 5 bytes"]


def test_faces_that_are_used_again_and_again_are_counted(monkeypatch):
    monkeypatch.setattr(limits, "FACE_CORNERS", 7)
    faces = Faces("a.gml")
    faces.add(0, [[0, 1, 2]])
    faces.add_bare(0, [[[0, 1, 2, 3]]])
    for add in (lambda: faces.add(1, [[0, 1, 2]]), lambda: faces.add_bare(1, [[[0, 1, 2]]])):
        with pytest.raises(CityError, match=r"a.gml: at most 7 corners of faces expected, found more"):
            add()


def gltf(path, **accessor):
    """A triangle in two nodes, whose positions are zeros where no buffer has them."""
    nodes = [{"name": "a", "mesh": 0}, {"name": "b", "mesh": 0}]
    meshes = [{"primitives": [{"attributes": {"POSITION": 0}}]}]
    accessors = [{"componentType": 5126, "type": "VEC3", "count": 3} | accessor]
    path.write_text(json.dumps({"asset": {"version": "2.0"}, "nodes": nodes, "meshes": meshes, "accessors": accessors}))
    return path


def test_triangles_of_gltf_count_as_often_as_they_are_used(tmp_path, monkeypatch):
    path = gltf(tmp_path / "a.gltf")
    monkeypatch.setattr(limits, "PLACED_TRIANGLES", 2)
    assert len(read_gltf(path, Ledger()).items) == 2
    monkeypatch.setattr(limits, "PLACED_TRIANGLES", 1)
    with pytest.raises(CityError, match=r"a.gltf: at most 1 triangles expected, found more"):
        read_gltf(path, Ledger())


def test_zeros_that_gltf_asks_for_are_few(tmp_path):
    path = gltf(tmp_path / "a.gltf", count=limits.EMPTY_ACCESSOR_ELEMENTS // 3 + 1)
    with pytest.raises(CityError, match=r"a.gltf: .*an accessor of 5592406 elements; at most 5592405 expected"):
        read_gltf(path, Ledger())


def test_a_model_without_a_coordinate_system_is_no_wider_than_a_city(tmp_path, monkeypatch):
    corners = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1))
    far = "".join(f"v {x} 0 {z}\n" for x in (2000, 2001) for z in (0, 1))
    (tmp_path / "a.obj").write_text(
        f"{corners}{far}o a\nf 1 2 4 3\nf 5 6 8 7\nf 1 2 6 5\nf 3 4 8 7\nf 2 4 8 6\no b\nf 9 10 12 11\n"
    )
    monkeypatch.setattr(limits, "EXTENT", 2000.0)
    with pytest.raises(CityError, match=r"a.obj: the buildings spread over 2 km: expected a city in metres"):
        read_city(tmp_path / "a.obj", ReadOptions(up="z"))


def test_files_of_datasets_are_refused_by_their_size(tmp_path, monkeypatch):
    monkeypatch.setattr(limits, "MANIFEST_BYTES", 1000)
    (tmp_path / "manifest.json").write_bytes(b" " * 1001)
    with pytest.raises(DatasetError, match=r"manifest.json: a file of at most 1 kB expected, found 1 kB$"):
        open_dataset(tmp_path)
    (tmp_path / "build.json").write_text('{"program": "build-impostors"}')
    assert is_ours(tmp_path)
    monkeypatch.setattr(limits, "RECORD_BYTES", 10)
    assert not is_ours(tmp_path)


def test_walks_and_what_moves_are_refused_by_their_size(tmp_path, monkeypatch):
    (tmp_path / "a.json").write_text('"four"')
    assert read_json(tmp_path / "a.json", "a walk") == "four"
    monkeypatch.setattr(limits, "JSON_BYTES", 5)
    with pytest.raises(ParameterError, match=r"a.json: a walk's JSON of up to 5 bytes expected, found more"):
        read_json(tmp_path / "a.json", "a walk")


def test_a_small_walk_takes_little_memory(tmp_path):
    (tmp_path / "a.json").write_text('"four"')
    tracemalloc.start()
    try:
        assert read_json(tmp_path / "a.json", "a walk") == "four"
        assert tracemalloc.get_traced_memory()[1] < 8 << 20 < limits.JSON_BYTES
    finally:
        tracemalloc.stop()


def lines_osm(path, *, action=""):
    """A house and a street beside it."""
    places = [(0, 0), (0, 1), (1, 1), (1, 0), (-5, -1), (5, -1)]
    nodes = "".join(
        f'<node id="{i}" lat="{60 + 1e-4 * y}" lon="{25 + 1e-4 * x}"{action}/>' for i, (x, y) in enumerate(places, 1)
    )
    house = "".join(f'<nd ref="{i}"/>' for i in (1, 2, 3, 4, 1))
    path.write_text(
        f'<osm version="0.6">{nodes}<way id="1">{house}<tag k="building" v="yes"/><tag k="height" v="9"/></way>'
        '<way id="2"><nd ref="5"/><nd ref="6"/><tag k="highway" v="residential"/></way></osm>'
    )
    return path


def test_edited_maps_are_written_anew_up_to_a_size(tmp_path, monkeypatch):
    path = lines_osm(tmp_path / "a.osm", action=' action="modify"')
    path.write_text(path.read_text().replace("</osm>", '<node id="9" lat="60" lon="25" action="delete"/></osm>'))
    read_city(path)
    monkeypatch.setattr(limits, "REWRITTEN_BYTES", 100)
    with pytest.raises(CityError, match=r"a.osm: at most 100 bytes expected to come out of it, found more"):
        read_city(path)


def test_streets_that_reach_too_far_are_left_out(tmp_path, monkeypatch):
    path = lines_osm(tmp_path / "a.osm")
    monkeypatch.setattr(limits, "STREET_REACH", 20.0)  # it is 56 m long
    with pytest.raises(CityError, match=r"a.osm: no streets for --network drive; found only 1 out of reach"):
        read_city(path)


def test_values_beyond_any_building_are_not_used(tmp_path, monkeypatch):
    path = lines_osm(tmp_path / "a.osm")
    (house,) = read_city(path)[0].objects
    assert house.prisms[0].top - house.prisms[0].bottom == pytest.approx(9.0)
    monkeypatch.setattr(limits, "BUILDING_HEIGHT", 8.0)
    with pytest.raises(CityError, match="none of 1 buildings has a height"):
        read_city(path)


def test_no_more_views_are_drawn_than_somebody_waits_for():
    with pytest.raises(ParameterError, match="1 to 100000 views expected, found 100001"):
        random_views([object()], 100_001, seed=1)


def test_a_metropolis_stays_within_all_of_them():
    """A million buildings of 30 faces, as 10 GB of CityJSON lines; 50,000 cells of 80 kB in the manifest."""
    buildings = 1_000_000
    assert limits.CITY_BYTES > 5 * 10_000_000_000
    assert limits.FACE_CORNERS > 5 * buildings * 30 * 5
    assert limits.PLACED_TRIANGLES > buildings * 200
    assert limits.MANIFEST_BYTES > 50_000 * 80_000
    assert np.isfinite(limits.EXTENT) and limits.EXTENT >= 100_000.0
