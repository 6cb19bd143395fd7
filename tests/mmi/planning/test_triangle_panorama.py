"""Panoramas of triangles against rays cast at the same triangles by brute force."""

import math

import numpy as np
import pytest
from hills import _cast

from mmi.planning.triangle_panorama import draw_triangles, empty_panorama, spans_of

COLUMNS, UP, DOWN, ROW = 180, 40, 30, 0.03


def drawn(corners, eye):
    """A panorama of triangles with ``corners`` (m, 3, 3)."""
    panorama = empty_panorama(COLUMNS, up=UP, down=DOWN, row=ROW)
    everywhere = np.tile(np.array([0, UP + DOWN], dtype=np.int64), (COLUMNS, 1))
    vertices = corners.reshape(-1, 3).astype(np.float32)
    triangles = np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)
    draw_triangles(vertices, triangles, np.arange(len(corners)), eye, panorama, everywhere)
    return panorama


def by_rays(corners, eye):
    """What the centres of all pixels meet: distance along the ground, triangle."""
    turn = 2.0 * math.pi / COLUMNS
    azimuth, slope = np.meshgrid((np.arange(COLUMNS) + 0.5) * turn, (np.arange(-DOWN, UP) + 0.5) * ROW, indexing="ij")
    rays = np.stack([np.cos(azimuth), np.sin(azimuth), slope], axis=-1).reshape(-1, 3)
    far, hit = _cast(
        np.ascontiguousarray(np.broadcast_to(eye, rays.shape)),
        rays,
        corners.astype(np.float32).astype(float),
        np.arange(len(corners) + 1),
        np.column_stack([corners.mean(axis=1), np.full(len(corners), 1e4)]),
        np.arange(len(corners)),
    )
    return far.reshape(azimuth.shape), hit.reshape(azimuth.shape)


@pytest.mark.parametrize("seed", range(8))
def test_a_panorama_shows_what_rays_meet(seed):
    """Triangles anywhere around the viewpoint, above and below it and behind the seam of azimuths."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-20.0, 20.0, (30, 1, 3)) + rng.uniform(-15.0, 15.0, (30, 3, 3))
    corners = np.concatenate([corners, [[(-30.0, -30.0, 9.0), (30.0, -30.0, 9.0), (0.0, 40.0, 9.0)]]])
    eye = np.array([0.3, -0.2, 1.7])
    panorama, (far, hit) = drawn(corners, eye), by_rays(corners, eye)
    assert (hit >= 0).mean() > 0.5
    same = panorama.triangle == hit
    assert same.mean() > 0.999  # but for roundings along edges
    met = same & (hit >= 0)
    np.testing.assert_allclose(panorama.inverse[met], 1.0 / far[met], rtol=1e-4)


def test_nothing_is_drawn_outside_of_the_rows_asked_for():
    corners = np.array([[(10.0, -5.0, -5.0), (10.0, 5.0, -5.0), (10.0, 0.0, 8.0)]])
    whole = drawn(corners, np.zeros(3))
    spans = spans_of(whole)
    shown = whole.triangle >= 0
    assert shown.any()
    np.testing.assert_array_equal(spans[:, 1] - spans[:, 0], shown.sum(axis=1))
    half = empty_panorama(COLUMNS, up=UP, down=DOWN, row=ROW)
    rows = spans.copy()
    rows[:, 1] = np.minimum(rows[:, 1], DOWN)
    draw_triangles(
        corners.reshape(-1, 3).astype(np.float32),
        np.array([[0, 1, 2]], dtype=np.int32),
        np.array([0]),
        np.zeros(3),
        half,
        rows,
    )
    np.testing.assert_array_equal(half.triangle[:, :DOWN], whole.triangle[:, :DOWN])
    assert (half.triangle[:, DOWN:] < 0).all()
