import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mmi.foundation.shelves import on_shelves


@given(st.lists(st.tuples(st.integers(1, 90), st.integers(1, 70)), max_size=40), st.integers(1, 300))
def test_no_picture_lies_on_another_and_all_within_the_extent(sizes, width):
    corners, (used, height) = on_shelves(np.array(sizes, dtype=np.int64).reshape(-1, 2), width)
    taken = np.zeros((height, used), dtype=int)
    for (x, y), (wide, high) in zip(corners.tolist(), sizes, strict=True):
        assert x + wide <= max(width, wide)
        taken[y : y + high, x : x + wide] += 1
    assert taken.max(initial=0) <= 1
    assert taken.sum() == sum(wide * high for wide, high in sizes)
    if sizes:
        assert used <= max(width, *(wide for wide, _ in sizes))


def test_shelves_by_hand():
    """The highest stands first; the second does not fit beside it, the low ones stand beside each other."""
    corners, extent = on_shelves(np.array([(4, 2), (6, 5), (5, 4), (3, 2)]), 10)
    assert corners.tolist() == [[5, 5], [0, 0], [0, 5], [0, 9]]
    assert extent == (9, 11)
    assert on_shelves(np.empty((0, 2), dtype=np.int64), 10)[1] == (0, 0)
