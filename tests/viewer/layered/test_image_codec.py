import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from placed_pictures import FOCAL, apart, picture_of, view_at

from mmi.foundation.errors import DatasetError
from viewer.layered.image_codec import decoded, encoded
from viewer.layered.layered_image import HALF, LayeredImage
from viewer.layered.merging import merged
from viewer.layered.viewpoints import construction_views


def image_of(seed=0, count=6):
    sheets = apart(np.random.default_rng(seed), count)
    views = construction_views(view_at((3.0, 4.0, 5.0), 0.0), 8.0, 4.0, 9, sheets.points)
    return merged([picture_of(view, sheets) for view in views], radius=4.0)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 8))
def test_what_is_read_is_what_was_written(seed, count):
    image = image_of(seed, count)
    found = decoded(encoded(image), "x")
    for name in ("starts", "ids", "reaches"):
        assert np.array_equal(getattr(found, name), getattr(image, name)), name
    assert abs(found.colors.astype(int) - image.colors).max(initial=0) <= 3
    assert np.array_equal(found.view.eye_from_world, image.view.eye_from_world)
    assert (found.view.window, found.view.focal) == (image.view.window, image.view.focal)
    if len(image.depths):
        near, again = 1.0 / image.depths.astype(float), 1.0 / found.depths.astype(float)
        step = max((near.max() - near.min()) / 3071.0, near.max() * 2.0**-24)
        assert abs(near - again).max() <= 0.5 * step + 1e-6 * near.max()
        # In pixels, for a viewer as far from the image's eye as its nearest sample.
        assert FOCAL * image.depths.min() * abs(near - again).max() < 1.01 * FOCAL / 6142.0
        off = abs(found.slopes - image.slopes)
        assert (off <= np.maximum(2.5 * step, abs(image.slopes) / 30.0) + 1e-9).all()


@pytest.mark.parametrize("noise", [0, 40])
def test_what_is_even_keeps_its_colour(noise):
    """An edge, or a rough surface before, may be off; what it is off by tints no surface of one colour beside it."""
    view, rng = view_at(), np.random.default_rng(3)
    width, height = view.window[2:]
    colors = np.full((height, width, 3), (197, 196, 195))
    colors[:, : width // 3] += rng.integers(-noise, noise + 1, (height, width // 3, 3))
    colors[:, width // 3 :] -= (51, 22, 13)
    m = width * height
    image = LayeredImage(
        view, np.arange(m + 1, dtype=np.int32), np.full(m, 9.0, np.float32), np.zeros((m, 2), np.float32),
        np.full((m, 4), HALF, np.uint8), colors.reshape(-1, 3).astype(np.uint8), np.zeros(m, np.int32),
    )  # fmt: skip
    off = abs(decoded(encoded(image), "x").colors.astype(int) - image.colors).reshape(height, width, 3)
    assert off.max() <= 3
    assert off[:, width // 3 + 16 :].any(axis=2).mean() <= (0.0 if noise == 0 else 0.1)


def test_bytes_are_the_same_again():
    image = image_of()
    data = encoded(image)
    assert encoded(image) == data


def test_numbers_of_any_size_survive():
    """Slopes and samples that no picture would have."""
    rng = np.random.default_rng(1)
    counts = rng.integers(0, 6, 48 * 36)
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
    m = starts[-1]
    depths = rng.uniform(1.0, 1e4, m)
    order = np.lexsort((depths, np.repeat(np.arange(48 * 36), counts)))
    slopes = np.sign(rng.normal(size=(m, 2))) * 10.0 ** rng.uniform(-12.0, 0.0, (m, 2))
    ids = rng.integers(-(2**31), 2**31, m).astype(np.int32)
    image = LayeredImage(
        view_at(), starts, depths[order].astype(np.float32), slopes.astype(np.float32),
        rng.integers(0, HALF + 1, (m, 4)).astype(np.uint8),
        rng.integers(0, 256, (m, 3)).astype(np.uint8), ids,
    )  # fmt: skip
    found = decoded(encoded(image), "x")
    assert np.array_equal(found.ids, image.ids)
    assert np.array_equal(found.reaches, image.reaches)
    assert abs(found.colors.astype(int) - image.colors).max() <= 3
    assert (abs(found.slopes - image.slopes) <= np.maximum(2.5 / 3071.0, abs(image.slopes) / 30.0)).all()


@pytest.mark.parametrize("slope", [0.0, 0.1])
def test_an_image_of_one_depth_or_of_nothing(slope):
    view = view_at()
    nothing = LayeredImage(
        view, np.zeros(48 * 36 + 1, np.int32), np.zeros(0, np.float32), np.zeros((0, 2), np.float32),
        np.zeros((0, 4), np.uint8),
        np.zeros((0, 3), np.uint8), np.zeros(0, np.int32),
    )  # fmt: skip
    assert not decoded(encoded(nothing), "x").counts.any()
    starts = np.ones(48 * 36 + 1, np.int32)
    starts[0] = 0
    one = LayeredImage(
        view, starts, np.full(1, 7.0, np.float32), np.full((1, 2), slope, np.float32),
        np.full((1, 4), HALF, np.uint8), np.ones((1, 3), np.uint8),
        np.full(1, 9, np.int32),
    )  # fmt: skip
    found = decoded(encoded(one), "x")
    assert found.depths[0] == pytest.approx(7.0)
    assert found.slopes[0] == pytest.approx(np.full(2, slope), rel=0.03)


def test_too_many_samples_in_a_pixel_are_refused():
    view = view_at(window=(0, 0, 1, 1))
    m = 256
    image = LayeredImage(
        view, np.array([0, m], np.int32), np.linspace(1.0, 2.0, m, dtype=np.float32), np.zeros((m, 2), np.float32),
        np.zeros((m, 4), np.uint8),
        np.zeros((m, 3), np.uint8), np.zeros(m, np.int32),
    )  # fmt: skip
    with pytest.raises(ValueError, match="at most 255 samples a pixel expected, found 256"):
        encoded(image)


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_damaged_bytes_are_one_line_or_an_image(data):
    good = GOOD
    bad = bytearray(good)
    match data.draw(st.sampled_from(["byte", "cut", "more", "header"])):
        case "byte":
            bad[data.draw(st.integers(0, len(bad) - 1))] ^= data.draw(st.integers(1, 255))
        case "cut":
            del bad[data.draw(st.integers(0, len(bad) - 1)) :]
        case "more":
            bad += data.draw(st.binary(min_size=1, max_size=20))
        case _:
            at = 8 + 4 * data.draw(st.integers(0, 5))
            bad[at : at + 4] = struct.pack("<i", data.draw(st.integers(-5, 2**20)))
    try:
        found = decoded(bytes(bad), "some.file")
    except DatasetError as error:
        assert str(error).startswith("some.file: ")
        assert "\n" not in str(error)
        assert "expected" in str(error)
    else:
        assert len(found.depths) == found.starts[-1]
        assert (found.depths > 0.0).all()


GOOD = encoded(image_of())


def test_what_unpacks_into_more_than_it_should_is_refused():
    size = struct.calcsize("<8s4i2I15d")
    bomb = zlib.compress(bytes(10**7), 9)
    with pytest.raises(DatasetError, match="x: 16 bytes of objects expected, found 17 or more"):
        decoded(GOOD[:size] + struct.pack("<I", len(bomb)) + bomb, "x")


def test_more_than_so_few_bytes_can_say_is_refused_before_room_is_made():
    bad = bytearray(GOOD)
    bad[16:24] = struct.pack("<2i", 8000, 8000)
    with pytest.raises(DatasetError, match=r"x: more than \d+ bytes expected of \d+ samples of 8000 x 8000 pixels"):
        decoded(bytes(bad), "x")


def test_what_can_be_foreseen_takes_next_to_nothing():
    """A wall of one color across the axis, whose patches are whole."""
    width, height = 200, 150
    view, m = view_at(window=(-100, -75, width, height)), width * height
    image = LayeredImage(
        view, np.arange(m + 1, dtype=np.int32), np.full(m, 9.0, np.float32),
        np.zeros((m, 2), np.float32), np.full((m, 4), HALF, np.uint8),
        np.full((m, 3), 77, np.uint8), np.full(m, 5, np.int32),
    )  # fmt: skip
    data = encoded(image)
    assert len(data) < 0.01 * m
    assert np.array_equal(decoded(data, "x").ids, image.ids)


@pytest.mark.parametrize("size", [(1, 40), (40, 1)])
def test_pictures_as_narrow_as_a_pixel(size):
    rng = np.random.default_rng(2)
    view, m = view_at(window=(0, 0, *size)), 80
    image = LayeredImage(
        view, np.arange(0, m + 1, 2, dtype=np.int32), np.tile(np.float32([2.0, 5.0]), 40),
        np.zeros((m, 2), np.float32), rng.integers(0, HALF + 1, (m, 4)).astype(np.uint8),
        rng.integers(0, 256, (m, 3)).astype(np.uint8), rng.integers(0, 3, m).astype(np.int32),
    )  # fmt: skip
    found = decoded(encoded(image), "x")
    assert np.array_equal(found.ids, image.ids)
    assert np.array_equal(found.reaches, image.reaches)
