"""Pictures as bytes and back."""

import io
import struct

import numpy as np
import pytest
from PIL import Image

from viewer.serving.encoding import Encoder, jpeg, message, opened, png


@pytest.fixture(scope="module")
def picture():
    y, x = np.mgrid[:90, :160]
    return np.ascontiguousarray(np.stack([x, 2 * y, 255 - x], axis=-1).astype(np.uint8))


def read(data):
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)


@pytest.mark.parametrize("quality", [30, 80, 95])
def test_jpeg_is_near_the_picture(picture, quality):
    found = read(jpeg(picture, quality))
    assert found.shape == picture.shape
    assert np.abs(found - picture).mean() < 4.0
    assert Image.open(io.BytesIO(jpeg(picture, quality))).format == "JPEG"


def test_worse_quality_is_smaller(picture):
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 255, picture.shape).astype(np.uint8)
    sizes = [len(jpeg(noise, quality)) for quality in (30, 60, 80, 95)]
    assert sizes == sorted(sizes)


@pytest.mark.parametrize("small", [False, True])
def test_png_is_the_picture(picture, small):
    data = png(picture, {"pose": "1 2 3", "note": "näh"}, small=small)
    np.testing.assert_array_equal(read(data), picture)
    assert Image.open(io.BytesIO(data)).text == {"pose": "1 2 3", "note": "näh"}


def test_a_message_is_a_header_and_a_picture():
    header = {"frame": 3, "cell": "Töölö"}
    data = message(header, b"\xff\xd8...")
    (length,) = struct.unpack_from("<I", data)
    assert data[4 : 4 + length].decode() == '{"frame":3,"cell":"T\\u00f6\\u00f6l\\u00f6"}'
    assert opened(data) == (header, b"\xff\xd8...")


def test_a_header_holds_finite_numbers_only():
    with pytest.raises(ValueError, match="JSON"):
        message({"ms": float("nan")}, b"")


def test_threads_encode(picture):
    with Encoder() as encoder:
        found = [encoder.jpeg(picture, 80), encoder.png(picture), encoder.png(picture, {"a": "b"}, small=True)]
        encoded = [one.result() for one in found]
    assert [one.format for one in encoded] == ["jpeg", "png", "png"]
    assert encoded[0].data == jpeg(picture, 80)
    assert all(one.seconds > 0.0 for one in encoded)
