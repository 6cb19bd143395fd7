from __future__ import annotations

import numpy as np
import pytest

from mmi.foundation.srgb import linear_from_srgb, srgb_from_linear

BYTES = np.arange(256, dtype=np.uint8)


def test_known_values():
    """Black, the last byte of the straight piece, middle grey (as in the standard's tables), white."""
    linear = linear_from_srgb(np.array([0, 10, 128, 255], dtype=np.uint8))
    assert linear == pytest.approx([0.0, 10 / 255 / 12.92, 0.21586050011389926, 1.0], abs=1e-12)


@pytest.mark.parametrize(
    "stored", [lambda x: x, lambda x: np.rint(65535.0 * x) / 65535.0, lambda x: x.astype(np.float16).astype(float)]
)
def test_every_byte_comes_back_from_what_files_hold(stored):
    assert np.array_equal(srgb_from_linear(stored(linear_from_srgb(BYTES))), BYTES)


def test_any_shape():
    picture = np.random.default_rng(3).integers(0, 256, (4, 5, 3)).astype(np.uint8)
    assert linear_from_srgb(picture).shape == (4, 5, 3)
    assert np.array_equal(srgb_from_linear(linear_from_srgb(picture)), picture)
