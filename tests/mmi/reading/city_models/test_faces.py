"""Faces in space: triangles cover them once, turn as their outer ring, and keep the looks of their corners."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmi.city.model import PAINTED, PLAIN
from mmi.reading.city_models.faces import Faces, triangulate_faces


def star(points, radii, turn=0.0):
    angles = np.arange(points) * 2.0 * np.pi / points + turn
    return np.column_stack([np.cos(angles), np.sin(angles)]) * np.resize(radii, points)[:, None]


def rotation(seed):
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else q[:, ::-1]


def shoelace(ring):
    a, b = np.asarray(ring), np.roll(ring, -1, axis=0)
    return 0.5 * float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())


def vectors(points, triangles):
    """(m, 3) twice the area of each triangle, times its normal."""
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    return np.cross(b - a, c - a)


def one_mesh(points, rings, table, **looks):
    faces = Faces()
    assert faces.add(0, rings, **looks)
    return faces.meshes(np.asarray(points, dtype=float), np.asarray(table))[0]


SHAPES = st.tuples(
    st.lists(st.floats(1.2, 3.0), min_size=3, max_size=7),
    st.integers(3, 12),
    st.integers(0, 3),
    st.floats(0.0, 6.0),
    st.integers(0, 999),
    st.booleans(),
)


@settings(max_examples=120, deadline=None)
@given(st.lists(SHAPES, min_size=1, max_size=4))
def test_planar_faces_are_covered_once_and_keep_their_turn(shapes):
    corners, lengths, counts, exact = [], [], [], []
    for radii, count, holes, turn, seed, backwards in shapes:
        # Holes lie within the circle that fits into the coarsest star: 0.5 x 1.2.
        rings = [star(count, radii, turn)]
        rings += [star(4, [0.12], turn) + 0.35 * star(3, [1.0], turn)[k] for k in range(holes)]
        rings[1:] = [ring[::-1] for ring in rings[1:]]
        area = shoelace(rings[0]) + sum(shoelace(ring) for ring in rings[1:])
        axes = rotation(seed)
        normal = axes[:, 2] * (-1.0 if backwards else 1.0)
        place = np.random.default_rng(seed).uniform(-500.0, 500.0, 3)
        for ring in rings:
            spatial = ring @ axes[:, :2].T + place
            corners.append(spatial[::-1] if backwards else spatial)
            lengths.append(len(ring))
        counts.append(len(rings))
        exact.append((area, normal))
    points = np.concatenate(corners)
    triangles, face = triangulate_faces(points, np.array(lengths), np.array(counts))
    assert (np.diff(face) >= 0).all()
    for i, (area, normal) in enumerate(exact):
        along = vectors(points, triangles[face == i]) @ normal
        assert (along >= -1e-9).all(), "all turn as the outer ring"
        assert along.sum() / 2.0 == pytest.approx(area, rel=1e-9)
        own = np.arange(sum(lengths[: sum(counts[:i])]), sum(lengths[: sum(counts[: i + 1])]))
        assert np.isin(triangles[face == i], own).all(), "of its own corners"


@pytest.mark.parametrize("first", range(4))
@pytest.mark.parametrize("backwards", [False, True])
def test_concave_quads(first, backwards):
    arrow = np.roll([(0.0, 0, 0), (2, 1, 0), (0, 2, 0), (0.5, 1, 0)], first, axis=0)  # concave at its last
    arrow = arrow[::-1] if backwards else arrow
    triangles, _ = triangulate_faces(arrow, np.array([4]), np.array([1]))
    up = vectors(arrow, triangles)[:, 2] * (-1.0 if backwards else 1.0)
    assert len(up) == 2
    assert (up > 0).all()
    assert up.sum() / 2 == pytest.approx(abs(shoelace(arrow[:, :2])))


def test_faces_that_are_not_quite_flat_are_covered():
    rng = np.random.default_rng(1)
    rim = np.column_stack([star(9, [2.0, 5.0]), rng.normal(scale=0.05, size=9)])
    triangles, _ = triangulate_faces(rim, np.array([9]), np.array([1]))
    up = vectors(rim, triangles)[:, 2]
    assert (up > 0).all()
    assert up.sum() / 2 == pytest.approx(shoelace(rim[:, :2]))


def test_points_that_repeat_go():
    square = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    uv = [(0, 0), (1, 0), (1, 1), (0, 1)]
    ring = [0, 0, 1, 2, 2, 2, 3, 0]
    mesh = one_mesh(square, [ring], uv, texture=5, uv=[ring])
    assert vectors(mesh.vertices, mesh.triangles)[:, 2].sum() == pytest.approx(2.0)
    assert mesh.uv == pytest.approx(mesh.vertices[mesh.triangles][..., :2])
    faces = Faces()
    assert not faces.add(0, [[0, 1, 1, 0]])
    assert not faces.add(0, [[]])
    assert not faces.add(0, [])
    assert not faces.add(0, [[3]])
    assert len(faces) == 0
    assert faces.meshes(np.zeros((4, 3)), np.empty((0, 2))) == {}
    assert faces.add(0, [[0, 1, 2, 3], [2, 2]]), "a hole of nothing is none"
    assert len(faces.meshes(np.array(square, dtype=float), np.empty((0, 2)))[0].triangles) == 2


@settings(max_examples=40, deadline=None)
@given(st.integers(3, 9), st.integers(0, 2), st.integers(0, 999), st.booleans())
def test_corners_keep_their_texture_coordinates(count, holes, seed, repeat):
    """Oracle: coordinates are an affine image of places in the plane, in every corner of every triangle."""
    rng = np.random.default_rng(seed)
    rings = [star(count, [1.5, 2.0])] + [np.add(star(5, [0.1])[::-1], (0.3 * k, 0.0)) for k in range(holes)]
    flat = np.concatenate(rings)
    axes, affine = rotation(seed), rng.normal(size=(2, 2))
    points, uv = flat @ axes[:, :2].T, flat @ affine + 3.0
    names = np.split(np.arange(len(flat)), np.cumsum([len(ring) for ring in rings])[:-1])
    lists = [name.tolist() + (name[:1].tolist() if repeat else []) for name in names]
    shuffled = rng.permutation(len(uv))  # the table of coordinates has an order of its own
    table = np.empty_like(uv)
    table[shuffled] = uv
    mesh = one_mesh(points, lists, table, texture=2, uv=[shuffled[own].tolist() for own in lists], color=(1, 2, 3))
    back = mesh.vertices[mesh.triangles] @ axes[:, :2]
    assert mesh.uv == pytest.approx(back @ affine + 3.0, abs=1e-5)
    assert (mesh.textures == 2).all()
    assert (mesh.colors == 255).all(), "pictures are not tinted"


@pytest.mark.parametrize(
    "given_faces",
    [
        [[[0, 1, 2]], [[0, 2, 3], [1, 4, 2]], [[4, 3, 2, 1]]],
        [[[0, 1, 2]], [], [[]], [[0, 1, 1, 2, 0]], [[3, 4]], [[0, 2, 3], [1]]],
        [],
    ],
)
def test_many_at_once_are_as_one_by_one(given_faces):
    points = np.random.default_rng(0).normal(size=(5, 3))
    one, many = Faces(), Faces()
    for faces in (one, many):
        faces.add(1, [[0, 1, 4]], color=(1, 2, 3))
    many.add_bare(0, given_faces)
    for face in given_faces:
        one.add(0, face)
    assert len(one) == len(many)
    mine, theirs = (faces.meshes(points, np.empty((0, 2))) for faces in (many, one))
    assert mine.keys() == theirs.keys()
    for owner, mesh in mine.items():
        for name in mesh.__slots__:
            assert (getattr(mesh, name) == getattr(theirs[owner], name)).all()


def test_looks():
    points = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0)], dtype=float)
    uv = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (np.nan, 0.0), (1e30, 0.0)])
    faces = Faces()
    faces.add(3, [[0, 1, 2]])
    faces.add(3, [[0, 2, 3]], color=(10, 20, 30))
    faces.add(7, [[0, 1, 2]], texture=0, uv=[[0, 1, 2]])
    faces.add(7, [[0, 2, 3]], texture=1, uv=[[0, 1]])
    faces.add(7, [[0, 2, 4]], texture=1, uv=[[0, 1, 3]])
    faces.add(7, [[1, 2, 4]], texture=1, uv=[[0, 1, 4]])
    found = faces.meshes(points, uv)
    assert list(found) == [3, 7]
    assert found[3].textures.tolist() == [PAINTED, PLAIN]
    assert found[3].colors.tolist() == [[255] * 3, [10, 20, 30]]
    assert found[7].textures.tolist() == [0, PLAIN, PLAIN, PLAIN], "coordinates missing, of another number, not sane"
    assert not found[7].uv[1:].any()
    assert len(found[3].vertices) == 4, "only its own points"
