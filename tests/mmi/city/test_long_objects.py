"""Long objects in parts: nothing is moved, lost or doubled, and parts are as long as they should be."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from cities import block, city_of, crossroads
from closed_meshes import directed_edges, is_closed, outside_prisms, volume
from hypothesis import given, settings
from hypothesis import strategies as st
from model_cities import BOX_TRIANGLES, box_corners, dressed_box, model_city
from shapely import affinity
from shapely.geometry import Polygon, box
from solids import Solids

from mmi.appearance.city_mesh import build_city_mesh
from mmi.appearance.facades import blind_strip
from mmi.appearance.shading import looks_of
from mmi.city.long_objects import cut_objects
from mmi.city.model import PAINTED, CityObject, Prism, TriangleMesh
from mmi.foundation.errors import ParameterError
from mmi.planning.parameters import BuildParameters
from mmi.planning.plan import landmark_factors

HORSESHOE = Polygon([(0, 0), (100, 0), (100, 60), (85, 60), (85, 15), (15, 15), (15, 60), (0, 60)])
YARD = Polygon(box(0, 0, 90, 70).exterior, [box(20, 20, 70, 50).exterior.coords])


def lengths(one):
    """The sides of the smallest rectangle around an object, in some order."""
    corners = shapely.get_coordinates(shapely.oriented_envelope(one.footprint))
    return np.hypot(*(corners[1:3] - corners[:2]).T)


def turned(shape, degrees=17.0):
    return affinity.rotate(shape, degrees, origin=(0.0, 0.0))


def turn_back(degrees):
    """(2, 2): what points (n, 2) are multiplied with to undo :func:`turned`."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[c, -s], [s, c]])


def solid(shape, name="long", top=12.0):
    return CityObject(name, (Prism(shape, 0.0, top),))


def tube(points, top=9.0):
    """A closed mesh over a convex outline, its wall a fan of slanting triangles."""
    n = len(points)
    low, high = np.column_stack([points, np.zeros(n)]), np.column_stack([points, np.full(n, top)])
    fan = [(0, i, i + 1) for i in range(1, n - 1)]
    walls = [t for i in range(n) for j in [(i + 1) % n] for t in ((i, j, n + j), (i, n + j, n + i))]
    triangles = [(a, c, b) for a, b, c in fan] + [(n + a, n + b, n + c) for a, b, c in fan] + walls
    return TriangleMesh(np.vstack([low, high]), np.array(triangles, dtype=np.int32))


@pytest.mark.parametrize("shape", [box(0, 0, 100, 12), HORSESHOE, YARD], ids=["bar", "horseshoe", "yard"])
@pytest.mark.parametrize("degrees", [0.0, 17.0, 45.0])
def test_parts_are_the_whole_and_no_longer_than_asked_for(shape, degrees):
    whole = solid(turned(shape, degrees))
    cut = cut_objects(city_of(whole), 30.0)
    assert [one.id for one in cut.objects] == [f"long#{k}" for k in range(len(cut.objects))]
    assert {one.part_of for one in cut.objects} == {"long"}
    footprints = [one.footprint for one in cut.objects]
    assert shapely.area(footprints).sum() == pytest.approx(whole.footprint.area, rel=1e-9)
    assert shapely.union_all(footprints).symmetric_difference(whole.footprint).area < 1e-6
    assert all((prism.bottom, prism.top) == (0.0, 12.0) for one in cut.objects for prism in one.prisms)
    # Tiles are at most 30 x 30; what fills one less may lie across it.
    assert max(lengths(one).max() for one in cut.objects) <= math.hypot(30.0, 30.0) + 1e-6
    if shape.equals(box(0, 0, 100, 12)):
        assert [round(max(lengths(one)), 6) for one in cut.objects] == [25.0] * 4


def test_what_is_short_or_cut_already_stays():
    city = crossroads()
    assert cut_objects(city, None) is city
    assert cut_objects(city, 60.0) is city
    cut = cut_objects(city, 40.0)
    assert len(cut.objects) == 4 * len(city.objects)
    assert cut_objects(cut, 40.0) is cut
    assert cut_objects(cut, 10.0) is cut
    assert cut_objects(city_of(), 40.0).objects == ()


def test_ids_that_look_like_those_of_parts_are_no_trouble():
    city = city_of(solid(box(0, 0, 100, 12), "Mesh"), block("Mesh#0", 0, 50, 10, 60, 5.0))
    names = [one.id for one in cut_objects(city, 60.0).objects]
    assert names == ["Mesh##0", "Mesh##1", "Mesh#0"]


def test_a_landscape_is_cut_too():
    """Two kilometres of ground that somebody called a building."""
    cut = cut_objects(city_of(solid(box(0, 0, 2_000, 1_800), "land", 1.0)), 40.0)
    assert len(cut.objects) == 50 * 45
    assert sum(one.footprint.area for one in cut.objects) == pytest.approx(3.6e6)


def test_parts_of_buildings_with_towers_and_cores():
    tower = Prism(box(40, 0, 60, 12), 12.0, 40.0)
    one = CityObject("x", (Prism(box(0, 0, 100, 12), 0.0, 12.0), tower), core=(Prism(box(1, 1, 99, 11), 0.0, 12.0),))
    cut = cut_objects(city_of(one), 30.0)
    assert [len(part.prisms) for part in cut.objects] == [1, 2, 2, 1]
    for name, expected in (("prisms", 100 * 12 * 12 + 20 * 12 * 28), ("core", 98 * 10 * 12)):
        volumes = [p.footprint.area * (p.top - p.bottom) for part in cut.objects for p in getattr(part, name)]
        assert sum(volumes) == pytest.approx(expected)


def test_a_corner_with_next_to_nothing_in_it_goes_to_its_neighbour():
    shape = shapely.union_all([box(0, 0, 80, 10), box(37, 10, 40, 40), box(37, 40, 38.5, 41.5)])
    whole = solid(shape)
    cut = cut_objects(city_of(whole), 40.0)
    assert min(one.footprint.area for one in cut.objects) > 4.0
    assert sum(one.footprint.area for one in cut.objects) == pytest.approx(whole.footprint.area)


@settings(deadline=None)
@given(seed=st.integers(0, 10_000), longest=st.floats(10.0, 60.0))
def test_rays_meet_the_same_walls_of_random_shapes(seed, longest):
    """What a ray meets, and where, is the same; of an object's parts, one."""
    rng = np.random.default_rng(seed)
    objects = []
    for k in range(3):
        shape = shapely.MultiPoint(rng.uniform(-60.0, 60.0, (7, 2))).convex_hull
        hole = affinity.scale(shape, 0.5, 0.5, origin="centroid")
        shape = turned(shape.difference(hole if k == 1 else box(-200, -200, -10, 200)), rng.uniform(0.0, 360.0))
        for j, part in enumerate(one for one in shapely.get_parts(shape) if one.area > 1.0):
            objects.append(solid(affinity.translate(part, 150.0 * k), f"{k}.{j}", rng.uniform(5.0, 30.0)))
    city = city_of(*objects)
    cut = cut_objects(city, longest)
    origins = np.column_stack([rng.uniform(-100.0, 400.0, (300, 2)), rng.uniform(35.0, 60.0, 300)])
    towards = np.column_stack([rng.uniform(-60.0, 360.0, (300, 1)), rng.uniform(-60.0, 60.0, (300, 1)), np.zeros(300)])
    far, hits = Solids(city).cast(origins, towards - origins)
    near_far, parts = Solids(cut).cast(origins, towards - origins)
    np.testing.assert_allclose(near_far, far, atol=1e-9)
    names = np.array([*(one.id for one in city.objects), "none"], dtype=object)
    wholes = np.array([*(one.part_of or one.id for one in cut.objects), "none"], dtype=object)
    assert np.mean(names[hits] == wholes[parts]) > 0.995  # but for rays along a wall that two share


def test_a_mesh_is_cut_where_its_prisms_are():
    outline = turned(box(0, 0, 100, 30))
    whole = CityObject("m", (Prism(outline, 0.0, 9.0),), tube(shapely.get_coordinates(outline)[:4]))
    cut = cut_objects(city_of(whole), 40.0)
    assert len(cut.objects) == 3
    area = sum(triangle_areas(one.mesh).sum() for one in cut.objects)
    assert area == pytest.approx(triangle_areas(whole.mesh).sum(), rel=1e-12)
    assert sum(map(outside_prisms, cut.objects)) == 0
    # Put together again it is as closed as it was: both sides of a cut have the same vertices.
    vertices = np.concatenate([one.mesh.vertices for one in cut.objects])
    starts = np.cumsum([0, *(len(one.mesh.vertices) for one in cut.objects)])
    triangles = np.concatenate([one.mesh.triangles + start for one, start in zip(cut.objects, starts, strict=False)])
    again = TriangleMesh(vertices, triangles)
    assert is_closed(whole.mesh)
    assert is_closed(again)
    assert volume(again) == pytest.approx(volume(whole.mesh), rel=1e-12)


def triangle_areas(mesh):
    a, b, c = (mesh.vertices[mesh.triangles[:, i]] for i in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


@settings(deadline=None)
@given(seed=st.integers(0, 10_000))
def test_pictures_stay_where_they_were_on_a_cut_mesh(seed):
    """Texture coordinates that are linear in space still are, each triangle keeps its picture and colour, and its area."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0.0, 100.0, (12, 3))
    if rng.random() < 0.5:  # vertices on cuts
        points = np.round(points / 10.0) * 10.0
    points[:4, :2] = [(0, 0), (100, 0), (100, 100), (0, 100)]
    triangles = np.array([rng.choice(12, 3, replace=False) for _ in range(20)], dtype=np.int32)
    matrix = rng.uniform(-0.1, 0.1, (3, 2))
    textures, colors = np.arange(20, dtype=np.int32) % 2, rng.integers(0, 255, (20, 3)).astype(np.uint8)
    mesh = TriangleMesh(points, triangles, textures, colors, (points @ matrix)[triangles].astype(np.float32))
    city = replace(model_city(), objects=(CityObject("m", (Prism(box(0, 0, 100, 100), -1.0, 101.0),), mesh),))
    cut = cut_objects(city, 50.0)
    areas = np.zeros((2, len(cut.objects)))
    for k, one in enumerate(cut.objects):
        corners = one.mesh.vertices[one.mesh.triangles]
        np.testing.assert_allclose(one.mesh.uv, corners @ matrix, atol=1e-4)
        areas[:, k] = np.bincount(one.mesh.textures, triangle_areas(one.mesh), minlength=2)
        (x0, y0, x1, y1) = one.footprint.bounds
        assert np.all((corners[..., 0] >= x0 - 1e-6) & (corners[..., 0] <= x1 + 1e-6))
        assert np.all((corners[..., 1] >= y0 - 1e-6) & (corners[..., 1] <= y1 + 1e-6))
        assert {tuple(color) for color in one.mesh.colors.tolist()} <= {tuple(color) for color in colors.tolist()}
    expected = np.bincount(textures, triangle_areas(mesh), minlength=2)
    np.testing.assert_allclose(areas.sum(axis=1), expected, rtol=1e-9)


def test_prisms_around_nothing_are_no_part():
    """A mesh may fill less than the prisms that bound it."""
    mesh = TriangleMesh(box_corners(0.0, 0.0, 0.0, 10.0, 10.0, 5.0), BOX_TRIANGLES)
    one = CityObject("m", (Prism(box(0, 0, 100, 10), 0.0, 5.0),), mesh)
    (left,) = cut_objects(city_of(one), 30.0).objects
    assert left is one


def test_parts_look_like_the_whole():
    city = city_of(*(solid(affinity.translate(HORSESHOE, 0.0, 90.0 * k), f"way/{k}", 9.0 + 8.0 * k) for k in range(12)))
    cut = cut_objects(city, 30.0)
    index = city.index()
    of = [index[one.part_of] for one in cut.objects]
    looks, parts = looks_of(city.objects), looks_of(cut.objects)
    for name in ("style", "tint", "bay"):
        assert np.array_equal(getattr(parts, name), getattr(looks, name)[of])


@pytest.mark.parametrize("shape", [box(0, 0, 60, 12), YARD, HORSESHOE], ids=["bar", "yard", "horseshoe"])
def test_walls_along_a_cut_are_painted_like_the_end_of_the_facade(shape):
    """Where a facade ends, the wall along the cut begins with the colour and the texture of its last column."""
    cut = cut_objects(city_of(solid(turned(shape))), 40.0)
    mesh = build_city_mesh(cut)
    on_outline = shapely.distance(shape.boundary, shapely.points(mesh.positions[:, :2] @ turn_back(17.0))) < 1e-4
    looks = np.column_stack([mesh.uv, mesh.colors])
    walls = mesh.triangles[np.ptp(mesh.positions[mesh.triangles][..., 2], axis=1) > 1.0]
    middle = mesh.positions[walls][..., :2].mean(axis=1)
    facade = shapely.distance(shape.boundary, shapely.points(middle @ turn_back(17.0))) < 1e-3
    owners = np.searchsorted(mesh.object_vertices, walls[:, 0], side="right")
    # Where a part's facade ends at a cut, its wall along the cut begins, on the outline.
    checked = 0
    for part in np.unique(owners):
        inside = np.unique(walls[(owners == part) & ~facade])
        outside = np.unique(walls[(owners == part) & facade])
        for vertex in inside[on_outline[inside]]:
            same = outside[np.all(mesh.positions[outside] == mesh.positions[vertex], axis=1)]
            found = looks[same] - looks[vertex]
            found[:, 0] -= np.rint(found[:, 0])  # the texture repeats
            assert (np.abs(found) < 1e-5).all(axis=1).any()
            checked += 1
    assert checked >= 4 * len(cut.objects)
    # From there to the other end, the texture goes the short way.
    assert np.ptp(mesh.uv[walls[~facade]][..., 0], axis=1).max() <= 0.5


def test_so_are_those_of_prisms_on_top_of_each_other():
    shape = box(0, 0, 60, 12)
    tower = CityObject("tower", (Prism(shape, 0.0, 9.6), Prism(shape, 9.6, 19.2)))
    mesh = build_city_mesh(cut_objects(city_of(tower), 40.0))
    seam = np.all(mesh.positions[mesh.triangles][..., 0] == 30.0, axis=1)
    uv = mesh.uv[mesh.triangles][seam]
    assert seam.sum() == 8  # two parts of two prisms, and two triangles a wall
    assert np.ptp(uv[..., 1], axis=1).min() > 0.03  # storeys, no plain strip


def test_a_tile_without_facades_has_plain_walls_along_cuts():
    cut = cut_objects(city_of(solid(box(0, 0, 90, 90))), 30.0)
    mesh = build_city_mesh(cut)
    inner = next(i for i, one in enumerate(cut.objects) if one.footprint.equals(box(30, 30, 60, 60)))
    v = mesh.uv[mesh.object_vertices[inner] : mesh.object_vertices[inner] + 16, 1]
    top, bottom = (float(edge) for edge in blind_strip(looks_of(cut.objects).style[inner]))
    assert set(v.tolist()) == {np.float32(top), np.float32(bottom)}


def test_a_landmark_is_all_of_its_parts():
    city = cut_objects(city_of(solid(box(0, 0, 100, 12)), block("b", 0, 50, 10, 60, 5.0)), 30.0)
    assert landmark_factors(city, BuildParameters(landmarks=(("long", 3.0),))) == dict.fromkeys(range(4), 3.0)
    assert landmark_factors(city, BuildParameters(landmarks=(("long#1", 2.0), ("b", 5.0)))) == {1: 2.0, 4: 5.0}
    with pytest.raises(ParameterError, match="landmark lon: an object of made expected"):
        landmark_factors(city, BuildParameters(landmarks=(("lon", 2.0),)))


def test_an_open_mesh_with_texture_keeps_what_it_had():
    one = CityObject("dressed", (Prism(box(40, 20, 52.5, 31), 0.0, 8.0),), dressed_box(), ())
    city = replace(model_city(), objects=(one,))
    cut = cut_objects(city, 10.0)
    assert len(cut.objects) == 4
    assert all(part.core == () for part in cut.objects)
    for texture in (PAINTED, 0, 1):
        area = sum(triangle_areas(part.mesh)[part.mesh.textures == texture].sum() for part in cut.objects)
        assert area == pytest.approx(triangle_areas(one.mesh)[one.mesh.textures == texture].sum())
    assert len(directed_edges(one.mesh)[0]) < sum(len(directed_edges(part.mesh)[0]) for part in cut.objects)
