"""Blocks, lots and walls, against shapely's polygon operations and shapes small enough to work out by hand."""

from itertools import pairwise

import numpy as np
import pytest
import shapely
import shapely.affinity
from hypothesis import given, settings
from hypothesis import strategies as st

from citygen.presets import COUNTRY
from citygen.streets.blocks import carve_blocks, cut_lots, subtract_cores, weld
from citygen.streets.networks import Network, faces, lattice_network
from citygen.streets.ragged import are_convex, cut, from_rings, oriented_boxes, to_rings
from citygen.streets.subdivision import subdivide


def frame(widths):
    """Four streets of ``widths`` around 100 x 60 m."""
    nodes = np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 60.0], [0.0, 60.0]])
    ends = np.array([[0, 1], [1, 2], [2, 3], [3, 0]])
    text = np.array(["residential"] * 4)
    return Network(nodes, ends, shapely.linestrings(nodes[ends]), text, np.array(widths), text)


def some_polygons(seed, count=60):
    """Convex ones, and ones with a notch."""
    rng = np.random.default_rng(seed)
    hulls = [shapely.MultiPoint(rng.uniform(0.0, 60.0, (7, 2))).convex_hull for _ in range(count)]
    notches = [shapely.Point(rng.uniform(10.0, 50.0, 2)).buffer(9.0, quad_segs=2) for _ in range(count)]
    dented = [hull.difference(notch) for hull, notch in zip(hulls, notches, strict=True)]
    shapes = [one for one in [*hulls, *dented] if one.geom_type == "Polygon" and one.area > 100.0]
    return np.array(shapes, dtype=object)


def overlap(polygons):
    """The largest area that two of the polygons share."""
    i, j = shapely.STRtree(polygons).query(polygons, predicate="intersects")
    i, j = i[i < j], j[i < j]
    return shapely.area(shapely.intersection(polygons[i], polygons[j])).max(initial=0.0)


def test_block_is_what_streets_leave():
    network = frame([4.0, 5.0, 6.0, 7.0])
    blocks, owners = carve_blocks(faces(network), network, pavement=2.0)
    assert owners.tolist() == [0]
    assert blocks[0].equals(shapely.box(9.0, 6.0, 93.0, 52.0))


def test_too_small_a_block_is_left_to_the_street():
    network = frame([28.0] * 4)
    assert len(carve_blocks(faces(network), network, pavement=1.0)[0]) == 0


def test_dead_end_is_left_open():
    around = frame([4.0] * 4)
    nodes = np.concatenate([around.nodes, [[50.0, 60.0], [50.0, 30.0]]])
    ends = np.array([[0, 1], [1, 2], [2, 4], [4, 3], [3, 0], [4, 5]])
    text = np.array(["residential"] * 6)
    network = Network(nodes, ends, shapely.linestrings(nodes[ends]), text, np.full(6, 4.0), text)
    blocks, _ = carve_blocks(faces(network), network, pavement=1.0)
    assert len(blocks) == 1
    assert shapely.distance(blocks[0], network.lines[5]) == pytest.approx(5.0, abs=0.5)  # round ends have few corners


@pytest.mark.parametrize("bent", [False, True])
def test_blocks_stay_off_streets_and_inside_their_face(bent):
    square = np.array([[0.0, 0.0], [400.0, 0.0], [400.0, 400.0], [0.0, 400.0]])
    rng = np.random.default_rng(1)
    if bent:
        network = subdivide(square, lambda p: np.sin(p[:, 0] / 70.0), rng, blocks=14, junctions=60, ranks=COUNTRY)
    else:
        network = lattice_network(rng, columns=5, rows=7)
    areas = faces(network)
    blocks, owners = carve_blocks(areas, network, pavement=2.0)
    assert set(owners.tolist()) == set(range(len(areas)))
    assert (shapely.area(shapely.difference(blocks, areas[owners])) < 1e-6).all()
    near, street = shapely.STRtree(network.lines).query(blocks, predicate="dwithin", distance=30.0)
    room = shapely.distance(blocks[near], network.lines[street]) - network.half_widths[street]
    assert 1.4 < room.min() < 2.3
    # What is lost is the strips and little else.
    strips = shapely.union_all(shapely.buffer(network.lines, network.half_widths + 2.0))
    assert shapely.area(blocks).sum() == pytest.approx(shapely.union_all(areas).difference(strips).area, rel=0.02)


@pytest.mark.parametrize("seed", range(3))
def test_lots_are_a_partition(seed):
    blocks = some_polygons(seed)
    lots, owners = cut_lots(blocks, np.full(len(blocks), 150.0), np.random.default_rng(seed), spread=0.0)
    assert np.bincount(owners, shapely.area(lots)) == pytest.approx(shapely.area(blocks), rel=2e-3)
    assert (shapely.area(lots) <= 150.0 * 1.45 + 1e-9).all()
    assert np.median(shapely.area(lots)) > 75.0
    for k in range(0, len(blocks), 7):
        assert overlap(lots[owners == k]) < 1e-6


@pytest.mark.parametrize("seed", range(3))
def test_cores_are_subtracted_as_by_shapely(seed):
    blocks = some_polygons(seed)
    lots, owners = cut_lots(blocks, np.full(len(blocks), 120.0), np.random.default_rng(seed))
    cores = shapely.buffer(blocks, -6.0, join_style="mitre")[owners]
    pieces, whole = subtract_cores(lots, cores)
    wanted = shapely.area(shapely.difference(lots, cores))
    assert np.bincount(whole, shapely.area(pieces), len(lots)) == pytest.approx(
        wanted, abs=2.5
    )  # parts under a square metre go
    assert shapely.area(shapely.intersection(pieces, cores[whole])).max() < 1e-6


@pytest.mark.parametrize("seed", range(3))
def test_cut_gives_both_sides_of_a_line(seed):
    rng = np.random.default_rng(seed)
    polygons = some_polygons(seed)
    polygons = polygons[are_convex(polygons)]
    xy, owner = to_rings(polygons)
    points = shapely.get_coordinates(shapely.centroid(polygons)) + rng.uniform(-20.0, 20.0, (len(polygons), 2))
    angles = rng.uniform(0.0, 2.0 * np.pi, len(polygons))
    normals = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    along = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
    for side, rings in zip((1.0, -1.0), cut((xy, owner), points[owner], normals[owner]), strict=True):
        found, whose = from_rings(rings)
        corners = [points - 999 * along, points + 999 * along]
        corners += [corners[1] + side * 999 * normals, corners[0] + side * 999 * normals]
        wanted = shapely.area(shapely.intersection(polygons, shapely.polygons(np.stack(corners, axis=1))))
        assert np.bincount(whose, shapely.area(found), len(polygons)) == pytest.approx(wanted, abs=1e-6)


def test_convex():
    shapes = [
        shapely.box(0, 0, 2, 1),
        shapely.Polygon([(0, 0), (4, 0), (4, 4), (2, 1)]),
        shapely.box(0, 0, 9, 9).difference(shapely.box(2, 2, 4, 4)),
        shapely.MultiPolygon([shapely.box(0, 0, 1, 1), shapely.box(5, 0, 6, 1)]),
        shapely.Polygon(),
    ]
    assert are_convex(np.array(shapes, dtype=object)).tolist() == [True, False, False, False, False]


def test_wall_has_a_corner_where_neighbours_meet_it():
    long = shapely.box(0.0, 0.0, 10.0, 5.0)
    pieces = np.array([long, shapely.box(0.0, 5.0, 4.0, 9.0), shapely.box(4.0, 5.0, 10.0, 9.0)], dtype=object)
    welded = weld(pieces)
    assert (4.0, 5.0) in welded[0].exterior.coords
    assert [len(one.exterior.coords) - 1 for one in welded] == [5, 4, 4]
    assert shapely.equals(welded, pieces).all()


def test_courtyard_walls_are_welded_too():
    ring = shapely.box(0.0, 0.0, 10.0, 10.0).difference(shapely.box(3.0, 3.0, 7.0, 7.0))
    pieces = np.array([ring, shapely.box(3.0, 3.0, 5.0, 7.0), shapely.box(12.0, 0.0, 13.0, 1.0)], dtype=object)
    welded = weld(pieces)
    assert {(5.0, 3.0), (5.0, 7.0)} <= set(welded[0].interiors[0].coords)
    assert welded[2].equals(pieces[2])


def shortest_wall(polygons):
    xy, ring = shapely.get_coordinates(shapely.get_rings(polygons), return_index=True)
    return np.hypot(*np.diff(xy, axis=0).T)[np.diff(ring) == 0].min()


def test_corners_that_nearly_meet_are_one():
    """Lots on both sides of a wall are cut almost, not quite, at one place: no sliver is left between them."""
    lots = [shapely.box(0, 0, 4, 5), shapely.box(4, 0, 9, 5), shapely.box(0, 5, 4.06, 9), shapely.box(4.06, 5, 9, 9)]
    welded = weld(np.array(lots, dtype=object))
    assert [len(one.exterior.coords) - 1 for one in welded] == [4, 4, 4, 4]
    assert shapely.union_all(welded).equals(shapely.box(0, 0, 9, 9))
    assert shapely.area(welded).sum() == pytest.approx(81.0)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(0.0, 9.0), max_size=4), st.lists(st.floats(0.0, 9.0), max_size=4), st.floats(-0.2, 0.2))
def test_welded_rows_neither_overlap_nor_leave_gaps(below, above, tilt):
    """Two rows of lots along a wall, each cut where it likes."""
    whole = shapely.Polygon([(-3.0, -5.0), (12.0, -5.0), (12.0, 5.0 + tilt), (-3.0, 5.0 - tilt)])
    lots = []
    for low, high, cuts in ((-9.0, 0.0, below), (0.0, 9.0, above)):
        edges = [-3.0, *sorted(cuts), 12.0]
        lots += [shapely.box(a, low, b, high).intersection(whole) for a, b in pairwise(edges) if b - a > 0.3]
    welded = weld(np.array(lots, dtype=object))
    assert shapely.is_valid(welded).all()
    assert shortest_wall(welded) >= 0.1
    apart = np.triu(shapely.area(shapely.intersection(welded[:, None], welded[None])), 1)
    assert apart.max(initial=0.0) < 1e-6
    bound = 0.4 * shapely.length(shapely.union_all(lots))
    assert shapely.area(shapely.symmetric_difference(shapely.union_all(lots), shapely.union_all(welded))) < bound


def test_holes_and_necks_no_wider_than_a_hand_are_closed():
    hole = shapely.box(0, 0, 9, 9).difference(shapely.box(4, 4, 4.05, 4.05))
    neck = shapely.union_all([shapely.box(20, 0, 29, 9), shapely.box(29, 4, 31, 4.05), shapely.box(31, 0, 33, 9)])
    welded = weld(np.array([hole, neck], dtype=object))
    assert not welded[0].interiors
    assert shapely.is_valid(welded).all()
    assert welded[1].bounds == (20.0, 0.0, 29.0, 9.0)


def test_nothing_to_weld():
    assert len(weld(np.zeros(0, dtype=object))) == 0


@pytest.mark.parametrize("seed", range(3))
def test_oriented_boxes_are_the_smallest(seed):
    polygons = some_polygons(seed)
    middle, along, size = oriented_boxes(polygons)
    assert (size[:, 0] >= size[:, 1]).all()
    for k, polygon in enumerate(polygons):
        local = (np.array(polygon.exterior.coords) - middle[k]) @ np.array([along[k], [-along[k, 1], along[k, 0]]]).T
        assert np.abs(local).max(axis=0) == pytest.approx(0.5 * size[k])
        turns = [shapely.affinity.rotate(polygon, angle).bounds for angle in range(0, 90, 3)]
        assert size[k].prod() <= min((b[2] - b[0]) * (b[3] - b[1]) for b in turns) + 1e-6
