"""Places of images of boxes: within the bytes that are said, never two in one, and those needed least recently give way."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from viewer.caching.atlases import TEXEL_BYTES, Atlases


def nobody(_node):
    pass


def atlases(most_bytes, forget=nobody, largest=64):
    return Atlases("test", largest=largest, most_bytes=most_bytes, forget=forget)


def test_without_bytes_there_is_no_place():
    made = atlases(0)
    assert made.take(1, (16, 16), 0, np.full(5, -1), 1) is None
    assert made.bytes == 0


def test_the_least_recently_needed_gives_way_and_what_this_frame_needs_stays():
    gone = []
    made = atlases(2 * 64 * 64 * TEXEL_BYTES, gone.append)
    used = np.full(9, -1)
    for node in (1, 2):
        assert made.take(node, (64, 64), 0, used, node) is not None
        used[node] = node
    used[1] = 5
    assert made.take(3, (64, 64), 0, used, 6) is not None
    assert gone == [2]
    used[1] = used[3] = 6
    assert made.take(4, (64, 64), 0, used, 6) is None
    assert gone == [2]
    assert made.bytes <= 2 * 64 * 64 * TEXEL_BYTES


def test_generations_never_share_an_atlas():
    made = atlases(10 * 64 * 64 * TEXEL_BYTES)
    used = np.full(9, 1)
    one, other = (made.take(node, (16, 16), node, used, 1) for node in (0, 1))
    assert one.image != other.image
    made.drop(0)
    assert made.take(2, (64, 64), 1, used, 1).image == one.image  # nobody needs it for another generation


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 39), st.integers(1, 64), st.integers(1, 64), st.integers(0, 2)), max_size=120),
    st.integers(1, 6),
)
def test_places_never_overlap_and_bytes_suffice(orders, pages):
    gone = set()
    made = atlases(pages * 64 * 64 * TEXEL_BYTES, gone.add)
    used = np.full(40, -1)
    places = {}
    for frame, (node, width, height, generation) in enumerate(orders):
        slot = made.take(node, (width, height), generation, used, frame)
        places.pop(node, None)
        for one in gone:
            places.pop(one, None)
        gone.clear()
        assert slot is not None  # nobody else is needed in this frame
        used[node] = frame
        x, y = slot.corner
        for image, (a, b, w, h), other in places.values():
            if image == slot.image:
                assert other == generation
                assert a + w <= x or x + width <= a or b + h <= y or y + height <= b
        places[node] = slot.image, (x, y, width, height), generation
        assert max(x + width, y + height) <= slot.size[0]
        assert made.bytes <= pages * 64 * 64 * TEXEL_BYTES
