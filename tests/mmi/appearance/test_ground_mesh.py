from __future__ import annotations

import networkx as nx
import numpy as np
import pytest
import shapely
from cities import HELSINKI
from hills import waves
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import LineString, Point, Polygon, box

from mmi.appearance.city_mesh import object_boxes
from mmi.appearance.ground_mesh import ground_mesh
from mmi.city.model import City, CityObject, Prism
from mmi.city.terrain import Terrain
from mmi.reading.read_city import read_city


def crossroads(ground: float = 0.0) -> City:
    streets = nx.MultiGraph()
    for i, (x, y) in enumerate([(100, 0), (0, 100), (-100, 0), (0, -100)]):
        streets.add_edge(
            0, i + 1, geometry=LineString([(0, 0), (x, y)]), half_width=4.0, kind="street", name="", index=i
        )
    house = CityObject("a", (Prism(box(20, 20, 60, 50), ground, ground + 12.0),))
    return City((house,), streets, "EPSG:32631", (0.0, 0.0, 0.0), "test", ground)


def color_at(mesh, x: float, y: float) -> tuple[int, int, int]:
    polygons = [Polygon(t) for t in mesh.positions[mesh.triangles][:, :, :2]]
    hits = [i for i, polygon in enumerate(polygons) if polygon.contains(Point(x, y))]
    assert len(hits) == 1
    return tuple(mesh.colors[mesh.triangles[hits[0], 0]].tolist())


def test_the_ground_is_covered_once_and_faces_up():
    mesh = ground_mesh(crossroads(2.0), margin=50.0, tile=500.0)
    assert (mesh.positions[:, 2] == 2.0).all()
    a, b, c = mesh.positions[mesh.triangles].astype(float)[..., :2].swapaxes(0, 1)
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert (area >= 0.0).all()
    assert area.sum() == pytest.approx(300.0**2, rel=1e-6)
    whole = shapely.union_all(
        [Polygon(t) for t in mesh.positions[mesh.triangles][:, :, :2].astype(float)], grid_size=1e-3
    )
    assert whole.area == pytest.approx(300.0**2, rel=1e-5)
    assert mesh.triangle_counts.tolist() == [len(mesh.triangles)]


def test_streets_have_kerbs_pavements_and_grass_beyond():
    mesh = ground_mesh(crossroads(), margin=50.0)
    road, kerb, pavement, grass = (color_at(mesh, 80.1, y) for y in (1.03, 4.12, 6.01, -60.2))
    assert len({road, kerb, pavement, grass}) == 4
    assert sum(road) < sum(grass) < sum(kerb)
    assert color_at(mesh, 40.3, 35.2) == pavement  # below the house
    assert color_at(mesh, 65.1, 35.2) == pavement  # around it
    assert color_at(mesh, 90.1, 90.2) == grass


def test_a_city_without_streets_has_ground():
    house = CityObject("a", (Prism(box(0, 0, 10, 10), 0.0, 12.0),))
    mesh = ground_mesh(City((house,), nx.MultiGraph(), "EPSG:32631", (0.0, 0.0, 0.0), "test"), margin=30.0)
    low, high = mesh.positions.min(axis=0), mesh.positions.max(axis=0)
    assert (low[:2] == -30.0).all()
    assert (high[:2] == 40.0).all()


# Tiles


def areas(mesh) -> np.ndarray:
    a, b, c = mesh.positions[mesh.triangles].astype(float)[..., :2].swapaxes(0, 1)
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def cuts_along(mesh, tile: int, axis: int, line: float) -> list[tuple[float, float]]:
    """The sides of a tile's triangles that lie along the line where coordinate ``axis`` is ``line``, from low to high."""
    corners = mesh.positions[mesh.triangles[mesh.object_triangles[tile] : mesh.object_triangles[tile + 1]]]
    sides = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2, 3)
    sides = sides[(sides[:, :, axis] == np.float32(line)).all(axis=1)]
    return sorted(tuple(sorted(side.tolist())) for side in sides[:, :, 1 - axis])


def assert_tiles_fit(mesh) -> None:
    """Every tile is full, and neighbours meet vertex to vertex: sides along their border are the same on either side."""
    bounds = object_boxes(mesh)[:, :, :2].reshape(-1, 4)
    per_tile = np.add.reduceat(areas(mesh), mesh.object_triangles[:-1])
    np.testing.assert_allclose(per_tile, np.prod(bounds[:, 2:] - bounds[:, :2], axis=1), rtol=1e-5, atol=1e-3)
    assert bounds[np.lexsort((bounds[:, 0], bounds[:, 1]))].tolist() == bounds.tolist()  # row by row
    borders = 0
    for i, low in enumerate(bounds):
        for j, high in enumerate(bounds):
            for axis in (0, 1):
                if low[axis + 2] != high[axis] or (low[[1 - axis, 3 - axis]] != high[[1 - axis, 3 - axis]]).any():
                    continue
                one, other = (cuts_along(mesh, k, axis, high[axis]) for k in (i, j))
                assert one == other
                assert [a for a, _ in one[1:]] == [b for _, b in one[:-1]]
                assert (one[0][0], one[-1][1]) == (low[1 - axis], low[3 - axis])
                borders += 1
    columns, rows = (len(np.unique(bounds[:, k])) for k in (0, 1))
    assert len(bounds) == columns * rows
    assert borders == (columns - 1) * rows + columns * (rows - 1)


def test_tiles_fit_and_show_the_same_ground():
    whole, tiled = (ground_mesh(crossroads(2.0), margin=50.0, tile=tile) for tile in (1000.0, 40.0))
    assert object_boxes(whole).tolist() == [[[-150.0, -150.0, 2.0], [150.0, 150.0, 2.0]]]
    assert len(object_boxes(tiled)) == 8 * 8
    assert_tiles_fit(tiled)
    for x, y in np.random.default_rng(3).uniform(-149.0, 149.0, (60, 2)):
        assert color_at(tiled, x, y) == color_at(whole, x, y)


@settings(deadline=None, max_examples=25)
@given(
    lines=st.lists(st.lists(st.tuples(st.integers(0, 30), st.integers(0, 30)), min_size=2, max_size=4), max_size=4),
    houses=st.lists(st.tuples(*[st.integers(0, 25)] * 2, *[st.integers(1, 9)] * 2), min_size=1, max_size=5),
    tile=st.sampled_from([7.0, 10.0, 16.0]),
    shift=st.sampled_from([0.0, 3333.3]),
)
def test_tiles_fit_whatever_lies_on_their_borders(lines, houses, tile, shift):
    """Whole numbers make streets and pavements end on borders, at corners, and run along them."""
    streets = nx.MultiGraph()
    for i, line in enumerate(lines):
        points = [(x + shift, y + shift) for x, y in line]
        if LineString(points).length > 0.0:
            streets.add_edge(2 * i, 2 * i + 1, geometry=LineString(points), half_width=3.0, kind="", name="", index=i)
    objects = tuple(
        CityObject(str(i), (Prism(box(x + shift, y + shift, x + shift + w, y + shift + d), 0.0, 9.0),))
        for i, (x, y, w, d) in enumerate(houses)
    )
    city = City(objects, streets, "EPSG:32631", (0.0, 0.0, 0.0), "test")
    mesh = ground_mesh(city, margin=10.0, tile=tile)
    assert_tiles_fit(mesh)
    assert areas(mesh).min() > -2e-3


def test_tiles_of_a_real_city_fit():
    city, _ = read_city(HELSINKI)
    mesh = ground_mesh(city, margin=300.0)
    assert (np.ptp(object_boxes(mesh), axis=1) <= 200.0).all()
    assert_tiles_fit(mesh)


def test_carriageways_of_a_real_city_are_its_streets_as_wide_as_they_are():
    city, _ = read_city(HELSINKI)
    mesh = ground_mesh(city, margin=300.0)
    edges = [edge for _, _, edge in city.streets.edges(data=True)]
    plain = shapely.union_all([edge["geometry"].buffer(edge["half_width"], quad_segs=3) for edge in edges])
    road = (mesh.colors[mesh.triangles[:, 0]] == np.rint(255.0 * np.array([0.46, 0.46, 0.47]))).all(axis=1)
    shown = shapely.union_all(shapely.polygons(mesh.positions[mesh.triangles[road], :2].astype(float)))
    assert shapely.symmetric_difference(plain, shown).buffer(-0.011).is_empty  # thinned by 2 cm at most
    assert shown.area == pytest.approx(plain.area, rel=1e-3)


# Hills


def hilly(lines, houses, terrain, *, half_width=3.0):
    streets = nx.MultiGraph()
    for i, line in enumerate(lines):
        streets.add_edge(2 * i, 2 * i + 1, geometry=LineString(line), half_width=half_width, kind="", name="", index=i)
    objects = tuple(CityObject(str(i), (Prism(one, 0.0, 90.0),)) for i, one in enumerate(houses))
    return City(objects, streets, "EPSG:32631", (0.0, 0.0, 0.0), "test", terrain=terrain)


def assert_ground_is_the_terrain(mesh, terrain, *, within) -> None:
    """Every vertex, and points inside of triangles ``within`` metres; that gaps have no room, ``assert_tiles_fit`` tells."""
    points = mesh.positions.astype(float)
    assert np.abs(points[:, 2] - terrain.at(points)).max() < 1e-4
    corners = points[mesh.triangles]
    plan = corners[:, :, :2]
    # Nowhere across a line of the grid, where the ground has an edge.
    low, high = (end(plan, axis=1) for end in (np.min, np.max))
    square = (0.5 * (low + high) - terrain.origin) // terrain.spacing
    edges = np.array(terrain.origin) + terrain.spacing * square
    x0, y0, x1, y1 = terrain.bounds
    inside = ((low > (x0, y0)) & (high < (x1, y1))).all(axis=1)
    assert (low >= edges - 1e-3)[inside].all()
    assert (high <= edges + terrain.spacing + 1e-3)[inside].all()
    inner = np.einsum("kc,mcx->kmx", np.random.default_rng(0).dirichlet(np.ones(3), 6), corners).reshape(-1, 3)
    assert np.abs(inner[:, 2] - terrain.at(inner)).max() < within


def test_the_ground_of_a_hilly_city_is_its_terrain():
    terrain = waves(3, size=150.0)
    twist = np.diff(np.diff(terrain.heights, axis=0), axis=1)
    city = hilly([[(-80, -60), (0, 10), (90, 20)], [(0, 10), (-20, 90)]], [box(20, 40, 50, 60)], terrain)
    mesh = ground_mesh(city, margin=40.0, tile=60.0)
    assert_tiles_fit(mesh)
    assert_ground_is_the_terrain(mesh, terrain, within=0.26 * np.abs(twist).max())
    assert np.ptp(mesh.positions[:, 2]) > 10.0
    assert areas(mesh).min() > -2e-3
    assert len({tuple(color) for color in mesh.colors.tolist()}) > 50  # shaded


@settings(deadline=None, max_examples=20)
@given(
    lines=st.lists(st.lists(st.tuples(st.integers(0, 30), st.integers(0, 30)), min_size=2, max_size=4), max_size=3),
    houses=st.lists(st.tuples(*[st.integers(0, 25)] * 2, *[st.integers(1, 9)] * 2), min_size=1, max_size=4),
    tile=st.sampled_from([9.0, 16.0, 200.0]),
    grid=st.tuples(st.sampled_from([-12.0, 0.0, 3.3]), st.sampled_from([2.0, 4.7, 10.0]), st.integers(2, 8)),
    shift=st.sampled_from([0.0, 3333.3]),
)
def test_tiles_on_hills_fit_whatever_lies_on_the_lines_of_the_terrain(lines, houses, tile, grid, shift):
    """Grids that end within the city or reach beyond it; streets and houses along their lines and across them."""
    start, spacing, count = grid
    heights = np.random.default_rng(count).uniform(0.0, 0.3 * spacing, (count, count + 1))
    terrain = Terrain((start + shift, start + shift), spacing, heights)
    moved = [[(x + shift, y + shift) for x, y in line] for line in lines if LineString(line).length > 0.0]
    boxes = [box(x + shift, y + shift, x + shift + w, y + shift + d) for x, y, w, d in houses]
    mesh = ground_mesh(hilly(moved, boxes, terrain), margin=10.0, tile=tile)
    assert_tiles_fit(mesh)
    assert areas(mesh).min() > -2e-3
    assert_ground_is_the_terrain(mesh, terrain, within=0.3 * spacing)


def test_level_terrain_looks_like_flat_ground():
    plain = crossroads(2.0)
    level = City(
        plain.objects,
        plain.streets,
        plain.crs,
        plain.origin,
        plain.source,
        terrain=Terrain((-200, -200), 50.0, np.full((9, 9), 2.0)),
    )
    one, other = (ground_mesh(city, margin=50.0, tile=100.0) for city in (plain, level))
    assert (other.positions[:, 2] == 2.0).all()
    for x, y in np.random.default_rng(3).uniform(-149.0, 149.0, (60, 2)):
        assert color_at(one, x, y) == color_at(other, x, y)


def test_slopes_towards_the_sun_are_lighter():
    """It shines from the south-west."""
    sides = {}
    for name, slope in (("south", (0.0, 0.3)), ("north", (0.0, -0.3)), ("west", (0.3, 0.0)), ("east", (-0.3, 0.0))):
        x, y = np.meshgrid(np.linspace(-200, 200, 9), np.linspace(-200, 200, 9))
        city = hilly([], [box(0, 0, 10, 10)], Terrain((-200.0, -200.0), 50.0, slope[0] * x + slope[1] * y))
        sides[name] = ground_mesh(city, margin=50.0).colors.mean()
    assert min(sides["south"], sides["west"]) > 1.03 * max(sides["north"], sides["east"])


def test_buildings_that_are_above_the_highest_ground_below_them_have_no_pavement():
    terrain = Terrain((-200.0, -200.0), 100.0, np.tile(np.linspace(0.0, 40.0, 5), (5, 1)))
    footprint = box(40, -20, 80, 20)
    colors = []
    for bottom in (terrain.at([80.0, 0.0]) + 0.5, 80.0):
        house = CityObject("a", (Prism(footprint, float(bottom), 90.0),))
        city = City((house,), nx.MultiGraph(), "EPSG:32631", (0.0, 0.0, 0.0), "test", terrain=terrain)
        colors.append(color_at(ground_mesh(city, margin=40.0), 60.3, 5.1))
    assert colors[0] != colors[1]
