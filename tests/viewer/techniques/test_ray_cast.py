import math

import numpy as np
import pytest
from cut_out_cities import street_of_trees
from selection import with_slow
from techniques_drawn import BUDGET, drawn, errors, look

from mmi.foundation.camera import Camera, view_towards
from viewer.casting.rules import CastRules
from viewer.drawing.renderer import Renderer
from viewer.measuring.view_errors import view_errors
from viewer.plan import Budget, Done, Objects, Plan
from viewer.scene.scene import scene_of_city
from viewer.techniques.geometry import FullGeometry
from viewer.techniques.ray_cast import RayCasting

NEAR = 20.0  # much of the crossroads is far


@pytest.fixture(scope="module")
def renderer(scene):
    camera = scene.camera
    with Renderer(scene.mesh, scene.ground, size=(camera.width, camera.height), measured=True) as made:
        yield made


VIEWS = [
    (-140.0, 0.0, 0.0, 0.0, 1.7),
    (-100.0, 1.0, 0.3, 0.15, 1.7),
    (100.0, -1.0, math.pi, -0.1, 1.7),
    (0.0, -120.0, 1.4, 0.05, 1.7),
    (0.0, 0.0, 2.2, 0.0, 1.7),
    (-250.0, -250.0, 0.8, -0.3, 90.0),  # from high above, with the whole town far
]


@pytest.mark.parametrize("caster", ["embree", "grid"])
@pytest.mark.parametrize("where", VIEWS)
def test_a_picture_with_nothing_cast_yet_is_that_of_the_geometry(scene, renderer, where, caster):
    view = look(scene, *where)
    technique = RayCasting(scene, CastRules(near_field=NEAR, caster=caster))
    picture = drawn(renderer, technique, view)
    assert technique.latest.rays > 100
    found = errors(scene, renderer, picture, view)
    assert found.thickness_px <= 1.0
    assert found.psnr_db > 45.0
    truth = drawn(renderer, FullGeometry(scene), view)
    same = truth.object_ids == picture.object_ids
    solid = same & (truth.object_ids >= 0)
    assert picture.depth[solid] == pytest.approx(truth.depth[solid], rel=2e-3)


def test_every_pixel_is_counted_once(scene, renderer):
    technique = RayCasting(scene, CastRules(near_field=NEAR))
    view = look(scene, *VIEWS[0])
    for k in range(3):
        drawn(renderer, technique, view)
        tally = technique.latest
        pixels = tally.covered + tally.sky + tally.reused + tally.hit + tally.missed + tally.late + tally.unknown
        assert pixels == view.window[2] * view.window[3]
        assert bool(tally.rays) == (k == 0), "who stands still has cast everything at once"
    assert technique.tally.frames == 3


def test_turning_on_the_spot_casts_only_what_comes_into_view(scene, renderer):
    technique = RayCasting(scene, CastRules(near_field=NEAR))
    first = look(scene, *VIEWS[0])
    drawn(renderer, technique, first)
    whole = technique.latest.rays
    for turn in (0.05, 0.1, 0.15):
        drawn(renderer, technique, look(scene, -140.0, 0.0, turn))
        assert technique.latest.rays < 0.25 * whole
    drawn(renderer, technique, look(scene, -140.0, 0.0, 0.0))
    assert technique.latest.rays < 0.02 * whole, "what was seen before is still there"


@pytest.mark.parametrize("limit", with_slow([2.0, 5.0], {2.0}))
def test_on_the_way_no_region_is_thicker_than_the_limit_says(scene, renderer, limit):
    technique = RayCasting(scene, CastRules(near_field=NEAR, limit_px=limit))
    thickest, reused = 0.0, 0
    for k in range(120):
        view = look(scene, -150.0 + 0.03 * k, 0.3 * math.sin(0.1 * k), 0.15 * math.sin(0.07 * k))
        picture = drawn(renderer, technique, view, measured=k % 4 == 3)
        reused += technique.latest.reused
        assert technique.latest.kept_px <= limit + 1.0
        assert not technique.latest.late
        assert not technique.latest.unknown
        if k % 4 == 3:
            thickest = max(thickest, errors(scene, renderer, picture, view).thickness_px)
    assert thickest <= limit + 2.0
    assert reused > technique.tally.rays


def test_a_viewer_who_stops_gets_the_picture_of_the_geometry(scene, renderer):
    technique = RayCasting(scene, CastRules(near_field=NEAR, limit_px=8.0, settling=500))
    for k in range(12):
        drawn(renderer, technique, look(scene, -140.0 + 0.1 * k, 0.0, 0.0), measured=False)
    view = look(scene, -138.9, 0.0, 0.0)
    before = None
    for _ in range(60):
        picture = drawn(renderer, technique, view)
        assert technique.latest.rays <= 600 or before is None
        before = technique.latest
        if before.rays < 20:
            break
    assert before.rays < 20, "two pixels may share a texel"
    assert before.kept_px < 1.0
    assert errors(scene, renderer, picture, view).thickness_px <= 1.0


def test_with_few_rays_the_worst_go_first_and_the_report_says_what_was_kept(scene, renderer):
    technique = RayCasting(scene, CastRules(near_field=NEAR, limit_px=1.0, rays=300))
    view = look(scene, *VIEWS[0])
    drawn(renderer, technique, view)
    first = technique.latest
    assert first.rays == 300
    assert first.unknown > 0
    assert first.kept_px == 0.0
    left = first.unknown
    while technique.latest.unknown:
        drawn(renderer, technique, view)
        assert technique.latest.unknown < left or not technique.latest.unknown
        left = technique.latest.unknown
    drawn(renderer, technique, look(scene, -139.0, 0.0, 0.0))
    late = technique.latest
    assert late.rays == 300
    assert late.late > 0
    assert late.kept_px > 1.0


def test_no_rays_are_cast_where_updates_are_forbidden(scene, renderer):
    technique = RayCasting(scene, CastRules(near_field=NEAR))
    drawn(renderer, technique, look(scene, *VIEWS[0]), budget=Budget(updates=0.0))
    assert technique.latest.rays == 0
    assert technique.latest.unknown > 100


def test_near_geometry_is_what_the_view_may_show(scene):
    technique = RayCasting(scene, CastRules(near_field=NEAR))
    plan = technique.plan(look(scene, *VIEWS[0]), now=0.0, budget=BUDGET)
    near = next(draw for draw in plan.draws if isinstance(draw, Objects))
    assert 0 < len(near.objects) < len(scene.mesh.triangle_counts)
    behind = technique.plan(look(scene, -140.0, 0.0, math.pi), now=0.0, budget=BUDGET)
    other = next(draw for draw in behind.draws if isinstance(draw, Objects))
    assert near.key != other.key


def test_half_of_the_columns_are_as_in_the_whole_picture(scene, renderer):
    view = look(scene, *VIEWS[1])
    whole = drawn(renderer, RayCasting(scene, CastRules(near_field=NEAR)), view)
    plan = RayCasting(scene, CastRules(near_field=NEAR)).plan(view, now=0.0, budget=BUDGET)
    half = renderer.draw(plan, view, columns=(100, 256))
    same = (half.color == whole.color[:, 100:]).all(axis=2)
    assert same.mean() > 0.999


def test_a_plan_that_finishes_can_be_multisampled(scene):
    view = look(scene, *VIEWS[0])
    camera = scene.camera
    with Renderer(scene.mesh, scene.ground, size=(camera.width, camera.height), samples=4) as smooth:
        full = smooth.draw(FullGeometry(scene).plan(view, now=0.0, budget=BUDGET), view)
        cast = smooth.draw(RayCasting(scene, CastRules(near_field=NEAR)).plan(view, now=0.0, budget=BUDGET), view)
        bare = smooth.draw(
            Plan(RayCasting(scene, CastRules(near_field=NEAR)).plan(view, now=0.0, budget=BUDGET).draws), view
        )
    off = np.abs(full.color.astype(int) - cast.color).max(axis=2) > 40
    without = np.abs(full.color.astype(int) - bare.color).max(axis=2) > 40
    assert off.mean() < 0.03
    assert off.mean() < 0.2 * without.mean()


@pytest.mark.parametrize("pitch", [1.5, 0.7, -0.7, -1.5])
@pytest.mark.parametrize("near", [1.0, 20.0, 1e5])
def test_it_looks_up_and_down_with_any_near_field(scene, renderer, pitch, near):
    technique = RayCasting(scene, CastRules(near_field=near))
    for k in range(3):
        view = look(scene, -60.0 + 0.2 * k, 0.5, 0.4 + 0.3 * k, pitch, 1.7 if near > 1.0 else 40.0)
        picture = drawn(renderer, technique, view)
        assert errors(scene, renderer, picture, view).thickness_px <= 2.0
        assert bool(technique.latest.rays + technique.latest.reused) <= (near < 1e5)


def test_another_display_begins_anew(scene, renderer):
    technique = RayCasting(scene, CastRules(near_field=NEAR))
    view = look(scene, *VIEWS[0])
    drawn(renderer, technique, view)
    closer = view_towards(view.eye, 0.0, 0.0, focal=2.0 * view.focal, window=view.window)
    picture = drawn(renderer, technique, closer)
    assert not technique.latest.reused, "the panorama of larger pixels has too few texels"
    assert errors(scene, renderer, picture, closer).thickness_px <= 1.0


def test_rays_pass_where_pictures_are_clear():
    """Trees and a railing of which half is clear, all beyond the near field."""
    camera = Camera(256, 192, math.radians(60.0))
    trees = scene_of_city(street_of_trees(), name="multi-mesh", camera=camera)
    with Renderer(trees.mesh, trees.ground, size=(256, 192), measured=True) as seen:
        for x, azimuth in ((-95.0, 0.1), (-95.0, -0.05), (60.0, math.pi - 0.1)):
            view = view_towards(np.array([x, 1.0, 2.0]), azimuth, 0.03, focal=camera.focal, window=camera.window)
            technique = RayCasting(trees, CastRules(near_field=15.0))
            picture = drawn(seen, technique, view)
            truth = drawn(seen, FullGeometry(trees), view)
            wrong = view_errors(truth, picture, focal=camera.focal, disoccluded=np.zeros((192, 256), bool), flip=False)
            leaves = np.isin(truth.object_ids, [k for k, one in enumerate(trees.objects) if "tree" in one])
            assert leaves.mean() > 0.005
            assert wrong.thickness_px <= 2.0
            assert wrong.wrong_share < 0.01


def test_few_rays_a_frame_come_to_the_same_picture(scene, renderer):
    """Pixels that show what was cast for their neighbours get rays of their own."""
    technique = RayCasting(scene, CastRules(near_field=NEAR, rays=1000))
    view = look(scene, *VIEWS[0])
    for _ in range(60):
        picture = drawn(renderer, technique, view)
        if technique.latest.rays < 20:
            break
    assert technique.tally.frames > 10
    found = errors(scene, renderer, picture, view)
    assert found.thickness_px <= 1.0
    assert found.psnr_db > 45.0


def walked(renderer, technique, views, *, updates, seconds):
    """The rays, and the budgets, of frames where rays take ``seconds``, a function of how many, and all else takes 3 ms."""
    rays, budgets, done = [], [], None
    for view in views:
        budgets.append(Budget(updates=updates, done=done))
        drawn(renderer, technique, view, budget=budgets[-1], measured=False)
        rays.append(technique.latest.rays)
        done = Done(finish=3e-3 + seconds(rays[-1]), finding=seconds(rays[-1]))
    return rays, budgets


def test_frames_that_cast_few_rays_do_not_make_rays_dear(scene, renderer):
    """What a frame takes whatever it casts is no ray's cost: who turns then has rays for what comes into view."""
    technique = RayCasting(scene, CastRules(near_field=NEAR))
    slow = [look(scene, -140.0 + 0.001 * k, 0.0, 0.0) for k in range(40)]
    aside = look(scene, -139.961, 0.0, 0.6)
    rays, _ = walked(renderer, technique, [*slow, aside], updates=8e-3, seconds=lambda n: 1e-4 * (n > 0) + 2e-6 * n)
    assert 0 < max(rays[20:40]) < 200
    assert rays[-1] > 1000
    assert technique.latest.late == technique.latest.unknown == 0


def test_rays_take_what_they_may_and_recorded_budgets_give_the_same_rays(scene, renderer):
    """Going fast, with rays that take ten times as long as is believed at first."""
    views = [look(scene, -140.0 + 3.0 * k, 0.0, 0.0) for k in range(40)]
    rules = CastRules(near_field=NEAR)
    rays, budgets = walked(renderer, RayCasting(scene, rules), views, updates=5e-3, seconds=lambda n: 2e-5 * n)
    assert rays[0] > 2000, "as is believed"
    assert min(rays[20:]) * 2e-5 > 0.7 * 5e-3
    assert max(rays[20:]) * 2e-5 < 1.4 * 5e-3
    again = RayCasting(scene, rules)
    for view, budget, count in zip(views, budgets, rays, strict=True):
        drawn(renderer, again, view, budget=budget, measured=False)
        assert again.latest.rays == count
