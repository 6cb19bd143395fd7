"""Coordinates: whatever the file says, the city comes out in true metres, or the file is refused."""

from __future__ import annotations

import math

import numpy as np
import pyproj
import pytest
import shapely
from city_files import degrees, geojson
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import LineString, box

from mmi.foundation.errors import CityError
from mmi.reading.coordinates import named_crs
from mmi.reading.read_city import read_city
from mmi.reading.read_options import ReadOptions

HOUSES = [box(x, y, x + 12, y + 8) for x in range(0, 120, 20) for y in range(0, 100, 20)]
STREET = LineString([(-20, -5), (130, -5)])


def turn(geometry, angle=0.4):
    matrix = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    return shapely.transform(geometry, lambda xy: xy @ matrix)


def city_at(folder, lon, lat, *, to=None, declare=None, swap=False):
    """Houses of 96 m2 at a place, written in CRS ``to`` and declared as ``declare``. Returns the two files."""

    def place(geometry):
        geometry = degrees(turn(geometry), lon=lon, lat=lat)
        if to is not None:
            move = pyproj.Transformer.from_crs(4326, to, always_xy=True)
            geometry = shapely.transform(geometry, lambda xy: np.column_stack(move.transform(*xy.T)))
        return shapely.transform(geometry, lambda xy: xy[:, ::-1]) if swap else geometry

    folder.mkdir(exist_ok=True)
    declared = declare if declare is not None else to
    houses = geojson(folder / "houses.geojson", [(place(one), {"height": 6}) for one in HOUSES], crs=declared)
    streets = geojson(folder / "streets.geojson", [(place(STREET), {})], crs=declared)
    return houses, streets


def areas(city):
    return [one.footprint.area for one in city.objects]


@pytest.mark.parametrize(
    ("lon", "lat", "code"),
    [
        (2.35, 48.86, "EPSG:32631"),
        (-43.2, -22.9, "EPSG:32723"),
        (179.9, -17.0, "EPSG:32760"),
        (24.94, 60.17, "EPSG:32635"),
    ],
)
def test_degrees_go_to_utm(tmp_path, lon, lat, code):
    houses, streets = city_at(tmp_path / "c", lon, lat)
    city, _ = read_city(houses, ReadOptions(streets=streets))
    assert city.crs == code
    assert areas(city) == pytest.approx([96.0] * 30, rel=0.012)  # `degrees` is a sphere's
    assert max(abs(one) for one in city.bounds) < 200


def test_web_mercator_is_deflated(tmp_path):
    houses, streets = city_at(tmp_path / "c", 14.4, 50.1, to="EPSG:3857")
    city, report = read_city(houses, ReadOptions(streets=streets))
    assert city.crs == "EPSG:32633"
    assert areas(city) == pytest.approx([96.0] * 30, rel=0.012)
    assert any("web-mercator" in text for text in report.warnings)


@pytest.mark.parametrize(
    ("lon", "lat", "code"), [(-3.4, 47.75, "EPSG:2154"), (4.9, 52.37, "EPSG:28992"), (8.5, 47.17, "EPSG:2056")]
)
def test_national_grids_are_kept(tmp_path, lon, lat, code):
    houses, streets = city_at(tmp_path / "c", lon, lat, to=code)
    city, report = read_city(houses, ReadOptions(streets=streets))
    assert city.crs == code
    assert areas(city) == pytest.approx([96.0] * 30, rel=0.012)
    assert not report.warnings


def test_feet_and_far_zones_are_reprojected(tmp_path):
    for lon, lat, code, word in ((-74.0, 40.73, "EPSG:2263", "units"), (14.4, 50.1, "EPSG:32631", "outside its area")):
        houses, streets = city_at(tmp_path / "c", lon, lat, to=code)
        city, report = read_city(houses, ReadOptions(streets=streets))
        assert city.crs in {"EPSG:32618", "EPSG:32633"}
        assert areas(city) == pytest.approx([96.0] * 30, rel=0.012)
        assert any(word in text for text in report.warnings)


@settings(max_examples=15, deadline=None)
@given(st.floats(-179, 179), st.floats(-55, 75))
def test_true_metres_everywhere(tmp_path_factory, lon, lat):
    houses, streets = city_at(tmp_path_factory.mktemp("c") / "c", lon, lat)
    city, _ = read_city(houses, ReadOptions(streets=streets))
    assert areas(city) == pytest.approx([96.0] * 30, rel=0.015)
    back = pyproj.Transformer.from_crs(city.crs, 4326, always_xy=True)
    x, y = city.objects[0].footprint.centroid.coords[0]
    true = degrees(turn(HOUSES[0]), lon=lon, lat=lat).centroid
    assert back.transform(x + city.origin[0], y + city.origin[1]) == pytest.approx((true.x, true.y), abs=1e-6)


@pytest.mark.parametrize(
    ("lon", "lat"), [(2.35, 48.86), (-74.0, 40.73), (103.8, 1.35), (151.2, -33.9), (-0.2, 51.5), (-78.5, -0.2)]
)
def test_swapped_axes_are_refused(tmp_path, lon, lat):
    houses, streets = city_at(tmp_path / "c", lon, lat, swap=True)
    with pytest.raises(CityError, match="swapped") as caught:
        read_city(houses, ReadOptions(streets=streets))
    assert "\n" not in str(caught.value)


def test_only_the_streets_swapped(tmp_path):
    houses, _ = city_at(tmp_path / "a", 2.35, 48.86)
    _, streets = city_at(tmp_path / "b", 2.35, 48.86, swap=True)
    with pytest.raises(CityError, match=r"lie apart: latitude and longitude look swapped in .*streets.geojson"):
        read_city(houses, ReadOptions(streets=streets))


def test_metres_without_a_crs_need_one(tmp_path):
    folder = tmp_path / "c"
    houses, streets = city_at(folder, 2.35, 48.86, to="EPSG:32631", declare="")
    for file in (houses, streets):
        file.write_text(file.read_text().replace('"crs"', '"no_crs"'))
    with pytest.raises(CityError, match="--crs"):
        read_city(houses, ReadOptions(streets=streets))
    city, _ = read_city(houses, ReadOptions(streets=streets, crs="EPSG:32631"))
    assert city.crs == "EPSG:32631"
    assert areas(city) == pytest.approx([96.0] * 30, rel=0.012)


def test_degrees_declared_as_metres_are_refused(tmp_path):
    houses, streets = city_at(tmp_path / "c", 2.35, 48.86, declare="EPSG:32631")
    with pytest.raises(CityError, match="look like degrees but are declared as EPSG:32631"):
        read_city(houses, ReadOptions(streets=streets))
    city, _ = read_city(houses, ReadOptions(streets=streets, crs="EPSG:4326"))
    assert areas(city) == pytest.approx([96.0] * 30, rel=0.012)


def test_a_wrong_crs_of_one_file_is_replaced_by_the_option(tmp_path):
    houses, _ = city_at(tmp_path / "a", 2.35, 48.86, to="EPSG:32631", declare="EPSG:32633")
    _, streets = city_at(tmp_path / "b", 2.35, 48.86)
    with pytest.raises(CityError, match="lie apart"):
        read_city(houses, ReadOptions(streets=streets))
    city, _ = read_city(houses, ReadOptions(streets=streets, crs="EPSG:32631"))
    assert city.streets.number_of_edges() == 1
    assert areas(city) == pytest.approx([96.0] * 30, rel=0.012)


def test_a_crs_that_puts_the_city_elsewhere_is_refused(tmp_path):
    houses, streets = city_at(tmp_path / "c", 8.5, 47.17, to="EPSG:32632")
    with pytest.raises(CityError, match="far outside the area of EPSG:2263"):
        read_city(houses, ReadOptions(streets=streets, crs="EPSG:2263"))


def test_a_stray_building_far_away_is_explained(tmp_path):
    features = [(degrees(one), {"height": 6}) for one in HOUSES] + [(box(0, 10, 0.001, 10.001), {"height": 6})]
    houses = geojson(tmp_path / "h.geojson", features)
    streets = geojson(tmp_path / "s.geojson", [(degrees(STREET), {})])
    with pytest.raises(CityError, match=r"spread over .* km.*--clip"):
        read_city(houses, ReadOptions(streets=streets))
    city, report = read_city(houses, ReadOptions(streets=streets, clip=(8.9, 47.9, 9.1, 48.1)))
    assert len(city.objects) == 30
    assert any("outside --clip" in one.what for one in report.left_out)


def test_moving_the_city_changes_nothing_but_the_origin(tmp_path):
    cities = []
    for shift in (0.0, 730.0):
        folder = tmp_path / str(shift)
        folder.mkdir()

        def move(geometry, by=shift):
            return shapely.transform(geometry, lambda xy: xy + np.array([500_000 + by, 5_300_000 + by]))

        houses = geojson(folder / "h.geojson", [(move(one), {"height": 6}) for one in HOUSES], crs="EPSG:32632")
        streets = geojson(folder / "s.geojson", [(move(STREET), {})], crs="EPSG:32632")
        cities.append(read_city(houses, ReadOptions(streets=streets))[0])
    one, other = cities
    assert np.subtract(other.origin, one.origin).tolist() == [730.0, 730.0, 0.0]
    assert [a.footprint.wkb for a in one.objects] == [b.footprint.wkb for b in other.objects]


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("EPSG:25833", 25833),
        ("25833", 25833),
        ("urn:ogc:def:crs:EPSG::25833", 25833),
        ("urn:ogc:def:crs:EPSG:6.12:25833", 25833),
        ("urn:ogc:def:crs,crs:EPSG::25833,crs:EPSG::5783", 25833),
        ("urn:ogc:def:crs,crs:EPSG:6.12:3068,crs:EPSG:6.12:5783", 3068),
        ("http://www.opengis.net/def/crs/EPSG/0/25833", 25833),
        ("http://www.opengis.net/def/crs/EPSG/9.9.1/25833", 25833),
        ("http://www.opengis.net/def/crs-compound?1=http://www.opengis.net/def/crs/EPSG/0/25833"
         "&2=http://www.opengis.net/def/crs/EPSG/0/5783", 25833),
        ("http://www.opengis.net/gml/srs/epsg.xml#4326", 4326),
        ("EPSG:25833+5783", 25833),
        ("EPSG:5783+25833", None),  # the second number of a sum has no name of its own
        ("['[EPSG:5783]', '[EPSG:25833]']", 25833),
        ("EPSG:7415", 28992),  # a compound system by itself
        ("EPSG:5783", None),  # heights
        ("EPSG:99999", None),
        ("EPSG:1234567", None),
        ("urn:adv:crs:ETRS89_UTM33*DE_DHHN2016_NH", None),
    ],
)  # fmt: skip
def test_names_of_coordinate_systems(text, code):
    local = pyproj.CRS.from_epsg(31468)
    assert named_crs("a.gml: srsName", text, local).to_epsg() == (31468 if code is None else code)
    if code is None:
        with pytest.raises(CityError, match=r"^a\.gml: srsName: an EPSG code expected.*--crs"):
            named_crs("a.gml: srsName", text, None)
