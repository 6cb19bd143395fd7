"""A cell promises its bound only where all that it shows is checked, and says in words what is not."""

from dataclasses import replace

import pytest
from cities import crossroads
from model_cities import open_box

from mmi.building.cell import _promise, build_cell
from mmi.building.dataset import build_dataset
from mmi.capture.renderer import Capturer
from mmi.cells.viewing_cells import viewing_cells
from mmi.dataset.reading import open_dataset
from mmi.foundation.camera import Camera
from mmi.planning.parameters import BuildParameters
from mmi.planning.plan import plan_cell, prepare_city

PARAMETERS = BuildParameters(near_distance=30.0, camera=Camera(128, 128, 1.0), cell_length=80.0)


@pytest.fixture(scope="module")
def made():
    """A prepared city, the plan of one of its cells, and the impostor."""
    prepared = prepare_city(crossroads(), PARAMETERS)
    graph = viewing_cells(prepared.city, max_length=PARAMETERS.cell_length, eye=PARAMETERS.eye)
    cell = graph.nodes[sorted(graph)[0]]["cell"]
    with Capturer(prepared.mesh) as capturer:
        return prepared, plan_cell(prepared, cell), build_cell(prepared, cell, capturer)


def test_the_threshold_is_promised_where_all_is_checked(made):
    prepared, plan, impostor = made
    promise = _promise(prepared, plan, impostor.layers)
    assert promise == impostor.promise
    assert (promise.error_px, promise.withheld) == (PARAMETERS.max_error_px, None)
    assert promise.displacement_px <= PARAMETERS.max_error_px


def test_a_mesh_that_displaces_more_takes_the_promise_back(made):
    prepared, plan, impostor = made
    too_far = PARAMETERS.camera.angle_from_pixels(1.5 * PARAMETERS.max_error_px)
    first, *others = impostor.layers
    promise = _promise(prepared, plan, (replace(first, displacement=too_far), *others))
    assert promise.error_px is None
    assert promise.withheld == "a mesh may displace what it shows by 15.0 px, 10 px were asked for"
    assert promise.displacement_px == pytest.approx(15.0)


def test_a_region_that_layers_miss_takes_it_back(made):
    prepared, plan, impostor = made
    promise = _promise(prepared, replace(plan, missed=12.34), impostor.layers)
    assert promise.withheld == "layers miss a region 12.3 px thick, 10 px were asked for"


@pytest.mark.parametrize("choice", [{"weights": "critical-zone"}, {"layering": "single"}])
def test_choices_that_keep_no_bound_promise_none(made, choice):
    prepared, plan, impostor = made
    other = replace(prepared, parameters=replace(PARAMETERS, **choice))
    promise = _promise(other, replace(plan, missed=None), impostor.layers)
    assert promise.error_px is None
    assert promise.withheld.endswith("keep no bound")


def test_detailed_meshes_in_sight_are_not_bounded(made):
    prepared, plan, impostor = made
    seen = int(plan.selection.objects[0])
    objects = list(prepared.city.objects)
    objects[seen] = replace(objects[seen], mesh=open_box())
    selection = replace(plan.selection, city=replace(prepared.city, objects=tuple(objects)))
    promise = _promise(prepared, replace(plan, selection=selection), impostor.layers)
    assert promise.error_px is None
    assert promise.withheld == (
        "detailed meshes are in sight: what layers miss is measured from 16 viewpoints, not bounded"
    )


def test_the_summary_counts_what_is_withheld_and_what_is_removed(tmp_path):
    out = tmp_path / "out"
    first = build_dataset(crossroads(), out, PARAMETERS, max_cells=3)
    assert (first.withheld, first.removed) == ({}, 0)
    again = build_dataset(crossroads(), out, replace(PARAMETERS, layering="single"), max_cells=1)
    assert again.removed == 2, "two cells of other options were not asked for again"
    (cell,) = open_dataset(out).manifest.cells
    assert again.withheld == {cell.id: cell.promise_withheld} and cell.promised_error_px is None
