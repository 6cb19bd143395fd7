import numpy as np
import pytest
from placed_pictures import apart, picture_of, view_at

from viewer.layered.layered_image import LayeredImage, Picture
from viewer.layered.merging import merged


def test_arrays_have_the_views_size():
    view = view_at()
    color, depth, ids = np.zeros((36, 48, 3), np.uint8), np.ones((36, 48), np.float32), np.zeros((36, 48), np.int32)
    Picture(view, color, depth, ids)
    with pytest.raises(ValueError, match="depth of shape"):
        Picture(view, color, depth[1:], ids)
    with pytest.raises(ValueError, match="depths above 0 expected, infinite for nothing, found 0"):
        Picture(view, color, 0.0 * depth, ids)
    starts = np.zeros(36 * 48 + 1, np.int32)
    nothing = (
        np.zeros(0, np.float32),
        np.zeros((0, 2), np.float32),
        np.zeros((0, 4), np.uint8),
        np.zeros((0, 3), np.uint8),
        np.zeros(0, np.int32),
    )
    assert not LayeredImage(view, starts, *nothing).counts.any()
    with pytest.raises(ValueError, match="starts of shape"):
        LayeredImage(view, starts[1:], *nothing)


def test_samples_cannot_be_written_to():
    image = merged([picture_of(view_at(), apart(np.random.default_rng(0), 3))], radius=1.0)
    assert image.counts.sum() == len(image.depths) > 0
    with pytest.raises(ValueError, match="read-only"):
        image.depths[0] = 1.0
