"""The angle between two points of a ray: its greatest over slopes, against many slopes, and what bounds it."""

import numpy as np
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from mmi.parallax.ray_angles import RayViewpoints, no_wider_than, widest

ONE = np.ones(1, dtype=np.bool_)


class TestSlopes:
    @settings(max_examples=300, deadline=None, derandomize=True)
    @given(
        st.floats(2.0, 60.0),
        st.floats(0.1, 60.0),
        st.lists(st.floats(-3.0, 3.0), min_size=2, max_size=2),
        st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0)),
    )
    @example(8.602, 5.92, [-1.772, -0.026], (19.814, 0.218))  # downwards only: 3 times as wide as at both ends
    @example(37.62, 1.56, [-1.61, 1.72], (-12.1, 15.92))  # 6 % wider than where elevations part most
    def test_none_of_the_range_parts_them_more(self, near, longer, slopes, at):
        lowest, highest = sorted(slopes)
        viewpoints = RayViewpoints(np.array(at[:1]), np.array(at[1:]), 0.0)
        assume(abs(at[1]) > 1e-3 or not 0.0 < at[0])
        found = widest(near, near + longer, lowest, highest, viewpoints, ONE)
        for slope in np.linspace(lowest, highest, 50):
            assert widest(near, near + longer, slope, slope, viewpoints, ONE) <= found * (1.0 + 1e-9) + 1e-24


class TestBoundOfARay:
    @settings(max_examples=300, deadline=None, derandomize=True)
    @given(
        st.lists(st.floats(0.01, 300.0), min_size=4, max_size=4),
        st.lists(st.floats(-3.0, 3.0), min_size=4, max_size=4),
        st.lists(st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0)), min_size=1, max_size=5),
        st.floats(0.0, 3.0),
    )
    def test_nothing_between_its_ends_is_wider(self, distances, slopes, at, rise):
        (near, one, other, far), (lowest, low, high, highest) = sorted(distances), sorted(slopes)
        along, aside = np.array(at).T.copy()
        viewpoints, every = RayViewpoints(along, aside, rise), np.ones(len(at), dtype=np.bool_)
        bound = no_wider_than(near, far, lowest, highest, viewpoints, every)
        assert widest(one, other, low, high, viewpoints, every) <= bound + 1e-24
        assert widest(near, far, lowest, highest, viewpoints, every) <= bound + 1e-24
