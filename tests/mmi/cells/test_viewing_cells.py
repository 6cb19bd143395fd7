"""Viewing cells: hand-made streets, random ones, and real cities."""

from __future__ import annotations

import json
import math
from collections import Counter

import networkx as nx
import numpy as np
import pytest
import shapely
from cities import real
from hills import waves
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import LineString, Polygon, box, shape

from mmi.building.halving import halves
from mmi.cells import viewing_cells as cells
from mmi.cells.choice import spread
from mmi.cells.viewing_cells import CellReport, ViewingCell, viewing_cells
from mmi.city.model import City, CityObject, Prism
from mmi.city.terrain import Terrain
from mmi.foundation.errors import CityError, ParameterError


def city_of(lines, boxes=(), *, half_width=3.0, ground=0.0, bottom=0.0, top=10.0):
    """A city of ``lines`` (shared end points are junctions) and buildings with footprints ``boxes``."""
    streets = nx.MultiGraph()
    for i, line in enumerate(lines):
        ends = [tuple(map(float, line[k])) for k in (0, -1)]
        for x, y in ends:
            streets.add_node((x, y), x=x, y=y)
        streets.add_edge(*ends, geometry=LineString(line), kind="street", half_width=half_width, name=f"S{i}", index=i)
    objects = tuple(CityObject(f"b{i}", (Prism(one, bottom, top),)) for i, one in enumerate(boxes))
    return City(objects, streets, "EPSG:32631", (0.0, 0.0, 0.0), "test", ground)


def cells_of(graph):
    return [cell for _, cell in graph.nodes(data="cell")]


def regions(graph):
    return shapely.polygons([cell.corners for cell in cells_of(graph)])


def clearance(graph, city):
    """Metres between cells and buildings, the least of them (the plain way: all pairs)."""
    footprints = np.array([prism.footprint for one in city.objects for prism in one.prisms])
    return shapely.distance(regions(graph)[:, None], footprints[None, :]).min()


def as_values(graph):
    return cells_of(graph), sorted(map(sorted, graph.edges))


def test_straight_street_is_split_evenly_with_its_width_and_eyes():
    graph = viewing_cells(city_of([[(0, 0), (100, 0)]], ground=7.0))
    assert list(graph) == ["0000-00", "0000-01", "0000-02"]
    assert np.allclose(
        [(*cell.p, *cell.q) for cell in cells_of(graph)], [(k * 100 / 3, 0, (k + 1) * 100 / 3, 0) for k in range(3)]
    )
    assert {(cell.half_width, cell.eye, cell.street) for cell in cells_of(graph)} == {(3.0, (8.5, 8.9), "S0")}
    assert sorted(graph.edges) == [("0000-00", "0000-01"), ("0000-01", "0000-02")]
    report = graph.graph["report"]
    assert report == CellReport(1, 100.0, 3, pytest.approx(100.0), 0, 0.0, 0, 0)


def test_bend_is_a_split_point():
    graph = viewing_cells(city_of([[(0, 0), (30, 0), (30, 30)]]))
    assert [(cell.p, cell.q) for cell in cells_of(graph)] == [((0, 0), (30, 0)), ((30, 0), (30, 30))]
    assert graph.number_of_edges() == 1


def test_cells_at_a_junction_are_neighbours_of_each_other():
    graph = viewing_cells(city_of([[(0, 0), (x, y)] for x, y in [(30, 0), (-30, 0), (0, 30), (0, -30)]]))
    assert graph.number_of_nodes() == 4 and graph.number_of_edges() == 6


def test_streets_that_only_cross_are_not_neighbours():
    graph = viewing_cells(city_of([[(-15, 0), (15, 0)], [(0, -15), (0, 15)]]))
    assert graph.number_of_edges() == 0


def test_street_drawn_from_its_second_node_meets_the_right_neighbours():
    city = city_of([[(0, 0), (90, 0)], [(90, 0), (120, 0)]])
    a, b = (0.0, 0.0), (90.0, 0.0)
    city.streets.edges[a, b, 0]["geometry"] = LineString([b, a])
    graph = viewing_cells(city)
    assert set(graph["0001-00"]) == {"0000-00"} and cells_of(graph)[0].p == b


def test_arc_becomes_few_chords_within_tolerance():
    turn = np.linspace(0, math.pi, 400)
    arc = np.column_stack([50 * np.cos(turn), 50 * np.sin(turn)])
    graph = viewing_cells(city_of([arc]))
    axes = shapely.union_all([LineString([cell.p, cell.q]) for cell in cells_of(graph)])
    # A chord of sagitta s spans 2 sqrt(2 R s) = 14 m of this arc; halving may leave it half of that.
    assert 157 / 14.2 <= len(graph) <= 2 * 157 / 14.1 + 1
    assert shapely.distance(axes, shapely.points(arc)).max() <= cells.CHORD_TOLERANCE


def test_short_pieces_merge_where_the_chord_stays_close_and_only_there():
    def axes(line):
        return [(cell.p, cell.q) for cell in cells_of(viewing_cells(city_of([line])))]

    # A 2 m dog-leg of 0.8 m: more than the tolerance of chords, less than that of merging.
    assert axes([(0, 0), (30, 0), (32, 0.8), (34.5, 0.8)]) == [((0, 0), (34.5, 0.8))]
    # The same with 3 m is a corner that stays.
    assert axes([(0, 0), (30, 0), (30, 3), (60, 3)]) == [((0, 0), (30, 0)), ((30, 0), (30, 3)), ((30, 3), (60, 3))]


def test_half_width_shrinks_to_what_is_beside_the_cell_but_not_to_what_is_beyond():
    city = city_of([[(0, 0), (30, 0)]], [box(10, 2, 20, 10)])
    (cell,) = cells_of(viewing_cells(city))
    assert cell.half_width == pytest.approx(2.0 - cells.CLEARANCE, abs=1e-5)
    beyond = city_of([[(0, 0), (30, 0)]], [box(30.5, -9, 40, 9)])
    assert [cell.half_width for cell in cells_of(viewing_cells(beyond))] == [3.0]
    assert cells_of(viewing_cells(city, max_half_width=1.0))[0].half_width == 1.0


@pytest.mark.parametrize(
    ("bottom", "top", "wide"), [(0.0, 1.0, False), (1.8, 9.0, False), (1.95, 9.0, True), (-4.0, 0.0, True)]
)
def test_what_is_over_the_eyes_or_under_the_ground_is_no_obstacle(bottom, top, wide):
    (cell,) = cells_of(viewing_cells(city_of([[(0, 0), (30, 0)]], [box(10, 2, 20, 10)], bottom=bottom, top=top)))
    assert (cell.half_width == 3.0) is wide


def test_chord_that_cuts_a_corner_gives_way_to_the_centre_line():
    line = [(0, 0), (10, 0.45), (20, 0)]
    assert len(viewing_cells(city_of([line]))) == 1
    city = city_of([line], [box(9, -5, 11, 0.05)])
    graph = viewing_cells(city)
    assert [(cell.p, cell.q) for cell in cells_of(graph)] == [((0, 0), (10, 0.45)), ((10, 0.45), (20, 0))]
    assert graph.graph["report"].cut_pieces == 0
    assert clearance(graph, city) >= cells.CLEARANCE


def test_street_through_a_building_is_cut_and_counted():
    city = city_of([[(0, 0), (60, 0)]], [box(20, -5, 40, 5)])
    graph = viewing_cells(city, max_length=100.0)
    first, second = cells_of(graph)
    assert first.q[0] == pytest.approx(19.75, abs=0.01) and second.p[0] == pytest.approx(40.25, abs=0.01)
    assert graph.number_of_edges() == 0
    assert graph.graph["report"].cut_pieces == 1
    assert graph.graph["report"].cut_length == pytest.approx(20.5, abs=0.02)
    assert clearance(graph, city) >= cells.CLEARANCE


def test_cells_around_a_thin_obstacle_and_at_a_touching_wall_stay_neighbours():
    pinched = viewing_cells(city_of([[(0, 0), (60, 0)]], [box(30, -5, 30.5, 0.1)]), max_length=100.0)
    assert pinched.number_of_nodes() == 2 and pinched.number_of_edges() == 1
    touching = viewing_cells(city_of([[(0, 0), (30, 0)], [(30, 0), (60, 0)]], [box(29.9, 0, 30.1, 5)]))
    assert touching.number_of_nodes() == 2 and touching.number_of_edges() == 1


def test_street_inside_a_building_leaves_no_cell():
    graph = viewing_cells(city_of([[(0, 0), (30, 0)]], [box(-5, -5, 35, 5)]))
    assert len(graph) == 0
    assert graph.graph["report"].cut_length == 30.0
    assert spread(graph, 3) == []


def test_loops_parallel_and_degenerate_streets():
    ring = [(20 * math.cos(a), 20 * math.sin(a)) for a in np.linspace(0, 2 * math.pi, 33)]
    ring[-1] = ring[0]
    dot = [(0.1 * math.cos(a), 0.1 * math.sin(a)) for a in np.linspace(0, 2 * math.pi, 5)]
    dot[-1] = dot[0]
    graph = viewing_cells(
        city_of([ring, [(0, 0), (9, 9), (30, 0)], [(0, 0), (9, -9), (30, 0)], [(99, 9), (99, 9)], dot])
    )
    by_street = Counter(name[:4] for name in graph)
    assert by_street["0000"] >= 8 and by_street["0001"] == by_street["0002"] == 2 and by_street["0004"] == 2
    assert graph.graph["report"].degenerate_streets == 1
    assert nx.number_of_selfloops(graph) == 0
    loop = graph.subgraph(name for name in graph if name.startswith("0000"))
    assert all(degree == 2 for _, degree in loop.degree) and nx.is_connected(loop)
    assert graph.has_edge("0001-00", "0002-00") and graph.has_edge("0001-01", "0002-01")


def test_ids_stay_when_other_streets_change():
    lines = [[(0, 0), (50, 0)], [(50, 0), (50, 130)], [(0, 0), (0, 70), (20, 70)]]
    before = viewing_cells(city_of(lines))
    after = viewing_cells(city_of([lines[0], [(50, 0), (50, 20)], lines[2]]))
    for name in before:
        if not name.startswith("0001"):
            assert after.nodes[name]["cell"] == before.nodes[name]["cell"]


@pytest.mark.parametrize(
    "options",
    [
        {"max_length": 0.0},
        {"max_length": math.nan},
        {"max_length": math.inf},
        {"eye": (2.0, 1.0)},
        {"eye": (-1.0, 1.0)},
        {"max_half_width": 0.0},
    ],
)
def test_options_without_meaning_are_refused(options):
    with pytest.raises(ParameterError, match="expected, found"):
        viewing_cells(city_of([[(0, 0), (30, 0)]]), **options)


def test_street_without_width_is_refused_by_name():
    with pytest.raises(CityError, match="test: street 0 needs a positive half_width"):
        viewing_cells(city_of([[(0, 0), (30, 0)]], half_width=math.nan))


grid = st.integers(-60, 60)
polylines = st.lists(st.tuples(grid, grid), min_size=2, max_size=7)
blocks = st.lists(
    st.builds(lambda x, y, w, h: box(x, y, x + w, y + h), grid, grid, st.integers(1, 30), st.integers(1, 30)),
    max_size=4,
)


@settings(max_examples=150, deadline=None)
@given(st.lists(polylines, min_size=1, max_size=5), st.floats(1.0, 60.0))
def test_cells_cover_the_streets_and_keep_to_them(lines, max_length):
    city = city_of(lines)
    graph = viewing_cells(city, max_length=max_length)
    assert all(cell.length <= max_length * (1 + 1e-9) for cell in cells_of(graph))
    assert len({cell.id for cell in cells_of(graph)}) == len(graph)
    for _, _, street in city.streets.edges(data=True):
        line = street["geometry"]
        axes = [LineString([c.p, c.q]) for c in cells_of(graph) if c.id.startswith(f"{street['index']:04d}")]
        if line.length > 0.0:
            covered = shapely.union_all(axes)
            along = shapely.line_interpolate_point(line, np.linspace(0.0, line.length, 60))
            assert shapely.distance(covered, along).max() <= cells.MERGE_TOLERANCE + 1e-9
            assert shapely.hausdorff_distance(line, covered, densify=0.1) <= cells.MERGE_TOLERANCE + 1e-9
    for a, b in graph.edges:
        one, other = graph.nodes[a]["cell"], graph.nodes[b]["cell"]
        assert {one.p, one.q} & {other.p, other.q}


@settings(max_examples=150, deadline=None)
@given(st.lists(polylines, min_size=1, max_size=4), blocks, st.floats(0.3, 8.0))
def test_no_cell_comes_near_a_building_and_wide_streets_stay_wide(lines, boxes, half_width):
    city = city_of(lines, boxes, half_width=half_width)
    graph = viewing_cells(city)
    assert as_values(graph) == as_values(viewing_cells(city))
    if len(graph) and boxes:
        assert clearance(graph, city) >= cells.CLEARANCE
    footprints = shapely.union_all(boxes) if boxes else Polygon()
    for cell in cells_of(graph):
        if cell.half_width < half_width:
            wider = ViewingCell(cell.id, cell.p, cell.q, cell.half_width + 0.01, cell.eye)
            assert shapely.distance(Polygon(wider.corners), footprints) < 1.5 * cells.CLEARANCE
    kept = sum(cell.length for cell in cells_of(graph))
    report = graph.graph["report"]
    assert report.cell_length == pytest.approx(kept)
    assert report.cut_length <= report.street_length + 1e-9


def real_city(name):
    """Buildings and streets of a folder's derived files, as they are: streets run through buildings."""
    folder = real(name)
    streets = json.loads((folder / "derived_streets.geojson").read_text())["features"]
    buildings = json.loads((folder / "derived_buildings.geojson").read_text())["features"]
    origin = np.array(streets[0]["geometry"]["coordinates"][0])
    lines = [np.array(one["geometry"]["coordinates"]) - origin for one in streets]
    footprints = [shapely.make_valid(shape(one["geometry"])) for one in buildings]
    parts = shapely.get_parts(shapely.transform(footprints, lambda points: points - origin))
    return city_of(lines, [part for part in parts if isinstance(part, Polygon)])


@pytest.mark.parametrize("name", ["paris_9e", "nyc_west_village"])
def test_real_city(name):
    city = real_city(name)
    graph = viewing_cells(city)
    report = graph.graph["report"]
    assert max(cell.length for cell in cells_of(graph)) <= 40.0 + 1e-9
    footprints = shapely.STRtree([one.footprint for one in city.objects])
    assert footprints.query(regions(graph), predicate="dwithin", distance=cells.CLEARANCE)[0].size == 0
    # Chords and merging shorten streets by little; what is missing besides is what buildings took.
    assert 0.995 * report.street_length <= report.cell_length + report.cut_length <= report.street_length
    assert report.cells <= report.street_length / 40.0 * 3


# Hills


def on_hills(terrain, lines, boxes=(), **options):
    city = city_of(lines, boxes, **options)
    return City(city.objects, city.streets, city.crs, city.origin, city.source, terrain=terrain)


def anywhere(cell, count, rng):
    """Points (count, 2) of the cell's region, many of them on its outline, and their shares of the way from p to q."""
    p, q = np.array(cell.p), np.array(cell.q)
    left = np.array([-(q - p)[1], (q - p)[0]]) / cell.length * cell.half_width
    t, s = rng.random((count, 1)), rng.uniform(-1.0, 1.0, (count, 1))
    s[: count // 2] = np.sign(s[: count // 2])
    return p + t * (q - p) + s * left, t[:, 0]


ENDS = st.tuples(st.floats(-120.0, 120.0), st.floats(-120.0, 120.0))
HILLS = st.builds(
    lambda seed, spacing, steep: waves(seed, size=140.0, spacing=spacing, steep=steep),
    st.integers(0, 40),
    st.sampled_from([2.0, 8.0, 25.0]),
    st.sampled_from([0.05, 0.2, 0.5]),
)


@settings(deadline=None, max_examples=40)
@given(HILLS, st.lists(st.tuples(ENDS, ENDS), min_size=1, max_size=3), st.sampled_from([1.0, 3.0, 8.0]))
def test_eye_bands_hold_the_eyes_of_a_walker_anywhere_in_the_cell(terrain, lines, half_width):
    lines = [line for line in lines if math.dist(*line) > 1.0]
    rng = np.random.default_rng(1)
    for cell in cells_of(viewing_cells(on_hills(terrain, lines, half_width=half_width))):
        points, t = anywhere(cell, 400, rng)
        ground = terrain.at(points)
        low, high = cell.eye
        assert low <= ground.min() + 1.5 + 0.03
        assert ground.max() + 1.9 <= high + 0.03
        # And not much more than that: the band of a cell is as high as its ground is uneven.
        assert high - low <= np.ptp(ground) + abs(cell.rise) + 0.4 + 0.5
        bands = np.array([cell.eye_at(share) for share in t])
        assert (bands[:, 0] <= ground + 1.5 + 0.03).all()
        assert (ground + 1.9 <= bands[:, 1] + 0.03).all()
        a, b = terrain.at([cell.p, cell.q])
        assert cell.rise == pytest.approx(b - a, abs=1e-9)


@settings(deadline=None, max_examples=40)
@given(HILLS, st.lists(st.tuples(ENDS, ENDS), min_size=1, max_size=3))
def test_no_cell_is_steeper_than_it_may_be_unless_it_is_short(terrain, lines):
    lines = [line for line in lines if math.dist(*line) > 1.0]
    graph = viewing_cells(on_hills(terrain, lines))
    flat = viewing_cells(city_of(lines))
    for cell in cells_of(graph):
        along = np.linspace(cell.p, cell.q, 200)
        ground = terrain.at(along)
        assert np.ptp(ground) <= cells.STEEPEST + 0.05 or cell.length <= cells.SHORT_PIECE + 1e-6
        assert cell.length >= min(0.5 * cells.SHORT_PIECE, math.dist(cell.p, cell.q))
    assert len(graph) >= len(flat)
    assert graph.graph["report"].cell_length == pytest.approx(flat.graph["report"].cell_length)
    assert sorted(nx.number_connected_components(one) for one in (graph, flat))[0] == len(
        list(nx.connected_components(graph))
    )


def test_cells_on_hills_have_the_names_and_neighbours_of_their_pieces():
    """Of two streets that meet, the steep one is cut into ten metres, the level one as on flat ground."""
    terrain = Terrain((-200.0, -200.0), 100.0, np.tile(np.maximum(np.arange(-200.0, 201.0, 100.0), 0.0) * 0.2, (5, 1)))
    graph = viewing_cells(on_hills(terrain, [[(0, 0), (100, 0)], [(0, 0), (-80, 0)], [(0, 0), (0, 80)]]))
    assert list(graph) == [
        *(f"0000-{i:02d}" for i in range(10)),
        *(f"{street:04d}-{i:02d}" for street in (1, 2) for i in range(2)),
    ]
    assert [cell.rise for cell in cells_of(graph)] == pytest.approx([2.0] * 10 + [0.0] * 4)
    assert cells_of(graph)[3].eye == pytest.approx((6.0 + 1.5, 8.0 + 1.9))
    assert cells_of(graph)[10].eye == pytest.approx((1.5, 1.9))
    assert sorted(graph["0000-00"]) == ["0000-01", "0001-00", "0002-00"]
    assert sorted(graph["0000-04"]) == ["0000-03", "0000-05"]
    assert graph.number_of_edges() == 9 + 1 + 1 + 3
    # Nothing of this changes when there is another street, or a hill elsewhere.
    more = viewing_cells(
        on_hills(terrain, [[(0, 0), (100, 0)], [(0, 0), (-80, 0)], [(0, 0), (0, 80)], [(0, 80), (50, 90)]])
    )
    assert [cell for cell in cells_of(more) if cell.id < "0003"] == cells_of(graph)


@given(HILLS, st.tuples(ENDS, ENDS), st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
@settings(deadline=None, max_examples=60)
def test_parts_of_a_cell_lie_in_it_and_have_its_eyes(terrain, line, one, other, share):
    if math.dist(*line) < 5.0 or abs(one - other) < 0.01:
        return
    cell = cells_of(viewing_cells(on_hills(terrain, [line])))[0]
    start, end = sorted((one, other))
    part = cell.part(start, end, "part")
    assert part.id == "part"
    assert shapely.covers(Polygon(cell.corners).buffer(1e-6), Polygon(part.corners))
    assert cell.eye[0] - 1e-9 <= part.eye[0] <= part.eye[1] <= cell.eye[1] + 1e-9
    assert part.eye_at(share) == pytest.approx(cell.eye_at(start + share * (end - start)), abs=1e-6)
    for half in halves(cell) or ():
        assert half.length == pytest.approx(0.5 * cell.length)
        assert half.eye[1] - half.eye[0] <= cell.eye[1] - cell.eye[0] + 1e-9
    assert cell.part(0.0, 1.0, cell.id).eye == pytest.approx(cell.eye)


def test_buildings_dug_into_a_slope_or_above_it_leave_room():
    """On a slope of 1:5 the ground below this footprint is between 10 and 14 m high."""
    terrain = Terrain((-200.0, -200.0), 5.0, np.tile(np.arange(-200.0, 201.0, 5.0) * 0.2, (81, 1)))
    footprint = box(50, -10, 70, 10)
    for bottom, top, blocks in ((5.0, 30.0, True), (13.5, 30.0, True), (16.5, 30.0, False), (0.0, 9.5, False)):
        city = on_hills(terrain, [[(0, 0), (100, 0)]], [footprint], bottom=bottom, top=top)
        graph = viewing_cells(city)
        assert (graph.graph["report"].cut_pieces > 0) == blocks
        if blocks:
            assert clearance(graph, city) >= cells.CLEARANCE - 1e-9
