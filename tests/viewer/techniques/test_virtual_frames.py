"""Virtual frames: what stays right is kept, what is or will be wrong is not shown, and the same views give the same plans."""

from __future__ import annotations

import math

import numpy as np
import pytest
from moving import block, movers_of

from mmi.foundation.camera import Camera, view_towards
from mmi.foundation.errors import ParameterError
from viewer.plan import Budget, Costs, Moving, Objects, Plan, Relief, Sky
from viewer.techniques import virtual_frames as module
from viewer.techniques.virtual_frames import FrameRules
from viewer.techniques.with_movers import WithMovers

CAMERA = Camera(320, 240, math.radians(60.0))
RATE = 30.0
EAGER = FrameRules(thrifty=False)


class Still:
    """A technique that draws some objects and the sky, and keeps what it was told."""

    name = "still"

    def __init__(self):
        self.told = []

    def plan(self, _, *, now, budget):  # noqa: ARG002
        self.told.append(budget)
        return Plan((Objects("all", np.arange(3)), Sky()))


def look(eye=(0.0, 0.0, 1.7), azimuth=0.0):
    return view_towards(np.array(eye), azimuth, 0.0, focal=CAMERA.focal, window=CAMERA.window)


def straight(start, speed, heading=0.0, seconds=20.0):
    """A track at an even speed (metres a second along x and y)."""
    (x, y), (vx, vy) = start, speed
    return [(0.0, x, y, 0, heading), (seconds, x + vx * seconds, y + vy * seconds, 0, heading)]


def walk(movers, *, frames=60, rules=EAGER, eye=lambda _: (0.0, 0.0, 1.7), budget=None, start=0.0):
    """Views and plans of some frames, and the technique that made them."""
    technique = WithMovers(Still(), movers, CAMERA, rules=rules)
    found = []
    for i in range(frames):
        time = start + i / RATE
        view = look(eye(time))
        found.append((time, view, technique.plan(view, now=time, budget=budget or Budget(1.0 / RATE))))
    return found, technique


def shown(plan, movers):
    """Movers as geometry, and parts of reliefs."""
    geometry = [which for draw in plan.draws if isinstance(draw, Moving) for which in draw.which.tolist()]
    parts = [part for draw in plan.draws if isinstance(draw, Relief) for part in draw.parts]
    assert len(geometry) + len(parts) <= len(movers.ids)
    return geometry, parts


def points_of(movers, pose, n=7):
    """(n^3, 3) points all through the box of the first shape."""
    steps = np.linspace(0.0, 1.0, n)
    share = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    own = movers.boxes[0, 0] + share * (movers.boxes[0, 1] - movers.boxes[0, 0])
    return own @ pose[:3, :3].T + pose[:3, 3]


def test_one_that_stands_is_captured_once():
    movers = movers_of([straight((40.0, 3.0), (0.0, 0.0))])
    found, technique = walk(movers)
    assert [len(plan.requests) for _, _, plan in found] == [1] + [0] * 59
    for time, _, plan in found:
        geometry, (part,) = shown(plan, movers)
        assert not geometry
        assert (part.moved is None) == (time == 0.0) or np.allclose(part.moved, np.eye(4))
    assert technique.tally[:4] == (60, 0, 1, 59)


def test_an_image_moves_with_its_object():
    """World now from world then takes the object's points along, whatever it does."""
    movers = movers_of([[(0.0, 60, 3, 0, 0), (20.0, 64, 5, 0, 40)]])
    found, _ = walk(movers, frames=30)
    then = {}
    kept = 0
    for time, _, plan in found:
        pose = movers.poses(time)[0]
        (part,) = shown(plan, movers)[1]
        if plan.requests:
            then[part.view.window] = pose
        before = then[part.view.window]
        moved = np.eye(4) if part.moved is None else part.moved
        assert np.allclose(moved @ before, pose)
        kept += part.moved is not None
    assert kept > 20


@pytest.mark.parametrize("calculation", ["predictive", "common"])
@pytest.mark.parametrize(
    ("track", "eye"),
    [
        (straight((30.0, -8.0), (0.0, 6.0), 90.0), lambda _: (0.0, 0.0, 1.7)),
        (straight((60.0, 2.0), (-12.0, 0.0), 180.0), lambda time: (4.0 * time, 0.0, 1.7)),
        ([(0.0, 35, 0, 0, 0), (3.0, 35, 0, 0, 50)], lambda time: (0.0, 2.0 * time, 1.7)),
        (straight((50.0, 0.0), (0.0, 0.0)), lambda time: (0.0, 0.0, 1.7 + 3.0 * math.sin(6.0 * time))),
    ],
)
def test_no_point_is_ever_wrong_by_more_than_the_limit(calculation, track, eye):
    """Of every point, and of whatever an image may show in its place: all points on the capture ray within the box."""
    limit = CAMERA.angle_from_pixels(1.0)
    movers = movers_of([track])
    found, technique = walk(movers, rules=FrameRules(calculation=calculation, thrifty=False), eye=eye)
    looked = worst = 0
    for time, view, plan in found:
        _, parts = shown(plan, movers)
        for part in parts:
            moved = np.eye(4) if part.moved is None else part.moved
            points = points_of(movers, movers.poses(time)[0])
            captured = part.view.eye @ moved[:3, :3].T + moved[:3, 3]
            rays = points - captured
            length = np.linalg.norm(rays, axis=1, keepdims=True)
            rays /= length
            inverse = np.linalg.inv(movers.poses(time)[0])
            own, way = captured @ inverse[:3, :3].T + inverse[:3, 3], rays @ inverse[:3, :3].T
            with np.errstate(divide="ignore", invalid="ignore"):
                ends = (movers.boxes[0][:, None] - own) / way  # (2, n, 3)
            enter = np.nanmax(np.minimum(*ends), axis=1)[:, None]
            leave = np.nanmin(np.maximum(*ends), axis=1)[:, None]
            for other in (captured + enter * rays, captured + leave * rays):
                a, b = points - view.eye, other - view.eye
                angles = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1))
                worst = max(worst, float(angles.max()))
            looked += 1
    assert looked > 20
    assert technique.tally.reused > 10
    assert worst <= limit + 1e-9
    assert calculation == "predictive" or worst > 0.2 * limit or not technique.tally.ended


def test_near_ones_and_those_across_the_edge_of_sight_are_geometry():
    movers = movers_of(
        [straight((12.0, 0.0), (0.0, 0.0)), straight((1.0, 4.0), (0.0, 0.0)), straight((40.0, 9.0), (0.0, 0.0))]
    )
    (_, _, plan), *_ = walk(movers, frames=1)[0]
    assert shown(plan, movers)[0] == [0]
    assert len(plan.requests) == 1
    assert plan.requests[0].draws[0].which.tolist() == [2]


def test_one_that_turns_fast_is_geometry_by_prediction():
    """180 degrees in half a second: an image would last less than two frames."""
    movers = movers_of([[(0.0, 30, 0, 0, 0), (0.5, 30, 0, 0, 179)]])
    found, _ = walk(movers, frames=12, start=0.05)
    assert all(shown(plan, movers)[0] == [0] and not plan.requests for _, _, plan in found)
    found, _ = walk(movers, frames=12, start=0.05, rules=FrameRules(calculation="common", thrifty=False))
    assert sum(len(plan.requests) for _, _, plan in found) >= 10


def test_one_that_comes_closer_is_captured_anew_before_its_texels_show():
    movers = movers_of([straight((200.0, 0.0), (-14.0, 0.0), 180.0, seconds=13.0)])
    found, _ = walk(movers, frames=380)
    sizes = []
    for time, view, plan in found:
        for part in shown(plan, movers)[1]:
            now = view.project(movers.corners(movers.poses(time))[0])
            width = np.ptp(now[:, 0])
            sizes.append(width / (part.view.window[2] - 2.0))
    assert len(sizes) > 300
    assert max(sizes) < 1.35


def test_a_budget_of_nothing_has_geometry_only():
    movers = movers_of([straight((40.0, 3.0), (0.0, 0.0))] * 1)
    found, technique = walk(movers, budget=Budget(1.0 / RATE, updates=0.0), frames=5)
    assert all(shown(plan, movers)[0] == [0] and not plan.requests for _, _, plan in found)
    assert all(told.updates == 0.0 for told in technique.technique.told)


def test_captures_keep_to_the_budget_and_the_rest_is_left_to_the_technique():
    movers = movers_of([straight((40.0 + i, 2.0 - i), (0.0, 0.0)) for i in range(8)])
    costs = Costs(request=1e-3)
    found, technique = walk(movers, budget=Budget(1.0 / RATE, updates=2.5e-3, costs=costs), frames=6)
    assert [len(plan.requests) for _, _, plan in found] == [2, 2, 2, 2, 0, 0]
    for (_, _, plan), told in zip(found, technique.technique.told, strict=True):
        left = 2.5e-3 - 1e-3 * len(plan.requests)
        assert 0.0 < told.updates <= left
        assert told.frame < 1.0 / RATE
        geometry, parts = shown(plan, movers)
        assert len(geometry) + len(parts) == 8


def test_the_nearest_are_captured_first():
    movers = movers_of([straight((70.0 - 10 * i, 0.0), (0.0, 0.0)) for i in range(4)])
    costs = Costs(request=1e-3)
    found, _ = walk(movers, budget=Budget(1.0 / RATE, updates=1.5e-3, costs=costs), frames=4)
    assert [plan.requests[0].draws[0].which.tolist() for _, _, plan in found] == [[3], [2], [1], [0]]


def test_what_saves_no_time_stays_geometry():
    """A box of twelve triangles is cheaper than its picture; one of many triangles is not."""
    movers = movers_of([straight((40.0, 3.0), (0.5, 0.0))])
    rules = FrameRules(thrifty=True)
    found, _ = walk(movers, rules=rules, budget=Budget(1.0 / RATE, costs=Costs(triangle=1e-9)))
    assert not any(plan.requests for _, _, plan in found)
    found, _ = walk(movers, rules=rules, budget=Budget(1.0 / RATE, costs=Costs(triangle=1e-4)))
    assert any(plan.requests for _, _, plan in found)


def test_places_are_given_back_and_never_shared():
    """Many come and go; no two that are shown have the same texels."""
    rng = np.random.default_rng(2)
    tracks = [straight(rng.uniform((20, -150), (110, 150)), rng.uniform(-14, 14, 2), 10 * i) for i in range(120)]
    movers = movers_of(tracks)
    found, technique = walk(movers, frames=150, budget=Budget(10.0))
    for _, _, plan in found:
        used = np.zeros((1024, 1024), dtype=np.int8)
        for part in shown(plan, movers)[1]:
            (x, y), (_, _, width, height) = part.corner, part.view.window
            used[y : y + height, x : x + width] += 1
        assert used.max(initial=0) <= 1
    assert technique.tally.ended > 50


def test_where_places_are_few_those_that_are_shown_keep_theirs(monkeypatch):
    """Sixteen places for forty objects, of which a viewer who turns to and fro sees half at a time."""
    monkeypatch.setattr(module, "_ATLAS", 256)
    movers = movers_of([straight((18.0 + i / 4.0, (-1) ** i * (4.0 + i)), (0.3, 0.0)) for i in range(40)])
    rules = FrameRules(thrifty=False, largest=64, limit_px=8.0)
    technique = WithMovers(Still(), movers, CAMERA, rules=rules)
    counts = []
    for i in range(80):
        view = look(azimuth=0.9 * math.sin(i / 5.0))
        plan = technique.plan(view, now=i / RATE, budget=Budget(10.0))
        used = np.zeros((256, 256), dtype=np.int8)
        for part in shown(plan, movers)[1]:
            (x, y), (_, _, width, height) = part.corner, part.view.window
            used[y : y + height, x : x + width] += 1
        assert used.max(initial=0) <= 1
        counts.append(len(shown(plan, movers)[1]))
    assert max(counts) >= 12
    assert technique.tally.ended > 16
    assert technique.tally.shown <= technique.tally.captured + technique.tally.reused


def test_the_same_views_and_budgets_give_the_same_plans():
    rng = np.random.default_rng(4)
    tracks = [straight(rng.uniform((20, -50), (110, 50)), rng.uniform(-9, 9, 2), 10 * i) for i in range(30)]
    one, other = (walk(movers_of(tracks), frames=25)[0] for _ in range(2))
    assert all(a[2].same_as(b[2]) for a, b in zip(one, other, strict=True))
    assert sum(len(plan.requests) for _, _, plan in one) > 20


def test_draws_stand_before_the_sky_and_in_what_fades():
    movers = movers_of([straight((40.0, 3.0), (0.0, 0.0))])

    class Fading(Still):
        def plan(self, *_, **__):
            return Plan((Objects("new", np.arange(3)), Sky()), fading=(Objects("old", np.arange(2)), Sky()), mix=0.5)

    plan = WithMovers(Fading(), movers, CAMERA).plan(look(), now=0.0, budget=Budget())
    assert [type(draw) for draw in plan.draws] == [type(draw) for draw in plan.fading] == [Objects, Moving, Sky]


def test_without_rules_all_are_geometry_and_at_a_time_they_stand():
    movers = movers_of([straight((40.0, 3.0), (1.0, 0.0))], mesh=block())
    technique = WithMovers(Still(), movers, CAMERA, at=2.0)
    for now in (0.0, 7.0):
        (draw,) = [draw for draw in technique.plan(look(), now=now, budget=Budget()).draws if isinstance(draw, Moving)]
        assert draw.poses[0, 0, 3] == 42.0
    assert technique.tally[:4] == (2, 2, 0, 0)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"limit_px": 0.0}, "limit_px: 0.01 to 100 expected, found 0.0"),
        ({"limit_px": math.nan}, "limit_px"),
        ({"calculation": "best"}, "calculation: one of predictive, common expected, found 'best'"),
        ({"least_frames": 0}, "least_frames: 1 to 1000 expected"),
        ({"nearest": -1.0}, "nearest"),
        ({"coarsest": 0.5}, "coarsest"),
        ({"largest": 100}, "largest: one of 64, 128, 256, 512 expected, found 100"),
    ],
)
def test_rules_without_meaning_are_refused(change, said):
    with pytest.raises(ParameterError, match=said):
        FrameRules(**change)
