"""The images of one point: which yaws they serve, and that their pictures are wide enough."""

import math

import numpy as np
import pytest
from clustered_triangles import clusters

from mmi.foundation.errors import ParameterError
from viewer.placing.directions import TURN, seen_from
from viewer.placing.model_cells import cells_for
from viewer.placing.placements import placements_at
from viewer.placing.rules import Fov, PlacingRules
from viewer.placing.solution_grid import Needs

RULES = PlacingRules(2000, 1200, Fov(0.577, 0.433))
POINT = np.array([22.0, 14.0, 3.0])
NEEDS = Needs(np.array([0.0, 2.0]), np.array([3.0, 1.5]))


@pytest.fixture(scope="module")
def cells():
    return cells_for(*clusters(), RULES)


@pytest.fixture(scope="module")
def placed(cells):
    return placements_at(POINT, NEEDS, cells, RULES)


def test_every_yaw_is_within_the_budget(cells, placed):
    needed = 0
    for yaw in np.arange(0.0, TURN, 0.01):
        drawn = seen_from(cells.boxes, POINT, yaw, RULES.fov)
        seen, image = cells.counts[drawn].sum(), placed.at(yaw)
        if image >= 0:
            drawn[placed.images[image].cells] = False
            needed += 1
        bound = placed.counts[np.searchsorted(placed.borders, yaw, side="right") - 1]
        assert cells.counts[drawn].sum() <= bound <= RULES.budget
        assert image >= 0 or seen <= RULES.budget
    assert needed > 50
    assert placed.at(1.0) == placed.at(1.0 - TURN) == placed.at(1.0 + TURN)


def test_pictures_have_all_that_views_show_of_their_cells(cells, placed):
    """Random points of cells that a served view has in its pyramid are within the picture's window, behind its near depth."""
    rng = np.random.default_rng(1)
    looked = 0
    for yaw in np.arange(0.005, TURN, 0.03):
        if placed.at(yaw) < 0:
            continue
        image = placed.images[placed.at(yaw)]
        boxes = cells.boxes[image.cells]
        points = boxes[:, :1] + rng.uniform(size=(len(boxes), 40, 3)) * np.ptp(boxes, axis=1)[:, None] - POINT
        points = points.reshape(-1, 3)
        cos, sin = math.cos(yaw), math.sin(yaw)
        ahead, aside = points[:, 0] * cos + points[:, 1] * sin, points[:, 1] * cos - points[:, 0] * sin
        shown = (np.abs(aside) <= RULES.fov.across * ahead) & (np.abs(points[:, 2]) <= RULES.fov.up * ahead)
        x, y, z = points[shown].T
        cos, sin = math.cos(image.yaw), math.sin(image.yaw)
        depth, across = x * cos + y * sin, x * sin - y * cos
        left, bottom, right, top = image.window
        looked += len(x)
        assert (depth >= image.near - 1e-9).all()
        assert ((across >= (left - 1e-9) * depth) & (across <= (right + 1e-9) * depth)).all()
        assert ((z >= (bottom - 1e-9) * depth) & (z <= (top + 1e-9) * depth)).all()
    assert looked > 1000


def test_an_image_comes_close_to_the_target(cells, placed):
    for image in placed.images:
        drawn = seen_from(cells.boxes, POINT, image.yaw, RULES.fov)
        drawn[image.cells] = False
        assert 0.9 * RULES.target <= cells.counts[drawn].sum() <= RULES.target


def test_yaws_that_are_not_needed_have_no_image(cells):
    nowhere = placements_at(POINT, Needs(np.zeros(1), np.zeros(1)), cells, RULES)
    assert nowhere.images == ()
    assert (nowhere.serving == -1).all()
    half = placements_at(POINT, Needs(np.array([0.0, 2.0]), np.array([0.0, 1.5])), cells, RULES)
    assert all(half.at(yaw) == -1 for yaw in np.arange(0.0, 1.99, 0.01))
    assert len(half.images) > 0


def test_a_point_with_too_much_around_it_is_refused(cells):
    with pytest.raises(ParameterError, match="at most 2,000 triangles within 90 m in each view expected, found"):
        placements_at(POINT, Needs(np.zeros(1), np.array([90.0])), cells, RULES)


def test_the_same_point_has_the_same_images(cells, placed):
    again = placements_at(POINT.copy(), NEEDS, cells, RULES)
    assert np.array_equal(again.borders, placed.borders)
    assert np.array_equal(again.serving, placed.serving)
    for one, other in zip(again.images, placed.images, strict=True):
        assert np.array_equal(one.cells, other.cells)
        assert (one.yaw, one.window, one.near, one.distance) == (other.yaw, other.window, other.near, other.distance)
