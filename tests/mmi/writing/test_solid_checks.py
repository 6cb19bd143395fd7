from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from model_cities import BOX_TRIANGLES, QUADS, box_corners, dressed_box, open_box
from solid_checks import NAMES, check_mesh, check_solid, check_surfaces

from mmi.city.model import TriangleMesh
from mmi.city.welding import is_closed, volume, weld

CUBE = box_corners(0, 0, 0, 10, 10, 10)
SHELL = [[list(quad)] for quad in QUADS]


def codes(defects):
    return {(one.code, one.name) for one in defects}


def only(code):
    return {(code, NAMES[code])}


def test_whole_solids_have_no_defects():
    assert check_solid(CUBE, [SHELL]) == []
    assert check_mesh(dressed_box()) == []


def test_a_cube_with_a_cavity_has_none_either():
    cavity = [[[8 + index for index in reversed(quad)]] for quad in QUADS]
    vertices = np.concatenate([CUBE, box_corners(3, 3, 3, 7, 7, 7)])
    assert check_solid(vertices, [SHELL, cavity]) == []
    outwards = [[ring[::-1] for ring in surface] for surface in cavity]
    found = check_solid(vertices, [SHELL, outwards])
    assert codes(found) == only(405)
    assert found[0].where == "shell 1"


def test_too_few_points():
    assert codes(check_solid(CUBE, [[*SHELL, [[0, 1]]]])) == only(101)


def test_consecutive_points_same():
    vertices = np.concatenate([CUBE, CUBE[:1]])
    broken = [[[0, 8, 3, 2, 1]], *SHELL[1:]]
    found = check_solid(vertices, [broken], where="way/1")
    assert codes(found) == only(102)
    assert found[0].where == "way/1: shell 0, surface 0, ring 0"
    assert codes(check_solid(CUBE, [[[[0, 3, 2, 1, 0]], *SHELL[1:]]])) == only(
        102
    )  # a ring that repeats its first point


@pytest.mark.parametrize("ring", [[4, 6, 5, 7], [4, 5, 6, 7, 6]])
def test_ring_self_intersection(ring):
    assert codes(check_solid(CUBE, [[SHELL[0], [ring], *SHELL[2:]]])) == only(104)


def test_collapsed_ring():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]])
    assert codes(check_surfaces(vertices, [[[0, 1, 2]]])) == only(104)


@pytest.mark.parametrize(
    ("code", "hole"),
    [
        (206, [(20, 20), (20, 22), (22, 22), (22, 20)]),
        (201, [(8, 4), (8, 6), (12, 6), (12, 4)]),
        (208, [(2, 2), (4, 2), (4, 4), (2, 4)]),
    ],
)
def test_holes(code, hole):
    square = [(0, 0), (10, 0), (10, 10), (0, 10)]
    vertices = np.array([(x, y, 3.0) for x, y in square + hole])
    assert codes(check_surfaces(vertices, [[[0, 1, 2, 3], [4, 5, 6, 7]]])) == only(code)


def test_nested_holes_and_cut_interior():
    square = [(0, 0), (10, 0), (10, 10), (0, 10)]
    holes = [[(1, 1), (1, 9), (9, 9), (9, 1)], [(3, 3), (3, 5), (5, 5), (5, 3)]]
    points = np.array([(x, y, 0.0) for x, y in square + holes[0] + holes[1]])
    assert codes(check_surfaces(points, [[[0, 1, 2, 3], [4, 5, 6, 7], [8, 9, 10, 11]]])) == only(207)
    diamond = np.array([(x, y, 0.0) for x, y in [*square, (0, 5), (5, 8), (10, 5), (5, 2)]])
    assert codes(check_surfaces(diamond, [[[0, 1, 2, 3], [4, 5, 6, 7]]])) == only(205)


def test_a_courtyard_is_no_defect():
    vertices = np.array([(0, 0, 1), (10, 0, 1), (10, 10, 1), (0, 10, 1), (2, 2, 1), (2, 4, 1), (4, 4, 1), (4, 2, 1)])
    assert check_surfaces(vertices, [[[0, 1, 2, 3], [4, 5, 6, 7]]]) == []


def test_non_planar_quad():
    lifted = CUBE.copy()
    lifted[6, 2] += 0.1
    assert codes(check_solid(lifted, [SHELL])) == only(203)
    lifted[6, 2] = CUBE[6, 2] + 0.005
    assert check_solid(lifted, [SHELL]) == []


def test_normals_deviation():
    """An ear of 2 cm whose tip is 9 mm up: within a centimetre of the plane, but bent by 24 degrees."""
    ear = [(0, 5.01, 0), (-0.02, 5, 0.009), (0, 4.99, 0)]
    vertices = np.array([(0, 0, 0), (10, 0, 0), (10, 10, 0), (0, 10, 0), *ear])
    assert codes(check_surfaces(vertices, [[list(range(7))]])) == only(204)
    vertices[5, 2] = 0.0
    assert check_surfaces(vertices, [[list(range(7))]]) == []


def test_too_few_polygons():
    assert codes(check_solid(CUBE, [SHELL[:3]])) == only(301)


def test_a_hole_punched():
    assert codes(check_solid(CUBE, [SHELL[1:]])) == only(302)
    assert codes(check_mesh(open_box())) == only(302)


def test_a_fin():
    vertices = np.concatenate([CUBE, [[0, -5, 0], [0, -5, 10]]])
    fin = [[[0, 4, 9, 8]], [[0, 8, 9, 4]]]
    assert codes(check_solid(vertices, [SHELL + fin])) == only(303)


@pytest.mark.parametrize(("shift", "code"), [((10, 10, 10), 303), ((10, 10, 0), 303), ((20, 0, 0), 305)])
def test_two_cubes_in_one_shell(shift, code):
    """They touch in a vertex, along an edge, or not at all."""
    other = [[[8 + index for index in quad]] for quad in QUADS]
    assert codes(check_solid(np.concatenate([CUBE, CUBE + shift]), [SHELL + other])) == only(code)


def test_a_face_flipped():
    broken = [*SHELL[:3], [SHELL[3][0][::-1]], *SHELL[4:]]
    assert codes(check_solid(CUBE, [broken])) == only(307)


def test_all_faces_flipped():
    assert codes(check_solid(CUBE, [[[ring[::-1] for ring in surface] for surface in SHELL]])) == only(405)


def test_surfaces_that_pierce_each_other():
    """A pyramid's apex pushed down through its base."""
    vertices = np.array([(0, 0, 0), (10, 0, 0), (10, 10, 0), (0, 10, 0), (5, 5, 6), (4, 4, -2)], dtype=float)
    whole = [[[0, 3, 2, 1]], [[0, 1, 4]], [[1, 2, 4]], [[2, 3, 4]], [[3, 0, 4]]]
    assert check_solid(vertices, [whole]) == []
    # The base is a dent that comes out at the top.
    dented = [[[0, 5, 1]], [[1, 5, 2]], [[2, 5, 3]], [[3, 5, 0]], *whole[1:]]
    vertices[5] = (5, 4, 3)
    assert check_solid(vertices, [dented]) == []
    vertices[5] = (5, 0.5, 5)
    assert codes(check_solid(vertices, [dented])) == only(306)
    assert check_solid(vertices, [dented], self_intersections=False) == []


def test_surfaces_that_cover_each_other():
    """A slot as thin as nothing: its two sides are the same square."""
    vertices = np.array([(0, 0, 0), (10, 0, 0), (10, 10, 0), (0, 10, 0), (5, 5, 6), (5, 5, 0)], dtype=float)
    flat = [[[0, 3, 2, 1]], [[0, 1, 5]], [[1, 2, 5]], [[2, 3, 5]], [[3, 0, 5]]]
    assert codes(check_solid(vertices, [flat])) == only(306)


def test_closed_is_by_place_not_by_index():
    split = CUBE[BOX_TRIANGLES].reshape(-1, 3)
    assert is_closed(split, np.arange(36).reshape(-1, 3))
    assert is_closed(CUBE, BOX_TRIANGLES)
    assert not is_closed(CUBE, BOX_TRIANGLES[1:])
    assert not is_closed(CUBE, np.concatenate([BOX_TRIANGLES, BOX_TRIANGLES]))
    assert not is_closed(CUBE, BOX_TRIANGLES[:0])
    flipped = BOX_TRIANGLES.copy()
    flipped[4] = flipped[4, ::-1]
    assert not is_closed(CUBE, flipped)
    assert is_closed(CUBE, np.concatenate([BOX_TRIANGLES, [[0, 0, 1]]])), "a triangle of two corners is none"


def closed_plainly(vertices, triangles):
    """The same, edge by edge."""
    edges = [
        (tuple(vertices[t[k]]), tuple(vertices[t[(k + 1) % 3]]))
        for t in triangles
        if len({tuple(vertices[i]) for i in t}) == 3
        for k in range(3)
    ]
    return bool(edges) and len(set(edges)) == len(edges) and {(b, a) for a, b in edges} == set(edges)


@given(st.lists(st.tuples(*[st.integers(0, 3)] * 3), max_size=6), st.permutations(range(4)), st.booleans())
def test_closed_as_edge_by_edge(extra, order, whole):
    tetrahedron = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)] if whole else []
    triangles = np.array(tetrahedron + extra, dtype=np.int64).reshape(-1, 3)
    vertices = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype=float)[list(order)]
    assert is_closed(vertices, triangles) == closed_plainly(vertices, triangles)


@given(*[st.floats(0.1, 100.0)] * 3, st.floats(-1e6, 1e6))
def test_volume_of_boxes(wide, deep, high, away):
    corners = box_corners(away, -away, 5, away + wide, deep - away, 5 + high)
    exact = np.prod(corners[6] - corners[0])
    assert volume(corners, BOX_TRIANGLES) == pytest.approx(exact, rel=1e-9)
    assert volume(corners, BOX_TRIANGLES[:, ::-1]) == pytest.approx(-exact, rel=1e-9)


def test_volume_of_nothing():
    assert volume(CUBE, np.empty((0, 3), dtype=int)) == 0.0


def test_weld_takes_both_zeros_as_one():
    assert weld([[0.0, 1.0, 2.0], [-0.0, 1.0, 2.0], [0.0, 1.0, 2.5]]).tolist() == [0, 0, 1]


def test_an_empty_mesh_is_no_solid():
    empty = TriangleMesh(np.empty((0, 3)), np.empty((0, 3), dtype=np.int32))
    assert codes(check_mesh(empty)) == only(301)
