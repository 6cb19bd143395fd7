"""Walks with placed images: near to the geometry, within the budget, and the geometry itself where nothing is promised."""

import math

import numpy as np
import pytest
from cities import crossroads
from placed_models import CAMERA, RULES, model_of, placed, towers

from mmi.foundation.camera import View, view_towards
from mmi.foundation.errors import ParameterError
from viewer.computed import WarpedPicture, WarpedSamples
from viewer.drawing.renderer import Renderer
from viewer.measuring.view_errors import view_errors
from viewer.placed.rules import PlacedRules
from viewer.plan import Budget, Faces
from viewer.techniques.geometry import FullGeometry
from viewer.techniques.placed_images import PlacedImages

BUDGET = Budget()


@pytest.fixture(scope="module")
def model():
    return model_of(towers())


@pytest.fixture(scope="module")
def folder(model, tmp_path_factory):
    return placed(model, tmp_path_factory.mktemp("placed") / "towers").folder


@pytest.fixture(scope="module")
def scene(model):
    return model.scene(CAMERA)


@pytest.fixture(scope="module")
def renderer(scene):
    with Renderer(scene.mesh, scene.ground, size=(CAMERA.width, CAMERA.height), measured=True) as renderer:
        yield renderer


@pytest.fixture
def technique(scene, folder):
    return PlacedImages(scene, PlacedRules(folder.path))


def look(eye, yaw, pitch=0.0):
    return view_towards(np.asarray(eye, dtype=float), yaw, pitch, focal=CAMERA.focal, window=CAMERA.window)


def views_with_images(folder, count, seed=2):
    """Random views that an image is shown in."""
    rng, solutions = np.random.default_rng(seed), folder.solutions
    found = []
    while len(found) < count:
        eye, yaw = rng.uniform(*solutions.grid.domain), rng.uniform(-math.pi, math.pi)
        if solutions.serving(solutions.grid.closest(eye, yaw), yaw) >= 0:
            found.append(look(eye, yaw))
    return found


def drawn(renderer, technique, view):
    return renderer.draw(technique.plan(view, now=0.0, budget=BUDGET), view, measured=True)


def errors(renderer, scene, technique, view):
    truth = drawn(renderer, FullGeometry(scene), view)
    found = drawn(renderer, technique, view)
    return view_errors(truth, found, focal=CAMERA.focal, disoccluded=np.zeros(truth.depth.shape, bool), flip=False)


def test_from_its_point_an_image_is_the_geometry(scene, renderer, technique, folder):
    looked = 0
    for image in folder.solutions.images:
        view = look(image.point, image.placement.yaw)
        if folder.solutions.grid.closest(view.eye, image.placement.yaw) < 0:
            continue
        found = errors(renderer, scene, technique, view)
        looked += technique.latest.image
        assert found.thickness_px <= 1.0
    assert looked > 0


def test_random_views_are_near_to_the_geometry(scene, renderer, technique, folder):
    found = [errors(renderer, scene, technique, view) for view in views_with_images(folder, 40)]
    assert np.mean([one.wrong_share for one in found]) < 0.01
    assert np.median([one.thickness_px for one in found]) <= 2.0
    assert technique.tally.image == 40
    assert technique.tally.over == technique.tally.outside == technique.tally.tilted == 0


def test_warped_by_the_renderer_it_is_as_near_and_draws_the_same_triangles(scene, renderer, technique, folder):
    points = PlacedImages(scene, PlacedRules(folder.path, warp="points"))
    views = views_with_images(folder, 40)
    found = [errors(renderer, scene, points, view) for view in views]
    assert np.mean([one.wrong_share for one in found]) < 0.01
    assert np.median([one.thickness_px for one in found]) <= 2.0
    drawn(renderer, technique, views[-1])
    assert points.latest == technique.latest
    plan = points.plan(views[-1], now=0.0, budget=BUDGET)
    assert sum(isinstance(one, WarpedSamples) for one in plan.draws) == 1
    assert plan.same_as(points.plan(views[-1], now=0.0, budget=BUDGET))


def test_a_plan_draws_each_triangle_in_view_or_has_it_in_its_image(scene, technique, folder):
    everything = scene.mesh.positions[scene.mesh.triangles]
    for view in views_with_images(folder, 20, seed=4):
        plan = technique.plan(view, now=0.0, budget=BUDGET)
        faces = next(one for one in plan.draws if isinstance(one, Faces))
        assert len(faces.triangles) == technique.latest.most <= RULES.budget
        assert sum(isinstance(one, WarpedPicture) for one in plan.draws) == 1
        yaw = math.atan2(*-view.eye_from_world[2, 1::-1])
        number = folder.solutions.serving(folder.solutions.grid.closest(view.eye, yaw), yaw)
        replaced = set()
        for cell in folder.solutions.images[number].placement.cells.tolist():
            cells = technique._cells
            replaced |= set(cells.triangles[cells.starts[cell] : cells.starts[cell + 1]].tolist())
        shown = view.project(everything)
        inside = (
            (shown[..., 2] > 0.1) & (abs(shown[..., 0]) < CAMERA.width / 2) & (abs(shown[..., 1]) < CAMERA.height / 2)
        )
        seen = set(np.flatnonzero(inside.any(axis=1)).tolist())
        assert seen <= replaced | set(faces.triangles.tolist())


@pytest.mark.parametrize(
    "view",
    [
        look([0.0, -60.0, 5.0], 1.6, pitch=0.2),
        look([0.0, -900.0, 5.0], 1.6),
        View(look([0.0, -60.0, 5.0], 1.6).eye_from_world, 0.5 * CAMERA.focal, CAMERA.window),
    ],
    ids=["tilted", "outside", "wide"],
)
def test_where_nothing_is_promised_it_is_the_geometry(scene, renderer, technique, view):
    truth, found = drawn(renderer, FullGeometry(scene), view), drawn(renderer, technique, view)
    np.testing.assert_array_equal(found.object_ids, truth.object_ids)
    np.testing.assert_array_equal(found.color, truth.color)
    assert technique.tally.outside + technique.tally.tilted == 1
    assert technique.tally.most == 0


def test_images_around_are_brought_in_ahead(model, folder):
    technique = PlacedImages(model.scene(CAMERA), PlacedRules(folder.path))
    view = views_with_images(folder, 1)[0]
    for _ in range(2):
        technique.plan(view, now=0.0, budget=BUDGET)
    images = technique._images
    assert images.waited == 1
    for number in technique._around(view.eye):
        images.get(number)
    assert images.bytes > 0
    images.close()


def test_few_bytes_are_slower_and_never_wrong(scene, folder):
    few, many = (PlacedImages(scene, PlacedRules(folder.path, bytes=most)) for most in (0, 1 << 30))
    for view in views_with_images(folder, 12, seed=7):
        pictures = [
            next(one for one in technique.plan(view, now=0.0, budget=BUDGET).draws if isinstance(one, WarpedPicture))
            for technique in (few, many)
        ]
        np.testing.assert_array_equal(pictures[0].color, pictures[1].color)


def test_a_folder_of_another_model_or_none_is_refused(scene, folder):
    with pytest.raises(ParameterError, match=r"^placed: the folder of placed images expected"):
        PlacedImages(scene, PlacedRules())

    with pytest.raises(ParameterError, match=r"^warp: one of software, points expected, found 'gpu'"):
        PlacedRules(warp="gpu")

    with pytest.raises(ParameterError, match="images placed for made as it is now expected"):
        PlacedImages(model_of(crossroads()).scene(CAMERA), PlacedRules(folder.path))
