"""The check of all directions, held against plain tests of views beside all borders; and what it finds amiss."""

import math
from dataclasses import replace

import numpy as np
import pytest
from clustered_triangles import clusters

from viewer.placing.directions import TURN, arcs_of, seen_from
from viewer.placing.grid_check import check_grid
from viewer.placing.model_cells import cells_for
from viewer.placing.placements import placements_at
from viewer.placing.refining import solution_grid
from viewer.placing.rules import Fov, PlacingRules
from viewer.placing.solution_grid import domain_of

VIEW = Fov(math.tan(math.radians(30.0)), 0.75 * math.tan(math.radians(30.0)))
LEVEL = PlacingRules(900, 700, VIEW, depth=4)
PITCHED = PlacingRules(900, 750, VIEW, depth=4, pitch=math.radians(12.0))


@pytest.fixture(scope="module", params=[LEVEL, PITCHED], ids=["level", "pitched"])
def placed(request):
    rules = request.param
    cells = cells_for(*clusters(count=1500), rules)
    grid = solution_grid(cells, rules, domain_of(cells))
    placements = [placements_at(*one, cells, rules) for one in zip(grid.points, grid.needs(), strict=True)]
    return cells, grid, placements, rules


def served_by(grid, point):
    """(k,) the leaves that a point serves."""
    return np.repeat(np.arange(len(grid.codes)), np.diff(grid.leaf_starts))[grid.leaf_points == point]


def alone(grid, point):
    """The grid with one of its points."""
    leaves = served_by(grid, point)
    parts = {name: getattr(grid, name)[leaves] for name in ("codes", "depths", "reaches")}
    nothing_else = {"leaf_starts": np.arange(len(leaves) + 1), "leaf_points": np.zeros(len(leaves), dtype=np.int32)}
    return replace(grid, points=grid.points[[point]], **parts, **nothing_else)


def plainly_counted(placed, point):
    """(y,) what views from a point draw in the middle of each range, and beside its borders, where they may be needed."""
    cells, grid, placements, rules = placed
    eye, one, fov = grid.points[point], placements[point], rules.pyramid
    viewers = grid.leaf_boxes[served_by(grid, point)]
    arcs = np.concatenate([arcs_of(cells.boxes, eye, fov), arcs_of(viewers, eye, fov)])
    borders = np.unique(np.append(arcs.ravel(), one.borders))
    middles = 0.5 * (borders + np.append(borders[1:], TURN))
    found = []
    for yaw in np.concatenate([middles, borders - 1e-7, borders + 1e-7]) % TURN:
        if seen_from(viewers, eye, yaw, fov).any():
            drawn = seen_from(cells.boxes, eye, yaw, fov)
            if one.at(yaw) >= 0:
                drawn[one.images[one.at(yaw)].cells] = False
            found.append(cells.counts[drawn].sum())
    return np.array(found)


def without(one, image):
    """The placements of a point, of which an image replaces nothing any more."""
    images = list(one.images)
    images[image] = replace(images[image], cells=images[image].cells[:0])
    return replace(one, images=tuple(images))


def test_the_budget_is_kept_in_all_directions_from_all_points(placed):
    cells, grid, placements, rules = placed
    seen = []
    found = check_grid(cells, grid, placements, rules, lambda done, total, _: seen.append((done, total)))
    assert found.kept and found.over == 0
    assert found.points == len(grid.points) == seen[-1][0] == seen[-1][1]
    assert found.ranges > 100 * found.points
    assert found.most == max(one.counts.max() for one in placements) <= found.budget == rules.budget


def test_from_each_point_it_counts_what_views_draw(placed):
    cells, grid, placements, rules = placed
    helped = 0
    for point in range(0, len(grid.points), 17):
        found = check_grid(cells, alone(grid, point), [placements[point]], rules)
        plainly = plainly_counted(placed, point)
        assert found.most >= plainly.max()  # boxes are a hair larger
        if placements[point].images:
            assert found.most == plainly.max()
            helped += 1
    assert helped > 10


def test_an_image_that_does_not_replace_what_it_should_is_found(placed):
    cells, grid, placements, rules = placed
    images = [(point, image) for point, one in enumerate(placements) for image in range(len(one.images))]
    assert len(images) > 100
    for point, image in images[::17]:
        checked = check_grid(cells, alone(grid, point), [without(placements[point], image)], rules)
        assert not checked.kept
        assert checked.most > rules.budget
    point, image = images[len(images) // 2]
    checked = check_grid(cells, alone(grid, point), [without(placements[point], image)], rules)
    spoilt = [without(one, image) if n == point else one for n, one in enumerate(placements)]
    assert check_grid(cells, grid, spoilt, rules).over == checked.over > 0


def test_directions_that_an_image_should_serve_and_does_not_are_found(placed):
    cells, grid, placements, rules = placed
    point = next(n for n, one in enumerate(placements) if one.images and len(one.borders) > 2)
    one = placements[point]
    last = np.flatnonzero(one.serving >= 0)[-1]
    later = one.borders.copy()
    later[last] += 1e-3
    assert check_grid(cells, alone(grid, point), [one], rules).kept
    serving = np.where(np.arange(len(one.serving)) == last, -1, one.serving).astype(np.int32)
    assert not check_grid(cells, alone(grid, point), [replace(one, serving=serving)], rules).kept
    begun = check_grid(cells, alone(grid, point), [replace(one, borders=later)], rules)
    assert not begun.kept
    assert begun.over < 20  # a thousandth of a radian
