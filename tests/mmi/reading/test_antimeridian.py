"""Towns across 180 degrees come out as they are on the ground, in every format that has degrees and in grids."""

from __future__ import annotations

import json

import numpy as np
import pyproj
import pytest
import shapely
from city_files import degrees, geojson
from model_cities import QUADS, box_corners
from shapely.geometry import LineString, box

from mmi.foundation.errors import CityError, ParameterError
from mmi.reading.antimeridian import boxes_meet, degrees_outside, joined_longitudes, within_180
from mmi.reading.read_city import read_city
from mmi.reading.read_options import ReadOptions

TAVEUNI = (180.0, -16.8)
HOUSES = [box(x, 10, x + 20, 25) for x in (-170, -110, -50, -10, 50, 110)]
"""Metres from where the 180th meridian crosses the island; the fourth lies on both sides."""
STREET = LineString([(-200, 0), (200, 0)])


def wrapped(geometry):
    """Metres as longitude and latitude, none of which is above 180."""
    geometry = degrees(geometry, lon=TAVEUNI[0], lat=TAVEUNI[1])
    return shapely.transform(
        geometry, lambda xy: np.column_stack([np.where(xy[:, 0] > 180.0, xy[:, 0] - 360.0, xy[:, 0]), xy[:, 1]])
    )


def town(folder, *, houses=HOUSES, street=STREET, to=None):
    """The two files, in degrees or in the system ``to``."""

    def place(geometry):
        if to is None:
            return wrapped(geometry)
        move = pyproj.Transformer.from_crs(4326, to, always_xy=True)
        return shapely.transform(wrapped(geometry), lambda xy: np.column_stack(move.transform(*xy.T)))

    return (
        geojson(folder / "houses.geojson", [(place(one), {"height": 6}) for one in houses], crs=to),
        geojson(folder / "streets.geojson", [(place(street), {})], crs=to),
    )


def middles(city):
    """Middles of the houses (n, 2) from the first, metres; the frame may be turned by a part of a degree."""
    found = np.array([one.footprint.centroid.coords[0] for one in city.objects])
    return found - found[0]


@pytest.mark.parametrize(
    ("to", "frame"),
    [
        (None, {"EPSG:32701", "EPSG:32760"}),
        ("EPSG:4326", {"EPSG:32701", "EPSG:32760"}),
        ("EPSG:32760", {"EPSG:32760"}),
        ("EPSG:32701", {"EPSG:32701"}),
        ("EPSG:3460", {"EPSG:3460"}),  # Fiji, whose area reaches over 180 degrees
    ],
)
def test_a_town_on_both_sides(tmp_path, to, frame):
    houses, streets = town(tmp_path, to=to)
    city, _ = read_city(houses, ReadOptions(streets=streets))
    assert city.crs in frame
    assert [one.footprint.area for one in city.objects] == pytest.approx([300.0] * 6, rel=0.012)
    apart = np.array([(0, 0), (60, 0), (120, 0), (160, 0), (220, 0), (280, 0)])
    assert np.linalg.norm(middles(city), axis=1) == pytest.approx(np.linalg.norm(apart, axis=1), rel=0.01)
    assert middles(city)[-1, 0] > 270.0, "east is where it was"
    assert sum(edge["geometry"].length for _, _, edge in city.streets.edges(data=True)) == pytest.approx(
        400.0, rel=0.01
    )


@pytest.mark.parametrize("side", ["west", "east"])
def test_streets_on_one_side_only(tmp_path, side):
    street = LineString([(-200, 0), (-20, 0)] if side == "west" else [(20, 0), (200, 0)])
    houses, streets = town(tmp_path, street=street)
    city, _ = read_city(houses, ReadOptions(streets=streets))
    (line,) = [edge["geometry"] for _, _, edge in city.streets.edges(data=True)]
    assert line.length == pytest.approx(180.0, rel=0.01)
    x = np.array([one.footprint.centroid.x for one in city.objects])
    assert (line.centroid.x < x.mean()) == (side == "west")


def test_a_map_on_both_sides(tmp_path):
    """A house in OpenStreetMap whose outline jumps from 180 to -180."""
    nodes, ways = [], []
    for k, (geometry, tags) in enumerate([(one, "building") for one in HOUSES] + [(STREET, "highway")]):
        places = shapely.get_coordinates(wrapped(geometry))
        ids = [f"{k}{n}1" for n in range(len(places) - (tags == "building"))]
        nodes += [f"<node id='{i}' lon='{x:.9f}' lat='{y:.9f}'/>" for i, (x, y) in zip(ids, places, strict=False)]
        refs = "".join(f"<nd ref='{i}'/>" for i in (ids + ids[:1] if tags == "building" else ids))
        value = "yes" if tags == "building" else "residential"
        ways.append(f"<way id='{k}'>{refs}<tag k='{tags}' v='{value}'/><tag k='height' v='6'/></way>")
    path = tmp_path / "a.osm"
    path.write_text(f"<osm version='0.6'>{''.join(nodes)}{''.join(ways)}</osm>")
    city, _ = read_city(path)
    assert [one.footprint.area for one in city.objects] == pytest.approx([300.0] * 6, rel=0.012)
    assert middles(city)[-1, 0] == pytest.approx(280.0, rel=0.01)


def test_a_model_on_both_sides(tmp_path):
    objects, vertices = {}, []
    for k, house in enumerate(HOUSES):
        x0, y0, x1, y1 = house.bounds
        corners = box_corners(x0, y0, 0.0, x1, y1, 6.0)
        flat = shapely.get_coordinates(wrapped(LineString(corners[:, :2])))
        faces = [[[i + len(vertices) for i in quad]] for quad in QUADS]
        vertices += np.column_stack([flat, corners[:, 2]]).tolist()
        objects[f"h{k}"] = {"type": "Building", "geometry": [{"type": "Solid", "lod": "1", "boundaries": [faces]}]}
    document = {"type": "CityJSON", "version": "1.0", "CityObjects": objects, "vertices": vertices}
    path = tmp_path / "a.json"
    path.write_text(json.dumps(document | {"metadata": {"referenceSystem": "urn:ogc:def:crs:EPSG::4326"}}))
    city, _ = read_city(path)
    assert [one.footprint.area for one in city.objects] == pytest.approx([300.0] * 6, rel=0.012)
    assert middles(city)[-1, 0] == pytest.approx(280.0, rel=0.01)


@pytest.mark.parametrize(
    ("clip", "kept"),
    [
        ((179.9, -16.9, 180.1, -16.7), 6),
        ((179.0, -16.9, 180.0, -16.7), 4),
        ((-180.0, -16.9, -179.0, -16.7), 3),
        ((180.0, -16.9, 181.0, -16.7), 3),
    ],
)
@pytest.mark.parametrize("to", [None, "EPSG:32760"])
def test_boxes_to_both_sides(tmp_path, clip, kept, to):
    houses, streets = town(tmp_path, to=to)
    city, _ = read_city(houses, ReadOptions(streets=streets, clip=clip))
    assert len(city.objects) == kept


def test_boxes_around_the_earth_are_refused():
    for clip in ((-180.0, 0.0, 181.0, 1.0), (181.0, 0.0, 182.0, 1.0), (10.0, 0.0, 361.0, 1.0)):
        with pytest.raises(ParameterError, match="--clip: expected west < east"):
            ReadOptions(clip=clip)


def test_two_towns_on_the_two_sides_of_the_earth_are_no_town(tmp_path):
    houses = [box(x, 10, x + 20, 25) for x in (-9e6, 0, 9e6)]
    path, streets = town(tmp_path, houses=houses)
    with pytest.raises(CityError, match=r"the buildings spread over 3[0-9]* km: expected a city"):
        read_city(path, ReadOptions(streets=streets))


def test_longitudes_are_joined_only_around_180():
    near = np.array([179.9, -179.9, -180.0, 180.0])
    assert joined_longitudes(near).tolist() == [179.9, 180.1, 180.0, 180.0]
    for other in (
        [179.0, 178.0],
        [-179.0, -178.0],
        [179.9, 0.0, -179.9],
        [100.0, -100.0],
        [179.0, -165.0],
        [181.0, -179.0],
        [],
    ):
        lon = np.array(other, dtype=float)
        assert joined_longitudes(lon) is lon


def test_longitude_is_round():
    assert [within_180(lon) for lon in (179.0, 180.0, 181.0, 360.0, -180.0)] == [179.0, 180.0, -179.0, 0.0, -180.0]
    assert boxes_meet((179.9, 0, 180.1, 1), (-180.0, 0, -179.95, 1))
    assert boxes_meet((-180.0, 0, -179.95, 1), (179.9, 0, 180.1, 1))
    assert not boxes_meet((179.9, 0, 180.1, 1), (-179.8, 0, -179.7, 1))
    assert not boxes_meet((179.9, 0, 180.1, 1), (179.9, 2, 180.1, 3))
    assert degrees_outside(-179.0, 176.0, -178.0) == 0.0
    assert degrees_outside(175.0, 176.0, -178.0) == 1.0
