"""What stands at a pixel: against the geometry, the manifest and the plan; and what is said where there is no answer."""

import io
import json
import math
import shutil
import time
from dataclasses import replace

import numpy as np
import pytest
from cities import block, cell_along_x, city_of, crossroads
from manifests import sign_again
from moving import movers_of

from mmi.building.dataset import build_dataset
from mmi.dataset.reading import Dataset, open_dataset
from mmi.foundation.camera import Camera, level_view
from mmi.foundation.errors import ParameterError
from mmi.planning.parameters import BuildParameters
from mmi.planning.plan import plan_cell, prepare_city
from viewer.cells.loaded_cell import load_cell
from viewer.drawing.renderer import Renderer
from viewer.plan import CellKey, CellLayers, Objects, Plan, Sky
from viewer.scene.scene import open_scene
from viewer.window.answers.explaining import explanation
from viewer.window.answers.picking import Picker, Seen, seen_at
from viewer.window.answers.replanning import answer_questions

SIZE = (320, 240)
CELL = "0001-01"


@pytest.fixture(scope="module")
def picker(scene):
    made = Picker(scene)
    yield made
    made.close()


def of(scene, name, **fields):
    return Seen(
        **{"object_id": scene.objects[name], "point": (1.0, 2.0, 3.0), "distance": 9.0, "displaced_px": None, **fields}
    )


def plain(answer):
    """The answer after its trip to a page."""
    return json.loads(json.dumps(answer, allow_nan=False))


def test_what_is_seen_is_what_rays_meet(scene):
    """Also through an impostor: the object, and the point of it that the geometry has there."""
    place = scene.cell(CELL)
    view = level_view(place.cell.reference, 3.4, focal=277.0, window=(-160, -120, *SIZE))
    every = Plan((Objects("all", np.arange(len(scene.mesh.triangle_counts))), scene.ground_in(view), Sky()))
    layered = Plan(
        (
            Objects("near", place.near),
            CellLayers(CellKey("multi-mesh", CELL), place.layers),
            scene.ground_in(view),
            Sky(),
        )
    )
    with Renderer(scene.mesh, scene.ground, size=SIZE, measured=True) as renderer:
        renderer.upload(load_cell(scene, CELL, measured=True))
        truth, shown = (renderer.draw(plan, view, measured=True) for plan in (every, layered))
        unmeasured = renderer.draw(every, view)
    kinds = set()
    for x, y in np.random.default_rng(17).integers([0, 0], SIZE, (300, 2)).tolist():
        one, other = seen_at(truth, view, x, y), seen_at(shown, view, x, y)
        kinds.add((min(one.object_id, 0), other.displaced_px is None))
        assert one.object_id == truth.object_ids[y, x]
        assert one.displaced_px is None
        if one.object_id == -1:
            assert one.point is None and one.distance is None
            continue
        np.testing.assert_allclose(np.linalg.norm(np.array(one.point) - view.eye), one.distance)
        at = view.project(np.array([one.point]))[0]
        np.testing.assert_allclose(at, [x - 160 + 0.5, y - 120 + 0.5, truth.depth[y, x]], atol=1e-3)
        if one.object_id >= 0 and one.object_id == other.object_id:
            (low, high), texel = scene.boxes[one.object_id], 0.01 * one.distance
            assert (np.array(other.point) >= low - texel).all() and (np.array(other.point) <= high + texel).all()
    assert kinds >= {(0, True), (0, False), (-2, True), (-1, True)}
    with pytest.raises(ParameterError, match="a pixel of a picture of 320 x 240 expected, found 320, 0"):
        seen_at(truth, view, 320, 0)
    with pytest.raises(ValueError, match="measured"):
        seen_at(unmeasured, view, 0, 0)


def test_each_object_has_the_part_that_the_manifest_gives_it(scene, picker):
    entry = scene.dataset.cell(CELL)
    roles = set()
    for name, index in scene.objects.items():
        told = plain(picker.told(of(scene, name), CELL))
        roles.add(told["role"])
        assert (told["what"], told["id"], told["cell"]) == ("object", name, CELL)
        assert told["role"] == ("near" if name in entry.near else "far" if name in entry.far else "hidden")
        shown = {one.name for _, one in entry.pictures if name in [entry.far[i] for i in one.objects]}
        assert {picture for layer in told["layers"] for picture in layer["pictures"]} == shown
        for layer in told["layers"]:
            assert all(f".l{layer['layer']}" in picture for picture in layer["pictures"])
            assert {int(picture[1]) for picture in layer["pictures"]} == set(layer["sectors"])
        assert told["height_m"] == pytest.approx(crossroads().objects[index].height)
        assert told["triangles"] == scene.mesh.triangle_counts[index]
        assert told["attributes"] == {} and "made" in told["attributes_note"]
    assert {"near", "far"} <= roles
    assert picker.told(of(scene, "block/00"), None)["role"] == "none"


def test_sky_ground_and_what_moves_are_told_apart(scene, picker):
    assert picker.told(Seen(-1, None, None, None), CELL)["what"] == "sky"
    ground = picker.told(Seen(-2, (1.0, 2.0, 0.0), 5.0, None), None)
    assert (ground["what"], ground["distance_m"], ground["cell"]) == ("ground", 5.0, None)
    moving = replace(scene, movers=movers_of([[(0.0, 1.0, 2.0, 0.0, 0.0)], [(0.0, 5.0, 2.0, 0.0, 0.0)]]))
    seen = Seen(len(scene.objects) + 1, (1.0, 2.0, 0.0), 5.0, None)
    told = Picker(moving).told(seen, CELL)
    assert (told["what"], told["id"]) == ("mover", moving.movers.ids[1])
    assert picker.explained(Seen(-1, None, None, None), CELL).result(1.0)["what"] == "sky"


def test_only_ids_of_openstreetmap_have_a_link_there(scene):
    names = {"way/12": "way/12", "relation/3#4": "relation/3", "building/7": None, "way/12/x": None}
    picker = Picker(replace(scene, objects={name: i for i, name in enumerate(names)}))
    for name, expected in names.items():
        link = None if expected is None else f"https://www.openstreetmap.org/{expected}"
        assert picker.told(Seen(list(names).index(name), (0.0, 0.0, 0.0), 1.0, None), None)["link"] == link


def test_the_planner_explains_near_and_far_objects(scene, picker):
    """The whole way: a process of its own, which finds what the plan made here says."""
    entry = scene.dataset.cell(CELL)
    prepared = prepare_city(scene.dataset.city(), scene.parameters)
    plan = plan_cell(prepared, entry.viewing_cell)
    for name in (entry.near[0], entry.far[0], entry.far[-1]):
        answer = plain(picker.explained(of(scene, name), CELL, patience=120.0).result(120.0))
        expected = plain(explanation(prepared, plan, scene.objects[name]))
        assert answer["why"]["planned"]
        assert {key: answer[key] for key in expected} == expected
        assert answer["id"] == name


def test_who_clicks_is_answered_in_time(scene):
    picker = Picker(scene)
    try:
        start = time.monotonic()
        answer = picker.explained(of(scene, "block/00"), CELL, patience=0.01).result(5.0)
        assert time.monotonic() - start < 2.0
        assert answer["why"]["waiting"] and not answer["why"]["planned"]
        assert answer["role"] in ("near", "far", "hidden"), "what is known is told all the same"
    finally:
        start = time.monotonic()
        picker.close()
        assert time.monotonic() - start < 2.0


@pytest.fixture(scope="module")
def far_field():
    """Two houses that part, one that none can overlap, and one that is near; a landmark among them."""
    objects = (
        block("front", -10.0, 130.0, 10.0, 145.0, 12.0),
        block("back", -30.0, 260.0, 30.0, 280.0, 70.0),
        block("aside", -160.0, -300.0, -120.0, -260.0, 20.0),
        block("close", -10.0, -30.0, 10.0, -20.0, 9.0),
        block("hidden", -5.0, -33.0, 5.0, -31.0, 2.0),
    )
    prepared = prepare_city(city_of(*objects), BuildParameters(landmarks=(("back", 1.5),), max_error_px=10.0))
    return prepared, plan_cell(prepared, cell_along_x(20.0))


def test_weights_are_those_of_the_plan_heaviest_first(far_field):
    prepared, plan = far_field
    camera = prepared.parameters.camera
    front = plain(explanation(prepared, plan, 0))["why"]
    assert 0 in plan.selection.far and 1 in plan.selection.far
    own = {tuple(sorted(pair)): weight for pair, weight in zip(plan.pairs.tolist(), plan.weights.tolist(), strict=True)}
    (neighbour,) = [one for one in front["neighbours"] if one["id"] == "back"]
    assert neighbour["weight_px"] == pytest.approx(camera.pixels_from_angle(1.5 * own[0, 1]), abs=0.01)
    assert neighbour["apart"] == plan.graph.has_edge(0, 1)
    assert neighbour["apart"] == (neighbour["weight_px"] > 10.0)
    assert front["weighed"] == sum(0 in pair for pair in own)
    assert front["layer"] == next(i for i, members in enumerate(plan.layers) if 0 in members)
    heavy = [one["weight_px"] for one in front["neighbours"]]
    assert heavy == sorted(heavy, reverse=True)
    aside = explanation(prepared, plan, 2)["why"]
    assert aside["neighbours"] == [] and "0 far objects" in aside["answer"]


def test_near_and_hidden_objects_are_explained_in_words(far_field):
    prepared, plan = far_field
    close, hidden = (plain(explanation(prepared, plan, i)) for i in (3, 4))
    assert "it comes within 17.0 m of the cell, and up to 30 m is near" in close["why"]["answer"]
    assert close["why"]["reasons"][0]["found"] == pytest.approx(17.0)
    assert "Nothing of it can be seen from this cell" in hidden["why"]["answer"]
    assert hidden["kept"] == {
        "part_of": None,
        "base_m": 0.0,
        "top_m": 2.0,
        "height_m": 2.0,
        "footprint_m2": 20.0,
        "solids": 1,
        "detailed": False,
    }


def answers(path, *questions):
    found = io.StringIO()
    answer_questions(path, [json.dumps(question) for question in questions], found)
    return [json.loads(line) for line in found.getvalue().splitlines()]


def test_budgets_of_triangles_are_explained_from_the_stored_mesh(tmp_path):
    parameters = BuildParameters(camera=Camera(128, 128, math.radians(60.0)), near_triangles=200, longest_object=None)
    build_dataset(crossroads(), tmp_path / "out", parameters, max_cells=1)
    dataset = open_dataset(tmp_path / "out")
    entry = dataset.manifest.cells[0]
    index = dataset.city().index()
    prepared, *found = answers(
        dataset.path, {"prepare": True}, *({"cell": entry.id, "index": index[name]} for name in entry.near)
    )
    assert prepared == {}
    assert {reason["rule"] for one in found for reason in one["why"]["reasons"]} & {"budget", "slope", "parallax"}


def test_what_cannot_be_planned_again_is_answered_in_words(dataset, tmp_path):
    (found,) = answers(tmp_path / "nothing", {"cell": CELL, "index": 0})
    assert "folder of a dataset expected" in found["failed"]
    (found,) = answers(dataset.path, {"cell": "9999-99", "index": 0})
    assert "no cell '9999-99'" in found["failed"]


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"visibility": "item-buffer"}, "inspect-layers"),
        ({"weights": "test_choices:all_apart@1"}, "does not run"),
    ],
)
def test_what_the_viewer_does_not_do_is_said_at_once(scene, changed, expected):
    parameters = replace(scene.parameters, **changed)
    dataset = Dataset(scene.dataset.path, replace(scene.dataset.manifest, parameters=parameters))
    picker = Picker(replace(scene, built=dataset))
    picker.prepare()
    why = picker.explained(of(scene, "block/00"), CELL).result(1.0)["why"]
    assert not why["planned"] and expected in why["answer"]
    picker.close()


def test_a_plan_that_is_not_the_manifests_is_told(dataset, tmp_path):
    """Another version may plan otherwise: whoever asks is told, and shown no plan that was not built."""
    shutil.copytree(dataset.path, tmp_path / "other")
    first = dataset.manifest.cells[0]

    def fewer(document):
        document["cells"][0]["near"] = document["cells"][0]["near"][:-1]

    sign_again(tmp_path / "other", fewer)
    scene = open_scene(open_dataset(tmp_path / "other"), name="multi-mesh")
    picker = Picker(scene)
    answer = picker.explained(of(scene, first.near[-1]), first.id, patience=120.0).result(120.0)
    assert answer["role"] == "hidden"
    assert answer["why"]["answer"].startswith(
        "The cell cannot be planned again: manifest.json: the near objects of cell"
    )
    picker.close()
