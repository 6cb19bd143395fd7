"""Choices by name and functions of one's own: what is told of them, what is refused, and what a plan does with them."""

import json

import numpy as np
import pytest
from cities import block, cell_along_x, city_of

from mmi.foundation.errors import ParameterError
from mmi.planning.choices import LAYERINGS, NEAR_STAGES, WEIGHTS, choose, function_of
from mmi.planning.parameters import BuildParameters
from mmi.planning.plan import plan_cell, prepare_city
from mmi.planning.segmentation import near_stage_by_distance
from mmi.visibility.selection import Selection

__version__ = "3"
CITY = city_of(block("a", -10, 60, 10, 70, 9), block("b", -20, 120, 50, 130, 19), block("c", -90, 60, -70, 70, 9))


def all_apart(far):
    one, other = np.triu_indices(len(far.objects), 1)
    return np.column_stack([one, other]), np.ones(len(one))


def together(far):  # noqa: ARG001
    return [], []


def broken(far):
    return far.nothing


def one_too_few(far):  # noqa: ARG001
    return [(0, 1), (1, 2)], [0.5]


def out_of_range(far):  # noqa: ARG001
    return [(0, 7)], [0.5]


def twice(far):  # noqa: ARG001
    return [(0, 1), (1, 0)], [0.5, 0.5]


def negative(far):  # noqa: ARG001
    return [(0, 1)], [-0.5]


def each_alone(graph, boxes):
    assert boxes.shape == (len(graph), 4)
    return [[node] for node in graph]


def one_lost(graph, boxes):  # noqa: ARG001
    return [list(graph)[1:]]


def first_is_near(settings):
    before = near_stage_by_distance(settings)

    def extract(selection):
        near = before(selection)
        return Selection(near.city, near.cell, near.objects, np.append(near.near, 0), near.wall_visibility)

    return extract


def planned(**options):
    return plan_cell(prepare_city(CITY, BuildParameters(**options)), cell_along_x(40.0))


class TestTables:
    @pytest.mark.parametrize("table", [WEIGHTS, LAYERINGS, NEAR_STAGES])
    def test_every_entry_has_a_function(self, table):
        assert len({one.name for one in table}) == len(table)
        for one in table:
            assert choose(table, one.name, what="x") is one
            assert callable(function_of(one))
            assert one.near_stage in {stage.name for stage in NEAR_STAGES}

    def test_what_keeps_the_bound(self):
        bounded = {
            (weights.name, layering.name, stage)
            for weights in WEIGHTS
            for layering in LAYERINGS
            for stage in (None, *(one.name for one in NEAR_STAGES))
            if BuildParameters(weights=weights.name, layering=layering.name, near_stage=stage).bounded
        }
        layerings = {"best", "incremental", "largest-first", "smallest-last", "dsatur"}
        assert bounded == {("same-ray", layering, stage) for layering in layerings for stage in (None, "parallax")}

    def test_the_papers_weights_go_without_the_parallax_stage(self):
        assert planned(weights="critical-zone").selection.parallax is None
        assert planned().selection.parallax is not None
        assert planned(near_stage="distance").selection.parallax is None
        assert planned(weights="critical-zone", near_stage="parallax").selection.parallax is not None


class TestParameters:
    @pytest.mark.parametrize("of", [all_apart, "test_choices:all_apart"])
    def test_name_and_version_are_kept_and_nothing_is_promised(self, of):
        parameters = BuildParameters(weights=of)
        assert parameters.weights == "test_choices:all_apart@3"
        assert not parameters.bounded
        stored = json.loads(json.dumps(parameters.as_dict()))
        assert stored["weights"] == "test_choices:all_apart@3"
        assert BuildParameters.from_dict(stored) == parameters

    def test_layerings_and_near_stages_too(self):
        assert not BuildParameters(layering=each_alone).bounded
        parameters = BuildParameters(near_stage=first_is_near)
        assert not parameters.bounded
        assert parameters.as_dict()["near_stage"] == "test_choices:first_is_near@3"
        assert BuildParameters.from_dict(parameters.as_dict()) == parameters

    def test_those_of_built_in_choices_have_the_form_that_they_always_had(self):
        assert "near_stage" not in BuildParameters().as_dict()
        assert BuildParameters().as_dict()["weights"] == "same-ray"

    def test_stored_ones_are_read_where_the_function_is_not(self):
        stored = {**BuildParameters().as_dict(), "weights": "nowhere.to_be:found@1"}
        parameters = BuildParameters.from_dict(stored)
        assert parameters.weights == "nowhere.to_be:found@1"
        with pytest.raises(ParameterError, match=r"nowhere.to_be:found: a module nowhere.to_be that can be imported"):
            prepare_city(CITY, parameters)

    def test_another_version_than_was_chosen_is_refused(self):
        with pytest.raises(ParameterError, match="test_choices:all_apart: version 2 expected, found 3"):
            prepare_city(CITY, BuildParameters(weights="test_choices:all_apart@2"))

    @pytest.mark.parametrize("name", ["weights", "layering", "near_stage"])
    def test_unknown_names_and_what_others_cannot_import_are_refused(self, name):
        def inner(far):
            return far

        for of, text in (
            ("heavy", f"{name}: .* or package.module:function expected, found 'heavy'"),
            (lambda far: far, f"{name}: .*found a lambda"),
            (inner, f"{name}: .*found a function inside of a function"),
            ("nowhere.to_be:found", f"{name}: nowhere.to_be:found: a module"),
        ):
            with pytest.raises(ParameterError, match=text):
                BuildParameters(**{name: of})


class TestPlans:
    def test_a_weight_decides_on_layers(self):
        assert [layer.tolist() for layer in planned(weights=all_apart, near_stage="distance").layers] == [[0], [1], [2]]
        plan = planned(weights=together, near_stage="distance")
        assert [layer.tolist() for layer in plan.layers] == [[0, 1, 2]]
        assert plan.missed is None

    def test_a_layering_divides(self):
        plan = planned(layering=each_alone, near_stage="distance")
        assert [layer.tolist() for layer in plan.layers] == [[0], [1], [2]]

    def test_a_near_stage_makes_near(self):
        assert planned(near_stage=first_is_near).selection.near.tolist() == [0]

    @pytest.mark.parametrize(
        ("of", "text"),
        [
            (broken, "weights test_choices:broken: AttributeError: "),
            (one_too_few, "weights test_choices:one_too_few: one for each of 2 pairs expected, found shape"),
            (out_of_range, "two different numbers from 0 to 2 expected"),
            (twice, "each pair once"),
            (negative, "0 or more expected, found -0.5"),
        ],
    )
    def test_nonsense_of_a_weight_is_refused(self, of, text):
        with pytest.raises(ParameterError, match=text):
            planned(weights=of, near_stage="distance")

    def test_a_layering_that_loses_an_object_is_refused(self):
        with pytest.raises(ParameterError, match="each of 3 objects in one layer expected, found 2 in 1 layers"):
            planned(layering=one_lost, near_stage="distance")
