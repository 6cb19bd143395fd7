"""Places of small pictures in a large one: never two on the same texels, and none is lost."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from viewer.techniques.slots import Slots


@settings(max_examples=60)
@given(st.lists(st.tuples(st.integers(1, 70), st.integers(0, 9)), max_size=80))
def test_places_never_overlap_and_are_large_enough(orders):
    slots = Slots(size=128, page=64, least=8)
    used = np.zeros((128, 128), dtype=int)
    taken = []
    for needed, dice in orders:
        if dice < 4 and taken:
            place = taken.pop(dice % len(taken))
            slots.give_back(place)
            used[place.corner[1] :, place.corner[0] :][: place.side, : place.side] -= 1
            continue
        place = slots.take(needed)
        if place is None:
            assert needed > 64 or (used.sum() > 0)
            continue
        assert needed <= place.side <= max(8, 2 * needed - 1)
        window = used[place.corner[1] :, place.corner[0] :][: place.side, : place.side]
        assert window.shape == (place.side, place.side)
        window += 1
        taken.append(place)
        assert used.max() == 1
    for place in taken:
        slots.give_back(place)
    assert [slots.take(64) is None for _ in range(5)] == [False] * 4 + [True]


def test_what_is_too_large_has_no_place():
    slots = Slots(size=128, page=64, least=8)
    assert slots.side(65) is None
    assert slots.take(65) is None
    assert [slots.side(needed) for needed in (1, 8, 9, 64)] == [8, 8, 16, 64]
