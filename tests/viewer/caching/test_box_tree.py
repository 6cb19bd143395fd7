from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from soups import random_soup

from mmi.foundation.errors import ParameterError
from viewer.caching.box_tree import box_tree


def tree_of(corners, **options):
    corners = np.asarray(corners, dtype=np.float32).reshape(-1, 3, 3)
    return box_tree(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), **options)


def sound(tree):
    """What holds for every tree, whatever is in it."""
    count = len(tree.boxes)
    assert (np.diff(tree.boxes, axis=1) >= 0.0).all()
    assert tree.levels[0] == 0 and tree.levels[1] == 1 and tree.levels[-1] == count and (np.diff(tree.levels) > 0).all()
    assert tree.parents[0] == -1 and tree.ranges[0].tolist() == [0, len(tree.references)]
    level = np.searchsorted(tree.levels, np.arange(count), side="right") - 1
    assert tree.children[0, 0] == 1 and (tree.children[1:, 0] == tree.children[:-1, 1]).all()
    assert tree.children[-1, 1] == count
    for node in range(count):
        first, end = tree.children[node]
        start, stop = tree.ranges[node]
        own = tree.triangles_of(node)
        assert (np.diff(own) > 0).all()
        if first == end:
            assert tree.is_leaf[node]
            assert tree.references[start:stop].tolist() == own.tolist(), "ascending, each once"
            continue
        assert not tree.is_leaf[node]
        assert 2 <= end - first <= 8
        assert (tree.parents[first:end] == node).all() and (level[first:end] == level[node] + 1).all()
        assert tree.ranges[first:end, 0].tolist() == [start, *tree.ranges[first : end - 1, 1]]
        assert tree.ranges[end - 1, 1] == stop
        below = tree.boxes[first:end]
        assert (below[:, 0] >= tree.boxes[node, 0]).all() and (below[:, 1] <= tree.boxes[node, 1]).all()
        together = np.array([below[:, 0].min(axis=0), below[:, 1].max(axis=0)])
        assert np.abs(together - tree.boxes[node]).max() <= 1e-12 * np.abs(tree.boxes[node]).max()
        lowest = np.maximum(below[:, None, 0], below[None, :, 0])
        highest = np.minimum(below[:, None, 1], below[None, :, 1])
        apart = (highest - lowest <= 0.0).any(axis=2)
        assert apart[~np.eye(len(below), dtype=bool)].all()
    return tree


def clipped(polygon, axis, plane, sign):
    """The part of a polygon, a list of points, below a plane, or above it where ``sign`` is -1; exact in fractions."""
    part = []
    for last, point in zip([*polygon[-1:], *polygon[:-1]], polygon, strict=True):
        before, here = sign * (last[axis] - plane), sign * (point[axis] - plane)
        if before * here < 0:
            part.append(tuple(p + (q - p) * before / (before - here) for p, q in zip(last, point, strict=True)))
        if here <= 0:
            part.append(point)
    return part


def exact(triangle):
    return [tuple(Fraction(float(one)) for one in corner) for corner in np.asarray(triangle, dtype=np.float32)]


def shadows(polygon):
    """Twice the areas, with signs, of a polygon seen along each axis."""
    return [
        sum(
            p[(n + 1) % 3] * q[(n + 2) % 3] - p[(n + 2) % 3] * q[(n + 1) % 3]
            for p, q in zip([*polygon[-1:], *polygon[:-1]], polygon, strict=True)
        )
        for n in range(3)
    ]


def in_box(triangle, box):
    part = exact(triangle)
    for axis in range(3):
        for end, sign in ((0, -1), (1, 1)):
            part = clipped(part, axis, Fraction(float(box[end, axis])), sign)
    return part


def bounds(parts):
    points = [point for _, polygon in parts for point in polygon]
    return [[choose(one[n] for one in points) for n in range(3)] for choose in (min, max)]


def halves(parts):
    low, high = bounds(parts)
    sides = [b - a for a, b in zip(low, high, strict=True)]
    axis = sides.index(max(sides))
    plane = (low[axis] + high[axis]) / 2
    below, above = [], []
    for name, polygon in parts:
        along = [point[axis] for point in polygon]
        if max(along) <= plane:
            below.append((name, polygon))
        elif min(along) >= plane:
            above.append((name, polygon))
        else:
            below.append((name, clipped(polygon, axis, plane, 1)))
            above.append((name, clipped(polygon, axis, plane, -1)))
    return [one for one in (below, above) if one]


def twin(parts, growth, *, leaf_triangles, depth):
    """The tree as it is described, in exact arithmetic, of polygons that are cut into pieces: box, triangles and children."""
    low, high = bounds(parts)
    sides = [b - a for a, b in zip(low, high, strict=True)]
    children = []
    if len(parts) > leaf_triangles and depth > 0 and max(sides) > 0:
        pieces = [parts]
        for _ in range(max(2, sum(2 * side > max(sides) for side in sides))):
            pieces = [
                half for piece in pieces for half in (halves(piece) if 8 * len(piece) > leaf_triangles else [piece])
            ]
        within = sum(map(len, pieces))
        if len(pieces) > 1 and within <= min(growth, 2) * len(parts):
            left = growth * len(parts) / Fraction(within)
            children = [twin(one, left, leaf_triangles=leaf_triangles, depth=depth - 1) for one in pieces]
    return [low, high], [name for name, _ in parts], children


def same(tree, node, expected):
    box, names, children = expected
    assert [[Fraction(float(one)) for one in corner] for corner in tree.boxes[node]] == box
    assert tree.triangles_of(node).tolist() == names
    first, end = tree.children[node]
    assert end - first == len(children)
    for child, one in zip(range(first, end), children, strict=True):
        same(tree, child, one)


@st.composite
def half_squares(draw):
    """Right triangles in planes of the axes, legs a power of two, so that halving them rounds nothing; some without area."""
    soup = []
    for _ in range(draw(st.integers(1, 24))):
        corner = [4 * draw(st.integers(0, 4)) for _ in range(3)]
        axis, leg, turned = (
            draw(st.integers(0, 2)),
            draw(st.sampled_from([0, 1, 2, 4, 8])),
            draw(st.sampled_from([-1, 1])),
        )
        one, two = list(corner), list(corner)
        one[axis] += leg
        two[(axis + 1) % 3] += turned * leg
        soup.append([corner, one, two])
    return np.array(soup, dtype=np.float32)


@settings(deadline=None, max_examples=150)
@given(half_squares(), st.sampled_from([1, 2, 4, 16]), st.integers(0, 4))
def test_it_is_the_tree_of_its_description(soup, leaf_triangles, depth):
    tree = sound(tree_of(soup, leaf_triangles=leaf_triangles, depth=depth))
    parts = [(i, exact(one)) for i, one in enumerate(soup)]
    same(tree, 0, twin(parts, Fraction(4), leaf_triangles=leaf_triangles, depth=depth))


def covered(tree, soup):
    """Each triangle's parts in the leaves that list it make it up, and it has no part in others."""
    leaves = np.flatnonzero(tree.is_leaf)
    lists = [set(tree.triangles_of(leaf).tolist()) for leaf in leaves]
    for i, triangle in enumerate(soup):
        found, whole = [Fraction(0)] * 3, shadows(exact(triangle))
        flat = np.ptp(triangle, axis=0) == 0.0
        assert any(i in one for one in lists)
        for leaf, listed in zip(leaves, lists, strict=True):
            part = shadows(in_box(triangle, tree.boxes[leaf]))
            if i in listed:
                found = [a + b for a, b in zip(found, part, strict=True)]
            elif not (flat & (tree.boxes[leaf] == triangle[0]).any(axis=0)).any():  # it may lie in the face of a box
                assert max(map(abs, part)) < 1e-6
        assert max(abs(a - b) for a, b in zip(found, whole, strict=True)) < 1e-6


@settings(deadline=None, max_examples=60)
@given(
    st.lists(st.lists(st.integers(-20, 20), min_size=9, max_size=9), min_size=1, max_size=12),
    st.integers(1, 3),
    st.sampled_from([1.0, 0.1, 1e-3]),
)
def test_leaves_hold_all_of_each_triangle_and_no_other(numbers, leaf_triangles, size):
    soup = np.array(numbers, dtype=np.float32).reshape(-1, 3, 3)
    soup[:, 1:] = soup[:, :1] + np.float32(size) * (soup[:, 1:] - soup[:, :1])
    covered(sound(tree_of(soup, leaf_triangles=leaf_triangles)), soup)


def test_a_mesh_of_small_triangles():
    soup = random_soup(np.random.default_rng(5), 200, size=0.3).astype(np.float32)
    tree = sound(tree_of(soup, leaf_triangles=20))
    covered(tree, soup)
    assert tree.triangle_counts[tree.is_leaf].max() <= 20
    assert len(tree.levels) > 3


def test_boxes_that_are_about_cubes_have_eight_children_and_flat_ones_four():
    rng = np.random.default_rng(6)
    cube = random_soup(rng, 5000, size=0.01, spread=(10.0, 9.0, 8.0))
    flat = random_soup(rng, 5000, size=0.01, spread=(10.0, 9.0, 0.5))
    for soup, branching in ((cube, 8), (flat, 4)):
        tree = sound(tree_of(soup, depth=2, leaf_triangles=100))
        assert np.diff(tree.levels).tolist() == [1, branching, branching**2]
        assert (
            np.ptp(tree.boxes, axis=1)[:, :2].max(axis=1) < 2.2 * np.ptp(tree.boxes, axis=1)[:, :2].min(axis=1)
        ).all()


def test_boxes_are_no_larger_than_what_they_hold():
    """Far from its only neighbours a cluster is found at once, not by halving what is empty."""
    rng = np.random.default_rng(7)
    cluster = random_soup(rng, 1000, size=0.001, spread=(1.0, 1.0, 1.0))
    tree = sound(tree_of(np.concatenate([cluster, cluster[:1] + 1000.0]), leaf_triangles=300))
    assert len(tree.levels) - 2 <= 2
    assert tree.triangles_of(int(tree.children[0, 1]) - 1).tolist() == [1000]
    assert np.ptp(tree.boxes[1:], axis=1).max() < 1.1


@pytest.mark.parametrize("depth", range(4))
def test_no_node_lies_deeper_than_allowed(depth):
    tree = sound(tree_of(random_soup(np.random.default_rng(8), 500, size=0.1), leaf_triangles=2, depth=depth))
    assert len(tree.levels) - 2 == depth


@pytest.mark.parametrize("leaf_triangles", [7, 100, 499, 500])
def test_leaves_are_small_enough(leaf_triangles):
    soup = random_soup(np.random.default_rng(9), 500, size=1e-5)
    tree = sound(tree_of(soup, leaf_triangles=leaf_triangles))
    assert tree.triangle_counts[tree.is_leaf].max() <= leaf_triangles
    assert (tree.triangle_counts[~tree.is_leaf] > leaf_triangles).all()


def test_the_same_mesh_gives_the_same_tree():
    soup = random_soup(np.random.default_rng(10), 3000)
    one, other = (tree_of(soup, leaf_triangles=50) for _ in range(2))
    for name in one.__slots__:
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes()


def test_what_lies_in_a_plane_of_division_is_on_one_side_and_what_touches_it_on_its_own():
    square = [[0, 0, 0], [0, 1, 0], [0, 1, 1]]
    below, above = [[-8, 0, 0], [-8, 1, 0], [-8, 1, 1]], [[8, 0, 0], [8, 1, 0], [8, 1, 1]]
    left, right = [[-2, 0, 0], [0, 0, 0], [-2, 1, 0]], [[2, 0, 0], [0, 0, 0], [0, 1, 0]]
    tree = sound(tree_of([below, square, left, right, above], leaf_triangles=3, depth=1))
    listed = [tree.triangles_of(leaf).tolist() for leaf in np.flatnonzero(tree.is_leaf)]
    assert listed == [[0], [1, 2], [3], [4]]


def fan(count, rng):
    """Large triangles that meet in one point."""
    soup = 100.0 * rng.normal(size=(count, 3, 3))
    soup[:, 0] = 0.0
    return soup


def needles(count, rng):
    soup = 100.0 * rng.normal(size=(count, 3, 3))
    soup[:, 2] = soup[:, 1] + 1e-3
    return soup


def large_among_small(count, rng):
    return np.concatenate([random_soup(rng, count // 2), 10.0 * rng.random((count // 2, 3, 3))])


@pytest.mark.parametrize("soup", [fan, needles, large_among_small])
@pytest.mark.parametrize("leaf_triangles", [1, 20])
def test_large_triangles_are_not_divided_over_and_over(soup, leaf_triangles):
    corners = soup(600, np.random.default_rng(11))
    tree = sound(tree_of(corners, leaf_triangles=leaf_triangles))
    assert len(tree.references) <= 4 * len(corners)


def test_triangles_that_are_all_the_same_stay_together():
    once = random_soup(np.random.default_rng(12), 1)
    tree = sound(tree_of(np.repeat(once, 50, axis=0), leaf_triangles=5))
    assert len(tree.boxes) == 1
    assert tree.triangles_of(0).tolist() == list(range(50))


def test_triangles_in_one_plane():
    soup = random_soup(np.random.default_rng(13), 1000, size=0.1)
    soup[:, :, 2] = 3.0
    tree = sound(tree_of(soup, leaf_triangles=20))
    assert (tree.boxes[:, :, 2] == 3.0).all()
    assert tree.triangle_counts[tree.is_leaf].max() <= 20


def test_triangles_without_area_are_listed():
    rng = np.random.default_rng(14)
    points = np.repeat(10.0 * rng.random((100, 1, 3)), 3, axis=1)
    lines = 10.0 * rng.random((100, 3, 3))
    lines[:, 2] = 0.5 * lines[:, 0] + 0.5 * lines[:, 1]
    tree = sound(tree_of(np.concatenate([points, lines]), leaf_triangles=20))
    assert len(tree.boxes) > 1
    assert tree.triangles_of(0).tolist() == list(range(200))
    same_points = sound(tree_of(np.repeat(points[:1], 100, axis=0), leaf_triangles=20))
    assert len(same_points.boxes) == 1


def test_neighbours_as_close_as_numbers_can_be():
    next_one = np.nextafter(np.float32(1.0), np.float32(2.0))
    points = np.repeat(np.array([[1.0] * 3, [next_one, 1.0, 1.0]])[:, None], 3, axis=1)
    tree = sound(tree_of(np.repeat(points, 5, axis=0), leaf_triangles=2))
    assert [tree.triangles_of(leaf).tolist() for leaf in np.flatnonzero(tree.is_leaf)] == [
        [0, 1, 2, 3, 4],
        [5, 6, 7, 8, 9],
    ]


def test_one_triangle_is_one_leaf():
    tree = sound(tree_of([[[1, 2, 3], [4, 0, 3], [1, 2, 9]]], leaf_triangles=1))
    assert tree.boxes.tolist() == [[[1, 0, 3], [4, 2, 9]]]
    assert tree.references.tolist() == [0]


def test_no_triangles_are_an_empty_leaf():
    tree = sound(tree_of([]))
    assert tree.boxes.tolist() == [[[0.0] * 3] * 2]
    assert tree.is_leaf.tolist() == [True]
    assert tree.triangles_of(0).tolist() == []


def test_triangles_that_are_nowhere_are_in_no_box():
    soup = random_soup(np.random.default_rng(15), 50, size=0.1)
    soup[7, 1, 2], soup[9, 0, 0] = np.nan, np.inf
    tree = sound(tree_of(soup, leaf_triangles=10))
    assert tree.triangles_of(0).tolist() == [i for i in range(50) if i not in (7, 9)]
    assert np.isfinite(tree.boxes).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"leaf_triangles": 0}, "leaf triangles: 1 or more expected, found 0"),
        ({"depth": -1}, "depth: 0 or more expected, found -1"),
    ],
)
def test_options_without_a_meaning(options, message):
    with pytest.raises(ParameterError, match=message):
        tree_of([], **options)
