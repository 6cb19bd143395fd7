import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from viewer.cells.layer_atlas import BORDER, bordered, shelves

sizes = st.lists(st.tuples(st.integers(1, 90), st.integers(1, 70)), max_size=40)


@given(sizes)
def test_pictures_lie_within_the_whole_and_nowhere_on_each_other(sizes):
    corners, (width, height) = shelves(sizes)
    taken = np.zeros((height, width), dtype=int)
    for (x, y), (w, h) in zip(corners, sizes, strict=True):
        assert 0 <= x <= x + w <= width
        assert 0 <= y <= y + h <= height
        taken[y : y + h, x : x + w] += 1
    assert taken.max(initial=0) <= 1


def test_little_room_is_lost():
    rng = np.random.default_rng(1)
    sizes = [tuple(16 * rng.integers(1, 20, 2)) for _ in range(60)]
    _, (width, height) = shelves(sizes)
    assert width * height < 1.35 * sum(w * h for w, h in sizes)
    assert 0.6 < width / height < 1.6


def test_a_border_repeats_the_edge():
    picture = np.arange(12).reshape(3, 4)
    around = bordered(picture)
    assert around.shape == (3 + 2 * BORDER, 4 + 2 * BORDER)
    assert np.array_equal(around[BORDER:-BORDER, BORDER:-BORDER], picture)
    assert (around[:BORDER, :BORDER] == 0).all()
    assert (around[-BORDER:, -BORDER:] == 11).all()
    assert bordered(np.zeros((2, 2, 4))).shape == (2 + 2 * BORDER, 2 + 2 * BORDER, 4)
