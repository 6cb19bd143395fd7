"""Dynamic updates decide without OpenGL: what is captured when, and what is shown instead of stored layers."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from mmi.foundation.camera import level_view
from mmi.foundation.errors import ParameterError
from mmi.validity.layers import layer_errors, layer_parallax
from viewer.plan import Budget, CellLayers, Costs, Objects, Relief
from viewer.techniques.dynamic import ORDERS, Candidate, DynamicImpostors
from viewer.techniques.layered import LayeredImpostors
from viewer.techniques.updates import bounds_in, capture_window, cell_units

FREE = Costs(frame=0.0, draw=0.0, triangle=0.0, request=0.0, pixel=0.0, relief=0.0, captured=0.0)
ONE_BY_ONE = replace(Budget(), updates=1.0, frame=10.0, costs=FREE._replace(request=0.6))
"""A budget in which one request fits into a frame."""


def look(scene, x, y=0.0, azimuth=0.0):
    camera = scene.camera
    return level_view(np.array([x, y, 1.7]), azimuth, focal=camera.focal, window=camera.window)


def walk(technique, views, budget):
    return [technique.plan(view, now=i / 30.0, budget=budget) for i, view in enumerate(views)]


def creeping(technique, view, frames, budget):
    """Plans for a viewer who hardly moves, and does not stand still: each layer is captured into an image of its own."""
    steps = np.arange(frames + 1) * 1e-6
    views = [
        level_view(view.eye + np.array([0.0, step, 0.0]), azimuth_of(view), focal=view.focal, window=view.window)
        for step in steps
    ]
    return walk(technique, views, budget)[1:]


def azimuth_of(view):
    return math.atan2(-view.eye_from_world[2, 1], -view.eye_from_world[2, 0])


def stored_names(plan):
    return {name for draw in plan.draws if isinstance(draw, CellLayers) for name in draw.names}


def reliefs(plan):
    return [draw for draw in plan.draws if isinstance(draw, Relief)]


def units_shown(scene, view):
    """Names of (sector, layer) that multi-mesh draws."""
    names = stored_names(LayeredImpostors(scene).plan(view, now=0.0, budget=Budget()))
    return {".".join(name.split(".")[:2]) for name in names}


@pytest.fixture(scope="module")
def busy(scene):
    """The azimuth in which most layers are seen from the middle of the cell."""
    return max(
        np.linspace(-3.1, 3.1, 32).tolist(),
        key=lambda azimuth: len(units_shown(scene, look(scene, 50.0, azimuth=azimuth))),
    )


@pytest.fixture(scope="module")
def walked(scene):
    xs = np.concatenate([np.arange(20.0, 75.0, 0.7), [75.0] * 5])
    return [look(scene, x, 0.3 * math.sin(x), 0.2 * math.sin(0.1 * x)) for x in xs]


def test_without_time_for_updates_the_plans_are_those_of_multi_mesh(scene, walked):
    for fade in (0.0, 0.3):
        plans = walk(DynamicImpostors(scene, fade=fade), walked, Budget(updates=0.0))
        stored = walk(LayeredImpostors(scene, fade=fade), walked, Budget())
        assert all(one.same_as(other) for one, other in zip(plans, stored, strict=True))


def test_a_budget_of_nothing_forgets_what_was_captured(scene, busy):
    technique = DynamicImpostors(scene)
    view = look(scene, 50.0, azimuth=busy)
    made = technique.plan(view, now=0.0, budget=replace(Budget(), costs=FREE))
    assert reliefs(made)
    after = technique.plan(view, now=0.1, budget=Budget(updates=0.0))
    assert set(after.drops) == {request.into.image for request in made.requests}
    assert not reliefs(after) and stored_names(after)


def test_a_view_that_is_held_is_captured_once_through_its_own_projection(scene):
    technique, view = DynamicImpostors(scene), look(scene, 50.0, azimuth=0.4)
    plans = walk(technique, [view] * 4, replace(Budget(), costs=FREE))
    shown = reliefs(plans[0])
    assert shown and not stored_names(plans[0])
    for relief in shown:
        [part] = relief.parts
        np.testing.assert_array_equal(part.view.eye_from_world, view.eye_from_world)
        assert part.view.focal == view.focal, "a texel is a pixel"
    assert not any(plan.requests or plan.drops for plan in plans[1:])
    assert all(plan.same_as(plans[1]) for plan in plans[2:])


def test_it_settles_in_no_more_frames_than_there_are_layers(scene):
    for azimuth in np.linspace(-3.0, 3.0, 9):
        view = look(scene, 50.0, azimuth=azimuth)
        boxes = [unit.boxes for unit in cell_units(scene, "0001-01").units]
        units = [some for some in boxes if capture_window(view, bounds_in(view, some), margin=0) is not None]
        plans = walk(DynamicImpostors(scene), [view] * 12, ONE_BY_ONE)
        assert all(len(plan.requests) <= 1 for plan in plans)
        settled = next(i for i, plan in enumerate(plans) if not plan.requests)
        assert settled <= len(units)
        assert not stored_names(plans[settled])


def test_every_relief_was_captured_by_a_request_and_dropped_once_it_is_not_needed(scene, walked):
    technique = DynamicImpostors(scene)
    there = set()
    for i, view in enumerate(walked):
        plan = technique.plan(view, now=i / 30.0, budget=ONE_BY_ONE)
        assert set(plan.drops) <= there
        there -= set(plan.drops)
        there |= {request.into.image for request in plan.requests}
        assert {relief.image for relief in reliefs(plan)} <= there
    assert len(there) <= len(cell_units(scene, plan.place).units), "no image is left behind"


def test_the_worst_layer_is_captured_first_and_of_equals_the_nearest(scene, busy):
    view = look(scene, 57.0, 2.0, busy)  # at a corner of the cell
    technique = DynamicImpostors(scene)
    plans = creeping(technique, view, 12, ONE_BY_ONE)
    units = {unit.name: unit for unit in cell_units(scene, plans[0].place).units}
    reference = np.array(scene.dataset.cell(plans[0].place).reference)
    widened = scene.camera.angle_from_pixels(16)
    order = [units[plan.requests[0].into.image.name.split()[0]] for plan in plans if plan.requests]
    keys = [
        (-layer_errors([layer_parallax(reference, unit.boxes, widened=widened)], view.eye)[0], unit.depth)
        for unit in order
    ]
    assert len(keys) > 1 and keys == sorted(keys)


def test_orders_are_what_they_are_called():
    some = [
        Candidate(0, 0.1, 50.0, 7, 0.001),
        Candidate(1, 0.3, 90.0, 3, 0.004),
        Candidate(2, 0.3, 20.0, 9, 0.004),
        Candidate(3, 0.2, 60.0, -1, 0.001),
    ]
    found = {name: [one.unit for one in order(some, 5)] for name, order in ORDERS.items()}
    assert found["error-angle"] == [2, 1, 3, 0]
    assert found["error-by-time"] == [3, 0, 2, 1]
    assert found["front-to-back"] == [2, 0, 3, 1]
    assert found["round-robin"] == [3, 1, 0, 2]
    assert sorted(found["random"]) == [0, 1, 2, 3]
    assert len({tuple(one.unit for one in ORDERS["random"](some, frame)) for frame in range(20)}) > 5


def test_an_unknown_order_is_refused(scene):
    with pytest.raises(ParameterError, match="error-angle, error-by-time, front-to-back, round-robin, random expected"):
        DynamicImpostors(scene, order="at-will")


def test_what_is_captured_fits_into_the_frame_and_into_the_updates(scene, walked):
    costs = Costs(frame=0.004, draw=1e-4, triangle=1e-6, request=3e-4, pixel=4e-8, relief=2e-8, captured=1e-6)
    for frame, updates in ((0.033, 0.005), (0.012, math.inf), (0.009, 0.002)):
        asked = 0
        for plan in walk(DynamicImpostors(scene), walked, Budget(frame=frame, updates=updates, costs=costs)):
            taken = 0.0
            for request in plan.requests:
                triangles = sum(
                    int(scene.mesh.triangle_counts[draw.objects].sum())
                    for draw in request.draws
                    if isinstance(draw, Objects)
                )
                taken += costs.of_request(triangles=triangles, draws=len(request.draws), pixels=request.pixels)
            assert taken <= updates + 1e-12
            drawn = costs.frame + sum(costs.relief * draw.pixels + costs.draw for draw in reliefs(plan))
            assert not plan.requests or taken + drawn <= frame + 1e-12
            asked += len(plan.requests)
        assert asked


def test_for_a_viewer_who_stands_all_layers_are_one_picture_of_as_few_requests_as_there_is_time_for(scene, busy):
    view = look(scene, 50.0, azimuth=busy)
    for updates, requests in ((0.7, 1), (10.0, 1)):
        plans = walk(DynamicImpostors(scene), [view] * 4, replace(ONE_BY_ONE, updates=updates))
        assert [len(plan.requests) for plan in plans] == [requests, 0, 0, 0]
        [relief] = reliefs(plans[-1])
        assert relief.parts[0].view.window == view.window
    one_layer = Budget(updates=1.0, frame=1e6, costs=FREE._replace(draw=0.6))
    plans = walk(DynamicImpostors(scene), [view] * 12, one_layer)
    layers = [{draw.key.split()[3] for request in plan.requests for draw in request.draws} for plan in plans]
    assert len(layers[0]) == 1 and len(set.union(*layers)) == sum(len(some) for some in layers) > 1
    assert {len(reliefs(plan)) for plan in plans} == {1} and not stored_names(plans[-1])
    after = DynamicImpostors(scene)
    held = walk(after, [view] * 2, replace(ONE_BY_ONE, updates=10.0))
    moved = after.plan(look(scene, 50.2, azimuth=busy), now=1.0, budget=replace(ONE_BY_ONE, updates=10.0))
    assert {one.image for one in reliefs(held[-1])} <= set(moved.drops)


def test_where_a_frame_is_too_short_for_reliefs_the_stored_layers_are_there(scene, busy):
    technique, view = DynamicImpostors(scene), look(scene, 50.0, azimuth=busy)
    plans = walk(technique, [view] * 2, replace(Budget(), costs=FREE))
    assert reliefs(plans[1])
    dear = Budget(costs=FREE._replace(relief=1.0))
    walks_on = technique.plan(look(scene, 50.01, azimuth=busy), now=0.1, budget=dear)
    assert not reliefs(walks_on) and not walks_on.requests and stored_names(walks_on)


def test_for_a_viewer_who_stands_the_picture_settles_on_a_machine_that_is_too_slow(scene, busy):
    budget = Budget(updates=0.005, costs=FREE._replace(frame=0.1, request=0.003))
    view = look(scene, 50.0, azimuth=busy)
    plans = walk(DynamicImpostors(scene), [view] * 12, budget)
    assert not plans[-1].requests and not stored_names(plans[-1])
    moving = walk(DynamicImpostors(scene), [look(scene, 50.0 + 0.01 * i, azimuth=busy) for i in range(12)], budget)
    assert not any(plan.requests for plan in moving[1:])


def test_a_layer_too_large_for_a_frame_is_captured_in_strips(scene, busy):
    view = look(scene, 50.0, azimuth=busy)
    costs = FREE._replace(pixel=1e-6, request=1e-4)
    for updates in (0.05, 0.02, 0.008):
        plans = creeping(DynamicImpostors(scene), view, 60, Budget(updates=updates, frame=1.0, costs=costs))
        assert not plans[-1].requests and reliefs(plans[-1])
        images = {}
        for plan in plans:
            assert sum(costs.request + costs.pixel * request.pixels for request in plan.requests) <= updates
            for request in plan.requests:
                images.setdefault(request.into.image, []).append(request)
        for image, requests in images.items():
            assert len({request.into.size for request in requests}) == 1
            spans = sorted(
                (request.into.corner[0], request.into.corner[0] + request.view.window[2]) for request in requests
            )
            assert all(a[1] <= b[0] for a, b in itertools.pairwise(spans)), image
            for request in requests:  # a strip is where it belongs in the whole
                left, top = request.view.window[:2]
                whole = next(r for plan in plans for r in reliefs(plan) if r.image == image).parts[0].view
                assert request.into.corner == (left - whole.window[0], top - whole.window[1])


def test_a_capture_is_shown_while_its_error_is_below_the_bound_and_the_stored_one(scene, busy):
    free = replace(Budget(), costs=FREE)
    technique = DynamicImpostors(scene)
    creeping(technique, look(scene, 45.0, azimuth=busy), 2, free)
    still_there, late = [], Budget(updates=1e-9, costs=FREE._replace(request=1.0))
    for step in np.arange(0.0, 16.0, 0.5):  # with no time for more
        plan = technique.plan(look(scene, 45.0 + step, azimuth=busy), now=0.1 + step, budget=late)
        if plan.place != "0001-01":
            break
        eye = np.array([45.0 + step, 0.0, 1.7])
        for relief in reliefs(plan):
            unit = next(one for one in cell_units(scene, plan.place).units if one.name == relief.image.name.split()[0])
            widened = scene.camera.angle_from_pixels(16)
            now = layer_errors([layer_parallax(relief.parts[0].view.eye, unit.boxes, widened=widened)], eye)[0]
            reference = np.array(scene.dataset.cell(plan.place).reference)
            before = layer_errors([layer_parallax(reference, unit.boxes, widened=widened)], eye)[0]
            assert now <= min(before, scene.parameters.max_angle)
        still_there.append(len(reliefs(plan)))
    assert still_there[0] == max(still_there) > 0


def test_a_layer_that_takes_longer_is_captured_in_pieces_and_shown_when_it_is_whole(scene, busy, monkeypatch):
    monkeypatch.setattr("viewer.techniques.updates._PIECE_TRIANGLES", 1)
    view = look(scene, 50.0, azimuth=busy)
    units = {unit.name: unit for unit in cell_units(scene, "0001-01").units}
    assert max(len(unit.pieces) for unit in units.values()) > 1
    budget = Budget(updates=1.0, frame=1e6, costs=FREE._replace(request=0.6, draw=0.15))
    plans = creeping(DynamicImpostors(scene), view, 40, budget)
    drawn = {}
    for plan in plans:
        for request in plan.requests:
            drawn.setdefault(request.into.image, []).append(request)
        for relief in reliefs(plan):
            unit = units[relief.image.name.split()[0]]
            keys = {draw.key for request in drawn[relief.image] for draw in request.draws}
            seen_as = relief.parts[0].view
            for piece in unit.pieces:
                seen = capture_window(seen_as, bounds_in(seen_as, unit.boxes[piece.rows]), margin=0)
                assert (piece.draw.key in keys) == (seen is not None)
    assert any(len(some) > 1 for some in drawn.values()), "some came in pieces"
    assert not plans[-1].requests and reliefs(plans[-1])
    for first, second in itertools.pairwise(plans):
        assert {one.image for one in reliefs(first)} <= {one.image for one in reliefs(second)}


def pixels(plan):
    """Of the captures of a plan, by the layers."""
    return {request.into.image.name.split()[0]: request.pixels for request in plan.requests}


def waited(scene, view, order):
    """Error angles of layers that were not captured yet, summed over the frames of a viewer who hardly moves."""
    whole = creeping(DynamicImpostors(scene), view, 1, replace(Budget(), costs=FREE))[0]
    layers = pixels(whole)
    if not layers:
        return 0.0
    reference = np.array(scene.dataset.cell(whole.place).reference)
    boxes = {unit.name: unit.boxes for unit in cell_units(scene, whole.place).units}
    widened = scene.camera.angle_from_pixels(16)
    errors = layer_errors([layer_parallax(reference, boxes[name], widened=widened) for name in layers], view.eye)
    budget = Budget(updates=0.15 * sum(layers.values()), frame=1e9, costs=FREE._replace(pixel=1.0))
    plans = creeping(DynamicImpostors(scene, order=order), view, 40, budget)
    shown = [{relief.image.name.split()[0] for relief in reliefs(plan)} for plan in plans]
    assert shown[-1] == set(layers)
    return sum(error for some in shown for name, error in zip(layers, errors, strict=True) if name not in some)


def test_by_error_and_time_errors_fall_fastest(scene):
    views = [look(scene, 57.0, 2.0, azimuth) for azimuth in np.linspace(-3.1, 3.1, 16)]
    total = {order: sum(waited(scene, view, order) for view in views) for order in ORDERS}
    assert total["error-by-time"] == min(total.values()) < total["error-angle"]


@pytest.mark.parametrize("share", np.linspace(0.1, 0.9, 9).tolist())
def test_time_that_does_not_do_for_the_first_layer_is_spent_on_others(scene, busy, share):
    view = look(scene, 50.0, azimuth=busy)
    layers = pixels(DynamicImpostors(scene).plan(view, now=0.0, budget=replace(Budget(), costs=FREE)))
    budget = Budget(updates=share * sum(layers.values()), frame=1e9, costs=FREE._replace(pixel=1.0))
    plan = DynamicImpostors(scene).plan(view, now=0.0, budget=budget)
    spent = sum(request.pixels for request in plan.requests)
    assert all(cost > budget.updates - spent for name, cost in layers.items() if name not in pixels(plan))


def test_the_same_views_and_budgets_give_the_same_plans(scene, walked):
    rng = np.random.default_rng(3)
    budgets = [replace(ONE_BY_ONE, costs=Costs(*(rng.uniform(0.5, 2.0) * np.array(Costs())).tolist())) for _ in walked]
    runs = []
    for _ in range(2):
        technique = DynamicImpostors(scene)
        runs.append(
            [technique.plan(v, now=i / 30.0, budget=b) for i, (v, b) in enumerate(zip(walked, budgets, strict=True))]
        )
    assert all(one.same_as(other) for one, other in zip(*runs, strict=True))
    assert sum(len(plan.requests) for plan in runs[0])
