"""What GDAL reads: layers, columns, ids and line networks."""

from __future__ import annotations

import numpy as np
import pyogrio
import pytest
import shapely
from city_files import OsmFile, degrees, geojson
from shapely.geometry import GeometryCollection, LineString, MultiLineString, MultiPolygon, Point, Polygon, box

from mmi.foundation.errors import CityError, ParameterError
from mmi.reading.read_city import read_city
from mmi.reading.read_options import ReadOptions

UTM = "EPSG:32632"
AT = (500_000.0, 5_300_000.0)


def at(geometry):
    return shapely.transform(geometry, lambda xy: xy + AT)


def houses(path, *features, crs=UTM):
    return geojson(path, [(None if g is None else at(g), p) for g, p in features], crs=crs)


HOUSE = (box(0, 10, 10, 20), {"height": 9})
STREET = (LineString([(-50, 0), (50, 0)]), {})


@pytest.fixture
def street(tmp_path):
    return houses(tmp_path / "street.geojson", STREET)


def tally(report, section, what):
    return sum(one.count for one in report.sections()[section] if one.what == what)


def gpkg(path, **layers):
    """Layers of (geometry type, geometries, fields)."""
    for i, (name, (kind, shapes, fields)) in enumerate(layers.items()):
        pyogrio.raw.write(
            path,
            shapely.to_wkb(shapes),
            [list_to_array(values) for values in fields.values()],
            list(fields),
            layer=name,
            driver="GPKG" if path.suffix == ".gpkg" else "ESRI Shapefile",
            geometry_type=kind,
            crs=UTM,
            append=i > 0,
        )
    return path


def list_to_array(values):
    return np.array(values, dtype=object if isinstance(values[0], str) else float)


def test_a_projected_crs_is_kept_and_ids_counted(tmp_path, street):
    path = houses(tmp_path / "h.geojson", HOUSE, (box(20, 10, 30, 20), {"height": 4}))
    city, report = read_city(path, ReadOptions(streets=street))
    assert city.crs == UTM
    assert [one.id for one in city.objects] == ["feature/0", "feature/1"]
    assert [one.top for one in city.objects] == [9.0, 4.0]
    assert city.objects[0].footprint.area == 100.0
    back = shapely.transform(city.objects[0].footprint, lambda xy: xy + city.origin[:2])
    assert back.equals(at(box(0, 10, 10, 20)))
    assert tally(report, "inferred", "height from column height") == 2
    assert city.source == "h.geojson"


@pytest.mark.parametrize(
    ("column", "value", "top"),
    [
        ("HAUTEUR", 7.5, 7.5),
        ("Height_ag", 7, 7.0),
        ("height_m", "7,5 m", 7.5),
        ("building:levels", "2", 6.4),
        ("floors_ag", 3, 9.6),
        ("Stories", 1.0, 3.2),
    ],
)
def test_columns_are_guessed(tmp_path, street, column, value, top):
    city, report = read_city(houses(tmp_path / "h.geojson", (HOUSE[0], {column: value})), ReadOptions(streets=street))
    assert city.objects[0].top == pytest.approx(top)
    assert column in report.inferred[0].what


def test_columns_can_be_named(tmp_path, street):
    features = [
        (HOUSE[0], {"height": 9, "eaves": 5, "n": 4, "key": "a"}),
        (box(20, 10, 30, 20), {"height": 8, "key": "a"}),
    ]
    path = houses(tmp_path / "h.geojson", *features)
    city, report = read_city(
        path, ReadOptions(streets=street, height_column="eaves", levels_column="n", id_column="key")
    )
    assert [one.id for one in city.objects] == ["a", "a#2"]
    assert [one.top for one in city.objects] == [5.0, 5.0]
    assert tally(report, "repaired", "repeated id made unique") == 1
    assert tally(report, "inferred", "height from the median of 8 neighbours") == 1
    with pytest.raises(CityError, match=r"--height-column 'hight': no such column; found height, eaves, n, key"):
        read_city(path, ReadOptions(streets=street, height_column="hight"))


@pytest.mark.parametrize(
    ("column", "unit", "foot"),
    [
        ("height", None, 1.0),
        ("height", "ft", 0.3048),
        ("height", "m", 1.0),
        ("height_ft", None, 0.3048),
        ("Height (ft)", None, 0.3048),
        ("HEIGHTFEET", None, 0.3048),
        ("HEIGHT_FEE", None, 0.3048),  # in a Shapefile
        ("coffee", None, 1.0),
        ("height_ft", "m", 1.0),
        ("loft", None, 1.0),
        ("shaft height", None, 1.0),
    ],
)
def test_heights_in_feet(tmp_path, street, column, unit, foot):
    """The option goes before the column's name; a cell that names its unit before both."""
    path = houses(
        tmp_path / "h.geojson",
        (HOUSE[0], {column: "40", "min_height": "10"}),
        (box(20, 9, 30, 20), {column: "40 m", "min_height": "10 m"}),
        (box(40, 9, 50, 20), {column: "nan", "levels": "2"}),
    )
    city, report = read_city(path, ReadOptions(streets=street, height_column=column, height_unit=unit))
    assert [one.top for one in city.objects] == pytest.approx([40.0 * foot, 40.0, 6.4])
    assert [one.base for one in city.objects] == pytest.approx([10.0 * foot, 10.0, 0.0])
    assert tally(report, "inferred", f"height from column {column}{' in feet' * (foot < 1.0)}") == 2
    said = f"heights in feet, as the column's name says ({column})"
    assert tally(report, "noted", said) == (unit is None and foot < 1.0)


def test_feet_are_guessed_where_a_column_says_so(tmp_path, street):
    city, _ = read_city(houses(tmp_path / "h.geojson", (HOUSE[0], {"height_ft": 100})), ReadOptions(streets=street))
    assert city.objects[0].top == pytest.approx(30.48)


def test_the_unit_means_nothing_for_openstreetmap(tmp_path):
    osm = OsmFile()
    with pytest.raises(ParameterError, match=r"--height-unit: .*a\.osm is OpenStreetMap"):
        read_city(osm.write(tmp_path / "a.osm"), ReadOptions(height_unit="ft"))


@pytest.mark.parametrize(("value", "stays"), [(True, 0), (False, 1), ("yes", 0), ("no", 1), (None, 1)])
def test_houses_below_the_ground(tmp_path, street, value, stays):
    path = houses(
        tmp_path / "h.geojson",
        (HOUSE[0], {"height": 3, "is_underground": value}),
        (box(20, 9, 30, 20), {"height": 3, "is_underground": False}),
    )
    city, report = read_city(path, ReadOptions(streets=street))
    assert len(city.objects) == 1 + stays
    assert tally(report, "left out", "building: underground") == 1 - stays


def test_unique_id_columns_are_used(tmp_path, street):
    path = houses(
        tmp_path / "h.geojson",
        (HOUSE[0], {"osm_id": 12.0, "height": 3}),
        (box(20, 9, 30, 20), {"osm_id": 7, "height": 3}),
    )
    assert [one.id for one in read_city(path, ReadOptions(streets=street))[0].objects] == ["12", "7"]


def test_two_layers_of_one_file(tmp_path):
    path = gpkg(
        tmp_path / "city.gpkg",
        plots=("Polygon", [at(box(-9, 5, 30, 30))], {"owner": ["me"]}),
        buildings=("Polygon", [at(HOUSE[0])], {"height": [9]}),
        roads=("LineString", [at(STREET[0])], {"fclass": ["tertiary"]}),
    )
    city, _ = read_city(path)
    assert city.objects[0].top == 9.0
    ((_, _, edge),) = city.streets.edges(data=True)
    assert edge["kind"] == "tertiary"
    with pytest.raises(CityError, match="--buildings-layer 'houses': no such layer; found plots, buildings, roads"):
        read_city(path, ReadOptions(buildings_layer="houses"))
    with pytest.raises(CityError, match="none of 1 buildings has a height"):
        read_city(path, ReadOptions(buildings_layer="plots"))


def test_several_possible_layers_are_refused_by_name(tmp_path):
    layers = {
        name: ("Polygon", [at(box(x, 10, x + 9, 20))], {"height": [9]}) for x, name in ((0, "zone"), (20, "around"))
    }
    path = gpkg(tmp_path / "city.gpkg", **layers, roads=("LineString", [at(STREET[0])], {"name": ["x"]}))
    with pytest.raises(
        CityError, match=r"several layers could be building polygons \(zone, around\): choose with --buildings-layer"
    ):
        read_city(path)
    city, _ = read_city(path, ReadOptions(buildings_layer="zone, around"))
    assert [one.id for one in city.objects] == ["zone/feature/0", "around/feature/0"]


def test_a_folder_of_shapefiles(tmp_path):
    folder = tmp_path / "district"
    folder.mkdir()
    gpkg(folder / "buildings.shp", buildings=("Polygon", [at(HOUSE[0])], {"height": [9]}))
    gpkg(folder / "roads.shp", roads=("LineString", [at(STREET[0])], {"type": ["primary"]}))
    city, _ = read_city(folder)
    assert len(city.objects) == 1
    assert city.source == "district"
    assert [edge["kind"] for _, _, edge in city.streets.edges(data=True)] == ["primary"]


def test_one_mixed_layer(tmp_path):
    path = houses(tmp_path / "all.geojson", HOUSE, STREET, (Point(0, 0), {}))
    city, report = read_city(path)
    assert (len(city.objects), city.streets.number_of_edges()) == (1, 1)
    assert tally(report, "noted", "line or point among the footprints") == 2


def test_odd_geometries(tmp_path, street):
    two = MultiPolygon([box(0, 10, 10, 20), box(12, 10, 20, 20)])
    deep = GeometryCollection([Point(0, 0), GeometryCollection([box(30, 10, 40, 20)])])
    solid = Polygon([(50, 10, 3), (60, 10, 3), (60, 20, 4)])
    features = [two, deep, solid, None, Polygon(), LineString([(0, 9), (9, 9)])]
    path = houses(tmp_path / "h.geojson", *[(one, {"height": 5}) for one in features])
    city, report = read_city(path, ReadOptions(streets=street))
    assert [(one.id, len(one.prisms)) for one in city.objects] == [("feature/0", 2), ("feature/1", 1), ("feature/2", 1)]
    assert not city.objects[2].footprint.has_z
    assert tally(report, "left out", "building: no geometry") == 2


def test_curves_are_flattened(tmp_path, street):
    path = tmp_path / "curves.csv"
    circle = "500000 5300020, 500010 5300030, 500020 5300020, 500010 5300010, 500000 5300020"
    path.write_text(f'WKT,height\n"CURVEPOLYGON(CIRCULARSTRING({circle}))",9\n')
    city, _ = read_city(path, ReadOptions(streets=street, crs=UTM))
    assert city.objects[0].footprint.area == pytest.approx(314.16, rel=0.01)


def test_building_parts_in_columns(tmp_path, street):
    tower = (box(0, 10, 5, 20), {"building_part": "yes", "height": 30})
    city, report = read_city(
        houses(tmp_path / "h.geojson", (HOUSE[0], {"building": "yes", "height": 9}), tower), ReadOptions(streets=street)
    )
    assert sorted(prism.top for prism in city.objects[0].prisms) == [9.0, 30.0]
    assert tally(report, "read", "building parts") == 1


def network(tmp_path, *features):
    house = houses(
        tmp_path / "h.geojson", (box(-300, -310, -290, -300), {"height": 9}), (box(300, 300, 310, 310), {"height": 9})
    )
    return read_city(house, ReadOptions(streets=houses(tmp_path / "lines.geojson", *features)))


def lengths(city):
    return sorted(round(edge["geometry"].length, 1) for _, _, edge in city.streets.edges(data=True))


def test_lines_meet_where_they_touch_or_cross(tmp_path):
    cross = [(LineString([(-100, 0), (100, 0)]), {}), (LineString([(0, -50), (0, 70)]), {})]
    nearly = (LineString([(60.02, 40), (60, 0.03)]), {})  # ends 3 cm off the first line
    city, _ = network(tmp_path, *cross, nearly)
    assert lengths(city) == [40.0, 40.0, 50.0, 60.0, 70.0, 100.0]
    assert sorted(dict(city.streets.degree()).values()) == [1, 1, 1, 1, 1, 3, 4]


def test_bridges_do_not_meet_what_they_cross(tmp_path):
    below = (LineString([(-100, 0), (100, 0)]), {"name": "river road"})
    bridge = (LineString([(0, -50), (0, 70)]), {"bridge": "T"})
    after = (LineString([(0, 70), (0, 90)]), {"bridge": "F"})
    city, report = network(tmp_path, below, bridge, after)
    assert lengths(city) == [20.0, 120.0, 200.0]
    assert sorted(dict(city.streets.degree()).values()) == [1, 1, 1, 1, 2]
    assert tally(report, "noted", "bridge kept on the ground") == 1


def test_repeated_lines_become_one_and_are_counted(tmp_path):
    first = (LineString([(-100, 0), (100, 0)]), {"highway": "primary"})
    again = (LineString([(100, 0), (-100, 0)]), {"highway": "residential"})
    city, report = network(tmp_path, first, again)
    assert [edge["kind"] for _, _, edge in city.streets.edges(data=True)] == ["primary"]
    assert tally(report, "left out", "street: repeats another or too short") == 1


def test_footprints_without_streets_get_paths_between_them(tmp_path):
    path = houses(
        tmp_path / "h.geojson", *((box(x, y, x + 30, y + 20), {"height": 9}) for x in (-35, 5) for y in (-25, 5))
    )
    city, report = read_city(path)
    paths = [edge["geometry"] for _, _, edge in city.streets.edges(data=True)]
    crossing = shapely.union_all([LineString([(-35, 0), (35, 0)]), LineString([(0, -25), (0, 25)])])
    assert all(line.within(crossing.buffer(1.0)) for line in paths)
    assert shapely.union_all(paths).length > 0.85 * crossing.length
    assert {edge["kind"] for *_, edge in city.streets.edges(data=True)} == {"pedestrian"}
    assert tally(report, "inferred", "paths through the open space, as there are no streets") == 4
    (warning,) = report.warnings
    assert warning.endswith(
        "h.geojson: no streets: no line layer or highways in it; paths lead through the open space instead (--streets FILE)"
    )


def test_paths_of_a_clipped_city_end_at_the_box(tmp_path):
    blocks = [(degrees(box(x, y, x + 30, y + 20)), {"height": 9}) for x in (-35, 5) for y in (-25, 5, 35)]
    path = geojson(tmp_path / "h.geojson", blocks)
    west, south, _, _ = degrees(box(-100, -100, 0, 0)).bounds
    east, north = degrees(Point(100, 20)).coords[0]
    city, report = read_city(path, ReadOptions(clip=(west, south, east, north)))
    assert len(city.objects) == 4
    assert tally(report, "left out", "building: outside --clip") == 2
    lines = shapely.union_all([edge["geometry"] for *_, edge in city.streets.edges(data=True)])
    clear = shapely.union_all([one.footprint for one in city.objects])
    assert not lines.is_empty
    assert lines.distance(clear) > 2.0


def test_lines_in_several_parts(tmp_path):
    parts = MultiLineString([[(-100, 0), (-50, 0)], [(50, 0), (100, 0)]])
    city, report = network(tmp_path, (parts, {"type": "Route"}), (LineString([(0, -20), (0, 20)]), {"tunnel": "yes"}))
    assert lengths(city) == [50.0, 50.0]
    assert tally(report, "left out", "street: tunnel") == 1


def test_streets_of_another_format(tmp_path):
    osm = OsmFile()
    osm.way(1, [(-20.0, -10.0), (20.0, -10.0)], highway="residential")
    path = geojson(tmp_path / "h.geojson", [(degrees(box(0, 0, 20, 10)), {"levels": 2})])
    city, _ = read_city(path, ReadOptions(streets=osm.write(tmp_path / "s.osm")))
    assert city.crs == UTM
    assert lengths(city) == pytest.approx([40], rel=0.01)


def test_missing_streets_and_unreadable_files_are_refused_in_one_line(tmp_path, street):
    path = houses(tmp_path / "h.geojson", HOUSE)
    (tmp_path / "text.txt").write_text("not a city\n")
    (tmp_path / "broken.geojson").write_text('{"type": "FeatureCollection", "features": [')
    (tmp_path / "empty.geojson").write_text('{"type": "FeatureCollection", "features": []}')
    (tmp_path / "zero.osm.pbf").write_bytes(b"")
    (tmp_path / "zero.gpkg").write_bytes(b"")
    (tmp_path / "cityjson.json").write_text('{"type": "CityJSON", "version": "1.0"}')
    (tmp_path / "folder").mkdir()
    gpkg(tmp_path / "half.shp", half=("Polygon", [at(HOUSE[0])], {"height": [9]}))
    (tmp_path / "half.shx").unlink()
    for name in (
        "missing.osm",
        "text.txt",
        "broken.geojson",
        "empty.geojson",
        "zero.osm.pbf",
        "zero.gpkg",
        "folder",
        "half.shp",
    ):
        with pytest.raises(CityError) as caught:
            read_city(tmp_path / name, ReadOptions(streets=street))
        assert "\n" not in str(caught.value)
        assert name in str(caught.value)
    with pytest.raises(CityError, match=r"cityjson\.json: "):
        read_city(tmp_path / "cityjson.json", ReadOptions(streets=street))
    with pytest.raises(
        CityError, match=r"h\.geojson: no streets: no line layer.* in it; expected streets, as this is where"
    ):
        read_city(path, ReadOptions(streets=path))
    with pytest.raises(CityError, match=r"--streets-layer 'roads': no such layer"):
        read_city(path, ReadOptions(streets_layer="roads"))
    with pytest.raises(
        CityError, match=r"no streets: no usable line in it; left out: 1 not a line; expected streets, as"
    ):
        read_city(path, ReadOptions(streets_layer="h"))
    with pytest.raises(CityError, match="no such file"):
        read_city(path, ReadOptions(streets=tmp_path / "nowhere.geojson"))


@pytest.mark.parametrize(
    "options",
    [
        {"network": "fly"},
        {"objects": "trees"},
        {"clip": (9.0, 48.0, 8.0, 49.0)},
        {"clip": (9.0, float("nan"), 10.0, 49.0)},
        {"crs": "EPSG:1234567"},
        {"crs": "utm please"},
        {"crs": "EPSG:4978"},  # geocentric
        {"crs": "EPSG:5714"},  # heights
    ],
)
def test_nonsense_options(tmp_path, street, options):
    with pytest.raises(ParameterError) as caught:
        read_city(houses(tmp_path / "h.geojson", HOUSE), ReadOptions(streets=street, **options))
    assert "\n" not in str(caught.value)


def test_columns_mean_nothing_for_openstreetmap(tmp_path):
    osm = OsmFile()
    osm.box(1, 0, 0, 9, 9, building="yes", height="3")
    with pytest.raises(ParameterError, match="--height-column"):
        read_city(osm.write(tmp_path / "a.osm"), ReadOptions(height_column="height"))


def test_what_the_libraries_throw_does_not_leak(tmp_path, street):
    path = gpkg(tmp_path / "h.shp", h=("Polygon", [at(HOUSE[0])], {"height": [9]}))
    path.with_suffix(".prj").write_bytes(b'PROJCS["\xa9\xf0\xe4')
    with pytest.raises(CityError, match=r"h\.shp"):
        read_city(path, ReadOptions(streets=street))
    osm = OsmFile()
    osm.box(1, 0, 0, 9, 9, building="yes", height="3")
    text = osm.write(tmp_path / "a.osm").read_text()
    for old, new in (('id="1"', 'id="1x"'), ('lon="9', 'lon="x9'), ('lat="48', 'lat="480')):
        (tmp_path / "a.osm").write_text(text.replace(old, new, 1))
        with pytest.raises(CityError, match=r"a\.osm") as caught:
            read_city(tmp_path / "a.osm")
        assert "\n" not in str(caught.value)
