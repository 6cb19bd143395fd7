"""The image cache: every triangle is drawn or captured, pictures are those of the geometry, and images are shown again."""

import math

import numpy as np
import pytest
from techniques_drawn import BUDGET, drawn, errors, look

from mmi.foundation.camera import view_towards
from mmi.foundation.errors import ParameterError
from viewer.caching.rules import CacheRules
from viewer.drawing.renderer import Renderer
from viewer.plan import Budget, Faces, Nailboards
from viewer.techniques import image_cache
from viewer.techniques.catalogue import TechniqueRules, make_technique
from viewer.techniques.geometry import FullGeometry
from viewer.techniques.image_cache import ImageCache

EAGER = CacheRules(eager=True, leaf_triangles=20)
VIEWS = [
    (-140.0, 0.0, 0.0, 0.0, 1.7),
    (-100.0, 1.0, 0.3, 0.15, 1.7),
    (0.0, -120.0, 1.4, 0.05, 1.7),
    (0.0, 0.0, 2.2, 0.0, 1.7),
    (-250.0, -250.0, 0.8, -0.3, 90.0),
    (0.0, 0.0, 1.0, 1.5, 1.7),  # straight up
]


@pytest.fixture
def renderer(scene):
    camera = scene.camera
    with Renderer(scene.mesh, scene.ground, size=(camera.width, camera.height), measured=True) as made:
        yield made


def walk(scene, frames, step=0.1):
    return [look(scene, -140.0 + step * k, 0.0, 0.2 + 0.01 * k) for k in range(frames)]


@pytest.mark.parametrize("where", VIEWS)
def test_a_first_picture_is_that_of_the_geometry(scene, renderer, where):
    view = look(scene, *where)
    technique = ImageCache(scene, EAGER)
    picture = drawn(renderer, technique, view)
    assert technique.latest.new > 0
    assert errors(scene, renderer, picture, view).thickness_px <= 2.0


def test_a_walk_shows_images_again_and_stays_right(scene, renderer):
    technique = ImageCache(scene, EAGER)
    for k, view in enumerate(walk(scene, 60)):
        picture = drawn(renderer, technique, view)
        if k % 10 == 9:
            assert errors(scene, renderer, picture, view).thickness_px <= 2.0
        assert technique.latest.kept_px <= 1.0 + 1e-9
    tally = technique.tally
    assert tally.frames == 60
    assert tally.late == 0
    assert tally.reused > 10 * (tally.new + tally.combined)


def test_images_are_combined_from_those_of_boxes_within_and_stay_right(scene, renderer):
    """With triangles that seem to take long, nodes are captured from images of their children, and these from theirs."""
    dear = Budget(costs=BUDGET.costs._replace(captured=1e-2, request=1e-6, relief=1e-9, draw=1e-6))
    technique = ImageCache(scene, CacheRules(eager=True, leaf_triangles=10))
    far = [look(scene, -400.0 + 2.0 * k, -300.0 - k, 0.6, 0.0, 20.0) for k in range(60)]
    for k, view in enumerate(far):
        picture = drawn(renderer, technique, view, budget=dear)
        if k in (0, 59):
            assert errors(scene, renderer, picture, view).thickness_px <= 2.0
    assert technique.tally.combined > 10


def test_everything_is_in_the_cut_once(scene):
    technique = ImageCache(scene, EAGER)
    tree = technique.tree
    for where in VIEWS:
        technique.plan(look(scene, *where), now=0.0, budget=BUDGET)
        nodes = np.concatenate([technique.kinds[name] for name in ("new", "reused", "impossible")])
        places = np.concatenate([np.arange(*tree.ranges[node]) for node in nodes])
        assert len(np.unique(places)) == len(places) == len(tree.references)


def test_who_stands_still_or_turns_captures_nothing(scene):
    technique = ImageCache(scene, EAGER)
    technique.plan(look(scene, -100.0, 0.0, 0.0), now=0.0, budget=BUDGET)
    assert technique.latest.new > 0
    for k in range(24):
        plan = technique.plan(look(scene, -100.0, 0.0, 0.3 * k, 0.1), now=0.0, budget=BUDGET)
        assert not plan.requests
        assert technique.latest.new == technique.latest.combined == 0


def test_in_the_frustum_turning_captures_what_comes_into_view_once(scene):
    technique = ImageCache(scene, CacheRules(eager=True, leaf_triangles=20, keep="frustum"))
    counts = []
    for k in range(48):
        technique.plan(look(scene, -100.0, 0.0, 2.0 * math.pi * k / 24), now=0.0, budget=BUDGET)
        counts.append(technique.latest.new)
    whole = ImageCache(scene, EAGER)
    whole.plan(look(scene, -100.0, 0.0, 0.0), now=0.0, budget=BUDGET)
    assert counts[0] < whole.latest.new
    assert sum(counts[24:]) == 0
    assert sum(counts) <= whole.latest.new


@pytest.mark.parametrize("most", [0, 64 * 64 * 16, 6 * 64 * 64 * 16])
def test_with_few_bytes_it_is_slower_and_never_wrong(scene, renderer, most):
    technique = ImageCache(scene, CacheRules(eager=True, leaf_triangles=20, largest=64, bytes=most))
    for k, view in enumerate(walk(scene, 20)):
        picture = drawn(renderer, technique, view)
        if k % 5 == 0:
            assert errors(scene, renderer, picture, view).thickness_px <= 2.0
    assert technique.tally.bytes <= most
    assert renderer.image_bytes(technique.owner) <= most
    assert technique.tally.late == 0


def test_with_a_budget_a_frame_captures_no_more_and_says_what_is_wrong(scene):
    costs = BUDGET.costs
    technique = ImageCache(scene, EAGER)
    most = 5 * costs.request
    counts = []
    for view in walk(scene, 120):
        plan = technique.plan(view, now=0.0, budget=Budget(updates=most, costs=costs))
        counts.append(len(plan.requests))
        assert technique.latest.kept_px < math.inf
    assert 0 < max(counts) <= 6
    assert technique.tally.reused > 0
    still = walk(scene, 1)[0]
    for _ in range(200):
        plan = technique.plan(still, now=0.0, budget=Budget(updates=most, costs=costs))
    assert not plan.requests
    assert technique.latest.late == 0
    assert technique.latest.kept_px <= 1.0


@pytest.mark.parametrize("most", [2 * 64 * 64 * 16, 8 * 64 * 64 * 16])
def test_images_that_others_are_made_of_are_not_given_up_meanwhile(scene, renderer, most):
    """There are hardly more places than one node's parts need, and the viewer leaves what is there behind."""
    technique = ImageCache(scene, CacheRules(eager=True, leaf_triangles=10, largest=64, bytes=most))
    for k in range(80):
        view = look(scene, -600.0 + 9.0 * k, -500.0, 0.7, 0.0, 30.0)
        picture = drawn(renderer, technique, view)
        if k % 20 == 0:
            assert errors(scene, renderer, picture, view).thickness_px <= 2.0
    assert technique.tally.new > 0


@pytest.mark.parametrize("seed", [0, 1])
def test_an_image_that_others_are_made_of_does_not_give_way_to_one_beside_it(scene, renderer, seed):
    """The nodes beside it are captured first, and everything else in the atlases is as new."""
    rng = np.random.default_rng(seed)
    technique = ImageCache(scene, CacheRules(eager=True, leaf_triangles=5, largest=128, bytes=3 * 256 * 256 * 16))
    where = np.array([-600.0, -500.0, 0.7])
    for k in range(60):
        where += rng.uniform(0.0, 12.0), rng.uniform(-6.0, 6.0), 0.2 * rng.normal()
        view = look(scene, *where, 0.0, 30.0)
        picture = drawn(renderer, technique, view)
        if k % 20 == 19:
            assert errors(scene, renderer, picture, view).thickness_px <= 2.0


def test_a_budget_captures_parts_first_and_never_all_primitives_at_once(scene):
    """A node whose parts have no images yet waits for them, frame by frame."""
    dear = BUDGET.costs._replace(captured=1e-3, request=1e-3, relief=1e-9, draw=1e-6)
    technique = ImageCache(scene, CacheRules(eager=True, leaf_triangles=10))
    view = look(scene, -400.0, -300.0, 0.6, 0.0, 20.0)
    largest = 0
    for _ in range(60):
        plan = technique.plan(view, now=0.0, budget=Budget(updates=5e-3, costs=dear))
        drawn_at_once = [sum(len(d.triangles) for d in one.draws if isinstance(d, Faces)) for one in plan.requests]
        largest = max(largest, *drawn_at_once, 0)
    assert 0 < largest <= 200
    assert technique.latest.reused > 0


def test_what_is_worth_an_image_does_not_change_with_what_frames_take(scene, monkeypatch):
    """Else frames that take long would have fewer images, and take longer."""
    monkeypatch.setattr(image_cache, "_FEW", 4)  # boxes of this scene have few triangles
    technique = ImageCache(scene, CacheRules(leaf_triangles=20))
    cheap = BUDGET.costs._replace(triangle=1e-4, relief=1e-12)
    view = look(scene, -400.0, -300.0, 0.6, 0.0, 20.0)
    technique.plan(view, now=0.0, budget=Budget(costs=cheap))
    images = technique.latest.new
    assert images > 0
    dear = Budget(costs=cheap._replace(relief=1.0, request=10.0, triangle=1e-12))
    technique.plan(view, now=0.0, budget=dear)
    assert technique.latest.reused == images


@pytest.mark.parametrize("error_px", [0.01, 0.3])
def test_nothing_inherits_more_than_it_may_be_wrong_by(scene, error_px):
    """Half a pixel comes from sampling others' texels anew: who allows less has images of triangles only."""
    technique = ImageCache(scene, CacheRules(eager=True, leaf_triangles=10, error_px=error_px))
    for k in range(4):
        technique.plan(look(scene, -400.0 + 0.1 * k, -300.0, 0.6, 0.0, 20.0), now=0.0, budget=BUDGET)
        assert technique.latest.kept_px <= error_px
    assert technique.tally.new > 0


def test_an_error_of_more_than_a_right_angle_may_be_allowed(scene):
    technique = ImageCache(scene, CacheRules(eager=True, leaf_triangles=20, error_px=1000.0))
    for view in walk(scene, 3):
        technique.plan(view, now=0.0, budget=BUDGET)
    assert technique.tally.new > 0


def test_with_a_budget_a_leap_leaves_no_picture_of_elsewhere_behind(scene, renderer):
    """Everything was captured from one side; after a leap to the other, as far away, there is no time to capture it anew."""
    technique = ImageCache(scene, EAGER)
    here, there = (
        look(scene, sign * 900.0, 0.0, azimuth, 0.0, 20.0) for sign, azimuth in ((-1.0, 0.0), (1.0, math.pi))
    )
    drawn(renderer, technique, here)
    assert technique.latest.new > 0
    picture = drawn(renderer, technique, there, budget=Budget(updates=1e-9))
    assert technique.latest.kept_px <= 10.0
    assert errors(scene, renderer, picture, there).thickness_px <= 2.0


def test_a_budget_of_nothing_is_the_geometry(scene, renderer):
    technique = ImageCache(scene, EAGER)
    view = look(scene, *VIEWS[0])
    picture = drawn(renderer, technique, view, budget=Budget(updates=0.0))
    truth = drawn(renderer, FullGeometry(scene), view)
    np.testing.assert_array_equal(picture.object_ids, truth.object_ids)
    np.testing.assert_array_equal(picture.color, truth.color)


def test_boxes_of_few_triangles_are_drawn_as_they_are_unless_it_is_eager(scene):
    technique = ImageCache(scene)
    plan = technique.plan(look(scene, *VIEWS[0]), now=0.0, budget=BUDGET)
    assert not plan.requests
    assert not any(isinstance(draw, Nailboards) for draw in plan.draws)
    assert any(isinstance(draw, Faces) for draw in plan.draws)


def test_the_same_walk_has_the_same_plans(scene):
    one, other = ImageCache(scene, EAGER), ImageCache(scene, EAGER)
    for view in walk(scene, 10, step=1.0):
        budget = Budget(updates=2e-3)
        assert one.plan(view, now=0.0, budget=budget).same_as(other.plan(view, now=0.0, budget=budget))


def test_another_display_has_images_of_its_own(scene):
    technique = ImageCache(scene, EAGER)
    view = look(scene, *VIEWS[0])
    technique.plan(view, now=0.0, budget=BUDGET)
    left, top, width, height = view.window
    window = (left // 2, top // 2, width // 2, height // 2)
    smaller = view_towards(view.eye, 0.0, 0.0, focal=0.5 * view.focal, window=window)
    plan = technique.plan(smaller, now=0.0, budget=BUDGET)
    assert plan.requests
    assert plan.drops
    assert technique.latest.kept_px == 0.0


def test_a_viewer_s_own_images_are_its_owner_s(scene):
    rules = TechniqueRules(images=EAGER)
    technique = make_technique("image-cache", {"multi-mesh": scene}, rules=rules, owner="somebody")
    plan = technique.plan(look(scene, *VIEWS[0]), now=0.0, budget=BUDGET)
    assert {request.into.image.owner for request in plan.requests} == {"somebody"}


@pytest.mark.parametrize(
    ("rules", "named"),
    [
        ({"error_px": 0.0}, "error_px"),
        ({"error_px": math.nan}, "error_px"),
        ({"leaf_triangles": 0}, "leaf_triangles"),
        ({"depth": -1}, "depth"),
        ({"bytes": -1}, "bytes"),
        ({"largest": 100}, "largest"),
        ({"keep": "some"}, "keep"),
    ],
)
def test_rules_without_meaning_are_refused_in_a_line(rules, named):
    with pytest.raises(ParameterError, match=f"^{named}: .* expected, found .*$"):
        CacheRules(**rules)
