"""Which texels around a corner share a vertex, against brute force."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mmi.cells.viewing_cells import ViewingCell
from mmi.foundation.camera import level_view
from mmi.foundation.ray_chords import Intrinsics
from mmi.meshing.tears import JOINED, Tears, filled, may_join, range_of, surface_of, surfaces_at
from mmi.parallax.from_anywhere import viewers_of

INTRINSICS = Intrinsics(-2.0, -2.0, 400.0)
VIEW = level_view(np.array([0.0, 0.0, 1.7]), 0.3, focal=400.0, window=(-2, -2, 4, 4))
VIEWERS = viewers_of(ViewingCell("", (-15.0, 0.0), (15.0, 0.0), 4.0, (1.5, 1.9)), VIEW)
LIMIT = 2.0 * math.sin(0.5 * 5.0 / 443.0)

texels = st.lists(
    st.sampled_from([0.0, 0.005, 0.006, 0.0101, 0.0102, 0.0105, 0.011, 0.012, 0.02]), min_size=16, max_size=16
)


def tears_of(values, *, all_jumps):
    return Tears(np.array(values).reshape(4, 4), VIEWERS, LIMIT, all_jumps)


@settings(max_examples=300, deadline=None)
@given(texels, st.booleans())
def test_surfaces_are_within_the_limit_and_as_few_as_their_front_most_texels_allow(values, all_jumps):
    tears = tears_of(values, all_jumps=all_jumps)
    around = tears.surface[1:3, 1:3].ravel()
    found = surfaces_at(2, 2, tears, INTRINSICS)
    names = [surface_of(found, texel) for texel in range(4)]
    assert all(
        names[name] == name <= texel for texel, name in enumerate(names)
    )  # the first texel of a surface names it
    seen = around[around > 0.0]

    def near(one, other):
        return may_join(2, 2, one, other, tears, INTRINSICS)

    if found == JOINED:
        shown = set(seen.tolist())
        flat = not shown or near(min(shown), max(shown))
        assert flat or (not all_jumps and all(goes_on(tears.surface, *pair) for pair in PAIRS))
        return
    left = {texel for texel in range(4) if around[texel] > 0.0}
    while left:  # from the front
        front = max(left, key=lambda texel: around[texel])
        own = {texel for texel in left if names[texel] == names[front]}
        assert own == {texel for texel in left if near(around[front], around[texel])}
        least, most = range_of(2, 2, tears, found, names[front])
        assert (least, most) == (min(around[list(own)]), max(around[list(own)]))
        left -= own
    assert all(names[texel] == names[int(np.argmax(around))] for texel in range(4) if around[texel] == 0.0)


PAIRS = [((1, 1), (1, 2)), ((2, 1), (2, 2)), ((1, 1), (2, 1)), ((1, 2), (2, 2))]
"""Row and column of neighbours around the corner in the middle."""


def goes_on(surface, one, other):
    """Whether 1/z changes between both by something between what it changes on either side."""
    one, other = np.array(one), np.array(other)
    line = [surface[tuple(place)] for place in (2 * one - other, one, other, 2 * other - one)]
    if not (line[1] and line[2]):
        return True
    step = line[2] - line[1]
    beside = [b - a for a, b in (line[:2], line[2:]) if a and b]
    return bool(beside) and min(beside) - 0.1 * abs(step) <= step <= max(beside) + 0.1 * abs(step)


@settings(max_examples=100, deadline=None)
@given(texels)
def test_empty_texels_next_to_covered_ones_belong_to_the_front_most(values):
    inverse = np.array(values).reshape(4, 4)
    padded = np.pad(inverse, 1)
    for j in range(4):
        for i in range(4):
            around = padded[j : j + 3, i : i + 3]
            beside = max(around[0, 1], around[1, 0], around[1, 2], around[2, 1])
            expected = inverse[j, i] or beside or around.max()
            assert filled(inverse)[j, i] == expected
