"""From 3D models to cities: on their ground, with streets or paths, options refused in one line; real models too."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyproj
import pytest
import shapely
from cities import block, city_of, crossroads, real
from city_files import geojson
from PIL import Image
from selection import with_slow
from shapely.geometry import LineString, box

from citygen.generate import generate
from mmi.city.model import CityObject
from mmi.foundation.errors import CityError, MmiError
from mmi.reading.city_models.cityjson import read_cityjson
from mmi.reading.models.model_city import heights_in_metres
from mmi.reading.raw_layers import ModelLayer
from mmi.reading.read_city import read_city
from mmi.reading.read_options import ReadOptions
from mmi.reading.report import Ledger
from mmi.writing.cityjson_writer import write_cityjson


def counts(report, section):
    return {one.what: one.count for one in report.sections()[section]}


def street_length(city):
    return sum(edge["geometry"].length for _, _, edge in city.streets.edges(data=True))


def above_ground(city):
    """(n,) metres from the lowest ground at an object's outline up to its lowest point."""
    return np.array([one.base - city.ground_at(shapely.get_coordinates(one.footprint)).min() for one in city.objects])


# ---------------------------------------------------------------------------------------------- cities made to order


def surface(mesh):
    corners = mesh.vertices[mesh.triangles]
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2


@pytest.fixture(scope="module")
def made():
    return generate("hamlet", 1, detail=1)


@pytest.fixture(scope="module", params=["hamlet.json", "hamlet.jsonl"])
def hamlet(request, made, tmp_path_factory):
    path = tmp_path_factory.mktemp("hamlet") / request.param
    city = made
    write_cityjson(city, path)
    return city, *read_city(path, ReadOptions(network="all"))


def test_a_hamlet_keeps_its_buildings_and_streets(hamlet):
    city, back, report = hamlet
    assert [one.id for one in back.objects] == [one.id for one in city.objects]
    assert back.crs == "local"
    shift = np.subtract(city.origin, back.origin)
    for mine, theirs in zip(back.objects, city.objects, strict=True):
        assert np.array(mine.footprint.bounds) - np.tile(shift[:2], 2) == pytest.approx(
            theirs.footprint.bounds, abs=0.11
        )
        assert mine.top - shift[2] == pytest.approx(theirs.mesh.vertices[:, 2].max(), abs=0.002)
        assert surface(mine.mesh) == pytest.approx(surface(theirs.mesh), rel=5e-3)
        assert mine.core
    assert back.streets.number_of_edges() == city.streets.number_of_edges()
    assert street_length(back) == pytest.approx(street_length(city), rel=1e-3)
    widths = [sorted(e["half_width"] for _, _, e in one.streets.edges(data=True)) for one in (city, back)]
    assert widths[1] == pytest.approx(widths[0], abs=0.01)
    assert counts(report, "kept")["buildings"] == len(city.objects)


def test_a_hamlet_stands_on_its_hill(hamlet):
    city, back, _ = hamlet
    assert (above_ground(back) <= 0.1).all(), "never floating"
    assert (above_ground(back) > -6.0).all()
    x0, y0, x1, y1 = shapely.total_bounds([one.footprint for one in city.objects])
    places = np.random.default_rng(1).uniform((x0, y0), (x1, y1), (400, 2))
    off = back.ground_at(places) - city.ground_at(places)  # the same frame: both are local, origins are zero
    assert back.origin == city.origin == (0.0, 0.0, 0.0)
    assert np.abs(off).max() < 0.05


def floating(height, **more):
    """Three blocks whose feet are ``height`` above flat ground at 0, as a model without a ground of its own."""
    objects = tuple(
        block(f"b{k}", 20.0 * k, 10.0, 20.0 * k + 12.0, 22.0, 9.0 + height, bottom=height) for k in range(3)
    )
    return replace(city_of(*objects), crs="local", **more)


def test_flat_ground_is_where_the_feet_are(tmp_path):
    write_cityjson(floating(7.0), tmp_path / "city.json")
    city, _ = read_city(tmp_path / "city.json", ReadOptions(network="all"))
    assert city.terrain is None
    assert city.ground == pytest.approx(7.0)
    assert (above_ground(city) == 0.0).all()


def test_feet_above_a_terrain_of_a_file_go_down_to_it(tmp_path):
    write_cityjson(floating(2.0), tmp_path / "city.json")
    grid = np.stack(np.meshgrid(np.arange(-60, 120, 5.0), np.arange(-60, 90, 5.0)), axis=-1).reshape(-1, 2)
    points = [(shapely.Point(x, y, 0.02 * x), {}) for x, y in grid]
    relief = geojson(tmp_path / "relief.geojson", points)
    city, report = read_city(tmp_path / "city.json", ReadOptions(network="all", terrain=relief))
    assert city.terrain is not None
    assert np.abs(above_ground(city)).max() < 0.01
    assert counts(report, "repaired")["building: let down to the ground"] == 3
    for one in city.objects:
        assert one.mesh.vertices[:, 2].min() == one.base
        assert all(prism.bottom == one.base for prism in one.core)


def write_obj(path, *boxes):
    """Closed boxes (x0, y0, z0, x1, y1, z1) as an OBJ, a group each."""
    lines, shift = [], 1
    for i, (x0, y0, z0, x1, y1, z1) in enumerate(boxes):
        lines.append(f"o house{i}")
        lines += [f"v {x} {y} {z}" for z in (z0, z1) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]
        quads = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
        lines += ["f " + " ".join(str(k + shift) for k in quad) for quad in quads]
        shift += 8
    path.write_text("\n".join(lines) + "\n")
    return path


TWO = ((0, 0, 0, 12, 10, 9), (0, 30, 0, 12, 40, 6))


def test_a_local_obj_with_local_streets(tmp_path):
    path = write_obj(tmp_path / "town.obj", *[(x0 + 900, y0, z0, x1 + 900, y1, z1) for x0, y0, z0, x1, y1, z1 in TWO])
    lines = geojson(tmp_path / "streets.geojson", [(LineString([(880, 20), (930, 20)]), {"highway": "residential"})])
    city, _ = read_city(path, ReadOptions(streets=lines, up="z"))
    assert city.crs == "local"
    assert len(city.objects) == 2
    assert street_length(city) == pytest.approx(50.0, abs=0.01)
    (edge,) = [edge["geometry"] for _, _, edge in city.streets.edges(data=True)]
    assert np.array(edge.coords)[:, 1] + city.origin[1] == pytest.approx([20.0, 20.0])
    both = [one.footprint.bounds for one in city.objects]
    assert sorted(y0 + city.origin[1] for _, y0, _, _ in both) == [0.0, 30.0]
    assert all(one.core for one in city.objects)


def test_a_model_in_metres_of_its_own_is_no_larger_than_a_city(tmp_path):
    """One in millimetres, or with a corner of another world."""
    write_obj(tmp_path / "far.obj", (0, 0, 0, 9, 9, 8), (370_000, 0, 0, 370_009, 9, 8))
    with pytest.raises(CityError, match=r"far\.obj: the buildings spread over 370 km: expected a city in metres"):
        read_city(tmp_path / "far.obj", ReadOptions(up="z"))


def test_a_model_without_streets_gets_paths(tmp_path):
    boxes = [(30 * i, 30 * j, 0, 30 * i + 18, 30 * j + 18, 9) for i in range(3) for j in range(3)]
    city, report = read_city(write_obj(tmp_path / "town.obj", *boxes), ReadOptions(up="z"))
    assert counts(report, "inferred")["paths through the open space, as there are no streets"] > 0
    assert street_length(city) > 100.0
    walls = shapely.union_all([one.footprint for one in city.objects])
    lines = [edge["geometry"] for _, _, edge in city.streets.edges(data=True)]
    assert max(line.intersection(walls).length for line in lines) < 0.01


def test_footprints_with_a_terrain_are_raised(tmp_path):
    outlines = [
        (box(500000, 5400000, 500012, 5400010), {"height": 8.0, "id": "a"}),
        (box(500040, 5400000, 500052, 5400010), {"height": 6.0, "id": "b"}),
    ]
    houses = geojson(tmp_path / "houses.geojson", outlines, crs="EPSG:32632")
    line = LineString([(499990, 5400020), (500080, 5400020)])
    lines = geojson(tmp_path / "streets.geojson", [(line, {"highway": "residential"})], crs="EPSG:32632")
    # Ground that rises by 1 in 10 to the east, 100 m high at 500000.
    grid = np.stack(np.meshgrid(np.arange(-60, 120, 5.0), np.arange(-60, 90, 5.0)), axis=-1).reshape(-1, 2)
    points = [(shapely.Point(500000 + x, 5400000 + y, 100.0 + 0.1 * x), {}) for x, y in grid]
    relief = geojson(tmp_path / "relief.geojson", points, crs="EPSG:32632")
    city, _ = read_city(houses, ReadOptions(streets=lines, terrain=relief))
    flat, _ = read_city(houses, ReadOptions(streets=lines))
    assert city.terrain is not None
    for one, level in zip(city.objects, flat.objects, strict=True):
        ring = np.array(one.footprint.exterior.coords)[:-1]
        east = ring[:, 0] + city.origin[0] - 500000.0
        assert city.ground_at(ring) == pytest.approx(100.0 + 0.1 * east, abs=0.05)
        assert one.base <= city.ground_at(ring).min() + 0.01
        assert one.top == pytest.approx(100.0 + 0.1 * east.mean() + level.top, abs=0.1)


# ------------------------------------------------------------------------------------------------------------ options


@pytest.fixture(scope="module")
def placed(tmp_path_factory):
    """Sixteen blocks in Finland, with streets."""
    path = tmp_path_factory.mktemp("placed") / "city.json"
    city = replace(crossroads(), crs="EPSG:3067", origin=(385000.0, 6672000.0, 0.0))
    write_cityjson(city, path)
    return path, city


def test_clip_keeps_what_meets_the_box(placed):
    path, city = placed
    to_degrees = pyproj.Transformer.from_crs("EPSG:3067", "EPSG:4326", always_xy=True)
    west, south = to_degrees.transform(city.origin[0] - 5.0, city.origin[1] - 5.0)
    east, north = to_degrees.transform(city.origin[0] + 60.0, city.origin[1] + 60.0)
    clipped, report = read_city(path, ReadOptions(clip=(west, south, east, north), network="all"))
    assert [one.id for one in clipped.objects] == ["block/22"]
    assert clipped.objects[0].footprint.area == pytest.approx(3600.0, rel=0.01), "whole although it reaches out"
    assert counts(report, "left out")["building: outside --clip"] == len(city.objects) - len(clipped.objects)
    whole, _ = read_city(path, ReadOptions(network="all"))
    assert street_length(clipped) < street_length(whole)


@pytest.mark.parametrize(("unit", "foot"), [(None, 1.0), ("m", 1.0), ("ft", 0.3048)])
def test_heights_of_a_model_in_feet(placed, unit, foot):
    """Houses and ground become lower; the plan, of which the coordinate system tells, stays."""
    path, _ = placed
    city, report = read_city(path, ReadOptions(height_unit=unit, network="all"))
    plain, _ = read_city(path, ReadOptions(network="all"))
    for one, other in zip(city.objects, plain.objects, strict=True):
        assert np.ptp(one.mesh.vertices[:, 2]) == pytest.approx(foot * np.ptp(other.mesh.vertices[:, 2]), abs=2e-3)
        assert one.mesh.vertices[:, :2].tolist() == other.mesh.vertices[:, :2].tolist()
    assert not [text for text in report.warnings if "--height-unit" in text]


@pytest.mark.parametrize("unit", [None, "m", "ft"])
def test_a_plan_in_feet_makes_feet_likely(unit):
    layer = ModelLayer("a.gml", (), pyproj.CRS.from_epsg(2263))
    ledger = Ledger()
    heights_in_metres(layer, unit, None, ledger)
    warnings = ledger.report(source="", crs="", origin=(0, 0, 0)).warnings
    assert warnings == (() if unit else (warnings[0],))
    assert unit or "--height-unit ft" in warnings[0]
    heights_in_metres(layer, None, pyproj.CRS.from_epsg(32618), other := Ledger())
    assert other.report(source="", crs="", origin=(0, 0, 0)).warnings == ()


def refused(path, match, **options):
    with pytest.raises(MmiError, match=match) as caught:
        read_city(path, ReadOptions(**options))
    assert "\n" not in str(caught.value)


def test_options_that_mean_nothing_are_told_in_one_line(placed, tmp_path):
    path, _ = placed
    local = write_obj(tmp_path / "town.obj", *TWO)
    refused(path, r"no buildings within --clip 1,1,2,2", clip=(1, 1, 2, 2))
    refused(local, "--clip: a model with a coordinate system expected, found .*town.obj", clip=(1, 1, 2, 2), up="z")
    refused(local, r"--lod: .*town.obj has no levels of detail; found '2'", lod="2")
    refused(path, r"--lod: a level of detail such as 2 or 1.3 expected, found 'high'", lod="high")
    refused(path, "--up: expected auto, y or z, found 'x'", up="x")
    refused(path, "--crs", crs="EPSG:99999")
    refused(path, "--height-column: .*city.json is a 3D model", height_column="h")
    refused(path, "--objects: buildings expected", objects="blocks")
    refused(path, "no such file", terrain=tmp_path / "gone.tif")
    lines = geojson(tmp_path / "s.geojson", [(LineString([(0, 0), (50, 0)]), {"highway": "residential"})])
    refused(lines, "--lod: a 3D model expected", lod="2")
    far = [(shapely.Point(1000.0 + k, 3.0 * k * k, 1.0), {}) for k in range(4)]
    refused(local, "heights of the ground within the city", up="z", terrain=geojson(tmp_path / "far.geojson", far))


def test_a_model_without_buildings(tmp_path):
    path = tmp_path / "city.json"
    write_cityjson(replace(crossroads(), objects=()), path)
    refused(path, r"city\.json: no buildings; expected objects of type Building")


def test_a_crs_replaces_that_of_the_file(placed):
    path, _ = placed
    city, _ = read_city(path, ReadOptions(crs="EPSG:25835", network="all"))
    assert city.crs == "EPSG:25835"


def test_all_of_no_height_is_refused_with_the_files_name(tmp_path):
    path = write_obj(tmp_path / "flat.obj", (0, 0, 0, 9, 9, 0))
    refused(path, r"flat\.obj: no buildings", up="z")


def test_objects_are_sound_after_settling(hamlet):
    _, back, _ = hamlet
    for one in back.objects:
        assert isinstance(one, CityObject)
        points = one.mesh.vertices
        held = np.zeros(len(points), dtype=bool)
        for prism in one.prisms:
            level = (points[:, 2] >= prism.bottom - 1e-9) & (points[:, 2] <= prism.top + 1e-9)
            held |= level & (shapely.distance(prism.footprint, shapely.points(points[:, :2])) < 0.0025)
        assert held.all()


# -------------------------------------------------------------------------------------------------------- real models


REAL = {  # buildings, pictures, CRS, longitude, latitude
    "denhaag_cityjson/DenHaag_01.json": (844, 0, "EPSG:28992", 4.273, 52.104),
    "delft_cityjson/delft.json": (160, 0, "EPSG:28992", 4.367, 52.012),
    "vienna_lod2_cityjsonl/vienna.jsonl": (149, 0, "local", None, None),
    "geores_textured/geoRES_testdata.compress.json": (5, 28, "local", None, None),
    "geores_textured/geoRES_testdata.xml": (5, 28, "EPSG:31467", 8.999, 48.738),
    "textured_small/rotterdam_two_buildings/twobuildings_t.json": (2, 14, "EPSG:28992", 4.479, 51.915),
    "dirty_tokyo_plateau/udx/bldg/53392642_bldg_6697_op2.gml": (8, 8, "EPSG:32654", 139.777, 35.54),
}


@pytest.fixture(scope="module", params=with_slow(REAL, {"vienna_lod2_cityjsonl/vienna.jsonl"}))
def real_model(request):
    return request.param, *read_city(real(request.param), ReadOptions(network="all"))


def test_real_models(real_model):
    name, city, report = real_model
    buildings, pictures, crs, lon, lat = REAL[name]
    assert (len(city.objects), len(city.textures), city.crs) == (buildings, pictures, crs)
    assert counts(report, "read")["buildings"] == buildings
    if lon is not None:
        found = pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(*city.origin[:2])
        assert found == pytest.approx((lon, lat), abs=0.001)
    x0, y0, x1, y1 = city.bounds
    assert max(-x0, -y0, x1, y1) < 400.0
    assert city.streets.number_of_edges() >= 1
    heights = np.array([one.height for one in city.objects])
    assert 1.0 < np.median(heights) < 60.0
    assert heights.max() < 150.0
    standing = above_ground(city)
    assert (standing <= 0.1).mean() > 0.85
    assert (standing > -20.0).all()


def test_cores_of_real_models_lie_within_their_bounds(real_model):
    name, city, report = real_model
    solid = sum(bool(one.core) for one in city.objects)
    assert solid >= {"DenHaag_01.json": 700, "delft.json": 140, "vienna.jsonl": 120}.get(Path(name).name, 0)
    beyond = 0
    for one in city.objects:
        for prism in one.core:
            beyond += prism.footprint.difference(one.footprint.buffer(0.01)).area > 0.01
            # Those of open meshes start at the ground, which is fitted to the feet.
            assert one.base - 0.001 <= prism.bottom < prism.top <= one.top + 1e-9
    open_ = [note.count for note in report.noted if note.what == "building: not closed, hides what its walls enclose"]
    assert beyond <= sum(open_), "only those of open meshes reach into what touches them"


def test_pictures_of_real_models_are_not_mirrored(real_model):
    """From outside, u turns to v counter-clockwise. (Atlases may turn pictures, files may be off by a corner: not told.)"""
    _, city, _ = real_model
    if not city.textures:
        pytest.skip("no pictures")
    right = total = 0.0
    for one in city.objects:
        shown = one.mesh.textures >= 0
        corners = one.mesh.vertices[one.mesh.triangles][shown]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        sides = (one.mesh.uv[shown, 1:] - one.mesh.uv[shown, :1]).astype(float)
        turn = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
        right, total = right + area[turn > 0].sum(), total + area.sum()
    assert right / total > 0.95


def test_pictures_of_georess_walls_stand_upright():
    """Repeating patterns and whole facades, no atlas: v grows with the height and u to the right, seen from outside."""
    path = real("geores_textured/geoRES_testdata.xml")
    city, _ = read_city(path, ReadOptions(network="all"))
    upright = rightward = total = 0.0
    for one in city.objects:
        corners = one.mesh.vertices[one.mesh.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(normals, axis=1)
        wall = (np.abs(normals[:, 2]) < 0.1 * area) & (one.mesh.textures >= 0)
        to_right = np.cross([0.0, 0.0, 1.0], normals[wall])
        across = np.einsum("ijk,ik->ij", corners[wall], to_right)
        up = corners[wall][..., 2]
        u, v = np.moveaxis(one.mesh.uv[wall].astype(float), 2, 0)
        grows = [
            ((a - a.mean(1, keepdims=True)) * (b - b.mean(1, keepdims=True))).sum(1) for a, b in ((up, v), (across, u))
        ]
        upright += area[wall][grows[0] > 0].sum()
        rightward += area[wall][grows[1] > 0].sum()
        total += area[wall].sum()
    assert upright / total > 0.98
    assert rightward / total > 0.98


def test_a_folder_with_one_model_and_its_pictures():
    folder = real("textured_small/rotterdam_two_buildings")
    city, _ = read_city(folder, ReadOptions(network="all"))
    assert len(city.objects) == 2


@pytest.mark.parametrize("name", ["denhaag_cityjson/DenHaag_01.json", "delft_cityjson/delft.json"])
def test_triangles_agree_with_the_files_own(name):
    """Oracle: areas by Newell's rule over the rings of the file itself, with holes."""
    path = real(name)
    document = json.loads(path.read_text(encoding="utf-8"))
    points = np.array(document["vertices"]) * document["transform"]["scale"]
    exact = 0.0
    for one in document["CityObjects"].values():
        if one["type"] not in ("Building", "BuildingPart"):
            continue
        for geometry in one.get("geometry", []):
            for face in geometry["boundaries"][0] if geometry["type"] == "Solid" else geometry["boundaries"]:
                rings = [points[ring] - points[face[0][0]] for ring in face]
                exact += (
                    np.linalg.norm(sum(np.cross(ring, np.roll(ring, -1, axis=0)).sum(axis=0) for ring in rings)) / 2
                )
    found = sum(surface(item.mesh) for item in read_cityjson(path, Ledger()).items)
    assert found == pytest.approx(exact, rel=0.01), "but for faces that are not flat"


def test_what_is_no_model_or_has_no_building():
    folder = real("dirty_tokyo_plateau/udx")
    refused(folder / "tran/533925_tran_6697_op.gml", "no buildings; expected objects of type Building")
    with pytest.raises(CityError):
        read_city(folder / "bldg/TestCaseOfInvalidFileNameGml.gml")


def test_lost_pictures_are_a_headline(tmp_path):
    """One of two boxes shows a picture that is there, the other one that is not."""
    path = write_obj(tmp_path / "town.obj", (0, 0, 0, 12, 10, 9), (30, 0, 0, 42, 10, 9))
    text = path.read_text().replace("o house0", "mtllib town.mtl\no house0\nusemtl there")
    text = text.replace("o house1", "o house1\nusemtl gone")
    path.write_text("\n".join(_with_corner(line) for line in ["vt 0 0", "vt 1 0", "vt 1 1", *text.splitlines()]) + "\n")
    (tmp_path / "town.mtl").write_text("newmtl there\nmap_Kd there.png\nnewmtl gone\nmap_Kd gone.png\n")
    Image.fromarray(np.full((8, 8, 3), 99, dtype=np.uint8)).save(tmp_path / "there.png")
    _, report = read_city(path, ReadOptions(up="z"))
    (warning,) = [text for text in report.warnings if "picture" in text]
    assert warning.startswith(
        "1 picture could not be read, and 50 % of 24 triangles of the buildings have no picture: 12 are "
    )
    Image.fromarray(np.full((8, 8, 3), 99, dtype=np.uint8)).save(tmp_path / "gone.png")
    _, report = read_city(path, ReadOptions(up="z"))
    assert not any("picture" in text for text in report.warnings)


def _with_corner(line):
    """A face whose corners have places in the picture."""
    if not line.startswith("f "):
        return line
    return "f " + " ".join(f"{corner}/{k % 3 + 1}" for k, corner in enumerate(line.split()[1:]))
