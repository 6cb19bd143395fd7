"""The conservative visible set against hand-made cities, a plain twin, and brute-force rays; the item buffer below it."""

import dataclasses
import itertools
import math

import networkx as nx
import numpy as np
import pytest
import shapely
from cities import HELSINKI, SHARED, real
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import PrismRays, searching_rays, viewpoints_within
from selection import with_slow
from shapely import affinity
from shapely.geometry import LineString, Point, Polygon, box

from mmi.cells.choice import spread
from mmi.cells.viewing_cells import ViewingCell, viewing_cells
from mmi.city.long_objects import cut_objects
from mmi.city.model import City, CityObject, Prism, TriangleMesh
from mmi.foundation.errors import ParameterError
from mmi.reading.read_city import read_city
from mmi.visibility.cell_outline import sample_viewpoints
from mmi.visibility.horizon import _levels, horizon_extractor, horizon_of_boxes, horizon_visible, prepare_horizon
from mmi.visibility.item_buffer import item_buffer_extractor, panorama
from mmi.visibility.selection import everything


def city_of(*solids, **options):
    """Objects from (footprint, top) or (footprint, bottom, top)."""
    objects = []
    for i, (footprint, *span) in enumerate(solids):
        bottom, top = span if len(span) == 2 else (0.0, *span)
        objects.append(CityObject(f"solid/{i}", (Prism(footprint, float(bottom), float(top)),)))
    return City(tuple(objects), nx.MultiGraph(), "EPSG:32631", (0.0, 0.0, 0.0), "made by hand", **options)


def cell_along_x(length=10.0, *, half_width=3.0):
    return ViewingCell("0000-00", (0.0, 0.0), (length, 0.0), half_width, (1.5, 1.9))


def visible(city, cell=None, **options):
    return horizon_visible(prepare_horizon(city, **options), cell or cell_along_x())[0].tolist()


WALL = box(-100, 10, 110, 30)
"""North of the cell and too long to look around its ends at what lies close behind it."""


class TestByHand:
    def test_a_wall_hides_the_house_behind_it(self):
        assert visible(city_of((WALL, 10), (box(0, 40, 10, 50), 8))) == [0]

    def test_a_tower_shows_above_the_wall(self):
        assert visible(city_of((WALL, 10), (box(0, 40, 10, 50), 60))) == [0, 1]

    def test_the_height_at_which_it_shows(self):
        # farthest back (3, -3), 13 m to the wall: (10 - 1.9) / 13 = 0.623; the house's near wall is 43 m away
        showing = 1.9 + 43.0 * 8.1 / 13.0
        assert visible(city_of((WALL, 10), (box(0, 40, 10, 50), showing + 0.01))) == [0, 1]
        # what shrinking by 0.5 m gives away: the wall counts from 0.55 m farther back
        assert visible(city_of((WALL, 10), (box(0, 40, 10, 50), showing - 1.3)), shrink=0.5) == [0]

    def test_a_house_shows_through_the_gap_between_two_walls(self):
        gap = [(box(-100, 10, 4, 30), 10), (box(6, 10, 110, 30), 10)]
        assert visible(city_of(*gap, (box(0, 40, 10, 50), 8))) == [0, 1, 2]

    def test_touching_walls_leave_no_gap(self):
        row = [(box(x, 10, x + 7, 30), 10 + x % 3) for x in range(-105, 110, 7)]
        assert visible(city_of(*row, (box(0, 40, 10, 50), 8))) == list(range(len(row)))

    def test_corners_within_a_column_leave_no_gap(self):
        teeth = [(x, 10.0 + 0.2 * (i % 2)) for i, x in enumerate(np.arange(-100.0, 110.0, 0.7))]
        jagged = Polygon([*teeth, (110, 30), (-100, 30)])
        assert visible(city_of((jagged, 10), (box(0, 40, 10, 50), 8))) == [0]

    def test_a_floating_solid_hides_nothing(self):
        assert visible(city_of((WALL, 0.5, 10), (box(0, 40, 10, 50), 8))) == [0, 1]

    def test_what_floats_can_be_hidden_or_show(self):
        assert visible(city_of((WALL, 10), (box(0, 40, 10, 50), 5, 8))) == [0]
        assert visible(city_of((WALL, 10), (box(0, 40, 10, 50), 50, 60))) == [0, 1]

    def test_an_object_that_is_not_opaque_hides_nothing(self):
        city = city_of((WALL, 10), (box(0, 40, 10, 50), 8))
        glass = CityObject("glass", city.objects[0].prisms, core=())
        assert visible(dataclasses.replace(city, objects=(glass, city.objects[1]))) == [0, 1]

    def test_a_wall_below_the_eye_hides_nothing(self):
        assert visible(city_of((WALL, 1.8), (box(0, 40, 10, 50), 8))) == [0, 1]

    def test_low_things_in_front_are_seen_and_behind_are_not(self):
        assert visible(city_of((WALL, 10), (box(0, 5, 1, 6), 0.5), (box(0, 40, 1, 41), 0.5))) == [0, 1]

    def test_a_building_that_the_cell_cuts_into_is_seen_and_hides_nothing(self):
        arch = box(-100, 2, 110, 30)
        assert visible(city_of((arch, 10), (box(0, 40, 10, 50), 8))) == [0, 1]

    def test_its_neighbours_still_hide(self):
        arch, neighbour = box(2, 2, 8, 30), box(8, 10, 300, 30)
        assert visible(city_of((arch, 10), (neighbour, 10), (box(100, 40, 110, 50), 8))) == [0, 1]

    def test_a_bridge_over_the_cell_is_seen(self):
        assert visible(city_of((box(4, -20, 6, 20), 5, 6))) == [0]

    def test_from_inside_of_what_walls_enclose_one_sees_the_walls_that_it_covers(self):
        """As an open mesh without a party wall and without walls around its courtyard: the neighbour's wall shows."""
        hall, neighbour = box(-15, -20, 25, 20), box(25, -20, 45, 20)
        sides = tuple(Prism(box(-15, y, 25, y + 12), 0.0, 9.0) for y in (-20, 8))
        objects = (CityObject("open", sides, None, (Prism(hall, 0.0, 9.0),)), *city_of((neighbour, 9)).objects)
        scene = prepare_horizon(dataclasses.replace(city_of(), objects=objects))
        rings = scene.occludees
        (ring,) = np.flatnonzero(scene.owners == 1).tolist()
        edges = np.arange(rings.starts[ring], rings.starts[ring + 1])
        towards = edges[(rings.xy[edges, 0] == 25.0) & (np.roll(rings.xy[edges, 0], -1) == 25.0)]
        for cell, lowest in (
            (cell_along_x(), -np.inf),
            (ViewingCell("c", (-40.0, 30.0), (60.0, 30.0), 3.0, (1.5, 1.9)), 9.0),
        ):
            assert horizon_visible(scene, cell)[1].lowest[towards] == pytest.approx(lowest)

    def test_from_a_courtyard_only_its_walls_and_towers_beyond(self):
        block = Polygon(box(-40, -40, 50, 40).exterior.coords, [box(-10, -10, 20, 10).exterior.coords])
        city = city_of((block, 15), (box(60, 0, 70, 10), 12), (box(0, 60, 10, 70), 120))
        assert visible(city) == [0, 2]

    def test_all_around_and_across_the_seam_of_azimuth(self):
        ring = shapely.difference(Point(5, 0).buffer(40), Point(5, 0).buffer(20))
        city = city_of(
            (ring, 10), *((affinity.rotate(box(60, -4, 70, 4), a, origin=(5, 0)), 9) for a in range(0, 360, 7))
        )
        assert visible(city) == [0]

    def test_an_empty_city(self):
        assert visible(city_of()) == []

    def test_only_floating_objects(self):
        assert visible(city_of((WALL, 5, 10))) == [0]

    def test_ground_elsewhere_than_at_zero(self):
        solids = [(WALL, 50, 60), (box(0, 40, 10, 50), 50, 58)]
        cell = ViewingCell("0000-00", (0.0, 0.0), (10.0, 0.0), 3.0, (51.5, 51.9))
        assert visible(city_of(*solids, ground=50.0), cell) == [0]
        assert visible(city_of(*solids, ground=49.0), cell) == [0, 1]


class TestBoxes:
    def found(self, *boxes, solids=((WALL, 10),)):
        scene = horizon_of_boxes(prepare_horizon(city_of(*solids)), np.array(boxes, dtype=np.float64))
        return horizon_visible(scene, cell_along_x())[0].tolist()

    def test_behind_the_wall_above_it_beside_and_within_the_cell(self):
        behind, above = [(0, 40, 0), (10, 50, 8)], [(0, 40, 0), (10, 50, 60)]
        beside, around = [(300, 0, 0), (310, 10, 3)], [(-5, -5, 0), (5, 5, 1)]
        assert self.found(behind, above, beside, around) == [1, 2, 3]

    def test_boxes_without_width_or_depth(self):
        assert self.found([(0, 40, 0), (10, 40, 8)], [(3, 40, 0), (3, 50, 8)], [(3, 5, 0), (3, 5, 0)]) == [2]

    def test_boxes_hide_nothing(self):
        assert self.found(
            [(-100, 10, 0), (110, 30, 10)], [(0, 40, 0), (10, 50, 8)], solids=((box(500, 0, 501, 1), 3),)
        ) == [
            0,
            1,
        ]

    def test_houses_as_boxes_are_found_as_the_houses_are(self):
        rng = np.random.default_rng(6)
        low = rng.uniform(-80.0, 80.0, (40, 2))
        size, tops = rng.uniform(4.0, 25.0, (40, 2)), rng.uniform(2.0, 15.0, 40)
        city = city_of(*[(box(*a, *(a + b)), top) for a, b, top in zip(low, size, tops, strict=True)])
        boxes = np.stack([np.column_stack([low, np.zeros(40)]), np.column_stack([low + size, tops])], axis=1)
        scene = prepare_horizon(city)
        found, houses = (horizon_visible(one, cell_along_x())[0] for one in (horizon_of_boxes(scene, boxes), scene))
        assert set(houses.tolist()) <= set(found.tolist())  # boxes are a hair larger
        assert len(found) <= len(houses) + 1 < 40


class TestOptions:
    @pytest.mark.parametrize("options", [{"shrink": 0.0}, {"shrink": math.inf}, {"columns": 4}, {"levels": 0}])
    def test_nonsense(self, options):
        with pytest.raises(ParameterError, match="found"):
            prepare_horizon(city_of((WALL, 10)), **options)

    @given(st.floats(1, 60), st.floats(0.5, 8), st.floats(0.2, 4), st.floats(0, 7))
    def test_viewpoints_reach_the_outline(self, length, half_width, reach, turn):
        q = (3.0 + length * math.cos(turn), -2.0 + length * math.sin(turn))
        cell = ViewingCell("0000-00", (3.0, -2.0), q, half_width, (1.5, 1.9))
        points = sample_viewpoints(cell, reach=reach)
        outline = shapely.segmentize(shapely.linearrings(cell.corners), 0.05)
        away = shapely.distance(shapely.points(shapely.get_coordinates(outline)), shapely.multipoints(points[:, :2]))
        assert away.max() <= reach + 1e-9
        assert np.all(points[:, 2] == 1.9)
        assert len(points) <= outline.length / (2 * reach) + 1.001

    def test_viewpoints_that_reach_nowhere(self):
        with pytest.raises(ParameterError):
            sample_viewpoints(cell_along_x(), reach=0.0)

    @given(st.lists(st.integers(1, 30), min_size=1, max_size=9), st.integers(1, 6))
    def test_levels_lose_the_least_height(self, tops, count):
        tops = np.array(tops, dtype=np.float64)

        def lost(levels):
            kept = np.sort(np.asarray(levels, dtype=np.float64))
            return np.sum(tops - kept[np.searchsorted(kept, tops, side="right") - 1])

        values = np.unique(tops)
        others = itertools.combinations(values[1:], min(count, len(values)) - 1)
        levels = _levels(tops, count)
        assert len(levels) <= count
        assert np.all(np.diff(levels) > 0)
        assert lost(levels) == pytest.approx(min(lost((values[0], *rest)) for rest in others))

    def test_levels_of_many_different_tops(self):
        tops = np.random.default_rng(4).gamma(3.0, 5.0, 5000)
        levels = _levels(tops, 12)
        assert len(levels) == 12
        assert levels[0] == tops.min()
        even = np.quantile(tops, np.arange(12) / 12, method="lower")
        lost, lost_evenly = (
            np.mean(tops - some[np.searchsorted(some, tops, side="right") - 1]) for some in (levels, even)
        )
        assert lost < 0.95 * lost_evenly

    def test_a_scene_of_another_city(self):
        extract = horizon_extractor(prepare_horizon(city_of((WALL, 10))))
        with pytest.raises(ValueError, match="horizon of"):
            extract(everything(city_of((WALL, 10)), cell_along_x()))


# Random cities: rectangles on a half-metre lattice (so that walls touch, align and overlap), some turned, some floating.


@st.composite
def rectangles(draw):
    x, y = draw(st.integers(-60, 60)) / 2.0, draw(st.integers(-60, 60)) / 2.0
    footprint = box(x, y, x + draw(st.integers(2, 40)) / 2.0, y + draw(st.integers(2, 40)) / 2.0)
    if draw(st.booleans()):
        footprint = affinity.rotate(footprint, draw(st.sampled_from([10.0, 30.0, 45.0, 77.0])))
    bottom = draw(st.sampled_from([0.0, 0.0, 0.0, 2.5, 6.0]))
    return footprint, bottom, bottom + draw(st.sampled_from([0.7, 3.0, 6.0, 6.1, 9.0, 15.0, 40.0]))


CITIES = st.lists(rectangles(), min_size=1, max_size=14)
CELLS = st.builds(
    lambda length, turn, half: ViewingCell(
        "0000-00", (0.25, -0.5), (0.25 + length * math.cos(turn), -0.5 + length * math.sin(turn)), half, (1.5, 1.9)
    ),
    st.sampled_from([4.0, 13.0]),
    st.sampled_from([0.0, 0.5 * math.pi, 1.1, 2.5]),
    st.sampled_from([1.0, 3.0]),
)


def plain_visible(scene, cell, *, slack):
    """The sweep told with shapely: wedge by wedge, all stretches of all rings, no order, no pruning.

    ``slack`` (relative, of either sign) makes slopes that hide larger and so sets smaller.
    """
    region = Polygon(cell.corners)
    seen = set()
    solids = [prism for one in scene.city.objects for prism in one.prisms]
    owners = [i for i, one in enumerate(scene.city.objects) for _ in one.prisms]
    cutting = [
        p.footprint.buffer(scene.shrink + 0.05, join_style="mitre")
        for one in scene.city.objects
        for p in one.occluders
        if p.bottom == 0.0 and p.footprint.intersects(region.buffer(-1e-3, join_style="mitre"))
    ]
    blocks = shapely.difference(scene.blocks, shapely.union_all(cutting)) if cutting else scene.blocks
    seen |= {i for p, i in zip(solids, owners, strict=True) if p.footprint.distance(region) <= 1e-3}
    for x, y, eye in sample_viewpoints(cell, reach=scene.shrink):
        at = Point(x, y)
        for column in range(scene.columns):
            low, high = (
                LineString([(x, y), (x + 1e3 * math.cos(turn), y + 1e3 * math.sin(turn))])
                for turn in 2.0 * math.pi / scene.columns * np.array([column, column + 1])
            )
            wedge = Polygon([(x, y), low.coords[1], high.coords[1]])
            steps = []
            for block, height in zip(blocks, scene.block_heights, strict=True):
                if height <= eye or not block.intersects(wedge):
                    continue
                rings = [ring for part in shapely.get_parts(block) for ring in shapely.get_rings(part)]
                pieces = shapely.get_parts(shapely.intersection(rings, wedge))
                for piece in shapely.get_parts(shapely.line_merge(shapely.union_all(pieces))):
                    if piece.distance(low) < 1e-9 and piece.distance(high) < 1e-9:
                        farthest = piece.hausdorff_distance(at)
                        steps.append((farthest, (height - eye) / farthest))
            shapely.prepare(wedge)
            for solid, owner in zip(solids, owners, strict=True):
                if owner in seen or not wedge.intersects(solid.footprint.boundary):
                    continue
                distance = solid.footprint.boundary.intersection(wedge).distance(at)
                slope = (solid.top - eye) / distance
                if all(d >= distance * (1 + slack) or s * (1 + slack) < slope for d, s in steps):
                    seen.add(owner)
    return sorted(seen)


def city_with_probes(rng, *, probes):
    """Toothed walls of all sizes around the origin, and many specks around the skyline that they make."""
    solids = []
    for _ in range(12):
        width, depth = rng.uniform(4, 25), rng.uniform(3, 8)
        teeth = np.arange(0.0, width, rng.uniform(0.3, 4.0))
        front = np.column_stack([teeth, rng.uniform(0.0, 1.5, len(teeth)) * rng.integers(0, 2)])
        wall = Polygon([*front, (width, depth), (0.0, depth)]) if len(front) > 1 else box(0, 0, width, depth)
        wall = affinity.translate(wall, -0.5 * width, rng.uniform(6, 25))
        wall = affinity.rotate(wall, rng.uniform(0, 360), origin=(0, 0))
        if wall.is_valid and wall.distance(Point(0, 0)) > 5.5:
            solids.append((wall, rng.uniform(3, 25)))
    away, turn = rng.uniform(7, 60, probes), rng.uniform(0, 2 * math.pi, probes)
    tops = 1.9 + away * rng.uniform(0.01, 0.9, probes)
    at = np.column_stack([away * np.cos(turn), away * np.sin(turn)])
    specks = [(box(x, y, x + 0.2, y + 0.2), top - 0.1, top) for (x, y), top in zip(at, tops, strict=True)]
    city = city_of(*solids, *specks)
    return dataclasses.replace(
        city,
        objects=tuple(
            CityObject(one.id, one.prisms, core=one.prisms if one.base == 0.0 else ()) for one in city.objects
        ),
    )


@pytest.mark.parametrize("seed", range(5))
def test_the_kernel_agrees_with_its_plain_twin(seed):
    scene = prepare_horizon(city_with_probes(np.random.default_rng(seed), probes=300), shrink=1.0, columns=64)
    cell = ViewingCell("0000-00", (-0.8, -0.6), (0.8, 0.6), 0.5, (1.5, 1.9))
    found = set(horizon_visible(scene, cell)[0].tolist())
    assert set(plain_visible(scene, cell, slack=1e-7)) == found == set(plain_visible(scene, cell, slack=-1e-7))
    assert 100 < len(found) < 290


@pytest.mark.parametrize("seed", range(9))
def test_no_ray_finds_a_hidden_speck(seed):
    rng = np.random.default_rng(seed)
    city = city_with_probes(rng, probes=400)
    cell = ViewingCell("0000-00", (-4.0, -3.0), (4.0, 3.0), 1.5, (1.5, 1.9))
    origins, directions = searching_rays(city, cell, 200_000, rng)
    hits = np.unique(PrismRays(city).first_hits(origins, directions))
    shrink = (0.25, 0.5, 1.0)[seed % 3]
    found = visible(city, cell, shrink=shrink, columns=(256, 1024)[seed % 2], levels=12)
    assert np.isin(hits[hits >= 0], found).all()
    assert len(found) < 0.8 * len(city.objects)


@settings(max_examples=150, deadline=None)
@given(CITIES, CELLS, st.sampled_from([0.5, 1.0, 2.0]), st.sampled_from([32, 512]), st.integers(1, 4))
def test_no_ray_hits_what_is_not_in_the_set(solids, cell, shrink, columns, levels):
    city = city_of(*solids)
    found = visible(city, cell, shrink=shrink, columns=columns, levels=levels)
    origins, directions = searching_rays(city, cell, 6000, np.random.default_rng(7))
    hits = np.unique(PrismRays(city).first_hits(origins, directions))
    assert np.isin(hits[hits >= 0], found).all()


@settings(max_examples=60, deadline=None)
@given(CITIES, st.sampled_from([0.5, 2.0]))
def test_shrunken_occluders_keep_their_distance(solids, shrink):
    scene = prepare_horizon(city_of(*solids), shrink=shrink, levels=3)
    for height in np.unique(scene.block_heights):
        standing = [footprint for footprint, bottom, top in solids if bottom == 0.0 and top >= height]
        grown = shapely.union_all(scene.blocks[scene.block_heights == height]).buffer(shrink)
        assert shapely.union_all(standing).buffer(1e-9).covers(grown)


@settings(max_examples=60, deadline=None)
@given(CITIES, st.sampled_from([0.5, 2.0]), st.integers(1, 4))
def test_occluders_are_those_of_all_that_stands_as_high_shrunken_at_once(solids, shrink, levels):
    scene = prepare_horizon(city_of(*solids), shrink=shrink, levels=levels)
    for height in np.unique(scene.block_heights):
        standing = [footprint for footprint, bottom, top in solids if bottom == 0.0 and top >= height]
        plain = shapely.union_all(standing).buffer(-(shrink + 0.05), join_style="mitre")
        blocks = shapely.union_all(scene.blocks[scene.block_heights >= height])
        assert shapely.symmetric_difference(plain, blocks).buffer(-0.023).is_empty  # simplified by 4.5 cm at most


def test_a_tower_among_low_houses_casts_their_union_and_its_own():
    row = [(box(x, 10, x + 10, 30), 40 if x == 20 else 10) for x in range(0, 50, 10)]
    scene = prepare_horizon(city_of(*row, (box(100, 10, 110, 30), 40)), shrink=1.0)
    found = [(height, round(block.area)) for height, block in zip(scene.block_heights, scene.blocks, strict=True)]
    assert found == [(10, round(47.9 * 17.9)), (40, round(7.9 * 17.9)), (40, round(7.9 * 17.9))]


@settings(max_examples=30, deadline=None)
@given(CITIES, CELLS)
def test_moving_the_city_changes_nothing(solids, cell):
    dx, dy = 128.0, -512.0
    there = [(affinity.translate(footprint, dx, dy), *span) for footprint, *span in solids]
    moved = dataclasses.replace(cell, p=(cell.p[0] + dx, cell.p[1] + dy), q=(cell.q[0] + dx, cell.q[1] + dy))
    assert visible(city_of(*solids), cell) == visible(city_of(*there), moved)


class TestItemBuffer:
    @staticmethod
    def drawn_by_rays(city, views=None):
        rays = PrismRays(city)

        def identify(objects, view):
            if views is not None:
                views.append(view)
            u, v = np.meshgrid(*view.pixel_centres())
            directions = view.unproject(u, v, np.ones_like(u)) - view.eye
            hits = rays.first_hits(np.broadcast_to(view.eye, (u.size, 3)), directions.reshape(-1, 3))
            return np.where(np.isin(hits, objects), hits, -1).astype(np.int32).reshape(u.shape)

        return identify

    def test_it_sees_what_shows_and_drops_the_rest(self):
        city = city_of((WALL, 10), (box(0, 40, 10, 50), 8), (box(20, 40, 30, 50), 60), (box(4, -20, 6, 20), 5, 6))
        views = []
        extract = item_buffer_extractor(self.drawn_by_rays(city, views), resolution=64)
        selection = extract(everything(city, cell_along_x()))
        assert selection.objects.tolist() == [0, 2, 3]
        assert len(views) == 6 * len(sample_viewpoints(cell_along_x(), reach=2.0))

    def test_points_inside_a_solid_do_not_count(self):
        city = city_of((box(-100, 2.5, 110, 30), 10), (box(0, 40, 10, 50), 8))
        views = []
        selection = item_buffer_extractor(self.drawn_by_rays(city, views), resolution=64)(
            everything(city, cell_along_x())
        )
        assert selection.objects.tolist() == [0]
        assert views
        assert all(view.eye[1] < 2.5 for view in views)

    @settings(max_examples=20, deadline=None)
    @given(CITIES, CELLS)
    def test_its_set_lies_inside_the_conservative_one(self, solids, cell):
        city = city_of(*solids)
        start = everything(city, cell)
        drawn = item_buffer_extractor(self.drawn_by_rays(city), resolution=32, spacing=5.0)(start)
        swept = horizon_extractor(prepare_horizon(city))(start)
        assert np.isin(drawn.objects, swept.objects).all()

    def test_nonsense(self):
        with pytest.raises(ParameterError):
            item_buffer_extractor(self.drawn_by_rays(city_of((WALL, 10))), resolution=0)

    def test_a_panorama_shows_every_direction_once(self):
        eye = np.array([3.0, 4.0, 1.9])
        views = panorama(eye, resolution=64, rise=0.5, fall=0.2)
        rng = np.random.default_rng(5)
        azimuth, slope = rng.uniform(0.0, 2.0 * math.pi, 2000), rng.uniform(-0.2, 0.5, 2000)
        points = eye + np.column_stack([np.cos(azimuth), np.sin(azimuth), slope])
        shown = np.zeros(2000, dtype=int)
        for view in views:
            u, v, depth = view.project(points).T
            left, top, width, height = view.window
            shown += (depth > 0) & (left <= u) & (u < left + width) & (top <= v) & (v < top + height)
        assert np.all(shown == 1)


class TestOracle:
    def test_walls_roofs_undersides_and_ground(self):
        rays = PrismRays(city_of((box(10, -1, 12, 1), 0, 3), (box(20, -50, 90, 50), 5, 6)))
        origin = np.array([0.0, 0.0, 1.0])
        directions = [[1, 0, 0], [1, 0, 1], [1, 0.5, 0.18], [1, 0.5, 0.09], [-1, 0, 0], [1, 0.5, 0.3], [1, 0, -0.2]]
        hits = rays.first_hits(np.broadcast_to(origin, (7, 3)), np.array(directions, dtype=float))
        # front wall; over everything; underside; leaves below it; away; front of the slab... and the ground in between
        assert hits.tolist() == [0, -1, 1, 1, -1, -1, -1]
        above = rays.first_hits(np.array([[0.0, 0.0, 20.0]]), np.array([[1.0, 0.0, -0.5]]))
        assert above.tolist() == [1]

    def test_viewpoints_lie_in_the_cell(self):
        cell = ViewingCell("0000-00", (1.0, 2.0), (4.0, 6.0), 1.5, (1.5, 1.9))
        points = viewpoints_within(cell, 500, np.random.default_rng(1))
        assert shapely.covers(Polygon(cell.corners).buffer(1e-9), shapely.points(points[:, :2])).all()
        assert 1.5 <= points[:, 2].min() < points[:, 2].max() <= 1.9


PARIS, MANHATTAN = SHARED / "paris_9e/map.osm", SHARED / "nyc_west_village/nyc.osm.pbf"


@pytest.mark.parametrize(
    "path",
    with_slow((HELSINKI, PARIS, MANHATTAN), {PARIS, MANHATTAN}),
    ids=lambda path: path.parent.name,
)
def test_a_million_rays_in_a_real_city(path):
    city, _ = read_city(real(path))
    graph = viewing_cells(city)
    scene, caster, rng = prepare_horizon(city), PrismRays(city), np.random.default_rng(11)
    swept = hit = 0
    for name in spread(graph, 10):
        cell = graph.nodes[name]["cell"]
        found, _ = horizon_visible(scene, cell)
        hits = np.unique(caster.first_hits(*searching_rays(city, cell, 100_000, rng)))
        missing = np.setdiff1d(hits[hits >= 0], found)
        assert not missing.size, f"cell {name}: {[city.objects[i].id for i in missing]} hit, not in the set"
        swept, hit = swept + len(found), hit + np.count_nonzero(hits >= 0)
    assert swept < 1.7 * hit


def test_all_of_a_mesh_that_a_street_cuts_into_hides_nothing():
    """A long shell without a roof, in parts: from inside one of them there is no wall before the next."""
    corners = [(0, 0), (80, 0), (80, 10), (0, 10)]
    ends = zip(corners, (*corners[1:], corners[0]), strict=True)
    walls = np.array([[(*a, 0), (*b, 0), (*b, 8), (*a, 8)] for a, b in ends], dtype=float)
    mesh = TriangleMesh(walls.reshape(-1, 3), [[4 * i, 4 * i + k, 4 * i + k + 1] for i in range(4) for k in (1, 2)])
    shell = Prism(box(0, 0, 80, 10), 0.0, 8.0)
    town = city_of((box(150, 0, 160, 10), 20))
    town = dataclasses.replace(town, objects=(CityObject("shell", (shell,), mesh, (shell,)), *town.objects))
    scene = prepare_horizon(cut_objects(town, 40.0))
    assert [one.id for one in scene.city.objects] == ["shell#0", "shell#1", "solid/0"]
    inside, outside = (ViewingCell("0000-00", (x, 5.0), (x + 5.0, 5.0), 1.0, (1.6, 1.8)) for x in (10.0, -30.0))
    assert horizon_visible(scene, inside)[0].tolist() == [0, 1, 2]
    assert 2 not in horizon_visible(scene, outside)[0]
