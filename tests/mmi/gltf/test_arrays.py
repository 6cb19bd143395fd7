"""Arrays that are written come back, from views that are packed or not; no number in a file is believed."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmi.foundation.srgb import srgb_from_linear
from mmi.gltf.codes import DTYPES, FLOAT, UINT16, UINT32, WIDTHS
from mmi.gltf.reading import BufferView, buffer_view, elements, whole_number
from mmi.gltf.writing import BufferViews


def back(views, accessor, images=()):
    """An array as the entries of the finished file describe it, read by this package's reader; and its accessor."""
    document, blobs, _ = views.entries(images)
    entry = document["accessors"][accessor]
    view = buffer_view(document, [b"".join(blobs)], entry["bufferView"])
    values = elements(
        view,
        offset=entry["byteOffset"],
        count=entry["count"],
        component=entry["componentType"],
        kind=entry["type"],
    )
    return values, entry


@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 1000))
@settings(max_examples=40, deadline=None)
def test_arrays_of_all_kinds_come_back(n, m, seed):
    rng = np.random.default_rng(seed)
    first, second = rng.normal(scale=300.0, size=(n, 3)), rng.normal(size=(m, 3))
    colors = rng.integers(0, 256, size=(n, 3), dtype=np.uint8)
    uv, unit = rng.uniform(-3, 9, size=(n, 2)), rng.uniform(0, 1, size=(m, 2))
    index = rng.integers(0, n, size=3 * m)
    views = BufferViews()
    numbers = [
        views.positions(first), views.colors(colors), views.coordinates(uv), views.indices(index, n),
        views.positions(second, shortest=True), views.unit_coordinates(unit),
    ]  # fmt: skip
    assert numbers == list(range(6))
    found = [back(views, i) for i in numbers]
    for (values, entry), points in ((found[0], first), (found[4], second)):
        np.testing.assert_array_equal(values, points.astype(np.float32))
        np.testing.assert_array_equal(np.float32(entry["min"]), values.min(axis=0))
        np.testing.assert_array_equal(np.float32(entry["max"]), values.max(axis=0))
    np.testing.assert_array_equal(srgb_from_linear(found[1][0][:, :3] / 65535.0), colors)
    assert (found[1][0][:, 3] == 65535).all()
    np.testing.assert_array_equal(found[2][0], uv.astype(np.float32))
    np.testing.assert_array_equal(found[3][0].reshape(-1), index)
    np.testing.assert_allclose(found[5][0] / 65535.0, unit, atol=0.5 / 65535 + 1e-9)
    assert [bool(entry.get("normalized")) for _, entry in found] == [False, True, False, False, False, True]


def test_everything_begins_at_a_multiple_of_four_bytes():
    views = BufferViews()
    for count in (1, 3, 2):
        views.indices(np.arange(count), 3)
    views.positions(np.zeros((1, 3)))
    document, blobs, first_image = views.entries([b"12345", b"678"])
    assert first_image == 2
    assert [entry["byteOffset"] for entry in document["accessors"]] == [0, 4, 12, 0]
    assert [(view["byteOffset"], view["byteLength"]) for view in document["bufferViews"]] == [
        (0, 16), (16, 12), (28, 5), (36, 3),
    ]  # fmt: skip
    assert document["buffers"] == [{"byteLength": 40}]
    assert b"".join(blobs)[28:] == b"12345\0\0\x00678\0"


@pytest.mark.parametrize(("vertices", "component"), [(65535, UINT16), (65536, UINT32)])
def test_the_largest_index_of_sixteen_bits_is_never_used(vertices, component):
    views = BufferViews()
    values, entry = back(views, views.indices(np.array([0, 1, vertices - 1]), vertices))
    assert entry["componentType"] == component
    assert values.reshape(-1).tolist() == [0, 1, vertices - 1]


def test_elements_may_lie_apart():
    data = b"".join(struct.pack("<ffHxx", i, -i, i) for i in range(3))
    places = elements(BufferView(memoryview(data), 12), offset=0, count=3, component=FLOAT, kind="VEC2")
    numbers = elements(BufferView(memoryview(data), 12), offset=8, count=3, component=UINT16, kind="SCALAR")
    np.testing.assert_array_equal(places, [[0, 0], [1, -1], [2, -2]])
    np.testing.assert_array_equal(numbers, [[0], [1], [2]])
    places[:] = 0  # a copy


@given(
    st.integers(0, 40), st.integers(0, 50), st.integers(0, 20), st.integers(0, 20),
    st.sampled_from(sorted(DTYPES)), st.sampled_from(sorted(WIDTHS)),
)  # fmt: skip
@settings(max_examples=300, deadline=None)
def test_elements_are_inside_their_view_or_refused(size, offset, count, stride, component, kind):
    """The oracle takes each number by itself."""
    data = bytes(range(size))
    dtype, width = DTYPES[component], WIDTHS[kind]
    each = width * dtype.itemsize
    step = stride or each
    places = [offset + i * step + k * dtype.itemsize for i in range(count) for k in range(width)]
    fits = step >= each and all(place + dtype.itemsize <= size for place in places)
    view = BufferView(memoryview(data), stride)
    if not fits:
        with pytest.raises(ValueError, match=rf"^{count} times {kind} from byte {offset} wanted, the view has {size} "):
            elements(view, offset=offset, count=count, component=component, kind=kind)
        return
    found = elements(view, offset=offset, count=count, component=component, kind=kind)
    expected = [np.frombuffer(data, dtype, 1, place)[0] for place in places]
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, np.array(expected, dtype).reshape(count, width))


@pytest.mark.parametrize("value", [-1, True, 1.0, "0", None])
def test_indices_are_whole_numbers(value):
    with pytest.raises(ValueError, match="a whole number >= 0 expected"):
        whole_number(value)
    with pytest.raises(ValueError, match="a whole number >= 0 expected"):
        buffer_view({"bufferViews": [{"buffer": 0, "byteLength": 1}]}, [b"1"], value)


def test_a_view_beyond_its_buffer_is_refused():
    document = {"bufferViews": [{"buffer": 1, "byteOffset": 2, "byteLength": 3}]}
    assert bytes(buffer_view(document, [b"", b"abcde"], 0).data) == b"cde"
    with pytest.raises(ValueError, match="bytes 2 to 5 wanted, the buffer has 4"):
        buffer_view(document, [b"", b"abcd"], 0)
