import errno
import math
import mmap
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmi.foundation.camera import Camera, View
from viewer.casting.panorama import PIXEL_LEVELS, SAMPLE, Panorama, smallest_pixel, store, texel_of

CAMERA = Camera(64, 48, math.radians(60.0))
VIEW = View(np.eye(4), CAMERA.focal, CAMERA.window)
NUMBERS = st.floats(-1.0, 1.0)


@settings(deadline=None)
@given(NUMBERS, NUMBERS, NUMBERS)
def test_every_direction_has_a_texel_that_is_near_it(x, y, z):
    if math.sqrt(x * x + y * y + z * z) < 1e-3:
        return
    texels = Panorama(smallest_pixel(VIEW)).texels
    column, row = texel_of(x, y, z, texels.columns, texels.rows, texels.step)
    assert 0 <= column < texels.columns
    assert 0 <= row < texels.rows
    height = (row + 0.5) * texels.step - 0.5 * math.pi
    assert abs(height - math.atan2(z, math.hypot(x, y))) <= 0.51 * texels.step
    turn = math.remainder((column + 0.5) * texels.step - math.pi - math.atan2(y, x), 2.0 * math.pi)
    assert abs(turn) <= 0.51 * texels.step


def test_no_two_pixels_of_a_level_view_need_the_same_texel():
    panorama = Panorama(smallest_pixel(VIEW))
    u = (np.arange(64) - 31.5) / CAMERA.focal
    columns = [texel_of(1.0, -one, 0.0, *panorama.texels[:3])[0] for one in u]
    assert len(set(columns)) == len(columns)


def test_what_was_cast_is_kept_with_its_record():
    panorama = Panorama(smallest_pixel(VIEW))
    eye = np.array([10.0, 20.0, 2.0])
    record = panorama.record_at(eye)
    directions = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    samples = np.zeros(2, dtype=SAMPLE)
    samples[0] = (0, 0, 120.0, 0.25, 0.5, 2.0, 0xFF102030, 7)
    samples["object"][1] = -1
    points = np.array([[130.0, 20.0, 2.0], [0.0, 1.0, 0.0]], dtype=np.float32)
    store(record, directions, np.array([0.8, 0.6, 0.0]), points, samples, panorama.texels)
    texels = panorama.texels
    hit, missed = (
        np.ravel_multi_index(texel_of(*one, *texels[:3])[::-1], (texels.rows, texels.columns)) for one in directions
    )
    known = texels.map[[hit, missed]]
    assert known["record"].tolist() == [record, record]
    assert (texels.map["record"] > 0).sum() == 2
    assert known["object"].tolist() == [7, -1]
    assert [known[name].tolist() for name in "xyz"] == [[130.0, 0.0], [20.0, 1.0], [2.0, 0.0]]
    assert [known["u"][0], known["v"][0], known["tint"][0]] == [0.25, 0.5, 0xFF102030]
    assert known["level"][0] == pytest.approx(2.0 - PIXEL_LEVELS * math.log2(0.8))


@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux how much memory is taken")
def test_directions_far_apart_take_little_memory():
    """A few rays all around, in the map of a display whose smallest pixels are tiny."""

    def taken():
        return mmap.PAGESIZE * int(Path("/proc/self/statm").read_text().split()[1])

    rng = np.random.default_rng(1)
    directions = rng.normal(size=(300, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    samples, points = np.zeros(300, dtype=SAMPLE), directions.astype(np.float32)
    ahead = np.array([1.0, 0.0, 0.0])
    store(1, directions, ahead, points, samples, Panorama(1.0).texels)  # compiled before
    panorama = Panorama(1e-6)
    before = taken()
    store(1, directions, ahead, points, samples, panorama.texels)
    assert taken() - before < 30_000_000, "that is less than 100 kilobytes a ray"


@pytest.mark.skipif(sys.platform != "linux", reason="NumPy raises it elsewhere")
def test_memory_that_ran_out_is_called_so(monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOMEM, "Cannot allocate memory")

    monkeypatch.setattr("viewer.casting.panorama.mmap.mmap", full)
    with pytest.raises(MemoryError, match="bytes for what rays have found"):
        Panorama(0.1)


def test_records_tell_how_far_away_they_are():
    panorama = Panorama(smallest_pixel(VIEW))
    places = [np.array([float(k), 0.0, 0.0]) for k in range(5)]
    records = [panorama.record_at(place) for place in places]
    assert records == [1, 2, 3, 4, 5]
    assert panorama.record_at(places[2]) == 3, "a place that was there before has its record"
    away = panorama.distances(np.array([4.0, 3.0, 0.0]))
    assert np.isinf(away[0])
    assert away[1:] == pytest.approx([5.0, math.sqrt(18.0), math.sqrt(13.0), math.sqrt(10.0), 3.0])


def test_old_records_are_not_shown_again():
    panorama = Panorama(smallest_pixel(VIEW))
    for k in range(5000):
        assert panorama.record_at(np.array([float(k), 0.0, 0.0])) == k + 1
    away = panorama.distances(np.zeros(3))
    assert len(away) == 5001
    assert np.isinf(away[:905]).all()
    assert away[905:] == pytest.approx(np.arange(904.0, 5000.0))
