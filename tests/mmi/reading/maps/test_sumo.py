"""SUMO networks: both directions of a street are one line in its middle, where it is on the earth, with its tags."""

from __future__ import annotations

import gzip
import json

import numpy as np
import pytest
import shapely
from cities import real

from mmi.foundation.errors import CityError
from mmi.reading.maps.sumo import is_sumo, read_sumo
from mmi.reading.read_city import read_city
from mmi.reading.read_options import ReadOptions
from mmi.reading.report import Ledger

HEAD = '<?xml version="1.0"?>\n<net version="1.9" xmlns:xsi="x" xsi:noNamespaceSchemaLocation="http://sumo.dlr.de/xsd/net_file.xsd">\n'
UTM = (
    '<location netOffset="-600000.00,-5790000.00" projParameter="+proj=utm +zone=32 +ellps=WGS84 +units=m +no_defs"/>\n'
)
LOCAL = '<location netOffset="0,0" projParameter="!"/>\n'
BODY = """
<edge id=":a_0" function="internal"><lane id=":a_0_0" index="0" shape="0,0 1,1"/></edge>
<edge id="e" from="a" to="b" type="highway.residential" name="Elm Street">
  <lane id="e_0" index="0" shape="2,-4.8 98,-4.8"/><lane id="e_1" index="1" shape="2,-1.6 98,-1.6"/>
</edge>
<edge id="-e" from="b" to="a" type="highway.residential"><lane id="-e_0" index="0" width="6.4" shape="98,3.2 2,3.2"/></edge>
<edge id="one" from="b" to="c" type="highway.footway"><lane id="one_0" index="0" shape="100,2 100,50 100,98"/></edge>
<edge id="tram" from="a" to="c" type="railway.tram"><lane id="tram_0" index="0" shape="0,0 100,100"/></edge>
<edge id="up" from="c" to="d" type="highway.primary"><lane id="up_0" index="0" shape="102,130 198,130"/></edge>
<edge id="down" from="d" to="c" type="highway.primary"><lane id="down_0" index="0" shape="198,70 102,70"/></edge>
<junction id="a" type="priority" x="0" y="0" shape=""/><junction id="b" type="priority" x="100" y="0"/>
<junction id="c" type="priority" x="100" y="100"/><junction id=":x" type="internal" x="7" y="7"/>
<junction id="d" type="dead_end" x="200" y="100"/>
</net>"""


def write(path, text):
    path.write_text(text)
    return path


def streets(layer):
    return {one.id: one for one in layer.items}


def test_two_directions_become_one_street_in_the_middle(tmp_path):
    ledger = Ledger()
    path = write(tmp_path / "x.net.xml", HEAD + LOCAL + BODY)
    assert is_sumo(path)
    layer = read_sumo(path, ledger)
    found = streets(layer)
    assert set(found) == {"e", "one", "up", "down"}
    # Lanes at -3.2 in the mean one way, 3.2 the other.
    assert list(found["e"].lines[0].coords) == [(0.0, 0.0), (2.0, 0.0), (98.0, 0.0), (100.0, 0.0)]
    assert found["e"].tags == {"highway": "residential", "name": "Elm Street", "lanes": "3", "width": "12.8"}
    assert found["one"].tags == {"highway": "footway"}
    assert ledger.count("left out", "street: railway") == 1
    assert ledger.count("noted", "opposite directions joined to one street") == 1
    assert (layer.crs, layer.crs_certain) == (None, False)


def test_carriageways_far_apart_stay_two_and_meet_at_their_junctions(tmp_path):
    found = streets(read_sumo(write(tmp_path / "x.net.xml", HEAD + LOCAL + BODY), Ledger()))
    assert found["up"].lines[0].coords[0] == found["down"].lines[0].coords[-1] == (100.0, 100.0)


def test_the_offset_is_taken_back_where_the_network_is_projected(tmp_path):
    path = write(tmp_path / "x.net.xml", HEAD + UTM + BODY)
    layer = read_sumo(path, Ledger())
    assert layer.crs is not None
    assert layer.crs.is_projected
    assert layer.crs_certain
    assert streets(layer)["e"].lines[0].coords[0] == (600000.0, 5790000.0)
    here = read_sumo(path, Ledger(), local=True)
    assert here.crs is None
    assert streets(here)["e"].lines[0].coords[0] == (0.0, 0.0)


def test_directions_of_different_shape_have_a_mean(tmp_path):
    body = """<edge id="1" from="a" to="b"><lane id="1_0" index="0" shape="0,-2 50,-2 100,-2"/></edge>
    <edge id="2" from="b" to="a"><lane id="2_0" index="0" shape="100,2 0,2"/></edge></net>"""
    (street,) = read_sumo(write(tmp_path / "x.net.xml", HEAD + body), Ledger()).items
    assert np.abs(shapely.get_coordinates(street.lines[0])[:, 1]).max() < 1e-9
    assert street.lines[0].length == pytest.approx(100.0)
    assert street.tags["highway"] == "road"


def test_gzip_is_read(tmp_path):
    path = tmp_path / "x.net.xml.gz"
    path.write_bytes(gzip.compress((HEAD + LOCAL + BODY).encode()))
    assert is_sumo(path)
    assert len(read_sumo(path, Ledger()).items) == 4
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(CityError, match=r"x\.net\.xml\.gz: expected gzip"):
        read_sumo(path, Ledger())


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ((HEAD + LOCAL + BODY)[:700], "complete to its end"),
        (HEAD + "</net>", "found none"),
        ("", "no element found|empty file"),
        ("<osm/>", "found <osm>"),
        (HEAD + '<edge id="1"><lane id="1_0" shape="0,0 x,1"/></edge></net>', "found: "),
        (HEAD + '<edge id="1"><lane id="1_0" shape="0,0 nan,1"/></edge></net>', "x,y expected"),
        ('<?xml version="1.0"?><!DOCTYPE net [<!ENTITY a "b">]><net><edge id="&a;"/></net>', "without a DTD"),
        (HEAD + '<location netOffset="0,0" projParameter="+proj=nonsense"/></net>', "PROJ string"),
    ],
)
def test_what_is_no_network_is_refused_in_one_line(tmp_path, text, what):
    path = write(tmp_path / "bad.net.xml", text)
    with pytest.raises(CityError, match=what) as caught:
        read_sumo(path, Ledger())
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_other_xml_is_no_network(tmp_path):
    assert not is_sumo(write(tmp_path / "x.xml", "<osm/>"))
    assert not is_sumo(write(tmp_path / "x.txt", HEAD))
    assert not is_sumo(tmp_path / "none.net.xml")


def test_braunschweig_is_all_there():
    folder = real("braunschweig_mesh_net")
    layer = read_sumo(folder / "bs.net.xml", Ledger(), local=True)
    features = json.loads((folder / "derived_streets_localmetres.geojson").read_text())["features"]
    lines = [shapely.geometry.shape(one["geometry"]) for one in features if "railway" not in one["properties"]["type"]]
    theirs, mine = shapely.union_all(lines), shapely.union_all([one.lines[0] for one in layer.items])
    assert shapely.intersection(theirs, shapely.buffer(mine, 8.0)).length > 0.995 * theirs.length
    assert shapely.intersection(mine, shapely.buffer(theirs, 8.0)).length > 0.98 * mine.length
    # One line where there were two.
    assert 0.45 < mine.length / sum(line.length for line in lines) < 0.75


@pytest.mark.parametrize(
    "bad", ['shape="0,0 x,1"', 'shape="0,0 nan,1"', 'shape="0,0 5"', 'shape="0,0 9,9" width="wide"']
)
def test_a_damaged_edge_is_left_out_and_named(tmp_path, bad):
    edge = f'<edge id="bad" from="a" to="b" type="highway.residential"><lane id="x_0" {bad}/></edge>'
    junction = '<junction id="j" type="priority" x="here" y="5"/>'
    ledger = Ledger()
    layer = read_sumo(write(tmp_path / "x.net.xml", HEAD + LOCAL + edge + junction + BODY), ledger)
    plain = read_sumo(write(tmp_path / "y.net.xml", HEAD + LOCAL + BODY), Ledger())
    assert [one.id for one in layer.items] == [one.id for one in plain.items]
    found = [one for one in ledger.report(source="", crs="", origin=(0, 0, 0)).left_out if "no numbers" in one.what]
    assert [(one.count, one.examples) for one in found] == [(1, ("bad",))]


@pytest.mark.parametrize(
    ("kind", "permissions", "highway"),
    [
        ("highway.residential|railway.tram", "", "residential"),
        ("railway.tram|highway.residential", "", "residential"),
        ("railway.rail", "", None),
        ("railway.rail|waterway.canal", "", None),
        ("waterway.ferry", 'allow="ship"', None),
        ("highway.steps", 'allow="pedestrian"', "steps"),
        ("", "", "road"),
        ("", 'allow="tram bus passenger"', "road"),
        ("", 'allow="all"', "road"),
        ("", 'disallow="rail tram pedestrian"', "road"),
        ("", 'allow="pedestrian"', "footway"),
        ("", 'allow="bicycle pedestrian"', "footway"),
        ("", 'allow="bicycle"', "cycleway"),
        ("", 'allow="rail_urban rail"', None),
        ("", 'disallow="all"', None),
        ("my.own", "", "my.own"),
        ("my.own", 'allow="tram"', None),
    ],
)
def test_kinds_of_streets_and_who_may_use_them(tmp_path, kind, permissions, highway):
    edge = f'<edge id="x" from="a" to="b" type="{kind}"><lane id="x_0" {permissions} shape="0,0 50,0"/></edge>'
    ledger = Ledger()
    layer = read_sumo(write(tmp_path / "x.net.xml", HEAD + LOCAL + edge + BODY), ledger)
    assert streets(layer).get("x", None) is None if highway is None else streets(layer)["x"].tags["highway"] == highway
    assert ledger.count("left out") == 1 + (highway is None)  # the tram of BODY, too


@pytest.mark.parametrize(
    ("far", "why"),
    [
        ("1e308", "street: a shape or width that is no numbers"),
        ("-1e155", "street: a shape or width that is no numbers"),
        ("3e7", "street: it reaches further than 1,000 km"),
    ],
)
def test_a_lane_of_another_world_is_left_out_and_the_others_stay(tmp_path, far, why):
    """Coordinates that are numbers, but with which no geometry can be computed."""
    houses = "".join(f"v {x} {y} {z}\n" for z in (0, 6) for x, y in ((20, 20), (40, 20), (40, 40), (20, 40)))
    faces = "f 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n"
    model = write(tmp_path / "house.obj", f"o house\n{houses}{faces}")
    streets_file = write(tmp_path / "x.net.xml", HEAD + LOCAL + BODY.replace('shape="100,2 100', f'shape="{far},2 100'))
    city, report = read_city(model, ReadOptions(streets=streets_file, up="z", network="all"))
    assert 1 == sum(one.count for one in report.left_out if one.what == why)
    assert city.streets.number_of_edges() >= 1
