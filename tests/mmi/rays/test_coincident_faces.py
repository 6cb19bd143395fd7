"""Faces that coincide are found, and the one that is drawn first is hit, by every caster."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import Polygon
from soups import random_soup, soup_mesh

from mmi.rays.brute_force import brute_force
from mmi.rays.casters import make_caster
from mmi.rays.coincident import coincident_faces
from mmi.rays.grid import build_grid
from mmi.rays.ray_triangle import bounds_of


def pairs_of(soup):
    """The pairs of coincident triangles (i, j), i < j."""
    corners = np.asarray(soup, dtype=np.float32).reshape(-1, 9)
    found = coincident_faces(corners, bounds_of(corners), build_grid(corners))
    firsts = np.repeat(np.arange(len(corners)), np.diff(found.starts))
    both = {(int(i), int(j)) for i, j in zip(firsts, found.others, strict=True)}
    assert both == {(j, i) for i, j in both}
    return {(i, j) for i, j in both if i < j}


SQUARE = np.array([[[0, 0, 0], [4, 0, 0], [4, 4, 0]], [[0, 0, 0], [4, 4, 0], [0, 4, 0]]], dtype=np.float64)


def test_a_square_has_no_coincident_faces():
    assert pairs_of(SQUARE) == set()


@pytest.mark.parametrize("turn", [False, True])
@pytest.mark.parametrize("first", [0, 1, 2])
def test_repeated_faces_coincide_whichever_way_they_face(turn, first):
    again = np.roll(SQUARE, first, axis=1)[:, :: -1 if turn else 1]
    assert pairs_of(np.concatenate([SQUARE, again])) == {(0, 2), (1, 3)}


def test_faces_that_overlap_in_part_coincide():
    assert pairs_of(np.concatenate([SQUARE, np.add(SQUARE[:1], (3.0, 1.0, 0.0))])) == {(0, 2)}
    assert pairs_of(np.concatenate([SQUARE, np.add(SQUARE[:1], (4.0, 0.0, 0.0))])) == set()


def test_faces_a_millimetre_apart_coincide():
    assert pairs_of(np.concatenate([SQUARE[:1], np.add(SQUARE[:1], (0.0, 0.0, 0.0009))])) == {(0, 1)}
    assert pairs_of(np.concatenate([SQUARE[:1], np.add(SQUARE[:1], (0.0, 0.0, 0.0011))])) == set()


def test_crossing_faces_do_not_coincide():
    tilted = SQUARE + np.array([0.0, 0.0, 1.0]) * (0.1 * SQUARE[..., :1] - 0.2)
    assert pairs_of(np.concatenate([SQUARE, tilted])) == set()


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(*[st.tuples(*[st.integers(0, 5)] * 2)] * 3), min_size=2, max_size=15), st.integers(0, 2))
def test_faces_in_one_plane_coincide_where_their_polygons_overlap(flat, axis):
    flat = [Polygon(one) for one in flat]
    flat = [one for one in flat if one.area > 0.0]
    soup = [np.insert(np.array(one.exterior.coords)[:3], axis, 2.5, axis=1) for one in flat]
    expected = {(i, j) for j in range(len(flat)) for i in range(j) if flat[i].intersection(flat[j]).area > 1e-6}
    assert not soup or pairs_of(soup) == expected


@pytest.mark.parametrize("kind", ["brute", "grid", "embree"])
def test_the_first_drawn_is_hit(kind):
    """Walls in one plane, in shuffled order and orientation: each ray hits the first drawn of those that it meets."""
    rng = np.random.default_rng(6)
    flat = random_soup(rng, 40, size=3.0, spread=(10.0, 10.0, 0.0))
    flat[..., 2] = 0.0
    along = np.array([[0.6, 0.8, 0.0], [0.0, 0.0, 1.0], [0.8, -0.6, 0.0]])
    soup = (flat @ along + (120.0, 50.0, 3.0)).astype(np.float32)
    mesh = soup_mesh(soup)
    caster = brute_force(mesh) if kind == "brute" else make_caster(mesh, kind=kind, workers=1)
    targets = rng.uniform(0.0, 10.0, (2000, 2))
    points = np.column_stack([targets, np.zeros(2000)]) @ along + (120.0, 50.0, 3.0)
    origin = np.array([3.0, -2.0, 1.7])
    directions = (points - origin) / np.linalg.norm(points - origin, axis=1, keepdims=True)
    hits = caster.first_hits(origin, directions, nearest=20.0)
    ring = flat[:, [0, 1, 2, 0], :2]
    turns = np.cross(
        np.insert(ring[:, 1:] - ring[:, :3], 2, 0.0, axis=-1)[None],
        np.insert(targets[:, None, None] - ring[None, :, :3], 2, 0.0, axis=-1),
    )[..., 2]
    inside = (turns > 0.0).all(axis=2) | (turns < 0.0).all(axis=2)
    clear = np.abs(turns).min(axis=(1, 2)) > 0.02
    expected = np.where(inside.any(axis=1), inside.argmax(axis=1), -1)
    assert (expected >= 0).sum() > 500
    np.testing.assert_array_equal(hits.triangle[clear], expected[clear])


def test_many_flat_roofs_at_one_height_are_no_trouble():
    """Roofs side by side in one plane: as many as a city has, and none coincides."""
    x, y = (one.ravel() for one in np.meshgrid(np.arange(150.0), np.arange(150.0)))
    soup = np.concatenate([SQUARE[k] / 4.0 + np.stack([x, y, np.full_like(x, 9.0)], axis=1)[:, None] for k in (0, 1)])
    assert pairs_of(soup) == set()
