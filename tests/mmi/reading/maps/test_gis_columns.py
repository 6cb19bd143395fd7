"""Exports of whole maps: land use is no building, rails and rivers are no streets, and all of it is counted."""

import numpy as np
import pyogrio
import pytest
import shapely
from city_files import geojson
from shapely.geometry import LineString, box

from mmi.foundation.errors import CityError
from mmi.reading.read_city import read_city
from mmi.reading.read_options import ReadOptions

UTM = "EPSG:32632"
E, N = 500_000.0, 5_300_000.0


def house(k, **columns):
    return box(E + 20 * k, N + 10, E + 20 * k + 10, N + 20), {"height": 9, **columns}


def line(k, **columns):
    return LineString([(E - 50, N - 10 * k), (E + 150, N - 10 * k)]), columns


def read(tmp_path, polygons, lines, **options):
    return read_city(
        geojson(tmp_path / "houses.geojson", polygons, crs=UTM),
        ReadOptions(streets=geojson(tmp_path / "lines.geojson", lines, crs=UTM), **options),
    )


def left_out(report):
    return {one.what: one.count for one in report.left_out}


def tally(report, section, start):
    return sum(one.count for one in report.sections()[section] if one.what.startswith(start))


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        (None, "none (empty in the column building)"),
        ("", "none (empty in the column building)"),
        ("  ", "none (empty in the column building)"),
        ("no", "building=no"),
        ("False", "building=false"),
        ("0", "building=0"),
    ],
)
def test_a_polygon_without_building_is_none(tmp_path, value, reason):
    polygons = [house(0, building="yes"), house(1, building=value), house(2, building="house")]
    city, report = read(tmp_path, polygons, [line(0)])
    assert [one.id for one in city.objects] == ["feature/0", "feature/2"]
    assert left_out(report) == {f"building: {reason}": 1}
    assert tally(report, "read", "buildings") == 3


def test_a_part_of_a_building_needs_no_value(tmp_path):
    polygons = [house(0, building="yes"), house(0, building=None, building_part="yes")]
    city, report = read(tmp_path, polygons, [line(0)])
    assert len(city.objects) == 1
    assert left_out(report) == {}


@pytest.mark.parametrize("columns", [{}, {"building": None}])
def test_without_the_column_every_polygon_is_a_building(tmp_path, columns):
    city, report = read(tmp_path, [house(0, **columns), house(1, **columns)], [line(0)])
    assert len(city.objects) == 2
    assert left_out(report) == {}


@pytest.mark.parametrize(
    ("columns", "reason"),
    [
        ({"highway": None}, "empty in the column highway"),
        ({"highway": None, "railway": "rail"}, "railway"),
        ({"highway": None, "waterway": "river"}, "waterway"),
        ({"highway": None, "barrier": "fence"}, "barrier"),
        ({"highway": None, "power": "line"}, "power"),
        ({"highway": "no", "railway": "rail"}, "highway=no"),
    ],
)
def test_a_line_that_is_no_highway_is_no_street(tmp_path, columns, reason):
    city, report = read(tmp_path, [house(0)], [line(0, highway="residential"), line(1, **columns)])
    assert [edge["kind"] for _, _, edge in city.streets.edges(data=True)] == ["residential"]
    assert left_out(report) == {f"street: no road ({reason})": 1}
    assert tally(report, "read", "streets") == 2


def test_a_road_with_rails_or_a_fence_is_a_street(tmp_path):
    roads = [line(0, highway="residential", railway="tram"), line(1, highway="tertiary", barrier="yes")]
    city, report = read(tmp_path, [house(0)], roads)
    assert city.streets.number_of_edges() == 2
    assert left_out(report) == {}


def test_without_a_column_highway_the_others_tell(tmp_path):
    lines = [line(0, railway=None), line(1, railway="no"), line(2, railway="rail")]
    city, report = read(tmp_path, [house(0)], lines)
    assert city.streets.number_of_edges() == 2
    assert left_out(report) == {"street: no road (railway)": 1}


def test_kinds_of_lines_in_one_column(tmp_path):
    lines = [line(0, fclass="residential"), line(1, fclass="rail"), line(2, fclass="Stream"), line(3, fclass="lane")]
    city, report = read(tmp_path, [house(0)], lines)
    assert [edge["kind"] for _, _, edge in city.streets.edges(data=True)] == ["residential", "street"]
    assert left_out(report) == {"street: no road (rail)": 1, "street: no road (stream)": 1}


def test_lines_without_any_road_are_refused_with_their_number(tmp_path):
    why = r"no streets: no usable line in it; left out: 2 no road \(railway\); expected streets, as this is where"
    with pytest.raises(CityError, match=why):
        read(tmp_path, [house(0)], [line(0, railway="rail"), line(1, railway="tram")])


@pytest.mark.parametrize("word", ["NULL", "<null>", "nan", "n/a", "-"])
def test_words_for_an_empty_cell(tmp_path, word):
    polygons = [house(0, building="yes", gid="1"), house(1, building=word, gid=word)]
    city, report = read(tmp_path, polygons, [line(0)])
    assert [one.id for one in city.objects] == ["feature/0"]
    assert left_out(report) == {"building: none (empty in the column building)": 1}


def test_open_land_is_no_building(tmp_path):
    """Its class in an extract as a Shapefile, or a column of land use where there is no height."""
    polygons = [house(0, fclass="building"), house(1, fclass="water"), house(2, fclass="forest")]
    city, report = read(tmp_path, polygons, [line(0)])
    assert [one.id for one in city.objects] == ["feature/0"]
    assert left_out(report) == {"building: open land (water)": 1, "building: open land (forest)": 1}
    polygons = [house(0, natural=None), house(1, natural="Water", height=None), house(2, landuse="grass")]
    city, report = read(tmp_path, polygons, [line(0)])
    assert [one.id for one in city.objects] == ["feature/0", "feature/2"]
    assert left_out(report) == {"building: open land (water)": 1}


def shapefile(path, ids, encoding, cpg):
    """Houses with ids in an encoding that the .cpg tells, or does not."""
    shapes = [house(k)[0] for k in range(len(ids))]
    columns = [np.array(ids, dtype=object), np.full(len(ids), 9.0)]
    pyogrio.raw.write(
        path, shapely.to_wkb(shapes), columns, ["id", "height"], geometry_type="Polygon", crs=UTM, encoding=encoding
    )
    path.with_suffix(".cpg").unlink()
    if cpg is not None:
        path.with_suffix(".cpg").write_text(cpg)
    return path


@pytest.mark.parametrize(
    ("encoding", "cpg", "as_they_are", "noted"),
    [
        ("UTF-8", "UTF-8", True, 0),
        ("UTF-8", None, True, 1),
        ("UTF-8", "", True, 1),
        ("SHIFT_JIS", "SHIFT_JIS", True, 0),
        ("SHIFT_JIS", None, False, 0),
    ],
)
def test_texts_of_shapefiles(tmp_path, encoding, cpg, as_they_are, noted):
    ids = ["東京", "表示", "能登", "h4"]
    path = shapefile(tmp_path / "h.shp", ids, encoding, cpg)
    streets = geojson(tmp_path / "lines.geojson", [line(0)], crs=UTM)
    city, report = read_city(path, ReadOptions(streets=streets))
    found = [one.id for one in city.objects]
    assert len(set(found)) == 4
    assert "h4" in found
    assert (found == ids) == as_they_are
    assert all(one.isprintable() for one in found)
    assert tally(report, "noted", "texts read as UTF-8") == noted
    assert any(".cpg should" in one for one in report.warnings) == (not as_they_are)
