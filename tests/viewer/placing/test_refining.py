"""The grid: leaves that cover the domain once, points that hold, the same each time, and what cannot be done in one line."""

import numpy as np
import pytest
from clustered_triangles import clusters

from mmi.foundation.errors import ParameterError
from viewer.placing.directions import TURN, arc_holds, arcs_of, distances_to, seen_from
from viewer.placing.model_cells import cells_for, model_cells
from viewer.placing.refining import solution_grid
from viewer.placing.rules import Fov, PlacingRules
from viewer.placing.solution_grid import domain_of

RULES = PlacingRules(3500, 2200, Fov(0.577, 0.433))


@pytest.fixture(scope="module")
def cells():
    return cells_for(*clusters(), RULES)


@pytest.fixture(scope="module")
def grid(cells):
    return solution_grid(cells, RULES, domain_of(cells))


def test_leaves_cover_the_domain_once(grid):
    assert np.ptp(grid.leaf_boxes, axis=1).prod(axis=1).sum() == pytest.approx(np.ptp(grid.domain, axis=0).prod())
    assert len(np.unique(grid.reaches)) > 2
    rng = np.random.default_rng(1)
    for eye in rng.uniform(*grid.domain, size=(300, 3)):
        low, high = grid.leaf_boxes[grid.leaf_of(eye)]
        assert ((low <= eye) & (eye <= high)).all()
    assert grid.leaf_of(grid.domain[0]) >= 0
    assert grid.leaf_of(grid.domain[1]) >= 0
    assert grid.leaf_of(grid.domain[1] + [1e-6, 0.0, 0.0]) == grid.leaf_of(grid.domain[0] - 1e-6) == -1


def test_every_point_holds_for_its_leaves(grid, cells):
    """In any yaw in which a point has some of a leaf in view, at most the target is within the leaf's reach."""
    rng = np.random.default_rng(2)
    boxes = grid.leaf_boxes
    for pair in rng.choice(len(grid.leaf_points), size=150, replace=False):
        leaf = int(np.searchsorted(grid.leaf_starts, pair, side="right")) - 1
        point = grid.points[grid.leaf_points[pair]]
        assert distances_to(boxes[leaf : leaf + 1], point)[0] <= grid.reaches[leaf] * (1.0 + 1e-6)
        near = distances_to(cells.boxes, point) <= grid.reaches[leaf]
        for yaw in np.arange(0.0, TURN, 0.05):
            if seen_from(boxes[leaf : leaf + 1], point, yaw, grid.fov)[0]:
                seen = seen_from(cells.boxes, point, yaw, grid.fov)
                assert cells.counts[seen & near].sum() <= RULES.target


def test_needs_are_those_of_the_leaves(grid):
    needs, boxes = grid.needs(), grid.leaf_boxes
    for n in np.random.default_rng(3).choice(len(grid.points), size=40, replace=False):
        pairs = np.flatnonzero(grid.leaf_points == n)
        leaves = np.searchsorted(grid.leaf_starts, pairs, side="right") - 1
        arcs = arcs_of(boxes[leaves], grid.points[n], grid.fov)
        for yaw in np.arange(0.0037, TURN, 0.05):
            radius = needs[n].radii[np.searchsorted(needs[n].borders, yaw, side="right") - 1]
            assert radius == max(grid.reaches[leaves][arc_holds(arcs, yaw)], default=0.0)
    assert grid.radii == pytest.approx([one.radii.max() for one in needs])


def test_the_same_model_has_the_same_grid(grid, cells):
    again = solution_grid(cells, RULES, domain_of(cells))
    for name in grid.__slots__[1:]:
        assert np.array_equal(getattr(grid, name), getattr(again, name)), name
    assert again.fov == grid.fov


def test_viewers_on_a_plane_need_fewer_points(grid, cells):
    flat = grid.domain.copy()
    flat[:, 2] = 1.7
    plane = solution_grid(cells, RULES, flat)
    assert len(plane.points) < 0.5 * len(grid.points)
    for eye in np.random.default_rng(4).uniform(*flat, size=(300, 3)):
        assert all(plane.closest(eye, yaw) >= 0 for yaw in (0.1, 2.0, 4.0))


def test_what_no_grid_can_keep():
    """A speck of more triangles than a view may have."""
    rng = np.random.default_rng(5)
    positions = np.concatenate([rng.uniform(0.0, 1e-4, size=(300, 3)), [[40.0, 30.0, 9.0]] * 3])
    cells = model_cells(positions, np.arange(303).reshape(-1, 3), depth=3, most=1000)
    rules = PlacingRules(60, 50, RULES.fov, depth=3)
    told = r"^target: more than 50 triangles, or smaller cells, expected: 100 are within 0\.\d+ m of -?0\.0.* points already"
    with pytest.raises(ParameterError, match=told):
        solution_grid(cells, rules, domain_of(cells))
    with pytest.raises(ParameterError, match="the domain of viewers: a finite box expected"):
        solution_grid(cells, rules, np.zeros((2, 3)))
