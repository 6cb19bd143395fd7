"""A small dataset for all tests of the viewer, built once: the crossroads, five cells a street, for a small display.

Drawing and comparing take as long as there are pixels. Half the pixels a side and half the error that is allowed are the same
angle, and so the same layers, as the defaults.
"""

import math
from dataclasses import replace

import pytest
from cities import crossroads

from mmi.building.dataset import build_dataset
from mmi.dataset.reading import open_dataset
from mmi.foundation.camera import Camera
from mmi.planning.parameters import BuildParameters
from viewer.scene.scene import open_scene

CAMERA = Camera(256, 256, math.radians(60.0))
PARAMETERS = BuildParameters(max_error_px=5.0, camera=CAMERA, near_distance=30.0, longest_object=None)


@pytest.fixture(scope="session")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("viewer") / "crossroads"
    build_dataset(crossroads(), folder, PARAMETERS)
    return open_dataset(folder)


@pytest.fixture(scope="session")
def scene(dataset):
    return open_scene(dataset, name="multi-mesh")


@pytest.fixture(scope="session")
def single(tmp_path_factory, scene):
    folder = tmp_path_factory.mktemp("viewer") / "single"
    build_dataset(crossroads(), folder, replace(PARAMETERS, layering="single"))
    return open_scene(open_dataset(folder), name="single-mesh", like=scene)
