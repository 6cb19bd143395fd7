from itertools import pairwise

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from mmi.city.model import TriangleMesh
from mmi.city.welding import is_closed, volume
from mmi.reading.models.needles import without_needles


def slimmest(mesh):
    corners = mesh.vertices[mesh.triangles]
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).max(axis=1)
    double = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return (double / sides).min()


def folds(mesh):
    """Edges over which two faces lie on each other."""
    corners = mesh.vertices[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    edges = {tuple(edge): i for i, face in enumerate(mesh.triangles.tolist()) for edge in pairwise([*face, face[0]])}
    return sum(normal[i] @ normal[edges[b, a]] < -0.99 for (a, b), i in edges.items())


def area(mesh):
    corners = mesh.vertices[mesh.triangles]
    return 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()


def with_point_on_a_side(box, side, t):
    """A box whose triangle ``side`` has a point on its first edge that only a needle beside it knows of."""
    a, b, c = box.faces[side]
    points = np.vstack([box.vertices, box.vertices[a] + t * (box.vertices[b] - box.vertices[a])])
    new = len(points) - 1
    faces = [face for i, face in enumerate(box.faces.tolist()) if i != side]
    faces += [[a, new, c], [new, b, c], [a, b, new]]
    return points, np.array(faces)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 11), st.floats(0.1, 0.9), st.randoms())
def test_a_needle_goes_and_the_box_stays_closed(side, t, random):
    points, faces = with_point_on_a_side(trimesh.creation.box((8.0, 6.0, 5.0)), side, t)
    random.shuffle(order := list(range(len(faces))))
    uv = points[faces[order]][:, :, :2]
    mesh = without_needles(TriangleMesh(points, faces[order].astype(np.int32), uv=uv))
    assert is_closed(mesh.vertices, mesh.triangles)
    assert volume(mesh.vertices, mesh.triangles) == pytest.approx(8.0 * 6.0 * 5.0)
    assert area(mesh) == pytest.approx(2 * (48.0 + 40.0 + 30.0))
    assert slimmest(mesh) > 0.1
    # Texture coordinates that were linear in space still are.
    np.testing.assert_allclose(mesh.uv, mesh.vertices[mesh.triangles][:, :, :2], atol=1e-5)


def test_several_on_one_line_go_one_after_the_other():
    """A fan of triangles without area over a side with points in between, as cutting of ears leaves it."""
    points = np.array([[0.0, 0, 0], [4, 0, 0], [4, 3, 0], [0, 3, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [2, 1.5, 4]])
    roof = [[0, 4, 7], [4, 5, 7], [5, 6, 7], [6, 1, 7], [1, 2, 7], [2, 3, 7], [3, 0, 7]]
    floor = [[1, 0, 3], [1, 3, 2], [0, 1, 4], [4, 1, 5], [5, 1, 6]]
    assert is_closed(points, np.array(roof + floor))
    mesh = without_needles(TriangleMesh(points, np.array(roof + floor, dtype=np.int32)))
    assert is_closed(mesh.vertices, mesh.triangles)
    assert slimmest(mesh) > 0.1
    assert volume(mesh.vertices, mesh.triangles) == pytest.approx(4 * 3 * 4 / 3)


def test_a_triangle_that_rounding_turned_over_goes():
    """The middle of a side of the floor lies a millimetre beyond it: the sliver beside it faces up, over the floor."""
    points, faces = with_point_on_a_side(trimesh.creation.box((8.0, 6.0, 5.0)), 0, 0.4)
    inward = points[trimesh.creation.box((8.0, 6.0, 5.0)).faces[0, 2]] - points[-1]
    for beyond in (0.001, -0.001):
        moved = points.copy()
        moved[-1] += beyond * inward / np.linalg.norm(inward)
        mesh = without_needles(TriangleMesh(moved, faces.astype(np.int32)))
        assert is_closed(mesh.vertices, mesh.triangles)
        assert folds(mesh) == 0
        assert volume(mesh.vertices, mesh.triangles) == pytest.approx(240.0, abs=0.05)


def test_needles_that_lie_on_each_other_do_not_change_places_for_ever():
    """A floor divided at two points of a side, both known to one needle beside another, as folded roofs leave it."""
    points = np.array([[0.0, 0, 0], [6, 0, 0], [6, 4, 0], [0, 4, 0], [2, 0, 0], [4, 0, 0], [3, 2, 5]])
    points[4, 1], points[5, 1] = -0.0004, 0.0004
    faces = [[0, 4, 6], [4, 5, 6], [5, 1, 6], [1, 2, 6], [2, 3, 6], [3, 0, 6]]
    faces += [[3, 1, 0], [3, 2, 1], [0, 1, 4], [4, 1, 5]]
    for turn in range(len(faces)):
        turned = np.roll(np.array(faces, dtype=np.int32), turn, axis=0)
        assert is_closed(points, turned)
        mesh = without_needles(TriangleMesh(points, turned))
        assert is_closed(mesh.vertices, mesh.triangles)
        assert slimmest(mesh) > 0.1
        assert volume(mesh.vertices, mesh.triangles) == pytest.approx(40.0, abs=0.02)


def test_triangles_with_two_corners_in_one_place_go():
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    faces = np.vstack([box.faces, [[0, 0, 1], [1, 0, 0]]])
    mesh = without_needles(TriangleMesh(box.vertices, faces.astype(np.int32)))
    assert len(mesh.triangles) == 12


def test_a_sound_mesh_is_left_alone():
    sphere = trimesh.creation.icosphere()
    mesh = TriangleMesh(sphere.vertices, sphere.faces.astype(np.int32))
    assert without_needles(mesh) is mesh
