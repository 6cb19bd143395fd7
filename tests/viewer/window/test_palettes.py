"""Pictures of depth, objects, differences and wrong surfaces, against plain twins of a few lines."""

import numpy as np
import pytest

from viewer.measuring.view_errors import WrongRegions
from viewer.window.palettes import (
    GROUND,
    HOLE,
    SKY,
    WRONG,
    depth_picture,
    difference_picture,
    objects_picture,
    wrong_picture,
)


@pytest.fixture
def random():
    return np.random.default_rng(17)


def light(picture):
    """How light pixels are, also to those who see no colours."""
    return picture.astype(float) @ np.array([0.299, 0.587, 0.114])


def test_what_is_nearer_is_lighter_and_the_sky_is_the_skys():
    depth = np.geomspace(2.0, 2000.0, 60, dtype=np.float32).reshape(6, 10)
    picture = depth_picture(depth)
    assert picture.dtype == np.uint8
    assert picture.flags.c_contiguous
    assert (np.diff(light(picture).ravel()) < 0.0).all()
    np.testing.assert_array_equal(depth_picture(np.full((2, 3), np.inf, dtype=np.float32)), np.full((2, 3, 3), SKY))
    beyond = depth_picture(np.array([[0.1, 2.0], [2000.0, 9000.0]], dtype=np.float32))
    np.testing.assert_array_equal(beyond[:, 0], beyond[:, 1])


def test_equal_factors_of_depth_are_equal_steps():
    """Halfway between 2 m and 2000 m is their geometric mean, and there is the middle of the scale."""
    middle = depth_picture(np.array([[np.sqrt(2.0 * 2000.0)]], dtype=np.float32))[0, 0]
    np.testing.assert_allclose(middle, (33, 145, 140), atol=1)


def test_an_object_has_one_colour_in_every_picture(random):
    ids = random.integers(-2, 5000, (40, 50)).astype(np.int32)
    picture, turned = objects_picture(ids), objects_picture(ids[::-1, ::-1])
    np.testing.assert_array_equal(turned, picture[::-1, ::-1])
    of = {int(one): tuple(color) for one, color in zip(ids.ravel(), picture.reshape(-1, 3).tolist(), strict=True)}
    assert (of[-2], of[-1]) == (GROUND, SKY)
    assert objects_picture(np.array([[3_000_000_000 % 2**31]], dtype=np.int32)).shape == (1, 1, 3), "no id is too large"


def test_objects_next_to_each_other_in_the_file_differ_and_none_looks_like_ground_or_sky():
    colors = objects_picture(np.arange(3000, dtype=np.int32)[None])[0].astype(float)
    for step in range(1, 8):
        assert np.linalg.norm(colors[step:] - colors[:-step], axis=1).min() > 40.0
    for one in (GROUND, SKY):
        assert np.linalg.norm(colors - np.array(one), axis=1).min() > 25.0


def test_differences_are_black_where_pictures_agree_and_lighter_the_more_they_differ(random):
    one, other = (random.integers(0, 256, (30, 40, 3)).astype(np.uint8) for _ in range(2))
    other[:10] = one[:10]
    picture = difference_picture(one, other)
    largest = np.abs(one.astype(int) - other).max(axis=2)
    assert (light(picture)[:10] < 1.0).all()
    order = np.argsort(largest.ravel(), kind="stable")
    assert (np.diff(light(picture).ravel()[order]) > -1e-9).all()
    assert light(picture)[largest == 2].min(initial=255.0) > 5.0, "a difference of two steps shows"
    with pytest.raises(ValueError, match="one size"):
        difference_picture(one, other[1:])


def test_wrong_pixels_and_holes_are_marked_on_a_grey_picture(random):
    shown = random.integers(0, 256, (30, 40, 3)).astype(np.uint8)
    wrong = random.random((30, 40)) < 0.3
    holes = wrong & (random.random((30, 40)) < 0.5)
    picture = wrong_picture(shown, WrongRegions(wrong, holes))
    grey = 96 + ((shown.astype(int) @ np.array([77, 150, 29])) >> 8) // 2
    expected = np.repeat(grey[..., None], 3, axis=2)
    expected[wrong], expected[holes] = WRONG, HOLE
    np.testing.assert_array_equal(picture, expected)
    with pytest.raises(ValueError, match="size"):
        wrong_picture(shown, WrongRegions(wrong[1:], holes[1:]))
