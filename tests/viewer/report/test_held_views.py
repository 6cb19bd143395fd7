"""Views that are held: by a technique that captures what it shows, a part in each frame, and by those that capture nothing."""

import json
import math
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest

import viewer
from mmi.walks.walk import Pose
from viewer.casting.rules import CastRules
from viewer.cells.scene_cache import cell_cache
from viewer.drawing.renderer import Renderer
from viewer.plan import (
    Budget,
    CellKey,
    CellLayers,
    Costs,
    ImageKey,
    Objects,
    Plan,
    Relief,
    ReliefPart,
    Request,
    Sky,
    Slot,
)
from viewer.report.compare import CompareOptions, compare_views
from viewer.report.held_views import alike_after, held_again, hold_view, layers_shown, settled_after, settled_frames
from viewer.scene.follower import Follower
from viewer.techniques.catalogue import make_technique
from viewer.techniques.ray_cast import RayCasting

SCHEMA = json.loads((Path(viewer.__file__).parent / "report" / "schemas" / "report.json").read_text())
IMAGE = ImageKey("gradual", "all")
PARTS = 3
VIEW = Pose((50.0, 0.0, 1.7), 0.3, 0.0)
FAR = Pose((0.0, 0.0, 1.7), 0.3, 0.0)
"""It shows something that is not near."""


class Gradual:
    """Captures what is visible in a few parts, one in each frame, and draws it when it has them all; near objects till then.

    It captures nothing before it has been told what a frame took, nor where updates are forbidden.
    """

    name = "gradual"

    def __init__(self, scene):
        self._follower, self._scene = Follower(scene), scene
        self.captured = 0
        self.budgets, self.times, self.plans = [], [], []

    def plan(self, view, *, now, budget):
        self.budgets.append(budget)
        self.times.append(now)
        place = self._follower.move(view.eye).cell
        requests = ()
        if budget.updates > 0.0 and budget.done is not None and self.captured < PARTS:
            objects = place.visible[self.captured :: PARTS]
            part = Objects(f"part {self.captured} of {place.cell.id}", objects)
            requests = (Request(Slot(IMAGE, view.window[2:]), view, (part,), clear=not self.captured),)
            self.captured += 1
        shown = Objects(f"near {place.cell.id}", place.near)
        if self.captured == PARTS:
            shown = Relief(IMAGE, (ReliefPart(view, (0, 0), 100.0),))
        self.plans.append(Plan((shown, self._scene.ground_in(view), Sky()), place=place.cell.id, requests=requests))
        return self.plans[-1]


def gradual(scene):
    """The technique as one of somebody's own."""
    return Gradual(scene)


def options(*techniques, **more):
    return CompareOptions(techniques=techniques, keep=0, flip=False, **more)


def without_times(entry):
    return {name: value for name, value in entry.items() if not name.endswith("_ms") and name != "late_share"}


@pytest.fixture(scope="module")
def renderer(scene):
    with Renderer(scene.mesh, scene.ground, size=(scene.camera.width, scene.camera.height), measured=True) as renderer:
        yield renderer


@pytest.fixture(scope="module")
def cache(scene, renderer):
    with cell_cache({"multi-mesh": scene}, renderer, measured=True) as cache:
        yield cache


def test_a_view_that_is_held_is_scored_when_it_has_settled(dataset, tmp_path):
    """Its first frame is as wrong as near geometry alone, its last is the geometry."""
    report = {
        frames: compare_views(dataset.path, tmp_path, views=6, seed=5, options=options("local", gradual, settle=frames))
        for frames in (1, PARTS + 2, PARTS)
    }
    for one in report.values():
        jsonschema.validate(one, SCHEMA)
    own = next(name for name in report[1]["techniques"] if name != "local")
    first, last, early = (report[frames]["techniques"] for frames in (1, PARTS + 2, PARTS))
    assert first[own]["hole_share"] == first["local"]["hole_share"] > 0.001
    assert first[own]["settling"] is None
    assert first["local"]["wrong_thickness_px"]["max"] > 10.0 > 1.0 >= last[own]["wrong_thickness_px"]["max"]
    assert last[own]["psnr_db"] > last[own]["psnr_worst_db"] > 45.0 > 30.0 > first["local"]["psnr_worst_db"]
    assert last[own]["psnr_worst_db"] == min(one["psnr_db"] for one in report[PARTS + 2]["scored"][own])
    assert last["local"]["hole_share"] == first["local"]["hole_share"]
    views = report[PARTS + 2]["scored"]
    far = [one["wrong_thickness_px"] > 2.0 for one in views["local"]]  # the others are like the geometry at once
    assert sum(far) > 2
    assert [one["frames"] for one in views[own]] == [PARTS if one else 0 for one in far]
    assert last[own]["requests"] == pytest.approx(PARTS / (PARTS + 2))
    assert last[own]["captured_pixels"] == pytest.approx(256 * 256 * PARTS / (PARTS + 2))
    assert (last["local"]["requests"], last["local"]["captured_pixels"]) == (0.0, 0.0)
    layers = [one["layers"] for one in report[PARTS + 2]["scored"][own]]
    assert max(layers) > 0
    assert last[own]["settling"] == {
        "alike_frames": last[own]["settling"]["alike_frames"],
        "unlike": 0,
        "settled_frames": dict.fromkeys(("p50", "p99", "max"), PARTS + 1.0),  # a first one captures nothing
        "unsettled": 0,
        "layers": {"p50": np.median(layers), "max": max(layers)},
        "later_than_layers": sum(one < PARTS for one, some in zip(layers, far, strict=True) if some),
    }
    assert last["local"]["settling"]["settled_frames"]["max"] == 0.0
    assert early[own]["settling"]["unsettled"] == 6
    assert early[own]["settling"]["settled_frames"] is None
    assert last[own]["settling"]["alike_frames"]["max"] == PARTS
    assert early[own]["settling"]["unlike"] == sum(far)
    assert [one["frames"] for one in report[PARTS]["scored"][own]] == [None if one else 0 for one in far]
    assert early[own]["hole_share"] == first["local"]["hole_share"], "shown when it is whole"


def test_updates_that_are_forbidden_never_come(dataset, tmp_path):
    found = compare_views(dataset.path, tmp_path, views=2, options=options("local", gradual, settle=5, budget_ms=0.0))
    local, own = found["techniques"].values()
    assert (found["budget_ms"], found["held_frames"]) == (0.0, 5)
    assert own["hole_share"] == local["hole_share"]
    assert own["settling"]["settled_frames"]["max"] == 0.0


def test_techniques_that_capture_nothing_score_the_same_however_long_a_view_is_held(dataset, tmp_path):
    names = ("full", "visible", "local", "single-mesh", "multi-mesh")
    once, held = (
        compare_views(dataset.path, tmp_path, views=3, seed=2, options=options(*names, settle=settle))
        for settle in (1, 3)
    )
    for name in names:
        one, other = (without_times(report["techniques"][name]) for report in (once, held))
        settling = other.pop("settling")
        assert one.pop("settling") is None
        assert one == other
        assert (settling is None) == (name == "full")
        if settling is not None:
            assert settling["settled_frames"] == {"p50": 0.0, "p99": 0.0, "max": 0.0}
            assert settling["unsettled"] == 0
            assert set((settling["alike_frames"] or {}).values()) <= {0.0}, "from the first picture on, or never"
    views = zip(once["scored"]["multi-mesh"], held["scored"]["multi-mesh"], strict=True)
    assert all({**one, "frames": other["frames"]} == other for one, other in views)


def test_what_is_scored_was_planned_with_the_budgets_that_were_timed(scene, renderer, cache):
    view = VIEW.view(scene.camera)
    timed, again = Gradual(scene), Gradual(scene)
    costs = Costs(frame=0.001)
    held = hold_view(timed, renderer, cache, view, frames=6, frames_per_second=20.0, updates=0.004, costs=costs)
    budgets = list(timed.budgets)
    assert settled_frames(timed, renderer, cache, view, held) == PARTS + 1
    patient = timed.budgets[-1]
    assert [(one.frame, one.updates) for one in budgets] == 6 * [(0.05, 0.004)]
    assert patient.frame > 60.0 and patient.updates == math.inf and patient.done == held.frames[-1].done
    assert (timed.budgets[0].costs, timed.budgets[0].done) == (costs, None)
    assert len({one.costs for one in budgets} | {held.costs}) == 7, "what frames took is learnt from"
    assert [one.done.requests.pixels > 0 for one in budgets[1:]] == [False, True, True, True, False]
    assert timed.times == pytest.approx([0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3])
    assert all(
        frame.seconds >= budget.done.draws.seconds for frame, budget in zip(held.frames, budgets[1:], strict=False)
    )
    with held_again(again, renderer, cache, view, held) as plans:
        found = list(plans)
        assert renderer.image(IMAGE).object_ids.max() >= 0
    assert [asked for _, asked in found] == [bool(one.requests) for one in again.plans]
    assert all(plan.same_as(replace(one, requests=())) for (plan, _), one in zip(found, again.plans, strict=True))
    assert (again.budgets, again.times) == (budgets, timed.times[:-1])
    assert all(one.same_as(other) for one, other in zip(again.plans, timed.plans[:-1], strict=True))


def test_nothing_that_was_captured_is_left(scene, renderer, cache):
    view = VIEW.view(scene.camera)
    held = hold_view(Gradual(scene), renderer, cache, view, frames=6)
    with pytest.raises(KeyError):
        renderer.image(IMAGE)
    with pytest.raises(RuntimeError), held_again(Gradual(scene), renderer, cache, view, held) as plans:
        list(plans)
        renderer.image(IMAGE)
        raise RuntimeError
    with pytest.raises(KeyError):
        renderer.image(IMAGE)


@pytest.mark.parametrize(
    ("plans", "after"),
    [
        ("aa", 0),
        ("aaaa", 0),
        ("Aaaa", 1),
        ("aAaa", 2),
        ("baaaa", 1),
        ("abaa", 2),
        ("AAAaa", 3),
        ("A", None),
        ("ab", None),
        ("abab", None),
        ("AAAA", None),
        ("AAAa", None),
        ("aaaA", None),
    ],
)
def test_a_view_has_settled_where_plans_capture_nothing_and_stay_the_same(scene, plans, after):
    """A letter is what is drawn, a capital letter has something captured as well. The last one had all the time there is."""
    request = Request(Slot(IMAGE, (8, 8)), VIEW.view(scene.camera), ())
    *made, patient = [
        Plan((Objects(one.lower(), np.arange(1)), Sky()), requests=(request,) if one.isupper() else ()) for one in plans
    ]
    assert settled_after(made, patient) == after


def test_images_that_are_dropped_unsettle_nothing():
    plan = Plan((Sky(),))
    assert settled_after([replace(plan, drops=(IMAGE,)), plan, plan], plan) == 0


def test_who_has_no_time_to_capture_has_not_settled(scene, renderer, cache):
    class Starved(Gradual):
        """Captures a part where a frame has ten seconds."""

        def plan(self, view, *, now, budget):
            return super().plan(view, now=now, budget=budget if budget.frame > 10.0 else replace(budget, updates=0.0))

    view = VIEW.view(scene.camera)
    for updates, after in ((math.inf, None), (0.005, None), (0.0, 0)):
        technique = Starved(scene)
        held = hold_view(technique, renderer, cache, view, frames=4, updates=updates)
        assert settled_frames(technique, renderer, cache, view, held) == after


@pytest.mark.parametrize(("rays", "after"), [(None, 1), (50, None), (0, 0)])
def test_who_still_has_rays_to_cast_has_not_settled(scene, renderer, cache, rays, after):
    view = FAR.view(scene.camera)
    technique = RayCasting(scene, CastRules(near_field=20.0, rays=rays))
    held = hold_view(technique, renderer, cache, view, frames=3)
    assert held.frames[0].done.fresh > 1 or rays is not None
    assert settled_frames(technique, renderer, cache, view, held) == after


def test_layers_are_counted_by_sector_and_pieces_are_no_layers(scene):
    cell = CellKey("multi-mesh", "c")
    names = ("s0.l0", "s0.l1", "s0.l2", "s0.l2.1", "s1.l0", "s1.l0.1", "s1.l0.2", "s10.l0")
    assert layers_shown(Plan((Sky(), CellLayers(cell, names)))) == 5
    assert layers_shown(Plan((CellLayers(cell, names), CellLayers(CellKey("multi-mesh", "d"), names[:1])))) == 6
    assert layers_shown(Plan((Sky(),))) == 0
    shown = make_technique("multi-mesh", {"multi-mesh": scene}).plan(VIEW.view(scene.camera), now=0.0, budget=Budget())
    assert layers_shown(shown) > 0


def test_frames_before_the_first_that_is_like_the_geometry_are_counted(scene, renderer, cache):
    view = FAR.view(scene.camera)
    full = make_technique("full", {"multi-mesh": scene}).plan(view, now=0.0, budget=Budget())
    truth = renderer.draw(full, view, measured=True)
    held = hold_view(Gradual(scene), renderer, cache, view, frames=6)
    with held_again(Gradual(scene), renderer, cache, view, held) as plans:
        plan, after = alike_after(plans, renderer, view, truth)
        assert after == PARTS and plan.draws and not plan.requests
    short = replace(held, frames=held.frames[:PARTS])
    with held_again(Gradual(scene), renderer, cache, view, short) as plans:
        assert alike_after(plans, renderer, view, truth)[1] is None
    assert alike_after(iter([(full, False)]), renderer, view, truth) == (full, 0)
