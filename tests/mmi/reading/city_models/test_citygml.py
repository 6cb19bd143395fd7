"""CityGML in: small documents of both versions, with looks and axes in any order, and damage."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from model_cities import QUADS, box_corners
from PIL import Image

from mmi.city.model import PAINTED, PLAIN
from mmi.foundation.errors import CityError, MmiError
from mmi.reading.city_models.citygml import is_citygml, read_citygml
from mmi.reading.read_city import read_city
from mmi.reading.read_options import ReadOptions
from mmi.reading.report import Ledger

GML = ' xmlns:gml="http://www.opengis.net/gml" xmlns:xlink="http://www.w3.org/1999/xlink"'
SPACES = {
    version: GML
    + "".join(
        f' xmlns:{name}="http://www.opengis.net/citygml/{path}{version}"'
        for name, path in (("core", ""), ("bldg", "building/"), ("app", "appearance/"), ("dem", "relief/"))
    )
    for version in ("1.0", "2.0")
}
TOKYO = (139.7, 35.6)
DEGREES = 1e-5


def box_at(x0=0.0, y0=0.0, x1=10.0, y1=10.0, z1=6.0, z0=0.0):
    return box_corners(x0, y0, z0, x1, y1, z1)


def ring(points, name, *, pos=False):
    """A closed ring of points (n, 3)."""
    closed = [*points, points[0]]
    if pos:
        inside = "".join(f"<gml:pos>{x} {y} {z}</gml:pos>" for x, y, z in closed)
    else:
        inside = '<gml:posList srsDimension="3">' + " ".join(f"{c:.12g}" for p in closed for c in p) + "</gml:posList>"
    return f'<gml:LinearRing gml:id="{name}">{inside}</gml:LinearRing>'


def polygon(points, name, *, pos=False, hole=None):
    inner = "" if hole is None else f"<gml:interior>{ring(hole, name + '-h', pos=pos)}</gml:interior>"
    outer = f"<gml:exterior>{ring(points, name + '-r', pos=pos)}</gml:exterior>"
    return f'<gml:Polygon gml:id="{name}">{outer}{inner}</gml:Polygon>'


def faces(corners, name, *, pos=False):
    return [polygon(corners[list(quad)], f"{name}-{i}", pos=pos) for i, quad in enumerate(QUADS)]


def members(polygons):
    return "".join(f"<gml:surfaceMember>{one}</gml:surfaceMember>" for one in polygons)


def solid(polygons, level=2):
    surface = f"<gml:exterior><gml:CompositeSurface>{members(polygons)}</gml:CompositeSurface></gml:exterior>"
    return f"<bldg:lod{level}Solid><gml:Solid>{surface}</gml:Solid></bldg:lod{level}Solid>"


def linked(corners, name, level=2, *, pos=False):
    """A solid by links, to polygons that stand in boundary surfaces."""
    links = "".join(f'<gml:surfaceMember xlink:href="#{name}-{i}"/>' for i in range(6))
    kinds = ["GroundSurface", "RoofSurface", *["WallSurface"] * 4]
    bounds = "".join(
        f"<bldg:boundedBy><bldg:{kind}><bldg:lod{level}MultiSurface><gml:MultiSurface>{members([one])}"
        f"</gml:MultiSurface></bldg:lod{level}MultiSurface></bldg:{kind}></bldg:boundedBy>"
        for kind, one in zip(kinds, faces(corners, name, pos=pos), strict=True)
    )
    shell = f"<gml:exterior><gml:CompositeSurface>{links}</gml:CompositeSurface></gml:exterior>"
    return f"<bldg:lod{level}Solid><gml:Solid>{shell}</gml:Solid></bldg:lod{level}Solid>{bounds}"


def building(name, *content, kind="Building"):
    return f'<bldg:{kind} gml:id="{name}">{"".join(content)}</bldg:{kind}>'


def part(name, *content):
    return f"<bldg:consistsOfBuildingPart>{building(name, *content, kind='BuildingPart')}</bldg:consistsOfBuildingPart>"


def envelope(crs):
    if crs is None:
        return ""
    return f'<gml:boundedBy><gml:Envelope srsName="{crs}" srsDimension="3"/></gml:boundedBy>'


def model(*objects, crs="EPSG:25832", looks="", version="2.0", spaces=None):
    inside = "".join(f"<core:cityObjectMember>{one}</core:cityObjectMember>" for one in objects)
    declared = SPACES[version] if spaces is None else spaces
    return f'<?xml version="1.0"?>\n<core:CityModel{declared}>{envelope(crs)}{inside}{looks}</core:CityModel>'


def appearance(*data, around="appearanceMember"):
    inside = "".join(f"<app:surfaceDataMember>{one}</app:surfaceDataMember>" for one in data)
    prefix = "app" if around == "appearanceMember" else "bldg"
    return f"<{prefix}:{around}><app:Appearance><app:theme>x</app:theme>{inside}</app:Appearance></{prefix}:{around}>"


def photo(image, target, coordinates, name):
    pairs = " ".join(f"{c:g}" for pair in [*coordinates, coordinates[0]] for c in pair)
    listed = f'<app:textureCoordinates ring="#{name}-r">{pairs}</app:textureCoordinates>'
    return (
        f"<app:ParameterizedTexture><app:imageURI>{image}</app:imageURI><app:target uri='#{target}'><app:TexCoordList>"
        f"{listed}</app:TexCoordList></app:target></app:ParameterizedTexture>"
    )


def material(color, *targets):
    inside = "".join(f"<app:target>#{one}</app:target>" for one in targets)
    return f"<app:X3DMaterial><app:diffuseColor>{color}</app:diffuseColor>{inside}</app:X3DMaterial>"


def read(text, folder, *, lod=None):
    path = folder / "city.gml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    ledger = Ledger()
    return read_citygml(path, ledger, lod=lod), ledger


def areas(mesh):
    corners = mesh.vertices[mesh.triangles]
    return 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)


def volume(mesh):
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles] - mesh.vertices.mean(axis=0), 1, 0)
    return float((a * np.cross(b, c)).sum() / 6.0)


def size(item):
    return np.ptp(item.mesh.vertices, axis=0).tolist()


@pytest.mark.parametrize("version", SPACES)
@pytest.mark.parametrize("pos", [False, True])
def test_solids(version, pos, tmp_path):
    here, there = box_at(), box_at(x0=20.0, x1=28.0)
    text = model(
        building("a", solid(faces(here, "a", pos=pos))),
        building("b", linked(there, "b", pos=pos)),
        version=version,
    )
    layer, ledger = read(text, tmp_path)
    assert [item.id for item in layer.items] == ["a", "b"]
    assert [volume(item.mesh) for item in layer.items] == pytest.approx([600.0, 480.0])
    assert [len(item.mesh.triangles) for item in layer.items] == [12, 12], "by links each face once"
    assert areas(layer.items[0].mesh).sum() == pytest.approx(440.0)
    assert (layer.items[0].mesh.textures == PAINTED).all()
    assert layer.crs.to_epsg() == 25832
    assert ledger.count("read", "buildings") == 2
    assert is_citygml(tmp_path / "city.gml")


def behind(target):
    """A link to a surface from its other side."""
    return f'<gml:OrientableSurface orientation="-"><gml:baseSurface xlink:href="#{target}"/></gml:OrientableSurface>'


@pytest.mark.parametrize("parts", [False, True])
def test_a_wall_between_two_solids_stands_once_in_the_file(parts, tmp_path):
    """Neighbours, or parts of a building, of which one has the wall and the other links to it from behind."""
    left, right = faces(box_at(), "a"), faces(box_at(x0=10.0, x1=14.0), "b")
    shared = next(i for i, quad in enumerate(QUADS) if (box_at()[list(quad), 0] == 10.0).all())
    back = next(i for i, quad in enumerate(QUADS) if (box_at()[list(quad), 0] == 0.0).all())
    right[back] = behind(f"a-{shared}")
    make = part if parts else building
    both = [make("b", solid(right)), make("a", solid(left))]
    layer, _ = read(model(building("whole", *both)) if parts else model(*both), tmp_path)
    volumes = {item.id: volume(item.mesh) for item in layer.items}
    assert volumes == pytest.approx({"whole": 840.0} if parts else {"a": 600.0, "b": 240.0})
    assert sum(len(item.mesh.triangles) for item in layer.items) == 24


def test_a_whole_that_links_to_its_parts_has_each_face_once(tmp_path):
    own = faces(box_at(), "a")
    links = "".join(f'<gml:surfaceMember xlink:href="#a-{i}"/>' for i in range(6))
    shell = f"<gml:exterior><gml:CompositeSurface>{links}</gml:CompositeSurface></gml:exterior>"
    text = building("w", f"<bldg:lod2Solid><gml:Solid>{shell}</gml:Solid></bldg:lod2Solid>", part("a", solid(own)))
    layer, _ = read(model(text), tmp_path)
    assert len(layer.items[0].mesh.triangles) == 12


def test_links_in_a_circle_or_to_nothing_show_nothing(tmp_path):
    circle = '<gml:OrientableSurface gml:id="s"><gml:baseSurface xlink:href="#s"/></gml:OrientableSurface>'
    layer, _ = read(model(building("a", solid([*faces(box_at(), "a"), circle, behind("nowhere")]))), tmp_path)
    assert len(layer.items[0].mesh.triangles) == 12


@pytest.mark.parametrize("many", [1, 2])
def test_links_to_links_are_followed_once_however_long_the_chain(many, tmp_path):
    """A thousand surfaces in a row, each of which is the next one, ``many`` times."""
    chain = "".join(
        f'<gml:CompositeSurface gml:id="s{i}">'
        + many * f'<gml:surfaceMember xlink:href="#s{i + 1}"/>'
        + "</gml:CompositeSurface>"
        for i in range(1000)
    )
    last = f'<gml:CompositeSurface gml:id="s1000">{members(faces(box_at(), "a"))}</gml:CompositeSurface>'
    store = (
        f"<bldg:lod1MultiSurface><gml:MultiSurface>{members([chain, last])}</gml:MultiSurface></bldg:lod1MultiSurface>"
    )
    first = '<gml:Solid><gml:exterior xlink:href="#s0"/></gml:Solid>'
    text = model(building("a", store), building("b", f"<bldg:lod2Solid>{first}</bldg:lod2Solid>"))
    layer, _ = read(text, tmp_path)
    assert {item.id: len(item.mesh.triangles) for item in layer.items} == {"a": 12, "b": 12}


def test_shapes_in_coordinates_of_their_own_are_left_out(tmp_path):
    shape = f"<gml:MultiSurface>{members(faces(box_at(), 'd'))}</gml:MultiSurface>"
    shape = (
        f"<core:ImplicitGeometry><core:relativeGMLGeometry>{shape}</core:relativeGMLGeometry></core:ImplicitGeometry>"
    )
    placed = f"<bldg:lod3ImplicitRepresentation>{shape}</bldg:lod3ImplicitRepresentation>"
    installation = building("i", placed, kind="BuildingInstallation")
    installation = f"<bldg:outerBuildingInstallation>{installation}</bldg:outerBuildingInstallation>"
    house = solid(faces(box_at(x0=400.0, x1=410.0), "a"))
    layer, ledger = read(model(building("a", house, installation)), tmp_path)
    assert layer.items[0].mesh.vertices[:, 0].min() == 400.0
    assert ledger.count("left out", "building: a shape in coordinates of its own") == 1


def test_holes(tmp_path):
    corners = box_at()
    yard = np.array([(2, 2, 6), (2, 4, 6), (4, 4, 6), (4, 2, 6)], dtype=float)
    every = faces(corners, "a")
    every[1] = polygon(corners[list(QUADS[1])], "a-1", hole=yard)
    layer, _ = read(model(building("a", solid(every))), tmp_path)
    assert areas(layer.items[0].mesh).sum() == pytest.approx(436.0)


def test_parts_are_one_building_and_rooms_are_left_out(tmp_path):
    room = (
        "<bldg:interiorRoom><bldg:Room>"
        + solid(faces(box_at(1, 1, 3, 3, 99.0), "r"), 4)
        + "</bldg:Room></bldg:interiorRoom>"
    )
    text = model(
        building("a", solid(faces(box_at(), "a")), part("p", solid(faces(box_at(x0=10.0, x1=14.0, z1=9.0), "p"))), room)
    )
    layer, _ = read(text, tmp_path)
    assert size(layer.items[0]) == [14, 10, 9]
    assert len(layer.items) == 1


LEVELS = {None: 9, "1": 4, "2": 6, "2.2": 6, "3": 9, "4": 9}


@pytest.mark.parametrize("lod", LEVELS)
def test_levels_of_detail(lod, tmp_path):
    shapes = [solid(faces(box_at(z1=z), f"a{level}"), level) for level, z in ((1, 4.0), (2, 6.0), (3, 9.0))]
    flat = f"<bldg:lod0FootPrint><gml:MultiSurface>{members(faces(box_at(z1=50), 'f'))}</gml:MultiSurface></bldg:lod0FootPrint>"
    layer, ledger = read(
        model(building("a", flat, *shapes), building("b", flat.replace("f-", "g-"))), tmp_path, lod=lod
    )
    assert [size(item)[2] for item in layer.items] == [LEVELS[lod]]
    assert ledger.count("noted") == (lod == "4")
    assert ledger.count("left out", "building: no surfaces above level of detail 0") == 1


def test_a_part_at_a_lower_level_is_not_lost(tmp_path):
    fine, coarse = faces(box_at(), "p"), faces(box_at(x0=10.0, x1=14.0), "q")
    layer, _ = read(model(building("a", part("p", solid(fine, 2)), part("q", solid(coarse, 1)))), tmp_path)
    assert size(layer.items[0]) == [14, 10, 6]
    layer, _ = read(model(building("a", solid(coarse, 1), part("p", solid(fine, 2)))), tmp_path)
    assert size(layer.items[0]) == [10, 10, 6], "a coarse whole gives way to its finer parts"
    layer, _ = read(model(building("a", solid(fine, 2), part("q", solid(coarse, 1)))), tmp_path)
    assert size(layer.items[0]) == [10, 10, 6], "what the whole shows, parts are not added to"


# ------------------------------------------------------------------------------------------------------------ looks


UV = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]


def dressed(folder, *, around="appearanceMember"):
    image = np.array([[[255, 255, 255], [0, 0, 255]], [[255, 0, 0], [0, 255, 0]]], dtype=np.uint8)
    (folder / "pics").mkdir(exist_ok=True)
    Image.fromarray(image).save(folder / "pics" / "wall.png")
    looks = appearance(
        photo("pics/wall.png", "a-2", UV, "a-2"),
        material("1 0.5 0", "a-1", "a-2"),
        material("0 0 1", "a-1"),
        around=around,
    )
    shape = solid(faces(box_at(), "a"))
    if around == "appearance":
        return model(building("a", looks, shape)), image
    return model(building("a", shape), looks=looks), image


@pytest.mark.parametrize("around", ["appearanceMember", "appearance"])
def test_pictures_stand_upright_and_colours_are_bytes(around, tmp_path):
    text, image = dressed(tmp_path, around=around)
    layer, _ = read(text, tmp_path)
    mesh = layer.items[0].mesh
    assert (layer.textures[0].image == image).all()
    south = mesh.textures == 0
    assert south.sum() == 2
    corners = mesh.vertices[mesh.triangles][south]
    assert (corners[..., 1] == 0).all()
    assert mesh.uv[south] == pytest.approx(corners[..., [0, 2]] / (10.0, 6.0)), "u to the east, v up"
    roof = (mesh.vertices[mesh.triangles][..., 2] == 6).all(axis=1)
    assert (mesh.textures[roof] == PLAIN).all()
    assert (mesh.colors[roof] == (255, 128, 0)).all(), "the first material counts"
    assert (mesh.textures[~roof & ~south] == PAINTED).all()


def test_pictures_that_are_not_there(tmp_path):
    text, _ = dressed(tmp_path)
    layer, ledger = read(text.replace("wall.png", "gone.png"), tmp_path)
    assert ledger.count("left out", "picture: it is not there") == 1
    mesh = layer.items[0].mesh
    assert (mesh.textures >= 0).sum() == 0
    south = (mesh.vertices[mesh.triangles][..., 1] == 0).all(axis=1)
    assert (mesh.colors[south] == (255, 128, 0)).all(), "then the material shows"
    layer, ledger = read(text.replace("pics/wall.png", "../wall.png"), tmp_path)
    assert ledger.count("left out", "picture: it is not there") == 1
    assert layer.textures == ()


def test_coordinates_for_another_ring_show_nothing(tmp_path):
    text, _ = dressed(tmp_path)
    layer, _ = read(text.replace("#a-2-r", "#elsewhere"), tmp_path)
    assert (layer.items[0].mesh.textures < 0).all()


# -------------------------------------------------------------------------------------------------------------- axes


def degrees(corners, *, latitude_first):
    """Box corners in metres as degrees near Tokyo, a hundred thousandth for a metre."""
    lon_lat = corners[:, :2] * DEGREES + TOKYO
    return np.column_stack([lon_lat[:, ::-1] if latitude_first else lon_lat, corners[:, 2]])


@pytest.mark.parametrize("latitude_first", [True, False])
@pytest.mark.parametrize("name", ["http://www.opengis.net/def/crs/EPSG/0/6697", "urn:ogc:def:crs:EPSG::6697"])
def test_degrees_in_either_order(latitude_first, name, tmp_path):
    corners = degrees(box_at(x1=30.0), latitude_first=latitude_first)
    layer, _ = read(model(building("a", solid(faces(corners, "a"))), crs=name), tmp_path)
    mesh = layer.items[0].mesh
    assert mesh.vertices[:, :2].min(axis=0) == pytest.approx(TOKYO)
    assert np.ptp(mesh.vertices[:, :2], axis=0) == pytest.approx([30 * DEGREES, 10 * DEGREES], rel=1e-4)
    assert layer.crs.is_geographic
    city, _ = read_city(tmp_path / "city.gml", ReadOptions(network="all"))
    assert city.crs == "EPSG:32654"
    x0, y0, x1, y1 = city.objects[0].footprint.bounds
    assert (x1 - x0, y1 - y0) == pytest.approx((27.2, 11.1), abs=0.7)
    # A file that is latitude first has its faces counter-clockwise on earth only if they were written so.
    back = pyproj.Transformer.from_crs(city.crs, "EPSG:4326", always_xy=True)
    lon, lat = back.transform(x0 + city.origin[0], y0 + city.origin[1])
    assert (lon, lat) == pytest.approx(TOKYO, abs=1e-5)


@pytest.mark.parametrize("swapped", [True, False])
def test_northing_first(swapped, tmp_path):
    """Gauss-Krueger says northing first; most files have the easting first all the same."""
    corners = box_at() + np.array([3500000.0, 5400000.0, 0.0])
    written = corners[:, [1, 0, 2]] if swapped else corners
    layer, _ = read(model(building("a", solid(faces(written, "a"))), crs="urn:ogc:def:crs,crs:EPSG:31467"), tmp_path)
    assert layer.items[0].mesh.vertices.min(axis=0) == pytest.approx(corners.min(axis=0))


ANKARA = (32.8, 39.9)
"""Both orders are places on earth: the other one is in Yemen."""


def town_of(place, *, latitude_first, floors=True, inwards=()):
    """Three houses of 30 x 10 m at a place (longitude, latitude) as CityGML in EPSG:4326."""
    houses = []
    for k in range(3):
        corners = box_at(x1=30.0, y0=20.0 * k, y1=20.0 * k + 10)
        lon_lat = corners[:, :2] * DEGREES + place
        swapped = np.column_stack([lon_lat[:, ::-1] if latitude_first else lon_lat, corners[:, 2]])
        sides = [quad[::-1] if k in inwards else quad for quad in QUADS[0 if floors else 1 :]]
        houses.append(building(f"h{k}", solid([polygon(swapped[list(q)], f"h{k}-{i}") for i, q in enumerate(sides)])))
    return model(*houses, crs="urn:ogc:def:crs:EPSG::4326")


@pytest.mark.parametrize("floors", [True, False])
@pytest.mark.parametrize("latitude_first", [True, False])
@pytest.mark.parametrize("place", [ANKARA, (45.0, 45.0), (-20.0, 64.0), (-70.0, -33.0)])
def test_faces_that_look_outwards_tell_the_order_of_axes(place, latitude_first, floors, tmp_path):
    layer, ledger = read(town_of(place, latitude_first=latitude_first, floors=floors), tmp_path)
    points = np.concatenate([one.mesh.vertices for one in layer.items])
    assert points[:, :2].min(axis=0) == pytest.approx(place)
    assert np.ptp(points[:, :2], axis=0) == pytest.approx([30 * DEGREES, 50 * DEGREES], rel=1e-4)
    assert all(volume(one.mesh) > 0.0 for one in layer.items)
    said = "order of the axes: east first, though the coordinate system says north first"
    assert ledger.count("noted", said) == (not latitude_first)


@pytest.mark.parametrize("latitude_first", [True, False])
def test_faces_that_contradict_one_another_prove_nothing(latitude_first, tmp_path):
    """Then the coordinate system is taken at its word."""
    layer, ledger = read(town_of(ANKARA, latitude_first=latitude_first, inwards=(0,)), tmp_path)
    first = np.concatenate([one.mesh.vertices for one in layer.items])[:, :2].min(axis=0)
    assert first == pytest.approx(ANKARA if latitude_first else ANKARA[::-1])
    assert ledger.count("noted") == 0


@pytest.mark.parametrize("latitude_first", [True, False])
def test_the_area_of_a_system_goes_before_faces(latitude_first, tmp_path):
    """Faces that look inwards are turned, where only one order is in Japan."""
    text = town_of(TOKYO, latitude_first=latitude_first, inwards=(0, 1, 2)).replace("::4326", "::6697")
    layer, _ = read(text, tmp_path)
    assert np.concatenate([one.mesh.vertices for one in layer.items])[:, :2].min(axis=0) == pytest.approx(TOKYO)


def test_prisms_on_footprints_prove_nothing(tmp_path):
    """They are made to look outwards whatever the order is."""
    square = np.array([(39.9, 32.8, 0.0), (39.9001, 32.8, 0.0), (39.9001, 32.8003, 0.0), (39.9, 32.8003, 0.0)])
    flat = f"<bldg:lod0FootPrint><gml:MultiSurface>{members([polygon(square, 'f')])}</gml:MultiSurface></bldg:lod0FootPrint>"
    layer, _ = read(model(building("a", flat + height(9)), crs="urn:ogc:def:crs:EPSG::4326"), tmp_path)
    assert layer.items[0].mesh.vertices[:, :2].min(axis=0) == pytest.approx(ANKARA)


def test_without_crs(tmp_path):
    layer, _ = read(model(building("a", solid(faces(box_at(), "a"))), crs=None), tmp_path)
    assert layer.crs is None
    assert read_city(tmp_path / "city.gml", ReadOptions(network="all"))[0].crs == "local"


def test_a_crs_that_is_named_replaces_one_that_nobody_understands(tmp_path):
    corners = box_at() + np.array([500000.0, 5400000.0, 0.0])
    text = model(building("a", solid(faces(corners, "a"))), crs="urn:adv:crs:ETRS89_UTM32*DE_DHHN92_NH")
    with pytest.raises(CityError, match=r"city\.gml: srsName: an EPSG code expected.*--crs"):
        read(text, tmp_path)
    assert read_city(tmp_path / "city.gml", ReadOptions(crs="EPSG:25832", network="all"))[0].crs == "EPSG:25832"


def test_ground(tmp_path):
    def triangle(points):
        return f"<gml:Triangle><gml:exterior>{ring(np.array(points, dtype=float), 't')}</gml:exterior></gml:Triangle>"

    patches = triangle([(-50, -50, 1), (60, -50, 1), (60, 60, 3)]) + triangle(
        [(-50, -50, 1), (60, 60, 3), (-50, 60, 3)]
    )
    tin = f"<gml:TriangulatedSurface><gml:trianglePatches>{patches}</gml:trianglePatches></gml:TriangulatedSurface>"
    relief = f"<dem:ReliefFeature><dem:TINRelief><dem:tin>{tin}</dem:tin></dem:TINRelief></dem:ReliefFeature>"
    square = polygon(np.array([(0, 0, 77), (9, 0, 77), (9, 9, 77)], dtype=float), "land")
    land = f"<core:LandUse><core:lod1MultiSurface>{square}</core:lod1MultiSurface></core:LandUse>"
    house = building("a", solid(faces(box_at(z0=2.0, z1=9.0), "a")))
    layer, ledger = read(model(house, relief, land, "<core:Bridge/>"), tmp_path)
    assert len(layer.terrain.triangles) == 2
    assert layer.terrain.vertices[:, 2].max() == 3.0
    assert ledger.count("left out", "Bridge: no building") == 1
    city, _ = read_city(tmp_path / "city.gml", ReadOptions(network="all"))
    assert city.terrain is not None
    assert city.objects[0].base <= city.ground_at(np.array(city.objects[0].footprint.exterior.coords)).min() + 0.01
    layer, _ = read(model(house, land), tmp_path)
    assert layer.terrain.vertices[:, 2].min() == 77.0, "land tells where there is no relief"


# ------------------------------------------------------------------------------------------------------------ damage


def test_prefixes_need_not_be_bound(tmp_path):
    text = model(building("a", linked(box_at(), "a")), spaces="")
    assert "xmlns" not in text
    layer, _ = read(text, tmp_path)
    assert volume(layer.items[0].mesh) == pytest.approx(600.0)


GOOD = model(building("a", solid(faces(box_at(), "a"))), looks=appearance(material("1 0 0", "a-1")))
DAMAGES = {
    "document type": (GOOD.replace("<core:CityModel", '<!DOCTYPE x [<!ENTITY a "b">]><core:CityModel', 1), "document type"),
    "truncated": (GOOD[: len(GOOD) // 2], "damaged XML"),
    "another root": (GOOD.replace("core:CityModel", "core:Other"), "with a CityModel expected, found Other"),
    "numbers": (GOOD.replace("<gml:posList srsDimension=\"3\">", "<gml:posList>x ", 1), "object a: numbers expected"),
    "one too few": (GOOD.replace("<gml:posList srsDimension=\"3\">0", "<gml:posList>", 1), "object a: points of three"),
    "NaN": (GOOD.replace("<gml:posList srsDimension=\"3\">0", "<gml:posList>nan", 1), "object a: points of three"),
    "infinite": (GOOD.replace("<gml:posList srsDimension=\"3\">0", "<gml:posList>1e999", 1), "object a: points of three"),
    "far away": (GOOD.replace("<gml:posList srsDimension=\"3\">0", "<gml:posList>1e300", 1), "object a: points of three"),
    "unknown EPSG": (GOOD.replace("EPSG:25832", "EPSG:99999"), "srsName: an EPSG code expected"),
    "nested deep": (GOOD.replace("<core:cityObjectMember>", "<a>" * 3000, 1).replace(
        "</core:cityObjectMember>", "</a>" * 3000, 1), "nested more than"),
    "encoding": (GOOD.replace('version="1.0"', 'version="1.0" encoding="no-such"', 1), "damaged XML"),
    "encoding of more bytes": (GOOD.replace('version="1.0"', 'version="1.0" encoding="gb18030"', 1), "damaged XML"),
    "empty": ("", "damaged XML"),
}  # fmt: skip


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_told_in_one_line(name, tmp_path):
    text, wanted = DAMAGES[name]
    with pytest.raises(CityError, match=wanted) as caught:
        read(text, tmp_path)
    assert str(caught.value).startswith(str(tmp_path / "city.gml"))
    assert "\n" not in str(caught.value)


SMALL_DAMAGES = {
    "word": lambda text: text.replace(">20", ">x", 1),
    "one too few": lambda text: text.replace(">20 ", ">", 1),
    "NaN": lambda text: text.replace(">20", ">nan", 1),
    "infinite": lambda text: text.replace(">20", ">1e999", 1),
    "far away": lambda text: text.replace(">20", ">-1e300", 1),
    "last corner": lambda text: "0 nan</gml:posList>".join(text.rsplit("0 0</gml:posList>", 1)),
}


@pytest.mark.parametrize("name", SMALL_DAMAGES)
@pytest.mark.parametrize("first", [True, False])
def test_a_damaged_building_is_left_out_and_named(name, first, tmp_path):
    bad = SMALL_DAMAGES[name](building("bad", solid(faces(box_at(20, 0, 30, 10), "bad"))))
    good = [building(one, solid(faces(box_at(y0=y, y1=y + 10), one))) for one, y in (("a", 0), ("b", 20))]
    layer, ledger = read(model(*([bad, *good] if first else [*good, bad])), tmp_path)
    assert [one.id for one in layer.items] == ["a", "b"]
    assert [volume(one.mesh) for one in layer.items] == pytest.approx([600.0, 600.0])
    (line,) = ledger.report(source="", crs="", origin=(0, 0, 0)).left_out
    assert (line.what, line.count, line.examples) == ("building: coordinates that are no places", 1, ("bad",))


@pytest.mark.parametrize("color", ["1 0", "1 0 nan", "red"])
def test_a_damaged_colour_is_none(color, tmp_path):
    layer, ledger = read(GOOD.replace("1 0 0</app:diff", f"{color}</app:diff"), tmp_path)
    assert (layer.items[0].mesh.textures == PAINTED).all()
    assert ledger.count("left out", "colour: not three numbers") == 1


def test_damaged_texture_coordinates_show_nothing(tmp_path):
    text, _ = dressed(tmp_path)
    assert '-r">0 0' in text
    layer, ledger = read(text.replace('-r">0 0', '-r">0 x'), tmp_path)
    assert (layer.items[0].mesh.textures < 0).all()
    assert ledger.count("left out", "face: texture coordinates that are no numbers") == 1


def test_ids_that_repeat_get_numbers(tmp_path):
    twice = [building("a", solid(faces(box_at(x0=x, x1=x + 10), f"{x}"))) for x in (0, 20)]
    layer, ledger = read(model(*twice, building("a", solid([]))), tmp_path)
    assert [one.id for one in layer.items] == ["a", "a#2"]
    assert [one.mesh.vertices[:, 0].min() for one in layer.items] == [0.0, 20.0]
    assert ledger.count("repaired", "repeated id made unique") == 1


def test_ground_with_a_damaged_face_keeps_the_others(tmp_path):
    squares = [
        polygon(np.array([(x, 0, 7.0), (x + 9, 0, 7.0), (x + 9, 9, 7.0), (x, 9, 7.0)]), f"g{x}") for x in (0, 40)
    ]
    land = f'<luse:LandUse gml:id="land">{members(squares)}</luse:LandUse>'.replace(">40", ">nan", 1)
    layer, ledger = read(model(building("a", solid(faces(box_at(), "a"))), land), tmp_path)
    assert layer.terrain.vertices[:, 0].max() == 9.0
    assert ledger.count("left out", "ground: coordinates that are no places") == 1


def test_links_that_lead_nowhere_are_counted_with_their_building(tmp_path):
    whole, gone = linked(box_at(), "a"), linked(box_at(20, 0, 30, 10), "b")
    roof = faces(box_at(20, 0, 30, 10), "b")[1]
    assert roof in gone
    other = linked(box_at(40, 0, 50, 10), "c").partition("<bldg:boundedBy>")[0]
    text = model(
        building("a", whole), building("b", gone.replace(roof, "")), building("c", other.replace("#", "x.gml#"))
    )
    layer, ledger = read(text, tmp_path)
    assert [len(one.mesh.triangles) for one in layer.items] == [12, 10]
    found = {one.what: (one.count, one.examples) for one in ledger.report(source="", crs="", origin=(0, 0, 0)).left_out}
    assert found == {
        "surface: its link leads nowhere": (7, ("b", "c")),
        "building: its surfaces are links that lead nowhere": (1, ("c",)),
    }


def footprint(z=2.0, x0=0.0, kind="FootPrint", turned=False):
    square = np.array([(x0, 0, z), (x0 + 10, 0, z), (x0 + 10, 10, z), (x0, 10, z)])[:: -1 if turned else 1]
    inside = f"<gml:MultiSurface>{members([polygon(square, f'f{x0}')])}</gml:MultiSurface>"
    return f"<bldg:lod0{kind}>{inside}</bldg:lod0{kind}>"


def height(value, uom="m"):
    return f'<bldg:measuredHeight uom="{uom}">{value}</bldg:measuredHeight>'


@pytest.mark.parametrize(
    ("content", "span"),
    [
        (footprint() + height(9), (2.0, 11.0)),
        (footprint(turned=True) + height(9, "#m"), (2.0, 11.0)),
        (footprint() + height(10, "urn:ogc:def:uom:UCUM::[ft_i]"), (2.0, 5.048)),
        (footprint() + "<bldg:storeysAboveGround>3</bldg:storeysAboveGround>", (2.0, 11.6)),
        (footprint(12.0, kind="RoofEdge") + height(9), (3.0, 12.0)),
        (footprint(12.0, kind="RoofEdge") + footprint() + height(9), (2.0, 11.0)),
        (height(9) + part("p", footprint()), (2.0, 11.0)),
        (height(7) + part("p", footprint() + height(9)), (2.0, 11.0)),
    ],
)
def test_footprints_with_a_height_are_prisms(content, span, tmp_path):
    layer, ledger = read(
        model(building("a", content), building("b", footprint() + solid(faces(box_at(), "b")))), tmp_path
    )
    prism, other = (one.mesh for one in layer.items)
    assert volume(prism) == pytest.approx(100.0 * (span[1] - span[0]))
    assert (prism.vertices[:, 2].min(), prism.vertices[:, 2].max()) == pytest.approx(span)
    assert volume(other) == pytest.approx(600.0), "solids go before footprints"
    assert sum(one.count for one in ledger.report(source="", crs="", origin=(0, 0, 0)).inferred) == 1


@pytest.mark.parametrize("content", [footprint(), footprint() + height(-1), height(7), part("p", footprint())])
def test_footprints_without_a_height_are_left_out(content, tmp_path):
    layer, ledger = read(model(building("a", content), building("b", solid(faces(box_at(), "b")))), tmp_path)
    assert [one.id for one in layer.items] == ["b"]
    assert ledger.count("left out", "building: no surfaces above level of detail 0") == 1


def test_no_building(tmp_path):
    path = tmp_path / "city.gml"
    path.write_text(model("<core:Bridge/>"))
    with pytest.raises(CityError, match=r"city\.gml: no buildings; expected objects of type Building"):
        read_city(path)


def test_byte_order_mark_and_blanks(tmp_path):
    path = tmp_path / "city.gml"
    path.write_bytes(b"\xef\xbb\xbf" + GOOD.encode())
    assert is_citygml(path)
    assert len(read_citygml(path, Ledger()).items) == 1


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 99999), st.integers(0, 3), st.integers(32, 126)), min_size=1, max_size=4))
def test_bytes_changed_by_chance_raise_nothing_else(tmp_path_factory, changes):
    folder = tmp_path_factory.getbasetemp() / "fuzz_citygml"
    folder.mkdir(exist_ok=True)
    text = bytearray(dressed(folder)[0].encode())
    for place, kind, letter in changes:
        k = place % len(text)
        digits = [i for i, one in enumerate(text) if 48 <= one < 58]
        if kind == 3:  # within a number, which leaves the document well formed
            text[digits[place % len(digits)]] = [45, 46, 101, 32, 57, 110][letter % 6]
        else:
            text[k : k + (kind != 1)] = b"" if kind == 0 else bytes([letter])
    (folder / "city.gml").write_bytes(text)
    try:
        read_citygml(folder / "city.gml", Ledger())
    except MmiError as error:
        assert "\n" not in str(error)
