"""The worst region: against the whole picture's distance transform, in its place, next to the promise, given up in time."""

import json
import math
import threading
from dataclasses import replace

import numpy as np
import pytest
from manifests import with_first_cell
from scipy.ndimage import binary_dilation

from mmi.foundation.camera import level_view
from mmi.foundation.thickness import thickness
from viewer.drawing.drawn_picture import DrawnPicture
from viewer.measuring.view_errors import view_errors
from viewer.window.answers.worst_region import Promised, WorstFinder, promised, thickest, worst_region

NOTHING = Promised(None, None, "a reason")


def picture(ids, displacement=None):
    ids = np.asarray(ids, dtype=np.int32)
    return DrawnPicture(
        color=np.zeros((*ids.shape, 3), dtype=np.uint8),
        object_ids=ids,
        depth=np.ones(ids.shape, dtype=np.float32),
        displacement=np.full(ids.shape, np.nan, dtype=np.float32) if displacement is None else displacement,
        seconds=0.0,
        gpu_seconds=None,
        triangles=0,
        draws=0,
    )


def view_of(shape, focal=100.0, eye=(0.0, 0.0, 1.7)):
    height, width = shape
    return level_view(np.array(eye), 0.0, focal=focal, window=(-width // 2, -height // 2, width, height))


@pytest.mark.parametrize("seed", range(12))
def test_the_thickest_region_is_that_of_the_whole_picture(seed):
    random = np.random.default_rng([17, seed])
    wrong = random.random((90, 130)) < random.choice([0.002, 0.02, 0.2, 0.6, 0.95])
    wrong = binary_dilation(wrong, iterations=int(random.integers(1, 4))) if seed % 3 else wrong
    found, (x, y, width, height) = thickest(wrong)
    assert found == thickness(wrong)
    assert max(width, height) <= math.ceil(found) + 1
    rows, columns = np.mgrid[0:90, 0:130]
    middle_x, middle_y = x + 0.5 * width, y + 0.5 * height
    within = np.hypot(columns + 0.5 - middle_x, rows + 0.5 - middle_y) < 0.5 * found - 1.5
    assert wrong[within].all()


def test_nothing_wrong_has_no_box_and_everything_wrong_has_the_whole_picture():
    assert thickest(np.zeros((20, 30), dtype=bool)) == (0.0, None)
    found, box = thickest(np.ones((20, 30), dtype=bool))
    assert found == 20.0
    assert box[3] == 20


def test_it_says_where_how_thick_and_how_far_displaced():
    truth = np.zeros((80, 120), dtype=int)
    shown = truth.copy()
    shown[20:32, 60:90] = 5
    shown[70, :] = -1
    displacement = np.full((80, 120), np.nan, dtype=np.float32)
    displacement[3, 4], displacement[5, 6] = 0.02, 0.01
    view = view_of((80, 120))
    truth, shown = picture(truth), picture(shown, displacement)
    found = json.loads(json.dumps(worst_region(truth, shown, view, Promised(12.5, 10.5)), allow_nan=False))
    x, y, width, height = found["box"]
    assert found["thickness_px"] == 12.0 == view_errors(truth, shown, focal=100.0, flip=False).thickness_px
    assert (y, height) == (20 - 6, 12 + 12)
    assert 60 - 6 <= x and x + width <= 90 + 6
    assert found["displacement_px"] == pytest.approx(100.0 * math.tan(0.02), abs=0.01)
    assert found["wrong_share"] == pytest.approx((12 * 30 + 120) / 9600)
    assert found["promised_px"] == {"thickness": 12.5, "displacement": 10.5}


def test_boxes_end_where_the_picture_does():
    shown = np.zeros((40, 50), dtype=int)
    shown[:9, :9] = 3
    found = worst_region(picture(np.zeros((40, 50))), picture(shown), view_of((40, 50)), NOTHING)
    assert found["box"] == [0, 0, 15, 15]
    assert (found["promised_px"]["thickness"], found["why"]) == (None, "a reason")
    same = worst_region(picture(shown), picture(shown), view_of((40, 50)), NOTHING)
    assert (same["box"], same["thickness_px"], same["wrong_share"]) == (None, 0.0, 0.0)


def test_what_was_not_measured_is_refused():
    with pytest.raises(ValueError, match="without displacement"):
        worst_region(picture([[0]]), replace(picture([[0]]), displacement=None), view_of((1, 1)), NOTHING)
    with pytest.raises(ValueError, match="one size"):
        worst_region(picture([[0]]), picture([[0, 1]]), view_of((1, 1)), NOTHING)


class TestPromises:
    """The manifest's angle in pixels of the picture; for viewers in the cell only."""

    def test_it_is_the_thresholds_angle_in_pixels_of_the_picture(self, scene):
        entry = next(one for one in scene.dataset.manifest.cells if one.promised_error_px is not None)
        camera = scene.camera
        display = promised(scene, entry.id, view_of((256, 256), focal=camera.focal, eye=entry.reference))
        assert display.displacement == pytest.approx(entry.promised_error_px)
        assert display.thickness == pytest.approx(entry.promised_error_px + 2.0)
        twice = promised(scene, entry.id, view_of((512, 512), focal=2.0 * camera.focal, eye=entry.reference))
        assert twice.displacement == pytest.approx(2.0 * entry.promised_error_px)
        assert (twice.thickness, twice.why) == (pytest.approx(2.0 * entry.promised_error_px + 2.0), None)

    def test_nothing_is_promised_outside_of_the_cell(self, scene):
        entry = next(one for one in scene.dataset.manifest.cells if one.promised_error_px is not None)
        x, y, z = entry.reference
        (px, py), (qx, qy) = entry.axis
        outside = {
            "beyond its end": (qx + 0.6 * (qx - px), qy + 0.6 * (qy - py), z),
            "beside it": (
                x + 1.2 * entry.half_width * (qy - py) / 30.0,
                y + 1.2 * entry.half_width * (qx - px) / 30.0,
                z,
            ),
            "above it": (x, y, entry.eye[1] + 0.5),
            "below it": (x, y, entry.eye[0] - 0.5),
        }
        for where, eye in outside.items():
            found = promised(scene, entry.id, view_of((256, 256), eye=eye))
            assert found.thickness is None and "outside of cell" in found.why, where
        assert promised(scene, None, view_of((256, 256))).why == "The viewer is in no cell of the dataset."

    def test_a_withheld_promise_says_why(self, scene):
        first = scene.dataset.manifest.cells[0]
        other = with_first_cell(scene.dataset, promised_error_px=None, promise_withheld="a mesh is coarse")
        found = promised(replace(scene, built=other), first.id, view_of((256, 256), eye=first.reference))
        assert found == Promised(None, None, f"Nothing is promised for cell {first.id}: a mesh is coarse.")


def test_the_last_question_is_answered_and_the_others_are_given_up():
    truth = picture(np.zeros((60, 80)))
    shown = picture((np.random.default_rng(17).random((60, 80)) < 0.4).astype(int))
    finder = WorstFinder()
    try:
        futures = [finder.ask(truth, shown, view_of((60, 80)), NOTHING) for _ in range(40)]
        expected = worst_region(truth, shown, view_of((60, 80)), NOTHING)
        assert futures[-1].result(30.0) == expected
        for one in futures[:-1]:
            assert one.cancelled() or one.result(30.0) in (None, expected)
        finder.give_up()
        assert futures[-1].result(0.0) == expected
    finally:
        finder.close()


def test_who_moves_on_is_not_waited_for():
    stop = threading.Event()
    looked = []

    def stopped():
        looked.append(True)
        stop.set()
        return len(looked) > 1

    wrong = np.zeros((40, 90), dtype=bool)
    wrong[2:30:6, 2:8] = wrong[2:9, 20:27] = wrong[2:12, 40:47] = True
    assert thickest(wrong, stopped=stopped) is None or len(looked) == 1
    assert thickest(wrong, stopped=lambda: True) is None
