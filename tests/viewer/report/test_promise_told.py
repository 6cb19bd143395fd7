"""What a dataset promises on another display than the one that it was built for."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from manifests import with_first_cell

from mmi.foundation.camera import Camera
from mmi.walks.walk import Pose
from viewer.measuring.judge import Scored
from viewer.measuring.view_errors import ViewErrors
from viewer.report.promise import promised_thickness, source_of, verdict_of

DISPLAYS = st.builds(Camera, st.integers(16, 4096), st.integers(16, 4096), st.floats(10.0, 150.0).map(math.radians))


def seen(camera, *, by, tolerance):
    """Whether the corners of a picture of ``camera`` are in a picture of ``by`` that looks the same way (shares of it)."""
    tangents = np.array([camera.width, camera.height]) / (2.0 * camera.focal)
    return bool((tangents * by.focal <= np.array([by.width, by.height]) / 2.0 * tolerance).all())


@given(DISPLAYS, DISPLAYS, st.floats(0.5, 20.0))
def test_a_promise_is_kept_where_the_picture_is_a_part_of_the_one_built_for(built, shown, threshold):
    found = promised_thickness(threshold, built, shown)
    if seen(shown, by=built, tolerance=1.0 - 1e-6):
        # A region so thick in this picture is, in the other one, thinner by the focal length, and there T is promised.
        finer = shown.focal / built.focal
        assert (found - 1.0 - max(finer, 1.0)) / finer == pytest.approx(threshold, rel=1e-9)
        assert found >= finer * threshold + 2.0
    elif not seen(shown, by=built, tolerance=1.0 + 1e-6):
        assert found is None


@pytest.mark.parametrize(
    ("shown", "pixels"),
    [
        (Camera(512, 512, math.radians(60.0)), 7.0),
        (Camera(1024, 1024, math.radians(60.0)), 10.0 + 1.0 + 2.0),
        (Camera(1920, 1080, math.radians(60.0)), 5.0 * 3.75 + 1.0 + 3.75),
        (Camera(256, 256, math.radians(60.0)), 2.5 + 2.0),
        (Camera(512, 512, math.radians(90.0)), None),
        (Camera(512, 1024, math.radians(60.0)), None),
    ],
)
def test_promises_that_can_be_worked_out_by_hand(shown, pixels):
    found = promised_thickness(5.0, Camera(512, 512, math.radians(60.0)), shown)
    assert found is None if pixels is None else found == pytest.approx(pixels)


def test_a_dataset_tells_what_it_was_built_for_and_what_that_is_here(scene):
    own = source_of(scene)
    built_for = {"width": 256, "height": 256, "fov_deg": pytest.approx(60.0), "max_error_px": 5.0}
    assert (own["kind"], own["built_for"], own["max_error_px"], own["promised_px"]) == ("dataset", built_for, 5.0, 7.0)
    finer = source_of(replace(scene, camera=Camera(512, 512, scene.camera.fov)))
    assert finer["built_for"] == built_for
    assert finer["max_error_px"] == pytest.approx(10.0)
    assert finer["promised_px"] == pytest.approx(13.0)
    wider = source_of(replace(scene, camera=Camera(256, 256, math.radians(90.0))))
    assert wider["promised_px"] is None
    assert wider["max_error_px"] == pytest.approx(5.0 * math.tan(math.radians(30.0)))


def test_a_city_promises_nothing(scene):
    told = source_of(replace(scene, built=None))
    assert told["kind"] == "city"
    assert told["cells"] == len(scene.whereabouts.cells)
    assert {told[name] for name in ("built_for", "max_error_px", "promised_px", "promising_cells")} == {None}


def view_of(cell, thickness, displacement):
    return Scored("multi-mesh", cell, Pose((0.0, 0.0, 1.7), 0.0, 0.0), None, errors_of(thickness, displacement))


def errors_of(thickness, displacement):
    return ViewErrors(0.0, 0.0, thickness, 0.0, 0.0, displacement, None, None, None, 60.0, 1.0)


@pytest.mark.parametrize(
    ("views", "kept", "line"),
    [
        (
            [(6.0, 4.1), (2.0, 5.0)],
            True,
            "promise kept: worst region 6 px (T + 2 = 7), displacement 5 px (T = 5), 2 views",
        ),
        ([(7.0, 0.0)], True, "promise kept: worst region 7 px (T + 2 = 7), displacement 0 px (T = 5), 1 view"),
        (
            [(9.0, 0.5), (1.0, 5.25), (1.0, 1.0)],
            False,
            "promise BROKEN in 2 of 3 views: worst region 9 px (T + 2 = 7), displacement 5.25 px (T = 5)",
        ),
    ],
)
def test_a_verdict_of_views(scene, views, kept, line):
    cell = scene.built.manifest.cells[0].id
    found = verdict_of(scene, [view_of(cell, *one) for one in views])
    assert (found["kept"], found["line"], found["other_views"]) == (kept, line, 0)


def test_views_from_cells_that_promise_nothing_do_not_count(scene):
    first, second, *_ = scene.built.manifest.cells
    some = replace(scene, built=with_first_cell(scene.built, promised_error_px=None, promise_withheld="it is bent"))
    found = verdict_of(some, [view_of(first.id, 99.0, 99.0), view_of(second.id, 1.0, 1.0)])
    assert (found["kept"], found["views"], found["other_views"], found["thickness_px"]) == (True, 1, 1, 1.0)
    assert found["line"].endswith("1 view; 1 more in cells that promise nothing")
    found = verdict_of(some, [view_of(first.id, 99.0, 99.0)])
    assert (found["kept"], found["line"]) == (
        None,
        "promise not checked: no view is in a cell that promises something",
    )


def test_what_is_no_part_of_the_promise_is_not_held_against_it(scene):
    views = [view_of(scene.built.manifest.cells[0].id, 99.0, 99.0)]
    assert verdict_of(scene, views, glint=True)["line"].startswith("promise not checked: windows that mirror")
    assert verdict_of(scene, views, movers=True)["kept"] is None
    assert verdict_of(replace(scene, built=None), views) is None
    assert verdict_of(scene, None) is None


def test_on_a_display_that_sees_farther_displacement_counts_alone(scene):
    wider = replace(scene, camera=Camera(256, 256, math.radians(90.0)))
    cell = scene.built.manifest.cells[0].id
    found = verdict_of(wider, [view_of(cell, 99.0, 1.0)])
    assert found["kept"]
    assert "99 px (nothing promised on a display that sees farther), displacement 1 px (T = 2.89)" in found["line"]
    assert not verdict_of(wider, [view_of(cell, 0.0, 3.0)])["kept"]
    finer = replace(scene, camera=Camera(512, 512, scene.camera.fov))
    assert "(promised 13)" in verdict_of(finer, [view_of(cell, 12.0, 1.0)])["line"]
