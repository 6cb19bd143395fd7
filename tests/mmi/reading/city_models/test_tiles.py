"""A folder of tiles is one city: as one file of the same buildings would be."""

from __future__ import annotations

import json
import zipfile

import numpy as np
import pytest
from model_cities import QUADS, box_corners

from mmi.foundation.errors import CityError
from mmi.reading.city_models.tiles import tiles_of
from mmi.reading.read_city import read_city
from mmi.reading.read_options import ReadOptions

PLACE = np.array([391000.0, 5818000.0, 35.0])
BOXES = {"a": (0, 0, 10, 10, 6), "b": (30, 0, 40, 12, 8), "c": (60, 0, 75, 10, 12), "d": (0, 30, 12, 45, 9)}


def cityjson(path, *names, crs="urn:ogc:def:crs:EPSG::25833", color=None, rename=None, floors=True):
    objects, vertices = {}, []
    for name in names:
        x0, y0, x1, y1, z1 = BOXES[name]
        corners = box_corners(x0, y0, 0, x1, y1, z1) + PLACE
        faces = [[[k + len(vertices) for k in quad]] for quad in QUADS[0 if floors else 1 :]]
        vertices += corners.tolist()
        shape = {"type": "MultiSurface", "lod": "2", "boundaries": faces}
        if color is not None:
            shape["texture"] = {"t": {"values": [[[0, 0, 1, 2, 3]]] * len(faces)}}
        objects[rename or name] = {"type": "Building", "geometry": [shape]}
    document = {"type": "CityJSON", "version": "1.0", "CityObjects": objects, "vertices": vertices}
    if crs is not None:
        document["metadata"] = {"referenceSystem": crs}
    if color is not None:
        from PIL import Image

        Image.new("RGB", (2, 2), color).save(path.parent / f"{path.stem}.png")
        document["appearance"] = {
            "textures": [{"image": f"{path.stem}.png"}],
            "vertices-texture": [[0, 0], [1, 0], [1, 1], [0, 1]],
        }
    path.write_text(json.dumps(document))


def citygml(path, *names):
    members = ""
    for name in names:
        x0, y0, x1, y1, z1 = BOXES[name]
        corners = box_corners(x0, y0, 0, x1, y1, z1) + PLACE
        rings = (" ".join(str(c) for k in (*quad, quad[0]) for c in corners[k]) for quad in QUADS)
        faces = "".join(
            f"<Polygon><exterior><LinearRing><posList>{ring}</posList></LinearRing></exterior></Polygon>"
            for ring in rings
        )
        members += (
            f"<cityObjectMember><Building id='{name}'><lod2Solid>{faces}</lod2Solid></Building></cityObjectMember>"
        )
    path.write_text(f"<CityModel><Envelope srsName='EPSG:25833'/>{members}</CityModel>")


def outlines(city):
    return {one.id: [*one.footprint.bounds, one.top] for one in city.objects}


@pytest.mark.parametrize(("write", "suffix"), [(cityjson, "json"), (citygml, "gml")])
def test_tiles_are_one_city(write, suffix, tmp_path):
    (tmp_path / "tiles").mkdir()
    write(tmp_path / "tiles" / f"1.{suffix}", "a", "b")
    write(tmp_path / "tiles" / f"2.{suffix}", "b", "c")  # b stands on the border
    write(tmp_path / "tiles" / f"3.{suffix}", "d")
    (tmp_path / "tiles" / "readme.txt").write_text("What this is.")
    write(tmp_path / f"whole.{suffix}", *"abcd")
    city, report = read_city(tmp_path / "tiles")
    whole, _ = read_city(tmp_path / f"whole.{suffix}")
    assert outlines(city) == outlines(whole)
    assert (city.crs, city.origin, city.source) == (whole.crs, whole.origin, "tiles")
    assert [(one.what, one.count) for one in report.read] == [("buildings", 5), ("tiles", 3)]
    assert [(one.what, one.examples) for one in report.left_out if "tile" in one.what] == [
        ("building: stands in another tile", ("b",))
    ]


def test_pictures_stay_with_their_tiles(tmp_path):
    cityjson(tmp_path / "1.json", "a", color=(200, 0, 0))
    cityjson(tmp_path / "2.json", "b", color=(0, 0, 200))
    city, _ = read_city(tmp_path)
    shown = [city.textures[one.mesh.textures[0]].image[0, 0].tolist() for one in city.objects]
    assert shown == [[200, 0, 0], [0, 0, 200]]


def test_one_id_in_two_places_is_two_buildings_and_the_finer_of_two_stays(tmp_path):
    cityjson(tmp_path / "1.json", "a", rename="x")
    cityjson(tmp_path / "2.json", "b", rename="x", floors=False)
    cityjson(tmp_path / "3.json", "b", rename="x")
    city, _ = read_city(tmp_path)
    assert [(one.id, len(one.mesh.triangles)) for one in city.objects] == [("x", 12), ("x#2", 12)]


def test_tiles_of_two_systems_are_refused(tmp_path):
    cityjson(tmp_path / "1.json", "a")
    cityjson(tmp_path / "2.json", "b", crs="urn:ogc:def:crs:EPSG::25832")
    with pytest.raises(
        CityError, match=r"tiles of one coordinate system expected, found .*33N in 1\.json and .*32N in 2\.json"
    ):
        read_city(tmp_path)
    cityjson(tmp_path / "2.json", "b", crs=None)
    with pytest.raises(CityError, match=r"found .*33N in 1\.json and none in 2\.json"):
        read_city(tmp_path)


def test_a_damaged_tile_is_left_out_and_named(tmp_path):
    for k, name in enumerate("abc"):
        cityjson(tmp_path / f"{k}.json", name)
    (tmp_path / "1.json").write_text((tmp_path / "1.json").read_text()[:-20])
    city, report = read_city(tmp_path)
    assert [one.id for one in city.objects] == ["a", "c"]
    assert [(one.what, one.examples) for one in report.left_out] == [("tile: it cannot be used", ("1.json",))]
    assert len(report.warnings) == 1
    assert "1.json: CityJSON expected, found damaged JSON" in report.warnings[0]
    for k in (0, 2):
        (tmp_path / f"{k}.json").write_text('{"CityObjects": 5}')
    with pytest.raises(CityError, match=r"2\.json"):
        read_city(tmp_path)


def test_one_city_in_two_formats_is_no_folder_of_tiles(tmp_path):
    cityjson(tmp_path / "1.json", "a")
    assert tiles_of(tmp_path) == []
    cityjson(tmp_path / "2.json", "b")
    assert [one.name for one in tiles_of(tmp_path)] == ["1.json", "2.json"]
    citygml(tmp_path / "1.gml", "a", "b")
    assert tiles_of(tmp_path) == []


def zipped(folder, path, **more):
    """All files of a folder in a zip, a folder deep, and ``more`` by name."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for one in sorted(folder.iterdir()):
            archive.write(one, f"download/{one.name}")
        for name, text in more.items():
            archive.writestr(name, text)
    return path


@pytest.mark.parametrize(("write", "suffix"), [(cityjson, "json"), (citygml, "gml")])
@pytest.mark.parametrize("number", [1, 2])
def test_a_zip_of_tiles_is_one_city(write, suffix, number, tmp_path):
    (tmp_path / "tiles").mkdir()
    for k, names in enumerate(["ab", "cd"][:number]):
        write(tmp_path / "tiles" / f"{k}.{suffix}", *names)
    path = zipped(
        tmp_path / "tiles", tmp_path / "city.zip", **{"readme.xml": "<readme/>", "index.json": "[]", "big.bin": "x"}
    )
    city, report = read_city(path)
    folder, _ = read_city(tmp_path / "tiles")
    assert outlines(city) == outlines(folder)
    assert (city.crs, city.origin, city.source) == (folder.crs, folder.origin, "city.zip")
    assert report.warnings == ()


def test_pictures_in_a_zip_are_found(tmp_path):
    (tmp_path / "tiles").mkdir()
    cityjson(tmp_path / "tiles" / "1.json", "a", color=(200, 0, 0))
    city, _ = read_city(zipped(tmp_path / "tiles", tmp_path / "city.zip"))
    assert [one.image[0, 0].tolist() for one in city.textures] == [[200, 0, 0]]


def test_names_that_lead_out_of_a_zip_are_passed_over(tmp_path):
    (tmp_path / "tiles").mkdir()
    cityjson(tmp_path / "tiles" / "1.json", "a")
    evil = (tmp_path / "tiles" / "1.json").read_text()
    names = ["../evil.json", "/tmp/evil.json", "a/../../evil.json", "C:/evil.json", "..\\evil.json"]
    city, _ = read_city(zipped(tmp_path / "tiles", tmp_path / "city.zip", **dict.fromkeys(names, evil)))
    assert [one.id for one in city.objects] == ["a"]
    assert not list(tmp_path.rglob("*evil*"))


def test_errors_in_a_zip_name_the_zip(tmp_path):
    (tmp_path / "tiles").mkdir()
    citygml(tmp_path / "tiles" / "1.gml", "a")
    text = (tmp_path / "tiles" / "1.gml").read_text()
    (tmp_path / "tiles" / "1.gml").write_text(text[:-20])
    with pytest.raises(CityError) as caught:
        read_city(zipped(tmp_path / "tiles", tmp_path / "city.zip"))
    assert str(caught.value).startswith(f"{tmp_path}/city.zip/download/1.gml: CityGML expected, found damaged XML")
    (tmp_path / "tiles" / "1.gml").write_text(text)
    cityjson(tmp_path / "tiles" / "2.json", "a")
    with pytest.raises(CityError, match=r"city\.zip: tiles of one kind expected, found both CityGML and CityJSON"):
        read_city(zipped(tmp_path / "tiles", tmp_path / "city.zip"))


def test_damaged_and_huge_zips_are_refused_in_one_line(tmp_path, monkeypatch):
    (tmp_path / "tiles").mkdir()
    cityjson(tmp_path / "tiles" / "1.json", *"abcd")
    path = zipped(tmp_path / "tiles", tmp_path / "city.zip")
    whole = bytearray(path.read_bytes())
    whole[60:300] = bytes(240)
    path.write_bytes(whole)
    with pytest.raises(
        CityError, match=r"city\.zip: expected a zip of city models, complete and open; found: "
    ) as caught:
        read_city(path)
    assert "\n" not in str(caught.value)
    monkeypatch.setattr("mmi.limits.ZIP_BYTES", 1000)
    with pytest.raises(CityError, match=r"city\.zip: at most .* together expected, found 1 of .*; unpack it"):
        read_city(zipped(tmp_path / "tiles", path))
    monkeypatch.setattr("mmi.limits.ZIP_FILES", 0)
    with pytest.raises(
        CityError, match=r"city\.zip: at most 0 files of .* together expected, found 1 of .*; unpack it"
    ):
        read_city(path)


def test_options_hold_for_all_tiles(tmp_path):
    cityjson(tmp_path / "1.json", "a")
    cityjson(tmp_path / "2.json", "b")
    city, _ = read_city(tmp_path, ReadOptions(height_unit="ft"))
    heights = [float(np.ptp(one.mesh.vertices[:, 2])) for one in city.objects]
    assert heights == pytest.approx([6 * 0.3048, 8 * 0.3048], abs=2e-3)
