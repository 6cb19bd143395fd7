"""What a frame costs is arithmetic that can be done by hand."""

import math

import pytest

from mmi.foundation.errors import ParameterError
from mmi.planning.frame_costs import MOST, FrameCosts, FrameLoad
from mmi.planning.parameters import BuildParameters


def test_a_frame_costs_its_triangles_and_what_the_rest_is_worth():
    load = FrameLoad(triangles=1000, draws=2, texels=500_000, bytes=150_000)
    assert load.cost(FrameCosts(draw=50.0, kilotexel=0.2, kilobyte=3.0)) == 1000 + 2 * 50 + 500 * 0.2 + 150 * 3
    assert load.cost(FrameCosts(0.0, 0.0, 0.0)) == 1000
    assert FrameLoad(10, 1).cost(FrameCosts(draw=7.0)) == 17.0
    assert math.isfinite(FrameLoad(2**53, 2, 2**53, 2**53).cost(FrameCosts(MOST, MOST, MOST)))


@pytest.mark.parametrize("wrong", [-1.0, math.nan, math.inf, 2e12, 10**400, "1", True, None])
@pytest.mark.parametrize("name", ["draw", "kilotexel", "kilobyte"])
def test_costs_are_numbers_of_triangles(name, wrong):
    with pytest.raises(ParameterError, match=f"for a {name} expected, found"):
        FrameCosts(**{name: wrong})


def test_parameters_carry_costs_through_json():
    parameters = BuildParameters(geometry="cheaper", costs=FrameCosts(1.0, 2, 3.5))
    document = parameters.as_dict()
    assert document["costs"] == {"draw": 1.0, "kilotexel": 2.0, "kilobyte": 3.5}
    assert BuildParameters.from_dict(document) == parameters


@pytest.mark.parametrize(
    "costs", [None, 3, {"draw": 1.0, "pixel": 1.0}, {"draw": 1.0, "kilotexel": -1.0, "kilobyte": 0.0}]
)
def test_stored_costs_that_are_none_are_refused(costs):
    document = BuildParameters().as_dict() | {"costs": costs}
    with pytest.raises(ParameterError):
        BuildParameters.from_dict(document)
