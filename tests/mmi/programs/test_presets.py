"""A word stands for options, and options win over it."""

import math

import pytest

from mmi.foundation.camera import Camera
from mmi.planning.parameters import BuildParameters
from mmi.programs.build_impostors import _build_parser, _parameters
from mmi.programs.presets import PRESETS, too_coarse


def told(*options):
    return _parameters(_build_parser().parse_args(["city.osm", "-o", "out", *options]))


def test_without_a_word_it_is_the_paper_s_experiment():
    found, paper = told("--geometry", "near"), BuildParameters()
    assert found == paper


@pytest.mark.parametrize("preset", PRESETS, ids=lambda one: one.name)
def test_a_word_stands_for_a_display_an_error_and_budgets(preset):
    found = told("--for", preset.name)
    assert (found.camera.width, found.camera.height) == preset.display
    assert found.camera.fov == math.radians(60.0)
    assert (found.max_error_px, found.max_triangles) == (preset.max_error, preset.max_triangles)
    assert found.max_bytes == preset.max_bytes
    assert too_coarse(found) is None, "what we recommend is not pointed out"


def test_what_is_said_beside_it_wins():
    found = told("--for", "4k", "--max-error", "3", "--display", "640x480", "--fov", "90", "--max-bytes", "5")
    assert (found.max_error_px, found.camera, found.max_bytes) == (3.0, Camera(640, 480, math.radians(90.0)), 5)
    assert found.max_triangles == 500_000


@pytest.mark.parametrize(
    ("width", "fov", "error", "pixels"),
    [(512, 60.0, 10.0, 37.5), (1920, 60.0, 11.0, 11.0), (1920, 60.0, 10.0, None), (3840, 60.0, 18.0, None)],
)
def test_thresholds_are_told_in_pixels_of_a_common_display(width, fov, error, pixels):
    """Pixels of displays that see as wide are in proportion to their widths."""
    parameters = BuildParameters(max_error_px=error, camera=Camera(width, width, math.radians(fov)))
    text = too_coarse(parameters)
    assert (text is None) == (pixels is None)
    if pixels is not None:
        found = float(text.split("as wide as ")[1].split(" px")[0])
        assert found == pytest.approx(pixels, abs=0.01)
