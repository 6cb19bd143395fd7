"""Sessions: the pictures are the renderer's own, walks, what is due, freezing, and what is outside of the cells."""

import math
import time
from dataclasses import replace

import numpy as np
import pytest

from mmi.foundation.errors import ParameterError
from mmi.walks.walk import Pose, read_walk, walk_from, write_walk
from viewer.drawing.style import PLAIN
from viewer.plan import Budget, Plan
from viewer.techniques.catalogue import make_technique
from viewer.window.commands import GoTo, Held, PutAt, WalkCommand
from viewer.window.stage import window_camera

STEP = 0.05


class Clock:
    """The time of frames."""

    def __init__(self):
        self.now = 100.0

    def frame(self, session, look=None, **changes):
        self.now += STEP
        mail = replace(session.mail, turned=(0.0, 0.0), put=None)
        if look is not None:
            changes["look"] = replace(mail.look, **look)
        return session.frame(replace(mail, **changes), self.now)


@pytest.fixture
def clock():
    return Clock()


def own(session, name, pose, size, *, columns=None, measured=False):
    """The renderer's own picture of a technique that knows of no viewer yet."""
    stage = session.stage
    camera = window_camera(stage.main.camera, size)
    view = pose.view(camera)
    plan = make_technique(name, stage.scenes).plan(view, now=0.0, budget=Budget())
    stage.cells.want(plan.cells)
    stage.cells.require(plan.cells)
    stage.renderer.resize(size)
    return stage.renderer.draw(Plan(plan.draws), view, measured=measured, columns=columns, style=PLAIN)


def posed(session):
    return session.walker.pose


@pytest.mark.parametrize("name", ["full", "visible", "local", "multi-mesh"])
@pytest.mark.parametrize("size", [(160, 96), (97, 133)])
def test_a_frame_is_the_renderers_own_picture(session, clock, name, size):
    """Pixel for pixel, wherever the viewer walked before."""
    for _ in range(3):
        clock.frame(session, {"right": name}, size=size, held=Held(forward=1.0, turn=0.3))
    shown = clock.frame(session)
    assert shown.picture.shape == (size[1], size[0], 3)
    assert shown.picture.flags.c_contiguous
    assert not shown.picture.flags.writeable
    assert np.array_equal(shown.picture, own(session, name, posed(session), size).color)
    assert shown.header["pose"] == [*posed(session).eye, posed(session).azimuth, posed(session).pitch]


def test_panels_are_parts_of_the_renderers_own_pictures(session, clock):
    size = session.mail.size
    shown = clock.frame(session, {"mode": "swipe", "swipe": 0.3}).picture
    left, right = (own(session, name, posed(session), size).color for name in ("full", "multi-mesh"))
    assert np.array_equal(shown[:, :48], left[:, :48])
    assert np.array_equal(shown[:, 48:], right[:, 48:])
    shown = clock.frame(session, {"mode": "side", "left": "local"}).picture
    half = (size[0] // 2, size[1])
    left, right = (own(session, name, posed(session), half).color for name in ("local", "multi-mesh"))
    assert not np.array_equal(left, right)
    assert np.array_equal(shown, np.hstack([left, right]))


def test_the_height_of_a_window_is_the_displays_angle(stage):
    camera = stage.main.camera
    assert window_camera(camera, (camera.width, camera.height)) == camera
    wide = window_camera(camera, (2 * camera.width, camera.height))
    assert wide.focal == pytest.approx(camera.focal)
    assert window_camera(camera, (300, 512)).focal == pytest.approx(2.0 * camera.focal)


def test_equal_techniques_do_not_differ_and_others_do(session, clock):
    same = clock.frame(session, {"mode": "difference", "left": "full", "right": "full"}).picture
    assert (same == same[0, 0]).all()
    other = clock.frame(session, {"right": "local"}).picture
    assert (other != same).any()


def test_wrong_surfaces_are_those_of_the_geometry(session, clock):
    right = clock.frame(session, {"mode": "wrong", "right": "visible"}).picture
    wrong = clock.frame(session, {"right": "local", "threshold_px": 0.0}).picture
    truth = own(session, "full", posed(session), session.mail.size, measured=True)
    shown = own(session, "local", posed(session), session.mail.size, measured=True)
    differs = truth.object_ids != shown.object_ids
    colourful = np.ptp(wrong.astype(int), axis=2) > 20
    assert differs.any()
    assert np.array_equal(colourful, differs)
    assert (np.ptp(right.astype(int), axis=2) <= 20).mean() > 0.95


def test_depth_and_objects_are_measured(session, clock):
    ids = own(session, "multi-mesh", posed(session), session.mail.size, measured=True).object_ids
    clock.frame(session)
    objects = clock.frame(session, {"show": "objects"}).picture
    for one in np.unique(ids):
        colours = objects[ids == one]
        assert (colours == colours[0]).all()
    depth = clock.frame(session, {"show": "depth"}).picture
    assert len(np.unique(depth.reshape(-1, 3), axis=0)) > 20


def test_layers_are_tinted_and_shown_alone(session, clock):
    plain = clock.frame(session).picture
    tinted = clock.frame(session, {"show": "layers"}).picture
    assert (tinted != plain).any()
    ids = own(session, "multi-mesh", posed(session), session.mail.size, measured=True)
    geometry = np.isnan(ids.displacement)
    assert np.array_equal(tinted[geometry], plain[geometry])
    one = clock.frame(session, {"show": "picture", "layer": 999}).picture
    nothing = own(session, "multi-mesh", posed(session), session.mail.size)
    assert (one != nothing.color).any()
    lines = clock.frame(session, {"layer": None, "wireframe": True}).picture
    assert (lines != plain).any()


def test_an_idle_session_is_not_due(session, clock):
    assert session.due(clock.now)
    shown = [clock.frame(session)]
    while session.due(clock.now):
        shown.append(clock.frame(session))
        assert len(shown) < 10
    assert shown[-1].header["still"]
    assert not shown[0].header["still"]
    assert session.due_at(clock.now) is None
    clock.frame(session, held=Held(forward=1.0))
    assert session.due(clock.now)
    clock.frame(session, held=Held())
    while session.due(clock.now):
        last = clock.frame(session)
    assert last.header["still"]


def test_blinking_is_due_at_a_time(session, clock):
    for _ in range(8):
        clock.frame(session, {"mode": "blink"})
    at = session.due_at(clock.now)
    assert clock.now < at <= clock.now + 0.5
    clock.now = at
    names = {clock.frame(session).header["views"][0]["technique"]}
    clock.now += 0.6
    names.add(clock.frame(session).header["views"][0]["technique"])
    assert names == {"full", "multi-mesh"}


def test_time_that_nobody_looked_at_does_not_move_the_viewer(session, clock):
    while session.due(clock.now):
        clock.frame(session)
    before = posed(session)
    clock.now += 1000.0
    clock.frame(session, held=Held(forward=1.0))
    assert math.dist(posed(session).eye, before.eye) < 0.2


def test_go_and_put(session, clock, stage):
    shown = clock.frame(session, put=GoTo((1000.0, 3.0)))
    cells = stage.main.whereabouts
    assert shown.header["inside"]
    assert cells.distances(np.array(posed(session).eye)).min() == 0.0
    pose = Pose((1.0, 0.5, 1.7), 2.0, 0.25)
    clock.frame(session, put=PutAt(pose))
    assert posed(session) == pose
    assert clock.frame(session).header["pose"][3:] == [2.0, 0.25]


def test_outside_of_the_cells_all_is_geometry_and_it_says_so(session, clock):
    high = Pose((0.0, 0.0, 60.0), 0.5, -0.5)
    shown = clock.frame(session, {"fly": True}, put=PutAt(high))
    assert not shown.header["inside"]
    assert shown.header["views"][0]["technique"] == "multi-mesh"
    assert shown.header["views"][0]["stored"] == 0
    assert np.array_equal(shown.picture, own(session, "full", high, session.mail.size).color)


def test_freezing_holds_the_plan_while_the_camera_flies(session, clock):
    clock.frame(session)
    pose = posed(session)
    whole = own(session, "multi-mesh", pose, session.mail.size).color
    assert np.array_equal(clock.frame(session, {"freeze": True}).picture, whole)
    away = Pose((pose.eye[0] - 20.0, pose.eye[1], 30.0), pose.azimuth, -0.4)
    frozen = clock.frame(session, put=PutAt(away))
    assert frozen.header["frozen"]
    assert frozen.header["inside"]
    assert frozen.header["views"][0]["stored"] > 0
    assert (frozen.picture != own(session, "full", away, session.mail.size).color).any()
    assert np.array_equal(
        clock.frame(session, {"right": "full"}).picture, own(session, "full", away, session.mail.size).color
    )
    clock.frame(session, {"right": "multi-mesh", "freeze": False})
    assert posed(session) == pose


def test_a_recorded_walk_can_be_read_and_played(session, clock, tmp_path):
    clock.frame(session)
    session.command(WalkCommand("record"))
    path = []
    for i in range(40):
        path.append(posed(session))
        clock.frame(session, held=Held(forward=1.0, turn=0.5 if i > 20 else 0.0))
    shown = session.last
    assert shown.header["recording"]
    clock.frame(session, held=Held(), put=GoTo((50.0, 0.0)))
    reply = session.command(WalkCommand("stop"))
    walk = walk_from(reply["walk"])
    write_walk(walk, tmp_path / "walk.json")
    assert read_walk(tmp_path / "walk.json") == walk
    assert sum(keyframe.cut for keyframe in walk.keyframes) == 1
    assert walk.seconds == pytest.approx(41 * STEP, abs=2.0 * STEP)
    for k, pose in enumerate(path):
        assert math.dist(walk.pose(k * STEP).eye, pose.eye) < 0.1
    session.command(WalkCommand("replay"))
    assert posed(session) == walk.pose(0.0)
    shown = clock.frame(session)
    assert shown.header["playing"] == "walk"
    while session.playing is not None:
        clock.frame(session)
    assert math.dist(posed(session).eye, walk.keyframes[-1].pose.eye) < 1e-9


def test_stop_without_a_walk_and_replay_without_one(session, clock):
    clock.frame(session)
    assert session.command(WalkCommand("stop")) == {"type": "walk", "walk": None}
    with pytest.raises(ParameterError, match="walk to replay"):
        session.command(WalkCommand("replay"))


def test_a_tour_plays_until_somebody_moves(session, clock):
    clock.frame(session)
    session.command(WalkCommand("tour"))
    first = clock.frame(session)
    assert first.header["playing"] == "tour"
    assert first.header["inside"]
    before = posed(session)
    assert session.due(clock.now)
    clock.frame(session)
    assert 0.0 < math.dist(posed(session).eye, before.eye) < 1.0
    assert clock.frame(session, held=Held(forward=1.0)).header["playing"] is None


def test_updates_are_counted_and_the_budget_is_kept_to(session, clock):
    none = {"stored": 0, "captured": 0, "reused": 0}
    shown = clock.frame(session, {"right": "multi-mesh-dynamic", "budget_ms": 0.0}).header["views"][0]
    assert shown["captured"] == 0
    assert shown["stored"] > 0
    found = dict(none)
    for _ in range(12):
        shown = clock.frame(session, {"budget_ms": 1000.0}).header["views"][0]
        found = {name: found[name] + shown[name] for name in found}
    assert found["captured"] > 0
    assert shown["memory_mb"] > 0.0
    owner = "somebody multi-mesh-dynamic"
    assert session.stage.renderer.image_bytes(owner) > 0
    session.close()
    assert session.stage.renderer.image_bytes(owner) == 0


def test_what_was_measured_at_a_column(session, clock):
    clock.frame(session, {"mode": "side", "left": "full"})
    width = session.mail.size[0]
    frame, view, column = session.measured_at(width - 1)
    assert column == width // 2 - 1
    assert view.window[2] == width // 2
    truth = own(session, "multi-mesh", posed(session), (width // 2, session.mail.size[1]), measured=True)
    assert np.array_equal(frame.picture.object_ids, truth.object_ids)
    with pytest.raises(ParameterError, match="column"):
        session.measured_at(width)
    assert len(session.pictures.drawn) == 2


def test_rays_are_prepared_in_the_background_and_then_cast(session, clock):
    """Meanwhile the geometry is shown, and in the end the same picture: all of it is near or cast."""
    look = {"right": "ray-cast", "budget_ms": None}
    first = clock.frame(session, look).header["views"][0]
    assert first["technique"] == "ray-cast"
    assert first["preparing"] or session.stage.prepared("ray-cast")
    deadline = time.monotonic() + 120.0
    while not session.stage.prepared("ray-cast") and time.monotonic() < deadline:
        time.sleep(0.05)
    shown = clock.frame(session, look)
    assert not shown.header["views"][0]["preparing"]
    full = own(session, "full", posed(session), session.mail.size).color
    off = np.abs(shown.picture.astype(int) - full).max(axis=2)
    assert (off > 60).mean() < 0.01
