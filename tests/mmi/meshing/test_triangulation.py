"""Rectangles to triangles: all of them filled once, no triangle a line, from the middle only where that is needed."""

import math

import numpy as np
import pytest
from numba.typed import List

from mmi.foundation.ray_chords import Intrinsics
from mmi.meshing.displacement import Captured
from mmi.meshing.tears import JOINED, LOWER_LEFT, LOWER_RIGHT, UPPER_LEFT, UPPER_RIGHT, Lattice
from mmi.meshing.triangulation import triangulated

INTRINSICS = Intrinsics(-16.0, -16.0, 100.0)
OFFSETS = np.array([[x, 0.0, z] for x in (-3.0, 3.0) for z in (-3.0, 3.0)])
"""Viewpoints in the capture's eye space, metres."""


def boxes_of(*boxes):
    return List([tuple(int(x) for x in box) for box in boxes])


def run(inverse, known, *boxes, tolerance=1e-3):
    """Of one surface: all texels around a corner share what is ``known`` there."""
    corners = Lattice(np.full(known.shape, JOINED, np.uint8), np.repeat(known[..., None], 4, axis=2))
    return triangulated(Captured(inverse, INTRINSICS, OFFSETS), boxes_of(*boxes), corners, tolerance)


def plane(side=32, across=0.0, down=0.0):
    """1/z at texels' centres and at their corners."""

    def at(shift, count):
        j, i = np.mgrid[:count, :count] + shift
        return 0.02 + across * i + down * j

    return at(0.5, side), at(0.0, side + 1)


def areas(lattice, triangles):
    a, b, c = (lattice[triangles[:, k]] for k in range(3))
    return 0.5 * ((b - a)[:, 1] * (c - a)[:, 0] - (b - a)[:, 0] * (c - a)[:, 1])


def halves(box, rng, depth):
    x0, y0, x1, y1 = box
    if depth == 0 or max(x1 - x0, y1 - y0) < 2 or rng.random() < 0.2:
        return [box]
    if x1 - x0 > 1 and (y1 - y0 < 2 or rng.random() < 0.5):
        k = int(rng.integers(x0 + 1, x1))
        return halves((x0, y0, k, y1), rng, depth - 1) + halves((k, y0, x1, y1), rng, depth - 1)
    k = int(rng.integers(y0 + 1, y1))
    return halves((x0, y0, x1, k), rng, depth - 1) + halves((x0, k, x1, y1), rng, depth - 1)


@pytest.mark.parametrize("seed", range(12))
def test_every_rectangle_is_filled_once_and_planes_need_no_middles(seed):
    rng = np.random.default_rng(seed)
    inverse, known = plane(across=1e-5, down=-2e-5)
    boxes = halves((0, 0, 32, 32), rng, 6)
    lattice, triangles, values = run(inverse, known, *boxes)
    found = areas(lattice, triangles)
    assert (found > 0.0).all()
    assert math.isclose(found.sum(), 32 * 32)
    assert np.allclose(values, 0.02 + lattice @ [1e-5, -2e-5])
    # Each triangle lies in one box, and no vertex inside of a triangle's side: then sides match, and nothing cracks.
    middles = lattice[triangles].mean(axis=1)
    for box in boxes:
        x0, y0, x1, y1 = box
        inside = (middles > [x0, y0]).all(axis=1) & (middles < [x1, y1]).all(axis=1)
        on = (lattice >= [x0, y0]).all(axis=1) & (lattice <= [x1, y1]).all(axis=1)
        corners = lattice[triangles[inside]]
        assert (corners >= [x0, y0]).all() and (corners <= [x1, y1]).all()
        assert set(np.unique(triangles[inside]).tolist()) == set(np.flatnonzero(on).tolist())
        extras = [np.count_nonzero(on & strictly_on(lattice, box, side)) for side in range(4)]
        fan = 1 in extras or any(extras[k] + extras[k - 1] == 0 for k in range(4))
        assert inside.sum() == on.sum() - (2 if fan else 1)


def strictly_on(lattice, box, side):
    """(n,) which vertices are on a side, corners left out; sides in turn."""
    (x, y), (x0, y0, x1, y1) = lattice.T, box
    level, upright = (x0 < x) & (x < x1), (y0 < y) & (y < y1)
    return ((y == y0) & level, (x == x1) & upright, (y == y1) & level, (x == x0) & upright)[side]


def test_rectangles_of_two_surfaces_share_no_vertex():
    """The right one lies on another surface from the third row on: below, each has a vertex of its own at every corner."""
    surfaces = np.full((9, 9), JOINED, dtype=np.uint8)
    surfaces[2:, 4] = UPPER_RIGHT << 2 * UPPER_RIGHT | UPPER_LEFT << 2 * LOWER_LEFT | UPPER_RIGHT << 2 * LOWER_RIGHT
    values = np.full((9, 9, 4), 0.02)
    values[2:, 4, UPPER_RIGHT] = 0.03
    captured = Captured(np.full((8, 8), 0.02), INTRINSICS, OFFSETS)
    boxes = boxes_of((0, 0, 4, 2), (4, 0, 8, 2), (0, 2, 4, 5), (4, 2, 8, 8), (0, 5, 4, 8))
    lattice, triangles, found = triangulated(captured, boxes, Lattice(surfaces, values), 1e-3)
    on = {y: sorted(found[(lattice == [4, y]).all(axis=1)].tolist()) for y in (0, 2, 5, 8)}
    assert on == {0: [0.02], 2: [0.02, 0.03], 5: [0.02], 8: [0.02, 0.03]}
    middles = lattice[triangles].mean(axis=1)
    right = (middles[:, 0] > 4.0) & (middles[:, 1] > 2.0)
    assert not np.isin(triangles[right], triangles[(middles[:, 0] < 4.0)]).any()
    assert math.isclose(areas(lattice, triangles).sum(), 64.0)


def test_a_crowded_rectangle_has_its_middle():
    """With two vertices on every side, any fan from one of them has a line for a triangle."""
    inverse, known = plane()
    thirds = [(0, 4), (4, 8), (8, 12)]
    around = [(a + 10, 6, b + 10, 10) for a, b in thirds] + [(a + 10, 22, b + 10, 26) for a, b in thirds]
    around += [(6, a + 10, 10, b + 10) for a, b in thirds] + [(22, a + 10, 26, b + 10) for a, b in thirds]
    lattice, triangles, _ = run(inverse, known, (10, 10, 22, 22), *around)
    middle = np.flatnonzero((lattice == [16, 16]).all(axis=1))
    assert len(middle) == 1
    assert (triangles == middle[0]).any(axis=1).sum() == 12


def test_a_fan_never_displaces_more_than_one_from_the_middle():
    """A vertex on the upper side lies nearer: from there, all of the box would bulge."""
    inverse, known = plane()
    known = known.copy()
    known[8, 16] *= 1.2
    big, small = (8, 8, 24, 24), [(8, 4, 16, 8), (16, 4, 24, 8)]
    lattice, triangles, values = run(inverse, known, big, *small, tolerance=1e-6)
    off = displaced(inverse, lattice, triangles, values)
    apex = np.flatnonzero((lattice == [16, 8]).all(axis=1))
    inside = lattice[triangles].mean(axis=1)[:, 1] > 8.0
    assert not (inside.sum() == 3 and (triangles[inside] == apex).any(axis=1).all())
    assert off[8:24, 8:24].max() <= displaced_from_middle(inverse, known, big, (16, 8)) + 1e-12


def displaced(inverse, lattice, triangles, values):
    """(h, w) relative difference of 1/z, by brute force."""
    off = np.zeros(inverse.shape)
    for t in triangles:
        a, b, c = lattice[t]
        matrix = np.linalg.inv(np.column_stack([b - a, c - a]))
        for j in range(inverse.shape[0]):
            for i in range(inverse.shape[1]):
                q, r = matrix @ (np.array([i + 0.5, j + 0.5]) - a)
                if q >= 0.0 and r >= 0.0 and q + r <= 1.0:
                    w = values[t[0]] + q * (values[t[1]] - values[t[0]]) + r * (values[t[2]] - values[t[0]])
                    off[j, i] = max(off[j, i], abs(w / inverse[j, i] - 1.0))
    return off


def displaced_from_middle(inverse, known, box, extra):
    x0, y0, x1, y1 = box
    ring = [(x0, y0), (x0, y1), (x1, y1), (x1, y0), extra]
    lattice = np.array([*ring, (0.5 * (x0 + x1), 0.5 * (y0 + y1))])
    values = np.array([*(known[y, x] for x, y in ring), 0.5 * (known[y0, x0] + known[y1, x1])])
    triangles = np.array([(k, (k + 1) % 5, 5) for k in range(5)])
    return displaced(inverse, lattice, triangles, values)[y0:y1, x0:x1].max()
