"""Why objects are near: for each rule a city in which it alone holds; and every near object of a plan has reasons that hold."""

import math

import numpy as np
import pytest
import shapely
from cities import block, cell_along_x, city_of, crossroads

from mmi.cells.viewing_cells import ViewingCell
from mmi.foundation.camera import Camera
from mmi.parallax.critical_zone import cell_region
from mmi.planning.parameters import BuildParameters
from mmi.planning.plan import plan_cell, prepare_city
from mmi.planning.reasons import near_reasons
from mmi.planning.segmentation import near_by_triangles
from mmi.visibility.selection import everything

FAR = block("far", -40.0, 300.0, 40.0, 320.0, 12.0)


def planned(*objects, **options):
    prepared = prepare_city(city_of(*objects, FAR), BuildParameters(**options))
    return prepared, plan_cell(prepared, cell_along_x())


def test_what_is_close_is_near_by_its_distance():
    prepared, plan = planned(block("close", -10.0, 25.0, 10.0, 40.0, 9.0), weights="critical-zone")
    (reason,) = near_reasons(prepared, plan, 0)
    assert (reason.rule, reason.found, reason.limit) == ("distance", pytest.approx(22.0), 30.0)


def test_a_tower_is_near_by_its_slope():
    prepared, plan = planned(block("tower", -10.0, 43.0, 10.0, 60.0, 121.5), weights="critical-zone")
    (reason,) = near_reasons(prepared, plan, 0)
    assert (reason.rule, reason.found, reason.limit) == ("slope", pytest.approx(120.0 / 40.0), 2.0)


def test_what_touches_the_cell_has_no_slope_but_an_infinite_one():
    prepared, plan = planned(block("on it", -10.0, 2.0, 10.0, 40.0, 9.0), weights="critical-zone")
    by_distance, by_slope = near_reasons(prepared, plan, 0)
    assert (by_distance.rule, by_distance.found) == ("distance", 0.0)
    assert (by_slope.rule, by_slope.found) == ("slope", math.inf)


def test_the_nearest_objects_are_near_by_a_budget_of_triangles():
    prepared, plan = planned(block("close", -10.0, 25.0, 10.0, 40.0, 9.0), weights="critical-zone", near_triangles=12)
    (reason,) = near_reasons(prepared, plan, 0)
    assert (reason.rule, reason.limit) == ("budget", 12.0)
    assert reason.found == prepared.mesh.triangle_counts[0] <= 12


def test_far_objects_have_no_reason():
    prepared, plan = planned()
    with pytest.raises(ValueError, match=r"near object of cell 0000-00 expected, found 0"):
        near_reasons(prepared, plan, 0)


def test_a_near_stage_of_ones_own_is_named_and_not_second_guessed():
    prepared = prepare_city(city_of(FAR), BuildParameters(near_stage="test_choices:first_is_near"))
    (reason,) = near_reasons(prepared, plan_cell(prepared, cell_along_x()), 0)
    assert reason.rule == "own"


@pytest.mark.parametrize("budget", [None, 100])
def test_every_near_object_has_reasons_that_hold(budget):
    """Against the rules themselves, in the crossroads with a cell in the middle of a street and one at its end."""
    parameters = BuildParameters(
        camera=Camera(512, 512, math.radians(60.0)), near_distance=20.0, near_triangles=budget, longest_object=None
    )
    city = crossroads()
    prepared = prepare_city(city, parameters)
    seen = set()
    for p, q in (((20.0, 0.0), (60.0, 0.0)), ((0.0, 110.0), (0.0, 150.0))):
        cell = ViewingCell("0000-00", p, q, 3.0, (1.5, 1.9))
        plan = plan_cell(prepared, cell)
        distances = shapely.distance([one.footprint for one in city.objects], cell_region(cell))
        for index in plan.selection.near.tolist():
            reasons = {one.rule: one for one in near_reasons(prepared, plan, index)}
            seen |= set(reasons)
            limit = 20.0 if budget is None else 4.0
            assert ("distance" in reasons) == (distances[index] <= limit)
            assert ("slope" in reasons) == (city.objects[index].top - 1.5 > 2.0 * distances[index])
            if budget is not None:
                alone = near_by_triangles(budget, prepared.mesh.triangle_counts)
                start = prepared.visible(
                    type(plan.selection)(city, cell, np.arange(len(city.objects)), np.empty(0, int))
                )
                assert ("budget" in reasons) == (index in alone(start).near)
            if "parallax" in reasons:
                assert reasons["parallax"].found > reasons["parallax"].limit == parameters.max_angle
                assert not {"distance", "slope", "budget"} & set(reasons)
            if "layers" in reasons:
                assert set(reasons) == {"layers"}
    assert {"slope", "distance" if budget is None else "budget"} <= seen


def test_what_the_rehearsal_makes_near_says_so():
    """Narrow houses in a row, their common front just out of sight of the middle of the cell: each alone would do."""
    houses = [block(f"house/{i}", 60.0 + 4.0 * i, -6.0, 64.0 + 4.0 * i, 2.0 + i % 2, 9.0 + i % 3) for i in range(8)]
    prepared = prepare_city(city_of(*houses), BuildParameters(max_error_px=12.0))
    cell = ViewingCell("0000-00", (-20.0, -4.0), (20.0, -4.0), 6.0, (1.5, 1.9))
    plan = plan_cell(prepared, cell)
    before = prepared.near(prepared.visible(everything(prepared.city, cell)))
    demoted = np.setdiff1d(plan.selection.near, before.near)
    assert len(demoted)
    for index in demoted.tolist():
        assert [one.rule for one in near_reasons(prepared, plan, index)] == ["layers"]
