"""The account of a reading: refusals give the counted reasons for which things were left out."""

from __future__ import annotations

import pytest
import shapely
from city_files import OsmFile, degrees, geojson
from shapely.geometry import LineString, box

from mmi.foundation.errors import CityError
from mmi.reading.read_city import read_city
from mmi.reading.read_options import ReadOptions
from mmi.reading.report import Ledger


def test_reasons_are_counted_and_the_most_frequent_named():
    ledger = Ledger()
    assert ledger.why_left_out() == ledger.why_left_out("building") == ""
    for what, count in (("a", 1), ("b", 7), ("c", 3), ("d", 2), ("e", 1), ("f", 1)):
        ledger.note("left out", f"building: {what}", count=count)
    ledger.note("left out", "street: tunnel", count=2)
    ledger.note("noted", "building: x", count=99)
    assert ledger.why_left_out("building") == "; left out: 7 b, 3 c, 2 d, 1 a, 2 for other reasons"
    assert ledger.why_left_out("street") == "; left out: 2 tunnel"
    assert ledger.why_left_out().startswith(
        "; left out: 7 building: b, 3 building: c, 2 building: d, 2 street: tunnel, 3"
    )


HOUSE = degrees(box(0, 5, 10, 15))
ROAD = degrees(LineString([(-20, 0), (40, 0)]))
UNDER = degrees(LineString([(2, 8), (6, 9)]))


@pytest.mark.parametrize(
    ("features", "message"),
    [
        ([(HOUSE, {"building": "no", "height": 3}), (ROAD, {})], r"no buildings left; .*; left out: 1 building=no$"),
        ([(HOUSE, {"height": 3, "is_underground": True}), (ROAD, {})], "left out: 1 underground$"),
        ([(HOUSE, {"height": 3}), (UNDER, {})], "left out: 1 inside buildings$"),
    ],
)  # fmt: skip
def test_refusals_give_their_reasons(tmp_path, features, message):
    with pytest.raises(CityError, match=message) as caught:
        read_city(geojson(tmp_path / "a.geojson", features))
    assert "\n" not in str(caught.value)


def test_refusals_of_maps_and_models_give_their_reasons(tmp_path):
    osm = OsmFile()
    osm.way(1, [(0, 5), (10, 5), (10, 15)], building="yes")
    with pytest.raises(CityError, match=r"no buildings; .*; left out: 1 outline not closed$"):
        read_city(osm.write(tmp_path / "a.osm"))
    members = "<cityObjectMember><Building/></cityObjectMember>" * 2 + "<cityObjectMember><Bridge/></cityObjectMember>"
    (tmp_path / "a.gml").write_text(f"<CityModel>{members}</CityModel>")
    reasons = "left out: 2 building: no surfaces above level of detail 0, 1 Bridge: no building$"
    with pytest.raises(CityError, match=f"no buildings; .*; {reasons}"):
        read_city(tmp_path / "a.gml")


@pytest.mark.parametrize(
    ("crs", "xy", "swapped"),
    [("EPSG:4326", (25.0, 89.0), True), ("EPSG:4326", (150.0, 89.0), False), ("EPSG:32633", (500000, 9990000), False)],
)
def test_swapped_axes_are_named_only_where_that_can_be(tmp_path, crs, xy, swapped):
    size = 1e-4 if crs == "EPSG:4326" else 10.0
    house = shapely.box(*xy, xy[0] + size, xy[1] + size)
    path = geojson(
        tmp_path / "a.geojson", [(house, {"height": 3}), (LineString([xy, (xy[0] + size, xy[1])]), {})], crs=crs
    )
    with pytest.raises(CityError, match="where no city is") as caught:
        read_city(path, ReadOptions())
    assert ("latitude and longitude swapped" in str(caught.value)) is swapped
