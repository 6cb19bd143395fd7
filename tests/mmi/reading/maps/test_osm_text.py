"""What osmium does not read by itself: places in ways and relation members, as Overpass writes them for ``out geom``."""

from __future__ import annotations

import gzip

import numpy as np
import pytest
import shapely

from mmi.foundation.errors import CityError
from mmi.reading.maps.osm import read_osm
from mmi.reading.maps.osm_text import DAMAGED, look_through
from mmi.reading.report import Ledger

SQUARE = [(9.0, 48.0), (9.001, 48.0), (9.001, 48.001), (9.0, 48.001), (9.0, 48.0)]
REFS = [1, 2, 3, 4, 1]


def corners(places, refs=None):
    refs = [""] * len(places) if refs is None else [f"ref='{ref}' " for ref in refs]
    return "".join(
        f"<nd {ref}/>" if place is None else f"<nd {ref}lat='{place[1]:.7f}' lon='{place[0]:.7f}'/>"
        for ref, place in zip(refs, places, strict=True)
    )


def way(number, inside, **tags):
    return f"<way id='{number}'>{inside}{tagged(tags)}</way>"


def tagged(tags):
    return "".join(f"<tag k='{key}' v='{value}'/>" for key, value in tags.items())


def relation(number, *members, **tags):
    inside = "".join(f"<member type='way' ref='{ref}' role='{role}'>{nds}</member>" for ref, role, nds in members)
    return f"<relation id='{number}'>{inside}{tagged({'type': 'multipolygon'} | tags)}</relation>"


def read(path, *elements, buildings=True):
    text = ("<osm version='0.6' generator='Overpass API'>" + "".join(elements) + "</osm>").encode()
    path.write_bytes(gzip.compress(text) if path.suffix == ".gz" else text)
    ledger = Ledger()
    found, lines = read_osm(path, ledger, buildings=buildings, streets=not buildings)
    return (found if buildings else lines).items, ledger


@pytest.mark.parametrize("refs", [REFS, None])
@pytest.mark.parametrize("name", ["a.osm", "a.osm.gz"])
def test_ways_that_bring_their_places(tmp_path, refs, name):
    (house,), ledger = read(tmp_path / name, way(5, corners(SQUARE, refs), building="yes"))
    assert shapely.get_coordinates(house.geometry) == pytest.approx(np.array(SQUARE))
    assert ledger.count("left out") == 0


def test_nodes_go_before_places_in_ways(tmp_path):
    """Only what a file has no node for comes from its ways."""
    node = "<node id='1' version='1' lat='47.9' lon='9.0'/>"
    (house,), _ = read(tmp_path / "a.osm", node, way(5, corners(SQUARE, REFS), building="yes"))
    moved = [(9.0, 47.9), *SQUARE[1:4], (9.0, 47.9)]
    assert shapely.get_coordinates(house.geometry) == pytest.approx(np.array(moved))


@pytest.mark.parametrize("refs", [([1, 2], [2, 3]), (None, None)])
def test_streets_meet_where_their_places_are_equal(tmp_path, refs):
    a, b = (way(n, corners(SQUARE[n : n + 2], refs[n]), highway="service") for n in (0, 1))
    streets, _ = read(tmp_path / "a.osm", a, b, buildings=False)
    assert len(streets) == 2
    assert streets[0].nodes[0][1] == streets[1].nodes[0][0]


@pytest.mark.parametrize("refs", [None, REFS])
def test_members_that_bring_their_places(tmp_path, refs):
    """Two halves of an outline and a courtyard that stand in no way; the way that stands there too counts once."""
    yard = [(9 + 0.3 * (x - 9) + 0.0002, 48 + 0.3 * (y - 48) + 0.0002) for x, y in SQUARE]
    members = [
        (11, "outer", corners(SQUARE[:3])),
        (12, "outer", corners(SQUARE[2:])),
        (13, "inner", corners(yard)),
        (5, "outer", corners(SQUARE)),
    ]
    other = [(x + 0.01, y) for x, y in SQUARE]
    there = way(5, corners(other, refs), building="shed")
    items, ledger = read(tmp_path / "a.osm", there, relation(9, *members, building="yes"))
    (whole,) = [one for one in items if one.id == "relation/9"]
    square = 1e-6
    assert whole.geometry.area == pytest.approx(2 * square - 0.09 * square)
    assert ledger.count("repaired") == 0


def test_corners_outside_the_box_that_was_asked_for_are_missing(tmp_path):
    places = [SQUARE[0], None, None, SQUARE[3], SQUARE[0]]
    members = relation(9, (11, "outer", corners(places)), building="yes")
    items, ledger = read(tmp_path / "a.osm", way(5, corners(SQUARE), building="yes"), members)
    assert [one.id for one in items] == ["way/5"]
    assert ledger.count("left out", "building: relation whose outer ring is incomplete") == 1


def test_a_street_of_one_point_is_no_street_whose_nodes_are_missing(tmp_path):
    _, ledger = read(tmp_path / "a.osm", way(5, corners(SQUARE[:1], [1]), highway="service"), buildings=False)
    assert ledger.count("left out", "street: fewer than two points") == 1


def test_other_files_are_left_to_osmium(tmp_path):
    path = tmp_path / "a.osm"
    path.write_text("<osm version='0.6'><way id='1'><nd ref='1'/></way></osm>")
    assert look_through(path).source == str(path)


@pytest.mark.parametrize("damage", ["</osm>", "<!DOCTYPE osm>"])
def test_damage_is_told(tmp_path, damage):
    path = tmp_path / "a.osm"
    body = relation(9, (11, "outer", corners(SQUARE)), building="yes")
    path.write_text(f"<!DOCTYPE osm><osm version='0.6'>{body}</osm>" if "!" in damage else f"<osm>{body}</way>")
    with pytest.raises(CityError, match=r"a\.osm"):
        read_osm(path, Ledger(), buildings=True, streets=False)


HOUSES = [
    "".join(f"<node id='{n}{k}' lat='{y}' lon='{x + 0.01 * n}'/>" for k, (x, y) in enumerate(SQUARE[:4]))
    + way(n, "".join(f"<nd ref='{n}{k}'/>" for k in (0, 1, 2, 3, 0)), building="yes")
    for n in (1, 2)
]


@pytest.mark.parametrize(
    "bad",
    [
        "<node id='50' lat='NaN' lon='9'/>",
        "<node id='50' lat='' lon='9'/>",
        "<node id='50' lat='48,5' lon='9'/>",
        "<node id='x' lat='48' lon='9'/>",
        "<way id='x'><nd ref='10'/></way>",
        "<way id='50'><nd ref='a'/></way>",
        "<relation id='x'/>",
        "<relation id='50'><member type='way' ref='?' role='outer'/></relation>",
    ],
)
@pytest.mark.parametrize("name", ["a.osm", "a.osm.gz"])
def test_an_element_that_is_no_number_costs_itself(tmp_path, bad, name):
    houses, ledger = read(tmp_path / name, HOUSES[0], bad, HOUSES[1])
    assert [one.id for one in houses] == ["way/1", "way/2"]
    assert all(one.geometry.area == pytest.approx(1e-6) for one in houses)
    assert ledger.count("left out", DAMAGED) == ledger.count("left out") == 1
    assert ledger.count("read", "buildings") == 2


def test_a_corner_that_is_no_number_costs_its_house(tmp_path):
    houses, ledger = read(tmp_path / "a.osm", HOUSES[0].replace("lat='48.0'", "lat='nan'", 1), HOUSES[1])
    assert [one.id for one in houses] == ["way/2"]
    assert ledger.count("left out", "building: nodes missing from the file") == 1
    (line,) = [one for one in ledger.report(source="", crs="", origin=(0, 0, 0)).left_out if one.what == DAMAGED]
    assert line.examples == ("node/10",)


@pytest.mark.parametrize(("old", "new"), [("lat='48.0'", "lat='95'"), ("lon='9.01'", "lon='1300.0'")])
def test_a_corner_outside_the_world_costs_its_house(tmp_path, old, new):
    assert old in HOUSES[0]
    houses, ledger = read(tmp_path / "a.osm", HOUSES[0].replace(old, new, 1), HOUSES[1])
    assert [one.id for one in houses] == ["way/2"]
    assert ledger.count("left out", "building: coordinates outside the world") == 1


def test_deletions_in_a_damaged_file_are_told_too(tmp_path):
    gone = HOUSES[1].replace("<way ", "<way action='delete' ")
    houses, ledger = read(tmp_path / "a.osm", HOUSES[0], "<node id='x' lat='48' lon='9'/>", gone)
    assert [one.id for one in houses] == ["way/1"]
    assert ledger.count("left out", "building: deleted in an editor") == 1
