"""Techniques decide without OpenGL: plans are data, and the same walk gives the same ones."""

import itertools

import numpy as np
import pytest
from techniques_drawn import OF_DATASETS

from mmi.foundation.camera import level_view
from mmi.foundation.errors import DatasetError, ParameterError
from mmi.foundation.plug_ins import plug_in
from viewer.plan import Budget, CellKey, CellLayers, Faces, Ground, Objects, Plan, Sky
from viewer.scene.follower import Follower
from viewer.scene.scene import open_scene
from viewer.techniques.catalogue import MAIN, REFERENCE, TECHNIQUES, find_technique, make_technique
from viewer.techniques.geometry import FullGeometry
from viewer.techniques.layered import LayeredImpostors

BUDGET = Budget()


def look(scene, x, y=0.0, azimuth=0.0):
    camera = scene.camera
    return level_view(np.array([x, y, 1.7]), azimuth, focal=camera.focal, window=camera.window)


def walk(technique, scene, xs):
    return [technique.plan(look(scene, x), now=0.1 * i, budget=BUDGET) for i, x in enumerate(xs)]


def objects(plan):
    return next(draw for draw in plan.draws if isinstance(draw, Objects)).objects


@pytest.fixture
def scenes(scene, single):
    return {"multi-mesh": scene, "single-mesh": single}


@pytest.mark.parametrize("name", OF_DATASETS)
def test_every_technique_draws_objects_ground_and_sky_last(scenes, scene, name):
    technique = make_technique(name, scenes)
    assert technique.name == name
    plan = technique.plan(look(scene, 20.0), now=0.0, budget=BUDGET)
    assert isinstance(plan.draws[0], Faces if name == "image-cache" else Objects)
    assert isinstance(plan.draws[-2], Ground)
    assert isinstance(plan.draws[-1], Sky)
    assert plan.mix == 1.0


def test_what_geometry_techniques_draw(scenes, scene, dataset):
    plans = {name: make_technique(name, scenes).plan(look(scene, 50.0), now=0.0, budget=BUDGET) for name in OF_DATASETS}
    entry = dataset.cell("0001-01")
    index = dataset.city().index()
    assert objects(plans["full"]).tolist() == list(range(16))
    assert plans["full"].cells == plans["visible"].cells == plans["local"].cells == ()
    assert objects(plans["visible"]).tolist() == sorted(index[one] for one in entry.near + entry.far)
    for name in ("local", "multi-mesh", "single-mesh"):
        assert objects(plans[name]).tolist() == sorted(index[one] for one in entry.near)
        assert plans[name].place == "0001-01"


def test_layers_are_those_of_the_cell_that_the_view_may_show_nearest_first(scenes, scene, dataset):
    entry = dataset.cell("0001-01")
    depth = {one.name: one.depth[0] for sector in entry.layers for one in sector}
    seen = set()
    for azimuth in np.linspace(-3.1, 3.1, 24):
        plan = make_technique("multi-mesh", scenes).plan(look(scene, 50.0, 0.0, azimuth), now=0.0, budget=BUDGET)
        [layers] = [draw for draw in plan.draws if isinstance(draw, CellLayers)]
        assert plan.cells == (layers.cell,) == (CellKey("multi-mesh", "0001-01"),)
        assert [depth[name] for name in layers.names] == sorted(depth[name] for name in layers.names)
        assert len(layers.names) < len(depth)
        seen |= set(layers.names)
    assert seen == set(depth), "all layers are seen from somewhere"


def test_single_mesh_has_one_layer_a_sector(single):
    entry = single.dataset.cell("0001-01")
    assert {one.index for sector in entry.layers for one in sector} == {0}
    assert entry.promised_error_px is None


def test_neighbours_are_wanted_ahead_in_the_direction_of_walking(scenes, scene):
    east = walk(make_technique("multi-mesh", scenes), scene, np.arange(10.0, 60.0, 2.0))
    west = walk(make_technique("multi-mesh", scenes), scene, np.arange(60.0, 10.0, -2.0))
    assert east[-1].place == west[0].place
    assert east[-1].ahead[0].cell != west[3].ahead[0].cell
    assert all(plan.cells[0] not in plan.ahead for plan in east)


def test_the_same_walk_gives_the_same_plans(scenes, scene):
    xs = np.concatenate([np.arange(5.0, 140.0, 3.0), np.arange(140.0, 5.0, -3.0)])
    for name in OF_DATASETS:
        first, second = (walk(make_technique(name, scenes), scene, xs) for _ in range(2))
        assert all(a.same_as(b) for a, b in zip(first, second, strict=True))
    assert not first[0].same_as(first[len(first) // 2])


def test_wavering_at_a_border_changes_cells_once(scenes, scene):
    technique = make_technique("multi-mesh", scenes)
    plans = walk(technique, scene, [37.0, 37.4, 37.6, 37.4, 37.6, 37.3, 37.8, 38.2, 37.8, 37.4, 37.6])
    changes = sum(a.place != b.place for a, b in itertools.pairwise(plans))
    assert changes == 1


def test_a_cell_fades_into_the_next(scene):
    technique = LayeredImpostors(scene, fade=0.5)
    plans = walk(technique, scene, np.arange(30.0, 45.0, 1.0))
    entered = next(i for i, plan in enumerate(plans) if plan.place != plans[0].place)
    assert plans[entered - 1].mix == 1.0
    assert [plan.mix for plan in plans[entered : entered + 6]] == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
    fading = plans[entered + 2]
    assert {key.cell for key in fading.cells} == {plans[0].place, plans[entered].place}, "both are in memory"
    assert objects(Plan(fading.fading)).tolist() == objects(plans[0]).tolist()
    assert plans[entered + 5].fading == ()
    assert len(plans[entered + 5].cells) == 1


def test_a_jump_is_no_walk_and_does_not_fade(scene):
    technique = LayeredImpostors(scene, fade=0.5)
    walk(technique, scene, [30.0, 31.0])
    plan = technique.plan(look(scene, 120.0), now=0.3, budget=BUDGET)
    assert plan.mix == 1.0
    follower = Follower(scene)
    steps = [follower.move(np.array([x, 0.0, 1.7])) for x in (10.0, 12.0, 100.0, 101.0)]
    assert [step.jumped for step in steps] == [True, False, True, False]
    assert [step.entered for step in steps] == [True, False, True, False]


def test_ground_is_drawn_as_far_as_it_is_more_than_a_line(scene):
    """Tiles beyond eye height times focal length are left out, those near the viewer never are."""
    low, high = scene.tiles[:, 0].min(axis=0), scene.tiles[:, 1].max(axis=0)
    near = scene.ground_in(look(scene, 0.0))
    inside = [i for i, ((x0, y0, _), (x1, y1, _)) in enumerate(scene.tiles) if x0 < 10.0 < x1 and y0 < 0.0 < y1]
    assert set(inside) & set(near.tiles)
    far = 1.7 * scene.camera.focal + 5.0
    assert scene.ground_in(look(scene, low[0] - far, 0.5 * (low[1] + high[1]))).tiles == ()


def test_unknown_techniques_and_foreign_cities_are_refused(scenes, scene, tmp_path):
    with pytest.raises(ParameterError, match="multi-mesh"):
        make_technique("magic", scenes)
    from cities import two_blocks

    from mmi.building.dataset import build_dataset
    from mmi.dataset.reading import open_dataset

    build_dataset(two_blocks(), tmp_path / "other")
    with pytest.raises(DatasetError, match="another"):
        open_scene(open_dataset(tmp_path / "other"), name="single-mesh", like=scene)


def everything_and_nothing(scene):
    """A technique of one's own: it draws what ``full`` draws."""
    return FullGeometry(scene)


def no_technique(scene):  # noqa: ARG001
    return "a picture"


def test_the_table_has_names_that_are_keys_and_scenes_that_are_names():
    assert [entry.name for entry in TECHNIQUES.values()] == list(TECHNIQUES)
    assert {name for name, entry in TECHNIQUES.items() if entry.layered} == {
        "single-mesh",
        "multi-mesh",
        "multi-mesh-dynamic",
    }
    assert TECHNIQUES["single-mesh"].scene == "single-mesh"
    assert {entry.scene for name, entry in TECHNIQUES.items() if name != "single-mesh"} == {MAIN}
    assert not TECHNIQUES[REFERENCE].layered


def test_a_technique_of_ones_own_is_a_function_of_the_scene(scenes, scene):
    entries = [find_technique(one) for one in (everything_and_nothing, f"{__name__}:everything_and_nothing")]
    assert entries[0].origin == entries[1].origin
    assert entries[0].name == f"{__name__}:everything_and_nothing"
    named = find_technique(plug_in(everything_and_nothing, name="mine", version="3"))
    assert (named.name, named.origin.version) == ("mine", "3")
    view = look(scene, 20.0)
    for entry in (*entries, named):
        plan = make_technique(entry, scenes).plan(view, now=0.0, budget=BUDGET)
        assert plan.same_as(make_technique("full", scenes).plan(view, now=0.0, budget=BUDGET))


class _Planning:
    """A technique whose plan is what ``make`` gives, or fails as ``make`` does."""

    name = "own"

    def __init__(self, make):
        self.make = make

    def plan(self, view, *, now, budget):  # noqa: ARG002
        return self.make()


def fails(_scene):
    raise RuntimeError("no such luck\nin two lines")


def leaves(_scene):
    raise SystemExit(7)


def plans_a_number(_scene):
    return _Planning(lambda: 7)


def fails_to_plan(_scene):
    return _Planning(lambda: {}["a row"])


@pytest.mark.parametrize(
    ("own", "message"),
    [
        (fails, "fails: RuntimeError: no such luck$"),
        (leaves, "leaves: SystemExit: 7$"),
        (plans_a_number, "plans_a_number: a Plan expected of it, found a value of type int$"),
        (fails_to_plan, "fails_to_plan: KeyError: 'a row'$"),
    ],
)
def test_mistakes_of_a_technique_of_ones_own_are_told_as_such(scenes, scene, own, message):
    with pytest.raises(ParameterError, match=rf"^technique {__name__}:{message}"):
        make_technique(own, scenes).plan(look(scene, 20.0), now=0.0, budget=BUDGET)


def test_what_is_no_technique_of_ones_own_is_refused(scenes):
    with pytest.raises(ParameterError, match="found a lambda"):
        find_technique(lambda scene: FullGeometry(scene))
    with pytest.raises(ParameterError, match="which has a method plan, expected from it, found a value of type str"):
        make_technique(no_technique, scenes)
    with pytest.raises(ParameterError, match="no other technique has expected, found 'full'"):
        find_technique(plug_in(everything_and_nothing, name="full"))
    with pytest.raises(ParameterError, match="nowhere that can be imported"):
        find_technique("nowhere:technique")
