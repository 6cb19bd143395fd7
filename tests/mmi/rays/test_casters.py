"""Grid and Embree find what testing every triangle finds: in soups, at edges and borders, in flat scenes, in real cities."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from selection import with_slow
from soups import random_directions, random_soup, soup_mesh

from mmi.appearance.city_mesh import build_city_mesh
from mmi.rays.brute_force import brute_force
from mmi.rays.casters import make_caster
from mmi.reading.read_city import read_city

ROOT = Path(__file__).resolve().parents[3]
DATA = ROOT.parent / "shared" / "data"
KINDS = ("grid", "embree")
CITIES = {
    "helsinki": ROOT / "examples" / "helsinki" / "helsinki.osm.pbf",
    "geores": DATA / "geores_textured" / "geoRES_testdata.xml",
    "denhaag": DATA / "denhaag_cityjson" / "DenHaag_01.json",
}


def assert_same_hits(found, expected, mesh, origins, directions, *, tolerance=2e-3):
    """Hits are the same, but for rays that pass an edge within roundings of float32, and those are as far away."""
    other = found.triangle != expected.triangle
    assert other.mean() <= 1e-3, f"{other.sum()} of {len(other)} rays hit other triangles"
    same = ~other & (expected.triangle >= 0)
    np.testing.assert_allclose(found.distance[same], expected.distance[same], atol=tolerance, rtol=1e-5)
    np.testing.assert_allclose(found.weights[same], expected.weights[same], atol=5e-2)
    np.testing.assert_array_equal(found.distance[expected.triangle < 0][~other[expected.triangle < 0]], np.inf)
    origins = np.broadcast_to(origins, directions.shape)
    for r in np.flatnonzero(other):
        gaps = [
            edge_gap(mesh, one.triangle[r], origins[r] + one.distance[r].astype(np.float64) * directions[r])
            for one in (found, expected)
            if one.triangle[r] >= 0
        ]
        assert min(gaps) < 0.01, f"ray {r}: {found.triangle[r]} instead of {expected.triangle[r]}, {gaps} m from edges"


def edge_gap(mesh, triangle, point):
    """Metres from a point to the nearest edge of a triangle."""
    corners = mesh.positions[mesh.triangles[triangle]].astype(np.float64)
    gaps = []
    for a, b in zip(corners, np.roll(corners, 1, axis=0), strict=True):
        length = (b - a) @ (b - a)
        along = np.clip((point - a) @ (b - a) / length, 0.0, 1.0) if length else 0.0
        gaps.append(np.linalg.norm(a + along * (b - a) - point))
    return min(gaps)


def hold(mesh, origins, directions, *, kind, nearest=0.0, workers=1):
    """Check a caster against brute force."""
    expected = brute_force(mesh).first_hits(origins, directions, nearest=nearest)
    found = make_caster(mesh, kind=kind, workers=workers).first_hits(origins, directions, nearest=nearest)
    assert_same_hits(found, expected, mesh, origins, directions)
    return expected


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("count", [1, 2, 17, 400])
@pytest.mark.parametrize("nearest", [0.0, 4.0])
def test_soups(kind, count, nearest):
    rng = np.random.default_rng(count)
    mesh = soup_mesh(random_soup(rng, count))
    origins = rng.uniform(-15.0, 25.0, size=(3000, 3))
    expected = hold(mesh, origins, random_directions(rng, 3000), kind=kind, nearest=nearest)
    assert count == 1 or (expected.triangle >= 0).any()


@pytest.mark.parametrize("kind", KINDS)
def test_long_thin_triangles(kind):
    rng = np.random.default_rng(3)
    corners = rng.uniform(-500.0, 500.0, size=(60, 3, 3))
    corners[:, 2] = corners[:, 1] + rng.normal(size=(60, 3))
    tiny = rng.uniform(-20.0, 20.0, size=(500, 1, 3)) + 0.05 * rng.normal(size=(500, 3, 3))
    mesh = soup_mesh(np.concatenate([corners, tiny]))
    hold(mesh, rng.uniform(-30.0, 30.0, size=(2000, 3)), random_directions(rng, 2000), kind=kind)


@pytest.mark.parametrize("kind", KINDS)
def test_threads_change_nothing(kind):
    rng = np.random.default_rng(5)
    mesh = soup_mesh(random_soup(rng, 300))
    origin, directions = np.array([5.0, 5.0, 1.0]), random_directions(rng, 20_000)
    one, three = (make_caster(mesh, kind=kind, workers=w).first_hits(origin, directions) for w in (1, 3))
    for name in ("triangle", "distance", "weights"):
        np.testing.assert_array_equal(getattr(one, name), getattr(three, name))


@pytest.mark.parametrize("kind", KINDS)
def test_a_city_without_triangles(kind):
    hits = make_caster(soup_mesh(np.zeros((0, 3, 3))), kind=kind, workers=2).first_hits(np.zeros(3), np.eye(3))
    assert hits.triangle.tolist() == [-1, -1, -1]
    assert np.isinf(hits.distance).all()
    assert not hits.weights.any()


@pytest.mark.parametrize("kind", KINDS)
def test_no_rays(kind):
    mesh = soup_mesh(random_soup(np.random.default_rng(0), 5))
    hits = make_caster(mesh, kind=kind, workers=2).first_hits(np.zeros((0, 3)), np.zeros((0, 3)))
    assert hits.triangle.shape == hits.distance.shape == (0,)
    assert hits.weights.shape == (0, 2)


@pytest.mark.parametrize("kind", KINDS)
def test_rays_of_other_shapes_are_refused(kind):
    caster = make_caster(soup_mesh(np.zeros((1, 3, 3))), kind=kind, workers=1)
    for origins, directions in (((3,), (3,)), ((2, 3), (4, 3)), ((3,), (4, 2))):
        with pytest.raises(ValueError, match=r"expected|need"):
            caster.first_hits(np.zeros(origins), np.zeros(directions))


@pytest.mark.parametrize("kind", KINDS)
def test_rays_without_a_direction_hit_nothing(kind):
    mesh = soup_mesh(random_soup(np.random.default_rng(0), 50))
    directions = np.array([[0.0, 0.0, 0.0], [np.nan, 1.0, 0.0], [np.nan, np.nan, np.nan]])
    assert (make_caster(mesh, kind=kind, workers=1).first_hits(np.ones(3), directions).triangle == -1).all()


@pytest.mark.parametrize("kind", KINDS)
def test_hits_nearer_than_asked_do_not_count(kind):
    walls = [[[x, -50.0, -50.0], [x, 50.0, -50.0], [x, 0.0, 80.0]] for x in (5.0, 99.0, 101.0, 300.0)]
    caster = make_caster(soup_mesh(walls), kind=kind, workers=1)
    found = [caster.first_hits(np.zeros(3), [[1.0, 0.0, 0.0]], nearest=near) for near in (0.0, 100.0, 200.0, 400.0)]
    assert [one.triangle[0] for one in found] == [0, 2, 3, -1]
    assert [one.distance[0] for one in found] == [5.0, 101.0, 300.0, np.inf]


@pytest.mark.parametrize("kind", KINDS)
def test_weights_are_those_of_the_point(kind):
    rng = np.random.default_rng(11)
    mesh = soup_mesh(random_soup(rng, 100, size=3.0))
    origin, directions = np.array([5.0, 5.0, 1.0]), random_directions(rng, 3000)
    hits = make_caster(mesh, kind=kind, workers=1).first_hits(origin, directions)
    hit = hits.triangle >= 0
    a, b, c = mesh.positions[mesh.triangles[hits.triangle[hit]]].astype(np.float64).transpose(1, 0, 2)
    v, w = hits.weights[hit].astype(np.float64).T[:, :, None]
    points = (1.0 - v - w) * a + v * b + w * c
    assert hit.sum() > 500
    np.testing.assert_allclose(points, origin + hits.distance[hit, None] * directions[hit], atol=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_no_ray_slips_through_shared_edges(kind):
    """Rays from within a closed surface of many triangles, aimed at its edges and corners, all hit."""
    rng = np.random.default_rng(2)
    steps = np.linspace(-1.0, 1.0, 6)
    p, q = (one.ravel() for one in np.meshgrid(np.arange(5), np.arange(5)))
    cells = [
        np.stack([steps[p + i], steps[q + j], np.ones(len(p))], axis=1) for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))
    ]
    side = np.concatenate([np.stack([cells[0], cells[i], cells[i + 1]], axis=1) for i in (1, 2)])
    cube = np.concatenate([np.roll(side * s, k, axis=-1) for k in range(3) for s in (1.0, -1.0)])
    corners = (cube / np.linalg.norm(cube, axis=-1, keepdims=True) * 731.7 + (3001.3, -4002.7, 55.5)).astype(np.float32)
    ends = corners[rng.integers(len(corners), size=20_000)].astype(np.float64)
    at = rng.random((len(ends), 1))
    targets = np.where(rng.random((len(ends), 1)) < 0.2, ends[:, 0], ends[:, 0] + at * (ends[:, 1] - ends[:, 0]))
    origin = np.array([3100.1, -3900.3, 33.3])
    directions = (targets - origin) / np.linalg.norm(targets - origin, axis=1, keepdims=True)
    hits = make_caster(soup_mesh(corners), kind=kind, workers=1).first_hits(origin, directions, nearest=100.0)
    assert (hits.triangle >= 0).all()
    np.testing.assert_allclose(hits.distance, np.linalg.norm(targets - origin, axis=1), rtol=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_flat_scenes(kind):
    """All triangles at one height: met from above and below, and passed by level rays, in their plane as well."""
    rng = np.random.default_rng(4)
    corners = random_soup(rng, 200, spread=(100.0, 100.0, 0.0), size=4.0)
    corners[..., 2] = 7.0
    origins = rng.uniform(-10.0, 110.0, size=(2000, 3)) * (1.0, 1.0, 0.1)
    expected = hold(soup_mesh(corners), origins, random_directions(rng, 2000), kind=kind)
    assert (expected.triangle >= 0).sum() > 100
    level = random_directions(rng, 500, flatness=0.0)
    for height in (6.9, 7.0):
        assert (hold(soup_mesh(corners), np.array([50.0, 50.0, height]), level, kind=kind).triangle == -1).all()


@pytest.mark.parametrize("kind", KINDS)
def test_triangles_without_area_are_not_hit(kind):
    rng = np.random.default_rng(8)
    corners = np.rint(random_soup(rng, 300, size=2.0))
    corners[::3, 2] = corners[::3, 1]
    corners[1::6] = corners[1::6, :1]
    mesh = soup_mesh(corners)
    expected = hold(
        mesh,
        np.add(np.rint(rng.uniform(-5.0, 15.0, (2000, 3))), (0.3719, 0.1123, 0.7301)),
        random_directions(rng, 2000),
        kind=kind,
    )
    assert not (expected.triangle % 3 == 0)[expected.triangle >= 0].any()


whole = st.integers(-6, 6)
triangles = st.lists(st.tuples(*[st.tuples(whole, whole, whole)] * 3), min_size=0, max_size=12)
axes = st.sampled_from([sign * np.eye(3)[k] for k in range(3) for sign in (1.0, -1.0)])
halves = st.integers(-16, 16).map(lambda n: 0.5 * n)


@settings(max_examples=40, deadline=None)
@given(triangles, st.lists(st.tuples(st.tuples(halves, halves, halves), axes), min_size=1, max_size=20))
def test_rays_along_axes_and_borders_of_cells(corners, rays):
    """Whole coordinates, so that rays run along edges, borders of cells and the sides of the grid, and roundings are none."""
    mesh = soup_mesh(np.array(corners, dtype=np.float64).reshape(-1, 3, 3))
    origins, directions = (np.array(one, dtype=np.float64) for one in zip(*rays, strict=True))
    expected = brute_force(mesh).first_hits(origins, directions)
    found = make_caster(mesh, kind="grid", workers=1).first_hits(origins, directions)
    np.testing.assert_array_equal(found.triangle >= 0, expected.triangle >= 0)
    np.testing.assert_allclose(found.distance, expected.distance, rtol=1e-6)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 60), st.sampled_from([0.1, 1.0, 30.0]), st.sampled_from([0.0, 3.0]))
def test_any_soup(seed, count, size, nearest):
    rng = np.random.default_rng(seed)
    mesh = soup_mesh(random_soup(rng, count, size=size))
    origins = rng.uniform(-5.0, 15.0, size=(200, 3))
    hold(mesh, origins, random_directions(rng, 200, flatness=rng.random()), kind="grid", nearest=nearest)


@pytest.mark.parametrize("name", with_slow(CITIES, {"denhaag"}))
def test_real_cities(name):
    """Half of the rays are aimed at triangles, half are nearly level."""
    if not CITIES[name].exists():
        pytest.skip("needs the cities of ../shared/data")
    mesh = build_city_mesh(read_city(CITIES[name])[0])
    rng = np.random.default_rng(1)
    low, high = mesh.positions.min(axis=0), mesh.positions.max(axis=0)
    origins = rng.uniform(low, high, size=(40, 3))
    origins[:28, 2] = low[2] + 1.7
    directions = random_directions(rng, 40, flatness=0.2)
    aims = mesh.positions[mesh.triangles[rng.integers(len(mesh.triangles), size=20)]].mean(axis=1) - origins[::2]
    directions[::2] = aims / np.linalg.norm(aims, axis=1, keepdims=True)
    casters = [make_caster(mesh, kind=kind, workers=1) for kind in KINDS]
    for nearest in (0.0, 20.0):
        expected = brute_force(mesh).first_hits(origins, directions, nearest=nearest, pixel_angle=0.002)
        assert (expected.triangle >= 0).sum() > 10
        for caster in casters:
            found = caster.first_hits(origins, directions, nearest=nearest, pixel_angle=0.002)
            assert_same_hits(found, expected, mesh, origins, directions)
