"""What a build is told is checked where the value is made, kinds of values too."""

import json

import numpy as np
import pytest

from mmi.foundation.errors import ParameterError
from mmi.planning.parameters import BuildParameters


@pytest.mark.parametrize(
    "values",
    [
        {"max_layers": True}, {"max_triangles": 2.0}, {"sectors": "8"}, {"sectors": 8.0}, {"quad": np.int64(16)},
        {"max_error_px": "5"}, {"max_error_px": float("nan")}, {"cell_length": None}, {"near_distance": True},
        {"landmarks": 5}, {"landmarks": (("a",),)}, {"eye": (1,)}, {"camera": None}, {"weights": None}, {"layering": 3},
        {"longest_object": "40"},
    ],
    ids=str,
)  # fmt: skip
def test_values_of_another_kind_are_refused(values):
    with pytest.raises(ParameterError):
        BuildParameters(**values)


def test_numbers_of_numpy_become_pythons():
    parameters = BuildParameters(max_error_px=np.float32(9.0), cell_length=np.int64(30))
    assert json.loads(json.dumps(parameters.as_dict()))["max_error_px"] == 9.0
    assert type(parameters.cell_length) is float
