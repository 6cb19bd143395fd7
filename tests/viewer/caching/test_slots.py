"""Places of small pictures in a large one: never two on the same texels, and none is lost."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from viewer.caching.slots import Slots


@settings(max_examples=60)
@given(st.lists(st.tuples(st.integers(1, 70), st.integers(1, 70), st.integers(0, 9)), max_size=80))
def test_places_never_overlap_and_are_large_enough(orders):
    slots = Slots(size=128, page=64, least=8)
    used = np.zeros((128, 128), dtype=int)
    taken = []
    for width, height, dice in orders:
        if dice < 4 and taken:
            place = taken.pop(dice % len(taken))
            slots.give_back(place)
            used[place.corner[1] :, place.corner[0] :][: place.size[1], : place.size[0]] -= 1
            continue
        place = slots.take(width, height)
        if place is None:
            assert max(width, height) > 64 or used.any()
            continue
        for needed, side in zip((width, height), place.size, strict=True):
            assert needed <= side <= max(8, 2 * needed - 1)
        window = used[place.corner[1] :, place.corner[0] :][: place.size[1], : place.size[0]]
        assert window.shape == place.size[::-1]
        window += 1
        taken.append(place)
        assert used.max() == 1
    for place in taken:
        slots.give_back(place)
    assert [slots.take(64, 64) is None for _ in range(5)] == [False] * 4 + [True]


def test_what_is_too_large_has_no_place():
    slots = Slots(size=128, page=64, least=8)
    assert slots.size_for(65, 1) is slots.size_for(1, 65) is None
    assert slots.take(65, 1) is None
    assert [slots.size_for(needed, 9) for needed in (1, 8, 9, 64)] == [(8, 16), (8, 16), (16, 16), (64, 16)]
