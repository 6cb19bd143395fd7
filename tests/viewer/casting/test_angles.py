import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from viewer.casting.angles import angle_of

numbers = st.floats(-1e6, 1e6, allow_subnormal=False)


@settings(deadline=None)
@given(numbers, numbers)
def test_it_is_the_arc_tangent(y, x):
    assert abs(angle_of(y, x) - math.atan2(y + 0.0, x + 0.0)) < 1e-11


def test_all_around_and_where_its_pieces_meet():
    turns = np.concatenate([np.linspace(-math.pi, math.pi, 4001), np.arange(-8, 9) * (math.pi / 8.0)])
    turns = np.concatenate([turns, turns + 1e-12, turns - 1e-12])
    found = np.array([angle_of(math.sin(one), math.cos(one)) for one in turns])
    off = np.abs(np.remainder(found - turns + math.pi, 2.0 * math.pi) - math.pi)
    assert off.max() < 1e-11
    assert angle_of(0.0, 0.0) == 0.0
    assert angle_of(0.0, -1.0) == math.pi
