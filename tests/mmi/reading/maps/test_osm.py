"""OpenStreetMap: small files whose city is known by hand."""

from __future__ import annotations

import gzip
import re

import pytest
from city_files import OsmFile
from hypothesis import given
from hypothesis import strategies as st

from mmi.foundation.errors import CityError
from mmi.reading.maps.osm_shapes import join_rings
from mmi.reading.maps.streets import refusal
from mmi.reading.read_city import read_city
from mmi.reading.read_options import ReadOptions

STREET = [(-50.0, -10.0), (0.0, -10.0), (50.0, -10.0)]


def tally(report, section, what):
    return sum(one.count for one in report.sections()[section] if one.what == what)


def with_street() -> OsmFile:
    osm = OsmFile()
    osm.way(900, STREET, highway="residential", name="High Street")
    return osm


def area(city_object):
    return city_object.footprint.area


@pytest.mark.parametrize("ways_first", [False, True])
def test_a_house_and_a_street(tmp_path, ways_first):
    osm = with_street()
    osm.box(1, 0, 0, 20, 10, building="yes", height="12,5")
    city, report = read_city(osm.write(tmp_path / "tiny.osm", ways_first=ways_first))
    assert city.crs == "EPSG:32632"
    assert city.source == "tiny.osm"
    assert all(part % 10 == 0 for part in city.origin)
    (house,) = city.objects
    assert house.id == "way/1"
    assert (house.base, house.top) == (0.0, 12.5)
    assert area(house) == pytest.approx(200, rel=0.01)
    ((_, _, edge),) = city.streets.edges(data=True)
    assert edge["geometry"].length == pytest.approx(100, rel=0.01)
    assert (edge["kind"], edge["name"], edge["half_width"], edge["index"]) == ("residential", "High Street", 3.0, 0)
    assert tally(report, "read", "buildings") == 1
    # x and y are near the origin: within the frame, not swapped, not kilometres off.
    assert max(abs(one) for one in city.bounds) < 100


def courtyard(osm):
    osm.way(11, [(0.0, 0.0), (40.0, 0.0), (40.0, 40.0)])
    osm.way(12, [(0.0, 0.0), (0.0, 40.0), (40.0, 40.0)])
    osm.box(13, 10, 10, 30, 30)


def test_a_courtyard_of_a_multipolygon_is_open(tmp_path):
    osm = with_street()
    courtyard(osm)
    osm.relation(
        5, [(11, "outer"), (12, "outer"), (13, "inner")], type="multipolygon", building="yes", building__levels="5"
    )
    city, report = read_city(osm.write(tmp_path / "a.osm"))
    (block,) = city.objects
    assert block.id == "relation/5"
    assert area(block) == pytest.approx(1600 - 400, rel=0.01)
    assert len(block.prisms[0].footprint.interiors) == 1
    assert block.top == pytest.approx(16.0)
    assert tally(report, "inferred", "height from building:levels x 3.2 m") == 1


def test_broken_relations_are_survived_and_counted(tmp_path):
    osm = with_street()
    courtyard(osm)
    osm.relation(5, [(11, "outer"), (77, "outer"), (13, "inner")], type="multipolygon", building="yes")
    osm.relation(6, [(11, "outer"), (12, "outer"), (78, "inner")], type="multipolygon", building="yes", height="9")
    osm.relation(7, [(11, "outer")], type="building", building="yes")
    city, report = read_city(osm.write(tmp_path / "a.osm"))
    assert [one.id for one in city.objects] == ["relation/6"]
    assert area(city.objects[0]) == pytest.approx(1600, rel=0.01)
    assert tally(report, "left out", "building: relation whose outer ring is incomplete") == 1
    assert tally(report, "left out", "building: relation of type building, only groups others") == 1
    assert tally(report, "repaired", "relation with an incomplete courtyard: courtyard filled") == 1


@pytest.mark.parametrize("ways_first", [False, True])
def test_a_building_that_only_its_relation_tells(tmp_path, ways_first):
    """Outlines without tags: a way, two halves of one, and a multipolygon with a courtyard. Parts stand in them."""
    osm = with_street()
    osm.box(1, 100, 0, 120, 20)
    osm.box(2, 100, 0, 110, 20, building__part="yes", height="30")
    osm.relation(8, [(1, "outline"), (2, "part")], type="building", building="church", height="9")
    osm.way(3, [(200, 0), (220, 0), (220, 20)])
    osm.way(4, [(220, 20), (200, 20), (200, 0)])
    osm.relation(9, [(3, "outline"), (4, "outline")], type="building", name="of no height")
    courtyard(osm)
    osm.relation(5, [(11, "outer"), (12, "outer"), (13, "inner")], type="multipolygon")
    osm.relation(10, [], [(5, "outline")], type="building", building="yes", height="12")
    city, report = read_city(osm.write(tmp_path / "a.osm", ways_first=ways_first))
    found = {one.id: (area(one), [prism.top for prism in one.prisms]) for one in city.objects}
    assert found == {
        "relation/8": (pytest.approx(400, rel=0.01), [9.0, 30.0]),
        "relation/9": (pytest.approx(400, rel=0.01), [pytest.approx(12.0)]),
        "relation/10": (pytest.approx(1200, rel=0.01), [12.0]),
    }
    assert report.left_out == ()
    assert tally(report, "read", "buildings") == 3


def test_tags_that_only_the_relation_of_a_building_has(tmp_path):
    """Its outline is a building by itself: it keeps its own tags, and takes from the relation those that it lacks."""
    osm = with_street()
    osm.box(1, 0, 0, 20, 20, building="yes")
    osm.relation(7, [(1, "outline")], type="building", building="church", height="30")
    osm.box(2, 40, 0, 60, 20, building="yes", height="5")
    osm.relation(8, [(2, "outline")], type="building", height="30")
    courtyard(osm)
    osm.relation(5, [(11, "outer"), (12, "outer"), (13, "inner")], type="multipolygon", building="yes")
    osm.relation(9, [(11, "outline")], type="building", height="12")
    osm.box(3, 70, 0, 90, 20, building__part="yes", height="8")
    osm.relation(10, [(3, "outline")], type="building", building="yes")
    osm.relation(11, [(2, "part")], type="building", building="yes", height="99")
    city, report = read_city(osm.write(tmp_path / "a.osm"))
    tops = {"relation/5": 12.0, "way/1": 30.0, "way/2": 5.0, "way/3": 8.0}
    assert {one.id: one.top for one in city.objects} == tops
    assert tally(report, "left out", "building: relation of type building, only groups others") == 3
    (line,) = [one for one in report.noted if one.what == "building with the tags of its relation"]
    assert line.examples == ("way/1", "way/2", "relation/5")


def test_the_outer_way_of_a_building_is_not_a_second_building(tmp_path):
    osm = with_street()
    osm.box(1, 0, 0, 20, 20, building="yes", height="5")
    osm.box(2, 5, 5, 9, 9)
    osm.relation(5, [(1, "outer"), (2, "inner")], type="multipolygon", building="yes", height="8")
    city, report = read_city(osm.write(tmp_path / "a.osm"))
    assert [one.id for one in city.objects] == ["relation/5"]
    assert tally(report, "left out", "building: outline of a relation that was read") == 1


def test_parts_replace_the_outline_where_they_cover_it(tmp_path):
    osm = with_street()
    osm.box(1, 0, 0, 30, 10, building="yes", height="8")
    osm.box(2, 0, 0, 10, 10, building__part="yes", height="40")
    osm.box(3, 10, 0, 20, 10, building__part="yes", height="12", min_height="4")
    city, report = read_city(osm.write(tmp_path / "a.osm"))
    (house,) = city.objects
    spans = sorted((p.bottom, p.top, round(p.footprint.area, -1)) for p in house.prisms)
    assert spans == [(0.0, 8.0, 100.0), (0.0, 40.0, 100.0), (4.0, 12.0, 100.0)]
    assert tally(report, "kept", "building parts as prisms of their building") == 2
    assert tally(report, "noted", "building outline kept where its parts leave a gap") == 1


def test_storeys_that_the_mapper_left_to_the_outline_go_on_below_floating_parts(tmp_path):
    osm = with_street()
    osm.box(1, 0, 0, 30, 10, building="yes", height="8")
    osm.box(2, 0, 0, 20, 10, building__part="yes", height="20", min_height="8")
    osm.box(3, 5, 0, 15, 10, building__part="yes", height="30", min_height="20")
    osm.box(4, 20, 0, 30, 10, building__part="yes", height="12")
    city, report = read_city(osm.write(tmp_path / "a.osm"))
    (house,) = city.objects
    spans = sorted((p.bottom, p.top, round(p.footprint.area, -1)) for p in house.prisms)
    assert spans == [(0.0, 8.0, 200.0), (0.0, 12.0, 100.0), (8.0, 20.0, 200.0), (20.0, 30.0, 100.0)]
    assert tally(report, "repaired", "storeys below parts that would float, from the building's outline") == 1


def test_a_part_without_height_takes_its_buildings(tmp_path):
    osm = with_street()
    osm.box(1, 0, 0, 20, 10, building="yes", height="21")
    osm.box(2, 0, 0, 10, 10, building__part="yes")
    osm.box(3, 40, 0, 50, 10, building="yes", height="3")
    city, report = read_city(osm.write(tmp_path / "a.osm"))
    assert {prism.top for prism in city.objects[0].prisms} == {21.0}
    assert tally(report, "inferred", "height of a part from its building") == 1


def test_what_is_not_above_the_ground_is_left_out_with_its_reason(tmp_path):
    osm = with_street()
    osm.box(1, 0, 0, 20, 10, building="yes", height="5")
    osm.box(2, 30, 0, 40, 10, building="no")
    osm.box(3, 50, 0, 60, 10, building="garage", location="underground")
    osm.box(4, 70, 0, 80, 10, building="garage", layer="-1")
    osm.way(5, [(0.0, 90.0), (9.0, 90.0), (9.0, 99.0), (0.0, 99.0)], building="yes")
    osm.lose_node(20.0, 120.0)
    osm.box(6, 0, 100, 20, 120, building="yes")
    city, report = read_city(osm.write(tmp_path / "a.osm"))
    assert [one.id for one in city.objects] == ["way/1"]
    assert tally(report, "read", "buildings") == 6
    assert sum(one.count for one in report.left_out) == 5
    assert tally(report, "left out", "building: outline not closed") == 1
    assert tally(report, "left out", "building: nodes missing from the file") == 1


def crossroads() -> OsmFile:
    osm = OsmFile()
    osm.box(1, 20, 20, 40, 40, building="yes", height="10")
    osm.way(101, [(-100.0, 0.0), (0.0, 0.0), (100.0, 0.0)], highway="residential")
    osm.way(102, [(0.0, -100.0), (0.0, 0.0), (0.0, 100.0)], highway="primary", lanes="4")
    osm.way(103, [(0.0, 0.0), (50.0, 50.0)], highway="footway", width="4 m")
    osm.way(104, [(-50.0, -50.0), (-50.0, 50.0)], highway="secondary", bridge="yes")  # crosses 101 without a node
    osm.way(105, [(-20.0, -50.0), (-20.0, 50.0)], highway="secondary", tunnel="yes")
    osm.way(106, [(-30.0, -50.0), (-30.0, 50.0)], highway="residential", access="private")
    osm.way(107, [(-40.0, -50.0), (-40.0, 50.0)], highway="motorway")
    osm.way(108, [(60.0, -50.0), (90.0, -50.0), (90.0, -80.0), (60.0, -50.0)], highway="pedestrian", area="yes")
    osm.way(109, [(60.0, 50.0), (90.0, 50.0)], highway="platform")
    osm.way(110, [(60.0, 60.0), (90.0, 60.0)], highway="footway", footway="sidewalk")
    return osm


def kinds(city):
    return sorted(edge["kind"] for _, _, edge in city.streets.edges(data=True))


def test_networks_and_junctions(tmp_path):
    path = crossroads().write(tmp_path / "a.osm")
    drive, report = read_city(path, ReadOptions(network="drive"))
    assert kinds(drive) == ["motorway", "primary", "primary", "residential", "residential", "secondary"]
    assert max(dict(drive.streets.degree()).values()) == 4
    assert tally(report, "left out", "street: tunnel") == 1
    assert tally(report, "left out", "street: access=private") == 1
    assert tally(report, "left out", "street: an area") == 1
    assert tally(report, "left out", "street: not a street (construction, platform, elevator, ...)") == 1
    assert tally(report, "left out", "street: not for --network drive") == 2
    assert tally(report, "noted", "bridge kept on the ground") == 1
    walk, report = read_city(path, ReadOptions(network="walk"))
    # The footway runs into the building and is cut there: from the crossing to its corner, and a bit behind.
    assert kinds(walk) == ["footway", "footway", "primary", "primary", "residential", "residential", "secondary"]
    (cut,) = [one for one in report.repaired if one.what == "street cut where it runs through buildings"]
    assert cut.metres == pytest.approx(20 * 2**0.5, rel=0.01)
    every, _ = read_city(path, ReadOptions(network="all"))
    assert kinds(every) == sorted([*kinds(walk), "motorway"])
    widths = {edge["kind"]: edge["half_width"] for _, _, edge in every.streets.edges(data=True)}
    assert (widths["primary"], widths["footway"], widths["residential"]) == (6.0, 2.0, 3.0)


def test_edges_run_from_the_lower_node_and_end_at_their_nodes(tmp_path):
    city, _ = read_city(crossroads().write(tmp_path / "a.osm"), ReadOptions(network="all"))
    for a, b, edge in city.streets.edges(data=True):
        low, high = sorted((a, b))
        line = edge["geometry"]
        for number, point in ((low, line.coords[0]), (high, line.coords[-1])):
            assert (city.streets.nodes[number]["x"], city.streets.nodes[number]["y"]) == point
    indices = [edge["index"] for _, _, edge in city.streets.edges(data=True)]
    assert sorted(indices) == list(range(len(indices)))


def test_a_street_with_missing_nodes_is_shortened(tmp_path):
    osm = crossroads()
    osm.way(120, [(0.0, 0.0), (0.0, -20.0), (1.0, -40.0), (0.0, -60.0), (0.0, -80.0)], highway="tertiary")
    osm.lose_node(1.0, -40.0)
    city, report = read_city(osm.write(tmp_path / "a.osm"))
    lengths = [edge["geometry"].length for _, _, edge in city.streets.edges(data=True) if edge["kind"] == "tertiary"]
    assert lengths == pytest.approx([20, 20], rel=0.01)
    assert tally(report, "repaired", "street shortened where nodes are missing") == 1


def test_coordinates_outside_the_world_are_told_from_missing_nodes(tmp_path):
    osm = crossroads()
    osm.way(120, [(0.0, 0.0), (0.0, -20.0), (1.0, -40.0), (0.0, -60.0), (0.0, -80.0)], highway="tertiary")
    osm.box(121, 200, 200, 210, 210, building="yes", height="10")
    text = osm.write(tmp_path / "a.osm").read_text()
    for number in (osm.node(1.0, -40.0), osm.node(200.0, 200.0)):
        text = re.sub(rf'(<node id="{number}" [^>]*lat=")[^"]*"', r'\g<1>95.0"', text)
    (tmp_path / "a.osm").write_text(text)
    _, report = read_city(tmp_path / "a.osm")
    assert tally(report, "repaired", "street shortened where it has coordinates outside the world") == 1
    assert tally(report, "left out", "building: coordinates outside the world") == 1
    assert not any("missing" in one.what for one in (*report.repaired, *report.left_out))


def test_streets_stop_200_m_outside_the_buildings(tmp_path):
    osm = OsmFile()
    osm.box(1, 0, 0, 100, 100, building="yes", height="10")
    osm.way(2, [(-500.0, -10.0), (500.0, -10.0)], highway="residential")
    osm.way(3, [(500.0, 0.0), (600.0, 0.0)], highway="residential")
    city, report = read_city(osm.write(tmp_path / "a.osm"))
    ((_, _, edge),) = city.streets.edges(data=True)
    assert edge["geometry"].length == pytest.approx(500, rel=0.01)
    assert tally(report, "left out", "street: outside the city's window") == 1
    assert tally(report, "repaired", "street cut at the city's window") == 1


def test_elevated_parts_leave_room_for_streets(tmp_path):
    osm = OsmFile()
    osm.way(2, [(-50.0, 5.0), (150.0, 5.0)], highway="residential")
    osm.box(1, 0, 0, 20, 10, building="yes", height="10", min_height="4")
    osm.box(3, 60, 0, 80, 10, building="yes", height="10", min_height="2")
    city, report = read_city(osm.write(tmp_path / "a.osm"))
    lengths = sorted(edge["geometry"].length for _, _, edge in city.streets.edges(data=True))
    assert lengths == pytest.approx([70, 110], rel=0.01)
    (cut,) = [one for one in report.repaired if "through buildings" in one.what]
    assert cut.metres == pytest.approx(20, rel=0.01)


def test_clip_keeps_whole_buildings_and_cuts_streets(tmp_path):
    osm = with_street()
    osm.box(1, -5, 0, 20, 10, building="yes", height="5")
    osm.box(2, -40, 0, -20, 10, building="yes", height="5")
    path = osm.write(tmp_path / "a.osm")
    city, report = read_city(path, ReadOptions(clip=(9.0, 47.99, 9.1, 48.01)))  # x > 0
    assert [one.id for one in city.objects] == ["way/1"]
    assert area(city.objects[0]) == pytest.approx(250, rel=0.01)
    ((_, _, edge),) = city.streets.edges(data=True)
    assert edge["geometry"].length == pytest.approx(50, rel=0.02)
    assert tally(report, "left out", "building: outside --clip") == 1
    with pytest.raises(CityError, match="no buildings within --clip"):
        read_city(path, ReadOptions(clip=(10.0, 47.0, 11.0, 48.0)))


def test_nothing_to_build_is_refused_with_a_way_out(tmp_path):
    only_street = with_street().write(tmp_path / "s.osm")
    with pytest.raises(CityError, match="no buildings"):
        read_city(only_street)
    osm = OsmFile()
    osm.box(1, 0, 0, 20, 10, building="yes", height="5")
    path = osm.write(tmp_path / "b.osm")
    with pytest.raises(CityError, match=r"b\.osm: no streets: no line layer or highways in it; expected streets, as"):
        read_city(path, ReadOptions(streets=path))
    city, report = read_city(path)
    assert kinds(city) == ["pedestrian"]  # around the only house
    assert tally(report, "inferred", "paths through the open space, as there are no streets") == 1
    osm.way(2, [(0.0, -5.0), (50.0, -5.0)], highway="footway")
    with pytest.raises(CityError, match=r"no streets for --network drive; found only 1 footway"):
        read_city(osm.write(tmp_path / "c.osm"))
    assert kinds(read_city(tmp_path / "c.osm", ReadOptions(network="walk"))[0]) == ["footway"]
    assert kinds(read_city(tmp_path / "b.osm", ReadOptions(streets=only_street))[0]) == ["residential"]
    osm = with_street()
    osm.box(1, 0, 0, 20, 10, building="yes")
    osm.box(2, 30, 0, 40, 10, building="roof")
    with pytest.raises(CityError, match="none of 2 buildings has a height"):
        read_city(osm.write(tmp_path / "d.osm"))


@given(st.lists(st.integers(3, 8), min_size=1, max_size=3), st.randoms(use_true_random=False))
def test_rings_are_joined_from_any_pieces(sizes, random):
    ways, first = [], 0
    for size in sizes:
        ring = [*range(first, first + size), first]
        first += size
        cuts = sorted(random.sample(range(1, size), random.randint(0, min(3, size - 1))))
        for start, stop in zip([0, *cuts], [*cuts, size], strict=True):
            piece = ring[start : stop + 1]
            ways.append(tuple(piece if random.random() < 0.5 else piece[::-1]))
    random.shuffle(ways)
    rings, left_over = join_rings(ways)
    assert left_over == 0
    assert sorted(len(ring) - 1 for ring in rings) == sorted(sizes)
    assert all(ring[0] == ring[-1] and len(set(ring)) == len(ring) - 1 for ring in rings)


def plainly_joined(ways):
    """The same by looking through all the chains at each step, whose time grows with the square of their number."""
    rings = [way for way in ways if len(way) > 3 and way[0] == way[-1]]
    chains = [list(way) for way in ways if len(way) > 1 and way[0] != way[-1]]
    left_over = 0
    while chains:
        chain, used = chains.pop(0), 1
        while chain[0] != chain[-1]:
            match = next((i for i, other in enumerate(chains) if chain[-1] in (other[0], other[-1])), None)
            if match is None:
                break
            other = chains.pop(match)
            chain += other[1:] if other[0] == chain[-1] else other[-2::-1]
            used += 1
        if chain[0] == chain[-1] and len(chain) > 3:
            rings.append(tuple(chain))
        else:
            left_over += used
    return rings, left_over


@given(st.lists(st.lists(st.integers(1, 7), max_size=5).map(tuple), max_size=14))
def test_chains_that_meet_anyhow_are_joined_in_their_order(ways):
    assert join_rings(ways) == plainly_joined(ways)


def josm(path, text):
    """A file as JOSM saves it: new objects have negative ids, the apostrophe is its quotation mark."""
    text = f"<?xml version='1.0' encoding='UTF-8'?>\n<osm version='0.6' generator='JOSM'>{text}</osm>"
    if path.suffix == ".gz":
        path.write_bytes(gzip.compress(text.encode()))
    else:
        path.write_text(text)
    return path


def node(number, x, y):
    return f"<node id='{number}' action='modify' visible='true' lat='{48.0 + y * 1e-4}' lon='{9.0 + x * 1e-4}'/>"


def way(number, nodes, tags, action=""):
    refs = "".join(f"<nd ref='{one}'/>" for one in nodes)
    own = "".join(f"<tag k='{key}' v='{value}'/>" for key, value in tags.items())
    return f"<way id='{number}' user='a>b'{action} visible='true'>{refs}{own}</way>"


HOUSE = {"building": "yes", "height": "9"}
GONE = " action='delete'"


def edited():
    corners = [(1, 1), (2, 1), (2, 2), (1, 2)]
    return "".join(
        [
            *(node(k + 1, x, y) for k, (x, y) in enumerate(corners)),
            *(node(-k - 1, x + 3, y) for k, (x, y) in enumerate(corners)),
            node(-11, 0, 0),
            node(12, 9, 0),
            way(1, [1, 2, 3, 4, 1], HOUSE),
            way(-1, [-1, -2, -3, -4, -1], HOUSE),
            way(2, [1, 2, 3, 1], HOUSE, GONE),
            way(3, [-11, 12], {"highway": "residential"}),
            way(-3, [-11, 1], {"highway": "residential"}, GONE),
            f"<relation id='-7'{GONE}><member type='way' ref='1' role='outer'/><tag k='type' v='multipolygon'/>"
            "<tag k='building' v='yes'/></relation>",
        ]
    )


@pytest.mark.parametrize("name", ["edited.osm", "edited.osm.gz"])
def test_what_an_editor_saved(tmp_path, name):
    city, report = read_city(josm(tmp_path / name, edited()))
    assert [one.id for one in city.objects] == ["way/1", "way/-1"]
    assert city.objects[0].footprint.area == pytest.approx(city.objects[1].footprint.area, rel=0.01)
    assert kinds(city) == ["residential"]
    assert {one.what: (one.count, one.examples) for one in report.left_out} == {
        "building: deleted in an editor": (2, ("relation/-7", "way/2")),
        "street: deleted in an editor": (1, ("way/-3",)),
    }
    assert tally(report, "read", "buildings") == 4


def test_a_compressed_file_that_is_cut_off_is_refused(tmp_path):
    path = josm(tmp_path / "edited.osm.gz", edited())
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(CityError):
        read_city(path)


@pytest.mark.parametrize(
    ("tags", "drive", "walk"),
    [
        ({"highway": "residential"}, True, True),
        ({"highway": "residential", "access": "no"}, False, False),
        ({"highway": "residential", "access": "private", "foot": "yes"}, False, True),
        ({"highway": "residential", "access": "no", "foot": "designated"}, False, True),
        ({"highway": "residential", "access": "no", "foot": "no"}, False, False),
        ({"highway": "residential", "access": "no", "motor_vehicle": "yes"}, True, False),
        ({"highway": "residential", "vehicle": "no"}, False, True),
        ({"highway": "residential", "vehicle": "no", "motor_vehicle": "yes"}, True, True),
        ({"highway": "residential", "access": "no", "vehicle": "permissive"}, True, False),
        ({"highway": "residential", "access": "no", "motor_vehicle": "private", "foot": "permissive"}, False, True),
        ({"highway": "motorway", "access": "no", "foot": "yes"}, False, False),
        ({"highway": "cycleway", "access": "no", "foot": "yes"}, False, True),
        ({"highway": "footway", "access": "customers"}, False, True),
    ],
)
def test_the_tag_of_one_kind_of_traffic_goes_before_access(tags, drive, walk):
    found = {network: refusal(tags, network, osm=True) for network in ("drive", "walk", "all")}
    assert {network: reason is None for network, reason in found.items()} == {
        "drive": drive,
        "walk": walk,
        "all": drive or walk,
    }
    if tags.get("access") in {"no", "private"}:
        assert set(found.values()) <= {None, f"access={tags['access']}"}
