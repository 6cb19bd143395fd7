"""Houses are solid, lie within their prisms and around their cores, and wear their pictures upright and in whole bays."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import shapely
from closed_meshes import (
    footprints,
    is_closed,
    is_simple,
    outside_prisms,
    points_in_core,
    prism_volume,
    volume,
    winding,
)
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from shapely.geometry import Polygon, box

from citygen.buildings.houses import ROOF_KINDS, STYLES, house
from citygen.buildings.roofs import raise_roof
from citygen.buildings.walls import outline_of
from citygen.shapes.textures import DOORS, FACADES, GROUNDS, NAMES, PANES, ROOFS, WALLS
from mmi.foundation.errors import CityError

BLOCK = box(0.0, 0.0, 16.0, 11.0)
ELL = Polygon([(0, 0), (18, 0), (18, 9), (8, 9), (8, 18), (0, 18)])
COURT = box(0.0, 0.0, 30.0, 28.0).difference(box(9.0, 9.0, 20.0, 18.0))


def built(footprint=BLOCK, *, detail=1, style="stucco", roof="flat", seed=1, base=-0.5, eaves=16.0, blind=None):
    rng = np.random.default_rng(seed)
    return house("h", footprint, base=base, eaves=eaves, style=style, roof=roof, detail=detail, rng=rng, blind=blind)


def check_solid(one, *, once):
    assert is_closed(one.mesh)
    assert is_simple(one.mesh) or not once
    assert outside_prisms(one) == 0
    inside = points_in_core(one, 6, np.random.default_rng(7))
    assert (winding(one.mesh, inside) > 0.99).all()


def openings(one):
    """Corners (m, 3, 3) of all triangles with windows, doors or shops in their picture."""
    pictures = [*(i for group in (FACADES, GROUNDS) for chosen in group.values() for i in chosen), PANES, DOORS]
    return one.mesh.vertices[one.mesh.triangles[np.isin(one.mesh.textures, pictures)]]


@settings(max_examples=40, deadline=None)
@given(footprints(), st.sampled_from(STYLES), st.sampled_from(ROOF_KINDS), st.integers(1, 3), st.data())
def test_houses_on_any_footprint_are_solid(footprint, style, roof, detail, data):
    edges = len(footprint.exterior.coords) - 1
    blind = data.draw(st.one_of(st.none(), st.lists(st.booleans(), min_size=edges, max_size=edges)))
    eaves = data.draw(st.sampled_from([2.0, 4.5, 10.0, 19.0]))
    one = built(footprint, detail=detail, style=style, roof=roof, eaves=eaves, blind=blind)
    check_solid(one, once=detail == 1)
    assert one.base == -0.5
    assert one.mesh.vertices[:, 2].min() == -0.5
    core, prisms = sum(map(prism_volume, one.core)), sum(map(prism_volume, one.prisms))
    assert core - 1e-6 <= volume(one.mesh) <= prisms * 1.02


@settings(max_examples=40, deadline=None)
@given(footprints(), st.sampled_from([0.4, 1.0]))
def test_hip_roofs_are_the_lowest_over_all_edges(footprint, slope):
    """The straight skeleton: at its nodes the roof is as high as the nearest edges' planes, never above any edge's plane
    that it stands on; and nothing of it is level.
    """
    outline = outline_of(footprint, None)
    roof = raise_roof(outline.points, outline.after, ((0.0, 10.0), (1000.0, 10.0 + 1000.0 * slope)))
    assume(roof is not None)  # one in a thousand has slivers
    corners = roof.vertices[roof.triangles]
    start, inward = outline.points[roof.edge][:, None], outline.inward[roof.edge][:, None]
    depth = ((corners[..., :2] - start) * inward).sum(axis=2)
    off = np.abs(corners[..., 2] - 10.0 - slope * depth).max()
    assert off < 0.05 * slope  # each face lies in its edge's plane, where nodes within 2 cm are one
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert normal[:, 2].sum() / 2.0 == pytest.approx(footprint.area, rel=1e-3)
    border = shapely.distance(footprint.boundary, shapely.points(roof.vertices[:, :2]))
    assert (roof.vertices[:, 2] <= 10.0 + slope * 6.0 * border + 1e-2).all()


@pytest.mark.parametrize("roof", ROOF_KINDS)
def test_a_rectangle_gets_the_roof_asked_for(roof):
    one = built(roof=roof, style="stone")
    top = {"flat": 16.0, "gable": 16.0 + 0.8 * 5.5, "hip": 16.0 + 0.8 * 5.5, "mansard": 16.0 + 2.7 + 0.22 * 4.4}[roof]
    assert one.top == pytest.approx(top, abs=1e-6)
    solid = 16.0 * 11.0 * 16.5
    above = {
        "flat": -0.55 * 15.4 * 10.4,
        "gable": 0.5 * 4.4 * 11.0 * 16.0,
        "hip": 4.4 * (0.5 * 11.0 * 5.0 + 11.0 * 11.0 / 3.0),
        "mansard": None,
    }[roof]
    if above is not None:
        assert volume(one.mesh) == pytest.approx(solid + above, rel=1e-9)


def test_gables_stand_on_the_blind_sides():
    """Of a rectangle the shorter sides, unless houses touch the longer ones."""

    def gables(blind):
        mesh = built(roof="gable", blind=blind).mesh
        faces = mesh.vertices[mesh.triangles[mesh.textures == WALLS["stucco"]]]
        high = faces[faces[..., 2].max(axis=1) > 16.0 + 1e-6]
        return {tuple(np.flatnonzero(np.ptp(face, axis=0)[:2] < 1e-9)) for face in high}

    assert gables(None) == {(0,)}  # at x = 0 and x = 16
    assert gables([False, True, False, True]) == {(1,)}  # a box starts with its side at x = 16


@pytest.mark.parametrize("detail", [1, 2, 3])
@pytest.mark.parametrize("clockwise", [False, True])
def test_party_walls_have_no_windows(detail, clockwise):
    """And nothing stands out from them."""
    ring = [(0, 0), (16, 0), (16, 11), (0, 11)]
    shape = Polygon(ring[::-1] if clockwise else ring)
    coordinates = np.array(shape.exterior.coords)
    blind = [bool(a[0] == b[0] == 16.0) for a, b in itertools.pairwise(coordinates)]
    assert sum(blind) == 1
    one = built(shape, detail=detail, style="brick", roof="gable", blind=blind)
    faces = openings(one)
    assert len(faces)
    east = (faces[..., 0] > 15.5).all(axis=1)
    assert not east.any()
    assert ((faces[..., 0] < 0.5).all(axis=1)).any()
    assert one.mesh.vertices[:, 0].max() <= 16.0 + 1e-9


def test_walls_wear_whole_bays_upright():
    for style in STYLES:
        mesh = built(ELL, style=style).mesh
        painted = np.isin(mesh.textures, [*FACADES[style], *GROUNDS[style]])
        assert painted.sum() == 2 * 2 * 6
        corners, uv = mesh.vertices[mesh.triangles[painted]], mesh.uv[painted].astype(np.float64)
        bays = np.ptp(uv[..., 0], axis=1) * 8.0
        wide = np.hypot(*np.ptp(corners, axis=1)[:, :2].T)
        assert np.allclose(bays, np.rint(bays), atol=1e-4)
        assert ((wide / bays > 2.2) & (wide / bays < 4.8)).all()
        storeys = np.ptp(uv[np.isin(mesh.textures[painted], FACADES[style]), :, 1], axis=1) * 8.0
        assert np.allclose(storeys, np.rint(storeys), atol=1e-4)
        assert storeys.min() >= 3.0
        for face, place in zip(corners, uv, strict=True):  # v grows with height, u to the right as seen from outside
            up = np.argsort(face[:, 2])
            assert (np.diff(place[up, 1]) >= -1e-6).all()
            normal = np.cross(face[1] - face[0], face[2] - face[0])
            right = np.array([-normal[1], normal[0], 0.0])
            assert (np.diff(place[np.argsort(face @ right), 0]) >= -1e-6).all()


@pytest.mark.parametrize("style", STYLES)
def test_detail_adds_triangles(style):
    counts = [len(built(detail=d, style=style, roof="hip").mesh.triangles) for d in (1, 2, 3)]
    assert 20 <= counts[0] <= 60
    assert 300 <= counts[1] <= 1800
    assert counts[1] <= counts[2] <= 4000
    assert style == "glass" or counts[1] < counts[2]


def test_detail_2_has_recesses_and_detail_3_balconies():
    """Panes lie behind the walls; balconies before them."""
    two, three = built(detail=2, style="stone"), built(detail=3, style="stone")
    panes = two.mesh.vertices[two.mesh.triangles[two.mesh.textures == PANES]]
    depth = shapely.distance(BLOCK.boundary, shapely.points(panes[..., :2].reshape(-1, 2)))
    assert np.allclose(depth, 0.25, atol=1e-9)
    assert not any(prism.footprint.area > 1.35 * BLOCK.area for prism in two.prisms)
    reach = shapely.distance(BLOCK, shapely.points(three.mesh.vertices[:, :2])).max()
    assert reach == pytest.approx(0.75, abs=1e-6)
    assert "railing" in {NAMES[i] for i in np.unique(three.mesh.textures)}


def test_a_house_without_detail_is_its_prism():
    one = built(COURT, detail=0)
    assert one.mesh is None
    assert one.occluders == one.prisms
    assert prism_volume(one.prisms[0]) == pytest.approx(COURT.area * 16.5)


def test_many_windows_stay_painted():
    """A tower at detail 2 keeps the pictures of its windows, for it would have thousands of recesses."""
    tower = built(box(0, 0, 40, 40), detail=2, style="glass", eaves=120.0)
    assert len(tower.mesh.triangles) < 500
    assert np.isin(tower.mesh.textures, FACADES["glass"]).any()
    check_solid(tower, once=False)


def test_collinear_corners_are_no_corners():
    """A point in the middle of a side changes neither volume nor height."""
    more = Polygon([(0, 0), (7, 0), (16, 0), (16, 11), (4, 11), (0, 11)])
    for roof in ROOF_KINDS:
        plain, split = built(roof=roof), built(more, roof=roof)
        assert volume(split.mesh) == pytest.approx(volume(plain.mesh), rel=1e-9)
        assert split.top == pytest.approx(plain.top)


def test_the_same_dice_build_the_same_house():
    a, b, c = (built(ELL, detail=3, seed=seed).mesh for seed in (4, 4, 5))
    assert all(np.array_equal(getattr(a, name), getattr(b, name)) for name in ("vertices", "triangles", "uv", "colors"))
    assert not (a.colors.shape == c.colors.shape and np.array_equal(a.colors, c.colors))


def test_roofs_are_of_roof():
    mesh = built(roof="hip", style="brick").mesh
    slopes = mesh.textures == ROOFS["tiles"]
    corners = mesh.vertices[mesh.triangles[slopes]]
    assert corners[..., 2].min() >= 16.0
    assert mesh.uv[slopes][..., 1].max() == pytest.approx(np.hypot(5.5, 0.75 * 5.5) / 6.4, rel=1e-5)


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"style": "mud"}, "found 'mud'"),
        ({"roof": "onion"}, "found 'onion'"),
        ({"detail": 4}, "found 4"),
        ({"eaves": -0.5}, "eaves -0.5"),
        ({"eaves": float("nan")}, "nan"),
        ({"blind": [True]}, "found 1"),
    ],
)
def test_mistakes_are_told(change, found):
    with pytest.raises(CityError, match=found):
        built(**change)


def test_points_in_a_line_around_a_courtyard_are_kept():
    """Earcut leaves such points out of its triangles, which would tear floor and walls apart."""
    ring = [(12, 0), (8, 0), (0, 0), (0, 6), (0, 9), (7, 9), (7, 14), (20, 14), (20, 10), (20, 9), (20, 4), (12, 4)]
    shape = Polygon(ring, [[(8, 6), (10, 6), (10, 9), (8, 9)]])
    for eaves in (2.0, 12.0):
        for roof in ROOF_KINDS:
            check_solid(built(shape, eaves=eaves, roof=roof, base=0.0), once=True)


def test_long_fronts_are_solid():
    """Forty bays and three storeys on one side, all recessed."""
    blind = [False, True, True, True]
    one = built(Polygon([(0, 0), (128, 0), (128, 12), (0, 12)]), detail=3, style="brick", eaves=10.0, blind=blind)
    assert (one.mesh.textures == PANES).sum() >= 2 * 2 * 40
    check_solid(one, once=False)
