"""What walls enclose: never more than rays say, whatever is missing, and as much as is there.

The oracle is the claim itself: a sight from outside of a place, below its top, to a point in it meets a triangle.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from closed_meshes import footprints
from hypothesis import given, settings
from hypothesis import strategies as st
from open_meshes import divided, kept, normals, turned
from shapely.geometry import Polygon, box
from test_objects_from_meshes import extruded, joined

from mmi.city.model import CityObject, Prism, Texture, TriangleMesh
from mmi.city.terrain import Terrain
from mmi.reading.models.enclosures import enclosing
from mmi.reading.report import Ledger

FEW = settings(max_examples=40, deadline=None)
HOUSE = box(0, 0, 10, 8)


def hidden_by(*meshes, ground=0.0, open_=None, textures=()):
    """The objects of the meshes, all of them open by default, with what they enclose; and the ledger."""
    ledger = Ledger()
    objects = []
    for i, mesh in enumerate(meshes):
        outline = shapely.convex_hull(shapely.multipoints(mesh.vertices[:, :2]))
        low, high = mesh.vertices[:, 2].min(), mesh.vertices[:, 2].max()
        objects.append(CityObject(f"m{i}", (Prism(outline, low, high),), mesh, ()))
    ids = frozenset(one.id for one in objects) if open_ is None else frozenset(open_)
    return enclosing(objects, ids, ground, textures, ledger), ledger


def areas(objects):
    return [round(sum(prism.footprint.area for prism in one.core), 2) for one in objects]


def without(mesh, *, side):
    """Less all triangles that face along ``side`` (3,)."""
    return kept(mesh, normals(mesh) @ np.array(side, dtype=float) < 0.9)


def blocked(corners, starts, ends):
    """(n,) whether the way from each of ``starts`` to its one of ``ends`` (n, 3) meets one of the triangles (m, 3, 3)."""
    ways = ends - starts
    found = np.zeros(len(starts), dtype=bool)
    for a, b, c in corners:
        u, v = b - a, c - a
        across = np.cross(ways, v)
        scale = across @ u
        with np.errstate(divide="ignore", invalid="ignore"):
            away = starts - a
            first = (away * across).sum(axis=1) / scale
            turn = np.cross(away, u)
            second = (ways * turn).sum(axis=1) / scale
            at = turn @ v / scale
        found |= (first >= 0) & (second >= 0) & (first + second <= 1) & (at >= 0) & (at <= 1)
    return found


def violations(objects, *, rays=400, seed=0):
    """How many sights reach a point of a place from outside and below its top, of all that were tried."""
    rng = np.random.default_rng(seed)
    corners = np.concatenate([one.mesh.vertices[one.mesh.triangles] for one in objects])
    wrong = tried = 0
    for prism in [prism for one in objects for prism in one.core]:
        x0, y0, x1, y1 = prism.footprint.bounds
        inside = rng.uniform((x0, y0, 0.2), (x1, y1, prism.top - 1e-3), (4 * rays, 3))
        inside = inside[shapely.contains_xy(prism.footprint.buffer(-0.02), inside[:, :2])][:rays]
        eyes = rng.uniform((x0 - 15, y0 - 15, 0.3), (x1 + 15, y1 + 15, prism.top - 1e-3), (len(inside), 3))
        out = ~shapely.contains_xy(prism.footprint.buffer(0.02), eyes[:, :2])
        wrong += int((~blocked(corners, eyes[out], inside[out])).sum())
        tried += int(out.sum())
    return wrong, tried


def test_a_box_without_floor_and_roof_hides_as_high_as_its_walls():
    mesh = extruded(HOUSE, 0.0, 6.0)
    for bare in (
        without(mesh, side=(0, 0, -1)),
        without(mesh, side=(0, 0, 1)),
        kept(mesh, abs(normals(mesh)[:, 2]) < 0.5),
    ):
        (one,), ledger = hidden_by(bare)
        assert areas([one]) == [80.0]
        assert one.core[0].top == pytest.approx(6.0)
        assert ledger.count("noted", "building: not closed, hides what its walls enclose") == 1
        assert violations([one])[0] == 0


@pytest.mark.parametrize("side", [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)])
def test_without_a_front_nothing_is_hidden(side):
    (one,), ledger = hidden_by(without(extruded(HOUSE, 0.0, 6.0), side=side))
    assert one.core == ()
    assert ledger.count("noted", "building: not closed, hides nothing") == 1


def with_window(bottom, top):
    """A box with a hole in its front, 2 m wide."""
    frame = [(0, 0), (10, 0), (10, 6), (0, 6)], [(4, bottom), (6, bottom), (6, top), (4, top)]
    rest = without(extruded(HOUSE, 0.0, 6.0), side=(0, -1, 0))
    wall = Polygon(*[frame[0], [frame[1]]])
    faces = [face for face in shapely.delaunay_triangles(wall).geoms if wall.contains(face.centroid)]
    faces = [np.array(face.exterior.coords)[:3] for face in faces]
    assert sum(Polygon(face).area for face in faces) == pytest.approx(wall.area)
    front = np.concatenate(faces)
    points = np.column_stack([front[:, 0], np.zeros(len(front)), front[:, 1]])
    return joined(rest, TriangleMesh(points, np.arange(len(points)).reshape(-1, 3)))


def test_a_window_that_is_a_hole_lets_sight_in_from_its_sill():
    (low,), _ = hidden_by(with_window(1.0, 2.5))
    assert low.core == ()
    (high,), _ = hidden_by(with_window(4.0, 5.5))
    assert [prism.top for prism in high.core] == [pytest.approx(4.0, abs=0.005)]
    assert violations([high])[0] == 0


def row(*, heights=(6.0, 8.0, 7.0), party=False):
    houses = [extruded(box(10 * i, 0, 10 * i + 10, 8), 0.0, high) for i, high in enumerate(heights)]
    if party:
        return houses
    last = len(houses) - 1
    bare = [without(mesh, side=(1, 0, 0)) if i < last else mesh for i, mesh in enumerate(houses)]
    return [without(mesh, side=(-1, 0, 0)) if i else mesh for i, mesh in enumerate(bare)]


def test_party_walls_that_are_missing_are_those_of_the_neighbours():
    objects, ledger = hidden_by(*row())
    assert sum(areas(objects)) == pytest.approx(240.0)
    assert {prism.top for one in objects for prism in one.core} == {6.0}, "over the lowest one looks in"
    assert violations(objects)[0] == 0
    assert ledger.count("noted", "building: not closed, hides what its walls enclose") == 3
    objects, _ = hidden_by(*row(party=True))
    assert areas(objects) == [80.0] * 3
    assert [one.core[0].top for one in objects] == [6.0, 8.0, 7.0]


def test_where_a_neighbour_has_no_front_sight_runs_through_the_row():
    houses = row()
    houses[1] = without(houses[1], side=(0, -1, 0))
    objects, _ = hidden_by(*houses)
    assert areas(objects) == [0.0] * 3
    objects, _ = hidden_by(*row()[:2])
    assert areas(objects) == [0.0] * 2, "the last of a row that ends open"


def test_a_closed_neighbour_lends_its_wall():
    closed, beside = extruded(box(10, 0, 20, 8), 0.0, 9.0), without(extruded(HOUSE, 0.0, 6.0), side=(1, 0, 0))
    objects, _ = hidden_by(beside, closed, open_=["m0"])
    assert areas(objects) == [80.0, 0.0]
    assert objects[0].core[0].top == pytest.approx(6.0)
    objects, _ = hidden_by(beside, extruded(box(10, 0, 20, 8), 0.0, 4.0), open_=["m0"])
    assert objects[0].core[0].top == pytest.approx(4.0), "over a lower one one looks in"
    objects, _ = hidden_by(beside, extruded(box(10.05, 0, 20, 8), 0.0, 9.0), open_=["m0"])
    assert areas(objects) == [0.0, 0.0], "five centimetres apart"


def test_walls_in_the_air_and_arcades_hide_nothing():
    (one,), _ = hidden_by(without(extruded(HOUSE, 1.0, 9.0), side=(0, 0, -1)))
    assert one.core == ()
    legs = without(extruded(HOUSE, 0.0, 3.0), side=(0, -1, 0))
    (one,), _ = hidden_by(joined(legs, without(extruded(HOUSE, 3.0, 9.0), side=(0, 0, -1))))
    assert one.core == ()


def test_on_a_slope_walls_reach_the_ground_or_hide_nothing():
    slope = Terrain((-20.0, -20.0), 5.0, np.linspace(0.0, 4.0, 13)[None].repeat(13, axis=0))
    lowest = float(slope.at(np.array([[0.0, 0.0]]))[0])
    (one,), _ = hidden_by(without(extruded(HOUSE, lowest, 9.0), side=(0, 0, -1)), ground=slope)
    assert areas([one]) == [80.0]
    assert one.core[0].bottom <= lowest
    (one,), _ = hidden_by(without(extruded(HOUSE, lowest + 0.2, 9.0), side=(0, 0, -1)), ground=slope)
    assert one.core == ()


@pytest.mark.parametrize("eaves", [6.0, 5.5])
def test_a_roof_that_is_an_object_of_its_own_hides_what_the_walls_below_it_enclose(eaves):
    mesh, above = extruded(HOUSE, 0.0, 6.0), extruded(box(-1, -1, 11, 9), eaves, 8.0)
    walls, roof = kept(mesh, abs(normals(mesh)[:, 2]) < 0.5), without(above, side=(0, 0, -1))
    for meshes in ((roof, walls), (walls, roof)):
        objects, _ = hidden_by(*meshes)
        (prism,) = [prism for one in objects for prism in one.core]
        assert prism.footprint.area == pytest.approx(80.0)
        assert (prism.bottom, prism.top) == (0.0, pytest.approx(6.0))


def test_railings_hide_nothing():
    mesh = without(extruded(HOUSE, 0.0, 6.0), side=(0, 0, -1))
    leaves, brick = Texture("leaves", np.zeros((2, 2, 4), np.uint8)), Texture("brick", np.zeros((2, 2, 3), np.uint8))
    textured = replace(mesh, textures=np.zeros(len(mesh.triangles), np.int32))
    assert hidden_by(textured, textures=(leaves,))[0][0].core == ()
    assert areas(hidden_by(textured, textures=(brick,))[0]) == [80.0]


def test_a_street_may_come_into_what_is_open_towards_a_courtyard():
    """Without the walls of the courtyard it is one place with the house around it."""
    ring = Polygon(box(0, 0, 30, 30).exterior, [box(10, 10, 20, 20).exterior])
    mesh = extruded(ring, 0.0, 6.0)
    inner = mesh.vertices[mesh.triangles].mean(axis=1)
    inner = (abs(normals(mesh)[:, 2]) < 0.5) & (abs(inner[:, :2] - 15.0).max(axis=1) < 6.0)
    (one,), _ = hidden_by(kept(mesh, ~inner))
    assert areas([one]) == [900.0]
    assert violations([one])[0] == 0


@FEW
@given(
    st.lists(st.tuples(footprints(), st.floats(3.0, 20.0)), min_size=1, max_size=3),
    st.sets(st.sampled_from(("corners", "facing"))),
    st.floats(0.0, 0.2),
    st.integers(0, 999),
)
def test_no_sight_from_below_reaches_what_walls_enclose(houses, kinds, lost, seed):
    rng = np.random.default_rng(seed)
    meshes = []
    for i, (footprint, top) in enumerate(houses):
        plan = shapely.set_precision(shapely.affinity.translate(footprint, 12.0 * i, 0.0), 1e-3)
        mesh = extruded(plan if plan.geom_type == "Polygon" else HOUSE, 0.0, round(top, 3))
        mesh = kept(mesh, rng.random(len(mesh.triangles)) >= lost)
        if "corners" in kinds:
            mesh = divided(mesh, rng.random(len(mesh.triangles)) < 0.5)
        if "facing" in kinds:
            mesh = turned(mesh, rng.random(len(mesh.triangles)) < 0.5)
        meshes.append(mesh)
    objects, _ = hidden_by(*meshes)
    assert violations(objects, rays=150, seed=seed)[0] == 0


@FEW
@given(footprints(), st.integers(0, 999))
def test_turned_faces_and_corners_that_are_not_shared_cost_nothing(footprint, seed):
    rng = np.random.default_rng(seed)
    plan = shapely.set_precision(footprint, 1e-3)
    mesh = without(extruded(plan, 0.0, 9.0), side=(0, 0, -1))
    mesh = divided(mesh, rng.random(len(mesh.triangles)) < 0.5)
    mesh = turned(mesh, rng.random(len(mesh.triangles)) < 0.5)
    (one,), _ = hidden_by(mesh)
    large = [part for part in shapely.get_parts(plan).tolist() if part.area > 5.0]
    assert shapely.union_all([prism.footprint for prism in one.core]).area >= 0.98 * sum(part.area for part in large)
