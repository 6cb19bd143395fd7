"""What a user says of placed images is checked, and pyramids around pitched views hold these."""

import math

import numpy as np
import pytest

from mmi.foundation.camera import Camera, view_towards
from mmi.foundation.errors import ParameterError
from viewer.placing.rules import Fov, FrameBudget, PlacingRules, fov_of

USUAL = Fov(0.577, 0.433)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"target": 0}, "target: from 1 triangle to the budget of 1,000 expected, found 0"),
        ({"target": 1001}, "target: from 1 triangle to the budget of 1,000 expected, found 1,001"),
        ({"depth": 0}, "depth: a number from 1 to 10 expected, found 0"),
        ({"benefit": math.nan}, "benefit: a number from 0 to 1 expected, found nan"),
        ({"look_ahead": 9}, "look_ahead: a number from 0 to 3 expected"),
        ({"margin": 0.0}, "margin: a number from 0.0872665 to 1.0472 expected, found 0.0"),
        ({"pitch": 1.2}, "pitch: views that stay below 87 degrees expected, found up to 92"),
        ({"fov": Fov(3.0, 0.5)}, "at most 140 degrees wide expected, found 143"),
    ],
)
def test_what_has_no_meaning(options, told):
    with pytest.raises(ParameterError, match=told):
        PlacingRules(**{"budget": 1000, "target": 500, "fov": USUAL} | options)


@pytest.mark.parametrize("bad", [0.1, 21.0, math.nan])
def test_a_view_is_neither_a_line_nor_all_round(bad):
    with pytest.raises(ParameterError, match="up: the tangent of half an angle of view"):
        Fov(1.0, bad)


@pytest.mark.parametrize("size", [(640, 480), (641, 479)])
def test_the_pyramid_of_a_display_is_that_of_its_window(size):
    camera = Camera(*size, math.radians(60.0))
    left, top, width, height = camera.window
    fov = fov_of(camera)
    assert fov.across == max(-left, left + width) / camera.focal
    assert fov.up == max(-top, top + height) / camera.focal


def test_the_pyramid_around_pitched_views_is_the_least_that_holds_them():
    camera = Camera(640, 480, math.radians(60.0))
    fov, most = fov_of(camera), 0.3
    around = fov.for_pitches(most)
    left, top, width, height = camera.window
    u, v = np.array([left, 0, left + width] * 2), np.array([top] * 3 + [top + height] * 3)
    slopes = []
    for pitch in np.linspace(-most, most, 13):
        view = view_towards(np.zeros(3), 0.0, pitch, focal=camera.focal, window=camera.window)
        rays = view.unproject(u, v, np.ones(6))
        slopes.append(np.abs(rays[:, 1:]) / rays[:, :1])
    found = np.max(slopes, axis=(0, 1))
    assert found == pytest.approx([around.across, around.up], rel=1e-9)
    assert fov.for_pitches(0.0).up == pytest.approx(fov.up)


def test_a_frame_leaves_the_triangles_that_it_has_time_for():
    frame = FrameBudget(ms=20.0, fixed=2.0, million=50.0, image=8.0)
    assert frame.triangles == 200_000
    assert frame.fixed + frame.image + frame.million * 1e-6 * frame.triangles <= frame.ms


@pytest.mark.parametrize(
    ("costs", "told"),
    [
        ({"ms": 10.0}, "ms: more than 10, as a frame with an image takes without triangles, expected, found 10"),
        ({"fixed": -1.0}, "fixed: 0 to 1000000 milliseconds expected, found -1.0"),
        ({"million": 0.0}, "million: 0.001 to "),
        ({"image": math.nan}, "image: 0 to "),
    ],
)
def test_frames_that_leave_none_have_no_meaning(costs, told):
    with pytest.raises(ParameterError, match=told):
        FrameBudget(**{"ms": 20.0, "fixed": 2.0, "million": 50.0, "image": 8.0} | costs)
