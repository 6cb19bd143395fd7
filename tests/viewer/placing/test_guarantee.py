"""Placed images keep every view within the budget: random viewers of a small model, and what holds of each image."""

import math

import numpy as np
import pytest
from clustered_triangles import clusters

from viewer.placing.directions import distances_to, seen_from
from viewer.placing.model_cells import cells_for
from viewer.placing.placements import placements_at
from viewer.placing.refining import solution_grid
from viewer.placing.rules import Fov, PlacingRules
from viewer.placing.solution_grid import domain_of

RULES = PlacingRules(4500, 3000, Fov(math.tan(math.radians(30.0)), 0.75 * math.tan(math.radians(30.0))))


@pytest.fixture(scope="module")
def placed():
    cells = cells_for(*clusters(), RULES)
    grid = solution_grid(cells, RULES, domain_of(cells))
    needs = grid.needs()
    return cells, grid, needs, [placements_at(*one, cells, RULES) for one in zip(grid.points, needs, strict=True)]


def viewers(grid, count, seed):
    """Random eyes (count, 3) in the domain, and yaws."""
    rng = np.random.default_rng(seed)
    return rng.uniform(*grid.domain, size=(count, 3)), rng.uniform(-7.0, 7.0, size=count)


def test_every_view_is_within_the_budget(placed):
    cells, grid, _, placements = placed
    counts, helped = cells.counts, 0
    for eye, yaw in zip(*viewers(grid, 3000, seed=1), strict=True):
        serving = placements[grid.closest(eye, yaw)]
        drawn = seen_from(cells.boxes, eye, yaw, RULES.pyramid)
        helped += counts[drawn].sum() > RULES.budget
        if serving.at(yaw) >= 0:
            drawn[serving.images[serving.at(yaw)].cells] = False
        assert counts[drawn].sum() <= RULES.budget
    assert helped > 200


def test_a_point_serves_every_viewer(placed):
    _, grid, needs, _ = placed
    for eye, yaw in zip(*viewers(grid, 3000, seed=2), strict=True):
        point = grid.closest(eye, yaw)
        assert point >= 0
        apart = eye - grid.points[point]
        ahead = math.cos(yaw) * apart[0] + math.sin(yaw) * apart[1]
        aside = math.cos(yaw) * apart[1] - math.sin(yaw) * apart[0]
        assert abs(apart[2]) <= RULES.fov.up * ahead + 1e-9
        assert abs(aside) <= RULES.fov.across * ahead + 1e-9
        need = needs[point]
        radius = need.radii[np.searchsorted(need.borders, yaw % (2.0 * math.pi), side="right") - 1]
        assert np.linalg.norm(apart) <= radius * (1.0 + 1e-9) <= grid.radii[point] * (1.0 + 1e-8)
    assert grid.closest(grid.domain[1] + 0.1, 0.0) == -1


def test_no_image_has_what_a_viewer_may_be_at(placed):
    cells, grid, needs, placements = placed
    images = 0
    for point, need, one in zip(grid.points, needs, placements, strict=True):
        distances = distances_to(cells.boxes, point)
        for k, image in enumerate(one.images):
            images += 1
            yaws = one.borders[one.serving == k] + 1e-7
            radii = need.radii[np.searchsorted(need.borders, yaws, side="right") - 1]
            assert distances[image.cells].min() == image.distance > radii.max()
            assert (np.diff(image.cells) > 0).all()
    assert images > 20
