"""What nobody sees whom a point serves: held against rays from there, the budget, and pictures of the whole model."""

import dataclasses
import math

import numpy as np
import pytest
from placed_models import CAMERA, blocks, model_of, placed

from mmi.foundation.camera import view_towards
from mmi.foundation.errors import ParameterError
from mmi.rays.brute_force import brute_force
from viewer.drawing.renderer import Renderer
from viewer.making.checking import check_directions, check_views
from viewer.making.hidden_cells import hidden_cells, print_of_occluders
from viewer.placed.folder import open_placed
from viewer.placed.rules import PlacedRules
from viewer.placing.directions import seen_from
from viewer.placing.model_cells import cells_for
from viewer.placing.placements import placements_at
from viewer.placing.refining import solution_grid
from viewer.placing.rules import PlacingRules, fov_of
from viewer.placing.solution_grid import domain_of, mask_of
from viewer.plan import Budget
from viewer.techniques.geometry import FullGeometry
from viewer.techniques.placed_images import PlacedImages

RULES = PlacingRules(budget=1200, target=300, fov=fov_of(CAMERA), depth=4)
HEIGHTS = (1.5, 1.9)


@pytest.fixture(scope="module")
def model():
    return model_of(blocks())


@pytest.fixture(scope="module")
def cells(model):
    return cells_for(model.mesh.positions, model.mesh.triangles, RULES)


@pytest.fixture(scope="module")
def summary(model, tmp_path_factory):
    return placed(
        model, tmp_path_factory.mktemp("hidden") / "blocks", rules=RULES, heights=HEIGHTS, hidden=True, pictures=1
    )


def grid_of(cells, heights=HEIGHTS):
    domain = domain_of(cells)
    domain[:, 2] = heights
    return solution_grid(cells, RULES, domain)


def test_no_ray_from_whom_a_point_serves_ends_at_what_is_hidden(model, cells):
    grid = grid_of(cells)
    hidden = np.array([mask_of(bits, len(cells.counts)) for bits in hidden_cells(model.city, cells, grid)])
    assert hidden.shape == (len(grid.points), len(cells.counts))
    assert (hidden @ cells.counts).mean() > 0.2 * len(model.mesh.triangles)
    caster, rng = brute_force(model.mesh), np.random.default_rng(8)
    corners = model.mesh.positions[model.mesh.triangles].astype(float)
    leaves, cell_of = np.repeat(np.arange(len(grid.codes)), np.diff(grid.leaf_starts)), np.empty(len(corners), int)
    cell_of[cells.triangles] = np.repeat(np.arange(len(cells.counts)), cells.counts)
    looked = 0
    for point in range(0, len(grid.points), 5):
        triangles = cells.triangles_of(np.flatnonzero(hidden[point]))
        if not len(triangles):
            continue
        own = rng.choice(leaves[grid.leaf_points == point], 60)
        eyes = rng.uniform(grid.leaf_boxes[own, 0], grid.leaf_boxes[own, 1])
        aims = np.einsum("kc,kcn->kn", rng.dirichlet(np.ones(3), 60), corners[rng.choice(triangles, 60)])
        directions = (aims - eyes) / np.linalg.norm(aims - eyes, axis=1)[:, None]
        hits = caster.first_hits(eyes, directions)
        assert (hits.triangle >= 0).all()
        assert not hidden[point][cell_of[hits.triangle]].any()
        looked += 60
    assert looked > 1000


def test_it_takes_fewer_images(cells, summary):
    grid = summary.folder.solutions.grid
    without = [placements_at(*one, cells, RULES) for one in zip(grid.points, grid.needs(), strict=True)]
    assert summary.points == len(without)
    assert summary.images < 0.9 * sum(len(one.images) for one in without)


def test_the_budget_is_kept(model, summary):
    solutions = open_placed(summary.folder.path).solutions
    assert solutions.occluders == print_of_occluders(model.city)
    views = check_views(summary.folder, model, views=400)
    assert views.kept and views.drawn == 400
    assert check_directions(summary.folder, model).kept
    bare = [dataclasses.replace(one, hidden=one.hidden[:0]) for one in solutions.points]
    counting_all = dataclasses.replace(summary.folder, solutions=dataclasses.replace(solutions, points=tuple(bare)))
    assert not check_directions(counting_all, model).kept


def test_a_view_without_an_image_shows_what_the_whole_model_does(model, cells, summary):
    scene, grid, rng = model.scene(CAMERA), summary.folder.solutions.grid, np.random.default_rng(4)
    technique, full = PlacedImages(scene, PlacedRules(summary.folder.path)), FullGeometry(scene)
    compared = left_out = 0
    with Renderer(scene.mesh, scene.ground, size=(CAMERA.width, CAMERA.height)) as renderer:
        for _ in range(300):
            eye, yaw = rng.uniform(*grid.domain), rng.uniform(-math.pi, math.pi)
            view = view_towards(eye, yaw, 0.0, focal=CAMERA.focal, window=CAMERA.window)
            plan = technique.plan(view, now=0.0, budget=Budget())
            if technique.latest.image:
                continue
            found = renderer.draw(plan, view)
            truth = renderer.draw(full.plan(view, now=0.0, budget=Budget()), view)
            np.testing.assert_array_equal(found.color, truth.color)
            in_view = cells.counts[seen_from(cells.boxes, eye, yaw, RULES.pyramid)].sum()
            compared, left_out = compared + 1, left_out + (technique.latest.most < in_view)
    assert compared > 100
    assert left_out > 20


def test_a_folder_is_taken_for_what_it_was_asked_for(model, summary):
    again = placed(model, summary.folder.path, rules=RULES, heights=HEIGHTS, hidden=True, pictures=1)
    assert again.made == 0 and "hidden" not in again.stages


def test_from_below_the_ground_nothing_is_hidden(model, cells):
    grid = grid_of(cells, (-0.5, 1.9))
    assert not hidden_cells(model.city, cells, grid).any()


def test_without_solid_buildings_it_is_refused(model, tmp_path):
    glass = [dataclasses.replace(one, core=()) for one in model.city.objects]
    city = dataclasses.replace(model.city, objects=tuple(glass))
    with pytest.raises(ParameterError, match=r"^hidden: a city with solid buildings expected"):
        placed(dataclasses.replace(model, city=city), tmp_path / "none", hidden=True)
