"""Meshes as city objects: prisms hold them, cores lie in them, whatever was wrong with the mesh."""

from __future__ import annotations

import base64
import zlib

import numpy as np
import pytest
import shapely
from closed_meshes import footprints, is_closed, points_in_core, volume, winding
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from model_cities import BOX_TRIANGLES, box_corners
from shapely.geometry import Polygon, box

from citygen.buildings.houses import ROOF_KINDS, STYLES, house
from mmi.city.model import CityObject, Prism, TriangleMesh
from mmi.city.triangulate import triangulate
from mmi.foundation.errors import CityError
from mmi.reading.models.enclosures import note_open
from mmi.reading.models.objects_from_meshes import _core, objects_from_models
from mmi.reading.raw_layers import ModelLayer, RawModel
from mmi.reading.report import Ledger

FEW = settings(max_examples=25, deadline=None)
SLIVERS = (
    "eNpNlE1oXFUYhu9koEnrOMPQaZqa5DQmCE1u20ymVg5YBYdBhiI1SaGtFPVIKYqCogtJKrhRUFGq1JU/6OBCrF4Qx59KYzfShYI4GxEKgqCNtO"
    "rCrjzWH/zePnNDNh8vz5z3OfecOzPzs583lpIPdxy2+cWOp+aWkvlrhHzv7A82X5/8z+aTIw/bfGbkZD0n5HcnJy0f3n26Uauenj5u89PpF+Zq"
    "VQj52O5vbf64/Xubc6OnbN42+lk9J+Tftl+t0wpOnuDUDQ5Clic4tYKTJzh1c0KWJ7h9e640OhWehye5a3j/XK+llStNdVeaE1sO2JMvlh61eX"
    "fplJ0FQh7f8oTN1SHdwx0Dr9q8feDMGiH/NPS2TZmTvgcDJEneWOPKnYpytyRDt1TdfMjO/kD5QZv3lV+0s0PI5c0ndCeDTxu5tfiyTV/8eI2Q"
    "Lw2+028FJ09w6gYHIctjd2Kt4OQJTt2ckOWhlaXyZKm6WQohy5OlamWpPFmqbk7I8tCKXp7o1Y0eQpYnerWilyd6dXNClid6bozzcktnCweSpe"
    "TrTbtsfrNpY2EpgZDPFWZsHipPGLla22jz39pqkhPyPeV/bJ5MFu194MFwdKveFi3Wi3QqWtMtiXRLl4t3JrXqa0N7bb45VC3UqhDy78VJm/OV"
    "cSNJrWSzWLuU5IR8sPJXQis4eYJTNzgIWZ7g1ApOnuDUzQlZHlpZKk+WqpulELI8WapWlsqTpermhCwPrejliV7d6CFkeaJXy96IeaJXNydkea"
    "J/bpvu7YOpT2y+NfWKvQsI+cS2vy2fn77e8vH6YzaP1PcP5IR8ZvpyIX8XeDAs3vxeIem3WC/SqWhNtyTSLTXH2na3f0y8ZPPniYfsXUDIe8em"
    "bJ6bGbP5yGywef/svoGckD+a+bPfCk6e4NQNDkKWJzi1gpMnOHVzQpaHVvTyRK9u9BCyPNGrFb080aubE7I80fM95FyciLPz5HCRXktkpSnbSh"
    "NybM91O3utsztX0+U2Wf+KOSHzr/j4cGdmuU3W785sGy4YIev30mvdNHhxw3KbrKfqtW7Z+r4RMjs+u+vK4HKbzC4Q9mIXOHuxC5y92AXOXuwC"
    "Zy+ccHL/ROM3jjYWyDi/Gv7yhsYCGSeEjPO74eeHGwtknJD1/oPjvxjpn+XaLhD2wgnHjAGOh/VwMuvT0YsjRxfJrP915LwRMush67vrW3wKYQ"
    "0Z/j8aZFIB"
)
"""Triangles of a house of ``citygen montmartre --detail 2``, millimetres from a corner: reveals of windows end nearly where the
eaves do."""


def as_objects(*meshes):
    """The meshes read as buildings, and the ledger."""
    ledger = Ledger()
    items = tuple(RawModel(f"m{i}", mesh) for i, mesh in enumerate(meshes))
    objects, open_ids = objects_from_models(ModelLayer("made", items, None), lambda points: points, ledger)
    note_open(objects, open_ids, ledger)
    return objects, ledger


def extruded(footprint, bottom, top):
    """A prism as a closed mesh, counter-clockwise from outside."""
    footprint = shapely.orient_polygons(footprint)
    points, caps, _ = triangulate([footprint])
    n = len(points)
    after = np.arange(n) + 1
    ends = np.cumsum([len(ring.coords) - 1 for ring in (footprint.exterior, *footprint.interiors)])
    after[ends - 1] = np.append(0, ends[:-1])
    low, high = (np.column_stack([points, np.full(n, z)]) for z in (bottom, top))
    k = np.arange(n)
    walls = [np.column_stack([k, after, after + n]), np.column_stack([k, after + n, k + n])]
    return TriangleMesh(np.concatenate([low, high]), np.concatenate([caps[:, ::-1], caps + n, *walls]))


def joined(*meshes):
    shifts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return TriangleMesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.triangles + shift for mesh, shift in zip(meshes, shifts, strict=False)]),
    )


def only(mesh, keep):
    return TriangleMesh(mesh.vertices, mesh.triangles[keep])


def facing(mesh):
    corners = mesh.vertices[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def loose(one, slack):
    """How many vertices lie further than ``slack`` (metres) from all prisms."""
    points = one.mesh.vertices[one.mesh.triangles].reshape(-1, 3)
    flat, inside = shapely.points(points[:, :2]), np.zeros(len(points), dtype=bool)
    for prism in one.prisms:
        level = (points[:, 2] >= prism.bottom - 1e-9) & (points[:, 2] <= prism.top + 1e-9)
        inside |= level & (shapely.distance(prism.footprint, flat) <= slack)
    return int((~inside).sum())


def check(one, solid=None, *, slack=0.0025):
    """Bounds hold the mesh, the core lies in ``solid`` (by default the mesh itself), and prisms are sound."""
    assert loose(one, slack) == 0
    rng = np.random.default_rng(5)
    middles = one.mesh.vertices[one.mesh.triangles] * rng.dirichlet(np.ones(3), len(one.mesh.triangles))[..., None]
    inner = CityObject("inner", one.prisms, TriangleMesh(middles.sum(axis=1), [[0, 0, 0]]))
    points = TriangleMesh(inner.mesh.vertices, np.arange(len(middles))[:, None].repeat(3, axis=1))
    assert loose(CityObject("inner", one.prisms, points), slack) == 0, "not only corners, points between them too"
    for prism in (*one.prisms, *one.core):
        ring = shapely.get_coordinates(prism.footprint)
        assert prism.footprint.is_valid
        assert prism.footprint.area > 0
        steps = np.linalg.norm(np.diff(ring, axis=0), axis=1)
        assert (steps > 1e-6).all()
        assert prism.footprint.buffer(-1e-4).area >= 0, "GEOS has no trouble with it"
    for prism in one.core:
        assert any(
            prism.footprint.within(bound.footprint.buffer(0.01)) for bound in one.prisms if bound.bottom <= prism.bottom
        )
    inside = points_in_core(CityObject("core", one.prisms, None, shrunk(one.core)), 40, rng)
    if len(inside):
        found = winding(one.mesh if solid is None else solid, inside)
        assert (found > 0.99).all(), f"{(found <= 0.99).sum()} of {len(inside)} points of the core are outside"


def filled(prisms):
    """Volume, counting twice where prisms overlap; a core's higher prisms stand on its lowest point too."""
    return sum(prism.footprint.area * (prism.top - prism.bottom) for prism in prisms)


def shrunk(core):
    """Cores without what the rounding of outlines, and walls that lean a millimetre, may add."""
    parts = [
        Prism(part, prism.bottom, prism.top)
        for prism in core
        for part in shapely.get_parts(prism.footprint.buffer(-0.03))
        if not part.is_empty
    ]
    return tuple(parts)


@FEW
@given(
    footprints(), st.sampled_from(STYLES), st.sampled_from(ROOF_KINDS), st.sampled_from([1, 2, 3]), st.integers(0, 99)
)
def test_houses(footprint, style, roof, detail, seed):
    made = house(
        "h", footprint, base=2.0, eaves=10.5, style=style, roof=roof, detail=detail, rng=np.random.default_rng(seed)
    )
    (one,), ledger = as_objects(made.mesh)
    check(one)
    if is_closed(made.mesh):
        assert one.top == pytest.approx(made.mesh.vertices[:, 2].max(), abs=0.001)
        assert ledger.count("noted") == (0 if one.core else ledger.count("noted"))


@FEW
@given(footprints(), st.floats(-20.0, 20.0), st.floats(2.5, 60.0))
def test_prisms_as_meshes_are_their_own_core(footprint, bottom, height):
    mesh = extruded(footprint, bottom, bottom + height)
    assume(is_closed(mesh))  # not where a courtyard touches the outline
    (one,), ledger = as_objects(mesh)
    check(one)
    exact = footprint.area * height
    held, hidden = filled(one.prisms), filled(one.core)
    slack = 0.01 * footprint.length * height + 0.002 * footprint.area
    assert held == pytest.approx(exact, abs=slack)
    if footprint.area > 30.0:
        assert hidden == pytest.approx(exact, abs=slack)
    assert ledger.count("noted") == 0


@FEW
@given(footprints(), st.integers(0, 99))
def test_a_house_without_a_floor_or_inside_out_hides_the_same(footprint, seed):
    rng = np.random.default_rng(seed)
    made = house("h", footprint, base=0.0, eaves=9.0, style=STYLES[0], roof="flat", detail=1, rng=rng)
    mesh = made.mesh
    (whole,), _ = as_objects(mesh)
    floor = (facing(mesh)[:, 2] < -0.5) & (mesh.vertices[mesh.triangles][..., 2].max(axis=1) < 0.01)
    assert floor.any()
    (bare,), _ = as_objects(only(mesh, ~floor))
    check(bare, mesh)
    assert filled(bare.core) == pytest.approx(filled(whole.core))
    (turned,), ledger = as_objects(TriangleMesh(mesh.vertices, mesh.triangles[:, ::-1]))
    assert ledger.count("repaired", "building: faced inwards, turned") == 1
    assert volume(turned.mesh) == pytest.approx(volume(whole.mesh))
    check(turned)
    assert filled(turned.core) == pytest.approx(filled(whole.core))


def test_turned_triangles_keep_the_looks_of_their_corners():
    mesh = extruded(box(0, 0, 8, 8), 0.0, 6.0)
    uv = mesh.vertices[mesh.triangles][..., [0, 2]]
    inverted = TriangleMesh(mesh.vertices, mesh.triangles[:, ::-1], None, None, uv[:, ::-1])
    (one,), _ = as_objects(inverted)
    assert one.mesh.uv == pytest.approx(one.mesh.vertices[one.mesh.triangles][..., [0, 2]])


@FEW
@given(
    st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3), st.integers(3, 9)), min_size=2, max_size=7, unique=True)
)
def test_solids_that_touch_or_overlap(places):
    """Towers on a grid share walls face to face; at one place, one stands in the other."""
    mesh = joined(*(extruded(box(8 * i, 8 * j, 8 * i + 8, 8 * j + 8), 0.0, 3.0 * h) for i, j, h in places))
    (one,), _ = as_objects(mesh)
    check(one, mesh)
    hidden = shapely.union_all([prism.footprint for prism in one.core])
    assert hidden.area == pytest.approx(64.0 * len({(i, j) for i, j, _ in places}), rel=0.01)
    assert min(prism.top for prism in one.core) >= 3.0 * min(h for _, _, h in places)


def test_what_juts_out_hides_nothing_below_itself():
    stem, hat = extruded(box(0, 0, 10, 10), 0.0, 8.0), extruded(box(-10, -10, 20, 20), 8.0, 14.0)
    (one,), _ = as_objects(joined(stem, hat))
    check(one)
    low = [prism for prism in one.core if prism.bottom < 7.9]
    assert all(prism.footprint.within(box(0, 0, 10, 10).buffer(0.01)) for prism in low)
    assert filled(one.core) == pytest.approx(100 * 8 + 900 * 6)
    assert filled(low) == pytest.approx(800.0)


def test_loose_parts_do_not_take_the_core_away():
    """A sheet beside, a flagpole on top, and a box without a floor up in the air."""
    body, sheet = extruded(box(0, 0, 10, 10), 0.0, 8.0), TriangleMesh([[20, 0, 0], [20, 9, 0], [20, 0, 9]], [[0, 1, 2]])
    hood = extruded(box(30, 0, 40, 10), 5.0, 12.0)
    bare = only(hood, facing(hood)[:, 2] > -0.5)
    (one,), ledger = as_objects(joined(body, sheet, bare))
    check(one, body)
    assert filled(one.core) == pytest.approx(800.0)
    assert ledger.count("noted") == 0
    (two,), _ = as_objects(joined(body, sheet, hood))
    assert filled(two.core) == pytest.approx(1500.0)
    (three,), ledger = as_objects(joined(sheet, bare))
    assert three.core == ()
    assert ledger.count("noted", "building: not closed, hides nothing") == 1


def test_a_tower_on_a_slab_gets_prisms_of_its_own():
    slab, tower = extruded(box(0, 0, 60, 40), 0.0, 6.0), extruded(box(5, 5, 15, 15), 0.0, 60.0)
    (one,), _ = as_objects(joined(slab, tower))
    check(one)
    assert filled(one.prisms) == pytest.approx(60 * 40 * 6 + 100 * 54, rel=0.01)
    assert max(prism.top for prism in one.core) == pytest.approx(60.0)


@FEW
@given(st.integers(0, 9999), st.integers(1, 60))
def test_soups_have_bounds_but_no_core(seed, count):
    rng = np.random.default_rng(seed)
    corners = rng.normal(scale=12.0, size=(count, 3, 3)) * rng.choice([1.0, 1.0, 0.01, 1e-4], (count, 1, 3))
    mesh = TriangleMesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))
    try:
        (one,), _ = as_objects(mesh)
    except CityError:
        heights = np.round(corners[..., 2], 3)
        assert np.ptp(heights) < 0.02 or count < 3
        return
    check(one)
    low = one.mesh.vertices[:, 2].min()
    if np.ptp(one.mesh.vertices[:, 2]) > 3.0:
        open_edges_low = (one.mesh.vertices[one.mesh.triangles][..., 2].max() - low) <= 1.0
        assert open_edges_low or one.core == ()


@FEW
@given(footprints(), st.integers(0, 999))
def test_a_hole_in_the_wall_or_roof_takes_the_core_away(footprint, seed):
    mesh = extruded(footprint, 0.0, 12.0)
    assume(is_closed(mesh))
    high = np.flatnonzero(mesh.vertices[mesh.triangles][..., 2].max(axis=1) > 1.0)
    lost = np.random.default_rng(seed).choice(high)
    (one,), ledger = as_objects(only(mesh, np.arange(len(mesh.triangles)) != lost))
    assert one.core == ()
    assert ledger.count("noted", "building: not closed, hides nothing") == 1
    check(one)


def test_repeated_faces_go_even_if_their_corners_are_others():
    mesh = extruded(box(0, 0, 9, 9), 0.0, 7.0)
    twice = joined(mesh, TriangleMesh(mesh.vertices, np.roll(mesh.triangles, 1, axis=1)))
    (one,), ledger = as_objects(twice)
    assert ledger.count("repaired", "building: repeated faces dropped") == 12
    assert len(one.mesh.triangles) == 12
    assert len(one.mesh.vertices) == 8
    assert one.core
    check(one)


def test_points_that_no_triangle_uses_bound_nothing():
    mesh = extruded(box(0, 0, 9, 9), 0.0, 7.0)
    (one,), _ = as_objects(TriangleMesh(np.vstack([mesh.vertices, (1e4, -1e4, 900.0)]), mesh.triangles))
    assert len(one.mesh.vertices) == 8
    assert (one.base, one.top) == (0.0, 7.0)
    assert one.footprint.area == pytest.approx(81.0, rel=0.01)


def test_a_fence_has_a_footprint():
    mesh = TriangleMesh([[0, 0, 0], [30, 0.002, 0], [30, 0.002, 2], [0, 0, 2.0]], [[0, 1, 2], [0, 2, 3]])
    (one,), _ = as_objects(mesh)
    check(one)
    assert 0.5 < one.footprint.area < 3.0
    assert one.core == ()


def test_slivers_narrower_than_the_grid_stay_within_bounds():
    """A wall that leans a millimetre has an area from above, and none in a union that rounds to millimetres."""
    body = extruded(box(0, 0, 20, 10), 0.0, 8.0)
    leaning = TriangleMesh([[25, 0, 0], [25.0005, 40.0, 0], [25.001, 17.333, 9.0]], [[0, 1, 2]])
    (one,), _ = as_objects(joined(body, leaning))
    check(one)
    assert one.footprint.bounds[3] >= 40.0


@pytest.mark.parametrize(
    "vertices",
    [
        [[0, 0, 0], [9, 0, 0], [0, 9, 0]],
        [[0, 0, 5], [9, 0, 5.004], [0, 9, 5]],
        [[0, 0, 0], [1, 1, 1], [2, 2, 2]],
        [[3, 3, 3]] * 3,
    ],
)
def test_what_has_no_height_or_no_area_is_left_out(vertices):
    body = extruded(box(0, 0, 9, 9), 0.0, 7.0)
    found, ledger = as_objects(
        TriangleMesh(vertices, [[0, 1, 2]]), TriangleMesh(np.empty((0, 3)), np.empty((0, 3))), body
    )
    assert [one.id for one in found] == ["m2"]
    assert ledger.count("left out") == 2
    with pytest.raises(CityError, match="made: no buildings; expected objects with surfaces, found 1 without"):
        as_objects(TriangleMesh(vertices, [[0, 1, 2]]))


@pytest.mark.parametrize("height", [-9999.0, -32768.0, 5_316_521.0])
def test_a_corner_where_no_ground_can_be_costs_its_building(height):
    """A void, or an easting in the place of a height."""
    house, other = extruded(box(0, 0, 9, 9), 0.0, 7.0), extruded(box(20, 0, 29, 9), 0.0, 7.0)
    vertices = other.vertices.copy()
    vertices[0, 2] = height
    found, ledger = as_objects(house, TriangleMesh(vertices, other.triangles))
    assert [one.id for one in found] == ["m0"]
    assert ledger.count("left out") == 1


def test_outlines_of_very_many_points_are_simplified_outwards():
    angles = np.linspace(0.0, 2.0 * np.pi, 4000, endpoint=False)
    radii = 20.0 + 0.02 * np.random.default_rng(2).normal(size=4000)
    rim = np.column_stack([np.cos(angles), np.sin(angles)]) * radii[:, None]
    (one,), _ = as_objects(extruded(Polygon(rim), 0.0, 15.0))
    check(one)
    assert max(shapely.get_num_coordinates(prism.footprint) for prism in one.prisms) < 800
    assert one.footprint.area == pytest.approx(np.pi * 400.0, rel=0.03)


def test_comb():
    """Many thin teeth: an outline of many points whose parts must not be lost."""
    teeth = shapely.union_all([box(0, 0, 100, 5), *(box(k, 4, k + 0.4, 12) for k in range(100))])
    (one,), _ = as_objects(extruded(teeth, 0.0, 10.0))
    check(one)


def test_where_it_stands_makes_no_difference():
    rng = np.random.default_rng(4)
    footprint = shapely.convex_hull(shapely.multipoints(rng.uniform(0, 30, (9, 2))))
    made = house("h", footprint, base=0.0, eaves=9.0, style=STYLES[1], roof="gable", detail=2, rng=rng)
    (here,), _ = as_objects(made.mesh)
    mesh = TriangleMesh(np.add(np.round(made.mesh.vertices, 3), (4000.0, -7000.0, 100.0)), made.mesh.triangles)
    (there,), _ = as_objects(mesh)
    assert [p.top + 100.0 for p in here.prisms] == pytest.approx([p.top for p in there.prisms])
    assert [p.footprint.area for p in here.core] == pytest.approx([p.footprint.area for p in there.core], rel=1e-3)


def test_box_of_the_writers_tests():
    (one,), _ = as_objects(TriangleMesh(box_corners(0, 0, 0, 10, 10, 8), BOX_TRIANGLES))
    (prism,), (core,) = one.prisms, one.core
    for solid in (prism, core):
        assert solid.footprint.equals(box(0, 0, 10, 10))
        assert (solid.bottom, solid.top) == (0.0, 8.0)
    assert one.occluders == one.core


def test_slivers_that_collapse_into_lines_do_not_stop_a_city():
    millimetres = np.frombuffer(zlib.decompress(base64.b64decode(SLIVERS)), "<i2").reshape(-1, 3)
    points = (
        millimetres + np.array([363478, -356950, 9543])
    ) / 1000.0  # where it stands decides what rounding makes of it
    prisms = _core(TriangleMesh(points, np.arange(len(points), dtype=np.int32).reshape(-1, 3)), -np.inf)
    outline = shapely.MultiPoint(points[:, :2]).convex_hull
    assert [prism.footprint.area > 50.0 and outline.buffer(0.01).covers(prism.footprint) for prism in prisms] == [
        True
    ] * 2
    assert shapely.area(prisms[1].footprint.difference(prisms[0].footprint.buffer(0.01))) == 0.0, (
        "the higher within the lower"
    )
