"""Numbers of ranges, one after the other, as loops have them."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mmi.city.ranges import numbers_in


@given(st.lists(st.tuples(st.integers(0, 50), st.integers(0, 6)), max_size=20), st.sampled_from([np.int32, np.int64]))
def test_numbers_are_those_of_a_loop(ranges, kind):
    firsts = np.array([first for first, _ in ranges], dtype=kind)
    ends = firsts + np.array([count for _, count in ranges], dtype=kind)
    found = numbers_in(firsts, ends)
    assert found.dtype == np.int64
    assert found.tolist() == [n for first, count in ranges for n in range(first, first + count)]
